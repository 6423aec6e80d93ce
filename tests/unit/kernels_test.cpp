// Every kernel on every instruction set of this machine against its plain double reference. Most must agree bit for bit:
// they do the same operations in the same order, without fused multiply-add, and round once.
#include <gtest/gtest.h>
#include <hwy/highway.h>
#include <hwy/targets.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "kernels/convert.h"
#include "kernels/lattice.h"
#include "kernels/linear.h"
#include "kernels/mantissa.h"
#include "kernels/spectra.h"

namespace {

using namespace spectex;
namespace k = spectex::kernels;

// Runs a check on each target in turn; restores the machine's own choice.
template <class F>
void on_every_target(F check) {
    const std::int64_t all = hwy::SupportedTargets() & HWY_TARGETS;
    int seen = 0;
    for (std::int64_t left = all; left != 0; left &= left - 1) {
        const std::int64_t target = left & -left;
        hwy::SetSupportedTargetsForTest(target);
        hwy::GetChosenTarget().Update(target);
        SCOPED_TRACE(hwy::TargetName(target));
        check();
        ++seen;
    }
    hwy::SetSupportedTargetsForTest(0);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    EXPECT_GE(seen, 1);
}

constexpr float inf = std::numeric_limits<float>::infinity();
constexpr float nan = std::numeric_limits<float>::quiet_NaN();

// Sizes around every vector width and block, and starts that align to nothing wider than a sample.
const std::size_t sizes[] = {0, 1, 2, 3, 5, 7, 8, 15, 16, 17, 31, 33, 63, 64, 65, 511, 512, 513, 1000, 4099};
const std::size_t starts[] = {0, 1, 3};

std::vector<float> random_floats(std::size_t n, unsigned seed, float low = 0, float high = 1) {
    std::mt19937 engine(seed);
    std::uniform_real_distribution<float> uniform(low, high);
    std::vector<float> v(n);
    for (float& x : v) x = uniform(engine);
    return v;
}

bool same_bytes(float a, float b) { return std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b); }
bool same(double a, double b) {
    return (std::isnan(a) && std::isnan(b)) || std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b);
}

TEST(Convert, every_half_widens_exactly) {
    std::vector<std::uint16_t> halves(65536);
    for (std::size_t i = 0; i < halves.size(); ++i) halves[i] = static_cast<std::uint16_t>(i);
    std::vector<float> expected(65536), got(65536);
    k::half_to_float_reference(halves.data(), 1, 65536, expected.data());
    EXPECT_EQ(expected[0x3c00], 1.0f);
    EXPECT_EQ(expected[0x0001], 0x1p-24f);
    EXPECT_EQ(expected[0x7bff], 65504.0f);
    EXPECT_EQ(expected[0xfc00], -inf);
    on_every_target([&] {
        k::half_to_float(halves.data(), 1, 65536, got.data());
        for (std::size_t i = 0; i < 65536; ++i) ASSERT_TRUE(same_bytes(got[i], expected[i])) << std::hex << i;
    });
}

TEST(Convert, every_half_survives_the_way_through_float) {
    std::vector<std::uint16_t> halves(65536), back(65536);
    std::vector<float> wide(65536);
    for (std::size_t i = 0; i < halves.size(); ++i) halves[i] = static_cast<std::uint16_t>(i);
    on_every_target([&] {
        k::half_to_float(halves.data(), 1, 65536, wide.data());
        EXPECT_EQ(k::float_to_half(wide.data(), 65536, back.data(), 1), 0u);
        for (std::size_t i = 0; i < 65536; ++i) {
            const bool is_nan = (i & 0x7fff) > 0x7c00;
            ASSERT_EQ(back[i], is_nan ? i | 0x200 : i);
        }
    });
}

