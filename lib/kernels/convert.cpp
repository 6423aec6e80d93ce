#include "kernels/convert.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/convert.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "kernels/simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {

// Strided samples pass through a buffer of this many, a multiple of every vector's lanes.
constexpr std::size_t block_size = 512;
static_assert(block_size >= HWY_MAX_BYTES, "a block holds whole vectors");

void HalfBlocks(const std::uint16_t* src, std::size_t stride, std::size_t n, float* out) {
    const hn::ScalableTag<float> df;
    const hn::Rebind<std::uint16_t, decltype(df)> d16;
    const std::size_t lanes = hn::Lanes(df);
    std::uint16_t in[block_size];
    float last[HWY_MAX_BYTES / sizeof(float)];
    for (std::size_t begin = 0; begin < n; begin += block_size) {
        const std::size_t count = std::min(block_size, n - begin);
        const std::uint16_t* halves = in;
        if (stride == 1 && count == block_size) {
            halves = src + begin;
        } else {
            for (std::size_t i = 0; i < count; ++i) in[i] = src[(begin + i) * stride];
            for (std::size_t i = count; i < block_size && i < count + lanes; ++i) in[i] = 0;
        }
        std::size_t i = 0;
        for (; i + lanes <= count; i += lanes)
            hn::StoreU(widen_half(df, hn::LoadU(d16, halves + i)), df, out + begin + i);
        if (i < count) {
            hn::StoreU(widen_half(df, hn::LoadU(d16, halves + i)), df, last);
            std::memcpy(out + begin + i, last, (count - i) * sizeof(float));
        }
    }
}

std::size_t ToHalf(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride) {
    const hn::ScalableTag<float> df;
    const hn::RebindToSigned<decltype(df)> di;
    const hn::Rebind<std::uint16_t, decltype(df)> d16;
    const std::size_t lanes = hn::Lanes(df);
    const auto magnitude_bits = hn::Set(di, 0x7fffffff);
    const auto last_finite = hn::Set(di, 0x477fefff);  // the float below 65520
    const auto infinity = hn::Set(di, 0x7f800000);
    std::size_t overflows = 0;
    std::uint16_t strided[HWY_MAX_BYTES / sizeof(float)];
    float last[HWY_MAX_BYTES / sizeof(float)] = {};
    for (std::size_t i = 0; i < n; i += lanes) {
        const std::size_t count = std::min(lanes, n - i);
        const float* values = src + i;
        if (count < lanes) {
            std::memcpy(last, values, count * sizeof(float));
            values = last;
        }
        const auto v = hn::LoadU(df, values);
        const auto magnitude = hn::And(hn::BitCast(di, v), magnitude_bits);
        overflows += hn::CountTrue(di, hn::And(hn::Gt(magnitude, last_finite), hn::Lt(magnitude, infinity)));
        const auto half = round_to_half(df, v);
        if (stride == 1 && count == lanes) {
            hn::StoreU(half, d16, out + i);
        } else {
            hn::StoreU(half, d16, strided);
            for (std::size_t k = 0; k < count; ++k) out[(i + k) * stride] = strided[k];
        }
    }
    return overflows;
}

template <class Code>
std::size_t Quantize(const float* src, std::size_t n, Code* out, std::size_t stride) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<float, decltype(dd)> df;
    const hn::Rebind<std::int32_t, decltype(dd)> di;
    const std::size_t lanes = hn::Lanes(dd);
    constexpr double top = static_cast<Code>(-1);
    const auto zero = hn::Zero(dd);
    const auto most = hn::Set(dd, top);
    const auto past = hn::Set(dd, top + 1);
    const auto half = hn::Set(dd, 0.5);
    std::size_t kept = 0;
    std::int32_t codes[HWY_MAX_BYTES / sizeof(double)];
    float last[HWY_MAX_BYTES / sizeof(double)] = {};
    for (std::size_t i = 0; i < n; i += lanes) {
        const std::size_t count = std::min(lanes, n - i);
        const float* values = src + i;
        if (count < lanes) {
            // The padding is zero, which is never counted as lost.
            std::memset(last, 0, sizeof(last));
            std::memcpy(last, values, count * sizeof(float));
            values = last;
        }
        const auto scaled = hn::Add(hn::Mul(hn::PromoteTo(dd, hn::LoadU(df, values)), most), half);
        const auto not_below = hn::Ge(scaled, zero);  // false for NaN
        const auto not_above = hn::Lt(scaled, past);
        kept += hn::CountTrue(dd, hn::And(not_below, not_above));
        const auto clipped = hn::IfThenElseZero(not_below, hn::IfThenElse(not_above, scaled, most));
        hn::StoreU(hn::DemoteTo(di, clipped), di, codes);
        for (std::size_t k = 0; k < count; ++k) out[(i + k) * stride] = static_cast<Code>(codes[k]);
    }
    const std::size_t seen = (n + lanes - 1) / lanes * lanes;
    return seen - kept;
}

