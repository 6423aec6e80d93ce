// MaterialX 1.38 documents: image nodes, and what their graphs lead to.
#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <set>

#include "scene/xml.h"

namespace spectex::scene {
namespace {

bool ends_a_graph(std::string_view type) {
    return type == "surfaceshader" || type == "BSDF" || type == "EDF" || type == "VDF" || type == "displacementshader" || type == "volumeshader" ||
           type == "lightshader";
}

bool is_color_type(std::string_view type) { return type == "color3" || type == "color4"; }

/// A shader's input by its name and type: standard_surface, gltf_pbr, UsdPreviewSurface, OpenPBR, and BSDF nodes.
SceneUse use_of_input(std::string_view node, std::string_view input, std::string_view type) {
    const std::string name = lower(input);
    if (!is_color_type(type)) return SceneUse::data;
    if (name.starts_with("emission") || name.starts_with("emissive") || node.ends_with("_edf")) return SceneUse::emission;
    static constexpr std::array<std::string_view, 5> scalars{"opacity", "radius", "roughness", "scatter", "ior"};
    for (const auto word : scalars)
        if (name.find(word) != std::string::npos) return SceneUse::data;
    return name.find("color") != std::string::npos || name == "reflectance" || name == "tint" || name == "albedo" ? SceneUse::reflectance : SceneUse::data;
}

struct Place {
    std::size_t text;  ///< index into texts
    pugi::xml_node node;
    std::string scope;  ///< name of the node graph, or empty
};

class MaterialXReader {
public:
    explicit MaterialXReader(Builder& builder) : builder_(builder) {}

    Status read(const std::string& path) {
        if (auto s = read_file(path, nullptr, 0); !s) return s;
        return report();
    }

private:
    Status read_file(const std::string& path, const Text* from, std::size_t offset) {
        if (auto s = builder_.enter(path, from, offset); !s) return s;
        auto loaded = builder_.load(path);
        if (!loaded) return loaded.error();
        texts_.push_back(std::make_unique<Text>(std::move(*loaded)));
        documents_.push_back(std::make_unique<pugi::xml_document>());
        const std::size_t number = texts_.size() - 1;
        const Text& text = *texts_[number];
        if (auto s = parse_xml(text, builder_.limits(), *documents_[number]); !s) return s;
        const auto root = documents_[number]->child("materialx");
        if (!root) return text.error(0, "has no <materialx> element");
        for (const pugi::xml_node child : root.children()) {
            const std::string_view name = child.name();
            if (name == "xi:include") {
                if (auto s = include(text, child); !s) return s;
            } else if (name == "nodegraph") {
                const std::string graph = child.attribute("name").value();
                for (const pugi::xml_node inner : child.children()) register_node(number, inner, graph);
            } else {
                register_node(number, child, "");
            }
        }
        builder_.leave();
        return {};
    }

    Status include(const Text& text, const pugi::xml_node& node) {
        const std::string path = resolve(folder_of(text.path), node.attribute("href").value());
        if (!exists(path)) return text.error(offset_of(node), fmt::format("there is no file {}", path));
        if (const auto range = attribute_range(text, node, "href")) builder_.add_include(text, range->begin, range->end);
        return read_file(path, &text, offset_of(node));
    }

    void register_node(std::size_t text, const pugi::xml_node& node, const std::string& scope) {
        if (node.type() != pugi::node_element) return;
        nodes_.emplace(scope + "/" + node.attribute("name").value(), places_.size());
        places_.push_back({text, node, scope});
    }

    const Place* find(const std::string& scope, const char* name) const {
        const auto at = nodes_.find(scope + "/" + name);
        return at == nodes_.end() ? nullptr : &places_[at->second];
    }

    /// The node that an input is fed by, in its own scope, through a node graph's output, or through the graph's own input.
    const Place* source(const Place& place, const pugi::xml_node& input) const {
        if (const auto graph = input.attribute("nodegraph")) {
            const char* output = input.attribute("output").value();
            const Place* found = *output ? find(graph.value(), output) : find(graph.value(), "out");
            return found && std::string_view(found->node.name()) == "output" ? source(*found, found->node) : found;
        }
        if (const auto name = input.attribute("nodename")) return find(place.scope, name.value());
        if (const auto name = input.attribute("interfacename")) return find(place.scope, name.value());
        if (const auto output = input.attribute("output")) {
            const Place* found = find(place.scope, output.value());
            return found && found->node != place.node && std::string_view(found->node.name()) == "output" ? find(found->scope, found->node.attribute("nodename").value()) : nullptr;
        }
        return nullptr;
    }

