// Jakob and Hanika, 'A Low-Dimensional Function Space for Efficient Spectral Upsampling', Computer Graphics Forum 38(2), 2019,
// doi:10.1111/cgf.13626: r(l) = S(c0 l^2 + c1 l + c2) (eq. 3 and 4).
//
// The map from coefficients to colours is one to one onto the interior of the object-colour solid wherever the observer's
// spectral locus is convex, and the primaries of BT.709 lie inside the solid of CIE 1931: every colour but black and white
// has finite coefficients, corners included, and Newton's method finds them. Reflectances come in pairs r and 1 - r, with
// colours p and A1 - p and coefficients c and -c, so only the darker half of the cube is solved. Towards black r tends to
// 1 / (4 x^2), so that c sqrt(z) has a limit.
#include "methods/jakob2019.h"

#include <fmt/format.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <mutex>

#include "methods/near_table.h"
#include "methods/registry.h"
#include "parallel.h"
#include "spectex/coefficient_table.h"

namespace spectex::jakob2019 {
namespace {

/// What is darker is black: its coefficients, of the order of 1000 / sqrt(z), would exceed what counts as saturated. No float
/// is so small.
constexpr double darkest = 1e-50;
/// Below it the kernel's residual, formed by 1/2 + x / (2 sqrt(1 + x^2)), is too coarse beside the colour.
constexpr double darkest_in_kernel = 1e-5;
/// sqrt(z) of the vertices that stand for black: close enough to the limit that the difference, of the order of z, is less
/// than a float resolves.
constexpr double darkest_vertex = 1e-4;
/// Each table is solved from the guesses of the one before it, the first one by one.
constexpr std::array<std::size_t, 3> resolutions{5, 13, 41};
/// As many colours as plans ask for at a time, so that of those refined again, a few in a hundred, enough are together.
constexpr std::size_t block = 1024;

double norm(const Vector3& v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

bool solve3(const Matrix3& m, const Vector3& f, Vector3& x) {
    const double c0 = m(1, 1) * m(2, 2) - m(1, 2) * m(2, 1), c1 = m(1, 2) * m(2, 0) - m(1, 0) * m(2, 2),
                 c2 = m(1, 0) * m(2, 1) - m(1, 1) * m(2, 0);
    const double determinant = m(0, 0) * c0 + m(0, 1) * c1 + m(0, 2) * c2;
    x = {(c0 * f[0] + (m(0, 2) * m(2, 1) - m(0, 1) * m(2, 2)) * f[1] + (m(0, 1) * m(1, 2) - m(0, 2) * m(1, 1)) * f[2]) /
             determinant,
         (c1 * f[0] + (m(0, 0) * m(2, 2) - m(0, 2) * m(2, 0)) * f[1] + (m(0, 2) * m(1, 0) - m(0, 0) * m(1, 2)) * f[2]) /
             determinant,
         (c2 * f[0] + (m(0, 1) * m(2, 0) - m(0, 0) * m(2, 1)) * f[1] + (m(0, 0) * m(1, 1) - m(0, 1) * m(1, 0)) * f[2]) /
             determinant};
    return std::isfinite(x[0]) && std::isfinite(x[1]) && std::isfinite(x[2]);
}

/// Lab over XYZ / white: CIE 15:2018 eq. 8.3..8.6, and the derivative.
double lab_f(double t) { return t > 216.0 / 24389 ? std::cbrt(t) : t * 841 / 108 + 4.0 / 29; }
double lab_slope(double t) { return t > 216.0 / 24389 ? 1 / (3 * std::cbrt(t) * std::cbrt(t)) : 841.0 / 108; }

}  // namespace

Solver::Solver(const Colorimetry& colorimetry, Bare)
    : rgb_to_xyz_(colorimetry.rgb_to_xyz()), white_(colorimetry.white_xyz()) {
    const std::size_t n = colorimetry.bands().size();
    for (const double nm : colorimetry.bands().wavelengths_nm()) nodes_.push_back((nm - origin_nm) / unit_nm);
    equations_ = kernels::SigmoidEquations(nodes_, colorimetry.sensing_matrix());
    equations_.sum = colorimetry.rgb_of(std::vector<double>(n, 1.0));
    // What the integrated white leaves of (1,1,1) is the rounding of the sensing matrix.
    diffuser_is_white_ = true;
    for (const double s : equations_.sum) diffuser_is_white_ = diffuser_is_white_ && std::fabs(s - 1) < 1e-13;
    if (diffuser_is_white_) equations_.sum = {1, 1, 1};
}

Solver::Solver(const Colorimetry& colorimetry) : Solver(colorimetry, Bare{}) {
    for (const std::size_t n : resolutions) tabulate(n);
}

std::shared_ptr<const Solver> Solver::shared(const Colorimetry& colorimetry) {
    struct Kept {
        std::vector<double> key;
        std::shared_ptr<const Solver> solver;
    };
    static std::mutex mutex;
    static std::vector<Kept> recent;  // latest last
    constexpr std::size_t most = 4;
    std::vector<double> key = colorimetry.bands().wavelengths_nm();
    key.insert(key.end(), colorimetry.sensing_matrix().begin(), colorimetry.sensing_matrix().end());

    const std::lock_guard lock(mutex);
    auto found = std::find_if(recent.begin(), recent.end(), [&](const Kept& k) { return k.key == key; });
    if (found != recent.end()) {
        std::rotate(found, found + 1, recent.end());
        return recent.back().solver;
    }
    // Isolated, so that this thread, which holds the lock, takes up no outer task that would wait for it.
    std::shared_ptr<const Solver> made;
    tbb::this_task_arena::isolate([&] { made = std::make_shared<Solver>(colorimetry); });
    if (recent.size() == most) recent.erase(recent.begin());
    recent.push_back({std::move(key), made});
    return made;
}

Solver::Mirrored Solver::mirror(Vector3 p) const {
    for (double& v : p) v = v > 0 ? std::min(v, 1.0) : 0;  // NaN to 0
    Mirrored m;
    m.flipped = std::max({p[0], p[1], p[2]}) + std::min({p[0], p[1], p[2]}) > 1;
    for (std::size_t i = 0; i < 3; ++i) m.q[i] = m.flipped ? equations_.sum[i] - p[i] : p[i];
    m.z = std::max({m.q[0], m.q[1], m.q[2]});
    return m;
}

bool Solver::closed_form(const Mirrored& m, Vector3& c) const {
    if (!(m.z > darkest)) {
        c = {0, 0, -saturated};
        return true;
    }
    if (!diffuser_is_white_ || m.q[0] != m.q[1] || m.q[1] != m.q[2]) return false;
    const double v = m.z;
    c = {0, 0, std::max((v - 0.5) / std::sqrt(v * (1 - v)), -saturated)};
    return true;
}

void Solver::residual(const Vector3& c, Vector3& f, Matrix3& jacobian) const {
    // Values and slopes of many bands at once, by vectors; summed in the bands' order.
    constexpr std::size_t most = 64;
    std::array<double, most> value, slope;
    f = {};
    std::array<double, 9>& j = jacobian.m;
    j = {};
    for (std::size_t begin = 0; begin < nodes_.size(); begin += most) {
        const std::span<const double> nodes = std::span(nodes_).subspan(begin, std::min(most, nodes_.size() - begin));
        kernels::sigmoids_and_slopes(c, nodes, value.data(), slope.data());
        for (std::size_t k = 0; k < nodes.size(); ++k) {
            const auto& band = equations_.bands[begin + k];
            for (std::size_t i = 0; i < 3; ++i) {
                f[i] += band.a[i] * value[k];
                const double w = band.a[i] * slope[k];
                j[3 * i + 2] += w;
                j[3 * i + 1] += w * band.t;
                j[3 * i] += w * band.t * band.t;
            }
        }
    }
}

bool Solver::newton(const Vector3& q, Vector3& c) const {
    constexpr int most_steps = 60, most_halvings = 20;
    const double z = std::max({q[0], q[1], q[2]}), goal = 1e-15 * z, enough = 1e-12 * z;
    Vector3 f, step;
    Matrix3 jacobian;
    residual(c, f, jacobian);
    for (std::size_t i = 0; i < 3; ++i) f[i] -= q[i];
    double error = norm(f);
    for (int k = 0; k < most_steps && !(error <= goal); ++k) {
        if (!solve3(jacobian, f, step)) break;
        bool better = false;
        double share = 1;
        // What a whole step no longer betters is rounding, once it is little enough.
        for (int h = 0; h < (error <= enough ? 1 : most_halvings); ++h, share /= 2) {
            const Vector3 next{c[0] - share * step[0], c[1] - share * step[1], c[2] - share * step[2]};
            Vector3 g;
            Matrix3 next_jacobian;
            residual(next, g, next_jacobian);
            for (std::size_t i = 0; i < 3; ++i) g[i] -= q[i];
            if (norm(g) < error) {
                c = next, f = g, jacobian = next_jacobian, error = norm(g);
                better = true;
                break;
            }
        }
        if (!better) break;
    }
    return error <= enough;
}

/// The last sigmoid on the straight line from grey: the colour q with as little taken off its saturation as sixteenths allow.
Vector3 Solver::towards(const Vector3& q) const {
    const double grey = std::clamp((q[0] + q[1] + q[2]) / 3, darkest, 0.5);
    Vector3 c{0, 0, (grey - 0.5) / std::sqrt(grey * (1 - grey))};
    double reached = 0, step = 1;
    while (reached < 1 && step >= 1.0 / 16) {
        const double goal = std::min(1.0, reached + step);
        Vector3 trial = c;
        if (newton({grey + goal * (q[0] - grey), grey + goal * (q[1] - grey), grey + goal * (q[2] - grey)}, trial))
            c = trial, reached = goal;
        else
            step /= 2;
    }
    return c;
}

/// Levenberg 1944 and Marquardt 1963 on the three components of Lab. @return the squared CIE76 that is left.
double Solver::nearest(const Vector3& rgb, Vector3& c) const {
    const Vector3 target = rgb_to_xyz_ * rgb;
    const auto evaluate = [&](const Vector3& at, Vector3& e, Matrix3& slope) {
        Vector3 colour;
        Matrix3 jacobian;
        residual(at, colour, jacobian);
        const Vector3 xyz = rgb_to_xyz_ * colour;
        const Matrix3 to_xyz = rgb_to_xyz_ * jacobian;
        Vector3 d{};
        Matrix3 s;
        for (std::size_t i = 0; i < 3; ++i) {
            d[i] = lab_f(xyz[i] / white_[i]) - lab_f(target[i] / white_[i]);
            for (std::size_t k = 0; k < 3; ++k) s(i, k) = lab_slope(xyz[i] / white_[i]) / white_[i] * to_xyz(i, k);
        }
        constexpr Matrix3 lab{{0, 116, 0, 500, -500, 0, 0, 200, -200}};
        e = lab * d;
        slope = lab * s;
        return e[0] * e[0] + e[1] * e[1] + e[2] * e[2];
    };
    constexpr int most_steps = 60;
    // The nearest ones are boxes, in the limit; a sigmoid this steep is one, and steeper ones have no slope to follow.
    constexpr double steepest = 1e5;
    Vector3 e;
    Matrix3 slope;
    double error = evaluate(c, e, slope), damping = 1e-3;
    for (int k = 0; k < most_steps && damping < 1e12; ++k) {
        Matrix3 normal;
        Vector3 gradient{};
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t l = 0; l < 3; ++l) {
                normal(i, l) = 0;
                for (std::size_t m = 0; m < 3; ++m) normal(i, l) += slope(m, i) * slope(m, l);
            }
            for (std::size_t m = 0; m < 3; ++m) gradient[i] += slope(m, i) * e[m];
        }
        for (std::size_t i = 0; i < 3; ++i) normal(i, i) *= 1 + damping;
        Vector3 step;
        if (!solve3(normal, gradient, step)) break;
        const Vector3 next{c[0] - step[0], c[1] - step[1], c[2] - step[2]};
        Vector3 next_e;
        Matrix3 next_slope;
        const double next_error = evaluate(next, next_e, next_slope);
        if (next_error < error && std::max({std::fabs(next[0]), std::fabs(next[1]), std::fabs(next[2])}) <= steepest) {
            const bool settled = error - next_error < 1e-10 * error;
            c = next, e = next_e, slope = next_slope, error = next_error;
            damping /= 5;
            if (settled) break;
        } else {
            damping *= 4;
        }
    }
    return error;
}

