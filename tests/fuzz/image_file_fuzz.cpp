// Whole files, by the readers that a texture meets. Only formats of textures are passed on: the library opens whatever
// OpenImageIO does, but the search is for faults between the two, not in its rarer decoders.
#include <algorithm>
#include <vector>

#include "fuzz.h"
#include "spectex/io.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const char* suffix = spectex::fuzz::suffix_for(spectex::fuzz::text_of(data, size));
    if (suffix == nullptr) return 0;
    static const spectex::fuzz::Folder folder;
    const auto path = folder.write(std::string("image") + suffix, {data, size});
    // A decompression bomb must be refused by its header; what is within the limits is cheap to read.
    spectex::Limits limits;
    limits.max_width = limits.max_height = 256;
    limits.max_pixels = 256 * 64;
    limits.max_channels = 64;
    limits.max_row_bytes = 64 * 1024;
    constexpr int rows = 4;
    (void)spectex::probe(path);
    if (auto reader = spectex::ImageReader::open(path, 1, limits)) {
        const auto& header = (*reader)->header();
        SPECTEX_FUZZ_CHECK(header.geometry.width >= 1 && header.geometry.width <= limits.max_width);
        SPECTEX_FUZZ_CHECK(header.geometry.height >= 1 && header.geometry.height <= limits.max_height);
        SPECTEX_FUZZ_CHECK(!header.channels.empty() && (*reader)->preferred_rows() >= 1);
        const auto channels = static_cast<int>(header.channels.size());
        for (const int c : header.color) SPECTEX_FUZZ_CHECK(c >= -1 && c < channels);
        const std::size_t row_bytes = static_cast<std::size_t>(header.geometry.width) * header.channels.size() *
                                      spectex::pixel_bytes(header.type);
        for (int y = 0; y < header.geometry.height; y += rows) {
            const int count = std::min(rows, header.geometry.height - y);
            // As large as promised and no larger, so that an overrun is seen.
            std::vector<std::byte> out(row_bytes * static_cast<std::size_t>(count));
            if (!(*reader)->read_rows(y, count, out.data())) break;
        }
    }
    if (auto reader = spectex::SpectralReader::open(path, 1, limits)) {
        const auto& header = (*reader)->header();
        const std::size_t planes = header.wavelengths_nm.size() + header.coefficients.size();
        SPECTEX_FUZZ_CHECK(planes >= 1 && header.others.size() == header.other_types.size());
        for (std::size_t i = 1; i < header.wavelengths_nm.size(); ++i)
            SPECTEX_FUZZ_CHECK(header.wavelengths_nm[i] > header.wavelengths_nm[i - 1]);
        const auto width = static_cast<std::size_t>(header.geometry.width);
        for (int y = 0; y < header.geometry.height; y += rows) {
            const int count = std::min(rows, header.geometry.height - y);
            const std::size_t samples = width * static_cast<std::size_t>(count);
            std::vector<std::vector<float>> bands(planes, std::vector<float>(samples));
            std::vector<float*> band_pointers;
            for (auto& band : bands) band_pointers.push_back(band.data());
            std::vector<std::vector<std::byte>> others;
            std::vector<std::byte*> other_pointers;
            for (const auto type : header.other_types) others.emplace_back(samples * spectex::pixel_bytes(type));
            for (auto& other : others) other_pointers.push_back(other.data());
            if (!(*reader)->read_rows(y, count, band_pointers, other_pointers)) break;
        }
    }
    return 0;
}
