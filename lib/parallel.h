// Loops on the threads of TBB.
//
// TBB hands tasks from thread to thread inside its library, which ThreadSanitizer does not see: it calls every access of a
// loop's body to what its caller wrote a race, and those of TBB's own headers as well, and takes minutes to print them all.
// There, loops run on plain threads, and the races that are found are those of the bodies.
#pragma once

#if defined(__SANITIZE_THREAD__)
#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>
#else
#include <tbb/parallel_for.h>
#endif

namespace spectex {

/// body(i) for i in [begin, end), in any order.
template <class Index, class Body>
void parallel_for(Index begin, Index end, const Body& body) {
#if defined(__SANITIZE_THREAD__)
    std::atomic<Index> next{begin};
    std::mutex mutex;
    std::exception_ptr failed;
    const auto run = [&] {
        try {
            for (Index i = next++; i < end; i = next++) body(i);
        } catch (...) {
            const std::lock_guard lock(mutex);
            if (!failed) failed = std::current_exception();
            next = end;
        }
    };
    std::vector<std::thread> others;
    for (Index i = begin + 1; i < end && others.size() < 3; ++i) others.emplace_back(run);
    run();
    for (auto& thread : others) thread.join();
    if (failed) std::rethrow_exception(failed);
#else
    tbb::parallel_for(begin, end, body);
#endif
}

}  // namespace spectex
