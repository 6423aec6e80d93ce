// Pictures for people: ticks, colour maps, sheets, legends and spectrum plots.
#include "spectex/heatmap.h"

#include <OpenImageIO/imageio.h>
#include <expat.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <numeric>
#include <random>
#include <set>
#include <string>

#include "heatmap/text.h"
#include "spectex/color.h"

namespace spectex {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr Rgb8 white{255, 255, 255}, black{0, 0, 0};

Rgb8 pixel(const Picture& p, int x, int y) {
    const std::size_t i = 3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(p.width) + static_cast<std::size_t>(x));
    return {p.rgb[i], p.rgb[i + 1], p.rgb[i + 2]};
}

/// Box of all pixels that are not white: left, top, right, bottom; right < left when there is none.
std::array<int, 4> ink_box(const Picture& p) {
    std::array<int, 4> box{p.width, p.height, -1, -1};
    for (int y = 0; y < p.height; ++y)
        for (int x = 0; x < p.width; ++x)
            if (pixel(p, x, y) != white)
                box = {std::min(box[0], x), std::min(box[1], y), std::max(box[2], x), std::max(box[3], y)};
    return box;
}

double parse_label(std::string text, int exponent) {
    double sign = 1;
    if (text.starts_with("\u2212")) {
        sign = -1;
        text.erase(0, std::string("\u2212").size());
    }
    text += "e" + std::to_string(exponent);
    double value = nan;
    const auto end = std::from_chars(text.data(), text.data() + text.size(), value).ptr;
    EXPECT_EQ(end, text.data() + text.size()) << text;
    return sign * value;
}

TEST(RoundUpRange, SmallestOfTheSeriesOverASweep) {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> decade(-6, 9);
    constexpr std::array<double, 10> series{1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10};
    for (int i = 0; i < 20000; ++i) {
        const double value = std::pow(10, decade(random));
        const double range = round_up_range(value);
        ASSERT_GE(range, value);
        const double power = std::pow(10, std::floor(std::log10(range) + 1e-9));
        // pow and the division leave a few ulp: 1e-12 is far above them and far below the series' spacing of 0.2.
        const auto at = std::find_if(series.begin(), series.end() - 1,
                                     [&](double m) { return std::abs(range / power - m) < 1e-12; });
        ASSERT_NE(at, series.end() - 1) << range;
        const double next_smaller = at == series.begin() ? 0.8 * power : *(at - 1) * power;
        ASSERT_LT(next_smaller, value * (1 + 1e-12)) << range;
        ASSERT_EQ(round_up_range(range), range) << "a member of the series stays";
    }
}

TEST(RoundUpRange, EndsOfTheDomain) {
    for (const double value : {0.0, -1.0, -infinity, nan, 1e-6, 1e-300}) EXPECT_EQ(round_up_range(value), 1e-6) << value;
    EXPECT_EQ(round_up_range(infinity), 1.5e308);
    EXPECT_EQ(round_up_range(std::numeric_limits<double>::max()), 1.5e308);
    EXPECT_EQ(round_up_range(9e307), 1e308);
    EXPECT_EQ(round_up_range(34.2), 40);
    EXPECT_EQ(round_up_range(0.3), 0.3);
}

TEST(Ticks, FourToEightRoundNumbersInsideOverASweep) {
    std::mt19937_64 random(2);
    std::uniform_real_distribution<double> decade(-9, 9), offset(-30, 30);
    for (int i = 0; i < 20000; ++i) {
        const double span = std::pow(10, decade(random));
        const double low = i % 3 == 0 ? 0 : offset(random) * span;
        const double high = i % 3 == 2 ? low + round_up_range(span) : low + span;
        const auto positions = ticks(low, high);
        ASSERT_GE(positions.size(), 4u) << low << " " << high;
        ASSERT_LE(positions.size(), 8u) << low << " " << high;
        const double step = positions[1] - positions[0];
        for (std::size_t k = 0; k < positions.size(); ++k) {
            ASSERT_GE(positions[k], low);
            ASSERT_LE(positions[k], high);
            // Each tick is its decimal to half an ulp, so a difference is off by ulps of the largest of at most 60 steps.
            if (k > 0) {
                ASSERT_NEAR(positions[k] - positions[k - 1], step, 1e-12 * step * 60);
            }
        }
        // One more on either side would lie outside: nothing of the range is left unmarked.
        ASSERT_LT(positions.front() - step * (1 + 1e-9), low);
        ASSERT_GT(positions.back() + step * (1 + 1e-9), high);

        const auto labels = tick_labels(positions);
        ASSERT_EQ(labels.text.size(), positions.size());
        bool decimals_needed = labels.text[0].find('.') == std::string::npos;
        for (std::size_t k = 0; k < positions.size(); ++k) {
            ASSERT_EQ(parse_label(labels.text[k], labels.exponent), positions[k]) << labels.text[k] << " " << labels.exponent;
            // Sign of three bytes, point, and the digits of a mantissa up to 60 steps of 2.5: "−148.75" at the most.
            ASSERT_LE(labels.text[k].size(), 10u) << labels.text[k];
            if (labels.text[k].back() != '0') decimals_needed = true;
        }
        ASSERT_TRUE(decimals_needed) << labels.text[1] << ": a decimal that is 0 in every label says nothing";
        ASSERT_EQ(labels.multiplier.empty(), labels.exponent == 0);
    }
}

