// Peters, Merzbach, Hanika and Dachsbacher, 'Using Moments to Represent Bounded Signals for Spectral Rendering', ACM Transactions
// on Graphics 38(4), 2019, doi:10.1145/3306346.3322964: three trigonometric moments, mirrored, of which the bounded maximum
// entropy spectral estimate makes a spectrum. Fourier sRGB: the same authors, 'Spectral Rendering with the Bounded MESE and sRGB
// Data', Workshop on Material Appearance Modeling 2019.
//
// Published are a table of moments and a table of the phases of wavelengths, both for CIE 1931 and D65. Here the phases follow
// from the observer by a rule (even shares of sqrt(x + y + z), the exponent and no even share of wavelengths chosen by how well
// measured reflectances are predicted: mean CIEDE2000 1.04 against 1.27 of phases linear in wavelength), and the moments of each colour are found by Newton's method, so
// that A r = rgb for any observer, light, space and bands. The functions 1/2 + arctan(P) / pi have one colour each, and all
// colours inside the object-colour solid, on whose surface P has become a step of one or two edges: the cube of BT.709 but
// black and white lies inside. Reflectances come in pairs g and 1 - g with multipliers v and -v, so only the darker half is
// solved. Towards black g tends to -1 / (pi P), and a colour below 2^-12 is a scaled one.
#include "methods/peters2019.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <mutex>
#include <numbers>

#include "kernels/arctangent.h"
#include "methods/near_table.h"
#include "methods/registry.h"
#include "spectex/color.h"

namespace spectex::peters2019 {
namespace {

using Complex = std::complex<double>;
constexpr double pi = std::numbers::pi;
/// Below the darkest sRGB code: moments of far darker colours would not tell the spikes of coarse bands apart.
constexpr double darkest = 0x1p-12;
/// How near to the boundary of what bounded functions have: far nearer than floats resolve, enough for finite multipliers.
constexpr double largest_reflection = 1 - 1e-12;
constexpr double first_nm = 360, last_nm = 830;
/// Of the tables of near solutions: the second is solved from the guesses of the first.
constexpr std::array<std::size_t, 2> resolutions{7, 17};

Vector3 grey_multipliers(const Vector3& q) { return {-1 / std::tan(pi * ((q[0] + q[1] + q[2]) / 3)), 0, 0}; }
double norm(const Vector3& v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

}  // namespace

double bounded(double p) { return std::atan2(1.0, -p) / pi; }

Vector3 moments_of(const Vector3& v) {
    // -P + i = (i - a) (1 - x u1)(1 - x u2), and with u = 2 w / (1 + w^2), |w| < 1, a factor is (1 - w z)(1 - w / z) / (1 + w^2)
    // at z = exp(i phi), whose logarithm has the Fourier coefficients -w^n / n.
    const Complex lead(v[0], -1);
    const Complex root = std::sqrt(v[1] * v[1] - 4.0 * lead * v[2]);
    const Complex plus = -v[1] + root, minus = -v[1] - root;
    const Complex larger = std::norm(plus) > std::norm(minus) ? plus : minus;
    const Complex u1 = larger / (2.0 * lead), u2 = larger == 0.0 ? Complex(0) : 2.0 * v[2] / larger;
    const auto inside = [](const Complex& u) { return u / (1.0 + std::sqrt(1.0 - u * u)); };
    const Complex w1 = inside(u1), w2 = inside(u2), q1 = w1 * w1, q2 = w2 * w2;
    return {(std::atan2(1.0, -v[0]) - std::arg(1.0 + q1) - std::arg(1.0 + q2)) / pi, -(w1 + w2).imag() / pi,
            -(q1 + q2).imag() / (2 * pi)};
}

Vector3 multipliers_of(const Vector3& m) {
    // Exponential moments, and Levinson's recursion on their Toeplitz matrix.
    const Complex half(std::sin(pi * m[0]) / (2 * pi), -std::cos(pi * m[0]) / (2 * pi));
    const double g0 = 2 * half.real();
    const Complex g1 = Complex(0, 2 * pi) * half * m[1];
    const Complex g2 = Complex(0, pi) * (2.0 * half * m[2] + g1 * m[1]);
    const auto limited = [](const Complex& k) {
        const double size = std::abs(k);
        return size > largest_reflection ? k * (largest_reflection / size) : k;
    };
    const Complex k1 = limited(-g1 / g0);
    const Complex k2 = limited(-(g2 + g1 * k1) / (g0 * (1 - std::norm(k1))));
    // Q(z) = 1 + p z + q z^2, and -P + i is a multiple of Q(z) Q(1/z).
    const Complex p = std::conj(k1 + k2 * std::conj(k1)), q = std::conj(k2);
    const Complex phase(std::cos(pi * m[0]), std::sin(pi * m[0]));
    const Complex constant = phase * (1.0 + p * p + q * q);
    // Positive wherever a function has the moments; drawn moments are near one that has.
    const double unit = 1 / std::max(constant.imag(), 1e-12);
    const double l0 = -unit * constant.real(), l1 = -2 * unit * (phase * p * (1.0 + q)).real(), l2 = -2 * unit * (phase * q).real();
    return {l0 - l2, l1, 2 * l2};
}

double phase_cosine(const Observer& observer, double wavelength_nm) {
    double all = 0, below = 0;
    for (std::size_t i = 0; i < observer.x_bar.size(); ++i) {
        const double nm = observer.start_nm + static_cast<double>(i);
        if (nm < first_nm || nm > last_nm) continue;
        const double share = std::sqrt(std::max(observer.x_bar[i] + observer.y_bar[i] + observer.z_bar[i], 0.0));
        // Each row is a nanometre wide.
        all += share;
        below += share * std::clamp(wavelength_nm - nm + 0.5, 0.0, 1.0);
    }
    return std::cos(pi * below / all);
}

/// Multipliers times z, the largest component, at the vertices of a near_table: with the factor they have a limit at black.
struct Solver::Near {
    std::once_flag made;
    kernels::ArctangentEquations equations;
    std::size_t resolution = 0;
    std::vector<Vector3> table;

