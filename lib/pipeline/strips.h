// The one streaming driver: strips of whole rows, in order, with reading, computing and writing overlapped.
#pragma once

#include <tbb/info.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>

#include "parallel.h"
#include "spectex/pipeline.h"

namespace spectex::pipeline {

/// Strips in flight: one being read, one computed, one written.
constexpr std::size_t strips_in_flight = 3;
/// What the buffers of one strip may take; a strip has at least `least_rows` all the same.
constexpr std::size_t strip_bytes = std::size_t{24} << 20;
constexpr int least_rows = 16;

/// Rows per strip: as the reader prefers, fewer where they would need too much memory.
inline int rows_per_strip(int preferred, std::size_t bytes_per_row, int height) {
    const auto fitting = static_cast<std::int64_t>(strip_bytes / std::max<std::size_t>(bytes_per_row, 1));
    std::int64_t rows = std::max(preferred, 1);
    if (fitting < rows) rows = std::max<std::int64_t>(fitting / least_rows * least_rows, least_rows);
    return static_cast<int>(std::min<std::int64_t>(rows, std::max(height, 1)));
}

/// First error of several threads.
class FirstError {
public:
    void set(Error error) {
        const std::lock_guard lock(mutex_);
        if (!error_) error_ = std::move(error);
        failed_.store(true, std::memory_order_release);
    }
    void check(Status status) {
        if (!status) set(status.error());
    }
    bool failed() const { return failed_.load(std::memory_order_acquire); }
    Status status() const { return error_ ? Status(*error_) : Status(); }

private:
    std::mutex mutex_;
    std::atomic<bool> failed_{false};
    std::optional<Error> error_;
};

/// Runs read (in order) -> compute (any order, in parallel inside) -> write (in order) over strips of rows.
/// @param make     () -> Buffers, called strips_in_flight times at most.
/// @param read     (Buffers&, y, rows) -> Status.
/// @param compute  (Buffers&, y, rows) -> Status.
/// @param write    (Buffers&, y, rows) -> Status.
template <class Make, class Read, class Compute, class Write>
Status run_strips(const JobOptions& job, int width, int height, int rows, const Make& make, const Read& read, const Compute& compute,
                  const Write& write) {
    using Buffers = decltype(make());
    struct Strip {
        Buffers buffers;
        int y = 0, rows = 0;
    };
    FirstError error;
    const int threads = job.threads > 0 ? job.threads : tbb::info::default_concurrency();
    try {
        std::vector<std::unique_ptr<Strip>> pool;
        std::size_t next = 0;
        int y = 0;
        const auto run = [&] {
            parallel_pipeline<Strip>(
                strips_in_flight,
                [&]() -> Strip* {
                    if (y >= height || error.failed()) return nullptr;
                    // Strip k + strips_in_flight starts only after strip k was written.
                    const std::size_t slot = next++ % strips_in_flight;
                    if (pool.size() <= slot) pool.push_back(std::unique_ptr<Strip>(new Strip{make()}));
                    Strip* strip = pool[slot].get();
                    strip->y = y;
                    strip->rows = std::min(rows, height - y);
                    y += strip->rows;
                    error.check(read(strip->buffers, strip->y, strip->rows));
                    return strip;
                },
                [&](Strip* strip) {
                    if (!error.failed()) error.check(compute(strip->buffers, strip->y, strip->rows));
                },
                [&](Strip* strip) {
                    if (error.failed()) return;
                    error.check(write(strip->buffers, strip->y, strip->rows));
                    if (job.progress && !error.failed())
                        job.progress(static_cast<std::uint64_t>(strip->y + strip->rows) * static_cast<std::uint64_t>(width),
                                     static_cast<std::uint64_t>(height) * static_cast<std::uint64_t>(width));
                });
        };
        // A thread that waits for this job's strips must not begin another file in the meantime.
        if (job.in_callers_arena)
            tbb::this_task_arena::isolate(run);
        else
            tbb::task_arena(threads).execute(run);
    } catch (const std::bad_alloc&) {
        return Error{ErrorKind::input, "not enough memory for one strip of rows"};
    } catch (const std::exception& e) {
        return Error{ErrorKind::input, std::string("internal failure: ") + e.what()};
    }
    return error.status();
}

/// Runs body(first_row, rows) over groups of whole rows of about 8192 pixels, in parallel.
template <class Body>
void for_row_groups(int rows, int width, const Body& body) {
    const auto grain = static_cast<std::size_t>(std::max(1, 8192 / std::max(width, 1)));
    parallel_for(std::size_t{0}, (static_cast<std::size_t>(rows) + grain - 1) / grain, [&](std::size_t group) {
        const std::size_t first = group * grain;
        body(static_cast<int>(first), static_cast<int>(std::min(grain, static_cast<std::size_t>(rows) - first)));
    });
}

}  // namespace spectex::pipeline
