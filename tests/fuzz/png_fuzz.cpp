// The own PNG decoder against OpenImageIO's: bytes of any kind, with the checksums of the chunks made right, since a search
// by mutation hardly finds one. What both read is the same.
#include <OpenImageIO/imageio.h>
#include <isa-l/crc.h>

#include <vector>

#include "fuzz.h"
#include "io/png.h"

namespace {

std::uint32_t be32(const std::uint8_t* p) {
    return std::uint32_t{p[0]} << 24 | std::uint32_t{p[1]} << 16 | std::uint32_t{p[2]} << 8 | p[3];
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace spectex;
    std::vector<std::uint8_t> bytes(data, data + size);
    if (!fuzz::text_of(data, size).starts_with("\x89PNG\r\n\x1a\n")) return 0;
    for (std::size_t at = 8; at + 12 <= bytes.size();) {
        const std::size_t length = be32(&bytes[at]);
        if (length > bytes.size() - at - 12) break;
        const auto sum = crc32_gzip_refl(0, &bytes[at + 4], length + 4);
        for (std::size_t i = 0; i < 4; ++i) bytes[at + 8 + length + i] = static_cast<std::uint8_t>(sum >> (24 - 8 * i));
        at += 12 + length;
    }
    static const fuzz::Folder folder;
    const std::string path = folder.write("image.png", bytes);
    Limits limits;
    limits.max_width = limits.max_height = 256;
    limits.max_pixels = 256 * 64;
    const auto facts = io::read_file_facts(path);
    const auto reader = ImageReader::open(path, 1, limits);
    if (!facts || !reader) return 0;
    const auto& header = (*reader)->header();
    const std::size_t row = static_cast<std::size_t>(header.geometry.width) * header.channels.size() * pixel_bytes(header.type);
    std::vector<std::byte> ours(row * static_cast<std::size_t>(header.geometry.height));
    for (int y = 0; y < header.geometry.height; y += 3)
        if (!(*reader)->read_rows(y, std::min(3, header.geometry.height - y), ours.data() + row * static_cast<std::size_t>(y))) return 0;
    // Whether that was the own decoder.
    if (!io::open_png(header, *facts)) return 0;
    OIIO::ImageSpec hints;
    hints.attribute("oiio:UnassociatedAlpha", 1);
    const auto theirs = OIIO::ImageInput::open(path, &hints);
    SPECTEX_FUZZ_CHECK(theirs != nullptr);
    std::vector<std::byte> pixels(ours.size());
    // The one that reads on where the other stops may do so: libpng takes more damage than we do.
    if (!theirs->read_image(0, 0, 0, -1, header.type == PixelType::uint8 ? OIIO::TypeUInt8 : OIIO::TypeUInt16, pixels.data())) return 0;
    if (theirs->has_error()) return 0;
    SPECTEX_FUZZ_CHECK(pixels == ours);
    return 0;
}
