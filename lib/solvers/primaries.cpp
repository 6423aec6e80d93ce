// Mallett and Yuksel, 'Spectral Primary Decomposition for Rendering with sRGB Reflectance', EGSR 2019,
// doi:10.2312/sr.20191216: eq. 5 to 8 as a quadratic programme.
#include "solvers/primaries.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "solvers/quadratic_programme.h"

namespace spectex::solvers {
namespace {

using Triplets = std::vector<Eigen::Triplet<double>>;

struct Grid {
    std::span<const double> sensing;
    std::span<const double> nm;
    std::size_t bands() const { return nm.size(); }
    double a(std::size_t component, std::size_t band) const { return sensing[component * bands() + band]; }
};

/// Rows of the difference operator, each up to three (band, weight) pairs.
struct DifferenceRow {
    std::size_t first = 0;
    std::array<double, 3> weight{};
    std::size_t count = 2;
};

std::vector<DifferenceRow> difference_rows(std::span<const double> nm, Smoothness smoothness) {
    const std::size_t n = nm.size();
    const double mean = (nm.back() - nm.front()) / static_cast<double>(n - 1);
    // Spacing relative to the mean; exactly 1 on even grids, whose centres are rounded to 1e-6 nm.
    const auto spacing = [&](std::size_t i) {
        const double h = nm[i + 1] - nm[i];
        return std::abs(h - mean) < 2e-6 ? 1.0 : h / mean;
    };
    std::vector<DifferenceRow> rows;
    if (smoothness == Smoothness::first) {
        for (std::size_t i = 0; i + 1 < n; ++i) rows.push_back({i, {-1 / spacing(i), 1 / spacing(i), 0}, 2});
    } else {
        for (std::size_t i = 0; i + 2 < n; ++i) {
            const double h0 = spacing(i), h1 = spacing(i + 1), h = 0.5 * (h0 + h1);
            rows.push_back({i, {1 / (h0 * h), -(1 / h0 + 1 / h1) / h, 1 / (h1 * h)}, 3});
        }
    }
    return rows;
}

/// The equations b_r + b_g + b_b = 1 and A b_r = e_r, A b_g = e_g. A b_b = e_b follows from A 1 = 1 and would make the rows
/// dependent.
constexpr std::size_t solved_primaries = 2;

/// Makes (r + g) + b exactly 1 as floating point adds it, so that white is exactly 1: with s = fl(x) in [0,1],
/// s + fl(1 - s) misses 1 by no more than half a unit in the last place below 1, and the tie goes to 1.
void close_sums(std::vector<double>& basis) {
    const std::size_t n = basis.size() / 3;
    for (std::size_t l = 0; l < n; ++l) {
        double &r = basis[l], &g = basis[n + l], &b = basis[2 * n + l];
        if (b > 0 && r + g < 1) {
            b = 1 - (r + g);
        } else {
            b = 0;
            (r > g ? r : g) = 1 - std::min(r, g);
        }
    }
}

PrimariesSolution finish(const Grid& grid, std::vector<double> basis, Smoothness smoothness) {
    const std::size_t n = grid.bands();
    PrimariesSolution s;
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t c = 0; c < 3; ++c) {
            long double sum = i == c ? -1 : 0;
            for (std::size_t l = 0; l < n; ++l) sum += static_cast<long double>(grid.a(c, l)) * basis[i * n + l];
            s.sensing_residual = std::max(s.sensing_residual, static_cast<double>(std::abs(sum)));
        }
    for (std::size_t l = 0; l < n; ++l) {
        const long double sum = static_cast<long double>(basis[l]) + basis[n + l] + basis[2 * n + l] - 1;
        s.sum_residual = std::max(s.sum_residual, static_cast<double>(std::abs(sum)));
    }
    const auto [low, high] = std::minmax_element(basis.begin(), basis.end());
    s.minimum = *low;
    s.maximum = *high;
    s.objective = roughness(basis, grid.nm, smoothness);
    s.basis = std::move(basis);
    return s;
}

struct LeastViolation {
    double t = 0;
    std::vector<double> basis;
    FarkasCertificate certificate;
    int iterations = 0;
    double gap = 0;
};

/// min t with v = b + t >= 0 and w = 1 + t - b >= 0. Unknowns: v [3][n], w [3][n], t. Its multipliers, y of the sensing rows
/// and s of the sums, have t = sum y_i . e_i + sum s - sum max(A^T y_i + s, 0) at the optimum: a positive t is the
/// certificate's own margin.
Result<LeastViolation> least_violation(const Grid& grid) {
    const std::size_t n = grid.bands(), t = 6 * n, sums = 3 * solved_primaries, boxes = sums + n;
    const auto at = [](std::size_t i) { return static_cast<int>(i); };
    QuadraticProgramme<SparseMatrix> p;
    const auto unknowns = static_cast<Eigen::Index>(6 * n + 1), rows = static_cast<Eigen::Index>(boxes + 3 * n);
    p.P.resize(unknowns, unknowns);
    p.q = Eigen::VectorXd::Zero(unknowns);
    p.q[at(t)] = 1;
    p.d = Eigen::VectorXd::Ones(rows);
    Triplets entries;
    Eigen::VectorXd scale = Eigen::VectorXd::Ones(rows);
    for (std::size_t i = 0; i < solved_primaries; ++i)
        for (std::size_t c = 0; c < 3; ++c) {
            double top = 0, white = 0;
            for (std::size_t l = 0; l < n; ++l) top = std::max(top, std::abs(grid.a(c, l))), white += grid.a(c, l);
            const auto row = at(3 * i + c);
            scale[row] = 1 / top;
            for (std::size_t l = 0; l < n; ++l) entries.emplace_back(row, at(i * n + l), grid.a(c, l) / top);
            entries.emplace_back(row, at(t), -white / top);
            p.d[row] = (i == c ? 1 : 0) / top;
        }
    for (std::size_t l = 0; l < n; ++l) {
        for (std::size_t i = 0; i < 3; ++i) {
            const auto box = at(boxes + i * n + l);
            entries.emplace_back(at(sums + l), at(i * n + l), 1);
            entries.emplace_back(box, at(i * n + l), 1);
            entries.emplace_back(box, at((3 + i) * n + l), 1);
            entries.emplace_back(box, at(t), -2);
        }
        entries.emplace_back(at(sums + l), at(t), -3);
    }
    p.C.resize(rows, unknowns);
    p.C.setFromTriplets(entries.begin(), entries.end());
    p.lower = Eigen::VectorXd::Zero(unknowns);
    p.lower[at(t)] = -std::numeric_limits<double>::infinity();
    p.upper = Eigen::VectorXd::Constant(unknowns, std::numeric_limits<double>::infinity());

    QuadraticProgrammeOptions options;
    options.polish = false;
    auto solved = solve_quadratic_programme(p, options);
    if (!solved) return solved.error();
    LeastViolation out;
    out.t = solved->x[at(t)];
    out.iterations = solved->iterations;
    out.gap = solved->duality_gap;
    out.basis.resize(3 * n);
    for (std::size_t j = 0; j < 3 * n; ++j) out.basis[j] = solved->x[at(j)] - out.t;
    out.certificate.y.assign(9, 0.0);
    for (std::size_t j = 0; j < sums; ++j) out.certificate.y[j] = solved->y[at(j)] * scale[at(j)];
    out.certificate.s.resize(n);
    for (std::size_t l = 0; l < n; ++l) out.certificate.s[l] = solved->y[at(sums + l)];
    return out;
}

Result<PrimariesSolution> smoothest(const Grid& grid, Smoothness smoothness) {
    const std::size_t n = grid.bands(), sums = 3 * solved_primaries;
    const auto at = [](std::size_t i) { return static_cast<int>(i); };
    const auto unknowns = static_cast<Eigen::Index>(3 * n), rows = static_cast<Eigen::Index>(sums + n);
    // Finer grids have smaller differences; without the factor second differences at 1 nm drown beside the bounds.
    const int order = smoothness == Smoothness::first ? 1 : 2;
    const double factor = 2 * std::pow(static_cast<double>(n) / 81, 2 * order - 1);
    QuadraticProgramme<SparseMatrix> p;
    Triplets entries;
    for (const DifferenceRow& row : difference_rows(grid.nm, smoothness))
        for (std::size_t i = 0; i < 3; ++i)
            for (std::size_t j = 0; j < row.count; ++j)
                for (std::size_t k = 0; k < row.count; ++k)
                    entries.emplace_back(at(i * n + row.first + j), at(i * n + row.first + k),
                                         factor * row.weight[j] * row.weight[k]);
    p.P.resize(unknowns, unknowns);
    p.P.setFromTriplets(entries.begin(), entries.end());
    p.q = Eigen::VectorXd::Zero(unknowns);
    entries.clear();
    p.d = Eigen::VectorXd::Ones(rows);
    Eigen::VectorXd scale = Eigen::VectorXd::Ones(rows);
    for (std::size_t i = 0; i < solved_primaries; ++i)
        for (std::size_t c = 0; c < 3; ++c) {
            double top = 0;
            for (std::size_t l = 0; l < n; ++l) top = std::max(top, std::abs(grid.a(c, l)));
            // A power of two, so that the polish meets the very numbers of the table.
            const double unit = std::exp2(-std::ceil(std::log2(top)));
            const auto row = at(3 * i + c);
            scale[row] = unit;
            for (std::size_t l = 0; l < n; ++l) entries.emplace_back(row, at(i * n + l), grid.a(c, l) * unit);
            p.d[row] = (i == c ? 1 : 0) * unit;
        }
    for (std::size_t l = 0; l < n; ++l)
        for (std::size_t i = 0; i < 3; ++i) entries.emplace_back(at(sums + l), at(i * n + l), 1);
    p.C.resize(rows, unknowns);
    p.C.setFromTriplets(entries.begin(), entries.end());
    // b <= 1 follows from b >= 0 and the sum.
    p.lower = Eigen::VectorXd::Zero(unknowns);
    p.upper = Eigen::VectorXd::Constant(unknowns, std::numeric_limits<double>::infinity());

    auto solved = solve_quadratic_programme(p);
    if (!solved) return solved.error();
    std::vector<double> basis(solved->x.data(), solved->x.data() + solved->x.size());
    close_sums(basis);
    PrimariesSolution s = finish(grid, std::move(basis), smoothness);
    s.duality_gap = solved->duality_gap;
    s.iterations = solved->iterations;
    s.multipliers.assign(9 + n, 0.0);
    for (std::size_t j = 0; j < sums; ++j) s.multipliers[j] = solved->y[at(j)] * scale[at(j)] * 2 / factor;
    for (std::size_t l = 0; l < n; ++l) s.multipliers[9 + l] = solved->y[at(sums + l)] * 2 / factor;
    return s;
}

}  // namespace

