#include "spectex/kernel_speed.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <ctime>
#include <functional>
#include <optional>
#include <random>
#include <utility>

#include "compare/spaces.h"
#include "kernels/convert.h"
#include "kernels/lattice.h"
#include "kernels/linear.h"
#include "kernels/mantissa.h"
#include "kernels/sigmoid.h"
#include "kernels/spectra.h"
#include "spectex/color.h"
#include "spectex/compare.h"

namespace spectex {
namespace {

/// Pixels of a picture: three float planes of them are 50 MB, beyond any cache but a server's whole third level.
constexpr std::size_t pixels = std::size_t{1} << 22;
/// Of a strip, as for_row_groups cuts them.
constexpr std::size_t strip = 8192;
constexpr std::size_t bands = 36;

using Planes = std::array<std::vector<float>, 3>;

struct Task {
    std::string name;
    double target = 0;
    /// Pixels [begin, begin + n).
    std::function<void(std::size_t begin, std::size_t n)> run;
    /// Largest difference from the reference over the first n pixels.
    std::function<double(std::size_t n)> error;
    double allowed = 0;
    std::string unit;
    std::size_t part = 1;  ///< every so many pixels are enough to time it
};

struct Pictures {
    std::vector<std::uint8_t> codes;  // [pixels][3]
    Planes a, b, out;
    std::vector<float> difference;
    std::array<std::vector<std::uint16_t>, 3> halves;
    std::array<float, 256> table{};
    // Of one strip.
    std::vector<std::vector<float>> spectra{bands, std::vector<float>(strip)};
    std::vector<std::vector<std::uint16_t>> half_spectra{bands, std::vector<std::uint16_t>(strip)};
    std::vector<double> basis, weights;
    std::array<std::vector<double>, 3> lab;
    std::vector<double> coefficients, reflectance, positions;
    LatticeTable lattice;
    std::optional<kernels::LatticeKernel> relight;
    std::optional<DifferenceAccumulator> accumulator;

