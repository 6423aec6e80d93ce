#include <algorithm>
#include <cmath>
#include <numbers>

#include "compare/spaces.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compare/delta_planes.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "kernels/simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

/// Runs body(a, b, out) over vectors of whole lanes of coordinates; the rest goes through buffers.
template <class Body>
HWY_INLINE void over_lanes(std::size_t lanes, const double* const* la, const double* const* lb, std::size_t n, float* out,
                           const Body& body) {
    constexpr std::size_t most = HWY_MAX_BYTES / sizeof(float);
    for (std::size_t i = 0; i < n; i += lanes) {
        const double* a[3] = {la[0] + i, la[1] + i, la[2] + i};
        const double* b[3] = {lb[0] + i, lb[1] + i, lb[2] + i};
        if (n - i >= lanes) {
            body(a, b, out + i);
            continue;
        }
        double copy[6][most] = {};
        float rest[most];
        for (int k = 0; k < 3; ++k) {
            std::copy_n(a[k], n - i, copy[k]);
            std::copy_n(b[k], n - i, copy[3 + k]);
            a[k] = copy[k];
            b[k] = copy[3 + k];
        }
        body(a, b, rest);
        std::copy_n(rest, n - i, out + i);
    }
}

/// Runs body(dd, a, b), of three vectors of doubles each, and rounds what it gives to floats. In double and in the order of
/// the formulas for one pair, whose very numbers come out.
template <class Body>
HWY_INLINE void over_doubles(const double* const* la, const double* const* lb, std::size_t n, float* out, const Body& body) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<float, decltype(dd)> df;
    using V = hn::Vec<decltype(dd)>;
    over_lanes(hn::Lanes(dd), la, lb, n, out, [&](const double* const* a, const double* const* b, float* to) HWY_ATTR {
        const V p[3] = {hn::LoadU(dd, a[0]), hn::LoadU(dd, a[1]), hn::LoadU(dd, a[2])};
        const V q[3] = {hn::LoadU(dd, b[0]), hn::LoadU(dd, b[1]), hn::LoadU(dd, b[2])};
        hn::StoreU(kernels::HWY_NAMESPACE::round_to_float(df, body(dd, p, q)), df, to);
    });
}

void DistancePlanes(double unit, const double* const* la, const double* const* lb, std::size_t n, float* out) {
    over_doubles(la, lb, n, out, [unit](auto dd, const auto* p, const auto* q) HWY_ATTR {
        const auto d0 = hn::Sub(p[0], q[0]), d1 = hn::Sub(p[1], q[1]), d2 = hn::Sub(p[2], q[2]);
        return hn::Mul(hn::Set(dd, unit), hn::Sqrt(hn::Add(hn::Add(hn::Mul(d0, d0), hn::Mul(d1, d1)), hn::Mul(d2, d2))));
    });
}

/// What CIE94 and CMC share: differences of lightness, chroma and hue, and the chroma of the first colour.
template <class V>
struct Differences {
    V lightness, chroma, hue, c1;
};
template <class D, class V>
HWY_INLINE Differences<V> DifferencesOf(D dd, const V* p, const V* q) {
    const V a1 = p[1], b1 = p[2], a2 = q[1], b2 = q[2], zero = hn::Zero(dd);
    const V c1 = hn::Sqrt(hn::Add(hn::Mul(a1, a1), hn::Mul(b1, b1))), c2 = hn::Sqrt(hn::Add(hn::Mul(a2, a2), hn::Mul(b2, b2)));
    const V da = hn::Sub(a2, a1), db = hn::Sub(b2, b1), sum = hn::Add(c1, c2);
    const V chroma = hn::Add(hn::Mul(da, hn::Div(hn::Add(a1, a2), sum)), hn::Mul(db, hn::Div(hn::Add(b1, b2), sum)));
    const V dot = hn::Add(hn::Mul(a1, a2), hn::Mul(b1, b2)), product = hn::Mul(c1, c2);
    const auto near = hn::Gt(dot, zero);
    const V root = hn::Sqrt(hn::IfThenElse(near, hn::Add(product, dot), hn::Mul(hn::Set(dd, 2), hn::Sub(product, dot))));
    const V cross = hn::Mul(hn::Set(dd, std::numbers::sqrt2), hn::Sub(hn::Mul(a1, db), hn::Mul(b1, da)));
    return {hn::Sub(q[0], p[0]), hn::IfThenElse(hn::Eq(sum, zero), zero, chroma), hn::IfThenElse(near, hn::Div(cross, root), root), c1};
}
template <class V>
HWY_INLINE V Length(V x, V y, V z) {
    return hn::Sqrt(hn::Add(hn::Add(hn::Mul(x, x), hn::Mul(y, y)), hn::Mul(z, z)));
}

