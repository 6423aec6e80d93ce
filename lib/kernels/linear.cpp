#include "kernels/linear.h"

#include <algorithm>
#include <cstring>
#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "kernels/linear.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#include "kernels/simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace spectex::kernels::HWY_NAMESPACE {

// Pixels per block: three planes of double and one of sums stay in the first-level cache. A multiple of every vector's lanes.
constexpr std::size_t block_size = 512;
static_assert(block_size >= HWY_MAX_BYTES, "a block holds whole vectors");

// Copies `count` floats and fills the rest of the last vector with zeros, so that loops need no tail of their own.
template <class T>
HWY_INLINE void load_padded(const float* src, std::size_t count, std::size_t lanes, T* out) {
    for (std::size_t i = 0; i < count; ++i) out[i] = src[i];
    for (std::size_t i = count; i % lanes != 0; ++i) out[i] = 0;
}

void Matrix(const double* m, const float* const* in, std::size_t n, float* const* out) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<float, decltype(dd)> df;
    const std::size_t lanes = hn::Lanes(dd);
    const auto m0 = hn::Set(dd, m[0]), m1 = hn::Set(dd, m[1]), m2 = hn::Set(dd, m[2]);
    const auto m3 = hn::Set(dd, m[3]), m4 = hn::Set(dd, m[4]), m5 = hn::Set(dd, m[5]);
    const auto m6 = hn::Set(dd, m[6]), m7 = hn::Set(dd, m[7]), m8 = hn::Set(dd, m[8]);
    const auto pixels = [&](const float* x, const float* y, const float* z, float* u, float* v, float* w) HWY_ATTR {
        const auto a = hn::PromoteTo(dd, hn::LoadU(df, x));
        const auto b = hn::PromoteTo(dd, hn::LoadU(df, y));
        const auto c = hn::PromoteTo(dd, hn::LoadU(df, z));
        hn::StoreU(round_to_float(df, hn::Add(hn::Add(hn::Mul(m0, a), hn::Mul(m1, b)), hn::Mul(m2, c))), df, u);
        hn::StoreU(round_to_float(df, hn::Add(hn::Add(hn::Mul(m3, a), hn::Mul(m4, b)), hn::Mul(m5, c))), df, v);
        hn::StoreU(round_to_float(df, hn::Add(hn::Add(hn::Mul(m6, a), hn::Mul(m7, b)), hn::Mul(m8, c))), df, w);
    };
    std::size_t i = 0;
    for (; i + lanes <= n; i += lanes) pixels(in[0] + i, in[1] + i, in[2] + i, out[0] + i, out[1] + i, out[2] + i);
    if (i < n) {
        float last[3][HWY_MAX_BYTES / sizeof(double)];
        for (int k = 0; k < 3; ++k) load_padded(in[k] + i, n - i, lanes, last[k]);
        pixels(last[0], last[1], last[2], last[0], last[1], last[2]);
        for (int k = 0; k < 3; ++k) std::memcpy(out[k] + i, last[k], (n - i) * sizeof(float));
    }
}

void CombineFloat(const float* const* rgb, std::size_t n, const double* basis, std::size_t bands, std::size_t band_begin,
                  std::size_t band_end, float* const* planes) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<float, decltype(dd)> df;
    const std::size_t lanes = hn::Lanes(dd);
    HWY_ALIGN double wide[3][block_size];
    float last[HWY_MAX_BYTES / sizeof(double)];
    for (std::size_t begin = 0; begin < n; begin += block_size) {
        const std::size_t count = std::min(block_size, n - begin);
        for (int k = 0; k < 3; ++k) load_padded(rgb[k] + begin, count, lanes, wide[k]);
        for (std::size_t band = band_begin; band < band_end; ++band) {
            const auto r = hn::Set(dd, basis[band]);
            const auto g = hn::Set(dd, basis[bands + band]);
            const auto b = hn::Set(dd, basis[2 * bands + band]);
            float* out = planes[band - band_begin] + begin;
            const auto sum = [&](std::size_t i) HWY_ATTR {
                return round_to_float(df, hn::Add(hn::Add(hn::Mul(r, hn::Load(dd, wide[0] + i)),
                                                          hn::Mul(g, hn::Load(dd, wide[1] + i))),
                                                  hn::Mul(b, hn::Load(dd, wide[2] + i))));
            };
            std::size_t i = 0;
            for (; i + lanes <= count; i += lanes) hn::StoreU(sum(i), df, out + i);
            if (i < count) {
                hn::StoreU(sum(i), df, last);
                std::memcpy(out + i, last, (count - i) * sizeof(float));
            }
        }
    }
}

