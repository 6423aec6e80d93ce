// Burns, 'Numerical methods for smoothest reflectance reconstruction', Color Research and Application 45(1), 2020,
// doi:10.1002/col.22437: least hyperbolic tangent slope squared. r = (tanh z + 1) / 2, and of all z with A r = rgb the one of
// least sum of squared differences.
//
// Newton's method on the Karush-Kuhn-Tucker system, from a flat spectrum, for each colour by itself. The Hessian is
// tridiagonal, so that a step costs O(bands): the system of the multipliers is 3x3. Colours nearer to white than to black are
// solved as their complements, 1 - rgb and -z, which is the same problem and keeps its digits. Black and white are the limits
// z -> -inf and +inf, greys are flat. Many colours are solved several at a time by vectors, from guesses of a table, and those
// that do not settle there one by one.
#include "methods/burns2020.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <mutex>

#include "kernels/tanh_spectra.h"
#include "methods/near_table.h"
#include "methods/registry.h"

namespace spectex::burns2020 {
namespace {

/// Of the tables of guesses: the second is solved from the first.
constexpr std::array<std::size_t, 2> resolutions{5, 13};
/// What stands for black in the tables, and from where on colours are solved one by one.
constexpr double darkest_vertex = 1e-4, darkest = 1e-20;

bool is_grey(double top, double low) { return top - low <= 1e-14 * top || !(top > 0); }
bool is_complement(double top, double low) { return 1 - low < top; }

}  // namespace

/// z less half the logarithm of the largest component, which has a limit at black, and the multipliers, at the vertices of a
/// near_table.
struct Solver::Guesses {
    std::once_flag made;
    kernels::TanhEquations equations;
    std::size_t resolution = 0;
    std::vector<float> table;  ///< [vertex][bands + 3]

