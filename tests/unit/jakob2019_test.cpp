#include <gtest/gtest.h>
#include <hwy/targets.h>
#include <tbb/parallel_for.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <random>

#include "kernels/sigmoid.h"
#include "methods/jakob2019.h"
#include "reference.h"
#include "spectex/coefficient_table.h"
#include "spectex/methods.h"

namespace spectex {
namespace {

using reference::Real;

#if defined(SPECTEX_SLOW_BUILD)
constexpr std::size_t code_stride = 4099;  // a prime: every value of every component still comes up
#else
constexpr std::size_t code_stride = 1;
#endif

Colorimetry colorimetry(const std::string& bands = "380:780:5", const char* space = "BT.709",
                        RgbMatrix matrix = RgbMatrix::integrated) {
    return Colorimetry::make({"cie1931", "", space, matrix}, BandSet::parse(bands).value()).value();
}

std::shared_ptr<const Model> model(std::string_view id, const Colorimetry& c) {
    auto made = make_model(id, c);
    EXPECT_TRUE(made) << made.error().message;
    return made ? *made : nullptr;
}

Real sigmoid(Real x) {
    const Real root = std::sqrt(1 + x * x);
    return x < 0 ? 0.5L / (root * (root - x)) : 1 - 0.5L / (root * (root + x));
}

/// Largest |A r - rgb|, summed in long double from the coefficients.
Real residual(const Colorimetry& c, const double* coefficients, const double* rgb) {
    const std::size_t n = c.bands().size();
    std::array<Real, 3> sum{};
    for (std::size_t b = 0; b < n; ++b) {
        const Real t = (static_cast<Real>(c.bands()[b]) - 580) / 200;
        const Real r = sigmoid((coefficients[0] * t + coefficients[1]) * t + coefficients[2]);
        for (std::size_t i = 0; i < 3; ++i) sum[i] += c.sensing_matrix()[i * n + b] * r;
    }
    Real worst = 0;
    for (std::size_t i = 0; i < 3; ++i) worst = std::max(worst, std::fabs(sum[i] - static_cast<Real>(rgb[i])));
    return worst;
}

double linear(unsigned code) { return static_cast<double>(reference::srgb_to_linear(static_cast<Real>(code) / 255)); }

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

std::vector<double> random_colors(std::size_t n, unsigned seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> uniform(0, 1), exponent(-45, 0);
    std::vector<double> rgb(3 * n);
    for (std::size_t i = 0; i < n; ++i) {
        const auto kind = random() % 8;
        for (std::size_t k = 0; k < 3; ++k) {
            double& v = rgb[3 * i + k];
            v = uniform(random);
            if (kind < 2) v = random() % 3 == 0 ? 0 : random() % 2 == 0 ? 1 : v;  // faces, edges, corners
            if (kind == 2 && k > 0) v = rgb[3 * i];                               // greys
            if (kind == 3) v = static_cast<double>(static_cast<float>(v * std::pow(10.0, exponent(random))));  // near black
            if (kind == 4) v = 1 - v * 1e-6;                                      // near white
            if (kind == 5 && k > 0) v = std::clamp(rgb[3 * i] + (v - 0.5) * 1e-7, 0.0, 1.0);  // near grey
        }
    }
    return rgb;
}

TEST(Sigmoid, MatchesLongDoubleOnEveryTargetByteForByte) {
    std::mt19937_64 random(1);
    std::normal_distribution<double> normal(0, 1);
    for (const std::size_t bands : {3u, 8u, 36u, 81u, 401u}) {
        std::vector<double> t, c;
        for (std::size_t b = 0; b < bands; ++b) t.push_back(-1 + 2 * static_cast<double>(b) / static_cast<double>(bands - 1));
        for (int i = 0; i < 300; ++i) c.push_back(normal(random) * std::pow(10.0, static_cast<double>(random() % 8)));
        const double infinity = std::numeric_limits<double>::infinity(), nan = std::nan("");
        for (const double v : {infinity, -infinity, nan, 1e308, -1e308, 0.0})
            for (const double w : {infinity, -infinity, nan, 1e308, 0.0}) c.insert(c.end(), {v, w, -v});
        std::vector<double> expected(c.size() / 3 * bands), got(expected.size());
        kernels::evaluate_sigmoids_reference(c, t, expected);
        for (const double r : expected) ASSERT_TRUE(r >= 0 && r <= 1);
        for (std::size_t i = 0; i < 100; ++i)
            for (std::size_t b = 0; b < bands; ++b) {
                const double x = (c[3 * i] * t[b] + c[3 * i + 1]) * t[b] + c[3 * i + 2];
                const Real r = sigmoid(x);
                // Five roundings, of which the square root halves one.
                ASSERT_NEAR(static_cast<double>(expected[i * bands + b] / r), 1, 5 * 0x1p-52) << x;
            }
        on_every_target([&] {
            kernels::evaluate_sigmoids(c, t, got);
            EXPECT_EQ(std::memcmp(got.data(), expected.data(), got.size() * sizeof(double)), 0) << bands;
        });
    }
    EXPECT_EQ(kernels::sigmoid(-jakob2019::saturated), 0.0);
    EXPECT_EQ(kernels::sigmoid(jakob2019::saturated), 1.0);
    EXPECT_EQ(kernels::sigmoid(std::nan("")), 0.0);
    EXPECT_GT(kernels::sigmoid(-0x1p79), 0.0);
}

TEST(Jakob2019, CornersGreysAndLimits) {
    const auto c = colorimetry();
    const auto m = model("jakob2019", c);
    ASSERT_TRUE(m);
    EXPECT_TRUE(m->info().exact);
    EXPECT_EQ(m->coefficient_names(), (std::vector<std::string>{"c0", "c1", "c2"}));
    std::vector<double> r(c.bands().size());
    m->reflectance(std::vector<double>{0, 0, 0}, r);
    for (const double v : r) EXPECT_EQ(v, 0.0);
    m->reflectance(std::vector<double>{1, 1, 1}, r);
    for (const double v : r) EXPECT_EQ(v, 1.0);
    for (unsigned corner = 1; corner < 7; ++corner) {
        const Vector3 rgb{corner & 1 ? 1.0 : 0, corner & 2 ? 1.0 : 0, corner & 4 ? 1.0 : 0};
        Vector3 coefficients;
        m->coefficients(rgb, coefficients);
        // The kernel foresees at most 1e-12 of the largest component.
        EXPECT_LE(residual(c, coefficients.data(), rgb.data()), 1e-12) << corner;
        // The primaries lie inside the object-colour solid, so that no corner needs steep flanks.
        for (const double v : coefficients) EXPECT_LT(std::fabs(v), 50) << corner;
    }
    for (const double v : {1e-300, 1e-45, 1e-9, 1e-5, 0.1, 0.2, 0.5, 0.7, 0.999999, 1 - 0x1p-53}) {
        Vector3 coefficients;
        m->coefficients(Vector3{v, v, v}, coefficients);
        EXPECT_EQ(coefficients[0], 0.0);
        EXPECT_EQ(coefficients[1], 0.0);
        m->reflectance(Vector3{v, v, v}, r);
        // Flushed to zero below 2^-162; else the roundings of c2, which near white are those of 1 - v.
        for (const double x : r) EXPECT_NEAR(x, v, v < 0x1p-160 ? v : std::min(v, 1.0) * 8 * 0x1p-53);
    }
    // What is no colour is clamped, and NaN is 0.
    Vector3 a, b;
    m->coefficients(Vector3{2, -1, std::nan("")}, a);
    m->coefficients(Vector3{1, 0, 0}, b);
    EXPECT_EQ(a, b);
}

TEST(Jakob2019, SolvesRandomColoursOnEveryGrid) {
    for (const char* bands : {"380:780:5", "400:700:10", "16", "360:830:1"}) {
        SCOPED_TRACE(bands);
        const auto c = colorimetry(bands);
        const auto solver = jakob2019::Solver::shared(c);
        ASSERT_TRUE(jakob2019::reaches_all_corners(c));
        const auto rgb = random_colors(4000, 7);
        std::vector<double> out(rgb.size()), spectrum(c.bands().size());
        jakob2019::Counts counts;
        solver->solve(rgb, out, &counts);
        // Near-black purples rise towards both ends. Where the observer sees next to nothing of the last bands, at 830 nm, the
        // rise would have to end between two bands, and the search may stop short of it.
        const bool blind_ends = c.bands().back() > 800;
        EXPECT_LE(counts.nearest, blind_ends ? 40u : 0u);
        EXPECT_GT(counts.closed, 0u);
        EXPECT_GT(counts.damped, 0u);
        EXPECT_GT(counts.passes[0], 1000u);
        for (std::size_t i = 0; i < rgb.size(); i += 3) {
            const double z = std::max({rgb[i], rgb[i + 1], rgb[i + 2]});
            // The kernel foresees 1e-12 of the largest component and rounds sums of 1 + x y, 5e-15 on the finest grid; below
            // 1e-5 colours are solved relative to themselves, down to where tails are flushed to zero.
            const double bound = 2e-12 * z + (z >= 1e-5 ? 1e-14 : blind_ends && z < 1e-6 ? 1e-7 : 0x1p-160);
            ASSERT_LE(residual(c, &out[i], &rgb[i]), bound) << rgb[i] << ' ' << rgb[i + 1] << ' ' << rgb[i + 2];
            kernels::evaluate_sigmoids(std::span(out).subspan(i, 3), solver->nodes(), spectrum);
            for (const double r : spectrum) ASSERT_TRUE(r >= 0 && r <= 1);
        }
    }
}

TEST(Jakob2019, TheKernelAgreesWithDampedNewtonFromScratch) {
    const auto c = colorimetry();
    const auto solver = jakob2019::Solver::shared(c);
    const auto rgb = random_colors(500, 11);
    std::vector<double> out(rgb.size());
    solver->solve(rgb, out);
    for (std::size_t i = 0; i < rgb.size(); i += 3) {
        const auto alone = solver->solve_one({rgb[i], rgb[i + 1], rgb[i + 2]});
        ASSERT_TRUE(alone.reached) << rgb[i] << ' ' << rgb[i + 1] << ' ' << rgb[i + 2];
        const double largest = std::max({std::fabs(alone.c[0]), std::fabs(alone.c[1]), std::fabs(alone.c[2])});
        // 2e-12 in the colour times the condition of the equations, which near white (1 - rgb rounded to 1e-16 of colours
        // of 1e-7 and less) is lost with the digits of 1 - rgb.
        const double dark = std::min(std::max({rgb[i], rgb[i + 1], rgb[i + 2]}), 1 - std::min({rgb[i], rgb[i + 1], rgb[i + 2]}));
        for (std::size_t k = 0; k < 3; ++k)
            ASSERT_NEAR(out[i + k], alone.c[k], largest * (1e-8 + 1e-13 / std::max(dark, 1e-13)))
                << rgb[i] << ' ' << rgb[i + 1] << ' ' << rgb[i + 2];
    }
}

TEST(Jakob2019, BytesDependNeitherOnTheCutNorOnTheTarget) {
    const auto solver = jakob2019::Solver::shared(colorimetry());
    const auto rgb = random_colors(1500, 3);
    std::vector<double> whole(rgb.size()), parts(rgb.size());
    solver->solve(rgb, whole);
    on_every_target([&] {
        for (std::size_t begin = 0, size = 1; begin < rgb.size(); begin += size, size = 3 * (size % 71 + 1)) {
            size = std::min(size - size % 3 + (size < 3 ? 3 : 0), rgb.size() - begin);
            solver->solve(std::span(rgb).subspan(begin, size), std::span(parts).subspan(begin, size));
        }
        EXPECT_EQ(std::memcmp(parts.data(), whole.data(), parts.size() * sizeof(double)), 0);
    });
}

/// Differences of all sRGB codes after coefficients have been stored as floats.
struct Sweep {
    double mean = 0, max = 0;
    std::uint64_t changed = 0, out_of_range = 0;
};
Sweep sweep(const Model& m) {
    const auto& c = m.colorimetry();
    const std::size_t bands = c.bands().size();
    std::vector<double> lin(256);
    for (unsigned i = 0; i < 256; ++i) lin[i] = linear(i);
    constexpr std::size_t codes = std::size_t{1} << 24, chunk = 4096;
    const std::size_t used = (codes + code_stride - 1) / code_stride, chunks = (used + chunk - 1) / chunk;
    std::vector<Sweep> partial(chunks);
    const auto& a = c.sensing_matrix();
    std::vector<double> transposed(4 * bands);
    for (std::size_t b = 0; b < bands; ++b)
        for (std::size_t i = 0; i < 3; ++i) transposed[4 * b + i] = a[i * bands + b];
    const auto lab = [&](const Vector3& rgb) {
        const Vector3 xyz = c.rgb_to_xyz() * rgb, w = c.white_xyz();
        std::array<double, 3> f;
        for (std::size_t i = 0; i < 3; ++i) {
            const double t = xyz[i] / w[i];
            f[i] = t > 216.0 / 24389 ? std::cbrt(t) : t * 841 / 108 + 4.0 / 29;
        }
        return Vector3{116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])};
    };
    tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t k) {
        const std::size_t begin = k * chunk, n = std::min(chunk, used - begin);
        std::vector<double> rgb(3 * n), coefficients(3 * n), spectra(bands * n);
        std::vector<std::array<unsigned, 3>> code(n);
        for (std::size_t i = 0; i < n; ++i)
            for (unsigned j = 0; j < 3; ++j) {
                code[i][j] = static_cast<unsigned>((begin + i) * code_stride >> (8 * (2 - j))) & 255;
                rgb[3 * i + j] = lin[code[i][j]];
            }
        m.coefficients(rgb, coefficients);
        for (double& v : coefficients) v = static_cast<double>(static_cast<float>(v));
        m.reflectance_of_coefficients(coefficients, spectra);
        Sweep& s = partial[k];
        for (std::size_t i = 0; i < n; ++i) {
            Vector3 got{};
            bool inside = true;
            for (std::size_t b = 0; b < bands; ++b) {
                const double r = spectra[i * bands + b];
                inside = inside && r >= 0 && r <= 1;
                for (std::size_t j = 0; j < 3; ++j) got[j] += transposed[4 * b + j] * r;
            }
            s.out_of_range += !inside;
            const Vector3 p{rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]};
            const Vector3 x = lab(p), y = lab(got);
            const double d = std::sqrt((x[0] - y[0]) * (x[0] - y[0]) + (x[1] - y[1]) * (x[1] - y[1]) +
                                       (x[2] - y[2]) * (x[2] - y[2]));
            s.mean += d;
            s.max = std::max(s.max, d);
            for (std::size_t j = 0; j < 3; ++j) {
                // A code holds while the value stays between the encodings halfway to its neighbours.
                const auto edge = [](double v) { return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4); };
                const unsigned v = code[i][j];
                if ((v > 0 && got[j] < edge((v - 0.5) / 255)) || (v < 255 && got[j] > edge((v + 0.5) / 255))) {
                    ++s.changed;
                    break;
                }
            }
        }
    });
    Sweep total;
    for (const Sweep& s : partial) {
        total.mean += s.mean / static_cast<double>(used);
        total.max = std::max(total.max, s.max);
        total.changed += s.changed;
        total.out_of_range += s.out_of_range;
    }
    return total;
}

