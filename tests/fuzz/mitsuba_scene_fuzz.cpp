#include "scene_fuzz.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    spectex::fuzz::check_scene("xml", true, data, size);
    return 0;
}
