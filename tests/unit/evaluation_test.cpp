// How methods are measured, against sums of our own and against models whose faults are known.
#include "spectex/evaluation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <set>

#include "method_checks.h"
#include "reference.h"
#include "spectex/color.h"
#include "spectex/solvers.h"
#include "spectex/stability.h"

namespace {

using namespace spectex;

#if defined(SPECTEX_SLOW_BUILD)
constexpr bool slow = true;
#else
constexpr bool slow = false;
#endif

/// A method whose spectrum is any function of the colour.
class Shaped : public Model {
public:
    using Shape = double (*)(const Vector3& rgb);
    Shaped(const Colorimetry& c, Shape shape) : Model({.id = "shaped", .title = "", .source = ""}, c), shape_(shape) {}
    void reflectance(std::span<const double> rgb, std::span<double> out) const override {
        const std::size_t bands = colorimetry().bands().size();
        for (std::size_t i = 0; i * bands < out.size(); ++i)
            for (std::size_t b = 0; b < bands; ++b)
                out[i * bands + b] = b == 3 ? shape_({rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]}) : 0;
    }
    std::string to_json() const override { return "{}"; }

private:
    Shape shape_;
};

// CIE 142-2001 in long double, written from the standard's equations.
reference::Real delta_e2000(const reference::Vec3& p, const reference::Vec3& q) {
    using R = reference::Real;
    const R pi = std::acos(R(-1)), deg = pi / 180;
    const auto seventh = [](R c) { return std::sqrt(std::pow(c, R(7)) / (std::pow(c, R(7)) + std::pow(R(25), R(7)))); };
    const R g = (1 - seventh((std::hypot(p[1], p[2]) + std::hypot(q[1], q[2])) / 2)) / 2;
    const R a1 = (1 + g) * p[1], a2 = (1 + g) * q[1], c1 = std::hypot(a1, p[2]), c2 = std::hypot(a2, q[2]);
    const auto hue = [&](R a, R b) { return a == 0 && b == 0 ? R(0) : std::fmod(std::atan2(b, a) / deg + 360, R(360)); };
    const R h1 = hue(a1, p[2]), h2 = hue(a2, q[2]);
    R dh = h2 - h1, mean = (h1 + h2) / 2;
    if (c1 * c2 == 0) dh = 0, mean = h1 + h2;
    else if (dh > 180) dh -= 360, mean = h1 + h2 < 360 ? mean + 180 : mean - 180;
    else if (dh < -180) dh += 360, mean = h1 + h2 < 360 ? mean + 180 : mean - 180;
    const R dl = q[0] - p[0], dc = c2 - c1, dhh = 2 * std::sqrt(c1 * c2) * std::sin(dh / 2 * deg);
    const R l = (p[0] + q[0]) / 2, c = (c1 + c2) / 2;
    const R t = 1 - 0.17L * std::cos((mean - 30) * deg) + 0.24L * std::cos(2 * mean * deg) + 0.32L * std::cos((3 * mean + 6) * deg) -
                0.20L * std::cos((4 * mean - 63) * deg);
    const R sl = 1 + 0.015L * (l - 50) * (l - 50) / std::sqrt(20 + (l - 50) * (l - 50)), sc = 1 + 0.045L * c, sh = 1 + 0.015L * c * t;
    const R turn = -2 * seventh(c) * std::sin(60 * deg * std::exp(-((mean - 275) / 25) * ((mean - 275) / 25)));
    return std::sqrt(dl / sl * (dl / sl) + dc / sc * (dc / sc) + dhh / sh * (dhh / sh) + turn * (dc / sc) * (dhh / sh));
}

std::vector<double> wavelengths(const Colorimetry& c) {
    return {c.bands().wavelengths_nm().begin(), c.bands().wavelengths_nm().end()};
}

/// Broad bumps: pigments of no particular kind, all inside the cube.
SampleSet bumps(const Colorimetry& c, std::string name, double offset) {
    SampleSet set{std::move(name), wavelengths(c), {}};
    for (double centre = 430 + offset; centre < 700; centre += 40) {
        std::vector<double> r;
        for (const double nm : set.wavelengths_nm) r.push_back(0.15 + 0.5 * std::exp(-(nm - centre) * (nm - centre) / 4000));
        set.samples.push_back(r);
    }
    return set;
}

