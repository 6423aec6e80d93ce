#include "kernels/lattice.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/lattice.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "kernels/simd-inl.h"

#ifndef SPECTEX_KERNELS_LATTICE_ONCE
#define SPECTEX_KERNELS_LATTICE_ONCE
namespace spectex::kernels {

/// One axis of a table as the kernels see it.
struct LatticeAxis {
    const double* knots;
    std::size_t count;
    std::size_t stride;
    bool uniform;
};

/// Cell and position within it of a component. Out-of-range values are clamped, NaN counts as 0.
inline std::size_t locate(const LatticeAxis& axis, double x, double& position) {
    if (!(x >= 0)) x = 0;
    if (x > 1) x = 1;
    if (axis.uniform) {
        const double scaled = x * static_cast<double>(axis.count - 1);
        const std::size_t cell = std::min(static_cast<std::size_t>(scaled), axis.count - 2);
        position = scaled - static_cast<double>(cell);
        return cell;
    }
    const double* above = std::upper_bound(axis.knots + 1, axis.knots + axis.count - 1, x);
    position = (x - above[-1]) / (above[0] - above[-1]);
    return static_cast<std::size_t>(above - axis.knots) - 1;
}

}  // namespace spectex::kernels
#endif

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {

// Few enough pixels that the vertices they touch stay in the first-level cache from one value to the next.
constexpr std::size_t block_size = 64;
static_assert(block_size * sizeof(double) >= HWY_MAX_BYTES, "a block holds whole vectors");

/// @param Padded  three values, each vertex of which takes four numbers: a load brings all of it.
template <bool Padded, class Out>
void Interpolate(const LatticeAxis* axes, const double* vertices, std::size_t values, const float* const* rgb, std::size_t n,
                 Out* const* planes) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<float, decltype(dd)> df;
    const hn::RebindToSigned<decltype(dd)> di;
    const hn::Rebind<std::int32_t, decltype(dd)> di32;
    const std::size_t lanes = hn::Lanes(dd);
    const auto stride_r = hn::Set(di, static_cast<std::int64_t>(axes[0].stride));
    const auto stride_g = hn::Set(di, static_cast<std::int64_t>(axes[1].stride));
    const auto stride_b = hn::Set(di, static_cast<std::int64_t>(axes[2].stride));
    const auto stride_all = hn::Add(stride_r, hn::Add(stride_g, stride_b));
    const bool uniform = axes[0].uniform && axes[1].uniform && axes[2].uniform;
    HWY_ALIGN float in[3][block_size];
    HWY_ALIGN double position[3][block_size];
    HWY_ALIGN double weight[4][block_size];
    HWY_ALIGN std::int64_t vertex[4][block_size];
    HWY_ALIGN Out out[block_size];
    for (std::size_t begin = 0; begin < n; begin += block_size) {
        const std::size_t count = std::min(block_size, n - begin);
        const std::size_t padded = (count + lanes - 1) / lanes * lanes;
        for (int k = 0; k < 3; ++k) {
            std::memcpy(in[k], rgb[k] + begin, count * sizeof(float));
            std::fill(in[k] + count, in[k] + padded, 0.0f);
        }
        if (uniform) {
            for (std::size_t i = 0; i < padded; i += lanes) {
                auto base = hn::Zero(di32);
                for (int k = 0; k < 3; ++k) {
                    auto x = hn::PromoteTo(dd, hn::LoadU(df, in[k] + i));
                    x = hn::IfThenElseZero(hn::Ge(x, hn::Zero(dd)), x);
                    x = hn::IfThenElse(hn::Gt(x, hn::Set(dd, 1)), hn::Set(dd, 1), x);
                    const auto scaled = hn::Mul(x, hn::Set(dd, static_cast<double>(axes[k].count - 1)));
                    const auto cell =
                        hn::Min(hn::DemoteTo(di32, scaled), hn::Set(di32, static_cast<std::int32_t>(axes[k].count - 2)));
                    hn::Store(hn::Sub(scaled, hn::PromoteTo(dd, cell)), dd, position[k] + i);
                    base = hn::Add(base, hn::Mul(cell, hn::Set(di32, static_cast<std::int32_t>(axes[k].stride))));
                }
                hn::Store(hn::PromoteTo(di, base), di, vertex[0] + i);
            }
        } else {
            for (std::size_t i = 0; i < padded; ++i) {
                std::size_t base = 0;
                for (int k = 0; k < 3; ++k) base += locate(axes[k], in[k][i], position[k][i]) * axes[k].stride;
                vertex[0][i] = static_cast<std::int64_t>(base);
            }
        }
        for (std::size_t i = 0; i < padded; i += lanes) {
            const auto r = hn::Load(dd, position[0] + i);
            const auto g = hn::Load(dd, position[1] + i);
            const auto b = hn::Load(dd, position[2] + i);
            const auto most = hn::Max(r, hn::Max(g, b));
            const auto least = hn::Min(r, hn::Min(g, b));
            const auto middle = hn::Max(hn::Min(r, g), hn::Min(hn::Max(r, g), b));
            hn::Store(hn::Sub(hn::Set(dd, 1), most), dd, weight[0] + i);
            hn::Store(hn::Sub(most, middle), dd, weight[1] + i);
            hn::Store(hn::Sub(middle, least), dd, weight[2] + i);
            hn::Store(least, dd, weight[3] + i);
            const auto r_g = hn::RebindMask(di, hn::Ge(r, g));
            const auto r_b = hn::RebindMask(di, hn::Ge(r, b));
            const auto g_b = hn::RebindMask(di, hn::Ge(g, b));
            const auto first = hn::IfThenElse(hn::And(r_g, r_b), stride_r, hn::IfThenElse(g_b, stride_g, stride_b));
            const auto last = hn::IfThenElse(hn::And(g_b, r_b), stride_b, hn::IfThenElse(r_g, stride_g, stride_r));
            const auto base = hn::Load(di, vertex[0] + i);
            hn::Store(hn::Add(base, first), di, vertex[1] + i);
            hn::Store(hn::Add(base, hn::Sub(stride_all, last)), di, vertex[2] + i);
            hn::Store(hn::Add(base, stride_all), di, vertex[3] + i);
        }
        if constexpr (Padded) {
            const hn::CappedTag<double, 4> d4;
            const hn::Rebind<float, decltype(d4)> f4;
            const hn::ScalableTag<float> whole;
            HWY_ALIGN float quads[4 * block_size];
            for (std::size_t i = 0; i < count; ++i)
                for (std::size_t part = 0; part < 4; part += hn::Lanes(d4)) {
                    const double* from = vertices + part;
                    auto sum = hn::Mul(hn::Set(d4, weight[0][i]), hn::LoadU(d4, from + vertex[0][i]));
                    for (int k = 1; k < 4; ++k)
                        sum = hn::Add(sum, hn::Mul(hn::Set(d4, weight[k][i]), hn::LoadU(d4, from + vertex[k][i])));
                    hn::StoreU(round_to_float(f4, sum), f4, quads + 4 * i + part);
                }
            const std::size_t step = hn::Lanes(whole);
            std::fill(quads + 4 * count, quads + 4 * ((count + step - 1) / step * step), 0.0f);
            HWY_ALIGN float plane[3][block_size];
            for (std::size_t i = 0; i < count; i += step) {
                auto a = hn::Zero(whole), b = a, c = a, unused = a;
                hn::LoadInterleaved4(whole, quads + 4 * i, a, b, c, unused);
                hn::Store(a, whole, plane[0] + i);
                hn::Store(b, whole, plane[1] + i);
                hn::Store(c, whole, plane[2] + i);
            }
            for (std::size_t value = 0; value < 3; ++value)
                if (planes[value] != nullptr) std::memcpy(planes[value] + begin, plane[value], count * sizeof(float));
            continue;
        }
        for (std::size_t value = 0; value < values; ++value) {
            if (planes[value] == nullptr) continue;
            const double* from = vertices + value;
            for (std::size_t i = 0; i < padded; i += lanes) {
                auto sum = hn::Mul(hn::Load(dd, weight[0] + i), hn::GatherIndex(dd, from, hn::Load(di, vertex[0] + i)));
                for (int k = 1; k < 4; ++k)
                    sum = hn::Add(sum, hn::Mul(hn::Load(dd, weight[k] + i),
                                               hn::GatherIndex(dd, from, hn::Load(di, vertex[k] + i))));
                if constexpr (sizeof(Out) == sizeof(float)) hn::StoreU(round_to_float(df, sum), df, out + i);
                else hn::StoreU(sum, dd, out + i);
            }
            std::memcpy(planes[value] + begin, out, count * sizeof(Out));
        }
    }
}

