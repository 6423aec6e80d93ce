// What the groups of the stress suite share: inputs, errors in units in the last place, and the worst of them.
#pragma once

#include <functional>
#include <limits>

#include "evaluation/formulas.h"
#include "spectex/stability.h"

namespace spectex::stability {

using quad::Quad;

/// The worst of some cases. Of equals the first counts, so that the split into threads does not matter.
struct Tally {
    static constexpr std::uint64_t none = ~std::uint64_t{0};
    std::uint64_t cases = 0, broken = 0;
    double worst = -1, delta_e = -1;
    std::uint64_t worst_at = none, delta_e_at = none, broken_at = none;

    /// @param ulps  NaN: broken.
    void add(std::uint64_t i, double ulps);
    void add(std::uint64_t i, double ulps, double difference) {
        add(i, ulps);
        if (difference > delta_e || (difference == delta_e && i < delta_e_at)) delta_e = difference, delta_e_at = i;
    }
    void merge(const Tally& other);
};

/// Spacing of a type's numbers at x; below its normal range that of the subnormal ones.
template <class T>
double spacing(double x) {
    const double least = std::numeric_limits<T>::denorm_min();
    if (!(std::fabs(x) >= static_cast<double>(std::numeric_limits<T>::min()))) return least;
    return std::ldexp(1.0, std::ilogb(x) - std::numeric_limits<T>::digits + 1);
}
/// The nearest float. GCC 12 vectorises pairs of double -> float -> double into nothing; what is volatile it leaves alone.
inline double rounded(double v) {
    volatile float f = static_cast<float>(v);
    return static_cast<double>(f);
}
/// Of half floats: 11 bits, least 2^-24.
inline double half_spacing(double x) { return std::fabs(x) < 0x1p-14 ? 0x1p-24 : std::ldexp(1.0, std::ilogb(x) - 10); }

/// |result - exact| in units in the last place of T at the exact value. Results must overflow where the exact value does, and
/// be NaN where it is; else NaN comes out.
/// @param least  what is smaller is measured as if it were this.
template <class T>
double ulps(T result, Quad exact, double least = 0) {
    if (exact != exact) return std::isnan(result) ? 0 : std::nan("");
    const double most = static_cast<double>(std::numeric_limits<T>::max());
    const Quad beyond = Quad(most) + Quad(spacing<T>(most)) / 2;
    if (quad::abs(exact) >= beyond) return std::isinf(result) && (result > 0) == (exact > 0) ? 0 : std::nan("");
    // One rounding from the end either side is right.
    if (std::isinf(result)) return quad::abs(exact) > Quad(most) * (1 - Quad(1e-6)) ? 1 : std::nan("");
    if (std::isnan(result)) return std::nan("");
    return static_cast<double>(quad::abs(Quad(Quad(result) - exact)) / Quad(spacing<T>(std::max(least, std::fabs(static_cast<double>(exact))))));
}
/// Error over 2^-53 of the terms that were added.
inline double terms(double result, Quad exact, Quad size) {
    if (!std::isfinite(result)) return exact != exact && std::isnan(result) ? 0 : std::nan("");
    const Quad error = quad::abs(Quad(Quad(result) - exact));
    if (error == 0) return 0;
    return static_cast<double>(error / (quad::larger(size, Quad(std::numeric_limits<double>::min())) * Quad(0x1p-53)));
}

/// The colour of (1,1,1), which is the white but for the rounding of the matrix: references take greys for neutral, as
/// they are meant.
template <class Real>
quad::Triple<Real> white_of_grey(const Matrix3& rgb_to_xyz, const Vector3& white) {
    auto out = quad::times(quad::wide<Real>(rgb_to_xyz), quad::Triple<Real>{1, 1, 1});
    for (std::size_t k = 0; k < 3; ++k)
        if (quad::abs(Real(out[k] - Real(white[k]))) > Real(1e-13)) return quad::wide<Real>(white);
    return out;
}

/// Calls body(first, last, tally) for parts of [0, count) on all threads, and merges.
Tally measure(std::uint64_t count, std::uint64_t part, const std::function<void(std::uint64_t, std::uint64_t, Tally&)>& body);

/// Inputs: adversarial colours first, then random ones, then sRGB codes.
class Colors {
public:
    enum class Range { cube, any };
    /// @param single  every component is a float.
    Colors(const StabilityOptions& options, Range range, bool single, std::uint64_t thinning = 1);
    std::uint64_t size() const { return fixed_.size() + random_ + codes_; }
    Vector3 operator[](std::uint64_t i) const;
    std::string describe(std::uint64_t i) const;

private:
    Vector3 random(std::uint64_t i) const;
    std::vector<Vector3> fixed_;
    std::uint64_t random_ = 0, codes_ = 0, stride_ = 1, seed_ = 1;
    Range range_;
    bool single_;
};
/// Magnitudes at which something changes: ends of types, toes of curves, walls of lattices, each with both neighbours.
std::vector<double> notable_values(bool single);
std::uint64_t scrambled(std::uint64_t x);
/// Uniform in [0,1) of a hash.
inline double unit_of(std::uint64_t x) { return static_cast<double>(x >> 11) * 0x1p-53; }

std::string text_of(const Vector3& v);

struct Bounds {
    double most = std::numeric_limits<double>::infinity(), delta_e = std::numeric_limits<double>::infinity();
    std::string reason;
};

class Study {
public:
    const Colorimetry& colorimetry;
    const StabilityOptions& options;
    StabilityReport report;

    StabilityRow& add(std::string group, std::string path, std::string unit, const Tally& tally,
                      const std::function<std::string(std::uint64_t)>& describe, Bounds bounds);
    /// A single figure.
    StabilityRow& figure(std::string group, std::string path, std::string unit, double value, std::string at, Bounds bounds);
};

void study_colors(Study& study);
void study_differences(Study& study);
Status study_methods(Study& study);
Status study_solvers(Study& study);
Status study_lights(Study& study);
Status study_sums(Study& study);
Status study_conditioning(Study& study);

}  // namespace spectex::stability
