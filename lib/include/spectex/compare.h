// Colour differences and their statistics.
//
// Lab values are L* in 0..100. The first argument is the reference. Every formula gives exactly 0 for identical colours,
// is finite for finite input (negative XYZ included: CIE's linear branch is continued), and NaN for NaN.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"

namespace spectex {

enum class Metric { cie76, cie94, ciede2000, cmc, din99, itp, oklab };
/// @error usage, listing the names.
SPECTEX_API Result<Metric> parse_metric(std::string_view name);
SPECTEX_API std::string_view metric_name(Metric metric);
SPECTEX_API std::string_view metric_title(Metric metric);  ///< "CIE76 ΔE*ab", "CIEDE2000", ...

/// CIE 15:2018 eq. 8.3..8.6, relative to a white with any Y.
SPECTEX_API Vector3 lab_from_xyz(const Vector3& xyz, const Vector3& white);
SPECTEX_API double delta_e76(const Vector3& lab_reference, const Vector3& lab_sample);
SPECTEX_API double delta_e94(const Vector3& lab_reference, const Vector3& lab_sample);       ///< graphic arts
SPECTEX_API double delta_e2000(const Vector3& lab_reference, const Vector3& lab_sample);     ///< kL = kC = kH = 1
SPECTEX_API double delta_cmc(const Vector3& lab_reference, const Vector3& lab_sample);       ///< l:c = 2:1
SPECTEX_API double delta_e_din99(const Vector3& lab_reference, const Vector3& lab_sample);   ///< DIN 6176, kE = kCH = 1

/// Differences of n pixels given as linear RGB; double inside, float out.
class SPECTEX_API DifferenceKernel {
public:
    /// @param rgb_to_xyz  for either side, XYZ relative to Y = 1; @param white  the reference white's XYZ.
    DifferenceKernel(Metric metric, const Matrix3& a_to_xyz, const Matrix3& b_to_xyz, const Vector3& white);
    /// @param a, b  three planes of n each; @param out  [n].
    void operator()(std::array<const float*, 3> a, std::array<const float*, 3> b, std::size_t n, float* out) const;
    void operator()(std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, double* out) const;

private:
    Metric metric_;
    Matrix3 a_to_xyz_, b_to_xyz_;
    Vector3 white_;
};

struct DifferenceStatistics {
    std::uint64_t pixels = 0;     ///< finite ones, over which all below is taken
    std::uint64_t nonfinite = 0;
    std::uint64_t changed_codes = 0;
    double mean = 0, rms = 0, p50 = 0, p95 = 0, p99 = 0, p999 = 0, max = 0;
    std::array<std::int64_t, 2> max_at{-1, -1};  ///< x, y of the first pixel, in row order, with the largest value
};

/// Gathers differences row by row: compensated sums in row order, exact percentiles (nearest rank) in bounded memory:
/// beyond `memory_bytes` values go to an unlinked temporary file. The result does not depend on threads or strip height.
class SPECTEX_API DifferenceAccumulator {
public:
    explicit DifferenceAccumulator(std::size_t memory_bytes = std::size_t{1} << 28);
    ~DifferenceAccumulator();
    DifferenceAccumulator(DifferenceAccumulator&&) noexcept;
    /// Rows must come in ascending order. Non-finite values are counted and left out.
    Status add_row(std::int64_t y, std::span<const float> values);
    void add_changed_codes(std::uint64_t n);
    Result<DifferenceStatistics> finish();

private:
    struct State;
    std::unique_ptr<State> state_;
};

/// How many of n pixels differ in 8-bit sRGB code after encoding (rounded to nearest, clipped).
SPECTEX_API std::uint64_t count_changed_codes(std::array<const float*, 3> a, std::array<const float*, 3> b, std::size_t n);

}  // namespace spectex
