// spxdiff: colour differences of two files, or of a texture and its round trip.
#include <fmt/format.h>

#include "reports.h"
#include "uplift_options.h"

using namespace spectex;
using namespace spectex::app;

int main(int argc, char** argv) {
    App app({"spxdiff", "A B [options]\n--roundtrip IN... [options]\n--metamerism IN... -i ILLUMINANT[,...] [options]",
             "Measures colour differences, A the reference; or the round trip of textures through spectra and back; or how far "
             "methods disagree on textures under other lights.",
             {{"spxdiff a.png b.png --fail-max 1", "exit 1 when some pixel differs by more than 1"},
              {"spxdiff --roundtrip bricks.png --store spectral --bands 36 --half", "the whole path through 36 half bands"},
              {"spxdiff --metamerism bricks.png -i A,FL11 --map map.exr", "where no method is to be trusted under these lights"},
              {"spxdiff a.exr b.exr --metric cie76 --map map.exr", "a map for spxheat"}}});
    std::vector<std::string> arguments;
    bool roundtrip = false, metamerism = false;
    std::vector<std::string> light_names, method_names{"mallett2019", "smits1999:exact", "jakob2019", "lattice"};
    std::string metric_text = "ciede2000", map, input_colorspace;
    std::optional<double> fail_mean, fail_p99, fail_max;
    UpliftOptionSet set;
    SelectionOptions selection;
    app.positional("FILE", &arguments, 1, App::unlimited, "A and B; or the textures of --roundtrip or --metamerism");
    app.group("Difference");
    app.flag("--roundtrip", &roundtrip, "uplift, store and reproject in memory, against the linearised input");
    app.flag("--metamerism", &metamerism, "per pixel the largest difference between methods under the lights of -i, against each light's white");
    app.list("-i,--lights", "ILLUMINANT[,...]", &light_names, "with --metamerism, the lights: names, D:KELVIN, P:KELVIN, files, mixtures");
    app.list("--methods", "M[,...]", &method_names, "with --metamerism, the methods to hold against each other; the exact ones agree under the "
             "reference light");
    app.choice("--metric", "METRIC", &metric_text, {"cie76", "cie94", "ciede2000", "cmc", "din99", "itp", "oklab"},
               "colour difference: CIE94 graphic arts, CMC 2:1");
    app.text("--map", "MAP.exr", &map, "write the differences as a float EXR of one channel");
    constexpr double infinity = std::numeric_limits<double>::infinity();
    app.number("--fail-mean", "X", &fail_mean, 0, infinity, "", "exit 1 when the mean is above X");
    app.number("--fail-p99", "X", &fail_p99, 0, infinity, "", "exit 1 when the 99th percentile is above X");
    app.number("--fail-max", "X", &fail_max, 0, infinity, "", "exit 1 when the largest is above X");
    app.group("Input");
    add_selection_options(app, selection, false);
    add_input_colorspace(app, input_colorspace);
    add_uplift_options(app, set);

    return app.run(argc, argv, [&]() -> int {
        const auto metric = parse_metric(metric_text);
        if (!metric) return app.report(metric.error());
        const auto inputs = app.inputs(arguments);
        if (!inputs) return app.report(inputs.error());
        if (const auto s = selection.check(); !s) return app.report(s.error());
        if (roundtrip && metamerism) return app.usage_error("--roundtrip excludes --metamerism: expected one of them");
        if (!roundtrip && !metamerism && inputs->size() != 2)
            return app.usage_error(fmt::format("{} files: expected two, A and B; or --roundtrip or --metamerism", inputs->size()));
        if (metamerism)
            for (const char* option : {"--method", "--store", "--half", "--float", "--compression"})
                if (app.given(option))
                    return app.usage_error(fmt::format("{} does not apply to --metamerism, which stores nothing and takes --methods", option));
        for (const char* option : {"--lights", "--methods"})
            if (!metamerism && app.given(option)) return app.usage_error(fmt::format("{} needs --metamerism", option));
        if (!map.empty()) {
            if ((roundtrip || metamerism) && inputs->size() > 1) return app.usage_error("--map: expected one input with it");
            const NamedOutput outputs[] = {{"--map", map}};
            if (auto s = check_outputs(*inputs, outputs); !s) return app.report(s.error());
        }
        DifferenceOptions options;
        options.metric = *metric;
        options.map = map;
        options.matrix = set.colorimetry.spec.matrix;
        options.observer = set.colorimetry.spec.observer;
        bool exceeded = false;
        const auto judge = [&](const DifferenceStatistics& s, const std::string& what) {
            const auto check = [&](const char* name, std::optional<double> bound, double value) {
                if (!bound || value <= *bound) return;
                exceeded = true;
                app.warn(fmt::format("{}: {} {} is above --fail-{} {}", what, name, number_text(value), name, number_text(*bound)));
            };
            check("mean", fail_mean, s.mean);
            check("p99", fail_p99, s.p99);
            check("max", fail_max, s.max);
        };
        const auto show = [&](const DifferenceReport& report) {
            const auto& s = report.statistics;
            app.out(fmt::format("{}: {}\n  rms {:.4g}  p50 {:.4g}  p95 {:.4g}  pixels {}  not finite {}  changed 8-bit codes {}\n"
                                "  reference white: {}\n",
                                metric_title(*metric), summary(s), s.rms, s.p50, s.p95, s.pixels, s.nonfinite, s.changed_codes,
                                report.white));
        };
        int code = exit_ok;
        if (metamerism) {
            MetamerismOptions lit;
            lit.metric = *metric;
            lit.map = map;
            lit.methods = method_names;
            lit.colorimetry = set.colorimetry.spec;
            lit.gamut = set.method.gamut;
            for (const auto& id : method_names)
                if (auto found = find_method(id); !found) return app.report({found.error().kind, "--methods: " + found.error().message});
            for (const auto& name : light_names) {
                auto light = parse_illuminant(name);
                if (!light) return app.report(light.error());
                lit.illuminants.push_back(*std::move(light));
            }
            if (lit.illuminants.empty()) return app.usage_error("--metamerism: -i is missing: expected lights such as -i A,FL11");
            if (app.given("--bands")) {
                auto bands = set.colorimetry.band_set();
                if (!bands) return app.report(bands.error());
                lit.bands = *std::move(bands);
            }
            std::vector<Job> jobs;
            for (const auto& input : *inputs) jobs.push_back({input, {}});
            code = app.each(jobs, [&](const Job& job) -> Result<Json> {
                const auto progress = app.progress(job.input);
                lit.job = job_options(app, progress, input_colorspace);
                lit.job.select = selection.at(selection.levels[0]);
                const auto report = compare_metamerism(job.input, lit);
                if (!report) return report.error();
                explain(app, job.input, report->explanation);
                warn_about(app, report->input);
                const auto& s = report->statistics;
                const auto& w = report->worst;
                app.out(fmt::format("{}: {} of {} methods under {} light{}: {}\n  rms {:.4g}  p50 {:.4g}  p95 {:.4g}  pixels {}\n"
                                    "  worst: {} against {} under {}\n  reference white: {}\n",
                                    escape(job.input), metric_title(*metric), lit.methods.size(), lit.illuminants.size(),
                                    lit.illuminants.size() == 1 ? "" : "s", summary(s), s.rms,
                                    s.p50, s.p95, s.pixels, w.methods[0], w.methods[1], escape(w.illuminant), report->white));
                judge(s, job.input);
                const auto combination = [](const MetamerismReport::Combination& c) {
                    return Json{{"illuminant", c.illuminant}, {"methods", c.methods}, {"pixels", c.pixels}, {"max", c.max}};
                };
                Json json = to_json(report->input);
                json.update(to_json(s, *metric));
                json["methods"] = lit.methods;
                json["illuminants"] = Json::array();
                for (const auto& light : lit.illuminants) json["illuminants"].push_back(light.name);
                json["max_methods"] = w.methods;
                json["max_illuminant"] = w.illuminant;
                json["largest"] = Json::array();
                for (const auto& c : report->combinations) json["largest"].push_back(combination(c));
                json["white"] = report->white;
                if (!map.empty()) json["map"] = map;
                return json;
            });
        } else if (roundtrip) {
            const auto settings = set.settings(app);
            if (!settings) return app.report(settings.error());
            std::vector<Job> jobs;
            for (const auto& input : *inputs) jobs.push_back({input, {}});
            code = app.each(jobs, [&](const Job& job) -> Result<Json> {
                const auto progress = app.progress(job.input);
                options.job = job_options(app, progress, input_colorspace);
                options.job.select = selection.at(selection.levels[0]);
                if (app.explaining()) {
                    UpliftOptions uplift;
                    uplift.settings = *settings;
                    uplift.job = options.job;
                    uplift.check_all = true;
                    const auto lines = explain_uplift(job.input, uplift);
                    if (!lines) return lines.error();
                    explain(app, job.input, *lines);
                }
                const auto report = compare_roundtrip(job.input, *settings, options);
                if (!report) return report.error();
                warn_about(app, report->a);
                app.out(fmt::format("{}: {}\n", escape(job.input), report->path));
                show(*report);
                app.out(fmt::format("  read with the standard's rounded white instead: {}\n", summary(*report->standard_matrix)));
                judge(report->statistics, job.input);
                Json json = to_json(report->a);
                json.update(to_json(report->statistics, *metric));
                json["method"] = settings->method;
                json["store"] = set.store;
                json["path"] = report->path;
                json["white"] = report->white;
                json["standard_matrix"] = to_json(*report->standard_matrix, *metric);
                if (!map.empty()) json["map"] = map;
                return json;
            });
        } else {
            const auto progress = app.progress((*inputs)[0]);
            options.job = job_options(app, progress, input_colorspace);
            options.job.select = selection.at(selection.levels[0]);
            const auto report = compare_files((*inputs)[0], (*inputs)[1], options);
            if (!report) return app.report(report.error());
            const Explanation lines = {{"A", fmt::format("{} ({})", report->a.colorspace, report->a.colorspace_reason)},
                                       {"B", fmt::format("{} ({})", report->b.colorspace, report->b.colorspace_reason)},
                                       {"white", report->white},
                                       {"skipped", "alpha and other channels: not colour"}};
            explain(app, "difference", lines);
            show(*report);
            judge(report->statistics, (*inputs)[1]);
            Json json = to_json(report->statistics, *metric);
            json["a"] = to_json(report->a);
            json["b"] = to_json(report->b);
            json["input"] = (*inputs)[0];
            json["white"] = report->white;
            if (!map.empty()) json["map"] = map;
            app.record(std::move(json));
        }
        return code != exit_ok ? code : exceeded ? static_cast<int>(exit_threshold) : static_cast<int>(exit_ok);
    });
}
