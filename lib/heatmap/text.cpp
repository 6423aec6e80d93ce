#include "heatmap/text.h"

#include <fmt/format.h>

#include <array>
#include <cstdint>

#include "spectex/heatmap.h"

namespace spectex::heatmap {
namespace {

constexpr std::string_view replacement = "\xEF\xBF\xBD";
constexpr std::string_view ellipsis = "\xE2\x80\xA6";

bool is_continuation(char c) { return (static_cast<unsigned char>(c) & 0xC0u) == 0x80u; }

/// Bytes of the well-formed sequence at the front (Unicode 15, table 3-7), or 0.
std::size_t sequence_length(std::string_view s, std::uint32_t& code) {
    const auto lead = static_cast<unsigned char>(s[0]);
    std::size_t n = 0;
    if (lead < 0x80) {
        code = lead;
        return 1;
    }
    if (lead >= 0xC2 && lead <= 0xDF) {
        n = 2;
        code = lead & 0x1Fu;
    } else if (lead >= 0xE0 && lead <= 0xEF) {
        n = 3;
        code = lead & 0x0Fu;
    } else if (lead >= 0xF0 && lead <= 0xF4) {
        n = 4;
        code = lead & 0x07u;
    }
    if (n == 0 || s.size() < n) return 0;
    for (std::size_t i = 1; i < n; ++i) {
        if (!is_continuation(s[i])) return 0;
        code = (code << 6) | (static_cast<unsigned char>(s[i]) & 0x3Fu);
    }
    constexpr std::array<std::uint32_t, 5> smallest{0, 0, 0x80, 0x800, 0x10000};
    if (code < smallest[n] || code > 0x10FFFF || (code >= 0xD800 && code <= 0xDFFF)) return 0;
    return n;
}

}  // namespace

std::string clean_utf8(std::string_view text) {
    std::string out;
    out.reserve(text.size());
    while (!text.empty()) {
        std::uint32_t code = 0;
        const std::size_t n = sequence_length(text, code);
        if (n == 0 || code == 0xFFFE || code == 0xFFFF)
            out += replacement;
        else if (code < 0x20 || (code >= 0x7F && code < 0xA0) || code == 0x2028 || code == 0x2029)
            out += ' ';
        else
            out += text.substr(0, n);
        text.remove_prefix(n == 0 ? 1 : n);
    }
    return out;
}

std::string elide(std::string_view clean, std::size_t characters) {
    std::size_t count = 0, cut = 0;
    for (std::size_t i = 0; i < clean.size(); ++i) {
        if (is_continuation(clean[i])) continue;
        if (count + 1 == characters) cut = i;
        if (++count > characters) return std::string(clean.substr(0, cut)) + std::string(ellipsis);
    }
    return std::string(clean);
}

std::string escape_xml(std::string_view clean) {
    std::string out;
    out.reserve(clean.size());
    for (const char c : clean) switch (c) {
            case '&': out += "&amp;"; break;
            case '<': out += "&lt;"; break;
            case '>': out += "&gt;"; break;
            case '"': out += "&quot;"; break;
            case '\'': out += "&apos;"; break;
            default: out += c;
        }
    return out;
}

std::vector<Run> split_runs(std::string_view clean) {
    constexpr std::string_view notation = "E*ab", subscript_digit = "\xE2\x82";  // then 0x80 to 0x89
    std::vector<Run> runs;
    const auto append = [&](std::string_view piece, bool subscript) {
        if (runs.empty() || runs.back().subscript != subscript) runs.push_back({{}, subscript});
        runs.back().text += piece;
    };
    while (!clean.empty()) {
        std::size_t used = 1;
        if (clean.starts_with(notation)) {
            append(clean.substr(0, 2), false);
            append(clean.substr(2, 2), true);
            used = notation.size();
        } else if (clean.starts_with(subscript_digit) && static_cast<unsigned char>(clean[2]) <= 0x89) {
            const char digit = static_cast<char>('0' + (static_cast<unsigned char>(clean[2]) - 0x80));
            append({&digit, 1}, true);
            used = 3;
        } else {
            append(clean.substr(0, 1), false);
        }
        clean.remove_prefix(used);
    }
    return runs;
}

std::string superscript(int value) {
    constexpr std::array<const char*, 10> digits{"⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"};
    std::string out;
    for (const char c : std::to_string(value)) out += c == '-' ? "⁻" : digits[static_cast<std::size_t>(c - '0')];
    return out;
}

std::string hex(const Rgb8& color) { return fmt::format("#{:02x}{:02x}{:02x}", color[0], color[1], color[2]); }

}  // namespace spectex::heatmap

namespace spectex {

std::string printable(std::string_view text) {
    std::string out;
    out.reserve(text.size());
    while (!text.empty()) {
        std::uint32_t code = 0;
        const std::size_t n = heatmap::sequence_length(text, code);
        const std::size_t length = n == 0 ? 1 : n;
        // U+0080..U+009F are control characters too: some terminals obey them.
        if (n == 0 || code < 0x20 || (code >= 0x7F && code < 0xA0)) {
            if (n != 0 && code == '\n') out += "\\n";
            else if (n != 0 && code == '\t') out += "\\t";
            else if (n != 0 && code == '\r') out += "\\r";
            else
                for (const char c : text.substr(0, length)) out += fmt::format("\\x{:02x}", static_cast<unsigned char>(c));
        } else {
            out.append(text.substr(0, n));
        }
        text.remove_prefix(length);
    }
    return out;
}

}  // namespace spectex