std::size_t Quantize8(const float* src, std::size_t n, std::uint8_t* out, std::size_t stride) {
    return Quantize(src, n, out, stride);
}
std::size_t Quantize16(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride) {
    return Quantize(src, n, out, stride);
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex::kernels {

HWY_EXPORT(HalfBlocks);
HWY_EXPORT(ToHalf);
HWY_EXPORT(Quantize8);
HWY_EXPORT(Quantize16);

namespace {

template <class Code>
void decode(const Code* src, std::size_t stride, std::size_t n, const float* table, float* out) {
    // Two loads and a store per sample keep up with memory; vector gathers are no faster. Four at a time are a third faster
    // than one.
    std::size_t i = 0;
    for (; i + 4 <= n; i += 4, src += 4 * stride) {
        const float a = table[src[0]], b = table[src[stride]], c = table[src[2 * stride]], d = table[src[3 * stride]];
        out[i] = a;
        out[i + 1] = b;
        out[i + 2] = c;
        out[i + 3] = d;
    }
    for (; i < n; ++i, src += stride) out[i] = table[*src];
}

float widen(std::uint16_t half) {
    const int exponent = (half >> 10) & 31;
    const int mantissa = half & 0x3ff;
    const double sign = half & 0x8000 ? -1 : 1;
    if (exponent == 31) {
        const std::uint32_t quiet = mantissa ? 0x400000u : 0u;
        return std::bit_cast<float>((half & 0x8000u) << 16 | 0x7f800000u | quiet | static_cast<std::uint32_t>(mantissa) << 13);
    }
    const double value = exponent ? std::ldexp(1024 + mantissa, exponent - 25) : std::ldexp(mantissa, -24);
    return static_cast<float>(sign * value);
}

std::uint16_t narrow(float value) {
    const std::uint32_t bits = std::bit_cast<std::uint32_t>(value);
    const std::uint32_t sign = bits >> 16 & 0x8000u;
    if (std::isnan(value)) return static_cast<std::uint16_t>(sign | 0x7e00u | (bits >> 13 & 0x3ffu));
    const double magnitude = std::fabs(static_cast<double>(value));
    if (magnitude >= 65520) return static_cast<std::uint16_t>(sign | 0x7c00u);
    // The spacing of halves at this magnitude is 2^(e - 10), and never below 2^-24.
    int e = -14;
    if (magnitude >= 0x1p-14) e = std::ilogb(magnitude);
    const double units = std::nearbyint(std::ldexp(magnitude, 10 - e));  // exact, then ties to even
    // Units count from the binade's own zero: 1024 is its first normal number, and 2048 the next binade's.
    const auto code = static_cast<std::uint32_t>(units) + static_cast<std::uint32_t>(e + 14) * 1024u;
    return static_cast<std::uint16_t>(sign | code);
}

template <class Code>
std::size_t quantize_plain(const float* src, std::size_t n, Code* out, std::size_t stride) {
    constexpr double top = static_cast<Code>(-1);
    std::size_t lost = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const double code = std::floor(src[i] * top + 0.5);
        const bool inside = code >= 0 && code <= top;
        lost += !inside;
        out[i * stride] = static_cast<Code>(inside ? code : code > top ? top : 0);
    }
    return lost;
}

}  // namespace

void decode_codes(const std::uint8_t* src, std::size_t stride, std::size_t n, const float* table, float* out) {
    decode(src, stride, n, table, out);
}
void decode_codes(const std::uint16_t* src, std::size_t stride, std::size_t n, const float* table, float* out) {
    decode(src, stride, n, table, out);
}

void half_to_float(const std::uint16_t* src, std::size_t stride, std::size_t n, float* out) {
    HWY_DYNAMIC_DISPATCH(HalfBlocks)(src, stride, n, out);
}
void half_to_float_reference(const std::uint16_t* src, std::size_t stride, std::size_t n, float* out) {
    for (std::size_t i = 0; i < n; ++i) out[i] = widen(src[i * stride]);
}
void gather_floats(const float* src, std::size_t stride, std::size_t n, float* out) {
    if (stride == 1 && n > 0) std::memcpy(out, src, n * sizeof(float));
    else
        for (std::size_t i = 0; i < n; ++i) out[i] = src[i * stride];
}

std::size_t float_to_half(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride) {
    return HWY_DYNAMIC_DISPATCH(ToHalf)(src, n, out, stride);
}
std::size_t float_to_half_reference(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride) {
    std::size_t overflows = 0;
    for (std::size_t i = 0; i < n; ++i) {
        out[i * stride] = narrow(src[i]);
        overflows += std::isfinite(src[i]) && (out[i * stride] & 0x7fff) == 0x7c00;
    }
    return overflows;
}
void scatter_floats(const float* src, std::size_t n, float* out, std::size_t stride) {
    if (stride == 1 && n > 0) std::memcpy(out, src, n * sizeof(float));
    else
        for (std::size_t i = 0; i < n; ++i) out[i * stride] = src[i];
}

std::size_t quantize(const float* src, std::size_t n, std::uint8_t* out, std::size_t stride) {
    return HWY_DYNAMIC_DISPATCH(Quantize8)(src, n, out, stride);
}
std::size_t quantize_reference(const float* src, std::size_t n, std::uint8_t* out, std::size_t stride) {
    return quantize_plain(src, n, out, stride);
}
std::size_t quantize(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride) {
    return HWY_DYNAMIC_DISPATCH(Quantize16)(src, n, out, stride);
}
std::size_t quantize_reference(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride) {
    return quantize_plain(src, n, out, stride);
}

}  // namespace spectex::kernels
#endif  // HWY_ONCE
