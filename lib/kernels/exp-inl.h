// The exponential, the same bytes on every Highway target. Included once per target.
#if defined(SPECTEX_KERNELS_EXP_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPECTEX_KERNELS_EXP_INL_H
#undef SPECTEX_KERNELS_EXP_INL_H
#else
#define SPECTEX_KERNELS_EXP_INL_H
#endif

#include <numbers>

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// ln 2 in two parts, of which the first times any exponent is exact.
constexpr double ln2_high = 0x1.62e42feep-1, ln2_low = std::numbers::ln2 - ln2_high;

/// e^x for x in [-700, 700].
template <class D, class V>
HWY_INLINE V Exp(D dd, V x) {
    const hn::RebindToSigned<D> di;
    // Adding it rounds to a whole number, which then stands in the lowest bits.
    const V rounder = hn::Set(dd, 0x1.8p52), shifted = hn::Add(hn::Mul(x, hn::Set(dd, std::numbers::log2e)), rounder);
    const V k = hn::Sub(shifted, rounder);
    const V r = hn::Sub(hn::Sub(x, hn::Mul(k, hn::Set(dd, ln2_high))), hn::Mul(k, hn::Set(dd, ln2_low)));
    // Taylor's series: |r| < 0.347, whose 14th power over 14! is 4e-18.
    V series = hn::Set(dd, 1.0 / 6227020800.0);
    for (const double factorial : {479001600.0, 39916800.0, 3628800.0, 362880.0, 40320.0, 5040.0, 720.0, 120.0, 24.0, 6.0, 2.0})
        series = hn::Add(hn::Mul(series, r), hn::Set(dd, 1 / factorial));
    const V y = hn::Add(hn::Set(dd, 1), hn::Add(r, hn::Mul(hn::Mul(r, r), series)));
    return hn::BitCast(dd, hn::Add(hn::BitCast(di, y), hn::ShiftLeft<52>(hn::BitCast(di, shifted))));
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
