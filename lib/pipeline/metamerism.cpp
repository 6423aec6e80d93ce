// Where methods that agree under one light disagree under others.
#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "pipeline/map_writer.h"
#include "pipeline/roundtrip.h"
#include "pipeline/strips.h"

namespace spectex {
namespace {

using namespace pipeline;

/// The worst of a colour: over all lights and pairs of methods.
struct Worst {
    float difference = 0;
    std::uint16_t combination = 0;  // light * pairs + pair
    std::uint8_t changed = 0;
};

/// The last colours that a thread has met, found by a hash: textures of 8 bits repeat theirs. A slot keeps the latest.
class Memory {
public:
    static constexpr std::size_t slots = std::size_t{1} << 16;
    using Key = std::array<float, 3>;
    const Worst* find(const Key& key) const {
        const Slot& slot = slots_[index(key)];
        return slot.used && std::memcmp(&slot.key, &key, sizeof key) == 0 ? &slot.worst : nullptr;
    }
    void keep(const Key& key, const Worst& worst) { slots_[index(key)] = {key, worst, true}; }

private:
    struct Slot {
        Key key{};
        Worst worst;
        bool used = false;
    };
    static std::size_t index(const Key& key) {
        std::uint64_t h = 0;
        for (const float v : key) {
            std::uint32_t bits = 0;
            std::memcpy(&bits, &v, sizeof bits);
            h = (h ^ bits) * 0x9E3779B97F4A7C15u;  // Fibonacci hashing, Knuth 1973, 6.4
        }
        return static_cast<std::size_t>(h >> 48);
    }
    std::vector<Slot> slots_{slots};
};

struct Candidate {
    std::shared_ptr<const Model> model;
    RelightPlan plan;
};

struct Comparison {
    std::vector<Candidate> methods;
    std::vector<DifferenceKernel> kernels;  // per light, against its white
    std::vector<std::array<std::size_t, 2>> pairs;

