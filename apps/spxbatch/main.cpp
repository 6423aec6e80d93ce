// spxbatch: libraries of textures to folders of spectral or coefficient EXRs.
#include <fmt/format.h>
#include <unistd.h>

#include "reports.h"
#include "scene.h"
#include "spectex/batch.h"
#include "uplift_options.h"

using namespace spectex;
using namespace spectex::app;

namespace {

Json to_json(const BatchFile& f) {
    Json json{{"input", f.input}, {"output", f.output.empty() ? Json() : Json(f.output)}, {"status", batch_status_name(f.status)},
              {"reason", f.reason}, {"use", f.use}, {"width", f.width}, {"height", f.height}};
    if (!f.content_hash.empty()) json["content_xxh3"] = f.content_hash;
    if (!f.output_hash.empty()) json["output_xxh3"] = f.output_hash;
    json["nonfinite"] = f.nonfinite;
    json["out_of_gamut"] = f.out_of_gamut;
    if (f.measured)
        json["roundtrip"] = {{"metric", "cie76"}, {"pixels", f.measured_pixels}, {"mean", f.mean}, {"p99", f.p99}, {"max", f.max},
                             {"changed_codes", f.changed_codes}};
    if (f.seconds > 0) json["seconds"] = f.seconds;
    return json;
}

Json to_json(const BatchReport& r) {
    Json json{{"converted", r.converted}, {"skipped", r.skipped}, {"data", r.data}, {"failed", r.failed}, {"copied", r.copied},
              {"excluded", r.excluded}, {"other_shards", r.other_shards}, {"not_images", r.not_images}, {"pixels", r.pixels},
              {"model", r.model}, {"files", Json::array()}};
    for (const auto& f : r.files) json["files"].push_back(to_json(f));
    return json;
}

/// Bytes with an optional suffix K, M, G or T, powers of 1024.
Result<std::uint64_t> parse_bytes(std::string_view text) {
    static constexpr std::string_view units = "KMGT";
    std::uint64_t scale = 1;
    std::string_view digits = text;
    if (!digits.empty())
        if (const auto at = units.find(digits.back()); at != std::string_view::npos) {
            scale = std::uint64_t{1} << (10 * (at + 1));
            digits.remove_suffix(1);
        }
    const auto number = parse_integer(digits, 1, (std::int64_t{1} << 50) / static_cast<std::int64_t>(scale));
    if (!number) return expected("bytes such as 4G or 800M", text);
    return static_cast<std::uint64_t>(*number) * scale;
}

std::string summary(const BatchReport& r) {
    return fmt::format("{} converted ({} by copying the same content), {} skipped, {} data, {} failed", r.converted, r.copied,
                       r.skipped, r.data, r.failed);
}

/// The settings of a run, as its page states them.
std::vector<std::pair<std::string, std::string>> facts(const App& app, const BatchOptions& options, const UpliftOptionSet& set,
                                                       const BatchReport& r) {
    std::vector<std::pair<std::string, std::string>> rows{{"Method", r.model}};
    const auto& s = options.settings;
    rows.emplace_back("Stored", s.store == Store::coefficients ? std::string("coefficients, three per texel")
                                : s.choose_bands               ? std::string("spectra in the fewest bands that its lights need")
                                                               : fmt::format("spectra in {} bands from {:g} to {:g} nm", s.bands.size(), s.bands.front(), s.bands.back()));
    rows.emplace_back("Samples", s.type ? std::string(pixel_type_name(*s.type)) : std::string("half for textures of 8 bits and half, else float32"));
    rows.emplace_back("Compression", options.compression.empty() ? "zip" : options.compression);
    rows.emplace_back("Layout", options.layout == Layout::multipart ? "multipart" : "single part");
    rows.emplace_back("Outside [0,1]", set.method.gamut == GamutPolicy::clip ? "clipped" : set.method.gamut == GamutPolicy::desaturate ? "desaturated" : "an error");
    rows.emplace_back("Errors measured", options.check_all ? "on every pixel" : "on every 16th row");
    rows.emplace_back("Input colour space", options.job.input_colorspace.empty() ? "as each file says" : options.job.input_colorspace);
    if (s.max_error) rows.emplace_back("Error allowed", fmt::format("CIE76 {:g}", *s.max_error));
    if (!set.lights.empty()) rows.emplace_back("For lights", fmt::format("{}", fmt::join(set.lights, ", ")));
    if (s.skip_transparent) rows.emplace_back("Transparent texels", "stored as black");
    rows.emplace_back("Data maps", options.data == DataMaps::copy ? "copied as they are" : "left alone");
    for (const auto& pattern : options.include) rows.emplace_back("Only", pattern);
    for (const auto& pattern : options.exclude) rows.emplace_back("Without", pattern);
    for (const auto& rule : options.treat_as) rows.emplace_back("Treated as", fmt::format("{} = {}", rule.pattern, texture_use_name(rule.use)));
    if (options.shard) rows.emplace_back("Shard", fmt::format("{} of {}", options.shard->index, options.shard->count));
    if (options.dry_run) rows.emplace_back("Dry run", "what would be done; nothing was written");
    rows.emplace_back("Threads", app.threads() > 0 ? fmt::format("{}", app.threads()) : std::string("all processors"));
    return rows;
}

/// What failed, once more at the end, where it is seen.
int list_failures(App& app, const BatchReport& r) {
    for (const auto& f : r.files)
        if (f.status == BatchStatus::failed) app.report({ErrorKind::input, f.reason}, f.input);
    return r.failed > 0 ? exit_failure : exit_ok;
}

int merge(App& app, const std::string& destination) {
    const auto r = merge_batch(destination);
    if (!r) return app.report(r.error(), destination);
    for (const int i : r->missing) app.warn(fmt::format("{}: shard {} has left no manifest", destination, i));
    app.note(fmt::format("{}: {} shards joined, {} files", destination, r->shards, r->files));
    app.record({{"shards", r->shards}, {"merged_files", r->files}, {"missing", r->missing}});
    return r->missing.empty() ? exit_ok : exit_failure;
}

int verify(App& app, const std::string& destination) {
    const auto r = verify_batch(destination);
    if (!r) return app.report(r.error(), destination);
    app.note(fmt::format("{}: {} outputs are as they were written, {} are not", destination, r->skipped, r->failed));
    app.record(to_json(*r));
    return list_failures(app, *r);
}

int prune(App& app, const std::string& source, const std::string& destination, bool yes) {
    const auto r = prune_batch(source, destination, yes);
    if (!r) return app.report(r.error(), destination);
    Json outputs = Json::array();
    for (const auto& o : r->outputs) {
        app.out(fmt::format("{}{}: {}\n", o.removed ? "removed " : "", escape(o.path), escape(o.reason)));
        outputs.push_back({{"output", o.path}, {"reason", o.reason}, {"removed", o.removed}});
    }
    app.note(yes ? fmt::format("{} outputs had no source", r->outputs.size())
                 : fmt::format("{} outputs have no source; --yes removes them", r->outputs.size()));
    app.record({{"removed", yes}, {"outputs", std::move(outputs)}});
    return exit_ok;
}

}  // namespace