    /// @param z  largest component of q.
    Vector3 guess(const Vector3& q, double z) const {
        const auto cell = near_table::cell_of(q, z, resolution);
        Vector3 v{};
        for (std::size_t corner = 0; corner < 8; ++corner)
            for (std::size_t i = 0; i < 3; ++i) v[i] += cell.share[corner] / z * table[cell.vertex[corner]][i];
        return v;
    }
};

Solver::Solver(const Colorimetry& colorimetry) : near_(std::make_shared<Near>()) {
    const auto& a = colorimetry.sensing_matrix();
    const std::size_t n = colorimetry.bands().size();
    for (std::size_t b = 0; b < n; ++b) {
        x_.push_back(phase_cosine(colorimetry.observer(), colorimetry.bands()[b]));
        sense_.push_back({a[b], a[n + b], a[2 * n + b]});
    }
}

bool Solver::newton(const Vector3& q, Vector3& v, Solution& report) const {
    const double unit = 1 / std::max({q[0], q[1], q[2]});
    Matrix3 jacobian;
    const auto evaluate = [&](const Vector3& at, Matrix3* j) {
        Vector3 f{-q[0], -q[1], -q[2]};
        if (j) j->m.fill(0);
        for (std::size_t b = 0; b < x_.size(); ++b) {
            const double x = x_[b], p = (at[2] * x + at[1]) * x + at[0], g = bounded(p);
            for (std::size_t i = 0; i < 3; ++i) f[i] += sense_[b][i] * g;
            if (!j) continue;
            const double slope = 1 / (pi * (1 + p * p));
            for (std::size_t i = 0; i < 3; ++i) {
                const double s = sense_[b][i] * slope;
                (*j)(i, 0) += s;
                (*j)(i, 1) += s * x;
                (*j)(i, 2) += s * x * x;
            }
        }
        for (double& e : f) e *= unit;
        if (j)
            for (double& e : j->m) e *= unit;
        return f;
    };
    Vector3 f = evaluate(v, &jacobian);
    double size = norm(f);
    for (int step = 0; step < 60; ++step) {
        const Vector3 d = jacobian.inverse() * f;
        if (!std::isfinite(d[0] + d[1] + d[2])) break;
        ++report.steps;
        double length = 1;
        bool better = false;
        for (int half = 0; half < 12 && !better; ++half, length *= 0.5) {
            const Vector3 next{v[0] - length * d[0], v[1] - length * d[1], v[2] - length * d[2]};
            Matrix3 j;
            const Vector3 g = evaluate(next, &j);
            const double reached = norm(g);
            better = reached < (1 - 0.25 * length) * size;
            // The last steps change rounding only: the best is kept.
            if (better || (size < 1e-13 && reached < size)) v = next, f = g, jacobian = j, size = reached;
            if (size < 1e-13) break;
        }
        if (!better || size < 2e-16) break;
    }
    report.error = std::max({std::abs(f[0]), std::abs(f[1]), std::abs(f[2])});
    return size < 1e-12;
}

bool Solver::prepare(const Vector3& rgb, Solution& s, Prepared& out) {
    s = {};
    Vector3& q = out.q;
    for (std::size_t i = 0; i < 3; ++i) q[i] = rgb[i] > 0 ? std::min(rgb[i], 1.0) : 0.0;
    double top = std::max({q[0], q[1], q[2]}), low = std::min({q[0], q[1], q[2]});
    s.complement = 1 - low < top;
    if (s.complement) {
        for (double& v : q) v = 1 - v;
        const double dark = 1 - top;
        top = 1 - low, low = dark;
    }
    if (!(top > 0)) {
        s.scale = 0;
        return false;
    }
    if (top < darkest) {
        s.scale = top / darkest;
        // Denormals have no digits to lose in a division by their largest.
        for (double& v : q) v = v / top * darkest;
        top = darkest;
    }
    out.top = top, out.low = low;
    return true;
}

const Solver::Near& Solver::near() const {
    std::call_once(near_->made, [&] {
        Near& near = *near_;
        for (std::size_t b = 0; b < x_.size(); ++b) near.equations.bands.push_back({x_[b], sense_[b]});
        for (const std::size_t n : resolutions) {
            const auto colors = near_table::vertices(n, darkest);
            std::vector<double> rgb;
            for (const Vector3& q : colors) rgb.insert(rgb.end(), q.begin(), q.end());
            std::vector<Solution> solved(colors.size());
            if (near.resolution == 0)
                std::transform(colors.begin(), colors.end(), solved.begin(), [&](const Vector3& q) { return solve(q); });
            else
                solve(rgb, solved.data(), near);
            near.table.assign(solved.size(), {});
            for (std::size_t i = 0; i < solved.size(); ++i) {
                const double z = std::max({colors[i][0], colors[i][1], colors[i][2]}), factor = solved[i].complement ? -z : z;
                for (std::size_t l = 0; l < 3; ++l) near.table[i][l] = factor * solved[i].multipliers[l];
            }
            near.resolution = n;
        }
    });
    return *near_;
}

void Solver::solve(std::span<const double> rgb, Solution* out) const { solve(rgb, out, near()); }

void Solver::solve(std::span<const double> rgb, Solution* out, const Near& near) const {
    constexpr std::size_t block = 256;
    std::array<double, block> q[3], v[3];
    std::array<std::size_t, block> where;
    std::array<bool, block> accepted;
    const std::size_t n = rgb.size() / 3;
    for (std::size_t begin = 0; begin < n; begin += block) {
        std::size_t gathered = 0;
        for (std::size_t i = begin; i < std::min(begin + block, n); ++i) {
            Prepared p;
            if (!prepare({rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]}, out[i], p)) continue;
            if (p.top - p.low <= 1e-15 * p.top) {
                out[i].multipliers = grey_multipliers(p.q);
                continue;
            }
            const Vector3 start = near.guess(p.q, p.top);
            for (std::size_t k = 0; k < 3; ++k) q[k][gathered] = p.q[k], v[k][gathered] = start[k];
            where[gathered++] = i;
        }
        kernels::refine_arctangents(near.equations, {q[0].data(), q[1].data(), q[2].data()}, gathered,
                                    {v[0].data(), v[1].data(), v[2].data()}, accepted.data());
        for (std::size_t g = 0; g < gathered; ++g) {
            const std::size_t i = where[g];
            if (accepted[g])
                out[i].multipliers = {v[0][g], v[1][g], v[2][g]};
            else
                out[i] = solve({rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]});
        }
    }
}

