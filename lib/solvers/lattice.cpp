// Spectra at the vertices of a lattice over the RGB cube: exact metamers under a prior that measured reflectances near each
// vertex's colour give.
#include "solvers/lattice.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <mutex>
#include <nlohmann/json.hpp>

#include "parallel.h"
#include "solvers/quadratic_programme.h"

namespace spectex::solvers {
namespace {

using Json = nlohmann::ordered_json;

/// The spacing of the bands at which ridge and smoothness are stated.
constexpr double reference_step_nm = 5;
/// What A r = rgb may miss by: a few roundings of a sum of hundreds of terms.
constexpr double accepted_residual = 1e-13;

/// Half the distance between a band's neighbours; at the ends, the distance to the only one.
std::vector<double> band_widths(const BandSet& bands) {
    std::vector<double> out(bands.size());
    for (std::size_t l = 0; l < out.size(); ++l) {
        const std::size_t low = l == 0 ? 0 : l - 1, high = std::min(l + 1, out.size() - 1);
        out[l] = (bands[high] - bands[low]) / static_cast<double>(high - low);
    }
    return out;
}

/// x as a linear function of s: sum_l w_l (x_l - s_l)^2 + weight * 5 nm^4 * sum_l w_l x''_l^2 is least, w the bands' widths and x''
/// the second divided difference (Whittaker 1923, doi:10.1017/S0013091500077853). Straight lines stay as they are.
Eigen::LDLT<Eigen::MatrixXd> whittaker(const BandSet& bands, const Eigen::VectorXd& widths, double weight) {
    const auto n = static_cast<Eigen::Index>(bands.size());
    Eigen::MatrixXd system = Eigen::MatrixXd(widths.asDiagonal());
    const double unit = std::pow(reference_step_nm, 4);
    for (Eigen::Index l = 1; l + 1 < n; ++l) {
        const auto i = static_cast<std::size_t>(l);
        const double below = bands[i] - bands[i - 1], above = bands[i + 1] - bands[i];
        Eigen::Vector3d second(1 / below, -1 / below - 1 / above, 1 / above);
        second *= 2 / (below + above);
        system.block<3, 3>(l - 1, l - 1) += weight * unit * widths[l] * second * second.transpose();
    }
    return system.ldlt();
}

double lab_f(double t) {
    constexpr double d = 6.0 / 29.0;
    return t > d * d * d ? std::cbrt(t) : t / (3 * d * d) + 4.0 / 29.0;
}

bool inside_cube(const Vector3& rgb) {
    return std::all_of(rgb.begin(), rgb.end(), [](double v) { return v >= 0 && v <= 1; });
}

std::array<long double, 3> residual(std::span<const double> sensing, std::span<const double> r, const Vector3& rgb) {
    const std::size_t n = r.size();
    std::array<long double, 3> out{};
    for (std::size_t c = 0; c < 3; ++c) {
        long double sum = rgb[c];
        for (std::size_t l = 0; l < n; ++l) sum -= static_cast<long double>(sensing[c * n + l]) * r[l];
        out[c] = sum;
    }
    return out;
}

double largest(const std::array<long double, 3>& v) {
    return static_cast<double>(std::max({std::abs(v[0]), std::abs(v[1]), std::abs(v[2])}));
}

/// Runs body(vertex index) for each vertex in parallel and keeps the first error by index, whatever the order of execution.
template <class Body>
Status for_all_vertices(std::size_t count, const Body& body) {
    std::mutex mutex;
    std::size_t first = count;
    Error error;
    parallel_for(std::size_t{0}, count, [&](std::size_t v) {
        if (Status done = body(v); !done) {
            const std::lock_guard lock(mutex);
            if (v < first) first = v, error = done.error();
        }
    });
    if (first < count) return error;
    return {};
}

LatticeTable empty_table(std::size_t n, std::size_t values) {
    LatticeTable table;
    for (auto& knots : table.knots)
        for (std::size_t i = 0; i < n; ++i) knots.push_back(static_cast<double>(i) / static_cast<double>(n - 1));
    table.values = values;
    table.vertices.assign(n * n * n * values, 0.0);
    return table;
}

Vector3 vertex_colour(const LatticeTable& table, std::size_t v) {
    const std::size_t g = table.knots[1].size(), b = table.knots[2].size();
    return {table.knots[0][v / (g * b)], table.knots[1][v / b % g], table.knots[2][v % b]};
}

std::string vertex_name(const Vector3& rgb) { return fmt::format("({:g}, {:g}, {:g})", rgb[0], rgb[1], rgb[2]); }

}  // namespace

bool nearest_metamer(std::span<const double> sensing, std::span<const double> target, std::span<const double> mobility,
                     const Vector3& rgb, std::span<double> out) {
    const std::size_t n = target.size();
    using Eigen::Matrix3d, Eigen::Vector3d;
    const auto column = [&](std::size_t l) { return Vector3d(sensing[l], sensing[n + l], sensing[2 * n + l]); };
    const Vector3d goal(rgb[0], rgb[1], rgb[2]);
    // The dual's value is sum_l [r_l s_l - (r_l - t_l)^2 / (2 w_l)] - y . rgb with s = A^T y, r = clip(t + w s): convex and
    // differentiable; its gradient is A r - rgb.
    const auto evaluate = [&](const Vector3d& y, Vector3d& gradient, Matrix3d* hessian) {
        double value = -y.dot(goal);
        gradient = -goal;
        if (hessian) hessian->setZero();
        for (std::size_t l = 0; l < n; ++l) {
            const Vector3d a = column(l);
            const double s = a.dot(y), t = target[l], w = mobility[l];
            const double free = t + w * s, r = std::clamp(free, 0.0, 1.0);
            out[l] = r;
            value += w > 0 ? r * s - (r - t) * (r - t) / (2 * w) : t * s;
            gradient += r * a;
            if (hessian && w > 0 && free > 0 && free < 1) *hessian += w * a * a.transpose();
        }
        return value;
    };
    Vector3d y = Vector3d::Zero(), gradient;
    Matrix3d hessian;
    double value = evaluate(y, gradient, &hessian);
    // The dual is piecewise quadratic: Newton's method ends after finitely many pieces.
    for (int k = 0; k < 200 && gradient.lpNorm<Eigen::Infinity>() > 1e-14; ++k) {
        // Where all bands that could move are at a bound the Hessian is singular, and the step is the gradient's.
        Matrix3d h = hessian;
        h.diagonal().array() += 1e-12 * hessian.trace() + 1e-12;
        const Vector3d step = -h.ldlt().solve(gradient);
        const double slope = gradient.dot(step);
        Vector3d next_gradient;
        double length = 1, next = 0;
        bool better = false;
        for (int half = 0; half < 60 && !better; ++half, length *= 0.5) {
            next = evaluate(y + length * step, next_gradient, nullptr);
            // Close to the end the value no longer tells, and the gradient does.
            better = next <= value + 1e-4 * length * slope || next_gradient.norm() < (1 - 0.5 * length) * gradient.norm();
            if (better) y += length * step;
        }
        if (!better) break;
        value = evaluate(y, gradient, &hessian);
    }
    evaluate(y, gradient, nullptr);
    // What rounding of t + w s leaves is given to the bands that lie strictly between the bounds.
    auto missing = residual(sensing, out, rgb);
    for (int k = 0; k < 6 && largest(missing) > 0; ++k) {
        Matrix3d h = Matrix3d::Zero();
        const auto give = [&](std::size_t l) { return std::min(out[l], 1 - out[l]) * (mobility[l] > 0 ? 1.0 : 0.0); };
        for (std::size_t l = 0; l < n; ++l) h += give(l) * column(l) * column(l).transpose();
        const Vector3d d(static_cast<double>(missing[0]), static_cast<double>(missing[1]), static_cast<double>(missing[2]));
        const Eigen::FullPivLU<Matrix3d> solver(h);
        if (!solver.isInvertible()) break;
        const Vector3d z = solver.solve(d);
        std::vector<double> trial(out.begin(), out.end());
        for (std::size_t l = 0; l < n; ++l) trial[l] = std::clamp(out[l] + give(l) * column(l).dot(z), 0.0, 1.0);
        const auto left = residual(sensing, trial, rgb);
        if (!(largest(left) < largest(missing))) break;
        std::copy(trial.begin(), trial.end(), out.begin());
        missing = left;
    }
    return largest(missing) <= accepted_residual;
}

Result<double> least_violation(std::span<const double> sensing, const Vector3& rgb) {
    // With v = r + t >= 0 and w = 1 + t - r >= 0 the unknowns are v, w and the free t.
    const std::size_t n = sensing.size() / 3;
    const auto at = [](std::size_t i) { return static_cast<int>(i); };
    QuadraticProgramme<SparseMatrix> p;
    const auto unknowns = static_cast<Eigen::Index>(2 * n + 1), rows = static_cast<Eigen::Index>(n + 3);
    p.P.resize(unknowns, unknowns);
    p.q = Eigen::VectorXd::Zero(unknowns);
    p.q[at(2 * n)] = 1;
    p.d = Eigen::VectorXd::Ones(rows);
    std::vector<Eigen::Triplet<double>> entries;
    for (std::size_t c = 0; c < 3; ++c) {
        double top = 0, white = 0;
        for (std::size_t l = 0; l < n; ++l) top = std::max(top, std::abs(sensing[c * n + l])), white += sensing[c * n + l];
        for (std::size_t l = 0; l < n; ++l) entries.emplace_back(at(c), at(l), sensing[c * n + l] / top);
        entries.emplace_back(at(c), at(2 * n), -white / top);
        p.d[at(c)] = rgb[c] / top;
    }
    for (std::size_t l = 0; l < n; ++l) {
        entries.emplace_back(at(3 + l), at(l), 1);
        entries.emplace_back(at(3 + l), at(n + l), 1);
        entries.emplace_back(at(3 + l), at(2 * n), -2);
    }
    p.C.resize(rows, unknowns);
    p.C.setFromTriplets(entries.begin(), entries.end());
    p.lower = Eigen::VectorXd::Zero(unknowns);
    p.lower[at(2 * n)] = -std::numeric_limits<double>::infinity();
    p.upper = Eigen::VectorXd::Constant(unknowns, std::numeric_limits<double>::infinity());
    QuadraticProgrammeOptions options;
    options.polish = false;
    auto solved = solve_quadratic_programme(p, options);
    if (!solved) return std::move(solved).error();
    return solved->x[at(2 * n)];
}

Status check_cube(const Colorimetry& c) {
    const auto& a = c.sensing_matrix();
    const std::size_t n = c.bands().size();
    for (std::size_t k = 0; k < 3; ++k) {
        long double white = 0;
        for (std::size_t l = 0; l < n; ++l) white += a[k * n + l];
        if (!(std::abs(white - 1) <= 1e-12L))
            return Error{ErrorKind::infeasible,
                         fmt::format("lattice: the white vertex (1, 1, 1) has no reflectance in [0,1] ({}): the perfect diffuser "
                                     "is not RGB (1,1,1) with this matrix; the integrated one makes it so",
                                     c.describe())};
    }
    // The colours that reflectances in [0,1] have are a convex set, symmetric about (1/2, 1/2, 1/2): with red, green and blue
    // it holds their complements, black, white and all of the cube.
    Vector3 worst{};
    double most = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        Vector3 corner{};
        corner[k] = 1;
        const auto t = least_violation(a, corner);
        if (!t) return Error{t.error().kind, "lattice: vertex " + vertex_name(corner) + ": " + t.error().message};
        if (*t > most) most = *t, worst = corner;
    }
    // The interior point's own accuracy.
    if (most > 1e-8)
        return Error{ErrorKind::infeasible,
                     fmt::format("lattice: vertex {} has no reflectance in [0,1] ({}): the best violate [0,1] by {:.4g}",
                                 vertex_name(worst), c.describe(), most)};
    return {};
}