TEST(Ticks, NamedRanges) {
    const auto text = [](double low, double high) {
        const auto labels = tick_labels(ticks(low, high));
        std::string all;
        for (const auto& label : labels.text) all += label + " ";
        return all + labels.multiplier;
    };
    EXPECT_EQ(text(0, 35), "0 5 10 15 20 25 30 35 ");
    EXPECT_EQ(text(0, 0.3), "0.00 0.05 0.10 0.15 0.20 0.25 0.30 ");
    EXPECT_EQ(text(0, 0.06), "0.00 0.01 0.02 0.03 0.04 0.05 0.06 ");
    EXPECT_EQ(text(0, 2e-5), "0.0 0.5 1.0 1.5 2.0 ×10⁻⁵");
    EXPECT_EQ(text(-3, 3), "\u22123 \u22122 \u22121 0 1 2 3 ");
    EXPECT_EQ(text(0, 1), "0.0 0.2 0.4 0.6 0.8 1.0 ");
    EXPECT_EQ(text(0, 1e7), "0.0 0.2 0.4 0.6 0.8 1.0 ×10⁷");
    EXPECT_EQ(text(380, 780), "400 450 500 550 600 650 700 750 ");
}

TEST(Ticks, NoneForRangesThatHaveNone) {
    for (const auto& [low, high] : {std::pair{0.0, 0.0}, {1.0, 0.0}, {nan, 1.0}, {0.0, nan}, {0.0, infinity}, {-infinity, 0.0},
                                    {0.0, 1e301}, {1.0, 1.0 + 1e-15}, {0.0, 5e-324}})
        EXPECT_TRUE(ticks(low, high).empty()) << low << " " << high;
    EXPECT_TRUE(tick_labels({}).text.empty());
    EXPECT_GE(ticks(-1e300, 1e300).size(), 4u);
    EXPECT_GE(ticks(1e9, 1e9 + 1).size(), 4u);
}

TEST(ColorMaps, EndsAsPublished) {
    struct Ends {
        const char* name;
        Rgb8 low, high;
        int tolerance;
    };
    // viridis: van der Walt and Smith 2015; turbo: Mikhailov 2019; their 8-bit ends, rounded. magma and inferno start at
    // (0.001, 0, 0.014). One code for the rounding of a table kept in linear light.
    for (const Ends& e : {Ends{"viridis", {68, 1, 84}, {253, 231, 37}, 1}, Ends{"magma", {0, 0, 4}, {252, 253, 191}, 1},
                          Ends{"inferno", {0, 0, 4}, {252, 255, 164}, 1}, Ends{"plasma", {13, 8, 135}, {240, 249, 33}, 1},
                          Ends{"turbo", {48, 18, 59}, {122, 4, 3}, 1}}) {
        const auto map = find_color_map(e.name);
        ASSERT_TRUE(map) << map.error().message;
        for (std::size_t c = 0; c < 3; ++c) {
            EXPECT_NEAR(map->codes[0][c], e.low[c], e.tolerance) << e.name << c;
            EXPECT_NEAR(map->codes[255][c], e.high[c], e.tolerance) << e.name << c;
        }
    }
}

TEST(ColorMaps, LightnessRisesStrictlyInTheSequentialOnes) {
    for (const char* name : {"magma", "inferno", "plasma", "viridis"}) {
        const auto map = find_color_map(name);
        ASSERT_TRUE(map);
        const auto lightness = [&](std::size_t i) {
            const auto& c = map->codes[i];
            const double y = 0.2126 * srgb_decode(c[0] / 255.0) + 0.7152 * srgb_decode(c[1] / 255.0) +
                             0.0722 * srgb_decode(c[2] / 255.0);
            return y > 216.0 / 24389 ? 116 * std::cbrt(y) - 16 : y * 24389 / 27;
        };
        // One entry is 0.2 to 0.4 L* long and a code's rounding is up to 0.2 L*: single steps may stall, four may not.
        for (std::size_t i = 0; i < 256; ++i) {
            if (i >= 1) {
                ASSERT_GE(lightness(i), lightness(i - 1) - 0.25) << name << i;
            }
            if (i >= 4) {
                ASSERT_GT(lightness(i), lightness(i - 4)) << name << i;
            }
        }
        EXPECT_GT(lightness(255) - lightness(0), 65) << name;
    }
}

