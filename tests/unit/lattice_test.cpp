#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <random>

#include "reference.h"
#include "solvers/lattice.h"
#include "solvers/quadratic_programme.h"
#include "spectex/methods.h"
#include "spectex/plan.h"
#include "spectex/solvers.h"

namespace spectex {
namespace {

using reference::Real;
using Json = nlohmann::ordered_json;

Colorimetry colorimetry(const std::string& bands = "380:780:5", const ColorimetrySpec& spec = {}) {
    return Colorimetry::make(spec, BandSet::parse(bands).value()).value();
}

std::shared_ptr<const Model> model(const Colorimetry& c) {
    auto made = make_model("lattice", c);
    EXPECT_TRUE(made) << made.error().message;
    return made ? *made : nullptr;
}

std::vector<double> spectrum(const Model& m, const Vector3& rgb) {
    std::vector<double> out(m.colorimetry().bands().size());
    m.reflectance(rgb, out);
    return out;
}

/// Largest |A r - rgb| in long double.
double residual(const Colorimetry& c, std::span<const double> r, const Vector3& rgb) {
    const auto& a = c.sensing_matrix();
    Real worst = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        Real sum = -rgb[k];
        for (std::size_t l = 0; l < r.size(); ++l) sum += static_cast<Real>(a[k * r.size() + l]) * r[l];
        worst = std::max(worst, std::abs(sum));
    }
    return static_cast<double>(worst);
}

bool bounded(const std::vector<double>& r) {
    return std::all_of(r.begin(), r.end(), [](double v) { return v >= 0 && v <= 1; });
}

struct Case {
    const char* bands;
    ColorimetrySpec spec;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.bands << ' ' << c.spec.observer << ' ' << c.spec.illuminant; }

class Lattices : public testing::TestWithParam<Case> {
protected:
    /// Made once for all tests: where no table is shipped, every vertex is solved.
    static std::shared_ptr<const Model> lattice() {
        static std::map<std::string, std::shared_ptr<const Model>> made;
        const auto& [bands, spec] = GetParam();
        auto& m = made[std::string(bands) + ' ' + spec.observer + ' ' + spec.illuminant + ' ' + spec.rgb_space];
        if (!m) m = model(colorimetry(bands, spec));
        return m;
    }
};

TEST_P(Lattices, AreExactAndBoundedAtVerticesAndBetween) {
    const auto c = colorimetry(GetParam().bands, GetParam().spec);
    const auto m = lattice();
    ASSERT_TRUE(m);
    EXPECT_EQ(m->info().pieces, Pieces::tetrahedral);
    EXPECT_EQ(m->basis(), nullptr);
    const LatticeTable* table = m->lattice();
    ASSERT_NE(table, nullptr);
    ASSERT_EQ(table->values, c.bands().size());
    const std::size_t n = table->knots[0].size();
    ASSERT_EQ(table->vertices.size(), n * n * n * table->values);

    for (const double r : spectrum(*m, {0, 0, 0})) EXPECT_EQ(r, 0.0);
    for (const double r : spectrum(*m, {1, 1, 1})) EXPECT_EQ(r, 1.0);
    double at_vertices = 0;
    for (std::size_t i = 0; i < n * n * n; ++i) {
        const Vector3 rgb{table->knots[0][i / (n * n)], table->knots[1][i / n % n], table->knots[2][i % n]};
        const std::vector<double> stored(table->vertices.begin() + static_cast<std::ptrdiff_t>(i * table->values),
                                         table->vertices.begin() + static_cast<std::ptrdiff_t>((i + 1) * table->values));
        ASSERT_TRUE(bounded(stored)) << i;
        EXPECT_EQ(spectrum(*m, rgb), stored) << i;
        at_vertices = std::max(at_vertices, residual(c, stored, rgb));
    }
    EXPECT_LE(at_vertices, 1e-13) << "what the solver promises";
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::uniform_int_distribution<int> kind(0, 5), knot(0, static_cast<int>(n) - 1);
    double between = 0;
    for (int trial = 0; trial < 3000; ++trial) {
        Vector3 rgb{};
        for (double& v : rgb) {
            const int k = kind(random);
            v = k == 0 ? 0.0 : k == 1 ? 1.0 : k == 2 ? table->knots[0][static_cast<std::size_t>(knot(random))] : uniform(random);
        }
        if (trial % 5 == 0) rgb[1] = rgb[0];
        if (trial % 25 == 0) rgb[2] = rgb[0];
        const auto r = spectrum(*m, rgb);
        ASSERT_TRUE(bounded(r)) << rgb[0] << ' ' << rgb[1] << ' ' << rgb[2];
        between = std::max(between, residual(c, r, rgb));
    }
    // The vertices' own, and four roundings of 1.1e-16 per band against |A|, which sums to less than 3.
    EXPECT_LE(between, 1e-13 + 2e-15);
}

TEST_P(Lattices, AreContinuousAcrossCellsAndTetrahedra) {
    const auto m = lattice();
    ASSERT_TRUE(m);
    const LatticeTable& table = *m->lattice();
    const double cells = static_cast<double>(table.knots[0].size() - 1);
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> uniform(0.01, 0.99);
    std::uniform_int_distribution<int> knot(1, static_cast<int>(cells) - 1), axis(0, 2);
    constexpr double step = 1e-9;
    for (int trial = 0; trial < 600; ++trial) {
        Vector3 rgb{uniform(random), uniform(random), uniform(random)};
        const auto i = static_cast<std::size_t>(axis(random)), j = (i + 1) % 3;
        if (trial % 2 == 0) {
            rgb[i] = knot(random) / cells;  // a wall between cells
        } else {
            rgb[j] = rgb[i];  // a diagonal wall between tetrahedra
        }
        Vector3 below = rgb, above = rgb;
        below[i] -= step;
        above[i] += step;
        const auto a = spectrum(*m, below), b = spectrum(*m, above);
        // Between neighbouring vertices a value changes by at most 1, over 1/cells; twice the step was made.
        for (std::size_t l = 0; l < a.size(); ++l) ASSERT_LE(std::abs(a[l] - b[l]), 2 * step * cells + 1e-15);
    }
}

TEST_P(Lattices, RelightAsTheIntegralOfTheBlendedSpectrum) {
    const auto c = colorimetry(GetParam().bands, GetParam().spec);
    const auto m = lattice();
    ASSERT_TRUE(m);
    RelightRequest request;
    request.illuminants = {parse_illuminant("A").value()};
    request.observer = c.observer().id;
    const auto plan = RelightPlan::for_model(m, request);
    ASSERT_TRUE(plan) << plan.error().message;
    const auto weights = tristimulus_weights(c.bands(), c.observer(), request.illuminants[0], Normalization::luminance).value();
    constexpr std::size_t count = 500;
    std::array<std::vector<float>, 3> in, out;
    std::mt19937 random(9);
    std::uniform_real_distribution<float> uniform(0, 1);
    for (auto& plane : in)
        for (std::size_t i = 0; i < count; ++i) plane.push_back(uniform(random));
    for (auto& plane : out) plane.resize(count);
    const std::vector<const float*> inputs{in[0].data(), in[1].data(), in[2].data()};
    const std::vector<float*> outputs{out[0].data(), out[1].data(), out[2].data()};
    plan->execute(inputs, count, outputs);
    // The output space has the white of its own illuminant.
    const Matrix3 to_rgb = colorimetry(GetParam().bands, {c.observer().id, "", "BT.709", RgbMatrix::integrated}).xyz_to_rgb();
    for (std::size_t i = 0; i < count; ++i) {
        const auto r = spectrum(*m, {in[0][i], in[1][i], in[2][i]});
        Vector3 xyz{};
        for (std::size_t k = 0; k < 3; ++k) {
            Real sum = 0;
            for (std::size_t l = 0; l < r.size(); ++l) sum += static_cast<Real>(weights.w[k * r.size() + l]) * r[l];
            xyz[k] = static_cast<double>(sum);
        }
        const Vector3 rgb = to_rgb * xyz;
        // One rounding to float of values below 2.
        for (std::size_t k = 0; k < 3; ++k) ASSERT_NEAR(out[k][i], rgb[k], 1.3e-7) << i;
    }
}

INSTANTIATE_TEST_SUITE_P(Cases, Lattices,
                         testing::Values(Case{"380:780:5", {}}, Case{"380:780:1", {}}, Case{"380:780:10", {}},
                                         Case{"380:780:20", {}}, Case{"36", {}}, Case{"7", {}}, Case{"400:700:10", {}},
                                         Case{"383:775:7", {}}, Case{"433:646:35.5", {}},
                                         Case{"380:780:5", {"cie1964", "", "BT.709", RgbMatrix::integrated}},
                                         Case{"380:780:10", {"cie1931", "D50", "BT.709", RgbMatrix::integrated}},
                                         Case{"380:780:10", {"cie1931", "", "PAL/SECAM", RgbMatrix::integrated}}));

TEST(Lattice, TheShippedTableIsWhatTheSolverGives) {
    const auto c = colorimetry();
    const auto m = model(c);
    const auto sets = lattice_sample_sets();
    ASSERT_TRUE(sets) << sets.error().message;
    const auto solver = solvers::LatticeSolver::make(c, *sets, {});
    ASSERT_TRUE(solver) << solver.error().message;
    const LatticeTable& table = *m->lattice();
    const std::size_t n = table.knots[0].size();
    ASSERT_EQ(n, LatticeOptions{}.n);
    for (const std::size_t i : {std::size_t{1}, n - 1, n * n - 1, n * n * (n - 1), n * n * n - n, (n * n * n) / 2, std::size_t{137},
                                std::size_t{402}, std::size_t{555}}) {
        const auto r = solver->reflectance({table.knots[0][i / (n * n)], table.knots[1][i / n % n], table.knots[2][i % n]});
        ASSERT_TRUE(r) << r.error().message;
        // Half a step of 16 bits, and as much again for giving A r = rgb back. Compilers differ in the last digits of the
        // interior point, which stops at 1e-9 of an objective whose curvature is of order one.
        for (std::size_t l = 0; l < table.values; ++l)
            EXPECT_NEAR(table.vertices[i * table.values + l], (*r)[l], 1.0 / 65535 + 2e-5) << i << " band " << l;
    }
}

TEST(Lattice, AVertexIsAtTheOptimumOfItsProgramme) {
    // Away from the recipe's own code: a small case with one set of samples, against random feasible directions.
    const auto c = colorimetry("380:780:20");
    auto sets = lattice_sample_sets().value();
    const std::size_t n = c.bands().size();
    LatticeOptions options;
    const Vector3 rgb{0.5, 0.25, 0.125};
    const auto solver = solvers::LatticeSolver::make(c, sets, options).value();
    const auto r = solver.reflectance(rgb).value();
    // The objective, written out again: weights, mean, covariance by plain sums.
    const auto feature = [&](const Vector3& v) {
        const Vector3 xyz = c.rgb_to_xyz() * Vector3{std::max(v[0], 0.0), std::max(v[1], 0.0), std::max(v[2], 0.0)};
        const auto lab = reference::lab({xyz[0], xyz[1], xyz[2]}, {c.white_xyz()[0], c.white_xyz()[1], c.white_xyz()[2]});
        return std::array<Real, 3>{lab[0] * 0.5L / 100, lab[1] / 100, lab[2] / 100};
    };
    const auto own = feature(rgb);
    // Whittaker's smoothing on an even grid: (1 + 10 (5/20)^4 D2^T D2)^-1, D2 the second differences.
    const auto smoothed = [](const std::vector<double>& v) {
        const auto count = static_cast<Eigen::Index>(v.size());
        Eigen::MatrixXd d2 = Eigen::MatrixXd::Zero(count - 2, count);
        for (Eigen::Index l = 0; l + 2 < count; ++l) d2(l, l) = 1, d2(l, l + 1) = -2, d2(l, l + 2) = 1;
        const Eigen::MatrixXd system = Eigen::MatrixXd::Identity(count, count) + 10 * std::pow(5.0 / 20, 4) * d2.transpose() * d2;
        const Eigen::VectorXd x = system.fullPivLu().solve(Eigen::Map<const Eigen::VectorXd>(v.data(), count));
        std::vector<double> out(x.data(), x.data() + count);
        for (double& r : out) r = std::clamp(r, 0.0, 1.0);
        return out;
    };
    std::vector<std::vector<double>> samples;
    std::vector<Real> weights;
    Real total = 0;
    for (const auto& set : sets) {
        const std::size_t first = samples.size();
        for (const auto& s : set.samples) {
            auto v = SpectralDistribution::make(set.wavelengths_nm, s).value().resampled(
                c.bands().wavelengths_nm(), Interpolation::linear, Extrapolation::hold);
            for (double& x : v) x = std::clamp(x, 0.0, 1.0);
            const Vector3 colour = c.rgb_of(v);
            if (*std::min_element(colour.begin(), colour.end()) < 0 || *std::max_element(colour.begin(), colour.end()) > 1) continue;
            const auto x = feature(colour);
            Real d2 = 0;
            for (std::size_t k = 0; k < 3; ++k) d2 += (x[k] - own[k]) * (x[k] - own[k]);
            weights.push_back(std::pow(1 + d2 / (0.15L * 0.15L), -4));
            v = smoothed(v);
            samples.push_back(std::move(v));
        }
        for (std::size_t i = first; i < samples.size(); ++i) weights[i] /= static_cast<Real>(samples.size() - first);
    }
    for (const Real w : weights) total += w;
    Eigen::VectorXd mean = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(n));
    Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(mean.size(), mean.size());
    const auto at = [&](std::size_t i) { return Eigen::Map<const Eigen::VectorXd>(samples[i].data(), mean.size()); };
    for (std::size_t i = 0; i < samples.size(); ++i) mean += static_cast<double>(weights[i] / total) * at(i);
    for (std::size_t i = 0; i < samples.size(); ++i)
        covariance += static_cast<double>(weights[i] / total) * (at(i) - mean) * (at(i) - mean).transpose();
    covariance.diagonal().array() += 3e-4 * 5 / 20;
    const Eigen::FullPivLU<Eigen::MatrixXd> inverse(covariance);
    const auto objective = [&](const Eigen::VectorXd& x) {
        double sum = (x - mean).dot(inverse.solve(x - mean));
        for (Eigen::Index l = 0; l + 1 < x.size(); ++l) sum += 200 * 5.0 / 20 * (x[l + 1] - x[l]) * (x[l + 1] - x[l]);
        return sum;
    };
    const Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(r.data(), mean.size());
    const double least = objective(x);
    using Rows = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>;
    const Eigen::MatrixXd A = Eigen::Map<const Rows>(c.sensing_matrix().data(), 3, mean.size());
    const Eigen::FullPivLU<Eigen::MatrixXd> kernel(A);
    const Eigen::MatrixXd free = kernel.kernel();
    std::mt19937_64 random(11);
    std::normal_distribution<double> normal;
    int tried = 0;
    for (int trial = 0; trial < 4000; ++trial) {
        Eigen::VectorXd z(free.cols());
        for (Eigen::Index k = 0; k < z.size(); ++k) z[k] = normal(random);
        Eigen::VectorXd direction = free * z;
        direction *= std::pow(10, -1 - trial % 4) / direction.cwiseAbs().maxCoeff();
        const Eigen::VectorXd other = x + direction;
        if (other.minCoeff() < 0 || other.maxCoeff() > 1) continue;
        ++tried;
        // The interior point stops at 1e-9 of the objective scaled by the mean diagonal.
        EXPECT_GE(objective(other), least * (1 - 1e-6));
    }
    EXPECT_GT(tried, 1000);
}