Vector3 Solver::from_grey(const Vector3& q) const {
    const double z = std::max({q[0], q[1], q[2]});
    // The same colour at a middling z, from grey; then darker by quarters, and from 1e-5 on, where c sqrt(z) has
    // settled, at once.
    double at = std::clamp(z, 0.1, 0.5);
    Vector3 c{0, 0, (at - 0.5) / std::sqrt(at * (1 - at))};
    while (at > z) {
        newton({q[0] / z * at, q[1] / z * at, q[2] / z * at}, c);
        const double next = at < 1e-5 ? z : std::max(at / 4, z);
        for (double& x : c) x *= std::sqrt(at / next);
        at = next;
    }
    return c;
}

bool Solver::newton_or_nearest(const Mirrored& m, const Vector3& start, Vector3& c) const {
    c = start;
    bool reached = newton(m.q, c);
    if (!reached) {
        c = from_grey(m.q);
        reached = newton(m.q, c);
    }
    if (!reached) {
        Vector3 rgb = m.q;
        if (m.flipped)
            for (std::size_t i = 0; i < 3; ++i) rgb[i] = equations_.sum[i] - rgb[i];
        // From the guess, which near such colours may be far off, and from what surely has the hue.
        double least = HUGE_VAL;
        for (Vector3 from : {towards(m.q), start}) {
            if (m.flipped)
                for (double& v : from) v = -v;
            const double left = nearest(rgb, from);
            if (left < least) least = left, c = from;
        }
        if (m.flipped)
            for (double& v : c) v = -v;
    }
    for (double& v : c) v = std::clamp(v, -saturated, saturated);
    return reached;
}

