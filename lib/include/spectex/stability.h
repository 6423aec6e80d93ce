// Every numeric path against a reference of 113 bits that shares no code with it, where it is likeliest to fail.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "spectex/base.h"
#include "spectex/spectral.h"

namespace spectex {

/// The worst that one path did over its inputs.
struct StabilityRow {
    std::string group;        ///< one of stability_groups()
    std::string path;         ///< what was computed, and in which precision
    std::string unit;         ///< of `worst`: "ulp" (of the result's own type), "2^-53 of terms", "condition", ...
    std::uint64_t cases = 0;
    double worst = 0;
    std::string worst_at;     ///< the input
    double delta_e = std::nan("");  ///< largest CIE76 that the error makes; NaN where no colour comes out
    std::string delta_e_at;
    std::uint64_t broken = 0; ///< not finite where the exact result is, finite where it is not, or outside the promised range
    std::string broken_at;    ///< the first
    double most = std::numeric_limits<double>::infinity(), most_delta_e = std::numeric_limits<double>::infinity();
    std::string reason;       ///< why these bounds

    bool kept() const { return broken == 0 && worst <= most && !(delta_e > most_delta_e); }
};

/// How the colours of a method that solves per colour were found.
struct SolverHistogram {
    std::string method;
    std::uint64_t colors = 0, unreached = 0;
    std::vector<std::pair<std::string, std::uint64_t>> counts;  ///< by steps or way
};

struct StabilityReport {
    std::vector<StabilityRow> rows;
    std::vector<SolverHistogram> solvers;
    /// Rows whose bound does not hold.
    SPECTEX_API std::size_t failures() const;
};

struct StabilityOptions {
    std::vector<std::string> groups;   ///< empty: all
    std::vector<std::string> methods;  ///< empty: all
    std::uint32_t stride = 1;          ///< takes every stride-th of the 2^24 codes; methods that solve per colour still fewer
    std::uint64_t colors = 1000000;    ///< random linear colours
    std::uint64_t seed = 1;
    std::uint32_t adversaries = 1;     ///< takes every so manieth of the adversarial colours
    int threads = 0;
};
/// colours, differences, methods, solvers, lights, sums, conditioning.
SPECTEX_API const std::vector<std::string>& stability_groups();

/// Runs the groups. Deterministic for any number of threads.
/// @error usage for an unknown group or method; that of a method which cannot be made.
SPECTEX_API Result<StabilityReport> measure_stability(const Colorimetry& colorimetry, const StabilityOptions& options);

}  // namespace spectex
