#include "color/curves.h"

namespace spectex {
namespace {

// BT.2020-2, table 4, note: the solution of the two equations that join the segments with one slope; BT.709 rounds it.
constexpr double bt709_alpha = 1.09929682680944, bt709_beta = 0.018053968510807;

}  // namespace

double srgb_decode(double encoded) {
    const double v = std::fabs(encoded);
    const double linear = v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
    return std::copysign(linear, encoded);
}

double srgb_encode(double linear) {
    const double v = std::fabs(linear);
    // 1.055 p - 0.055, in the form that gives exactly 1 for 1; an infinity stays one.
    const double encoded = v <= 0.0031308 ? v * 12.92 : 1 + 1.055 * (std::pow(v, 1 / 2.4) - 1);
    return std::copysign(encoded, linear);
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
