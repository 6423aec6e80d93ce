// Image files: what is read and written is bit-exact, hostile files are refused, and nothing half-written remains.
#include "spectex/io.h"

#include <gtest/gtest.h>

#include <OpenImageIO/imageio.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <Imath/half.h>
#include <fmt/format.h>

#include <array>
#include <clocale>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <locale>
#include <random>
#include <thread>

#include "io/deflate.h"

using namespace spectex;
namespace fs = std::filesystem;

namespace {

#if defined(SPECTEX_SLOW_BUILD)
constexpr bool slow_build = true;
#else
constexpr bool slow_build = false;
#endif

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
        {"ppm", uint8, "", 3}};
    const std::vector<std::string> names{"R", "G", "B", "A", "mask", "id"};
    const Geometry g = size(slow_build ? 23 : 67, 131);
    unsigned seed = 1;
    for (const Case& c : cases) {
        SCOPED_TRACE(c.suffix + " " + std::string(pixel_type_name(c.type)) + " " + c.compression + " " +
                     std::to_string(c.channels));
        std::vector<std::string> channels(names.begin(), names.begin() + c.channels);
        if (c.channels == 1) channels = {"Y"};
        if (c.channels == 2) channels = {"Y", "A"};
        const auto samples = noise(static_cast<std::size_t>(g.width * g.height * c.channels), c.type, seed++);
        const std::string file = path(std::to_string(seed) + "." + c.suffix);
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

TEST_F(IoTest, AlphaAndExtraChannelsPassUntouched) {
    // 42 in the mask, alpha below the colour: premultiplying or its undoing would change either.
    const Geometry g = size(9, 5);
    const std::vector<std::string> channels{"R", "G", "B", "A", "mask"};
    std::vector<std::byte> samples;
    for (int i = 0; i < 45; ++i)
        for (const int v : {200, 100, 50, 10, 42}) samples.push_back(static_cast<std::byte>(v));
    for (const char* name : {"x.tif", "x.png"}) {
        const std::size_t n = std::string(name) == "x.tif" ? 5 : 4;
        std::vector<std::byte> part;
        for (std::size_t p = 0; p < 45; ++p)
            part.insert(part.end(), samples.begin() + static_cast<std::ptrdiff_t>(p * 5),
                        samples.begin() + static_cast<std::ptrdiff_t>(p * 5 + n));
        auto w = ImageWriter::create(path(name), g, {channels.begin(), channels.begin() + static_cast<std::ptrdiff_t>(n)}, false,
                                     {}, {PixelType::uint8, "", 1});
        ASSERT_TRUE(w) << w.error().message;
        ASSERT_TRUE(write_all(**w, g, part, 5));
        auto r = ImageReader::open(path(name));
        ASSERT_TRUE(r) << r.error().message;
        EXPECT_EQ((*r)->header().alpha, 3);
        EXPECT_FALSE((*r)->header().alpha_associated);
        EXPECT_EQ((*r)->header().others.size(), n - 3);
        auto got = read_all(**r, 2);
        ASSERT_TRUE(got);
        EXPECT_EQ(*got, part) << name;
    }
}

TEST_F(IoTest, ChannelNamesAreFoundInAnySpellingAndLayer) {
    struct Case {
        std::vector<std::string> channels;
        std::vector<std::string> color;  // expected R, G, B
        std::string alpha;
    };
    const std::vector<Case> cases{{{"A", "B", "G", "R"}, {"R", "G", "B"}, "A"},
                                  {{"Z", "r", "g", "b", "a"}, {"r", "g", "b"}, "a"},
                                  {{"Red", "green", "BLUE", "alpha"}, {"Red", "green", "BLUE"}, "alpha"},
                                  {{"depth.Z", "diffuse.R", "diffuse.G", "diffuse.B", "spec.R"},
                                   {"diffuse.R", "diffuse.G", "diffuse.B"}, ""},
                                  {{"a.R", "a.G", "b.R", "b.G", "b.B", "b.A"}, {"b.R", "b.G", "b.B"}, "b.A"},
                                  {{"Y", "A"}, {"Y", "Y", "Y"}, "A"},
                                  {{"luminance"}, {"luminance", "luminance", "luminance"}, ""},
                                  {{"height"}, {"height", "height", "height"}, ""},
                                  {{"R", "G", "B", "r"}, {"R", "G", "B"}, ""},
                                  {{"Z"}, {}, ""},
                                  {{"u", "v"}, {}, ""},
                                  {{"Y", "BY", "RY"}, {}, ""}};
    const Geometry g = size(3, 2);
    for (std::size_t k = 0; k < cases.size(); ++k) {
        const Case& c = cases[k];
        SCOPED_TRACE(c.channels.front());
        const std::string file = path(std::to_string(k) + ".exr");
        auto w = ImageWriter::create(file, g, c.channels, true, {}, {PixelType::half, "", 1});
        ASSERT_TRUE(w) << w.error().message;
        ASSERT_TRUE(write_all(**w, g, noise(6 * c.channels.size(), PixelType::half, 5), 2));
        auto r = ImageReader::open(file);
        ASSERT_TRUE(r) << r.error().message;
        const ImageHeader& h = (*r)->header();
        ASSERT_EQ(h.has_color(), !c.color.empty());
        for (std::size_t i = 0; i < c.color.size(); ++i)
            EXPECT_EQ(h.channels[static_cast<std::size_t>(h.color[i])], c.color[i]);
        EXPECT_EQ(h.alpha >= 0 ? h.channels[static_cast<std::size_t>(h.alpha)] : "", c.alpha);
        EXPECT_EQ(h.alpha_associated, h.alpha >= 0);
    }
}

namespace {

struct CommaLocale : std::numpunct<char> {
    char do_decimal_point() const override { return ','; }
    char do_thousands_sep() const override { return '.'; }
    std::string do_grouping() const override { return "\3"; }
};

void check_names() {
    struct Case {
        const char* name;
        double nm;
        const char* stem;
        const char* layer;
    };
    const Case good[] = {{"T.400,000000nm", 400, "T", ""},   {"T.400.000000nm", 400, "T", ""},
                         {"T.380,0nm", 380, "T", ""},        {"T.380nm", 380, "T", ""},
                         {"S0.780,5nm", 780.5, "S0", ""},    {"S3.1e3nm", 1000, "S3", ""},
                         {"T.0,4um", 400, "T", ""},          {"T.0.4\xc2\xb5m", 400, "T", ""},
                         {"T.0.4\xce\xbcm", 400, "T", ""},   {"T.400e-9m", 400, "T", ""},
                         {"T.4,00E-7m", 400, "T", ""},       {"T.4e+2nm", 400, "T", ""},
                         {"T.0.0004mm", 400, "T", ""},       {"T.400000pm", 400, "T", ""},
                         {"T.749,481145THz", 400, "T", ""},  {"T.7.49481145e14Hz", 400, "T", ""},
                         {"T.749481.145GHz", 400, "T", ""},  {"S0.0,749481145PHz", 400, "S0", ""},
                         {"diffuse.T.400,5nm", 400.5, "T", "diffuse"}, {"a.b.T.400.5nm", 400.5, "T", "a.b"},
                         {"T.T.410nm", 410, "T", "T"},       {"T.,5um", 500, "T", ""},
                         {"T.500,nm", 500, "T", ""},         {"left.S0.0000400nm", 400, "S0", "left"},
                         {"T.4000000dam", 4e16, "T", ""},    {"T.0,00000000000000000004Em", 4e7, "T", ""}};
    for (const Case& c : good) {
        const auto n = parse_spectral_channel_name(c.name);
        ASSERT_TRUE(n) << c.name;
        const bool metres = std::string(c.name).find("Hz") == std::string::npos;
        // Lengths are rounded once, from their decimal text; frequencies are spelled with nine digits.
        EXPECT_NEAR(n->wavelength_nm, c.nm, metres ? 0.0 : 1e-6) << c.name;
        EXPECT_EQ(n->stem, c.stem) << c.name;
        EXPECT_EQ(n->layer, c.layer) << c.name;
    }
    for (const char* bad : {"", "T", "T.", "T.nm", "T.,nm", "T.400", "T.400n", "T.-400nm", "T.+400nm", "T.0nm", "T.0Hz", "T.infnm",
                            "T.nannm", "T.0x1p9nm", "T.4.0.0nm", "T.1.000,5nm", "T.400nmx", "T 400nm", "t.400nm", "S4.400nm",
                            "XT.400nm", "T.1e999nm", "T.1e-9999nm", "T.4e99999999999nm", "T.400 nm", "R", "T.400nm.R",
                            "T.400,000000Nm", "T..400nm.", "S0"})
        EXPECT_FALSE(parse_spectral_channel_name(bad)) << bad;
    EXPECT_EQ(spectral_channel_name("T", 400), "T.400,000000nm");
    EXPECT_EQ(spectral_channel_name("S0", 1234.5678912), "S0.1234,567891nm");
    for (double nm : {380.0, 400.123456, 1234.5, 0.000001})
        EXPECT_EQ(parse_spectral_channel_name(spectral_channel_name("T", nm))->wavelength_nm, nm);
}

}  // namespace

TEST(SpectralNames, AreReadInEverySpelling) { check_names(); }

TEST(SpectralNames, DoNotDependOnTheLocale) {
    const std::string before = std::setlocale(LC_ALL, nullptr);
    // Whether the machine has the locale or not, the C++ one below has a decimal comma.
    (void)std::setlocale(LC_ALL, "de_DE.UTF-8");
    const std::locale old = std::locale::global(std::locale(std::locale::classic(), new CommaLocale));
    check_names();
    std::locale::global(old);
    std::setlocale(LC_ALL, before.c_str());
}

namespace {

// Bands as the caller orders them; sample (x, y) of channel c is a half-exact number that tells all three apart.
float band_value(std::size_t c, int x, int y) { return static_cast<float>(static_cast<int>(c) * 64 + (x * 7 + y * 3) % 64); }

Status write_planes(const std::string& file, const Geometry& g, const std::vector<ExrPart>& parts, WriteOptions options,
                    int step = 1000) {
    auto w = ExrWriter::create(file, g, parts, options);
    if (!w) return w.error();
    for (int y0 = 0; y0 < g.height; y0 += step) {
        const int rows = std::min(step, g.height - y0);
        std::vector<std::vector<std::byte>> planes;
        std::vector<const std::byte*> pointers;
        for (const ExrPart& part : parts)
            for (const ExrChannel& c : part.channels) {
                std::vector<std::byte> plane;
                for (int y = y0; y < y0 + rows; ++y)
                    for (int x = 0; x < g.width; ++x) {
                        const float v = band_value(planes.size(), x, y);
                        std::array<std::byte, 4> raw{};
                        if (c.type == PixelType::half) {
                            const Imath::half h(v);
                            std::memcpy(raw.data(), &h, 2);
                        } else {
                            std::memcpy(raw.data(), &v, 4);
                        }
                        plane.insert(plane.end(), raw.begin(), raw.begin() + static_cast<std::ptrdiff_t>(pixel_bytes(c.type)));
                    }
                planes.push_back(std::move(plane));
            }
        for (const auto& p : planes) pointers.push_back(p.data());
        if (auto ok = (*w)->write_rows(y0, rows, pointers); !ok) return ok;
    }
    return (*w)->commit();
}

ExrPart part_of(const std::string& name, const std::vector<std::string>& channels, PixelType type, Attributes a = {}) {
    ExrPart p{name, {}, std::move(a)};
    for (const auto& c : channels) p.channels.push_back({c, type});
    return p;
}

// channel_of[i] is the number of band i's channel in the order of writing.
void expect_planes(const std::string& file, const Geometry& g, const std::vector<std::size_t>& channel_of, int step) {
    auto r = SpectralReader::open(file);
    ASSERT_TRUE(r) << r.error().message;
    const auto n = channel_of.size();
    for (int y = 0; y < g.height; y += step) {
        const int rows = std::min(step, g.height - y);
        std::vector<std::vector<float>> planes(n, std::vector<float>(static_cast<std::size_t>(rows * g.width)));
        std::vector<float*> pointers;
        for (auto& p : planes) pointers.push_back(p.data());
        if (n > 2) pointers[1] = nullptr;
        auto ok = (*r)->read_rows(y, rows, pointers, {});
        ASSERT_TRUE(ok) << ok.error().message;
        for (std::size_t b = 0; b < n; ++b)
            for (int yy = 0; yy < rows; ++yy)
                for (int x = 0; x < g.width; ++x)
                    ASSERT_EQ(planes[b][static_cast<std::size_t>(yy * g.width + x)],
                              pointers[b] ? band_value(channel_of[b], x, y + yy) : 0.0F)
                        << "band " << b << " at " << x << "," << y + yy;
    }
}

/// The decoder runs ahead of what is asked for: it may have taken all input before the last rows are out.
TEST_F(IoTest, EndsOfPngs) {
    for (const auto& [width, height, channels] : {std::array{512, 512, 4}, {512, 511, 4}, {1024, 172, 3}, {700, 500, 3}, {2048, 129, 4}, {3000, 59, 3}, {9, 3, 1}})
        for (const int noisy : {0, 40, 99}) {
            const auto row = static_cast<std::size_t>(width * channels);
            std::vector<std::uint8_t> pixels(row * static_cast<std::size_t>(height), 200), read(pixels.size());
            std::minstd_rand random(1);
            for (std::size_t i = 0; i < pixels.size() * static_cast<std::size_t>(noisy) / 100; ++i) pixels[i] = static_cast<std::uint8_t>(random());
            const std::string name = path("flat.png");
            auto out = OIIO::ImageOutput::create(name);
            OIIO::ImageSpec spec(width, height, channels, OIIO::TypeUInt8);
            spec["oiio:UnassociatedAlpha"] = 1;
            ASSERT_TRUE(out && out->open(name, spec) && out->write_image(OIIO::TypeUInt8, pixels.data()) && out->close());
            auto reader = ImageReader::open(name);
            ASSERT_TRUE(reader) << reader.error().message;
            const auto status = (*reader)->read_rows(0, height, reinterpret_cast<std::byte*>(read.data()));
            EXPECT_TRUE(status) << status.error().message;
            EXPECT_TRUE(read == pixels) << width << " x " << height;
        }
}

/// The encoder's matches depend on where its state lies (see deflate.cpp): every thread must have it in such a place that they
/// depend on the data alone.
TEST(Deflate, LiesWhereItsBytesDependOnTheDataAlone) {
    // Zeros that come back at other distances are what showed it.
    std::vector<std::uint8_t> data(std::size_t{1} << 17);
    std::minstd_rand random(3);
    for (std::size_t i = 0; i < data.size(); ++i) data[i] = i % 49248 < 24587 ? std::uint8_t{0} : static_cast<std::uint8_t>(random() % 7);
    std::vector<std::uint8_t> expected;
    io::deflate_append(data.data(), data.size(), true, expected);
    for (int i = 0; i < 16; ++i)
        std::thread([&] {
            EXPECT_TRUE(io::deflate_place_is_chosen());
            std::vector<std::uint8_t> out;
            io::deflate_append(data.data(), data.size(), true, out);
            EXPECT_EQ(out, expected);
        }).join();
}

}  // namespace

TEST_F(IoTest, BandsAreSortedByNumberWhateverTheirSpelling) {
    Geometry g = size(23, 40);
    g.x = -7;
    g.y = -1000;
    g.full_x = 3;
    g.full_width = 100;
    // The lexical order puts 1000 before 400; frequencies ascend where wavelengths descend.
    const std::vector<std::string> names{"T.1000,0nm", "T.400,000000nm", "T.0.5um", "T.500THz", "T.700.5nm", "A", "id.X"};
    for (const bool multi : {false, true})
        for (const PixelType type : {PixelType::half, PixelType::float32})
            for (const std::string compression : {"none", "rle", "zips", "zip", "piz"}) {
                SCOPED_TRACE(compression + (multi ? " multi" : " single"));
                const std::string file = path("s.exr");
                std::vector<ExrPart> parts{part_of("all", names, type, {{"spectralLayoutVersion", std::string("1.0")}})};
                if (multi)
                    parts = {part_of("rgb", {"R", "G", "B"}, type), part_of("low", {names[0], names[1], names[2]}, type),
                             part_of("high", {names[3], names[4], names[5], names[6]}, type)};
                auto ok = write_planes(file, g, parts, {type, compression, 2}, 13);
                ASSERT_TRUE(ok) << ok.error().message;
                auto r = SpectralReader::open(file);
                ASSERT_TRUE(r) << r.error().message;
                const SpectralHeader& h = (*r)->header();
                EXPECT_EQ(h.kind, FileKind::spectral);
                EXPECT_EQ(h.parts, multi ? 3 : 1);
                EXPECT_EQ(h.has_rgb, multi);
                EXPECT_EQ(h.type, type);
                EXPECT_EQ(h.geometry.x, -7);
                EXPECT_EQ(h.geometry.y, -1000);
                EXPECT_EQ(h.geometry.full_x, 3);
                EXPECT_EQ(h.geometry.full_width, 100);
                ASSERT_EQ(h.wavelengths_nm.size(), 5U);
                EXPECT_EQ(h.wavelengths_nm[0], 400);
                EXPECT_EQ(h.wavelengths_nm[1], 500);
                EXPECT_NEAR(h.wavelengths_nm[2], 599.584916, 1e-6);  // c / 500 THz
                EXPECT_EQ(h.wavelengths_nm[4], 1000);
                EXPECT_EQ(h.others, (std::vector<std::string>{"A", "id.X"}));
                const std::size_t o = multi ? 3 : 0;
                for (const int step : {1, 9, 40}) expect_planes(file, g, {1 + o, 2 + o, 3 + o, 4 + o, 0 + o}, step);
                EXPECT_EQ(*probe(file), FileKind::spectral);
            }
}

TEST_F(IoTest, RepeatedWavelengthsNameBothChannels) {
    const std::string file = path("r.exr");
    ASSERT_TRUE(write_planes(file, size(2, 2), {part_of("", {"T.400nm", "T.0,4um", "T.500nm"}, PixelType::half)}, {}));
    auto r = SpectralReader::open(file);
    ASSERT_FALSE(r);
    EXPECT_NE(r.error().message.find("T.400nm"), std::string::npos) << r.error().message;
    EXPECT_NE(r.error().message.find("T.0,4um"), std::string::npos) << r.error().message;
    EXPECT_FALSE(probe(file));
}

TEST_F(IoTest, KindsAreTold) {
    const Geometry g = size(4, 3);
    using enum PixelType;
    ASSERT_TRUE(write_planes(path("e.exr"), g, {part_of("", {"S0.400nm", "S0.500nm", "S1.400nm"}, half)}, {}));
    auto e = SpectralReader::open(path("e.exr"));
    ASSERT_TRUE(e);
    EXPECT_TRUE((*e)->header().emissive);
    EXPECT_FALSE((*e)->header().has_both);
    ASSERT_TRUE(write_planes(path("b.exr"), g, {part_of("", {"S0.400nm", "T.500nm", "T.600nm"}, half)}, {}));
    auto b = SpectralReader::open(path("b.exr"));
    ASSERT_TRUE(b);
    EXPECT_FALSE((*b)->header().emissive);
    EXPECT_TRUE((*b)->header().has_both);
    EXPECT_EQ((*b)->header().wavelengths_nm, (std::vector<double>{500, 600}));
    ASSERT_TRUE(write_planes(path("c.exr"), g,
                             {part_of("", {"q2", "q0", "q1", "A"}, float32,
                                      {{"spectex:model", std::string("m")}, {"spectex:coefficients", std::string("q0,q1,q2")}})},
                             {}));
    auto c = SpectralReader::open(path("c.exr"));
    ASSERT_TRUE(c) << c.error().message;
    EXPECT_EQ((*c)->header().kind, FileKind::coefficients);
    EXPECT_EQ((*c)->header().coefficients, (std::vector<std::string>{"q0", "q1", "q2"}));
    EXPECT_EQ((*c)->header().others, (std::vector<std::string>{"A"}));
    EXPECT_EQ((*c)->header().attributes.at("spectex:model"), AttributeValue(std::string("m")));
    expect_planes(path("c.exr"), g, {1, 2, 0}, 3);
    EXPECT_EQ(*probe(path("c.exr")), FileKind::coefficients);
    ASSERT_TRUE(write_planes(path("m.exr"), g,
                             {part_of("", {"q0", "q1"}, float32,
                                      {{"spectex:model", std::string("m")}, {"spectex:coefficients", std::string("q0,q1,q2")}})},
                             {}));
    auto m = SpectralReader::open(path("m.exr"));
    ASSERT_FALSE(m);
    EXPECT_NE(m.error().message.find("'q2'"), std::string::npos) << m.error().message;
    ASSERT_TRUE(write_planes(path("i.exr"), g, {part_of("", {"R", "G", "B"}, half)}, {}));
    EXPECT_EQ(*probe(path("i.exr")), FileKind::image);
    EXPECT_FALSE(SpectralReader::open(path("i.exr")));
    ASSERT_TRUE(write_text_file(path("t.exr"), "not an image"));
    EXPECT_FALSE(probe(path("t.exr")));
    EXPECT_FALSE(probe(path("missing.exr")));
    EXPECT_FALSE(probe(folder_.string()));
}

TEST_F(IoTest, TruncatedFilesFailAndNameTheFile) {
    const Geometry g = size(61, 97);
    for (const char* suffix : {"exr", "png", "tif", "jpg", "tga", "bmp", "ppm", "hdr"}) {
        const std::string whole = path(std::string("whole.") + suffix), cut = path(std::string("cut.") + suffix);
        const PixelType type = *storable_type(whole, PixelType::uint8);
        auto w = ImageWriter::create(whole, g, {"R", "G", "B"}, false, {}, {type, "", 1});
        ASSERT_TRUE(w) << w.error().message;
        ASSERT_TRUE(write_all(**w, g, noise(61 * 97 * 3, type, 3), 97));
        const auto bytes = read_bytes(whole);
        for (std::size_t k = 0; k < 16; ++k) {
            SCOPED_TRACE(std::string(suffix) + " " + std::to_string(k) + "/16");
            write_bytes(cut, std::span(bytes).first(bytes.size() * k / 16));
            auto r = ImageReader::open(cut);
            std::string message;
            if (!r) {
                message = r.error().message;
            } else {
                auto got = read_all(**r, 16);
                ASSERT_FALSE(got) << "read as if whole";
                message = got.error().message;
                EXPECT_NE(message.find("row"), std::string::npos) << message;
            }
            EXPECT_NE(message.find(cut), std::string::npos) << message;
        }
    }
    const std::string whole = path("spectral.exr"), cut = path("spectral-cut.exr");
    ASSERT_TRUE(write_planes(whole, g, {part_of("a", {"T.400nm", "T.500nm"}, PixelType::half),
                                        part_of("b", {"T.600nm"}, PixelType::half)}, {}));
    const auto bytes = read_bytes(whole);
    for (std::size_t k = 0; k < 16; ++k) {
        write_bytes(cut, std::span(bytes).first(bytes.size() * k / 16));
        auto r = SpectralReader::open(cut);
        if (!r) continue;
        std::vector<float> plane(61 * 97);
        float* const planes[] = {plane.data(), plane.data(), plane.data()};
        auto got = (*r)->read_rows(0, 97, planes, {});
        ASSERT_FALSE(got) << k;
        EXPECT_NE(got.error().message.find(cut), std::string::npos) << got.error().message;
    }
}

TEST_F(IoTest, DeclaredSizesOverTheLimitsAreRefused) {
    const Geometry g = size(50, 40);
    for (const char* name : {"a.exr", "a.png"}) {
        auto w = ImageWriter::create(path(name), g, {"R", "G", "B"}, false, {}, {*storable_type(name, PixelType::uint8), "", 1});
        ASSERT_TRUE(w);
        ASSERT_TRUE(write_all(**w, g, noise(50 * 40 * 3, (*w)->type(), 3), 40));
        EXPECT_TRUE(ImageReader::open(path(name)));
        Limits l;
        l.max_width = 49;
        EXPECT_FALSE(ImageReader::open(path(name), 1, l));
        l = {};
        l.max_height = 39;
        EXPECT_FALSE(ImageReader::open(path(name), 1, l));
        l = {};
        l.max_pixels = 1999;
        EXPECT_FALSE(ImageReader::open(path(name), 1, l));
        l = {};
        l.max_channels = 2;
        EXPECT_FALSE(ImageReader::open(path(name), 1, l));
        l = {};
        l.max_row_bytes = 149;
        EXPECT_FALSE(ImageReader::open(path(name), 1, l));
    }
    // A real EXR whose window is declared as two thousand million rows: refused by its header, not by running out.
    auto bytes = read_bytes(path("a.exr"));
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    const auto at = text.find("dataWindow") + 11 + 6 + 4;  // name, type "box2i", size
    const std::int32_t far = 2000000000;
    std::memcpy(bytes.data() + at + 12, &far, 4);
    write_bytes(path("huge.exr"), bytes);
    EXPECT_FALSE(ImageReader::open(path("huge.exr")));
    // The same for PNG: 65536 x 65536 within a file of no size is read by rows, and fails at the first.
    bytes = read_bytes(path("a.png"));
    bytes[16] = std::byte{0x7f};
    write_bytes(path("huge.png"), bytes);
    EXPECT_FALSE(ImageReader::open(path("huge.png")));
}

TEST_F(IoTest, TiledFilesAreReadByRows) {
    const int width = 70, height = 90;
    const Geometry g = size(width, height);
    for (const char* name : {"t.tif", "t.exr"}) {
        const bool exr = std::string(name) == "t.exr";
        const PixelType type = exr ? PixelType::half : PixelType::uint16;
        const auto samples = noise(static_cast<std::size_t>(width * height * 3), type, 11);
        OIIO::ImageSpec spec(width, height, 3, exr ? OIIO::TypeHalf : OIIO::TypeUInt16);
        spec.tile_width = 16;
        spec.tile_height = 32;
        auto out = OIIO::ImageOutput::create(path(name));
        ASSERT_TRUE(out && out->open(path(name), spec));
        ASSERT_TRUE(out->write_image(spec.format, samples.data()));
        ASSERT_TRUE(out->close());
        auto r = ImageReader::open(path(name));
        ASSERT_TRUE(r) << r.error().message;
        const ImageHeader& h = (*r)->header();
        EXPECT_EQ((*r)->preferred_rows() % 32, 0);
        for (const int step : {1, 5, 32, 33, 64, 90}) {
            auto got = read_all(**r, step);
            ASSERT_TRUE(got) << got.error().message;
            std::size_t wrong = 0;
            for (std::size_t p = 0; p < samples.size() / 6; ++p)
                for (std::size_t k = 0; k < 3; ++k)
                    wrong += std::memcmp(&samples[p * 6 + k * 2],
                                         &(*got)[p * 6 + static_cast<std::size_t>(h.color[k]) * 2], 2) != 0;
            EXPECT_EQ(wrong, 0U) << name << " by " << step;
        }
    }
    // A tiled spectral EXR of another writer, out of order.
    OIIO::ImageSpec spec(width, height, 3, OIIO::TypeFloat);
    spec.channelnames = {"T.500,0nm", "T.1000nm", "T.400.0nm"};
    spec.tile_width = spec.tile_height = 16;
    std::vector<float> samples;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            for (std::size_t c = 0; c < 3; ++c) samples.push_back(band_value(c, x, y));
    auto out = OIIO::ImageOutput::create(path("ts.exr"));
    ASSERT_TRUE(out && out->open(path("ts.exr"), spec) && out->write_image(OIIO::TypeFloat, samples.data()) && out->close());
    for (const int step : {7, 16, 90}) expect_planes(path("ts.exr"), g, {2, 0, 1}, step);
}

TEST_F(IoTest, LevelsAreReadByAnyRows) {
    for (const int up : {0, 1}) {
        const std::string file = path(fmt::format("levels{}.exr", up));
        auto out = OIIO::ImageOutput::create(file);
        ASSERT_TRUE(out);
        std::vector<std::vector<float>> levels;
        std::vector<std::array<int, 2>> sizes;
        for (int w = 37, h = 61;; w = std::max((w + up) / 2, 1), h = std::max((h + up) / 2, 1)) {
            OIIO::ImageSpec spec(w, h, 3, OIIO::TypeDesc::HALF);
            spec.tile_width = spec.tile_height = 8;
            spec.x = spec.full_x = 5;
            spec.y = spec.full_y = -3;
            spec.attribute("textureformat", "Plain Texture");
            spec.attribute("openexr:roundingmode", up);
            ASSERT_TRUE(out->open(file, spec, levels.empty() ? OIIO::ImageOutput::Create : OIIO::ImageOutput::AppendMIPLevel)) << out->geterror();
            std::vector<float> pixels;
            for (int i = 0; i < w * h * 3; ++i) pixels.push_back(static_cast<float>((i + 37 * static_cast<int>(levels.size())) % 2000));  // whole in half
            ASSERT_TRUE(out->write_image(OIIO::TypeDesc::FLOAT, pixels.data())) << out->geterror();
            levels.push_back(std::move(pixels));
            sizes.push_back({w, h});
            if (w == 1 && h == 1) break;
        }
        ASSERT_TRUE(out->close());
        out.reset();  // which alone ends a file that more levels might follow in
        std::int64_t pixels = 0;
        for (const auto& [w, h] : sizes) pixels += w * h;
        const int count = static_cast<int>(levels.size());
        for (int level = 0; level < count; ++level)
            for (const int step : {1, 3, 8, 13, 64}) {
                ImageSelection selection;
                selection.mip = level;
                auto reader = ImageReader::open(file, 1, {}, selection);
                ASSERT_TRUE(reader) << reader.error().message;
                const auto& h = (*reader)->header();
                const auto& [width, height] = sizes[static_cast<std::size_t>(level)];
                EXPECT_EQ(h.geometry.width, width);
                EXPECT_EQ(h.geometry.height, height);
                EXPECT_EQ(h.geometry.x, 5);
                EXPECT_EQ(h.mip_levels, count);
                EXPECT_EQ(h.mip_pixels, pixels);
                const auto row = static_cast<std::size_t>(3 * width);
                std::vector<half> got(row * static_cast<std::size_t>(height));
                for (int y = 0; y < height; y += step) {
                    const auto read = (*reader)->read_rows(y, std::min(step, height - y), reinterpret_cast<std::byte*>(got.data() + row * static_cast<std::size_t>(y)));
                    ASSERT_TRUE(read) << level << " " << step << " " << read.error().message;
                }
                // The file's channels are in the order of their names: B, G, R.
                for (std::size_t i = 0; i < got.size(); ++i)
                    ASSERT_EQ(static_cast<float>(got[i]), levels[static_cast<std::size_t>(level)][i / 3 * 3 + 2 - i % 3]) << level << " " << step << " " << i;
            }
        ImageSelection beyond;
        beyond.mip = count;
        const auto refused = ImageReader::open(file, 1, {}, beyond);
        ASSERT_FALSE(refused);
        EXPECT_NE(refused.error().message.find(fmt::format("expected 0 to {}", count - 1)), std::string::npos) << refused.error().message;
    }
}

TEST_F(IoTest, BytesDependNeitherOnThreadsNorOnStripsNorOnTheClock) {
    const Geometry g = size(123, 211);
    for (const char* suffix : {"exr", "png", "tif", "jpg", "tga", "bmp", "hdr"}) {
        std::vector<std::vector<std::byte>> files;
        for (const int threads : {1, 2}) {
            const std::string file = path(std::string("d.") + suffix);
            const PixelType type = *storable_type(file, PixelType::uint8);
            auto w = ImageWriter::create(file, g, {"R", "G", "B"}, false, {}, {type, "", threads});
            ASSERT_TRUE(w) << w.error().message;
            ASSERT_TRUE(write_all(**w, g, noise(123 * 211 * 3, type, 3), threads == 1 ? 64 : 211)) << suffix;
            files.push_back(read_bytes(file));
            // Stamps have a resolution of one second.
            if (threads == 1) ::usleep(1100000);
        }
        EXPECT_TRUE(files[0] == files[1]) << suffix;
        const std::string_view text(reinterpret_cast<const char*>(files[0].data()), files[0].size());
        EXPECT_EQ(text.find("capDate"), std::string_view::npos) << suffix;
        EXPECT_EQ(text.find("OpenImageIO 2"), std::string_view::npos) << suffix;
    }
    const std::vector<ExrPart> one{part_of("", {"R", "G", "B", "T.400nm", "T.500nm"}, PixelType::half)};
    const std::vector<ExrPart> two{part_of("a", {"R", "G", "B"}, PixelType::half),
                                   part_of("b", {"T.400nm", "T.500nm", "T.600nm"}, PixelType::half)};
    for (const char* c : {"zip", "piz", "none"}) {
        ASSERT_TRUE(write_planes(path("1.exr"), g, one, {PixelType::half, c, 1}, 211));
        ASSERT_TRUE(write_planes(path("2.exr"), g, one, {PixelType::half, c, 2}, 13));
        EXPECT_TRUE(read_bytes(path("1.exr")) == read_bytes(path("2.exr"))) << c;
        // Where there are several parts their chunks follow the strips, which must be the same here.
        ASSERT_TRUE(write_planes(path("1.exr"), g, two, {PixelType::half, c, 1}, 64));
        ASSERT_TRUE(write_planes(path("2.exr"), g, two, {PixelType::half, c, 2}, 64));
        EXPECT_TRUE(read_bytes(path("1.exr")) == read_bytes(path("2.exr"))) << c;
    }
}

// OpenEXR's own encoder writes PIZ, ours ZIP: its decoder must give the same samples of both.
TEST_F(IoTest, OwnZipChunksHoldWhatTheLibrarysPizDoes) {
    Geometry g = size(1501, 45);
    g.x = -7;
    g.y = 11;
    // A chunk of these is longer than a segment of the encoder; noise alone is stored as it is.
    const std::vector<ExrPart> parts{part_of("a", {"b", "a", "Z"}, PixelType::half), part_of("c", {"R", "G", "T.1nm"}, PixelType::float32),
                                     part_of("noise", {"n"}, PixelType::half)};
    const auto pixels = static_cast<std::size_t>(g.width) * static_cast<std::size_t>(g.height);
    std::vector<std::vector<std::byte>> planes;
    for (unsigned c = 0; c < 7; ++c) {
        const PixelType type = c < 3 || c == 6 ? PixelType::half : PixelType::float32;
        planes.push_back(noise(pixels, type, c));
        // Runs of equal samples, so that there is something to compress.
        const std::size_t sample = pixel_bytes(type);
        for (std::size_t i = 0; c < 6 && i < pixels; ++i)
            if (i % 16 != 0) std::memcpy(planes[c].data() + i * sample, planes[c].data() + (i - 1) * sample, sample);
    }
    std::vector<std::vector<std::byte>> files;
    struct Way {
        const char* compression;
        int threads, step;
    };
    for (const auto& [compression, threads, step] : {Way{"zip", 1, 45}, Way{"zip", 2, 1}, Way{"zip", 2, 19}, Way{"piz", 1, 45}}) {
        const std::string file = path("z.exr");
        auto w = ExrWriter::create(file, g, parts, {PixelType::half, compression, threads});
        ASSERT_TRUE(w) << w.error().message;
        for (int y = 0; y < g.height; y += step) {
            std::vector<const std::byte*> rows;
            for (const auto& plane : planes)
                rows.push_back(plane.data() + plane.size() / static_cast<std::size_t>(g.height) * static_cast<std::size_t>(y));
            ASSERT_TRUE((*w)->write_rows(y, std::min(step, g.height - y), rows));
        }
        ASSERT_TRUE((*w)->commit());
        auto in = OIIO::ImageInput::open(file);
        ASSERT_TRUE(in) << OIIO::geterror();
        std::size_t plane = 0;
        for (int p = 0; p < 3; ++p) {
            ASSERT_TRUE(in->seek_subimage(p, 0));
            EXPECT_EQ(in->spec().x, g.x);
            const OIIO::TypeDesc type = p == 1 ? OIIO::TypeFloat : OIIO::TypeHalf;
            for (const ExrChannel& c : parts[static_cast<std::size_t>(p)].channels) {
                const int at = in->spec().channelindex(c.name);
                ASSERT_GE(at, 0) << c.name;
                std::vector<std::byte> got(planes[plane].size());
                ASSERT_TRUE(in->read_image(p, 0, at, at + 1, type, got.data())) << in->geterror();
                EXPECT_TRUE(got == planes[plane]) << compression << " " << c.name;
                ++plane;
            }
        }
        if (compression == std::string_view("zip")) files.push_back(read_bytes(file));
    }
    EXPECT_TRUE(files[0] == files[1]);
    EXPECT_TRUE(files[0] == files[2]);
    EXPECT_LT(files[0].size(), pixels * 20 / 2);
}

// ZIP chunks of another writer, by every cut of the rows into calls, as OpenImageIO reads them; and no other pixels than its
// own from files with bytes of their headers of chunks, sizes and data turned over.
TEST_F(IoTest, ZipChunksAreReadAsTheLibraryReadsThem) {
    const int width = 203, height = 53;
    for (const char* compression : {"zip", "zips"})
        for (const PixelType type : {PixelType::half, PixelType::float32}) {
            OIIO::ImageSpec spec(width, height, 4, type == PixelType::half ? OIIO::TypeHalf : OIIO::TypeFloat);
            spec.channelnames = {"R", "G", "B", "depth"};
            spec.x = -5;
            spec.y = 9;
            spec.attribute("compression", compression);
            const std::size_t bytes = 4 * pixel_bytes(type), row = bytes * static_cast<std::size_t>(width);
            auto samples = noise(static_cast<std::size_t>(width * height) * 4, type, 5);
            // Half of the rows compress; chunks of the others are stored as they are.
            for (std::size_t y = 16; y < 40; ++y)
                for (std::size_t i = bytes; i < row; ++i)
                    if (i % (8 * bytes) >= bytes) samples[y * row + i] = samples[y * row + i - bytes];
            const std::string file = path("theirs.exr");
            auto out = OIIO::ImageOutput::create(file);
            ASSERT_TRUE(out && out->open(file, spec) && out->write_image(spec.format, samples.data()) && out->close());
            const auto whole = read_bytes(file);
            for (const int step : {1, 7, 16, 24, 53}) {
                auto r = ImageReader::open(file, 1 + step % 2);
                ASSERT_TRUE(r) << r.error().message;
                ASSERT_EQ((*r)->header().channels, (std::vector<std::string>{"B", "G", "R", "depth"}));
                const auto got = read_all(**r, step);
                ASSERT_TRUE(got) << got.error().message;
                for (std::size_t i = 0; i < got->size(); i += pixel_bytes(type)) {
                    const std::size_t c = i / pixel_bytes(type) % 4, theirs = c < 3 ? 2 - c : 3;
                    const auto* expected = samples.data() + i / bytes * bytes + theirs * pixel_bytes(type);
                    ASSERT_EQ(std::memcmp(got->data() + i, expected, pixel_bytes(type)), 0) << compression << " " << step << " " << i;
                }
            }
            std::mt19937 random(7);
            int refused = 0;
            for (int trial = 0; trial < 60; ++trial) {
                auto damaged = whole;
                // The first chunks' table, heads and data, and anything behind them.
                const std::size_t at = trial % 2 ? random() % whole.size() : whole.size() / 3 + random() % 64;
                damaged[at] ^= static_cast<std::byte>(1U << (random() % 8));
                write_bytes(path("damaged.exr"), damaged);
                auto r = ImageReader::open(path("damaged.exr"), 2);
                if (!r) continue;
                const auto got = read_all(**r, 53);
                std::vector<std::byte> theirs(samples.size());
                auto in = OIIO::ImageInput::open(path("damaged.exr"));
                const bool same_shape = in && in->spec().nchannels == 4 && in->spec().width == width && in->spec().height == height;
                const bool read = same_shape && in->read_image(0, 0, 0, 4, spec.format, theirs.data());
                if (!got) {
                    ++refused;
                    EXPECT_NE(got.error().message.find("damaged.exr"), std::string::npos) << got.error().message;
                    continue;
                }
                if (in && !same_shape) continue;
                ASSERT_TRUE(read) << "read what the library refuses";
                for (std::size_t i = 0; i < got->size(); i += bytes)
                    for (std::size_t c = 0; c < 3; ++c)
                        ASSERT_EQ(std::memcmp(got->data() + i + (2 - c) * pixel_bytes(type), theirs.data() + i + c * pixel_bytes(type),
                                              pixel_bytes(type)), 0) << trial << " " << i;
            }
            EXPECT_GT(refused, 0);
        }
}

// OpenImageIO reads what we write and we what it writes, with every filter, bit for bit; both over again from the first row.
TEST_F(IoTest, OwnPngHoldsWhatTheLibrarysDoes) {
    const std::vector<std::vector<std::string>> layouts{{"Y"}, {"Y", "A"}, {"R", "G", "B"}, {"R", "G", "B", "A"}};
    // Rows of several segments of the encoder and of several calls of the decoder.
    const std::size_t height = slow_build ? 150 : 500;
    const Geometry g = size(1777, static_cast<int>(height));
    for (const PixelType type : {PixelType::uint8, PixelType::uint16})
        for (const auto& channels : layouts) {
            SCOPED_TRACE(fmt::format("{} x {}", channels.size(), pixel_type_name(type)));
            const std::size_t n = channels.size(), sample = pixel_bytes(type), row = 1777 * n;
            std::vector<std::byte> pixels = noise(row * height, type, 5);
            // Bands of noise, slopes along either direction and both, so that each filter is the best somewhere.
            for (std::size_t y = 0; y < height; ++y)
                for (std::size_t i = 0; y % 50 >= 10 && i < row; ++i) {
                    const std::size_t x = i / n, k = y % 50 / 10, v = k == 1 ? 7 * x + 31 * y * y : k == 2 ? 7 * y + x * x : k == 3 ? 3 * (x + y) : x / 9 * y;
                    std::memcpy(pixels.data() + (y * row + i) * sample, &v, sample);
                }
            const std::string ours = path("ours.png"), theirs = path("theirs.png");
            auto w = ImageWriter::create(ours, g, channels, false, {{"ImageDescription", std::string("slopes")}}, {type, "", 2});
            ASSERT_TRUE(w) << w.error().message;
            ASSERT_TRUE(write_all(**w, g, pixels, 77));
            w = ImageWriter::create(theirs, g, channels, false, {{"ImageDescription", std::string("slopes")}}, {type, "6", 2});
            ASSERT_TRUE(w) << w.error().message;
            ASSERT_TRUE(write_all(**w, g, pixels, 77));
            // Level 6 searches longer for matches; a stream of level 1 as a whole would be larger by more.
            EXPECT_LT(static_cast<double>(fs::file_size(ours)), 1.15 * static_cast<double>(fs::file_size(theirs)));
            for (const std::string& file : {ours, theirs}) {
                auto in = OIIO::ImageInput::open(file);
                ASSERT_TRUE(in) << OIIO::geterror();
                EXPECT_EQ(in->spec().get_string_attribute("ImageDescription"), "slopes");
                std::vector<std::byte> got(pixels.size());
                ASSERT_TRUE(in->read_image(0, 0, 0, -1, type == PixelType::uint8 ? OIIO::TypeUInt8 : OIIO::TypeUInt16, got.data()));
                EXPECT_TRUE(n % 2 == 0 || got == pixels) << file;  // OpenImageIO multiplies by alpha
                auto r = ImageReader::open(file);
                ASSERT_TRUE(r) << r.error().message;
                for (const int step : {static_cast<int>(height), 31}) {
                    auto back = read_all(**r, step);
                    ASSERT_TRUE(back) << back.error().message;
                    EXPECT_TRUE(*back == pixels) << file << " by " << step;
                }
            }
            // One bit anywhere in the image data is noticed.
            std::vector<std::byte> bytes = read_bytes(ours);
            for (const std::size_t at : {bytes.size() / 3, bytes.size() - 20}) {
                std::vector<std::byte> bad = bytes;
                bad[at] ^= std::byte{4};
                write_bytes(path("bad.png"), bad);
                auto r = ImageReader::open(path("bad.png"));
                ASSERT_TRUE(r);
                EXPECT_FALSE(read_all(**r, 64)) << at;
            }
        }
}

TEST_F(IoTest, OthersReadWhatIsWritten) {
    const Geometry g = size(19, 33);
    const std::vector<std::string> names{"R", "G", "B", "T.400,000000nm", "T.500,000000nm"};
    ASSERT_TRUE(write_planes(path("o.exr"), g,
                             {part_of("", names, PixelType::float32,
                                      {{"EV", 0.0F}, {"spectralLayoutVersion", std::string("1.0")}, {"count", 7}, {"exact", 0.1},
                                       {"list", std::vector<float>{1, 2, 3}},
                                       {"chromaticities", std::vector<float>{.64F, .33F, .3F, .6F, .15F, .06F, .3127F, .329F}}})},
                             {PixelType::float32, "piz", 2}));
    auto in = OIIO::ImageInput::open(path("o.exr"));
    ASSERT_TRUE(in) << OIIO::geterror();
    const OIIO::ImageSpec spec = in->spec();
    EXPECT_EQ(spec.get_string_attribute("spectralLayoutVersion"), "1.0");
    EXPECT_EQ(spec.get_int_attribute("count"), 7);
    EXPECT_EQ(spec.get_string_attribute("compression"), "piz");
    EXPECT_NE(spec.find_attribute("list"), nullptr);
    EXPECT_EQ(spec.find_attribute("DateTime"), nullptr);
    std::vector<float> got(static_cast<std::size_t>(19 * 33 * spec.nchannels));
    ASSERT_TRUE(in->read_image(0, 0, 0, -1, OIIO::TypeFloat, got.data()));
    for (std::size_t c = 0; c < names.size(); ++c) {
        const auto at = static_cast<std::size_t>(spec.channelindex(names[c]));
        for (int y = 0; y < 33; ++y)
            for (int x = 0; x < 19; ++x)
                ASSERT_EQ(got[static_cast<std::size_t>(y * 19 + x) * names.size() + at], band_value(c, x, y));
    }
    auto r = ImageReader::open(path("o.exr"));
    ASSERT_TRUE(r);
    const ImageHeader& h = (*r)->header();
    ASSERT_TRUE(h.color_hints.chromaticities);
    EXPECT_EQ((*h.color_hints.chromaticities)[6], static_cast<double>(.3127F));
    EXPECT_EQ(h.metadata.at("exact"), AttributeValue(0.1));
    EXPECT_EQ(h.metadata.at("list"), AttributeValue(std::vector<float>{1, 2, 3}));
    EXPECT_FALSE(h.metadata.contains("chromaticities"));
}

TEST_F(IoTest, WhatIsNotCommittedLeavesNothing) {
    const Geometry g = size(8, 8);
    const auto samples = noise(8 * 8 * 3, PixelType::half, 1);
    {
        auto w = ImageWriter::create(path("a.exr"), g, {"R", "G", "B"}, false, {}, {PixelType::half, "", 1});
        ASSERT_TRUE(w);
        EXPECT_EQ(entries(), 1U);
        EXPECT_FALSE(fs::exists(path("a.exr")));
        ASSERT_TRUE((*w)->write_rows(0, 4, samples.data()));
        EXPECT_FALSE((*w)->write_rows(6, 2, samples.data())) << "a gap was accepted";
        EXPECT_FALSE((*w)->write_rows(4, 5, samples.data())) << "a row too many was accepted";
        EXPECT_FALSE((*w)->commit()) << "half a picture was committed";
    }
    EXPECT_EQ(entries(), 0U);
    {
        auto w = ImageWriter::create(path("a.png"), g, {"R", "G", "B"}, false, {}, {PixelType::uint8, "", 1});
        ASSERT_TRUE(w);
        ASSERT_TRUE((*w)->write_rows(0, 4, samples.data()));
        EXPECT_FALSE((*w)->write_rows(2, 2, samples.data()));
        EXPECT_FALSE((*w)->commit());
    }
    EXPECT_EQ(entries(), 0U);
    {
        auto f = OutputFile::create(path("a.txt"));
        ASSERT_TRUE(f);
        OutputFile moved = std::move(*f);
        EXPECT_EQ(fs::path(moved.temporary_path()).parent_path(), folder_);
        EXPECT_EQ(fs::path(moved.temporary_path()).extension(), ".txt");
        EXPECT_EQ(fs::path(moved.temporary_path()).filename().string().rfind(".a.txt.", 0), 0U);
    }
    EXPECT_EQ(entries(), 0U);
}

TEST_F(IoTest, OutputsKeepLinksAndPermissionsAndRefuseWhatIsNoFile) {
    ASSERT_TRUE(write_text_file(path("a.txt"), "one"));
    ASSERT_EQ(::chmod(path("a.txt").c_str(), 0640), 0);
    fs::create_directory(path("sub"));
    fs::create_symlink("../a.txt", path("sub/link.txt"));
    fs::create_symlink("new.txt", path("sub/dangling.txt"));
    ASSERT_TRUE(write_text_file(path("sub/link.txt"), "two"));
    EXPECT_TRUE(fs::is_symlink(path("sub/link.txt")));
    EXPECT_EQ(read_bytes(path("a.txt")).size(), 3U);
    EXPECT_EQ(static_cast<char>(read_bytes(path("a.txt"))[0]), 't');
    EXPECT_EQ(static_cast<unsigned>(fs::status(path("a.txt")).permissions()), 0640U);
    ASSERT_TRUE(write_text_file(path("sub/dangling.txt"), "x"));
    EXPECT_TRUE(fs::is_regular_file(path("sub/new.txt")));
    EXPECT_TRUE(same_file(path("a.txt"), path("sub/link.txt")));
    EXPECT_TRUE(same_file(path("sub/../none"), path("none")));
    EXPECT_FALSE(same_file(path("a.txt"), path("sub/new.txt")));
    fs::create_symlink("loop.txt", path("loop.txt"));
    const auto kind = [&](const std::string& p) {
        auto f = OutputFile::create(p);
        return f ? "created" : f.error().kind == ErrorKind::usage ? "usage" : "output";
    };
    EXPECT_STREQ(kind(path("sub")), "usage");
    EXPECT_STREQ(kind(path("none/a.txt")), "usage");
    EXPECT_STREQ(kind(path("a.txt/b.txt")), "usage");
    EXPECT_STREQ(kind(path("sub/")), "usage");
    EXPECT_STREQ(kind(""), "usage");
    EXPECT_STREQ(kind("/dev/null"), "output");
    EXPECT_STREQ(kind(path("loop.txt")), "output");
    EXPECT_STREQ(kind(path(std::string(300, 'n'))), "output");
    EXPECT_STREQ(kind(path(std::string(250, 'n') + ".txt")), "created");
    ASSERT_TRUE(write_text_file(path(std::string(240, 'n') + ".txt"), "x"));
}

TEST_F(IoTest, TheSignalHandlerRemovesOnlyThisProcesssFiles) {
    auto a = OutputFile::create(path("a.exr"));
    auto b = OutputFile::create(path("b.exr"));
    ASSERT_TRUE(a && b);
    ASSERT_EQ(entries(), 2U);
    const pid_t child = ::fork();
    if (child == 0) {
        remove_temporary_files_from_signal();
        ::_exit(0);
    }
    int status = 0;
    ::waitpid(child, &status, 0);
    EXPECT_EQ(entries(), 2U) << "a forked child removed its parent's files";
    ASSERT_TRUE(a->commit());
    remove_temporary_files_from_signal();
    EXPECT_TRUE(fs::exists(path("a.exr")));
    EXPECT_EQ(entries(), 1U);
    EXPECT_FALSE(b->commit());
}

TEST(FullDisk, Child) {
    const char* limit_text = std::getenv("SPECTEX_TEST_FILE_LIMIT");
    const char* file = std::getenv("SPECTEX_TEST_FILE");
    if (!limit_text || !file) GTEST_SKIP() << "run by the test below";
    std::signal(SIGXFSZ, SIG_IGN);
    const auto bytes = static_cast<rlim_t>(std::atoll(limit_text));
    const rlimit limit{bytes, bytes};
    ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &limit), 0);
    const Geometry g = size(400, 400);
    Status status;
    if (std::string(file).ends_with("p.exr")) {
        status = write_planes(file, g, {part_of("", {"T.400nm", "T.500nm"}, PixelType::float32)}, {PixelType::float32, "none", 1});
    } else {
        const PixelType type = *storable_type(file, PixelType::uint8);
        auto w = ImageWriter::create(file, g, {"R", "G", "B"}, false, {}, {type, "", 1});
        status = w ? write_all(**w, g, noise(400 * 400 * 3, type, 3), 64) : Status(w.error());
    }
    const bool reported =
        !status && status.error().kind == ErrorKind::output && status.error().message.find(file) != std::string::npos;
    ::_exit(status ? 1 : reported ? 0 : 2);
}