// The floats where rounding decides: each half, each midpoint between halves, and both neighbours of either.
TEST(Convert, halves_round_to_nearest_even_at_every_midpoint) {
    std::vector<float> values;
    std::vector<std::uint16_t> expected;
    for (std::uint32_t code = 0; code < 0x7c00; ++code) {
        const auto value = [](std::uint32_t c) {
            return c >= 0x400 ? std::ldexp(1024.0 + (c & 0x3ff), static_cast<int>(c >> 10) - 25) : std::ldexp(c, -24);
        };
        const float here = static_cast<float>(value(code));
        const float middle = static_cast<float>((value(code) + value(code + 1)) / 2);
        const std::uint32_t even = code + (code & 1);
        const std::pair<float, std::uint32_t> cases[] = {
            {here, code}, {std::nextafter(here, inf), code}, {std::nextafter(middle, 0.0f), code}, {middle, even},
            {std::nextafter(middle, inf), code + 1}};
        for (const auto& [v, c] : cases)
            for (const std::uint32_t sign : {0u, 0x8000u}) {
                values.push_back(sign ? -v : v);
                expected.push_back(static_cast<std::uint16_t>(c | sign));
            }
    }
    for (const float v : {inf, 1e30f, 65536.0f, 65520.0f, std::numeric_limits<float>::max()}) {
        values.push_back(v);
        expected.push_back(0x7c00);
    }
    std::size_t finite_overflows = 0;
    for (std::size_t i = 0; i < values.size(); ++i)
        finite_overflows += std::isfinite(values[i]) && (expected[i] & 0x7fff) == 0x7c00;
    std::vector<std::uint16_t> got(values.size());
    on_every_target([&] {
        EXPECT_EQ(k::float_to_half(values.data(), values.size(), got.data(), 1), finite_overflows);
        for (std::size_t i = 0; i < values.size(); ++i) ASSERT_EQ(got[i], expected[i]) << std::hexfloat << values[i];
    });
    EXPECT_EQ(k::float_to_half_reference(values.data(), values.size(), got.data(), 1), finite_overflows);
    EXPECT_EQ(got, expected);
}

TEST(Convert, halves_of_ten_million_random_bit_patterns) {
    std::mt19937 engine(1);
    std::vector<float> values(1 << 20);
    std::vector<std::uint16_t> expected(values.size()), got(values.size());
    for (int round = 0; round < 10; ++round) {
        for (float& v : values) v = std::bit_cast<float>(static_cast<std::uint32_t>(engine()));
        const std::size_t lost = k::float_to_half_reference(values.data(), values.size(), expected.data(), 1);
        on_every_target([&] {
            EXPECT_EQ(k::float_to_half(values.data(), values.size(), got.data(), 1), lost);
            ASSERT_EQ(std::memcmp(got.data(), expected.data(), got.size() * 2), 0);
        });
    }
}

TEST(Convert, strides_sizes_and_starts) {
    const auto src = random_floats(3 * 4200, 2, -0.2f, 1.2f);
    std::vector<std::uint16_t> halves(src.size());
    k::float_to_half_reference(src.data(), src.size(), halves.data(), 1);
    on_every_target([&] {
        for (const std::size_t n : sizes)
            for (const std::size_t start : starts)
                for (const std::size_t stride : {1u, 2u, 3u}) {
                    if (start + n * stride > src.size()) continue;
                    // One guard sample past the end and the gaps between samples must stay.
                    std::vector<std::uint16_t> out16(start + n * stride + 1, 42), ref16 = out16;
                    std::vector<std::uint8_t> out8(start + n * stride + 1, 42), ref8 = out8;
                    std::vector<float> wide(start + n + 1, 42), wide_ref = wide;
                    EXPECT_EQ(k::float_to_half(src.data() + start, n, out16.data() + start, stride),
                              k::float_to_half_reference(src.data() + start, n, ref16.data() + start, stride));
                    ASSERT_EQ(out16, ref16);
                    EXPECT_EQ(k::quantize(src.data() + start, n, out16.data() + start, stride),
                              k::quantize_reference(src.data() + start, n, ref16.data() + start, stride));
                    ASSERT_EQ(out16, ref16);
                    EXPECT_EQ(k::quantize(src.data() + start, n, out8.data() + start, stride),
                              k::quantize_reference(src.data() + start, n, ref8.data() + start, stride));
                    ASSERT_EQ(out8, ref8);
                    k::half_to_float(halves.data() + start, stride, n, wide.data() + start);
                    k::half_to_float_reference(halves.data() + start, stride, n, wide_ref.data() + start);
                    ASSERT_EQ(wide, wide_ref);
                    k::gather_floats(src.data() + start, stride, n, wide.data() + start);
                    for (std::size_t i = 0; i < n; ++i) ASSERT_EQ(wide[start + i], src[start + i * stride]);
                    ASSERT_EQ(wide.back(), 42);
                    std::vector<float> spread(start + n * stride + 1, 42);
                    k::scatter_floats(src.data() + start, n, spread.data() + start, stride);
                    for (std::size_t i = start; i + 1 < spread.size(); ++i)
                        ASSERT_EQ(spread[i], (i - start) % stride == 0 ? src[start + (i - start) / stride] : 42);
                    ASSERT_EQ(spread.back(), 42);
                }
    });
}