int main(int argc, char** argv) {
    App app({"spxbatch", "SRC DST [options]\nmerge DST",
             "Converts a folder of textures to spectral or coefficient EXRs: colour is uplifted, data maps are not, and what is "
             "up to date is not made again.",
             {{"spxbatch textures/ spectral/ --json report.json", "all colour textures of a library; a second run does nothing"},
              {"spxbatch textures/ spectral/ --dry-run --explain", "what would be done with each file, and why"},
              {"spxbatch textures/ spectral/ --shard \"$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT\"", "one task of a job array"},
              {"spxbatch merge spectral/", "joins what the tasks have left"}}});
    std::vector<std::string> arguments;
    std::string layout = "single", data = "skip";
    bool verifying = false, pruning = false, yes = false;
    std::int64_t jobs = 0;
    BatchOptions options;
    UpliftOptionSet set;
    app.positional("SRC DST", &arguments, 2, 2, "folder of textures, and folder for the outputs (made when missing); `merge DST` joins shards");
    app.group("Files");
    const auto pattern = [&](const char* name, std::vector<std::string>& out, const char* text) {
        app.add({.names = name, .metavar = "GLOB", .text = text, .repeatable = true, .set = [&out](std::string_view v) -> Status {
                     if (v.empty()) return expected("GLOB", v);
                     out.emplace_back(v);
                     return {};
                 }});
    };
    pattern("--include", options.include, "only files whose relative path or name matches");
    pattern("--exclude", options.exclude, "no files whose relative path or name matches");
    app.add({.names = "--treat-as", .metavar = "GLOB=USE",
             .text = "what matching files are: colour, data, or a use such as normal; the last that matches holds", .repeatable = true,
             .set = [&](std::string_view v) -> Status {
                 auto rule = parse_treat_as(v);
                 if (!rule) return rule.error();
                 options.treat_as.push_back(*std::move(rule));
                 return {};
             }});
    std::optional<std::string> scene_path, scene_output_path;
    const auto file = [&](const char* name, std::optional<std::string>& out, const char* text) {
        app.add({.names = name, .metavar = "FILE", .text = text, .set = [&out](std::string_view v) -> Status {
                     if (v.empty()) return expected("FILE", v);
                     out = v;
                     return {};
                 }});
    };
    file("--scene", scene_path, "only the textures that this scene uses as reflectances: .pbrt .xml (Mitsuba 3) .mtlx .gltf .glb .obj .mtl");
    file("--rewrite-scene", scene_output_path, "write the scene here, with the paths of the converted textures");
    app.choice("--data", "WHAT", &data, {"skip", "copy"}, "what is done with data maps");
    app.group("Run");
    app.integer("--jobs", "N", &jobs, 0, 1024, "files in work at once, at most; 0: as many as threads, which they share");
    app.add({.names = "--memory", .metavar = "BYTES", .text = "what the files in work may take, as 4G; a larger file is done alone",
             .default_value = "half of the machine's", .set = [&](std::string_view v) -> Status {
                 auto bytes = parse_bytes(v);
                 if (!bytes) return bytes.error();
                 options.memory = *bytes;
                 return {};
             }});
    app.add({.names = "--shard", .metavar = "I/N", .text = "only the files of part I of N, by content; N/N is 0/N",
             .set = [&](std::string_view v) -> Status {
                 auto shard = parse_shard(v);
                 if (!shard) return shard.error();
                 options.shard = *shard;
                 return {};
             }});
    app.flag("--dry-run", &options.dry_run, "decide and report, write nothing");
    app.flag("--verify", &verifying, "reread every output and compare it with what was written; converts nothing");
    app.flag("--prune", &pruning, "list outputs whose source is gone; converts nothing");
    app.flag("--yes", &yes, "with --prune: remove them");
    app.group("Output");
    app.choice("--layout", "LAYOUT", &layout, {"single", "multipart"},
               "one part (pbrt, spectral viewers), or colour in part 0 and spectrum in part 1 (Mitsuba)");
    std::optional<std::string> page_path;
    file("--report", page_path, "write a page on what was done, with thumbnails: one HTML file that stands alone");
    std::string page_light = "A";
    app.text("--report-light", "ILLUMINANT", &page_light, "light under which the report shows the outputs; by default the first of --for, else A");
    app.flag("--check", &options.check_all, "measure the round trip of every pixel instead of every 16th row");
    std::string input_colorspace;
    add_input_colorspace(app, input_colorspace);
    add_uplift_options(app, set);

    return app.run(argc, argv, [&]() -> int {
        const auto trimmed = [](std::string path) {
            while (path.size() > 1 && path.back() == '/') path.pop_back();
            return path;
        };
        const std::string source = trimmed(arguments[0]), destination = trimmed(arguments[1]);
        if (source.empty() || destination.empty()) return app.usage_error("expected two folders, got an empty name");
        if (yes && !pruning) return app.usage_error("--yes: only goes with --prune");
        if (verifying && pruning) return app.usage_error("--verify: excludes --prune");
        if (page_path && (verifying || pruning || source == "merge")) return app.usage_error("--report: tells of a conversion, and this converts nothing");
        if (app.given("--report-light") && !page_path) return app.usage_error("--report-light: needs --report");
        if (page_path) {
            if (!page_path->ends_with(".html") && !page_path->ends_with(".htm")) return app.usage_error(fmt::format("--report: expected a name that ends in .html, got '{}'", *page_path));
            const NamedOutput outputs[] = {{"--report", *page_path}, {"--json", app.json_path()}};
            if (auto s = check_outputs({}, outputs); !s) return app.report(s.error());
        }
        // A folder of that name is written ./merge.
        if (source == "merge") return merge(app, destination);
        if (verifying) return verify(app, destination);
        if (pruning) return prune(app, source, destination, yes);
        options.layout = layout == "multipart" ? Layout::multipart : Layout::single;
        if (scene_output_path && !scene_path) return app.usage_error("--rewrite-scene: needs --scene");
        std::optional<Scene> scene;
        if (scene_path) {
            auto read = read_scene(*scene_path);
            if (!read) return app.report(read.error(), *scene_path);
            scene = *std::move(read);
            if (auto s = apply_scene(app, *scene, source, scene_output_path, options, set); !s) return app.report(s.error(), *scene_path);
        }
        const auto settings = set.settings(app);
        if (!settings) return app.report(settings.error());
        if (settings->type == PixelType::uint8) return app.usage_error("--uint8 does not apply to folders, whose outputs are EXR: expected --half or --float");
        options.settings = *settings;
        const auto chosen = set.layout(app, options.layout);
        if (!chosen) return app.report(chosen.error());
        options.layout = *chosen;
        if (!app.given("--report-light") && !set.lights.empty()) page_light = set.lights.front();
        const auto light = parse_illuminant(page_light);
        if (!light) return app.report({light.error().kind, "--report-light: " + light.error().message});
        options.compression = set.output.compression;
        options.data = data == "copy" ? DataMaps::copy : DataMaps::skip;
        options.jobs = static_cast<int>(jobs);
        const auto progress = app.progress("spxbatch");
        options.job = job_options(app, progress, input_colorspace);
        const bool terminal = ::isatty(STDERR_FILENO) == 1;
        options.on_file = [&](const BatchFile& f, std::size_t done, std::size_t total) {
            progress.label(fmt::format("{}/{} files", done, total));
            const std::string line = fmt::format("{}: {}: {}", f.relative, batch_status_name(f.status), f.reason);
            if (!terminal && !app.explaining() && f.status != BatchStatus::skipped)
                app.note(fmt::format("[{}/{}] {}", done, total, line));
        };
        const auto r = run_batch(source, destination, options);
        if (!r) return app.report(r.error(), destination);
        if (app.explaining()) {
            std::vector<std::pair<std::string, std::string>> rows{{"model", r->model}};
            for (const auto& f : r->files)
                rows.emplace_back(escape(f.relative), fmt::format("{}: {}", batch_status_name(f.status), f.reason));
            app.explain(source, rows);
        }
        app.note(fmt::format("{}{}", options.dry_run ? "would be: " : "", ::summary(*r)));
        Json record = to_json(*r);
        if (scene) {
            const auto finished = finish_scene(app, *scene, *r, options.dry_run ? std::nullopt : scene_output_path);
            if (!finished) {
                app.record(std::move(record));
                return app.report(finished.error(), *scene_output_path);
            }
            record["scene"] = *finished;
        }
        int code = exit_ok;
        if (page_path) {
            BatchPageOptions page;
            const auto reading = app.progress("report");
            page.job = job_options(app, reading, input_colorspace);
            page.settings = options.settings;
            page.light = *light;
            page.facts = facts(app, options, set, *r);
            page.keep_thumbnails = !options.dry_run;
            const auto written = write_batch_page(*page_path, source, destination, *r, page);
            if (written) {
                app.note(fmt::format("{}: {} files, {} with pictures, {:.1f} MB", *page_path, written->rows, written->pictures, static_cast<double>(written->bytes) / 1e6));
                record["report"] = {{"path", *page_path}, {"rows", written->rows}, {"pictures", written->pictures}, {"from_cache", written->from_cache},
                                    {"without_pictures", written->without}, {"bytes", written->bytes}};
            } else {
                code = app.report(written.error(), *page_path);
            }
        }
        app.record(std::move(record));
        return std::max(code, list_failures(app, *r));
    });
}