void InterpolateFloat(const LatticeAxis* axes, const double* vertices, std::size_t values, const float* const* rgb,
                      std::size_t n, float* const* planes) {
    Interpolate<false>(axes, vertices, values, rgb, n, planes);
}
void InterpolateThree(const LatticeAxis* axes, const double* vertices, std::size_t values, const float* const* rgb,
                      std::size_t n, float* const* planes) {
    Interpolate<true>(axes, vertices, values, rgb, n, planes);
}
void InterpolateDouble(const LatticeAxis* axes, const double* vertices, std::size_t values, const float* const* rgb,
                       std::size_t n, double* const* planes) {
    Interpolate<false>(axes, vertices, values, rgb, n, planes);
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex::kernels {

HWY_EXPORT(InterpolateFloat);
HWY_EXPORT(InterpolateThree);
HWY_EXPORT(InterpolateDouble);

namespace {

/// Numbers of a table that is kept once more with its vertices padded: 8 MB, beyond which no cache would hold it.
constexpr std::size_t most_padded = std::size_t{1} << 20;

std::array<LatticeAxis, 3> axes_of(const LatticeTable& table, const std::array<bool, 3>& uniform,
                                   const std::array<std::size_t, 3>& strides) {
    std::array<LatticeAxis, 3> axes{};
    for (std::size_t k = 0; k < 3; ++k)
        axes[k] = {table.knots[k].data(), table.knots[k].size(), strides[k], uniform[k]};
    return axes;
}

}  // namespace

LatticeKernel::LatticeKernel(const LatticeTable& table) : table_(&table) {
    strides_[2] = table.values;
    strides_[1] = strides_[2] * table.knots[2].size();
    strides_[0] = strides_[1] * table.knots[1].size();
    // The fast path counts in 32 bits.
    const bool small = table.vertices.size() < std::size_t{1} << 31;
    for (std::size_t k = 0; k < 3; ++k) {
        uniform_[k] = small;
        const double last = static_cast<double>(table.knots[k].size() - 1);
        for (std::size_t i = 0; i < table.knots[k].size(); ++i)
            // Knots are printed and read back or computed in one of several ways, each right to a rounding or two.
            uniform_[k] = uniform_[k] && std::fabs(table.knots[k][i] - static_cast<double>(i) / last) <= 0x1p-51;
    }
    if (table.values != 3 || !small || table.vertices.size() > most_padded) return;
    padded_.resize(table.vertices.size() / 3 * 4);
    for (std::size_t i = 0; i < table.vertices.size(); ++i) padded_[i / 3 * 4 + i % 3] = table.vertices[i];
}

void LatticeKernel::operator()(std::array<const float*, 3> rgb, std::size_t n, float* const* planes) const {
    if (!padded_.empty()) {
        const std::array<std::size_t, 3> wider{strides_[0] / 3 * 4, strides_[1] / 3 * 4, 4};
        HWY_DYNAMIC_DISPATCH(InterpolateThree)(axes_of(*table_, uniform_, wider).data(), padded_.data(), 3, rgb.data(), n, planes);
        return;
    }
    HWY_DYNAMIC_DISPATCH(InterpolateFloat)
    (axes_of(*table_, uniform_, strides_).data(), table_->vertices.data(), table_->values, rgb.data(), n, planes);
}
void LatticeKernel::operator()(std::array<const float*, 3> rgb, std::size_t n, double* const* planes) const {
    HWY_DYNAMIC_DISPATCH(InterpolateDouble)
    (axes_of(*table_, uniform_, strides_).data(), table_->vertices.data(), table_->values, rgb.data(), n, planes);
}

void LatticeKernel::reference(std::array<const float*, 3> rgb, std::size_t n, double* const* planes) const {
    const auto axes = axes_of(*table_, uniform_, strides_);
    for (std::size_t i = 0; i < n; ++i) {
        std::array<double, 3> position{};
        std::array<std::size_t, 3> order{0, 1, 2};
        std::size_t base = 0;
        for (std::size_t k = 0; k < 3; ++k) base += locate(axes[k], rgb[k][i], position[k]) * axes[k].stride;
        std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return position[a] > position[b]; });
        const double f1 = position[order[0]], f2 = position[order[1]], f3 = position[order[2]];
        const double* v0 = table_->vertices.data() + base;
        const double* v1 = v0 + axes[order[0]].stride;
        const double* v2 = v1 + axes[order[1]].stride;
        const double* v3 = v2 + axes[order[2]].stride;
        for (std::size_t value = 0; value < table_->values; ++value)
            if (planes[value] != nullptr)
                planes[value][i] = (1 - f1) * v0[value] + (f1 - f2) * v1[value] + (f2 - f3) * v2[value] + f3 * v3[value];
    }
}

