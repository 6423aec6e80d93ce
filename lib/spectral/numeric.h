// Small numeric helpers shared by the rooms: compensated sums, locale-free number parsing.
#pragma once

#include <charconv>
#include <cmath>
#include <optional>
#include <string_view>

namespace spectex {

/// Neumaier 1974: a sum whose error does not grow with the number of terms.
class CompensatedSum {
public:
    void add(double value) {
        const double t = sum_ + value;
        if (std::fabs(sum_) >= std::fabs(value))
            compensation_ += (sum_ - t) + value;
        else
            compensation_ += (value - t) + sum_;
        sum_ = t;
    }
    double value() const { return sum_ + compensation_; }

private:
    double sum_ = 0, compensation_ = 0;
};

inline std::string_view trimmed(std::string_view text) {
    constexpr std::string_view blanks = " \t\r\n\f\v";
    const auto first = text.find_first_not_of(blanks);
    if (first == std::string_view::npos) return {};
    return text.substr(first, text.find_last_not_of(blanks) - first + 1);
}

/// A whole, finite number in the C locale's spelling; a leading plus is allowed.
inline std::optional<double> parse_number(std::string_view text) {
    text = trimmed(text);
    if (!text.empty() && text.front() == '+') text.remove_prefix(1);
    if (text.empty()) return std::nullopt;
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
    return value;
}

}  // namespace spectex