TEST(Lattice, NearestMetamerIsTheProjection) {
    const auto c = colorimetry("380:780:10");
    const std::size_t n = c.bands().size();
    std::mt19937_64 random(2);
    std::uniform_real_distribution<double> uniform(0, 1);
    for (int trial = 0; trial < 40; ++trial) {
        std::vector<double> target(n), seed(n), out(n);
        const std::vector<double> mobility(n, 1.0);
        for (double& t : target) t = uniform(random);
        // A colour that some reflectance has: of another random spectrum, half of them box-like and close to the boundary.
        for (double& t : seed) t = uniform(random);
        if (trial % 2 == 0)
            for (double& t : seed) t = std::round(t);
        const Vector3 rgb = c.rgb_of(seed);
        ASSERT_TRUE(solvers::nearest_metamer(c.sensing_matrix(), target, mobility, rgb, out)) << trial;
        EXPECT_LE(residual(c, out, rgb), 1e-13);
        EXPECT_TRUE(bounded(out));
        solvers::QuadraticProgramme<Eigen::MatrixXd> p;
        const auto rows = static_cast<Eigen::Index>(n);
        p.P = Eigen::MatrixXd::Identity(rows, rows);
        p.q = -Eigen::Map<const Eigen::VectorXd>(target.data(), rows);
        using Rows = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>;
        p.C = Eigen::Map<const Rows>(c.sensing_matrix().data(), 3, rows);
        p.d = Eigen::Vector3d(rgb[0], rgb[1], rgb[2]);
        p.lower = Eigen::VectorXd::Zero(rows);
        p.upper = Eigen::VectorXd::Ones(rows);
        const auto s = solvers::solve_quadratic_programme(p);
        ASSERT_TRUE(s) << s.error().message;
        // Both meet A r = rgb to 1e-13; 1e-9 leaves room for a nearly dependent active set.
        for (std::size_t l = 0; l < n; ++l) EXPECT_NEAR(out[l], s->x[static_cast<Eigen::Index>(l)], 1e-9) << trial;
    }
    // No reflectance is more saturated than the spectrum's own colours.
    std::vector<double> target(n, 0.5), out(n);
    EXPECT_FALSE(solvers::nearest_metamer(c.sensing_matrix(), target, std::vector<double>(n, 1.0), {1, -1, 1}, out));
}