TEST(Jakob2019, EverySrgbCodeComesBack) {
    const auto s = sweep(*model("jakob2019", colorimetry()));
    RecordProperty("max", std::to_string(s.max));
    EXPECT_EQ(s.changed, 0u);
    EXPECT_EQ(s.out_of_range, 0u);
    // What the rounding to float leaves; measured 8.4e-5 at coefficients of 750 and a slope of Lab of 1800.
    EXPECT_LE(s.max, 1e-3);
}

TEST(Jakob2019Table, ErrsAsTheInterpolationDoes) {
    const auto m = model("jakob2019:table", colorimetry());
    EXPECT_FALSE(m->info().exact);
    const auto s = sweep(*m);
    EXPECT_EQ(s.out_of_range, 0u);
    // A well built table of 64^3 errs by 0.06 on average and 1.4 at most; a coarse or badly solved one errs by more, an
    // exact method by less.
    EXPECT_NEAR(s.mean, 0.058, 0.004);
    EXPECT_LT(s.max, 1.5);
    EXPECT_GT(s.max, code_stride == 1 ? 1.3 : 0.5);
}

TEST(Jakob2019, IsContinuousAlongLinesThroughTheCube) {
    const auto c = colorimetry();
    const auto solver = jakob2019::Solver::shared(c);
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> uniform(0, 1);
    const std::size_t bands = c.bands().size(), steps = 200;
    const auto largest_change = [&](double length) {
        double largest = 0;
        std::mt19937_64 again = random;
        for (int line = 0; line < 60; ++line) {
            Vector3 from{uniform(again), uniform(again), uniform(again)}, to{uniform(again), uniform(again), uniform(again)};
            // Across the diagonal plane at which colours are mirrored, across grey, and along a face.
            if (line % 4 == 1) from = {0.3, 0.5, 0.5}, to = {0.6, 0.5, 0.5};
            if (line % 4 == 2) from[0] = to[0] = 0;
            std::vector<double> rgb, out(3 * steps), spectra(bands * steps);
            for (std::size_t s = 0; s < steps; ++s)
                for (std::size_t k = 0; k < 3; ++k)
                    rgb.push_back(from[k] + (to[k] - from[k]) * (0.5 + (static_cast<double>(s) / steps - 0.5) * length));
            solver->solve(rgb, out);
            kernels::evaluate_sigmoids(out, solver->nodes(), spectra);
            for (std::size_t s = 1; s < steps; ++s)
                for (std::size_t b = 0; b < bands; ++b)
                    largest = std::max(largest, std::fabs(spectra[s * bands + b] - spectra[(s - 1) * bands + b]));
        }
        return largest;
    };
    // Steps a thousandth as long make changes a thousandth as large (the lines then cover less, so: no more than that with
    // room for the difference in slope); a jump would stay.
    const double coarse = largest_change(1), fine = largest_change(1e-3);
    EXPECT_LT(fine, 5e-3 * coarse);
    EXPECT_GT(fine, 0);
}

