// spxbench kernels: how near the kernels come to the speed of memory.
#pragma once

#include <string>

#include "../common/app.h"

namespace spectex::bench {

int kernels(app::App& tool, int rounds, const std::string& folder);

}  // namespace spectex::bench