double roughness(std::span<const double> spectra, std::span<const double> wavelengths_nm, Smoothness smoothness) {
    const std::size_t n = wavelengths_nm.size();
    long double sum = 0;
    const auto rows = difference_rows(wavelengths_nm, smoothness);
    for (std::size_t start = 0; start + n <= spectra.size(); start += n)
        for (const DifferenceRow& row : rows) {
            long double difference = 0;
            for (std::size_t j = 0; j < row.count; ++j)
                difference += static_cast<long double>(row.weight[j]) * spectra[start + row.first + j];
            sum += difference * difference;
        }
    return static_cast<double>(sum);
}

bool verify(FarkasCertificate& certificate, std::span<const double> sensing) {
    const std::size_t n = certificate.s.size();
    if (certificate.y.size() != 9 || n == 0 || sensing.size() != 3 * n) return false;
    long double constraint = 0, box = 0, size = 0;
    for (std::size_t i = 0; i < 3; ++i) {
        constraint += certificate.y[4 * i];
        size += std::abs(certificate.y[4 * i]);
        for (std::size_t l = 0; l < n; ++l) {
            long double c = certificate.s[l];
            for (std::size_t k = 0; k < 3; ++k) c += static_cast<long double>(certificate.y[3 * i + k]) * sensing[k * n + l];
            box += std::max(c, 0.0L);
        }
    }
    for (const double s : certificate.s) {
        constraint += s;
        size += std::abs(s);
    }
    certificate.constraint_value = static_cast<double>(constraint);
    certificate.box_maximum = static_cast<double>(box);
    // Long double rounds each of the few times n terms by 5e-20 of its size, and the two figures are stored as doubles.
    return constraint - box > 1e-14L * (size + box) && certificate.constraint_value > certificate.box_maximum;
}

