// The scene description language of pbrt-v4 (https://pbrt.org/fileformat-v4), as far as textures and lights go.
#include <algorithm>
#include <array>
#include <map>
#include <set>

#include "scene/internal.h"

namespace spectex::scene {
namespace {

struct Token {
    enum class Kind { word, string, open, close, end } kind = Kind::end;
    std::string value;                 ///< of strings, after escapes
    std::size_t begin = 0, end = 0;    ///< of the text; without quotes for strings
};

/// Words, quoted strings and brackets; comments from # to the end of the line.
class Tokenizer {
public:
    explicit Tokenizer(const Text& text) : text_(text), s_(text.content) {}

    Result<Token> next() {
        if (ahead_) {
            Token t = std::move(*ahead_);
            ahead_.reset();
            return t;
        }
        while (at_ < s_.size()) {
            const char c = s_[at_];
            if (c == '#')
                while (at_ < s_.size() && s_[at_] != '\n') ++at_;
            else if (is_space(c)) ++at_;
            else break;
        }
        Token t;
        t.begin = t.end = at_;
        if (at_ >= s_.size()) return t;
        const char c = s_[at_];
        if (c == '"') return string();
        if (c == '[' || c == ']') {
            t.kind = c == '[' ? Token::Kind::open : Token::Kind::close;
            t.end = ++at_;
            return t;
        }
        while (at_ < s_.size() && !is_space(s_[at_]) && s_[at_] != '"' && s_[at_] != '[' && s_[at_] != ']' && s_[at_] != '#') ++at_;
        t.kind = Token::Kind::word;
        t.end = at_;
        // Numbers make up most of a scene and are not copied; nor is what could not be a word of the language.
        if (t.end - t.begin <= 64) t.value = s_.substr(t.begin, t.end - t.begin);
        return t;
    }
    void put_back(Token t) { ahead_ = std::move(t); }

private:
    static bool is_space(char c) { return c == ' ' || c == '\n' || c == '\t' || c == '\r'; }

    Result<Token> string() {
        Token t;
        t.kind = Token::Kind::string;
        t.begin = ++at_;
        for (; at_ < s_.size(); ++at_) {
            const char c = s_[at_];
            if (c == '"') {
                t.end = at_++;
                return t;
            }
            if (c == '\n') break;
            if (c != '\\') {
                t.value.push_back(c);
                continue;
            }
            static constexpr std::string_view escapes = "bfnrt\\'\"", meanings = "\b\f\n\r\t\\'\"";
            const auto which = at_ + 1 < s_.size() ? escapes.find(s_[at_ + 1]) : std::string_view::npos;
            if (which == std::string_view::npos) return text_.error(at_, "a string has an escape that is none of \\b \\f \\n \\r \\t \\\\ \\' \\\"");
            t.value.push_back(meanings[which]);
            ++at_;
        }
        return text_.error(t.begin, "a string is not closed on its line");
    }

    const Text& text_;
    std::string_view s_;
    std::size_t at_ = 0;
    std::optional<Token> ahead_;
};

struct Parameter {
    std::string type, name;
    std::size_t offset = 0;
    std::vector<Token> strings;
    std::vector<double> numbers;  ///< the first few only
};

bool is_value(const Token& t) {
    if (t.kind == Token::Kind::string) return true;
    if (t.kind != Token::Kind::word) return false;
    const char c = t.value.empty() ? '0' : t.value[0];
    return (c >= '0' && c <= '9') || c == '-' || c == '+' || c == '.' || t.value == "true" || t.value == "false";
}

enum class Kind { spectrum, floating };

struct ImageMap {
    SceneTexture texture;
    bool colored = false;  ///< defined as "spectrum"
};

/// A named texture: image files of its own, and the textures that it is made of.
struct PbrtTexture {
    std::vector<ImageMap> images;
    std::vector<std::pair<std::string, Kind>> parts;
    std::set<SceneUse> uses;
};

class PbrtReader {
public:
    explicit PbrtReader(Builder& builder) : builder_(builder) {}

    Status read(const std::string& path) {
        search_ = folder_of(path);
        if (auto s = read_file(path, nullptr, 0); !s) return s;
        return report();
    }

private:
    Status read_file(const std::string& path, const Text* from, std::size_t offset) {
        if (auto s = builder_.enter(path, from, offset); !s) return s;
        auto text = builder_.load(path);
        if (!text) return text.error();
        if (auto s = directives(*text); !s) return s;
        builder_.leave();
        return {};
    }

