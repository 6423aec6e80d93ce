#include "spectral/lamp_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <optional>
#include <pugixml.hpp>

#include "spectral/names.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

/// What anyone sees, in nm.
constexpr double visible_low = 360, visible_high = 830;

Error wrong(std::string_view label, std::size_t line, std::string_view why) {
    return {ErrorKind::input, line > 0 ? fmt::format("{}: line {}: {}", label, line, why) : fmt::format("{}: {}", label, why)};
}

/// A field as a message shows it.
std::string shown(std::string_view field) { return std::string(field.substr(0, 40)); }

struct Unit {
    const char* name;
    double nm;
};
constexpr Unit nanometres{"nm", 1}, micrometres{"µm", 1e3}, metres{"m", 1e9}, angstroms{"Å", 0.1};

/// Rows of a lamp's file, each checked as it comes.
class Rows {
public:
    explicit Rows(std::string_view label) : label_(label) {}

    std::size_t size() const { return wavelengths_.size(); }

    Status add(std::size_t line, std::string_view wavelength, std::string_view power) {
        const auto nm = parse_number(wavelength);
        if (!nm || *nm <= 0) return wrong(label_, line, fmt::format("'{}' is no wavelength", shown(wavelength)));
        return add(line, *nm, power);
    }
    Status add(std::size_t line, double wavelength, std::string_view power) {
        const auto value = parse_number(power);
        if (!value) return wrong(label_, line, fmt::format("'{}' is no finite power", shown(power)));
        if (*value < 0) return wrong(label_, line, fmt::format("power {} is negative", *value));
        if (!wavelengths_.empty() && wavelength <= wavelengths_.back())
            return wrong(label_, line,
                         fmt::format("wavelength {} does not lie above {}: expected ascending, none twice", wavelength,
                                     wavelengths_.back()));
        // Nothing that radiates visibly is tabulated beyond 0.1 mm; in any unit the number is smaller.
        if (wavelength > 1e6) return wrong(label_, line, fmt::format("wavelength {} is too long: expected nanometres", wavelength));
        if (wavelengths_.size() == most_lamp_rows) return wrong(label_, line, fmt::format("more than {} rows", most_lamp_rows));
        if (wavelengths_.empty()) first_line_ = line;
        wavelengths_.push_back(wavelength);
        powers_.push_back(*value);
        return {};
    }

    /// The whole. Numbers that would only make sense in another unit are refused, not guessed at.
    Result<LampFile> finish(std::string format, const Unit& unit = nanometres) && {
        if (wavelengths_.size() < 2)
            return wrong(label_, 0, fmt::format("{} rows of numbers, expected at least two", wavelengths_.size()));
        const double first = wavelengths_.front(), last = wavelengths_.back();
        const auto visible = [&](const Unit& u) { return last * u.nm >= visible_low && first * u.nm <= visible_high; };
        if (!visible(unit)) {
            std::string hint;
            for (const Unit* u : {&micrometres, &metres, &angstroms})
                if (hint.empty() && visible(*u)) hint = fmt::format(", as they would in {}", u->name);
            return wrong(label_, first_line_,
                         fmt::format("wavelengths {} to {} {} do not meet the visible range, {} to {} nm{}: expected nanometres",
                                     first, last, unit.name, visible_low, visible_high, hint));
        }
        if (std::all_of(powers_.begin(), powers_.end(), [](double p) { return p == 0; }))
            return wrong(label_, 0, "the power is zero everywhere");
        for (auto& w : wavelengths_) w *= unit.nm;
        auto power = SpectralDistribution::make(std::move(wavelengths_), std::move(powers_));
        if (!power) return wrong(label_, 0, power.error().message);
        return LampFile{*std::move(power), std::move(format)};
    }

private:
    std::string_view label_;
    std::size_t first_line_ = 0;
    std::vector<double> wavelengths_, powers_;
};

/// Lines of a text with their numbers, without comments and blank ends.
class Lines {
public:
    Lines(std::string_view text, std::initializer_list<std::string_view> comments) : text_(text), comments_(comments) {
        if (text_.starts_with("\xEF\xBB\xBF")) text_.remove_prefix(3);
    }
    bool next() {
        if (text_.empty()) return false;
        ++number;
        // Line ends of all three systems.
        const auto end = std::min(text_.find_first_of("\r\n"), text_.size());
        line = text_.substr(0, end);
        text_.remove_prefix(end + (text_.substr(end, 2) == "\r\n" ? 2 : end < text_.size() ? 1 : 0));
        for (const auto mark : comments_) line = line.substr(0, line.find(mark));
        line = trimmed(line);
        return true;
    }
    std::string_view line;
    std::size_t number = 0;

private:
    std::string_view text_;
    std::vector<std::string_view> comments_;
};

