// Convex quadratic programmes, sparse and dense, by an interior point and an active-set polish.
//
//     minimise 1/2 x^T P x + q^T x   subject to   C x = d,   lower <= x <= upper
//
// with P symmetric positive semidefinite (zero for a linear programme), infinite bounds allowed, lower < upper, and rows of
// C that are linearly independent. Two instances share the code: Eigen::SparseMatrix<double>, and Eigen::MatrixXd for
// programmes of about a hundred unknowns and a few rows, for which P plus a diagonal must be positive definite.
#pragma once

#include <Eigen/Dense>
#include <Eigen/SparseCore>

#include "spectex/base.h"

namespace spectex::solvers {

using SparseMatrix = Eigen::SparseMatrix<double>;

template <class Matrix>
struct QuadraticProgramme {
    Matrix P;               ///< [n][n], both triangles
    Eigen::VectorXd q;      ///< [n]
    Matrix C;               ///< [m][n]
    Eigen::VectorXd d;      ///< [m]
    Eigen::VectorXd lower;  ///< [n], may be -infinity
    Eigen::VectorXd upper;  ///< [n], may be +infinity
};

struct QuadraticProgrammeOptions {
    int max_iterations = 200;
    /// Relative accuracy at which the interior point stops; it accepts 1e4 times this when it can get no further.
    double tolerance = 1e-10;
    /// Finish on the optimal active set in long double. Meant for strictly convex programmes: the free part of a linear
    /// programme's solution need not be unique.
    bool polish = true;
};

/// Stationarity reads P x + q = C^T y + z, with z >= 0 where x is at its lower bound, z <= 0 at its upper, else z = 0
/// (complementary to the stated accuracy when not polished).
struct QuadraticProgrammeSolution {
    Eigen::VectorXd x;
    Eigen::VectorXd y;             ///< multipliers of C x = d
    Eigen::VectorXd z;             ///< multipliers of the bounds
    double objective = 0;
    double equality_residual = 0;  ///< largest |C x - d|
    double dual_residual = 0;      ///< largest |P x + q - C^T y - z|
    double duality_gap = 0;        ///< of the interior solution: complementarity over 1 + |objective|
    int iterations = 0;            ///< of the interior point
    int polish_rounds = 0;
};

/// Primal-dual interior point with Mehrotra's predictor and corrector (SIAM J. Optim. 2(4), 1992, doi:10.1137/0802028) from
/// an infeasible start; the Newton system is factored as LDL^T with a small static regularisation that iterative refinement
/// takes out again. The polish solves the equality-constrained programme of the free variables in long double and moves
/// variables between the sets until all bounds and signs hold; variables at a bound then lie exactly on it.
/// @error usage, when shapes do not match, a number is NaN, or lower >= upper; input, when the iteration or the polish does
/// not converge, with the figures reached.
template <class Matrix>
Result<QuadraticProgrammeSolution> solve_quadratic_programme(const QuadraticProgramme<Matrix>& programme,
                                                             const QuadraticProgrammeOptions& options = {});

extern template Result<QuadraticProgrammeSolution> solve_quadratic_programme(const QuadraticProgramme<SparseMatrix>&,
                                                                             const QuadraticProgrammeOptions&);
extern template Result<QuadraticProgrammeSolution> solve_quadratic_programme(const QuadraticProgramme<Eigen::MatrixXd>&,
                                                                             const QuadraticProgrammeOptions&);

}  // namespace spectex::solvers
