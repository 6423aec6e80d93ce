// Names of spectral channels. Layout: Fichet, Pacanowski and Wilkie 2021, "An OpenEXR layout for spectral images", JCGT 10(3),
// section 3; more spellings are accepted than it has, since writers differ.
#include <charconv>
#include <cmath>

#include "io/internal.h"

namespace spectex {
namespace {

constexpr double speed_of_light_m_per_s = 299792458.0;  // SI, exact
constexpr std::string_view stems[] = {"T", "S0", "S1", "S2", "S3"};

struct Prefix {
    std::string_view text;
    int power;
};
// Longer texts first: "da" would otherwise be taken for "d". The micro sign has two code points.
constexpr Prefix prefixes[] = {{"da", 1}, {"\xc2\xb5", -6}, {"\xce\xbc", -6}, {"Y", 24}, {"Z", 21}, {"E", 18}, {"P", 15},
                               {"T", 12}, {"G", 9},  {"M", 6},  {"k", 3},   {"h", 2},   {"d", -1},  {"c", -2},
                               {"m", -3}, {"u", -6}, {"n", -9}, {"p", -12}, {"", 0}};

bool is_digit(char c) { return c >= '0' && c <= '9'; }

// The number and unit after the stem, in nm. The power of ten is added to the exponent in text, so that 400e-9m is 400 exactly.
std::optional<double> parse_quantity(std::string_view text) {
    std::string digits;
    std::size_t i = 0;
    bool any = false, separator = false;
    for (; i < text.size(); ++i) {
        if (is_digit(text[i])) {
            digits += text[i];
            any = true;
        } else if ((text[i] == ',' || text[i] == '.') && !separator) {
            digits += '.';
            separator = true;
        } else {
            break;
        }
    }
    if (!any) return std::nullopt;
    int exponent = 0;
    if (i + 1 < text.size() && (text[i] == 'e' || text[i] == 'E')) {
        std::size_t k = i + 1;
        const bool negative = text[k] == '-';
        if (text[k] == '+' || text[k] == '-') ++k;
        // Without digits the letter is the prefix exa.
        if (k < text.size() && is_digit(text[k])) {
            for (; k < text.size() && is_digit(text[k]); ++k)
                if (exponent < 100000) exponent = exponent * 10 + (text[k] - '0');
            if (negative) exponent = -exponent;
            i = k;
        }
    }
    const std::string_view unit = text.substr(i);
    for (const Prefix& p : prefixes) {
        if (!unit.starts_with(p.text)) continue;
        const std::string_view base = unit.substr(p.text.size());
        const bool metre = base == "m", hertz = base == "Hz" || base == "hz";
        if (!metre && !hertz) continue;
        const std::string number = fmt::format("{}e{}", digits, exponent + p.power + (metre ? 9 : 0));
        double value = 0;
        const auto [end, code] = std::from_chars(number.data(), number.data() + number.size(), value);
        if (code != std::errc() || end != number.data() + number.size()) return std::nullopt;
        if (hertz) value = speed_of_light_m_per_s / value * 1e9;
        if (!std::isfinite(value) || value <= 0) return std::nullopt;
        return value;
    }
    return std::nullopt;
}

}  // namespace

std::string spectral_channel_name(std::string_view prefix, double wavelength_nm) {
    std::string number = fmt::format("{:.6f}", wavelength_nm);
    if (const auto dot = number.find('.'); dot != std::string::npos) number[dot] = ',';
    return fmt::format("{}.{}nm", prefix, number);
}

std::optional<SpectralChannelName> parse_spectral_channel_name(std::string_view name) {
    for (std::size_t at = 0; at < name.size();) {
        for (std::string_view stem : stems) {
            const std::string_view rest = name.substr(at);
            if (!rest.starts_with(stem) || rest.size() <= stem.size() || rest[stem.size()] != '.') continue;
            if (const auto nm = parse_quantity(rest.substr(stem.size() + 1)))
                return SpectralChannelName{std::string(at == 0 ? "" : name.substr(0, at - 1)), std::string(stem), *nm};
        }
        const auto dot = name.find('.', at);
        if (dot == std::string_view::npos) break;
        at = dot + 1;
    }
    return std::nullopt;
}

}  // namespace spectex