TEST(Convert, codes_decode_through_their_table) {
    std::vector<float> table(65536);
    for (std::size_t i = 0; i < table.size(); ++i) table[i] = static_cast<float>(i) * 0.5f;
    const std::vector<std::uint8_t> bytes{9, 0, 8, 255, 7, 128};
    const std::vector<std::uint16_t> words{9, 0, 8, 65535, 7, 128};
    std::vector<float> out(3);
    k::decode_codes(bytes.data() + 1, 2, 3, table.data(), out.data());
    EXPECT_EQ(out, (std::vector<float>{0, 127.5f, 64}));
    k::decode_codes(words.data() + 1, 2, 3, table.data(), out.data());
    EXPECT_EQ(out, (std::vector<float>{0, 32767.5f, 64}));
}

TEST(Convert, codes_round_to_nearest_and_clip) {
    // Halfway between codes 0 and 1 of 255 no float lies; the floats on either side do not tie.
    const float half_code = 0.5f / 255;
    const std::vector<float> src{0,    1, 1.0001f, 1.01f, -0.001f, -0.01f, nan, inf, -inf, std::nextafter(half_code, 0.0f) * 0.999f,
                                 std::nextafter(half_code, 1.0f) * 1.001f, 128 / 255.0f};
    const std::vector<std::uint8_t> expected{0, 255, 255, 255, 0, 0, 0, 255, 0, 0, 1, 128};
    std::vector<std::uint8_t> got(src.size());
    on_every_target([&] {
        EXPECT_EQ(k::quantize(src.data(), src.size(), got.data(), 1), 5u);
        EXPECT_EQ(got, expected);
    });
    std::vector<float> every(65536);
    std::vector<std::uint16_t> codes(65536);
    for (std::size_t i = 0; i < every.size(); ++i) every[i] = static_cast<float>(i) / 65535;
    on_every_target([&] {
        EXPECT_EQ(k::quantize(every.data(), every.size(), codes.data(), 1), 0u);
        for (std::size_t i = 0; i < every.size(); ++i) ASSERT_EQ(codes[i], i);
    });
}

