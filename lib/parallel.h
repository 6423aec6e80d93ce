// Loops, pipelines and groups of tasks on the threads of TBB.
//
// TBB hands tasks from thread to thread inside its library, which ThreadSanitizer does not see: it calls every access of a
// loop's body to what its caller wrote a race, and those of TBB's own headers as well, and takes minutes to print them all.
// There, all of them run on plain threads, and the races that are found are those of the bodies.
#pragma once

#if defined(__SANITIZE_THREAD__)
#include <algorithm>
#include <array>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>
#else
#include <tbb/parallel_for.h>
#include <tbb/parallel_pipeline.h>
#include <tbb/task_group.h>
#endif

#include <cstddef>

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

/// first() -> Item*, in order, until it returns null; then(Item*) in any order; last(Item*) in the items' order.
/// @param in_flight  items between first and last, at most.
template <class Item, class First, class Then, class Last>
void parallel_pipeline(std::size_t in_flight, const First& first, const Then& then, const Last& last) {
#if defined(__SANITIZE_THREAD__)
    std::mutex mutex;
    std::condition_variable changed;
    std::array<std::size_t, 3> done{};
    std::vector<Item*> items(in_flight);
    bool ended = false;
    std::exception_ptr failed;
    const auto stage = [&](std::size_t k, const auto& work) {
        for (std::size_t i = 0;; ++i) {
            std::unique_lock lock(mutex);
            const auto over = [&] { return failed || (k > 0 && ended && i >= done[0]); };
            changed.wait(lock, [&] { return over() || (k == 0 ? i < done[2] + in_flight : done[k - 1] > i); });
            if (over()) return;
            Item*& item = items[i % in_flight];
            lock.unlock();
            try {
                work(item);
            } catch (...) {
                lock.lock();
                if (!failed) failed = std::current_exception();
                changed.notify_all();
                return;
            }
            lock.lock();
            if (k == 0 && !item) ended = true;
            else done[k] = i + 1;
            changed.notify_all();
            if (k == 0 && ended) return;
        }
    };
    std::thread reader([&] { stage(0, [&](Item*& item) { item = first(); }); });
    std::thread worker([&] { stage(1, [&](Item* item) { then(item); }); });
    stage(2, [&](Item* item) { last(item); });
    reader.join();
    worker.join();
    if (failed) std::rethrow_exception(failed);
#else
    tbb::parallel_pipeline(in_flight, tbb::make_filter<void, Item*>(tbb::filter_mode::serial_in_order,
                                                                    [&](tbb::flow_control& flow) -> Item* {
                                                                        Item* item = first();
                                                                        if (!item) flow.stop();
                                                                        return item;
                                                                    }) &
                                          tbb::make_filter<Item*, Item*>(tbb::filter_mode::parallel,
                                                                         [&](Item* item) {
                                                                             then(item);
                                                                             return item;
                                                                         }) &
                                          tbb::make_filter<Item*, void>(tbb::filter_mode::serial_in_order, [&](Item* item) { last(item); }));
#endif
}

#if defined(__SANITIZE_THREAD__)
/// As tbb::task_group: run() may be called by what it runs.
class TaskGroup {
public:
    template <class Task>
    void run(Task task) {
        const std::lock_guard lock(mutex_);
        threads_.emplace_back(std::move(task));
    }
    void wait() {
        for (;;) {
            std::unique_lock lock(mutex_);
            if (threads_.empty()) return;
            std::thread next = std::move(threads_.back());
            threads_.pop_back();
            lock.unlock();
            next.join();
        }
    }

private:
    std::mutex mutex_;
    std::vector<std::thread> threads_;
};
#else
using TaskGroup = tbb::task_group;
#endif

}  // namespace spectex
