// Transfer curves of the encodings that this library knows by formula.
#pragma once

#include <cmath>

#include "spectex/color.h"

namespace spectex {

enum class CurveKind {
    linear,
    srgb,   ///< IEC 61966-2-1
    power,  ///< linear = encoded^exponent
    bt709,  ///< ITU-R BT.709-6 item 1.2 and BT.2020-2 table 4, the same curve with its constants unrounded
    romm,   ///< ISO 22028-2, gamma 1.8 with a linear toe
};

/// Encoded value to linear light and back, in double; every curve is continued as an odd function below 0 and by its own
/// formula above 1, and leaves NaN and infinities as they are.
struct TransferCurve {
    CurveKind kind = CurveKind::linear;
    double exponent = 1;

    bool is_linear() const { return kind == CurveKind::linear || (kind == CurveKind::power && exponent == 1); }
    bool operator==(const TransferCurve&) const = default;
    double decode(double encoded) const;
    double encode(double linear) const;
};

}  // namespace spectex