TEST_F(IoTest, AFullDiskIsReportedAndLeavesNothing) {
#if defined(__SANITIZE_THREAD__)
    GTEST_SKIP() << "each case is a process of one thread that takes seconds to begin here";
#endif
    for (const std::string name : {"f.exr", "f.png", "f.tif", "f.jpg", "f.tga", "f.hdr", "f.bmp", "f.webp", "f.ppm", "p.exr"})
        for (const rlim_t bytes : {rlim_t{100}, rlim_t{20000}, rlim_t{60000}}) {
            if (slow_build && bytes != 20000) continue;  // a process under a sanitizer takes a second to begin
            const std::string size_text = std::to_string(bytes), file = path(name);
            // A process of its own: a forked one would lack the threads that OpenEXR's pool believes it has.
            const pid_t child = ::fork();
            if (child == 0) {
                ::setenv("SPECTEX_TEST_FILE_LIMIT", size_text.c_str(), 1);
                ::setenv("SPECTEX_TEST_FILE", file.c_str(), 1);
                ::execl("/proc/self/exe", "io_test", "--gtest_filter=FullDisk.Child", static_cast<char*>(nullptr));
                ::_exit(3);
            }
            int status = 0;
            ::waitpid(child, &status, 0);
            EXPECT_TRUE(WIFEXITED(status)) << name;
            EXPECT_EQ(WEXITSTATUS(status), 0) << name << " at " << bytes << ": 1 written as if whole, 2 without its name";
            EXPECT_EQ(entries(), 0U) << name << " at " << bytes;
            fs::remove(file);
        }
}