TEST(Linear, matrix_agrees_bit_for_bit_and_with_long_double) {
    const Matrix3 m{{0.4123907992659593, 0.357584339383878, 0.1804807884018343, 0.2126390058715102, 0.715168678767756,
                     0.0721923153607337, -0.0193308187155918, 0.119194779794626, 0.9505321522496607}};
    std::vector<float> in[3];
    for (unsigned c = 0; c < 3; ++c) {
        in[c] = random_floats(4200, 10 + c, -0.5f, 2);
        in[c][7] = inf;
        in[c][8] = nan;
        in[c][9] = std::numeric_limits<float>::max();
    }
    on_every_target([&] {
        for (const std::size_t n : sizes)
            for (const std::size_t start : starts) {
                std::vector<float> out[3], ref[3];
                for (int c = 0; c < 3; ++c) out[c] = ref[c] = std::vector<float>(n + start + 1, 42);
                const std::array<const float*, 3> from{in[0].data() + start, in[1].data() + start, in[2].data() + start};
                k::matrix3(m, from, n, {out[0].data() + start, out[1].data() + start, out[2].data() + start});
                k::matrix3_reference(m, from, n, {ref[0].data() + start, ref[1].data() + start, ref[2].data() + start});
                for (int c = 0; c < 3; ++c)
                    for (std::size_t i = 0; i < out[c].size(); ++i) ASSERT_TRUE(same(out[c][i], ref[c][i])) << n << " " << i;
            }
        // In place, and against long double: one rounding to float after a double sum that is good to 4 * 2^-53 of the
        // sum of magnitudes.
        std::vector<float> plane[3] = {in[0], in[1], in[2]};
        k::matrix3(m, {plane[0].data(), plane[1].data(), plane[2].data()}, 4200,
                   {plane[0].data(), plane[1].data(), plane[2].data()});
        for (std::size_t i = 10; i < 4200; ++i)
            for (std::size_t row = 0; row < 3; ++row) {
                long double sum = 0, magnitude = 0;
                for (std::size_t c = 0; c < 3; ++c) {
                    sum += static_cast<long double>(m(row, c)) * in[c][i];
                    magnitude += std::fabs(static_cast<long double>(m(row, c)) * in[c][i]);
                }
                ASSERT_LE(std::fabs(plane[row][i] - sum), 0x1p-24L * std::fabs(sum) + 0x1p-50L * magnitude);
            }
    });
}

// What cancels must cancel to nothing: a fused multiply-add would leave the product's rounding behind on some machines.
TEST(Linear, nothing_is_fused) {
    const double third = 1.0 / 3;
    const Matrix3 m{{third, -third, 0, 0, third, -third, third, 0, -third}};
    const auto grey = random_floats(1001, 15);
    std::vector<float> out[3];
    for (auto& o : out) o.resize(grey.size());
    const std::vector<double> basis{third, -third, 0, -third, third, 0, 0, 0, 0};
    std::vector<double> sum(grey.size());
    on_every_target([&] {
        k::matrix3(m, {grey.data(), grey.data(), grey.data()}, grey.size(), {out[0].data(), out[1].data(), out[2].data()});
        for (const auto& o : out) ASSERT_EQ(o, std::vector<float>(grey.size(), 0.0f));
        float* planes[] = {out[0].data(), out[1].data(), out[2].data()};
        k::combine_basis({grey.data(), grey.data(), grey.data()}, grey.size(), basis, 0, 3, planes);
        for (const auto& o : out) ASSERT_EQ(o, std::vector<float>(grey.size(), 0.0f));
        const float* bands[] = {grey.data(), grey.data()};
        double* to = sum.data();
        k::integrate_bands(bands, grey.size(), std::vector<double>{third, -third}, 1, &to);
        ASSERT_EQ(sum, std::vector<double>(grey.size(), 0.0));
    });
}

std::vector<double> random_doubles(std::size_t n, unsigned seed, double low, double high) {
    std::mt19937_64 engine(seed);
    std::uniform_real_distribution<double> uniform(low, high);
    std::vector<double> v(n);
    for (double& x : v) x = uniform(engine);
    return v;
}