    Pictures() {
        std::mt19937 random(1);
        codes.resize(3 * pixels);
        for (auto& c : codes) c = static_cast<std::uint8_t>(random() >> 24);
        for (std::size_t i = 0; i < 256; ++i) table[i] = static_cast<float>(srgb_decode(static_cast<double>(i) / 255));
        for (std::size_t c = 0; c < 3; ++c) {
            a[c].resize(pixels);
            b[c].resize(pixels);
            out[c].resize(pixels);
            halves[c].resize(pixels);
            lab[c].resize(strip);
            for (std::size_t i = 0; i < pixels; ++i) {
                a[c][i] = table[codes[3 * i + c]];
                b[c][i] = a[c][i] * (0.9f + 0.2f * static_cast<float>(random()) / 4294967296.0f);
            }
        }
        difference.resize(pixels);
        std::uniform_real_distribution<double> unit(0, 1);
        for (std::size_t i = 0; i < 3 * bands; ++i) {
            basis.push_back(unit(random) / 3);
            weights.push_back(unit(random) / bands);
        }
        // As a relight has it: 9 vertices an axis, three values each.
        lattice.values = 3;
        for (auto& axis : lattice.knots)
            for (int i = 0; i < 9; ++i) axis.push_back(i / 8.0);
        for (std::size_t i = 0; i < 9 * 9 * 9 * 3; ++i) lattice.vertices.push_back(unit(random));
        relight.emplace(lattice);
        for (std::size_t i = 0; i < 3 * strip; ++i) coefficients.push_back(10 * unit(random) - 5);
        for (std::size_t i = 0; i < bands; ++i) positions.push_back(static_cast<double>(i) / (bands - 1));
        reflectance.resize(strip * bands);
        for (std::size_t band = 0; band < bands; ++band)
            for (std::size_t i = 0; i < strip; ++i)
                spectra[band][i] = static_cast<float>(basis[band] * a[0][i] + basis[bands + band] * a[1][i] + basis[2 * bands + band] * a[2][i]);
    }
    std::array<const float*, 3> in(std::size_t at) const { return {a[0].data() + at, a[1].data() + at, a[2].data() + at}; }
    std::array<const float*, 3> other(std::size_t at) const { return {b[0].data() + at, b[1].data() + at, b[2].data() + at}; }
    std::array<float*, 3> to(std::size_t at) { return {out[0].data() + at, out[1].data() + at, out[2].data() + at}; }
};

template <class T>
std::vector<T*> pointers(std::vector<std::vector<T>>& planes) {
    std::vector<T*> p;
    for (auto& plane : planes) p.push_back(plane.data());
    return p;
}
template <class T>
std::vector<const T*> pointers(const std::vector<std::vector<T>>& planes) {
    std::vector<const T*> p;
    for (const auto& plane : planes) p.push_back(plane.data());
    return p;
}

double half_value(std::uint16_t h) {
    float v = 0;
    kernels::half_to_float_reference(&h, 1, 1, &v);
    return v;
}

std::vector<Task> tasks(Pictures& p) {
    const Matrix3 matrix{{0.9, 0.08, 0.02, 0.05, 0.9, 0.05, 0.01, 0.09, 0.9}};
    const auto max_difference = [&p](std::size_t n, const auto& expected) {
        double worst = 0;
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t i = 0; i < n; ++i) worst = std::max(worst, std::fabs(static_cast<double>(p.out[c][i]) - static_cast<double>(expected[c][i])));
        return worst;
    };
    std::vector<Task> all;
    all.push_back({"decoding of 8-bit codes to half coefficients", 0.5,
                   [&p](std::size_t at, std::size_t n) {
                       thread_local std::vector<float> plane(strip);
                       for (std::size_t c = 0; c < 3; ++c) {
                           kernels::decode_codes(p.codes.data() + 3 * at + c, 3, n, p.table.data(), plane.data());
                           kernels::float_to_half(plane.data(), n, p.halves[c].data() + at, 1);
                       }
                   },
                   [&p](std::size_t n) {
                       double worst = 0;
                       for (std::size_t c = 0; c < 3; ++c)
                           for (std::size_t i = 0; i < n; ++i) {
                               std::uint16_t expected = 0;
                               kernels::float_to_half_reference(&p.table[p.codes[3 * i + c]], 1, &expected, 1);
                               worst = std::max(worst, std::fabs(half_value(p.halves[c][i]) - half_value(expected)));
                           }
                       return worst;
                   },
                   0, "linear"});
    all.push_back({"halves to float", 0,
                   [&p](std::size_t at, std::size_t n) {
                       for (std::size_t c = 0; c < 3; ++c) kernels::half_to_float(p.halves[c].data() + at, 1, n, p.out[c].data() + at);
                   },
                   [&p, max_difference](std::size_t n) {
                       Planes expected;
                       for (std::size_t c = 0; c < 3; ++c) {
                           expected[c].resize(n);
                           kernels::half_to_float_reference(p.halves[c].data(), 1, n, expected[c].data());
                       }
                       return max_difference(n, expected);
                   },
                   0, "linear"});
    all.push_back({"relight by a matrix", 0.8, [&p, matrix](std::size_t at, std::size_t n) { kernels::matrix3(matrix, p.in(at), n, p.to(at)); },
                   [&p, matrix, max_difference](std::size_t n) {
                       Planes expected;
                       for (auto& plane : expected) plane.resize(n);
                       kernels::matrix3_reference(matrix, p.in(0), n, {expected[0].data(), expected[1].data(), expected[2].data()});
                       return max_difference(n, expected);
                   },
                   0, "linear"});
    all.push_back({"relight by the lattice", 0.15,
                   [&p](std::size_t at, std::size_t n) {
                       const auto to = p.to(at);
                       (*p.relight)(p.in(at), n, to.data());
                   },
                   [&p, max_difference](std::size_t n) {
                       std::array<std::vector<double>, 3> expected;
                       for (auto& plane : expected) plane.resize(n);
                       double* const to[] = {expected[0].data(), expected[1].data(), expected[2].data()};
                       p.relight->reference(p.in(0), n, to);
                       return max_difference(n, expected);
                   },
                   // Rounded once to float.
                   0x1p-24, "linear"});
    all.push_back({"36 half bands of three spectra", 0.25,
                   [&p](std::size_t at, std::size_t n) { kernels::combine_basis(p.in(at), n, p.basis, 0, bands, pointers(p.half_spectra).data()); },
                   [&p](std::size_t n) {
                       std::vector<std::vector<float>> expected(bands, std::vector<float>(n));
                       kernels::combine_basis_reference(p.in(0), n, p.basis, 0, bands, pointers(expected).data());
                       double worst = 0;
                       for (std::size_t band = 0; band < bands; ++band)
                           for (std::size_t i = 0; i < n; ++i)
                               worst = std::max(worst, std::fabs(half_value(p.half_spectra[band][i]) - static_cast<double>(expected[band][i])));
                       return worst;
                   },
                   // Half a unit in the last place of the halves below 1, and what the sums in float add.
                   0x1.01p-12, "reflectance"});
    all.push_back({"36 bands to halves whose errors cancel", 0,
                   [&p](std::size_t, std::size_t n) {
                       static const kernels::HalfSpectraRounder rounder(p.weights, bands);
                       rounder(pointers(std::as_const(p.spectra)).data(), n, pointers(p.half_spectra).data());
                   },
                   [&p](std::size_t n) {
                       double worst = 0;
                       for (std::size_t band = 0; band < bands; ++band)
                           for (std::size_t i = 0; i < n; ++i)
                               worst = std::max(worst, std::fabs(half_value(p.half_spectra[band][i]) - static_cast<double>(p.spectra[band][i])));
                       return worst;
                   },
                   // One unit and a half.
                   0x1.8p-11, "reflectance", 4});
    all.push_back({"sigmoids at 36 bands", 0,
                   [&p](std::size_t, std::size_t n) {
                       kernels::evaluate_sigmoids({p.coefficients.data(), 3 * n}, p.positions, {p.reflectance.data(), n * bands});
                   },
                   [&p](std::size_t n) {
                       std::vector<double> expected(n * bands);
                       kernels::evaluate_sigmoids_reference({p.coefficients.data(), 3 * n}, p.positions, expected);
                       double worst = 0;
                       for (std::size_t i = 0; i < expected.size(); ++i) worst = std::max(worst, std::fabs(p.reflectance[i] - expected[i]));
                       return worst;
                   },
                   0, "reflectance", 8});
    all.push_back({"36 bands to tristimulus", 0,
                   [&p](std::size_t, std::size_t n) {
                       float* const to[] = {p.out[0].data(), p.out[1].data(), p.out[2].data()};
                       kernels::integrate_bands(pointers(std::as_const(p.spectra)), n, p.weights, 3, to);
                   },
                   [&p, max_difference](std::size_t n) {
                       std::array<std::vector<double>, 3> expected;
                       for (auto& plane : expected) plane.resize(n);
                       double* const to[] = {expected[0].data(), expected[1].data(), expected[2].data()};
                       kernels::integrate_bands_reference(pointers(std::as_const(p.spectra)), n, p.weights, 3, to);
                       return max_difference(n, expected);
                   },
                   // Rounded once to float, of sums up to 2.
                   0x1p-24, "linear", 4});
    all.push_back({"mantissas to 7 bits", 0,
                   [&p](std::size_t at, std::size_t n) {
                       for (std::size_t c = 0; c < 3; ++c) kernels::round_mantissa(p.a[c].data() + at, n, 7, true, p.out[c].data() + at);
                   },
                   [&p, max_difference](std::size_t n) {
                       Planes expected;
                       for (std::size_t c = 0; c < 3; ++c) {
                           expected[c].resize(n);
                           kernels::round_mantissa_reference(p.a[c].data(), n, 7, true, expected[c].data());
                       }
                       return max_difference(n, expected);
                   },
                   0, "linear"});
    const Matrix3 to_xyz = {{0.4124, 0.3576, 0.1805, 0.2126, 0.7152, 0.0722, 0.0193, 0.1192, 0.9505}};
    const Vector3 white{0.9505, 1, 1.089};
    Matrix3 relative = to_xyz;
    for (std::size_t row = 0; row < 3; ++row)
        for (std::size_t column = 0; column < 3; ++column) relative(row, column) /= white[row];
    all.push_back({"XYZ to Lab", 0,
                   [&p, relative](std::size_t at, std::size_t n) { lab_planes(relative, p.in(at), n, {p.lab[0].data(), p.lab[1].data(), p.lab[2].data()}); },
                   [&p, relative](std::size_t n) {
                       double worst = 0;
                       lab_planes(relative, p.in(0), n, {p.lab[0].data(), p.lab[1].data(), p.lab[2].data()});
                       for (std::size_t i = 0; i < n; ++i) {
                           const Vector3 expected = lab_from_xyz(relative * Vector3{p.a[0][i], p.a[1][i], p.a[2][i]}, {1, 1, 1});
                           for (std::size_t c = 0; c < 3; ++c) worst = std::max(worst, std::fabs(p.lab[c][i] - expected[c]));
                       }
                       return worst;
                   },
                   1e-12, "Lab"});
    for (const Metric metric : {Metric::cie76, Metric::cie94, Metric::ciede2000, Metric::cmc, Metric::din99, Metric::itp, Metric::oklab}) {
        const DifferenceKernel kernel(metric, to_xyz, to_xyz, white);
        all.push_back({std::string(metric_title(metric)), metric == Metric::ciede2000 ? 0.05 : 0,
                       [&p, kernel](std::size_t at, std::size_t n) { kernel(p.in(at), p.other(at), n, p.difference.data() + at); },
                       [&p, kernel](std::size_t n) {
                           std::array<std::vector<double>, 6> wide;
                           for (std::size_t c = 0; c < 3; ++c) {
                               wide[c].assign(p.a[c].begin(), p.a[c].begin() + static_cast<std::ptrdiff_t>(n));
                               wide[3 + c].assign(p.b[c].begin(), p.b[c].begin() + static_cast<std::ptrdiff_t>(n));
                           }
                           std::vector<double> expected(n);
                           kernel({wide[0].data(), wide[1].data(), wide[2].data()}, {wide[3].data(), wide[4].data(), wide[5].data()}, n, expected.data());
                           double worst = 0;
                           for (std::size_t i = 0; i < n; ++i) worst = std::max(worst, std::fabs(p.difference[i] - expected[i]));
                           return worst;
                       },
                       // Of differences below 20: a rounding to float, or what weights in float leave.
                       1e-4, "ΔE", static_cast<std::size_t>(metric == Metric::cie76 || metric == Metric::ciede2000 ? 1 : 8)});
    }
    all.push_back({"changed 8-bit codes", 0, [&p](std::size_t at, std::size_t n) { p.difference[at] = static_cast<float>(count_changed_codes(p.in(at), p.other(at), n)); },
                   [](std::size_t) { return 0.0; }, 0, "codes"});
    all.push_back({"statistics with exact percentiles", 0,
                   [&p](std::size_t at, std::size_t n) {
                       if (at == 0) p.accumulator.emplace();
                       (void)p.accumulator->add_row(static_cast<std::int64_t>(at / strip), {p.a[0].data() + at, n});
                       if (at + n == pixels) (void)p.accumulator->finish();
                   },
                   [](std::size_t) { return 0.0; }, 0, ""});
    return all;
}

/// Of this thread's processor time: on a machine that does nothing else it is what a clock shows.
double seconds(const std::function<void(std::size_t, std::size_t)>& run, std::size_t n) {
    const auto now = [] {
        timespec t{};
        ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
        return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
    };
    const double begin = now();
    for (std::size_t at = 0; at < n; at += strip) run(at, std::min(strip, n - at));
    return now() - begin;
}

double median(std::vector<double> v) {
    std::sort(v.begin(), v.end());
    return v.size() % 2 ? v[v.size() / 2] : (v[v.size() / 2 - 1] + v[v.size() / 2]) / 2;
}

}  // namespace

