#include <fmt/format.h>
#include <time.h>

#include <algorithm>
#include <functional>
#include <limits>
#include <random>

#include "plan/color_memory.h"
#include "spectex/kernel_speed.h"
#include "spectex/plan.h"

namespace spectex {
namespace {

using plan::ColorMemory;

constexpr std::size_t strip_pixels = 8192;

double cpu_seconds() {
    timespec t{};
    ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

/// Colours of which a share were met a moment before, in no order.
std::array<std::vector<float>, 3> colors_with_repeats(std::size_t n, double share, std::mt19937& random) {
    std::array<std::vector<float>, 3> colors;
    for (auto& plane : colors) plane.resize(n);
    std::uniform_real_distribution<float> unit(0, 1);
    // As far back as a memory reaches that is not crowded.
    constexpr std::size_t reach = 2048;
    for (std::size_t p = 0; p < n; ++p) {
        const bool repeated = p > 0 && unit(random) < static_cast<float>(share);
        const std::size_t from = repeated ? p - 1 - random() % std::min(p, reach) : 0;
        for (auto& plane : colors) plane[p] = repeated ? plane[from] : unit(random);
    }
    return colors;
}

/// Nanoseconds a colour, at least of some rounds: interruptions only add.
double best_of(int rounds, std::size_t n, const std::function<void()>& run) {
    double best = std::numeric_limits<double>::infinity();
    for (int round = 0; round < rounds; ++round) {
        const double begin = cpu_seconds();
        run();
        best = std::min(best, 1e9 * (cpu_seconds() - begin) / static_cast<double>(n));
    }
    return best;
}

class Forced {
public:
    explicit Forced(ColorMemory::Use use) { ColorMemory::use = use; }
    ~Forced() { ColorMemory::use = ColorMemory::Use::as_it_pays; }
    Forced(const Forced&) = delete;
    Forced& operator=(const Forced&) = delete;
};

/// Where the line of differences between neighbouring shares crosses zero; 1 where remembering never wins.
double crossing(const std::vector<MemorySpeed::Point>& points) {
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double gain = points[i].computed_ns - points[i].remembered_ns;
        if (gain < 0) continue;
        if (i == 0) return points[0].share;
        const double before = points[i - 1].computed_ns - points[i - 1].remembered_ns;
        return points[i - 1].share + (points[i].share - points[i - 1].share) * -before / (gain - before);
    }
    return 1;
}

}  // namespace

Result<std::vector<MemorySpeed>> measure_color_memory(std::span<const std::string> methods, int rounds) {
    if (rounds < 1 || rounds > 1000) return Error{ErrorKind::usage, fmt::format("{} rounds: expected 1 to 1000", rounds)};
    const auto bands = BandSet::parse("36");
    if (!bands) return bands.error();
    auto light = parse_illuminant("A");
    if (!light) return std::move(light).error();
    RelightRequest request;
    request.illuminants = {*std::move(light)};
    std::vector<MemorySpeed> results;
    for (const auto& id : methods) {
        const auto colorimetry = Colorimetry::make({}, *bands);
        if (!colorimetry) return colorimetry.error();
        const auto model = make_model(id, *colorimetry);
        if (!model) return model.error();
        if ((*model)->info().pieces != Pieces::nonlinear) continue;
        const auto coefficients = StorePlan::make(*model, Store::coefficients, PixelType::float32);
        const auto spectra = StorePlan::make(*model, Store::spectral, PixelType::float32);
        const auto relight = RelightPlan::for_model(*model, request);
        if (!coefficients) return coefficients.error();
        if (!spectra) return spectra.error();
        if (!relight) return relight.error();
        std::vector<std::vector<float>> out(std::max<std::size_t>(spectra->channels(), 8), std::vector<float>(strip_pixels));
        std::vector<std::byte*> planes;
        std::vector<float*> lit;
        for (auto& plane : out) planes.push_back(reinterpret_cast<std::byte*>(plane.data())), lit.push_back(plane.data());
        using Colors = std::array<const float*, 3>;
        const auto store = [&planes](const StorePlan& plan) {
            return [&planes, stored = &plan](const Colors& c, std::size_t n) { stored->store(c, n, {planes.data(), stored->channels()}); };
        };
        struct Work {
            std::string name;
            std::function<void(const Colors&, std::size_t)> run;
            const Explanation& explanation;
        };
        const Work works[] = {{"coefficients", store(*coefficients), coefficients->explanation()},
                              {"36 bands", store(*spectra), spectra->explanation()},
                              {"relit under A", [&](const Colors& c, std::size_t n) { relight->execute_colors(c, n, {lit.data(), 3}); }, relight->explanation()}};
        for (const Work& work : works) {
            MemorySpeed row;
            row.method = id;
            row.work = work.name;
            for (const auto& line : work.explanation)
                if (line.text.starts_with("colours met before")) row.decision = line.text;
            // As many colours as take a moment.
            std::mt19937 random(1);
            std::size_t n = strip_pixels;
            {
                const auto c = colors_with_repeats(256, 0, random);
                const Forced never(ColorMemory::Use::never);
                const double ns = best_of(2, 256, [&] { work.run({c[0].data(), c[1].data(), c[2].data()}, 256); });
                n = std::clamp<std::size_t>(static_cast<std::size_t>(2e7 / std::max(ns, 1.0)) / 1024 * 1024, 1024, 4 * strip_pixels);
            }
            for (const double share : {0.0, 0.05, 0.1, 0.25, 0.5, 0.9}) {
                const auto c = colors_with_repeats(n, share, random);
                const auto all = [&] {
                    for (std::size_t at = 0; at < n; at += strip_pixels) work.run({c[0].data() + at, c[1].data() + at, c[2].data() + at}, std::min(strip_pixels, n - at));
                };
                MemorySpeed::Point point{share, 0, 0};
                {
                    const Forced never(ColorMemory::Use::never);
                    point.computed_ns = best_of(rounds, n, all);
                }
                {
                    const Forced always(ColorMemory::Use::always);
                    // Every round with colours that it has not seen, or all of them would be found.
                    double best = std::numeric_limits<double>::infinity();
                    for (int round = 0; round < rounds; ++round) {
                        auto fresh = colors_with_repeats(n, share, random);
                        best = std::min(best, best_of(1, n, [&] {
                            for (std::size_t at = 0; at < n; at += strip_pixels)
                                work.run({fresh[0].data() + at, fresh[1].data() + at, fresh[2].data() + at}, std::min(strip_pixels, n - at));
                        }));
                    }
                    point.remembered_ns = best;
                }
                row.points.push_back(point);
            }
            row.break_even = crossing(row.points);
            results.push_back(std::move(row));
        }
    }
    return results;
}

}  // namespace spectex