TEST(ColorMaps, NearestEntryAndNoValue) {
    for (const auto& name : color_map_names()) {
        const auto map = find_color_map(name);
        ASSERT_TRUE(map) << map.error().message;
        EXPECT_EQ(map->name, name);
        EXPECT_EQ(map->at(nan), ColorMap::no_value);
        EXPECT_EQ(map->at(-1), map->codes[0]);
        EXPECT_EQ(map->at(-infinity), map->codes[0]);
        EXPECT_EQ(map->at(2), map->codes[255]);
        EXPECT_EQ(map->at(infinity), map->codes[255]);
        for (std::size_t i = 0; i < 256; ++i) {
            EXPECT_EQ(map->at(static_cast<double>(i) / 255), map->codes[i]);
            EXPECT_EQ(map->at((static_cast<double>(i) + 0.4) / 255), map->codes[i]);
            EXPECT_EQ(map->at((static_cast<double>(i) - 0.4) / 255), map->codes[i]);
        }
        EXPECT_GT(std::set<Rgb8>(map->codes.begin(), map->codes.end()).size(), 100u) << name;
    }
    EXPECT_EQ(color_map_names().front(), default_color_map());
    for (const char* name : {"", "Magma", "jet", "magma "}) {
        const auto map = find_color_map(name);
        ASSERT_FALSE(map) << name;
        EXPECT_EQ(map.error().kind, ErrorKind::usage);
        for (const auto& known : color_map_names()) EXPECT_NE(map.error().message.find(known), std::string::npos);
    }
}

TEST(Text, CleanElidedEscaped) {
    using namespace heatmap;
    const std::string fffd = "\xEF\xBF\xBD";
    EXPECT_EQ(clean_utf8("ΔE*₀₀ λ 𝜆"), "ΔE*₀₀ λ 𝜆");
    EXPECT_EQ(clean_utf8("a\tb\nc\x01\x7F"), "a b c  ");
    EXPECT_EQ(clean_utf8("\xC0\xAF"), fffd + fffd) << "overlong";
    EXPECT_EQ(clean_utf8("\xED\xA0\x80"), fffd + fffd + fffd) << "surrogate";
    EXPECT_EQ(clean_utf8("\xF4\x90\x80\x80"), fffd + fffd + fffd + fffd) << "beyond U+10FFFF";
    EXPECT_EQ(clean_utf8("x\xCE"), "x" + fffd) << "cut off";
    EXPECT_EQ(clean_utf8("\xEF\xBF\xBF"), fffd) << "U+FFFF is not XML";
    EXPECT_EQ(clean_utf8(std::string_view("\0", 1)), " ");
    EXPECT_EQ(elide("Δλ", 2), "Δλ");
    EXPECT_EQ(elide("Δλμ", 2), "Δ…");
    EXPECT_EQ(elide("", 2), "");
    EXPECT_EQ(escape_xml("<a b=\"c\" d='e'>&"), "&lt;a b=&quot;c&quot; d=&apos;e&apos;&gt;&amp;");
    EXPECT_EQ(superscript(-12), "⁻¹²");
    const auto runs = split_runs("ΔE*ab, ΔE*₀₀!");
    ASSERT_EQ(runs.size(), 5u);
    EXPECT_EQ(runs[1].text, "ab");
    EXPECT_TRUE(runs[1].subscript);
    EXPECT_EQ(runs[3].text, "00");
    EXPECT_EQ(runs[4].text, "!");
}

TEST(Resize, BoxKeepsLightAndNearestKeepsCodes) {
    Picture checker{2, 2, {0, 0, 0, 255, 255, 255, 255, 255, 255, 0, 0, 0}};
    const auto one = resize(checker, 1, 1, Filter::box);
    ASSERT_TRUE(one);
    // Half the light of white is sRGB code 187.5 (IEC 61966-2-1); a mean of the codes would be 128.
    EXPECT_NEAR(pixel(*one, 0, 0)[0], 188, 1);

    Picture noise{37, 23, {}};
    std::mt19937 random(3);
    for (int i = 0; i < 3 * 37 * 23; ++i) noise.rgb.push_back(static_cast<std::uint8_t>(random() % 256));
    for (const auto filter : {Filter::nearest, Filter::box}) {
        const auto larger = resize(noise, 37 * 3, 23 * 5, filter);
        ASSERT_TRUE(larger);
        for (int y = 0; y < larger->height; ++y)
            for (int x = 0; x < larger->width; ++x) ASSERT_EQ(pixel(*larger, x, y), pixel(noise, x / 3, y / 5));
    }
    const auto light = [](const Picture& p) {
        double sum = 0;
        for (const auto code : p.rgb) sum += srgb_decode(code / 255.0);
        return sum / static_cast<double>(p.rgb.size());
    };
    const auto smaller = resize(noise, 10, 7, Filter::box);
    ASSERT_TRUE(smaller);
    // Codes near the mean of 0.4 are 0.006 of linear light apart; 210 roundings of up to half of that average out to 1e-3.
    EXPECT_NEAR(light(*smaller), light(noise), 1e-3);
    const auto thirds = resize(Picture{3, 1, {0, 0, 0, 255, 255, 255, 0, 0, 0}}, 2, 1, Filter::box);
    ASSERT_TRUE(thirds);
    for (const int x : {0, 1}) EXPECT_EQ(pixel(*thirds, x, 0)[0], std::lround(255 * srgb_encode(1.0 / 3))) << x;
    EXPECT_FALSE(resize(noise, 0, 5, Filter::box));
    EXPECT_FALSE(resize(noise, 5, 70000, Filter::box));
    EXPECT_FALSE(resize(Picture{4, 4, {1, 2, 3}}, 2, 2, Filter::nearest));
    EXPECT_FALSE(resize(Picture{}, 2, 2, Filter::nearest));
}