Result<std::vector<KernelSpeed>> measure_kernels(int rounds) {
    if (rounds < 1 || rounds > 1000) return Error{ErrorKind::usage, fmt::format("{} rounds: expected 1 to 1000", rounds)};
    Pictures p;
    auto all = tasks(p);
    const auto copy = [&p](std::size_t at, std::size_t n) {
        for (std::size_t c = 0; c < 3; ++c) std::memcpy(p.out[c].data() + at, p.a[c].data() + at, n * sizeof(float));
    };
    std::vector<KernelSpeed> results;
    for (const Task& t : all) {
        constexpr std::size_t checked = 4096;
        t.run(0, checked);
        const double error = t.error(checked);
        if (!(error <= t.allowed))
            return Error{ErrorKind::input, fmt::format("{}: differs from its reference by {:.3g} {}, expected {:.3g} at most", t.name, error, t.unit, t.allowed)};
        results.push_back({t.name, 0, 0, t.target, error, t.unit});
    }
    std::vector<std::vector<double>> speeds(all.size()), ratios(all.size());
    std::vector<double> copies;
    for (int round = 0; round < rounds; ++round)
        for (std::size_t k = 0; k < all.size(); ++k) {
            // A copy beside each, so that what else the machine does meets both.
            const double memory = static_cast<double>(pixels) / seconds(copy, pixels);
            const std::size_t n = pixels / all[k].part;
            const double speed = static_cast<double>(n) / seconds(all[k].run, n);
            copies.push_back(memory * 1e-6);
            speeds[k].push_back(speed * 1e-6);
            ratios[k].push_back(speed / memory);
        }
    for (std::size_t k = 0; k < all.size(); ++k) {
        results[k].megapixels = median(speeds[k]);
        results[k].ratio = median(ratios[k]);
    }
    results.insert(results.begin(), {"memory copy of three float planes", median(copies), 1, 0, 0, ""});
    return results;
}

}  // namespace spectex
