// Coefficients in eight bits, by the curve of sRGB: where they are linear RGB, those of an 8-bit sRGB texture are its own codes again.
#pragma once

#include <cstddef>
#include <cstdint>

#include "spectex/methods.h"

namespace spectex::plan {

/// Whether the coefficients of a model lie in [0,1]: linear RGB itself, or Fourier sRGB, which is meant to be kept by that curve.
bool fits_codes(const Model& model);

/// What the codes stand for. @return [256].
const float* code_table();

/// Nearest codes on the encoded scale: a value half way between two goes to the upper one. NaN becomes 0, and what lies
/// outside [0,1] its end.
void encode_codes(const float* values, std::size_t n, std::uint8_t* codes);

}  // namespace spectex::plan
