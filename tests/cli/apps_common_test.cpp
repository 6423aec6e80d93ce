// Naming of outputs and text helpers, which no single tool shows whole.

#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>

#include "app.h"

namespace spectex::app {
namespace {

namespace fs = std::filesystem;

class Outputs : public testing::Test {
protected:
    void SetUp() override {
        std::string pattern = (fs::temp_directory_path() / "spectex-outputs-XXXXXX").string();
        ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
        root_ = pattern;
        fs::create_directories(root_ / "out");
        fs::create_directories(root_ / "other");
        for (const char* name : {"a.png", "b.png", "other/a.tif"}) std::ofstream(root_ / name) << name;
    }
    void TearDown() override { fs::remove_all(root_); }
    std::string at(const char* name) const { return (root_ / name).string(); }

    fs::path root_;
};

void expect_usage(const Result<std::vector<Job>>& jobs, std::initializer_list<std::string> mentions) {
    ASSERT_FALSE(jobs.ok());
    EXPECT_EQ(jobs.error().kind, ErrorKind::usage);
    for (const auto& mention : mentions) EXPECT_NE(jobs.error().message.find(mention), std::string::npos) << jobs.error().message;
}

TEST_F(Outputs, OneFile) {
    const std::vector<std::string> inputs{at("a.png")};
    const auto jobs = plan_outputs(inputs, at("new.exr"), ".exr");
    ASSERT_TRUE(jobs.ok()) << jobs.error().message;
    ASSERT_EQ(jobs->size(), 1u);
    EXPECT_EQ((*jobs)[0].outputs, std::vector<std::string>{at("new.exr")});
}

TEST_F(Outputs, Folder) {
    const std::vector<std::string> inputs{at("a.png"), at("b.png")};
    const auto jobs = plan_outputs(inputs, at("out"), ".exr");
    ASSERT_TRUE(jobs.ok()) << jobs.error().message;
    EXPECT_EQ((*jobs)[0].outputs[0], at("out/a.exr"));
    EXPECT_EQ((*jobs)[1].outputs[0], at("out/b.exr"));
}

TEST_F(Outputs, ManyNeedAFolder) {
    const std::vector<std::string> inputs{at("a.png"), at("b.png")};
    expect_usage(plan_outputs(inputs, at("none"), ".exr"), {"folder", "missing"});
    expect_usage(plan_outputs(inputs, at("b.png"), ".exr"), {"need a folder"});
    expect_usage(plan_outputs({inputs.data(), 1}, at("none/"), ".exr"), {"folder", "missing"});
    expect_usage(plan_outputs({inputs.data(), 1}, at("none/x.exr"), ".exr"), {"folder", "missing"});
}

TEST_F(Outputs, SameStemCollides) {
    const std::vector<std::string> inputs{at("a.png"), at("other/a.tif")};
    expect_usage(plan_outputs(inputs, at("out"), ".exr"), {inputs[0], inputs[1]});
}

TEST_F(Outputs, SameInputTwiceCollides) {
    const std::vector<std::string> inputs{at("a.png"), at("a.png")};
    expect_usage(plan_outputs(inputs, at("out"), ".exr"), {inputs[0]});
}

TEST_F(Outputs, InputIsRefusedThroughAnyName) {
    const std::vector<std::string> inputs{at("a.png")};
    fs::create_symlink(at("a.png"), at("soft.exr"));
    fs::create_hard_link(at("a.png"), at("hard.exr"));
    fs::create_directory_symlink(root_, root_ / "round");
    for (const char* name : {"a.png", "soft.exr", "hard.exr", "out/../a.png", "round/a.png"})
        expect_usage(plan_outputs(inputs, at(name), ".exr"), {"is the input"});
    expect_usage(plan_outputs(inputs, root_.string(), ".png"), {"is the input"});
}

TEST_F(Outputs, OutputOfOneIsInputOfAnother) {
    const std::vector<std::string> inputs{at("other/a.tif"), at("a.png")};
    expect_usage(plan_outputs({inputs.data(), 2}, root_.string(), ".png"), {"is the input"});
}

TEST_F(Outputs, Illuminants) {
    const std::vector<std::string> inputs{at("a.png")}, lights{"D:5003", "FL11"};
    const auto named = plan_outputs(inputs, at("x_{illuminant}.exr"), ".exr", lights);
    ASSERT_TRUE(named.ok()) << named.error().message;
    EXPECT_EQ((*named)[0].outputs, (std::vector<std::string>{at("x_D_5003.exr"), at("x_FL11.exr")}));
    const auto folder = plan_outputs(inputs, at("out"), ".exr", lights);
    ASSERT_TRUE(folder.ok()) << folder.error().message;
    EXPECT_EQ((*folder)[0].outputs, (std::vector<std::string>{at("out/a_D_5003.exr"), at("out/a_FL11.exr")}));
    expect_usage(plan_outputs(inputs, at("x.exr"), ".exr", lights), {"{illuminant}"});
    const std::vector<std::string> alike{"D:5003", "D/5003"};
    expect_usage(plan_outputs(inputs, at("x_{illuminant}.exr"), ".exr", alike), {"D:5003", "D/5003"});
}

TEST_F(Outputs, Wildcards) {
    const std::vector<std::string> pattern{at("?.png")}, folder{at("o*")}, none{at("*.gif")}, missing{at("c.png")}, empty{""};
    const auto found = expand_inputs(pattern);
    ASSERT_TRUE(found.ok());
    EXPECT_EQ(*found, (std::vector<std::string>{at("a.png"), at("b.png")}));
    EXPECT_EQ(expand_inputs(folder).error().kind, ErrorKind::usage);
    EXPECT_EQ(expand_inputs(none).error().kind, ErrorKind::input);
    EXPECT_EQ(expand_inputs(empty).error().kind, ErrorKind::usage);
    EXPECT_TRUE(expand_inputs(missing).ok());
}

TEST(FileNamePart, KeepsFoldersOut) {
    for (const char* name : {"../x", "/etc", "a/b", "..", ".", "", "-o", "a b", "0.7*A+0.3*FL11", "x\ny"}) {
        const auto part = file_name_part(name);
        EXPECT_FALSE(part.empty());
        EXPECT_EQ(part.find_first_of("/:* \n"), std::string::npos) << part;
        EXPECT_FALSE(part.starts_with('.') || part.starts_with('-')) << part;
    }
    EXPECT_EQ(file_name_part("0.7*A+0.3*FL11"), "0.7_A+0.3_FL11");
}

TEST(Escape, LeavesUtf8AndNothingElse) {
    EXPECT_EQ(escape("ΔE λ 😀"), "ΔE λ 😀");
    EXPECT_EQ(escape("a\nb\tc\x1b[0m\x7f"), "a\\nb\\tc\\x1b[0m\\x7f");
    EXPECT_EQ(escape("\xff\xc3"), "\\xff\\xc3");
    EXPECT_EQ(escape("\xc0\xaf"), "\\xc0\\xaf") << "overlong";
    EXPECT_EQ(escape("\xed\xa0\x80"), "\\xed\\xa0\\x80") << "surrogate";
    EXPECT_EQ(escape("\xc2\x9b" "31m"), "\\xc2\\x9b31m") << "C1 control sequence introducer";
    EXPECT_EQ(escape("\xf4\x90\x80\x80"), "\\xf4\\x90\\x80\\x80") << "beyond U+10FFFF";
}

TEST(Numbers, WholeTextInRange) {
    EXPECT_EQ(*parse_number("0.5", 0, 1), 0.5);
    EXPECT_EQ(*parse_number("-1e-3", -1, 1), -1e-3);
    for (const char* text : {"", " 1", "1 ", "1,5", "nan", "inf", "0x1", "1e999", "2", "-0.1", "+1", "1f"})
        EXPECT_FALSE(parse_number(text, 0, 1).ok()) << text;
    EXPECT_EQ(*parse_integer("1024", 0, 1024), 1024);
    for (const char* text : {"", "1.0", "1025", "-1", "9999999999999999999999"}) EXPECT_FALSE(parse_integer(text, 0, 1024).ok()) << text;
    EXPECT_EQ((*parse_range("-1:2.5")), (std::array<double, 2>{-1, 2.5}));
    for (const char* text : {"1:1", "2:1", ":", "1:", ":1", "a:b", "1:2:3"}) EXPECT_FALSE(parse_range(text).ok()) << text;
    EXPECT_EQ(parse_list("a,b")->size(), 2u);
    for (const char* text : {"", ",", "a,", ",a", "a,,b"}) EXPECT_FALSE(parse_list(text).ok()) << text;
}

TEST(Numbers, TextReadsBack) {
    for (const double value : {0.1, 1.0 / 3, 1e-300, 5e-324, std::numeric_limits<double>::max()})
        EXPECT_EQ(*parse_number(number_text(value), -HUGE_VAL, HUGE_VAL), value);
    EXPECT_EQ(number_text(0.1), "0.1");
}

TEST(Nearest, SlipsOnly) {
    const std::vector<std::string> names{"--bands", "--half", "--output"};
    EXPECT_EQ(nearest("--band", names), "--bands");
    EXPECT_EQ(nearest("--bnads", names), "--bands");
    EXPECT_EQ(nearest("--out", names), "--output");
    EXPECT_EQ(nearest("--something", names), std::nullopt);
}

TEST(Wrap, KeepsEveryWord) {
    EXPECT_EQ(wrap("aa bb cc", 5), (std::vector<std::string>{"aa bb", "cc"}));
    EXPECT_EQ(wrap("aaaaaaaa b", 5), (std::vector<std::string>{"aaaaaaaa", "b"}));
    EXPECT_EQ(wrap("", 5), std::vector<std::string>{""});
    EXPECT_EQ(columns("λΔ"), 2u);
}

/// Fixed arguments first and last, the list between takes the rest.
TEST(Positionals, AssignedInOrder) {
    std::vector<std::string> command, files, last;
    App app({.name = "spxtest", .synopsis = "", .summary = "", .examples = {}});
    app.positional("COMMAND", &command, 1, 1, "");
    app.positional("FILE...", &files, 0, App::unlimited, "");
    app.positional("LAST", &last, 1, 1, "");
    std::array<std::string, 6> words{"spxtest", "go", "[x,y]", "--", "--b", "end"};
    std::array<char*, 6> argv{};
    for (std::size_t i = 0; i < words.size(); ++i) argv[i] = words[i].data();
    EXPECT_EQ(app.run(6, argv.data(), [] { return 1; }), 1);
    EXPECT_EQ(command, std::vector<std::string>{"go"});
    EXPECT_EQ(files, (std::vector<std::string>{"[x,y]", "--b"}));
    EXPECT_EQ(last, std::vector<std::string>{"end"});
}

}  // namespace
}  // namespace spectex::app
