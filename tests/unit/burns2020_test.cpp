#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <chrono>

#include "method_checks.h"
#include "reference.h"

using namespace method_checks;

namespace {

class Burns : public testing::TestWithParam<const char*> {};

TEST_P(Burns, IsExactInRangeAndSmooth) {
    const auto m = model("burns2020", colorimetry(GetParam()));
    ASSERT_TRUE(m);
    const auto list = colors(2000);
    const auto start = std::chrono::steady_clock::now();
    const auto e = extremes(*m, list);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    printf("burns2020 %-12s %.3g Mpixel/s, residual %.3g\n", GetParam(), 1e-6 * static_cast<double>(list.size()) / seconds.count(), e.residual);
    EXPECT_TRUE(e.finite);
    EXPECT_GE(e.low, 0.0);
    EXPECT_LE(e.high, 1.0);
    // Newton stops at the rounding of a sum of products with sum |a| < 3; bright colours are complements, and 1 - r is rounded.
    EXPECT_LE(e.residual, 1e-13);
    for (const double v : spectrum(*m, {0, 0, 0})) EXPECT_EQ(v, 0.0);
    for (const double v : spectrum(*m, {1, 1, 1})) EXPECT_EQ(v, 1.0);
    for (const double v : spectrum(*m, {0.5, 0.5, 0.5})) EXPECT_EQ(v, 0.5);
    // sRGB's steepest colours lie within 0.016 of the solid's surface, where a band moves some 30 times as fast as the colour.
    EXPECT_LE(largest_change(*m, 1e-7, 300), 1e-5);
}

TEST_P(Burns, HasTheLeastSlopeInTheTanhDomain) {
    const auto c = colorimetry(GetParam());
    const auto m = model("burns2020", c);
    ASSERT_TRUE(m);
    const std::size_t n = c.bands().size();
    const auto& a = c.sensing_matrix();
    // At the optimum the gradient of the slopes is a combination of the three constraints' gradients: fit them by least
    // squares in long double and look at what is left.
    for (const Vector3& rgb : {Vector3{0.2, 0.5, 0.3}, {0.9, 0.1, 0.1}, {0.05, 0.1, 0.6}, {0.6, 0.7, 0.9}, {0.01, 0.002, 0.03}}) {
        const auto r = spectrum(*m, rgb);
        std::vector<reference::Real> z(n), g(n);
        for (std::size_t l = 0; l < n; ++l) z[l] = std::atanh(2 * static_cast<reference::Real>(r[l]) - 1);
        reference::Real size = 0, left = 0;
        reference::Mat3 normal{};
        reference::Vec3 right{};
        const auto gradient = [&](std::size_t i, std::size_t l) { return a[i * n + l] * 2 * static_cast<reference::Real>(r[l]) * (1 - r[l]); };
        for (std::size_t l = 0; l < n; ++l) {
            g[l] = (l > 0 ? z[l] - z[l - 1] : 0) - (l + 1 < n ? z[l + 1] - z[l] : 0);
            size = std::max(size, std::fabs(g[l]));
            for (std::size_t i = 0; i < 3; ++i) {
                right[i] += gradient(i, l) * g[l];
                for (std::size_t j = 0; j < 3; ++j) normal[i][j] += gradient(i, l) * gradient(j, l);
            }
        }
        const auto y = reference::solve(normal, right);
        for (std::size_t l = 0; l < n; ++l)
            left = std::max(left, std::fabs(g[l] - y[0] * gradient(0, l) - y[1] * gradient(1, l) - y[2] * gradient(2, l)));
        // Newton ends with steps below 1e-9, and z comes back from rounded r.
        EXPECT_LE(left, 1e-6 * size) << rgb[0] << " " << rgb[1] << " " << rgb[2];
    }
}

INSTANTIATE_TEST_SUITE_P(Burns2020, Burns, testing::Values("380:780:5", "380:780:10", "380:780:20", "36", "433:646:35.5"));

TEST(Burns2020, GivesTheSameBytesOnEveryTargetAndForEverySplit) {
    const auto c = colorimetry("380:780:10");
    std::vector<double> rgb;
    for (const auto& v : colors(300)) rgb.insert(rgb.end(), v.begin(), v.end());
    const std::size_t n = rgb.size() / 3, bands = c.bands().size();
    std::vector<double> first;
    const std::int64_t all = hwy::SupportedTargets();
    for (std::int64_t rest = all; rest != 0; rest &= rest - 1) {
        const std::int64_t target = rest & -rest;
        SCOPED_TRACE(hwy::TargetName(target));
        hwy::SetSupportedTargetsForTest(target);
        const auto m = model("burns2020", c);
        ASSERT_TRUE(m);
        std::vector<double> whole(n * bands), parts(whole.size());
        m->reflectance(rgb, whole);
        for (std::size_t at = 0, step = 1; at < n; at += step, step = step % 37 + 1) {
            const std::size_t count = std::min(step, n - at);
            m->reflectance(std::span(rgb).subspan(3 * at, 3 * count), std::span(parts).subspan(at * bands, count * bands));
        }
        if (first.empty()) first = whole;
        EXPECT_EQ(whole, first);
        EXPECT_EQ(parts, first);
    }
    hwy::SetSupportedTargetsForTest(0);
}

TEST(Burns2020, ComplementsMirror) {
    const auto m = model("burns2020", colorimetry());
    ASSERT_TRUE(m);
    for (const auto& rgb : colors(100)) {
        const auto r = spectrum(*m, rgb), q = spectrum(*m, {1 - rgb[0], 1 - rgb[1], 1 - rgb[2]});
        for (std::size_t l = 0; l < r.size(); ++l) ASSERT_NEAR(r[l], 1 - q[l], 1e-8);
    }
}

TEST(Burns2020, JsonAndWhatHasNoSpectrum) {
    const auto m = model("burns2020", colorimetry("380:780:10"));
    ASSERT_TRUE(m);
    expect_round_trip(*m);
    EXPECT_EQ(coefficient_difference(*m, colors(20)), 0.0);
    const auto wide = make_model("burns2020", colorimetry("380:780:5", {"cie1931", "", "ProPhoto", RgbMatrix::integrated}));
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().kind, ErrorKind::infeasible);
}

}  // namespace