    /// Worst of n colours in the gamut.
    void operator()(std::array<const float*, 3> rgb, std::size_t n, std::span<Worst> out) const {
        const std::size_t lights = kernels.size();
        thread_local std::vector<std::vector<float>> lit;
        thread_local std::vector<float> difference;
        lit.resize(methods.size() * 3 * lights);
        for (auto& plane : lit) plane.resize(std::max(plane.size(), n));
        difference.resize(std::max(difference.size(), n));
        for (std::size_t m = 0; m < methods.size(); ++m) {
            std::vector<float*> planes;
            for (std::size_t i = 0; i < 3 * lights; ++i) planes.push_back(lit[m * 3 * lights + i].data());
            methods[m].plan.execute_colors(rgb, n, planes);
        }
        const auto image = [&](std::size_t m, std::size_t k, std::size_t offset) {
            const auto* planes = &lit[(m * lights + k) * 3];
            return std::array<const float*, 3>{planes[0].data() + offset, planes[1].data() + offset, planes[2].data() + offset};
        };
        for (std::size_t p = 0; p < n; ++p) out[p] = {-1, 0, 0};
        for (std::size_t k = 0; k < lights; ++k)
            for (std::size_t i = 0; i < pairs.size(); ++i) {
                kernels[k](image(pairs[i][0], k, 0), image(pairs[i][1], k, 0), n, difference.data());
                for (std::size_t p = 0; p < n; ++p)
                    // A NaN stays: a pixel that cannot be compared is counted, not hidden.
                    if (difference[p] > out[p].difference || std::isnan(difference[p]))
                        out[p] = {difference[p], static_cast<std::uint16_t>(k * pairs.size() + i), 0};
            }
        for (std::size_t p = 0; p < n; ++p) {
            const std::size_t k = out[p].combination / pairs.size();
            const auto& pair = pairs[out[p].combination % pairs.size()];
            out[p].changed = static_cast<std::uint8_t>(count_changed_codes(image(pair[0], k, p), image(pair[1], k, p), 1));
        }
    }
};

}  // namespace

Result<MetamerismReport> compare_metamerism(const std::string& input, const MetamerismOptions& options) {
    const auto usage = [&](std::string why) { return Error{ErrorKind::usage, std::move(why)}; };
    if (!options.map.empty() && same_file(input, options.map)) return usage(fmt::format("{}: the map is the input itself", options.map));
    if (options.illuminants.empty()) return usage("no illuminant is given: expected lights to compare methods under, such as -i A,FL11");
    if (options.methods.size() < 2) return usage(fmt::format("{} methods: expected two at least to compare", options.methods.size()));
    for (std::size_t i = 0; i < options.methods.size(); ++i)
        for (std::size_t j = 0; j < i; ++j)
            if (options.methods[i] == options.methods[j]) return usage(fmt::format("method {} is given twice", options.methods[i]));
    const std::size_t pair_count = options.methods.size() * (options.methods.size() - 1) / 2;
    constexpr std::size_t most_combinations = 4096;
    if (pair_count * options.illuminants.size() > most_combinations)
        return usage(fmt::format("{} pairs of methods under {} lights: expected at most {} combinations", pair_count,
                                 options.illuminants.size(), most_combinations));
    const auto kind = probe(input);
    if (!kind) return kind.error();
    if (*kind != FileKind::image)
        return Error{ErrorKind::input, fmt::format("{}: holds spectra or coefficients already: expected a texture in RGB, whose spectra "
                                                   "are open", input)};
    auto colorimetry = Colorimetry::make(options.colorimetry, options.bands);
    if (!colorimetry) return std::move(colorimetry).error();
    RelightRequest request;
    request.observer = colorimetry->observer().id;
    request.illuminants = options.illuminants;
    request.output_space = colorimetry->rgb_space().name;
    auto output = Colorimetry::make({request.observer, "", request.output_space, RgbMatrix::integrated}, options.bands);
    if (!output) return std::move(output).error();

    Comparison comparison;
    for (const auto& id : options.methods) {
        auto model = make_model(id, *colorimetry);
        if (!model) return std::move(model).error();
        auto plan = RelightPlan::for_model(*model, request);
        if (!plan) return std::move(plan).error();
        comparison.methods.push_back({*std::move(model), *std::move(plan)});
    }
    for (std::size_t i = 0; i < options.methods.size(); ++i)
        for (std::size_t j = i + 1; j < options.methods.size(); ++j) comparison.pairs.push_back({i, j});
    for (const auto& light : options.illuminants) {
        auto weights = tristimulus_weights(options.bands, output->observer(), light, Normalization::luminance);
        if (!weights) return std::move(weights).error();
        comparison.kernels.emplace_back(options.metric, output->rgb_to_xyz(), output->rgb_to_xyz(), weights->white);
    }

    JobOptions color = options.job;
    color.select.color_only = true;
    auto opened = open_image_source(input, colorimetry->rgb_space(), color);
    if (!opened) return std::move(opened).error();
    auto& source = **opened;
    const auto& geometry = source.geometry();
    const int width = geometry.width;
    MetamerismReport report;
    report.white = fmt::format("of each light, {}", colorimetry->observer().title);
    auto map = MapWriter::create(options.map, geometry, options.metric, report.white, options.job);
    if (!map) return std::move(map).error();

    struct Strip {
        RawStrip raw;
        std::vector<Worst> worst;
    };
    DifferenceAccumulator accumulator;
    CountTotals totals;
    const std::size_t combinations = comparison.pairs.size() * options.illuminants.size();
    std::vector<std::uint64_t> pixels(combinations, 0);
    std::vector<float> largest(combinations, 0), values(static_cast<std::size_t>(width));
    Worst worst{-1, 0, 0};
    const std::size_t row_bytes = source.raw_bytes_per_row() + static_cast<std::size_t>(width) * (sizeof(Worst) + sizeof(float));
    tbb::enumerable_thread_specific<Memory> memories;
    const auto status = run_strips(
        options.job, width, geometry.height, rows_per_strip(source.preferred_rows(), row_bytes, geometry.height), [] { return Strip{}; },
        [&](Strip& s, int y, int n) { return source.read(y, n, s.raw); },
        [&](Strip& s, int y, int n) -> Status {
            s.worst.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(n));
            FirstError error;
            for_row_groups(n, width, [&](int first, int count) {
                thread_local Scratch scratch;
                thread_local std::array<std::vector<float>, 3> fresh;
                thread_local std::vector<std::size_t> open;
                thread_local std::vector<Worst> found;
                Memory& memory = memories.local();
                const std::size_t begin = static_cast<std::size_t>(first) * static_cast<std::size_t>(width);
                const std::size_t size = static_cast<std::size_t>(count) * static_cast<std::size_t>(width);
                std::vector<const float*> in;
                source.decode(s.raw, begin, size, scratch.decode, in);
                std::array<float*, 3> rgb{};
                for (std::size_t c = 0; c < 3; ++c) {
                    scratch.rgb[c].resize(std::max(scratch.rgb[c].size(), size));
                    std::copy_n(in[c], size, scratch.rgb[c].data());
                    rgb[c] = scratch.rgb[c].data();
                }
                Counts counts;
                if (auto mapped = map_colors(rgb, size, options.gamut, *colorimetry, {input, y, begin, width}, counts); !mapped) {
                    error.check(mapped);
                    return;
                }
                totals.add(counts, y, width);
                // Colours that this thread has met lately are not computed again. What is computed depends on the colour alone, so
                // the bytes do not depend on who met it.
                constexpr std::size_t block = 2048;
                for (std::size_t from = 0; from < size; from += block) {
                    const std::size_t to = std::min(from + block, size);
                    open.clear();
                    for (auto& plane : fresh) plane.clear();
                    for (std::size_t p = from; p < to; ++p) {
                        const Memory::Key key{rgb[0][p], rgb[1][p], rgb[2][p]};
                        if (const Worst* known = memory.find(key)) {
                            s.worst[begin + p] = *known;
                            continue;
                        }
                        open.push_back(p);
                        for (std::size_t c = 0; c < 3; ++c) fresh[c].push_back(key[c]);
                    }
                    if (open.empty()) continue;
                    found.resize(open.size());
                    comparison({fresh[0].data(), fresh[1].data(), fresh[2].data()}, open.size(), found);
                    for (std::size_t i = 0; i < open.size(); ++i) {
                        s.worst[begin + open[i]] = found[i];
                        memory.keep({fresh[0][i], fresh[1][i], fresh[2][i]}, found[i]);
                    }
                }
            });
            return error.status();
        },
        [&](Strip& s, int y, int n) -> Status {
            for (int row = 0; row < n; ++row) {
                std::uint64_t changed = 0;
                for (std::size_t x = 0; x < values.size(); ++x) {
                    const Worst& w = s.worst[static_cast<std::size_t>(row) * values.size() + x];
                    values[x] = w.difference;
                    changed += w.changed;
                    if (!std::isfinite(w.difference)) continue;
                    // Where nothing differs, no pair is the worst.
                    if (w.difference > 0) ++pixels[w.combination];
                    largest[w.combination] = std::max(largest[w.combination], w.difference);
                    if (w.difference > worst.difference) worst = w;
                }
                accumulator.add_changed_codes(changed);
                if (auto st = accumulator.add_row(y + row, values); !st) return st;
                if (auto st = map->write_row(y + row, values); !st) return st;
            }
            return {};
        });
    if (!status) return status.error();
    report.input = source.report();
    totals.put_into(report.input);
    if (auto s = check_strict(options.job, report.input); !s) return s.error();
    auto statistics = accumulator.finish();
    if (!statistics) return std::move(statistics).error();
    report.statistics = *std::move(statistics);
    const auto named = [&](std::size_t combination) {
        const auto& pair = comparison.pairs[combination % comparison.pairs.size()];
        return MetamerismReport::Combination{options.illuminants[combination / comparison.pairs.size()].name,
                                             {options.methods[pair[0]], options.methods[pair[1]]}, pixels[combination],
                                             largest[combination]};
    };
    report.worst = named(worst.combination);
    for (std::size_t c = 0; c < combinations; ++c)
        if (pixels[c] > 0) report.combinations.push_back(named(c));
    std::stable_sort(report.combinations.begin(), report.combinations.end(),
                     [](const auto& a, const auto& b) { return a.pixels > b.pixels; });
    for (const auto& candidate : comparison.methods)
        for (const auto& line : candidate.plan.explanation())
            if (line.key == "kernel") report.explanation.push_back({candidate.model->info().id, line.text});
    report.explanation.push_back({"skipped", "colours met lately: computed once"});
    if (auto s = map->commit(); !s) return s.error();
    return report;
}

}  // namespace spectex
