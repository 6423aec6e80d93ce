// Convex programmes behind the spectra: spectral primaries as a quadratic programme, with a certificate where there are none.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "spectex/base.h"
#include "spectex/spectral.h"

namespace spectex {

/// What the primaries minimise.
enum class Smoothness {
    first,   ///< sum over the three spectra of squared first differences
    second,  ///< of squared second differences
};

/// Proof that no three spectra in [0,1] that sum to one meet A b_i = e_i. With c_i = A^T y_i + s, every feasible b would
/// give sum_i c_i . b_i = sum_i y_i . e_i + sum_l s_l (`constraint_value`), but over the box it is at most
/// sum max(c, 0) (`box_maximum`), which is less.
struct FarkasCertificate {
    std::vector<double> y;  ///< [3 primaries][3 components]
    std::vector<double> s;  ///< [bands]
    double constraint_value = 0;
    double box_maximum = 0;
};

struct PrimariesSolution {
    std::vector<double> basis;       ///< [3][bands] row-major: b_r, b_g, b_b
    double objective = 0;            ///< sum of squared differences as chosen, unscaled, between neighbouring bands
    double sensing_residual = 0;     ///< largest |A b_i - e_i|
    double sum_residual = 0;         ///< largest |b_r + b_g + b_b - 1|
    double minimum = 0, maximum = 0; ///< over all entries
    double duality_gap = 0;          ///< relative, at the interior solution before the polish
    double least_violation = 0;      ///< smallest t with -t <= b <= 1 + t; negative: slack
    int iterations = 0;
    /// Proof of optimality: y [3 primaries][3 components], then s [bands], with which
    /// z_i = (gradient of objective by b_i) - A^T y_i - s is >= 0 everywhere and 0 where b_i > 0. By convexity no feasible
    /// spectra have a smaller objective.
    std::vector<double> multipliers;
};

struct PrimariesOutcome {
    bool feasible = false;
    PrimariesSolution solution;      ///< when feasible; otherwise the spectra of least violation
    FarkasCertificate certificate;   ///< when infeasible
};

/// The three spectra of Mallett and Yuksel 2019, eq. 5 to 8, as a convex quadratic programme at its global optimum:
/// minimise the differences subject to b_r + b_g + b_b = 1, 0 <= b <= 1, A b_i = e_i. Differences between unevenly spaced
/// bands are divided by the spacing relative to the mean one, so that the objective measures slope.
/// Primal-dual interior point (Mehrotra 1992) on a sparse LDL^T factorisation, then an active-set polish in long double:
/// residuals <= 1e-12, bounds exact.
/// @error infeasible never: that is an outcome. input, when the numerics fail to converge (said with the figures reached).
SPECTEX_API Result<PrimariesOutcome> solve_primaries(const Colorimetry& colorimetry, Smoothness smoothness);

/// The objective of three (or any) spectra, [spectra][bands]: the sum of their squared differences, in long double.
SPECTEX_API double squared_differences(std::span<const double> spectra, const BandSet& bands, Smoothness smoothness);

}  // namespace spectex