Solution Solver::solve(const Vector3& rgb) const {
    Solution s;
    Prepared p;
    if (!prepare(rgb, s, p)) return s;
    const auto& [q, top, low] = p;
    // A grey of the same brightness has P constant; from there along the straight line, in as long steps as Newton bears.
    const double grey = (q[0] + q[1] + q[2]) / 3;
    Vector3 v = grey_multipliers(q);
    if (top - low <= 1e-15 * top) {
        s.multipliers = v;
        return s;
    }
    double reached = 0, stride = 1;
    while (reached < 1 && stride > 1e-6) {
        const double goal = std::min(1.0, reached + stride);
        Vector3 trial = v;
        const Vector3 colour{grey + goal * (q[0] - grey), grey + goal * (q[1] - grey), grey + goal * (q[2] - grey)};
        if (newton(goal < 1 ? colour : q, trial, s)) {
            v = trial, reached = goal, stride *= 2;
        } else {
            stride *= 0.25;
        }
    }
    if (reached < 1) s.error = 1 - reached;
    s.multipliers = v;
    return s;
}

void Solver::reflectances(const Solution& s, std::span<const double> x, double* out) {
    if (s.scale > 0)
        kernels::evaluate_arctangents(s.multipliers, x, out);
    else
        std::fill_n(out, x.size(), 0.0);
    if (s.scale < 1)
        for (std::size_t b = 0; b < x.size(); ++b) out[b] *= s.scale;
    if (s.complement)
        for (std::size_t b = 0; b < x.size(); ++b) out[b] = 1 - out[b];
}