void Delta94Planes(const double* const* la, const double* const* lb, std::size_t n, float* out) {
    over_doubles(la, lb, n, out, [](auto dd, const auto* p, const auto* q) HWY_ATTR {
        const auto d = DifferencesOf(dd, p, q);
        const auto one = hn::Set(dd, 1);
        return Length(d.lightness, hn::Div(d.chroma, hn::Add(one, hn::Mul(hn::Set(dd, 0.045), d.c1))),
                      hn::Div(d.hue, hn::Add(one, hn::Mul(hn::Set(dd, 0.015), d.c1))));
    });
}

// As delta_cmc, but for its angle: cosines of the hue and another angle come from the hue's own cosine and sine, and on which
// side of an angle it lies from the sign of a cross product.
void CmcPlanes(const double* const* la, const double* const* lb, std::size_t n, float* out) {
    constexpr double degree = std::numbers::pi / 180;
    const double cos35 = std::cos(35 * degree), sin35 = std::sin(35 * degree), cos168 = std::cos(168 * degree),
                 sin168 = std::sin(168 * degree), cos164 = std::cos(164 * degree), sin164 = std::sin(164 * degree),
                 cos345 = std::cos(345 * degree), sin345 = std::sin(345 * degree);
    over_doubles(la, lb, n, out, [=](auto dd, const auto* p, const auto* q) HWY_ATTR {
        const auto d = DifferencesOf(dd, p, q);
        const auto set = [&](double v) HWY_ATTR { return hn::Set(dd, v); };
        const auto zero = hn::Zero(dd), one = set(1), l1 = p[0], a1 = p[1], b1 = p[2], c1 = d.c1;
        const auto rotated = [&](double cosine, double sine) HWY_ATTR {
            return hn::Abs(hn::Sub(hn::Mul(a1, set(cosine)), hn::Mul(b1, set(sine))));
        };
        const auto left_of = [&](double cosine, double sine) HWY_ATTR {
            return hn::Gt(hn::Sub(hn::Mul(set(cosine), b1), hn::Mul(set(sine), a1)), zero);
        };
        const auto right_of = [&](double cosine, double sine) HWY_ATTR {
            return hn::Lt(hn::Sub(hn::Mul(set(cosine), b1), hn::Mul(set(sine), a1)), zero);
        };
        const auto warm = hn::And(left_of(cos345, sin345), right_of(cos164, sin164));
        // A neutral has no hue, and f = 0 takes no heed of t.
        const auto inverse = hn::Div(one, hn::IfThenElse(hn::Gt(c1, zero), c1, one));
        const auto t = hn::IfThenElse(warm, hn::Add(set(0.36), hn::Mul(hn::Mul(set(0.4), rotated(cos35, sin35)), inverse)),
                                      hn::Add(set(0.56), hn::Mul(hn::Mul(set(0.2), rotated(cos168, sin168)), inverse)));
        const auto sl = hn::IfThenElse(hn::Lt(l1, set(16)), set(0.511),
                                       hn::Div(hn::Mul(set(0.040975), l1), hn::Add(one, hn::Mul(set(0.01765), l1))));
        const auto sc = hn::Add(hn::Div(hn::Mul(set(0.0638), c1), hn::Add(one, hn::Mul(set(0.0131), c1))), set(0.638));
        const auto squared = hn::Mul(c1, c1);
        const auto f = hn::Sqrt(hn::Div(one, hn::Add(one, hn::Div(set(1900), hn::Mul(squared, squared)))));
        const auto sh = hn::Mul(sc, hn::Sub(hn::Add(hn::Mul(f, t), one), f));
        return Length(hn::Div(d.lightness, hn::Mul(set(2), sl)), hn::Div(d.chroma, sc), hn::Div(d.hue, sh));
    });
}

