// The figure of the paper: every colour, rendered by several methods, and where they err.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "spectex/evaluation.h"
#include "spectex/heatmap.h"

namespace spectex::app {

struct Figure1Style {
    int width = 2400;
    std::array<double, 2> range{0, 35};  ///< of the heatmaps and of the bars
    std::string colormap = "magma";
    std::string caption;  ///< one line at the foot
};
/// Pixels of a panel's side in a figure of that width.
int figure1_panel(int width, std::size_t methods);
/// Columns: ground truth, then the methods. Rows: renderings; noise and imprecision; colour distortion. Below the ground
/// truth the means as bars with whiskers up to the 99th percentile; one scale for all maps at the right.
/// @error that of the drawing.
Result<Picture> draw_figure1(const GamutRendering& rendering, const Figure1Style& style);

}  // namespace spectex::app