TEST_F(IoTest, WhatAFormatCannotHoldIsRefused) {
    const Geometry g = size(4, 4);
    const auto kind = [&](const std::string& name, const std::vector<std::string>& channels, const std::string& compression) {
        auto w = ImageWriter::create(path(name), g, channels, false, {}, {PixelType::uint8, compression, 1});
        return w ? "created" : w.error().kind == ErrorKind::usage ? "usage" : "output";
    };
    const std::vector<std::string> rgb{"R", "G", "B"}, rgba{"R", "G", "B", "A"}, five{"R", "G", "B", "A", "x"};
    EXPECT_STREQ(kind("a.jpg", rgba, ""), "output");
    EXPECT_STREQ(kind("a.hdr", rgba, ""), "output");
    EXPECT_STREQ(kind("a.png", five, ""), "output");
    EXPECT_STREQ(kind("a.xyz", rgb, ""), "output");
    EXPECT_STREQ(kind("a", rgb, ""), "output");
    EXPECT_STREQ(kind("a.png", {"R", "G"}, ""), "output");
    for (const char* c : {"dwaa", "dwab:45", "b44", "b44a", "pxr24", "D:99", "zip ", "9", "lzw"})
        EXPECT_STREQ(kind("a.exr", rgb, c), "usage") << c;
    for (const char* c : {"10", "-1", "zip", "D:99", "6x"}) EXPECT_STREQ(kind("a.png", rgb, c), "usage") << c;
    for (const char* c : {"jpeg", "D:99", "9", "ccitt"}) EXPECT_STREQ(kind("a.tif", rgb, c), "usage") << c;
    for (const char* c : {"ZIP", "Piz", "rle"}) EXPECT_STREQ(kind("a.exr", rgb, c), "created") << c;
    EXPECT_EQ(storable_type("a.png", PixelType::half), PixelType::uint16);
    EXPECT_EQ(storable_type("a.png", PixelType::uint8), PixelType::uint8);
    EXPECT_EQ(storable_type("a.JPG", PixelType::float32), PixelType::uint8);
    EXPECT_EQ(storable_type("a.exr", PixelType::uint8), PixelType::half);
    EXPECT_EQ(storable_type("a.exr", PixelType::uint16), PixelType::float32);
    EXPECT_EQ(storable_type("a.tif", PixelType::half), PixelType::float32);
    EXPECT_EQ(storable_type("a.txt", PixelType::half), std::nullopt);
    EXPECT_FALSE(ExrWriter::create(path("a.exr"), g, {part_of("x", {"a"}, PixelType::half), part_of("x", {"b"}, PixelType::half)}, {}));
    EXPECT_FALSE(ExrWriter::create(path("a.exr"), g, {part_of("", {"a", "a"}, PixelType::half)}, {}));
    EXPECT_FALSE(ExrWriter::create(path("a.exr"), g, {part_of("", {""}, PixelType::half)}, {}));
    EXPECT_FALSE(ExrWriter::create(path("a.exr"), g, {part_of("", {"a"}, PixelType::uint8)}, {}));
    EXPECT_EQ(entries(), 0U);
}

