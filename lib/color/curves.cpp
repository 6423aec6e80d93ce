#include "color/curves.h"

namespace spectex {
namespace {

// BT.2020-2, table 4, note: the solution of the two equations that join the segments with one slope; BT.709 rounds it.
constexpr double bt709_alpha = 1.09929682680944, bt709_beta = 0.018053968510807;

// What the doubles nearest to 2.4 and 1 / 2.4 leave of them.
constexpr double decode_rest = 8.881784197001253e-17, encode_rest = -1.850371707708594e-17;

/// x^(exponent + rest), the rest being what the exponent's own rounding left: it matters where the logarithm is large.
double power(double x, double exponent, double rest) {
    const double p = std::pow(x, exponent);
    return x > 16 && std::isfinite(p) ? p + p * (rest * std::log(x)) : p;
}

}  // namespace

double srgb_decode(double encoded) {
    const double v = std::fabs(encoded);
    const double linear = v <= 0.04045 ? v / 12.92 : power((v + 0.055) / 1.055, 2.4, decode_rest);
    return std::copysign(linear, encoded);
}

double srgb_encode(double linear) {
    const double v = std::fabs(linear);
    if (v <= 0.0031308) return linear * 12.92;
    const double p = power(v, 1 / 2.4, encode_rest);
    // 1.055 p - 0.055, near 1 in the form that gives exactly 1 for 1, below it in the one that does not cancel; an infinity
    // stays one.
    return std::copysign(v < 0.5 ? 1.055 * p - 0.055 : 1 + 1.055 * (p - 1), linear);
}

double TransferCurve::decode(double encoded) const {
    const double v = std::fabs(encoded);
    switch (kind) {
        case CurveKind::linear: return encoded;
        case CurveKind::srgb: return srgb_decode(encoded);
        case CurveKind::power: return std::copysign(std::pow(v, exponent), encoded);
        case CurveKind::bt709:
            return std::copysign(
                v < 4.5 * bt709_beta ? v / 4.5 : std::pow((v + (bt709_alpha - 1)) / bt709_alpha, 1 / 0.45), encoded);
        case CurveKind::romm: return std::copysign(v < 16.0 / 512 ? v / 16 : std::pow(v, 1.8), encoded);
    }
    return encoded;
}

double TransferCurve::encode(double linear) const {
    const double v = std::fabs(linear);
    switch (kind) {
        case CurveKind::linear: return linear;
        case CurveKind::srgb: return srgb_encode(linear);
        case CurveKind::power: return std::copysign(std::pow(v, 1 / exponent), linear);
        case CurveKind::bt709:
            return std::copysign(v < bt709_beta ? v * 4.5 : bt709_alpha * std::pow(v, 0.45) - (bt709_alpha - 1), linear);
        case CurveKind::romm: return std::copysign(v < 1.0 / 512 ? v * 16 : std::pow(v, 1 / 1.8), linear);
    }
    return linear;
}

}  // namespace spectex