std::vector<Illuminant> lamps(std::initializer_list<const char*> names) {
    std::vector<Illuminant> out;
    for (const char* name : names) out.push_back(parse_illuminant(name).value());
    return out;
}

TEST(Accuracy, IsThatOfSumsOfOurOwn) {
    const auto c = method_checks::colorimetry();
    const auto set = bumps(c, "bumps", 0);
    const auto report = measure_accuracy(c, {.methods = {"mallett2019"}, .sets = {set}, .unseen = {}, .lamps = {}, .probes = lamps({"A"})});
    ASSERT_TRUE(report) << report.error().message;
    ASSERT_EQ(report->rows.size(), 1u);
    EXPECT_EQ(report->rows[0].samples, set.samples.size());

    // Bands are joined by lines, and light A is Planck's at its old constants: CIE 15, 4.1.
    using R = reference::Real;
    const std::string cie = std::string(SPECTEX_LUTS_SOURCE) + "/cie";
    const auto cmf = reference::read_csv(cie + "/cie1931_2deg_360-830-1.csv");
    reference::Light a{cmf.nm, {}};
    for (const R nm : cmf.nm) {
        const R c2 = 1.435e7L, t = 2848;
        a.power.push_back(100 * std::pow(560 / nm, R(5)) * std::expm1(c2 / (t * 560)) / std::expm1(c2 / (t * nm)));
    }
    const auto model = method_checks::model("mallett2019", c);
    const auto bands = wavelengths(c);
    const auto lab = [&](const std::vector<double>& r) {
        const std::vector<R> nm(bands.begin(), bands.end()), values(r.begin(), r.end());
        const int first = static_cast<int>(bands.front()), last = static_cast<int>(bands.back());
        const auto white = reference::xyz(cmf, a, first, last, [](R) { return R(1); });
        return reference::lab(reference::xyz(cmf, a, first, last, [&](R at) { return reference::interpolate(nm, values, at); }), white);
    };
    R sum = 0, rms = 0, most = 0;
    for (const auto& sample : set.samples) {
        const auto ours = method_checks::spectrum(*model, c.rgb_of(sample));
        const R d = delta_e2000(lab(sample), lab(ours));
        sum += d, most = std::max(most, d);
        R squares = 0;
        for (std::size_t b = 0; b < bands.size(); ++b) squares += R(ours[b] - sample[b]) * R(ours[b] - sample[b]);
        rms += std::sqrt(squares / R(bands.size()));
    }
    const R n = static_cast<R>(set.samples.size());
    // Rounding alone: some hundred operations in double on numbers of about one.
    EXPECT_NEAR(report->rows[0].mean, double(sum / n), 1e-10);
    EXPECT_NEAR(report->rows[0].rms, double(rms / n), 1e-12);
    // Seven samples: the nearest rank of 95 % is the last.
    EXPECT_NEAR(report->rows[0].p95, double(most), 1e-10);
    ASSERT_EQ(report->rows[0].mean_under.size(), 1u);
    EXPECT_NEAR(report->rows[0].mean_under[0], double(sum / n), 1e-10);
    EXPECT_GT(report->rows[0].mean, 0.5) << "bumps are no combinations of three spectra";
}

TEST(Accuracy, IsPerfectOnAMethodsOwnSpectra) {
    const auto c = method_checks::colorimetry();
    for (const std::string id : {"mallett2019", "smits1999:exact", "jakob2019"}) {
        if (slow && id == "jakob2019") continue;
        const auto model = method_checks::model(id, c);
        SampleSet own{"own", wavelengths(c), {}};
        for (const Vector3 rgb : {Vector3{0.2, 0.4, 0.1}, Vector3{0.9, 0.3, 0.25}, Vector3{0.02, 0.05, 0.3}})
            own.samples.push_back(method_checks::spectrum(*model, rgb));
        const auto report = measure_accuracy(c, {.methods = {id}, .sets = {own}, .unseen = {}, .lamps = lamps({"FL11", "lamp:7"}), .probes = {}});
        ASSERT_TRUE(report) << report.error().message;
        EXPECT_EQ(report->lamps, 2u);
        EXPECT_LT(report->rows[0].mean, 1e-9) << id;  // rounding, as the solve of a colour leaves it
    }
}