TEST_F(IoTest, OrientationAspectAndTextAreKept) {
    Geometry g = size(5, 4);
    g.orientation = 6;
    g.pixel_aspect = 2;
    const Attributes given{{"Copyright", std::string("© A")}, {"Artist", std::string("B")}, {"ImageDescription", std::string("C")}};
    for (const char* name : {"a.exr", "a.tif", "a.png"}) {
        const PixelType type = *storable_type(name, PixelType::uint16);
        auto w = ImageWriter::create(path(name), g, {"R", "G", "B"}, false, given, {type, "", 1});
        ASSERT_TRUE(w) << w.error().message;
        ASSERT_TRUE(write_all(**w, g, noise(5 * 4 * 3, type, 2), 4));
        auto r = ImageReader::open(path(name));
        ASSERT_TRUE(r) << r.error().message;
        const ImageHeader& h = (*r)->header();
        EXPECT_EQ(h.geometry.orientation, std::string(name) == "a.png" ? 1 : 6) << name;  // PNG has no orientation
        EXPECT_EQ(h.geometry.pixel_aspect, 2) << name;
        EXPECT_TRUE(h.geometry.same_size(g));
        for (const auto& [key, value] : given) {
            ASSERT_TRUE(h.metadata.contains(key)) << name << " " << key;
            EXPECT_EQ(h.metadata.at(key), value) << name << " " << key;
        }
        for (const auto& [key, value] : h.metadata) {
            EXPECT_FALSE(key.starts_with("oiio:") || key == "Software" || key == "Orientation") << name << " " << key;
            EXPECT_TRUE(key != "DateTime" || value == AttributeValue(std::string())) << name;
        }
        EXPECT_EQ(h.color_hints.declared, "") << name << ": nothing in the file says so";
    }
}

