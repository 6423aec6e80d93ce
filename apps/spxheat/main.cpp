// spxheat: false-colour pictures of differences.
#include <fmt/format.h>

#include "options.h"
#include "reports.h"
#include "spectex/heatmap.h"

using namespace spectex;
using namespace spectex::app;

int main(int argc, char** argv) {
    App app({"spxheat", "MAP.exr | A B -o OUT.png [options]",
             "Draws a map of differences, or the differences of two images, in false colour with a legend.",
             {{"spxheat map.exr -o map.png --legend", "0 to the 99.9th percentile"},
              {"spxheat a.png b.png -o heat.png --legend --range 0:35 --metric cie76", "on the scale of a published figure"}}});
    std::vector<std::string> arguments;
    std::string output, metric_text = "cie76", colormap = "magma", input_colorspace;
    std::optional<std::array<double, 2>> range;
    bool legend = false;
    app.positional("IN", &arguments, 1, 2, "a one-channel map (spxdiff --map), or two images, the first the reference");
    app.group("Picture");
    app.add({.names = "-o,--output", .metavar = "OUT.png", .text = "picture to write", .required = true,
             .set = [&](std::string_view v) -> Status {
                 output = v;
                 return {};
             }});
    app.add({.names = "--range", .metavar = "LO:HI", .text = "values at the ends of the scale",
             .default_value = "0 to the 99.9th percentile, rounded up", .set = [&](std::string_view v) -> Status {
                 const auto parsed = parse_range(v);
                 if (!parsed) return parsed.error();
                 range = *parsed;
                 return {};
             }});
    app.choice("--colormap", "NAME", &colormap, color_map_names(), "colour map");
    app.flag("--legend", &legend, "draw the scale beside the map, with mean, p99 and max");
    app.choice("--metric", "METRIC", &metric_text, {"cie76", "cie94", "ciede2000", "cmc", "din99", "itp", "oklab"},
               "colour difference between two images");
    add_input_colorspace(app, input_colorspace);

    return app.main(argc, argv, [&]() -> int {
        const auto metric = parse_metric(metric_text);
        if (!metric) return app.report(metric.error());
        const auto inputs = app.inputs(arguments);
        if (!inputs) return app.report(inputs.error());
        if (inputs->size() > 2) return app.usage_error(fmt::format("{} files: expected a map or two images", inputs->size()));
        const NamedOutput outputs[] = {{"-o", output}};
        if (auto s = check_outputs(*inputs, outputs); !s) return app.report(s.error());
        const auto progress = app.progress((*inputs)[0]);
        HeatmapOptions options;
        options.job = job_options(app, progress, input_colorspace);
        options.metric = *metric;
        options.range = range;
        options.colormap = colormap;
        options.legend = legend;
        const auto report = heatmap((*inputs)[0], inputs->size() == 2 ? (*inputs)[1] : "", output, options);
        if (!report) return app.report(report.error());
        const Explanation lines = {{"scale", fmt::format("{} to {} in {}", report->low, report->high, colormap)},
                                   {"size", fmt::format("{} x {}", report->width, report->height)}};
        explain(app, "heatmap", lines);
        app.note(fmt::format("{}: {} x {}, scale {:.4g} to {:.4g}, {}; {} pixels above the scale", output, report->width,
                             report->height, report->low, report->high, summary(report->statistics), report->above));
        Json json = to_json(report->statistics, *metric);
        if (inputs->size() == 1) json.erase("metric");
        json.erase("changed_codes");
        json["input"] = (*inputs)[0];
        json["output"] = output;
        json["range"] = {report->low, report->high};
        json["above"] = report->above;
        json["below"] = report->below;
        json["width"] = report->width;
        json["height"] = report->height;
        app.record(std::move(json));
        return exit_ok;
    });
}