TEST(Canvas, FillsPastesAndClips) {
    auto canvas = Canvas::make(20, 10, {1, 2, 3});
    ASSERT_TRUE(canvas);
    const Picture red{1, 1, {255, 0, 0}};
    canvas->fill(0, 0, 5, 5, {9, 8, 7});
    canvas->paste(red, -2, -2, 4, 4, Filter::nearest);
    canvas->paste(red, 18, 8, 40, 40, Filter::box);
    canvas->paste(red, 100, 100);
    canvas->paste(red, -100, -100);
    const auto picture = canvas->picture();
    ASSERT_TRUE(picture);
    EXPECT_EQ(pixel(*picture, 1, 1), (Rgb8{255, 0, 0}));
    EXPECT_EQ(pixel(*picture, 2, 2), (Rgb8{9, 8, 7}));
    EXPECT_EQ(pixel(*picture, 5, 5), (Rgb8{1, 2, 3}));
    EXPECT_EQ(pixel(*picture, 17, 8), (Rgb8{1, 2, 3}));
    EXPECT_EQ(pixel(*picture, 19, 9), (Rgb8{255, 0, 0}));
    canvas->paste(Picture{2, 2, {1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4}}, -1, -1);
    const auto corner = canvas->picture();
    ASSERT_TRUE(corner);
    EXPECT_EQ(pixel(*corner, 0, 0), (Rgb8{4, 4, 4}));
    EXPECT_EQ(pixel(*corner, 1, 0), (Rgb8{255, 0, 0}));
    canvas->paste(Picture{3, 3, {}}, 0, 0);
    EXPECT_FALSE(canvas->picture());
    EXPECT_FALSE(Canvas::make(0, 5));
    EXPECT_FALSE(Canvas::make(5, 40000));
}

TEST(Canvas, TextFillsItsMeasuredExtents) {
    for (const double size : {11.0, 25.0, 85.0})
        for (const Weight weight : {Weight::regular, Weight::bold})
            for (const char* text : {"ΔE*ab", "ground truth | ours | Meng et al. 2015", "0.06", "CIEDE2000 ΔE*₀₀ ×10⁻⁵"}) {
                const auto extents = measure_text(text, size, weight);
                const int width = static_cast<int>(std::ceil(extents.width)) + 200;
                for (const auto anchor : {Anchor::left, Anchor::center, Anchor::right}) {
                    auto canvas = Canvas::make(width, 300);
                    ASSERT_TRUE(canvas);
                    const double left = 100;
                    const double x = anchor == Anchor::left     ? left
                                     : anchor == Anchor::center ? left + extents.width / 2
                                                                : left + extents.width;
                    canvas->text(x, 150, text, size, black, weight, anchor);
                    const auto picture = canvas->picture();
                    ASSERT_TRUE(picture);
                    const auto box = ink_box(*picture);
                    // Letters have side bearings of up to 0.11 em in DejaVu Sans; a pixel each for the soft edges.
                    EXPECT_NEAR(box[0], left, 0.11 * size + 1) << text;
                    EXPECT_NEAR(box[2] + 1, left + extents.width, 0.11 * size + 1) << text;
                    EXPECT_GE(box[1], 150 - extents.ascent - 1) << text;
                    EXPECT_LE(box[3], 150 + extents.descent + 0.1 * size) << text;
                }
            }
    EXPECT_EQ(measure_text("", 20).width, 0);
    EXPECT_GT(measure_text("wide", 20, Weight::bold).width, measure_text("wide", 20).width);
    // Unhinted outlines scale: ten times the size is ten times the width but for the font's own 26.6 fixed point.
    EXPECT_NEAR(measure_text("ΔE*ab", 200).width / measure_text("ΔE*ab", 20).width, 10, 0.05);
}

const std::vector<std::string>& hostile_strings() {
    static const std::vector<std::string> strings{
        "",
        " ",
        "<&>\"'",
        "]]></text><script>",
        "\xFF\xFE\x80\xC0\xAF",
        std::string("nul\0inside", 10),
        "line\nbreak\ttab",
        std::string(100000, 'W'),
        std::string(5000, '\xFF'),
        "\xE2\x80\xAE" "right to left",
        "\xEF\xBF\xBF",
        "ΔE*ab ΔE*ab E*a E* E*abE*ab₀₉₊",
    };
    return strings;
}

/// Nothing is drawn in the outer `ring` pixels.
void expect_clear_border(const Picture& p, int ring) {
    const auto box = ink_box(p);
    EXPECT_GE(box[0], ring);
    EXPECT_GE(box[1], ring);
    EXPECT_LT(box[2], p.width - ring);
    EXPECT_LT(box[3], p.height - ring);
}