Vector3 Solver::guess(const Vector3& q) const {
    const double z = *std::max_element(q.begin(), q.end()), w = std::sqrt(z);
    const auto cell = near_table::cell_of(q, z, equations_.resolution);
    Vector3 c{};
    for (std::size_t corner = 0; corner < 8; ++corner) {
        const float* vertex = &equations_.table[4 * cell.vertex[corner]];
        for (std::size_t i = 0; i < 3; ++i) c[i] += cell.share[corner] * static_cast<double>(vertex[i]) / w;
    }
    return c;
}

void Solver::tabulate(std::size_t n) {
    const auto last = static_cast<double>(n - 1);
    std::vector<float> table(4 * 3 * n * n * n);
    std::vector<double> ratio, root;
    for (std::size_t k = 0; k < n; ++k) {
        ratio.push_back(kernels::SigmoidEquations::ratio_at(static_cast<double>(k) / last));
        root.push_back(kernels::SigmoidEquations::root_at(static_cast<double>(k) / last));
    }
    parallel_for(std::size_t{0}, 3 * n, [&](std::size_t plane) {
        const std::size_t largest = plane / n, k = plane % n;
        const double w = std::max(root[k], darkest_vertex), z = w * w;
        // Only vertices of cells that hold colours with largest + smallest component <= 1 are looked at.
        const double below = k > 0 ? root[k - 1] : 0;
        std::vector<double> rgb, c;
        std::vector<std::size_t> where;
        Vector3 start{};
        bool have_start = false;
        for (std::size_t y = n; y-- > 0;)
            for (std::size_t x = n; x-- > 0;) {
                const std::size_t least = std::min(x, y);
                const double smallest = below * below * (least > 0 ? ratio[least - 1] : 0);
                if (below * below + smallest > 1) continue;
                const std::size_t vertex = (plane * n + y) * n + x;
                Mirrored m;
                m.z = z;
                m.q[largest] = z;
                m.q[(largest + 1) % 3] = z * ratio[x];
                m.q[(largest + 2) % 3] = z * ratio[y];
                if (m.q[0] >= 1 && m.q[1] >= 1 && m.q[2] >= 1) continue;
                if (equations_.resolution > 0 && z >= darkest_in_kernel) {
                    rgb.insert(rgb.end(), m.q.begin(), m.q.end());
                    where.push_back(vertex);
                    continue;
                }
                Vector3 solution;
                if (!closed_form(m, solution)) {
                    if (equations_.resolution > 0)
                        start = guess(m.q);
                    else if (!have_start)
                        start = {0, 0, (z - 0.5) / std::sqrt(z * (1 - z) + 1e-6)};
                    newton_or_nearest(m, start, solution);
                }
                start = solution;
                have_start = true;
                for (std::size_t i = 0; i < 3; ++i) table[4 * vertex + i] = static_cast<float>(solution[i] * w);
            }
        c.resize(rgb.size());
        solve(rgb, c);
        for (std::size_t i = 0; i < where.size(); ++i)
            for (std::size_t l = 0; l < 3; ++l) table[4 * where[i] + l] = static_cast<float>(c[3 * i + l] * w);
    });
    equations_.resolution = n;
    equations_.table = std::move(table);
}

