// Names of outputs, shards and the manifest of the batch room.
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <random>
#include <set>

#include "batch/discover.h"
#include "batch/manifest.h"
#include "batch/small_png.h"

using namespace spectex;
using namespace spectex::batch;

namespace {

TEST(OutputNames, SharedStemsKeepWholeNamesAndNeverMeet) {
    EXPECT_EQ(output_names({"a.png", "b/a.png", "b/a.tif", "c.d/x"}),
              (std::vector<std::string>{"a.exr", "b/a.png.exr", "b/a.tif.exr", "c.d/x.exr"}));
    const auto names = output_names({"a.jpg", "a.png", "a.png.exr", "a.png.tif"});
    EXPECT_EQ(std::set<std::string>(names.begin(), names.end()).size(), names.size());

}

TEST(OutputNames, ManifestPathsCannotLeaveTheFolder) {
    EXPECT_TRUE(stays_below("a/b.exr"));
    EXPECT_TRUE(stays_below("..a/b..exr"));
    for (const char* path : {"", "/a", "../a", "a/../b", "a/..", "a//b", "./a", "a/"}) EXPECT_FALSE(stays_below(path)) << path;
}

TEST(Shards, ParseAndCoverEveryContentOnce) {
    EXPECT_EQ(parse_shard("3/3")->index, 0);
    EXPECT_EQ(parse_shard("2/3")->index, 2);
    for (const char* text : {"", "1", "/3", "1/", "-1/3", "4/3", "0/0", "1/3x", " 1/3", "1/100001"})
        EXPECT_FALSE(parse_shard(text)) << text;
    std::map<int, int> counts;
    for (int i = 0; i < 3000; ++i) ++counts[shard_of(hash_text(std::to_string(i)), 3)];
    ASSERT_EQ(counts.size(), 3u);
    // Binomial with mean 1000 and deviation 26: six deviations, for one seedless draw that never changes.
    for (const auto& [shard, count] : counts) EXPECT_NEAR(count, 1000, 156) << shard;
}

TEST(Hashes, AreThePublishedXxh3) {
    // XXH3_128bits of no bytes, as the specification of xxHash lists it.
    EXPECT_EQ(hash_text(""), "99aa06d3014798d86001c324468d497f");
}

TEST(ManifestFile, KeepsRowsAcrossOpeningsAndRefusesOthers) {
    const auto folder = std::filesystem::temp_directory_path() / ("spectex_batch_test_" + std::to_string(::getpid()));
    std::filesystem::create_directories(folder);
    const std::string path = folder / "m.sqlite";
    Row row;
    row.path = std::string("not\xffutf8 \n'quoted'.png");
    row.stamp = {123, 456789};
    row.content = hash_text("x");
    row.status = "converted";
    row.output = "o.exr";
    row.max = 0.25;
    row.out_of_gamut = 7;
    {
        auto manifest = Manifest::open(path, true);
        ASSERT_TRUE(manifest) << manifest.error().message;
        ASSERT_TRUE(manifest->put(row));
        ASSERT_TRUE(manifest->add_orphan("old.exr", "hash"));
    }
    auto manifest = Manifest::open(path, false);
    ASSERT_TRUE(manifest) << manifest.error().message;
    const auto rows = manifest->rows();
    ASSERT_TRUE(rows);
    ASSERT_EQ(rows->count(row.path), 1u);
    const Row& back = rows->at(row.path);
    EXPECT_EQ(back.stamp, row.stamp);
    EXPECT_EQ(back.content, row.content);
    EXPECT_EQ(back.output, "o.exr");
    EXPECT_EQ(back.max, 0.25);
    EXPECT_EQ(back.out_of_gamut, 7);
    EXPECT_EQ(manifest->orphans()->at("old.exr"), "hash");

    const std::string other = folder / "other.sqlite";
    std::ofstream(other) << "this is text, and long enough to be taken for a header of something else entirely";
    EXPECT_FALSE(Manifest::open(other, true));
    const auto lock = Lock::take(folder / "lock", false, "DST");
    ASSERT_TRUE(lock);
    EXPECT_FALSE(Lock::take(folder / "lock", true, "DST"));
    std::filesystem::remove_all(folder);
}

/// Mean and largest difference of codes between a picture and its file as OpenImageIO's reader has it.
std::pair<double, int> difference(const Picture& picture, int colors) {
    const auto path = std::filesystem::temp_directory_path() / ("spectex_png_test_" + std::to_string(::getpid()) + ".png");
    const auto bytes = small_png(picture, colors);
    std::ofstream(path, std::ios::binary).write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    auto reader = ImageReader::open(path, 1);
    if (!reader) return {-1, -1};
    const auto& h = (*reader)->header();
    if (h.geometry.width != picture.width || h.geometry.height != picture.height || h.channels.size() != 3 || h.type != PixelType::uint8) return {-2, -2};
    std::vector<std::uint8_t> read(picture.rgb.size());
    if (!(*reader)->read_rows(0, picture.height, reinterpret_cast<std::byte*>(read.data()))) return {-3, -3};
    std::filesystem::remove(path);
    double sum = 0;
    int most = 0;
    for (std::size_t i = 0; i < read.size(); ++i) {
        const int d = std::abs(read[i] - picture.rgb[i]);
        sum += d;
        most = std::max(most, d);
    }
    return {sum / static_cast<double>(read.size()), most};
}

TEST(SmallPng, IsExactWithFewColorsAndNearWithMany) {
    std::minstd_rand random(5);
    // 1, 2, 4 and 8 bits a pixel, and widths that leave bits over.
    for (const int colors : {1, 2, 3, 4, 5, 16, 17, 200, 256})
        for (const int width : {1, 7, 33}) {
            Picture picture{width, 9, {}};
            std::vector<Rgb8> palette;
            for (int i = 0; i < colors; ++i) palette.push_back({static_cast<std::uint8_t>(i), static_cast<std::uint8_t>(37 * i), static_cast<std::uint8_t>(random())});
            for (int i = 0; i < width * 9; ++i)
                for (const auto c : palette[random() % palette.size()]) picture.rgb.push_back(c);
            EXPECT_EQ(difference(picture, std::max(colors, 2)).second, 0) << colors << " colours, " << width << " wide";
        }
    // A smooth picture of 4096 colours: 96 cubes of the plane that it spans have a side of 255 / sqrt(96) = 26, whose mean
    // distance from the middle is a quarter; one axis follows the others.
    Picture smooth{64, 64, {}};
    for (int y = 0; y < 64; ++y)
        for (int x = 0; x < 64; ++x)
            for (const int v : {4 * x, 4 * y, 2 * (x + y)}) smooth.rgb.push_back(static_cast<std::uint8_t>(v));
    const auto [mean, most] = difference(smooth, 96);
    EXPECT_GE(mean, 0);
    EXPECT_LT(mean, 6.5);
    EXPECT_LT(most, 26);
    EXPECT_EQ(small_png(smooth, 96), small_png(smooth, 96));
    // RFC 4648, section 10.
    for (const auto& [text, code] : {std::pair{"", ""}, {"f", "Zg=="}, {"fo", "Zm8="}, {"foo", "Zm9v"}, {"foobar", "Zm9vYmFy"}})
        EXPECT_EQ(base64({text, text + std::string_view(text).size()}), code);
}

TEST(Page, SaysWhatItLeavesOut) {
    const auto folder = std::filesystem::temp_directory_path() / ("spectex_page_test_" + std::to_string(::getpid()));
    std::filesystem::create_directories(folder);
    BatchReport report;
    for (int i = 0; i < 40; ++i) {
        BatchFile f;
        f.relative = "f" + std::to_string(i) + ".png";
        f.input = (folder / f.relative).string();
        f.output = (folder / ("f" + std::to_string(i) + ".exr")).string();
        f.status = i == 3 ? BatchStatus::failed : BatchStatus::converted;
        f.reason = i == 3 ? f.input + ": <b>broken</b>" : "new";
        f.measured = i != 3;
        f.max = i;
        f.use = "color";
        report.files.push_back(f);
    }
    report.failed = 1, report.converted = 39;
    BatchPageOptions options;
    options.light = parse_illuminant("A").value();
    options.most_rows = 10;
    options.most_pictures = 4;
    const std::string path = folder / "p.html";
    const auto written = write_batch_page(path, "S", "D", report, options);
    ASSERT_TRUE(written) << written.error().message;
    EXPECT_EQ(written->rows, 10u);
    // None of these files exists: the page says so of each that it should have shown.
    EXPECT_EQ(written->without, 4u);
    EXPECT_EQ(written->pictures, 0u);
    std::ifstream stream(path);
    const std::string text{std::istreambuf_iterator<char>(stream), {}};
    EXPECT_EQ(text.size(), written->bytes);
    const auto has = [&](std::string_view part) { return text.find(part) != std::string::npos; };
    EXPECT_TRUE(has("The table has 10 of 40 files"));
    EXPECT_TRUE(has("The 4 textures of the largest errors out of 39"));
    EXPECT_TRUE(has("<b>f3.png</b>: &lt;b&gt;broken&lt;/b&gt;"));
    EXPECT_TRUE(has("f39.png<small>") && has("f31.png<small>") && has("f3.png<small>") && !has("f30.png<small>"));
    EXPECT_TRUE(has("no pictures: "));
    EXPECT_FALSE(write_batch_page(folder / "none" / "p.html", "S", "D", report, options));
    std::filesystem::remove_all(folder);
}

}  // namespace