TEST(LegendPicture, InkStaysInsideTheMarginsAtEverySize) {
    const auto map = find_color_map("magma");
    ASSERT_TRUE(map);
    for (const int height : {192, 512, 1200, 4096})
        for (const auto& [low, high] : {std::pair{0.0, 35.0}, {0.0, 2e-5}, {0.0, 0.06}, {-3.0, 3.0}, {1e6, 1.5e6}, {-1e-9, 0.0}})
            for (const bool extended : {false, true}) {
                Legend legend{low, high, "CIE76 ΔE*ab", {"mean\t0.0213", "p99 0.1"}, extended, extended, extended};
                const auto picture = draw_legend(*map, legend, height);
                ASSERT_TRUE(picture) << picture.error().message;
                ASSERT_EQ(picture->height, height);
                expect_clear_border(*picture, static_cast<int>(0.5 * legend_text_size(height)));
            }
}

TEST(LegendPicture, EnoughRoomForNotesAtEveryHeight) {
    const auto map = find_color_map("magma");
    ASSERT_TRUE(map);
    // Below 528 rows the text keeps its size, so that the first height is the tightest; above, rounding decides.
    for (int height = minimum_map_height(); height < 1000; height = std::max(528, height + 13)) {
        const auto four = draw_legend(*map, {0, 35, "Title", {"a", "b", "c", "d"}, false, false, false}, height);
        ASSERT_TRUE(four) << four.error().message;
        const auto two = draw_legend(*map, {0, 2e-5, "Title", {"a", "b"}, true, true, true}, height);
        ASSERT_TRUE(two) << two.error().message;
    }
    const auto many = draw_legend(*map, {0, 1, "Title", std::vector<std::string>(100, "note"), false, false, false}, 512);
    ASSERT_FALSE(many);
    EXPECT_EQ(many.error().kind, ErrorKind::usage);
}

TEST(LegendPicture, BarRunsThroughTheMap) {
    const auto map = find_color_map("viridis");
    ASSERT_TRUE(map);
    const auto picture = draw_legend(*map, {0, 1, "", {}, false, false, false}, 1200);
    ASSERT_TRUE(picture);
    // A column in the middle of the bar, whose left edge is the margin of 1.1 em.
    const int x = static_cast<int>(2 * legend_text_size(1200));
    int first = -1, last = -1;
    for (int y = 0; y < picture->height; ++y)
        if (pixel(*picture, x, y) != white) {
            if (first < 0) first = y;
            last = y;
        }
    constexpr int rule = 2;
    EXPECT_EQ(pixel(*picture, x, first + rule), map->codes[255]);
    EXPECT_EQ(pixel(*picture, x, last - rule), map->codes[0]);
    // The middle of the bar lies between entries 127 and 128.
    const Rgb8 middle = pixel(*picture, x, (first + last + 1) / 2);
    EXPECT_TRUE(middle == map->codes[127] || middle == map->codes[128]);
    std::set<Rgb8> seen;
    for (int y = first + rule; y <= last - rule; ++y) seen.insert(pixel(*picture, x, y));
    EXPECT_EQ(seen.size(), std::set<Rgb8>(map->codes.begin(), map->codes.end()).size());
}

TEST(LegendPicture, HostileTextIsDrawnWithinBounds) {
    const auto map = find_color_map("magma");
    ASSERT_TRUE(map);
    for (const auto& text : hostile_strings()) {
        const auto picture = draw_legend(*map, {0, 1, text, {text, text + "\t" + text}, true, false, true}, 300);
        ASSERT_TRUE(picture) << picture.error().message;
        expect_clear_border(*picture, 5);
        // 64 characters of at most 1.2 em (bold W is 1.1), two margins.
        EXPECT_LT(picture->width, 64 * 1.2 * 11 + 40);
    }
}

TEST(LegendPicture, RefusesWhatCannotBeRead) {
    const auto map = find_color_map("magma");
    ASSERT_TRUE(map);
    for (const auto& [low, high] : {std::pair{0.0, 0.0}, {2.0, 1.0}, {nan, 1.0}, {0.0, infinity}}) {
        const auto picture = draw_legend(*map, {low, high, "x", {}, false, false, false}, 512);
        ASSERT_FALSE(picture);
        EXPECT_EQ(picture.error().kind, ErrorKind::usage);
    }
    for (const int height : {191, 0, -5, std::numeric_limits<int>::min()})
        EXPECT_FALSE(draw_legend(*map, {0, 1, "x", {}, false, false, false}, height));
    const auto tall = draw_legend(*map, {0, 1, "x", {}, false, false, false}, 40001);
    ASSERT_TRUE(tall) << tall.error().message;
    EXPECT_EQ(tall->height, 40001);
}