Eigen::Vector3d LatticeSolver::feature(const Vector3& rgb) const {
    const Vector3 xyz = colorimetry_.rgb_to_xyz() * Vector3{std::max(rgb[0], 0.0), std::max(rgb[1], 0.0), std::max(rgb[2], 0.0)};
    const Vector3& white = colorimetry_.white_xyz();
    const double x = lab_f(xyz[0] / white[0]), y = lab_f(xyz[1] / white[1]), z = lab_f(xyz[2] / white[2]);
    return {options_.lightness * (1.16 * y - 0.16), 5 * (x - y), 2 * (y - z)};
}

Result<LatticeSolver> LatticeSolver::make(const Colorimetry& colorimetry, std::span<const SampleSet> sets,
                                          const LatticeOptions& options) {
    const auto positive = [](double v) { return std::isfinite(v) && v > 0; };
    if (options.n < 2 || options.n > 65 || !positive(options.reach) || !positive(options.lightness) || !positive(options.decay) ||
        !positive(options.ridge) || !(options.smoothness >= 0 && std::isfinite(options.smoothness)) ||
        !(options.denoising >= 0 && std::isfinite(options.denoising)))
        return Error{ErrorKind::usage, "lattice: expected 2..65 vertices per axis and positive parameters"};
    LatticeSolver s(colorimetry);
    s.options_ = options;
    const BandSet& bands = colorimetry.bands();
    const std::size_t n = bands.size();
    std::vector<std::vector<double>> kept;
    std::vector<double> weights;
    for (const SampleSet& set : sets) {
        const std::size_t first = kept.size();
        for (const auto& sample : set.samples) {
            const auto measured = SpectralDistribution::make(set.wavelengths_nm, sample);
            if (!measured) return Error{measured.error().kind, set.name + ": " + measured.error().message};
            auto r = measured->resampled(bands.wavelengths_nm(), Interpolation::linear, Extrapolation::hold);
            for (double& v : r) v = std::clamp(v, 0.0, 1.0);
            if (inside_cube(colorimetry.rgb_of(r))) kept.push_back(std::move(r));
        }
        for (std::size_t i = first; i < kept.size(); ++i) weights.push_back(1.0 / static_cast<double>(kept.size() - first));
    }
    if (kept.empty()) return Error{ErrorKind::input, "lattice: no measured reflectance has a colour inside the cube"};
    const auto rows = static_cast<Eigen::Index>(n), count = static_cast<Eigen::Index>(kept.size());
    s.samples_.resize(rows, count);
    s.features_.resize(3, count);
    s.weights_ = Eigen::Map<const Eigen::VectorXd>(weights.data(), count);
    for (Eigen::Index i = 0; i < count; ++i) {
        const auto& r = kept[static_cast<std::size_t>(i)];
        s.samples_.col(i) = Eigen::Map<const Eigen::VectorXd>(r.data(), rows);
        s.features_.col(i) = s.feature(colorimetry.rgb_of(r));
    }
    const auto widths = band_widths(bands);
    const Eigen::VectorXd width = Eigen::Map<const Eigen::VectorXd>(widths.data(), rows);
    // Colours stay those of the measurements.
    if (options.denoising > 0)
        s.samples_ = whittaker(bands, width, options.denoising).solve(width.asDiagonal() * s.samples_).cwiseMax(0).cwiseMin(1).eval();
    s.smoothness_ = Eigen::MatrixXd::Zero(rows, rows);
    for (Eigen::Index l = 0; l + 1 < rows; ++l) {
        const auto i = static_cast<std::size_t>(l);
        const double weight = options.smoothness * reference_step_nm / (bands[i + 1] - bands[i]);
        s.smoothness_(l, l) += weight;
        s.smoothness_(l + 1, l + 1) += weight;
        s.smoothness_(l, l + 1) -= weight;
        s.smoothness_(l + 1, l) -= weight;
    }
    s.ridge_.resize(rows);
    for (Eigen::Index l = 0; l < rows; ++l) s.ridge_[l] = options.ridge * reference_step_nm / widths[static_cast<std::size_t>(l)];
    return s;
}

