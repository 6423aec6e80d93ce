// Colour or data: by names alone, by pixels made here, and on files of Debian's packages that a person has looked at.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <random>
#include <sstream>

#include "spectex/texture_use.h"
#include "textures/name_tokens.h"

namespace spectex {
namespace {
namespace fs = std::filesystem;

TextureUse by_name(std::string_view path) { return judge_texture(path, nullptr, nullptr).use; }

TEST(TextureUse, CutsNamesIntoWords) {
    using Words = std::vector<std::string>;
    EXPECT_EQ(textures::name_words("Bricks075A_2K_NormalGL"), (Words{"bricks", "075a", "2k", "normal", "gl"}));
    EXPECT_EQ(textures::name_words("rock_01-AORough.x"), (Words{"rock", "01", "ao", "rough", "x"}));
    EXPECT_EQ(textures::name_words("turn100R m1"), (Words{"turn", "100r", "m1"}));
    EXPECT_EQ(textures::name_words("__"), Words{});
    EXPECT_EQ(textures::texture_stem("a/b.c/wood_Base.1001.png"), "wood_Base");
    EXPECT_EQ(textures::texture_stem("wood.<UDIM>.exr"), "wood");
    EXPECT_EQ(textures::texture_stem(".png"), ".png");
}

TEST(TextureUse, ReadsNamesAsLibrariesWriteThem) {
    using enum TextureUse;
    const std::pair<const char*, TextureUse> names[] = {
        // Poly Haven
        {"brick_wall_001_diff_2k.jpg", color}, {"brick_wall_001_nor_gl_2k.exr", normal}, {"brick_wall_001_nor_dx_4k.png", normal},
        {"brick_wall_001_arm_2k.jpg", packed}, {"brick_wall_001_rough_2k.jpg", roughness}, {"brick_wall_001_disp_2k.png", displacement},
        {"brick_wall_001_ao_2k.jpg", occlusion}, {"metal_plate_diff_1k.png", color}, {"metal_plate_metal_1k.png", metallic},
        {"rough_plaster_broken_col_01_2k.png", color}, {"metal_plate_spec_1k.png", specular}, {"fabric_mask_1k.png", mask},
        // ambientCG
        {"Bricks075A_2K-JPG_Color.jpg", color}, {"Bricks075A_2K-JPG_NormalGL.jpg", normal}, {"Bricks075A_2K_NormalDX.png", normal},
        {"Bricks075A_2K-PNG_Roughness.png", roughness}, {"Metal032_1K_Metalness.png", metallic}, {"Bricks075A_Displacement.png", displacement},
        {"Bricks075A_2K_AmbientOcclusion.jpg", occlusion}, {"Leaf001_1K_Opacity.png", mask}, {"Sign009_2K_Emission.png", emission},
        // Substance, Quixel
        {"Helmet_BaseColor.1001.png", color}, {"Helmet_Base_Color.1002.png", color}, {"Helmet_OcclusionRoughnessMetallic.1001.png", packed},
        {"Helmet_Height.1001.exr", displacement}, {"tkmkefwa_4K_Albedo.jpg", color}, {"tkmkefwa_4K_Normal_LOD0.jpg", normal},
        {"tkmkefwa_4K_Cavity.jpg", occlusion}, {"tkmkefwa_4K_Gloss.jpg", roughness}, {"tkmkefwa_4K_Bump.jpg", displacement},
        {"T_Rock_ORM.tga", packed}, {"T_Rock_N.tga", normal}, {"T_Rock_D.tga", color}, {"T_Rock_S.tga", specular}, {"T_Rock_MRA.tga", packed},
        // glTF samples
        {"Default_albedo.jpg", color}, {"Default_metalRoughness.jpg", packed}, {"Default_AO.jpg", occlusion}, {"BoomBox_baseColor.png", color},
        {"BoomBox_occlusionRoughnessMetallic.png", packed}, {"FlightHelmet_Materials_LensesMat_OcclusionRoughMetal.png", packed},
        {"Avocado_roughnessMetallic.png", packed}, {"Default_emissive.jpg", emission}, {"metallicRoughness.png", packed},
        // others
        {"wood_bump.png", displacement}, {"wood-nrm.tga", normal}, {"earthnormal2k.jpg", normal}, {"wood.specular.png", specular},
        {"matid.png", id}, {"rock_lut.png", lut}, {"kloofendal_hdri_2k.exr", environment}, {"hand_flowmap.png", data},
        // names of things that only sound like data
        {"metal.png", color}, {"rough_sea.jpg", color}, {"arm.png", color}, {"colorado.jpg", color}, {"speedbump.png", color},
        {"turn100R.png", color}, {"s.png", color}, {"normandy.jpg", color}, {"alpha_centauri.jpg", color}, {"photo.jpg", color}, {"", color},
        // folders speak where names are silent, and only then
        {"lib/Roughness/brick01.png", roughness}, {"lib/normals/brick01_diffuse.png", color}, {"lib/normal/brick01.png", normal}};
    for (const auto& [name, use] : names)
        EXPECT_EQ(texture_use_name(by_name(name)), texture_use_name(use)) << name << ": " << judge_texture(name, nullptr, nullptr).reason;
}

TEST(TextureUse, RulesStandAboveAll) {
    TextureUseOptions options;
    options.root = "/lib";
    for (const char* rule : {"*_normal*=color", "decals/*=mask", "/lib/a=b.png=data"}) {
        const auto parsed = parse_treat_as(rule);
        ASSERT_TRUE(parsed) << rule;
        options.treat_as.push_back(*parsed);
    }
    EXPECT_EQ(judge_texture("/lib/wood_normal.png", nullptr, nullptr, options).use, TextureUse::color);
    EXPECT_TRUE(judge_texture("/lib/wood_normal.png", nullptr, nullptr, options).by_option);
    EXPECT_EQ(judge_texture("/lib/decals/x_normal.png", nullptr, nullptr, options).use, TextureUse::mask);  // the last that matches
    EXPECT_EQ(judge_texture("/lib/a=b.png", nullptr, nullptr, options).use, TextureUse::data);
    for (const char* wrong : {"", "=", "x", "=color", "*.png=colr", "*.png="}) {
        const auto parsed = parse_treat_as(wrong);
        ASSERT_FALSE(parsed) << wrong;
        EXPECT_EQ(parsed.error().kind, ErrorKind::usage);
    }
}

/// An image of floats as a reader.
class Picture final : public ImageReader {
public:
    using Paint = std::function<std::array<float, 4>(int x, int y)>;
    Picture(int width, int height, Paint paint, bool alpha = false) : paint_(std::move(paint)) {
        header_.geometry.width = width;
        header_.geometry.height = height;
        header_.channels = {"R", "G", "B"};
        header_.type = PixelType::float32;
        header_.color = {0, 1, 2};
        if (alpha) header_.channels.push_back("A"), header_.alpha = 3;
    }
    const ImageHeader& header() const override { return header_; }
    int preferred_rows() const override { return 64; }
    Status read_rows(int y, int rows, std::byte* out) override {
        for (int r = 0; r < rows; ++r)
            for (int x = 0; x < header_.geometry.width; ++x) {
                const auto c = paint_(x, y + r);
                const std::size_t bytes = header_.channels.size() * sizeof(float);
                std::memcpy(out, c.data(), bytes);
                out += bytes;
            }
        return {};
    }

private:
    ImageHeader header_;
    Paint paint_;
};

TextureVerdict by_pixels(int width, int height, Picture::Paint paint, std::string_view name = "x.png", bool alpha = false) {
    Picture picture(width, height, std::move(paint), alpha);
    const auto pixels = sample_pixels(picture);
    EXPECT_TRUE(pixels);
    return judge_texture(name, nullptr, &*pixels);
}

TEST(TextureUse, KnowsNormalMapsByTheirPixels) {
    const auto bumps = [](int x, int y) -> std::array<float, 4> {
        const float nx = 0.4f * std::sin(0.2f * static_cast<float>(x)), ny = 0.4f * std::cos(0.15f * static_cast<float>(y));
        const float nz = std::sqrt(1 - nx * nx - ny * ny);
        return {0.5f + nx / 2, 0.5f + ny / 2, 0.5f + nz / 2, 1};
    };
    EXPECT_EQ(by_pixels(128, 128, bumps).use, TextureUse::normal);
    EXPECT_EQ(by_pixels(128, 128, bumps, "wood_diffuse.png").use, TextureUse::normal);  // unmistakable, whatever the name
    const auto sky = [](int, int y) -> std::array<float, 4> { return {0.3f, 0.5f + 0.002f * static_cast<float>(y), 0.9f, 1}; };
    EXPECT_EQ(by_pixels(128, 128, sky).use, TextureUse::color);
    // A picture whose name ends like a normal map's.
    const auto leaves = [](int x, int y) -> std::array<float, 4> { return {0.1f, 0.2f + 0.05f * static_cast<float>((x ^ y) & 3), 0.05f, 1}; };
    EXPECT_EQ(by_pixels(128, 128, leaves, "tree_n.png").use, TextureUse::color);
    EXPECT_EQ(by_pixels(128, 128, leaves, "button_normal.png").use, TextureUse::color);
    EXPECT_EQ(by_pixels(128, 128, bumps, "tree_n.png").use, TextureUse::normal);
}

TEST(TextureUse, KnowsMasksTablesAndIdsByTheirPixels) {
    const auto disc = [](int x, int y) -> std::array<float, 4> {
        const float v = (x - 64) * (x - 64) + (y - 64) * (y - 64) < 1600 ? 1.0f : 0.0f;
        return {v, v, v, 1};
    };
    EXPECT_EQ(by_pixels(128, 128, disc).use, TextureUse::mask);
    EXPECT_EQ(by_pixels(128, 128, disc, "icon_color.png").use, TextureUse::color);
    const auto grey = [](int x, int y) -> std::array<float, 4> {
        const float v = 0.5f + 0.3f * std::sin(0.1f * static_cast<float>(x * y % 97));
        return {v, v, v, 1};
    };
    EXPECT_EQ(by_pixels(128, 128, grey).use, TextureUse::color);  // asphalt is grey
    EXPECT_EQ(by_pixels(128, 128, grey, "x_s.png").use, TextureUse::specular);
    const auto red = [](int, int) -> std::array<float, 4> { return {0.8f, 0.1f, 0.1f, 1}; };
    EXPECT_EQ(by_pixels(128, 128, red, "x_s.png").use, TextureUse::color);
    EXPECT_EQ(by_pixels(128, 128, red).use, TextureUse::color);
    for (const auto& [width, height] : {std::pair{1024, 32}, {256, 16}, {16, 256}, {512, 512}}) {
        const int n = width == 512 ? 64 : std::min(width, height), columns = width / n;
        const auto table = [&](int x, int y) -> std::array<float, 4> {
            const auto m = static_cast<float>(n - 1);
            return {static_cast<float>(x % n) / m, static_cast<float>(y % n) / m, static_cast<float>(y / n * columns + x / n) / m, 1};
        };
        EXPECT_EQ(by_pixels(width, height, table).use, TextureUse::lut) << width << " x " << height;
        EXPECT_EQ(by_pixels(width, height, grey).use, TextureUse::color);
    }
    const auto parts = [](int x, int y) -> std::array<float, 4> {
        constexpr std::array<std::array<float, 4>, 4> colors{{{1, 0, 0, 1}, {0, 1, 0, 1}, {0, 0, 1, 1}, {1, 1, 0, 1}}};
        return colors[static_cast<std::size_t>((x / 128 + 2 * (y / 128)) & 3)];
    };
    EXPECT_EQ(by_pixels(256, 256, parts).use, TextureUse::id);
    // What is transparent is not looked at.
    const auto hidden = [](int x, int y) -> std::array<float, 4> { return x < 100 ? std::array<float, 4>{0.5f, 0.5f, 1, 0} : std::array<float, 4>{0.1f, 0.2f, 0.05f * static_cast<float>(y & 3), 1}; };
    EXPECT_EQ(by_pixels(128, 128, hidden, "x.png", true).use, TextureUse::color);
    const auto nothing = [](int, int) -> std::array<float, 4> { return {NAN, INFINITY, -INFINITY, NAN}; };
    EXPECT_FALSE(by_pixels(64, 64, nothing, "x.png", true).reason.empty());
}

std::vector<std::string> fields(const std::string& line) {
    std::vector<std::string> out;
    std::stringstream in(line);
    for (std::string field; std::getline(in, field, ',');) out.push_back(field);
    return out;
}

TEST(TextureUse, AgreesWithAPersonOnRealLibraries) {
    std::ifstream in(SPECTEX_TEST_DATA "/texture_use_labels.csv");
    std::string line;
    ASSERT_TRUE(std::getline(in, line));
    std::vector<std::vector<std::string>> rows;
    while (std::getline(in, line)) rows.push_back(fields(line));
    ASSERT_GE(rows.size(), 400u);
    for (const auto& row : rows) {
        ASSERT_EQ(row.size(), 4u);
        ASSERT_TRUE(parse_texture_use(row[2])) << row[2];
    }
    const char* root = std::getenv("SPECTEX_TEST_LIBRARIES");
    if (!root || !fs::is_directory(root))
        GTEST_SKIP() << "SPECTEX_TEST_LIBRARIES names no folder of unpacked packages (tests/unit/texture_libraries.py makes it)";
    struct Counts {
        int hits = 0, false_alarms = 0, misses = 0, rejections = 0;
        double precision() const { return static_cast<double>(hits) / (hits + false_alarms); }
        double recall() const { return static_cast<double>(hits) / (hits + misses); }
        int total() const { return hits + false_alarms + misses + rejections; }
    };
    std::map<std::string, Counts> halves;
    for (const auto& row : rows) {
        const std::string folder = std::string(root) + "/" + row[0], path = folder + "/" + row[1];
        if (!fs::exists(path)) continue;
        TextureUseOptions options;
        options.root = folder;
        const auto verdict = classify_texture(path, options);
        ASSERT_TRUE(verdict) << verdict.error().message;
        const bool truth = is_color(*parse_texture_use(row[2])), said = verdict->color();
        // Maps of levels (`levels`: heights and what grows where) are no textures, and look like drawings: told, not judged.
        const bool level = row[3] == "levels";
        for (Counts* c : {&halves[row[3]], level ? nullptr : &halves["judged"]})
            if (c) (truth ? (said ? c->hits : c->misses) : (said ? c->false_alarms : c->rejections)) += 1;
        if (!level && truth != said) std::printf("  %s: labelled %s; %s\n", path.c_str(), row[2].c_str(), verdict->reason.c_str());
    }
    for (const auto& [half, c] : halves)
        std::printf("%s: %d files, %d colour of which %d found, %d data of which %d taken for colour\n", half.c_str(), c.total(), c.hits + c.misses,
                    c.hits, c.false_alarms + c.rejections, c.false_alarms);
    const Counts& judged = halves["judged"];
    if (judged.total() == 0) GTEST_SKIP() << root << " has none of the labelled files";
    // The promise is 0.97 over the whole list. A part of it may have one odd file in twenty.
    const double promise = judged.total() >= 150 ? 0.97 : 0.9;
    EXPECT_GE(judged.precision(), promise);
    EXPECT_GE(judged.recall(), promise);
    if (const Counts& held = halves["held-out"]; held.total() >= 100) {
        EXPECT_GE(held.precision(), 0.97);
        EXPECT_GE(held.recall(), 0.97);
    }
}

}  // namespace
}  // namespace spectex
