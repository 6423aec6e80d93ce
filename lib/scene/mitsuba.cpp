// Scenes of Mitsuba 3 (https://mitsuba.readthedocs.io, "Scene XML file format").
#include <algorithm>
#include <array>
#include <map>
#include <set>

#include "scene/xml.h"

namespace spectex::scene {
namespace {

/// A texture of the scene: files of its own, and uses that reach it from where it stands or through references.
struct MitsubaTexture {
    std::vector<SceneTexture> images;
    std::vector<std::string> parts;  ///< ids of textures within, by reference
    std::vector<std::size_t> children;
    std::set<SceneUse> uses;
    std::string parameter;
};

bool is_reflectance(std::string_view name) {
    static constexpr std::array<std::string_view, 15> names{
        "reflectance", "diffuse_reflectance", "specular_reflectance", "specular_transmittance", "diffuse_transmittance",
        "transmittance", "base_color", "color", "albedo", "sheen_color", "subsurface_color", "coat_color", "specular_color",
        "reflectance_map", "rho_0"};
    return std::find(names.begin(), names.end(), name) != names.end();
}

bool is_emission(std::string_view name) { return name == "radiance" || name == "irradiance" || name == "intensity" || name == "emission"; }

/// Inputs of a texture that are textures of the same kind; others (weights) are data.
bool is_texture_part(std::string_view name) { return name.empty() || name.starts_with("color") || name == "bitmap" || name == "nested_texture" || name == "input"; }

class MitsubaReader {
public:
    explicit MitsubaReader(Builder& builder) : builder_(builder) {}

    Status read(const std::string& path) {
        folders_.push_back(folder_of(path));
        if (auto s = read_file(path, nullptr, 0); !s) return s;
        return report();
    }

private:
    Status read_file(const std::string& path, const Text* from, std::size_t offset) {
        if (auto s = builder_.enter(path, from, offset); !s) return s;
        auto text = builder_.load(path);
        if (!text) return text.error();
        pugi::xml_document document;
        if (auto s = parse_xml(*text, builder_.limits(), document); !s) return s;
        const auto root = document.document_element();
        if (!root) return text->error(0, "has no element");
        if (auto s = object(*text, root, nullptr); !s) return s;
        builder_.leave();
        return {};
    }

    struct Parent {
        std::string tag, type;
        std::size_t texture = SIZE_MAX;  ///< node of the innermost texture element
    };

    /// A scene's element that holds others: scene, shape, bsdf, emitter, texture, medium, ...
    Status object(const Text& text, const pugi::xml_node& node, const Parent* parent) {
        const std::string tag = node.name();
        Parent self{tag, value_of(node, "type"), SIZE_MAX};
        const std::string name = value_of(node, "name"), id = value_of(node, "id");
        if (tag == "texture") {
            if (nodes_.size() >= builder_.limits().max_textures)
                return text.error(offset_of(node), fmt::format("the scene has more than {} textures", builder_.limits().max_textures));
            self.texture = nodes_.size();
            nodes_.emplace_back();
            if (!id.empty()) ids_[id] = self.texture;
            connect(parent, name, self.texture, {});
        }
        if (tag == "emitter") light(text, node, self);
        for (const pugi::xml_node child : node.children()) {
            const std::string kind = child.name();
            if (kind == "default") {
                // The first definition wins: it is the command line's in Mitsuba, the includer's here.
                variables_.emplace(child.attribute("name").value(), expand(child.attribute("value").value()));
            } else if (kind == "path") {
                folders_.insert(folders_.begin(), resolve(folder_of(text.path), value_of(child, "value")));
            } else if (kind == "include") {
                if (auto s = include(text, child); !s) return s;
            } else if (kind == "alias") {
                const auto known = ids_.find(value_of(child, "id"));
                if (known != ids_.end()) ids_[value_of(child, "as")] = known->second;
            } else if (kind == "ref") {
                connect(&self, value_of(child, "name"), SIZE_MAX, value_of(child, "id"));
            } else if (kind == "string" && value_of(child, "name") == "filename") {
                if (auto s = filename(text, node, child, self); !s) return s;
            } else if (child.type() == pugi::node_element && child.first_child()) {
                if (auto s = object(text, child, &self); !s) return s;
            } else if (kind == "emitter") {
                light(text, child, {kind, value_of(child, "type"), SIZE_MAX});
            }
        }
        return {};
    }