    /// The nearest attribute of the element or of those that hold it.
    static std::string inherited(pugi::xml_node node, const char* attribute) {
        for (; node; node = node.parent())
            if (const auto a = node.attribute(attribute)) return a.value();
        return {};
    }

    Status report() {
        for (std::size_t i = 0; i < places_.size(); ++i) {
            const Place& place = places_[i];
            const std::string_view type = place.node.attribute("type").value();
            if (!ends_a_graph(type)) continue;
            for (const pugi::xml_node input : place.node.children("input")) {
                const std::string_view input_type = input.attribute("type").value();
                if (ends_a_graph(input_type)) continue;
                if (const Place* from = source(place, input))
                    follow(*from, use_of_input(place.node.name(), input.attribute("name").value(), input_type),
                           std::string(place.node.name()) + "." + input.attribute("name").value());
            }
        }
        for (std::size_t i = 0; i < places_.size(); ++i)
            if (auto s = images(i); !s) return s;
        return {};
    }

    void follow(const Place& start, SceneUse use, const std::string& parameter) {
        std::vector<std::pair<const Place*, SceneUse>> open{{&start, use}};
        while (!open.empty()) {
            const auto [place, what] = open.back();
            open.pop_back();
            const auto index = static_cast<std::size_t>(place - places_.data());
            if (!uses_[index].emplace(what, parameter).second) continue;
            const std::string_view kind = place->node.name();
            for (const pugi::xml_node input : place->node.children("input")) {
                const Place* from = source(*place, input);
                if (!from) continue;
                // A scalar within a colour's graph is a weight, unless it becomes the colour by conversion.
                const bool colored = is_color_type(input.attribute("type").value()) || kind == "convert" || kind == "swizzle";
                open.push_back({from, colored ? what : SceneUse::data});
            }
        }
    }

    Status images(std::size_t index) {
        const Place& place = places_[index];
        const Text& text = *texts_[place.text];
        for (const pugi::xml_node input : place.node.children("input")) {
            if (std::string_view(input.attribute("type").value()) != "filename" || !input.attribute("value")) continue;
            SceneTexture t;
            const std::string prefix = inherited(input, "fileprefix");
            t.written = prefix + input.attribute("value").value();
            t.file = text.path;
            t.where = text.where(offset_of(input));
            t.parameter = std::string(place.node.name()) + "." + input.attribute("name").value();
            const std::string space = inherited(input, "colorspace");
            t.raw = space == "raw" || space == "none" || space == "data";
            if (const auto range = attribute_range(text, input, "value")) {
                SceneToken token;
                token.file = text.file;
                token.begin = range->begin;
                token.end = range->end;
                token.prefix = prefix;
                t.token = builder_.add_token(token);
                // What was encoded becomes linear Rec.709, and the document must say so.
                SceneToken mark;
                mark.kind = SceneToken::Kind::colorspace;
                mark.file = text.file;
                mark.target = t.token;
                if (const auto own = attribute_range(text, input, "colorspace")) mark.begin = own->begin, mark.end = own->end;
                else mark.begin = mark.end = range->end + 1;
                builder_.add_token(mark);
            }
            const bool colored = is_color_type(place.node.attribute("type").value());
            auto uses = uses_[index];
            if (uses.empty()) uses.emplace(SceneUse::unused, t.parameter);
            for (const auto& [use, parameter] : uses) {
                SceneTexture one = t;
                one.use = use != SceneUse::unused && (one.raw || !colored) ? SceneUse::data : use;
                one.parameter = parameter;
                if (auto s = builder_.add(std::move(one), folder_of(text.path)); !s) return s;
            }
        }
        return {};
    }

    Builder& builder_;
    std::vector<std::unique_ptr<Text>> texts_;
    std::vector<std::unique_ptr<pugi::xml_document>> documents_;
    std::vector<Place> places_;
    std::map<std::string, std::size_t> nodes_;
    std::map<std::size_t, std::map<SceneUse, std::string>> uses_;
};

}  // namespace

Status read_materialx(Builder& builder, const std::string& path) { return MaterialXReader(builder).read(path); }

}  // namespace spectex::scene