Result<PrimariesOutcome> solve_primaries(std::span<const double> sensing, std::span<const double> wavelengths_nm,
                                         Smoothness smoothness) {
    const std::size_t n = wavelengths_nm.size();
    if (n < 3 || sensing.size() != 3 * n)
        return Error{ErrorKind::usage, "spectral primaries need at least three bands and a sensing matrix of 3 x bands"};
    const Grid grid{sensing, wavelengths_nm};
    Vector3 white{};
    for (std::size_t c = 0; c < 3; ++c) {
        long double sum = 0;
        long double top = 0;
        for (std::size_t l = 0; l < n; ++l) {
            if (!std::isfinite(grid.a(c, l))) return Error{ErrorKind::usage, "the sensing matrix has an entry that is not finite"};
            sum += grid.a(c, l);
            top = std::max(top, std::abs(static_cast<long double>(grid.a(c, l))));
        }
        if (top == 0) return Error{ErrorKind::input, "one component of the sensing matrix is zero in every band"};
        white[c] = static_cast<double>(sum);
    }

    PrimariesOutcome outcome;
    // Summed over the primaries, A b_i = e_i says A 1 = 1. Where the white of the grid is another no t helps, and
    // y_i = y with s = -A^T y proves it: c_i = 0, and y . (1 - A 1) > 0.
    std::size_t worst = 0;
    for (std::size_t c = 1; c < 3; ++c)
        if (std::abs(white[c] - 1) > std::abs(white[worst] - 1)) worst = c;
    // Colorimetry's own white is 1 to a few roundings of a sum.
    if (std::abs(white[worst] - 1) > 1e-12) {
        const double sign = white[worst] < 1 ? 1 : -1;
        outcome.certificate.y.assign(9, 0.0);
        for (std::size_t i = 0; i < 3; ++i) outcome.certificate.y[3 * i + worst] = sign;
        outcome.certificate.s.resize(n);
        for (std::size_t l = 0; l < n; ++l) outcome.certificate.s[l] = -sign * grid.a(worst, l);
        outcome.solution.least_violation = std::numeric_limits<double>::infinity();
        if (!verify(outcome.certificate, sensing))
            return Error{ErrorKind::input, fmt::format("the white of the grid, {:.17g}, misses 1 by too little to prove that no "
                                                       "primaries exist and too much to solve for them", white[worst])};
        return outcome;
    }

    auto violation = least_violation(grid);
    if (!violation)
        return Error{violation.error().kind, "the least violation of the primaries was not found: " + violation.error().message};
    if (violation->t > 0 && verify(violation->certificate, sensing)) {
        outcome.certificate = std::move(violation->certificate);
        outcome.solution = finish(grid, std::move(violation->basis), smoothness);
        outcome.solution.least_violation = violation->t;
        outcome.solution.iterations = violation->iterations;
        outcome.solution.duality_gap = violation->gap;
        return outcome;
    }
    auto solution = smoothest(grid, smoothness);
    if (!solution)
        return Error{solution.error().kind, fmt::format("the smoothest primaries were not found (slack {:.3g}): {}",
                                                        -violation->t, solution.error().message)};
    outcome.feasible = true;
    outcome.solution = std::move(*solution);
    outcome.solution.least_violation = violation->t;
    // The interface promises these; anything else is a failure of the numerics and must not pass as a solution.
    const PrimariesSolution& s = outcome.solution;
    if (!(s.sensing_residual <= 1e-12 && s.sum_residual <= 1e-12 && s.minimum >= 0 && s.maximum <= 1))
        return Error{ErrorKind::input,
                     fmt::format("the smoothest primaries came out with sensing residual {:.2e}, sum residual {:.2e}, minimum "
                                 "{:.3g} and maximum {:.17g}",
                                 s.sensing_residual, s.sum_residual, s.minimum, s.maximum)};
    return outcome;
}

}  // namespace spectex::solvers

namespace spectex {

Result<PrimariesOutcome> solve_primaries(const Colorimetry& colorimetry, Smoothness smoothness) {
    return solvers::solve_primaries(colorimetry.sensing_matrix(), colorimetry.bands().wavelengths_nm(), smoothness);
}

double squared_differences(std::span<const double> spectra, const BandSet& bands, Smoothness smoothness) {
    return solvers::roughness(spectra, bands.wavelengths_nm(), smoothness);
}

}  // namespace spectex
