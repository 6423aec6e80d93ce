// Run time against error over whole files, and cost against size, bands and threads.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "../common/app.h"
#include "spectex/spectral.h"

namespace spectex::bench {

struct GridRequest {
    std::vector<std::string> methods, stores, kernels, corpus;  ///< each may be empty: defaults
    ColorimetrySpec colorimetry;
    std::string folder, baseline;
    std::int64_t runs = 3;
    double max_megapixels = 64;
};

/// Methods x stores x kernels over a corpus: table, JSON, CSV, and a chart of run time against error with its front.
int grid(app::App& tool, const GridRequest& request);
/// One method and store at growing sizes, bands and threads.
int scaling(app::App& tool, const GridRequest& request);

}  // namespace spectex::bench