TEST(Lattice, FinerBandsHoldTheSameSpectra) {
    const auto coarse = model(colorimetry("380:780:5")), fine = model(colorimetry("380:780:1"));
    for (const Vector3 rgb : {Vector3{0.2, 0.5, 0.9}, Vector3{1, 0, 0}, Vector3{0.5, 0.5, 0.5}}) {
        const auto a = spectrum(*coarse, rgb), b = spectrum(*fine, rgb);
        // Linear between bands is what stored bands mean: the integrals agree to rounding and nothing is corrected.
        for (std::size_t l = 0; l < a.size(); ++l) EXPECT_NEAR(a[l], b[5 * l], 1e-11);
        for (std::size_t l = 0; l + 1 < a.size(); ++l) EXPECT_NEAR(b[5 * l + 2], 0.6 * a[l] + 0.4 * a[l + 1], 1e-11);
    }
}

TEST(Lattice, SaysWhichVertexHasNoReflectance) {
    const auto wide = make_model("lattice", colorimetry("380:780:5", {"cie1931", "", "Rec.2020", RgbMatrix::integrated}));
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().kind, ErrorKind::infeasible);
    EXPECT_NE(wide.error().message.find("(1, 0, 0)"), std::string::npos) << wide.error().message;
    const auto standard = make_model("lattice", colorimetry("380:780:5", {"cie1931", "", "BT.709", RgbMatrix::standard}));
    ASSERT_FALSE(standard);
    EXPECT_EQ(standard.error().kind, ErrorKind::infeasible);
    EXPECT_NE(standard.error().message.find("(1, 1, 1)"), std::string::npos) << standard.error().message;
}

