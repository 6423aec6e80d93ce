#include "spectex/solvers.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "reference.h"
#include "solvers/primaries.h"
#include "solvers/quadratic_programme.h"

#ifdef SPECTEX_HAVE_IPOPT
#include <coin/IpIpoptApplication.hpp>
#include <coin/IpTNLP.hpp>
#endif

namespace spectex {
namespace {

using reference::Real;

ColorimetrySpec spec(const char* observer, const char* illuminant = "", const char* space = "BT.709") {
    return {observer, illuminant, space, RgbMatrix::integrated};
}
Colorimetry colorimetry(const ColorimetrySpec& s, std::string_view bands = "380:780:5") {
    return Colorimetry::make(s, BandSet::parse(bands).value()).value();
}
PrimariesOutcome solved(const Colorimetry& c, Smoothness smoothness) {
    auto outcome = solve_primaries(c, smoothness);
    EXPECT_TRUE(outcome) << c.describe() << ": " << outcome.error().message;
    return outcome ? *std::move(outcome) : PrimariesOutcome{};
}

/// Squared differences as the interface words them, on even grids.
Real plain_roughness(const std::vector<double>& basis, int order) {
    const std::size_t n = basis.size() / 3;
    Real sum = 0;
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t l = static_cast<std::size_t>(order); l < n; ++l) {
            const Real a = basis[i * n + l], b = basis[i * n + l - 1];
            const Real d = order == 1 ? a - b : a - 2 * b + basis[i * n + l - 2];
            sum += d * d;
        }
    return sum;
}

/// The sensing matrix of sums over the band centres alone, as the literature has it, from the CSV tables.
std::vector<double> sampled_sensing(const char* observer, const reference::Light& light, int start, int end, int step) {
    const auto cmf = reference::read_csv(std::string(SPECTEX_LUTS_SOURCE) + "/cie/" + observer);
    std::vector<reference::Vec3> weights;
    reference::Vec3 white{};
    for (int nm = start; nm <= end; nm += step) {
        reference::Vec3 w{};
        for (std::size_t i = 0; i < cmf.nm.size(); ++i)
            if (cmf.nm[i] == nm)
                w = {cmf.column.at("x_bar")[i] * light(nm), cmf.column.at("y_bar")[i] * light(nm),
                     cmf.column.at("z_bar")[i] * light(nm)};
        weights.push_back(w);
        for (std::size_t c = 0; c < 3; ++c) white[c] += w[c];
    }
    const Real y = white[1];
    for (Real& v : white) v /= y;
    const auto matrix = reference::bt709_to_xyz(white);
    std::vector<double> a(3 * weights.size());
    for (std::size_t l = 0; l < weights.size(); ++l) {
        for (Real& v : weights[l]) v /= y;
        const auto rgb = reference::solve(matrix, weights[l]);
        for (std::size_t c = 0; c < 3; ++c) a[c * weights.size() + l] = static_cast<double>(rgb[c]);
    }
    return a;
}
std::vector<double> wavelengths(int start, int end, int step) {
    std::vector<double> nm;
    for (int l = start; l <= end; l += step) nm.push_back(l);
    return nm;
}

/// Lagrange multipliers prove the optimum: z = gradient - A^T y - s is >= 0, and 0 wherever b > 0.
void expect_optimal(const PrimariesSolution& s, const std::vector<double>& a, Smoothness smoothness) {
    const std::size_t n = s.basis.size() / 3;
    ASSERT_EQ(s.multipliers.size(), 9 + n);
    std::vector<Real> gradient(3 * n, 0);
    for (std::size_t i = 0; i < 3; ++i) {
        const double* b = &s.basis[i * n];
        Real* g = &gradient[i * n];
        if (smoothness == Smoothness::first)
            for (std::size_t l = 0; l + 1 < n; ++l) {
                const Real d = 2 * (static_cast<Real>(b[l + 1]) - b[l]);
                g[l + 1] += d;
                g[l] -= d;
            }
        else
            for (std::size_t l = 0; l + 2 < n; ++l) {
                const Real d = 2 * (static_cast<Real>(b[l]) - 2 * static_cast<Real>(b[l + 1]) + b[l + 2]);
                g[l] += d;
                g[l + 1] -= 2 * d;
                g[l + 2] += d;
            }
    }
    Real most_negative = 0, complementarity = 0;
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t l = 0; l < n; ++l) {
            Real z = gradient[i * n + l] - s.multipliers[9 + l];
            for (std::size_t c = 0; c < 3; ++c) z -= static_cast<Real>(s.multipliers[3 * i + c]) * a[c * n + l];
            most_negative = std::min(most_negative, z);
            if (s.basis[i * n + l] > 0) complementarity = std::max(complementarity, std::abs(z));
        }
    // The multipliers and the spectra are rounded to doubles; both are of order one or smaller, and second differences
    // multiply the rounding of b by 16.
    EXPECT_GE(most_negative, -1e-13L);
    EXPECT_LE(complementarity, 1e-13L);
}

