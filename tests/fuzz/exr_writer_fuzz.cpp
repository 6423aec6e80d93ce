// The own writer and reader of compressed EXR chunks: pictures of any shape are read back by OpenEXR and by us bit for bit.
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>

#include <algorithm>
#include <cstring>
#include <vector>

#include "fuzz.h"
#include "spectex/io.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace spectex;
    if (size < 6) return 0;
    Geometry g;
    g.width = g.full_width = 1 + data[0] % 70;
    g.height = g.full_height = 1 + data[1] % 70;
    g.x = static_cast<std::int8_t>(data[2]);
    g.y = static_cast<std::int8_t>(data[3]);
    const std::size_t channels = 1 + data[4] % 5;
    constexpr const char* compressions[] = {"zip", "zips", "none", "piz", "rle"};
    const int strip = 1 + data[5] / 8;
    WriteOptions options{PixelType::half, compressions[data[5] % 5], 1};
    const std::uint8_t* rest = data + 6;
    const std::size_t left = size - 6;
    ExrPart part;
    std::vector<std::vector<std::byte>> planes;
    const auto pixels = static_cast<std::size_t>(g.width) * static_cast<std::size_t>(g.height);
    for (std::size_t c = 0; c < channels; ++c) {
        // Not in the order of the file, which is that of the names.
        part.channels.push_back({std::string(1, static_cast<char>('Z' - 7 * c % 26)), data[4] >> c & 8 ? PixelType::float32 : PixelType::half});
        planes.emplace_back(pixels * pixel_bytes(part.channels.back().type));
        for (std::size_t i = 0; i < planes[c].size() && left > 0; ++i) planes[c][i] = std::byte{rest[(i + c) % left]};
    }
    static const fuzz::Folder folder;
    const std::string path = folder.write("image.exr", {});
    auto writer = ExrWriter::create(path, g, {part}, options);
    SPECTEX_FUZZ_CHECK(writer.ok());
    for (int y = 0; y < g.height; y += strip) {
        std::vector<const std::byte*> rows;
        for (std::size_t c = 0; c < channels; ++c)
            rows.push_back(planes[c].data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(g.width) * pixel_bytes(part.channels[c].type));
        SPECTEX_FUZZ_CHECK((*writer)->write_rows(y, std::min(strip, g.height - y), rows).ok());
    }
    SPECTEX_FUZZ_CHECK((*writer)->commit().ok());

    Imf::InputFile file(path.c_str(), 0);
    SPECTEX_FUZZ_CHECK(file.isComplete());
    Imf::FrameBuffer frame;
    std::vector<std::vector<std::byte>> read;
    for (std::size_t c = 0; c < channels; ++c) {
        read.emplace_back(planes[c].size());
        const std::size_t bytes = pixel_bytes(part.channels[c].type);
        const auto type = bytes == 2 ? Imf::HALF : Imf::FLOAT;
        SPECTEX_FUZZ_CHECK(file.header().channels()[part.channels[c].name].type == type);
        frame.insert(part.channels[c].name, Imf::Slice::Make(type, read[c].data(), file.header().dataWindow(), bytes, bytes * static_cast<std::size_t>(g.width)));
    }
    file.setFrameBuffer(frame);
    file.readPixels(g.y, g.y + g.height - 1);
    SPECTEX_FUZZ_CHECK(read == planes);

    // And by the own reader, in strips of another height.
    if (std::any_of(part.channels.begin(), part.channels.end(), [&](const auto& c) { return c.type != part.channels[0].type; })) return 0;
    auto reader = ImageReader::open(path, 1);
    SPECTEX_FUZZ_CHECK(reader.ok());
    const auto& header = (*reader)->header();
    SPECTEX_FUZZ_CHECK(header.type == part.channels[0].type && header.channels.size() == channels);
    const std::size_t sample = pixel_bytes(header.type), row = channels * sample * static_cast<std::size_t>(g.width);
    const int step = 1 + data[4] / 8;
    for (int y = 0; y < g.height; y += step) {
        const int rows = std::min(step, g.height - y);
        std::vector<std::byte> got(row * static_cast<std::size_t>(rows));
        SPECTEX_FUZZ_CHECK((*reader)->read_rows(y, rows, got.data()).ok());
        for (std::size_t c = 0; c < channels; ++c) {
            const auto place = static_cast<std::size_t>(std::find(header.channels.begin(), header.channels.end(), part.channels[c].name) - header.channels.begin());
            const std::byte* plane = planes[c].data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(g.width) * sample;
            for (std::size_t i = 0; i < got.size() / (channels * sample); ++i)
                SPECTEX_FUZZ_CHECK(std::memcmp(got.data() + (i * channels + place) * sample, plane + i * sample, sample) == 0);
        }
    }
    return 0;
}