TEST_F(IoTest, OnlyTheFilesOwnWordOnItsColoursIsHeard) {
    const auto chunk = [](const std::string& type, const std::string& body) {
        const auto be = [](std::uint32_t v) {
            return std::string{static_cast<char>(v >> 24), static_cast<char>(v >> 16), static_cast<char>(v >> 8), static_cast<char>(v)};
        };
        std::uint32_t crc = 0xffffffffU;
        for (const char c : type + body) {
            crc ^= static_cast<unsigned char>(c);
            for (int k = 0; k < 8; ++k) crc = (crc >> 1) ^ (crc & 1U ? 0xedb88320U : 0U);
        }
        return be(static_cast<std::uint32_t>(body.size())) + type + body + be(~crc);
    };
    const Geometry g = size(2, 2);
    auto w = ImageWriter::create(path("a.png"), g, {"R", "G", "B"}, false, {}, {PixelType::uint8, "", 1});
    ASSERT_TRUE(w && write_all(**w, g, noise(12, PixelType::uint8, 1), 2));
    const auto plain = read_bytes(path("a.png"));
    const auto with = [&](const std::string& extra) {
        std::string s(reinterpret_cast<const char*>(plain.data()), plain.size());
        s.insert(33, extra);  // behind IHDR
        write_bytes(path("b.png"), std::as_bytes(std::span(s)));
        auto r = ImageReader::open(path("b.png"));
        EXPECT_TRUE(r) << r.error().message;
        return (*r)->header().color_hints;
    };
    EXPECT_EQ(with("").declared, "");
    EXPECT_FALSE(with("").gamma);
    EXPECT_EQ(with(chunk("sRGB", std::string(1, '\0'))).declared, "sRGB");
    const std::string gamma = chunk("gAMA", std::string("\x00\x00\xc3\x50", 4));  // 50000
    EXPECT_EQ(with(gamma).gamma, 2.0);
    EXPECT_EQ(with(gamma).declared, "");
    EXPECT_FALSE(with(chunk("sRGB", std::string(1, '\0')) + gamma).gamma) << "sRGB takes precedence";
    std::string xy;
    for (const int v : {31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000})
        xy += std::string{'\0', '\0', static_cast<char>(v >> 8), static_cast<char>(v)};
    const auto hints = with(chunk("cHRM", xy));
    ASSERT_TRUE(hints.chromaticities);
    EXPECT_EQ((*hints.chromaticities)[0], 0.64);
    EXPECT_EQ((*hints.chromaticities)[7], 0.329);
}
