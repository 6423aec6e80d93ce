#include "methods/smoothest.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "solvers/quadratic_programme.h"

namespace spectex::registry {
namespace {

using solvers::QuadraticProgramme;
using solvers::SparseMatrix;
using Triplets = std::vector<Eigen::Triplet<double>>;

constexpr double infinity = std::numeric_limits<double>::infinity();

/// A power of two, so that rows of every scale weigh alike and no number is rounded.
double unit_of(std::span<const double> row) {
    double top = 0;
    for (const double v : row) top = std::max(top, std::abs(v));
    return top > 0 ? std::exp2(-std::ceil(std::log2(top))) : 1;
}

/// The smallest t with -t <= r <= upper + t and weights r = target: v = r + t >= 0, w = upper + t - r >= 0.
Result<double> least_violation(std::span<const double> weights, std::size_t n, const Vector3& target, double upper) {
    const auto at = [](std::size_t i) { return static_cast<int>(i); };
    const bool bounded = std::isfinite(upper);
    const std::size_t t = bounded ? 2 * n : n, rows = bounded ? n + 3 : 3;
    QuadraticProgramme<SparseMatrix> p;
    const auto unknowns = static_cast<Eigen::Index>(t + 1);
    p.P.resize(unknowns, unknowns);
    p.q = Eigen::VectorXd::Zero(unknowns);
    p.q[at(t)] = 1;
    p.d = Eigen::VectorXd::Constant(at(rows), upper);
    Triplets entries;
    for (std::size_t c = 0; c < 3; ++c) {
        const auto row = weights.subspan(c * n, n);
        const double unit = unit_of(row);
        double white = 0;
        for (std::size_t l = 0; l < n; ++l) {
            entries.emplace_back(at(c), at(l), row[l] * unit);
            white += row[l] * unit;
        }
        entries.emplace_back(at(c), at(t), -white);
        p.d[at(c)] = target[c] * unit;
    }
    if (bounded)
        for (std::size_t l = 0; l < n; ++l) {
            entries.emplace_back(at(3 + l), at(l), 1);
            entries.emplace_back(at(3 + l), at(n + l), 1);
            entries.emplace_back(at(3 + l), at(t), -2);
        }
    p.C.resize(at(rows), unknowns);
    p.C.setFromTriplets(entries.begin(), entries.end());
    p.lower = Eigen::VectorXd::Zero(unknowns);
    // Below -upper / 2 the range is empty; without an upper bound t could fall for ever.
    p.lower[at(t)] = bounded ? -upper : -1;
    p.upper = Eigen::VectorXd::Constant(unknowns, infinity);
    solvers::QuadraticProgrammeOptions options;
    options.polish = false;
    const auto solved = solve_quadratic_programme(p, options);
    if (!solved) return solved.error();
    return solved->x[at(t)];
}

}  // namespace

Result<std::vector<double>> smoothest_spectrum(std::span<const double> weights, std::span<const double> wavelengths_nm,
                                               const Vector3& target, double upper) {
    const std::size_t n = wavelengths_nm.size();
    const auto at = [](std::size_t i) { return static_cast<int>(i); };
    const double mean = (wavelengths_nm.back() - wavelengths_nm.front()) / static_cast<double>(n - 1);
    // Finer grids have smaller differences; the factor keeps the objective in proportion to the bounds.
    const double factor = 2 * static_cast<double>(n) / 81;
    QuadraticProgramme<SparseMatrix> p;
    Triplets entries;
    for (std::size_t l = 0; l + 1 < n; ++l) {
        const double h = wavelengths_nm[l + 1] - wavelengths_nm[l];
        // Even grids have centres rounded to 1e-6 nm.
        const double w = factor * (std::abs(h - mean) < 2e-6 ? 1.0 : mean * mean / (h * h));
        entries.emplace_back(at(l), at(l), w);
        entries.emplace_back(at(l + 1), at(l + 1), w);
        entries.emplace_back(at(l), at(l + 1), -w);
        entries.emplace_back(at(l + 1), at(l), -w);
    }
    p.P.resize(at(n), at(n));
    p.P.setFromTriplets(entries.begin(), entries.end());
    p.q = Eigen::VectorXd::Zero(at(n));
    entries.clear();
    p.d.resize(3);
    for (std::size_t c = 0; c < 3; ++c) {
        const auto row = weights.subspan(c * n, n);
        const double unit = unit_of(row);
        for (std::size_t l = 0; l < n; ++l) entries.emplace_back(at(c), at(l), row[l] * unit);
        p.d[at(c)] = target[c] * unit;
    }
    p.C.resize(3, at(n));
    p.C.setFromTriplets(entries.begin(), entries.end());
    p.lower = Eigen::VectorXd::Zero(at(n));
    p.upper = Eigen::VectorXd::Constant(at(n), upper);
    const auto solved = solve_quadratic_programme(p);
    if (!solved) {
        const auto t = least_violation(weights, n, target, upper);
        // The linear programme is solved to 1e-10; what violates less exists as far as can be told.
        if (t && *t > 1e-9)
            return Error{ErrorKind::infeasible, fmt::format("({:.4g}, {:.4g}, {:.4g}): the best spectrum violates its bounds by {:.4g}",
                                                            target[0], target[1], target[2], *t)};
        return solved.error();
    }
    return std::vector<double>(solved->x.data(), solved->x.data() + solved->x.size());
}

}  // namespace spectex::registry
