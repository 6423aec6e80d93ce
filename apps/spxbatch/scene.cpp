#include "scene.h"

#include <fmt/format.h>

#include <filesystem>
#include <map>
#include <set>

namespace spectex::app {
namespace {
namespace fs = std::filesystem;

std::string real(const std::string& path) {
    std::error_code failed;
    return fs::weakly_canonical(path, failed).string();
}

}  // namespace

Status apply_scene(App& app, const Scene& scene, const std::string& source, const std::optional<std::string>& rewrite,
                   BatchOptions& options, UpliftOptionSet& set) {
    const SceneOutput reader = scene_output(scene.format);
    if (rewrite && !reader.readable) return Error{ErrorKind::usage, fmt::format("--rewrite-scene: {}", reader.sentence)};
    if (rewrite && reader.needs_multipart && options.layout != Layout::multipart)
        return Error{ErrorKind::usage, fmt::format("--rewrite-scene: {}", reader.sentence)};
    // rewrite_scene refuses this as well, but after the work is done.
    if (rewrite)
        for (const std::string& file : scene.files)
            if (same_file(file, *rewrite)) return Error{ErrorKind::usage, fmt::format("--rewrite-scene: {} is one of the scene's own files", *rewrite)};
    const std::string root = real(source) + "/";
    std::set<std::string> only;
    for (const SceneTexture& t : scene.textures) {
        if (t.use != SceneUse::reflectance || t.embedded) continue;
        if (!t.exists) app.warn(fmt::format("{}: {}: there is no texture {}", t.file, t.where, t.resolved));
        else if (!real(t.resolved).starts_with(root)) app.warn(fmt::format("{}: {}: {} lies outside {} and is not converted", t.file, t.where, t.resolved, source));
        else only.insert(t.resolved);
    }
    for (const SceneWarning& w : scene.warnings)
        if (!w.message.starts_with("there is no texture")) app.warn(fmt::format("{}: {}: {}", w.file, w.where, w.message));
    options.only.emplace(only.begin(), only.end());
    if (set.lights.empty() && set.store == "spectral" && app.given("--bands") && set.colorimetry.bands == "auto") {
        set.lights = scene_illuminants(scene);
        if (set.lights.empty()) return Error{ErrorKind::usage, fmt::format("{}: names no light that is known: --bands auto needs --for", scene.path)};
        app.note(fmt::format("{}: bands for its lights {}", scene.path, fmt::join(set.lights, ", ")));
    }
    return {};
}

Result<Json> finish_scene(App& app, const Scene& scene, const BatchReport& report, const std::optional<std::string>& output) {
    Json json{{"path", scene.path}, {"format", scene_format_name(scene.format)}, {"files", scene.files}, {"illuminants", scene_illuminants(scene)},
              {"textures", Json::array()}, {"warnings", Json::array()}};
    for (const SceneTexture& t : scene.textures)
        json["textures"].push_back({{"written", t.written}, {"resolved", t.resolved}, {"use", scene_use_name(t.use)}, {"parameter", t.parameter},
                                    {"file", t.file}, {"where", t.where}, {"exists", t.exists}, {"embedded", t.embedded}, {"raw", t.raw}});
    for (const SceneWarning& w : scene.warnings) json["warnings"].push_back({{"file", w.file}, {"where", w.where}, {"message", w.message}});
    if (!output) return json;
    std::map<std::string, std::string> made, converted;
    std::error_code failed;
    for (const BatchFile& f : report.files)
        if ((f.status == BatchStatus::converted || f.status == BatchStatus::skipped) && !f.output.empty() && fs::exists(f.output, failed)) made[real(f.input)] = f.output;
    for (const SceneTexture& t : scene.textures)
        if (const auto at = made.find(real(t.resolved)); t.use == SceneUse::reflectance && at != made.end()) converted[t.resolved] = at->second;
    const auto rewritten = rewrite_scene(scene, *output, converted);
    if (!rewritten) return rewritten.error();
    for (const auto& note : rewritten->notes) app.note(note);
    app.note(fmt::format("{}: {} paths of textures changed", *output, rewritten->changed));
    json["rewritten"] = rewritten->written;
    json["changed_paths"] = rewritten->changed;
    return json;
}

}  // namespace spectex::app
