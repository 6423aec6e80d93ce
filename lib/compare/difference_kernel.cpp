#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>

#include "compare/spaces.h"
#include "spectex/compare.h"
#include "spectex/spectral.h"

namespace spectex {

namespace {

struct MetricEntry {
    Metric metric;
    std::string_view name, title;
};
constexpr std::array<MetricEntry, 7> metric_entries{{
    {Metric::cie76, "cie76", "CIE76 ΔE*ab"},
    {Metric::cie94, "cie94", "CIE94 ΔE*94, graphic arts"},
    {Metric::ciede2000, "ciede2000", "CIEDE2000 ΔE00"},
    {Metric::cmc, "cmc", "CMC(2:1) ΔE"},
    {Metric::din99, "din99", "DIN99 ΔE99"},
    {Metric::itp, "itp", "BT.2124 ΔE ITP"},
    {Metric::oklab, "oklab", "Oklab ΔE"},
}};

const MetricEntry& entry_of(Metric metric) { return metric_entries[static_cast<std::size_t>(metric)]; }

}  // namespace

Result<Metric> parse_metric(std::string_view name) {
    std::string names;
    for (const MetricEntry& entry : metric_entries) {
        if (entry.name == name) return entry.metric;
        names += names.empty() ? "" : ", ";
        names += entry.name;
    }
    return Error{ErrorKind::usage, "unknown metric '" + std::string(name) + "': expected one of " + names};
}
std::string_view metric_name(Metric metric) { return entry_of(metric).name; }
std::string_view metric_title(Metric metric) { return entry_of(metric).title; }

double pq_encode(double luminance) {
    constexpr double m1 = 2610.0 / 16384, m2 = 2523.0 / 4096 * 128;
    constexpr double c1 = 3424.0 / 4096, c3 = 2392.0 / 4096 * 32;
    const double y = std::pow(std::fabs(luminance) / 10000, m1);
    // (c1 + c2 y) / (1 + c3 y) is 1 + (1 - c1) (y - 1) / (1 + c3 y), for c1 + c2 = 1 + c3: the power of 79 would magnify the
    // rounding of a number near 1.
    const double code = std::exp(m2 * std::log1p((1 - c1) * (y - 1) / (1 + c3 * y)));
    static const double zero = std::pow(c1, m2);
    return luminance < 0 ? 2 * zero - code : code;
}

ItpSpace::ItpSpace(const Vector3& white) {
    // BT.2100 table 7, over 4096.
    constexpr Matrix3 rgb_to_lms{{1688, 2146, 262, 683, 2951, 462, 99, 309, 3688}};
    RgbSpace bt2020;
    bt2020.primaries_xy = {{{0.708, 0.292}, {0.170, 0.797}, {0.131, 0.046}}};
    // The matrix takes the reference white itself to R = G = B = 1, and that to 203 cd/m2 (ITU-R BT.2408-7, table 1).
    xyz_to_lms = rgb_to_lms * rgb_to_xyz_matrix(bt2020, white).inverse();
    for (double& v : xyz_to_lms.m) v *= 203.0 / 4096;
}

Vector3 ItpSpace::operator()(const Vector3& xyz) const {
    const Vector3 lms = xyz_to_lms * xyz;
    const double l = pq_encode(lms[0]), m = pq_encode(lms[1]), s = pq_encode(lms[2]);
    const double ct = (6610 * l - 13613 * m + 7003 * s) / 4096;
    const double cp = (17933 * l - 17390 * m - 543 * s) / 4096;
    return {(l + m) / 2, ct / 2, cp};
}

OklabSpace::OklabSpace(const Vector3& white) {
    xyz_to_lms = {{0.8189330101, 0.3618667424, -0.1288597137, 0.0329845436, 0.9293118715, 0.0361456387, 0.0482003018,
                   0.2643662691, 0.6338517070}};
    const Vector3 lms = xyz_to_lms * white;
    for (std::size_t row = 0; row < 3; ++row)
        for (std::size_t column = 0; column < 3; ++column) xyz_to_lms(row, column) /= lms[row];
}

Vector3 OklabSpace::operator()(const Vector3& xyz) const {
    const Vector3 lms = xyz_to_lms * xyz;
    return lms_to_lab * Vector3{std::cbrt(lms[0]), std::cbrt(lms[1]), std::cbrt(lms[2])};
}

DifferenceKernel::DifferenceKernel(Metric metric, const Matrix3& a_to_xyz, const Matrix3& b_to_xyz, const Vector3& white)
    : metric_(metric), a_to_xyz_(a_to_xyz), b_to_xyz_(b_to_xyz), white_(white) {}

namespace {

constexpr std::size_t block_size = 256;

Matrix3 relative_to(const Vector3& white, Matrix3 m) {
    for (std::size_t row = 0; row < 3; ++row)
        for (std::size_t column = 0; column < 3; ++column) m(row, column) = white[row] == 0 ? 0 : m(row, column) / white[row];
    return m;
}

using Planes = std::array<double*, 3>;

/// @param delta  of two colours, or for floats of planes of them, which it may change.
template <class T, class F>
void over_lab(const Matrix3& a_to_relative, const Matrix3& b_to_relative, std::array<const T*, 3> a,
              std::array<const T*, 3> b, std::size_t n, T* out, F delta) {
    double la[3][block_size], lb[3][block_size];
    for (std::size_t begin = 0; begin < n; begin += block_size) {
        const std::size_t count = std::min(block_size, n - begin);
        lab_planes(a_to_relative, {a[0] + begin, a[1] + begin, a[2] + begin}, count, {la[0], la[1], la[2]});
        lab_planes(b_to_relative, {b[0] + begin, b[1] + begin, b[2] + begin}, count, {lb[0], lb[1], lb[2]});
        if constexpr (std::is_same_v<T, float>)
            delta(Planes{la[0], la[1], la[2]}, Planes{lb[0], lb[1], lb[2]}, count, out + begin);
        else
            for (std::size_t i = 0; i < count; ++i)
                out[begin + i] = static_cast<T>(
                    delta(Vector3{la[0][i], la[1][i], la[2][i]}, Vector3{lb[0][i], lb[1][i], lb[2][i]}));
    }
}

template <class T, class Space>
void over_space(const Space& space, double unit, const Matrix3& a_to_xyz, const Matrix3& b_to_xyz,
                std::array<const T*, 3> a, std::array<const T*, 3> b, std::size_t n, T* out) {
    if constexpr (std::is_same_v<T, float>) {
        double p[3][block_size], q[3][block_size];
        for (std::size_t begin = 0; begin < n; begin += block_size) {
            const std::size_t count = std::min(block_size, n - begin);
            space_planes(space, a_to_xyz, {a[0] + begin, a[1] + begin, a[2] + begin}, count, {p[0], p[1], p[2]});
            space_planes(space, b_to_xyz, {b[0] + begin, b[1] + begin, b[2] + begin}, count, {q[0], q[1], q[2]});
            distance_planes(unit, {p[0], p[1], p[2]}, {q[0], q[1], q[2]}, count, out + begin);
        }
    } else {
        for (std::size_t i = 0; i < n; ++i) {
            const Vector3 p = space(a_to_xyz * Vector3{a[0][i], a[1][i], a[2][i]});
            const Vector3 q = space(b_to_xyz * Vector3{b[0][i], b[1][i], b[2][i]});
            out[i] = unit * delta_e76(p, q);
        }
    }
}

/// Floats by vectors.
void run(Metric metric, const Matrix3& a_to_xyz, const Matrix3& b_to_xyz, const Vector3& white, std::array<const float*, 3> a,
         std::array<const float*, 3> b, std::size_t n, float* out) {
    const Matrix3 ma = relative_to(white, a_to_xyz), mb = relative_to(white, b_to_xyz);
    const auto with = [&](auto delta) { over_lab(ma, mb, a, b, n, out, delta); };
    using Read = std::array<const double*, 3>;
    const auto with_formula = [&](void (*formula)(Read, Read, std::size_t, float*)) {
        with([formula](const Planes& p, const Planes& q, std::size_t count, float* to) {
            formula({p[0], p[1], p[2]}, {q[0], q[1], q[2]}, count, to);
        });
    };
    switch (metric) {
        case Metric::cie76: return with_formula([](Read p, Read q, std::size_t count, float* to) { distance_planes(1, p, q, count, to); });
        case Metric::cie94: return with_formula(delta_e94_planes);
        case Metric::ciede2000: return with_formula(delta_e2000_planes);
        case Metric::cmc: return with_formula(delta_cmc_planes);
        case Metric::din99:
            return with([](const Planes& p, const Planes& q, std::size_t count, float* to) {
                din99_planes(p, count);
                din99_planes(q, count);
                distance_planes(1, {p[0], p[1], p[2]}, {q[0], q[1], q[2]}, count, to);
            });
        case Metric::itp: return over_space(ItpSpace(white), 720, a_to_xyz, b_to_xyz, a, b, n, out);
        case Metric::oklab: return over_space(OklabSpace(white), 1, a_to_xyz, b_to_xyz, a, b, n, out);
    }
}

/// Doubles one by one: the reference of the others.
void run(Metric metric, const Matrix3& a_to_xyz, const Matrix3& b_to_xyz, const Vector3& white, std::array<const double*, 3> a,
         std::array<const double*, 3> b, std::size_t n, double* out) {
    const Matrix3 ma = relative_to(white, a_to_xyz), mb = relative_to(white, b_to_xyz);
    // A template argument rather than a pointer, so that each formula is inlined into its own loop.
    const auto with = [&](auto delta) { over_lab(ma, mb, a, b, n, out, delta); };
    using V = const Vector3&;
    switch (metric) {
        case Metric::cie76: return with([](V p, V q) { return delta_e76(p, q); });
        case Metric::cie94: return with([](V p, V q) { return delta_e94(p, q); });
        case Metric::ciede2000: return with([](V p, V q) { return delta_e2000(p, q); });
        case Metric::cmc: return with([](V p, V q) { return delta_cmc(p, q); });
        case Metric::din99: return with([](V p, V q) { return delta_e_din99(p, q); });
        case Metric::itp: return over_space(ItpSpace(white), 720, a_to_xyz, b_to_xyz, a, b, n, out);
        case Metric::oklab: return over_space(OklabSpace(white), 1, a_to_xyz, b_to_xyz, a, b, n, out);
    }
}

}  // namespace

void DifferenceKernel::operator()(std::array<const float*, 3> a, std::array<const float*, 3> b, std::size_t n,
                                  float* out) const {
    run(metric_, a_to_xyz_, b_to_xyz_, white_, a, b, n, out);
}
void DifferenceKernel::operator()(std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n,
                                  double* out) const {
    run(metric_, a_to_xyz_, b_to_xyz_, white_, a, b, n, out);
}

}  // namespace spectex