Result<std::vector<double>> LatticeSolver::reflectance(const Vector3& rgb) const {
    const Eigen::Index n = samples_.rows();
    if (rgb == Vector3{0, 0, 0} || rgb == Vector3{1, 1, 1}) return std::vector<double>(static_cast<std::size_t>(n), rgb[0]);

    const Eigen::RowVectorXd distance2 = (features_.colwise() - feature(rgb)).colwise().squaredNorm();
    Eigen::VectorXd w = weights_.array() *
                        (1 + distance2.transpose().array() / (options_.reach * options_.reach)).pow(-options_.decay);
    w /= w.sum();
    const Eigen::VectorXd mean = samples_ * w;
    const Eigen::MatrixXd spread = (samples_.colwise() - mean) * w.cwiseSqrt().asDiagonal();
    Eigen::MatrixXd covariance = Eigen::MatrixXd(ridge_.asDiagonal());
    covariance.selfadjointView<Eigen::Lower>().rankUpdate(spread);
    const Eigen::LLT<Eigen::MatrixXd> factor(covariance);
    Eigen::MatrixXd precision = factor.solve(Eigen::MatrixXd::Identity(n, n));
    precision = 0.5 * (precision + precision.transpose()).eval();

    QuadraticProgramme<Eigen::MatrixXd> p;
    p.P = precision + smoothness_;
    p.q = -(precision * mean);
    const double scale = p.P.diagonal().mean();
    p.P /= scale;
    p.q /= scale;
    using Rows = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>;
    p.C = Eigen::Map<const Rows>(colorimetry_.sensing_matrix().data(), 3, n);
    p.d = Eigen::Vector3d(rgb[0], rgb[1], rgb[2]);
    p.lower = Eigen::VectorXd::Zero(n);
    p.upper = Eigen::VectorXd::Ones(n);
    QuadraticProgrammeOptions options;
    options.polish = false;
    options.tolerance = 1e-9;
    const auto solved = solve_quadratic_programme(p, options);
    if (!solved) return Error{solved.error().kind, "lattice: vertex " + vertex_name(rgb) + ": " + solved.error().message};

    std::vector<double> interior(solved->x.data(), solved->x.data() + n), mobility(interior.size()), out(interior.size());
    // What the interior point keeps off a bound by less than its accuracy lies on it.
    for (std::size_t l = 0; l < interior.size(); ++l) {
        double& v = interior[l];
        v = v < 1e-8 ? 0 : v > 1 - 1e-8 ? 1 : v;
        mobility[l] = v * (1 - v);
    }
    if (nearest_metamer(colorimetry_.sensing_matrix(), interior, mobility, rgb, out)) return out;
    std::fill(mobility.begin(), mobility.end(), 1.0);
    if (nearest_metamer(colorimetry_.sensing_matrix(), interior, mobility, rgb, out)) return out;
    return Error{ErrorKind::input, fmt::format("lattice: vertex {}: A r misses the colour by {:.2e}", vertex_name(rgb),
                                               largest(residual(colorimetry_.sensing_matrix(), out, rgb)))};
}

