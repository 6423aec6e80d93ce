// Wavefront OBJ names its material libraries, MTL the textures; the options are those of the format's specification of 1995
// and of its common extension for physically-based materials.
#include <algorithm>
#include <array>

#include "scene/internal.h"

namespace spectex::scene {
namespace {

struct Line {
    std::size_t begin = 0, end = 0;  ///< without blanks around it and without what ends it
};

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

Line trimmed(std::string_view s, std::size_t begin, std::size_t end) {
    while (begin < end && is_blank(s[begin])) ++begin;
    while (end > begin && is_blank(s[end - 1])) --end;
    return {begin, end};
}

template <class Do>
Status each_line(const Text& text, Do&& visit) {
    const std::string_view s = text.content;
    for (std::size_t at = 0; at < s.size();) {
        const std::size_t end = std::min(s.find('\n', at), s.size());
        const Line line = trimmed(s, at, end);
        if (line.begin < line.end && s[line.begin] != '#')
            if (auto done = visit(line); !done) return done;
        at = end + 1;
    }
    return {};
}

/// The word at the beginning of a line; what follows it is left in `line`.
std::string_view take_word(std::string_view s, Line& line) {
    std::size_t end = line.begin;
    while (end < line.end && !is_blank(s[end])) ++end;
    const auto word = s.substr(line.begin, end - line.begin);
    line = trimmed(s, end, line.end);
    return word;
}

struct Statement {
    std::string_view name;
    SceneUse use;
};
constexpr std::array statements{
    Statement{"map_kd", SceneUse::reflectance}, Statement{"map_ka", SceneUse::reflectance}, Statement{"map_ks", SceneUse::reflectance},
    Statement{"map_tf", SceneUse::reflectance}, Statement{"map_ke", SceneUse::emission},    Statement{"map_kn", SceneUse::data},
    Statement{"map_ns", SceneUse::data},        Statement{"map_d", SceneUse::data},         Statement{"map_tr", SceneUse::data},
    Statement{"map_bump", SceneUse::data},      Statement{"bump", SceneUse::data},          Statement{"disp", SceneUse::data},
    Statement{"map_disp", SceneUse::data},      Statement{"decal", SceneUse::data},         Statement{"map_pr", SceneUse::data},
    Statement{"map_pm", SceneUse::data},        Statement{"map_ps", SceneUse::data},        Statement{"map_pc", SceneUse::data},
    Statement{"map_pcr", SceneUse::data},       Statement{"norm", SceneUse::data},          Statement{"map_norm", SceneUse::data},
    Statement{"refl", SceneUse::emission},      Statement{"map_refl", SceneUse::emission},  Statement{"map_ao", SceneUse::data},
    Statement{"map_rma", SceneUse::data},       Statement{"map_orm", SceneUse::data}};

/// Skips -option arguments; what is left is the name, which may have spaces.
void skip_options(std::string_view s, Line& line) {
    static constexpr std::array<std::string_view, 10> one{"-blendu", "-blendv", "-cc", "-clamp", "-imfchan", "-texres", "-bm", "-boost", "-type", "-colorspace"};
    for (;;) {
        Line rest = line;
        const std::string option = lower(take_word(s, rest));
        int most = 0, least = 0;
        if (std::find(one.begin(), one.end(), option) != one.end()) most = least = 1;
        else if (option == "-mm") most = least = 2;
        else if (option == "-o" || option == "-s" || option == "-t") most = 3, least = 1;
        else return;
        for (int i = 0; i < most; ++i) {
            Line after = rest;
            const auto argument = take_word(s, after);
            // The numbers end where the name begins; the last word is the name, even if it looks like one.
            if (i >= least && (!number_of(argument) || after.begin == after.end)) break;
            if (after.begin == after.end) break;
            rest = after;
        }
        line = rest;
    }
}

Status read_mtl(Builder& builder, const std::string& path, const Text* from, std::size_t offset) {
    if (auto s = builder.enter(path, from, offset); !s) return s;
    auto text = builder.load(path);
    if (!text) return text.error();
    const std::string_view s = text->content;
    const std::string folder = folder_of(path);
    auto done = each_line(*text, [&](Line line) -> Status {
        const std::size_t begin = line.begin;
        const std::string word(take_word(s, line));
        const auto known = std::find_if(statements.begin(), statements.end(), [&](const Statement& st) { return st.name == lower(word); });
        if (known == statements.end()) return {};
        skip_options(s, line);
        if (line.begin == line.end) {
            builder.warn(*text, begin, fmt::format("{} names no file", word));
            return {};
        }
        SceneToken token;
        token.file = text->file;
        token.begin = line.begin;
        token.end = line.end;
        SceneTexture t;
        t.token = builder.add_token(std::move(token));
        t.written = s.substr(line.begin, line.end - line.begin);
        t.resolved = resolve(folder, t.written);
        // Files from Windows.
        if (!exists(t.resolved) && t.written.find('\\') != std::string::npos) {
            std::string slashes = t.written;
            std::replace(slashes.begin(), slashes.end(), '\\', '/');
            t.resolved = resolve(folder, slashes);
        }
        t.use = known->use;
        t.parameter = word;
        t.file = path;
        t.where = text->where(begin);
        return builder.add(std::move(t), folder);
    });
    builder.leave();
    return done;
}

}  // namespace

Status read_obj(Builder& builder, const std::string& path) {
    if (lower(path).ends_with(".mtl")) return read_mtl(builder, path, nullptr, 0);
    if (auto s = builder.enter(path, nullptr, 0); !s) return s;
    auto text = builder.load(path);
    if (!text) return text.error();
    const std::string_view s = text->content;
    std::vector<std::string> seen;
    auto done = each_line(*text, [&](Line line) -> Status {
        if (s[line.begin] != 'm') return {};
        const std::size_t begin = line.begin;
        if (take_word(s, line) != "mtllib") return {};
        // One name with spaces, or several names.
        std::vector<Line> names{line};
        if (!exists(resolve(folder_of(path), std::string(s.substr(line.begin, line.end - line.begin))))) {
            names.clear();
            for (Line rest = line; rest.begin < rest.end;) {
                const std::size_t at = rest.begin;
                const auto word = take_word(s, rest);
                names.push_back({at, at + word.size()});
            }
        }
        for (const Line& name : names) {
            const std::string library = resolve(folder_of(path), std::string(s.substr(name.begin, name.end - name.begin)));
            if (std::find(seen.begin(), seen.end(), library) != seen.end()) continue;
            seen.push_back(library);
            if (!exists(library)) {
                builder.warn(*text, begin, fmt::format("there is no material library {}", library));
                continue;
            }
            builder.add_include(*text, name.begin, name.end);
            if (auto read = read_mtl(builder, library, &*text, begin); !read) return read;
        }
        return {};
    });
    builder.leave();
    return done;
}

}  // namespace spectex::scene
