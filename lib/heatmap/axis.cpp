// Ranges, ticks and their labels.
#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "heatmap/text.h"
#include "spectex/heatmap.h"

namespace spectex {
namespace {

/// The double nearest to mantissa x 10^exponent. Multiplying by a power of ten would leave noise in the last digit.
double decimal(long long mantissa, int exponent) {
    const std::string text = fmt::format("{}e{}", mantissa, exponent);
    double value = 0;
    std::from_chars(text.data(), text.data() + text.size(), value);
    return value;
}

/// Power of ten of the leading digit.
int decade(double value) { return static_cast<int>(std::floor(std::log10(value))); }

/// The shortest decimal that reads back as the value, taken apart: d.ddd and the power of ten.
struct Scientific {
    std::string digits;
    int exponent = 0;
    int decimals = 0;  ///< digits after the point
};
Scientific scientific(double value) {
    std::array<char, 40> buffer{};
    const auto end = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value, std::chars_format::scientific).ptr;
    const std::string text(buffer.data(), end);
    const std::size_t e = text.find('e'), point = text.find('.');
    return {text.substr(0, e), std::atoi(text.c_str() + e + 1),
            point == std::string::npos ? 0 : static_cast<int>(e - point - 1)};
}

}  // namespace

double round_up_range(double value) {
    constexpr double least = 1e-6, greatest = 1.5e308;
    if (!(value > least)) return least;
    if (value >= greatest) return greatest;
    // One decade earlier than the estimate, in case log10 rounded up over a power of ten.
    for (int k = decade(value) - 1;; ++k)
        for (const int m : {10, 15, 20, 25, 30, 40, 50, 60, 80})
            if (const double candidate = decimal(m, k - 1); candidate >= value) return candidate;
}

std::vector<double> ticks(double low, double high) {
    constexpr double limit = 1e300, closest = 1e-12;
    if (!(std::abs(low) <= limit) || !(std::abs(high) <= limit) || !(low < high)) return {};
    const double span = high - low;
    if (span < closest * std::max(std::abs(low), std::abs(high)) || span < 1 / limit) return {};

    std::vector<double> best;
    double best_cost = std::numeric_limits<double>::infinity();
    for (int k = decade(span) - 2; k <= decade(span) + 1; ++k)
        for (const int m : {10, 20, 25, 50}) {
            const double step = decimal(m, k - 1);
            if (span / step > 9 || span / step < 2) continue;
            const auto first = static_cast<long long>(std::floor(low / step)) - 1;
            const auto last = static_cast<long long>(std::ceil(high / step)) + 1;
            std::vector<double> candidate;
            for (long long i = first; i <= last; ++i)
                if (const double t = decimal(i * m, k - 1); t >= low && t <= high) candidate.push_back(t);
            if (candidate.size() < 4 || candidate.size() > 8) continue;
            // Ticks on both ends tell the range without arithmetic, which outweighs an even count near six; quarters are
            // the harder numbers to read.
            const double cost = std::abs(static_cast<double>(candidate.size()) - 6.25) + (m == 25 ? 1.5 : 0) +
                                (candidate.front() == low ? 0 : 2) + (candidate.back() == high ? 0 : 2);
            if (cost < best_cost) {
                best_cost = cost;
                best = std::move(candidate);
            }
        }
    return best;
}

TickLabels tick_labels(std::span<const double> positions) {
    TickLabels labels;
    if (positions.empty()) return labels;
    double largest = 0;
    for (const double t : positions) largest = std::max(largest, std::abs(t));
    // Decimals that tell each tick apart are those that its shortest form needs.
    const auto decimals_at = [&](int exponent) {
        int decimals = 0;
        for (const double t : positions) {
            const Scientific s = scientific(t);
            if (t != 0) decimals = std::max(decimals, s.decimals - s.exponent + exponent);
        }
        return decimals;
    };
    if (largest > 0 && (largest >= 1e5 || decimals_at(0) > 4)) labels.exponent = decade(largest * (1 + 1e-12));
    const int decimals = std::max(0, decimals_at(labels.exponent));
    for (const double t : positions) {
        // The shift of the point is done on the decimal form: t / 10^exponent would round.
        double scaled = t;
        if (labels.exponent != 0) {
            const Scientific s = scientific(t);
            const std::string shifted = fmt::format("{}e{}", s.digits, s.exponent - labels.exponent);
            std::from_chars(shifted.data(), shifted.data() + shifted.size(), scaled);
        }
        std::string text = fmt::format("{:.{}f}", scaled == 0 ? 0.0 : std::abs(scaled), decimals);
        labels.text.push_back(t < 0 ? "\u2212" + text : text);
    }
    if (labels.exponent != 0) labels.multiplier = "×10" + heatmap::superscript(labels.exponent);
    return labels;
}

}  // namespace spectex