TEST(Accuracy, NeverTrainsOnWhatItPredicts) {
    if (slow) GTEST_SKIP() << "solves the lattice";
    const auto c = method_checks::colorimetry();
    auto all = lattice_sample_sets().value();
    all.erase(all.begin(), all.end() - 3);
    SampleSet left = all.back();
    const std::vector<SampleSet> others(all.begin(), all.end() - 1);
    SampleSet renamed = left;
    renamed.name = "unseen";
    const auto few = lamps({"FL11", "A"});
    const auto measured = [&](std::vector<SampleSet> sets, std::vector<SampleSet> unseen) {
        auto report = measure_accuracy(c, {.methods = {"lattice"}, .sets = std::move(sets), .unseen = std::move(unseen), .lamps = few, .probes = {}});
        EXPECT_TRUE(report) << report.error().message;
        return report->rows.back().mean;
    };
    const double left_out = measured(all, {}), unseen = measured(others, {renamed});
    EXPECT_EQ(left_out, unseen);
    // Trained on itself it does better, or nothing was learnt.
    EXPECT_GT(left_out, 1.05 * measured(all, {renamed}));
}

TEST(Accuracy, OfTheLatticeBeatsTheOthersOnEverySet) {
    if (slow) GTEST_SKIP() << "solves the lattice";
    const auto c = method_checks::colorimetry();
    AccuracyOptions options{.methods = {"lattice"}, .sets = lattice_sample_sets().value(), .unseen = {}, .lamps = {}, .probes = {}};
    const std::vector<std::pair<std::string, double>> rivals{{"jakob2019", 0.70}, {"otsu2018", 0.88}};
    for (const auto& [id, ratio] : rivals)
        if (find_method(id)) options.methods.push_back(id);
    // All lamps take four times as long and move no ratio by 1 %.
    for (int i = 1; i <= 401; i += 4) options.lamps.push_back(parse_illuminant("lamp:" + std::to_string(i)).value());
    const auto report = measure_accuracy(c, options);
    ASSERT_TRUE(report) << report.error().message;
    const std::size_t sets = options.sets.size();
    const auto mean = [&](std::size_t method) {
        double sum = 0;
        for (std::size_t s = 0; s < sets; ++s) sum += report->rows[method * sets + s].mean;
        return sum / static_cast<double>(sets);
    };
    for (std::size_t m = 1; m < options.methods.size(); ++m) {
        const auto rival = std::find_if(rivals.begin(), rivals.end(), [&](const auto& r) { return r.first == options.methods[m]; });
        EXPECT_LT(mean(0), rival->second * mean(m)) << options.methods[m];
        for (std::size_t s = 0; s < sets; ++s)
            EXPECT_LT(report->rows[s].mean, report->rows[m * sets + s].mean) << options.methods[m] << " on " << report->rows[s].set;
    }
}

TEST(Accuracy, RefusesWhatItCannotMeasure) {
    const auto c = method_checks::colorimetry();
    const auto set = bumps(c, "bumps", 0);
    SampleSet outside{"outside", wavelengths(c), {std::vector<double>(c.bands().size(), 0)}};
    for (std::size_t b = 0; b < c.bands().size(); ++b) outside.samples[0][b] = c.bands()[b] > 505 && c.bands()[b] < 525;
    const auto refused = [&](const AccuracyOptions& options) {
        const auto report = measure_accuracy(c, options);
        EXPECT_FALSE(report);
        return report ? std::string() : report.error().message;
    };
    const auto light = lamps({"A"});
    EXPECT_NE(refused({.methods = {}, .sets = {set}, .unseen = {}, .lamps = light, .probes = {}}), "");
    EXPECT_NE(refused({.methods = {"mallett2019"}, .sets = {set}, .unseen = {}, .lamps = {}, .probes = {}}), "");
    EXPECT_NE(refused({.methods = {"mallett2019"}, .sets = {set, set}, .unseen = {}, .lamps = light, .probes = {}}).find("bumps"), std::string::npos);
    EXPECT_NE(refused({.methods = {"mallett2019"}, .sets = {outside}, .unseen = {}, .lamps = light, .probes = {}}).find("outside: no sample"),
              std::string::npos);
    EXPECT_NE(refused({.methods = {"no such"}, .sets = {set}, .unseen = {}, .lamps = light, .probes = {}}).find("no such"), std::string::npos);
}