void CombineHalf(const float* const* rgb, std::size_t n, const double* basis, std::size_t bands, std::size_t band_begin,
                 std::size_t band_end, std::uint16_t* const* planes) {
    const hn::ScalableTag<float> df;
    const hn::Rebind<std::uint16_t, decltype(df)> d16;
    const std::size_t lanes = hn::Lanes(df);
    HWY_ALIGN float in[3][block_size];
    std::uint16_t last[HWY_MAX_BYTES / sizeof(float)];
    for (std::size_t begin = 0; begin < n; begin += block_size) {
        const std::size_t count = std::min(block_size, n - begin);
        for (int k = 0; k < 3; ++k) load_padded(rgb[k] + begin, count, lanes, in[k]);
        for (std::size_t band = band_begin; band < band_end; ++band) {
            const auto r = hn::Set(df, static_cast<float>(basis[band]));
            const auto g = hn::Set(df, static_cast<float>(basis[bands + band]));
            const auto b = hn::Set(df, static_cast<float>(basis[2 * bands + band]));
            std::uint16_t* out = planes[band - band_begin] + begin;
            const auto sum = [&](std::size_t i) HWY_ATTR {
                return round_to_half(df, hn::Add(hn::Add(hn::Mul(r, hn::Load(df, in[0] + i)),
                                                         hn::Mul(g, hn::Load(df, in[1] + i))),
                                                 hn::Mul(b, hn::Load(df, in[2] + i))));
            };
            std::size_t i = 0;
            for (; i + lanes <= count; i += lanes) hn::StoreU(sum(i), d16, out + i);
            if (i < count) {
                hn::StoreU(sum(i), d16, last);
                std::memcpy(out + i, last, (count - i) * sizeof(std::uint16_t));
            }
        }
    }
}

template <class Out>
void Integrate(const float* const* planes, std::size_t bands, std::size_t n, const double* weights, std::size_t rows,
               Out* const* out) {
    const hn::ScalableTag<double> dd;
    const hn::Rebind<float, decltype(dd)> df;
    const std::size_t lanes = hn::Lanes(dd);
    // Rows that share a pass over the bands, and bands whose terms are added before a sum goes back to memory.
    constexpr std::size_t row_group = 3, band_group = 4;
    HWY_ALIGN double sums[row_group][block_size];
    HWY_ALIGN float tail[band_group][block_size];
    for (std::size_t begin = 0; begin < n; begin += block_size) {
        const std::size_t count = std::min(block_size, n - begin);
        const bool padded = count % lanes != 0;
        for (std::size_t row = 0; row < rows; row += row_group) {
            const std::size_t group = std::min(row_group, rows - row);
            for (std::size_t j = 0; j < group; ++j) std::fill_n(sums[j], block_size, 0.0);
            for (std::size_t band = 0; band < bands;) {
                const float* source[band_group];
                std::size_t index[band_group];
                std::size_t taken = 0;
                for (; band < bands && taken < band_group; ++band) {
                    if (planes[band] == nullptr) continue;
                    source[taken] = planes[band] + begin;
                    if (padded) {
                        load_padded(source[taken], count, lanes, tail[taken]);
                        source[taken] = tail[taken];
                    }
                    index[taken++] = band;
                }
                for (std::size_t j = 0; j < group; ++j) {
                    const double* w = weights + (row + j) * bands;
                    double* sum = sums[j];
                    if (taken == band_group) {
                        const auto w0 = hn::Set(dd, w[index[0]]), w1 = hn::Set(dd, w[index[1]]);
                        const auto w2 = hn::Set(dd, w[index[2]]), w3 = hn::Set(dd, w[index[3]]);
                        for (std::size_t i = 0; i < count; i += lanes) {
                            auto s = hn::Load(dd, sum + i);
                            s = hn::Add(s, hn::Mul(w0, hn::PromoteTo(dd, hn::LoadU(df, source[0] + i))));
                            s = hn::Add(s, hn::Mul(w1, hn::PromoteTo(dd, hn::LoadU(df, source[1] + i))));
                            s = hn::Add(s, hn::Mul(w2, hn::PromoteTo(dd, hn::LoadU(df, source[2] + i))));
                            s = hn::Add(s, hn::Mul(w3, hn::PromoteTo(dd, hn::LoadU(df, source[3] + i))));
                            hn::Store(s, dd, sum + i);
                        }
                    } else {
                        for (std::size_t k = 0; k < taken; ++k) {
                            const auto weight = hn::Set(dd, w[index[k]]);
                            for (std::size_t i = 0; i < count; i += lanes) {
                                const auto term = hn::Mul(weight, hn::PromoteTo(dd, hn::LoadU(df, source[k] + i)));
                                hn::Store(hn::Add(hn::Load(dd, sum + i), term), dd, sum + i);
                            }
                        }
                    }
                }
            }
            for (std::size_t j = 0; j < group; ++j) {
                Out* to = out[row + j] + begin;
                for (std::size_t i = 0; i < count; ++i) to[i] = static_cast<Out>(sums[j][i]);
            }
        }
    }
}

