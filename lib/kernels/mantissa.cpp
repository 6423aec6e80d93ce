#include "kernels/mantissa.h"

#include <algorithm>
#include <cmath>

#include "kernels/convert.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/mantissa.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "kernels/simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void round_floats(const float* in, std::size_t n, int bits, bool half, float* out) {
    const hn::ScalableTag<float> df;
    const hn::RebindToSigned<decltype(df)> di;
    const std::size_t lanes = hn::Lanes(df);
    const int dropped = float_mantissa_bits - bits;
    const auto exponent = hn::Set(di, 0x7f800000), one = hn::Set(di, 1);
    // Just under half of what is dropped, plus one where the last kept bit is odd; a carry runs into the exponent.
    const auto almost_half = hn::Set(di, dropped > 0 ? (1 << (dropped - 1)) - 1 : 0);
    const auto kept = hn::Set(di, static_cast<int>(~((1u << dropped) - 1u)));
    const auto round = [&](hn::Vec<decltype(df)> v) {
        if (dropped > 0) {
            const auto b = hn::BitCast(di, v);
            // With no bit kept the last one is the leading one, which is not stored.
            const auto odd = bits == 0 ? one : hn::And(hn::ShiftRightSame(b, dropped), one);
            const auto rounded = hn::And(hn::Add(hn::Add(b, almost_half), odd), kept);
            const auto special = hn::Eq(hn::And(b, exponent), exponent);
            v = hn::BitCast(df, hn::IfThenElse(special, b, rounded));
        }
        return half ? widen_half(df, round_to_half(df, v)) : v;
    };
    std::size_t i = 0;
    for (; i + lanes <= n; i += lanes) hn::StoreU(round(hn::LoadU(df, in + i)), df, out + i);
    if (i < n) {
        float tail[HWY_MAX_BYTES / sizeof(float)] = {};
        std::copy_n(in + i, n - i, tail);
        hn::StoreU(round(hn::LoadU(df, tail)), df, tail);
        std::copy_n(tail, n - i, out + i);
    }
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex::kernels {
namespace {
HWY_EXPORT(round_floats);
}

void round_mantissa(const float* in, std::size_t n, int bits, bool half, float* out) {
    HWY_DYNAMIC_DISPATCH(round_floats)(in, n, bits, half, out);
}

void round_mantissa_reference(const float* in, std::size_t n, int bits, bool half, float* out) {
    for (std::size_t i = 0; i < n; ++i) {
        double v = in[i];
        if (std::isfinite(in[i]) && in[i] != 0) {
            // Below 2^-126 floats have a fixed spacing, and so have what is kept of them.
            const int exponent = std::max(std::ilogb(v), -126);
            v = std::scalbn(std::nearbyint(std::scalbn(v, bits - exponent)), exponent - bits);
        }
        out[i] = static_cast<float>(v);
        if (!half) continue;
        std::uint16_t h = 0;
        float_to_half_reference(&out[i], 1, &h, 1);
        half_to_float_reference(&h, 1, 1, &out[i]);
    }
}

}  // namespace spectex::kernels
#endif
