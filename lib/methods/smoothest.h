// The smoothest spectrum of a colour: what smits1999:exact and meng2015 are made of.
#pragma once

#include <span>
#include <vector>

#include "spectex/base.h"

namespace spectex::registry {

/// The r of least sum of squared slopes with weights r = target and 0 <= r <= upper. Differences between unevenly spaced
/// bands are divided by their spacing. Unique, as a strictly convex quadratic programme; met to the rounding of double.
/// @param weights         [3][bands] row-major.
/// @param wavelengths_nm  [bands], ascending.
/// @param upper           largest value allowed, or infinity.
/// @return [bands].
/// @error infeasible, with the least violation of the bounds, when there is no such r; input, when the numerics fail.
Result<std::vector<double>> smoothest_spectrum(std::span<const double> weights, std::span<const double> wavelengths_nm,
                                               const Vector3& target, double upper);

}  // namespace spectex::registry
