#include <algorithm>
#include <cmath>
#include <cstdint>

#include "compare/spaces.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "compare/lab_planes.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "kernels/simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// The estimate of the root passes through float, whose range this leaves with room.
constexpr double largest = 1e30;

// lab_f for t in [-largest, largest].
template <class D, class V>
HWY_INLINE V LabF(D dd, V t) {
    const hn::Rebind<float, D> df;
    const hn::Rebind<std::int32_t, D> di;
    const auto border = hn::Set(dd, (24.0 / 116) * (24.0 / 116) * (24.0 / 116));
    const auto above = hn::Gt(t, border);
    const auto x = hn::IfThenElse(above, t, hn::Set(dd, 1));
    // The inverse cube root needs no division. A third of the exponent, with the constant that halves the worst error, 3.5%;
    // each step in float (the series of (1 - e)^(-1/3) to e^2) cubes it and takes it to float's rounding.
    const auto xf = kernels::HWY_NAMESPACE::round_to_float(df, x);
    const auto third = hn::ConvertTo(di, hn::Mul(hn::ConvertTo(df, hn::BitCast(di, xf)), hn::Set(df, 1.0f / 3)));
    auto estimate = hn::BitCast(df, hn::Sub(hn::Set(di, 0x54a20000), third));
    for (int step = 0; step < 2; ++step) {
        const auto e = hn::Sub(hn::Set(df, 1), hn::Mul(xf, hn::Mul(hn::Mul(estimate, estimate), estimate)));
        estimate = hn::Add(estimate, hn::Mul(hn::Mul(estimate, e), hn::Add(hn::Set(df, 1.0f / 3), hn::Mul(hn::Set(df, 2.0f / 9), e))));
    }
    // The root itself is x r^2, and (1 - w)^(-2/3) with w = 1 - x r^3, below 1e-6, corrects it.
    const auto r = hn::PromoteTo(dd, estimate);
    const auto r2 = hn::Mul(r, r);
    const auto w = hn::Sub(hn::Set(dd, 1), hn::Mul(x, hn::Mul(r2, r)));
    const auto root = hn::Mul(x, r2);
    const auto y = hn::Add(root, hn::Mul(root, hn::Mul(w, hn::Add(hn::Set(dd, 2.0 / 3), hn::Mul(hn::Set(dd, 5.0 / 9), w)))));
    const auto line = hn::Add(hn::Mul(hn::Set(dd, 841.0 / 108), t), hn::Set(dd, 16.0 / 116));
    return hn::IfThenElse(above, y, line);
}

template <class In>
void LabPlanes(const GreyRow* rows, const In* const* rgb, std::size_t n, double* const* lab) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<In, decltype(dd)> din;
    const std::size_t lanes = hn::Lanes(dd);
    In in[3][HWY_MAX_BYTES / sizeof(double)] = {};
    double out[3][HWY_MAX_BYTES / sizeof(double)];
    for (std::size_t i = 0; i < n; i += lanes) {
        const std::size_t count = std::min(lanes, n - i);
        const In* from[3] = {rgb[0] + i, rgb[1] + i, rgb[2] + i};
        double* to[3] = {lab[0] + i, lab[1] + i, lab[2] + i};
        if (count < lanes)
            for (int k = 0; k < 3; ++k) {
                std::copy_n(from[k], count, in[k]);
                from[k] = in[k];
                to[k] = out[k];
            }
        const auto wide = [&](const In* p) HWY_ATTR {
            if constexpr (sizeof(In) == sizeof(double)) return hn::LoadU(dd, p);
            else return hn::PromoteTo(dd, hn::LoadU(din, p));
        };
        const auto r = wide(from[0]), g = wide(from[1]), b = wide(from[2]);
        const auto row = [&](int k) HWY_ATTR {
            const auto base = rows[k].base == 0 ? r : rows[k].base == 1 ? g : b;
            const auto first = rows[k].base == 0 ? g : r, second = rows[k].base == 2 ? g : b;
            return hn::Add(hn::Mul(hn::Set(dd, rows[k].sum), base),
                           hn::Add(hn::Mul(hn::Set(dd, rows[k].first), hn::Sub(first, base)),
                                   hn::Mul(hn::Set(dd, rows[k].second), hn::Sub(second, base))));
        };
        const auto x = row(0), y = row(1), z = row(2);
        const auto bound = hn::Set(dd, largest);
        const auto usual = hn::And(hn::Le(hn::Abs(x), bound), hn::And(hn::Le(hn::Abs(y), bound), hn::Le(hn::Abs(z), bound)));
        if (HWY_LIKELY(hn::AllTrue(dd, usual))) {
            const auto fx = LabF(dd, x), fy = LabF(dd, y), fz = LabF(dd, z);
            hn::StoreU(hn::Sub(hn::Mul(hn::Set(dd, 116), fy), hn::Set(dd, 16)), dd, to[0]);
            hn::StoreU(hn::Mul(hn::Set(dd, 500), hn::Sub(fx, fy)), dd, to[1]);
            hn::StoreU(hn::Mul(hn::Set(dd, 200), hn::Sub(fy, fz)), dd, to[2]);
        } else {
            // NaN, infinities and the beyond of the estimate's range; ordinary neighbours keep their ordinary way.
            double t[3][HWY_MAX_BYTES / sizeof(double)];
            double f[3][HWY_MAX_BYTES / sizeof(double)];
            const auto zero = hn::Zero(dd);
            hn::StoreU(x, dd, t[0]);
            hn::StoreU(y, dd, t[1]);
            hn::StoreU(z, dd, t[2]);
            hn::StoreU(LabF(dd, hn::IfThenElse(hn::Le(hn::Abs(x), bound), x, zero)), dd, f[0]);
            hn::StoreU(LabF(dd, hn::IfThenElse(hn::Le(hn::Abs(y), bound), y, zero)), dd, f[1]);
            hn::StoreU(LabF(dd, hn::IfThenElse(hn::Le(hn::Abs(z), bound), z, zero)), dd, f[2]);
            for (std::size_t j = 0; j < lanes; ++j) {
                Vector3 v{};
                for (std::size_t k = 0; k < 3; ++k) v[k] = std::fabs(t[k][j]) <= largest ? f[k][j] : lab_f(t[k][j]);
                v = lab_from_f(v);
                for (std::size_t k = 0; k < 3; ++k) to[k][j] = v[k];
            }
        }
        if (count < lanes)
            for (int k = 0; k < 3; ++k) std::copy_n(out[k], count, lab[k] + i);
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