TEST(Linear, combined_bands_agree) {
    constexpr std::size_t bands = 11, begin = 2, end = 9, taken = end - begin;
    const auto basis = random_doubles(3 * bands, 20, 0, 1);
    const std::vector<float> rgb[3] = {random_floats(4200, 21), random_floats(4200, 22), random_floats(4200, 23)};
    on_every_target([&] {
        for (const std::size_t n : sizes)
            for (const std::size_t start : starts) {
                const std::array<const float*, 3> in{rgb[0].data() + start, rgb[1].data() + start, rgb[2].data() + start};
                std::vector<std::vector<float>> out(taken, std::vector<float>(n + start + 1, 42)), ref = out;
                std::vector<std::vector<std::uint16_t>> half(taken, std::vector<std::uint16_t>(n + start + 1, 42));
                std::vector<float*> to, to_ref;
                std::vector<std::uint16_t*> to_half;
                for (std::size_t b = 0; b < taken; ++b) {
                    to.push_back(out[b].data() + start);
                    to_ref.push_back(ref[b].data() + start);
                    to_half.push_back(half[b].data() + start);
                }
                k::combine_basis(in, n, basis, begin, end, to.data());
                k::combine_basis_reference(in, n, basis, begin, end, to_ref.data());
                k::combine_basis(in, n, basis, begin, end, to_half.data());
                ASSERT_EQ(out, ref);
                for (std::size_t b = 0; b < taken; ++b) {
                    ASSERT_EQ(half[b].back(), 42);
                    for (std::size_t i = 0; i < n; ++i) {
                        double sum = 0;
                        for (std::size_t c = 0; c < 3; ++c) sum += basis[c * bands + begin + b] * rgb[c][start + i];
                        float wide;
                        k::half_to_float_reference(&half[b][start + i], 1, 1, &wide);
                        // Half a unit in the last place of a half, and the float sum's own error.
                        const double unit = std::ldexp(1.0, std::max(std::ilogb(sum), -14) - 10);
                        ASSERT_LE(std::fabs(wide - sum), unit / 2 + 4 * 0x1p-24 * sum);
                    }
                }
            }
    });
}

TEST(Linear, combined_halves_have_the_same_bytes_on_every_target) {
    constexpr std::size_t bands = 36, n = 20011;
    const auto basis = random_doubles(3 * bands, 24, -0.01, 1);
    const std::vector<float> rgb[3] = {random_floats(n, 25, -0.1f, 1), random_floats(n, 26), random_floats(n, 27)};
    std::vector<std::uint16_t> first;
    on_every_target([&] {
        std::vector<std::uint16_t> out(bands * n);
        std::vector<std::uint16_t*> planes;
        for (std::size_t b = 0; b < bands; ++b) planes.push_back(out.data() + b * n);
        k::combine_basis({rgb[0].data(), rgb[1].data(), rgb[2].data()}, n, basis, 0, bands, planes.data());
        if (first.empty()) first = out;
        ASSERT_EQ(out, first);
    });
}

TEST(Linear, integrals_agree_bit_for_bit_and_with_long_double) {
    for (const std::size_t bands : {1u, 3u, 4u, 7u, 36u, 81u})
        for (const std::size_t rows : {1u, 3u, 7u}) {
            const auto weights = random_doubles(rows * bands, 30, -0.1, 1);
            std::vector<std::vector<float>> planes;
            for (std::size_t b = 0; b < bands; ++b) planes.push_back(random_floats(1100, static_cast<unsigned>(31 + b)));
            on_every_target([&] {
                for (const std::size_t n : {0u, 1u, 5u, 512u, 1031u})
                    for (const std::size_t start : starts) {
                        std::vector<const float*> in;
                        for (const auto& p : planes) in.push_back(p.data() + start);
                        if (bands > 4) in[2] = nullptr;
                        std::vector<std::vector<float>> out(rows, std::vector<float>(n + start + 1, 42));
                        std::vector<std::vector<double>> wide(rows, std::vector<double>(n + start + 1, 42)), ref = wide;
                        std::vector<float*> to;
                        std::vector<double*> to_wide, to_ref;
                        for (std::size_t j = 0; j < rows; ++j) {
                            to.push_back(out[j].data() + start);
                            to_wide.push_back(wide[j].data() + start);
                            to_ref.push_back(ref[j].data() + start);
                        }
                        k::integrate_bands(in, n, weights, rows, to.data());
                        k::integrate_bands(in, n, weights, rows, to_wide.data());
                        k::integrate_bands_reference(in, n, weights, rows, to_ref.data());
                        ASSERT_EQ(wide, ref);
                        for (std::size_t j = 0; j < rows; ++j)
                            for (std::size_t i = 0; i < out[j].size(); ++i)
                                ASSERT_EQ(out[j][i], static_cast<float>(ref[j][i]));
                        for (std::size_t j = 0; j < rows; ++j)
                            for (std::size_t i = 0; i < n; ++i) {
                                long double sum = 0, magnitude = 0;
                                for (std::size_t b = 0; b < bands; ++b) {
                                    if (in[b] == nullptr) continue;
                                    const long double term = static_cast<long double>(weights[j * bands + b]) * in[b][i];
                                    sum += term;
                                    magnitude += std::fabs(term);
                                }
                                // A rounding per product and per sum.
                                ASSERT_LE(std::fabs(wide[j][start + i] - sum),
                                          static_cast<long double>(bands + 1) * 0x1p-53L * magnitude);
                            }
                    }
            });
        }
}

