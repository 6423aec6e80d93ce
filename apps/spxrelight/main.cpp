// spxrelight: textures, coefficients and spectra under other lights.
#include <fmt/format.h>

#include <cmath>

#include "options.h"
#include "reports.h"

using namespace spectex;
using namespace spectex::app;

namespace {

Status list_illuminants_matching(App& app, const std::string& pattern) {
    const auto entries = list_illuminants();
    if (!entries) return entries.error();
    const auto lower = [](std::string text) {
        for (char& c : text)
            if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
        return text;
    };
    const auto wanted = lower(pattern);
    Json list = Json::array();
    for (const auto& e : *entries) {
        if (lower(e.name + " " + e.title + " " + e.kind).find(wanted) == std::string::npos) continue;
        app.out(fmt::format("{:<10} {:<14} {}\n", e.name, e.kind, escape(e.title)));
        list.push_back({{"name", e.name}, {"kind", e.kind}, {"title", e.title}});
    }
    if (list.empty()) return Error{ErrorKind::usage, fmt::format("--list-illuminants: no name, kind or title holds '{}'", pattern)};
    app.record({{"illuminants", std::move(list)}});
    return {};
}

/// Bakes to the files of a name in which {illuminant} expands.
Status bake_to(App& app, const std::string& path, const std::vector<std::string>& names, const RelightOptions& options,
               double max_error, bool record) {
    std::vector<std::string> outputs;
    std::vector<NamedOutput> named;
    // A configuration takes all of them.
    const bool config = path.ends_with(".ocio") || path.ends_with(".OCIO");
    for (const auto& name : names) {
        if (config && !outputs.empty()) break;
        outputs.push_back(config ? path : expand_illuminant(path, name));
        named.push_back({fmt::format("--bake under {}", name), outputs.back()});
    }
    if (auto checked = check_outputs({}, named); !checked) return checked;
    const auto report = bake(outputs, options, max_error);
    if (!report) return report.error();
    Json list = Json::array();
    for (const auto& o : report->outputs) {
        app.note(fmt::format("{}: under {}, {}{}", o.path, o.illuminant, o.form,
                             o.grid == 0 ? ", exact"
                             : o.exact   ? fmt::format(" of {0} x {0} x {0}, exact", o.grid)
                                         : fmt::format(" of {0} x {0} x {0}, CIE76 mean {1:.3g} max {2:.3g}", o.grid, o.mean, o.max)));
        list.push_back({{"output", o.path}, {"illuminant", o.illuminant}, {"form", o.form}, {"grid", o.grid}, {"exact", o.exact},
                        {"mean", o.mean}, {"max", o.max}});
    }
    if (record) app.record({{"model", report->model}, {"baked", std::move(list)}});
    return {};
}

int sheet_of(App& app, const std::vector<std::string>& inputs, const std::string& sheet, RelightOptions& options,
             const std::string& input_colorspace, const SelectionOptions& selection) {
    if (inputs.size() != 1) return app.usage_error(fmt::format("--contact-sheet: {} inputs, expected one", inputs.size()));
    if (selection.levels.size() != 1) return app.usage_error(fmt::format("--contact-sheet: {} mip levels, expected one", selection.levels.size()));
    for (const char* option : {"--output-colorspace", "--half", "--float", "--uint16", "--compression"})
        if (app.given(option)) return app.usage_error(fmt::format("--contact-sheet is 8-bit sRGB: {} does not apply", option));
    const NamedOutput outputs[] = {{"--contact-sheet", sheet}};
    if (auto s = check_outputs(inputs, outputs); !s) return app.report(s.error());
    const auto progress = app.progress(inputs[0]);
    options.job = job_options(app, progress, input_colorspace);
    options.job.select = selection.at(selection.levels[0]);
    if (app.explaining()) {
        const auto lines = explain_relight(inputs[0], {}, options);
        if (!lines) return app.report(lines.error());
        explain(app, inputs[0], *lines);
    }
    const auto report = contact_sheet(inputs[0], sheet, options);
    if (!report) return app.report(report.error(), inputs[0]);
    warn_about(app, report->input);
    Json json{{"input", inputs[0]}};
    json.update(to_json(report->input));
    json["output"] = report->output;
    json["sheet_width"] = report->width;
    json["sheet_height"] = report->height;
    json["metric"] = "ciede2000";
    json["difference"] = report->note;
    json["tiles"] = Json::array();
    for (const auto& t : report->tiles) {
        const std::string kelvin = t.kelvin ? fmt::format("{:.1f} K", *t.kelvin) : "no CCT";
        app.out(fmt::format("{:<14} {:>10}  Duv {:+.4f}  from D65: mean {:.4g}  max {:.4g} at {},{}{}\n", escape(t.illuminant), kelvin, std::round(t.duv * 1e4) / 1e4 + 0.0,
                            t.mean, t.max, t.max_at[0], t.max_at[1],
                            t.clipped > 0 ? fmt::format("  {} samples of the tile clipped", t.clipped) : ""));
        json["tiles"].push_back({{"illuminant", t.illuminant}, {"title", t.title}, {"cct_kelvin", t.kelvin ? Json(*t.kelvin) : Json()},
                                 {"duv", t.duv}, {"mean", t.mean}, {"max", t.max}, {"max_at", t.max_at}, {"clipped", t.clipped}});
    }
    app.record(std::move(json));
    return exit_ok;
}

}  // namespace