void Solver::solve(std::span<const double> rgb, std::span<double> out, Counts* counts, std::vector<std::size_t>* unreached) const {
    std::array<double, 3 * block> q, c;
    std::array<bool, block> accepted;
    std::array<std::size_t, block> where;
    std::array<bool, block> flipped;
    Counts tally;
    const auto put = [&](std::size_t i, const Vector3& solution, bool negate) {
        for (std::size_t k = 0; k < 3; ++k) out[3 * i + k] = negate ? -solution[k] : solution[k];
    };
    const auto one_by_one = [&](std::size_t i, const Mirrored& m) {
        Vector3 solution;
        const bool reached = newton_or_nearest(m, guess(m.q), solution);
        ++(reached ? tally.damped : tally.nearest);
        if (!reached && unreached) unreached->push_back(i);
        put(i, solution, m.flipped);
    };
    const std::size_t n = rgb.size() / 3;
    for (std::size_t begin = 0; begin < n; begin += block) {
        std::size_t gathered = 0;
        for (std::size_t i = begin; i < std::min(begin + block, n); ++i) {
            const Mirrored m = mirror({rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]});
            Vector3 solution;
            if (closed_form(m, solution)) {
                ++tally.closed;
                put(i, solution, m.flipped);
            } else if (m.z < darkest_in_kernel) {
                one_by_one(i, m);
            } else {
                for (std::size_t k = 0; k < 3; ++k) q[k * block + gathered] = m.q[k];
                flipped[gathered] = m.flipped;
                where[gathered++] = i;
            }
        }
        // Colours that need more steps are gathered again, so that none pays for its neighbours.
        for (std::size_t pass = 0; pass < tally.passes.size() && gathered > 0; ++pass) {
            kernels::refine_sigmoids(equations_, {&q[0], &q[block], &q[2 * block]}, gathered,
                                     {&c[0], &c[block], &c[2 * block]}, pass == 0, accepted.data());
            std::size_t left = 0;
            for (std::size_t g = 0; g < gathered; ++g) {
                if (accepted[g]) {
                    ++tally.passes[pass];
                    put(where[g], {c[g], c[block + g], c[2 * block + g]}, flipped[g]);
                    continue;
                }
                for (std::size_t k = 0; k < 3; ++k) {
                    q[k * block + left] = q[k * block + g];
                    c[k * block + left] = c[k * block + g];
                }
                flipped[left] = flipped[g];
                where[left++] = where[g];
            }
            gathered = left;
        }
        for (std::size_t g = 0; g < gathered; ++g)
            one_by_one(where[g], mirror({rgb[3 * where[g]], rgb[3 * where[g] + 1], rgb[3 * where[g] + 2]}));
    }
    if (counts) {
        for (std::size_t k = 0; k < tally.passes.size(); ++k) counts->passes[k] += tally.passes[k];
        counts->closed += tally.closed;
        counts->damped += tally.damped;
        counts->nearest += tally.nearest;
    }
}