TEST(Primaries, MeetTheFiguresOfTheLiteratureForSumsAtBandCentres) {
    // D65 as CIE 15 computes it. The table rounded to two decimals would give 0.368803 and 0.0191733.
    const auto power = parse_illuminant("D65").value().power;
    const reference::Light d65{{power.wavelengths_nm().begin(), power.wavelengths_nm().end()},
                               {power.values().begin(), power.values().end()}};
    const auto nm = wavelengths(380, 780, 5);
    const auto a = sampled_sensing("cie1931_2deg_360-830-1.csv", d65, 380, 780, 5);
    const auto first = solvers::solve_primaries(a, nm, Smoothness::first), second = solvers::solve_primaries(a, nm, Smoothness::second);
    ASSERT_TRUE(first && second);
    // The figures are known to five digits.
    EXPECT_NEAR(first->solution.objective, 0.36880, 5e-6);
    EXPECT_NEAR(second->solution.objective, 0.019172, 5e-7);
    EXPECT_NEAR(first->solution.least_violation, -0.0158, 5e-5);
    EXPECT_EQ(first->solution.least_violation, second->solution.least_violation);
}

TEST(Primaries, MeetTheFiguresAtOneNanometre) {
    const auto c = colorimetry(spec("cie2006-10"), "380:780:1");
    // Known to five digits for D65 rounded to two decimals; ours comes from the daylight components.
    EXPECT_NEAR(solved(c, Smoothness::first).solution.objective, 0.19652, 2e-5);
    EXPECT_NEAR(solved(c, Smoothness::second).solution.objective, 0.0029138, 1e-6);
    EXPECT_NEAR(solved(c, Smoothness::first).solution.least_violation, -0.0041, 5e-5);
    EXPECT_NEAR(solved(colorimetry(spec("cie1964"), "380:780:1"), Smoothness::first).solution.least_violation, -0.0008, 5e-5);
}

struct Case {
    const char *observer, *illuminant, *space, *bands;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.observer << ' ' << c.illuminant << ' ' << c.space << ' ' << c.bands; }

class Feasible : public testing::TestWithParam<Case> {};

TEST_P(Feasible, IsExactBoundedAndOptimal) {
    const auto& p = GetParam();
    const auto c = colorimetry(spec(p.observer, p.illuminant, p.space), p.bands);
    const auto& a = c.sensing_matrix();
    const std::size_t n = c.bands().size();
    double objective[2][2];
    for (const auto smoothness : {Smoothness::first, Smoothness::second}) {
        const auto outcome = solved(c, smoothness);
        ASSERT_TRUE(outcome.feasible);
        const auto& s = outcome.solution;
        ASSERT_EQ(s.basis.size(), 3 * n);
        Real sensing = 0;
        for (std::size_t i = 0; i < 3; ++i)
            for (std::size_t k = 0; k < 3; ++k) {
                Real sum = i == k ? -1 : 0;
                for (std::size_t l = 0; l < n; ++l) sum += static_cast<Real>(a[k * n + l]) * s.basis[i * n + l];
                sensing = std::max(sensing, std::abs(sum));
            }
        // Each b is rounded by 6e-17 and |A| sums to a few units.
        EXPECT_LE(sensing, 2e-15L);
        EXPECT_NEAR(s.sensing_residual, static_cast<double>(sensing), 1e-18);
        bool zero = false;
        for (std::size_t l = 0; l < n; ++l) {
            EXPECT_EQ((s.basis[l] + s.basis[n + l]) + s.basis[2 * n + l], 1.0);
            for (std::size_t i = 0; i < 3; ++i) {
                EXPECT_GE(s.basis[i * n + l], 0.0);
                EXPECT_LE(s.basis[i * n + l], 1.0);
                zero |= s.basis[i * n + l] == 0;
            }
        }
        EXPECT_TRUE(zero) << "clamped values lie exactly at their bound";
        EXPECT_LT(s.least_violation, 0);
        EXPECT_LE(s.sum_residual, 1.2e-16);
        expect_optimal(s, a, smoothness);
        const int k = smoothness == Smoothness::first ? 0 : 1;
        for (int order : {1, 2}) objective[k][order - 1] = static_cast<double>(plain_roughness(s.basis, order));
        EXPECT_NEAR(s.objective, objective[k][k], 1e-12 * s.objective);
    }
    EXPECT_LE(objective[0][0], objective[1][0]);
    EXPECT_LE(objective[1][1], objective[0][1]);
}

