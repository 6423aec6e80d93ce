#include "kernels/sigmoid.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/sigmoid.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "kernels/simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {

// Of the residual before the last step, relative to the largest component: so small that the step can only leave rounding;
// small enough for the foresight below to hold, and what it may foresee to be left: a fifth of what is promised, for it errs.
constexpr double surely_small = 1e-9, near_enough = 1e-6, accepted_rest = 2e-13;

// Square roots and divisions of so many bands are begun while as many before them are used: one band's dependent operations
// would fill a processor's scheduler while they wait.
constexpr std::size_t bands_at_once = 4;

void Evaluate(const double* coefficients, std::size_t n, const double* t, std::size_t bands, double* out) {
    const hn::ScalableTag<double> d;
    const std::size_t lanes = hn::Lanes(d);
    const auto one = hn::Set(d, 1.0), half = hn::Set(d, 0.5), saturation = hn::Set(d, sigmoid_saturation);
    double last[HWY_MAX_BYTES / sizeof(double)];
    for (std::size_t i = 0; i < n; ++i, coefficients += 3, out += bands) {
        double c[3];
        for (int k = 0; k < 3; ++k) {
            const double v = coefficients[k];
            c[k] = v >= -0x1p100 ? std::min(v, 0x1p100) : -0x1p100;
        }
        const auto c0 = hn::Set(d, c[0]), c1 = hn::Set(d, c[1]), c2 = hn::Set(d, c[2]);
        const auto value = [&](hn::Vec<decltype(d)> at) HWY_ATTR {
            const auto x = hn::Add(hn::Mul(hn::Add(hn::Mul(c0, at), c1), at), c2);
            const auto magnitude = hn::Abs(x);
            const auto root = hn::Sqrt(hn::Add(one, hn::Mul(x, x)));
            // 1/2 - |x| / (2 sqrt(1 + x^2)) without the cancellation.
            auto tail = hn::Div(half, hn::Mul(root, hn::Add(root, magnitude)));
            tail = hn::IfThenElseZero(hn::Lt(magnitude, saturation), tail);
            return hn::IfThenElse(hn::Lt(x, hn::Zero(d)), tail, hn::Sub(one, tail));
        };
        std::size_t b = 0;
        for (; b + lanes <= bands; b += lanes) hn::StoreU(value(hn::LoadU(d, t + b)), d, out + b);
        if (b < bands) {
            std::fill(last, last + lanes, 0.0);
            std::memcpy(last, t + b, (bands - b) * sizeof(double));
            hn::StoreU(value(hn::LoadU(d, last)), d, last);
            std::memcpy(out + b, last, (bands - b) * sizeof(double));
        }
    }
}

void EvaluateWithSlopes(const double* c, const double* t, std::size_t bands, double* r, double* slope) {
    const hn::ScalableTag<double> d;
    const std::size_t lanes = hn::Lanes(d);
    const auto one = hn::Set(d, 1.0), half = hn::Set(d, 0.5);
    const auto c0 = hn::Set(d, c[0]), c1 = hn::Set(d, c[1]), c2 = hn::Set(d, c[2]);
    double staged[3][HWY_MAX_BYTES / sizeof(double)];
    for (std::size_t b = 0; b < bands; b += lanes) {
        const std::size_t used = std::min(lanes, bands - b);
        const bool whole = used == lanes;
        if (!whole) {
            std::fill_n(staged[0], lanes, 0.0);
            std::copy_n(t + b, used, staged[0]);
        }
        const auto at = hn::LoadU(d, whole ? t + b : staged[0]);
        const auto x = hn::Add(hn::Mul(hn::Add(hn::Mul(c0, at), c1), at), c2), magnitude = hn::Abs(x);
        const auto root = hn::Sqrt(hn::Add(one, hn::Mul(x, x))), together = hn::Add(root, magnitude);
        // 1/2 - |x| / (2 sqrt(1 + x^2)) without the cancellation, and by the same division 1 / sqrt(1 + x^2).
        const auto inverse = hn::Div(one, hn::Mul(root, together));
        const auto tail = hn::Mul(half, inverse), y = hn::Mul(together, inverse);
        hn::StoreU(hn::IfThenElse(hn::Lt(x, hn::Zero(d)), tail, hn::Sub(one, tail)), d, whole ? r + b : staged[1]);
        hn::StoreU(hn::Mul(hn::Mul(half, y), hn::Mul(y, y)), d, whole ? slope + b : staged[2]);
        if (!whole) {
            std::copy_n(staged[1], used, r + b);
            std::copy_n(staged[2], used, slope + b);
        }
    }
}