TEST(SmoothnessOfColour, FindsTheLargestStepAndJumps) {
    const auto c = method_checks::colorimetry("400:700:20");
    // Linear in green's code alone: every step along green is one code.
    const Shaped smooth(c, [](const Vector3& rgb) { return srgb_encode(rgb[1]); });
    const auto even = measure_smoothness(smooth, 20, 1);
    EXPECT_NEAR(even.max, 1 / 255.0, 1e-12);
    EXPECT_LT(even.jump, 1 / 255.0 / 1000);  // 2^-10 of a step
    EXPECT_LE(even.mean, even.p99);
    EXPECT_LE(even.p99, even.max);

    // A steep ramp around code 100.5 is steep, but no jump.
    const Shaped steep(c, [](const Vector3& rgb) { return std::clamp(4 * (255 * srgb_encode(rgb[1]) - 100.5), 0.0, 1.0); });
    const auto ramp = measure_smoothness(steep, 20, 1);
    EXPECT_NEAR(ramp.max, 1, 1e-12);
    EXPECT_NEAR(ramp.max_at[1], 100, 1.0);
    EXPECT_LT(ramp.jump, 4.0 / 1000);

    const Shaped broken(c, [](const Vector3& rgb) { return srgb_encode(rgb[1]) + (rgb[0] > rgb[2] ? 0.125 : 0.0); });
    const auto jump = measure_smoothness(broken, 20, 1);
    EXPECT_NEAR(jump.jump, 0.125, 1e-4);  // 2^-10 of a step remains
    const auto again = measure_smoothness(broken, 20, 1);
    EXPECT_EQ(jump.max, again.max);
    EXPECT_EQ(jump.max_at, again.max_at);
    EXPECT_NE(measure_smoothness(broken, 20, 2).mean, jump.mean) << "the seed moves the lines";

    const Shaped lost(c, [](const Vector3& rgb) { return rgb[1] > 0.9 ? std::nan("") : 0.0; });
    EXPECT_TRUE(std::isinf(measure_smoothness(lost, 0, 1).max)) << "a spectrum that is no number is the worst of steps";
}

TEST(RoundTrip, IsExactForExactMethodsAndCountsWhatLeavesTheRange) {
    const auto c = method_checks::colorimetry("380:780:10");
    constexpr std::uint32_t stride = slow ? 65521 : 1021;  // primes, so that every value of every component comes up
    const auto exact = measure_roundtrip(method_checks::model("mallett2019", c), Store::spectral, PixelType::float32, stride, 2);
    ASSERT_TRUE(exact) << exact.error().message;
    EXPECT_EQ(exact->pixels, ((1u << 24) + stride - 1) / stride);
    EXPECT_EQ(exact->difference.pixels, exact->pixels);
    EXPECT_EQ(exact->channels, 41u);
    EXPECT_EQ(exact->difference.changed_codes, 0u);
    EXPECT_EQ(exact->outside, 0u);
    EXPECT_LT(exact->difference.max, 1e-4);  // floats of 24 bits
    EXPECT_GT(exact->difference.max, 0);

    const auto classic = measure_roundtrip(method_checks::model("smits1999", c), Store::spectral, PixelType::float32, stride, 2);
    ASSERT_TRUE(classic);
    EXPECT_GT(classic->outside, 0u) << "Smits' spectra exceed 1";
    EXPECT_GT(classic->difference.changed_codes, classic->pixels / 2);
    // The worst code, done again by itself.
    const auto at = classic->difference.max_at;
    const unsigned code[3] = {unsigned(at[0]), unsigned(at[1]) >> 8, unsigned(at[1]) & 255};
    EXPECT_EQ((code[0] * 65536 + code[1] * 256 + code[2]) % stride, 0u);
    Vector3 rgb;
    for (std::size_t i = 0; i < 3; ++i) rgb[i] = srgb_decode(code[i] / 255.0);
    const auto back = c.rgb_of(method_checks::spectrum(*method_checks::model("smits1999", c), rgb));
    const auto lab = [&](const Vector3& v) {
        reference::Vec3 xyz{}, white{};
        for (std::size_t i = 0; i < 3; ++i) {
            white[i] = c.white_xyz()[i];
            for (std::size_t j = 0; j < 3; ++j) xyz[i] += reference::Real(c.rgb_to_xyz()(i, j)) * v[j];
        }
        return reference::lab(xyz, white);
    };
    EXPECT_NEAR(classic->difference.max, double(reference::delta_e76(lab(rgb), lab(back))), 1e-4);
    // Threads add nothing but time.
    const auto single = measure_roundtrip(method_checks::model("smits1999", c), Store::spectral, PixelType::float32, stride, 1);
    EXPECT_EQ(single->difference.mean, classic->difference.mean);
    EXPECT_EQ(single->difference.max_at, classic->difference.max_at);
}

