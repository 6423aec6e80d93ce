#include "pipeline/difference.h"

#include <fmt/format.h>

#include <cmath>

#include "pipeline/map_writer.h"
#include "pipeline/roundtrip.h"

namespace spectex {

using namespace pipeline;

namespace pipeline {

Result<DifferencePair> DifferencePair::open(const std::string& a, const std::string& b, const DifferenceOptions& options) {
    // Differences are taken in linear BT.709 with negative values: any space fits, the primaries do not matter to Lab.
    auto colorimetry = Colorimetry::make({options.observer, "D65", "BT.709", options.matrix},
                                         BandSet(SpectralShape::make(380, 780, 1).value()));
    if (!colorimetry) return std::move(colorimetry).error();
    auto first = LinearSource::open(a, colorimetry->rgb_space(), options.observer, options.job);
    if (!first) return std::move(first).error();
    auto second = LinearSource::open(b, colorimetry->rgb_space(), options.observer, options.job);
    if (!second) return std::move(second).error();
    const auto& ga = first->strips().geometry();
    const auto& gb = second->strips().geometry();
    if (!ga.same_size(gb))
        return Error{ErrorKind::input, fmt::format("{} is {} x {}, {} is {} x {}: expected images of one size", a, ga.width,
                                                   ga.height, b, gb.width, gb.height)};
    const Vector3 white = options.matrix == RgbMatrix::standard ? xyz_from_xy(0.3127, 0.3290) : colorimetry->white_xyz();
    const double sum = white[0] + white[1] + white[2];
    DifferencePair pair{*std::move(first), *std::move(second),
                        DifferenceKernel(options.metric, colorimetry->rgb_to_xyz(), colorimetry->rgb_to_xyz(), white),
                        fmt::format("D65 {}, x {:.5f} y {:.5f}, {}",
                                    options.matrix == RgbMatrix::standard ? "of the standard" : "integrated at 1 nm, 380-780 nm",
                                    white[0] / sum, white[1] / sum, colorimetry->observer().title),
                        {}, {}};
    pair.report_a = pair.a.strips().report();
    pair.report_b = pair.b.strips().report();
    return pair;
}

}  // namespace pipeline

Result<DifferenceReport> compare_files(const std::string& a, const std::string& b, const DifferenceOptions& options) {
    auto pair = DifferencePair::open(a, b, options);
    if (!pair) return std::move(pair).error();
    for (const auto& input : {a, b})
        if (!options.map.empty() && same_file(input, options.map))
            return Error{ErrorKind::usage, fmt::format("{}: the map is an input itself", options.map)};
    auto map = MapWriter::create(options.map, pair->a.strips().geometry(), options.metric, pair->white, options.job);
    if (!map) return std::move(map).error();
    DifferenceAccumulator accumulator;
    std::array<std::int64_t, 2> first_bad{-1, -1};
    const auto status = run_differences(*pair, options.job, true, [&](int y, int rows, std::span<const float> values,
                                                                      std::span<const std::uint64_t> changed) -> Status {
        const std::size_t width = values.size() / static_cast<std::size_t>(rows);
        for (int row = 0; row < rows; ++row) {
            const auto line = values.subspan(static_cast<std::size_t>(row) * width, width);
            accumulator.add_changed_codes(changed[static_cast<std::size_t>(row)]);
            for (std::size_t x = 0; first_bad[0] < 0 && x < width; ++x)
                if (!std::isfinite(line[x])) first_bad = {static_cast<std::int64_t>(x), y + row};
            if (auto s = accumulator.add_row(y + row, line); !s) return s;
            if (auto s = map->write_row(y + row, line); !s) return s;
        }
        return {};
    });
    if (!status) return status.error();
    auto statistics = accumulator.finish();
    if (!statistics) return std::move(statistics).error();
    DifferenceReport report;
    report.a = pair->report_a;
    report.b = pair->report_b;
    report.statistics = *std::move(statistics);
    report.white = pair->white;
    report.a.nonfinite = report.statistics.nonfinite;
    report.a.first_nonfinite = first_bad;
    if (auto s = check_strict(options.job, report.a); !s) return s.error();
    if (auto s = map->commit(); !s) return s.error();
    return report;
}

Result<DifferenceReport> compare_roundtrip(const std::string& input, const UpliftSettings& settings,
                                           const DifferenceOptions& options) {
    if (!options.map.empty() && same_file(input, options.map))
        return Error{ErrorKind::usage, fmt::format("{}: the map is the input itself", options.map)};
    auto setup = UpliftSetup::make(input, settings, options.job);
    if (!setup) return std::move(setup).error();
    const auto& colorimetry = setup->model->colorimetry();
    const auto& geometry = setup->source->geometry();
    const int width = geometry.width;
    const auto standard = Colorimetry::make({colorimetry.observer().id, "", colorimetry.rgb_space().name, RgbMatrix::standard},
                                            colorimetry.bands());
    if (!standard) return standard.error();
    const Vector3 white = colorimetry.white_xyz();
    const double sum = white[0] + white[1] + white[2];
    DifferenceReport report;
    report.white = fmt::format("{} integrated at 1 nm, {}-{} nm, x {:.5f} y {:.5f}, {}", colorimetry.illuminant().name,
                               colorimetry.bands().front(), colorimetry.bands().back(), white[0] / sum, white[1] / sum,
                               colorimetry.observer().title);
    auto map = MapWriter::create(options.map, geometry, options.metric, report.white, options.job);
    if (!map) return std::move(map).error();

    // A reader who takes the standard's rounded white for the stored reflectance gets this XYZ of each stored colour.
    const DifferenceKernel kernel(options.metric, colorimetry.rgb_to_xyz(), colorimetry.rgb_to_xyz(), white);
    const auto& space = colorimetry.rgb_space();
    const DifferenceKernel under_standard(options.metric, standard->rgb_to_xyz(), colorimetry.rgb_to_xyz(),
                                          xyz_from_xy(space.white_xy[0], space.white_xy[1]));
    struct Buffers {
        RawStrip raw;
        std::vector<float> difference, standard;
        std::vector<std::uint64_t> changed;
    };
    const std::size_t stored = setup->plan.channels(), sample = pixel_bytes(setup->plan.type());
    const int rows = rows_per_strip(setup->source->preferred_rows(),
                                    setup->source->raw_bytes_per_row() + static_cast<std::size_t>(width) * 8, geometry.height);
    DifferenceAccumulator accumulator, standard_accumulator;
    CountTotals totals;
    const auto status = run_strips(
        options.job, width, geometry.height, rows, [] { return Buffers{}; },
        [&](Buffers& b, int y, int n) { return setup->source->read(y, n, b.raw); },
        [&](Buffers& b, int y, int n) -> Status {
            const std::size_t pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(n);
            b.difference.resize(pixels);
            b.standard.resize(pixels);
            b.changed.assign(static_cast<std::size_t>(n), 0);
            FirstError error;
            for_row_groups(n, width, [&](int first, int count) {
                thread_local Scratch scratch;
                thread_local std::vector<std::byte> samples;
                const std::size_t begin = static_cast<std::size_t>(first) * static_cast<std::size_t>(width);
                const std::size_t size = static_cast<std::size_t>(count) * static_cast<std::size_t>(width);
                samples.resize(std::max(samples.size(), stored * size * sample));
                std::vector<std::byte*> planes;
                for (std::size_t i = 0; i < stored; ++i) planes.push_back(samples.data() + i * size * sample);
                Counts counts;
                if (auto s = setup->convert(b.raw, y, begin, size, scratch, planes, counts); !s) {
                    error.check(s);
                    return;
                }
                totals.add(counts, y, width);
                const auto w = static_cast<std::size_t>(width);
                for (std::size_t row = 0; row < static_cast<std::size_t>(count); ++row) {
                    const std::size_t at = begin + row * w;
                    measure_row(*setup, kernel, scratch, planes, row * w, w, b.difference.data() + at,
                                b.changed[static_cast<std::size_t>(first) + row]);
                    under_standard({scratch.input[0].data() + row * w, scratch.input[1].data() + row * w, scratch.input[2].data() + row * w},
                                   {scratch.back[0].data(), scratch.back[1].data(), scratch.back[2].data()}, w,
                                   b.standard.data() + at);
                }
            });
            return error.status();
        },
        [&](Buffers& b, int y, int n) -> Status {
            for (int row = 0; row < n; ++row) {
                const std::size_t at = static_cast<std::size_t>(row) * static_cast<std::size_t>(width);
                const std::span<const float> values(b.difference.data() + at, static_cast<std::size_t>(width));
                accumulator.add_changed_codes(b.changed[static_cast<std::size_t>(row)]);
                if (auto s = accumulator.add_row(y + row, values); !s) return s;
                if (auto s = standard_accumulator.add_row(y + row, {b.standard.data() + at, static_cast<std::size_t>(width)}); !s)
                    return s;
                if (auto s = map->write_row(y + row, values); !s) return s;
            }
            return {};
        });
    if (!status) return status.error();
    report.a = setup->source->report();
    totals.put_into(report.a);
    if (auto s = check_strict(options.job, report.a); !s) return s.error();
    auto statistics = accumulator.finish();
    if (!statistics) return std::move(statistics).error();
    report.statistics = *std::move(statistics);
    auto standard_statistics = standard_accumulator.finish();
    if (!standard_statistics) return std::move(standard_statistics).error();
    report.standard_matrix = *std::move(standard_statistics);
    if (auto s = map->commit(); !s) return s.error();
    report.path = fmt::format("{} -> {} as {} ({} channels) -> {}", report.a.colorspace, setup->model->info().id,
                              pixel_type_name(setup->plan.type()), stored, colorimetry.describe());
    return report;
}

}  // namespace spectex