/// What turns bent_ratio and bent_root into positions on [0,1].
struct Warp {
    float ratio_zero, ratio_scale, root_zero, root_scale;
};

// As many colours as a vector holds floats; their doubles come in two vectors, which are one and the same on the target that
// has one lane of either.
template <class DF>
struct Colors {
#if HWY_TARGET == HWY_SCALAR
    using DD = hn::Rebind<double, DF>;
#else
    using DD = hn::Repartition<double, DF>;
#endif
    using VD = hn::Vec<DD>;
    using VF = hn::Vec<DF>;
    struct Pair {
        VD lower, upper;
    };

    HWY_INLINE static VF narrow([[maybe_unused]] DF df, const Pair& v) {
        const hn::Rebind<float, DD> dh;
#if HWY_TARGET == HWY_SCALAR
        return round_to_float(dh, v.lower);
#else
        return hn::Combine(df, round_to_float(dh, v.upper), round_to_float(dh, v.lower));
#endif
    }
    HWY_INLINE static Pair widen([[maybe_unused]] DF df, VF v) {
        const DD dd;
#if HWY_TARGET == HWY_SCALAR
        return {hn::PromoteTo(dd, v), hn::PromoteTo(dd, v)};
#else
        const hn::Half<DF> dh;
        return {hn::PromoteTo(dd, hn::LowerHalf(dh, v)), hn::PromoteTo(dd, hn::UpperHalf(dh, v))};
#endif
    }
};

/// Solves j x = f, with j row-major, by Cramer's rule.
template <class D, class V>
HWY_INLINE void Solve(D d, const V* j, const V* f, V* x) {
    const auto minor = [](V a, V b, V p, V q) HWY_ATTR { return hn::Sub(hn::Mul(a, b), hn::Mul(p, q)); };
    const V c00 = minor(j[4], j[8], j[5], j[7]), c01 = minor(j[2], j[7], j[1], j[8]), c02 = minor(j[1], j[5], j[2], j[4]);
    const V c10 = minor(j[5], j[6], j[3], j[8]), c11 = minor(j[0], j[8], j[2], j[6]), c12 = minor(j[2], j[3], j[0], j[5]);
    const V c20 = minor(j[3], j[7], j[4], j[6]), c21 = minor(j[1], j[6], j[0], j[7]), c22 = minor(j[0], j[4], j[1], j[3]);
    const auto dot = [](V a, V u, V b, V v, V c, V w) HWY_ATTR {
        return hn::Add(hn::Add(hn::Mul(a, u), hn::Mul(b, v)), hn::Mul(c, w));
    };
    const V inverse = hn::Div(hn::Set(d, 1.0), dot(j[0], c00, j[1], c10, j[2], c20));
    x[0] = hn::Mul(dot(c00, f[0], c01, f[1], c02, f[2]), inverse);
    x[1] = hn::Mul(dot(c10, f[0], c11, f[1], c12, f[2]), inverse);
    x[2] = hn::Mul(dot(c20, f[0], c21, f[1], c22, f[2]), inverse);
}