GamutRendering rendered(std::vector<std::string> methods, int bits, int samples, int panel, int threads = 0, std::uint64_t seed = 1) {
    GamutRenderingOptions options;
    options.methods = std::move(methods);
    options.bits = bits, options.samples_per_pixel = samples, options.panel = panel, options.threads = threads, options.seed = seed;
    auto made = render_gamut(method_checks::colorimetry(), options);
    EXPECT_TRUE(made) << made.error().message;
    return *std::move(made);
}

TEST(Gamut, HoldsEveryColourOnce) {
    for (const auto& [bits, width] : {std::pair{2, 8}, {4, 64}, {6, 512}}) {
        if (slow && bits == 6) continue;
        const auto r = rendered({"mallett2019"}, bits, 1, width);
        const double last = (1 << bits) - 1;
        std::set<std::array<int, 3>> codes;
        for (std::size_t i = 0; i < r.truth.size(); i += 3) {
            std::array<int, 3> code{};
            for (std::size_t c = 0; c < 3; ++c) {
                const double v = last * srgb_encode(static_cast<double>(r.truth[i + c]));
                code[c] = static_cast<int>(std::lround(v));
                // Floats of linear light, at the steepest place of the curve.
                ASSERT_NEAR(v, code[c], 1e-3);
            }
            codes.insert(code);
        }
        EXPECT_EQ(codes.size(), std::size_t{1} << (3 * bits));
        EXPECT_EQ(r.texels, codes.size());
    }
}

TEST(Gamut, NoiseFallsWithTheRootOfTheSamplesAndExactMethodsHaveNoDistortion) {
    const auto few = rendered({"mallett2019", "smits1999"}, 4, 64, 32), many = rendered({"mallett2019", "smits1999"}, 4, 1024, 32);
    for (std::size_t m = 0; m < 2; ++m) {
        // Lab is curved, so a half of a half is not quite a quarter; a bias would leave a floor.
        EXPECT_NEAR(few.methods[m].noise.mean / many.methods[m].noise.mean, 4, 0.4);
        EXPECT_GT(many.methods[m].noise.mean, 0.1);
        EXPECT_EQ(few.methods[m].distortion.mean, many.methods[m].distortion.mean) << "no samples in it";
    }
    EXPECT_LT(few.methods[0].distortion.max, 1e-5);  // of planes of floats
    EXPECT_GT(few.methods[1].distortion.mean, 1);
    // What a map shows is what the figures say.
    for (const auto& method : few.methods) {
        const auto mean = [](const std::vector<float>& v) { return std::accumulate(v.begin(), v.end(), 0.0) / static_cast<double>(v.size()); };
        EXPECT_NEAR(mean(method.noise_map), method.noise.mean, 1e-5 * method.noise.mean);
        EXPECT_NEAR(mean(method.distortion_map), method.distortion.mean, 1e-5 * method.distortion.mean + 1e-12);
    }
}

