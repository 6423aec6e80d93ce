#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "spectex/spectral.h"

namespace spectex {
namespace {

/// The step when the points are evenly spaced to 1e-6 nm.
std::optional<double> even_step(const std::vector<double>& x) {
    if (x.size() < 2) return std::nullopt;
    const double step = (x.back() - x.front()) / static_cast<double>(x.size() - 1);
    for (std::size_t i = 0; i < x.size(); ++i)
        if (std::fabs(x.front() + step * static_cast<double>(i) - x[i]) > 1e-6) return std::nullopt;
    return step;
}

/// Values with two extra points at either end, by the boundary polynomials of CIE 167:2005, eq. 3 to 6.
std::vector<double> with_sprague_ends(const std::vector<double>& v) {
    static constexpr double ends[4][6] = {{884, -1960, 3033, -2648, 1080, -180},
                                          {508, -540, 488, -367, 144, -24},
                                          {-24, 144, -367, 488, -540, 508},
                                          {-180, 1080, -2648, 3033, -1960, 884}};
    const std::size_t n = v.size();
    const auto blend = [&](const double (&c)[6], std::size_t from) {
        double sum = 0;
        for (std::size_t k = 0; k < 6; ++k) sum += c[k] * v[from + k];
        return sum / 209;
    };
    std::vector<double> out;
    out.reserve(n + 4);
    out.push_back(blend(ends[0], 0));
    out.push_back(blend(ends[1], 0));
    out.insert(out.end(), v.begin(), v.end());
    out.push_back(blend(ends[2], n - 6));
    out.push_back(blend(ends[3], n - 6));
    return out;
}

/// Fifth-order interpolation between points i and i+1 of evenly spaced values (CIE 167:2005, eq. 1 and 2); `f` is padded by
/// two points at the front.
double sprague(const std::vector<double>& f, std::size_t i, double t) {
    const double a = f[i], b = f[i + 1], c = f[i + 2], d = f[i + 3], e = f[i + 4], g = f[i + 5];
    const double a1 = (2 * a - 16 * b + 16 * d - 2 * e) / 24;
    const double a2 = (-a + 16 * b - 30 * c + 16 * d - e) / 24;
    const double a3 = (-9 * a + 39 * b - 70 * c + 66 * d - 33 * e + 7 * g) / 24;
    const double a4 = (13 * a - 64 * b + 126 * c - 124 * d + 61 * e - 12 * g) / 24;
    const double a5 = (-5 * a + 25 * b - 50 * c + 50 * d - 25 * e + 5 * g) / 24;
    return c + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))));
}

/// Second derivatives of the natural cubic spline through the points.
Eigen::VectorXd spline_curvatures(const std::vector<double>& x, const std::vector<double>& y) {
    const auto n = static_cast<Eigen::Index>(x.size());
    Eigen::VectorXd m = Eigen::VectorXd::Zero(n);
    if (n < 3) return m;
    Eigen::MatrixXd k = Eigen::MatrixXd::Zero(n - 2, n - 2);
    Eigen::VectorXd r(n - 2);
    for (Eigen::Index i = 1; i + 1 < n; ++i) {
        const auto u = static_cast<std::size_t>(i);
        const double h0 = x[u] - x[u - 1], h1 = x[u + 1] - x[u];
        k(i - 1, i - 1) = (h0 + h1) / 3;
        if (i > 1) k(i - 1, i - 2) = h0 / 6;
        if (i + 2 < n) k(i - 1, i) = h1 / 6;
        r(i - 1) = (y[u + 1] - y[u]) / h1 - (y[u] - y[u - 1]) / h0;
    }
    m.segment(1, n - 2) = k.partialPivLu().solve(r);
    return m;
}

}  // namespace

Result<SpectralDistribution> SpectralDistribution::make(std::vector<double> wavelengths_nm, std::vector<double> values) {
    if (wavelengths_nm.empty() || wavelengths_nm.size() != values.size())
        return Error{ErrorKind::input, fmt::format("a spectrum has {} wavelengths and {} values: expected as many, at least one",
                                                   wavelengths_nm.size(), values.size())};
    for (std::size_t i = 0; i < values.size(); ++i) {
        if (!std::isfinite(wavelengths_nm[i]) || wavelengths_nm[i] <= 0 || !std::isfinite(values[i]))
            return Error{ErrorKind::input, fmt::format("a spectrum's entry {} is ({} nm, {}): expected a positive wavelength "
                                                       "and a finite value",
                                                       i, wavelengths_nm[i], values[i])};
        if (i > 0 && wavelengths_nm[i] <= wavelengths_nm[i - 1])
            return Error{ErrorKind::input, fmt::format("a spectrum's wavelength {} nm follows {} nm: expected wavelengths that "
                                                       "ascend, none twice",
                                                       wavelengths_nm[i], wavelengths_nm[i - 1])};
    }
    SpectralDistribution spectrum;
    spectrum.wavelengths_nm_ = std::move(wavelengths_nm);
    spectrum.values_ = std::move(values);
    return spectrum;
}

double SpectralDistribution::at(double wavelength_nm, Extrapolation outside) const {
    const auto& x = wavelengths_nm_;
    if (x.empty()) return 0;
    if (wavelength_nm < x.front()) return outside == Extrapolation::hold ? values_.front() : 0;
    if (wavelength_nm > x.back()) return outside == Extrapolation::hold ? values_.back() : 0;
    const auto above = std::lower_bound(x.begin(), x.end(), wavelength_nm);
    const auto i = static_cast<std::size_t>(above - x.begin());
    if (*above == wavelength_nm) return values_[i];
    const double t = (wavelength_nm - x[i - 1]) / (x[i] - x[i - 1]);
    return (1 - t) * values_[i - 1] + t * values_[i];
}

std::vector<double> SpectralDistribution::resampled(std::span<const double> wavelengths_nm, Interpolation between,
                                                    Extrapolation outside) const {
    std::vector<double> out;
    out.reserve(wavelengths_nm.size());
    const auto step = even_step(wavelengths_nm_);
    if (between == Interpolation::sprague && (!step || size() < 6)) between = Interpolation::cubic;
    if (between == Interpolation::cubic && size() < 3) between = Interpolation::linear;

    if (between == Interpolation::linear) {
        for (const double w : wavelengths_nm) out.push_back(at(w, outside));
        return out;
    }
    std::vector<double> padded;
    Eigen::VectorXd curvature;
    if (between == Interpolation::sprague)
        padded = with_sprague_ends(values_);
    else
        curvature = spline_curvatures(wavelengths_nm_, values_);
    const auto& x = wavelengths_nm_;
    for (const double w : wavelengths_nm) {
        if (w < x.front() || w > x.back()) {
            out.push_back(at(w, outside));
            continue;
        }
        const auto above = std::lower_bound(x.begin(), x.end(), w);
        auto i = static_cast<std::size_t>(above - x.begin());
        if (*above == w) {
            out.push_back(values_[i]);
            continue;
        }
        --i;
        const double h = x[i + 1] - x[i], t = (w - x[i]) / h;
        if (between == Interpolation::sprague) {
            out.push_back(sprague(padded, i, t));
        } else {
            const double u = 1 - t;
            const double m0 = curvature(static_cast<Eigen::Index>(i)), m1 = curvature(static_cast<Eigen::Index>(i + 1));
            out.push_back(u * values_[i] + t * values_[i + 1] + h * h / 6 * ((u * u * u - u) * m0 + (t * t * t - t) * m1));
        }
    }
    return out;
}

}  // namespace spectex
