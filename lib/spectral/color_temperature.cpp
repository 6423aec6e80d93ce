#include <fmt/format.h>

#include <array>
#include <cmath>

#include "spectex/spectral.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

using Point = std::array<double, 2>;

/// CIE 1960 u, v.
Point uv_of(const Vector3& xyz) {
    const double d = xyz[0] + 15 * xyz[1] + 3 * xyz[2];
    return {4 * xyz[0] / d, 6 * xyz[1] / d};
}

/// The Planckian locus and its derivative by reciprocal temperature (in 1e6/K), by sums at 1 nm over the observer's range.
class Locus {
public:
    explicit Locus(const Observer& observer) : observer_(observer) {}
    void at(double mired, Point& uv, Point& derivative) const {
        constexpr double c2 = 1.438776877e7;  // nm K, CODATA 2018
        const double inverse = mired * 1e-6;
        const std::array<const std::vector<double>*, 3> cmf{&observer_.x_bar, &observer_.y_bar, &observer_.z_bar};
        std::array<CompensatedSum, 3> sums, slopes;
        for (std::size_t i = 0; i < observer_.x_bar.size(); ++i) {
            const double nm = observer_.start_nm + static_cast<double>(i), u = c2 * inverse / nm, u560 = c2 * inverse / 560;
            // Relative to 560 nm in exponent, so that neither end of the temperatures overflows.
            const double power = std::pow(560 / nm, 5) * std::exp(u560 - u) / -std::expm1(-u);
            const double slope = power * (c2 / 560 - c2 / nm / -std::expm1(-u)) * 1e-6;
            for (std::size_t c = 0; c < 3; ++c) {
                sums[c].add(power * (*cmf[c])[i]);
                slopes[c].add(slope * (*cmf[c])[i]);
            }
        }
        const Vector3 xyz{sums[0].value(), sums[1].value(), sums[2].value()};
        const Vector3 d{slopes[0].value(), slopes[1].value(), slopes[2].value()};
        uv = uv_of(xyz);
        const double scale = xyz[0] + 15 * xyz[1] + 3 * xyz[2], scale_slope = d[0] + 15 * d[1] + 3 * d[2];
        derivative = {(4 * d[0] - uv[0] * scale_slope) / scale, (6 * d[1] - uv[1] * scale_slope) / scale};
    }

private:
    const Observer& observer_;
};

}  // namespace

Result<ColorTemperature> correlated_color_temperature(const Illuminant& illuminant) {
    const auto observer = find_observer("cie1931");
    if (!observer) return observer.error();
    const BandSet all(SpectralShape::make(360, 830, 1).value());
    const auto weights = tristimulus_weights(all, **observer, illuminant, Normalization::luminance);
    if (!weights) return weights.error();
    const Point light = uv_of(weights->white);
    const Locus locus(**observer);

    // The distance falls before its nearest point and rises after it: the sign of (locus - light) . tangent.
    const auto side = [&](double mired, Point& at, Point& tangent) {
        locus.at(mired, at, tangent);
        return (at[0] - light[0]) * tangent[0] + (at[1] - light[1]) * tangent[1];
    };
    const double least = 1e6 / ColorTemperature::most_kelvin, most = 1e6 / ColorTemperature::least_kelvin;
    Point at{}, tangent{};
    double low = least, high = most, before = side(least, at, tangent), nearest = 1e9;
    bool found = false;
    constexpr int steps = 50;
    double from = least;
    for (int i = 1; i <= steps; ++i) {
        // Even steps of mired: the locus has nearly even speed in them.
        const double to = least + (most - least) * i / steps, after = side(to, at, tangent);
        const double distance = std::hypot(at[0] - light[0], at[1] - light[1]);
        if (before < 0 && after >= 0 && distance < nearest) {
            low = from;
            high = to;
            nearest = distance;
            found = true;
        }
        before = after;
        from = to;
    }
    if (!found) return ColorTemperature{};
    for (int i = 0; i < 100 && high - low > 1e-12 * high; ++i) {
        const double middle = (low + high) / 2;
        if (middle <= low || middle >= high) break;
        (side(middle, at, tangent) < 0 ? low : high) = middle;
    }
    const double mired = (low + high) / 2;
    side(mired, at, tangent);
    ColorTemperature out;
    out.duv = std::copysign(std::hypot(at[0] - light[0], at[1] - light[1]), light[1] - at[1]);
    // CIE 15:2018, 9.4: no temperature is to be named for a chromaticity farther than this from the locus.
    if (std::fabs(out.duv) <= 0.05) out.kelvin = 1e6 / mired;
    return out;
}

}  // namespace spectex