TEST(Gamut, ConvergesToTheContractsQuadrature) {
    // 64 texels, two million wavelengths each: the standard error of a channel is near 0.001.
    const auto r = rendered({"lattice"}, 2, slow ? 20000 : 500000, 8);
    for (std::size_t i = 0; i < r.truth.size(); ++i)
        EXPECT_NEAR(r.methods[0].rendering[i], r.truth[i], slow ? 0.03 : 0.006) << i;
}

TEST(Gamut, DependsOnTheSeedAndNotOnThreads) {
    const auto one = rendered({"jakob2019"}, 4, 4, 50, 1), two = rendered({"jakob2019"}, 4, 4, 50, 2), other = rendered({"jakob2019"}, 4, 4, 50, 2, 7);
    EXPECT_EQ(one.methods[0].rendering, two.methods[0].rendering);
    EXPECT_EQ(one.methods[0].noise_map, two.methods[0].noise_map);
    EXPECT_EQ(one.methods[0].noise.mean, two.methods[0].noise.mean);
    EXPECT_NE(one.methods[0].rendering, other.methods[0].rendering);
    EXPECT_EQ(one.methods[0].distortion_map, other.methods[0].distortion_map);
}

TEST(Gamut, RefusesWhatItCannotRender) {
    const auto c = method_checks::colorimetry();
    const auto refused = [&](auto change) {
        GamutRenderingOptions options;
        options.methods = {"mallett2019"};
        options.bits = 2;
        change(options);
        return !render_gamut(c, options);
    };
    EXPECT_FALSE(refused([](auto&) {}));
    EXPECT_TRUE(refused([](auto& o) { o.methods.clear(); }));
    EXPECT_TRUE(refused([](auto& o) { o.methods = {"none such"}; }));
    EXPECT_TRUE(refused([](auto& o) { o.bits = 3; }));
    EXPECT_TRUE(refused([](auto& o) { o.bits = 10; }));
    EXPECT_TRUE(refused([](auto& o) { o.samples_per_pixel = 0; }));
    EXPECT_TRUE(refused([](auto& o) { o.panel = 0; }));
}

TEST(Pareto, FrontIsWhatNothingBeats) {
    const std::vector<std::array<double, 2>> points{{3, 1}, {1, 4}, {2, 4}, {2, 2}, {3, 1}, {4, 0.5}, {5, 3}, {1, 5}};
    const auto front = pareto_front(points);
    EXPECT_EQ(front, (std::vector<std::size_t>{1, 3, 0, 5}));
    EXPECT_TRUE(pareto_front({}).empty());
}

class Stability : public testing::TestWithParam<std::string> {};

// At a size that fits: spxbench stability runs the same over every code and as many colours as one likes.
TEST_P(Stability, EveryBoundHolds) {
#if defined(__SANITIZE_THREAD__)
    if (GetParam() == "solvers") GTEST_SKIP() << "jakob2019 in Rec.2020 makes its whole table, which takes minutes here";
#endif
    StabilityOptions options;
    options.groups = {GetParam()};
    options.stride = slow ? 1000003 : 65537;
    options.colors = slow ? 500 : 8000;
    options.adversaries = slow ? 257 : 17;
    const auto report = measure_stability(method_checks::colorimetry("380:780:10"), options);
    ASSERT_TRUE(report) << report.error().message;
    ASSERT_FALSE(report->rows.empty());
    for (const auto& r : report->rows) {
        EXPECT_TRUE(r.kept()) << r.path << ": " << r.worst << " " << r.unit << " at " << r.worst_at << " (bound " << r.most << "), CIE76 " << r.delta_e << " at "
                              << r.delta_e_at << " (bound " << r.most_delta_e << "), " << r.broken << " broken, first " << r.broken_at;
        EXPECT_GT(r.cases, 0u) << r.path;
        EXPECT_FALSE(r.reason.empty()) << r.path;
        EXPECT_TRUE(std::isfinite(r.most) || std::isfinite(r.most_delta_e)) << r.path << " has no bound";
    }
}

INSTANTIATE_TEST_SUITE_P(Groups, Stability, testing::ValuesIn(stability_groups()), [](const auto& info) { return info.param; });

}  // namespace