void IntegrateFloat(const float* const* planes, std::size_t bands, std::size_t n, const double* weights, std::size_t rows,
                    float* const* out) {
    Integrate(planes, bands, n, weights, rows, out);
}
void IntegrateDouble(const float* const* planes, std::size_t bands, std::size_t n, const double* weights, std::size_t rows,
                     double* const* out) {
    Integrate(planes, bands, n, weights, rows, out);
}

}  // namespace spectex::kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace spectex::kernels {

HWY_EXPORT(Matrix);
HWY_EXPORT(CombineFloat);
HWY_EXPORT(CombineHalf);
HWY_EXPORT(IntegrateFloat);
HWY_EXPORT(IntegrateDouble);

void matrix3(const Matrix3& m, std::array<const float*, 3> in, std::size_t n, std::array<float*, 3> out) {
    HWY_DYNAMIC_DISPATCH(Matrix)(m.m.data(), in.data(), n, out.data());
}
void matrix3_reference(const Matrix3& m, std::array<const float*, 3> in, std::size_t n, std::array<float*, 3> out) {
    for (std::size_t i = 0; i < n; ++i) {
        const Vector3 v = m * Vector3{in[0][i], in[1][i], in[2][i]};
        for (std::size_t k = 0; k < 3; ++k) out[k][i] = static_cast<float>(v[k]);
    }
}

void combine_basis(std::array<const float*, 3> rgb, std::size_t n, std::span<const double> basis, std::size_t band_begin,
                   std::size_t band_end, float* const* planes) {
    HWY_DYNAMIC_DISPATCH(CombineFloat)(rgb.data(), n, basis.data(), basis.size() / 3, band_begin, band_end, planes);
}
void combine_basis(std::array<const float*, 3> rgb, std::size_t n, std::span<const double> basis, std::size_t band_begin,
                   std::size_t band_end, std::uint16_t* const* planes) {
    HWY_DYNAMIC_DISPATCH(CombineHalf)(rgb.data(), n, basis.data(), basis.size() / 3, band_begin, band_end, planes);
}
void combine_basis_reference(std::array<const float*, 3> rgb, std::size_t n, std::span<const double> basis,
                             std::size_t band_begin, std::size_t band_end, float* const* planes) {
    const std::size_t bands = basis.size() / 3;
    for (std::size_t band = band_begin; band < band_end; ++band)
        for (std::size_t i = 0; i < n; ++i)
            planes[band - band_begin][i] = static_cast<float>(
                basis[band] * rgb[0][i] + basis[bands + band] * rgb[1][i] + basis[2 * bands + band] * rgb[2][i]);
}

void integrate_bands(std::span<const float* const> bands, std::size_t n, std::span<const double> weights, std::size_t rows,
                     float* const* out) {
    HWY_DYNAMIC_DISPATCH(IntegrateFloat)(bands.data(), bands.size(), n, weights.data(), rows, out);
}
void integrate_bands(std::span<const float* const> bands, std::size_t n, std::span<const double> weights, std::size_t rows,
                     double* const* out) {
    HWY_DYNAMIC_DISPATCH(IntegrateDouble)(bands.data(), bands.size(), n, weights.data(), rows, out);
}
void integrate_bands_reference(std::span<const float* const> bands, std::size_t n, std::span<const double> weights,
                               std::size_t rows, double* const* out) {
    for (std::size_t row = 0; row < rows; ++row)
        for (std::size_t i = 0; i < n; ++i) {
            double sum = 0;
            for (std::size_t band = 0; band < bands.size(); ++band)
                if (bands[band] != nullptr) sum += weights[row * bands.size() + band] * bands[band][i];
            out[row][i] = sum;
        }
}

}  // namespace spectex::kernels
#endif  // HWY_ONCE