LatticeTable random_table(std::array<std::size_t, 3> sizes_of, std::size_t values, bool uniform, unsigned seed) {
    LatticeTable t;
    std::mt19937_64 engine(seed);
    std::uniform_real_distribution<double> jitter(-0.3, 0.3);
    for (std::size_t a = 0; a < 3; ++a)
        for (std::size_t i = 0; i < sizes_of[a]; ++i) {
            const bool inner = i > 0 && i + 1 < sizes_of[a];
            t.knots[a].push_back((static_cast<double>(i) + (inner && !uniform ? jitter(engine) : 0)) /
                                 static_cast<double>(sizes_of[a] - 1));
        }
    t.values = values;
    t.vertices = random_doubles(sizes_of[0] * sizes_of[1] * sizes_of[2] * values, seed + 1, 0, 1);
    return t;
}

TEST(Spectra, halves_cancel_their_errors_with_the_same_bytes_on_every_target) {
    // Three bell-shaped weights, as a sensing matrix has.
    const std::size_t bands = 41;
    std::vector<double> weights(3 * bands);
    for (std::size_t b = 0; b < bands; ++b)
        for (std::size_t c = 0; c < 3; ++c) {
            const double d = (static_cast<double>(b) - (30.0 - 10.0 * static_cast<double>(c))) / 5;
            weights[c * bands + b] = 0.3 * std::exp(-d * d) - (c == 1 ? 0.01 * std::exp(-d * d / 4) : 0);
        }
    const k::HalfSpectraRounder rounder(weights, bands);
    for (const std::size_t n : {std::size_t{1}, std::size_t{17}, std::size_t{4099}}) {
        std::vector<std::vector<float>> in;
        for (std::size_t b = 0; b < bands; ++b) in.push_back(random_floats(n, static_cast<unsigned>(b + 7)));
        in[3][0] = 1;
        in[4][0] = 0;
        std::vector<const float*> planes;
        for (const auto& plane : in) planes.push_back(plane.data());
        std::vector<std::vector<std::uint16_t>> expected(bands, std::vector<std::uint16_t>(n)), got = expected;
        const auto pointers = [](std::vector<std::vector<std::uint16_t>>& v) {
            std::vector<std::uint16_t*> p;
            for (auto& plane : v) p.push_back(plane.data());
            return p;
        };
        rounder.reference(planes.data(), n, pointers(expected).data());
        on_every_target([&] {
            rounder(planes.data(), n, pointers(got).data());
            EXPECT_EQ(got, expected);
        });
        double diffused = 0, nearest = 0;
        for (std::size_t i = 0; i < n; ++i) {
            double loss = 0, plain_loss = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                double integral = 0, a = 0, b = 0;
                for (std::size_t band = 0; band < bands; ++band) {
                    float stored = 0, plain = 0;
                    std::uint16_t half = 0;
                    k::half_to_float(&expected[band][i], 1, 1, &stored);
                    k::float_to_half(&in[band][i], 1, &half, 1);
                    k::half_to_float(&half, 1, 1, &plain);
                    integral += weights[c * bands + band] * in[band][i];
                    a += weights[c * bands + band] * (stored - in[band][i]);
                    b += weights[c * bands + band] * (plain - in[band][i]);
                    // Asked-for correction and rounding, an ulp and a half of at most 2^-10 relative each.
                    EXPECT_LE(std::fabs(stored - in[band][i]), 1.5f * 0x1p-10f * in[band][i] + 0x1p-24f);
                    EXPECT_LE(stored, 1.0f);
                }
                loss += a * a / (std::fabs(integral) + 0.2);
                plain_loss += b * b / (std::fabs(integral) + 0.2);
            }
            diffused = std::max(diffused, loss);
            nearest = std::max(nearest, plain_loss);
        }
        // The bound below which a pixel keeps its plain rounding, and a percent for the float in which it is judged.
        EXPECT_LE(diffused, 1.6e-8 * 1.01);
        if (n > 1000) {
            EXPECT_GT(nearest, 3 * 1.6e-8);  // or the sample would show nothing
        }
    }
}

