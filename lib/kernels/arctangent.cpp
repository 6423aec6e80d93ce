#include "kernels/arctangent.h"

#include <algorithm>
#include <cstdint>
#include <numbers>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/arctangent.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "kernels/simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {

/// atan2(1, -p) / pi. The angle is that of a right triangle with the sides |p| and 1, from which an eighth of a turn is taken
/// where they are nearly equal: one division, of a quotient up to tan(pi / 8), and a polynomial (Chebyshev) that is within
/// 4e-18 of the arc.
template <class D, class V>
HWY_INLINE V Arc(D d, V p) {
    const V one = hn::Set(d, 1), t = hn::Abs(p);
    constexpr double tan_eighth = std::numbers::sqrt2 - 1;
    const auto flat = hn::Gt(t, hn::Set(d, 1 / tan_eighth)), steep = hn::Lt(t, hn::Set(d, tan_eighth));
    const V above = hn::IfThenElse(flat, one, hn::IfThenElse(steep, hn::Neg(t), hn::Sub(one, t)));
    const V below = hn::IfThenElse(flat, t, hn::IfThenElse(steep, one, hn::Add(one, t)));
    const V s = hn::Div(above, below), z = hn::Mul(s, s);
    V series = hn::Set(d, -0.017805397205419446);
    for (const double k : {0.03796525745386593, -0.05035102456601552, 0.05846878297330872, -0.06662951813629191, 0.07692045330902225,
                           -0.09090896809064027, 0.11111110744919658, -0.14285714279250245, 0.19999999999940893, -0.3333333333333312})
        series = hn::Add(hn::Mul(series, z), hn::Set(d, k));
    const V arc = hn::Add(s, hn::Mul(hn::Mul(s, z), series));
    const V base = hn::IfThenElseZero(hn::Not(flat), hn::IfThenElse(steep, hn::Set(d, std::numbers::pi / 2), hn::Set(d, std::numbers::pi / 4)));
    const V share = hn::Mul(hn::Add(base, arc), hn::Set(d, std::numbers::inv_pi));
    return hn::IfThenElse(hn::Gt(p, hn::Zero(d)), hn::Sub(one, share), share);
}

void EvaluateArcs(const double* v, const double* x, std::size_t bands, double* out) {
    const hn::ScalableTag<double> d;
    const std::size_t lanes = hn::Lanes(d);
    const auto v0 = hn::Set(d, v[0]), v1 = hn::Set(d, v[1]), v2 = hn::Set(d, v[2]);
    double last[HWY_MAX_BYTES / sizeof(double)] = {};
    for (std::size_t b = 0; b < bands; b += lanes) {
        const std::size_t used = std::min(lanes, bands - b);
        if (used < lanes) std::copy_n(x + b, used, last);
        const auto at = hn::LoadU(d, used < lanes ? last : x + b);
        const auto g = Arc(d, hn::Add(hn::Mul(hn::Add(hn::Mul(v2, at), v1), at), v0));
        if (used == lanes) {
            hn::StoreU(g, d, out + b);
        } else {
            hn::StoreU(g, d, last);
            std::copy_n(last, used, out + b);
        }
    }
}