INSTANTIATE_TEST_SUITE_P(
    Cases, Feasible,
    testing::Values(Case{"cie1931", "", "BT.709", "380:780:5"}, Case{"cie1931", "", "BT.709", "380:780:1"},
                    Case{"cie1931", "", "BT.709", "380:780:10"}, Case{"cie1931", "", "BT.709", "380:780:20"},
                    Case{"cie1931", "", "BT.709", "360:830:1"}, Case{"cie1931", "", "BT.709", "400:700:10"},
                    Case{"cie1931", "", "BT.709", "400:730:0.5"}, Case{"cie1931", "", "BT.709", "383:775:7"},
                    Case{"cie1931", "", "BT.709", "36"}, Case{"cie1931", "", "BT.709", "433:646:35.5"},
                    Case{"cie1964", "", "BT.709", "380:780:5"}, Case{"cie1964", "", "BT.709", "380:780:1"},
                    Case{"cie2006-2", "", "BT.709", "380:780:5"}, Case{"cie2006-10", "", "BT.709", "380:780:5"},
                    Case{"cie2006-10", "", "BT.709", "380:780:1"}, Case{"cie1931", "", "PAL/SECAM", "380:780:5"},
                    Case{"cie1931", "A", "BT.709", "380:780:5"}, Case{"cie1931", "D50", "BT.709", "380:780:5"},
                    Case{"cie1931", "E", "BT.709", "380:780:5"}, Case{"cie1931", "FL11", "BT.709", "380:780:5"}));

/// The least violation that each must have, or nothing known (0).
class Infeasible : public testing::TestWithParam<std::pair<Case, double>> {};

TEST_P(Infeasible, HasAProof) {
    const auto& [p, violation] = GetParam();
    const auto c = colorimetry(spec(p.observer, p.illuminant, p.space), p.bands);
    const auto outcome = solved(c, Smoothness::first);
    ASSERT_FALSE(outcome.feasible);
    // The reference figures are for sums at the band centres; integration at 1 nm changes the fourth digit.
    if (violation > 0) {
        EXPECT_NEAR(outcome.solution.least_violation, violation, 1.1e-3);
    }

    const auto& a = c.sensing_matrix();
    const auto& f = outcome.certificate;
    const std::size_t n = c.bands().size();
    ASSERT_EQ(f.y.size(), 9u);
    ASSERT_EQ(f.s.size(), n);
    Real constraint = f.y[0] + static_cast<Real>(f.y[4]) + f.y[8], box = 0;
    for (std::size_t l = 0; l < n; ++l) {
        constraint += f.s[l];
        for (std::size_t i = 0; i < 3; ++i) {
            Real coefficient = f.s[l];
            for (std::size_t k = 0; k < 3; ++k) coefficient += static_cast<Real>(f.y[3 * i + k]) * a[k * n + l];
            if (coefficient > 0) box += coefficient;
        }
    }
    EXPECT_GT(constraint, box);
    EXPECT_NEAR(f.constraint_value, static_cast<double>(constraint), 1e-14 * std::abs(f.constraint_value));
    EXPECT_NEAR(f.box_maximum, static_cast<double>(box), 1e-14 * (1 + f.box_maximum));
    // Duality: the proof's margin is the least violation, so that neither can be improved.
    // At three bands the equations leave the spectra no freedom, and the interior point stops early for want of an interior.
    EXPECT_NEAR(static_cast<double>(constraint - box), outcome.solution.least_violation, n == 3 ? 1e-5 : 1e-8);
    EXPECT_NEAR(outcome.solution.minimum, -outcome.solution.least_violation, 1e-7);
    EXPECT_LE(outcome.solution.maximum, 1 + outcome.solution.least_violation + 1e-7);
    EXPECT_LE(outcome.solution.sensing_residual, 1e-9);
}

