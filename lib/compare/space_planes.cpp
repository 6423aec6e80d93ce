#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "compare/spaces.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compare/space_planes.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "compare/cube_root-inl.h"
#include "kernels/exp-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using kernels::HWY_NAMESPACE::Exp;
using kernels::HWY_NAMESPACE::ln2_high;
using kernels::HWY_NAMESPACE::ln2_low;

/// ln(1 + f) + rest for f in [sqrt(1/2) - 1, sqrt(2) - 1], `rest` small beside it: 2 artanh(f / (2 + f)) with the terms f and
/// f^2 / 2 taken apart, whose rounding would count. The series of artanh, s^2 < 0.0295, to where a double ends.
template <class D, class V>
HWY_INLINE V LogNearOne(D dd, V f, V rest) {
    const V s = hn::Div(f, hn::Add(hn::Set(dd, 2), f)), z = hn::Mul(s, s);
    V series = hn::Set(dd, 2.0 / 21);
    for (const double k : {19.0, 17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0}) series = hn::Add(hn::Mul(series, z), hn::Set(dd, 2 / k));
    series = hn::Mul(series, z);
    const V half_square = hn::Mul(hn::Set(dd, 0.5), hn::Mul(f, f));
    return hn::Sub(f, hn::Sub(half_square, hn::Add(hn::Mul(s, hn::Add(half_square, series)), rest)));
}

/// A positive normal number as (1 + f) 2^exponent, f as LogNearOne takes it.
template <class D, class V>
HWY_INLINE void Split(D dd, V x, V& f, V& exponent) {
    const hn::RebindToSigned<D> di;
    constexpr std::int64_t sqrt_half = 0x3fe6a09e00000000, one = 0x3ff0000000000000;
    const auto bits = hn::Add(hn::BitCast(di, x), hn::Set(di, one - sqrt_half));
    const auto mantissa = hn::And(bits, hn::Set(di, 0x000fffffffffffff));
    f = hn::Sub(hn::BitCast(dd, hn::Add(mantissa, hn::Set(di, sqrt_half))), hn::Set(dd, 1));
    // The biased exponent becomes a number by the bits of 2^52.
    const auto biased = hn::Or(hn::ShiftRight<52>(bits), hn::Set(di, 0x4330000000000000));
    exponent = hn::Sub(hn::BitCast(dd, biased), hn::Set(dd, 0x1p52 + 1023));
}

template <class D, class V>
HWY_INLINE V Log(D dd, V x) {
    V f, exponent;
    Split(dd, x, f, exponent);
    return hn::Add(hn::Mul(exponent, hn::Set(dd, ln2_high)), LogNearOne(dd, f, hn::Mul(exponent, hn::Set(dd, ln2_low))));
}

/// ln(1 + x) for x >= 0.
template <class D, class V>
HWY_INLINE V LogOnePlus(D dd, V x) {
    const V one = hn::Set(dd, 1), u = hn::Add(one, x);
    V f, exponent;
    Split(dd, u, f, exponent);
    // What u has lost of 1 + x.
    const V lost = hn::Div(hn::IfThenElse(hn::Lt(x, one), hn::Sub(x, hn::Sub(u, one)), hn::Sub(one, hn::Sub(u, x))), u);
    const auto small = hn::Lt(x, hn::Set(dd, 0.41));
    f = hn::IfThenElse(small, x, f);
    exponent = hn::IfThenElseZero(hn::Not(small), exponent);
    const V rest = hn::IfThenElseZero(hn::Not(small), hn::Add(hn::Mul(exponent, hn::Set(dd, ln2_low)), lost));
    return hn::Add(hn::Mul(exponent, hn::Set(dd, ln2_high)), LogNearOne(dd, f, rest));
}

/// Runs body(v), of three vectors of doubles that it replaces, over planes; the rest goes through buffers.
template <class In, class Body>
HWY_INLINE void over_planes(const In* const* in, std::size_t n, double* const* out, const Body& body) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<In, decltype(dd)> di;
    constexpr std::size_t most = HWY_MAX_BYTES / sizeof(double);
    const std::size_t lanes = hn::Lanes(dd);
    for (std::size_t i = 0; i < n; i += lanes) {
        const bool whole = n - i >= lanes;
        In from[3][most] = {};
        double to[3][most];
        hn::Vec<decltype(dd)> v[3];
        for (int k = 0; k < 3; ++k) {
            if (!whole) std::copy_n(in[k] + i, n - i, from[k]);
            const auto loaded = hn::LoadU(di, whole ? in[k] + i : from[k]);
            if constexpr (sizeof(In) == sizeof(double)) v[k] = loaded;
            else v[k] = hn::PromoteTo(dd, loaded);
        }
        body(dd, v);
        for (int k = 0; k < 3; ++k) {
            hn::StoreU(v[k], dd, whole ? out[k] + i : to[k]);
            if (!whole) std::copy_n(to[k], n - i, out[k] + i);
        }
    }
}

