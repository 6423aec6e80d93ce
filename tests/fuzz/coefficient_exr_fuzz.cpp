// Headers of coefficient EXRs, and the models in them: the input is the text of the attribute spectex:model, and after a line
// break lines as exr_header.h reads them.
#include "exr_header.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static const spectex::fuzz::Folder folder;
    const auto text = spectex::fuzz::text_of(data, size);
    const auto file = spectex::fuzz::write_exr(folder, "f R\nf G\nf B\nf c0\nf c1\nf c2\ns spectex:model=" + std::string(text));
    if (file) spectex::fuzz::check_exr(folder, *file);
    return 0;
}
