#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "method_checks.h"

using namespace method_checks;

namespace {

class Macadam : public testing::TestWithParam<const char*> {};

TEST_P(Macadam, IsExactInRangeAndABox) {
    const auto m = model("macadam1935", colorimetry(GetParam()));
    ASSERT_TRUE(m);
    EXPECT_EQ(m->info().pieces, Pieces::nonlinear);
    const auto list = colors(20000);
    const auto e = extremes(*m, list);
    EXPECT_TRUE(e.finite);
    EXPECT_GE(e.low, 0.0);
    EXPECT_LE(e.high, 1.0);
    // Cramer's rule on facets between neighbouring hues loses digits to their small angle, and an edge may lie 1e-9 outside
    // its band, whose column is at most 1; colours 1e-13 from grey are taken for grey.
    EXPECT_LE(e.residual, 2e-9);
    for (const double v : spectrum(*m, {0, 0, 0})) EXPECT_EQ(v, 0.0);
    for (const double v : spectrum(*m, {1, 1, 1})) EXPECT_EQ(v, 1.0);
    for (const double v : spectrum(*m, {0.25, 0.25, 0.25})) EXPECT_EQ(v, 0.25);
    // Two values but for the bands of the edges: at most two distinct ones between 0 and s, and at most two runs of s.
    for (std::size_t k = 0; k < list.size(); k += 7) {
        const auto r = spectrum(*m, list[k]);
        const double s = *std::max_element(r.begin(), r.end());
        if (s == 0) continue;
        std::vector<double> edges;
        int rises = 0;
        for (std::size_t l = 0; l < r.size(); ++l) {
            const bool partial = r[l] > 1e-8 * s && r[l] < (1 - 1e-8) * s;
            if (partial && (edges.empty() || std::abs(edges.back() - r[l]) > 1e-12 * s)) edges.push_back(r[l]);
            const auto full = [&](std::size_t at) { return r[at] >= (1 - 1e-8) * s; };
            rises += full(l) && (l == 0 || !full(l - 1));
        }
        ASSERT_LE(edges.size(), 2u) << list[k][0] << " " << list[k][1] << " " << list[k][2];
        ASSERT_LE(rises, 2);
    }
}

TEST_P(Macadam, ScalesWithItsColourAndIsContinuous) {
    const auto m = model("macadam1935", colorimetry(GetParam()));
    ASSERT_TRUE(m);
    for (const auto& rgb : colors(300)) {
        const auto full = spectrum(*m, rgb), half = spectrum(*m, {rgb[0] / 2, rgb[1] / 2, rgb[2] / 2});
        for (std::size_t l = 0; l < full.size(); ++l) ASSERT_NEAR(half[l], full[l] / 2, 1e-9);
    }
    // An edge crosses a band as fast as the band is faint: those of 1e-3 of the luminance move by less than 1e3 times the
    // step times the condition of their hues, 20 on the finest grid.
    EXPECT_LE(largest_change(*m, 1e-8, 2000, 1e-3), 2e-4);
}

TEST_P(Macadam, CoefficientsAreTheSpectrum) {
    const auto m = model("macadam1935", colorimetry(GetParam()));
    ASSERT_TRUE(m);
    // The edges are divided by the number of bands and multiplied again.
    EXPECT_LE(coefficient_difference(*m, colors(2000)), 1e-12);
    std::vector<double> out(m->colorimetry().bands().size());
    for (const double hostile : {std::nan(""), -1.0, 2.0, HUGE_VAL}) {
        m->reflectance_of_coefficients(std::vector<double>{hostile, hostile, hostile}, out);
        for (const double v : out) EXPECT_TRUE(v >= 0 && v <= 1);
        m->reflectance_of_coefficients(std::vector<double>{0.2, hostile, 0.5}, out);
        for (const double v : out) EXPECT_TRUE(v >= 0 && v <= 1);
    }
}

TEST_P(Macadam, NoSpectrumOfThatColourHasALowerTop) {
    // The gauge of the object-colour solid, by its support function: for any normal v, max over r in [0,1] of v . A r is the
    // sum of the positive parts, so s >= v . rgb / that sum. Normals of the colour's own facet reach s.
    const auto m = model("macadam1935", colorimetry(GetParam()));
    ASSERT_TRUE(m);
    const std::size_t n = m->colorimetry().bands().size();
    const auto& a = m->colorimetry().sensing_matrix();
    std::mt19937_64 random(5);
    std::normal_distribution<double> normal;
    for (const auto& rgb : colors(50)) {
        const auto r = spectrum(*m, rgb);
        const double s = *std::max_element(r.begin(), r.end());
        for (int trial = 0; trial < 200; ++trial) {
            const Vector3 v{normal(random), normal(random), normal(random)};
            double support = 0;
            for (std::size_t l = 0; l < n; ++l) support += std::max(0.0, v[0] * a[l] + v[1] * a[n + l] + v[2] * a[2 * n + l]);
            ASSERT_GE(s * support, (v[0] * rgb[0] + v[1] * rgb[1] + v[2] * rgb[2]) - 1e-9);
        }
    }
}

INSTANTIATE_TEST_SUITE_P(Macadam1935, Macadam, testing::Values("380:780:1", "380:780:5", "380:780:10", "380:780:20", "36", "433:646:35.5"));

TEST(Macadam1935, JsonAndWhatHasNoBoxes) {
    const auto m = model("macadam1935", colorimetry("380:780:10"));
    ASSERT_TRUE(m);
    expect_round_trip(*m);
    const auto wide = make_model("macadam1935", colorimetry("380:780:5", {"cie1931", "", "ProPhoto", RgbMatrix::integrated}));
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().kind, ErrorKind::infeasible);
    auto json = nlohmann::ordered_json::parse(m->to_json());
    json["rgb_space"] = "ProPhoto";
    json["illuminant"] = {{"name", "D50"}};
    const auto read = make_model_from_json(json.dump());
    ASSERT_FALSE(read);
    EXPECT_EQ(read.error().kind, ErrorKind::input);
}

}  // namespace