INSTANTIATE_TEST_SUITE_P(Cases, Infeasible,
                         testing::Values(std::pair{Case{"cie1931", "", "Display P3", "380:780:5"}, 0.049},
                                         std::pair{Case{"cie1931", "", "Adobe RGB", "380:780:5"}, 0.068},
                                         std::pair{Case{"cie1931", "", "Rec.2020", "380:780:5"}, 0.210},
                                         std::pair{Case{"cie1931", "", "ACEScg", "380:780:5"}, 0.224},
                                         std::pair{Case{"cie1931", "", "ProPhoto", "380:780:5"}, 0.363},
                                         std::pair{Case{"cie1931", "", "ACES2065-1", "380:780:5"}, 0.0},
                                         std::pair{Case{"cie1931", "", "Rec.2020", "380:780:1"}, 0.0},
                                         std::pair{Case{"cie1931", "FL2", "BT.709", "380:780:1"}, 0.0},
                                         std::pair{Case{"cie1931", "", "BT.709", "400:700:50"}, 0.0},
                                         std::pair{Case{"cie1931", "", "BT.709", "3"}, 0.0}));

TEST(Primaries, NoCertificatePassesWhereThereAreSpectra) {
    const auto good = colorimetry(spec("cie1931"));
    auto proof = solved(colorimetry(spec("cie1931", "", "Rec.2020")), Smoothness::first).certificate;
    EXPECT_TRUE(solvers::verify(proof, colorimetry(spec("cie1931", "", "Rec.2020")).sensing_matrix()));
    EXPECT_FALSE(solvers::verify(proof, good.sensing_matrix()));
    std::mt19937_64 random(1902);
    std::normal_distribution<double> normal;
    for (int trial = 0; trial < 2000; ++trial) {
        FarkasCertificate guess = proof;
        for (double& y : guess.y) y += std::pow(10, trial % 7 - 5) * normal(random);
        for (double& s : guess.s) s += std::pow(10, trial % 5 - 5) * normal(random);
        EXPECT_FALSE(solvers::verify(guess, good.sensing_matrix()));
    }
    proof.y.pop_back();
    EXPECT_FALSE(solvers::verify(proof, good.sensing_matrix()));
}

TEST(Primaries, TheStandardsMatrixHasNoneAndSaysWhy) {
    const auto c = colorimetry({"cie1931", "", "BT.709", RgbMatrix::standard});
    auto outcome = solved(c, Smoothness::first);
    ASSERT_FALSE(outcome.feasible);
    EXPECT_TRUE(std::isinf(outcome.solution.least_violation));
    EXPECT_GT(outcome.certificate.constraint_value, 0);
    EXPECT_TRUE(solvers::verify(outcome.certificate, c.sensing_matrix()));
}

TEST(Primaries, UnevenBandsMeasureSlope) {
    // A straight line has equal slopes however it is sampled: n - 1 slopes of the mean rise per band.
    const std::vector<double> nm{400, 410, 440, 500, 700};
    std::vector<double> line;
    for (const double l : nm) line.push_back((l - 400) / 300);
    EXPECT_NEAR(solvers::roughness(line, nm, Smoothness::first), 4 * 0.25 * 0.25, 1e-15);
    EXPECT_NEAR(solvers::roughness(line, nm, Smoothness::second), 0, 1e-28);
    const auto bands = BandSet::make({366, 411, 475, 510, 590, 591, 752});
    ASSERT_TRUE(bands);
    const auto outcome = solved(Colorimetry::make({}, *bands).value(), Smoothness::first);
    EXPECT_TRUE(outcome.feasible);
    EXPECT_NEAR(outcome.solution.objective, solvers::roughness(outcome.solution.basis, bands->wavelengths_nm(), Smoothness::first),
                1e-15);
}

