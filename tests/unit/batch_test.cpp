// Names of outputs, shards and the manifest of the batch room.
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <set>

#include "batch/discover.h"
#include "batch/manifest.h"

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

}  // namespace