TEST(Lattice, agrees_bit_for_bit_with_the_reference) {
    std::vector<float> rgb[3] = {random_floats(4200, 40, -0.05f, 1.05f), random_floats(4200, 41), random_floats(4200, 42)};
    for (std::size_t i = 0; i < 4200; i += 5) rgb[1][i] = rgb[0][i];  // ties between positions, as greys have
    for (std::size_t i = 0; i < 4200; i += 10) rgb[2][i] = rgb[0][i];
    rgb[0][11] = nan;
    rgb[1][12] = inf;
    rgb[2][13] = -inf;
    for (const bool uniform : {true, false})
        for (const std::size_t values : {1u, 3u, 14u}) {
            const auto table = random_table(uniform ? std::array<std::size_t, 3>{9, 9, 9} : std::array<std::size_t, 3>{2, 5, 9},
                                            values, uniform, 50);
            const k::LatticeKernel kernel(table);
            on_every_target([&] {
                for (const std::size_t n : sizes)
                    for (const std::size_t start : starts) {
                        const std::array<const float*, 3> in{rgb[0].data() + start, rgb[1].data() + start,
                                                             rgb[2].data() + start};
                        std::vector<std::vector<float>> out(values, std::vector<float>(n + start + 1, 42));
                        std::vector<std::vector<double>> wide(values, std::vector<double>(n + start + 1, 42)), ref = wide;
                        std::vector<float*> to;
                        std::vector<double*> to_wide, to_ref;
                        for (std::size_t v = 0; v < values; ++v) {
                            to.push_back(out[v].data() + start);
                            to_wide.push_back(wide[v].data() + start);
                            to_ref.push_back(ref[v].data() + start);
                        }
                        if (values > 3) to[3] = nullptr;
                        kernel(in, n, to.data());
                        kernel(in, n, to_wide.data());
                        kernel.reference(in, n, to_ref.data());
                        ASSERT_EQ(wide, ref);
                        for (std::size_t v = 0; v < values; ++v)
                            for (std::size_t i = 0; i < out[v].size(); ++i)
                                ASSERT_EQ(out[v][i], to[v] == nullptr ? 42 : static_cast<float>(ref[v][i]));
                    }
            });
        }
}

