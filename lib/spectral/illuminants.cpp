#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>
#include <set>

#include "spectex/spectral.h"
#include "spectral/lamp_files.h"
#include "spectral/names.h"
#include "spectral/numeric.h"
#include "spectral/tables.h"

namespace spectex {
namespace {

constexpr std::string_view daylight_lut = "cie/daylight_components_300-830-5.csv";
constexpr std::string_view cie_tables_lut = "illuminants/cie_tables_380-780-5.csv";
constexpr std::string_view lamps_lut = "illuminants/lamps_380-780-5.csv";
constexpr std::string_view lamp_index_lut = "illuminants/lamps.csv";
constexpr std::string_view lamp_names_lut = "illuminants/names.csv";

Error usage(std::string message) { return {ErrorKind::usage, std::move(message)}; }
Error input(std::string message) { return {ErrorKind::input, std::move(message)}; }

/// f at 300..830 nm by 1 nm, scaled to 100 at 560 nm.
template <class F>
SpectralDistribution formula(const F& f) {
    std::vector<double> nm, values;
    for (int l = 300; l <= 830; ++l) {
        nm.push_back(l);
        values.push_back(100 * f(l) / f(560));
    }
    return SpectralDistribution::make(std::move(nm), std::move(values)).value();
}

/// Planck's law, relative; c2 in nm K.
SpectralDistribution planck(double kelvin, double c2) {
    // The common factor exp(c2 / (560 T)) is taken out, so that neither end overflows at low temperatures.
    return formula([&](double nm) {
        const double u = c2 / (nm * kelvin), u560 = c2 / (560 * kelvin);
        return std::exp(u560 - u) / (-std::expm1(-u)) * std::pow(560 / nm, 5);
    });
}

/// CIE daylight at a correlated colour temperature (CIE 15:2018 eq. 4.3 to 4.6). For the standard illuminants the factors
/// M1 and M2 are rounded to three decimals, as the CIE's tables were made.
Result<SpectralDistribution> daylight(double kelvin, bool rounded_factors) {
    auto table = load_spectral_table(daylight_lut);
    if (!table) return std::move(table).error();
    if (table->columns.size() != 3) return input(fmt::format("{}: expected columns s0, s1, s2", daylight_lut));
    const double t = 1e3 / kelvin;
    const double x = kelvin <= 7000 ? ((-4.6070 * t + 2.9678) * t + 0.09911) * t + 0.244063
                                    : ((-2.0064 * t + 1.9018) * t + 0.24748) * t + 0.237040;
    const double y = -3.000 * x * x + 2.870 * x - 0.275;
    const double m = 0.0241 + 0.2562 * x - 0.7341 * y;
    double m1 = (-1.3515 - 1.7703 * x + 5.9114 * y) / m;
    double m2 = (0.0300 - 31.4424 * x + 30.0717 * y) / m;
    if (rounded_factors) {
        m1 = std::round(m1 * 1e3) / 1e3;
        m2 = std::round(m2 * 1e3) / 1e3;
    }
    std::vector<double> values;
    for (std::size_t i = 0; i < table->wavelengths_nm.size(); ++i)
        values.push_back(std::max(0.0, table->columns[0][i] + m1 * table->columns[1][i] + m2 * table->columns[2][i]));
    return SpectralDistribution::make(std::move(table->wavelengths_nm), std::move(values));
}

Result<SpectralDistribution> column(std::string_view lut, std::size_t index) {
    auto table = load_spectral_table(lut);
    if (!table) return std::move(table).error();
    if (index >= table->columns.size()) return input(fmt::format("{}: no column {}", lut, index + 1));
    return SpectralDistribution::make(std::move(table->wavelengths_nm), std::move(table->columns[index]));
}

struct Lamp {
    std::size_t index = 0;  // from 1
    std::string label, kind;
};

Result<std::vector<Lamp>> lamps() {
    const auto text = lut_text(lamp_index_lut);
    if (!text) return text.error();
    const auto rows = parse_csv(*text, lamp_index_lut);
    if (!rows) return rows.error();
    std::vector<Lamp> out;
    for (std::size_t r = 1; r < rows->size(); ++r) {
        const auto& row = (*rows)[r];
        const auto index = row.size() < 3 ? std::nullopt : parse_number(row[0]);
        if (!index || *index < 1) return input(fmt::format("{}: row {}: expected index,label,kind", lamp_index_lut, r));
        out.push_back({static_cast<std::size_t>(*index), row[1], row[2]});
    }
    return out;
}

struct LampName {
    std::string name, description;
    std::size_t lamp = 0;
};

Result<std::vector<LampName>> lamp_names() {
    const auto text = lut_text(lamp_names_lut);
    if (!text) return text.error();
    const auto rows = parse_csv(*text, lamp_names_lut);
    if (!rows) return rows.error();
    std::vector<LampName> out;
    for (std::size_t r = 1; r < rows->size(); ++r) {
        const auto& row = (*rows)[r];
        const auto lamp = row.size() < 3 ? std::nullopt : parse_number(row[1]);
        if (!lamp || *lamp < 1) return input(fmt::format("{}: row {}: expected name,lamp,description", lamp_names_lut, r));
        out.push_back({row[0], row[2], static_cast<std::size_t>(*lamp)});
    }
    return out;
}

/// Nominal correlated colour temperatures of the CIE's daylight illuminants; the scale of temperature has changed since
/// they were defined (c2 = 1.4380e-2 m K then, 1.4388e-2 in CIE 15:2018).
struct NamedDaylight {
    const char* name;
    double nominal_kelvin;
};
constexpr NamedDaylight named_daylights[] = {{"D50", 5000}, {"D55", 5500}, {"D60", 6000},
                                             {"D65", 6500}, {"D75", 7500}, {"D93", 9300}};

Result<Illuminant> made(std::string name, std::string title, Result<SpectralDistribution> power) {
    if (!power) return std::move(power).error();
    return Illuminant{std::move(name), std::move(title), *std::move(power)};
}

/// A named illuminant; nothing when the name is none.
Result<std::optional<Illuminant>> by_name(std::string_view name) {
    const auto wrap = [](Result<Illuminant> r) -> Result<std::optional<Illuminant>> {
        if (!r) return std::move(r).error();
        return std::optional<Illuminant>(*std::move(r));
    };
    const auto wanted = folded_name(name);
    if (wanted.empty()) return std::optional<Illuminant>{};
    if (wanted == "a") return wrap(made("A", "CIE illuminant A (2856 K)", planck(2848, 1.435e7)));
    if (wanted == "e") return wrap(made("E", "equal energy", formula([](double) { return 1.0; })));
    for (const auto& d : named_daylights)
        if (wanted == folded_name(d.name))
            return wrap(made(d.name, fmt::format("CIE daylight {} K", d.nominal_kelvin),
                             daylight(d.nominal_kelvin * 1.4388 / 1.4380, true)));
    if (wanted == "b" || wanted == "c") {
        const auto table = load_spectral_table(cie_tables_lut);
        if (!table) return table.error();
        for (std::size_t c = 0; c < table->names.size(); ++c)
            if (folded_name(table->names[c]) == wanted)
                return wrap(made(table->names[c], "CIE illuminant " + table->names[c], column(cie_tables_lut, c)));
    }
    const auto names = lamp_names();
    if (!names) return names.error();
    const auto dotted = [](std::string_view text) {  // FL3.1 and FL31 differ
        std::string out;
        for (const char c : text)
            out += c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
        return out;
    };
    for (const auto& entry : *names)
        if (dotted(entry.name) == dotted(name)) return wrap(made(entry.name, entry.description, column(lamps_lut, entry.lamp - 1)));
    const auto all = lamps();
    if (!all) return all.error();
    for (const auto& lamp : *all)
        if (lamp.label == name || "lamp:" + std::to_string(lamp.index) == name)
            return wrap(made(fmt::format("lamp:{}", lamp.index), lamp.label, column(lamps_lut, lamp.index - 1)));
    return std::optional<Illuminant>{};
}

/// The names that share most with a mistyped one, for the error message.
std::string near_names(std::string_view name) {
    const auto entries = list_illuminants();
    if (!entries) return {};
    const auto wanted = folded_name(name);
    std::vector<std::pair<std::size_t, std::string>> scored;
    for (const auto& entry : *entries) {
        // Levenshtein distance of the folded names, one row at a time.
        const auto have = folded_name(entry.name);
        std::vector<std::size_t> row(have.size() + 1);
        for (std::size_t j = 0; j <= have.size(); ++j) row[j] = j;
        for (std::size_t i = 1; i <= wanted.size(); ++i) {
            std::size_t diagonal = row[0];
            row[0] = i;
            for (std::size_t j = 1; j <= have.size(); ++j) {
                const std::size_t next = std::min({row[j] + 1, row[j - 1] + 1, diagonal + (wanted[i - 1] != have[j - 1])});
                diagonal = row[j];
                row[j] = next;
            }
        }
        scored.emplace_back(row.back(), entry.name);
    }
    std::stable_sort(scored.begin(), scored.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    std::string out;
    for (std::size_t i = 0; i < scored.size() && i < 3; ++i) out += (i ? ", " : "") + scored[i].second;
    return out;
}

Result<Illuminant> from_file(std::string_view path) {
    const std::string name(path);
    const auto text = read_text(name, most_lamp_bytes);
    if (!text) return text.error();
    auto lamp = parse_lamp_file(*text, path);
    if (!lamp) return std::move(lamp).error();
    return Illuminant{std::filesystem::path(name).stem().string(), fmt::format("{} {}", lamp->format, name), std::move(lamp->power)};
}

std::optional<std::string> regular_file(std::string_view text) {
    std::error_code ignored;
    std::string path(text);
    if (std::filesystem::is_regular_file(path, ignored)) return path;
    return std::nullopt;
}

Result<Illuminant> parse_single(std::string_view spec) {
    if (spec.size() > 2 && (spec[0] == 'D' || spec[0] == 'd' || spec[0] == 'P' || spec[0] == 'p') && spec[1] == ':') {
        const bool is_daylight = spec[0] == 'D' || spec[0] == 'd';
        const auto kelvin = parse_number(spec.substr(2));
        const double low = is_daylight ? 4000 : 500, high = is_daylight ? 25000 : 1e6;
        if (!kelvin || *kelvin < low || *kelvin > high)
            return usage(fmt::format("illuminant '{}': expected {} and a temperature from {} to {} K, such as {}", spec,
                                     is_daylight ? "D:" : "P:", low, high, is_daylight ? "D:5003" : "P:2856"));
        if (is_daylight)
            return made(fmt::format("D:{}", *kelvin), fmt::format("daylight {} K", *kelvin), daylight(*kelvin, false));
        return made(fmt::format("P:{}", *kelvin), fmt::format("Planckian radiator {} K", *kelvin),
                    planck(*kelvin, 1.438776877e7));
    }
    auto named = by_name(spec);
    if (!named) return std::move(named).error();
    if (*named) return **std::move(named);
    if (const auto path = regular_file(spec)) return from_file(*path);
    if (spec.find('/') != std::string_view::npos || spec.find('.') != std::string_view::npos)
        return input(fmt::format("illuminant '{}': neither a name nor a readable file (near names: {})", spec, near_names(spec)));
    return usage(fmt::format("illuminant '{}' is not known: expected a name (near: {}), D:CCT, P:CCT, a file, or a mixture such "
                             "as 0.7*A+0.3*FL11",
                             spec, near_names(spec)));
}

/// Luminance of a power distribution by the CIE 1931 observer, relative.
Result<double> luminance(const Illuminant& illuminant) {
    const auto observer = find_observer("cie1931");
    if (!observer) return observer.error();
    const BandSet full(SpectralShape::make(360, 830, 1).value());
    const auto w = tristimulus_weights(full, **observer, illuminant, Normalization::none);
    if (!w) return w.error();
    return w->white[1];
}

Result<Illuminant> mixture(std::string_view spec) {
    std::vector<std::pair<double, Illuminant>> parts;
    std::set<double> grid;
    for (std::size_t at = 0; at <= spec.size();) {
        const auto end = std::min(spec.find('+', at), spec.size());
        const auto term = trimmed(spec.substr(at, end - at));
        at = end + 1;
        const auto star = term.find('*');
        const auto weight = star == std::string_view::npos ? std::optional<double>(1) : parse_number(term.substr(0, star));
        const auto name = star == std::string_view::npos ? term : trimmed(term.substr(star + 1));
        if (!weight || *weight < 0 || name.empty())
            return usage(fmt::format("illuminant mixture '{}': term '{}': expected WEIGHT*NAME with a weight of zero or more",
                                     spec, term));
        auto part = parse_single(name);
        if (!part) return part;
        const auto y = luminance(*part);
        if (!y) return y.error();
        grid.insert(part->power.wavelengths_nm().begin(), part->power.wavelengths_nm().end());
        parts.emplace_back(*weight / *y, *std::move(part));
    }
    std::vector<double> nm(grid.begin(), grid.end()), values;
    for (const double l : nm) {
        CompensatedSum sum;
        for (const auto& [weight, part] : parts) sum.add(weight * part.power.at(l, Extrapolation::zero));
        values.push_back(sum.value());
    }
    if (std::all_of(values.begin(), values.end(), [](double v) { return v == 0; }))
        return usage(fmt::format("illuminant mixture '{}': every weight is zero", spec));
    return made(std::string(spec), "mixture " + std::string(spec), SpectralDistribution::make(std::move(nm), std::move(values)));
}

}  // namespace

Result<Illuminant> parse_illuminant(std::string_view specification) {
    const auto spec = trimmed(specification);
    if (spec.empty()) return usage("an illuminant's name is empty: expected a name, D:CCT, P:CCT, a file or a mixture");
    if (spec.find('*') == std::string_view::npos) return parse_single(spec);
    if (const auto path = regular_file(spec)) return from_file(*path);
    return mixture(spec);
}

Result<std::vector<IlluminantEntry>> list_illuminants() {
    std::vector<IlluminantEntry> out{{"A", "CIE illuminant A (2856 K)", "incandescent"},
                                     {"B", "CIE illuminant B", "daylight"},
                                     {"C", "CIE illuminant C", "daylight"}};
    for (const auto& d : named_daylights)
        out.push_back({d.name, fmt::format("CIE daylight {} K", d.nominal_kelvin), "daylight"});
    out.push_back({"E", "equal energy", "theoretical"});
    const auto names = lamp_names();
    if (!names) return names.error();
    const auto all = lamps();
    if (!all) return all.error();
    const auto kind_of = [&](std::size_t index) {
        for (const auto& lamp : *all)
            if (lamp.index == index) return lamp.kind;
        return std::string();
    };
    for (const auto& entry : *names) out.push_back({entry.name, entry.description, kind_of(entry.lamp)});
    for (const auto& lamp : *all) out.push_back({fmt::format("lamp:{}", lamp.index), lamp.label, lamp.kind});
    return out;
}

}  // namespace spectex
