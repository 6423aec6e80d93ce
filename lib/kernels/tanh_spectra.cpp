#include "kernels/tanh_spectra.h"

#include <algorithm>
#include <cstdint>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/tanh_spectra.cpp"
#include "hwy/foreach_target.h"
#include "hwy/aligned_allocator.h"
#include "hwy/highway.h"

#include "kernels/exp-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {

void RefineTanhSpectra(const TanhEquations& equations, const double* q, std::size_t n, double* state, double* r, bool* accepted) {
    const hn::ScalableTag<double> d;
    const hn::RebindToSigned<decltype(d)> di;
    using V = hn::Vec<decltype(d)>;
    const std::size_t lanes = hn::Lanes(d), bands = equations.a.size(), width = bands + 3;
    const V one = hn::Set(d, 1), two = hn::Set(d, 2), zero = hn::Zero(d);
    // Planes of a vector a band: z and the multipliers, the inverse pivots, and the four right sides, half solved.
    const auto scratch = hwy::AllocateAligned<double>((width + 5 * bands) * lanes);
    double *z = scratch.get(), *inverse = z + width * lanes, *u = inverse + bands * lanes;
    const auto share = [&](V at) HWY_ATTR {
        const V x = hn::Min(hn::Max(hn::Mul(hn::Set(d, -2), at), hn::Set(d, -700)), hn::Set(d, 700));
        return hn::Div(one, hn::Add(one, Exp(d, x)));
    };
    for (std::size_t begin = 0; begin < n; begin += lanes) {
        const std::size_t used = std::min(lanes, n - begin);
        double staged[3][HWY_MAX_BYTES / sizeof(double)];
        for (std::size_t i = 0; i < lanes; ++i) {
            // The last colour fills the vector.
            const std::size_t from = begin + std::min(i, used - 1);
            for (std::size_t k = 0; k < 3; ++k) staged[k][i] = q[3 * from + k];
            for (std::size_t l = 0; l < width; ++l) z[l * lanes + i] = state[from * width + l];
        }
        const V q0 = hn::LoadU(d, staged[0]), q1 = hn::LoadU(d, staged[1]), q2 = hn::LoadU(d, staged[2]);
        const V unit = hn::Div(one, hn::Max(q0, hn::Max(q1, q2)));
        V y0 = hn::Load(d, z + bands * lanes), y1 = hn::Load(d, z + (bands + 1) * lanes), y2 = hn::Load(d, z + (bands + 2) * lanes);
        auto done = hn::Lt(one, zero);
        for (int step = 0; step < most_tanh_steps && !hn::AllTrue(d, done); ++step) {
            // Gradient and Hessian of the Lagrangian sum w (dz)^2 + y . unit (A r - q), right sides -gradient and J^T; the
            // tridiagonal LDL^T, and J H^-1 J^T and J H^-1 (-gradient) from the half-solved right sides, as it goes.
            // The shares first, in a loop of their own, in which those of several bands overlap.
            for (std::size_t l = 0; l < bands; ++l) hn::StoreU(share(hn::Load(d, z + l * lanes)), d, inverse + l * lanes);
            V f0 = hn::Neg(q0), f1 = hn::Neg(q1), f2 = hn::Neg(q2);
            V r0 = zero, r1 = zero, r2 = zero, s00 = zero, s10 = zero, s11 = zero, s20 = zero, s21 = zero, s22 = zero;
            V last_inverse = zero, l0 = zero, l1 = zero, l2 = zero, l3 = zero, at = hn::Load(d, z), rise = zero;
            double below = 0;
            for (std::size_t l = 0; l < bands; ++l) {
                const V a0 = hn::Set(d, equations.a[l][0]), a1 = hn::Set(d, equations.a[l][1]), a2 = hn::Set(d, equations.a[l][2]);
                const V value = hn::Load(d, inverse + l * lanes), first = hn::Mul(two, hn::Mul(value, hn::Sub(one, value)));
                const V second = hn::Mul(hn::Mul(two, first), hn::Sub(one, hn::Mul(two, value)));
                f0 = hn::Add(f0, hn::Mul(a0, value)), f1 = hn::Add(f1, hn::Mul(a1, value)), f2 = hn::Add(f2, hn::Mul(a2, value));
                const V s = hn::Mul(unit, hn::Add(hn::Add(hn::Mul(y0, a0), hn::Mul(y1, a1)), hn::Mul(y2, a2)));
                V gradient = hn::Add(hn::Mul(first, s), rise);
                double own = tanh_regularization - below;
                if (l + 1 < bands) {
                    const double above = 2 * equations.slope[l];
                    const V next = hn::Load(d, z + (l + 1) * lanes);
                    rise = hn::Mul(hn::Set(d, above), hn::Sub(next, at));
                    gradient = hn::Sub(gradient, rise);
                    own += above;
                    at = next;
                }
                const V diagonal = hn::Add(hn::Mul(second, s), hn::Set(d, own));
                const V factor = hn::Mul(hn::Set(d, below), last_inverse);
                last_inverse = hn::Div(one, hn::Sub(diagonal, hn::Mul(factor, hn::Set(d, below))));
                const V scaled = hn::Mul(unit, first);
                l0 = hn::Sub(hn::Neg(gradient), hn::Mul(factor, l0));
                l1 = hn::Sub(hn::Mul(scaled, a0), hn::Mul(factor, l1));
                l2 = hn::Sub(hn::Mul(scaled, a1), hn::Mul(factor, l2));
                l3 = hn::Sub(hn::Mul(scaled, a2), hn::Mul(factor, l3));
                hn::Store(last_inverse, d, inverse + l * lanes);
                hn::Store(l0, d, u + (4 * l) * lanes);
                hn::Store(l1, d, u + (4 * l + 1) * lanes);
                hn::Store(l2, d, u + (4 * l + 2) * lanes);
                hn::Store(l3, d, u + (4 * l + 3) * lanes);
                const V w1 = hn::Mul(l1, last_inverse), w2 = hn::Mul(l2, last_inverse), w3 = hn::Mul(l3, last_inverse);
                r0 = hn::Add(r0, hn::Mul(w1, l0)), r1 = hn::Add(r1, hn::Mul(w2, l0)), r2 = hn::Add(r2, hn::Mul(w3, l0));
                s00 = hn::Add(s00, hn::Mul(w1, l1)), s10 = hn::Add(s10, hn::Mul(w2, l1)), s11 = hn::Add(s11, hn::Mul(w2, l2));
                s20 = hn::Add(s20, hn::Mul(w3, l1)), s21 = hn::Add(s21, hn::Mul(w3, l2)), s22 = hn::Add(s22, hn::Mul(w3, l3));
                below = l + 1 < bands ? -2 * equations.slope[l] : 0;
            }
            const V b0 = hn::Add(r0, hn::Mul(unit, f0)), b1 = hn::Add(r1, hn::Mul(unit, f1)), b2 = hn::Add(r2, hn::Mul(unit, f2));
            const auto minor = [](V a, V b, V c, V e) HWY_ATTR { return hn::Sub(hn::Mul(a, b), hn::Mul(c, e)); };
            const auto dot = [](V a, V b, V c, V e, V g, V h) HWY_ATTR {
                return hn::Add(hn::Add(hn::Mul(a, b), hn::Mul(c, e)), hn::Mul(g, h));
            };
            const V c00 = minor(s11, s22, s21, s21), c10 = minor(s20, s21, s10, s22), c20 = minor(s10, s21, s20, s11);
            const V c11 = minor(s00, s22, s20, s20), c21 = minor(s10, s20, s00, s21), c22 = minor(s00, s11, s10, s10);
            const V over = hn::Div(one, dot(s00, c00, s10, c10, s20, c20));
            const V d0 = hn::Mul(dot(c00, b0, c10, b1, c20, b2), over), d1 = hn::Mul(dot(c10, b0, c11, b1, c21, b2), over),
                    d2 = hn::Mul(dot(c20, b0, c21, b1, c22, b2), over);
            V next = zero, largest = zero;
            auto sound = hn::Not(done);
            for (std::size_t l = bands; l-- > 0;) {
                const V u0 = hn::Load(d, u + (4 * l) * lanes), u1 = hn::Load(d, u + (4 * l + 1) * lanes),
                        u2 = hn::Load(d, u + (4 * l + 2) * lanes), u3 = hn::Load(d, u + (4 * l + 3) * lanes);
                V change = hn::Sub(hn::Sub(hn::Sub(u0, hn::Mul(d0, u1)), hn::Mul(d1, u2)), hn::Mul(d2, u3));
                if (l + 1 < bands) change = hn::Add(change, hn::Mul(hn::Set(d, 2 * equations.slope[l]), next));
                next = hn::Mul(change, hn::Load(d, inverse + l * lanes));
                hn::Store(next, d, u + (4 * l) * lanes);
                sound = hn::And(sound, hn::Le(hn::Abs(next), hn::Set(d, 1e6)));
                largest = hn::Max(largest, hn::Abs(next));
            }
            // r changes e-fold per half unit of z, beyond which the linear model is worth nothing. What is done stays, and so
            // does what has lost its way.
            const V length = hn::IfThenElseZero(sound, hn::Min(one, hn::Div(one, largest)));
            for (std::size_t l = 0; l < bands; ++l)
                hn::StoreU(hn::Add(hn::Load(d, z + l * lanes), hn::IfThenElseZero(sound, hn::Mul(length, hn::Load(d, u + (4 * l) * lanes)))), d,
                           z + l * lanes);
            y0 = hn::Add(y0, hn::IfThenElseZero(sound, hn::Mul(length, d0)));
            y1 = hn::Add(y1, hn::IfThenElseZero(sound, hn::Mul(length, d1)));
            y2 = hn::Add(y2, hn::IfThenElseZero(sound, hn::Mul(length, d2)));
            done = hn::Or(done, hn::And(sound, hn::Le(largest, hn::Set(d, 1e-8))));
        }
        hn::Store(y0, d, z + bands * lanes);
        hn::Store(y1, d, z + (bands + 1) * lanes);
        hn::Store(y2, d, z + (bands + 2) * lanes);
        for (std::size_t l = 0; l < bands; ++l) hn::StoreU(share(hn::Load(d, z + l * lanes)), d, u + l * lanes);
        std::int64_t flags[HWY_MAX_BYTES / sizeof(double)];
        hn::StoreU(hn::IfThenElseZero(hn::RebindMask(di, done), hn::Set(di, 1)), di, flags);
        for (std::size_t i = 0; i < used; ++i) {
            accepted[begin + i] = flags[i] != 0;
            for (std::size_t l = 0; l < width; ++l) state[(begin + i) * width + l] = z[l * lanes + i];
            for (std::size_t l = 0; l < bands; ++l) r[(begin + i) * bands + l] = u[l * lanes + i];
        }
    }
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex::kernels {

HWY_EXPORT(RefineTanhSpectra);

void refine_tanh_spectra(const TanhEquations& equations, const double* q, std::size_t n, double* state, double* r, bool* accepted) {
    HWY_DYNAMIC_DISPATCH(RefineTanhSpectra)(equations, q, n, state, r, accepted);
}

}  // namespace spectex::kernels
#endif