TEST(Primaries, RefuseWhatIsNoSensingMatrix) {
    const auto nm = wavelengths(400, 700, 10);
    std::vector<double> a(3 * nm.size(), 1.0 / static_cast<double>(nm.size()));
    EXPECT_FALSE(solvers::solve_primaries(std::span(a).first(7), nm, Smoothness::first));
    a[5] = std::nan("");
    EXPECT_FALSE(solvers::solve_primaries(a, nm, Smoothness::first));
    std::fill(a.begin(), a.end(), 0.0);
    EXPECT_FALSE(solvers::solve_primaries(a, nm, Smoothness::first));
}

struct ShippedSet {
    const char* file;
    Case request;
    Smoothness smoothness;
};
void PrintTo(const ShippedSet& s, std::ostream* out) { *out << s.file; }
class Shipped : public testing::TestWithParam<ShippedSet> {};

TEST_P(Shipped, IsWhatSolvingAgainGives) {
    const auto& p = GetParam();
    const auto c = colorimetry(spec(p.request.observer, p.request.illuminant, p.request.space), p.request.bands);
    const auto table = load_spectral_table(std::string("models/") + p.file);
    ASSERT_TRUE(table) << table.error().message;
    ASSERT_EQ(table->wavelengths_nm, c.bands().wavelengths_nm());
    const auto outcome = solved(c, p.smoothness);
    const std::size_t n = c.bands().size();
    double worst = 0;
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t l = 0; l < n; ++l)
            worst = std::max(worst, std::abs(table->columns.at(i).at(l) - outcome.solution.basis.at(i * n + l)));
    // The optimum is unique; what other compilers' rounding may move in it is far below this.
    EXPECT_LE(worst, 1e-9);
}

INSTANTIATE_TEST_SUITE_P(
    Sets, Shipped,
    testing::Values(
        ShippedSet{"mallett2019_cie1931_d65_bt709_380-780-1.csv", {"cie1931", "D65", "BT.709", "380:780:1"}, Smoothness::first},
        ShippedSet{"mallett2019_cie1931_d65_bt709_380-780-5.csv", {"cie1931", "D65", "BT.709", "380:780:5"}, Smoothness::first},
        ShippedSet{"mallett2019_cie1931_d65_bt709_380-780-10.csv", {"cie1931", "D65", "BT.709", "380:780:10"}, Smoothness::first},
        ShippedSet{"mallett2019_cie1931_d65_bt709_380-780-20.csv", {"cie1931", "D65", "BT.709", "380:780:20"}, Smoothness::first},
        ShippedSet{"mallett2019_cie1931_d65_bt709_380-780-5_second.csv", {"cie1931", "D65", "BT.709", "380:780:5"}, Smoothness::second},
        ShippedSet{"mallett2019_cie1931_d65_bt709_433-646-35.5.csv", {"cie1931", "D65", "BT.709", "433:646:35.5"}, Smoothness::first},
        ShippedSet{"mallett2019_cie1964_d65_bt709_380-780-5.csv", {"cie1964", "D65", "BT.709", "380:780:5"}, Smoothness::first},
        ShippedSet{"mallett2019_cie2006-2_d65_bt709_380-780-5.csv", {"cie2006-2", "D65", "BT.709", "380:780:5"}, Smoothness::first},
        ShippedSet{"mallett2019_cie2006-10_d65_bt709_380-780-5.csv", {"cie2006-10", "D65", "BT.709", "380:780:5"}, Smoothness::first},
        ShippedSet{"mallett2019_cie2006-10_d65_bt709_380-780-1.csv", {"cie2006-10", "D65", "BT.709", "380:780:1"}, Smoothness::first},
        ShippedSet{"mallett2019_cie1931_d50_bt709_380-780-5.csv", {"cie1931", "D50", "BT.709", "380:780:5"}, Smoothness::first},
        ShippedSet{"mallett2019_cie1931_d65_pal-secam_380-780-5.csv", {"cie1931", "D65", "PAL/SECAM", "380:780:5"}, Smoothness::first}));

