// Pictures for people: false-colour error maps with a legend, and spectra as curves. Text is drawn by Cairo.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"

namespace spectex {

/// A colour map as 256 sRGB triples, taken from OpenImageIO's color_map: magma, inferno, plasma, viridis, turbo, ...
struct ColorMap {
    std::string name;
    std::array<std::array<std::uint8_t, 3>, 256> codes{};
    /// Position t in [0,1] by nearest entry; NaN gives the "no value" colour.
    std::array<std::uint8_t, 3> at(double t) const;
    static constexpr std::array<std::uint8_t, 3> no_value{128, 128, 128};
};
/// @error usage, listing the names.
SPECTEX_API Result<ColorMap> find_color_map(std::string_view name);
SPECTEX_API std::vector<std::string> color_map_names();

/// Range and labels of a heatmap's legend.
struct Legend {
    double low = 0, high = 1;
    std::string title;       ///< "CIE76 ΔE*ab"
    std::vector<std::string> notes;  ///< small lines below: "mean 0.02  p99 0.1  max 0.3"
};
/// The smallest of 1, 1.5, 2, 2.5, 3, 4, 5, 6, 8 x 10^k that is >= value; 1e-6 at the least (so an all-zero map has a range).
SPECTEX_API double round_up_range(double value);
/// Tick positions for a legend or axis: 4 to 8 round numbers inside [low, high].
SPECTEX_API std::vector<double> ticks(double low, double high);

/// Pixels of 8-bit sRGB, [height][width][3].
struct Picture {
    int width = 0, height = 0;
    std::vector<std::uint8_t> rgb;
};
/// The legend bar beside a map of the given pixel height, as its own picture; text stays readable: never below 11 px, and
/// growing with the map.
SPECTEX_API Result<Picture> draw_legend(const ColorMap& map, const Legend& legend, int map_height);
/// Smallest height at which a map with a legend is drawn; smaller maps are enlarged by whole factors.
SPECTEX_API int minimum_map_height();

/// One curve of a spectrum plot.
struct Curve {
    std::string label;
    std::vector<double> wavelengths_nm, values;
    std::array<std::uint8_t, 3> color{0, 0, 0};
    bool markers = false;  ///< draw the band centres
};
/// Reflectance or power against wavelength as an SVG document, with axes in nm, a spectrum strip below, a legend.
SPECTEX_API Result<std::string> plot_spectra_svg(std::span<const Curve> curves, std::string_view title,
                                                 std::string_view y_label);

}  // namespace spectex