Vector3 Solver::moments(const Solution& s) {
    if (!(s.scale > 0)) return {s.complement ? 1.0 : 0.0, 0, 0};
    Vector3 m = moments_of(s.multipliers);
    for (double& v : m) v *= s.scale;
    if (s.complement) m = {1 - m[0], -m[1], -m[2]};
    return m;
}

Solution Solver::of_moments(Vector3 m) {
    Solution s;
    // No bounded function has larger ones: |m_j| <= 1 / pi for j > 0.
    for (double& v : m) v = v >= -1 ? std::min(v, 1.0) : v < -1 ? -1.0 : 0.0;
    s.complement = m[0] > 0.5;
    if (s.complement) m = {1 - m[0], -m[1], -m[2]};
    if (!(m[0] > 0)) {
        s.scale = 0;
        return s;
    }
    if (m[0] < darkest) {
        s.scale = m[0] / darkest;
        m = {darkest, std::clamp(m[1] / m[0], -1.0, 1.0) * darkest, std::clamp(m[2] / m[0], -1.0, 1.0) * darkest};
    }
    s.multipliers = multipliers_of(m);
    return s;
}

}  // namespace spectex::peters2019

namespace spectex::registry {
namespace {

using peters2019::Solution;
using peters2019::Solver;

constexpr std::string_view fourier_id = "peters2019:fourier-srgb";

/// Rows of [1, s1, s2]: Fourier RGB from moments. White has the moments (1, 0, 0), so that greys stay what they are.
Matrix3 fourier_matrix(const std::vector<double>& slopes) {
    return {{1, slopes[0], slopes[1], 1, slopes[2], slopes[3], 1, slopes[4], slopes[5]}};
}

class MomentModel final : public Model {
public:
    MomentModel(const MethodInfo& info, const Colorimetry& colorimetry, Solver solver, std::vector<double> slopes)
        : Model(info, colorimetry), solver_(std::move(solver)), slopes_(std::move(slopes)) {
        if (!slopes_.empty()) to_fourier_ = fourier_matrix(slopes_), to_moments_ = to_fourier_.inverse();
    }