#ifdef SPECTEX_HAVE_IPOPT
/// The same programme for Ipopt: A b_r = e_r, A b_g = e_g, sums, b >= 0.
class PrimariesForIpopt : public Ipopt::TNLP {
public:
    PrimariesForIpopt(const std::vector<double>& a, std::size_t n, int order) : a_(a), n_(static_cast<int>(n)), order_(order) {}
    double objective = 0;
    std::vector<double> basis;

    bool get_nlp_info(int& n, int& m, int& jacobian, int& hessian, IndexStyleEnum& style) override {
        n = 3 * n_;
        m = 6 + n_;
        jacobian = 6 * n_ + 3 * n_;
        hessian = 3 * (n_ - order_) * (order_ + 1) * (order_ + 2) / 2;
        style = C_STYLE;
        return true;
    }
    bool get_bounds_info(int n, double* low, double* high, int m, double* g_low, double* g_high) override {
        std::fill(low, low + n, 0.0);
        std::fill(high, high + n, 2e19);
        for (int k = 0; k < m; ++k) g_low[k] = g_high[k] = k >= 6 || k == 0 || k == 4 ? 1 : 0;
        return true;
    }
    bool get_starting_point(int n, bool, double* x, bool, double*, double*, int, bool, double*) override {
        std::fill(x, x + n, 1.0 / 3);
        return true;
    }
    bool eval_f(int, const double* x, bool, double& f) override {
        f = 0;
        differences([&](int i, int l, const double* w) {
            double d = 0;
            for (int j = 0; j <= order_; ++j) d += w[j] * x[i * n_ + l + j];
            f += d * d;
        });
        return true;
    }
    bool eval_grad_f(int n, const double* x, bool, double* g) override {
        std::fill(g, g + n, 0.0);
        differences([&](int i, int l, const double* w) {
            double d = 0;
            for (int j = 0; j <= order_; ++j) d += w[j] * x[i * n_ + l + j];
            for (int j = 0; j <= order_; ++j) g[i * n_ + l + j] += 2 * d * w[j];
        });
        return true;
    }
    bool eval_g(int, const double* x, bool, int, double* g) override {
        for (int i = 0; i < 2; ++i)
            for (int k = 0; k < 3; ++k) {
                g[3 * i + k] = 0;
                for (int l = 0; l < n_; ++l) g[3 * i + k] += a_[static_cast<std::size_t>(k * n_ + l)] * x[i * n_ + l];
            }
        for (int l = 0; l < n_; ++l) g[6 + l] = x[l] + x[n_ + l] + x[2 * n_ + l];
        return true;
    }
    bool eval_jac_g(int, const double*, bool, int, int, int* row, int* column, double* value) override {
        int e = 0;
        const auto put = [&](int r, int c, double v) {
            if (value)
                value[e] = v;
            else
                row[e] = r, column[e] = c;
            ++e;
        };
        for (int i = 0; i < 2; ++i)
            for (int k = 0; k < 3; ++k)
                for (int l = 0; l < n_; ++l) put(3 * i + k, i * n_ + l, a_[static_cast<std::size_t>(k * n_ + l)]);
        for (int l = 0; l < n_; ++l)
            for (int i = 0; i < 3; ++i) put(6 + l, i * n_ + l, 1);
        return true;
    }
    bool eval_h(int, const double*, bool, double factor, int, const double*, bool, int, int* row, int* column,
                double* value) override {
        int e = 0;
        differences([&](int i, int l, const double* w) {
            for (int j = 0; j <= order_; ++j)
                for (int k = 0; k <= j; ++k, ++e) {
                    if (value)
                        value[e] = factor * 2 * w[j] * w[k];
                    else
                        row[e] = i * n_ + l + j, column[e] = i * n_ + l + k;
                }
        });
        return true;
    }
    void finalize_solution(Ipopt::SolverReturn, int n, const double* x, const double*, const double*, int, const double*,
                           const double*, double f, const Ipopt::IpoptData*, Ipopt::IpoptCalculatedQuantities*) override {
        objective = f;
        basis.assign(x, x + n);
    }

private:
    template <class Use>
    void differences(const Use& use) const {
        static constexpr double first[] = {-1, 1}, second[] = {1, -2, 1};
        for (int i = 0; i < 3; ++i)
            for (int l = 0; l + order_ < n_; ++l) use(i, l, order_ == 1 ? first : second);
    }
    const std::vector<double>& a_;
    int n_, order_;
};