// Names and equation numbers as in delta_e2000. The differences of the coordinates are taken in double; what weighs them
// needs no more than float. No angle is formed: the bisector of two hues is the direction of the sum of their unit vectors.
void Delta2000Planes(const double* const* la, const double* const* lb, std::size_t n, float* out) {
    const hn::ScalableTag<float> df;
    const hn::Half<decltype(df)> half;
    const hn::Rebind<double, decltype(half)> dd;
    using V = hn::Vec<decltype(df)>;
    const std::size_t lanes = hn::Lanes(df);
    const auto set = [&](double v) HWY_ATTR { return hn::Set(df, static_cast<float>(v)); };
    const auto square = [](V v) HWY_ATTR { return hn::Mul(v, v); };
    const auto seventh = [&](V c) HWY_ATTR {
        const auto c2 = hn::Mul(c, c), c3 = hn::Mul(c2, c), c7 = hn::Mul(hn::Mul(c3, c3), c);
        return hn::Sqrt(hn::Div(c7, hn::Add(c7, set(6103515625.0))));
    };
    const V zero = hn::Zero(df), one = set(1);
    over_lanes(lanes, la, lb, n, out, [&](const double* const* a, const double* const* b, float* to) HWY_ATTR {
        V first[3], second[3], difference[3];
        for (int k = 0; k < 3; ++k) {
            const auto a0 = hn::LoadU(dd, a[k]), a1 = hn::LoadU(dd, a[k] + lanes / 2);
            const auto b0 = hn::LoadU(dd, b[k]), b1 = hn::LoadU(dd, b[k] + lanes / 2);
            const auto narrow = [&](hn::Vec<decltype(dd)> low, hn::Vec<decltype(dd)> high) HWY_ATTR {
#if HWY_TARGET == HWY_SCALAR
                (void)high;
                return kernels::HWY_NAMESPACE::round_to_float(df, low);
#else
                return hn::Combine(df, kernels::HWY_NAMESPACE::round_to_float(half, high),
                                   kernels::HWY_NAMESPACE::round_to_float(half, low));
#endif
            };
            first[k] = narrow(a0, a1);
            second[k] = narrow(b0, b1);
            difference[k] = narrow(hn::Sub(b0, a0), hn::Sub(b1, a1));
        }
        const auto usual = [&](V v) HWY_ATTR { return hn::Le(hn::Abs(v), set(1e4)); };
        auto ordinary = hn::And(usual(first[0]), usual(second[0]));
        for (int k = 1; k < 3; ++k) ordinary = hn::And(ordinary, hn::And(usual(first[k]), usual(second[k])));
        const bool all_ordinary = hn::AllTrue(df, ordinary);
        if (HWY_UNLIKELY(!all_ordinary))
            for (int k = 0; k < 3; ++k) {
                first[k] = hn::IfThenElseZero(ordinary, first[k]);
                second[k] = hn::IfThenElseZero(ordinary, second[k]);
                difference[k] = hn::IfThenElseZero(ordinary, difference[k]);
            }
        const V b1 = first[2], b2 = second[2], db = difference[2];
        const V squares1 = hn::Mul(b1, b1), squares2 = hn::Mul(b2, b2);
        const V chroma1 = hn::Sqrt(hn::Add(square(first[1]), squares1)), chroma2 = hn::Sqrt(hn::Add(square(second[1]), squares2));
        const V mean_c = hn::Mul(hn::Add(chroma1, chroma2), set(0.5));              // eq. 2, 3
        const V stretch = hn::Sub(set(1.5), hn::Mul(set(0.5), seventh(mean_c)));    // 1 + G of eq. 4
        const V a1 = hn::Mul(stretch, first[1]), a2 = hn::Mul(stretch, second[1]);  // eq. 5
        const V da = hn::Mul(stretch, difference[1]);
        const V c1 = hn::Sqrt(hn::Add(square(a1), squares1)), c2 = hn::Sqrt(hn::Add(square(a2), squares2));  // eq. 6
        const V sum_c = hn::Add(c1, c2);
        // Eq. 9 without its cancellation.
        const V squared = hn::Add(hn::Mul(da, hn::Add(a1, a2)), hn::Mul(db, hn::Add(b1, b2)));
        const V dc = hn::Div(squared, hn::IfThenElse(hn::Gt(sum_c, zero), sum_c, one));
        // The cross product from the smaller vector and the difference: exact for near colours, and for very different ones.
        const auto lower = hn::Or(hn::Lt(a1, a2), hn::And(hn::Eq(a1, a2), hn::Lt(b1, b2)));
        const auto nearer = hn::Or(hn::Lt(c1, c2), hn::And(hn::Eq(c1, c2), lower));
        const V cross = hn::Sub(hn::Mul(hn::IfThenElse(nearer, a1, a2), db), hn::Mul(hn::IfThenElse(nearer, b1, b2), da));
        const V dot = hn::Add(hn::Mul(a1, a2), hn::Mul(b1, b2));
        const V product = hn::Mul(c1, c2);
        // Below this dH' is less than 2e-12, and the squares of what follows would leave float's range.
        const auto neutral = hn::Le(product, set(1e-24));
        const V safe = hn::IfThenElse(neutral, one, product);
        const V inverse = hn::Div(one, safe);
        const auto acute = hn::Gt(dot, zero);
        // 1 + |cos| of the angle between the hues, and its part 1 / |sum of the unit vectors| (or of their difference).
        const V q = hn::Add(one, hn::Mul(hn::Abs(dot), inverse));
        const V r = hn::Sqrt(hn::Div(set(0.5), q));
        // The sense of the turn from the first hue to the second; at exactly half a turn it goes from the lesser angle up.
        const auto upper = hn::Or(hn::Gt(b1, zero), hn::And(hn::Eq(b1, zero), hn::Gt(a1, zero)));
        const auto left = hn::Or(hn::Gt(cross, zero), hn::And(hn::Eq(cross, zero), upper));
        const V turn = hn::IfThenElse(left, one, set(-1));
        // Eq. 11: 2 sqrt(C1' C2') sin(dh' / 2).
        const V sine = hn::Mul(r, hn::IfThenElse(acute, hn::Mul(cross, inverse), hn::Mul(turn, q)));
        const V dh = hn::IfThenElseZero(hn::Not(neutral), hn::Mul(hn::Mul(set(2), hn::Sqrt(product)), sine));
        // Eq. 14: the bisector, of the lesser angle.
        const V pa = hn::Mul(a1, c2), qa = hn::Mul(a2, c1), pb = hn::Mul(b1, c2), qb = hn::Mul(b2, c1);
        const V scale = hn::IfThenElseZero(hn::Not(neutral), hn::Mul(inverse, r));
        const V around = hn::Mul(scale, turn);
        const V c = hn::IfThenElse(acute, hn::Mul(hn::Add(pa, qa), scale), hn::Mul(hn::Sub(qb, pb), around));
        const V s = hn::IfThenElse(acute, hn::Mul(hn::Add(pb, qb), scale), hn::Mul(hn::Sub(pa, qa), around));
        // Eq. 15.
        const V cc = hn::Sub(hn::Mul(c, c), hn::Mul(s, s)), ss = hn::Mul(set(2), hn::Mul(s, c));
        const V c3 = hn::Sub(hn::Mul(cc, c), hn::Mul(ss, s)), s3 = hn::Add(hn::Mul(ss, c), hn::Mul(cc, s));
        const V c4 = hn::Sub(hn::Mul(cc, cc), hn::Mul(ss, ss)), s4 = hn::Mul(set(2), hn::Mul(ss, cc));
        V t = hn::Sub(one, hn::Add(hn::Mul(set(0.17 * 0.86602540378443865), c), hn::Mul(set(0.17 * 0.5), s)));
        t = hn::Add(t, hn::Mul(set(0.24), cc));
        t = hn::Add(t, hn::Sub(hn::Mul(set(0.32 * 0.99452189536827333), c3), hn::Mul(set(0.32 * 0.10452846326765347), s3)));
        t = hn::Sub(t, hn::Add(hn::Mul(set(0.20 * 0.45399049973954675), c4), hn::Mul(set(0.20 * 0.89100652418836787), s4)));
        // Eq. 16 and 21: sin(60 degrees * exp(-(phi / 25 degrees)^2)), phi the angle from 275 degrees, as a function of
        // u = 1 - cos(phi). A polynomial (Chebyshev, on [0, 1.4]) gives the exponential's fourth root; the sine of the
        // whole is then within 2e-8, and below 2e-9 beyond.
        const V u = hn::Max(zero, hn::Sub(one, hn::Sub(hn::Mul(set(0.087155742747658174), c), hn::Mul(set(0.99619469809174553), s))));
        V root = set(0.00039404872222803533);
        for (const double k : {-0.005831651855260134, 0.045774273574352264, -0.2369115948677063, 0.8371767997741699, -1.9860570430755615,
                               3.0108635425567627, -2.62624454498291, 1.0})
            root = hn::Add(hn::Mul(root, u), set(k));
        const V x = hn::Mul(set(1.0471975511965977), square(square(root)));
        const V x2 = hn::Mul(x, x);
        V sin_x = set(2.68863773e-06);
        for (const double k : {-1.98349826e-04, 8.33330966e-03, -1.66666664e-01, 1.0}) sin_x = hn::Add(hn::Mul(sin_x, x2), set(k));
        // The angle of the formula is not taken around: from 0 on, a mean hue is 275 degrees away and not 85.
        const auto near_275 = hn::And(hn::Lt(u, set(1.4)), hn::Or(hn::Lt(s, zero), hn::Lt(c, zero)));
        sin_x = hn::IfThenElseZero(near_275, hn::Mul(sin_x, x));
        const V mean_cp = hn::Mul(set(0.5), sum_c);                                              // eq. 13
        const V rt = hn::Mul(hn::Mul(set(-2), seventh(mean_cp)), sin_x);                         // eq. 17, 21
        const V from_50 = square(hn::Sub(hn::Mul(set(0.5), hn::Add(first[0], second[0])), set(50)));
        const V below = hn::Sqrt(hn::Add(set(20), from_50));
        const V sl = hn::Add(below, hn::Mul(set(0.015), from_50));                               // eq. 18, times `below`
        const V sc = hn::Add(one, hn::Mul(set(0.045), mean_cp));                                 // eq. 19
        const V sh = hn::Add(one, hn::Mul(hn::Mul(set(0.015), mean_cp), t));                     // eq. 20
        // One division for all three.
        const V over = hn::Div(one, hn::Mul(hn::Mul(sl, sc), sh));
        const V lightness = hn::Mul(hn::Mul(difference[0], below), hn::Mul(over, hn::Mul(sc, sh)));
        const V chroma = hn::Mul(dc, hn::Mul(over, hn::Mul(sl, sh)));
        const V hue = hn::Mul(dh, hn::Mul(over, hn::Mul(sl, sc)));
        const V sum = hn::Add(hn::Add(square(lightness), square(chroma)), hn::Add(square(hue), hn::Mul(rt, hn::Mul(chroma, hue))));
        hn::StoreU(hn::Sqrt(hn::Max(sum, zero)), df, to);                                        // eq. 22
        if (HWY_UNLIKELY(!all_ordinary))
            for (std::size_t j = 0; j < lanes; ++j) {
                bool inside = true;
                for (int k = 0; k < 3; ++k)
                    inside = inside && std::fabs(static_cast<float>(a[k][j])) <= 1e4f && std::fabs(static_cast<float>(b[k][j])) <= 1e4f;
                if (!inside) to[j] = static_cast<float>(delta_e2000({a[0][j], a[1][j], a[2][j]}, {b[0][j], b[1][j], b[2][j]}));
            }
    });
}

}  // namespace spectex::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex {

HWY_EXPORT(DistancePlanes);
HWY_EXPORT(Delta94Planes);
HWY_EXPORT(CmcPlanes);
HWY_EXPORT(Delta2000Planes);

void distance_planes(double unit, std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, float* out) {
    HWY_DYNAMIC_DISPATCH(DistancePlanes)(unit, a.data(), b.data(), n, out);
}
void delta_e94_planes(std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, float* out) {
    HWY_DYNAMIC_DISPATCH(Delta94Planes)(a.data(), b.data(), n, out);
}
void delta_cmc_planes(std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, float* out) {
    HWY_DYNAMIC_DISPATCH(CmcPlanes)(a.data(), b.data(), n, out);
}

void delta_e2000_planes(std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, float* out) {
    HWY_DYNAMIC_DISPATCH(Delta2000Planes)(a.data(), b.data(), n, out);
}

}  // namespace spectex
#endif  // HWY_ONCE
