// Image files: what is read and written is bit-exact, hostile files are refused, and nothing half-written remains.
#include "spectex/io.h"

#include <gtest/gtest.h>

#include <OpenImageIO/imageio.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <random>

using namespace spectex;
namespace fs = std::filesystem;

namespace {

class IoTest : public ::testing::Test {
protected:
    void SetUp() override {
        std::string pattern = (fs::temp_directory_path() / "spectex-io-XXXXXX").string();
        ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
        folder_ = pattern;
    }
    void TearDown() override { fs::remove_all(folder_); }
    std::string path(const std::string& name) const { return (folder_ / name).string(); }
    std::size_t entries() const {
        return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
    }
    fs::path folder_;
};

std::vector<std::byte> read_bytes(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    const std::string s((std::istreambuf_iterator<char>(in)), {});
    std::vector<std::byte> b(s.size());
    std::memcpy(b.data(), s.data(), s.size());
    return b;
}
void write_bytes(const std::string& path, std::span<const std::byte> bytes) {
    std::ofstream out(path, std::ios::binary);
    out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

// Every bit pattern of integers; finite halves and floats of wide range, negatives included.
std::vector<std::byte> noise(std::size_t samples, PixelType type, unsigned seed) {
    std::mt19937 random(seed);
    std::vector<std::byte> out(samples * pixel_bytes(type));
    for (std::size_t i = 0; i < samples; ++i) {
        if (type == PixelType::float32) {
            const float v = std::ldexp(static_cast<float>(random()) / 4294967296.0F - 0.5F, static_cast<int>(random() % 40) - 20);
            std::memcpy(out.data() + 4 * i, &v, 4);
        } else if (type == PixelType::uint8) {
            out[i] = static_cast<std::byte>(random() & 255U);
        } else {
            auto v = static_cast<std::uint16_t>(random());
            // exponent 31 would be infinity or NaN
            if (type == PixelType::half && (v & 0x7c00U) == 0x7c00U) v = static_cast<std::uint16_t>(v & ~0x4000U);
            std::memcpy(out.data() + 2 * i, &v, 2);
        }
    }
    return out;
}

Result<std::vector<std::byte>> read_all(ImageReader& reader, int step) {
    const ImageHeader& h = reader.header();
    const std::size_t row = static_cast<std::size_t>(h.geometry.width) * h.channels.size() * pixel_bytes(h.type);
    std::vector<std::byte> out(row * static_cast<std::size_t>(h.geometry.height));
    for (int y = 0; y < h.geometry.height; y += step) {
        const int n = std::min(step, h.geometry.height - y);
        if (auto ok = reader.read_rows(y, n, out.data() + row * static_cast<std::size_t>(y)); !ok) return ok.error();
    }
    return out;
}

Status write_all(ImageWriter& writer, const Geometry& g, std::span<const std::byte> samples, int step) {
    const std::size_t row = samples.size() / static_cast<std::size_t>(g.height);
    for (int y = 0; y < g.height; y += step) {
        const int n = std::min(step, g.height - y);
        if (auto ok = writer.write_rows(y, n, samples.data() + row * static_cast<std::size_t>(y)); !ok) return ok;
    }
    return writer.commit();
}

Geometry size(int width, int height) {
    Geometry g;
    g.width = g.full_width = width;
    g.height = g.full_height = height;
    return g;
}

}  // namespace

TEST_F(IoTest, RoundTripIsExactForEveryFormatTypeAndCompression) {
    struct Case {
        std::string suffix;
        PixelType type;
        std::string compression;
        int channels;
    };
    using enum PixelType;
    const std::vector<Case> cases{
        {"exr", half, "", 4},      {"exr", half, "none", 6},  {"exr", half, "rle", 3},   {"exr", half, "zips", 1},
        {"exr", half, "zip", 5},   {"exr", half, "piz", 4},   {"exr", float32, "", 4},   {"exr", float32, "none", 5},
        {"exr", float32, "rle", 1}, {"exr", float32, "zips", 3}, {"exr", float32, "zip", 5}, {"exr", float32, "piz", 4},
        {"png", uint8, "", 3},     {"png", uint8, "1", 4},    {"png", uint16, "9", 4},   {"png", uint16, "", 1},
        {"png", uint8, "0", 2},    {"tif", uint8, "", 4},     {"tif", uint16, "none", 6}, {"tif", uint16, "lzw", 3},
        {"tif", float32, "zip", 4}, {"tif", uint8, "lzw", 1}, {"tga", uint8, "", 4},     {"bmp", uint8, "", 3},
        {"ppm", uint8, "", 3},       {"sgi", uint16, "", 4},
        {"dpx", uint16, "", 3}};
    const std::vector<std::string> names{"R", "G", "B", "A", "mask", "id"};
    const Geometry g = size(67, 131);
    unsigned seed = 1;
    for (const Case& c : cases) {
        SCOPED_TRACE(c.suffix + " " + std::string(pixel_type_name(c.type)) + " " + c.compression + " " +
                     std::to_string(c.channels));
        std::vector<std::string> channels(names.begin(), names.begin() + c.channels);
        if (c.channels == 1) channels = {"Y"};
        if (c.channels == 2) channels = {"Y", "A"};
        const auto samples = noise(static_cast<std::size_t>(g.width * g.height * c.channels), c.type, seed++);
        const std::string file = path("t" + std::to_string(seed) + "." + c.suffix);
        auto writer = ImageWriter::create(file, g, channels, false, {}, {c.type, c.compression, 2});
        ASSERT_TRUE(writer) << writer.error().message;
        ASSERT_EQ((*writer)->type(), c.type);
        auto done = write_all(**writer, g, samples, 17);
        ASSERT_TRUE(done) << done.error().message;
        auto reader = ImageReader::open(file);
        ASSERT_TRUE(reader) << reader.error().message;
        const ImageHeader& h = (*reader)->header();
        EXPECT_EQ(h.type, c.type);
        EXPECT_TRUE(h.geometry.same_size(g));
        ASSERT_EQ(h.channels.size(), channels.size());
        EXPECT_TRUE(h.has_color());
        EXPECT_EQ(h.is_grey(), c.channels <= 2);
        EXPECT_EQ(h.alpha >= 0, c.channels == 2 || c.channels >= 4);
        for (int step : {1, 7, (*reader)->preferred_rows()}) {
            auto again = ImageReader::open(file);
            auto got = read_all(**again, step);
            ASSERT_TRUE(got) << got.error().message;
            const std::size_t bytes = pixel_bytes(c.type), n = channels.size();
            std::size_t wrong = 0;
            for (std::size_t k = 0; k < n; ++k) {
                const auto at = static_cast<std::size_t>(
                    std::find(h.channels.begin(), h.channels.end(), channels[k]) - h.channels.begin());
                // TIFF keeps no names beyond the four.
                const std::size_t from = at < n ? at : k;
                for (std::size_t p = 0; p < samples.size() / bytes / n; ++p)
                    wrong += std::memcmp(samples.data() + (p * n + k) * bytes, got->data() + (p * n + from) * bytes, bytes) != 0;
            }
            EXPECT_EQ(wrong, 0U) << "rows at a time: " << step;
        }
    }
    EXPECT_EQ(entries(), cases.size()) << "a temporary file remained";
}