TEST(Ipopt, FindsTheSameOptimum) {
    const auto c = colorimetry(spec("cie1931"));
    for (const int order : {1, 2}) {
        const auto ours = solved(c, order == 1 ? Smoothness::first : Smoothness::second);
        auto* problem = new PrimariesForIpopt(c.sensing_matrix(), 81, order);
        const Ipopt::SmartPtr<Ipopt::TNLP> owner = problem;
        Ipopt::IpoptApplication ipopt(false);
        ipopt.Options()->SetIntegerValue("print_level", 0);
        ipopt.Options()->SetStringValue("sb", "yes");
        ipopt.Options()->SetNumericValue("tol", 1e-12);
        ipopt.Options()->SetNumericValue("bound_relax_factor", 0);
        ipopt.Options()->SetStringValue("jac_c_constant", "yes");
        ipopt.Options()->SetStringValue("hessian_constant", "yes");
        ASSERT_EQ(ipopt.Initialize(), Ipopt::Solve_Succeeded);
        ASSERT_EQ(ipopt.OptimizeTNLP(owner), Ipopt::Solve_Succeeded);
        // Ipopt stays inside the bounds by its last barrier parameter, 1e-13, times 240 pairs.
        EXPECT_NEAR(problem->objective, ours.solution.objective, 1e-8 * ours.solution.objective);
        EXPECT_LE(ours.solution.objective, problem->objective * (1 + 1e-12));
        double worst = 0;
        for (std::size_t j = 0; j < 243; ++j) worst = std::max(worst, std::abs(problem->basis[j] - ours.solution.basis[j]));
        // Curvature along the flattest direction of the second differences is about 1e-5.
        EXPECT_LE(worst, 1e-4);
    }
}
#else
TEST(Ipopt, FindsTheSameOptimum) { GTEST_SKIP() << "built without Ipopt (coinor-libipopt-dev)"; }
#endif

using solvers::QuadraticProgramme;

/// Random convex programmes with known feasible points, solved dense and sparse, and checked by their own optimality.
TEST(QuadraticProgramme, RandomProgrammesAreSolvedToTheirOptimum) {
    std::mt19937_64 random(1992);
    std::normal_distribution<double> normal;
    for (int trial = 0; trial < 60; ++trial) {
        const Eigen::Index n = 3 + trial % 40, m = trial % 4;
        const Eigen::MatrixXd root = Eigen::MatrixXd::NullaryExpr(n, n, [&] { return normal(random); });
        QuadraticProgramme<Eigen::MatrixXd> p;
        p.P = root.transpose() * root / static_cast<double>(n) + 0.01 * Eigen::MatrixXd::Identity(n, n);
        p.q = Eigen::VectorXd::NullaryExpr(n, [&] { return 3 * normal(random); });
        p.C = Eigen::MatrixXd::NullaryExpr(std::min(m, n - 1), n, [&] { return normal(random); });
        const Eigen::VectorXd inside = Eigen::VectorXd::Constant(n, 0.5) + 0.3 * Eigen::VectorXd::NullaryExpr(n, [&] { return std::tanh(normal(random)); });
        p.d = p.C * inside;
        p.lower = Eigen::VectorXd::Zero(n);
        p.upper = Eigen::VectorXd::Ones(n);
        constexpr double inf = std::numeric_limits<double>::infinity();
        for (Eigen::Index j = 0; j < n; j += 5) p.lower[j] = -inf;
        for (Eigen::Index j = 0; j < n; j += 7) p.upper[j] = inf;
        const auto dense = solvers::solve_quadratic_programme(p);
        ASSERT_TRUE(dense) << trial << ": " << dense.error().message;
        QuadraticProgramme<solvers::SparseMatrix> q{p.P.sparseView(), p.q, p.C.sparseView(), p.d, p.lower, p.upper};
        const auto sparse = solvers::solve_quadratic_programme(q);
        ASSERT_TRUE(sparse) << trial << ": " << sparse.error().message;
        // Both are the one optimum, polished in long double.
        EXPECT_LE((dense->x - sparse->x).cwiseAbs().maxCoeff(), 1e-13) << trial;

        EXPECT_LE(dense->equality_residual, 1e-15);
        const Eigen::VectorXd residual = p.P * dense->x + p.q - p.C.transpose() * dense->y - dense->z;
        // Double rounding of a few dozen terms of size ten.
        EXPECT_LE(residual.cwiseAbs().maxCoeff(), 1e-12) << trial;
        for (Eigen::Index j = 0; j < n; ++j) {
            EXPECT_GE(dense->x[j], p.lower[j]);
            EXPECT_LE(dense->x[j], p.upper[j]);
            EXPECT_LE(dense->x[j] > p.lower[j] ? dense->z[j] : 0, 1e-14);
            EXPECT_GE(dense->x[j] < p.upper[j] ? dense->z[j] : 0, -1e-14);
        }
    }
}