    /// @param state  at least [colors][bands + 3].
    void refine(const std::vector<Vector3>& colors, std::vector<double>& state, double* r, bool* accepted) const {
        const std::size_t bands = equations.a.size(), width = bands + 3;
        for (std::size_t g = 0; g < colors.size(); ++g) {
            const double z = std::max({colors[g][0], colors[g][1], colors[g][2]}), shift = 0.5 * std::log(z);
            const auto cell = near_table::cell_of(colors[g], z, resolution);
            double* to = &state[g * width];
            for (std::size_t l = 0; l < width; ++l) to[l] = l < bands ? shift : 0;
            for (std::size_t corner = 0; corner < 8; ++corner) {
                const float* vertex = &table[cell.vertex[corner] * width];
                for (std::size_t l = 0; l < width; ++l) to[l] += cell.share[corner] * static_cast<double>(vertex[l]);
            }
        }
        kernels::refine_tanh_spectra(equations, colors.empty() ? nullptr : colors[0].data(), colors.size(), state.data(), r, accepted);
    }
};

Solver::Solver(const Colorimetry& colorimetry) : a_(colorimetry.sensing_matrix()), guesses_(std::make_shared<Guesses>()) {
    const auto& nm = colorimetry.bands().wavelengths_nm();
    const double mean = (nm.back() - nm.front()) / static_cast<double>(nm.size() - 1);
    for (std::size_t l = 0; l + 1 < nm.size(); ++l) {
        const double h = nm[l + 1] - nm[l];
        // Even grids have centres rounded to 1e-6 nm.
        slope_.push_back(std::abs(h - mean) < 2e-6 ? 1.0 : mean * mean / (h * h));
    }
}

void Solver::tabulate(std::size_t n) const {
    Guesses& guesses = *guesses_;
    const std::size_t width = bands() + 3;
    const auto colors = near_table::vertices(n, darkest_vertex);
    std::vector<double> state(colors.size() * width), r(colors.size() * bands());
    const auto accepted = std::make_unique<bool[]>(colors.size());
    if (guesses.resolution > 0) guesses.refine(colors, state, r.data(), accepted.get());
    std::vector<float> table(state.size());
    Work work(bands());
    for (std::size_t i = 0; i < colors.size(); ++i) {
        const double top = std::max({colors[i][0], colors[i][1], colors[i][2]}), low = std::min({colors[i][0], colors[i][1], colors[i][2]});
        // White itself, about which no colours are asked for, has no z.
        if (low >= 1) continue;
        double* found = &state[i * width];
        if (!accepted[i]) {
            newton(colors[i], work);
            std::copy(work.z.begin(), work.z.end(), found);
            std::copy(work.y.begin(), work.y.end(), found + bands());
        }
        for (std::size_t l = 0; l < width; ++l) table[i * width + l] = static_cast<float>(found[l] - (l < bands() ? 0.5 * std::log(top) : 0));
    }
    guesses.resolution = n;
    guesses.table = std::move(table);
}

void Solver::solve(std::span<const double> rgb, std::span<double> out) const {
    std::call_once(guesses_->made, [&] {
        guesses_->equations.slope = slope_;
        for (std::size_t l = 0; l < bands(); ++l) guesses_->equations.a.push_back({a_[l], a_[bands() + l], a_[2 * bands() + l]});
        for (const std::size_t n : resolutions) tabulate(n);
    });
    const std::size_t n = rgb.size() / 3;
    constexpr std::size_t block = 32;
    Work work(bands());
    std::vector<Vector3> colors;
    std::vector<std::size_t> where;
    std::vector<double> state(block * (bands() + 3)), r(block * bands());
    std::array<bool, block> accepted;
    const auto ends = [&](std::size_t p) {
        const double* c = &rgb[3 * p];
        return std::array{std::max({c[0], c[1], c[2]}), std::min({c[0], c[1], c[2]})};
    };
    for (std::size_t begin = 0; begin < n; begin += block) {
        colors.clear(), where.clear();
        for (std::size_t p = begin; p < std::min(begin + block, n); ++p) {
            const auto [top, low] = ends(p);
            if (is_grey(top, low) || !(low >= 0 && top <= 1) || std::min(top, 1 - low) < darkest) {
                solve(&rgb[3 * p], &out[p * bands()], work);
                continue;
            }
            Vector3 color{rgb[3 * p], rgb[3 * p + 1], rgb[3 * p + 2]};
            if (is_complement(top, low))
                for (double& v : color) v = 1 - v;
            colors.push_back(color);
            where.push_back(p);
        }
        guesses_->refine(colors, state, r.data(), accepted.data());
        for (std::size_t g = 0; g < where.size(); ++g) {
            const std::size_t p = where[g];
            if (!accepted[g]) {
                solve(&rgb[3 * p], &out[p * bands()], work);
                continue;
            }
            const auto [top, low] = ends(p);
            const bool complement = is_complement(top, low);
            for (std::size_t l = 0; l < bands(); ++l) out[p * bands() + l] = complement ? 1 - r[g * bands() + l] : r[g * bands() + l];
        }
    }
}

Solution Solver::solve(const double* rgb, double* out, Work& work) const {
    const std::size_t n = bands();
    const double top = std::max({rgb[0], rgb[1], rgb[2]}), low = std::min({rgb[0], rgb[1], rgb[2]});
    if (is_grey(top, low)) {
        std::fill_n(out, n, (rgb[0] + rgb[1] + rgb[2]) / 3);
        return {};
    }
    const bool complement = is_complement(top, low);
    Vector3 color{rgb[0], rgb[1], rgb[2]};
    if (complement)
        for (double& v : color) v = 1 - v;
    const Solution solution = newton(color, work);
    // 1 - r as 1 - r: r is the smaller of the two and exact to its own digits.
    for (std::size_t l = 0; l < n; ++l) out[l] = complement ? 1 - work.best[l] : work.best[l];
    return solution;
}

Solution Solver::newton(const Vector3& color, Work& w) const {
    const std::size_t n = slope_.size() + 1;
    const auto& a = a_;
    const double unit = 1 / std::max({color[0], color[1], color[2]});
    const double mean = std::clamp((color[0] + color[1] + color[2]) / 3, 1e-300, 0.5);
    std::fill(w.z.begin(), w.z.end(), 0.5 * (std::log(mean) - std::log1p(-mean)));
    Vector3& y = w.y = {};
    double best = HUGE_VAL;
    bool near = false;
    constexpr int max_steps = 200;
    int settled = 0, step = 0;
    for (; step < max_steps; ++step) {
        Vector3 residual{-color[0], -color[1], -color[2]};
        for (std::size_t l = 0; l < n; ++l) {
            w.r[l] = 1 / (1 + std::exp(-2 * w.z[l]));
            for (std::size_t c = 0; c < 3; ++c) residual[c] += a[c * n + l] * w.r[l];
        }
        const double error = unit * std::max({std::abs(residual[0]), std::abs(residual[1]), std::abs(residual[2])});
        // The last steps change rounding only; of those the best is kept.
        if (error < best || settled == 0) best = error, w.best = w.r;
        if (settled > 0 && (error < 4e-16 || settled > 2)) break;

        // Gradient and Hessian of the Lagrangian sum w (dz)^2 + y . unit (A r - rgb), right sides -gradient and J^T.
        for (std::size_t l = 0; l < n; ++l) {
            const double r = w.r[l], first = 2 * r * (1 - r), second = 2 * first * (1 - 2 * r);
            const double s = unit * (y[0] * a[l] + y[1] * a[n + l] + y[2] * a[2 * n + l]);
            double gradient = first * s, curvature = second * s;
            // Far from the solution a convex model; near it Newton's own, which converges quadratically.
            if (!near) curvature = std::max(curvature, 0.0);
            double diagonal = curvature + kernels::tanh_regularization;
            if (l > 0) {
                gradient += 2 * slope_[l - 1] * (w.z[l] - w.z[l - 1]);
                diagonal += 2 * slope_[l - 1];
            }
            if (l + 1 < n) {
                gradient -= 2 * slope_[l] * (w.z[l + 1] - w.z[l]);
                diagonal += 2 * slope_[l];
            }
            w.diagonal[l] = diagonal;
            double* right = &w.right[4 * l];
            right[0] = -gradient;
            for (std::size_t c = 0; c < 3; ++c) right[1 + c] = unit * a[c * n + l] * first;
        }
        // Tridiagonal LDL^T with four right sides.
        std::array<double, 9> schur{};
        Vector3 reduced{};
        std::vector<double>& inverse = w.inverse;
        inverse[0] = 1 / w.diagonal[0];
        for (std::size_t l = 1; l < n; ++l) {
            const double below = -2 * slope_[l - 1], factor = below * inverse[l - 1];
            inverse[l] = 1 / (w.diagonal[l] - factor * below);
            for (std::size_t k = 0; k < 4; ++k) w.right[4 * l + k] -= factor * w.right[4 * (l - 1) + k];
        }
        // J H^-1 J^T and J H^-1 (-gradient) from the half-solved right sides.
        for (std::size_t l = 0; l < n; ++l) {
            const double* u = &w.right[4 * l];
            for (std::size_t i = 0; i < 3; ++i) {
                reduced[i] += u[1 + i] * inverse[l] * u[0];
                for (std::size_t j = 0; j <= i; ++j) schur[3 * i + j] += u[1 + i] * inverse[l] * u[1 + j];
            }
        }
        Matrix3 matrix{{schur[0], schur[3], schur[6], schur[3], schur[4], schur[7], schur[6], schur[7], schur[8]}};
        const Vector3 dy = matrix.inverse() * Vector3{reduced[0] + unit * residual[0], reduced[1] + unit * residual[1],
                                                      reduced[2] + unit * residual[2]};
        if (!std::isfinite(dy[0] + dy[1] + dy[2])) {
            if (!near) break;
            near = false;
            continue;
        }
        double next = 0, largest = 0;
        for (std::size_t l = n; l-- > 0;) {
            const double* u = &w.right[4 * l];
            double d = u[0] - dy[0] * u[1] - dy[1] * u[2] - dy[2] * u[3];
            if (l + 1 < n) d += 2 * slope_[l] * next;
            next = d * inverse[l];
            w.right[4 * l] = next;
            largest = std::max(largest, std::abs(next));
        }
        // r changes e-fold per half unit of z, beyond which the linear model is worth nothing.
        const double length = std::min(1.0, 1.0 / largest);
        for (std::size_t l = 0; l < n; ++l) w.z[l] += length * w.right[4 * l];
        for (std::size_t c = 0; c < 3; ++c) y[c] += length * dy[c];
        near = largest < 0.3 && step < max_steps / 2;
        if (largest < 1e-9) ++settled;
    }
    return {best, step};
}

}  // namespace spectex::burns2020