// What the subdivision promises, without the reference: vertices are met, linear functions are reproduced, cells join.
TEST(Lattice, meets_vertices_and_reproduces_linear_functions) {
    for (const bool uniform : {true, false}) {
        auto table = random_table({5, 5, 3}, 3, uniform, 60);
        const k::LatticeKernel kernel(table);
        std::vector<float> r, g, b;
        for (const double x : table.knots[0])
            for (const double y : table.knots[1])
                for (const double z : table.knots[2]) {
                    r.push_back(static_cast<float>(x));
                    g.push_back(static_cast<float>(y));
                    b.push_back(static_cast<float>(z));
                }
        std::vector<double> out[3];
        for (auto& o : out) o.resize(r.size());
        double* planes[] = {out[0].data(), out[1].data(), out[2].data()};
        kernel({r.data(), g.data(), b.data()}, r.size(), planes);
        // A knot that no float equals is off by 2^-25, times the cells per unit and the steepest slope, 1 per cell.
        for (std::size_t i = 0; i < r.size(); ++i)
            for (std::size_t v = 0; v < 3; ++v)
                EXPECT_NEAR(out[v][i], table.vertices[i * 3 + v], uniform ? 1e-15 : 3 * 0x1p-25 * 12);
        std::size_t at = 0;
        for (const double x : table.knots[0])
            for (const double y : table.knots[1])
                for (const double z : table.knots[2]) {
                    table.vertices[at++] = 0.2 * x + 0.3 * y + 0.5 * z;
                    table.vertices[at++] = x;
                    table.vertices[at++] = 1;
                }
        const std::vector<float> in[3] = {random_floats(1000, 61), random_floats(1000, 62), random_floats(1000, 63)};
        for (auto& o : out) o.resize(1000);
        double* again[] = {out[0].data(), out[1].data(), out[2].data()};
        kernel({in[0].data(), in[1].data(), in[2].data()}, 1000, again);
        // A handful of roundings of numbers up to 1.
        for (std::size_t i = 0; i < 1000; ++i) {
            EXPECT_NEAR(out[0][i], 0.2 * in[0][i] + 0.3 * in[1][i] + 0.5 * in[2][i], 1e-15);
            EXPECT_NEAR(out[1][i], in[0][i], 1e-15);
            EXPECT_NEAR(out[2][i], 1, 1e-15);
        }
    }
}

TEST(Mantissa, keeps_what_it_is_told_on_every_target) {
    auto in = random_floats(4099, 11);
    for (std::size_t i = 0; i < 300; ++i) in[i] = std::ldexp(in[i], -static_cast<int>(i) / 2);  // halves' and floats' subnormals too
    const float special[] = {0.0f, -0.0f, 1.0f, 0x1.fffffep-1f, 65504.0f, 1e6f, -0.3f, inf, -inf, 0x1p-149f, 0x1.8p-3f, 0x1.4p-3f};
    std::copy(std::begin(special), std::end(special), in.begin() + 400);
    std::vector<float> expected(in.size()), got(in.size());
    for (const bool half : {false, true})
        for (int bits = 0; bits <= k::float_mantissa_bits; ++bits) {
            k::round_mantissa_reference(in.data(), in.size(), bits, half, expected.data());
            on_every_target([&] {
                k::round_mantissa(in.data(), in.size(), bits, half, got.data());
                for (std::size_t i = 0; i < in.size(); ++i)
                    // Floats below 2^-126 keep their bits counted from their own first one in the fast way: both are within
                    // half a step of the smallest normal number.
                    if (std::fabs(in[i]) >= 0x1p-126f || half) {
                        ASSERT_TRUE(same_bytes(got[i], expected[i])) << in[i] << " to " << bits << " bits";
                    }
            });
            for (std::size_t i = 0; i < in.size(); ++i) {
                if (!std::isfinite(in[i]) || std::fabs(in[i]) < 0x1p-126f || (half && std::fabs(in[i]) > 60000) || (half && std::fabs(in[i]) < 0x1p-14f)) continue;
                // Half a step at `bits`, and with halves of at most 10 bits another half of theirs.
                const float step = std::ldexp(std::fabs(in[i]), -bits - 1) + (half ? std::ldexp(std::fabs(in[i]), -11) : 0);
                ASSERT_LE(std::fabs(expected[i] - in[i]), step);
                const auto dropped = static_cast<unsigned>(k::float_mantissa_bits - (half ? std::min(bits, 10) : bits));
                ASSERT_EQ(std::bit_cast<std::uint32_t>(expected[i]) & ((1u << dropped) - 1), 0u);
            }
        }
    EXPECT_EQ(expected[402], 1.0f);
}

}  // namespace
