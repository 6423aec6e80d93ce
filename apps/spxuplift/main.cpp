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
              {"spxuplift bricks.png -o bricks.exr --store spectral --max-error 0.5 --for D65,A,FL11", "fewer mantissa bits, no pixel off by more under these lights"},
              {"spxuplift bricks.tx -o 'bricks_{mip}.exr' --mip 1:3", "three smaller levels of a mip-mapped texture, nothing else read"},
              {"spxuplift bricks.png -o bricks.exr --check --json -", "measure the round trip of every pixel"}}});
    std::vector<std::string> arguments;
    std::string output, layout = "single", input_colorspace;
    bool check = false, constant_to_pixel = false;
    UpliftOptionSet set;
    SelectionOptions selection;
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
    app.flag("--constant-to-pixel", &constant_to_pixel, "write a texture of one colour as 1 x 1");
    app.group("Input");
    add_selection_options(app, selection, true);
    add_input_colorspace(app, input_colorspace);
    add_uplift_options(app, set);

    return app.run(argc, argv, [&]() -> int {
        const auto settings = set.settings(app);
        if (!settings) return app.report(settings.error());
        const auto inputs = app.inputs(arguments);
        if (!inputs) return app.report(inputs.error());
        if (const auto s = selection.check(); !s) return app.report(s.error());
        const auto jobs = plan_outputs(*inputs, output, settings->type == PixelType::uint8 ? ".png" : ".exr", {}, selection.levels);
        if (!jobs) return app.report(jobs.error());
        UpliftOptions options;
        options.settings = *settings;
        options.layout = layout == "multipart" ? Layout::multipart : Layout::single;
        const auto chosen = set.layout(app, options.layout);
        if (!chosen) return app.report(chosen.error());
        options.layout = *chosen;
        options.constant_to_pixel = constant_to_pixel;
        options.compression = set.output.compression;
        options.check_all = check;
        // Solved once for all; what cannot be is said of each input.
        if (jobs->size() > 1)
            if (auto solved = solve_model(options.settings)) options.settings.model = *std::move(solved);
        return app.each_distinct(*jobs, [&](const Job& job) -> Result<Json> {
            const auto progress = app.progress(job.input);
            options.job = job_options(app, progress, input_colorspace);
            options.job.select = selection.at(job.mip);
            if (app.explaining()) {
                const auto lines = explain_uplift(job.input, options);
                if (!lines) return lines.error();
                auto all = *lines;
                if (const auto choice = set.store_choice(); choice && *choice) all.push_back({"store chosen", (*choice)->reason});
                explain(app, job.input, all);
            }
            const auto report = uplift(job.input, job.outputs[0], options);
            if (!report) return report.error();
            if (report->grey > 0)
                explain(app, job.input + ", as it went",
                        Explanation{{"skipped", fmt::format("nearly all of {} pixels without colour: stored as copies of equal greys", report->grey)}});
            warn_about(app, report->input);
            app.note(fmt::format("{}: {} channels of {}, {}, round trip CIE76 {} ({})", report->output, report->channels.size(),
                                 pixel_type_name(report->type), report->model, summary(report->roundtrip),
                                 report->checked_all ? "every pixel" : "every 16th row"));
            const double ratio = report->file_bytes > 0 ? static_cast<double>(report->raw_bytes) / static_cast<double>(report->file_bytes) : 0;
            if (report->bounded) {
                std::string checks;
                for (const auto& check : report->bounded->checks) checks += fmt::format(", {} {:.4g}", check.name, check.max);
                app.note(fmt::format("{}: {:.3g} mantissa bits kept on average, largest CIE76 of every pixel{}; {} bytes, {:.3g} times "
                                     "smaller than its samples",
                                     report->output, report->bounded->mean_bits, checks.substr(1), report->file_bytes, ratio));
            }
            Json json = to_json(report->input);
            if (job.mip > 0 || selection.levels.size() > 1) json["mip"] = job.mip;
            json["output"] = report->output;
            json["method"] = options.settings.method;
            json["model"] = report->model;
            json["store"] = options.settings.store == Store::spectral ? "spectral" : "coefficients";
            json["type"] = pixel_type_name(report->type);
            json["channels"] = report->channels;
            json["roundtrip"] = to_json(report->roundtrip, Metric::cie76);
            json["roundtrip"]["checked"] = report->checked_all ? "all" : "every 16th row";
            if (!report->bands_nm.empty()) json["bands_nm"] = report->bands_nm;
            if (options.settings.skip_transparent) json["transparent"] = report->transparent;
            if (options.constant_to_pixel) json["constant"] = report->constant;
            json["grey"] = report->grey;
            json["file_bytes"] = report->file_bytes;
            json["raw_bytes"] = report->raw_bytes;
            json["ratio"] = ratio;
            if (report->bounded) json["max_error"] = to_json(*report->bounded);
            return json;
        });
    });
}
