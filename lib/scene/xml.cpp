#include "scene/xml.h"

namespace spectex::scene {

Status parse_xml(const Text& text, const SceneLimits& limits, pugi::xml_document& document) {
    // UTF-8 only: offsets then are those of the file.
    const auto parsed = document.load_buffer(text.content.data(), text.content.size(), pugi::parse_default, pugi::encoding_utf8);
    if (!parsed) return text.error(static_cast<std::size_t>(parsed.offset), fmt::format("is no well-formed XML: {}", parsed.description()));
    int depth = 0;
    for (pugi::xml_node node = document.first_child(); node;) {
        if (const auto child = node.first_child()) {
            if (++depth > limits.max_depth) return text.error(offset_of(node), fmt::format("elements are nested deeper than {}", limits.max_depth));
            node = child;
            continue;
        }
        while (node && !node.next_sibling()) node = node.parent(), --depth;
        if (node) node = node.next_sibling();
    }
    return {};
}

std::optional<Range> attribute_range(const Text& text, const pugi::xml_node& node, std::string_view attribute) {
    const std::string_view s = text.content;
    std::size_t at = offset_of(node) + std::string_view(node.name()).size();
    const auto is_space = [](char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; };
    while (at < s.size() && s[at] != '>' && s[at] != '/') {
        while (at < s.size() && is_space(s[at])) ++at;
        const std::size_t name = at;
        while (at < s.size() && s[at] != '=' && s[at] != '>' && s[at] != '/' && !is_space(s[at])) ++at;
        const std::string_view found = s.substr(name, at - name);
        while (at < s.size() && is_space(s[at])) ++at;
        if (at >= s.size() || s[at] != '=') return {};
        ++at;
        while (at < s.size() && is_space(s[at])) ++at;
        if (at >= s.size() || (s[at] != '"' && s[at] != '\'')) return {};
        const std::size_t end = s.find(s[at], at + 1);
        if (end == std::string_view::npos) return {};
        if (found == attribute) return Range{at + 1, end};
        at = end + 1;
    }
    return {};
}

}  // namespace spectex::scene
