// A scene with other textures: only the bytes of their paths change.
#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <set>

#include <xxhash.h>

#include "scene/internal.h"
#include "spectex/io.h"

namespace spectex {
namespace fs = std::filesystem;
namespace {

/// As the format quotes it. Empty where the format cannot say it.
std::string quoted(SceneFormat format, std::string_view text) {
    std::string out;
    for (const char c : text) {
        if (format == SceneFormat::pbrt) {
            static constexpr std::string_view plain = "\b\f\n\r\t\\\"", escapes = "bfnrt\\\"";
            if (const auto at = plain.find(c); at != std::string_view::npos) out.append({'\\', escapes[at]});
            else out.push_back(c);
        } else if (format == SceneFormat::obj) {
            if (c == '\n' || c == '\r') return {};
            out.push_back(c);
        } else {
            switch (c) {
                case '&': out += "&amp;"; break;
                case '<': out += "&lt;"; break;
                case '"': out += "&quot;"; break;
                case '\'': out += "&apos;"; break;
                case '\n': out += "&#10;"; break;
                case '\t': out += "&#9;"; break;
                default: out.push_back(c);
            }
        }
    }
    return out;
}

std::string relative_to(const std::string& folder, const std::string& path) {
    return fs::path(path).lexically_relative(folder).generic_string();
}

struct Change {
    std::size_t begin, end;
    std::string text;
};

Result<std::string> read_unchanged(const Scene& scene, std::size_t file) {
    std::ifstream in(scene.files[file], std::ios::binary);
    std::string content((std::istreambuf_iterator<char>(in)), {});
    if (!in || XXH3_64bits(content.data(), content.size()) != scene.hashes[file])
        return Error{ErrorKind::input, fmt::format("{}: changed since the scene was read", scene.files[file])};
    return content;
}

}  // namespace

SceneOutput scene_output(SceneFormat format) {
    switch (format) {
        case SceneFormat::pbrt: return {true, false, "pbrt-v4 takes R, G, B of an EXR, linear, and passes over the bands"};
        case SceneFormat::mitsuba:
            return {true, true, "Mitsuba 3 takes the first part of an EXR, which has to be R, G, B alone: --layout multipart"};
        case SceneFormat::materialx:
            return {true, false, "MaterialX takes R, G, B of an EXR; the colour space of a converted image becomes lin_rec709"};
        case SceneFormat::gltf: return {false, false, "glTF 2.0 takes PNG and JPEG only, no EXR"};
        case SceneFormat::obj: return {true, false, "MTL says nothing of file formats: Blender takes EXR, many others do not"};
    }
    return {};
}

Result<SceneRewrite> rewrite_scene(const Scene& scene, const std::string& output, const std::map<std::string, std::string>& converted) {
    const SceneOutput reader = scene_output(scene.format);
    if (!reader.readable)
        return Error{ErrorKind::usage, fmt::format("{}: cannot be rewritten with EXR textures: {}", scene.path, reader.sentence)};
    std::error_code failed;
    const std::string target = fs::absolute(output, failed).lexically_normal().string();
    if (failed) return Error{ErrorKind::usage, fmt::format("{}: {}", output, failed.message())};
    const std::string folder = fs::path(target).parent_path().string(), stem = fs::path(target).stem().string();

    // The files to be written, by the number of the one they are made from: the scene, and includes that change.
    std::vector<std::string> targets(scene.files.size());
    std::set<std::string> taken{target};
    for (std::size_t i = 0; i < scene.files.size(); ++i) {
        if (i == 0) targets[i] = target;
        else {
            // An include that is read twice is written twice alike, under one name.
            const auto first = static_cast<std::size_t>(std::find(scene.files.begin(), scene.files.end(), scene.files[i]) - scene.files.begin());
            if (first < i) {
                targets[i] = targets[first];
                continue;
            }
            const std::string name = fs::path(scene.files[i]).filename().string();
            targets[i] = (fs::path(folder) / (stem + "." + name)).string();
            for (int n = 2; !taken.insert(targets[i]).second; ++n)
                targets[i] = (fs::path(folder) / fmt::format("{}.{}.{}", stem, n, name)).string();
        }
    }

    // A path changes where all its uses agree. One place read twice (an include) has several tokens at the same bytes.
    using Place = std::pair<std::string, std::size_t>;
    std::map<Place, std::pair<std::string, bool>> places;  // conversion, agreed
    SceneRewrite result;
    for (const SceneTexture& t : scene.textures) {
        if (t.token == SceneTexture::no_token) continue;
        const SceneToken& token = scene.tokens[t.token];
        const auto at = converted.find(t.resolved);
        const std::string to = at == converted.end() ? std::string() : at->second;
        const bool use = t.use == SceneUse::reflectance;
        auto [place, fresh] = places.try_emplace(Place{scene.files[token.file], token.begin}, to, use);
        if (!fresh) place->second.second = place->second.second && use && place->second.first == to;
    }

    std::vector<const SceneTexture*> texture_of(scene.tokens.size());
    for (const SceneTexture& t : scene.textures)
        if (t.token != SceneTexture::no_token) texture_of[t.token] = &t;
    std::vector<std::vector<const SceneToken*>> includes(scene.files.size());
    for (const SceneToken& token : scene.tokens)
        if (token.kind == SceneToken::Kind::include && token.target < scene.files.size()) includes[token.file].push_back(&token);

    std::vector<std::vector<Change>> changes(scene.files.size());
    std::set<std::pair<std::size_t, std::size_t>> done;
    std::set<std::size_t> changed_tokens;
    std::size_t disagreeing = 0, others = 0;
    for (std::size_t i = 0; i < scene.tokens.size(); ++i) {
        const SceneToken& token = scene.tokens[i];
        if (token.kind != SceneToken::Kind::texture) continue;
        const auto place = places.find({scene.files[token.file], token.begin});
        if (place == places.end()) continue;
        const auto& [to, agreed] = place->second;
        if (to.empty() || !agreed) {
            disagreeing += !to.empty();
            ++others;
            continue;
        }
        const SceneTexture* texture = texture_of[i];
        const std::string absolute = fs::absolute(to, failed).lexically_normal().string();
        std::string path = absolute;
        if (texture && !fs::path(texture->written).is_absolute()) {
            const fs::path prefix(token.prefix);
            if (!token.prefix.empty() && !token.prefix.ends_with('/')) {
                result.notes.push_back(fmt::format("{}: {}: the prefix {} is no folder: its texture keeps its path", texture->file, texture->where, token.prefix));
                continue;
            }
            path = relative_to((fs::path(folder) / prefix).lexically_normal().string(), absolute);
        }
        const std::string text = quoted(scene.format, path);
        if (text.empty()) {
            result.notes.push_back(fmt::format("{}: a path with a line break cannot be written in this format", absolute));
            continue;
        }
        changed_tokens.insert(i);
        if (done.insert({token.file, token.begin}).second) {
            changes[token.file].push_back({token.begin, token.end, text});
            ++result.changed;
        }
    }
    for (const SceneToken& token : scene.tokens)
        if (token.kind == SceneToken::Kind::colorspace && changed_tokens.contains(token.target))
            changes[token.file].push_back({token.begin, token.end, token.begin == token.end ? " colorspace=\"lin_rec709\"" : "lin_rec709"});

    // Includes change where what they include changes, from the innermost out: an include's number is above its includer's.
    std::vector<bool> written(scene.files.size());
    for (std::size_t file = scene.files.size(); file-- > 0;) {
        for (const SceneToken* token : includes[file]) {
            if (!written[token->target]) {
                ++others;
                continue;
            }
            changes[file].push_back({token->begin, token->end, quoted(scene.format, fs::path(targets[token->target]).filename().string())});
        }
        written[file] = file == 0 || !changes[file].empty();
    }

    std::vector<std::pair<std::string, std::string>> texts;
    std::set<std::string> made;
    for (std::size_t file = 0; file < scene.files.size(); ++file) {
        if (!written[file] || !made.insert(targets[file]).second) continue;
        for (const std::string& source : scene.files)
            if (targets[file] == source || same_file(targets[file], source))
                return Error{ErrorKind::usage, fmt::format("{}: is one of the scene's own files", targets[file])};
        for (const auto& [from, to] : converted)
            if (same_file(targets[file], to) || same_file(targets[file], from))
                return Error{ErrorKind::usage, fmt::format("{}: is a texture", targets[file])};
        auto content = read_unchanged(scene, file);
        if (!content) return content.error();
        auto& list = changes[file];
        std::sort(list.begin(), list.end(), [](const Change& a, const Change& b) { return a.begin < b.begin; });
        std::string text;
        std::size_t at = 0;
        for (const Change& c : list) {
            text.append(*content, at, c.begin - at);
            text += c.text;
            at = c.end;
        }
        text.append(*content, at, std::string::npos);
        texts.emplace_back(targets[file], std::move(text));
    }
    // Includes first: the scene appears when all that it needs is there.
    for (auto t = texts.rbegin(); t != texts.rend(); ++t) {
        if (auto s = write_text_file(t->first, t->second); !s) return s.error();
        result.written.insert(result.written.begin(), t->first);
    }
    if (disagreeing > 0)
        result.notes.push_back(fmt::format("{} path{} stay{} as before: the scene uses {} texture as data as well", disagreeing, disagreeing == 1 ? "" : "s",
                                           disagreeing == 1 ? "s" : "", disagreeing == 1 ? "that" : "each"));
    if (folder != fs::path(scene.files[0]).parent_path().string())
        result.notes.push_back(fmt::format("{} lies in another folder than the scene: other relative paths in it ({} known, and those of its geometry) now "
                                           "count from there", output, others));
    if (reader.needs_multipart) result.notes.push_back(std::string(reader.sentence));
    return result;
}

}  // namespace spectex