    Status directives(const Text& text) {
        Tokenizer tokens(text);
        for (;;) {
            auto t = tokens.next();
            if (!t) return t.error();
            if (t->kind == Token::Kind::end) return {};
            if (t->kind != Token::Kind::word || is_value(*t)) {
                // What a directive of numbers and lists leaves over: Translate, Transform.
                if (t->kind == Token::Kind::string) return text.error(t->begin, "a string stands where a directive is expected");
                continue;
            }
            if (auto s = directive(text, tokens, *t); !s) return s;
        }
    }

    Status directive(const Text& text, Tokenizer& tokens, const Token& name) {
        const std::string& d = name.value;
        std::size_t leading = 0;
        static const std::map<std::string, std::size_t, std::less<>> named{
            {"Texture", 3}, {"Material", 1}, {"MakeNamedMaterial", 1}, {"Shape", 1}, {"LightSource", 1}, {"AreaLightSource", 1},
            {"MakeNamedMedium", 1}, {"Film", 1}, {"Camera", 1}, {"Sampler", 1}, {"Integrator", 1}, {"Accelerator", 1},
            {"PixelFilter", 1}, {"Attribute", 1}, {"Include", 1}, {"Import", 1}, {"ColorSpace", 1}, {"NamedMaterial", 1},
            {"MediumInterface", 2}, {"CoordinateSystem", 1}, {"CoordSysTransform", 1}, {"ObjectBegin", 1},
            {"ObjectInstance", 1}, {"Option", 0}};
        if (const auto at = named.find(d); at != named.end()) leading = at->second;
        else return {};
        std::vector<Token> names;
        while (names.size() < leading) {
            auto t = tokens.next();
            if (!t) return t.error();
            if (t->kind != Token::Kind::string) {
                tokens.put_back(std::move(*t));
                if (d == "MediumInterface" && !names.empty()) break;
                return text.error(name.begin, fmt::format("{} needs {} quoted name{}", d, leading, leading == 1 ? "" : "s"));
            }
            names.push_back(std::move(*t));
        }
        if (d == "Include" || d == "Import") return include(text, name, names[0]);
        std::vector<Parameter> parameters;
        if (auto s = read_parameters(text, tokens, parameters); !s) return s;
        if (d == "Texture") return texture(text, names, parameters);
        if (d == "Material" || d == "MakeNamedMaterial") return material(text, names[0].value, parameters);
        if (d == "LightSource" || d == "AreaLightSource") return light(text, name.begin, names[0].value, parameters);
        if (d == "Shape") return shape(text, parameters);
        if (d == "ColorSpace") white_ = names[0].value == "aces2065-1" ? "D60" : "D65";
        return {};
    }

    Status read_parameters(const Text& text, Tokenizer& tokens, std::vector<Parameter>& parameters) {
        for (;;) {
            auto t = tokens.next();
            if (!t) return t.error();
            if (t->kind != Token::Kind::string) {
                tokens.put_back(std::move(*t));
                return {};
            }
            Parameter p;
            p.offset = t->begin;
            const auto space = t->value.find_first_of(" \t");
            const auto word = t->value.find_first_not_of(" \t", space);
            if (space == std::string::npos || word == std::string::npos)
                return text.error(t->begin, fmt::format("\"{}\" is no parameter: expected \"type name\"", t->value.substr(0, 80)));
            p.type = t->value.substr(0, space);
            p.name = t->value.substr(word);
            while (!p.name.empty() && (p.name.back() == ' ' || p.name.back() == '\t')) p.name.pop_back();
            auto v = tokens.next();
            if (!v) return v.error();
            if (v->kind == Token::Kind::open) {
                for (;;) {
                    v = tokens.next();
                    if (!v) return v.error();
                    if (v->kind == Token::Kind::close) break;
                    if (!is_value(*v)) return text.error(p.offset, fmt::format("the values of \"{}\" are not closed by ]", p.name));
                    keep(p, *v);
                }
            } else if (is_value(*v)) {
                keep(p, *v);
            } else {
                return text.error(p.offset, fmt::format("\"{}\" has no value", p.name));
            }
            parameters.push_back(std::move(p));
        }
    }

