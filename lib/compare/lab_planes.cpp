#include <algorithm>
#include <cmath>

#include "compare/spaces.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compare/lab_planes.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "compare/cube_root-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// lab_f for t in [-largest_rooted, largest_rooted].
template <class D, class V>
HWY_INLINE V LabF(D dd, V t) {
    const auto border = hn::Set(dd, (24.0 / 116) * (24.0 / 116) * (24.0 / 116));
    const auto above = hn::Gt(t, border);
    const auto y = CubeRoot(dd, hn::IfThenElse(above, t, hn::Set(dd, 1)));
    const auto line = hn::Add(hn::Mul(hn::Set(dd, 841.0 / 108), t), hn::Set(dd, 16.0 / 116));
    return hn::IfThenElse(above, y, line);
}

template <class In>
void LabPlanes(const GreyRow* rows, const In* const* rgb, std::size_t n, double* const* lab) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<In, decltype(dd)> din;
    const std::size_t lanes = hn::Lanes(dd);
    // In stages over a block: a loop whose body is one root lets the roots of several vectors overlap.
    constexpr std::size_t block = 64;
    static_assert(block % (HWY_MAX_BYTES / sizeof(double)) == 0, "a block holds whole vectors");
    HWY_ALIGN double t[3][block];
    HWY_ALIGN In in[3][block];
    for (std::size_t begin = 0; begin < n; begin += block) {
        const std::size_t count = std::min(block, n - begin), padded = (count + lanes - 1) / lanes * lanes;
        const In* from[3] = {rgb[0] + begin, rgb[1] + begin, rgb[2] + begin};
        if (count < padded)
            for (int k = 0; k < 3; ++k) {
                std::copy_n(from[k], count, in[k]);
                std::fill(in[k] + count, in[k] + padded, In{0});
                from[k] = in[k];
            }
        for (int k = 0; k < 3; ++k) {
            const In* base = from[rows[k].base];
            const In* first = from[rows[k].base == 0 ? 1 : 0];
            const In* second = from[rows[k].base == 2 ? 1 : 2];
            const auto a = hn::Set(dd, rows[k].sum), b = hn::Set(dd, rows[k].first), c = hn::Set(dd, rows[k].second);
            const auto wide = [&](const In* p) HWY_ATTR {
                if constexpr (sizeof(In) == sizeof(double)) return hn::LoadU(dd, p);
                else return hn::PromoteTo(dd, hn::LoadU(din, p));
            };
            for (std::size_t i = 0; i < padded; i += lanes) {
                const auto v = wide(base + i);
                hn::Store(hn::Add(hn::Mul(a, v), hn::Add(hn::Mul(b, hn::Sub(wide(first + i), v)), hn::Mul(c, hn::Sub(wide(second + i), v)))),
                          dd, t[k] + i);
            }
        }
        const auto bound = hn::Set(dd, largest_rooted);
        for (int k = 0; k < 3; ++k)
            for (std::size_t i = 0; i < padded; i += lanes) {
                const auto v = hn::Load(dd, t[k] + i);
                const auto usual = hn::Le(hn::Abs(v), bound);
                if (HWY_LIKELY(hn::AllTrue(dd, usual))) {
                    hn::Store(LabF(dd, v), dd, t[k] + i);
                    continue;
                }
                // NaN, infinities and the beyond of the estimate's range; ordinary neighbours keep their ordinary way.
                double f[HWY_MAX_BYTES / sizeof(double)];
                hn::StoreU(LabF(dd, hn::IfThenElseZero(usual, v)), dd, f);
                for (std::size_t j = 0; j < lanes; ++j) t[k][i + j] = std::fabs(t[k][i + j]) <= largest_rooted ? f[j] : lab_f(t[k][i + j]);
            }
        for (std::size_t i = 0; i < count; i += lanes) {
            const auto fx = hn::Load(dd, t[0] + i), fy = hn::Load(dd, t[1] + i), fz = hn::Load(dd, t[2] + i);
            const auto l = hn::Sub(hn::Mul(hn::Set(dd, 116), fy), hn::Set(dd, 16));
            const auto a = hn::Mul(hn::Set(dd, 500), hn::Sub(fx, fy)), b = hn::Mul(hn::Set(dd, 200), hn::Sub(fy, fz));
            if (i + lanes <= count) {
                hn::StoreU(l, dd, lab[0] + begin + i);
                hn::StoreU(a, dd, lab[1] + begin + i);
                hn::StoreU(b, dd, lab[2] + begin + i);
                continue;
            }
            hn::Store(l, dd, t[0] + i);
            hn::Store(a, dd, t[1] + i);
            hn::Store(b, dd, t[2] + i);
            for (int k = 0; k < 3; ++k) std::copy_n(t[k] + i, count - i, lab[k] + begin + i);
        }
    }
}

void LabPlanesFloat(const GreyRow* rows, const float* const* rgb, std::size_t n, double* const* lab) {
    LabPlanes(rows, rgb, n, lab);
}
void LabPlanesDouble(const GreyRow* rows, const double* const* rgb, std::size_t n, double* const* lab) {
    LabPlanes(rows, rgb, n, lab);
}

}  // namespace spectex::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex {

HWY_EXPORT(LabPlanesFloat);
HWY_EXPORT(LabPlanesDouble);

GreyRow::GreyRow(const double* row) {
    for (int k = 1; k < 3; ++k)
        if (std::fabs(row[k]) > std::fabs(row[base])) base = k;
    first = row[base == 0 ? 1 : 0], second = row[base == 2 ? 1 : 2];
    sum = (row[0] + row[1]) + row[2];
    // Off by what rounding leaves of 1, which the coefficient of the base takes up.
    if (std::fabs(sum - 1) < 1e-13) sum = 1;
}

namespace {

std::array<GreyRow, 3> rows_of(const Matrix3& m) { return {GreyRow(&m.m[0]), GreyRow(&m.m[3]), GreyRow(&m.m[6])}; }

}  // namespace

void lab_planes(const Matrix3& to_relative, std::array<const float*, 3> rgb, std::size_t n, std::array<double*, 3> lab) {
    HWY_DYNAMIC_DISPATCH(LabPlanesFloat)(rows_of(to_relative).data(), rgb.data(), n, lab.data());
}
void lab_planes(const Matrix3& to_relative, std::array<const double*, 3> rgb, std::size_t n, std::array<double*, 3> lab) {
    HWY_DYNAMIC_DISPATCH(LabPlanesDouble)(rows_of(to_relative).data(), rgb.data(), n, lab.data());
}

}  // namespace spectex
#endif  // HWY_ONCE