/// The golden picture of that name; with SPECTEX_WRITE_GOLDEN set to a folder, the picture is written there first.
void expect_golden(const Picture& picture, const std::string& name) {
    std::string folder = std::string(SPECTEX_TEST_DATA) + "/../../golden/";
    if (const char* write = std::getenv("SPECTEX_WRITE_GOLDEN")) {
        const std::string path = std::string(write) + "/" + name;
        auto out = OIIO::ImageOutput::create(path);
        OIIO::ImageSpec spec(picture.width, picture.height, 3, OIIO::TypeDesc::UINT8);
        ASSERT_TRUE(out && out->open(path, spec) && out->write_image(OIIO::TypeDesc::UINT8, picture.rgb.data()) && out->close());
    }
    auto in = OIIO::ImageInput::open(folder + name);
    ASSERT_TRUE(in) << folder + name;
    ASSERT_EQ(in->spec().width, picture.width);
    ASSERT_EQ(in->spec().height, picture.height);
    ASSERT_EQ(in->spec().nchannels, 3);
    std::vector<std::uint8_t> golden(picture.rgb.size());
    ASSERT_TRUE(in->read_image(0, 0, 0, 3, OIIO::TypeDesc::UINT8, golden.data()));
    double squares = 0;
    std::size_t differing = 0;
    for (std::size_t i = 0; i < golden.size(); ++i) {
        const int d = std::abs(int{golden[i]} - int{picture.rgb[i]});
        squares += d * d;
        if (d > 16) ++differing;
    }
    // Another FreeType or Cairo rasterises edges a few codes differently. One changed digit at 11 px moves the RMS of the
    // small picture by about 2 and 0.1 % of the samples.
    EXPECT_LT(std::sqrt(squares / static_cast<double>(golden.size())), 1.0) << name;
    EXPECT_LT(static_cast<double>(differing), 5e-4 * static_cast<double>(golden.size())) << name;
}

TEST(LegendPicture, Golden) {
    const auto magma = find_color_map("magma"), viridis = find_color_map("viridis");
    ASSERT_TRUE(magma && viridis);
    const auto large = draw_legend(*magma, {0, 35, "CIE76 ΔE*ab", {"mean\t0.0213", "p99\t0.104", "max\t0.318"}, false, true, true}, 512);
    ASSERT_TRUE(large);
    expect_golden(*large, "legend_magma_512.png");
    const auto small = draw_legend(*viridis, {-2e-5, 2e-5, "CIEDE2000 ΔE*₀₀", {"n = 16 777 216"}, true, true, false}, 192);
    ASSERT_TRUE(small);
    expect_golden(*small, "legend_viridis_192.png");
}

/// What a strict XML parser sees in a plot: texts, and every number of coordinates.
struct Document {
    bool well_formed = false;
    std::string title, all_text;
    std::string inside;  ///< innermost element, until it or a child ends
    std::string group;   ///< last group with a name
    std::vector<std::array<double, 2>> curve_points;
    std::size_t circles = 0;
    std::vector<double> numbers;
    std::vector<std::string> elements;
    std::array<double, 4> strip{};  ///< x, y, width, height
};

std::vector<double> numbers_in(std::string_view text) {
    std::vector<double> all;
    const char* p = text.data();
    const char* end = p + text.size();
    while (p < end) {
        double value = 0;
        const auto [next, error] = std::from_chars(p, end, value);
        if (error == std::errc()) {
            all.push_back(value);
            p = next;
        } else {
            ++p;
        }
    }
    return all;
}

Document parse(const std::string& svg) {
    Document document;
    XML_Parser parser = XML_ParserCreate(nullptr);
    XML_SetUserData(parser, &document);
    XML_SetElementHandler(
        parser,
        [](void* data, const XML_Char* name, const XML_Char** attributes) {
            auto& d = *static_cast<Document*>(data);
            d.elements.emplace_back(name);
            d.inside = name;
            std::string id;
            for (auto a = attributes; *a != nullptr; a += 2)
                if (std::string_view(a[0]) == "id") id = a[1];
            if (d.elements.back() == "g" && !id.empty()) d.group = id;
            for (auto a = attributes; *a != nullptr; a += 2) {
                const std::string_view key = a[0], value = a[1];
                for (const auto* geometry : {"x", "y", "cx", "cy", "r", "d", "width", "height", "font-size", "viewBox", "dy",
                                             "transform", "offset", "stroke-width"})
                    if (key == geometry)
                        for (const double n : numbers_in(value)) d.numbers.push_back(n);
                if (key == "d" && d.group == "curves") {
                    const auto n = numbers_in(value);
                    for (std::size_t i = 0; i + 1 < n.size(); i += 2) d.curve_points.push_back({n[i], n[i + 1]});
                }
                if (id == "spectrum") {
                    const std::array<std::string_view, 4> keys{"x", "y", "width", "height"};
                    for (std::size_t k = 0; k < 4; ++k)
                        if (key == keys[k]) d.strip[k] = numbers_in(value)[0];
                }
            }
            if (d.elements.back() == "circle" && d.group == "curves") ++d.circles;
        },
        [](void* data, const XML_Char*) { static_cast<Document*>(data)->inside.clear(); });
    XML_SetCharacterDataHandler(parser, [](void* data, const XML_Char* text, int length) {
        auto& d = *static_cast<Document*>(data);
        d.all_text.append(text, static_cast<std::size_t>(length));
        if (d.inside == "title") d.title.append(text, static_cast<std::size_t>(length));
    });
    document.well_formed = XML_Parse(parser, svg.data(), static_cast<int>(svg.size()), 1) == XML_STATUS_OK;
    if (!document.well_formed) ADD_FAILURE() << XML_ErrorString(XML_GetErrorCode(parser));
    XML_ParserFree(parser);
    return document;
}

