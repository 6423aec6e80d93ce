// Pictures of a texture, small: what contact sheets and thumbnails share.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

#include "spectex/color.h"
#include "spectex/heatmap.h"

namespace spectex::pipeline {

/// Which columns of the texture fall into one column of a tile, and how much of each: a box in linear light.
struct Box {
    int tile = 0;
    double ratio = 1;  ///< texture pixels per tile pixel
    /// Calls add(tile index, share) for the tile pixels that texture pixel i falls into.
    template <class Add>
    void spread(int i, const Add& add) const {
        const double low = i / ratio, high = (i + 1) / ratio;
        for (int t = static_cast<int>(low); t < tile && t < high; ++t) {
            const double part = std::min<double>(t + 1, high) - std::max<double>(t, low);
            if (part > 0) add(static_cast<std::size_t>(t), part);
        }
    }
};

/// Linear light as it is shown. @param linear  [height][width][3]; @param transform  to sRGB.
/// @param clipped  samples that sRGB does not hold are added.
inline Picture shown(std::span<const float> linear, int width, int height, const ColorTransform& transform, std::uint64_t& clipped) {
    const std::size_t n = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    std::array<std::vector<float>, 3> planes;
    for (std::size_t c = 0; c < 3; ++c) {
        planes[c].resize(n);
        for (std::size_t i = 0; i < n; ++i) planes[c][i] = linear[3 * i + c];
    }
    if (!transform.is_identity()) transform.apply({planes[0].data(), planes[1].data(), planes[2].data()}, n);
    Picture picture{width, height, std::vector<std::uint8_t>(3 * n)};
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t c = 0; c < 3; ++c) {
            const float v = planes[c][i];
            // Codes within half of the ends are those codes; beyond, a sample was clipped.
            if (v < -0.5F / 255 || v > 255.5F / 255) ++clipped;
            // A comparison that a NaN fails, so that one is black.
            picture.rgb[3 * i + c] = static_cast<std::uint8_t>(std::lround(v > 0 ? std::min(v, 1.0F) * 255 : 0.0F));
        }
    return picture;
}

}  // namespace spectex::pipeline
