#include "solvers/quadratic_programme.h"

#include <fmt/format.h>

#include <Eigen/SparseCholesky>
#include <cmath>
#include <limits>
#include <vector>

namespace spectex::solvers {
namespace {

template <class Scalar>
using Vector = Eigen::Matrix<Scalar, Eigen::Dynamic, 1>;
template <class Scalar>
using Dense = Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic>;
template <class Scalar>
using Sparse = Eigen::SparseMatrix<Scalar>;

/// The symmetric system [P + diag, C^T; C, 0] [u; v] = [a; b], factored with diag + rho and -rho in the lower corner.
template <class Matrix>
class KktSystem;

template <class Scalar>
class KktSystem<Sparse<Scalar>> {
public:
    KktSystem(const Sparse<Scalar>& P, const Sparse<Scalar>& C) : n_(P.rows()) {
        const Eigen::Index m = C.rows();
        std::vector<Eigen::Triplet<Scalar>> entries;
        entries.reserve(static_cast<std::size_t>(P.nonZeros() + C.nonZeros() + n_ + m));
        for (Eigen::Index j = 0; j < n_; ++j) {
            for (typename Sparse<Scalar>::InnerIterator it(P, j); it; ++it)
                if (it.row() >= j) entries.emplace_back(it.row(), j, it.value());
            for (typename Sparse<Scalar>::InnerIterator it(C, j); it; ++it) entries.emplace_back(n_ + it.row(), j, it.value());
            entries.emplace_back(j, j, Scalar(0));
        }
        for (Eigen::Index i = 0; i < m; ++i) entries.emplace_back(n_ + i, n_ + i, Scalar(0));
        lower_.resize(n_ + m, n_ + m);
        lower_.setFromTriplets(entries.begin(), entries.end());
        base_ = Vector<Scalar>(n_ + m);
        for (Eigen::Index j = 0; j < n_ + m; ++j) base_[j] = diagonal(j);
        factor_.analyzePattern(lower_);
    }
    bool factor(const Vector<Scalar>& diag, Scalar rho) {
        for (Eigen::Index j = 0; j < base_.size(); ++j) diagonal(j) = j < n_ ? base_[j] + diag[j] + rho : -rho;
        factor_.factorize(lower_);
        return factor_.info() == Eigen::Success;
    }
    void solve(const Vector<Scalar>& a, const Vector<Scalar>& b, Vector<Scalar>& u, Vector<Scalar>& v) const {
        Vector<Scalar> rhs(a.size() + b.size());
        rhs << a, b;
        const Vector<Scalar> w = factor_.solve(rhs);
        u = w.head(a.size());
        v = w.tail(b.size());
    }

private:
    Scalar& diagonal(Eigen::Index j) {
        // The diagonal comes first in each column of a lower triangle.
        return lower_.valuePtr()[lower_.outerIndexPtr()[j]];
    }
    Eigen::Index n_;
    Sparse<Scalar> lower_;
    Vector<Scalar> base_;
    Eigen::SimplicialLDLT<Sparse<Scalar>, Eigen::Lower> factor_;
};

template <class Scalar>
class KktSystem<Dense<Scalar>> {
public:
    KktSystem(const Dense<Scalar>& P, const Dense<Scalar>& C) : P_(P), C_(C) {}
    bool factor(const Vector<Scalar>& diag, Scalar rho) {
        work_ = P_;
        work_.diagonal() += diag;
        work_.diagonal().array() += rho;
        hessian_.compute(work_);
        if (hessian_.info() != Eigen::Success) return false;
        // Eigen takes references to elements of matrices that have none.
        if (C_.rows() == 0) {
            eliminated_.resize(P_.rows(), 0);
            return true;
        }
        eliminated_ = hessian_.solve(C_.transpose());
        schur_.compute(C_ * eliminated_ + rho * Dense<Scalar>::Identity(C_.rows(), C_.rows()));
        return schur_.info() == Eigen::Success;
    }
    void solve(const Vector<Scalar>& a, const Vector<Scalar>& b, Vector<Scalar>& u, Vector<Scalar>& v) const {
        const Vector<Scalar> t = hessian_.solve(a);
        v = Vector<Scalar>::Zero(b.size());
        if (b.size() > 0) v = schur_.solve(C_ * t - b);
        u = t - eliminated_ * v;
    }

private:
    const Dense<Scalar>& P_;
    const Dense<Scalar>& C_;
    Dense<Scalar> work_, eliminated_;
    Eigen::LLT<Dense<Scalar>> hessian_;
    Eigen::LDLT<Dense<Scalar>> schur_;
};

template <class Derived>
double largest(const Eigen::MatrixBase<Derived>& v) {
    return v.size() == 0 ? 0.0 : static_cast<double>(v.cwiseAbs().maxCoeff());
}

/// Solves the unregularised system by refinement; returns the largest residual left.
template <class Matrix, class Scalar>
double refine(const KktSystem<Matrix>& kkt, const Matrix& P, const Matrix& C, const Vector<Scalar>& diag,
              const Vector<Scalar>& a, const Vector<Scalar>& b, Vector<Scalar>& u, Vector<Scalar>& v, int steps,
              Scalar wanted) {
    kkt.solve(a, b, u, v);
    Vector<Scalar> du, dv;
    double best = std::numeric_limits<double>::infinity();
    Vector<Scalar> best_u = u, best_v = v;
    for (int k = 0;; ++k) {
        const Vector<Scalar> ra = a - P * u - diag.cwiseProduct(u) - C.transpose() * v;
        const Vector<Scalar> rb = b - C * u;
        const double residual = std::max(largest(ra), largest(rb));
        if (!(residual < best)) break;  // refinement stalls once rounding dominates; keep the better iterate
        best = residual;
        best_u = u;
        best_v = v;
        if (best <= static_cast<double>(wanted) || k == steps) break;
        kkt.solve(ra, rb, du, dv);
        u += du;
        v += dv;
    }
    u = best_u;
    v = best_v;
    return best;
}

enum class Place { free, lower, upper };

Sparse<long double> restricted(const Sparse<double>& M, const std::vector<int>& rows, const std::vector<int>& columns,
                               Eigen::Index row_count) {
    std::vector<Eigen::Triplet<long double>> entries;
    for (std::size_t j = 0; j < columns.size(); ++j)
        for (Sparse<double>::InnerIterator it(M, columns[j]); it; ++it)
            if (const int row = rows[static_cast<std::size_t>(it.row())]; row >= 0)
                entries.emplace_back(row, static_cast<int>(j), static_cast<long double>(it.value()));
    Sparse<long double> out(row_count, static_cast<Eigen::Index>(columns.size()));
    out.setFromTriplets(entries.begin(), entries.end());
    return out;
}
Dense<long double> restricted(const Dense<double>& M, const std::vector<int>& rows, const std::vector<int>& columns,
                              Eigen::Index row_count) {
    Dense<long double> out(row_count, static_cast<Eigen::Index>(columns.size()));
    for (std::size_t j = 0; j < columns.size(); ++j)
        for (std::size_t i = 0; i < rows.size(); ++i)
            if (rows[i] >= 0) out(rows[i], static_cast<Eigen::Index>(j)) = M(static_cast<Eigen::Index>(i), columns[j]);
    return out;
}

/// Equality rows that still hold a free variable; the others are satisfied or not by the bounds alone.
std::vector<int> live_rows(const Sparse<double>& C, const std::vector<int>& columns, Eigen::Index& count) {
    std::vector<int> rows(static_cast<std::size_t>(C.rows()), -1);
    for (const int j : columns)
        for (Sparse<double>::InnerIterator it(C, j); it; ++it)
            if (it.value() != 0) rows[static_cast<std::size_t>(it.row())] = 0;
    count = 0;
    for (int& row : rows)
        if (row == 0) row = static_cast<int>(count++);
    return rows;
}
std::vector<int> live_rows(const Dense<double>& C, const std::vector<int>& columns, Eigen::Index& count) {
    std::vector<int> rows(static_cast<std::size_t>(C.rows()), -1);
    count = 0;
    for (Eigen::Index i = 0; i < C.rows(); ++i)
        for (const int j : columns)
            if (C(i, j) != 0) {
                rows[static_cast<std::size_t>(i)] = static_cast<int>(count++);
                break;
            }
    return rows;
}

template <class Matrix>
using Wide = std::conditional_t<std::is_same_v<Matrix, SparseMatrix>, Sparse<long double>, Dense<long double>>;

template <class Matrix>
Status polish(const QuadraticProgramme<Matrix>& p, std::vector<Place> place, const Vector<long double>& y_interior,
              QuadraticProgrammeSolution& s) {
    using V = Vector<long double>;
    const Eigen::Index n = p.q.size();
    const Matrix& P = p.P;
    const Wide<Matrix> Pw = P.template cast<long double>(), Cw = p.C.template cast<long double>();
    const V q = p.q.template cast<long double>(), d = p.d.template cast<long double>();
    V x = s.x.template cast<long double>(), y = y_interior, z = V::Zero(n);
    const long double scale = 1 + static_cast<long double>(largest(p.q)) + static_cast<long double>(largest(s.z));
    // Rounding of long double with a margin for sums over thousands of terms: what a bound or a sign may miss by.
    const long double bound_slip = 1e-15L, sign_slip = 1e-15L * scale;
    constexpr int max_rounds = 100, bulk_rounds = 20;
    for (int round = 1; round <= max_rounds; ++round) {
        s.polish_rounds = round;
        std::vector<int> columns, column_of(static_cast<std::size_t>(n), -1);
        for (Eigen::Index j = 0; j < n; ++j) {
            if (place[static_cast<std::size_t>(j)] == Place::free) {
                column_of[static_cast<std::size_t>(j)] = static_cast<int>(columns.size());
                columns.push_back(static_cast<int>(j));
            } else {
                x[j] = place[static_cast<std::size_t>(j)] == Place::lower ? p.lower[j] : p.upper[j];
            }
        }
        Eigen::Index row_count = 0;
        const std::vector<int> rows = live_rows(p.C, columns, row_count);
        const auto free_count = static_cast<Eigen::Index>(columns.size());
        const Wide<Matrix> Pf = restricted(P, column_of, columns, free_count), Cf = restricted(p.C, rows, columns, row_count);
        for (const int j : columns) x[j] = 0;
        const V gradient = Pw * x + q, missing = d - Cw * x;
        V a(free_count), b(row_count), u, v;
        for (Eigen::Index k = 0; k < free_count; ++k) a[k] = -gradient[columns[static_cast<std::size_t>(k)]];
        for (std::size_t i = 0; i < rows.size(); ++i)
            if (rows[i] >= 0) b[rows[i]] = missing[static_cast<Eigen::Index>(i)];
        KktSystem<Wide<Matrix>> kkt(Pf, Cf);
        const V none = V::Zero(free_count);
        if (!kkt.factor(none, 1e-11L)) return Error{ErrorKind::input, "the polish met a singular active set"};
        refine(kkt, Pf, Cf, none, a, b, u, v, 40, 1e-19L);
        for (Eigen::Index k = 0; k < free_count; ++k) x[columns[static_cast<std::size_t>(k)]] = u[k];
        for (std::size_t i = 0; i < rows.size(); ++i)
            if (rows[i] >= 0) y[static_cast<Eigen::Index>(i)] = -v[rows[i]];
        z = Pw * x + q - Cw.transpose() * y;

        std::vector<std::pair<long double, Eigen::Index>> wrong;
        for (Eigen::Index j = 0; j < n; ++j) {
            const Place at = place[static_cast<std::size_t>(j)];
            const long double slip = at == Place::free    ? std::max(p.lower[j] - x[j], x[j] - p.upper[j]) / bound_slip
                                     : at == Place::lower ? -z[j] / sign_slip
                                                          : z[j] / sign_slip;
            if (!(slip <= 1)) wrong.emplace_back(slip, j);
        }
        if (wrong.empty()) {
            s.equality_residual = largest(Cw * x - d);
            double dual = 0;
            for (Eigen::Index j = 0; j < n; ++j)
                if (place[static_cast<std::size_t>(j)] == Place::free) {
                    dual = std::max(dual, static_cast<double>(std::abs(z[j])));
                    z[j] = 0;
                    x[j] = std::min<long double>(std::max<long double>(x[j], p.lower[j]), p.upper[j]);
                }
            s.dual_residual = dual;
            s.objective = static_cast<double>(0.5L * x.dot(Pw * x) + q.dot(x));
            s.x = x.template cast<double>();
            s.y = y.template cast<double>();
            s.z = z.template cast<double>();
            return {};
        }
        // Bulk exchange converges in a few rounds from the interior point's guess; one at a time cannot cycle as easily.
        if (round > bulk_rounds) wrong = {*std::max_element(wrong.begin(), wrong.end())};
        for (const auto& [slip, j] : wrong) {
            Place& at = place[static_cast<std::size_t>(j)];
            at = at != Place::free ? Place::free : x[j] < p.lower[j] ? Place::lower : Place::upper;
        }
    }
    return Error{ErrorKind::input, fmt::format("the polish found no consistent active set in {} rounds", max_rounds)};
}

}  // namespace

template <class Matrix>
Result<QuadraticProgrammeSolution> solve_quadratic_programme(const QuadraticProgramme<Matrix>& p,
                                                             const QuadraticProgrammeOptions& options) {
    const Eigen::Index n = p.q.size(), m = p.d.size();
    if (n == 0 || p.P.rows() != n || p.P.cols() != n || p.C.rows() != m || p.C.cols() != n || p.lower.size() != n ||
        p.upper.size() != n)
        return Error{ErrorKind::usage, "the matrices and vectors of the quadratic programme do not match in size"};
    if (!p.q.allFinite() || !p.d.allFinite() || !(p.lower.array() < p.upper.array()).all())
        return Error{ErrorKind::usage, "the quadratic programme has a number that is not finite or an empty range"};

    using V = Eigen::VectorXd;
    constexpr double inf = std::numeric_limits<double>::infinity();
    const bool linear = p.P.norm() == 0;
    std::vector<Eigen::Index> low, high;
    V x = V::Zero(n);
    for (Eigen::Index j = 0; j < n; ++j) {
        const bool l = p.lower[j] > -inf, u = p.upper[j] < inf;
        if (l) low.push_back(j);
        if (u) high.push_back(j);
        x[j] = l && u ? 0.5 * (p.lower[j] + p.upper[j]) : l ? p.lower[j] + 1 : u ? p.upper[j] - 1 : 0;
    }
    V y = V::Zero(m), zl = V::Zero(n), zu = V::Zero(n);
    const double start = 1 + largest(p.q);
    for (const auto j : low) zl[j] = start;
    for (const auto j : high) zu[j] = start;
    const double pairs = static_cast<double>(low.size() + high.size());

    KktSystem<Matrix> kkt(p.P, p.C);
    V diag(n), dx, dv, a(n), best_x, best_y, best_zl, best_zu;
    QuadraticProgrammeSolution s;
    double best = inf, primal = inf, dual = inf, gap = inf;
    int stalled = 0;
    for (int k = 0;; ++k) {
        const V gradient = p.P * x + p.q;
        const V rd = gradient - p.C.transpose() * y - zl + zu;
        const V rp = p.d - p.C * x;
        double mu = 0;
        for (const auto j : low) mu += zl[j] * (x[j] - p.lower[j]);
        for (const auto j : high) mu += zu[j] * (p.upper[j] - x[j]);
        const double objective = 0.5 * x.dot(gradient + p.q);
        primal = largest(rp) / (1 + largest(p.d));
        dual = largest(rd) / (1 + largest(p.q));
        gap = mu / (1 + std::abs(objective));
        const double merit = std::max({primal, dual, gap});
        if (!std::isfinite(merit)) break;
        if (merit < best) {
            stalled = merit > 0.9 * best ? stalled + 1 : 0;
            best = merit;
            best_x = x, best_y = y, best_zl = zl, best_zu = zu;
            s.equality_residual = largest(rp);
            s.dual_residual = largest(rd);
            s.duality_gap = gap;
            s.objective = objective;
            s.iterations = k;
        } else {
            ++stalled;
        }
        if (best <= options.tolerance || k == options.max_iterations || stalled > 15) break;
        if (pairs > 0) mu /= pairs;

        diag.setZero();
        for (const auto j : low) diag[j] += zl[j] / (x[j] - p.lower[j]);
        for (const auto j : high) diag[j] += zu[j] / (p.upper[j] - x[j]);
        // Relative to the entries, which are of order one, this is well above rounding and far below any curvature that
        // matters; refinement removes what it changes.
        if (!kkt.factor(diag, 1e-9)) break;

        V cl = V::Zero(n), cu = V::Zero(n);  // right-hand sides of the complementarity equations
        const auto newton = [&](V& dzl, V& dzu) {
            a = -rd;
            for (const auto j : low) a[j] += cl[j] / (x[j] - p.lower[j]);
            for (const auto j : high) a[j] -= cu[j] / (p.upper[j] - x[j]);
            refine(kkt, p.P, p.C, diag, a, rp, dx, dv, 8, 1e-14);
            dzl = dzu = V::Zero(n);
            for (const auto j : low) dzl[j] = (cl[j] - zl[j] * dx[j]) / (x[j] - p.lower[j]);
            for (const auto j : high) dzu[j] = (cu[j] + zu[j] * dx[j]) / (p.upper[j] - x[j]);
        };
        const auto lengths = [&](const V& dzl, const V& dzu) {
            double ap = 1, ad = 1;
            for (const auto j : low) {
                if (dx[j] < 0) ap = std::min(ap, (p.lower[j] - x[j]) / dx[j]);
                if (dzl[j] < 0) ad = std::min(ad, -zl[j] / dzl[j]);
            }
            for (const auto j : high) {
                if (dx[j] > 0) ap = std::min(ap, (p.upper[j] - x[j]) / dx[j]);
                if (dzu[j] < 0) ad = std::min(ad, -zu[j] / dzu[j]);
            }
            return std::pair{ap, ad};
        };

        V dzl, dzu;
        for (const auto j : low) cl[j] = -zl[j] * (x[j] - p.lower[j]);
        for (const auto j : high) cu[j] = -zu[j] * (p.upper[j] - x[j]);
        newton(dzl, dzu);  // predictor
        if (pairs > 0) {
            auto [ap, ad] = lengths(dzl, dzu);
            if (!linear) ap = ad = std::min(ap, ad);
            double mu_affine = 0;
            for (const auto j : low) mu_affine += (zl[j] + ad * dzl[j]) * (x[j] + ap * dx[j] - p.lower[j]);
            for (const auto j : high) mu_affine += (zu[j] + ad * dzu[j]) * (p.upper[j] - x[j] - ap * dx[j]);
            const double sigma = std::pow(mu_affine / pairs / mu, 3);
            for (const auto j : low) cl[j] += sigma * mu - dzl[j] * dx[j];
            for (const auto j : high) cu[j] += sigma * mu + dzu[j] * dx[j];
            newton(dzl, dzu);  // corrector
        }
        auto [ap, ad] = lengths(dzl, dzu);
        if (!linear) ap = ad = std::min(ap, ad);
        const double back_off = std::max(0.9, 1 - mu);
        ap = ap < 1 ? back_off * ap : 1;
        ad = ad < 1 ? back_off * ad : 1;
        if (back_off == 1 && ap < 1) ap *= 1 - 1e-9;
        if (back_off == 1 && ad < 1) ad *= 1 - 1e-9;
        x += ap * dx;
        y -= ad * dv;
        zl += ad * dzl;
        zu += ad * dzu;
    }
    if (!(best <= 1e4 * options.tolerance))
        return Error{ErrorKind::input,
                     fmt::format("the interior point stopped after {} iterations at equality residual {:.2e}, dual residual "
                                 "{:.2e} and duality gap {:.2e}",
                                 s.iterations, s.equality_residual, s.dual_residual, s.duality_gap)};
    s.x = best_x;
    s.y = best_y;
    s.z = best_zl - best_zu;
    if (options.polish) {
        std::vector<Place> place(static_cast<std::size_t>(n), Place::free);
        for (const auto j : low)
            if (best_zl[j] > best_x[j] - p.lower[j]) place[static_cast<std::size_t>(j)] = Place::lower;
        for (const auto j : high)
            if (best_zu[j] > p.upper[j] - best_x[j]) place[static_cast<std::size_t>(j)] = Place::upper;
        if (Status done = polish(p, std::move(place), best_y.template cast<long double>(), s); !done)
            return Error{done.error().kind, fmt::format("{} (interior point: {} iterations, duality gap {:.2e})",
                                                        done.error().message, s.iterations, s.duality_gap)};
    }
    return s;
}

template Result<QuadraticProgrammeSolution> solve_quadratic_programme(const QuadraticProgramme<SparseMatrix>&,
                                                                      const QuadraticProgrammeOptions&);
template Result<QuadraticProgrammeSolution> solve_quadratic_programme(const QuadraticProgramme<Eigen::MatrixXd>&,
                                                                      const QuadraticProgrammeOptions&);

}  // namespace spectex::solvers