int main(int argc, char** argv) {
    App app({"spxrelight", "IN... -i ILLUMINANT[,ILLUMINANT...] -o OUT|DIR [options]\n-i ILLUMINANT[,ILLUMINANT...] --bake FILE [options]\n"
             "IN -i ILLUMINANT[,ILLUMINANT...] --contact-sheet OUT.png [options]",
             "Reprojects textures, coefficient EXRs and spectral EXRs under other illuminants and observers.",
             {{"spxrelight bricks.png -i A -o bricks_a.png", "an sRGB texture as CIE illuminant A shows it"},
              {"spxrelight bricks.exr -i A,FL11,D:5003 -o 'bricks_{illuminant}.png'", "three lights in one pass"},
              {"spxrelight bricks.exr -i lamp.csv --adapt cat16 -o out.exr", "a measured lamp, its white adapted"},
              {"spxrelight bricks.png -i A,D50,FL2,FL11 --contact-sheet sheet.png", "one labelled picture of many lights"},
              {"spxrelight -i A,FL11 --bake show.ocio", "looks and colour spaces for Nuke, Blender, oiiotool: no plug-in"},
              {"spxrelight --list-illuminants led", "what can be named"}}});
    std::vector<std::string> arguments, names;
    std::string output, sheet, input_colorspace, adapt = "none", normalize = "luminance", list_pattern, relight_observer;
    std::string bake_path;
    double max_error = default_bake_error;
    bool listing = false;
    ColorimetryOptions colorimetry;
    MethodOptions method;
    OutputOptions out;
    SelectionOptions selection;
    app.positional("IN", &arguments, 0, App::unlimited, "RGB textures, coefficient EXRs, spectral EXRs; wildcards are expanded");
    app.group("Light");
    app.list("-i,--illuminant", "ILLUMINANT[,...]", &names,
             "lights: a name, lamp:N, D:KELVIN, P:KELVIN, a file, or a mixture as 0.7*A+0.3*FL11");
    app.add({.names = "--list-illuminants", .metavar = "TEXT", .text = "list the illuminants whose name, kind or title holds TEXT ('' for all)",
             .set = [&](std::string_view v) -> Status {
                 list_pattern = v;
                 listing = true;
                 return {};
             }});
    app.choice("--adapt", "METHOD", &adapt, {"none", "vonkries", "bradford", "cat02", "cat16"},
               "chromatic adaptation from the light's white to the output's");
    app.number("--max-error", "DE", &max_error, 0, 100, "CIE76",
               "how far a method that is not linear in pieces may be off: with fewer bands (unless given: exact), as a baked table");
    app.choice("--normalize", "HOW", &normalize, {"luminance", "none"},
               "scale every light so that a perfect diffuser has Y = 1, or keep the lamp's power relative to D65");
    app.add({.names = "--relight-observer", .metavar = "O", .text = "observer under the new light",
             .default_value = "the input's own", .set = [&](std::string_view v) -> Status {
                 if (auto found = find_observer(v); !found) return found.error();
                 relight_observer = v;
                 return {};
             }});
    app.group("Baking");
    app.text("--bake", "FILE", &bake_path,
             "write the relight itself, for linear RGB: .cube, .clf or .spimtx ({illuminant} expands), or an .ocio configuration, "
             "which is begun or added to; needs no IN");
    app.group("Output");
    app.text("-o,--output", "OUT|DIR", &output, "image to write, with {illuminant} for several lights, or an existing folder");
    app.text("--contact-sheet", "OUT.png", &sheet,
             "instead of -o: one picture of all lights, each with its colour temperature and its difference from D65");
    add_output_options(app, out);
    app.group("Input");
    add_selection_options(app, selection, true);
    add_input_colorspace(app, input_colorspace);
    add_method_options(app, method);
    add_colorimetry_options(app, colorimetry, "--reference-illuminant");

    return app.run(argc, argv, [&]() -> int {
        if (listing) {
            const auto listed = list_illuminants_matching(app, list_pattern);
            return listed ? exit_ok : app.report(listed.error());
        }
        const bool baking = !bake_path.empty();
        if (baking && arguments.empty() && !output.empty()) return app.usage_error("-o is given, but no IN to relight");
        const bool relighting = !baking || !output.empty() || !sheet.empty();
        if (relighting && arguments.empty()) return app.usage_error("IN is missing: expected an RGB texture, a coefficient EXR or a spectral EXR");
        if (relighting && output.empty() && sheet.empty()) return app.usage_error("-o is missing: expected an image to write or an existing folder");
        if (!output.empty() && !sheet.empty()) return app.usage_error("--contact-sheet excludes -o: expected one of them");

        RelightOptions options;
        options.method = method.method;
        options.gamut = method.gamut;
        options.colorimetry = colorimetry.spec;
        if (app.given("--bands")) {
            auto bands = colorimetry.band_set();
            if (!bands) return app.report(bands.error());
            options.bands = *std::move(bands);
        }
        std::vector<std::string> shown;
        for (const auto& name : names) {
            auto illuminant = parse_illuminant(name);
            if (!illuminant) return app.report(illuminant.error());
            shown.push_back(illuminant->name);
            options.illuminants.push_back(*std::move(illuminant));
        }
        // --observer means both; the observer under the new light may be named apart.
        if (!relight_observer.empty())
            options.observer = relight_observer;
        else if (app.given("--observer"))
            options.observer = colorimetry.spec.observer;
        options.adaptation = *parse_adaptation(adapt);
        options.normalization = normalize == "none" ? Normalization::none : Normalization::luminance;
        options.output_colorspace = out.colorspace;
        options.type = out.type;
        options.compression = out.compression;

        // A table needs some tolerance; a picture has none unless it is asked for.
        if (app.given("--max-error")) options.max_error = max_error;
        if (baking) {
            if (auto baked = bake_to(app, bake_path, shown, options, max_error, !relighting); !baked) return app.report(baked.error());
            if (!relighting) return exit_ok;
        }
        const auto inputs = app.inputs(arguments);
        if (!inputs) return app.report(inputs.error());
        if (const auto s = selection.check(); !s) return app.report(s.error());
        if (!sheet.empty()) return sheet_of(app, *inputs, sheet, options, input_colorspace, selection);
        const auto jobs = plan_outputs(*inputs, output, ".exr", shown, selection.levels);
        if (!jobs) return app.report(jobs.error());
        return app.each_distinct(*jobs, [&](const Job& job) -> Result<Json> {
            const auto progress = app.progress(job.input);
            options.job = job_options(app, progress, input_colorspace);
            options.job.select = selection.at(job.mip);
            if (app.explaining()) {
                const auto lines = explain_relight(job.input, job.outputs, options);
                if (!lines) return lines.error();
                explain(app, job.input, *lines);
            }
            const auto report = relight(job.input, job.outputs, options);
            if (!report) return report.error();
            warn_about(app, report->input);
            Json json = to_json(report->input);
            if (job.mip > 0 || selection.levels.size() > 1) json["mip"] = job.mip;
            json["kind"] = report->kind == FileKind::image ? "image" : report->kind == FileKind::spectral ? "spectral" : "coefficients";
            Json list = Json::array();
            for (const auto& o : report->outputs) {
                if (o.clipped > 0)
                    app.warn(fmt::format("{}: {} samples lie outside what {} holds in {}: clipped", o.path, o.clipped,
                                         pixel_type_name(o.type), o.colorspace));
                app.note(fmt::format("{}: under {}, {} in {}", o.path, o.illuminant, pixel_type_name(o.type), o.colorspace));
                list.push_back({{"output", o.path}, {"illuminant", o.illuminant}, {"type", pixel_type_name(o.type)},
                                {"colorspace", o.colorspace}, {"clipped", o.clipped}});
            }
            json["output"] = list[0]["output"];
            if (list.size() == 1)
                for (const char* key : {"illuminant", "type", "clipped"}) json[key] = list[0][key];
            json["outputs"] = std::move(list);
            return json;
        });
    });
}
