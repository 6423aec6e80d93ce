#include "kernels/spectra.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "kernels/convert.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/spectra.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "kernels/simd-inl.h"

#ifndef SPECTEX_KERNELS_SPECTRA_CONSTANTS
#define SPECTEX_KERNELS_SPECTRA_CONSTANTS
namespace spectex::kernels {
/// A squared error in a component matters as 1 / (component + this). Found on all 16.7M sRGB codes: without the term a dark
/// component beside bright ones loses its 8-bit code on grids of few bands; below 0.06 the bright ones pay for it.
constexpr float dark_offset = 0.2f;
/// Pixels that lose no more than this by plain rounding (a CIE76 of 0.03 at the most) keep it: what cancels errors is noise in the
/// last bits, and noise does not compress.
constexpr float tolerated = 1.6e-8f;
/// Weights whose squared length is below this cancel nothing that a float could tell.
constexpr float least_length = 1e-24f;
}  // namespace spectex::kernels
#endif

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

void round_spectra(const float* const* in, std::size_t n, std::uint16_t* const* out, const std::size_t* order, std::size_t bands,
                   const float* weights) {
    const hn::ScalableTag<float> df;
    const hn::Rebind<std::uint16_t, decltype(df)> d16;
    const std::size_t lanes = hn::Lanes(df);
    const auto unit = hn::Set(df, 0x1p-10f), zero = hn::Zero(df), one = hn::Set(df, 1.0f);
    const auto dark = hn::Set(df, dark_offset), least = hn::Set(df, least_length);
    float tail_in[HWY_MAX_BYTES / sizeof(float)] = {};
    std::uint16_t tail_out[HWY_MAX_BYTES / sizeof(float)] = {};
    const auto plain_enough = hn::Set(df, tolerated);
    for (std::size_t i = 0; i < n; i += lanes) {
        const std::size_t count = std::min(lanes, n - i);
        const auto load = [&](std::size_t k) {
            const float* plane = in[order[k]] + i;
            if (count < lanes) {
                std::copy_n(plane, count, tail_in);
                plane = tail_in;
            }
            return hn::LoadU(df, plane);
        };
        const auto store = [&](std::size_t k, hn::Vec<decltype(d16)> half) {
            if (count == lanes) {
                hn::StoreU(half, d16, out[order[k]] + i);
            } else {
                hn::StoreU(half, d16, tail_out);
                std::copy_n(tail_out, count, out[order[k]] + i);
            }
        };
        // To nearest first, with the integrals and what they lose.
        auto s0 = zero, s1 = zero, s2 = zero, l0 = zero, l1 = zero, l2 = zero;
        for (std::size_t k = 0; k < bands; ++k) {
            const auto r = load(k);
            const float* w = weights + 3 * k;
            const auto half = round_to_half(df, r);
            const auto left = hn::Sub(r, widen_half(df, half));
            store(k, half);
            s0 = hn::Add(s0, hn::Mul(hn::Set(df, w[0]), r));
            s1 = hn::Add(s1, hn::Mul(hn::Set(df, w[1]), r));
            s2 = hn::Add(s2, hn::Mul(hn::Set(df, w[2]), r));
            l0 = hn::Add(l0, hn::Mul(hn::Set(df, w[0]), left));
            l1 = hn::Add(l1, hn::Mul(hn::Set(df, w[1]), left));
            l2 = hn::Add(l2, hn::Mul(hn::Set(df, w[2]), left));
        }
        const auto importance = [&](hn::Vec<decltype(df)> s) { return hn::Div(one, hn::Add(hn::Abs(s), dark)); };
        const auto g0 = importance(s0), g1 = importance(s1), g2 = importance(s2);
        const auto loss = hn::Add(hn::Add(hn::Mul(hn::Mul(l0, l0), g0), hn::Mul(hn::Mul(l1, l1), g1)), hn::Mul(hn::Mul(l2, l2), g2));
        const auto redo = hn::Gt(loss, plain_enough);
        if (hn::AllFalse(df, redo)) continue;
        const auto redo_bits = hn::VecFromMask(df, redo);
        auto e0 = zero, e1 = zero, e2 = zero;
        for (std::size_t k = 0; k < bands; ++k) {
            const auto r = load(k);
            const float* w = weights + 3 * k;
            const auto p0 = hn::Mul(hn::Set(df, w[0]), g0), p1 = hn::Mul(hn::Set(df, w[1]), g1), p2 = hn::Mul(hn::Set(df, w[2]), g2);
            const auto length = hn::Add(hn::Add(hn::Mul(p0, hn::Set(df, w[0])), hn::Mul(p1, hn::Set(df, w[1]))),
                                        hn::Mul(p2, hn::Set(df, w[2])));
            auto wanted = hn::Div(hn::Add(hn::Add(hn::Mul(p0, e0), hn::Mul(p1, e1)), hn::Mul(p2, e2)), hn::Max(length, least));
            // One unit in the last place of a half is between 2^-11 and 2^-10 of the value.
            const auto ulp = hn::Mul(hn::Abs(r), unit);
            // Pixels that were good enough stay as they were rounded: nothing is wanted of them.
            wanted = hn::And(hn::Min(hn::Max(wanted, hn::Neg(ulp)), ulp), redo_bits);
            auto target = hn::Add(r, wanted);
            // What was a reflectance stays one.
            target = hn::IfThenElse(hn::Le(r, one), hn::Min(target, one), target);
            target = hn::IfThenElse(hn::Ge(r, zero), hn::Max(target, zero), target);
            const auto half = round_to_half(df, target);
            const auto left = hn::Sub(r, widen_half(df, half));
            e0 = hn::Add(e0, hn::Mul(hn::Set(df, w[0]), left));
            e1 = hn::Add(e1, hn::Mul(hn::Set(df, w[1]), left));
            e2 = hn::Add(e2, hn::Mul(hn::Set(df, w[2]), left));
            store(k, half);
        }
    }
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex::kernels {
namespace {
HWY_EXPORT(round_spectra);
}

HalfSpectraRounder::HalfSpectraRounder(std::span<const double> weights, std::size_t bands) : bands_(bands), order_(bands) {
    const auto squared = [&](std::size_t b) {
        return weights[b] * weights[b] + weights[bands + b] * weights[bands + b] + weights[2 * bands + b] * weights[2 * bands + b];
    };
    std::iota(order_.begin(), order_.end(), std::size_t{0});
    std::stable_sort(order_.begin(), order_.end(), [&](std::size_t a, std::size_t b) { return squared(a) > squared(b); });
    for (const std::size_t b : order_)
        for (std::size_t c = 0; c < 3; ++c) weights_.push_back(static_cast<float>(weights[c * bands + b]));
}

void HalfSpectraRounder::operator()(const float* const* in, std::size_t n, std::uint16_t* const* out) const {
    HWY_DYNAMIC_DISPATCH(round_spectra)(in, n, out, order_.data(), bands_, weights_.data());
}

void HalfSpectraRounder::reference(const float* const* in, std::size_t n, std::uint16_t* const* out) const {
    for (std::size_t i = 0; i < n; ++i) {
        float s[3] = {0, 0, 0}, l[3] = {0, 0, 0}, g[3], e[3] = {0, 0, 0};
        const auto rounded = [](float value, std::uint16_t& half) {
            float_to_half_reference(&value, 1, &half, 1);
            float stored = 0;
            half_to_float_reference(&half, 1, 1, &stored);
            return stored;
        };
        for (std::size_t k = 0; k < bands_; ++k) {
            const float r = in[order_[k]][i], left = r - rounded(r, out[order_[k]][i]);
            for (std::size_t c = 0; c < 3; ++c) {
                s[c] += weights_[3 * k + c] * r;
                l[c] += weights_[3 * k + c] * left;
            }
        }
        for (std::size_t c = 0; c < 3; ++c) g[c] = 1.0f / (std::fabs(s[c]) + dark_offset);
        if (!(l[0] * l[0] * g[0] + l[1] * l[1] * g[1] + l[2] * l[2] * g[2] > tolerated)) continue;
        for (std::size_t k = 0; k < bands_; ++k) {
            const float r = in[order_[k]][i];
            const float ulp = std::fabs(r) * 0x1p-10f;
            const float* w = &weights_[3 * k];
            const float p[3] = {w[0] * g[0], w[1] * g[1], w[2] * g[2]};
            const float length = p[0] * w[0] + p[1] * w[1] + p[2] * w[2];
            const float wanted = (p[0] * e[0] + p[1] * e[1] + p[2] * e[2]) / std::max(length, least_length);
            float target = r + std::min(std::max(wanted, -ulp), ulp);
            if (r <= 1) target = std::min(target, 1.0f);
            if (r >= 0) target = std::max(target, 0.0f);
            const float stored = rounded(target, out[order_[k]][i]);
            for (std::size_t c = 0; c < 3; ++c) e[c] += w[c] * (r - stored);
        }
    }
}

}  // namespace spectex::kernels
#endif
