// glTF 2.0 (ISO/IEC 12113), as JSON or in its binary container.
#include <cstring>
#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include "scene/internal.h"

namespace spectex::scene {
namespace {

using nlohmann::json;

/// RFC 3986 percent-decoding; what is malformed stays.
std::string decode_uri(std::string_view uri) {
    const auto digit = [](char c) {
        return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
    };
    std::string out;
    for (std::size_t i = 0; i < uri.size(); ++i) {
        if (uri[i] == '%' && i + 2 < uri.size() && digit(uri[i + 1]) >= 0 && digit(uri[i + 2]) >= 0) {
            out.push_back(static_cast<char>(digit(uri[i + 1]) * 16 + digit(uri[i + 2])));
            i += 2;
        } else {
            out.push_back(uri[i]);
        }
    }
    return out;
}

std::uint32_t le32(const char* p) {
    unsigned char b[4];
    std::memcpy(b, p, 4);
    return std::uint32_t{b[0]} | std::uint32_t{b[1]} << 8 | std::uint32_t{b[2]} << 16 | std::uint32_t{b[3]} << 24;
}

/// The JSON of a text: all of it, or the first chunk of a binary container.
Result<std::string_view> json_of(const Text& text) {
    const std::string_view s = text.content;
    if (!s.starts_with("glTF")) return s;
    const auto failed = [&](std::string_view what) { return Error{ErrorKind::input, fmt::format("{}: {}", text.path, what)}; };
    if (s.size() < 20) return failed("ends within the header of the binary container");
    if (le32(s.data() + 4) != 2) return failed(fmt::format("is a binary container of version {}: expected 2", le32(s.data() + 4)));
    const std::uint32_t length = le32(s.data() + 12);
    if (s.substr(16, 4) != "JSON") return failed("the first chunk of the binary container is not JSON");
    if (length > s.size() - 20) return failed(fmt::format("its JSON chunk has {} bytes and the file only {}", length, s.size()));
    return s.substr(20, length);
}

const json* member(const json& object, const std::string& name) {
    if (!object.is_object()) return nullptr;
    const auto at = object.find(name);
    return at == object.end() ? nullptr : &*at;
}

std::optional<std::size_t> index_in(const json& object, const std::string& name, std::size_t size) {
    const json* value = member(object, name);
    if (!value || !value->is_number_unsigned() || value->get<std::uint64_t>() >= size) return {};
    return static_cast<std::size_t>(value->get<std::uint64_t>());
}

struct Slot {
    const char *extension, *group, *name;
    SceneUse use;
};
// Core and Khronos extensions that put textures into materials.
constexpr Slot slots[] = {
    {nullptr, "pbrMetallicRoughness", "baseColorTexture", SceneUse::reflectance},
    {nullptr, "pbrMetallicRoughness", "metallicRoughnessTexture", SceneUse::data},
    {nullptr, nullptr, "normalTexture", SceneUse::data},
    {nullptr, nullptr, "occlusionTexture", SceneUse::data},
    {nullptr, nullptr, "emissiveTexture", SceneUse::emission},
    {"KHR_materials_pbrSpecularGlossiness", nullptr, "diffuseTexture", SceneUse::reflectance},
    {"KHR_materials_pbrSpecularGlossiness", nullptr, "specularGlossinessTexture", SceneUse::reflectance},
    {"KHR_materials_specular", nullptr, "specularTexture", SceneUse::data},
    {"KHR_materials_specular", nullptr, "specularColorTexture", SceneUse::reflectance},
    {"KHR_materials_sheen", nullptr, "sheenColorTexture", SceneUse::reflectance},
    {"KHR_materials_sheen", nullptr, "sheenRoughnessTexture", SceneUse::data},
    {"KHR_materials_clearcoat", nullptr, "clearcoatTexture", SceneUse::data},
    {"KHR_materials_clearcoat", nullptr, "clearcoatRoughnessTexture", SceneUse::data},
    {"KHR_materials_clearcoat", nullptr, "clearcoatNormalTexture", SceneUse::data},
    {"KHR_materials_transmission", nullptr, "transmissionTexture", SceneUse::data},
    {"KHR_materials_diffuse_transmission", nullptr, "diffuseTransmissionTexture", SceneUse::data},
    {"KHR_materials_diffuse_transmission", nullptr, "diffuseTransmissionColorTexture", SceneUse::reflectance},
    {"KHR_materials_volume", nullptr, "thicknessTexture", SceneUse::data},
    {"KHR_materials_iridescence", nullptr, "iridescenceTexture", SceneUse::data},
    {"KHR_materials_iridescence", nullptr, "iridescenceThicknessTexture", SceneUse::data},
    {"KHR_materials_anisotropy", nullptr, "anisotropyTexture", SceneUse::data},
};

}  // namespace

Status read_gltf(Builder& builder, const std::string& path) {
    if (auto s = builder.enter(path, nullptr, 0); !s) return s;
    auto text = builder.load(path);
    if (!text) return text.error();
    const auto chunk = json_of(*text);
    if (!chunk) return chunk.error();
    // Brackets within brackets cost the parser's memory; no glTF needs many.
    int depth = 0;
    bool quoted = false;
    for (std::size_t i = 0; i < chunk->size(); ++i) {
        const char c = (*chunk)[i];
        if (quoted) {
            if (c == '\\') ++i;
            else if (c == '"') quoted = false;
        } else if (c == '"') quoted = true;
        else if (c == '{' || c == '[') {
            if (++depth > builder.limits().max_depth) return text->error(i, fmt::format("JSON is nested deeper than {}", builder.limits().max_depth));
        } else if (c == '}' || c == ']') --depth;
    }
    json document;
    try {
        document = json::parse(*chunk);
    } catch (const json::parse_error& e) {
        return text->error(e.byte, "is no well-formed JSON");
    }
    static const json none = json::array();
    const auto list = [&](const char* name) -> const json& {
        const json* found = member(document, name);
        return found && found->is_array() ? *found : none;
    };
    const json &images = list("images"), &textures = list("textures"), &materials = list("materials");
    if (!document.is_object() || !member(document, "asset")) return text->error(0, "is no glTF: it has no asset");

    std::vector<std::map<SceneUse, std::string>> uses(images.size());
    const auto use_texture = [&](const json& slot, SceneUse use, const std::string& parameter) {
        const auto texture = index_in(slot, "index", textures.size());
        if (!texture) return;
        const json& t = textures[*texture];
        if (const auto image = index_in(t, "source", images.size())) uses[*image].emplace(use, parameter);
        if (const json* extensions = member(t, "extensions"); extensions && extensions->is_object())
            for (const auto& [name, extension] : extensions->items())
                if (const auto image = index_in(extension, "source", images.size())) uses[*image].emplace(use, parameter);
    };
    for (const json& material : materials)
        for (const Slot& slot : slots) {
            const json* at = &material;
            if (slot.extension) {
                at = member(material, "extensions");
                if (at) at = member(*at, slot.extension);
            } else if (slot.group) {
                at = member(material, slot.group);
            }
            if (at) at = member(*at, slot.name);
            if (at) use_texture(*at, slot.use, slot.name);
        }
    for (std::size_t i = 0; i < images.size(); ++i) {
        SceneTexture t;
        t.file = path;
        t.where = fmt::format("/images/{}", i);
        const json* uri = member(images[i], "uri");
        if (uri && uri->is_string() && !uri->get_ref<const std::string&>().starts_with("data:")) {
            t.written = decode_uri(uri->get_ref<const std::string&>());
            t.where += "/uri";
            if (t.written.find("://") != std::string::npos) {
                builder.warn(*text, 0, fmt::format("{} is on a network and not read", t.written));
                continue;
            }
        } else {
            t.embedded = true;
            const json* name = member(images[i], "name");
            t.written = name && name->is_string() ? name->get<std::string>() : fmt::format("image {}", i);
        }
        if (uses[i].empty()) uses[i].emplace(SceneUse::unused, "");
        if (t.embedded && uses[i].contains(SceneUse::reflectance))
            builder.warn(*text, 0, fmt::format("{} ({}) is embedded and not converted", t.written, t.where));
        for (const auto& [use, parameter] : uses[i]) {
            SceneTexture one = t;
            one.use = use;
            one.parameter = parameter;
            if (auto s = builder.add(std::move(one), folder_of(path)); !s) return s;
        }
    }
    builder.leave();
    return {};
}

}  // namespace spectex::scene