Curve curve(std::size_t n, double low, double high, unsigned seed) {
    Curve c;
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> value(low, high);
    for (std::size_t i = 0; i < n; ++i) {
        c.wavelengths_nm.push_back(380 + 400 * static_cast<double>(i) / static_cast<double>(std::max<std::size_t>(n, 2) - 1));
        c.values.push_back(value(random));
    }
    return c;
}

void expect_sound(const Document& d) {
    ASSERT_TRUE(d.well_formed);
    for (const double n : d.numbers) ASSERT_TRUE(std::isfinite(n) && std::abs(n) < 1e5) << n;
    // Coordinates are written to 0.01; a thousandth of the 380 px high plot may be overshot without a longer axis.
    for (const auto& p : d.curve_points) {
        ASSERT_GE(p[0], d.strip[0] - 0.011);
        ASSERT_LE(p[0], d.strip[0] + d.strip[2] + 0.011);
        ASSERT_LE(p[1], d.strip[1] + 0.391) << "below the axis";
        ASSERT_GE(p[1], d.strip[1] - 380 - 0.391) << "above the plot";
    }
}

TEST(SpectrumPlot, WellFormedAndInsideTheAxes) {
    for (const std::size_t n : {1u, 2u, 3u, 7u, 36u, 81u, 120u, 121u, 401u})
        for (const auto& [low, high] : {std::pair{0.0, 1.0}, {0.2, 0.4}, {0.0, 0.0}, {-0.3, 1.4}, {0.0, 130.0}, {1e-9, 2e-9},
                                        {-5.0, -4.0}, {1e8, 1e9}, {-1e299, 1e299}, {0.0, 1e-300}, {-1e-5, 1.0 + 1e-5}}) {
            auto c = curve(n, low, high, static_cast<unsigned>(n));
            c.label = "measured";
            c.markers = true;
            const auto svg = plot_spectra_svg({&c, 1}, "A title", "Reflectance");
            ASSERT_TRUE(svg) << svg.error().message;
            const auto d = parse(*svg);
            expect_sound(d);
            EXPECT_EQ(d.curve_points.size(), n);
            EXPECT_EQ(d.circles, n <= 120 ? (n == 1 ? 1 : n) : 0) << n;
            EXPECT_NE(d.all_text.find("nm"), std::string::npos);
            EXPECT_NE(d.all_text.find("measured"), std::string::npos);
        }
}

TEST(SpectrumPlot, PlacesValuesLinearlyOnTheUnitAxis) {
    Curve c;
    c.wavelengths_nm = {400, 500, 700};
    c.values = {0, 0.25, 1};
    const auto svg = plot_spectra_svg({&c, 1}, "", "");
    ASSERT_TRUE(svg);
    const auto d = parse(*svg);
    ASSERT_EQ(d.curve_points.size(), 3u);
    const auto& strip = d.strip;
    // Coordinates are written to 0.01.
    EXPECT_NEAR(d.curve_points[0][1], strip[1], 0.011);
    EXPECT_NEAR(d.curve_points[1][1], strip[1] - 95, 0.011);
    EXPECT_NEAR(d.curve_points[2][1], strip[1] - 380, 0.011);
    EXPECT_NEAR(d.curve_points[1][0], strip[0] + strip[2] / 3, 0.02);
    EXPECT_EQ(d.title, "");
}

TEST(SpectrumPlot, StripHasTheColoursOfTheSpectrum) {
    Curve c;
    c.wavelengths_nm = {400, 700};
    c.values = {0, 1};
    const auto svg = plot_spectra_svg({&c, 1}, "", "");
    ASSERT_TRUE(svg);
    const auto color_near = [&](double nm) {
        const int stop = static_cast<int>(std::lround((nm - 400) / 300 * 96));
        std::size_t at = 0;
        for (int i = 0; i <= stop; ++i) at = svg->find("stop-color=\"#", at + 1);
        const unsigned long code = std::stoul(svg->substr(at + 13, 6), nullptr, 16);
        return std::array<int, 3>{static_cast<int>(code >> 16), static_cast<int>(code >> 8 & 255), static_cast<int>(code & 255)};
    };
    // Hue names of spectral lights: blue, green and red lead at 460, 530 and 640 nm; sodium's 589 nm has red over green
    // and no blue; the ends fade.
    const auto blue = color_near(460), green = color_near(530), red = color_near(640), sodium = color_near(589);
    EXPECT_TRUE(blue[2] > blue[0] && blue[2] > blue[1]);
    EXPECT_TRUE(green[1] > green[0] && green[1] > green[2]);
    EXPECT_TRUE(red[0] > red[1] && red[0] > red[2]);
    EXPECT_TRUE(sodium[0] > sodium[1] && sodium[1] > 60 && sodium[2] < 60);
    EXPECT_LT(color_near(700)[0], red[0] / 2);
}

