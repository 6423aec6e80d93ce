// Text of the command line: numbers in, messages out. Nothing here depends on the locale.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"

namespace spectex::app {

/// Text made safe for a terminal: control characters and bytes that are not UTF-8 become \n, \t, \xNN.
std::string escape(std::string_view text);

/// A usage error "expected EXPECTED, got 'TEXT'".
Error expected(std::string_view what, std::string_view got);

/// A finite decimal number, the whole text. @error usage outside [low, high], both inclusive.
Result<double> parse_number(std::string_view text, double low, double high);
/// A decimal integer, the whole text. @error usage outside [low, high].
Result<std::int64_t> parse_integer(std::string_view text, std::int64_t low, std::int64_t high);
/// Two integers `X,Y`, each >= 0. @error usage.
Result<std::array<std::int64_t, 2>> parse_position(std::string_view text);
/// `LO:HI`, finite, LO < HI. @error usage.
Result<std::array<double, 2>> parse_range(std::string_view text);
/// Index of the text in the list. @error usage, listing the choices.
Result<std::size_t> parse_choice(std::string_view text, std::span<const std::string_view> choices);
/// Items between commas. @error usage, when one is empty.
Result<std::vector<std::string>> parse_list(std::string_view text);

/// Shortest decimal text that reads back as the same double; `nan`, `inf`, `-inf`.
std::string number_text(double value);

/// The candidate with the least edit distance, when it is near enough to be a slip of the hand.
std::optional<std::string> nearest(std::string_view word, std::span<const std::string> candidates);

/// Columns on a terminal, counting one for each code point.
std::size_t columns(std::string_view text);
/// Breaks text at spaces into lines of at most `width` columns (a longer word stays whole).
std::vector<std::string> wrap(std::string_view text, std::size_t width);

}  // namespace spectex::app