Solver::Solution Solver::solve_one(const Vector3& rgb) const {
    const Mirrored m = mirror(rgb);
    Solution solution;
    solution.reached = closed_form(m, solution.c);
    if (!solution.reached) {
        Vector3 c;
        solution.reached = newton_or_nearest(m, from_grey(m.q), c);
        solution.c = c;
    }
    if (m.flipped)
        for (double& v : solution.c) v = -v;
    return solution;
}

bool reaches_all_corners(const Colorimetry& colorimetry) {
    const Solver solver(colorimetry, Solver::Bare{});
    if (!solver.diffuser_is_white_) return false;
    for (unsigned corner = 1; corner < 7; ++corner)
        if (!solver.solve_one({corner & 1 ? 1.0 : 0, corner & 2 ? 1.0 : 0, corner & 4 ? 1.0 : 0}).reached) return false;
    return true;
}

}  // namespace spectex::jakob2019

namespace spectex::registry {
namespace {

/// Both variants; what they share is how a spectrum comes from stored coefficients.
class SigmoidModel final : public Model {
public:
    SigmoidModel(const MethodInfo& info, const Colorimetry& colorimetry, bool table)
        : Model(info, colorimetry), from_table_(table) {
        for (const double nm : colorimetry.bands().wavelengths_nm())
            nodes_.push_back((nm - jakob2019::origin_nm) / jakob2019::unit_nm);
    }

