#include "methods/registry.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <exception>

namespace spectex {
namespace registry {
namespace {

constexpr int format_version = 1;
/// Larger than any model that is written, small enough that a hostile file cannot fill the memory.
constexpr std::size_t max_json_bytes = std::size_t{1} << 28;
constexpr std::size_t max_power_entries = 100000;

/// The order is that of the README's table. A method that comes with a new paper adds its row here, and its file.
const std::vector<Entry>& table() {
    static const std::vector<Entry> entries{
        mallett2019(),
        mallett2019_published(),
        lattice(),
        smits1999_exact(),
        smits1999(),
        jakob2019(),
        jakob2019_table(),
        macadam1935(),
        burns2020(),
        meng2015(),
        meng2015_matched(),
        otsu2018(),
        peters2019(),
        peters2019_fourier(),
    };
    return entries;
}

Result<const Entry*> find(std::string_view id) {
    std::string ids;
    for (const Entry& entry : table()) {
        if (entry.info.id == id) return &entry;
        ids += (ids.empty() ? "" : ", ") + entry.info.id;
    }
    return Error{ErrorKind::usage, fmt::format("method '{}' is not known: expected one of {}", id, ids)};
}

Error wrong(std::string_view member, std::string_view why) {
    return {ErrorKind::input, fmt::format("model: member '{}': {}", member, why)};
}

Result<const Json*> child(const Json& json, std::string_view member) {
    const auto at = json.is_object() ? json.find(std::string(member)) : json.end();
    if (at == json.end()) return wrong(member, "missing");
    return &*at;
}

/// A list of any length up to a limit; the number of entries is checked by who makes an object of it.
Result<std::vector<double>> read_list(const Json& json, std::string_view member, std::size_t most) {
    const auto list = child(json, member);
    if (!list) return list.error();
    if (!(*list)->is_array() || (*list)->size() > most)
        return wrong(member, fmt::format("expected a list of at most {} numbers", most));
    return read_numbers(json, member, (*list)->size(), -1e300, 1e300);
}

/// Named illuminants only: a text from a file must not make the library open another file.
bool safely_named(std::string_view name) {
    if (name.starts_with("D:") || name.starts_with("P:")) return name.find_first_of("*+") == std::string_view::npos;
    const auto entries = list_illuminants();
    return entries && std::any_of(entries->begin(), entries->end(), [&](const auto& e) { return e.name == name; });
}

std::optional<Illuminant> named(std::string_view name) {
    if (!safely_named(name)) return std::nullopt;
    auto found = parse_illuminant(name);
    if (!found) return std::nullopt;
    return *std::move(found);
}

Result<Illuminant> read_illuminant(const Json& json) {
    const auto member = child(json, "illuminant");
    if (!member) return member.error();
    if (!(*member)->is_object()) return wrong("illuminant", "expected an object");
    auto name = read_text(**member, "name");
    if (!name) return wrong("illuminant", name.error().message);
    if (!(*member)->contains("power")) {
        auto found = named(*name);
        if (!found) return wrong("illuminant", fmt::format("'{}' is no named illuminant and there is no power", *name));
        return *std::move(found);
    }
    const auto power = child(**member, "power");
    auto nm = read_list(**power, "wavelengths_nm", max_power_entries);
    if (!nm) return std::move(nm).error();
    auto values = read_numbers(**power, "values", nm->size(), 0, 1e300);
    if (!values) return std::move(values).error();
    if (!nm->empty() && (nm->front() <= 0 || nm->back() > 1e5)) return wrong("illuminant", "wavelengths lie outside 0..100000 nm");
    auto spectrum = SpectralDistribution::make(*std::move(nm), *std::move(values));
    if (!spectrum) return wrong("illuminant", spectrum.error().message);
    std::string title = *name;
    if ((*member)->contains("title")) {
        auto text = read_text(**member, "title");
        if (!text) return std::move(text).error();
        title = *std::move(text);
    }
    return Illuminant{*std::move(name), std::move(title), *std::move(spectrum)};
}

Result<Colorimetry> read_colorimetry(const Json& json) {
    auto wavelengths = read_list(json, "bands", BandSet::max_size);
    if (!wavelengths) return std::move(wavelengths).error();
    const auto bands = BandSet::make(*std::move(wavelengths));
    if (!bands) return wrong("bands", bands.error().message);
    ColorimetrySpec spec;
    for (const auto& [member, text] : {std::pair{"observer", &spec.observer}, std::pair{"rgb_space", &spec.rgb_space}}) {
        auto read = read_text(json, member);
        if (!read) return std::move(read).error();
        *text = *std::move(read);
    }
    if (const auto found = find_observer(spec.observer); !found) return wrong("observer", found.error().message);
    if (const auto found = find_rgb_space(spec.rgb_space); !found) return wrong("rgb_space", found.error().message);
    const auto matrix = read_text(json, "matrix");
    if (!matrix) return matrix.error();
    if (*matrix != "integrated" && *matrix != "standard") return wrong("matrix", "expected integrated or standard");
    spec.matrix = *matrix == "integrated" ? RgbMatrix::integrated : RgbMatrix::standard;
    const auto illuminant = read_illuminant(json);
    if (!illuminant) return illuminant.error();
    auto made = Colorimetry::make(spec, *bands, *illuminant);
    if (!made) return wrong("illuminant", made.error().message);
    return made;
}

}  // namespace

Json model_json(const Model& model) {
    const Colorimetry& c = model.colorimetry();
    Json json;
    json["format"] = format_version;
    json["method"] = model.info().id;
    json["bands"] = c.bands().wavelengths_nm();
    json["observer"] = c.observer().id;
    Json illuminant;
    illuminant["name"] = c.illuminant().name;
    // A file may bear the name of a lamp of the table.
    const auto found = named(c.illuminant().name);
    if (!found || found->power.wavelengths_nm() != c.illuminant().power.wavelengths_nm() ||
        found->power.values() != c.illuminant().power.values()) {
        illuminant["title"] = c.illuminant().title;
        illuminant["power"]["wavelengths_nm"] = c.illuminant().power.wavelengths_nm();
        illuminant["power"]["values"] = c.illuminant().power.values();
    }
    json["illuminant"] = std::move(illuminant);
    json["rgb_space"] = c.rgb_space().name;
    json["matrix"] = c.matrix_kind() == RgbMatrix::integrated ? "integrated" : "standard";
    return json;
}

Result<std::vector<double>> read_numbers(const Json& json, std::string_view member, std::size_t count, double low, double high) {
    const auto list = child(json, member);
    if (!list) return list.error();
    if (!(*list)->is_array() || (*list)->size() != count)
        return wrong(member, fmt::format("expected a list of {} numbers", count));
    std::vector<double> out;
    out.reserve(count);
    for (const Json& entry : **list) {
        const double value = entry.is_number() ? entry.get<double>() : std::nan("");
        if (!(value >= low && value <= high))
            return wrong(member, entry.is_number() ? fmt::format("entry {} is {}, expected {}..{}", out.size(), value, low, high)
                                                   : fmt::format("entry {} is no number", out.size()));
        out.push_back(value);
    }
    return out;
}

Result<std::string> read_text(const Json& json, std::string_view member) {
    const auto text = child(json, member);
    if (!text) return text.error();
    if (!(*text)->is_string() || (*text)->get_ref<const std::string&>().size() > 256)
        return wrong(member, "expected a text of at most 256 bytes");
    return (*text)->get<std::string>();
}

}  // namespace registry

Model::~Model() = default;

namespace {

/// Some bands of n whole spectra, which `form(first, count, spectra)` gives a few colours at a time.
template <class Form>
void gather_bands(std::size_t n, std::size_t all, std::span<const std::size_t> bands, std::span<double> out, const Form& form) {
    constexpr std::size_t block = 64;
    std::vector<double> spectra(block * all);
    for (std::size_t first = 0; first < n; first += block) {
        const std::size_t count = std::min(block, n - first);
        form(first, count, std::span<double>(spectra.data(), count * all));
        for (std::size_t p = 0; p < count; ++p)
            for (std::size_t k = 0; k < bands.size(); ++k) out[(first + p) * bands.size() + k] = spectra[p * all + bands[k]];
    }
}

}  // namespace

void Model::reflectance_in(std::span<const std::size_t> bands, std::span<const double> rgb, std::span<double> out) const {
    gather_bands(rgb.size() / 3, colorimetry_.bands().size(), bands, out, [&](std::size_t first, std::size_t count, std::span<double> spectra) {
        reflectance(rgb.subspan(3 * first, 3 * count), spectra);
    });
}

void Model::reflectance_of_coefficients_in(std::span<const std::size_t> bands, std::span<const double> coefficients,
                                           std::span<double> out) const {
    const auto each = static_cast<std::size_t>(info_.coefficients);
    gather_bands(coefficients.size() / each, colorimetry_.bands().size(), bands, out,
                 [&](std::size_t first, std::size_t count, std::span<double> spectra) {
                     reflectance_of_coefficients(coefficients.subspan(each * first, each * count), spectra);
                 });
}

const std::vector<MethodInfo>& methods() {
    static const std::vector<MethodInfo> list = [] {
        std::vector<MethodInfo> out;
        for (const auto& entry : registry::table()) out.push_back(entry.info);
        return out;
    }();
    return list;
}

Result<MethodInfo> find_method(std::string_view id) {
    const auto entry = registry::find(id);
    if (!entry) return entry.error();
    return (*entry)->info;
}

Result<std::shared_ptr<const Model>> make_model(std::string_view id, const Colorimetry& colorimetry) {
    const auto entry = registry::find(id);
    if (!entry) return entry.error();
    return (*entry)->make((*entry)->info, colorimetry);
}

Result<std::shared_ptr<const Model>> train_model(std::string_view id, const Colorimetry& colorimetry,
                                                 std::span<const SampleSet> sets) {
    const auto entry = registry::find(id);
    if (!entry) return entry.error();
    if (!(*entry)->train) return (*entry)->make((*entry)->info, colorimetry);
    return (*entry)->train((*entry)->info, colorimetry, sets);
}

Result<std::shared_ptr<const Model>> make_model_from_json(std::string_view text) {
    if (text.size() > registry::max_json_bytes)
        return Error{ErrorKind::input, fmt::format("model: {} bytes of JSON, expected at most {}", text.size(), registry::max_json_bytes)};
    try {
        const auto json = registry::Json::parse(text, nullptr, false);
        if (json.is_discarded() || !json.is_object()) return Error{ErrorKind::input, "model: not a JSON object"};
        const auto version = json.find("format");
        if (version == json.end() || !version->is_number_integer() || *version != registry::format_version)
            return registry::wrong("format", fmt::format("expected {}", registry::format_version));
        const auto id = registry::read_text(json, "method");
        if (!id) return id.error();
        const auto entry = registry::find(*id);
        if (!entry) return registry::wrong("method", entry.error().message);
        const auto colorimetry = registry::read_colorimetry(json);
        if (!colorimetry) return colorimetry.error();
        return (*entry)->from_json((*entry)->info, *colorimetry, json);
    } catch (const std::exception& e) {
        return Error{ErrorKind::input, fmt::format("model: {}", e.what())};
    }
}

}  // namespace spectex