TEST(Jakob2019, ColoursBeyondTheSolidGetTheNearestSigmoid) {
#if defined(__SANITIZE_THREAD__)
    GTEST_SKIP() << "the whole table takes minutes here; CoefficientTable's tests make a small one by the same loop";
#endif
    const auto c = colorimetry("380:780:5", "Rec.2020");
    const auto m = model("jakob2019", c);
    ASSERT_TRUE(m);
    EXPECT_FALSE(m->info().exact);
    std::vector<double> r(c.bands().size());
    std::mt19937_64 random(9);
    const Vector3 red{1, 0, 0};
    Vector3 best;
    m->coefficients(red, best);
    m->reflectance(red, r);
    for (const double v : r) ASSERT_TRUE(v >= 0 && v <= 1);
    const auto distance = [&](const Vector3& coefficients) {
        std::vector<double> spectrum(c.bands().size());
        m->reflectance_of_coefficients(coefficients, spectrum);
        const auto f = [](double t) { return t > 216.0 / 24389 ? std::cbrt(t) : t * 841 / 108 + 4.0 / 29; };
        const Vector3 x = c.rgb_to_xyz() * c.rgb_of(spectrum), y = c.rgb_to_xyz() * red, w = c.white_xyz();
        std::array<double, 3> d;
        for (std::size_t i = 0; i < 3; ++i) d[i] = f(x[i] / w[i]) - f(y[i] / w[i]);
        return std::hypot(116 * d[1], 500 * (d[0] - d[1]), 200 * (d[1] - d[2]));
    };
    const double reached = distance(best);
    EXPECT_GT(reached, 0.1);
    std::normal_distribution<double> normal(0, 1);
    for (int trial = 0; trial < 2000; ++trial) {
        // Around the answer, and everywhere.
        Vector3 near = best;
        for (double& v : near) v = trial % 2 ? v * (1 + 0.02 * normal(random)) : 100 * normal(random);
        // The search stops where a step gains less than 1e-10 of the squared distance, or after 60 steps in a flat valley.
        EXPECT_GE(distance(near), reached * (1 - 2e-2));
    }
}