TEST(QuadraticProgramme, LinearProgrammesWithFreeVariables) {
    // min t with t >= |x_j - j|, x_0 + x_1 + x_2 = 6: by symmetry t = 1.  u_j = t - (x_j - j), v_j = t + (x_j - j).
    QuadraticProgramme<solvers::SparseMatrix> p;
    const int n = 10;
    p.P.resize(n, n);
    p.q = Eigen::VectorXd::Zero(n);
    p.q[9] = 1;
    Eigen::MatrixXd c = Eigen::MatrixXd::Zero(7, n);
    p.d = Eigen::VectorXd::Zero(7);
    for (int j = 0; j < 3; ++j) {
        c(j, 3 + j) = 1, c(j, j) = 1, c(j, 9) = -1, p.d[j] = j;
        c(3 + j, 6 + j) = 1, c(3 + j, j) = -1, c(3 + j, 9) = -1, p.d[3 + j] = -j;
        c(6, j) = 1;
    }
    p.d[6] = 6;
    p.C = c.sparseView();
    constexpr double inf = std::numeric_limits<double>::infinity();
    p.lower = Eigen::VectorXd::Constant(n, 0);
    p.upper = Eigen::VectorXd::Constant(n, inf);
    for (const int j : {0, 1, 2, 9}) p.lower[j] = -inf;
    solvers::QuadraticProgrammeOptions options;
    options.polish = false;
    const auto solved = solvers::solve_quadratic_programme(p, options);
    ASSERT_TRUE(solved) << solved.error().message;
    EXPECT_NEAR(solved->x[9], 1, 1e-9);
    EXPECT_NEAR(solved->y.dot(p.d), 1, 1e-9);  // strong duality, all bounds being zero
}

TEST(QuadraticProgramme, SaysWhatItCannotDo) {
    QuadraticProgramme<Eigen::MatrixXd> p;
    p.P = Eigen::MatrixXd::Identity(2, 2);
    p.q = Eigen::VectorXd::Zero(2);
    p.C = Eigen::MatrixXd::Ones(1, 2);
    p.d = Eigen::VectorXd::Constant(1, 5);  // out of reach of two values in [0,1]
    p.lower = Eigen::VectorXd::Zero(2);
    p.upper = Eigen::VectorXd::Ones(2);
    const auto unreachable = solvers::solve_quadratic_programme(p);
    ASSERT_FALSE(unreachable);
    EXPECT_EQ(unreachable.error().kind, ErrorKind::input);
    EXPECT_NE(unreachable.error().message.find("residual"), std::string::npos) << unreachable.error().message;
    p.d[0] = 1;
    ASSERT_TRUE(solvers::solve_quadratic_programme(p));
    p.upper[1] = 0;
    EXPECT_FALSE(solvers::solve_quadratic_programme(p));
    p.upper[1] = std::nan("");
    EXPECT_FALSE(solvers::solve_quadratic_programme(p));
    p.upper = Eigen::VectorXd::Ones(3);
    EXPECT_FALSE(solvers::solve_quadratic_programme(p));
}

}  // namespace
}  // namespace spectex
