// spxheat: false-colour pictures of differences.
#include <fmt/format.h>

#include <algorithm>

#include "figure1.h"
#include "options.h"
#include "reports.h"
#include "spectex/heatmap.h"

using namespace spectex;
using namespace spectex::app;

namespace {

/// Narrower panels have no room for their text.
constexpr int least_panel = 120;

struct Figure1Request {
    std::vector<std::string> methods{"lattice", "meng2015"};
    GamutRenderingOptions rendering;
    std::int64_t samples = 64, seed = 1, bits = 8;
    std::int64_t width = 2400;
};

int figure1(App& app, const std::string& output, const Figure1Request& request, Figure1Style style) {
    for (const char* option : {"--legend", "--metric", "--input-colorspace"})
        if (app.given(option)) return app.usage_error(fmt::format("{} does not go with figure1", option));
    for (const auto& id : request.methods)
        if (const auto known = find_method(id); !known) return app.report(known.error());
    GamutRenderingOptions options = request.rendering;
    options.methods = request.methods;
    options.samples_per_pixel = static_cast<int>(request.samples);
    options.seed = static_cast<std::uint64_t>(request.seed);
    options.bits = static_cast<int>(request.bits);
    options.threads = app.threads();
    style.width = static_cast<int>(request.width);
    options.panel = figure1_panel(style.width, options.methods.size());
    if (options.panel < least_panel)
        return app.usage_error(fmt::format("--width {}: too narrow for {} methods, a panel would have {} pixels: expected {} or more",
                                           style.width, options.methods.size(), options.panel, least_panel));
    const auto type = storable_type(output, PixelType::uint8);
    if (!type || *type != PixelType::uint8)
        return app.report({ErrorKind::usage, fmt::format("{}: expected a picture format of 8 bits, such as .png, .tif or .jpg", output)});
    const auto colorimetry = Colorimetry::make({}, BandSet());
    if (!colorimetry) return app.report(colorimetry.error());
    const auto progress = app.progress("figure1");
    options.progress = job_options(app, progress, "").progress;
    if (App::lines_only) return exit_ok;
    const auto rendering = render_gamut(*colorimetry, options);
    if (!rendering) return app.report(rendering.error());
    style.caption = fmt::format("A plane with {} as its albedo under CIE D65 from all sides. Hero-wavelength Monte Carlo, {} samples of 4 "
                                "wavelengths a pixel. Differences in CIE76, white D65, CIE 1931 2°.",
                                options.bits == 8 ? "every 8-bit sRGB colour once" : fmt::format("{} sRGB colours", rendering->texels),
                                options.samples_per_pixel);
    const auto picture = draw_figure1(*rendering, style);
    if (!picture) return app.report(picture.error(), output);
    if (const auto written = write_picture(output, *picture, app.threads()); !written) return app.report(written.error(), output);

    Json json{{"figure", "figure1"}, {"output", output}, {"width", picture->width}, {"height", picture->height}, {"texels", rendering->texels},
              {"samples_per_pixel", options.samples_per_pixel}, {"wavelengths_per_sample", 4}, {"seed", request.seed},
              {"range", style.range}, {"methods", Json::array()}};
    for (const auto& method : rendering->methods) {
        const auto part = [](const DifferenceStatistics& s) {
            auto figures = to_json(s, Metric::cie76);
            figures.erase("changed_codes");
            return figures;
        };
        json["methods"].push_back({{"method", method.method}, {"noise", part(method.noise)}, {"distortion", part(method.distortion)}});
        app.note(fmt::format("{}: noise and imprecision {}", method.method, summary(method.noise)));
        app.note(fmt::format("{}: colour distortion {}", method.method, summary(method.distortion)));
    }
    app.record(std::move(json));
    return exit_ok;
}

}  // namespace

int main(int argc, char** argv) {
    App app({"spxheat", "MAP.exr | A B -o OUT.png [options]\nfigure1 -o OUT.png [options]",
             "Draws a map of differences, or the differences of two images, in false colour with a legend.",
             {{"spxheat map.exr -o map.png --legend", "0 to the 99.9th percentile"},
              {"spxheat a.png b.png -o heat.png --legend --range 0:35 --metric cie76", "on the scale of a published figure"},
              {"spxheat figure1 -o figure1.png --methods lattice,jakob2019,meng2015",
               "every sRGB colour rendered by spectra, and where it errs, as in figure 1 of Mallett and Yuksel 2019"}}});
    std::vector<std::string> arguments;
    std::string output, metric_text = "cie76", colormap = "magma", input_colorspace;
    std::optional<std::array<double, 2>> range;
    bool legend = false;
    Figure1Request request;
    app.positional("IN", &arguments, 1, 2,
                   "a one-channel map (spxdiff --map), or two images, the first the reference; figure1 for the figure of the paper");
    app.group("Picture");
    app.add({.names = "-o,--output", .metavar = "OUT.png", .text = "picture to write", .required = true,
             .set = [&](std::string_view v) -> Status {
                 output = v;
                 return {};
             }});
    app.add({.names = "--range", .metavar = "LO:HI", .text = "values at the ends of the scale",
             .default_value = "0 to the 99.9th percentile, rounded up; figure1: 0:35", .set = [&](std::string_view v) -> Status {
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
    app.group("figure1");
    app.list("--methods", "M,...", &request.methods, "methods beside the ground truth; lattice,meng2015, unless given");
    app.integer("--spp", "N", &request.samples, 1, 65536, "samples a pixel, of four wavelengths each");
    app.integer("--seed", "N", &request.seed, 0, std::int64_t{1} << 53, "of the random numbers");
    app.integer("--width", "PIXELS", &request.width, 600, 16000, "of the figure");
    app.add({.names = "--bits", .metavar = "2|4|6|8", .text = "of a colour's component: fewer than 8 for a draft",
             .default_value = "8", .set = [&](std::string_view v) -> Status {
                 if (v != "2" && v != "4" && v != "6" && v != "8") return expected("2, 4, 6 or 8", v);
                 request.bits = v[0] - '0';
                 return {};
             }});

    return app.run(argc, argv, [&]() -> int {
        const auto metric = parse_metric(metric_text);
        if (!metric) return app.report(metric.error());
        if (arguments == std::vector<std::string>{"figure1"}) {
            Figure1Style style;
            if (range) style.range = *range;
            style.colormap = colormap;
            return figure1(app, output, request, style);
        }
        for (const char* option : {"--methods", "--spp", "--seed", "--width", "--bits"})
            if (app.given(option)) return app.usage_error(fmt::format("{} goes with figure1 alone", option));
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
