// All 16,777,216 sRGB codes through storage and back, for every method that claims exactness.
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <thread>

#include "reference.h"
#include "spectex/color.h"
#include "spectex/compare.h"
#include "spectex/plan.h"

using namespace spectex;

namespace {

constexpr std::uint32_t all_codes = 1u << 24;
constexpr std::uint32_t block = 1u << 12;

/// Runs body(first code) for every block, on all processors.
template <class Body>
void for_all_blocks(const Body& body) {
    std::atomic<std::uint32_t> next{0};
    std::vector<std::thread> threads;
    for (unsigned i = 0; i < std::max(1u, std::thread::hardware_concurrency()); ++i)
        threads.emplace_back([&] {
            for (std::uint32_t first; (first = next.fetch_add(block)) < all_codes;) body(first);
        });
    for (auto& t : threads) t.join();
}

const std::array<double, 256>& linear_codes() {
    static const auto table = [] {
        std::array<double, 256> t{};
        for (std::size_t i = 0; i < 256; ++i) t[i] = static_cast<double>(reference::srgb_to_linear(static_cast<reference::Real>(i) / 255));
        return t;
    }();
    return table;
}

std::array<std::uint8_t, 3> code_of(std::uint32_t index) {
    return {static_cast<std::uint8_t>(index >> 16), static_cast<std::uint8_t>(index >> 8), static_cast<std::uint8_t>(index)};
}

struct Worst {
    double max = 0;
    double sum = 0;
    std::uint64_t changed = 0;
    std::mutex mutex;
    void add(double value, std::uint64_t codes, double total = 0) {
        const std::lock_guard lock(mutex);
        sum += total;
        // NaN must not pass for small.
        if (!(value <= max)) max = value;
        changed += codes;
    }
};

/// Round trip of every code through StorePlan, the very code that the tools run.
/// @param stride  an odd number, for slow methods: every stride-th code alone.
void measure(const char* method, const BandSet& bands, Store store, PixelType type, Worst& worst,
             const ColorimetrySpec& spec = {}, std::uint32_t stride = 1) {
    const auto colorimetry = Colorimetry::make(spec, bands);
    ASSERT_TRUE(colorimetry) << colorimetry.error().message;
    const auto model = make_model(method, *colorimetry);
    ASSERT_TRUE(model) << model.error().message;
    const auto plan = StorePlan::make(*model, store, type);
    ASSERT_TRUE(plan) << plan.error().message;
    const DifferenceKernel kernel(Metric::cie76, colorimetry->rgb_to_xyz(), colorimetry->rgb_to_xyz(), colorimetry->white_xyz());
    const auto& linear = linear_codes();
    for_all_blocks([&](std::uint32_t first) {
        if (first / block % stride != 0) return;
        std::array<std::vector<float>, 3> in, out;
        for (auto& plane : in) plane.resize(block);
        for (auto& plane : out) plane.resize(block);
        for (std::uint32_t i = 0; i < block; ++i) {
            // Of every stride blocks of codes one block, filled from all of them.
            const auto code = code_of(std::min(first + i * stride, all_codes - 1));
            for (std::size_t c = 0; c < 3; ++c) in[c][i] = static_cast<float>(linear[code[c]]);
        }
        std::vector<std::byte> samples(plan->channels() * block * pixel_bytes(type));
        std::vector<std::byte*> planes;
        for (std::size_t b = 0; b < plan->channels(); ++b) planes.push_back(samples.data() + b * block * pixel_bytes(type));
        plan->store({in[0].data(), in[1].data(), in[2].data()}, block, planes);
        const std::vector<const std::byte*> stored(planes.begin(), planes.end());
        plan->reproject(stored, block, {out[0].data(), out[1].data(), out[2].data()});
        std::vector<float> difference(block);
        const std::array<const float*, 3> a{in[0].data(), in[1].data(), in[2].data()}, b{out[0].data(), out[1].data(), out[2].data()};
        kernel(a, b, block, difference.data());
        double largest = 0, total = 0;
        for (const float d : difference) {
            largest = d <= largest ? largest : d;
            total += d;
        }
        worst.add(largest, count_changed_codes(a, b, block), total);
    });
}

TEST(AllCodes, SrgbCurveIsRightToFloatRounding) {
    for (std::size_t i = 0; i < 256; ++i) {
        const double ours = srgb_decode(static_cast<double>(i) / 255);
        EXPECT_EQ(static_cast<float>(ours), static_cast<float>(linear_codes()[i])) << i;
    }
}

TEST(AllCodes, MallettInDoubleIsExact) {
    // Eq. 4 of Mallett and Yuksel is an identity; what is left is rounding: 81 terms of 1e-16 give 1e-15 in RGB, and Lab's
    // slope at black, 903.3 * 5, makes 1e-11 of it. 1e-9 leaves two digits.
    for (const char* grid : {"380:780:5", "380:780:10", "380:780:20", "7"}) {
        const auto colorimetry = *Colorimetry::make({}, *BandSet::parse(grid));
        const auto model = *make_model("mallett2019", colorimetry);
        const std::size_t bands = colorimetry.bands().size();
        const auto& a = colorimetry.sensing_matrix();
        const auto& linear = linear_codes();
        Worst worst;
        for_all_blocks([&](std::uint32_t first) {
            std::vector<double> rgb(3 * block), spectra(bands * block), back(3 * block), difference(block);
            for (std::uint32_t i = 0; i < block; ++i)
                for (std::size_t c = 0; c < 3; ++c) rgb[3 * i + c] = linear[code_of(first + i)[c]];
            model->reflectance(rgb, spectra);
            double largest = 0, low = 0, high = 1;
            std::array<std::vector<double>, 6> planes;
            for (auto& p : planes) p.resize(block);
            for (std::uint32_t i = 0; i < block; ++i) {
                const double* r = &spectra[i * bands];
                for (std::size_t c = 0; c < 3; ++c) {
                    double sum = 0;
                    for (std::size_t b = 0; b < bands; ++b) sum += a[c * bands + b] * r[b];
                    planes[c][i] = rgb[3 * i + c];
                    planes[3 + c][i] = sum;
                }
                for (std::size_t b = 0; b < bands; ++b) {
                    low = std::min(low, r[b]);
                    high = std::max(high, r[b]);
                }
            }
            // White is a sum of three doubles that is 1 to the last bit or two.
            if (low < 0 || high > 1 + 4.5e-16) largest = std::nan("");
            const DifferenceKernel kernel(Metric::cie76, colorimetry.rgb_to_xyz(), colorimetry.rgb_to_xyz(), colorimetry.white_xyz());
            kernel(std::array<const double*, 3>{planes[0].data(), planes[1].data(), planes[2].data()},
                   std::array<const double*, 3>{planes[3].data(), planes[4].data(), planes[5].data()}, block, difference.data());
            for (const double d : difference) largest = d <= largest ? largest : d;
            worst.add(largest, 0);
        });
        EXPECT_LE(worst.max, 1e-9) << grid;
        RecordProperty(std::string("max_double_") + grid, std::to_string(worst.max));
        printf("mallett2019 double %-12s max CIE76 %.3g\n", grid, worst.max);
    }
}

struct Case {
    const char* grid;
    Store store;
    PixelType type;
    double bound;
    const char* reason;
};

class ThroughStorage : public testing::TestWithParam<const char*> {};

TEST_P(ThroughStorage, NoCodeChanges) {
    const char* method = GetParam();
    const Case cases[] = {
        {"380:780:5", Store::coefficients, PixelType::float32, 1e-4, "rounding of 2^-24 in each component"},
        {"380:780:5", Store::coefficients, PixelType::half, 0.06, "2^-12 in each component, 500/3 of it in a*"},
        {"380:780:1", Store::spectral, PixelType::float32, 1e-4, "as coefficients, averaged over bands"},
        {"380:780:5", Store::spectral, PixelType::float32, 1e-4, ""},
        {"380:780:10", Store::spectral, PixelType::float32, 1e-4, ""},
        {"380:780:20", Store::spectral, PixelType::float32, 1e-4, ""},
        {"7", Store::spectral, PixelType::float32, 1e-4, ""},
        {"380:780:1", Store::spectral, PixelType::half, 0.05, "errors of many bands cancel"},
        {"380:780:5", Store::spectral, PixelType::half, 0.05, ""},
        {"380:780:10", Store::spectral, PixelType::half, 0.05, ""},
        {"36", Store::spectral, PixelType::half, 0.05, ""},
        {"380:780:20", Store::spectral, PixelType::half, 0.05, ""},
        {"7", Store::spectral, PixelType::half, 0.05, ""},
    };
    for (const auto& c : cases) {
        Worst worst;
        measure(method, *BandSet::parse(c.grid), c.store, c.type, worst);
        EXPECT_LE(worst.max, c.bound) << c.grid << " " << c.reason;
        EXPECT_EQ(worst.changed, 0u) << c.grid;
        printf("%s %-12s %-11s %-7s max CIE76 %.3g changed %llu\n", method, c.grid,
               c.store == Store::spectral ? "bands" : "coefficient", pixel_type_name(c.type).data(), worst.max,
               static_cast<unsigned long long>(worst.changed));
    }
}

INSTANTIATE_TEST_SUITE_P(Exact, ThroughStorage, testing::Values("mallett2019", "lattice"));

/// Float storage of a method that claims exactness: as coefficients, where 2^-24 of each matters, and as bands.
void expect_exact(const char* method, std::initializer_list<const char*> grids, std::uint32_t stride = 1) {
    for (const char* grid : grids)
        for (const Store store : {Store::coefficients, Store::spectral}) {
            Worst worst;
            measure(method, *BandSet::parse(grid), store, PixelType::float32, worst, {}, stride);
            EXPECT_LE(worst.max, 1e-3) << method << " " << grid;
            EXPECT_EQ(worst.changed, 0u) << method << " " << grid;
            printf("%s %-10s %-11s float mean CIE76 %.3g max %.3g changed %llu\n", method, grid,
                   store == Store::spectral ? "bands" : "coefficient", worst.sum / all_codes * stride, worst.max,
                   static_cast<unsigned long long>(worst.changed));
        }
}

TEST(AllCodes, SmitsExactThroughStorage) { expect_exact("smits1999:exact", {"380:780:5", "380:780:20"}); }

TEST(AllCodes, JakobThroughStorage) { expect_exact("jakob2019", {"380:780:5", "36"}); }

TEST(AllCodes, MacadamThroughStorage) { expect_exact("macadam1935", {"36"}); }

TEST(AllCodes, BurnsThroughStorage) { expect_exact("burns2020", {"36"}); }

// A minute and more for all of them: with SPECTEX_THOROUGH in the environment, else every 15th block of codes.
TEST(AllCodes, PetersThroughStorage) {
    const std::uint32_t stride = std::getenv("SPECTEX_THOROUGH") ? 1 : 15;
    expect_exact("peters2019", {"36"}, stride);
    expect_exact("peters2019:fourier-srgb", {"36"}, stride);
}

TEST(AllCodes, OtsuErrsOnlyWhereItClamps) {
    Worst worst;
    measure("otsu2018", *BandSet::parse("36"), Store::spectral, PixelType::float32, worst, {}, 15);
    printf("otsu2018 mean CIE76 %.4g max %.4g changed %llu\n", worst.sum / all_codes * 15, worst.max,
           static_cast<unsigned long long>(worst.changed));
    EXPECT_GT(worst.changed, 0u);
    EXPECT_LT(worst.max, 35);  // 27.4 where out-of-range values of the most saturated colours are clamped
}

TEST(AllCodes, MengErrsAsItDoes) {
    // As published, for equal energy; Mallett and Yuksel's supplement has a mean of 6.1.
    Worst worst;
    measure("meng2015", *BandSet::parse("36"), Store::spectral, PixelType::float32, worst);
    EXPECT_NEAR(worst.sum / all_codes, 6.0, 0.15);
    EXPECT_GT(worst.max, 15);
    printf("meng2015 mean CIE76 %.4g max %.4g changed %llu\n", worst.sum / all_codes, worst.max,
           static_cast<unsigned long long>(worst.changed));
}

TEST(AllCodes, SmitsAsPublishedErrsAsItDoes) {
    // Exact for no standard space: a change of these figures is a change of the table, its bins or the quadrature. They
    // are far below the mean 4.86 and max 19.5 that the same numbers give when the ten bins are read as samples every
    // 37.8 nm from 380 to 720 nm and joined by lines.
    Worst worst;
    measure("smits1999", *BandSet::parse("380:780:5"), Store::coefficients, PixelType::float32, worst);
    EXPECT_NEAR(worst.sum / all_codes, 1.860, 0.005);
    EXPECT_NEAR(worst.max, 5.551, 0.005);
    printf("smits1999 mean CIE76 %.4g max %.4g changed %llu\n", worst.sum / all_codes, worst.max,
           static_cast<unsigned long long>(worst.changed));
}

TEST(AllCodes, StoredHalvesIntegratedIndependently) {
    // Nothing of the library's quadrature, matrices or Lab: tables read again, sums and solves in long double, over the
    // half samples that a file would hold.
    const auto bands = *BandSet::parse("380:780:10");
    const auto colorimetry = *Colorimetry::make({}, bands);
    const auto plan = *StorePlan::make(*make_model("mallett2019", colorimetry), Store::spectral, PixelType::float32);
    const auto cmf = reference::read_csv(std::string(SPECTEX_LUTS_SOURCE) + "/cie/cie1931_2deg_360-830-1.csv");
    const auto d65 = *parse_illuminant("D65");
    reference::Light light;
    for (std::size_t i = 0; i < d65.power.size(); ++i) {
        light.nm.push_back(d65.power.wavelengths_nm()[i]);
        light.power.push_back(d65.power.values()[i]);
    }
    // Weights by integrating each band's hat on its own.
    std::vector<reference::Real> nm(bands.wavelengths_nm().begin(), bands.wavelengths_nm().end());
    std::vector<reference::Vec3> weights;
    reference::Vec3 white{};
    for (std::size_t b = 0; b < nm.size(); ++b) {
        std::vector<reference::Real> hat(nm.size(), 0);
        hat[b] = 1;
        weights.push_back(reference::xyz(cmf, light, 380, 780, [&](auto l) { return reference::interpolate(nm, hat, l); }));
        for (std::size_t c = 0; c < 3; ++c) white[c] += weights.back()[c];
    }
    const reference::Real y = white[1];
    for (auto& w : weights)
        for (auto& v : w) v /= y;
    for (auto& v : white) v /= y;
    const auto to_xyz = reference::bt709_to_xyz(white);
    const auto& linear = linear_codes();
    Worst worst;
    for_all_blocks([&](std::uint32_t first) {
        std::array<std::vector<float>, 3> in;
        for (auto& plane : in) plane.resize(block);
        for (std::uint32_t i = 0; i < block; ++i)
            for (std::size_t c = 0; c < 3; ++c) in[c][i] = static_cast<float>(linear[code_of(first + i)[c]]);
        std::vector<float> samples(plan.channels() * block);
        std::vector<std::byte*> planes;
        for (std::size_t b = 0; b < plan.channels(); ++b) planes.push_back(reinterpret_cast<std::byte*>(&samples[b * block]));
        plan.store({in[0].data(), in[1].data(), in[2].data()}, block, planes);
        double largest = 0;
        for (std::uint32_t i = 0; i < block; ++i) {
            reference::Vec3 xyz{};
            for (std::size_t b = 0; b < plan.channels(); ++b)
                for (std::size_t c = 0; c < 3; ++c) xyz[c] += weights[b][c] * samples[b * block + i];
            const reference::Vec3 rgb{in[0][i], in[1][i], in[2][i]};
            const auto d = reference::delta_e76(reference::lab(reference::multiply(to_xyz, rgb), white), reference::lab(xyz, white));
            largest = d <= largest ? largest : static_cast<double>(d);
        }
        worst.add(largest, 0);
    });
    // Float samples: 2^-24 relative in each band.
    EXPECT_LE(worst.max, 1e-4);
    printf("independent integration of float bands: max CIE76 %.3g\n", worst.max);
}

}  // namespace