/// Up to `most` fields of a line, parted by commas, semicolons and blanks.
std::vector<std::string_view> fields_of(std::string_view line, std::size_t most) {
    std::vector<std::string_view> fields;
    for (std::size_t at = 0; at < line.size() && fields.size() < most;) {
        const auto stop = std::min(line.find_first_of(",; \t", at), line.size());
        if (stop > at) fields.push_back(line.substr(at, stop - at));
        at = stop + 1;
    }
    return fields;
}

/// A token of CGATS text: quoted ones may hold blanks.
struct Token {
    std::string_view text;
    std::size_t line = 0;
};

class CgatsTokens {
public:
    explicit CgatsTokens(std::string_view text) : lines_(text, {}) {}
    /// The next token; nothing at the end.
    std::optional<Token> next() {
        for (;;) {
            rest_ = trimmed(rest_);
            if (rest_.empty() || rest_.front() == '#') {
                if (!lines_.next()) return std::nullopt;
                rest_ = lines_.line;
                continue;
            }
            const bool quoted = rest_.front() == '"';
            const auto stop = quoted ? rest_.find('"', 1) : rest_.find_first_of(" \t");
            Token token{quoted ? rest_.substr(1, stop == std::string_view::npos ? stop : stop - 1) : rest_.substr(0, stop),
                        lines_.number};
            rest_.remove_prefix(stop == std::string_view::npos ? rest_.size() : stop + 1);
            return token;
        }
    }

private:
    Lines lines_;
    std::string_view rest_;
};

/// The number that ends a field's name: SPEC_380, nm380, SPECTRAL_NM_380.
std::optional<double> wavelength_of_field(std::string_view name) {
    const auto folded = folded_name(name);
    if (!folded.starts_with("spec") && !folded.starts_with("nm")) return std::nullopt;
    const auto digits = name.find_last_not_of("0123456789.");
    if (digits == std::string_view::npos || digits + 1 >= name.size()) return std::nullopt;
    return parse_number(name.substr(digits + 1));
}

/// An element's name without its namespace prefix.
std::string_view local_name(const pugi::xml_node& node) {
    const std::string_view name = node.name();
    const auto colon = name.rfind(':');
    return colon == std::string_view::npos ? name : name.substr(colon + 1);
}

}  // namespace

Result<LampFile> parse_columns(std::string_view text, std::string_view label) {
    Rows rows(label);
    Lines lines(text, {"#", "//"});
    bool header_seen = false;
    while (lines.next()) {
        if (lines.line.empty() || lines.line.front() == ';') continue;
        const auto fields = fields_of(lines.line, 100);
        if (rows.size() == 0 && !header_seen && (fields.empty() || !parse_number(fields[0]))) {
            header_seen = true;
            continue;
        }
        if (fields.size() != 2) {
            const bool commas = lines.line.find(',') != std::string_view::npos &&
                                lines.line.find_first_of("; \t") != std::string_view::npos && fields.size() > 2;
            return wrong(label, lines.number,
                         fmt::format("{} fields, expected two: wavelength in nm and power{}", fields.size(),
                                     commas ? ", with a point for decimals" : ""));
        }
        if (auto s = rows.add(lines.number, fields[0], fields[1]); !s) return s.error();
    }
    return std::move(rows).finish("two columns");
}

Result<LampFile> parse_pbrt_spd(std::string_view text, std::string_view label) {
    Rows rows(label);
    Lines lines(text, {"#"});
    std::string_view wavelength;
    std::size_t at = 0;
    while (lines.next()) {
        const auto fields = fields_of(lines.line, 2 * most_lamp_rows + 2);
        // Other programs head their .spd tables with names.
        if (rows.size() == 0 && wavelength.empty() && !fields.empty() && !parse_number(fields[0])) continue;
        for (const auto field : fields) {
            if (wavelength.empty()) {
                wavelength = field;
                at = lines.number;
                continue;
            }
            if (auto s = rows.add(lines.number, wavelength, field); !s) return s.error();
            wavelength = {};
        }
    }
    if (!wavelength.empty()) return wrong(label, at, fmt::format("'{}' has no power: expected pairs", shown(wavelength)));
    return std::move(rows).finish("pbrt spectrum");
}

