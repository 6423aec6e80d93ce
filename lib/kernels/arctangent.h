// Reflectances that are arcs of quadratics (Peters et al. 2019): g(x) = 1/2 + arctan(v0 + v1 x + v2 x^2) / pi, and the search
// for the multipliers whose integrals are given.
//
// Only correctly rounded operations are used (no fused multiply-add, no estimates), each colour is treated alone, and sums
// run in the order of the bands: the bytes written depend neither on how the work is cut into calls nor on the instruction
// set.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

namespace spectex::kernels {

/// out[b] = g at x_b, within 4 units in the last place, towards 0 as well; NaN where P is.
void evaluate_arctangents(const std::array<double, 3>& v, std::span<const double> x, double* out);

/// The three equations sum_b a_i(b) g(x_b) = q_i.
struct ArctangentEquations {
    struct Band {
        double x;
        std::array<double, 3> a;
    };
    std::vector<Band> bands;
};

constexpr int most_arctangent_steps = 8;
/// Newton's method for the equations of n colours, at most `most_arctangent_steps` steps, none shortened.
/// @param q         three planes of n.
/// @param v         three planes of n: starts, and multipliers.
/// @param accepted  [n]: whether the largest residual before the last step was below 1e-9 of the largest component of q; the
///                  step leaves about its square. Otherwise v is of no use.
void refine_arctangents(const ArctangentEquations& equations, std::array<const double*, 3> q, std::size_t n,
                        std::array<double*, 3> v, bool* accepted);

}  // namespace spectex::kernels