Result<LatticeTable> transfer_lattice(const LatticeTable& table, const BandSet& from, const Colorimetry& to) {
    if (auto possible = check_cube(to); !possible) return possible.error();
    const std::size_t bands = to.bands().size();
    LatticeTable out = empty_table(table.knots[0].size(), bands);
    // A correction spread as a function of wavelength, not as a list: narrow bands do not take more of it than wide ones.
    std::vector<double> mobility = band_widths(to.bands());
    for (double& w : mobility) w = 1 / w;
    const auto done = for_all_vertices(out.vertices.size() / bands, [&](std::size_t v) -> Status {
        const std::span<double> spectrum(&out.vertices[v * bands], bands);
        const Vector3 rgb = vertex_colour(out, v);
        if (rgb == Vector3{0, 0, 0} || rgb == Vector3{1, 1, 1}) {
            std::fill(spectrum.begin(), spectrum.end(), rgb[0]);
            return {};
        }
        const double* stored = &table.vertices[v * table.values];
        const auto given = SpectralDistribution::make(from.wavelengths_nm(), std::vector<double>(stored, stored + table.values));
        if (!given) return given.error();
        auto target = given->resampled(to.bands().wavelengths_nm(), Interpolation::linear, Extrapolation::hold);
        for (double& r : target) r = std::clamp(r, 0.0, 1.0);
        if (nearest_metamer(to.sensing_matrix(), target, mobility, rgb, spectrum)) return {};
        return Error{ErrorKind::input, fmt::format("lattice: vertex {} ({}): A r misses the colour by {:.2e}", vertex_name(rgb),
                                                   to.describe(), largest(residual(to.sensing_matrix(), spectrum, rgb)))};
    });
    if (!done) return done.error();
    return out;
}

