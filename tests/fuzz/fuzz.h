// What the fuzz targets share. A target fails by a sanitizer's report, or by a broken promise of the library's headers.
#pragma once

#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>
#include <string_view>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

/// Kept in every build type, unlike assert.
#define SPECTEX_FUZZ_CHECK(condition)                                                            \
    do {                                                                                         \
        if (!(condition)) {                                                                      \
            std::fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #condition);  \
            std::abort();                                                                        \
        }                                                                                        \
    } while (false)

namespace spectex::fuzz {

inline std::string_view text_of(const std::uint8_t* data, std::size_t size) {
    return {reinterpret_cast<const char*>(data), size};
}

/// A folder of this process for the inputs that the library only takes as files.
class Folder {
public:
    Folder() {
        std::string pattern = (std::filesystem::temp_directory_path() / "spectex_fuzz_XXXXXX").string();
        SPECTEX_FUZZ_CHECK(::mkdtemp(pattern.data()) != nullptr);
        path_ = pattern;
    }
    ~Folder() {
        std::error_code ignored;
        std::filesystem::remove_all(path_, ignored);
    }
    Folder(const Folder&) = delete;
    Folder& operator=(const Folder&) = delete;

    /// Path of a file of that name with those bytes; it replaces the one before.
    std::string write(const std::string& name, std::span<const std::uint8_t> bytes) const {
        const auto path = (path_ / name).string();
        std::ofstream out(path, std::ios::binary | std::ios::trunc);
        out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
        SPECTEX_FUZZ_CHECK(out.flush());
        return path;
    }

private:
    std::filesystem::path path_;
};

/// By the first bytes, of the formats that textures come in; null for others.
inline const char* suffix_for(std::string_view bytes) {
    using namespace std::string_view_literals;
    if (bytes.starts_with("\x76\x2f\x31\x01"sv)) return ".exr";
    if (bytes.starts_with("\x89PNG"sv)) return ".png";
    if (bytes.starts_with("\xff\xd8"sv)) return ".jpg";
    if (bytes.starts_with("II\x2a\0"sv) || bytes.starts_with("MM\0\x2a"sv)) return ".tif";
    if (bytes.starts_with("#?"sv)) return ".hdr";
    return nullptr;
}

}  // namespace spectex::fuzz
