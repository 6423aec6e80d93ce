// Spectra r = 1 / (1 + exp(-2 z)) of least sum of squared differences of z with given integrals (Burns 2020): Newton's method
// on the Karush-Kuhn-Tucker systems of several colours at once, from starts near by.
//
// Only correctly rounded operations are used (no fused multiply-add, no estimates), each colour is treated alone, and sums
// run in the order of the bands: the bytes written depend neither on how the work is cut into calls nor on the instruction
// set.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace spectex::kernels {

struct TanhEquations {
    std::vector<std::array<double, 3>> a;  ///< [bands] of sum_b a_i(b) r_b = q_i
    std::vector<double> slope;             ///< [bands - 1], weight of each squared difference
};

constexpr int most_tanh_steps = 8;
/// What keeps the Hessian definite, whose differences do not see a constant.
constexpr double tanh_regularization = 1e-7;

/// At most `most_tanh_steps` steps each.
/// @param q         [n][3]
/// @param state     [n][bands + 3]: z and the multipliers of the equations over the largest component of q; starts, and what
///                  was found.
/// @param r         [n][bands]
/// @param accepted  [n]: whether the last step changed no z by more than 1e-8, whose square is what it leaves; otherwise state
///                  and r are of no use.
void refine_tanh_spectra(const TanhEquations& equations, const double* q, std::size_t n, double* state, double* r, bool* accepted);

}  // namespace spectex::kernels
