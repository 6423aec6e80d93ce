// A destination whose manifest somebody else has written.
#include "batch/manifest.h"
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    namespace fs = std::filesystem;
    using namespace spectex;
    static const fuzz::Folder folder;
    static const std::string root = fs::path(folder.write("beside.exr", {})).parent_path().string(), destination = root + "/dst";
    static const bool made = fs::create_directories(destination + "/.spxbatch") && fs::create_directories(root + "/src");
    SPECTEX_FUZZ_CHECK(made);
    folder.write("dst/out.exr", {data, std::min<std::size_t>(size, 8)});
    const std::string path = folder.write("dst/.spxbatch/manifest.sqlite", {data, size});
    for (const bool write : {false, true}) {
        auto manifest = batch::Manifest::open(path, write);
        if (!manifest) continue;
        if (const auto rows = manifest->rows())
            for (const auto& [key, row] : *rows) SPECTEX_FUZZ_CHECK(key == row.path);
        (void)manifest->orphans();
        if (!write) continue;
        batch::Row row;
        row.path = "new.png";
        if (manifest->put(row) && manifest->flush())
            if (const auto rows = manifest->rows()) SPECTEX_FUZZ_CHECK(rows->contains("new.png"));
    }
    (void)verify_batch(destination);
    (void)prune_batch(root + "/src", destination, true);
    SPECTEX_FUZZ_CHECK(fs::exists(root + "/beside.exr"));
    std::error_code ignored;
    fs::remove(path + "-journal", ignored);
    return 0;
}