    void reflectance(std::span<const double> rgb, std::span<double> out) const override {
        spectra(rgb, solver_.phase_cosines(), out);
    }
    std::vector<std::string> coefficient_names() const override {
        if (slopes_.empty()) return {"m0", "m1", "m2"};
        return {"R", "G", "B"};
    }
    void coefficients(std::span<const double> rgb, std::span<double> out) const override {
        of_each(rgb, [&](std::size_t p, const Solution& s) {
            Vector3 m = Solver::moments(s);
            if (!slopes_.empty()) m = to_fourier_ * m;
            std::copy(m.begin(), m.end(), &out[3 * p]);
        });
    }
    void reflectance_of_coefficients(std::span<const double> coefficients, std::span<double> out) const override {
        spectra_of_coefficients(coefficients, solver_.phase_cosines(), out);
    }
    bool bands_apart() const override { return true; }
    void reflectance_in(std::span<const std::size_t> bands, std::span<const double> rgb, std::span<double> out) const override {
        spectra(rgb, cosines_of(bands), out);
    }
    void reflectance_of_coefficients_in(std::span<const std::size_t> bands, std::span<const double> coefficients,
                                        std::span<double> out) const override {
        spectra_of_coefficients(coefficients, cosines_of(bands), out);
    }
    std::string to_json() const override {
        Json json = model_json(*this);
        if (!slopes_.empty()) json["fourier"] = slopes_;
        return json.dump(-1, ' ', false, Json::error_handler_t::replace);
    }

private:
    Solution solution_of(const double* coefficients) const {
        const Vector3 m{coefficients[0], coefficients[1], coefficients[2]};
        return Solver::of_moments(slopes_.empty() ? m : to_moments_ * m);
    }
    /// take(p, solution) of each colour.
    template <class Take>
    void of_each(std::span<const double> rgb, const Take& take) const {
        constexpr std::size_t block = 256;
        std::array<Solution, block> solved;
        const std::size_t n = rgb.size() / 3;
        for (std::size_t begin = 0; begin < n; begin += block) {
            const std::size_t count = std::min(block, n - begin);
            solver_.solve(rgb.subspan(3 * begin, 3 * count), solved.data());
            for (std::size_t i = 0; i < count; ++i) take(begin + i, solved[i]);
        }
    }
    void spectra(std::span<const double> rgb, std::span<const double> x, std::span<double> out) const {
        of_each(rgb, [&](std::size_t p, const Solution& s) { Solver::reflectances(s, x, &out[p * x.size()]); });
    }
    void spectra_of_coefficients(std::span<const double> coefficients, std::span<const double> x, std::span<double> out) const {
        for (std::size_t p = 0; 3 * p + 2 < coefficients.size(); ++p)
            Solver::reflectances(solution_of(&coefficients[3 * p]), x, &out[p * x.size()]);
    }
    std::vector<double> cosines_of(std::span<const std::size_t> bands) const {
        std::vector<double> x;
        for (const std::size_t b : bands) x.push_back(solver_.phase_cosines()[b]);
        return x;
    }

