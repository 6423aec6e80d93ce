// Floats to fewer bits, so that what is written compresses.
#pragma once

#include <cstddef>

namespace spectex::kernels {

/// Most mantissa bits that a half and a float keep after the leading one.
constexpr int half_mantissa_bits = 10, float_mantissa_bits = 23;

/// Rounds floats to `bits` mantissa bits after the leading one, to nearest, ties to even; with `half` to a half's range and
/// spacing as well, so that a conversion to half loses nothing more. Values of [0, 1] stay there; finite values above the
/// largest half become infinite with `half`. Any n and alignment; `out` may be `in`. The bytes do not depend on the
/// instruction set.
/// @param bits  0..23.
void round_mantissa(const float* in, std::size_t n, int bits, bool half, float* out);
void round_mantissa_reference(const float* in, std::size_t n, int bits, bool half, float* out);

}  // namespace spectex::kernels