namespace {

constexpr std::string_view magic = "SPXLATT1";
constexpr double steps = 65535;

}  // namespace

Result<LatticeTable> decode_lattice(std::string_view bytes, std::string_view label, const Colorimetry& colorimetry) {
    const auto wrong = [&](std::string_view why) { return Error{ErrorKind::input, fmt::format("{}: {}", label, why)}; };
    const auto byte = [&](std::size_t i) { return static_cast<std::uint32_t>(static_cast<unsigned char>(bytes[i])); };
    const std::size_t fixed = magic.size() + 4;
    if (bytes.size() < fixed || bytes.substr(0, magic.size()) != magic) return wrong("not a lattice of spectra");
    const std::uint32_t length = byte(8) | byte(9) << 8 | byte(10) << 16 | byte(11) << 24;
    if (length > bytes.size() - fixed) return wrong("the header is cut off");
    const Json header = Json::parse(bytes.substr(fixed, length), nullptr, false);
    if (!header.is_object() || !header.contains("n") || !header["n"].is_number_unsigned() || !header.contains("bands") ||
        header["bands"] != Json(colorimetry.bands().wavelengths_nm()))
        return wrong(fmt::format("expected a header with n and the bands {}", colorimetry.bands().describe()));
    const auto n = header["n"].get<std::uint64_t>();
    const std::size_t bands = colorimetry.bands().size();
    if (n < 2 || n > 65 || bytes.size() - fixed - length != 2 * n * n * n * bands)
        return wrong(fmt::format("{} bytes of reflectances do not make {}^3 vertices of {} bands", bytes.size() - fixed - length, n,
                                 bands));
    LatticeTable table = empty_table(n, bands);
    const std::size_t begin = fixed + length;
    const auto done = for_all_vertices(n * n * n, [&](std::size_t v) -> Status {
        const Vector3 rgb = vertex_colour(table, v);
        std::vector<double> stored(bands), mobility(bands);
        for (std::size_t l = 0; l < bands; ++l) {
            const std::size_t i = begin + 2 * (v * bands + l);
            stored[l] = static_cast<double>(byte(i) | byte(i + 1) << 8) / steps;
            mobility[l] = stored[l] * (1 - stored[l]);
        }
        const std::span<double> spectrum(&table.vertices[v * bands], bands);
        if (!nearest_metamer(colorimetry.sensing_matrix(), stored, mobility, rgb, spectrum))
            return wrong(fmt::format("the spectrum of vertex {} cannot be brought to its colour", vertex_name(rgb)));
        // Half a step in every band moves the colour by less than 2e-5 and asks for corrections of that size.
        for (std::size_t l = 0; l < bands; ++l)
            if (!(std::abs(spectrum[l] - stored[l]) <= 1e-3))
                return wrong(fmt::format("the spectrum of vertex {} has another colour ({})", vertex_name(rgb),
                                         colorimetry.describe()));
        return {};
    });
    if (!done) return done.error();
    return table;
}

}  // namespace spectex::solvers

