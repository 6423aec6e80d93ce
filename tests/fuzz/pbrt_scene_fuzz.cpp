#include "scene_fuzz.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    spectex::fuzz::check_scene("pbrt", true, data, size);
    return 0;
}