TEST(Lattice, SolvesTheSameTwiceAndRefusesOptionsOutOfRange) {
    const auto c = colorimetry("380:780:20");
    const auto sets = lattice_sample_sets().value();
    LatticeOptions small;
    small.n = 4;
    const auto a = solve_lattice(c, sets, small), b = solve_lattice(c, sets, small);
    ASSERT_TRUE(a && b);
    EXPECT_EQ(a->vertices, b->vertices);
    EXPECT_EQ(a->knots[0], (std::vector<double>{0, 1.0 / 3, 2.0 / 3, 1}));
    for (const auto change : {+[](LatticeOptions& o) { o.n = 1; }, +[](LatticeOptions& o) { o.n = 66; },
                              +[](LatticeOptions& o) { o.reach = 0; }, +[](LatticeOptions& o) { o.ridge = -1; },
                              +[](LatticeOptions& o) { o.smoothness = std::nan(""); }, +[](LatticeOptions& o) { o.denoising = -1; }}) {
        LatticeOptions bad;
        change(bad);
        const auto refused = solve_lattice(c, sets, bad);
        ASSERT_FALSE(refused);
        EXPECT_EQ(refused.error().kind, ErrorKind::usage);
    }
    EXPECT_FALSE(solve_lattice(c, {}, small));
}

