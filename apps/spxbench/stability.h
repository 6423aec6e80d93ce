// spxbench stability: every numeric path against a reference of 113 bits.
#pragma once

#include "../common/app.h"
#include "spectex/stability.h"

namespace spectex::bench {

struct StabilityRequest {
    StabilityOptions options;
    std::string folder, csv;
    bool brief = false;  ///< print a row a group
};

int stability(app::App& tool, const StabilityRequest& request, const Colorimetry& colorimetry);

}  // namespace spectex::bench