    Solver solver_;
    std::vector<double> slopes_;  ///< six for Fourier RGB
    Matrix3 to_fourier_, to_moments_;
};

Result<Solver> make_solver(const MethodInfo& info, const Colorimetry& colorimetry) {
    const auto infeasible = [&](std::string why) {
        return Error{ErrorKind::infeasible, fmt::format("{}: {} ({})", info.id, why, colorimetry.describe())};
    };
    const Vector3 diffuser = colorimetry.rgb_of(std::vector<double>(colorimetry.bands().size(), 1.0));
    for (const double v : diffuser)
        if (!(std::abs(v - 1) <= 1e-9))
            return infeasible(fmt::format("the perfect diffuser is RGB ({}, {}, {}), not (1,1,1); the integrated matrix makes it so",
                                          diffuser[0], diffuser[1], diffuser[2]));
    Solver solver(colorimetry);
    // The object colours are a convex set, so the cube lies inside when its vertices do.
    for (int v = 1; v < 7; ++v) {
        const Vector3 rgb{double(v & 1), double(v >> 1 & 1), double(v >> 2)};
        if (const auto s = solver.solve(rgb); !(s.error <= 1e-9))
            return infeasible(fmt::format("no spectrum is found for RGB ({}, {}, {})", rgb[0], rgb[1], rgb[2]));
    }
    return solver;
}

/// The slopes with which Fourier RGB is nearest to RGB, by least squares over codes evenly spaced in the sRGB curve, and then
/// as much flatter as 8-bit storage needs: all of the cube has Fourier RGB in [0,1].
std::vector<double> fit_slopes(const Solver& solver) {
    constexpr int steps = 8;
    double m11 = 0, m12 = 0, m22 = 0;
    std::array<double, 3> r1{}, r2{};
    std::vector<Vector3> moments;
    const auto linear = [](int i) { return srgb_decode(static_cast<double>(i) / steps); };
    for (int r = 0; r <= steps; ++r)
        for (int g = 0; g <= steps; ++g)
            for (int b = 0; b <= steps; ++b) {
                const Vector3 rgb{linear(r), linear(g), linear(b)}, m = Solver::moments(solver.solve(rgb));
                moments.push_back(m);
                m11 += m[1] * m[1], m12 += m[1] * m[2], m22 += m[2] * m[2];
                for (std::size_t c = 0; c < 3; ++c) r1[c] += m[1] * (rgb[c] - m[0]), r2[c] += m[2] * (rgb[c] - m[0]);
            }
    const double determinant = m11 * m22 - m12 * m12;
    std::vector<double> out;
    for (std::size_t c = 0; c < 3; ++c) {
        const double s1 = (m22 * r1[c] - m12 * r2[c]) / determinant, s2 = (m11 * r2[c] - m12 * r1[c]) / determinant;
        double most = 1;
        for (const Vector3& m : moments) {
            const double rise = s1 * m[1] + s2 * m[2];
            if (rise > 0) most = std::min(most, (1 - m[0]) / rise);
            if (rise < 0) most = std::min(most, m[0] / -rise);
        }
        out.push_back(most * s1);
        out.push_back(most * s2);
    }
    return out;
}

ModelResult make_moments(const MethodInfo& info, const Colorimetry& colorimetry) {
    auto solver = make_solver(info, colorimetry);
    if (!solver) return std::move(solver).error();
    auto slopes = info.id == fourier_id ? fit_slopes(*solver) : std::vector<double>{};
    return std::shared_ptr<const Model>(std::make_shared<MomentModel>(info, colorimetry, *std::move(solver), std::move(slopes)));
}

ModelResult read_moments(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    auto solver = make_solver(info, colorimetry);
    if (!solver) return Error{ErrorKind::input, "model: " + solver.error().message};
    std::vector<double> slopes;
    if (info.id == fourier_id) {
        auto read = read_numbers(json, "fourier", 6, -1e3, 1e3);
        if (!read) return std::move(read).error();
        slopes = *std::move(read);
        for (const double v : fourier_matrix(slopes).inverse().m)
            if (!(std::abs(v) < 1e6)) return Error{ErrorKind::input, "model: member 'fourier': moments do not follow from these slopes"};
    }
    return std::shared_ptr<const Model>(std::make_shared<MomentModel>(info, colorimetry, *std::move(solver), std::move(slopes)));
}

Entry entry(std::string_view id, std::string title, std::string source) {
    MethodInfo info;
    info.id = id;
    info.title = std::move(title);
    info.source = std::move(source);
    info.pieces = Pieces::nonlinear;
    info.exact = true;
    info.bounded = true;
    return {std::move(info), make_moments, read_moments};
}

}  // namespace

Entry peters2019() {
    return entry("peters2019", "Bounded maximum entropy from three moments",
                 "Peters, Merzbach, Hanika and Dachsbacher 2019, TOG 38(4), doi:10.1145/3306346.3322964");
}

Entry peters2019_fourier() {
    return entry(fourier_id, "The same, kept as Fourier sRGB",
                 "Peters, Merzbach, Hanika and Dachsbacher 2019, Workshop on Material Appearance Modeling; moments as in "
                 "doi:10.1145/3306346.3322964");
}

}  // namespace spectex::registry