TEST(Lattice, TablesSurviveBytesAndDamageIsNoticed) {
    const auto c = colorimetry("380:780:20");
    LatticeOptions small;
    small.n = 3;
    const auto table = solve_lattice(c, lattice_sample_sets().value(), small).value();
    const std::string bytes = encode_lattice(table, c);
    const auto back = solvers::decode_lattice(bytes, "x.bin", c);
    ASSERT_TRUE(back) << back.error().message;
    for (std::size_t i = 0; i < table.vertices.size(); ++i) EXPECT_NEAR(back->vertices[i], table.vertices[i], 4e-5);
    const auto refused = [&](const std::string& damaged) {
        const auto read = solvers::decode_lattice(damaged, "x.bin", c);
        if (read) return false;
        EXPECT_EQ(read.error().kind, ErrorKind::input);
        EXPECT_NE(read.error().message.find("x.bin"), std::string::npos) << read.error().message;
        return true;
    };
    for (std::size_t cut = 0; cut < bytes.size(); cut += 7) EXPECT_TRUE(refused(bytes.substr(0, cut))) << cut;
    EXPECT_TRUE(refused(bytes + "x"));
    for (std::size_t i = 0; i < 12; ++i) {
        std::string damaged = bytes;
        damaged[i] = static_cast<char>(damaged[i] ^ 0x55);
        EXPECT_TRUE(refused(damaged)) << i;
    }
    // Another vertex's spectrum has another colour.
    std::string swapped = bytes;
    const std::size_t one = 2 * c.bands().size();
    std::swap_ranges(swapped.end() - static_cast<std::ptrdiff_t>(5 * one), swapped.end() - static_cast<std::ptrdiff_t>(4 * one),
                     swapped.end() - static_cast<std::ptrdiff_t>(12 * one));
    EXPECT_TRUE(refused(swapped));
    EXPECT_FALSE(solvers::decode_lattice(bytes, "x.bin", colorimetry("380:780:10")));
}