/// f = 2 (sum a S - q) at c, and with it twice the derivative by c, row-major.
template <bool with_jacobian, class DF, class C = Colors<DF>>
HWY_INLINE void Residual(DF df, const SigmoidBand* bands, std::size_t count, const double* sum, const typename C::Pair* c,
                         const typename C::Pair* q, typename C::VD* fl, typename C::VD* fu, typename C::VD* jl,
                         typename C::VD* ju) {
    using VF = typename C::VF;
    using VD = typename C::VD;
    using Pair = typename C::Pair;
    const typename C::DD dd;
    const VF one_f = hn::Set(df, 1.0f), half_f = hn::Set(df, 0.5f);
    const VD three_quarters = hn::Set(dd, 0.75);
    const VD cl0 = c[0].lower, cl1 = c[1].lower, cl2 = c[2].lower;
    const VD cu0 = c[0].upper, cu1 = c[1].upper, cu2 = c[2].upper;
    VD fl0 = hn::Zero(dd), fl1 = fl0, fl2 = fl0, fu0 = fl0, fu1 = fl0, fu2 = fl0;
    [[maybe_unused]] VF j00 = hn::Zero(df), j01 = j00, j02 = j00, j10 = j00, j11 = j00, j12 = j00, j20 = j00, j21 = j00,
                        j22 = j00;
    VD xl[2 * bands_at_once], xu[2 * bands_at_once];
    VF roots[2 * bands_at_once];
    const auto begin_roots = [&](std::size_t first) HWY_ATTR {
        for (std::size_t b = first; b < std::min(first + bands_at_once, count); ++b) {
            const std::size_t slot = b % (2 * bands_at_once);
            const VD t = hn::Set(dd, bands[b].t);
            xl[slot] = hn::Add(hn::Mul(hn::Add(hn::Mul(cl0, t), cl1), t), cl2);
            xu[slot] = hn::Add(hn::Mul(hn::Add(hn::Mul(cu0, t), cu1), t), cu2);
            const VF x = C::narrow(df, Pair{xl[slot], xu[slot]});
            roots[slot] = hn::Div(half_f, hn::Sqrt(hn::Add(one_f, hn::Mul(x, x))));
        }
    };
    begin_roots(0);
    for (std::size_t b = 0; b < count; ++b) {
        const std::size_t slot = b % (2 * bands_at_once);
        if (b % bands_at_once == 0) begin_roots(b + bands_at_once);
        const SigmoidBand& band = bands[b];
        const VF y = roots[slot];
        if constexpr (with_jacobian) {
            const VF g = hn::Mul(hn::Mul(y, y), y);
            const VF tf = hn::Set(df, band.t_single), tt = hn::Set(df, band.t_squared_single);
            const VF u0 = hn::Mul(hn::Set(df, band.a_times_8_single[0]), g);
            const VF u1 = hn::Mul(hn::Set(df, band.a_times_8_single[1]), g);
            const VF u2 = hn::Mul(hn::Set(df, band.a_times_8_single[2]), g);
            j02 = hn::Add(j02, u0), j12 = hn::Add(j12, u1), j22 = hn::Add(j22, u2);
            j01 = hn::Add(j01, hn::Mul(u0, tf)), j11 = hn::Add(j11, hn::Mul(u1, tf)), j21 = hn::Add(j21, hn::Mul(u2, tf));
            j00 = hn::Add(j00, hn::Mul(u0, tt)), j10 = hn::Add(j10, hn::Mul(u1, tt)), j20 = hn::Add(j20, hn::Mul(u2, tt));
        }
        // y to double precision by one Newton step for y^-2 = 1 + x^2, of which a relative error e leaves 3/2 e^2. With
        // h = y / 2 and u = x h: x y (3/2 - (1 + x^2) y^2 / 2) = 4 u (3/4 - (h^2 + u^2)), of which the 4 is in the weights.
        const Pair yw = C::widen(df, y);
        const auto product = [&](VD xw, VD h) HWY_ATTR {
            const VD u = hn::Mul(xw, h);
            return hn::Mul(u, hn::Sub(three_quarters, hn::Add(hn::Mul(h, h), hn::Mul(u, u))));
        };
        const VD sl = product(xl[slot], yw.lower), su = product(xu[slot], yw.upper);
        const VD a0 = hn::Set(dd, band.a_times_4[0]), a1 = hn::Set(dd, band.a_times_4[1]), a2 = hn::Set(dd, band.a_times_4[2]);
        fl0 = hn::Add(fl0, hn::Mul(a0, sl)), fu0 = hn::Add(fu0, hn::Mul(a0, su));
        fl1 = hn::Add(fl1, hn::Mul(a1, sl)), fu1 = hn::Add(fu1, hn::Mul(a1, su));
        fl2 = hn::Add(fl2, hn::Mul(a2, sl)), fu2 = hn::Add(fu2, hn::Mul(a2, su));
    }
    // 2 sum a S = sum a (1 + x y).
    const auto rest = [&](int k, VD f, VD target) HWY_ATTR {
        return hn::Sub(hn::Add(hn::Set(dd, sum[k]), f), hn::Add(target, target));
    };
    fl[0] = rest(0, fl0, q[0].lower), fl[1] = rest(1, fl1, q[1].lower), fl[2] = rest(2, fl2, q[2].lower);
    fu[0] = rest(0, fu0, q[0].upper), fu[1] = rest(1, fu1, q[1].upper), fu[2] = rest(2, fu2, q[2].upper);
    if constexpr (with_jacobian) {
        const VF j[9] = {j00, j01, j02, j10, j11, j12, j20, j21, j22};
        for (int k = 0; k < 9; ++k) {
            const Pair p = C::widen(df, j[k]);
            jl[k] = p.lower, ju[k] = p.upper;
        }
    }
}