    Status include(const Text& text, const pugi::xml_node& node) {
        const std::string written = value_of(node, "filename"), path = find(written);
        if (!exists(path)) return text.error(offset_of(node), fmt::format("there is no file {}", path));
        if (const auto range = attribute_range(text, node, "filename")) builder_.add_include(text, range->begin, range->end);
        return read_file(path, &text, offset_of(node));
    }

    Status filename(const Text& text, const pugi::xml_node& owner, const pugi::xml_node& node, const Parent& self) {
        const bool texture = self.tag == "texture" && self.type == "bitmap";
        const bool lamp = self.tag == "emitter" && (self.type == "envmap" || self.type == "projector");
        if (!texture && !lamp) return {};
        SceneTexture t;
        t.written = value_of(node, "value");
        t.resolved = find(t.written);
        t.file = text.path;
        t.where = text.where(offset_of(node));
        t.parameter = self.type;
        for (const pugi::xml_node flag : owner.children("boolean"))
            if (value_of(flag, "name") == "raw") t.raw = value_of(flag, "value") == "true";
        const auto range = attribute_range(text, node, "value");
        // A variable in the path belongs to whoever sets it.
        if (range && text.content.find('$', range->begin) >= range->end) {
            SceneToken token;
            token.file = text.file;
            token.begin = range->begin;
            token.end = range->end;
            t.token = builder_.add_token(std::move(token));
        }
        if (texture) {
            nodes_[self.texture].images.push_back(std::move(t));
            return {};
        }
        t.use = SceneUse::emission;
        t.parameter = self.type + ".filename";
        return builder_.add(std::move(t), folders_.back());
    }

    /// Notes how a texture, itself or by its id, is used by what it stands in.
    void connect(const Parent* parent, const std::string& name, std::size_t texture, const std::string& id) {
        if (!parent) return;
        if (parent->texture != SIZE_MAX) {
            const bool part = is_texture_part(name);
            if (texture != SIZE_MAX && part) nodes_[parent->texture].children.push_back(texture);
            else if (texture != SIZE_MAX) request(texture, SceneUse::data, "texture." + name);
            else if (part) nodes_[parent->texture].parts.push_back(id);
            else references_.push_back({id, SceneUse::data, "texture." + name});
            return;
        }
        // A texture by itself in the scene waits for a reference.
        if (parent->tag == "scene") return;
        SceneUse use = SceneUse::data;
        if (is_reflectance(name)) use = SceneUse::reflectance;
        else if (is_emission(name)) use = SceneUse::emission;
        // Normal and bump maps, masks and blends take their texture by any name, and never as a colour.
        if (parent->type == "normalmap" || parent->type == "bumpmap" || parent->type == "mask" || parent->type == "blendbsdf") use = SceneUse::data;
        const std::string parameter = parent->type + "." + name;
        if (texture != SIZE_MAX) request(texture, use, parameter);
        else references_.push_back({id, use, parameter});
    }

    void request(std::size_t texture, SceneUse use, const std::string& parameter) { requests_.push_back({texture, use, parameter}); }

    void light(const Text& text, const pugi::xml_node& node, const Parent& self) {
        bool said = self.type == "envmap" || self.type == "projector";
        for (const pugi::xml_node child : node.children()) {
            const std::string kind = child.name(), name = value_of(child, "name");
            if (!is_emission(name)) continue;
            said = true;
            const std::string written = fmt::format("<{} name=\"{}\">", kind, name);
            const auto add = [&](std::string specification, const std::string& what) {
                builder_.add_illuminant(std::move(specification), what, text, offset_of(child));
            };
            if (kind == "rgb") {
                std::vector<double> rgb = numbers(value_of(child, "value"));
                if (rgb.size() == 1) rgb.assign(3, rgb[0]);
                add(grey_light(rgb, "D65"), fmt::format("rgb {}", value_of(child, "value")));
            } else if (kind == "spectrum") {
                const std::string type = value_of(child, "type"), value = value_of(child, "value"), file = value_of(child, "filename");
                if (type == "d65") add("D65", "d65");
                else if (type == "blackbody") {
                    std::string kelvin;
                    for (const pugi::xml_node f : child.children("float"))
                        if (value_of(f, "name") == "temperature") kelvin = value_of(f, "value");
                    add(number_of(kelvin) ? "P:" + kelvin : std::string(), "blackbody " + kelvin);
                } else if (!file.empty()) {
                    const std::string path = find(file);
                    add(exists(path) ? path : std::string(), file);
                } else if (type == "uniform" || number_of(value)) add("E", "constant " + value);
                else add("", value.empty() ? written : value.substr(0, 200));
            } else if (kind != "texture") {
                add("", written);
            }
        }
        // Without a spectrum lights shine with D65; area lights within shapes say theirs always.
        if (!said && (self.type == "constant" || self.type == "point" || self.type == "area" || self.type == "directional" || self.type == "spot"))
            builder_.add_illuminant("D65", self.type + " without a spectrum", text, offset_of(node));
    }