    void reflectance(std::span<const double> rgb, std::span<double> out) const override { evaluate(nodes_, rgb, out); }
    bool bands_apart() const override { return true; }
    void reflectance_in(std::span<const std::size_t> bands, std::span<const double> rgb, std::span<double> out) const override {
        evaluate(nodes_of(bands), rgb, out);
    }
    void reflectance_of_coefficients_in(std::span<const std::size_t> bands, std::span<const double> c, std::span<double> out) const override {
        kernels::evaluate_sigmoids(c, nodes_of(bands), out);
    }
    std::vector<std::string> coefficient_names() const override { return {"c0", "c1", "c2"}; }
    void coefficients(std::span<const double> rgb, std::span<double> out) const override {
        // Not before a colour is asked for: stored coefficients need no solver.
        std::call_once(ready_, [&] {
            if (from_table_)
                tbb::this_task_arena::isolate([&] { table_ = *make_coefficient_table(colorimetry()); });
            else
                solver_ = jakob2019::Solver::shared(colorimetry());
        });
        if (!from_table_) {
            solver_->solve(rgb, out);
            return;
        }
        // c0 l^2 + c1 l + c2 with l = origin + unit t.
        constexpr double o = jakob2019::origin_nm, u = jakob2019::unit_nm;
        for (std::size_t i = 0; i + 2 < rgb.size(); i += 3) {
            const Vector3 nm = table_.fetch({rgb[i], rgb[i + 1], rgb[i + 2]});
            out[i] = nm[0] * (u * u);
            out[i + 1] = (2 * o * nm[0] + nm[1]) * u;
            out[i + 2] = (nm[0] * o + nm[1]) * o + nm[2];
        }
    }
    std::vector<std::size_t> unreached(std::span<const double> rgb) const override {
        std::vector<std::size_t> out;
        if (from_table_ || info().exact) return out;
        coefficients({}, {});  // makes the solver
        std::vector<double> c(rgb.size());
        solver_->solve(rgb, c, nullptr, &out);
        std::sort(out.begin(), out.end());
        return out;
    }
    /// Of colours below some 1e-4 the coefficients, of the order of 1000 / sqrt(z), are no halves, and cut off one by one they
    /// are those of any colour. Scaled, they are the darkest of their chromaticity; black may be nearer still.
    void limit_coefficients(std::span<double> coefficients, double most) const override {
        for (std::size_t i = 0; i + 2 < coefficients.size(); i += 3) {
            const Vector3 c{coefficients[i], coefficients[i + 1], coefficients[i + 2]};
            const double largest = std::max({std::fabs(c[0]), std::fabs(c[1]), std::fabs(c[2])});
            // Flat ones may be infinite: they are evaluated to exactly 0 or 1.
            if (largest <= most || (c[0] == 0 && c[1] == 0)) continue;
            const double share = most / largest;
            constexpr double full = jakob2019::saturated;
            const std::array<Vector3, 3> candidates{Vector3{share * c[0], share * c[1], share * c[2]}, {0, 0, -full}, {0, 0, full}};
            const Vector3 wanted = color_of(c);
            double least = HUGE_VAL;
            for (const Vector3& candidate : candidates) {
                const Vector3 got = color_of(candidate);
                const double miss = std::max({std::fabs(got[0] - wanted[0]), std::fabs(got[1] - wanted[1]), std::fabs(got[2] - wanted[2])});
                if (miss < least) least = miss, std::copy(candidate.begin(), candidate.end(), &coefficients[i]);
            }
        }
    }
    void reflectance_of_coefficients(std::span<const double> c, std::span<double> out) const override {
        kernels::evaluate_sigmoids(c, nodes_, out);
    }
    std::string to_json() const override {
        Json json = model_json(*this);
        json["sigmoid"] = {{"origin_nm", jakob2019::origin_nm}, {"unit_nm", jakob2019::unit_nm}};
        return json.dump(-1, ' ', false, Json::error_handler_t::replace);
    }

private:
    Vector3 color_of(const Vector3& c) const {
        std::vector<double> r(nodes_.size());
        kernels::evaluate_sigmoids(c, nodes_, r);
        return colorimetry().rgb_of(r);
    }
    void evaluate(std::span<const double> nodes, std::span<const double> rgb, std::span<double> out) const {
        constexpr std::size_t block = 512;
        std::array<double, 3 * block> c;
        const std::size_t n = rgb.size() / 3, bands = nodes.size();
        for (std::size_t begin = 0; begin < n; begin += block) {
            const std::size_t count = std::min(block, n - begin);
            const std::span<double> some(c.data(), 3 * count);
            coefficients(rgb.subspan(3 * begin, 3 * count), some);
            kernels::evaluate_sigmoids(some, nodes, out.subspan(begin * bands, count * bands));
        }
    }
    std::vector<double> nodes_of(std::span<const std::size_t> bands) const {
        std::vector<double> out;
        for (const std::size_t b : bands) out.push_back(nodes_[b]);
        return out;
    }