TEST(Jakob2019, WorksWithTheStandardsMatrix) {
    const auto c = colorimetry("380:780:5", "BT.709", RgbMatrix::standard);
    const auto m = model("jakob2019", c);
    ASSERT_TRUE(m);
    const auto rgb = random_colors(300, 21);
    std::vector<double> r(c.bands().size() * 300);
    m->reflectance(rgb, r);
    for (const double v : r) ASSERT_TRUE(v >= 0 && v <= 1);
    Vector3 coefficients;
    const Vector3 grey{0.5, 0.5, 0.5};
    m->coefficients(grey, coefficients);
    EXPECT_LE(residual(c, coefficients.data(), grey.data()), 1e-12);
}

TEST(Jakob2019, JsonBringsTheModelBackWithoutASolve) {
    for (const char* id : {"jakob2019", "jakob2019:table"}) {
        const auto m = model(id, colorimetry("400:700:10"));
        const auto again = make_model_from_json(m->to_json());
        ASSERT_TRUE(again) << again.error().message;
        EXPECT_EQ((*again)->info().id, id);
        EXPECT_EQ((*again)->info().exact, m->info().exact);
        const auto rgb = random_colors(50, 2);
        std::vector<double> c(rgb.size()), d(rgb.size()), r(50 * 31), s(50 * 31);
        m->coefficients(rgb, c);
        m->reflectance(rgb, r);
        (*again)->reflectance_of_coefficients(c, s);
        EXPECT_EQ(r, s);
        (*again)->coefficients(rgb, d);
        EXPECT_EQ(c, d);
        std::string text = m->to_json();
        const auto at = text.find("580");
        ASSERT_NE(at, std::string::npos);
        EXPECT_FALSE(make_model_from_json(text.replace(at, 3, "560")));
    }
    auto text = model("jakob2019", colorimetry())->to_json();
    const auto at = text.find("\"sigmoid\"");
    ASSERT_NE(at, std::string::npos);
    EXPECT_FALSE(make_model_from_json(text.replace(at, 9, "\"sigmoit\"")));
}

