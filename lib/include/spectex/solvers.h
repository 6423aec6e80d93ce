// Convex programmes behind the spectra: spectral primaries as a quadratic programme, with a certificate where there are none,
// and the lattice's vertices as one small quadratic programme each.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "spectex/base.h"
#include "spectex/methods.h"
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

/// The sets from which the shipped lattices learn: vrhel, koivisto, krinov, nickerson, macbeth.
SPECTEX_API Result<std::vector<SampleSet>> lattice_sample_sets();

/// The recipe. Defaults were chosen by leaving out one set of the five at a time and predicting its colours under 404 lamps.
struct LatticeOptions {
    std::size_t n = 9;         ///< vertices per axis, 2..65
    double reach = 0.15;       ///< colour distance, in hundreds of Lab, at which a sample's weight begins to fall
    double lightness = 0.5;    ///< weight of L* beside a* and b* in that distance
    double decay = 4;          ///< exponent of the fall
    double ridge = 3e-4;       ///< variance of what the samples do not explain, per band of 5 nm
    double smoothness = 200;   ///< weight of squared first differences between bands 5 nm apart
    double denoising = 10;     ///< weight of squared second differences of 5 nm bands in smoothing the samples; 0: as measured
    bool operator==(const LatticeOptions&) const = default;
};

/// Spectra at the vertices of a uniform lattice over the linear RGB cube, each the most natural exact metamer of its colour:
///
///     minimise (r - m)^T (C + ridge I)^-1 (r - m) + smoothness |D1 r|^2   subject to   A r = rgb,  0 <= r <= 1
///
/// with m and C the mean and covariance of the samples, each sample weighted by (1 + d^2 / reach^2)^-decay / (size of its set),
/// d the distance from the vertex in (lightness L*, a*, b*) / 100 under the colorimetry's own white. Samples are held at their
/// ends; those outside the cube are left out. What the instruments added is taken off first, by Whittaker's smoothing (1923,
/// doi:10.1017/S0013091500077853): far from all samples the covariance would stretch their noise into steps. Ridge, smoothness
/// and denoising follow the spacing of the bands, so that all keep their limit on fine grids. Black is 0 and white is 1. Interior point per vertex, then the exact metamer nearest to its result:
/// |A r - rgb| <= 1e-12, bounds exact. Deterministic for any number of threads.
/// @error usage, for options out of range; infeasible, naming a vertex that has no reflectance in [0,1] and its least
/// violation; input, when no samples lie inside the cube or the numerics fail.
SPECTEX_API Result<LatticeTable> solve_lattice(const Colorimetry& colorimetry, std::span<const SampleSet> sets,
                                               const LatticeOptions& options = {});

/// A uniform lattice as bytes: 'SPXLATT1', the length of a JSON header (32 bits, little-endian), the header with n, bands and
/// colorimetry, then [r][g][b][bands] reflectances as 16-bit little-endian fractions of 65535.
SPECTEX_API std::string encode_lattice(const LatticeTable& table, const Colorimetry& colorimetry);

}  // namespace spectex
