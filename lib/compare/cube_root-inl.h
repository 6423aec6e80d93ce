// Cube roots that are the same bytes on every Highway target. Included once per target.
#if defined(SPECTEX_COMPARE_CUBE_ROOT_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPECTEX_COMPARE_CUBE_ROOT_INL_H
#undef SPECTEX_COMPARE_CUBE_ROOT_INL_H
#else
#define SPECTEX_COMPARE_CUBE_ROOT_INL_H
#endif

#include <cstdint>

#include "hwy/highway.h"

#include "kernels/simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// The estimate of the root passes through float, whose range these leave with room.
constexpr double least_rooted = 1e-30, largest_rooted = 1e30;

/// Cube root, within 2^-50, for x in [least_rooted, largest_rooted].
template <class D, class V>
HWY_INLINE V CubeRoot(D dd, V x) {
    const hn::Rebind<float, D> df;
    const hn::Rebind<std::int32_t, D> di;
    // The inverse cube root needs no division. A third of the exponent, with the constant that halves the worst error, 3.5%;
    // the series of (1 - e)^(-1/3) to e^4, in float, leaves 1.5e-6 of it.
    const auto xf = kernels::HWY_NAMESPACE::round_to_float(df, x);
    const auto third = hn::ConvertTo(di, hn::Mul(hn::ConvertTo(df, hn::BitCast(di, xf)), hn::Set(df, 1.0f / 3)));
    const auto guess = hn::BitCast(df, hn::Sub(hn::Set(di, 0x54a20000), third));
    const auto e = hn::Sub(hn::Set(df, 1), hn::Mul(hn::Mul(xf, guess), hn::Mul(guess, guess)));
    auto series = hn::Add(hn::Set(df, 14.0f / 81), hn::Mul(hn::Set(df, 35.0f / 243), e));
    series = hn::Add(hn::Set(df, 2.0f / 9), hn::Mul(series, e));
    series = hn::Add(hn::Set(df, 1.0f / 3), hn::Mul(series, e));
    const auto estimate = hn::Add(guess, hn::Mul(hn::Mul(guess, e), series));
    // The root itself is x r^2, and (1 - w)^(-2/3) with w = 1 - x r^3, below 6e-6, corrects it: w^3 / 2 is below rounding.
    const auto r = hn::PromoteTo(dd, estimate);
    const auto r2 = hn::Mul(r, r);
    const auto w = hn::Sub(hn::Set(dd, 1), hn::Mul(x, hn::Mul(r2, r)));
    const auto root = hn::Mul(x, r2);
    return hn::Add(root, hn::Mul(root, hn::Mul(w, hn::Add(hn::Set(dd, 2.0 / 3), hn::Mul(hn::Set(dd, 5.0 / 9), w)))));
}

}  // namespace spectex::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
