// spxuplift: textures to spectral or coefficient EXR.
#include <fmt/format.h>

#include "reports.h"
#include "uplift_options.h"

using namespace spectex;
using namespace spectex::app;

int main(int argc, char** argv) {
    App app({"spxuplift", "IN... -o OUT|DIR [options]",
             "Turns RGB textures into reflectance spectra: a spectral EXR, or a coefficient EXR of three channels.",
             {{"spxuplift bricks.png -o bricks.exr", "three half floats per texel and the model in the header"},
              {"spxuplift bricks.png -o bricks.exr --store spectral --bands 380:780:10", "41 reflective bands T.380nm to T.780nm"},
              {"spxuplift *.png -o spectral/ --store spectral --half --compression piz", "many files into a folder"},
              {"spxuplift bricks.png -o bricks.exr --check --json -", "measure the round trip of every pixel"}}});
    std::vector<std::string> arguments;
    std::string output, layout = "single", input_colorspace;
    bool check = false;
    UpliftOptionSet set;
    app.positional("IN", &arguments, 1, App::unlimited, "textures in any format of OpenImageIO; wildcards are expanded");
    app.group("Output");
    app.add({.names = "-o,--output", .metavar = "OUT|DIR", .text = "EXR to write, or an existing folder for many", .required = true,
             .set = [&](std::string_view v) -> Status {
                 output = v;
                 return {};
             }});
    app.choice("--layout", "LAYOUT", &layout, {"single", "multipart"},
               "one part (pbrt, spectral viewers), or colour in part 0 and spectrum in part 1 (Mitsuba)");
    app.flag("--check", &check, "measure the round trip of every pixel instead of every 16th row");
    add_input_colorspace(app, input_colorspace);
    add_uplift_options(app, set);

    return app.main(argc, argv, [&]() -> int {
        const auto settings = set.settings(app);
        if (!settings) return app.report(settings.error());
        const auto inputs = app.inputs(arguments);
        if (!inputs) return app.report(inputs.error());
        const auto jobs = plan_outputs(*inputs, output, ".exr");
        if (!jobs) return app.report(jobs.error());
        UpliftOptions options;
        options.settings = *settings;
        options.layout = layout == "multipart" ? Layout::multipart : Layout::single;
        options.compression = set.output.compression;
        options.check_all = check;
        return app.each(*jobs, [&](const Job& job) -> Result<Json> {
            const auto progress = app.progress(job.input);
            options.job = job_options(app, progress, input_colorspace);
            if (app.explaining()) {
                const auto lines = explain_uplift(job.input, options);
                if (!lines) return lines.error();
                explain(app, job.input, *lines);
            }
            const auto report = uplift(job.input, job.outputs[0], options);
            if (!report) return report.error();
            warn_about(app, report->input);
            app.note(fmt::format("{}: {} channels of {}, {}, round trip CIE76 {} ({})", report->output, report->channels.size(),
                                 pixel_type_name(report->type), report->model, summary(report->roundtrip),
                                 report->checked_all ? "every pixel" : "every 16th row"));
            Json json = to_json(report->input);
            json["output"] = report->output;
            json["method"] = options.settings.method;
            json["model"] = report->model;
            json["store"] = set.store;
            json["type"] = pixel_type_name(report->type);
            json["channels"] = report->channels;
            json["roundtrip"] = to_json(report->roundtrip, Metric::cie76);
            json["roundtrip"]["checked"] = report->checked_all ? "all" : "every 16th row";
            return json;
        });
    });
}
