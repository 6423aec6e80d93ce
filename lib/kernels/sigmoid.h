// Reflectances that are sigmoids of quadratics (Jakob and Hanika 2019, eq. 3 and 4): r(t) = S(c0 t^2 + c1 t + c2),
// S(x) = 1/2 + x / (2 sqrt(1 + x^2)), and the search for the coefficients whose integrals are given.
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

/// From |x| = 2^80 on S(x) is exactly 0 or 1: 1 - S(2^80) = 2^-162 is below every float.
inline constexpr double sigmoid_saturation = 0x1p80;

/// S(x), with full relative precision of S below zero and of 1 - S above. S(NaN) = 0.
double sigmoid(double x);

/// out[i][b] = S at t_b. Coefficients beyond 2^100, infinite ones included, count as 2^100; NaN counts as -2^100.
/// @param coefficients  [n][3] c0, c1, c2.
/// @param t             [bands]
/// @param out           [n][bands], each in [0,1].
void evaluate_sigmoids(std::span<const double> coefficients, std::span<const double> t, std::span<double> out);
void evaluate_sigmoids_reference(std::span<const double> coefficients, std::span<const double> t, std::span<double> out);

/// r[b] = S(x) and slope[b] = S'(x) at x = c0 t_b^2 + c1 t_b + c2, for one colour.
void sigmoids_and_slopes(const std::array<double, 3>& c, std::span<const double> t, double* r, double* slope);

/// A band of the equations, in both precisions.
struct SigmoidBand {
    double t;
    std::array<double, 3> a;
    std::array<double, 3> a_times_4{};
    float t_single = 0, t_squared_single = 0;
    std::array<float, 3> a_times_8_single{};
};

/// The three equations sum_b a_i(b) S(x(t_b)) = q_i, and a table of near solutions.
struct SigmoidEquations {
    SigmoidEquations() = default;
    /// @param t  [bands]
    /// @param a  [3][bands]
    SigmoidEquations(std::span<const double> t, std::span<const double> a);

    std::vector<SigmoidBand> bands;
    std::array<double, 3> sum{};  ///< sum_b a_i(b)

    /// The bands of the first step, which need not be exact: neighbours that weigh next to nothing,
    /// at either end of the spectrum, are taken together.
    struct Few {
        float t, t_squared;
        std::array<float, 3> a;
    };
    static constexpr std::size_t most_merged = 4;
    static constexpr double light_enough = 0.0003;  ///< of white's 1
    std::vector<Few> few;

    /// Coefficients times w = sqrt(z) on a grid over (block, w, y, x): the block is the index of the largest component z of
    /// q, x and y are the next two components (cyclically) over z. Four floats a vertex: c0, c1, c2 and padding. With the
    /// factor the table has a limit at black. The grid is even in ratio_position of x and y and in root_position of w.
    std::size_t resolution = 0;
    std::vector<float> table;

    /// Where coefficients bend most, at small ratios and where z nears 1, the grid is finest: of sRGB's codes a fifth as many
    /// need a second pass as with an even grid of 57 vertices on each axis, with 41.
    static constexpr double ratio_shift = 0.01, root_bend = 0.6, root_shift = 0.003;
    static double bent_ratio(double ratio);
    static double bent_root(double w);
    static double ratio_position(double ratio);
    static double ratio_at(double position);  ///< its inverse on [0,1]
    static double root_position(double w);
    static double root_at(double position);
};

/// Steps of Newton's method for the equations of n colours: one in single precision from the table's guess; one with the
/// residual in double and the Jacobian in single; one more with the residual in double and that same Jacobian.
/// @param q           three planes of n; the largest component z of a colour in [1e-5, 1].
/// @param c           three planes of n: the coefficients.
/// @param from_table  false: start from c, with the second step.
/// @param accepted    [n]: whether the residuals before and after the second step foretell that the last left no more than
///                    1e-12 z beside the sums' own rounding, some 1e-15; otherwise c is to be refined again, or is of no use.
void refine_sigmoids(const SigmoidEquations& equations, std::array<const double*, 3> q, std::size_t n,
                     std::array<double*, 3> c, bool from_table, bool* accepted);

}  // namespace spectex::kernels