namespace spectex {

Result<std::vector<SampleSet>> lattice_sample_sets() {
    std::vector<SampleSet> out;
    for (const auto& [name, path] :
         {std::pair{"vrhel", "reflectances/vrhel_390-730-2.csv"}, std::pair{"koivisto", "reflectances/koivisto_400-700-5.csv"},
          std::pair{"krinov", "reflectances/krinov_400-650-10.csv"}, std::pair{"nickerson", "reflectances/nickerson_400-700-5.csv"},
          std::pair{"macbeth", "reflectances/macbeth_390-730-5.csv"}}) {
        auto table = load_spectral_table(path);
        if (!table) return std::move(table).error();
        out.push_back({name, std::move(table->wavelengths_nm), std::move(table->columns)});
    }
    return out;
}

Result<LatticeTable> solve_lattice(const Colorimetry& colorimetry, std::span<const SampleSet> sets, const LatticeOptions& options) {
    if (auto possible = solvers::check_cube(colorimetry); !possible) return possible.error();
    const auto solver = solvers::LatticeSolver::make(colorimetry, sets, options);
    if (!solver) return solver.error();
    const std::size_t bands = colorimetry.bands().size();
    LatticeTable table = solvers::empty_table(options.n, bands);
    const auto done = solvers::for_all_vertices(table.vertices.size() / bands, [&](std::size_t v) -> Status {
        const auto r = solver->reflectance(solvers::vertex_colour(table, v));
        if (!r) return r.error();
        std::copy(r->begin(), r->end(), table.vertices.begin() + static_cast<std::ptrdiff_t>(v * bands));
        return {};
    });
    if (!done) return done.error();
    return table;
}

std::string encode_lattice(const LatticeTable& table, const Colorimetry& colorimetry) {
    nlohmann::ordered_json header{{"format", 1},
                                  {"n", table.knots[0].size()},
                                  {"observer", colorimetry.observer().id},
                                  {"illuminant", colorimetry.illuminant().name},
                                  {"rgb_space", colorimetry.rgb_space().name},
                                  {"matrix", colorimetry.matrix_kind() == RgbMatrix::integrated ? "integrated" : "standard"},
                                  {"bands", colorimetry.bands().wavelengths_nm()}};
    const std::string text = header.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
    std::string out(solvers::magic);
    for (int shift = 0; shift < 32; shift += 8) out += static_cast<char>(text.size() >> shift & 255);
    out += text;
    for (const double r : table.vertices) {
        const auto value = static_cast<unsigned>(std::lround(std::clamp(r, 0.0, 1.0) * solvers::steps));
        out += static_cast<char>(value & 255);
        out += static_cast<char>(value >> 8);
    }
    return out;
}

}  // namespace spectex
