#include <tbb/task_arena.h>

#include <chrono>
#include <cmath>

#include "parallel.h"
#include "spectex/color.h"
#include "spectex/evaluation.h"
#include "spectex/io.h"

namespace spectex {
namespace {

constexpr std::uint32_t all_codes = 1u << 24;
constexpr std::size_t row = 4096;
/// Rows that are handled together: enough for all processors, little enough memory for 81 bands.
constexpr std::size_t rows_at_once = 64;

}  // namespace

Result<RoundTripReport> measure_roundtrip(std::shared_ptr<const Model> model, Store store, PixelType type, std::uint32_t stride,
                                          int threads) {
    if (stride == 0) stride = 1;
    const auto plan = StorePlan::make(model, store, type);
    if (!plan) return plan.error();
    const auto& colorimetry = model->colorimetry();
    const DifferenceKernel kernel(Metric::cie76, colorimetry.rgb_to_xyz(), colorimetry.rgb_to_xyz(), colorimetry.white_xyz());
    std::array<float, 256> linear;
    for (std::size_t i = 0; i < 256; ++i) linear[i] = static_cast<float>(srgb_decode(static_cast<double>(i) / 255));

    RoundTripReport report;
    report.pixels = (all_codes + stride - 1) / stride;
    report.channels = plan->channels();
    const std::size_t bytes = pixel_bytes(type), rows = static_cast<std::size_t>((report.pixels + row - 1) / row);
    struct Row {
        std::array<std::vector<float>, 3> in, out;
        std::vector<std::byte> samples;
        std::vector<std::byte*> planes;
        std::vector<float> difference;
        std::size_t count = 0;
        std::uint64_t changed = 0, outside = 0;
    };
    std::vector<Row> work(rows_at_once);
    for (auto& w : work) {
        for (auto& plane : w.in) plane.resize(row);
        for (auto& plane : w.out) plane.resize(row);
        w.samples.resize(report.channels * row * bytes);
        for (std::size_t b = 0; b < report.channels; ++b) w.planes.push_back(w.samples.data() + b * row * bytes);
        w.difference.resize(row);
    }
    DifferenceAccumulator accumulator;
    tbb::task_arena arena(threads > 0 ? threads : tbb::task_arena::automatic);
    const auto seconds = [](const auto& body) {
        const auto begin = std::chrono::steady_clock::now();
        body();
        return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    };
    // Whatever a model makes at its first colour is no part of the speed.
    plan->store({work[0].in[0].data(), work[0].in[1].data(), work[0].in[2].data()}, 1, work[0].planes);
    for (std::size_t first = 0; first < rows; first += rows_at_once) {
        const std::size_t count = std::min(rows_at_once, rows - first);
        const auto each = [&](const auto& body) {
            arena.execute([&] { parallel_for(std::size_t{0}, count, [&](std::size_t i) { body(work[i], first + i); }); });
        };
        each([&](Row& w, std::size_t y) {
            w.count = static_cast<std::size_t>(std::min<std::uint64_t>(row, report.pixels - y * row));
            for (std::size_t x = 0; x < w.count; ++x) {
                const auto code = static_cast<std::uint32_t>((y * row + x) * stride);
                for (std::size_t c = 0; c < 3; ++c) w.in[c][x] = linear[code >> (16 - 8 * c) & 255];
            }
        });
        report.store_seconds += seconds([&] {
            each([&](Row& w, std::size_t) { plan->store({w.in[0].data(), w.in[1].data(), w.in[2].data()}, w.count, w.planes); });
        });
        report.relight_seconds += seconds([&] {
            each([&](Row& w, std::size_t) {
                const std::vector<const std::byte*> stored(w.planes.begin(), w.planes.end());
                plan->reproject(stored, w.count, {w.out[0].data(), w.out[1].data(), w.out[2].data()});
            });
        });
        each([&](Row& w, std::size_t) {
            const std::array<const float*, 3> a{w.in[0].data(), w.in[1].data(), w.in[2].data()},
                b{w.out[0].data(), w.out[1].data(), w.out[2].data()};
            kernel(a, b, w.count, w.difference.data());
            w.changed = count_changed_codes(a, b, w.count);
            w.outside = 0;
            if (store == Store::spectral && type == PixelType::float32)
                for (std::size_t b2 = 0; b2 < report.channels; ++b2) {
                    const auto* plane = reinterpret_cast<const float*>(w.planes[b2]);
                    for (std::size_t x = 0; x < w.count; ++x) w.outside += !(plane[x] >= 0 && plane[x] <= 1);
                }
        });
        for (std::size_t i = 0; i < count; ++i) {
            if (auto added = accumulator.add_row(static_cast<std::int64_t>(first + i), {work[i].difference.data(), work[i].count});
                !added)
                return added.error();
            accumulator.add_changed_codes(work[i].changed);
            report.outside += work[i].outside;
        }
    }
    auto difference = accumulator.finish();
    if (!difference) return std::move(difference).error();
    report.difference = *difference;
    if (auto& at = report.difference.max_at; at[0] >= 0) {
        const auto code = static_cast<std::int64_t>(static_cast<std::uint64_t>(at[1] * static_cast<std::int64_t>(row) + at[0]) * stride);
        at = {code >> 16, code & 0xffff};
    }
    return report;
}

}  // namespace spectex
