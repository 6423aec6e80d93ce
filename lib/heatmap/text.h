// Text of the heatmap room: what reaches Cairo and XML is valid UTF-8 of bounded length.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "spectex/heatmap.h"

namespace spectex::heatmap {

/// Valid UTF-8 in which each malformed byte and each code point that XML 1.0 excludes is U+FFFD, and each control
/// character a space.
std::string clean_utf8(std::string_view text);

/// At most `characters` code points of clean text; what is longer ends in an ellipsis.
std::string elide(std::string_view clean, std::size_t characters);

/// Clean text with & < > " ' as entities.
std::string escape_xml(std::string_view clean);

/// A piece of text that is set normally or as a subscript.
struct Run {
    std::string text;
    bool subscript = false;
};
/// CIE's "E*ab" split so that "ab" is a subscript (Unicode has no subscript b), and subscript digits as digits, so that both
/// kinds look alike.
std::vector<Run> split_runs(std::string_view clean);

constexpr double subscript_scale = 0.7;
constexpr double subscript_drop = 0.2;  ///< of the text size, downwards

/// A signed whole number in Unicode superscripts.
std::string superscript(int value);

/// #rrggbb
std::string hex(const Rgb8& color);

constexpr const char* font_family = "DejaVu Sans";

}  // namespace spectex::heatmap