    static void keep(Parameter& p, Token& v) {
        if (v.kind == Token::Kind::string) {
            if (p.strings.size() < 16) p.strings.push_back(std::move(v));
        } else if (p.numbers.size() < 4) {
            if (const auto n = number_of(v.value)) p.numbers.push_back(*n);
        }
    }

    Status include(const Text& text, const Token& directive, const Token& file) {
        const std::string path = resolve(search_, file.value);
        if (path.ends_with(".gz")) {
            builder_.warn(text, directive.begin, fmt::format("{} is compressed and not read", path));
            return {};
        }
        if (!exists(path)) return text.error(directive.begin, fmt::format("there is no file {}", path));
        builder_.add_include(text, file.begin, file.end);
        return read_file(path, &text, directive.begin);
    }

    ImageMap image(const Text& text, const Parameter& p, std::string parameter) {
        ImageMap map;
        const Token& file = p.strings[0];
        map.texture.written = file.value;
        map.texture.parameter = std::move(parameter);
        map.texture.file = text.path;
        map.texture.where = text.where(file.begin);
        SceneToken token;
        token.file = text.file;
        token.begin = file.begin;
        token.end = file.end;
        map.texture.token = builder_.add_token(std::move(token));
        return map;
    }

    Status texture(const Text& text, const std::vector<Token>& names, const std::vector<Parameter>& parameters) {
        const std::string &type = names[1].value, &kind_of = names[2].value;
        if (type != "spectrum" && type != "float")
            return text.error(names[1].begin, fmt::format("texture \"{}\" is of type \"{}\": expected spectrum or float", names[0].value, type));
        const Kind kind = type == "spectrum" ? Kind::spectrum : Kind::floating;
        if (nodes_.size() >= builder_.limits().max_textures)
            return text.error(names[0].begin, fmt::format("the scene has more than {} textures", builder_.limits().max_textures));
        PbrtTexture& node = nodes_[{kind, names[0].value}];
        bool linear = false;
        for (const Parameter& p : parameters)
            linear = linear || (p.type == "string" && p.name == "encoding" && !p.strings.empty() && p.strings[0].value == "linear");
        for (const Parameter& p : parameters) {
            if (p.type == "string" && p.name == "filename" && !p.strings.empty()) {
                if (kind_of != "imagemap") {
                    builder_.warn(text, p.offset, fmt::format("a texture of class {} is not converted: {}", kind_of, p.strings[0].value));
                    continue;
                }
                ImageMap map = image(text, p, fmt::format("Texture \"{}\"", names[0].value));
                map.colored = kind == Kind::spectrum;
                map.texture.raw = linear;
                node.images.push_back(std::move(map));
            } else if (p.type == "texture") {
                const bool weight = p.name == "amount" || p.name == "scale";
                for (const Token& t : p.strings) node.parts.push_back({t.value, weight ? Kind::floating : kind});
            }
        }
        return {};
    }

    static bool is_reflectance(std::string_view name) {
        static constexpr std::array<std::string_view, 9> names{"reflectance", "transmittance", "albedo", "color", "Kd",
                                                               "Ks", "Kr", "Kt", "basecolor"};
        // coatedconductor: "conductor.reflectance".
        if (const auto dot = name.rfind('.'); dot != std::string_view::npos) name.remove_prefix(dot + 1);
        return std::find(names.begin(), names.end(), name) != names.end();
    }

    Status material(const Text& text, const std::string& name, const std::vector<Parameter>& parameters) {
        std::string type = name;
        for (const Parameter& p : parameters)
            if (p.type == "string" && p.name == "type" && !p.strings.empty()) type = p.strings[0].value;
        for (const Parameter& p : parameters) {
            if (p.type == "texture") {
                const bool color = is_reflectance(p.name);
                static constexpr std::array<std::string_view, 7> spectra{"eta", "k", "sigma_a", "sigma_s", "mfp", "opacity", "Opacity"};
                std::string_view last = p.name;
                if (const auto dot = last.rfind('.'); dot != std::string_view::npos) last.remove_prefix(dot + 1);
                const bool spectrum = color || std::find(spectra.begin(), spectra.end(), last) != spectra.end();
                for (const Token& t : p.strings)
                    use({spectrum ? Kind::spectrum : Kind::floating, t.value}, color ? SceneUse::reflectance : SceneUse::data,
                        type + "." + p.name);
            } else if (p.type == "string" && p.name == "normalmap" && !p.strings.empty()) {
                SceneTexture t = image(text, p, type + ".normalmap").texture;
                t.use = SceneUse::data;
                t.raw = true;
                if (auto s = builder_.add(std::move(t), search_); !s) return s;
            }
        }
        return {};
    }

