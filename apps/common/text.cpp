#include "text.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <numeric>

#include "spectex/heatmap.h"

namespace spectex::app {

std::string escape(std::string_view text) { return printable(text); }

Error expected(std::string_view what, std::string_view got) {
    constexpr std::size_t longest = 120;
    std::string shown(got.substr(0, longest));
    if (got.size() > longest) shown += "...";
    return {ErrorKind::usage, fmt::format("expected {}, got '{}'", what, shown)};
}

std::string number_text(double value) {
    if (std::isnan(value)) return "nan";
    std::array<char, 64> buffer{};
    const auto end = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value).ptr;
    return {buffer.data(), end};
}

Result<double> parse_number(std::string_view text, double low, double high) {
    double value = 0;
    const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (code != std::errc{} || end != text.data() + text.size() || !std::isfinite(value) || value < low || value > high) {
        if (std::isinf(low) && std::isinf(high)) return expected("a number", text);
        if (std::isinf(high)) return expected(fmt::format("a number of at least {}", number_text(low)), text);
        if (std::isinf(low)) return expected(fmt::format("a number of at most {}", number_text(high)), text);
        return expected(fmt::format("a number in {}..{}", number_text(low), number_text(high)), text);
    }
    return value;
}

Result<std::int64_t> parse_integer(std::string_view text, std::int64_t low, std::int64_t high) {
    std::int64_t value = 0;
    const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (code != std::errc{} || end != text.data() + text.size() || value < low || value > high)
        return expected(fmt::format("an integer in {}..{}", low, high), text);
    return value;
}

Result<std::array<std::int64_t, 2>> parse_position(std::string_view text) {
    const auto comma = text.find(',');
    constexpr std::int64_t largest = std::int64_t{1} << 31;
    if (comma != std::string_view::npos) {
        const auto x = parse_integer(text.substr(0, comma), 0, largest);
        const auto y = parse_integer(text.substr(comma + 1), 0, largest);
        if (x && y) return std::array<std::int64_t, 2>{*x, *y};
    }
    return expected("X,Y as two integers from 0", text);
}

Result<std::array<double, 2>> parse_range(std::string_view text) {
    const auto colon = text.find(':');
    if (colon != std::string_view::npos) {
        const auto low = parse_number(text.substr(0, colon), -HUGE_VAL, HUGE_VAL);
        const auto high = parse_number(text.substr(colon + 1), -HUGE_VAL, HUGE_VAL);
        if (low && high && *low < *high) return std::array<double, 2>{*low, *high};
    }
    return expected("LO:HI with LO below HI", text);
}

Result<std::size_t> parse_choice(std::string_view text, std::span<const std::string_view> choices) {
    const auto found = std::find(choices.begin(), choices.end(), text);
    if (found == choices.end()) return expected(fmt::format("one of {}", fmt::join(choices, ", ")), text);
    return static_cast<std::size_t>(found - choices.begin());
}

Result<std::vector<std::string>> parse_list(std::string_view text) {
    std::vector<std::string> items;
    for (std::string_view rest = text;;) {
        const auto comma = rest.find(',');
        if (rest.substr(0, comma).empty()) return expected("a list separated by commas, without empty items", text);
        items.emplace_back(rest.substr(0, comma));
        if (comma == std::string_view::npos) return items;
        rest.remove_prefix(comma + 1);
    }
}

std::optional<std::string> nearest(std::string_view word, std::span<const std::string> candidates) {
    // The distance is quadratic in the word; no option is nearly so long as an argument may be.
    if (word.size() > 64) return std::nullopt;
    std::optional<std::string> best;
    std::size_t least = std::max<std::size_t>(2, word.size() / 3) + 1;
    for (const auto& candidate : candidates) {
        std::vector<std::size_t> row(candidate.size() + 1);
        std::iota(row.begin(), row.end(), std::size_t{0});
        for (std::size_t i = 1; i <= word.size(); ++i) {
            std::size_t diagonal = row[0];
            row[0] = i;
            for (std::size_t j = 1; j <= candidate.size(); ++j) {
                const std::size_t substituted = diagonal + (word[i - 1] != candidate[j - 1]);
                diagonal = row[j];
                row[j] = std::min({row[j] + 1, row[j - 1] + 1, substituted});
            }
        }
        std::size_t distance = row.back();
        // A prefix, as of --out for --output, is nearer than its length says.
        if (word.size() > 3 && candidate.starts_with(word)) distance = 1;
        if (distance < least) {
            least = distance;
            best = candidate;
        }
    }
    return best;
}

std::size_t columns(std::string_view text) {
    return static_cast<std::size_t>(
        std::count_if(text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xC0) != 0x80; }));
}

std::vector<std::string> wrap(std::string_view text, std::size_t width) {
    std::vector<std::string> lines;
    std::string line;
    while (!text.empty()) {
        const auto space = text.find(' ');
        const auto word = text.substr(0, space);
        if (!line.empty() && columns(line) + 1 + columns(word) > width) {
            lines.push_back(std::move(line));
            line.clear();
        }
        if (!word.empty()) {
            if (!line.empty()) line += ' ';
            line += word;
        }
        text.remove_prefix(space == std::string_view::npos ? text.size() : space + 1);
    }
    if (!line.empty() || lines.empty()) lines.push_back(std::move(line));
    return lines;
}

}  // namespace spectex::app
