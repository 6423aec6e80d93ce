#include <algorithm>
#include <cmath>

#include "spectex/methods.h"

namespace spectex {
namespace {

bool inside(float v) { return v >= 0 && v <= 1; }

float clipped(float v) { return std::clamp(v, 0.0f, 1.0f); }

/// On the line to the grey of the colour's luminance, the colour nearest to the original that lies in the cube.
Vector3 desaturated(const Vector3& rgb, const Vector3& luminance) {
    const double y = luminance[0] * rgb[0] + luminance[1] * rgb[1] + luminance[2] * rgb[2];
    const double grey = std::clamp(y, 0.0, 1.0);
    double keep = 1;
    for (const double v : rgb) {
        if (v > 1) keep = std::min(keep, (1 - grey) / (v - grey));
        if (v < 0) keep = std::min(keep, grey / (grey - v));
    }
    return {grey + keep * (rgb[0] - grey), grey + keep * (rgb[1] - grey), grey + keep * (rgb[2] - grey)};
}

}  // namespace

std::optional<std::size_t> map_into_gamut(std::array<float*, 3> rgb, std::size_t n, GamutPolicy policy, const Vector3& luminance,
                                          GamutCounts& counts) {
    constexpr std::size_t block = 256;
    for (std::size_t start = 0; start < n; start += block) {
        const std::size_t end = std::min(n, start + block);
        // Most blocks have nothing to do, and this loop compiles to vectors.
        bool all = true;
        for (const float* plane : rgb)
            for (std::size_t i = start; i < end; ++i) all &= inside(plane[i]);
        if (all) continue;
        for (std::size_t i = start; i < end; ++i) {
            if (inside(rgb[0][i]) && inside(rgb[1][i]) && inside(rgb[2][i])) continue;
            if (!std::isfinite(rgb[0][i]) || !std::isfinite(rgb[1][i]) || !std::isfinite(rgb[2][i])) {
                ++counts.nonfinite;
                for (float* plane : rgb) plane[i] = std::isnan(plane[i]) ? 0.0f : clipped(plane[i]);
                continue;
            }
            ++counts.out_of_gamut;
            if (policy == GamutPolicy::error) return i;
            if (policy == GamutPolicy::clip) {
                for (float* plane : rgb) plane[i] = clipped(plane[i]);
            } else {
                const Vector3 mapped = desaturated({rgb[0][i], rgb[1][i], rgb[2][i]}, luminance);
                for (std::size_t c = 0; c < 3; ++c) rgb[c][i] = clipped(static_cast<float>(mapped[c]));
            }
        }
    }
    return std::nullopt;
}

}  // namespace spectex
