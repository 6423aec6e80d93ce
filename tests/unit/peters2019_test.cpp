#include "methods/peters2019.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <chrono>
#include <complex>
#include <cstring>
#include <nlohmann/json.hpp>
#include <numbers>

#include "kernels/arctangent.h"
#include "method_checks.h"
#include "reference.h"
#include "spectex/color.h"
#include "spectex/compare.h"

using namespace method_checks;
using namespace spectex::peters2019;
using Json = nlohmann::ordered_json;

namespace {

#ifdef SPECTEX_SLOW_BUILD
constexpr std::size_t many = 300;
#else
constexpr std::size_t many = 3000;
#endif
constexpr reference::Real pi = std::numbers::pi_v<reference::Real>;
using Complex = std::complex<reference::Real>;

/// (1/pi) int_0^pi g cos(j phi) dphi by the midpoint rule, which converges geometrically for what is even and periodic.
std::array<reference::Real, 3> integrated_moments(const Vector3& v, int nodes) {
    std::array<reference::Real, 3> m{};
    for (int k = 0; k < nodes; ++k) {
        const reference::Real phi = pi * (static_cast<reference::Real>(k) + 0.5L) / nodes, x = std::cos(phi);
        const reference::Real g = 0.5L + std::atan(v[0] + (v[1] + v[2] * x) * x) / pi;
        for (int j = 0; j < 3; ++j) m[static_cast<std::size_t>(j)] += g * std::cos(static_cast<reference::Real>(j) * phi) / nodes;
    }
    return m;
}

std::vector<Vector3> random_multipliers(std::size_t n) {
    std::mt19937_64 random(3);
    std::normal_distribution<double> normal(0, 1);
    std::vector<Vector3> out{{0, 0, 0}, {1, 0, 0}, {-2, 3, 0}, {-2, 0, 3}, {0, 1e-9, 0}, {0, 0, 1e-9}, {-40, 5, 1e-12}};
    for (std::size_t i = 0; i < n; ++i) {
        const double size = std::min(std::pow(10, normal(random)), 30.0);
        out.push_back({size * normal(random), size * normal(random), size * normal(random)});
    }
    return out;
}

TEST(Moments, FollowFromMultipliersAsTheIntegralsThatTheyAre) {
    for (const Vector3& v : random_multipliers(many / 30)) {
        const auto closed = moments_of(v);
        const auto summed = integrated_moments(v, 20000);
        // The steepest step is as wide as 1 / |P'|, some hundredth of pi or 200 nodes, beyond which the sum gains digits fast.
        for (std::size_t j = 0; j < 3; ++j) ASSERT_NEAR(closed[j], static_cast<double>(summed[j]), 2e-14) << v[0] << " " << v[1] << " " << v[2];
    }
}

TEST(Moments, GiveTheSpectrumOfAnExplicitToeplitzSolve) {
    for (const Vector3& v : random_multipliers(many / 10)) {
        auto m = moments_of(v);
        if (m[0] > 0.5) continue;
        // Exponential moments of the paper's section 4, and T q = e0 by Gauss, all in long double.
        const Complex i(0, 1), half = std::exp(i * pi * (static_cast<reference::Real>(m[0]) - 0.5L)) / (2 * pi);
        std::array<Complex, 3> gamma{2 * half.real()};
        for (std::size_t l = 1; l < 3; ++l) {
            Complex sum = static_cast<reference::Real>(l) * half * static_cast<reference::Real>(m[l]);
            for (std::size_t j = 1; j < l; ++j) sum += static_cast<reference::Real>(l - j) * gamma[j] * static_cast<reference::Real>(m[l - j]);
            gamma[l] = 2.0L * pi * i / static_cast<reference::Real>(l) * sum;
        }
        std::array<std::array<Complex, 4>, 3> t;
        for (std::size_t r = 0; r < 3; ++r) {
            for (std::size_t c = 0; c < 3; ++c) t[r][c] = r >= c ? gamma[r - c] : std::conj(gamma[c - r]);
            t[r][3] = r == 0 ? 1 : 0;
        }
        for (std::size_t k = 0; k < 3; ++k)
            for (std::size_t r = 0; r < 3; ++r) {
                if (r == k) continue;
                const Complex factor = t[r][k] / t[k][k];
                for (std::size_t c = k; c < 4; ++c) t[r][c] -= factor * t[k][c];
            }
        std::array<Complex, 3> q;
        for (std::size_t k = 0; k < 3; ++k) q[k] = std::conj(t[k][3] / t[k][k]);
        const Vector3 back = multipliers_of(m);
        for (int k = 0; k <= 20; ++k) {
            const reference::Real phi = pi * k / 20, x = std::cos(phi);
            const Complex z = std::polar(1.0L, phi), inverse = std::conj(z);
            const Complex product = (q[0] + (q[1] + q[2] * z) * z) * (q[0] + (q[1] + q[2] * inverse) * inverse) / (q[0] * q[0]);
            const reference::Real expected = std::arg(std::polar(1.0L, pi * static_cast<reference::Real>(m[0])) * product) / pi;
            const double p = back[0] + (back[1] + back[2] * static_cast<double>(x)) * static_cast<double>(x);
            // Moments are doubles: near steps of height 1 and width 1 / |P'|, 1e-16 in a moment is some |P'| times that.
            const double size = std::abs(v[0]) + std::abs(v[1]) + std::abs(v[2]);
            ASSERT_NEAR(bounded(p), static_cast<double>(expected), 1e-14 * (1 + size * size)) << v[0] << " " << v[1] << " " << v[2];
            ASSERT_NEAR(bounded(p), bounded(v[0] + (v[1] + v[2] * static_cast<double>(x)) * static_cast<double>(x)), 1e-14 * (1 + size * size));
        }
    }
}

TEST(Moments, ThatNoFunctionHasGiveBoundedSpectraAllTheSame) {
    const Solver solver(colorimetry());
    const double nan = std::nan(""), inf = HUGE_VAL;
    std::vector<Vector3> list{{0.5, 1, 1}, {0.5, -1, 1}, {0.01, 0.3, 0}, {0.3, 0, -0.3}, {nan, nan, nan}, {inf, -inf, nan}, {0, 1, 1},
                              {1, 0.3, 0.3}, {1e-310, 1e-311, -1e-310}, {1e-7, 1, 1}, {0.5, 0.3183098861837907, 0}, {-1, 0, 0}, {1e300, 1e300, 0}};
    std::mt19937_64 random(8);
    std::uniform_real_distribution<double> uniform(0, 1), signed_third(-0.35, 0.35);
    for (std::size_t i = 0; i < many; ++i) list.push_back({uniform(random), signed_third(random), signed_third(random)});
    std::vector<double> r(81);
    for (const auto& m : list) {
        Solver::reflectances(Solver::of_moments(m), solver.phase_cosines(), r.data());
        for (const double v : r) ASSERT_TRUE(v >= 0 && v <= 1) << m[0] << " " << m[1] << " " << m[2] << ": " << v;
    }
}

/// Runs `check` on every instruction set that this machine and build have.
template <class Check>
void on_every_target(const Check& check) {
    const std::int64_t all = hwy::SupportedTargets();
    for (std::int64_t rest = all; rest != 0; rest &= rest - 1) {
        const std::int64_t target = rest & -rest;
        SCOPED_TRACE(hwy::TargetName(target));
        hwy::SetSupportedTargetsForTest(target);
        check();
    }
    hwy::SetSupportedTargetsForTest(0);
}

TEST(Arctangents, MatchLongDoubleOnEveryTargetByteForByte) {
    std::mt19937_64 random(9);
    std::uniform_real_distribution<double> exponent(-12, 14);
    std::vector<double> p{0.0, -0.0, 1, -1, std::numbers::sqrt2 - 1, std::numbers::sqrt2 + 1, 0x1p80, -0x1p80};
    for (std::size_t i = 0; i < many; ++i) p.push_back(std::pow(10, exponent(random)) * (i % 2 ? 1 : -1));
    std::vector<double> first;
    on_every_target([&] {
        std::vector<double> g(p.size());
        kernels::evaluate_arctangents({0, 1, 0}, p, g.data());
        for (std::size_t i = 0; i < p.size(); ++i) {
            const long double expected = std::atan2(1.0L, -static_cast<long double>(p[i])) / std::numbers::pi_v<long double>;
            // The quotient, the polynomial's last product and sum, the base and the share of pi round, by half a unit each.
            ASSERT_NEAR(static_cast<double>(g[i] / expected), 1, 4 * 0x1p-53) << p[i];
        }
        if (first.empty()) first = g;
        EXPECT_EQ(std::memcmp(first.data(), g.data(), g.size() * sizeof(double)), 0);
        double nothing = 0;
        kernels::evaluate_arctangents({std::nan(""), 0, 0}, std::vector<double>{1}, &nothing);
        EXPECT_TRUE(std::isnan(nothing));
    });
}

TEST(Peters2019, VectorsSolveWhatOneByOneSolvesInTheSameBytesForEveryTargetAndSplit) {
    const Solver solver(colorimetry());
    std::vector<double> list;
    for (const auto& rgb : colors(many)) list.insert(list.end(), rgb.begin(), rgb.end());
    const std::size_t n = list.size() / 3;
    std::vector<Solution> first;
    on_every_target([&] {
        std::vector<Solution> whole(n), parts(n);
        solver.solve(list, whole.data());
        for (std::size_t at = 0, step = 1; at < n; at += step, step = step % 37 + 1)
            solver.solve(std::span(list).subspan(3 * at, 3 * std::min(step, n - at)), parts.data() + at);
        if (first.empty()) first = whole;
        for (std::size_t i = 0; i < n; ++i) {
            ASSERT_EQ(whole[i].multipliers, first[i].multipliers) << i;
            ASSERT_EQ(parts[i].multipliers, first[i].multipliers) << i;
        }
    });
    std::vector<double> a(solver.phase_cosines().size()), b(a.size());
    for (std::size_t i = 0; i < n; ++i) {
        const auto one = solver.solve(Vector3{list[3 * i], list[3 * i + 1], list[3 * i + 2]});
        ASSERT_EQ(one.complement, first[i].complement);
        ASSERT_EQ(one.scale, first[i].scale);
        Solver::reflectances(one, solver.phase_cosines(), a.data());
        Solver::reflectances(first[i], solver.phase_cosines(), b.data());
        // Residuals of 1e-13 of the colour, and steep flanks, on which a band moves by some hundred times as much.
        for (std::size_t k = 0; k < a.size(); ++k) ASSERT_NEAR(a[k], b[k], 1e-9) << i;
    }
}

class Peters : public testing::TestWithParam<const char*> {};

TEST_P(Peters, IsExactInRangeAndContinuous) {
    const auto m = model("peters2019", colorimetry(GetParam()));
    ASSERT_TRUE(m);
    EXPECT_TRUE(m->info().exact);
    const auto list = colors(many);
    const auto start = std::chrono::steady_clock::now();
    const auto e = extremes(*m, list);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    printf("peters2019 %-12s %.3g Mpixel/s, residual %.3g\n", GetParam(), 1e-6 * static_cast<double>(list.size()) / seconds.count(), e.residual);
    EXPECT_TRUE(e.finite);
    EXPECT_GE(e.low, 0.0);
    EXPECT_LE(e.high, 1.0);
    // Newton stops at the rounding of a sum of products with sum |a| < 3, times the slope of g by P.
    EXPECT_LE(e.residual, 1e-13);
    for (const double v : spectrum(*m, {0, 0, 0})) EXPECT_EQ(v, 0.0);
    for (const double v : spectrum(*m, {1, 1, 1})) EXPECT_EQ(v, 1.0);
    for (const double v : spectrum(*m, {0.25, 0.25, 0.25})) EXPECT_NEAR(v, 0.25, 1e-15);
    // Near the solid's surface, where sRGB's blue lies, a band moves some hundred times as fast as the colour; on seven bands
    // the surface is nearer.
    EXPECT_LE(largest_change(*m, 1e-8, 200), 1e-5);
    // Below 2^-12 a scaled spectrum and the spectrum of scaled moments differ by some pi^2 g^2 / 3 of g. On seven bands dark
    // saturated colours have spikes between the bands, where g is not small.
    EXPECT_LE(coefficient_difference(*m, colors(many / 10)), m->colorimetry().bands().size() == 7 ? 5e-5 : 1e-8);
}

INSTANTIATE_TEST_SUITE_P(Peters2019, Peters, testing::Values("380:780:5", "380:780:20", "36", "433:646:35.5"));

TEST(Peters2019, DarkestColoursKeepTheirDigits) {
    const auto m = model("peters2019", colorimetry());
    ASSERT_TRUE(m);
    const auto& a = m->colorimetry().sensing_matrix();
    for (const double scale : {0x1p-11, 0x1p-12, 0x1p-13, 1e-12, 1e-100, 1e-300, 1e-308}) {
        const Vector3 rgb{0.9 * scale, 0.3 * scale, 0.1 * scale};
        const auto r = spectrum(*m, rgb);
        for (std::size_t c = 0; c < 3; ++c) {
            reference::Real sum = 0;
            for (std::size_t l = 0; l < r.size(); ++l) sum += static_cast<reference::Real>(a[c * r.size() + l]) * r[l];
            EXPECT_NEAR(static_cast<double>(sum / static_cast<reference::Real>(scale)), rgb[c] / scale, 1e-13) << scale;
        }
    }
    // Where scaling begins the spectrum does not jump: what is left out is some pi^2 g^2 / 3 of a g of some 1e-3, and the step made is 2e-9 of that again.
    const auto above = spectrum(*m, {0x1.0001p-12, 0x1p-14, 0x1p-15}), below = spectrum(*m, {0x0.ffffp-12, 0x1p-14, 0x1p-15});
    for (std::size_t l = 0; l < above.size(); ++l) EXPECT_NEAR(above[l], below[l], 3e-8);
    for (const double v : spectrum(*m, {4.9e-324, 0, 0})) EXPECT_TRUE(v >= 0 && v <= 1e-300);
}

TEST(Peters2019, ComplementsMirror) {
    const auto m = model("peters2019", colorimetry());
    ASSERT_TRUE(m);
    for (const auto& rgb : colors(100)) {
        const auto r = spectrum(*m, rgb), q = spectrum(*m, {1 - rgb[0], 1 - rgb[1], 1 - rgb[2]});
        for (std::size_t l = 0; l < r.size(); ++l) ASSERT_NEAR(r[l], 1 - q[l], 1e-9);
    }
}

double cie76(const Colorimetry& c, const Vector3& a, const Vector3& b) {
    const DifferenceKernel kernel(Metric::cie76, c.rgb_to_xyz(), c.rgb_to_xyz(), c.white_xyz());
    const std::array<const double*, 3> p{&a[0], &a[1], &a[2]}, q{&b[0], &b[1], &b[2]};
    double out = 0;
    kernel(p, q, 1, &out);
    return out;
}

int code(double linear) { return static_cast<int>(std::lround(255 * srgb_encode(std::clamp(linear, 0.0, 1.0)))); }

/// 4 x 4 codes as a BC1 block keeps them: two end colours of 5, 6 and 5 bits on the block's diagonal, two between.
void block_compressed(std::array<std::array<int, 3>, 16>& texels) {
    std::array<int, 3> low{255, 255, 255}, high{};
    for (const auto& t : texels)
        for (std::size_t c = 0; c < 3; ++c) low[c] = std::min(low[c], t[c]), high[c] = std::max(high[c], t[c]);
    std::array<double, 3> centre{}, slope{};
    for (const auto& t : texels)
        for (std::size_t c = 0; c < 3; ++c) centre[c] += t[c] / 16.0;
    for (const auto& t : texels)
        for (std::size_t c = 0; c < 3; ++c) slope[c] += (t[c] - centre[c]) * (t[1] - centre[1]);
    std::array<std::array<double, 3>, 4> palette{};
    for (std::size_t c = 0; c < 3; ++c) {
        if (slope[c] < 0) std::swap(low[c], high[c]);
        const int levels = c == 1 ? 63 : 31;
        const double a = std::round(low[c] * levels / 255.0) * 255 / levels, b = std::round(high[c] * levels / 255.0) * 255 / levels;
        for (std::size_t k = 0; k < 4; ++k) palette[k][c] = a + (b - a) * static_cast<double>(k) / 3;
    }
    for (auto& t : texels) {
        double least = HUGE_VAL;
        std::size_t best = 0;
        for (std::size_t k = 0; k < 4; ++k) {
            double d = 0;
            for (std::size_t c = 0; c < 3; ++c) d += (t[c] - palette[k][c]) * (t[c] - palette[k][c]);
            if (d < least) least = d, best = k;
        }
        for (std::size_t c = 0; c < 3; ++c) t[c] = static_cast<int>(std::lround(palette[best][c]));
    }
}

TEST(FourierSrgb, SurvivesEightBitsAndBlockCompressionAsSrgbDoes) {
    const auto c = colorimetry("380:780:10");
    const auto m = model("peters2019:fourier-srgb", c);
    ASSERT_TRUE(m);
    const auto back = [&](const std::array<int, 3>& codes) {
        const Vector3 kept{srgb_decode(codes[0] / 255.0), srgb_decode(codes[1] / 255.0), srgb_decode(codes[2] / 255.0)};
        std::vector<double> r(c.bands().size());
        m->reflectance_of_coefficients(kept, r);
        return c.rgb_of(r);
    };
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> uniform(0, 1);
    double eight = 0, eight_srgb = 0, worst = 0, block = 0, block_srgb = 0, near = 0, outside = 0;
    const std::size_t blocks = many / 20;
    for (std::size_t k = 0; k < blocks; ++k) {
        // A smooth piece of texture: a colour and its gradients in codes, as large as those of photographs.
        std::array<std::array<double, 3>, 3> plane;
        for (auto& p : plane[0]) p = 20 + 215 * uniform(random);
        for (std::size_t i = 1; i < 3; ++i)
            for (auto& p : plane[i]) p = 4 * (2 * uniform(random) - 1);
        std::array<std::array<int, 3>, 16> fourier, srgb;
        std::array<Vector3, 16> colour;
        for (std::size_t t = 0; t < 16; ++t) {
            Vector3 kept;
            for (std::size_t i = 0; i < 3; ++i)
                colour[t][i] = srgb_decode(std::clamp(plane[0][i] + plane[1][i] * static_cast<double>(t % 4) + plane[2][i] * static_cast<double>(t / 4), 0.0, 255.0) / 255);
            m->coefficients(colour[t], kept);
            for (std::size_t i = 0; i < 3; ++i) {
                outside = std::max({outside, -kept[i], kept[i] - 1});
                near += std::abs(srgb_encode(std::clamp(kept[i], 0.0, 1.0)) - srgb_encode(colour[t][i]));
                fourier[t][i] = code(kept[i]);
                srgb[t][i] = code(colour[t][i]);
            }
            const double d = cie76(c, colour[t], back(fourier[t]));
            eight += d;
            worst = std::max(worst, d);
            const auto decoded = [](const std::array<int, 3>& s) { return Vector3{srgb_decode(s[0] / 255.0), srgb_decode(s[1] / 255.0), srgb_decode(s[2] / 255.0)}; };
            eight_srgb += cie76(c, colour[t], decoded(srgb[t]));
        }
        block_compressed(fourier);
        block_compressed(srgb);
        for (std::size_t t = 0; t < 16; ++t) {
            const auto& s = srgb[t];
            block += cie76(c, colour[t], back(fourier[t]));
            block_srgb += cie76(c, colour[t], {srgb_decode(s[0] / 255.0), srgb_decode(s[1] / 255.0), srgb_decode(s[2] / 255.0)});
        }
    }
    const double n = 16.0 * static_cast<double>(blocks);
    printf("fourier-srgb: 8 bits mean CIE76 %.3g (sRGB %.3g) max %.3g; blocks %.3g (sRGB %.3g); differs from sRGB by %.3g on average\n", eight / n,
           eight_srgb / n, worst, block / n, block_srgb / n, near / n / 3);
    // What is kept lies in [0,1] but for what a grid of colours has missed.
    EXPECT_LE(outside, 1e-3);
    // A flatter map loses a little more than sRGB itself: twice is the promise of the authors' 'errors similar to sRGB'.
    EXPECT_LE(eight, 2 * eight_srgb);
    EXPECT_LE(block, 2 * block_srgb);
    EXPECT_GT(eight, eight_srgb / 4);
    EXPECT_LE(worst, 5);
    EXPECT_LE(near / n / 3, 0.08);
}

TEST(FourierSrgb, KeepsGreysAndTheSpectraOfTheMoments) {
    const auto c = colorimetry();
    const auto m = model("peters2019:fourier-srgb", c), plain = model("peters2019", c);
    ASSERT_TRUE(m && plain);
    EXPECT_EQ(m->coefficient_names(), (std::vector<std::string>{"R", "G", "B"}));
    for (const double v : {0.0, 1e-9, 0.001, 0.2, 0.7, 1.0}) {
        Vector3 kept;
        m->coefficients(Vector3{v, v, v}, kept);
        for (const double k : kept) EXPECT_NEAR(k, v, 1e-15);
    }
    for (const auto& rgb : colors(100)) EXPECT_EQ(spectrum(*m, rgb), spectrum(*plain, rgb));
    EXPECT_LE(coefficient_difference(*m, colors(many / 10)), 1e-8);
}

TEST(Peters2019, JsonAndWhatHasNoSpectrum) {
    expect_round_trip(*model("peters2019", colorimetry("380:780:10")));
    const auto m = model("peters2019:fourier-srgb", colorimetry("380:780:20"));
    expect_round_trip(*m);
    const Json good = Json::parse(m->to_json());
    for (const Json& wrong : {Json(), Json(1), Json({1, 2, 3}), Json({1, 2, 3, 4, 5, 1e9}), Json({1, 1, 1, 1, 1, 1})}) {
        Json json = good;
        json["fourier"] = wrong;
        const auto read = make_model_from_json(json.dump());
        ASSERT_FALSE(read);
        EXPECT_EQ(read.error().kind, ErrorKind::input);
        EXPECT_NE(read.error().message.find("fourier"), std::string::npos) << read.error().message;
    }
    const auto wide = make_model("peters2019", colorimetry("380:780:5", {"cie1931", "", "ProPhoto", RgbMatrix::integrated}));
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().kind, ErrorKind::infeasible);
}

}  // namespace