    static std::vector<double> numbers(const std::string& text) {
        std::vector<double> values;
        for (std::size_t at = 0; at < text.size() && values.size() < 16;) {
            const auto begin = text.find_first_not_of(" ,\t\n\r", at);
            if (begin == std::string::npos) break;
            at = std::min(text.find_first_of(" ,\t\n\r", begin), text.size());
            const auto value = number_of(std::string_view(text).substr(begin, at - begin));
            if (!value) return {};
            values.push_back(*value);
        }
        return values;
    }

    std::string value_of(const pugi::xml_node& node, const char* attribute) const { return expand(node.attribute(attribute).value()); }

    /// Replaces $name by its default; one pass, so values cannot expand each other without end.
    std::string expand(std::string_view text) const {
        std::string out;
        for (std::size_t i = 0; i < text.size();) {
            if (text[i] != '$') {
                out.push_back(text[i++]);
                continue;
            }
            std::size_t end = i + 1;
            const auto is_name = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_'; };
            while (end < text.size() && is_name(text[end])) ++end;
            const auto known = variables_.find(text.substr(i + 1, end - i - 1));
            if (known != variables_.end() && out.size() < 65536) out += known->second;
            else out.append(text.substr(i, end - i));
            i = end;
        }
        return out;
    }

    /// The first search folder that has it; else where it would be beside the scene.
    std::string find(const std::string& path) const {
        for (const std::string& folder : folders_)
            if (const std::string candidate = resolve(folder, path); exists(candidate)) return candidate;
        return resolve(folders_.back(), path);
    }

    Status report() {
        for (const auto& [id, use, parameter] : references_)
            if (const auto at = ids_.find(id); at != ids_.end()) request(at->second, use, parameter);
        for (std::size_t i = 0; i < requests_.size(); ++i) {
            const auto [texture, use, parameter] = requests_[i];
            MitsubaTexture& node = nodes_[texture];
            if (!node.uses.insert(use).second) continue;
            if (node.parameter.empty()) node.parameter = parameter;
            for (const std::size_t child : node.children) request(child, use, parameter);
            for (const std::string& id : node.parts)
                if (const auto at = ids_.find(id); at != ids_.end()) request(at->second, use, parameter);
        }
        for (MitsubaTexture& node : nodes_) {
            if (node.uses.empty()) node.uses.insert(SceneUse::unused);
            for (const SceneTexture& image : node.images)
                for (const SceneUse use : node.uses) {
                    SceneTexture t = image;
                    t.use = t.raw && use != SceneUse::unused ? SceneUse::data : use;
                    if (!node.parameter.empty()) t.parameter = node.parameter;
                    if (auto s = builder_.add(std::move(t), folders_.back()); !s) return s;
                }
        }
        return {};
    }

    struct Reference {
        std::string id;
        SceneUse use;
        std::string parameter;
    };
    struct Request {
        std::size_t texture;
        SceneUse use;
        std::string parameter;
    };

    Builder& builder_;
    std::vector<std::string> folders_;  ///< searched in this order; the scene's own is last
    std::map<std::string, std::string, std::less<>> variables_;
    std::map<std::string, std::size_t> ids_;
    std::vector<MitsubaTexture> nodes_;
    std::vector<Reference> references_;
    std::vector<Request> requests_;
};

}  // namespace

Status read_mitsuba(Builder& builder, const std::string& path) { return MitsubaReader(builder).read(path); }

}  // namespace spectex::scene