void interpolate_lattice(const LatticeTable& table, std::span<const double> rgb, std::span<double> out) {
    const std::size_t values = table.values;
    const std::size_t blues = table.knots[2].size(), greens = table.knots[1].size();
    const std::array<std::size_t, 3> strides{greens * blues * values, blues * values, values};
    for (std::size_t i = 0; 3 * i + 2 < rgb.size(); ++i) {
        std::array<std::pair<double, std::size_t>, 3> step;
        const double* vertex = table.vertices.data();
        for (std::size_t c = 0; c < 3; ++c) {
            const auto& knots = table.knots[c];
            const double v = std::clamp(rgb[3 * i + c], 0.0, 1.0);
            const auto above = static_cast<std::size_t>(std::upper_bound(knots.begin() + 1, knots.end() - 1, v) - knots.begin());
            vertex += (above - 1) * strides[c];
            step[c] = {(v - knots[above - 1]) / (knots[above] - knots[above - 1]), strides[c]};
        }
        std::stable_sort(step.begin(), step.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
        const double *v0 = vertex, *v1 = v0 + step[0].second, *v2 = v1 + step[1].second, *v3 = v2 + step[2].second;
        const double w0 = 1 - step[0].first, w1 = step[0].first - step[1].first, w2 = step[1].first - step[2].first,
                     w3 = step[2].first;
        double* r = &out[i * values];
        for (std::size_t l = 0; l < values; ++l) r[l] = (w0 * v0[l] + w1 * v1[l]) + (w2 * v2[l] + w3 * v3[l]);
    }
}

}  // namespace spectex::kernels
#endif  // HWY_ONCE
