// spxbench kernels: how near the kernels come to the speed of memory.
#pragma once

#include <string>
#include <vector>

#include "../common/app.h"

namespace spectex::bench {

int kernels(app::App& tool, int rounds, const std::string& folder);
/// spxbench memory: from what share of repeated colours on it pays to remember them. @param methods  all, where it is empty.
int memory(app::App& tool, std::vector<std::string> methods, int rounds, const std::string& folder);

}  // namespace spectex::bench
