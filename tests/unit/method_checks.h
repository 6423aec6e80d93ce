// What every reflectance method is held to, with sums of their own in long double.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "spectex/methods.h"

namespace method_checks {

using namespace spectex;

inline Colorimetry colorimetry(const std::string& bands = "380:780:5", const ColorimetrySpec& spec = {}) {
    return Colorimetry::make(spec, BandSet::parse(bands).value()).value();
}

inline std::shared_ptr<const Model> model(std::string_view id, const Colorimetry& c) {
    auto made = make_model(id, c);
    EXPECT_TRUE(made) << id << ": " << made.error().message;
    return made ? *made : nullptr;
}

inline std::vector<double> spectrum(const Model& m, const Vector3& rgb) {
    std::vector<double> out(m.colorimetry().bands().size(), std::nan(""));
    m.reflectance(rgb, out);
    return out;
}

/// Corners, edges, greys, codes near the corners, and n colours with components that are 0, 1 or uniform.
inline std::vector<Vector3> colors(std::size_t n, unsigned seed = 1999) {
    std::vector<Vector3> out;
    for (int i = 0; i < 8; ++i) out.push_back({double(i & 1), double(i >> 1 & 1), double(i >> 2)});
    for (int i = 0; i <= 64; ++i) out.push_back({i / 64.0, i / 64.0, i / 64.0});
    for (const double e : {1e-30, 1e-7, 3e-4, 1e-3, 0.02})
        for (int i = 1; i < 8; ++i) {
            const double r = i & 1, g = i >> 1 & 1, b = i >> 2;
            out.push_back({r * e, g * e, b * e});
            // 1 - 1e-30 is white itself.
            out.push_back({1 - r * e, 1 - g * e, 1 - b * e});
        }
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::uniform_int_distribution<int> kind(0, 5);
    for (std::size_t i = 0; i < n; ++i) {
        Vector3 rgb{};
        for (double& v : rgb) {
            const int k = kind(random);
            v = k == 0 ? 0.0 : k == 1 ? 1.0 : uniform(random);
        }
        out.push_back(rgb);
    }
    return out;
}

struct Extremes {
    double residual = 0;  ///< largest |A r - rgb| over the largest component of rgb (black: over 1)
    double low = 1, high = 0;
    bool finite = true;
};

inline Extremes extremes(const Model& m, const std::vector<Vector3>& colors) {
    const std::size_t bands = m.colorimetry().bands().size();
    const auto& a = m.colorimetry().sensing_matrix();
    Extremes e;
    for (const auto& rgb : colors) {
        const auto r = spectrum(m, rgb);
        for (const double v : r) {
            e.finite = e.finite && std::isfinite(v);
            e.low = std::min(e.low, v);
            e.high = std::max(e.high, v);
        }
        const double top = *std::max_element(rgb.begin(), rgb.end());
        for (std::size_t c = 0; c < 3; ++c) {
            long double sum = 0;
            for (std::size_t l = 0; l < bands; ++l) sum += static_cast<long double>(a[c * bands + l]) * r[l];
            e.residual = std::max(e.residual, static_cast<double>(std::abs(sum - rgb[c])) / (top > 0 ? top : 1));
        }
    }
    return e;
}

/// JSON brings back a model of the same spectra and the same text.
inline void expect_round_trip(const Model& m) {
    const std::string text = m.to_json();
    const auto back = make_model_from_json(text);
    ASSERT_TRUE(back) << m.info().id << ": " << back.error().message;
    EXPECT_EQ((*back)->info().id, m.info().id);
    EXPECT_EQ((*back)->to_json(), text);
    for (const auto& rgb : colors(20)) EXPECT_EQ(spectrum(**back, rgb), spectrum(m, rgb)) << m.info().id;
}

/// Stored coefficients bring back the spectrum that the colour has.
inline double coefficient_difference(const Model& m, const std::vector<Vector3>& colors) {
    double worst = 0;
    const auto count = static_cast<std::size_t>(m.info().coefficients);
    EXPECT_EQ(m.coefficient_names().size(), count);
    for (const auto& rgb : colors) {
        std::vector<double> kept(count), back(m.colorimetry().bands().size());
        m.coefficients(rgb, kept);
        m.reflectance_of_coefficients(kept, back);
        const auto direct = spectrum(m, rgb);
        for (std::size_t l = 0; l < back.size(); ++l) worst = std::max(worst, std::abs(back[l] - direct[l]));
    }
    return worst;
}

/// Largest change of a visible band (one that weighs at least `weight` of the luminance) over n random steps of `step`.
inline double largest_change(const Model& m, double step, std::size_t n, double weight = 0) {
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> uniform(0, 1);
    const auto& w = m.colorimetry().xyz_weights();
    const std::size_t bands = m.colorimetry().bands().size();
    double worst = 0;
    for (std::size_t i = 0; i < n; ++i) {
        Vector3 a{}, b{};
        for (std::size_t c = 0; c < 3; ++c) {
            a[c] = uniform(random);
            b[c] = std::clamp(a[c] + step * (2 * uniform(random) - 1), 0.0, 1.0);
        }
        const auto from = spectrum(m, a), to = spectrum(m, b);
        for (std::size_t l = 0; l < bands; ++l)
            if (w[bands + l] >= weight) worst = std::max(worst, std::abs(from[l] - to[l]));
    }
    return worst;
}

}  // namespace method_checks