namespace spectex::registry {
namespace {

class TanhModel final : public Model {
public:
    TanhModel(const MethodInfo& info, const Colorimetry& colorimetry) : Model(info, colorimetry), solver(colorimetry) {}

    void reflectance(std::span<const double> rgb, std::span<double> out) const override {
        solver.solve(rgb, out);
    }
    std::string to_json() const override { return model_json(*this).dump(-1, ' ', false, Json::error_handler_t::replace); }

    const burns2020::Solver solver;
};

ModelResult make_log_slopes(const MethodInfo& info, const Colorimetry& colorimetry) {
    const std::size_t bands = colorimetry.bands().size();
    const auto infeasible = [&](std::string why) {
        return Error{ErrorKind::infeasible, fmt::format("{}: {} ({})", info.id, why, colorimetry.describe())};
    };
    const Vector3 diffuser = colorimetry.rgb_of(std::vector<double>(bands, 1.0));
    for (const double v : diffuser)
        if (!(std::abs(v - 1) <= 1e-9))
            return infeasible(fmt::format("the perfect diffuser is RGB ({}, {}, {}), not (1,1,1); the integrated matrix makes it so",
                                          diffuser[0], diffuser[1], diffuser[2]));
    auto model = std::make_shared<TanhModel>(info, colorimetry);
    std::vector<double> r(bands);
    burns2020::Solver::Work work(bands);
    // The object colours are a convex set, so the cube lies inside when its vertices do; an edge's middle is no worse.
    for (int v = 1; v < 7; ++v) {
        const Vector3 rgb{double(v & 1), double(v >> 1 & 1), double(v >> 2)};
        const double error = model->solver.solve(rgb.data(), r.data(), work).error;
        if (!(error <= 1e-9))
            return infeasible(fmt::format("no spectrum is found for RGB ({}, {}, {}): the best misses by {:.3g}", rgb[0], rgb[1], rgb[2], error));
    }
    return std::shared_ptr<const Model>(std::move(model));
}

ModelResult read_log_slopes(const MethodInfo& info, const Colorimetry& colorimetry, const Json&) {
    auto made = make_log_slopes(info, colorimetry);
    if (!made) return Error{ErrorKind::input, "model: " + made.error().message};
    return made;
}

}  // namespace

Entry burns2020() {
    MethodInfo info;
    info.id = "burns2020";
    info.title = "Least hyperbolic tangent slope squared";
    info.source = "Burns 2020, Color Research and Application 45(1), doi:10.1002/col.22437";
    info.pieces = Pieces::nonlinear;
    info.exact = true;
    info.bounded = true;
    return {std::move(info), make_log_slopes, read_log_slopes};
}

}  // namespace spectex::registry