template <class D, class V>
HWY_INLINE void Multiply(D dd, const Matrix3& m, V* v) {
    V product[3];
    for (std::size_t row = 0; row < 3; ++row)
        product[row] = hn::Add(hn::Add(hn::Mul(hn::Set(dd, m(row, 0)), v[0]), hn::Mul(hn::Set(dd, m(row, 1)), v[1])),
                               hn::Mul(hn::Set(dd, m(row, 2)), v[2]));
    for (int k = 0; k < 3; ++k) v[k] = product[k];
}

template <class D, class V>
HWY_INLINE hn::Mask<D> IsFinite(D dd, V v) {
    return hn::Le(hn::Abs(v), hn::Set(dd, 0x1.fffffffffffffp1023));
}

void Din99Planes(double* const* lab, std::size_t n) {
    constexpr double degree = std::numbers::pi / 180;
    const double cos16 = std::cos(16 * degree), sin16 = std::sin(16 * degree);
    over_planes(lab, n, lab, [=](auto dd, auto* v) HWY_ATTR {
        const auto set = [&](double x) HWY_ATTR { return hn::Set(dd, x); };
        const auto zero = hn::Zero(dd), l = v[0], a = v[1], b = v[2];
        const auto e = hn::Add(hn::Mul(a, set(cos16)), hn::Mul(b, set(sin16)));
        const auto f = hn::Mul(set(0.7), hn::Sub(hn::Mul(b, set(cos16)), hn::Mul(a, set(sin16))));
        const auto g = hn::Mul(set(0.045), hn::Sqrt(hn::Add(hn::Mul(e, e), hn::Mul(f, f))));
        const auto finite = hn::And(IsFinite(dd, g), IsFinite(dd, l));
        const auto safe_g = hn::IfThenElseZero(finite, g), x = hn::IfThenElseZero(finite, hn::Mul(set(0.0158), l));
        const auto neutral = hn::Eq(safe_g, zero), dark = hn::Lt(x, zero);
        const auto k = hn::IfThenElse(neutral, set(1), hn::Div(LogOnePlus(dd, safe_g), hn::IfThenElse(neutral, set(1), safe_g)));
        const auto lightness = hn::IfThenElse(dark, hn::Mul(set(105.51 * 0.0158), l),
                                              hn::Mul(set(105.51), LogOnePlus(dd, hn::IfThenElseZero(hn::Not(dark), x))));
        // Infinite or no numbers: none of the coordinates is one.
        const auto nothing = hn::Add(hn::Sub(g, g), hn::Sub(l, l));
        v[0] = hn::IfThenElse(finite, lightness, nothing);
        v[1] = hn::IfThenElse(finite, hn::Mul(k, e), nothing);
        v[2] = hn::IfThenElse(finite, hn::Mul(k, f), nothing);
    });
}

