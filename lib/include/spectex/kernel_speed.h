// How near the kernels come to the speed of memory.
#pragma once

#include <string>
#include <vector>

#include "spectex/base.h"

namespace spectex {

struct KernelSpeed {
    std::string kernel;
    double megapixels = 0;  ///< a second of one thread's processor time; median of the rounds
    double ratio = 0;       ///< to a memory copy of three float planes in the same round; median of the rounds
    double target = 0;      ///< least ratio that is asked of it; 0: none
    double error = 0;       ///< largest difference from the kernel's reference, in `unit`
    std::string unit;
};

/// Times every kernel over planes that no cache holds, one thread, in strips as the tools use them; pictures are made of
/// random colours. Each is compared with its reference first.
/// @param rounds  of all kernels, 1 to 1000.
/// @error usage for other rounds; input, where a kernel differs from its reference by more than it states.
SPECTEX_API Result<std::vector<KernelSpeed>> measure_kernels(int rounds);

}  // namespace spectex
