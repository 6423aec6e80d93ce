// Conversions that give the same bytes on every Highway target. Included once per target.
#if defined(SPECTEX_KERNELS_SIMD_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPECTEX_KERNELS_SIMD_INL_H
#undef SPECTEX_KERNELS_SIMD_INL_H
#else
#define SPECTEX_KERNELS_SIMD_INL_H
#endif

#include <cstdint>

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Highway converts with F16C on these targets, which rounds to nearest even; elsewhere its conversion truncates or depends
// on the target.
#define SPECTEX_KERNELS_F16C (HWY_ARCH_X86 && HWY_TARGET <= HWY_AVX2)

/// Double to float, to nearest; overflow to infinity. (The emulated target's own conversion saturates.)
template <class DF, class VD>
HWY_INLINE hn::Vec<DF> round_to_float(DF df, VD v) {
#if HWY_TARGET == HWY_EMU128 || HWY_TARGET == HWY_SCALAR
    const hn::Rebind<double, DF> dd;
    double wide[HWY_MAX_BYTES / sizeof(double)];
    float narrow[HWY_MAX_BYTES / sizeof(double)] = {};
    hn::StoreU(v, dd, wide);
    for (std::size_t i = 0; i < hn::Lanes(dd); ++i) narrow[i] = static_cast<float>(wide[i]);
    return hn::LoadU(df, narrow);
#else
    return hn::DemoteTo(df, v);
#endif
}

/// Bits of the halves nearest to floats, ties to even.
template <class DF>
HWY_INLINE hn::Vec<hn::Rebind<std::uint16_t, DF>> round_to_half(DF df, hn::Vec<DF> v) {
    const hn::Rebind<std::uint16_t, DF> d16;
#if SPECTEX_KERNELS_F16C
    const hn::Rebind<hwy::float16_t, DF> dh;
    (void)df;
    return hn::BitCast(d16, hn::DemoteTo(dh, v));
#else
    const hn::RebindToSigned<DF> di;
    const auto bits = hn::BitCast(di, v);
    const auto magnitude = hn::And(bits, hn::Set(di, 0x7fffffff));
    const auto sign = hn::And(hn::ShiftRight<16>(bits), hn::Set(di, 0x8000));
    // Rebias the exponent from 127 to 15 and add just under half of the discarded bits, plus one when the kept bits are
    // odd; a carry runs into the exponent, up to infinity.
    const auto odd = hn::And(hn::ShiftRight<13>(magnitude), hn::Set(di, 1));
    const auto normal =
        hn::ShiftRight<13>(hn::Add(hn::Add(magnitude, hn::Set(di, 0xfff - (112 << 23))), odd));
    // Below 2^-14 halves are multiples of 2^-24, the spacing of floats from 0.5 on: let the addition round.
    const auto small = hn::Sub(hn::BitCast(di, hn::Add(hn::BitCast(df, magnitude), hn::Set(df, 0.5f))),
                               hn::Set(di, 0x3f000000));
    const auto nan = hn::Or(hn::Set(di, 0x7e00), hn::And(hn::ShiftRight<13>(magnitude), hn::Set(di, 0x3ff)));
    const auto huge = hn::IfThenElse(hn::Gt(magnitude, hn::Set(di, 0x7f800000)), nan, hn::Set(di, 0x7c00));
    auto half = hn::IfThenElse(hn::Lt(magnitude, hn::Set(di, 0x38800000)), small, normal);
    half = hn::IfThenElse(hn::Gt(magnitude, hn::Set(di, 0x477fffff)), huge, half);
    return hn::DemoteTo(d16, hn::Or(half, sign));
#endif
}

/// Floats of half bits.
template <class DF>
HWY_INLINE hn::Vec<DF> widen_half(DF df, hn::Vec<hn::Rebind<std::uint16_t, DF>> half) {
#if SPECTEX_KERNELS_F16C
    const hn::Rebind<hwy::float16_t, DF> dh;
    return hn::PromoteTo(df, hn::BitCast(dh, half));
#else
    const hn::RebindToSigned<DF> di;
    const auto bits = hn::PromoteTo(di, half);
    const auto magnitude = hn::And(bits, hn::Set(di, 0x7fff));
    const auto sign = hn::ShiftLeft<16>(hn::And(bits, hn::Set(di, 0x8000)));
    const auto normal = hn::Add(hn::ShiftLeft<13>(magnitude), hn::Set(di, 112 << 23));
    const auto small = hn::BitCast(di, hn::Mul(hn::ConvertTo(df, magnitude), hn::Set(df, 0x1p-24f)));
    auto special = hn::Add(normal, hn::Set(di, 112 << 23));
    special = hn::IfThenElse(hn::Gt(magnitude, hn::Set(di, 0x7c00)), hn::Or(special, hn::Set(di, 0x400000)), special);
    auto wide = hn::IfThenElse(hn::Lt(magnitude, hn::Set(di, 0x400)), small, normal);
    wide = hn::IfThenElse(hn::Gt(magnitude, hn::Set(di, 0x7bff)), special, wide);
    return hn::BitCast(df, hn::Or(wide, sign));
#endif
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#endif