TEST(CoefficientTable, RoundTripsAndHoldsItsVertices) {
    const auto c = colorimetry();
    const auto made = make_coefficient_table(c, 16);
    ASSERT_TRUE(made);
    const auto path = std::filesystem::temp_directory_path() / ("spectex-jakob2019-" + std::to_string(::getpid()) + ".coeff");
    ASSERT_TRUE(write_coefficient_table(*made, path.string()));
    EXPECT_EQ(std::filesystem::file_size(path), 8 + 4 * (16 + 9 * 16 * 16 * 16u));
    const auto again = read_coefficient_table(path.string());
    std::filesystem::remove(path);
    ASSERT_TRUE(again) << again.error().message;
    EXPECT_EQ(again->scale, made->scale);
    EXPECT_EQ(again->data, made->data);
    EXPECT_FALSE(read_coefficient_table(path.string()));

    // Vertices are met exactly but for the rounding to float of coefficients in nm, whose terms cancel; measured 9e-6.
    Real worst = 0;
    for (const Vector3 step : {Vector3{1, 0, 0}, {0.2, 1, 0.6}, {0, 1, 1}, {0.4, 0.8, 1}, {1, 1, 0}})
        for (std::size_t k = 1; k < 16; ++k) {
            const Vector3 rgb{step[0] * made->scale[k], step[1] * made->scale[k], step[2] * made->scale[k]};
            const Vector3 nm = made->fetch(rgb);
            const Vector3 t{nm[0] * 4e4, (2 * 580 * nm[0] + nm[1]) * 200, (nm[0] * 580 + nm[1]) * 580 + nm[2]};
            worst = std::max(worst, residual(c, t.data(), rgb.data()));
        }
    EXPECT_LT(static_cast<double>(worst), 5e-5);
    for (const Vector3& rgb : {Vector3{0, 0, 0}, {1, 1, 1}, {std::nan(""), -1, 2}, {1e-40, 0, 0}})
        for (const double v : made->fetch(rgb)) EXPECT_TRUE(std::isfinite(v));
    EXPECT_FALSE(make_coefficient_table(c, 1));
    EXPECT_FALSE(make_coefficient_table(c, 257));
}