void ItpPlanes(const Matrix3& to_xyz, const Matrix3& to_lms, double at_zero, const float* const* rgb, std::size_t n, double* const* out) {
    constexpr double m1 = 2610.0 / 16384, m2 = 2523.0 / 4096 * 128, c1 = 3424.0 / 4096, c3 = 2392.0 / 4096 * 32;
    const hn::ScalableTag<double> dd;
    const std::size_t lanes = hn::Lanes(dd);
    const auto set = [&](double x) HWY_ATTR { return hn::Set(dd, x); };
    const auto one = set(1);
    // In stages over a block: a loop whose body is one logarithm or one power lets those of several vectors overlap.
    constexpr std::size_t block = 64;
    static_assert(block % (HWY_MAX_BYTES / sizeof(double)) == 0, "a block holds whole vectors");
    HWY_ALIGN double light[3][block], t[3][block];
    for (std::size_t begin = 0; begin < n; begin += block) {
        const std::size_t count = std::min(block, n - begin);
        const float* from[3] = {rgb[0] + begin, rgb[1] + begin, rgb[2] + begin};
        double* lms[3] = {light[0], light[1], light[2]};
        over_planes(from, count, lms, [&](auto, auto* v) HWY_ATTR {
            Multiply(dd, to_xyz, v);
            Multiply(dd, to_lms, v);
        });
        const auto stage = [&](const double (&of)[3][block], const auto& body) HWY_ATTR {
            for (int k = 0; k < 3; ++k)
                for (std::size_t i = 0; i < count; i += lanes) hn::Store(body(hn::Load(dd, of[k] + i)), dd, t[k] + i);
        };
        for (auto& plane : light) std::fill(plane + count, plane + std::min(block, (count + lanes - 1) / lanes * lanes), 0.0);
        // pq_encode. So near to 0 the power has no digit left beside 1, as of the least; infinities and no numbers come last.
        stage(light, [&](auto v) HWY_ATTR {
            const auto magnitude = hn::IfThenElse(IsFinite(dd, v), hn::Abs(v), one);
            return Log(dd, hn::Max(hn::Div(magnitude, set(10000)), set(1e-290)));
        });
        stage(t, [&](auto log) HWY_ATTR { return Exp(dd, hn::Mul(set(m1), log)); });
        stage(t, [&](auto y) HWY_ATTR {
            const auto f = hn::Div(hn::Mul(set(1 - c1), hn::Sub(y, one)), hn::Add(one, hn::Mul(set(c3), y)));
            return LogNearOne(dd, f, hn::Zero(dd));
        });
        stage(t, [&](auto log) HWY_ATTR { return Exp(dd, hn::Mul(set(m2), log)); });
        const double* code[3] = {t[0], t[1], t[2]};
        double* to[3] = {out[0] + begin, out[1] + begin, out[2] + begin};
        std::size_t at = 0;
        over_planes(code, count, to, [&](auto, auto* v) HWY_ATTR {
            for (int k = 0; k < 3; ++k) {
                const auto of = hn::Load(dd, light[k] + at);
                const auto mirrored = hn::IfThenElse(hn::Lt(of, hn::Zero(dd)), hn::Sub(set(2 * at_zero), v[k]), v[k]);
                v[k] = hn::IfThenElse(IsFinite(dd, of), mirrored, hn::Sub(of, of));
            }
            at += lanes;
            const auto l = v[0], m = v[1], s = v[2];
            v[0] = hn::Mul(hn::Add(l, m), set(0.5));
            v[1] = hn::Mul(hn::Add(hn::Sub(hn::Mul(set(6610), l), hn::Mul(set(13613), m)), hn::Mul(set(7003), s)), set(0.5 / 4096));
            v[2] = hn::Mul(hn::Sub(hn::Sub(hn::Mul(set(17933), l), hn::Mul(set(17390), m)), hn::Mul(set(543), s)), set(1.0 / 4096));
        });
    }
}

void OklabPlanes(const Matrix3& to_xyz, const Matrix3& to_lms, const Matrix3& to_lab, const float* const* rgb, std::size_t n,
                 double* const* out) {
    over_planes(rgb, n, out, [&](auto dd, auto* v) HWY_ATTR {
        Multiply(dd, to_xyz, v);
        Multiply(dd, to_lms, v);
        for (int k = 0; k < 3; ++k) {
            const auto magnitude = hn::Abs(v[k]);
            const auto rooted = hn::And(hn::Ge(magnitude, hn::Set(dd, least_rooted)), hn::Le(magnitude, hn::Set(dd, largest_rooted)));
            const auto root = hn::CopySign(CubeRoot(dd, hn::IfThenElse(rooted, magnitude, hn::Set(dd, 1))), v[k]);
            const auto found = hn::IfThenElseZero(rooted, root);
            if (HWY_UNLIKELY(!hn::AllTrue(dd, hn::Or(rooted, hn::Eq(magnitude, hn::Zero(dd)))))) {
                // What is next to 0, beyond the estimate's range, infinite or no number.
                double x[HWY_MAX_BYTES / sizeof(double)], y[HWY_MAX_BYTES / sizeof(double)];
                hn::StoreU(v[k], dd, x);
                hn::StoreU(found, dd, y);
                for (std::size_t i = 0; i < hn::Lanes(dd); ++i)
                    if (!(std::fabs(x[i]) >= least_rooted && std::fabs(x[i]) <= largest_rooted)) y[i] = std::cbrt(x[i]);
                v[k] = hn::LoadU(dd, y);
                continue;
            }
            v[k] = found;
        }
        Multiply(dd, to_lab, v);
    });
}

}  // namespace spectex::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex {

HWY_EXPORT(Din99Planes);
HWY_EXPORT(ItpPlanes);
HWY_EXPORT(OklabPlanes);

void din99_planes(std::array<double*, 3> lab, std::size_t n) { HWY_DYNAMIC_DISPATCH(Din99Planes)(lab.data(), n); }
void space_planes(const ItpSpace& space, const Matrix3& to_xyz, std::array<const float*, 3> rgb, std::size_t n, std::array<double*, 3> out) {
    HWY_DYNAMIC_DISPATCH(ItpPlanes)(to_xyz, space.xyz_to_lms, pq_encode(0), rgb.data(), n, out.data());
}
void space_planes(const OklabSpace& space, const Matrix3& to_xyz, std::array<const float*, 3> rgb, std::size_t n, std::array<double*, 3> out) {
    HWY_DYNAMIC_DISPATCH(OklabPlanes)(to_xyz, space.xyz_to_lms, OklabSpace::lms_to_lab, rgb.data(), n, out.data());
}

}  // namespace spectex
#endif  // HWY_ONCE
