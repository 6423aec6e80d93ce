// Colour differences against published pairs, against second formulations in long double, and by their properties.
#include <gtest/gtest.h>
#include <hwy/highway.h>
#include <hwy/targets.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <numbers>
#include <random>
#include <sstream>
#include <vector>

#include <unistd.h>

#include "compare/spaces.h"
#include "spectex/compare.h"

namespace {

using namespace spectex;

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr Vector3 d65{0.95047, 1, 1.08883};
// BT.709 to XYZ under D65, to the digits that IEC 61966-2-1 prints: only an example matrix here.
constexpr Matrix3 bt709{{0.4124, 0.3576, 0.1805, 0.2126, 0.7152, 0.0722, 0.0193, 0.1192, 0.9505}};

using Formula = double (*)(const Vector3&, const Vector3&);
constexpr std::pair<const char*, Formula> formulas[] = {
    {"cie76", delta_e76}, {"cie94", delta_e94}, {"ciede2000", delta_e2000}, {"cmc", delta_cmc}, {"din99", delta_e_din99}};

struct Pair {
    Vector3 lab1, lab2;
    double published;
};

std::vector<Pair> sharma_pairs() {
    std::ifstream file(std::string(SPECTEX_TEST_DATA) + "/ciede2000_sharma2005.csv");
    std::string line;
    std::getline(file, line);
    std::vector<Pair> pairs;
    while (std::getline(file, line)) {
        std::ranges::replace(line, ',', ' ');
        std::istringstream in(line);
        int number = 0;
        Pair p{};
        in >> number >> p.lab1[0] >> p.lab1[1] >> p.lab1[2] >> p.lab2[0] >> p.lab2[1] >> p.lab2[2] >> p.published;
        if (in) pairs.push_back(p);
    }
    return pairs;
}

std::vector<Pair> random_pairs(std::size_t n, unsigned seed) {
    std::mt19937 engine(seed);
    std::uniform_real_distribution<double> lightness(3, 100), chroma(-110, 110), near(-3, 3);
    std::vector<Pair> pairs(n);
    for (std::size_t i = 0; i < n; ++i) {
        Pair& p = pairs[i];
        p.lab1 = {lightness(engine), chroma(engine), chroma(engine)};
        p.lab2 = {lightness(engine), chroma(engine), chroma(engine)};
        if (i % 2) p.lab2 = {p.lab1[0] + near(engine), p.lab1[1] + near(engine), p.lab1[2] + near(engine)};
    }
    return pairs;
}

// Second formulations, through hue angles and in long double, of what the library computes from components.
using Real = long double;
constexpr Real degree = std::numbers::pi_v<long double> / 180;
struct Polar {
    Real l, c, h;  // h in degrees, [0, 360)
};
Polar polar(Real l, Real a, Real b) {
    Real h = a == 0 && b == 0 ? 0 : std::atan2(b, a) / degree;
    if (h < 0) h += 360;
    return {l, std::hypot(a, b), h};
}
Real metric_hue(const Polar& p, const Polar& q) {
    return 2 * std::sqrt(p.c * q.c) * std::sin((q.h - p.h) / 2 * degree);
}
Real second_cie94(const Vector3& x, const Vector3& y) {
    const Polar p = polar(x[0], x[1], x[2]), q = polar(y[0], y[1], y[2]);
    return std::hypot(q.l - p.l, (q.c - p.c) / (1 + 0.045L * p.c), metric_hue(p, q) / (1 + 0.015L * p.c));
}
Real second_cmc(const Vector3& x, const Vector3& y) {
    const Polar p = polar(x[0], x[1], x[2]), q = polar(y[0], y[1], y[2]);
    const Real f = p.c * p.c / std::sqrt(std::pow(p.c, 4) + 1900);
    const Real t = p.h >= 164 && p.h <= 345 ? 0.56L + std::fabs(0.2L * std::cos((p.h + 168) * degree))
                                            : 0.36L + std::fabs(0.4L * std::cos((p.h + 35) * degree));
    const Real sl = p.l < 16 ? 0.511L : 0.040975L * p.l / (1 + 0.01765L * p.l);
    const Real sc = 0.0638L * p.c / (1 + 0.0131L * p.c) + 0.638L;
    const Real sh = (f * t + 1 - f) * sc;
    return std::hypot((q.l - p.l) / (2 * sl), (q.c - p.c) / sc, metric_hue(p, q) / sh);
}
Real second_ciede2000(const Vector3& x, const Vector3& y) {
    const Real c7 = std::pow((std::hypot<Real>(x[1], x[2]) + std::hypot<Real>(y[1], y[2])) / 2, 7);
    const Real stretch = 1.5L - 0.5L * std::sqrt(c7 / (c7 + std::pow(25.0L, 7)));
    const Polar p = polar(x[0], stretch * x[1], x[2]), q = polar(y[0], stretch * y[1], y[2]);
    const bool neutral = p.c * q.c == 0;
    Real dh = neutral ? 0 : q.h - p.h;
    Real mean = neutral ? p.h + q.h : (p.h + q.h) / 2;
    if (dh > 180) dh -= 360, mean += mean < 180 ? 180 : -180;
    else if (dh < -180) dh += 360, mean += mean < 180 ? 180 : -180;
    const Real l = (p.l + q.l) / 2, c = (p.c + q.c) / 2;
    const Real t = 1 - 0.17L * std::cos((mean - 30) * degree) + 0.24L * std::cos(2 * mean * degree) +
                   0.32L * std::cos((3 * mean + 6) * degree) - 0.2L * std::cos((4 * mean - 63) * degree);
    const Real m7 = std::pow(c, 7);
    const Real rotation = -2 * std::sqrt(m7 / (m7 + std::pow(25.0L, 7))) *
                          std::sin(60 * degree * std::exp(-std::pow((mean - 275) / 25, 2)));
    const Real dl = (q.l - p.l) / (1 + 0.015L * (l - 50) * (l - 50) / std::sqrt(20 + (l - 50) * (l - 50)));
    const Real dc = (q.c - p.c) / (1 + 0.045L * c);
    const Real hue = 2 * std::sqrt(p.c * q.c) * std::sin(dh / 2 * degree) / (1 + 0.015L * c * t);
    return std::sqrt(std::max(0.0L, dl * dl + dc * dc + hue * hue + rotation * dc * hue));
}
Real second_din99(const Vector3& x, const Vector3& y) {
    const auto space = [](const Vector3& v) {
        const Real e = v[1] * std::cos(16 * degree) + v[2] * std::sin(16 * degree);
        const Real f = 0.7L * (-v[1] * std::sin(16 * degree) + v[2] * std::cos(16 * degree));
        const Polar p = polar(105.51L * std::log(1 + 0.0158L * v[0]), e, f);
        const Real c = std::log(1 + 0.045L * p.c) / 0.045L;
        return std::array<Real, 3>{p.l, c * std::cos(p.h * degree), c * std::sin(p.h * degree)};
    };
    const auto p = space(x), q = space(y);
    return std::hypot(q[0] - p[0], q[1] - p[1], q[2] - p[2]);
}
Real second_cie76(const Vector3& x, const Vector3& y) {
    return std::hypot<Real, Real, Real>(x[0] - y[0], x[1] - y[1], x[2] - y[2]);
}
using Second = Real (*)(const Vector3&, const Vector3&);
constexpr Second seconds[] = {second_cie76, second_cie94, second_ciede2000, second_cmc, second_din99};

TEST(DeltaE, all_pairs_of_sharma_wu_and_dalal) {
    const auto pairs = sharma_pairs();
    ASSERT_EQ(pairs.size(), 34u);
    for (std::size_t i = 0; i < pairs.size(); ++i) {
        // The paper prints four decimals.
        EXPECT_NEAR(delta_e2000(pairs[i].lab1, pairs[i].lab2), pairs[i].published, 0.5001e-4) << "pair " << i + 1;
        EXPECT_NEAR(delta_e2000(pairs[i].lab2, pairs[i].lab1), pairs[i].published, 0.5001e-4) << "pair " << i + 1;
    }
}

// One chromatic pair far outside any gamut that other implementations publish with their answers (the colour-science
// package's documentation), to the seven decimals that are common to them.
TEST(DeltaE, published_values_of_the_other_formulas) {
    const Vector3 reference{100, 21.57210357, 272.22819350}, sample{100, 426.67945353, 72.39590835};
    EXPECT_NEAR(delta_e76(reference, sample), 451.7133019, 1e-6);
    EXPECT_NEAR(delta_e94(reference, sample), 83.7792255, 1e-6);
    EXPECT_NEAR(delta_e2000(reference, sample), 94.0356490, 1e-6);
    EXPECT_NEAR(delta_cmc(reference, sample), 172.7047712, 1e-6);
    // Published with 105.509 where DIN 6176 has 105.51: a relative 1e-5.
    EXPECT_NEAR(delta_e_din99({60.2574, -34.0099, 36.2677}, {60.4626, -34.1751, 39.4387}), 1.1772166, 2e-5);
}

TEST(DeltaE, agrees_with_the_second_formulations) {
    for (std::size_t f = 0; f < std::size(formulas); ++f)
        for (const Pair& p : random_pairs(100000, 7)) {
            const double expected = static_cast<double>(seconds[f](p.lab1, p.lab2));
            // Lab numbers up to 110 carry 1e-14; the formulas amplify that by less than 100.
            ASSERT_NEAR(formulas[f].second(p.lab1, p.lab2), expected, 1e-12 * (1 + expected)) << formulas[f].first;
        }
}

TEST(DeltaE, is_exactly_zero_for_identical_colours) {
    for (const auto& [name, formula] : formulas) {
        for (const Pair& p : random_pairs(10000, 8)) ASSERT_EQ(formula(p.lab1, p.lab1), 0) << name;
        for (const Vector3& v : {Vector3{0, 0, 0}, Vector3{100, 0, 0}, Vector3{-5, -0.0, 1e-300}, Vector3{50, 1e40, -1e40}})
            EXPECT_EQ(formula(v, v), 0) << name;
    }
}

TEST(DeltaE, is_symmetric_where_its_formula_is) {
    for (const Pair& p : random_pairs(20000, 9)) {
        EXPECT_EQ(delta_e76(p.lab1, p.lab2), delta_e76(p.lab2, p.lab1));
        EXPECT_EQ(delta_e_din99(p.lab1, p.lab2), delta_e_din99(p.lab2, p.lab1));
        EXPECT_NEAR(delta_e2000(p.lab1, p.lab2), delta_e2000(p.lab2, p.lab1), 1e-12);
    }
    // And the two that are weighted by their reference are not: A is the reference.
    const Vector3 grey{50, 0, 0}, strong{50, 60, 0};
    EXPECT_DOUBLE_EQ(delta_e94(grey, strong), 60);
    EXPECT_DOUBLE_EQ(delta_e94(strong, grey), 60 / (1 + 0.045 * 60));
    EXPECT_DOUBLE_EQ(delta_cmc(grey, strong), 60 / 0.638);
}

TEST(DeltaE, lightness_alone_of_neutrals) {
    EXPECT_DOUBLE_EQ(delta_e76({20, 0, 0}, {80, 0, 0}), 60);
    EXPECT_DOUBLE_EQ(delta_e94({20, 0, 0}, {80, 0, 0}), 60);
    EXPECT_DOUBLE_EQ(delta_e2000({20, 0, 0}, {80, 0, 0}), 60);  // SL is 1 at the mean of 50
    EXPECT_DOUBLE_EQ(delta_cmc({10, 0, 0}, {12, 0, 0}), 1 / 0.511);
    EXPECT_DOUBLE_EQ(delta_e_din99({0, 0, 0}, {100, 0, 0}), 105.51 * std::log(2.58));
}

TEST(DeltaE, is_continuous_but_where_ciede2000_is_not) {
    // Across hue 0/360: a step of 2e-9 in b moves no difference by more than a hundred times that.
    for (const auto& [name, formula] : formulas)
        for (const double chroma : {0.5, 5.0, 50.0, 120.0})
            for (const Vector3& other : {Vector3{40, 30, 4}, Vector3{60, 3, -20}, Vector3{50, 10, 30}}) {
                const Vector3 above{50, chroma, 1e-9}, below{50, chroma, -1e-9}, on{50, chroma, 0};
                EXPECT_NEAR(formula(above, other), formula(below, other), 2e-7) << name;
                EXPECT_NEAR(formula(other, above), formula(other, below), 2e-7) << name;
                EXPECT_NEAR(formula(above, below), 0, 1e-7) << name;
                EXPECT_NEAR(formula(on, other), formula(above, other), 2e-7) << name;
            }
    for (Pair p : random_pairs(20000, 10)) {
        const Polar h1 = polar(0, p.lab1[1], p.lab1[2]), h2 = polar(0, p.lab2[1], p.lab2[2]);
        const Real apart = std::fabs(h1.h - h2.h);
        if (std::fabs(apart - 180) < 10 || std::min(h1.c, h2.c) < 1) continue;
        const double here = delta_e2000(p.lab1, p.lab2);
        for (double& v : p.lab2) v += 1e-9;
        EXPECT_NEAR(delta_e2000(p.lab1, p.lab2), here, 1e-6);
    }
    // Opposite hues: the mean hue turns by 180 degrees there, as Sharma et al. discuss; their pairs 10 and 11 straddle it.
    const Vector3 reference{50, 2.5, 0};
    EXPECT_NEAR(delta_e2000(reference, {50, -2.5, 1e-9}), delta_e2000(reference, {50, -2.5, 2e-9}), 1e-6);
    const double jump = delta_e2000({50, -0.001, 2.49}, {50, 0.0010, -2.49}) - delta_e2000({50, -0.001, 2.49}, {50, 0.0011, -2.49});
    EXPECT_GT(std::fabs(jump), 0.02);
}

TEST(DeltaE, cie76_keeps_the_triangle_inequality) {
    const auto pairs = random_pairs(20000, 11);
    for (std::size_t i = 0; i + 1 < pairs.size(); ++i) {
        const double direct = delta_e76(pairs[i].lab1, pairs[i].lab2);
        const double detour = delta_e76(pairs[i].lab1, pairs[i + 1].lab1) + delta_e76(pairs[i + 1].lab1, pairs[i].lab2);
        EXPECT_LE(direct, detour * (1 + 1e-15));
    }
}

TEST(DeltaE, is_finite_for_finite_and_nan_for_nan) {
    const Vector3 odd[] = {{0, 0, 0},       {-1, -2, -3},     {-1e3, 1e3, -1e3}, {1e-310, 0, 1e-310}, {1e30, -1e30, 1e30},
                           {-1e38, 3e38, 1}, {1e-20, -1e-20, 0}, {1, 0, 0},         {0, 0, -1}};
    for (std::size_t f = 0; f < std::size(formulas); ++f)
        for (const Vector3& x : odd)
            for (const Vector3& y : odd)
                EXPECT_TRUE(std::isfinite(formulas[f].second(lab_from_xyz(x, d65), lab_from_xyz(y, d65))))
                    << formulas[f].first << " " << x[0] << " " << y[0];
    for (int m = 0; m < 7; ++m) {
        const DifferenceKernel kernel(static_cast<Metric>(m), bt709, bt709, d65);
        for (const Vector3& x : odd) {
            const double ones[3] = {1, 1, 1};
            double out = -1;
            kernel({&x[0], &x[1], &x[2]}, {&ones[0], &ones[1], &ones[2]}, 1, &out);
            EXPECT_TRUE(std::isfinite(out)) << m << " " << x[0];
            const double bad[3] = {x[0], nan, x[2]};
            kernel({&bad[0], &bad[1], &bad[2]}, {&bad[0], &bad[1], &bad[2]}, 1, &out);
            EXPECT_TRUE(std::isnan(out)) << m;
            kernel({&ones[0], &ones[1], &ones[2]}, {&bad[0], &bad[1], &bad[2]}, 1, &out);
            EXPECT_TRUE(std::isnan(out)) << m;
        }
    }
}

TEST(Lab, white_black_and_the_join_of_its_branches) {
    const Vector3 white = lab_from_xyz(d65, d65), black = lab_from_xyz({0, 0, 0}, d65);
    for (std::size_t k = 0; k < 3; ++k) {
        EXPECT_NEAR(white[k], k == 0 ? 100 : 0, 1e-13);
        EXPECT_NEAR(black[k], 0, 1e-13);
    }
    // CIE 15's border (24/116)^3 is where both branches give 24/116, hence L* = 8.
    const double border = std::pow(24.0 / 116, 3);
    EXPECT_NEAR(lab_from_xyz({0, std::nextafter(border, 1.0), 0}, {1, 1, 1})[0], 8, 1e-12);
    EXPECT_NEAR(lab_from_xyz({0, border, 0}, {1, 1, 1})[0], 8, 1e-12);
    // Y of 0.184187 is CIE L* 50, by definition of the cube: ((50 + 16) / 116)^3.
    EXPECT_NEAR(lab_from_xyz({0, std::pow(66.0 / 116, 3) * 100, 0}, {100, 100, 100})[0], 50, 1e-12);
}

TEST(Lab, planes_keep_to_the_scalar_formula) {
    constexpr std::size_t n = 60001;
    // From far below the linear branch's border, which lies at 0.0089, to far above white.
    std::array<std::vector<double>, 3> t, lab;
    std::mt19937 engine(12);
    std::uniform_real_distribution<double> exponent(-12, 12);
    for (auto& plane : t)
        for (std::size_t i = 0; i < n; ++i) plane.push_back(std::pow(10, exponent(engine)) * (i % 9 ? 1 : -1));
    for (auto& plane : lab) plane.resize(n);
    lab_planes(Matrix3{}, {t[0].data(), t[1].data(), t[2].data()}, n, {lab[0].data(), lab[1].data(), lab[2].data()});
    for (std::size_t i = 0; i < n; ++i) {
        const Vector3 expected = lab_from_xyz({t[0][i], t[1][i], t[2][i]}, {1, 1, 1});
        // Both roots are good to 2^-52; a* and b* subtract them at their largest.
        double scale = 0;
        for (std::size_t k = 0; k < 3; ++k) scale = std::max(scale, std::fabs(lab_f(t[k][i])));
        for (std::size_t k = 0; k < 3; ++k) ASSERT_NEAR(lab[k][i], expected[k], 1e-12 + 500 * scale * 0x1p-50) << i;
    }
}

// Runs a check on each instruction set of this machine; restores its own choice.
template <class F>
void on_every_target(F check) {
    const std::int64_t all = hwy::SupportedTargets() & HWY_TARGETS;
    for (std::int64_t left = all; left != 0; left &= left - 1) {
        const std::int64_t target = left & -left;
        hwy::SetSupportedTargetsForTest(target);
        hwy::GetChosenTarget().Update(target);
        SCOPED_TRACE(hwy::TargetName(target));
        check();
    }
    hwy::SetSupportedTargetsForTest(0);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

TEST(DeltaE, ciede2000_in_planes_keeps_to_its_reference_on_every_target) {
    std::vector<Pair> pairs = sharma_pairs();
    for (const Pair& p : random_pairs(60000, 31)) pairs.push_back(p);
    std::mt19937 engine(32);
    std::uniform_real_distribution<double> exponent(-14, 0), angle(0, 2 * std::numbers::pi), chroma(0, 130), lightness(0, 100);
    for (int i = 0; i < 60000; ++i) {
        // Neighbours at any distance, greys and near greys beside anything, the blue of the rotation term, exact neutrals.
        const double h = i % 2 ? angle(engine) : 275 / 57.29578 + 0.6 * (angle(engine) - 3), c = i % 7 ? chroma(engine) : std::pow(10, exponent(engine));
        Pair p{{lightness(engine), c * std::cos(h), c * std::sin(h)}, {}, 0};
        const double d = std::pow(10, exponent(engine)), e = angle(engine);
        p.lab2 = {p.lab1[0] + d * std::cos(3 * e), p.lab1[1] + d * std::cos(e), p.lab1[2] + d * std::sin(e)};
        if (i % 5 == 0) p.lab2 = {lightness(engine), 1e-9 * chroma(engine), -1e-9 * chroma(engine)};
        if (i % 11 == 0) p.lab1[1] = p.lab1[2] = 0;
        if (i % 13 == 0) p.lab2[1] = p.lab2[2] = 0;
        if (i % 17 == 0) p.lab2 = p.lab1;
        pairs.push_back(p);
    }
    // What the float path does not take: magnitudes over 1e4, NaN.
    for (const double v : {1e4, 1.0001e4, 1e30, -1e60, std::nan("")}) pairs.push_back({{50, v, 20}, {40, 30, v}, 0});
    std::array<std::vector<double>, 6> planes;
    for (const Pair& p : pairs)
        for (std::size_t k = 0; k < 3; ++k) planes[k].push_back(p.lab1[k]), planes[3 + k].push_back(p.lab2[k]);
    const auto at = [&](std::size_t first) { return std::array<const double*, 3>{planes[first].data(), planes[first + 1].data(), planes[first + 2].data()}; };
    std::vector<float> first;
    on_every_target([&] {
        std::vector<float> out(pairs.size()), swapped(pairs.size());
        delta_e2000_planes(at(0), at(3), pairs.size(), out.data());
        delta_e2000_planes(at(3), at(0), pairs.size(), swapped.data());
        if (first.empty()) first = out;
        for (std::size_t i = 0; i < pairs.size(); ++i) {
            const Pair& p = pairs[i];
            const double expected = delta_e2000(p.lab1, p.lab2);
            if (std::isnan(expected)) {
                ASSERT_TRUE(std::isnan(out[i])) << i;
                continue;
            }
            ASSERT_EQ(out[i], first[i]) << i;
            ASSERT_EQ(out[i], swapped[i]) << i;
            if (p.lab1 == p.lab2) {
                ASSERT_EQ(out[i], 0) << i;
            }
            // A few roundings of float, 6e-8 each, in the terms of chroma and hue, whose squares the rotation term can cancel
            // to (2 - sqrt 3) / (2 + sqrt 3), a fourteenth.
            ASSERT_NEAR(out[i], expected, 5e-6 * expected + 1e-11)
                << i << ": " << p.lab1[0] << " " << p.lab1[1] << " " << p.lab1[2] << ", " << p.lab2[0] << " " << p.lab2[1] << " " << p.lab2[2];
        }
    });
}

TEST(DeltaE, planes_keep_to_the_formulas_for_one_pair_on_every_target) {
    std::vector<Pair> pairs = random_pairs(40000, 41);
    std::mt19937 engine(42);
    std::uniform_real_distribution<double> exponent(-14, 0), angle(0, 2 * std::numbers::pi), chroma(0, 150), lightness(-5, 110);
    for (int i = 0; i < 40000; ++i) {
        const double h = angle(engine), c = chroma(engine), d = std::pow(10, exponent(engine)), e = angle(engine);
        Pair p{{lightness(engine), c * std::cos(h), c * std::sin(h)}, {}, 0};
        p.lab2 = {p.lab1[0] + d * std::cos(3 * e), p.lab1[1] + d * std::cos(e), p.lab1[2] + d * std::sin(e)};
        if (i % 3 == 0) p.lab2 = {lightness(engine), -p.lab1[1] * d, -p.lab1[2] * d};  // opposite hues
        if (i % 11 == 0) p.lab1[1] = p.lab1[2] = 0;
        if (i % 13 == 0) p.lab2[1] = p.lab2[2] = 0;
        if (i % 17 == 0) p.lab2 = p.lab1;
        pairs.push_back(p);
    }
    const double infinity = std::numeric_limits<double>::infinity();
    for (const double v : {1e30, -1e60, infinity, -infinity, std::nan("")})
        for (const std::size_t k : {0u, 1u, 2u}) {
            Pair p{{50, v == 1e30 ? 0.0 : 10, 20}, {40, 30, 5}, 0};
            p.lab2[k] = v;
            pairs.push_back(p);
            std::swap(p.lab1, p.lab2);
            pairs.push_back(p);
        }
    std::array<std::vector<double>, 6> planes;
    for (const Pair& p : pairs)
        for (std::size_t k = 0; k < 3; ++k) planes[k].push_back(p.lab1[k]), planes[3 + k].push_back(p.lab2[k]);
    using Read = std::array<const double*, 3>;
    struct Formula {
        const char* name;
        void (*of_planes)(Read, Read, std::size_t, float*);
        double (*of_pair)(const Vector3&, const Vector3&);
        double relative, absolute;
    };
    const Formula formulas[] = {
        {"cie76", [](Read a, Read b, std::size_t n, float* out) { distance_planes(1, a, b, n, out); }, delta_e76, 0, 0},
        {"cie94", delta_e94_planes, delta_e94, 0, 0},
        // The rounding to float, and before it the hue's weight from a cross product instead of an angle, some units of 2^-53.
        {"cmc", delta_cmc_planes, delta_cmc, 0x1p-24 + 1e-14, 0},
        // The rounding, and of coordinates up to 60 some units in the last place.
        {"din99",
         [](Read a, Read b, std::size_t n, float* out) {
             std::array<std::vector<double>, 6> own;
             for (std::size_t k = 0; k < 3; ++k) own[k].assign(a[k], a[k] + n), own[3 + k].assign(b[k], b[k] + n);
             din99_planes({own[0].data(), own[1].data(), own[2].data()}, n);
             din99_planes({own[3].data(), own[4].data(), own[5].data()}, n);
             distance_planes(1, {own[0].data(), own[1].data(), own[2].data()}, {own[3].data(), own[4].data(), own[5].data()}, n, out);
         },
         delta_e_din99, 0x1p-24 + 1e-14, 1e-13},
    };
    for (const Formula& f : formulas) {
        SCOPED_TRACE(f.name);
        std::vector<float> first;
        on_every_target([&] {
            std::vector<float> out(pairs.size());
            f.of_planes({planes[0].data(), planes[1].data(), planes[2].data()}, {planes[3].data(), planes[4].data(), planes[5].data()}, pairs.size(), out.data());
            if (first.empty()) first = out;
            for (std::size_t i = 0; i < pairs.size(); ++i) {
                const Pair& p = pairs[i];
                const double expected = f.of_pair(p.lab1, p.lab2);
                if (std::isnan(expected) || std::isnan(out[i])) {
                    // An infinite coordinate leaves no number, or infinity.
                    ASSERT_FALSE(std::isfinite(expected) || std::isfinite(out[i])) << i;
                    continue;
                }
                ASSERT_EQ(out[i], first[i]) << i;
                if (f.relative == 0 || std::isinf(expected) || expected > 1e30)
                    ASSERT_EQ(out[i], static_cast<float>(expected)) << i;
                else
                    ASSERT_NEAR(out[i], expected, f.relative * expected + f.absolute)
                        << i << ": " << p.lab1[0] << " " << p.lab1[1] << " " << p.lab1[2] << ", " << p.lab2[0] << " " << p.lab2[1] << " " << p.lab2[2];
            }
        });
    }
}

Real lab_distance(const Vector3& x, const Vector3& y, Metric metric) {
    const auto lab = [](const Vector3& rgb) {
        std::array<Real, 3> f{};
        for (std::size_t row = 0; row < 3; ++row) {
            Real t = 0;
            for (std::size_t c = 0; c < 3; ++c) t += static_cast<Real>(bt709(row, c)) * rgb[c];
            t /= d65[row];
            f[row] = t > 216.0L / 24389 ? std::cbrt(t) : (24389.0L / 27 * t + 16) / 116;
        }
        return Vector3{static_cast<double>(116 * f[1] - 16), static_cast<double>(500 * (f[0] - f[1])),
                       static_cast<double>(200 * (f[1] - f[2]))};
    };
    return seconds[static_cast<std::size_t>(metric)](lab(x), lab(y));
}

template <class T>
std::array<std::vector<T>, 3> random_planes(std::size_t n, unsigned seed) {
    std::mt19937 engine(seed);
    std::uniform_real_distribution<double> uniform(-0.1, 1.3), tiny(-0.01, 0.02);
    std::array<std::vector<T>, 3> planes;
    for (auto& p : planes)
        for (std::size_t i = 0; i < n; ++i) p.push_back(static_cast<T>(i % 3 ? uniform(engine) : tiny(engine)));
    return planes;
}
template <class T>
std::array<const T*, 3> pointers(const std::array<std::vector<T>, 3>& planes, std::size_t at = 0) {
    return {planes[0].data() + at, planes[1].data() + at, planes[2].data() + at};
}

TEST(DifferenceKernel, stays_within_a_billionth_of_long_double) {
    constexpr std::size_t n = 30011;
    const auto a = random_planes<double>(n, 20), b = random_planes<double>(n, 21);
    for (const Metric metric : {Metric::cie76, Metric::cie94, Metric::ciede2000, Metric::cmc}) {
        const DifferenceKernel kernel(metric, bt709, bt709, d65);
        std::vector<double> out(n);
        kernel(pointers(a), pointers(b), n, out.data());
        for (std::size_t i = 0; i < n; ++i) {
            const double expected =
                static_cast<double>(lab_distance({a[0][i], a[1][i], a[2][i]}, {b[0][i], b[1][i], b[2][i]}, metric));
            ASSERT_NEAR(out[i], expected, 1e-9) << metric_name(metric) << " " << i;
        }
    }
}

TEST(DifferenceKernel, gives_the_same_bytes_on_every_target_and_for_every_split) {
    constexpr std::size_t n = 3001;
    auto a = random_planes<float>(n, 22), b = random_planes<float>(n, 23);
    a[1][5] = std::numeric_limits<float>::infinity();
    a[2][77] = 3e38f;
    b[0][78] = -3e38f;
    std::vector<std::vector<float>> first(7);
    on_every_target([&] {
        for (int m = 0; m < 7; ++m) {
            const DifferenceKernel kernel(static_cast<Metric>(m), bt709, bt709, d65);
            std::vector<float> whole(n), split(n);
            kernel(pointers(a), pointers(b), n, whole.data());
            for (std::size_t at = 0, step = 1; at < n; at += step, step = step % 37 + 1)
                kernel(pointers(a, at), pointers(b, at), std::min(step, n - at), split.data() + at);
            auto& expected = first[static_cast<std::size_t>(m)];
            if (expected.empty()) expected = whole;
            for (std::size_t i = 0; i < n; ++i) {
                ASSERT_TRUE(whole[i] == expected[i] || (std::isnan(whole[i]) && std::isnan(expected[i]))) << m << " " << i;
                ASSERT_TRUE(split[i] == expected[i] || (std::isnan(split[i]) && std::isnan(expected[i]))) << m << " " << i;
            }
            EXPECT_TRUE(std::isnan(expected[5]));
            EXPECT_TRUE(std::isfinite(expected[77]));
        }
    });
}

TEST(DifferenceKernel, floats_by_vectors_keep_to_doubles_one_by_one_on_every_target) {
    constexpr std::size_t n = 20011;
    auto a = random_planes<float>(n, 25), b = random_planes<float>(n, 26);
    std::mt19937 engine(27);
    std::uniform_real_distribution<float> exponent(-42, 6);
    for (std::size_t i = 0; i < n; i += 3)
        for (std::size_t k = 0; k < 3; ++k) a[k][i] = std::pow(10.0f, exponent(engine)) * (engine() % 5 ? 1.0f : -1.0f);
    for (std::size_t i = 0; i < n; i += 5)
        for (std::size_t k = 0; k < 3; ++k) b[k][i] = i % 2 ? std::nextafter(a[k][i], 2.0f) : 0.0f;
    std::array<std::vector<double>, 6> wide;
    for (std::size_t k = 0; k < 3; ++k) wide[k].assign(a[k].begin(), a[k].end()), wide[3 + k].assign(b[k].begin(), b[k].end());
    for (const Metric metric : {Metric::cie76, Metric::cie94, Metric::cmc, Metric::din99, Metric::itp, Metric::oklab}) {
        const DifferenceKernel kernel(metric, bt709, bt709, d65);
        std::vector<double> expected(n);
        kernel({wide[0].data(), wide[1].data(), wide[2].data()}, {wide[3].data(), wide[4].data(), wide[5].data()}, n, expected.data());
        on_every_target([&] {
            std::vector<float> out(n);
            kernel(pointers(a), pointers(b), n, out.data());
            // The rounding to float; and of differences, what coordinates of up to 500 in Lab and 720 times the PQ curve, whose
            // slope is 79, leave of their own roundings.
            for (std::size_t i = 0; i < n; ++i) {
                double largest = 1;
                for (const auto& plane : wide) largest = std::max(largest, std::fabs(plane[i]));
                ASSERT_NEAR(out[i], expected[i], 0x1p-23 * expected[i] + 2e-11 * std::cbrt(largest)) << metric_name(metric) << " " << i;
            }
        });
    }
}

TEST(DifferenceKernel, is_exactly_zero_for_equal_pixels_and_takes_either_side_by_its_own_matrix) {
    const auto a = random_planes<float>(1000, 24);
    auto halved = a;
    for (auto& p : halved)
        for (float& v : p) v *= 0.5f;
    Matrix3 doubled = bt709;
    for (double& v : doubled.m) v *= 2;
    for (int m = 0; m < 7; ++m) {
        std::vector<float> out(1000, 1);
        DifferenceKernel(static_cast<Metric>(m), bt709, bt709, d65)(pointers(a), pointers(a), 1000, out.data());
        EXPECT_EQ(out, std::vector<float>(1000, 0));
        DifferenceKernel(static_cast<Metric>(m), bt709, doubled, d65)(pointers(a), pointers(halved), 1000, out.data());
        EXPECT_EQ(out, std::vector<float>(1000, 0)) << "powers of two scale exactly";
        DifferenceKernel(static_cast<Metric>(m), bt709, bt709, d65)(pointers(a), pointers(halved), 1000, out.data());
        EXPECT_GT(*std::ranges::max_element(out), 0);
    }
}

TEST(Itp, perceptual_quantizer_and_neutrals) {
    // ITU-R BT.2408 table 1 gives 58% at 203 cd/m2, and BT.2100's curve 0.508078 at 100 and 1 at 10000.
    EXPECT_NEAR(pq_encode(203), 0.58, 0.005);
    EXPECT_NEAR(pq_encode(100), 0.508078, 1e-6);
    EXPECT_NEAR(pq_encode(10000), 1, 1e-15);
    // Continuous at zero, where it rises as the 0.159th power of luminance: 1e-40 is 7e-8 of the way.
    EXPECT_NEAR(pq_encode(1e-40), pq_encode(-1e-40), 1e-9);
    EXPECT_LT(pq_encode(-1), pq_encode(0));
    const ItpSpace space(d65);
    for (const double y : {0.0, 0.18, 1.0, 10.0}) {
        const Vector3 itp = space({y * d65[0], y * d65[1], y * d65[2]});
        EXPECT_NEAR(itp[0], pq_encode(203 * y), 1e-13);
        EXPECT_NEAR(itp[1], 0, 1e-13);
        EXPECT_NEAR(itp[2], 0, 1e-13);
    }
    const double black[3] = {0, 0, 0}, white[3] = {1, 1, 1};
    const Vector3 sum{bt709(0, 0) + bt709(0, 1) + bt709(0, 2), bt709(1, 0) + bt709(1, 1) + bt709(1, 2),
                      bt709(2, 0) + bt709(2, 1) + bt709(2, 2)};
    double out = 0;
    DifferenceKernel(Metric::itp, bt709, bt709, sum)({&black[0], &black[1], &black[2]}, {&white[0], &white[1], &white[2]}, 1,
                                                     &out);
    EXPECT_NEAR(out, 720 * (pq_encode(203) - pq_encode(0)), 1e-10);
}

TEST(Oklab, the_authors_own_table) {
    // Ottosson 2020 lists these to three decimals; scaling by this white instead of his matrix's own moves them by less
    // than as much again.
    const OklabSpace space(d65);
    const std::pair<Vector3, Vector3> table[] = {{{0.950, 1.000, 1.089}, {1.000, 0.000, 0.000}},
                                                 {{1, 0, 0}, {0.450, 1.236, -0.019}},
                                                 {{0, 1, 0}, {0.922, -0.671, 0.263}},
                                                 {{0, 0, 1}, {0.153, -1.415, -0.449}}};
    for (const auto& [xyz, lab] : table)
        for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(space(xyz)[k], lab[k], 1e-3);
    const Matrix3 identity;
    const double x[3] = {1, 0, 0}, y[3] = {0, 1, 0};
    double out = 0;
    DifferenceKernel(Metric::oklab, identity, identity, d65)({&x[0], &x[1], &x[2]}, {&y[0], &y[1], &y[2]}, 1, &out);
    EXPECT_NEAR(out, std::hypot(0.450 - 0.922, 1.236 + 0.671, -0.019 - 0.263), 3e-3);
}

TEST(Metrics, names_go_both_ways) {
    for (int m = 0; m < 7; ++m) {
        const auto metric = static_cast<Metric>(m);
        const auto parsed = parse_metric(metric_name(metric));
        ASSERT_TRUE(parsed);
        EXPECT_EQ(*parsed, metric);
        EXPECT_FALSE(metric_title(metric).empty());
    }
    const auto unknown = parse_metric("cie2000");
    ASSERT_FALSE(unknown);
    EXPECT_EQ(unknown.error().kind, ErrorKind::usage);
    EXPECT_NE(unknown.error().message.find("ciede2000"), std::string::npos);
}

double nearest_rank(const std::vector<float>& sorted, std::uint64_t thousandths) {
    return sorted[(sorted.size() * thousandths + 999) / 1000 - 1];
}

void check_statistics(const std::vector<float>& values, std::size_t width, std::size_t memory) {
    DifferenceAccumulator accumulator(memory);
    for (std::size_t at = 0; at < values.size(); at += width)
        ASSERT_TRUE(accumulator.add_row(static_cast<std::int64_t>(at / width),
                                        std::span(values).subspan(at, std::min(width, values.size() - at))));
    const auto result = accumulator.finish();
    ASSERT_TRUE(result);
    std::vector<float> finite;
    Real sum = 0, squares = 0;
    std::int64_t first = -1;
    float max = -std::numeric_limits<float>::infinity();
    for (std::size_t i = 0; i < values.size(); ++i) {
        if (!std::isfinite(values[i])) continue;
        finite.push_back(values[i]);
        sum += values[i];
        squares += static_cast<Real>(values[i]) * values[i];
        if (values[i] > max) max = values[i], first = static_cast<std::int64_t>(i);
    }
    std::ranges::sort(finite);
    EXPECT_EQ(result->pixels, finite.size());
    EXPECT_EQ(result->nonfinite, values.size() - finite.size());
    ASSERT_FALSE(finite.empty());
    const Real count = static_cast<Real>(finite.size());
    // A compensated sum of non-negative numbers is right to a rounding.
    EXPECT_NEAR(result->mean, static_cast<double>(sum / count), 4e-16 * result->mean);
    EXPECT_NEAR(result->rms, static_cast<double>(std::sqrt(squares / count)), 4e-16 * result->rms);
    EXPECT_EQ(result->p50, nearest_rank(finite, 500));
    EXPECT_EQ(result->p95, nearest_rank(finite, 950));
    EXPECT_EQ(result->p99, nearest_rank(finite, 990));
    EXPECT_EQ(result->p999, nearest_rank(finite, 999));
    EXPECT_EQ(result->max, finite.back());
    EXPECT_EQ(result->max_at[0], first % static_cast<std::int64_t>(width));
    EXPECT_EQ(result->max_at[1], first / static_cast<std::int64_t>(width));
}

TEST(Accumulator, percentiles_are_those_of_a_sort_in_memory_and_spilled) {
    std::mt19937 engine(30);
    std::lognormal_distribution<float> skewed(0, 3);
    std::uniform_int_distribution<int> few(0, 20);
    for (const std::size_t n : {1u, 2u, 3u, 10u, 19u, 20u, 21u, 100u, 999u, 1000u, 1001u, 5000u, 123457u})
        for (const std::size_t memory : {std::size_t{1} << 28, std::size_t{4096}}) {
            std::vector<float> values(n);
            for (float& v : values) v = skewed(engine);
            check_statistics(values, 37, memory);
            for (float& v : values) v = static_cast<float>(few(engine));  // many equal: the first largest counts
            check_statistics(values, 37, memory);
            if (n > 10)
                for (std::size_t i = 3; i < n; i += 7) values[i] = i % 2 ? NAN : INFINITY;
            check_statistics(values, 64, memory);
        }
}

TEST(Accumulator, does_not_depend_on_how_rows_fall) {
    std::mt19937 engine(31);
    std::uniform_real_distribution<float> uniform(0, 1);
    std::vector<float> values(4096);
    for (float& v : values) v = uniform(engine);
    DifferenceAccumulator small(4096), large;
    for (std::int64_t y = 0; y < 64; ++y) {
        const auto row = std::span(values).subspan(static_cast<std::size_t>(y) * 64, 64);
        ASSERT_TRUE(small.add_row(y, row));
        ASSERT_TRUE(large.add_row(y, row));
    }
    const auto p = small.finish(), q = large.finish();
    ASSERT_TRUE(p && q);
    EXPECT_EQ(p->mean, q->mean);
    EXPECT_EQ(p->rms, q->rms);
    EXPECT_EQ(p->p999, q->p999);
    EXPECT_EQ(p->max_at, q->max_at);
}

TEST(Accumulator, sums_are_compensated) {
    // In plain double the ones would all be lost beside 1e17.
    DifferenceAccumulator accumulator;
    std::vector<float> values(1001, 1.0f);
    values[0] = 0x1p57f;
    ASSERT_TRUE(accumulator.add_row(0, values));
    EXPECT_EQ(accumulator.finish()->mean, static_cast<double>((0x1p57L + 1000) / 1001));
    EXPECT_NE(0x1p57 / 1001, static_cast<double>((0x1p57L + 1000) / 1001));
}

TEST(Accumulator, of_nothing_is_zero_and_not_nan) {
    const auto empty = DifferenceAccumulator().finish();
    ASSERT_TRUE(empty);
    EXPECT_EQ(empty->pixels, 0u);
    EXPECT_EQ(empty->mean, 0);
    EXPECT_EQ(empty->rms, 0);
    EXPECT_EQ(empty->p50, 0);
    EXPECT_EQ(empty->max, 0);
    EXPECT_EQ(empty->max_at, (std::array<std::int64_t, 2>{-1, -1}));
    DifferenceAccumulator only_bad;
    const std::vector<float> bad{NAN, INFINITY, -INFINITY};
    ASSERT_TRUE(only_bad.add_row(0, bad));
    only_bad.add_changed_codes(3);
    const auto statistics = only_bad.finish();
    ASSERT_TRUE(statistics);
    EXPECT_EQ(statistics->nonfinite, 3u);
    EXPECT_EQ(statistics->changed_codes, 3u);
    EXPECT_EQ(statistics->mean, 0);
    EXPECT_EQ(statistics->p99, 0);
}

TEST(Accumulator, refuses_rows_out_of_order_and_says_where_it_cannot_spill) {
    DifferenceAccumulator accumulator;
    const std::vector<float> row(8, 1.0f);
    ASSERT_TRUE(accumulator.add_row(5, row));
    const auto again = accumulator.add_row(5, row);
    ASSERT_FALSE(again);
    EXPECT_EQ(again.error().kind, ErrorKind::usage);

    const char* const before = std::getenv("TMPDIR");
    const std::string saved = before ? before : "";
    ::setenv("TMPDIR", "/nonexistent-folder", 1);
    DifferenceAccumulator spilling(4096);
    const std::vector<float> long_row(5000, 1.0f);
    const auto failed = spilling.add_row(0, long_row);
    if (before) ::setenv("TMPDIR", saved.c_str(), 1);
    else ::unsetenv("TMPDIR");
    ASSERT_FALSE(failed);
    EXPECT_EQ(failed.error().kind, ErrorKind::output);
    EXPECT_NE(failed.error().message.find("/nonexistent-folder"), std::string::npos);
}

TEST(Accumulator, leaves_no_temporary_file) {
    const auto folder = std::filesystem::temp_directory_path() / ("spectex-compare-test-" + std::to_string(::getpid()));
    std::filesystem::create_directory(folder);
    const char* const before = std::getenv("TMPDIR");
    const std::string saved = before ? before : "";
    ::setenv("TMPDIR", folder.c_str(), 1);
    {
        DifferenceAccumulator accumulator(4096);
        const std::vector<float> row(5000, 1.0f);
        ASSERT_TRUE(accumulator.add_row(0, row));
        EXPECT_TRUE(std::filesystem::is_empty(folder)) << "unlinked while in use";
        EXPECT_EQ(accumulator.finish()->p50, 1);
    }
    if (before) ::setenv("TMPDIR", saved.c_str(), 1);
    else ::unsetenv("TMPDIR");
    EXPECT_TRUE(std::filesystem::is_empty(folder));
    std::filesystem::remove(folder);
}

long double decode(long double c) { return c <= 0.04045L ? c / 12.92L : std::pow((c + 0.055L) / 1.055L, 2.4L); }

// Code by a search that needs no encoding: the number of boundaries decode((k - 1/2) / 255) not above the value.
int code_of(float v) {
    static const auto boundaries = [] {
        std::array<long double, 255> b{};
        for (int k = 1; k < 256; ++k) b[static_cast<std::size_t>(k - 1)] = decode((k - 0.5L) / 255);
        return b;
    }();
    return static_cast<int>(std::upper_bound(boundaries.begin(), boundaries.end(), static_cast<long double>(v)) -
                            boundaries.begin());
}

std::uint64_t changed(const std::vector<float>& a, const std::vector<float>& b) {
    const std::vector<float> zero(a.size(), 0.0f);
    return count_changed_codes({zero.data(), a.data(), zero.data()}, {zero.data(), b.data(), zero.data()}, a.size());
}

TEST(ChangedCodes, turn_exactly_at_the_boundaries) {
    for (int k = 1; k < 256; ++k) {
        const long double boundary = decode((k - 0.5L) / 255);
        float above = static_cast<float>(boundary);
        if (above < boundary) above = std::nextafter(above, 2.0f);
        const float below = std::nextafter(above, 0.0f);
        const float centre = static_cast<float>(decode(k / 255.0L)), previous = static_cast<float>(decode((k - 1) / 255.0L));
        EXPECT_EQ(changed({below}, {above}), 1u) << k;
        EXPECT_EQ(changed({below}, {previous}), 0u) << k;
        EXPECT_EQ(changed({above}, {centre}), 0u) << k;
    }
}

TEST(ChangedCodes, agree_with_the_search_on_random_values) {
    std::mt19937 engine(40);
    std::uniform_real_distribution<float> uniform(-0.1f, 1.1f);
    std::normal_distribution<float> near(0, 0.002f);
    std::vector<float> a(200000), b(a.size());
    std::uint64_t expected = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        a[i] = i % 4 ? uniform(engine) : std::ldexp(uniform(engine), -static_cast<int>(i / 4 % 20));
        b[i] = a[i] + near(engine);
        expected += code_of(a[i]) != code_of(b[i]);
    }
    EXPECT_EQ(changed(a, b), expected);
    EXPECT_GT(expected, 1000u);
    EXPECT_LT(expected, a.size() - 1000);
}

TEST(ChangedCodes, clip_and_count_pixels_once_and_nan_always) {
    EXPECT_EQ(changed({-1, 0, 1, 2, INFINITY, -0.0f}, {0, -INFINITY, 5, 1, 1, 0}), 0u);
    EXPECT_EQ(changed({NAN, 0, NAN}, {0, NAN, NAN}), 3u);
    const std::vector<float> black{0, 0}, white{1, 0};
    EXPECT_EQ(count_changed_codes({black.data(), black.data(), black.data()}, {white.data(), white.data(), white.data()}, 2),
              1u);
    EXPECT_EQ(count_changed_codes({black.data(), black.data(), black.data()}, {black.data(), black.data(), white.data()}, 2),
              1u);
    EXPECT_EQ(count_changed_codes({nullptr, nullptr, nullptr}, {nullptr, nullptr, nullptr}, 0), 0u);
}

}  // namespace