    bool from_table_;
    std::vector<double> nodes_;
    mutable std::once_flag ready_;
    mutable std::shared_ptr<const jakob2019::Solver> solver_;
    mutable CoefficientTable table_;
};

ModelResult make_refined(const MethodInfo& info, const Colorimetry& colorimetry) {
    MethodInfo here = info;
    here.exact = jakob2019::reaches_all_corners(colorimetry);
    return std::shared_ptr<const Model>(std::make_shared<SigmoidModel>(here, colorimetry, false));
}
ModelResult make_tabulated(const MethodInfo& info, const Colorimetry& colorimetry) {
    return std::shared_ptr<const Model>(std::make_shared<SigmoidModel>(info, colorimetry, true));
}

template <ModelResult (*make)(const MethodInfo&, const Colorimetry&)>
ModelResult read_sigmoid(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    const auto at = json.find("sigmoid");
    if (at == json.end() || !at->is_object()) return Error{ErrorKind::input, "model: member 'sigmoid': missing"};
    for (const auto& [member, expected] : {std::pair{"origin_nm", jakob2019::origin_nm}, {"unit_nm", jakob2019::unit_nm}}) {
        const auto value = at->find(member);
        if (value == at->end() || !value->is_number() || value->template get<double>() != expected)
            return Error{ErrorKind::input, fmt::format("model: member 'sigmoid.{}': expected {}", member, expected)};
    }
    return make(info, colorimetry);
}

MethodInfo sigmoid_info(std::string id, std::string title, bool exact) {
    MethodInfo info;
    info.id = std::move(id);
    info.title = std::move(title);
    info.source = "Jakob and Hanika 2019, Computer Graphics Forum 38(2), doi:10.1111/cgf.13626";
    info.pieces = Pieces::nonlinear;
    info.exact = exact;
    info.bounded = true;
    info.coefficients = 3;
    return info;
}

}  // namespace

Entry jakob2019() {
    return {sigmoid_info("jakob2019", "Sigmoid of a quadratic, solved per colour", true), make_refined, read_sigmoid<make_refined>};
}
Entry jakob2019_table() {
    return {sigmoid_info("jakob2019:table", "Sigmoid of a quadratic, interpolated in the 64^3 table", false), make_tabulated,
            read_sigmoid<make_tabulated>};
}

}  // namespace spectex::registry