    Status shape(const Text&, const std::vector<Parameter>& parameters) {
        for (const Parameter& p : parameters)
            if (p.type == "texture")
                for (const Token& t : p.strings) use({Kind::floating, t.value}, SceneUse::data, "Shape." + p.name);
        return {};
    }

    Status light(const Text& text, std::size_t offset, const std::string& type, const std::vector<Parameter>& parameters) {
        bool said = false, pictured = false;
        for (const Parameter& p : parameters) {
            if (p.type == "string" && p.name == "filename" && !p.strings.empty()) {
                SceneTexture t = image(text, p, type + ".filename").texture;
                t.use = SceneUse::emission;
                if (auto s = builder_.add(std::move(t), search_); !s) return s;
                pictured = true;
            }
            const bool power = p.name == "L" || p.name == "I" || p.name == "Le";
            if (!power) continue;
            said = true;
            if (p.type == "blackbody" && !p.numbers.empty())
                builder_.add_illuminant(fmt::format("P:{}", p.numbers[0]), fmt::format("blackbody {} [{}]", p.name, p.numbers[0]), text, p.offset);
            else if (p.type == "rgb")
                builder_.add_illuminant(grey_light(p.numbers, white_), fmt::format("rgb {} [{}]", p.name, fmt::join(p.numbers, " ")), text, p.offset);
            else if (p.type == "spectrum" && !p.strings.empty())
                builder_.add_illuminant(spectrum(p.strings[0].value), p.strings[0].value, text, p.offset);
            else if (p.type == "spectrum")
                builder_.add_illuminant("", "a spectrum in the scene itself", text, p.offset);
        }
        // pbrt-v4's lights shine with the colour space's illuminant where nothing else is said, and so do pictures of 1,1,1.
        if (!said) builder_.add_illuminant(pictured ? "" : white_, pictured ? type + " by a picture" : type + " without a spectrum", text, offset);
        return {};
    }

    /// pbrt's own names: stdillum-A, stdillum-D50, stdillum-F11, illum-acesD60; otherwise a file of wavelengths and values.
    std::string spectrum(const std::string& name) const {
        if (name.starts_with("stdillum-")) return name.substr(9);
        if (name == "illum-acesD60") return "D60";
        const std::string path = resolve(search_, name);
        return exists(path) ? path : std::string();
    }

    /// Uses travel down to the parts; each texture takes each use once, so cycles end.
    void use(std::pair<Kind, std::string> key, SceneUse what, const std::string& parameter) {
        std::vector<std::pair<std::pair<Kind, std::string>, SceneUse>> open{{std::move(key), what}};
        while (!open.empty()) {
            auto [k, w] = std::move(open.back());
            open.pop_back();
            const auto at = nodes_.find(k);
            if (at == nodes_.end() || !at->second.uses.insert(w).second) continue;
            for (ImageMap& map : at->second.images) map.texture.parameter = parameter;
            for (const auto& [name, kind] : at->second.parts)
                open.push_back({{kind, name}, kind == Kind::floating ? SceneUse::data : w});
        }
    }

    Status report() {
        for (auto& [key, node] : nodes_) {
            if (node.uses.empty()) node.uses.insert(SceneUse::unused);
            for (const ImageMap& map : node.images)
                for (const SceneUse what : node.uses) {
                    SceneTexture t = map.texture;
                    t.use = what == SceneUse::reflectance && !map.colored ? SceneUse::data : what;
                    if (auto s = builder_.add(std::move(t), search_); !s) return s;
                }
        }
        return {};
    }

    Builder& builder_;
    std::string search_, white_ = "D65";
    std::map<std::pair<Kind, std::string>, PbrtTexture> nodes_;
};

}  // namespace

Status read_pbrt(Builder& builder, const std::string& path) { return PbrtReader(builder).read(path); }

}  // namespace spectex::scene
