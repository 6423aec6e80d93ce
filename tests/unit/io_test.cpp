// Image files: what is read and written is bit-exact, hostile files are refused, and nothing half-written remains.
#include "spectex/io.h"

#include <gtest/gtest.h>

#include <OpenImageIO/imageio.h>
#include <sys/stat.h>
#include <unistd.h>

#include <Imath/half.h>

#include <array>
#include <clocale>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <locale>
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
    // 5e-13 relative: half a unit of the 12th digit, since most spellings here carry fewer.
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
        if (metres) EXPECT_EQ(n->wavelength_nm, c.nm) << c.name;  // correctly rounded from the decimal text
        else EXPECT_NEAR(n->wavelength_nm, c.nm, 1e-6) << c.name;  // nine digits of frequency
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
