// The programme of solve_primaries for a sensing matrix of the caller's own.
#pragma once

#include <span>

#include "spectex/solvers.h"

namespace spectex::solvers {

/// @param sensing         [3][bands] row-major: A with rgb = A r.
/// @param wavelengths_nm  [bands], ascending.
/// @param smoothness      what to minimise.
/// @error as solve_primaries; usage, when sizes do not match.
Result<PrimariesOutcome> solve_primaries(std::span<const double> sensing, std::span<const double> wavelengths_nm,
                                         Smoothness smoothness);

/// Whether a certificate proves, in long double and with a margin for rounding, that the primaries do not exist.
/// Fills in constraint_value and box_maximum.
bool verify(FarkasCertificate& certificate, std::span<const double> sensing);

/// Sum over the rows of `spectra` ([rows][bands]) of squared differences, as the objective of solve_primaries.
double roughness(std::span<const double> spectra, std::span<const double> wavelengths_nm, Smoothness smoothness);

}  // namespace spectex::solvers