Result<LampFile> parse_cgats(std::string_view text, std::string_view label) {
    CgatsTokens tokens(text);
    std::map<std::string, Token> keys;
    std::vector<Token> names, values;
    enum class In { head, format, data } in = In::head;
    bool data_seen = false;
    std::size_t last_line = 0;
    const auto take = [&](std::vector<Token>& list, const Token& token) -> Status {
        if (list.size() == most_lamp_rows) return wrong(label, token.line, fmt::format("more than {} fields", most_lamp_rows));
        list.push_back(token);
        return {};
    };
    while (const auto token = tokens.next()) {
        last_line = token->line;
        if (in == In::format) {
            if (token->text == "END_DATA_FORMAT") in = In::head;
            else if (auto s = take(names, *token); !s) return s.error();
        } else if (in == In::data) {
            if (token->text == "END_DATA") in = In::head;
            else if (auto s = take(values, *token); !s) return s.error();
        } else if (token->text == "BEGIN_DATA_FORMAT") {
            if (!names.empty()) return wrong(label, token->line, "a second BEGIN_DATA_FORMAT: expected one spectrum");
            in = In::format;
        } else if (token->text == "BEGIN_DATA") {
            if (data_seen) return wrong(label, token->line, "a second BEGIN_DATA: expected one spectrum");
            in = In::data;
            data_seen = true;
        } else if (token->text.starts_with("SPECTRAL_") || token->text == "NUMBER_OF_SETS" || token->text == "MEAS_TYPE") {
            const std::string key(token->text);
            const auto value = tokens.next();
            if (!value || value->line != token->line) return wrong(label, token->line, key + " has no value");
            keys[key] = *value;
        } else if (token->text == "KEYWORD") {
            (void)tokens.next();
        }
    }
    if (in != In::head)
        return wrong(label, last_line, in == In::data ? "the file ends before END_DATA" : "the file ends before END_DATA_FORMAT");
    if (!data_seen) return wrong(label, 0, "no BEGIN_DATA: expected a spectrum in CGATS text");
    const auto number = [&](const char* key) -> Result<std::optional<double>> {
        const auto found = keys.find(key);
        if (found == keys.end()) return std::optional<double>();
        const auto value = parse_number(found->second.text);
        if (!value || *value <= 0)
            return wrong(label, found->second.line, fmt::format("{} '{}': expected a number above 0", key, shown(found->second.text)));
        return value;
    };
    if (const auto type = keys.find("MEAS_TYPE"); type != keys.end())
        if (type->second.text == "REFLECTIVE" || type->second.text == "TRANSMISSIVE")
            return wrong(label, type->second.line, fmt::format("MEAS_TYPE {}: expected emission, a light", type->second.text));
    std::array<std::optional<double>, 5> stated;
    const std::array<const char*, 5> stated_keys{"SPECTRAL_BANDS", "SPECTRAL_START_NM", "SPECTRAL_END_NM", "SPECTRAL_NORM",
                                                 "NUMBER_OF_SETS"};
    for (std::size_t i = 0; i < stated.size(); ++i) {
        auto value = number(stated_keys[i]);
        if (!value) return std::move(value).error();
        stated[i] = *value;
    }
    const auto& [bands, start, end, norm, sets] = stated;
    if (sets && *sets != 1) return wrong(label, keys["NUMBER_OF_SETS"].line, fmt::format("{} spectra: expected one", *sets));
    if (!names.empty() && values.size() != names.size())
        return wrong(label, last_line, fmt::format("{} values for {} fields: expected one spectrum", values.size(), names.size()));

    // Fields that are no band (SAMPLE_ID and the like) are passed over.
    std::vector<Token> powers;
    std::vector<double> named;
    for (std::size_t i = 0; i < values.size(); ++i) {
        if (names.empty()) {
            powers.push_back(values[i]);
        } else if (const auto nm = wavelength_of_field(names[i].text)) {
            powers.push_back(values[i]);
            named.push_back(*nm);
        }
    }
    const bool range = bands && start && end;
    if (range && *bands != static_cast<double>(powers.size()))
        return wrong(label, keys["SPECTRAL_BANDS"].line,
                     fmt::format("SPECTRAL_BANDS {}, but {} values: expected as many", *bands, powers.size()));
    if (range && (powers.size() < 2 || *end <= *start))
        return wrong(label, keys["SPECTRAL_START_NM"].line,
                     fmt::format("{} bands from {} to {} nm: expected at least two that ascend", powers.size(), *start, *end));
    if (!range && named.size() != powers.size())
        return wrong(label, 0, "neither SPECTRAL_BANDS, SPECTRAL_START_NM and SPECTRAL_END_NM nor fields named by wavelength");
    Rows rows(label);
    for (std::size_t i = 0; i < powers.size(); ++i) {
        const double nm = range ? *start + (*end - *start) * static_cast<double>(i) / static_cast<double>(powers.size() - 1)
                                : named[i];
        // Names round to whole nanometres.
        if (range && !named.empty() && std::fabs(named[i] - nm) > 1)
            return wrong(label, names[0].line,
                         fmt::format("field {} is named {} nm, but lies at {:.6g} nm by SPECTRAL_START_NM and SPECTRAL_END_NM", i + 1,
                                     named[i], nm));
        if (auto s = rows.add(powers[i].line, nm, powers[i].text); !s) return s.error();
    }
    auto lamp = std::move(rows).finish("CGATS spectrum");
    if (!lamp || !norm || *norm == 1) return lamp;
    auto scaled = lamp->power.values();
    for (auto& v : scaled) v /= *norm;
    auto power = SpectralDistribution::make(lamp->power.wavelengths_nm(), std::move(scaled));
    if (!power) return wrong(label, keys["SPECTRAL_NORM"].line, power.error().message);
    lamp->power = *std::move(power);
    return lamp;
}

