// How near the kernels come to the speed of memory.
#pragma once

#include <span>
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

/// What remembering the results of colours is worth to a method that is not linear in pieces.
struct MemorySpeed {
    std::string method, work;  ///< work: what is computed of a colour
    struct Point {
        double share = 0;  ///< of colours that were met a moment before
        double computed_ns = 0, remembered_ns = 0;  ///< a colour, of one thread's processor time
    };
    std::vector<Point> points;
    double break_even = 1;  ///< share from which remembering wins, between the points; 1 where it wins at none
    std::string decision;   ///< what a plan of this method decided by its own measurement
};
/// Times colours in which some are repeated with every one computed, and with all remembered.
/// @param methods  ids; those that are linear in pieces are passed over. @param rounds  of which the fastest counts.
/// @error as make_model; usage for other rounds.
SPECTEX_API Result<std::vector<MemorySpeed>> measure_color_memory(std::span<const std::string> methods, int rounds);

}  // namespace spectex
