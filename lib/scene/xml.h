// pugixml with places: lines, and the bytes of an attribute's value.
#pragma once

#include <pugixml.hpp>

#include "scene/internal.h"

namespace spectex::scene {

/// @error input, with the line; elements nested deeper than the limit are refused.
Status parse_xml(const Text& text, const SceneLimits& limits, pugi::xml_document& document);

inline std::size_t offset_of(const pugi::xml_node& node) {
    const auto at = node.offset_debug();
    return at > 0 ? static_cast<std::size_t>(at) : 0;
}

/// Bytes of the value of an attribute of the element at `node`, as they stand in the text; nothing when it has none.
struct Range {
    std::size_t begin = 0, end = 0;
};
std::optional<Range> attribute_range(const Text& text, const pugi::xml_node& node, std::string_view attribute);

}  // namespace spectex::scene
