// Channel names and attributes of spectral EXRs.
#include "exr_header.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static const spectex::fuzz::Folder folder;
    if (const auto file = spectex::fuzz::write_exr(folder, spectex::fuzz::text_of(data, size))) spectex::fuzz::check_exr(folder, *file);
    return 0;
}