Result<LampFile> parse_tm27(std::string_view text, std::string_view label) {
    if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
    pugi::xml_document document;
    // Declared encodings are not converted: all that is read is ASCII, and offsets then are those of the file.
    const auto parsed = document.load_buffer(text.data(), text.size(), pugi::parse_minimal | pugi::parse_cdata, pugi::encoding_utf8);
    const auto line_at = [&](std::ptrdiff_t offset) {
        const auto end = std::clamp<std::ptrdiff_t>(offset, 0, static_cast<std::ptrdiff_t>(text.size()));
        return static_cast<std::size_t>(std::count(text.begin(), text.begin() + end, '\n')) + 1;
    };
    if (!parsed) return wrong(label, line_at(parsed.offset), fmt::format("no well-formed XML: {}", parsed.description()));
    const auto root = document.document_element();
    pugi::xml_node distribution;
    for (const auto child : root.children())
        if (local_name(child) == "SpectralDistribution") {
            if (distribution) return wrong(label, line_at(child.offset_debug()), "a second SpectralDistribution: expected one");
            distribution = child;
        }
    if (!distribution)
        return wrong(label, 0, fmt::format("the element '{}' has no SpectralDistribution: expected IES TM-27-14", shown(local_name(root))));
    const Unit* unit = &nanometres;
    Rows rows(label);
    // Lines are counted once over the whole text, however many elements.
    std::size_t line = 1;
    std::ptrdiff_t counted = 0;
    for (const auto child : distribution.children()) {
        const auto name = local_name(child);
        const std::ptrdiff_t offset = std::clamp<std::ptrdiff_t>(child.offset_debug(), counted, static_cast<std::ptrdiff_t>(text.size()));
        line += static_cast<std::size_t>(std::count(text.begin() + counted, text.begin() + offset, '\n'));
        counted = offset;
        const auto value = trimmed(child.child_value());
        if (name == "SpectralQuantity") {
            const auto quantity = folded_name(value);
            for (const char* refused : {"reflectance", "transmittance", "absorptance", "rfactor", "tfactor"})
                if (quantity == refused)
                    return wrong(label, line, fmt::format("SpectralQuantity '{}': expected that of a light", shown(value)));
        } else if (name == "WavelengthUnits" || name == "WavelengthUnit") {
            const auto stated = folded_name(value);
            if (stated == "nm" || stated.starts_with("nanomet")) unit = &nanometres;
            else if (stated == "um" || value == "µm" || value == "μm" || stated.starts_with("micromet")) unit = &micrometres;
            else if (stated.starts_with("angstrom") || value == "Å") unit = &angstroms;
            else if (stated == "m" || stated == "meter" || stated == "metre" || stated == "meters" || stated == "metres") unit = &metres;
            else return wrong(label, line, fmt::format("WavelengthUnits '{}': expected nm, um, angstrom or m", shown(value)));
        } else if (name == "SpectralData") {
            const auto wavelength = child.attribute("wavelength");
            if (!wavelength) return wrong(label, line, "SpectralData has no attribute wavelength");
            if (auto s = rows.add(line, wavelength.value(), value); !s) return s.error();
        }
    }
    return std::move(rows).finish("IES TM-27", *unit);
}

Result<LampFile> parse_lamp_file(std::string_view text, std::string_view label) {
    std::string_view start = text;
    if (start.starts_with("\xEF\xBB\xBF")) start.remove_prefix(3);
    start = trimmed(start.substr(0, 4096));
    const auto dot = label.rfind('.');
    const auto suffix = dot == std::string_view::npos ? std::string() : folded_name(label.substr(dot));
    if (text.size() > most_lamp_bytes)
        return wrong(label, 0, fmt::format("{} bytes, expected a spectrum of at most {}", text.size(), most_lamp_bytes));
    if (suffix == "spdx" || start.starts_with("<")) return parse_tm27(text, label);
    if (start.starts_with("SPECT") || start.starts_with("CGATS") || start.starts_with("ISO28178") ||
        text.find("BEGIN_DATA") != std::string_view::npos)
        return parse_cgats(text, label);
    if (suffix == "spd") return parse_pbrt_spd(text, label);
    return parse_columns(text, label);
}

}  // namespace spectex
