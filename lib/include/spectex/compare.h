// Colour differences and their statistics.
//
// Lab values are L* in 0..100. The first argument is the reference. Every formula gives exactly 0 for identical colours,
// is finite for finite input of magnitudes up to 1e100 (negative XYZ included: CIE's linear branch is continued), and NaN
// for NaN.
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
/// CIE 116-1995, graphic arts: kL = 1, K1 = 0.045, K2 = 0.015, weighted by the reference's chroma: not symmetric.
SPECTEX_API double delta_e94(const Vector3& lab_reference, const Vector3& lab_sample);
/// CIE 142-2001 with kL = kC = kH = 1, as Sharma, Wu and Dalal 2005 settle it (doi:10.1002/col.20070). Symmetric. The
/// formula itself jumps, by up to a few tenths, where the hues are 180 degrees apart.
SPECTEX_API double delta_e2000(const Vector3& lab_reference, const Vector3& lab_sample);
/// CMC l:c = 2:1 (BS 6923:1988), weighted by the reference: not symmetric.
SPECTEX_API double delta_cmc(const Vector3& lab_reference, const Vector3& lab_sample);
/// DIN 6176:2001 with kE = kCH = 1. Symmetric. Below L* = 0 the lightness scale goes on with its slope at 0.
SPECTEX_API double delta_e_din99(const Vector3& lab_reference, const Vector3& lab_sample);

/// Differences of n pixels given as linear RGB; double inside, rounded once to the planes' own type, but for CIEDE2000 of
/// floats: its differences of Lab are taken in double and weighed in float, to within 5e-6 of the result. Each pixel's bytes
/// depend on that pixel alone, not on the split into calls nor on the instruction set's width.
/// itp: ITU-R BT.2124 (720 times the distance in I, T, P); XYZ becomes linear BT.2020 by the matrix of BT.2020's primaries
/// and the reference white, which stands at 203 cd/m2, the diffuse white of ITU-R BT.2408; negative light mirrors the PQ
/// curve. oklab: Euclidean distance in Oklab (Ottosson 2020), L in 0..1, the cone responses relative to the white's.
class SPECTEX_API DifferenceKernel {
public:
    /// @param a_to_xyz, b_to_xyz  linear RGB of either side to XYZ. @param white  the reference white on the same scale of
    /// XYZ, any positive Y.
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
/// beyond `memory_bytes` values go to an unlinked temporary file in $TMPDIR. The result does not depend on threads or
/// strip height.
class SPECTEX_API DifferenceAccumulator {
public:
    explicit DifferenceAccumulator(std::size_t memory_bytes = std::size_t{1} << 28);
    ~DifferenceAccumulator();
    DifferenceAccumulator(DifferenceAccumulator&&) noexcept;
    /// Rows must come in ascending order. Non-finite values are counted and left out.
    /// @error usage for a row out of order; output when the temporary file cannot be written.
    Status add_row(std::int64_t y, std::span<const float> values);
    void add_changed_codes(std::uint64_t n);
    /// Over no finite value at all every figure is 0 and max_at is (-1, -1).
    /// @error output when the temporary file cannot be read back.
    Result<DifferenceStatistics> finish();

private:
    struct State;
    std::unique_ptr<State> state_;
};

/// How many of n pixels of linear RGB differ in 8-bit sRGB code after encoding (IEC 61966-2-1, rounded to nearest without
/// error, clipped). A pixel with a NaN on either side counts as changed.
SPECTEX_API std::uint64_t count_changed_codes(std::array<const float*, 3> a, std::array<const float*, 3> b, std::size_t n);

}  // namespace spectex