TEST(Lattice, JsonNamesTheTableByItsHash) {
    for (const auto& c : {colorimetry(), colorimetry("380:780:20"),
                          colorimetry("380:780:20", {"cie1931", "D50", "BT.709", RgbMatrix::integrated})}) {
        const auto m = model(c);
        const std::string text = m->to_json();
        EXPECT_LT(text.size(), 2000u);
        const auto back = make_model_from_json(text);
        ASSERT_TRUE(back) << back.error().message;
        EXPECT_EQ((*back)->to_json(), text);
        EXPECT_EQ((*back)->lattice()->vertices, m->lattice()->vertices);
        const Json good = Json::parse(text);
        for (const Json& value : {Json(), Json(1), Json("xxh3-64:0000000000000000"), Json(std::string(300, 'x'))}) {
            Json json = good;
            json["table"] = value;
            const auto read = make_model_from_json(json.dump());
            ASSERT_FALSE(read);
            EXPECT_EQ(read.error().kind, ErrorKind::input);
            EXPECT_NE(read.error().message.find("table"), std::string::npos);
        }
        Json json = good;
        json.erase("table");
        EXPECT_FALSE(make_model_from_json(json.dump()));
        json = good;
        json["rgb_space"] = "Rec.2020";
        EXPECT_FALSE(make_model_from_json(json.dump()));
    }
}

}  // namespace
}  // namespace spectex