TEST(CoefficientTable, RefusesWhatIsNoTable) {
    CoefficientTable small;
    small.resolution = 2;
    small.scale = {0, 1};
    small.data.assign(9 * 8, 0.5f);
    const std::string good = coefficient_table_bytes(small);
    ASSERT_TRUE(parse_coefficient_table(good, "good"));
    const auto refused = [&](std::string bytes, const char* says) {
        const auto parsed = parse_coefficient_table(bytes, "hostile.coeff");
        ASSERT_FALSE(parsed) << says;
        EXPECT_EQ(parsed.error().kind, ErrorKind::input);
        EXPECT_NE(parsed.error().message.find("hostile.coeff"), std::string::npos);
        EXPECT_NE(parsed.error().message.find(says), std::string::npos) << parsed.error().message;
    };
    const auto with = [&](std::size_t at, auto value) {
        std::string bytes = good;
        std::memcpy(bytes.data() + at, &value, sizeof value);
        return bytes;
    };
    refused("", "SPEC");
    refused("SPE", "SPEC");
    refused("SPEC", "SPEC");
    refused(with(0, 'X'), "SPEC");
    for (const std::uint32_t resolution : {0u, 1u, 257u, 0x80000000u, 0xffffffffu}) refused(with(4, resolution), "resolution");
    refused(with(4, std::uint32_t{3}), "bytes");
    refused(good + "x", "bytes");
    for (std::size_t cut = 8; cut < good.size(); cut += 7) refused(good.substr(0, cut), "bytes");
    const float nan = std::nanf(""), infinity = std::numeric_limits<float>::infinity();
    for (const float v : {nan, infinity, -1.0f, 1.0f, 2.0f}) refused(with(8, v), "scale[");
    for (const float v : {nan, infinity, -infinity}) refused(with(16 + 4 * 71, v), "data[71]");
}

}  // namespace
}  // namespace spectex