void RefineArcs(const ArctangentEquations& equations, const double* const* q, std::size_t n, double* const* v, bool* accepted) {
    const hn::ScalableTag<double> d;
    const hn::RebindToSigned<decltype(d)> di;
    using V = hn::Vec<decltype(d)>;
    const std::size_t lanes = hn::Lanes(d);
    const V one = hn::Set(d, 1), zero = hn::Zero(d);
    for (std::size_t begin = 0; begin < n; begin += lanes) {
        const std::size_t used = std::min(lanes, n - begin);
        double staged[HWY_MAX_BYTES / sizeof(double)];
        const auto load = [&](const double* from, double filling) HWY_ATTR {
            if (used == lanes) return hn::LoadU(d, from + begin);
            std::fill_n(staged, lanes, filling);
            std::copy_n(from + begin, used, staged);
            return hn::LoadU(d, staged);
        };
        V target[3], m[3];
        // A grey, at its solution, fills the vector.
        for (int k = 0; k < 3; ++k) target[k] = load(q[k], 0.5), m[k] = load(v[k], 0.0);
        const V enough = hn::Mul(hn::Set(d, 1e-9), hn::Max(target[0], hn::Max(target[1], target[2])));
        auto done = hn::Lt(one, zero);
        for (int step = 0; step < most_arctangent_steps && !hn::AllTrue(d, done); ++step) {
            V f0 = hn::Neg(target[0]), f1 = hn::Neg(target[1]), f2 = hn::Neg(target[2]);
            V j00 = zero, j01 = zero, j02 = zero, j10 = zero, j11 = zero, j12 = zero, j20 = zero, j21 = zero, j22 = zero;
            for (const auto& band : equations.bands) {
                const V x = hn::Set(d, band.x), a0 = hn::Set(d, band.a[0]), a1 = hn::Set(d, band.a[1]), a2 = hn::Set(d, band.a[2]);
                const V p = hn::Add(hn::Mul(hn::Add(hn::Mul(m[2], x), m[1]), x), m[0]);
                const V g = Arc(d, p), slope = hn::Div(hn::Set(d, std::numbers::inv_pi), hn::Add(one, hn::Mul(p, p)));
                f0 = hn::Add(f0, hn::Mul(a0, g)), f1 = hn::Add(f1, hn::Mul(a1, g)), f2 = hn::Add(f2, hn::Mul(a2, g));
                const V s1 = hn::Mul(slope, x), s2 = hn::Mul(s1, x);
                j00 = hn::Add(j00, hn::Mul(a0, slope)), j01 = hn::Add(j01, hn::Mul(a0, s1)), j02 = hn::Add(j02, hn::Mul(a0, s2));
                j10 = hn::Add(j10, hn::Mul(a1, slope)), j11 = hn::Add(j11, hn::Mul(a1, s1)), j12 = hn::Add(j12, hn::Mul(a1, s2));
                j20 = hn::Add(j20, hn::Mul(a2, slope)), j21 = hn::Add(j21, hn::Mul(a2, s1)), j22 = hn::Add(j22, hn::Mul(a2, s2));
            }
            const auto minor = [](V a, V b, V c, V e) HWY_ATTR { return hn::Sub(hn::Mul(a, b), hn::Mul(c, e)); };
            const auto dot = [](V a, V b, V c, V e, V g, V h) HWY_ATTR {
                return hn::Add(hn::Add(hn::Mul(a, b), hn::Mul(c, e)), hn::Mul(g, h));
            };
            const V c00 = minor(j11, j22, j12, j21), c01 = minor(j02, j21, j01, j22), c02 = minor(j01, j12, j02, j11);
            const V c10 = minor(j12, j20, j10, j22), c11 = minor(j00, j22, j02, j20), c12 = minor(j02, j10, j00, j12);
            const V c20 = minor(j10, j21, j11, j20), c21 = minor(j01, j20, j00, j21), c22 = minor(j00, j11, j01, j10);
            const V inverse = hn::Div(one, dot(j00, c00, j01, c10, j02, c20));
            const V d0 = hn::Mul(dot(c00, f0, c01, f1, c02, f2), inverse), d1 = hn::Mul(dot(c10, f0, c11, f1, c12, f2), inverse),
                    d2 = hn::Mul(dot(c20, f0, c21, f1, c22, f2), inverse);
            // What is done stays: no colour depends on its neighbours.
            m[0] = hn::IfThenElse(done, m[0], hn::Sub(m[0], d0));
            m[1] = hn::IfThenElse(done, m[1], hn::Sub(m[1], d1));
            m[2] = hn::IfThenElse(done, m[2], hn::Sub(m[2], d2));
            const auto small = [&](V f) HWY_ATTR { return hn::Le(hn::Abs(f), enough); };
            done = hn::Or(done, hn::And(small(f0), hn::And(small(f1), small(f2))));
        }
        const V sum = hn::Add(m[0], hn::Add(m[1], m[2]));
        done = hn::And(done, hn::Le(hn::Abs(sum), hn::Set(d, 0x1p100)));
        std::int64_t flags[HWY_MAX_BYTES / sizeof(double)];
        hn::StoreU(hn::IfThenElseZero(hn::RebindMask(di, done), hn::Set(di, 1)), di, flags);
        for (std::size_t i = 0; i < used; ++i) accepted[begin + i] = flags[i] != 0;
        for (int k = 0; k < 3; ++k) {
            hn::StoreU(m[k], d, staged);
            std::copy_n(staged, used, v[k] + begin);
        }
    }
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex::kernels {

HWY_EXPORT(EvaluateArcs);
HWY_EXPORT(RefineArcs);

void evaluate_arctangents(const std::array<double, 3>& v, std::span<const double> x, double* out) {
    HWY_DYNAMIC_DISPATCH(EvaluateArcs)(v.data(), x.data(), x.size(), out);
}

void refine_arctangents(const ArctangentEquations& equations, std::array<const double*, 3> q, std::size_t n,
                        std::array<double*, 3> v, bool* accepted) {
    HWY_DYNAMIC_DISPATCH(RefineArcs)(equations, q.data(), n, v.data(), accepted);
}

}  // namespace spectex::kernels
#endif