void Refine(const SigmoidEquations& equations, const double* const* q, std::size_t n, double* const* c,
            bool from_table, bool* accepted) {
    using DF = hn::ScalableTag<float>;
    using C = Colors<DF>;
    const DF df;
    using Pair = typename C::Pair;
    using VF = typename C::VF;
    using VD = typename C::VD;
    const typename C::DD dd;
    const hn::RebindToSigned<decltype(df)> di;
    const hn::RebindToSigned<decltype(dd)> dl;
    const std::size_t lanes = hn::Lanes(df), second = lanes - hn::Lanes(dd);
    const SigmoidBand* bands = equations.bands.data();
    const std::size_t count = equations.bands.size(), few_count = equations.few.size();
    const SigmoidEquations::Few* few = equations.few.data();
    const auto resolution = static_cast<std::int32_t>(equations.resolution);
    const float* table = equations.table.data();
    const VF one_f = hn::Set(df, 1.0f);
    const double least_ratio = SigmoidEquations::bent_ratio(0), least_root = SigmoidEquations::bent_root(0);
    const Warp warp{static_cast<float>(least_ratio), static_cast<float>(1 / (SigmoidEquations::bent_ratio(1) - least_ratio)),
                    static_cast<float>(least_root), static_cast<float>(1 / (SigmoidEquations::bent_root(1) - least_root))};

    for (std::size_t begin = 0; begin < n; begin += lanes) {
        const std::size_t used = std::min(lanes, n - begin);
        double staged[3][HWY_MAX_BYTES / sizeof(float)];
        Pair target[3], coefficient[3];
        for (int i = 0; i < 3; ++i) {
            const double* from = q[i] + begin;
            if (used < lanes) {
                std::fill_n(staged[i], lanes, i == 0 ? 0.5 : 0.25);  // any colour that converges
                std::copy_n(from, used, staged[i]);
                from = staged[i];
            }
            target[i] = {hn::LoadU(dd, from), hn::LoadU(dd, from + second)};
        }
        const auto largest = [&](VD a, VD b, VD e) HWY_ATTR { return hn::Max(hn::Max(a, b), e); };
        const Pair z{largest(target[0].lower, target[1].lower, target[2].lower),
                     largest(target[0].upper, target[1].upper, target[2].upper)};
        if (from_table) {
            const VF zf = C::narrow(df, z);
            VF guess[3];
            {
                const VF f0 = C::narrow(df, target[0]), f1 = C::narrow(df, target[1]), f2 = C::narrow(df, target[2]);
                const auto is_first = hn::Ge(f0, hn::Max(f1, f2)), is_second = hn::Ge(f1, f2);
                const VF u = hn::IfThenElse(is_first, f1, hn::IfThenElse(is_second, f2, f0));
                const VF v = hn::IfThenElse(is_first, f2, hn::IfThenElse(is_second, f0, f1));
                const float steps = static_cast<float>(equations.resolution - 1);
                const VF zero = hn::Zero(df), last = hn::Set(df, steps), w = hn::Sqrt(zf), inverse_z = hn::Div(one_f, zf);
                const VF shift = hn::Set(df, static_cast<float>(SigmoidEquations::ratio_shift));
                const VF ratio_zero = hn::Set(df, warp.ratio_zero), ratio_scale = hn::Set(df, steps * warp.ratio_scale);
                const auto ratio_position = [&](VF ratio) HWY_ATTR {
                    return hn::Mul(ratio_scale, hn::Sub(hn::Sqrt(hn::Add(hn::Max(ratio, zero), shift)), ratio_zero));
                };
                const VF bent = hn::Sqrt(hn::Max(hn::Sub(hn::Set(df, static_cast<float>(1 + SigmoidEquations::root_shift)), w), zero));
                const VF root = hn::Sub(w, hn::Mul(hn::Set(df, static_cast<float>(SigmoidEquations::root_bend)), bent));
                const VF position[3] = {ratio_position(hn::Mul(u, inverse_z)), ratio_position(hn::Mul(v, inverse_z)),
                                        hn::Mul(hn::Set(df, steps * warp.root_scale), hn::Sub(root, hn::Set(df, warp.root_zero)))};
                VF fraction[3];
                hn::Vec<decltype(di)> cell[3];
                for (int k = 0; k < 3; ++k) {
                    const VF p = hn::Min(hn::Max(position[k], zero), last);
                    cell[k] = hn::Min(hn::ConvertTo(di, p), hn::Set(di, resolution - 2));
                    fraction[k] = hn::Sub(p, hn::ConvertTo(df, cell[k]));
                }
                const auto block = hn::IfThenElse(hn::RebindMask(di, is_first), hn::Zero(di),
                                                  hn::IfThenElse(hn::RebindMask(di, is_second), hn::Set(di, 1), hn::Set(di, 2)));
                const auto r = hn::Set(di, resolution);
                const auto index = hn::ShiftLeft<2>(hn::Add(
                    hn::Mul(hn::Add(hn::Mul(hn::Add(hn::Mul(block, r), cell[2]), r), cell[1]), r), cell[0]));
                // A colour at a time, its three coefficients together: gathers of single numbers take longer than all else here.
                std::int32_t at[HWY_MAX_BYTES / sizeof(float)];
                float part[3][HWY_MAX_BYTES / sizeof(float)], found[HWY_MAX_BYTES / sizeof(float)][4];
                hn::StoreU(index, di, at);
                for (int k = 0; k < 3; ++k) hn::StoreU(fraction[k], df, part[k]);
                const hn::CappedTag<float, 4> d4;
                const std::size_t dx = 4, dy = dx * equations.resolution, dz = dy * equations.resolution;
                const auto blend = [](auto a, auto b, auto f) HWY_ATTR { return hn::Add(a, hn::Mul(f, hn::Sub(b, a))); };
                for (std::size_t i = 0; i < lanes; ++i) {
                    const auto fx = hn::Set(d4, part[0][i]), fy = hn::Set(d4, part[1][i]), fz = hn::Set(d4, part[2][i]);
                    for (std::size_t k = 0; k < 4; k += hn::Lanes(d4)) {
                        const float* vertex = table + static_cast<std::size_t>(at[i]) + k;
                        const auto row = [&](const float* from) HWY_ATTR {
                            return blend(hn::LoadU(d4, from), hn::LoadU(d4, from + dx), fx);
                        };
                        const auto near = blend(row(vertex), row(vertex + dy), fy);
                        const auto far = blend(row(vertex + dz), row(vertex + dz + dy), fy);
                        hn::StoreU(blend(near, far, fz), d4, found[i] + k);
                    }
                }
                const VF inverse_w = hn::Div(one_f, w);
                for (int k = 0; k < 3; ++k)
                    guess[k] = hn::Mul(hn::GatherIndex(df, &found[0][k], hn::ShiftLeft<2>(hn::Iota(di, 0))), inverse_w);
            }

            // A step in single precision.
            {
                VF f0 = hn::Zero(df), f1 = f0, f2 = f0;
                VF j00 = f0, j01 = f0, j02 = f0, j10 = f0, j11 = f0, j12 = f0, j20 = f0, j21 = f0, j22 = f0;
                const VF c0 = guess[0], c1 = guess[1], c2 = guess[2];
                VF xs[2 * bands_at_once], roots[2 * bands_at_once];
                const auto begin_roots = [&](std::size_t first) HWY_ATTR {
                    for (std::size_t b = first; b < std::min(first + bands_at_once, few_count); ++b) {
                        const std::size_t slot = b % (2 * bands_at_once);
                        const VF t = hn::Set(df, few[b].t);
                        xs[slot] = hn::Add(hn::Mul(hn::Add(hn::Mul(c0, t), c1), t), c2);
                        roots[slot] = hn::Div(one_f, hn::Sqrt(hn::Add(one_f, hn::Mul(xs[slot], xs[slot]))));
                    }
                };
                begin_roots(0);
                for (std::size_t b = 0; b < few_count; ++b) {
                    const std::size_t slot = b % (2 * bands_at_once);
                    if (b % bands_at_once == 0) begin_roots(b + bands_at_once);
                    const SigmoidEquations::Few& band = few[b];
                    const VF t = hn::Set(df, band.t), tt = hn::Set(df, band.t_squared);
                    const VF a0 = hn::Set(df, band.a[0]), a1 = hn::Set(df, band.a[1]), a2 = hn::Set(df, band.a[2]);
                    const VF x = xs[slot], y = roots[slot];
                    const VF s = hn::Mul(x, y), g = hn::Mul(hn::Mul(y, y), y);
                    f0 = hn::Add(f0, hn::Mul(a0, s));
                    f1 = hn::Add(f1, hn::Mul(a1, s));
                    f2 = hn::Add(f2, hn::Mul(a2, s));
                    const VF u0 = hn::Mul(a0, g), u1 = hn::Mul(a1, g), u2 = hn::Mul(a2, g);
                    j02 = hn::Add(j02, u0), j12 = hn::Add(j12, u1), j22 = hn::Add(j22, u2);
                    j01 = hn::Add(j01, hn::Mul(u0, t)), j11 = hn::Add(j11, hn::Mul(u1, t)), j21 = hn::Add(j21, hn::Mul(u2, t));
                    j00 = hn::Add(j00, hn::Mul(u0, tt)), j10 = hn::Add(j10, hn::Mul(u1, tt)), j20 = hn::Add(j20, hn::Mul(u2, tt));
                }
                const VF j[9] = {j00, j01, j02, j10, j11, j12, j20, j21, j22};
                const VF f[3] = {f0, f1, f2};
                Pair jw[9], fw[3];
                for (int k = 0; k < 9; ++k) jw[k] = C::widen(df, j[k]);
                for (int k = 0; k < 3; ++k) {
                    // 2 sum a S = sum a (1 + x y).
                    const VD sum = hn::Set(dd, equations.sum[static_cast<std::size_t>(k)]);
                    fw[k] = C::widen(df, f[k]);
                    fw[k].lower = hn::Sub(hn::Add(sum, fw[k].lower), hn::Add(target[k].lower, target[k].lower));
                    fw[k].upper = hn::Sub(hn::Add(sum, fw[k].upper), hn::Add(target[k].upper, target[k].upper));
                }
                VD jl[9], ju[9], step_l[3], step_u[3];
                for (int k = 0; k < 9; ++k) jl[k] = jw[k].lower, ju[k] = jw[k].upper;
                const VD fl[3] = {fw[0].lower, fw[1].lower, fw[2].lower}, fu[3] = {fw[0].upper, fw[1].upper, fw[2].upper};
                Solve(dd, jl, fl, step_l);
                Solve(dd, ju, fu, step_u);
                for (int k = 0; k < 3; ++k) {
                    coefficient[k] = C::widen(df, guess[k]);
                    coefficient[k].lower = hn::Sub(coefficient[k].lower, step_l[k]);
                    coefficient[k].upper = hn::Sub(coefficient[k].upper, step_u[k]);
                }
            }
        } else {
            for (int k = 0; k < 3; ++k) {
                const double* from = c[k] + begin;
                if (used < lanes) {
                    std::fill_n(staged[k], lanes, 0.0);
                    std::copy_n(from, used, staged[k]);
                    from = staged[k];
                }
                coefficient[k] = {hn::LoadU(dd, from), hn::LoadU(dd, from + second)};
            }
        }

        VD jl[9], ju[9], fl[3], fu[3], step_l[3], step_u[3];
        const auto advance = [&]() HWY_ATTR {
            Solve(dd, jl, fl, step_l);
            Solve(dd, ju, fu, step_u);
            for (int k = 0; k < 3; ++k) {
                coefficient[k].lower = hn::Sub(coefficient[k].lower, step_l[k]);
                coefficient[k].upper = hn::Sub(coefficient[k].upper, step_u[k]);
            }
        };
        const auto size = [](const VD* f) HWY_ATTR { return hn::Add(hn::Add(hn::Abs(f[0]), hn::Abs(f[1])), hn::Abs(f[2])); };
        Residual<true>(df, bands, count, equations.sum.data(), coefficient, target, fl, fu, jl, ju);
        const VD before_l = size(fl), before_u = size(fu);
        advance();
        Residual<false>(df, bands, count, equations.sum.data(), coefficient, target, fl, fu, jl, ju);
        advance();
        // The Newton step took a residual R to R' = K R^2; a step by its Jacobian, off by 2 K R, leaves about 2 R'^2 / R.
        const auto flag = [&](VD before, VD after, VD largest_component) HWY_ATTR {
            const auto small = hn::Le(after, hn::Mul(hn::Set(dd, surely_small), largest_component));
            const auto left = hn::Mul(hn::Set(dd, 4.0), hn::Mul(after, after));
            const auto foreseen = hn::Le(left, hn::Mul(hn::Mul(hn::Set(dd, accepted_rest), largest_component), before));
            const auto near = hn::Le(after, hn::Mul(hn::Set(dd, near_enough), largest_component));
            return hn::IfThenElseZero(hn::RebindMask(dl, hn::Or(small, hn::And(foreseen, near))),
                                      hn::Set(dl, std::int64_t{1}));
        };
        const auto taken_l = flag(before_l, size(fl), z.lower), taken_u = flag(before_u, size(fu), z.upper);
        std::int64_t taken[HWY_MAX_BYTES / sizeof(float)];
        hn::StoreU(taken_l, dl, taken);
        hn::StoreU(taken_u, dl, taken + second);
        for (std::size_t i = 0; i < used; ++i) accepted[begin + i] = taken[i] != 0;
        for (int k = 0; k < 3; ++k) {
            double* to = used < lanes ? staged[k] : c[k] + begin;
            hn::StoreU(coefficient[k].lower, dd, to);
            hn::StoreU(coefficient[k].upper, dd, to + second);
            if (used < lanes) std::copy_n(staged[k], used, c[k] + begin);
        }
    }
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex::kernels {

HWY_EXPORT(Evaluate);
HWY_EXPORT(EvaluateWithSlopes);
HWY_EXPORT(Refine);

double sigmoid(double x) {
    const double magnitude = std::fabs(x), root = std::sqrt(1 + x * x);
    const double tail = magnitude < sigmoid_saturation ? 0.5 / (root * (root + magnitude)) : 0;
    return x >= 0 ? 1 - tail : tail;
}

void evaluate_sigmoids(std::span<const double> coefficients, std::span<const double> t, std::span<double> out) {
    HWY_DYNAMIC_DISPATCH(Evaluate)(coefficients.data(), coefficients.size() / 3, t.data(), t.size(), out.data());
}

void evaluate_sigmoids_reference(std::span<const double> coefficients, std::span<const double> t, std::span<double> out) {
    for (std::size_t i = 0; i < coefficients.size() / 3; ++i) {
        double c[3];
        for (std::size_t k = 0; k < 3; ++k) {
            const double v = coefficients[3 * i + k];
            c[k] = std::isnan(v) ? -0x1p100 : std::clamp(v, -0x1p100, 0x1p100);
        }
        for (std::size_t b = 0; b < t.size(); ++b) out[i * t.size() + b] = sigmoid((c[0] * t[b] + c[1]) * t[b] + c[2]);
    }
}

void sigmoids_and_slopes(const std::array<double, 3>& c, std::span<const double> t, double* r, double* slope) {
    HWY_DYNAMIC_DISPATCH(EvaluateWithSlopes)(c.data(), t.data(), t.size(), r, slope);
}

// Colours beyond the cube are guessed too.
double SigmoidEquations::bent_ratio(double ratio) { return std::sqrt(std::max(ratio, 0.0) + ratio_shift); }
double SigmoidEquations::bent_root(double w) { return w - root_bend * std::sqrt(std::max(1 + root_shift - w, 0.0)); }
double SigmoidEquations::ratio_position(double ratio) {
    return (bent_ratio(ratio) - bent_ratio(0)) / (bent_ratio(1) - bent_ratio(0));
}
double SigmoidEquations::root_position(double w) { return (bent_root(w) - bent_root(0)) / (bent_root(1) - bent_root(0)); }
double SigmoidEquations::ratio_at(double position) {
    const double bent = bent_ratio(0) + position * (bent_ratio(1) - bent_ratio(0));
    return std::clamp(bent * bent - ratio_shift, 0.0, 1.0);
}
double SigmoidEquations::root_at(double position) {
    // A quadratic in s = sqrt(1 + root_shift - w).
    const double rest = 1 + root_shift - bent_root(0) - position * (bent_root(1) - bent_root(0));
    const double s = (std::sqrt(root_bend * root_bend + 4 * rest) - root_bend) / 2;
    return std::clamp(1 + root_shift - s * s, 0.0, 1.0);
}

SigmoidEquations::SigmoidEquations(std::span<const double> t, std::span<const double> a) {
    const std::size_t n = t.size();
    const auto weight = [&](std::size_t b) { return std::max({std::fabs(a[b]), std::fabs(a[n + b]), std::fabs(a[2 * n + b])}); };
    bands.reserve(n);
    for (std::size_t b = 0; b < n; ++b) {
        SigmoidBand band{t[b], {a[b], a[n + b], a[2 * n + b]}};
        for (std::size_t i = 0; i < 3; ++i) {
            sum[i] += band.a[i];
            band.a_times_4[i] = 4 * band.a[i];
            band.a_times_8_single[i] = static_cast<float>(8 * band.a[i]);
        }
        band.t_single = static_cast<float>(band.t);
        band.t_squared_single = static_cast<float>(band.t * band.t);
        bands.push_back(band);
    }
    for (std::size_t b = 0; b < n;) {
        std::size_t end = b + 1;
        double together = weight(b), moment = together * t[b];
        while (end < n && end - b < most_merged && together + weight(end) <= light_enough) {
            together += weight(end);
            moment += weight(end) * t[end];
            ++end;
        }
        std::size_t middle = b;
        for (std::size_t k = b; k < end; ++k)
            if (std::fabs(t[k] * together - moment) < std::fabs(t[middle] * together - moment)) middle = k;
        Few one{static_cast<float>(t[middle]), static_cast<float>(t[middle] * t[middle]), {}};
        for (std::size_t i = 0; i < 3; ++i) {
            double total = 0;
            for (std::size_t k = b; k < end; ++k) total += a[i * n + k];
            one.a[i] = static_cast<float>(total);
        }
        few.push_back(one);
        b = end;
    }
}

void refine_sigmoids(const SigmoidEquations& equations, std::array<const double*, 3> q, std::size_t n,
                     std::array<double*, 3> c, bool from_table, bool* accepted) {
    HWY_DYNAMIC_DISPATCH(Refine)(equations, q.data(), n, c.data(), from_table, accepted);
}

}  // namespace spectex::kernels
#endif
