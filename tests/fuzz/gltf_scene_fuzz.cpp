#include "scene_fuzz.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    spectex::fuzz::check_scene("gltf", false, data, size);
    return 0;
}