TEST(SpectrumPlot, GapsAtValuesThatAreNotFinite) {
    Curve c;
    c.wavelengths_nm = {400, 450, 500, 550, 600, 650, 700};
    c.values = {0.1, 0.2, nan, 0.4, infinity, 0.6, 0.7};
    const auto svg = plot_spectra_svg({&c, 1}, "", "");
    ASSERT_TRUE(svg);
    const auto d = parse(*svg);
    expect_sound(d);
    EXPECT_EQ(d.curve_points.size(), 5u);
    EXPECT_EQ(d.circles, 1u) << "the lone value at 550 nm shows as a dot";
    for (auto& v : c.values) v = nan;
    const auto none = plot_spectra_svg({&c, 1}, "", "");
    ASSERT_TRUE(none);
    expect_sound(parse(*none));
}

TEST(SpectrumPlot, HostileText) {
    for (const auto& text : hostile_strings()) {
        std::vector<Curve> curves{curve(3, 0, 1, 1), curve(5, 0, 1, 2), curve(9, 0, 1, 3)};
        for (auto& c : curves) c.label = text;
        const auto svg = plot_spectra_svg(curves, text, text);
        ASSERT_TRUE(svg);
        const auto d = parse(*svg);
        expect_sound(d);
        EXPECT_LT(svg->size(), 60000u);
        EXPECT_EQ(std::count(d.elements.begin(), d.elements.end(), "script"), 0);
        EXPECT_EQ(d.title, heatmap::elide(heatmap::clean_utf8(text), 1000));
    }
}

TEST(SpectrumPlot, RefusesBadCurves) {
    const auto refused = [](const std::vector<Curve>& curves) {
        const auto svg = plot_spectra_svg(curves, "", "");
        return !svg && svg.error().kind == ErrorKind::usage && !svg.error().message.empty();
    };
    EXPECT_TRUE(refused({}));
    EXPECT_TRUE(refused({Curve{}}));
    auto bad = curve(3, 0, 1, 1);
    bad.values.pop_back();
    EXPECT_TRUE(refused({bad}));
    for (const double l : {380.0, 300.0, nan, infinity}) {
        bad = curve(3, 0, 1, 1);
        bad.wavelengths_nm[1] = l;
        EXPECT_TRUE(refused({curve(3, 0, 1, 1), bad})) << l;
    }
    bad = curve(3, 0, 1, 1);
    bad.wavelengths_nm.back() = infinity;
    EXPECT_TRUE(refused({bad})) << "ascending, but no axis reaches it";
    bad = curve(3, 0, 1, 1);
    bad.values[1] = 1e301;
    EXPECT_TRUE(refused({bad}));
}

TEST(CurveColors, DifferAndStayDarkEnoughForWhitePaper) {
    std::set<Rgb8> seen;
    for (std::size_t i = 0; i < 8; ++i) {
        const Rgb8 c = curve_color(i);
        seen.insert(c);
        const double y = 0.2126 * srgb_decode(c[0] / 255.0) + 0.7152 * srgb_decode(c[1] / 255.0) + 0.0722 * srgb_decode(c[2] / 255.0);
        // WCAG contrast against white; the yellow of the original set has 1.3.
        EXPECT_GT(1.05 / (y + 0.05), 2.0) << i;
        EXPECT_EQ(curve_color(i + 8), c);
    }
    EXPECT_EQ(seen.size(), 8u);
}

}  // namespace
TEST(Chart, KeepsEveryLabelOffTheOthers) {
    Chart chart{"time & error", "seconds", "difference", {{"one", {}, {0, 0, 0}, false}}, {{1e-3, 0.5}}, 1e-6};
    for (int i = 0; i < 12; ++i) chart.series[0].points.push_back({"point " + std::to_string(i), 1e-3 * (1 + 0.001 * i), 0.5});
    chart.series[0].points.push_back({"exact", 1, 0});
    const auto svg = draw_chart_svg(chart);
    ASSERT_TRUE(svg) << svg.error().message;
    for (int i = 0; i < 12; ++i) EXPECT_NE(svg->find(">point " + std::to_string(i) + "<"), std::string::npos);
    EXPECT_NE(svg->find("\u2264 10\u207b\u2076"), std::string::npos);
    EXPECT_NE(svg->find("time &amp; error"), std::string::npos);
    const auto picture = draw_chart(chart, 0.5);
    ASSERT_TRUE(picture) << picture.error().message;
    EXPECT_EQ(picture->width, 600);
    chart.least_y = 0;
    EXPECT_FALSE(draw_chart_svg(chart));  // zero has no logarithm
    chart.series[0].points.clear();
    EXPECT_FALSE(draw_chart_svg(chart));
}

}  // namespace spectex
