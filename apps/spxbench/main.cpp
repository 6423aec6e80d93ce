// spxbench: methods against measured reflectances, against neighbouring colours, and against the clock.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include "../common/app.h"
#include "../common/options.h"
#include "grid.h"
#include "kernels.h"
#include "stability.h"
#include "table.h"
#include "spectex/evaluation.h"
#include "spectex/io.h"
#include "spectex/solvers.h"

namespace {

using namespace spectex;
using app::Json;
using bench::Table;

struct Request {
    std::vector<std::string> what, methods, sets, unseen, stores;
    app::ColorimetryOptions colorimetry;
    std::string folder;
    std::int64_t stride = 1, lines = 500, seed = 1;
    bench::GridRequest grid;
    std::string csv;
    bool brief = false;
    std::int64_t colors = 1000000;
    std::vector<std::string> groups;
};

std::vector<std::string> chosen_methods(const Request& request) {
    if (!request.methods.empty()) return request.methods;
    std::vector<std::string> all;
    for (const auto& info : methods()) all.push_back(info.id);
    return all;
}

int deliver(app::App& tool, const Request& request, const std::string& name, const Table& table, Json json) {
    return bench::deliver(tool, request.folder, name, table, std::move(json));
}

Result<std::vector<SampleSet>> training_sets(const Request& request) {
    auto all = lattice_sample_sets();
    if (!all || request.sets.empty()) return all;
    std::vector<SampleSet> out;
    for (const auto& name : request.sets) {
        const auto found = std::find_if(all->begin(), all->end(), [&](const SampleSet& s) { return s.name == name; });
        if (found == all->end()) {
            std::string names;
            for (const auto& s : *all) names += (names.empty() ? "" : ", ") + s.name;
            return Error{ErrorKind::usage, fmt::format("--sets: expected some of {}, got '{}'", names, app::escape(name))};
        }
        out.push_back(*found);
    }
    return out;
}

/// Every lamp, and the lights that are reported by themselves.
Result<AccuracyOptions> accuracy_options(const Request& request) {
    auto sets = training_sets(request);
    if (!sets) return std::move(sets).error();
    AccuracyOptions options;
    options.methods = chosen_methods(request);
    options.sets = *std::move(sets);
    for (const auto& path : request.unseen) {
        auto table = read_spectral_csv(path);
        if (!table) return std::move(table).error();
        options.unseen.push_back(SampleSet{app::stem(path), std::move(table->wavelengths_nm), std::move(table->columns)});
    }
    const auto entries = list_illuminants();
    if (!entries) return entries.error();
    for (const auto& entry : *entries)
        if (entry.name.starts_with("lamp:")) {
            auto lamp = parse_illuminant(entry.name);
            if (!lamp) return std::move(lamp).error();
            options.lamps.push_back(*std::move(lamp));
        }
    for (const char* name : {"A", "FL11", "D50"}) options.probes.push_back(*parse_illuminant(name));
    return options;
}

int accuracy(app::App& tool, const Request& request, const Colorimetry& c) {
    const auto made = accuracy_options(request);
    if (!made) return tool.report(made.error());
    const AccuracyOptions& options = *made;
    const auto report = measure_accuracy(c, options);
    if (!report) return tool.report(report.error());

    std::vector<std::string> header{"method"};
    const std::size_t seen = options.sets.size(), cases = seen + options.unseen.size();
    for (std::size_t i = 0; i < cases; ++i) header.push_back(report->rows[i].set);
    for (const char* column : {"mean", "p95", "spectral RMS", "A", "FL11", "D50"}) header.emplace_back(column);
    Table table(header);
    Json json{{"what", "accuracy"}, {"colorimetry", c.describe()}, {"lamps", report->lamps}, {"methods", Json::array()}};
    for (std::size_t m = 0; m < options.methods.size(); ++m) {
        std::vector<std::string> row{"`" + options.methods[m] + "`"};
        Json method{{"method", options.methods[m]}, {"sets", Json::array()}};
        double mean = 0, p95 = 0, rms = 0;
        std::array<double, 3> under{};
        for (std::size_t i = 0; i < cases; ++i) {
            const AccuracyRow& r = report->rows[m * cases + i];
            row.push_back(fmt::format("{:.3f}", r.mean));
            method["sets"].push_back({{"set", r.set}, {"samples", r.samples}, {"left_out", i < seen}, {"mean", r.mean}, {"p95", r.p95},
                                      {"spectral_rms", r.rms}, {"A", r.mean_under[0]}, {"FL11", r.mean_under[1]}, {"D50", r.mean_under[2]}});
            if (i >= seen) continue;
            const double share = 1 / static_cast<double>(seen);
            mean += share * r.mean, p95 += share * r.p95, rms += share * r.rms;
            for (std::size_t k = 0; k < 3; ++k) under[k] += share * r.mean_under[k];
        }
        for (const double v : {mean, p95}) row.push_back(fmt::format("{:.3f}", v));
        row.push_back(fmt::format("{:.4f}", rms));
        for (const double v : under) row.push_back(fmt::format("{:.3f}", v));
        table.add(std::move(row));
        method["mean"] = mean, method["p95"] = p95, method["spectral_rms"] = rms;
        json["methods"].push_back(std::move(method));
    }
    return deliver(tool, request, "accuracy", table, std::move(json));
}

int smoothness(app::App& tool, const Request& request, const Colorimetry& c) {
    Table table({"method", "steps", "mean", "p99", "max", "at code", "jump"});
    Json json{{"what", "smoothness"}, {"colorimetry", c.describe()}, {"methods", Json::array()}};
    for (const auto& id : chosen_methods(request)) {
        const auto model = make_model(id, c);
        if (!model) return tool.report(model.error());
        const auto r = measure_smoothness(**model, static_cast<std::size_t>(request.lines), static_cast<std::uint64_t>(request.seed));
        table.add({"`" + id + "`", std::to_string(r.steps), fmt::format("{:.4f}", r.mean), fmt::format("{:.4f}", r.p99),
                   fmt::format("{:.4f}", r.max), fmt::format("{:.0f}, {:.0f}, {:.0f}", r.max_at[0], r.max_at[1], r.max_at[2]),
                   fmt::format("{:.1e}", r.jump)});
        json["methods"].push_back({{"method", id}, {"steps", r.steps}, {"mean", r.mean}, {"p99", r.p99}, {"max", r.max},
                                   {"max_at", r.max_at}, {"jump", r.jump}});
    }
    return deliver(tool, request, "smoothness", table, std::move(json));
}

int speed(app::App& tool, const Request& request, const Colorimetry& c) {
    struct StoreName {
        std::string name;
        Store store;
        PixelType type;
    };
    const std::vector<StoreName> known{{"coefficients-float", Store::coefficients, PixelType::float32},
                                       {"coefficients-half", Store::coefficients, PixelType::half},
                                       {"spectral-float", Store::spectral, PixelType::float32},
                                       {"spectral-half", Store::spectral, PixelType::half}};
    std::vector<StoreName> stores;
    for (const auto& s : known)
        if (request.stores.empty() || std::find(request.stores.begin(), request.stores.end(), s.name) != request.stores.end())
            stores.push_back(s);
    for (const auto& name : request.stores)
        if (std::none_of(known.begin(), known.end(), [&](const auto& s) { return s.name == name; }))
            return tool.usage_error(fmt::format("--stores: expected coefficients-float, coefficients-half, spectral-float or "
                                                "spectral-half, got '{}'",
                                                app::escape(name)));
    Table table({"method", "stored as", "channels", "mean ΔE76", "max ΔE76", "changed codes", "not in [0,1]", "store Mpixel/s",
                 "reproject Mpixel/s"});
    Json json{{"what", "speed"}, {"colorimetry", c.describe()}, {"stride", request.stride}, {"rows", Json::array()}};
    for (const auto& id : chosen_methods(request)) {
        const auto model = make_model(id, c);
        if (!model) return tool.report(model.error());
        for (const auto& s : stores) {
            const auto r = measure_roundtrip(*model, s.store, s.type, static_cast<std::uint32_t>(request.stride), tool.threads());
            if (!r) return tool.report(r.error());
            const auto rate = [&](double seconds) { return static_cast<double>(r->pixels) / 1e6 / std::max(seconds, 1e-9); };
            const bool counted = s.store == Store::spectral && s.type == PixelType::float32;
            table.add({"`" + id + "`", s.name, std::to_string(r->channels), fmt::format("{:.2g}", r->difference.mean),
                       fmt::format("{:.2g}", r->difference.max), std::to_string(r->difference.changed_codes),
                       counted ? std::to_string(r->outside) : "", fmt::format("{:.3g}", rate(r->store_seconds)),
                       fmt::format("{:.3g}", rate(r->relight_seconds))});
            json["rows"].push_back({{"method", id}, {"store", s.name}, {"channels", r->channels}, {"pixels", r->pixels},
                                    {"mean", r->difference.mean}, {"p99", r->difference.p99}, {"max", r->difference.max},
                                    {"max_code", {r->difference.max_at[0], r->difference.max_at[1] >> 8, r->difference.max_at[1] & 255}},
                                    {"changed_codes", r->difference.changed_codes}, {"outside", counted ? Json(r->outside) : Json()},
                                    {"store_seconds", r->store_seconds}, {"reproject_seconds", r->relight_seconds}});
        }
    }
    return deliver(tool, request, "speed", table, std::move(json));
}

std::string scaled(double v) { return v == 0 ? "0" : v < 1e-3 ? fmt::format("{:.0e}", v) : fmt::format("{:.3g}", v); }

/// Of "Meng, Simon, Hanika and Dachsbacher 2015, CGF 34(4), doi:...": Meng et al. 2015.
std::string short_source(const std::string& source) {
    const auto end = source.find_first_of(",;"), year = source.find_first_of("0123456789");
    // Several authors have a comma before the year.
    if (end == std::string::npos || year == std::string::npos || year < end || source[end] == ';') return source.substr(0, end);
    return source.substr(0, end) + " et al. " + source.substr(year, 4);
}

/// A row a method, of all that is measured here.
int summary(app::App& tool, const Request& request, const Colorimetry& c) {
    auto options = accuracy_options(request);
    if (!options) return tool.report(options.error());
    const auto accurate = measure_accuracy(c, *options);
    if (!accurate) return tool.report(accurate.error());
    Table table({"method", "source", "exact", "mean ΔE76", "max ΔE76", "changed codes", "not in [0,1]", "relight ΔE2000", "step p99", "step max",
                 "per texel", "to coefficients, Mpixel/s", "relit, Mpixel/s"});
    Json json{{"what", "methods"}, {"colorimetry", c.describe()}, {"stride", request.stride}, {"lamps", accurate->lamps}, {"methods", Json::array()}};
    const std::size_t sets = options->sets.size(), cases = sets + options->unseen.size();
    for (std::size_t m = 0; m < options->methods.size(); ++m) {
        const auto& id = options->methods[m];
        const auto model = make_model(id, c);
        if (!model) return tool.report(model.error());
        const auto stride = static_cast<std::uint32_t>(request.stride);
        const auto spectra = measure_roundtrip(*model, Store::spectral, PixelType::float32, stride, tool.threads());
        if (!spectra) return tool.report(spectra.error());
        const auto kept = measure_roundtrip(*model, Store::coefficients, PixelType::half, stride, tool.threads());
        if (!kept) return tool.report(kept.error());
        const auto smooth = measure_smoothness(**model, static_cast<std::size_t>(request.lines), static_cast<std::uint64_t>(request.seed));
        double relight = 0;
        for (std::size_t i = 0; i < sets; ++i) relight += accurate->rows[m * cases + i].mean / static_cast<double>(sets);
        const auto& info = (*model)->info();
        const auto& d = spectra->difference;
        const auto rate = [&](double seconds) { return static_cast<double>(kept->pixels) / 1e6 / std::max(seconds, 1e-9); };
        table.add({"`" + id + "`", short_source(info.source), info.exact ? "yes" : "no", scaled(d.mean), scaled(d.max),
                   std::to_string(d.changed_codes), std::to_string(spectra->outside), fmt::format("{:.3f}", relight), fmt::format("{:.4f}", smooth.p99),
                   fmt::format("{:.3f}", smooth.max) + (smooth.jump > 0.01 ? ", jumps" : ""), std::to_string(info.coefficients),
                   fmt::format("{:.3g}", rate(kept->store_seconds)), fmt::format("{:.3g}", rate(kept->relight_seconds))});
        json["methods"].push_back({{"method", id}, {"source", info.source}, {"exact", info.exact}, {"bounded", info.bounded},
                                   {"mean", d.mean}, {"p99", d.p99}, {"max", d.max}, {"changed_codes", d.changed_codes},
                                   {"outside", spectra->outside}, {"relight", relight}, {"step_p99", smooth.p99}, {"step_max", smooth.max},
                                   {"jump", smooth.jump}, {"coefficients", info.coefficients}, {"pixels", kept->pixels},
                                   {"store_seconds", kept->store_seconds}, {"reproject_seconds", kept->relight_seconds}});
    }
    return deliver(tool, request, "methods", table, std::move(json));
}

int stability(app::App& tool, const Request& request, const Colorimetry& c) {
    bench::StabilityRequest wanted;
    wanted.options.groups = request.groups;
    wanted.options.methods = request.methods;
    wanted.options.stride = static_cast<std::uint32_t>(request.stride);
    wanted.options.colors = static_cast<std::uint64_t>(request.colors);
    wanted.options.seed = static_cast<std::uint64_t>(request.seed);
    wanted.options.threads = tool.threads();
    wanted.folder = request.folder;
    wanted.csv = request.csv;
    wanted.brief = request.brief;
    return bench::stability(tool, wanted, c);
}

}  // namespace

