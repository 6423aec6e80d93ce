// Two files as rows of colour differences.
#pragma once

#include <span>
#include <string>

#include "parallel.h"
#include "pipeline/source.h"
#include "pipeline/strips.h"

namespace spectex::pipeline {

/// A pair of opened files of one size and the formula between them.
struct DifferencePair {
    LinearSource a, b;
    DifferenceKernel kernel;
    std::string white;

    /// @error input, when sizes differ.
    static Result<DifferencePair> open(const std::string& a, const std::string& b, const DifferenceOptions& options);
    InputReport report_a, report_b;
};

/// Runs over the pair once; strips of differences come in order.
/// @param codes  whether to count, per row, the pixels whose 8-bit code changed.
/// @param take   (y, rows, values [rows][width], changed codes [rows]) -> Status.
template <class Take>
Status run_differences(DifferencePair& pair, const JobOptions& job, bool codes, const Take& take) {
    const auto& geometry = pair.a.strips().geometry();
    const int width = geometry.width, threads = job.threads;
    struct Buffers {
        RawStrip a, b;
        std::vector<float> difference;
        std::vector<std::uint64_t> changed;
    };
    const int rows = rows_per_strip(std::max(pair.a.strips().preferred_rows(), pair.b.strips().preferred_rows()),
                                    pair.a.strips().raw_bytes_per_row() + pair.b.strips().raw_bytes_per_row() +
                                        static_cast<std::size_t>(width) * 28,
                                    geometry.height);
    return run_strips(
        job, width, geometry.height, rows, [] { return Buffers{}; },
        [&](Buffers& b, int y, int n) -> Status {
            if (threads == 1) {
                if (auto s = pair.a.strips().read(y, n, b.a); !s) return s;
                return pair.b.strips().read(y, n, b.b);
            }
            // Decoders of whole files are serial: two of them keep two threads busy.
            Status of_a, of_b;
            parallel_for(0, 2, [&](int i) { i == 0 ? of_a = pair.a.strips().read(y, n, b.a) : of_b = pair.b.strips().read(y, n, b.b); });
            return of_a ? of_b : of_a;
        },
        [&](Buffers& b, int, int n) -> Status {
            b.difference.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(n));
            b.changed.assign(static_cast<std::size_t>(n), 0);
            for_row_groups(n, width, [&](int first, int count) {
                thread_local std::vector<std::vector<float>> scratch;
                thread_local std::array<std::vector<float>, 6> planes;
                const std::size_t begin = static_cast<std::size_t>(first) * static_cast<std::size_t>(width);
                const std::size_t size = static_cast<std::size_t>(count) * static_cast<std::size_t>(width);
                for (auto& plane : planes) plane.resize(std::max(plane.size(), size));
                const auto w = static_cast<std::size_t>(width);
                pair.a.decode(b.a, begin, size, scratch, {planes[0].data(), planes[1].data(), planes[2].data()});
                pair.b.decode(b.b, begin, size, scratch, {planes[3].data(), planes[4].data(), planes[5].data()});
                for (std::size_t row = 0; row < static_cast<std::size_t>(count); ++row) {
                    const std::array<const float*, 3> pa{planes[0].data() + row * w, planes[1].data() + row * w, planes[2].data() + row * w};
                    const std::array<const float*, 3> pb{planes[3].data() + row * w, planes[4].data() + row * w, planes[5].data() + row * w};
                    pair.kernel(pa, pb, w, b.difference.data() + begin + row * w);
                    if (codes) b.changed[static_cast<std::size_t>(first) + row] = count_changed_codes(pa, pb, w);
                }
            });
            return {};
        },
        [&](Buffers& b, int y, int n) -> Status {
            return take(y, n, std::span<const float>(b.difference), std::span<const std::uint64_t>(b.changed));
        });
}

}  // namespace spectex::pipeline