int main(int argc, char** argv) {
    app::App tool({"spxbench", "grid|scaling|kernels|memory|speed|accuracy|smoothness|stability|methods [options]",
                   "Measures methods: run time against error, relighting of measured reflectances, steps between neighbouring colours.",
                   {{"spxbench grid -o bench --corpus textures", "whole files: speed, size and error of methods and stores, with a chart"},
                    {"spxbench grid -o bench --baseline before.json", "the same as ratios to an earlier run"},
                    {"spxbench scaling --max-megapixels 256", "cost against pixels, bands and threads"},
                    {"spxbench kernels", "each kernel on one thread, as a ratio to a memory copy in the same run"},
                    {"spxbench memory --methods jakob2019", "from what share of repeated colours on it pays to remember them"},
                    {"spxbench speed --methods mallett2019,lattice", "speed and round trip over all 16,777,216 sRGB codes"},
                    {"spxbench methods", "one table of all of this, a row a method"},
                    {"spxbench accuracy", "each set of measured reflectances left out in turn, predicted under 404 lamps"},
                    {"spxbench accuracy --unseen mine.csv", "your own reflectances (wavelength_nm, one column a sample) as well"},
                    {"spxbench smoothness --methods lattice,otsu2018", "largest change of a spectrum from one code to the next"},
                    {"spxbench stability --colors 100000000", "every numeric path against 113 bits: worst errors, where, and whether bounds hold"}}});
    Request request;
    request.colorimetry.bands = "380:780:5";
    tool.positional("WHAT", &request.what, 0, 1, "grid, scaling, kernels, memory, speed, accuracy, smoothness, stability or methods; grid, where -o is given");
    tool.list("--methods", "M,...", &request.methods, "methods; all, unless given");
    tool.list("--stores", "S,...", &request.stores,
              "speed: coefficients-float, coefficients-half, spectral-float, spectral-half; all, unless given. "
              "grid: the same as KIND-TYPE[:BANDS][:max-error=DE]");
    tool.list("--kernels", "K,...", &request.grid.kernels, "grid: widest, narrowest: the instruction set; widest, unless given");
    tool.list("--corpus", "FILE|DIR,...", &request.grid.corpus, "grid: textures, or folders of them; one made for it, unless given");
    tool.text("--baseline", "FILE", &request.grid.baseline, "grid, scaling: the JSON of an earlier run, to which ratios are printed");
    tool.integer("--runs", "N", &request.grid.runs, 1, 1000, "grid, scaling: timed runs of each file, kernels, memory: rounds; the median counts, of memory the fastest");
    tool.number("--max-megapixels", "N", &request.grid.max_megapixels, 1, 1024, "Mpixel", "scaling: the largest texture");
    tool.integer("--stride", "N", &request.stride, 1, 65536, "speed, stability: takes every N-th of the sRGB codes");
    tool.integer("--colors", "N", &request.colors, 0, 1ll << 40, "stability: random linear colours");
    tool.list("--groups", "G,...", &request.groups, "stability: some of colours, differences, methods, solvers, lights, sums, conditioning; all, unless given");
    tool.text("--csv", "FILE", &request.csv, "stability: the whole table as CSV");
    tool.flag("--brief", &request.brief, "stability: print a row a group instead of a row a path");
    tool.list("--sets", "S,...", &request.sets, "accuracy: sets of measured reflectances; all, unless given");
    tool.list("--unseen", "FILE,...", &request.unseen, "accuracy: tables of reflectances that are predicted and never learnt from");
    tool.integer("--lines", "N", &request.lines, 0, 1000000, "smoothness: random lines through the cube");
    tool.integer("--seed", "N", &request.seed, 0, 1ll << 53, "smoothness, stability: of what is random");
    tool.add({.names = "-o,--output", .metavar = "DIR", .text = "folder for the table (.md) and its figures (.json); made where there is none",
              .set = [&](std::string_view value) -> Status {
                  if (value.empty()) return app::expected("a folder", value);
                  request.folder = value;
                  return {};
              }});
    app::add_colorimetry_options(tool, request.colorimetry);
    return tool.run(argc, argv, [&]() -> int {
        if (request.what.empty() && request.folder.empty())
            return tool.usage_error("expected grid, scaling, kernels, memory, speed, accuracy, smoothness, stability or methods, or -o DIR");
        const std::string what = request.what.empty() ? "grid" : request.what[0];
        const std::map<std::string, int (*)(app::App&, const Request&, const Colorimetry&)> all{
            {"grid", [](app::App& t, const Request& r, const Colorimetry&) { return bench::grid(t, r.grid); }},
            {"scaling", [](app::App& t, const Request& r, const Colorimetry&) { return bench::scaling(t, r.grid); }},
            {"kernels", [](app::App& t, const Request& r, const Colorimetry&) { return bench::kernels(t, static_cast<int>(r.grid.runs), r.folder); }},
            {"memory", [](app::App& t, const Request& r, const Colorimetry&) { return bench::memory(t, r.methods, static_cast<int>(r.grid.runs), r.folder); }},
            {"speed", speed}, {"accuracy", accuracy}, {"smoothness", smoothness}, {"methods", summary}, {"stability", stability}};
        const auto found = all.find(what);
        if (found == all.end())
            return tool.usage_error(fmt::format("expected grid, scaling, kernels, memory, speed, accuracy, smoothness, stability or methods, got '{}'", app::escape(what)));
        for (const auto& id : request.methods)
            if (const auto known = find_method(id); !known) return tool.report(known.error());
        const auto bands = request.colorimetry.band_set();
        if (!bands) return tool.report(bands.error());
        const auto c = Colorimetry::make(request.colorimetry.spec, *bands);
        if (!c) return tool.report(c.error());
        request.grid.methods = request.methods;
        request.grid.stores = request.stores;
        request.grid.folder = request.folder;
        request.grid.colorimetry = request.colorimetry.spec;
        if (app::App::lines_only) return app::exit_ok;
        return found->second(tool, request, *c);
    });
}
