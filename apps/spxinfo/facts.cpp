#include "facts.h"

#include <fmt/format.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <memory>

#include "spectex/color.h"
#include "spectex/io.h"
#include "spectex/methods.h"
#include "spectex/spectral.h"

namespace spectex::app {
namespace {

/// IEEE 754 binary16.
double half_value(std::uint16_t bits) {
    const int exponent = bits >> 10 & 31, fraction = bits & 1023;
    double magnitude = 0;
    if (exponent == 31)
        magnitude = fraction ? std::numeric_limits<double>::quiet_NaN() : std::numeric_limits<double>::infinity();
    else
        magnitude = exponent ? std::ldexp(1024 + fraction, exponent - 25) : std::ldexp(fraction, -24);
    return bits & 0x8000 ? -magnitude : magnitude;
}

double sample_value(const std::byte* at, PixelType type) {
    std::uint16_t word = 0;
    float single = 0;
    switch (type) {
        case PixelType::uint8: return std::to_integer<int>(*at);
        case PixelType::uint16: std::memcpy(&word, at, sizeof word); return word;
        case PixelType::half: std::memcpy(&word, at, sizeof word); return half_value(word);
        case PixelType::float32: std::memcpy(&single, at, sizeof single); return static_cast<double>(single);
    }
    return 0;
}

/// Largest code of an integer type; 1 for floating point.
double full_scale(PixelType type) {
    return type == PixelType::uint8 ? 255 : type == PixelType::uint16 ? 65535 : 1;
}

/// Few enough digits for a table; the JSON has them all.
std::string figure(double value) { return fmt::format("{:.6g}", value); }

std::string rgb_text(const Vector3& rgb) { return fmt::format("{:.6g} {:.6g} {:.6g}", rgb[0], rgb[1], rgb[2]); }

Json vector_json(const Vector3& v) { return Json::array({v[0], v[1], v[2]}); }

struct Writer {
    Facts& facts;
    void add(std::string key, std::string value) { facts.rows.emplace_back(std::move(key), std::move(value)); }
    void add(std::string key, const char* json_key, std::string value) {
        facts.json[json_key] = value;
        add(std::move(key), std::move(value));
    }
};

void add_geometry(Writer& writer, const Geometry& g) {
    auto& json = writer.facts.json;
    writer.add("size", fmt::format("{} x {} pixels", g.width, g.height));
    json["width"] = g.width;
    json["height"] = g.height;
    if (g.x != 0 || g.y != 0 || g.full_x != 0 || g.full_y != 0 || g.full_width != g.width || g.full_height != g.height) {
        writer.add("data window", fmt::format("from {}, {} in a display window of {} x {} from {}, {}", g.x, g.y, g.full_width,
                                              g.full_height, g.full_x, g.full_y));
        json["data_window"] = {g.x, g.y, g.width, g.height};
        json["display_window"] = {g.full_x, g.full_y, g.full_width, g.full_height};
    }
    if (g.pixel_aspect != 1) writer.add("pixel aspect", figure(g.pixel_aspect));
    if (g.orientation != 1) writer.add("orientation", fmt::format("{} (Exif)", g.orientation));
    json["pixel_aspect"] = g.pixel_aspect;
    json["orientation"] = g.orientation;
}

void add_file_size(Writer& writer, const std::string& path) {
    std::error_code failed;
    const auto bytes = std::filesystem::file_size(path, failed);
    if (failed) return;
    writer.add("file size", fmt::format("{} bytes", bytes));
    writer.facts.json["file_bytes"] = bytes;
}

std::string attribute_text(const AttributeValue& value) {
    if (const auto* text = std::get_if<std::string>(&value)) return *text;
    if (const auto* list = std::get_if<std::vector<float>>(&value)) return fmt::format("{}", fmt::join(*list, " "));
    if (const auto* integer = std::get_if<std::int32_t>(&value)) return std::to_string(*integer);
    if (const auto* single = std::get_if<float>(&value)) return fmt::format("{}", *single);
    return number_text(std::get<double>(value));
}

/// Header values; a long text is cut for people, and a model, which may be a whole table, is given by its size alone.
void add_attributes(Writer& writer, const Attributes& attributes) {
    Json all = Json::object();
    for (const auto& [name, value] : attributes) {
        if (name == "spectex:model") {
            const auto* text = std::get_if<std::string>(&value);
            writer.add(name, fmt::format("{} bytes", text ? text->size() : 0));
            all[name] = {{"bytes", text ? text->size() : 0}};
            continue;
        }
        Json& entry = all[name];
        std::visit([&](const auto& v) { entry = v; }, value);
        std::string shown = attribute_text(value);
        constexpr std::size_t longest = 160;
        if (shown.size() > longest) shown = fmt::format("{}... ({} bytes)", shown.substr(0, longest), shown.size());
        if (const auto last = shown.find_last_not_of(' '); last != std::string::npos) shown.resize(last + 1);
        writer.add(escape(name), shown);
    }
    writer.facts.json["attributes"] = std::move(all);
}

Status check_position(const std::string& path, const Geometry& g, const std::array<std::int64_t, 2>& at) {
    if (at[0] < g.width && at[1] < g.height) return {};
    return Error{ErrorKind::usage, fmt::format("--at: {} has X in 0..{} and Y in 0..{}, got {},{}", path, g.width - 1,
                                               g.height - 1, at[0], at[1])};
}

Status check_finite(std::string_view channel, double value, const std::array<std::int64_t, 2>& at) {
    if (std::isfinite(value)) return {};
    return Error{ErrorKind::input, fmt::format("pixel {},{}: channel {} is {}", at[0], at[1], channel, number_text(value))};
}

void add_pixel_heading(Writer& writer, const std::array<std::int64_t, 2>& at) {
    writer.add("pixel", fmt::format("{}, {}", at[0], at[1]));
    writer.facts.json["at"] = {at[0], at[1]};
}

void add_linear_rgb(Writer& writer, const Vector3& rgb, const std::string& space, std::string_view how) {
    writer.add("linear RGB", fmt::format("{} ({}, {})", rgb_text(rgb), space, how));
    writer.facts.json["linear_rgb"] = vector_json(rgb);
    writer.facts.json["linear_rgb_space"] = space;
}

/// Linear RGB of BT.709 from that of another space, white to white.
Vector3 to_bt709(const Vector3& rgb, const Colorimetry& from) {
    const auto bt709 = find_rgb_space("BT.709");
    return bt709 ? rgb_to_xyz_matrix(*bt709, from.white_xyz()).inverse() * (from.rgb_to_xyz() * rgb) : rgb;
}

Result<Facts> describe_image(const std::string& path, const FactsRequest& request) {
    auto opened = ImageReader::open(path, request.threads);
    if (!opened) return opened.error();
    ImageReader& reader = **opened;
    const ImageHeader& header = reader.header();
    Facts facts;
    Writer writer{facts};
    writer.add("kind", "kind", "image");
    writer.add("format", "format", header.format);
    add_file_size(writer, path);
    add_geometry(writer, header.geometry);
    writer.add("channels", fmt::format("{} ({})", header.channels.size(), fmt::join(header.channels, ", ")));
    facts.json["channels"] = header.channels;
    writer.add("type", "type", std::string(pixel_type_name(header.type)));
    if (header.alpha >= 0) {
        writer.add("alpha", header.alpha_associated ? "associated (colour is premultiplied)" : "straight");
        facts.json["alpha"] = header.alpha_associated ? "associated" : "straight";
    }
    if (header.subimages > 1) writer.add("subimages", fmt::format("{}, of which the first is read", header.subimages));
    facts.json["subimages"] = header.subimages;

    std::optional<ColorSpaceChoice> choice;
    if (header.has_color()) {
        auto chosen = choose_input_space(header, request.input_colorspace);
        if (!chosen) return chosen.error();
        choice = *std::move(chosen);
        writer.add("colour space", fmt::format("{} ({})", choice->name, choice->reason));
        facts.json["colorspace"] = choice->name;
        facts.json["colorspace_reason"] = choice->reason;
    }
    add_attributes(writer, header.metadata);
    if (!request.at) return facts;

    const std::int64_t x = (*request.at)[0], y = (*request.at)[1];
    if (auto ok = check_position(path, header.geometry, *request.at); !ok) return ok.error();
    const std::size_t sample = pixel_bytes(header.type), pixel = sample * header.channels.size();
    std::vector<std::byte> row(pixel * static_cast<std::size_t>(header.geometry.width));
    if (auto read = reader.read_rows(static_cast<int>(y), 1, row.data()); !read) return read.error();
    const auto value = [&](std::size_t channel) {
        return sample_value(row.data() + static_cast<std::size_t>(x) * pixel + channel * sample, header.type);
    };
    for (std::size_t c = 0; c < header.channels.size() && request.strict; ++c)
        if (auto ok = check_finite(header.channels[c], value(c), *request.at); !ok) return ok.error();
    add_pixel_heading(writer, *request.at);
    Json samples = Json::object();
    for (std::size_t c = 0; c < header.channels.size(); ++c) {
        writer.add("  " + escape(header.channels[c]), figure(value(c)));
        samples[header.channels[c]] = value(c);
    }
    facts.json["samples"] = std::move(samples);
    if (!choice) return facts;

    const auto bt709 = find_rgb_space("BT.709");
    if (!bt709) return bt709.error();
    auto transform = ColorTransform::to_linear(*choice, header, *bt709);
    if (!transform) return transform.error();
    std::array<float, 3> rgb{};
    for (std::size_t i = 0; i < 3; ++i)
        rgb[i] = static_cast<float>(value(static_cast<std::size_t>(header.color[i])) / full_scale(header.type));
    (*transform)->apply({&rgb[0], &rgb[1], &rgb[2]}, 1);
    facts.linear_bt709 = Vector3{static_cast<double>(rgb[0]), static_cast<double>(rgb[1]), static_cast<double>(rgb[2])};
    add_linear_rgb(writer, *facts.linear_bt709, bt709->name, (*transform)->describe());
    return facts;
}

std::string text_attribute(const Attributes& attributes, const char* name) {
    const auto found = attributes.find(name);
    if (found == attributes.end()) return {};
    const auto* text = std::get_if<std::string>(&found->second);
    return text ? *text : std::string();
}

/// The pixel's colour from its bands, by the file's own observer, illuminant and space where it names them.
void add_band_colour(Writer& writer, const SpectralHeader& header, const PixelSpectrum& spectrum) {
    ColorimetrySpec spec;
    for (const auto& [name, target] : {std::pair{"spectex:observer", &spec.observer},
                                       std::pair{"spectex:illuminant", &spec.illuminant},
                                       std::pair{"spectex:rgbSpace", &spec.rgb_space}})
        if (const auto text = text_attribute(header.attributes, name); !text.empty()) *target = text;
    if (text_attribute(header.attributes, "spectex:matrix") == "standard") spec.matrix = RgbMatrix::standard;
    const auto skip = [&](const Error& error) { writer.add("linear RGB", "not computed: " + error.message); };

    const auto bands = BandSet::make(spectrum.wavelengths_nm);
    if (!bands) return skip(bands.error());
    const auto colorimetry = Colorimetry::make(spec, *bands);
    if (!colorimetry) return skip(colorimetry.error());
    if (!spectrum.emissive) {
        const Vector3 rgb = colorimetry->rgb_of(spectrum.values);
        writer.facts.linear_bt709 = to_bt709(rgb, *colorimetry);
        return add_linear_rgb(writer, rgb, colorimetry->rgb_space().name,
                              fmt::format("{}, {}", colorimetry->observer().title, colorimetry->illuminant().name));
    }
    const auto weights = emission_weights(*bands, colorimetry->observer());
    Vector3 xyz{};
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t k = 0; k < bands->size(); ++k) xyz[i] += weights.w[i * bands->size() + k] * spectrum.values[k];
    writer.add("XYZ", fmt::format("{} ({})", rgb_text(xyz), colorimetry->observer().title));
    writer.facts.json["xyz"] = vector_json(xyz);
    const auto& space = colorimetry->rgb_space();
    const Matrix3 to_rgb = rgb_to_xyz_matrix(space, xyz_from_xy(space.white_xy[0], space.white_xy[1])).inverse();
    add_linear_rgb(writer, to_rgb * xyz, space.name, colorimetry->observer().title);
}

void add_spectrum(Writer& writer, const PixelSpectrum& spectrum) {
    for (std::size_t i = 0; i < spectrum.values.size(); ++i)
        writer.add(fmt::format("  {} nm", figure(spectrum.wavelengths_nm[i])), figure(spectrum.values[i]));
    writer.facts.json["spectrum"] = {{"quantity", spectrum.emissive ? "radiance" : "reflectance"},
                                     {"wavelengths_nm", spectrum.wavelengths_nm},
                                     {"values", spectrum.values}};
}

Result<Facts> describe_spectral(const std::string& path, const FactsRequest& request) {
    auto opened = SpectralReader::open(path, request.threads);
    if (!opened) return opened.error();
    SpectralReader& reader = **opened;
    const SpectralHeader& header = reader.header();
    const bool coefficients = header.kind == FileKind::coefficients;
    Facts facts;
    Writer writer{facts};
    writer.add("kind", "kind", coefficients ? "coefficients" : "spectral");
    writer.add("format", "format", header.type == PixelType::uint8 ? "png" : "openexr");
    add_file_size(writer, path);
    add_geometry(writer, header.geometry);
    writer.add("type", "type", std::string(pixel_type_name(header.type)));
    facts.json["parts"] = header.parts;
    if (header.parts > 1) writer.add("parts", std::to_string(header.parts));

    std::shared_ptr<const Model> model;
    if (coefficients) {
        auto made = make_model_from_json(text_attribute(header.attributes, "spectex:model"));
        if (!made) return Error{made.error().kind, fmt::format("attribute spectex:model: {}", made.error().message)};
        model = *std::move(made);
        if (header.coefficients.size() != static_cast<std::size_t>(model->info().coefficients))
            return Error{ErrorKind::input, fmt::format("{} coefficient channels, expected {} for {}", header.coefficients.size(),
                                                       model->info().coefficients, model->info().id)};
        const auto& c = model->colorimetry();
        writer.add("coefficients", fmt::format("{}", fmt::join(header.coefficients, ", ")));
        facts.json["coefficients"] = header.coefficients;
        writer.add("method", "method", model->info().id);
        writer.add("title", model->info().title);
        writer.add("source", model->info().source);
        writer.add("bands", fmt::format("{} ({})", c.bands().size(), c.bands().describe()));
        facts.json["wavelengths_nm"] = c.bands().wavelengths_nm();
        writer.add("observer", "observer", c.observer().id);
        writer.add("illuminant", "illuminant", c.illuminant().name);
        writer.add("RGB space", "rgb_space", c.rgb_space().name);
    } else {
        const auto& nm = header.wavelengths_nm;
        const auto bands = BandSet::make(nm);
        writer.add("bands", fmt::format("{} of {} ({})", nm.size(), header.emissive ? "radiance" : "reflectance",
                                        bands ? bands->describe() : fmt::format("{}..{} nm", figure(nm.front()), figure(nm.back()))));
        facts.json["wavelengths_nm"] = nm;
        facts.json["quantity"] = header.emissive ? "radiance" : "reflectance";
        if (header.has_both) writer.add("also", "bands of reflectance and of radiance; those of reflectance are read");
    }
    facts.json["preview"] = header.has_rgb;
    if (!coefficients) writer.add("preview", header.has_rgb ? "R, G, B" : "none");
    if (!header.others.empty()) writer.add("other channels", fmt::format("{}", fmt::join(header.others, ", ")));
    facts.json["other_channels"] = header.others;
    add_attributes(writer, header.attributes);
    if (!request.at) return facts;

    if (auto ok = check_position(path, header.geometry, *request.at); !ok) return ok.error();
    const std::int64_t x = (*request.at)[0], y = (*request.at)[1];
    const std::size_t count = coefficients ? header.coefficients.size() : header.wavelengths_nm.size();
    const auto width = static_cast<std::size_t>(header.geometry.width);
    std::vector<float> samples(count * width);
    std::vector<float*> planes;
    for (std::size_t i = 0; i < count; ++i) planes.push_back(samples.data() + i * width);
    if (auto read = reader.read_rows(static_cast<int>(y), 1, planes, {}); !read) return read.error();
    std::vector<double> values;
    const bool codes = header.type == PixelType::uint8;
    for (const float* plane : planes) {
        const auto value = static_cast<double>(plane[x]);
        values.push_back(codes ? srgb_decode(std::round(value * 255) / 255) : value);
    }

    for (std::size_t i = 0; i < count && request.strict; ++i) {
        const std::string name = coefficients ? header.coefficients[i] : figure(header.wavelengths_nm[i]) + " nm";
        if (auto ok = check_finite(name, values[i], *request.at); !ok) return ok.error();
    }
    add_pixel_heading(writer, *request.at);
    PixelSpectrum spectrum;
    if (coefficients) {
        for (std::size_t i = 0; i < count; ++i) {
            writer.add("  " + escape(header.coefficients[i]), figure(values[i]));
            facts.json["samples"][header.coefficients[i]] = values[i];
        }
        spectrum.wavelengths_nm = model->colorimetry().bands().wavelengths_nm();
        spectrum.values.resize(spectrum.wavelengths_nm.size());
        model->reflectance_of_coefficients(values, spectrum.values);
        const Vector3 rgb = model->colorimetry().rgb_of(spectrum.values);
        facts.linear_bt709 = to_bt709(rgb, model->colorimetry());
        add_linear_rgb(writer, rgb, model->colorimetry().rgb_space().name, model->colorimetry().describe());
    } else {
        spectrum = {header.wavelengths_nm, std::move(values), header.emissive};
        add_band_colour(writer, header, spectrum);
    }
    add_spectrum(writer, spectrum);
    facts.spectrum = std::move(spectrum);
    return facts;
}

}  // namespace

Result<Facts> describe_file(const std::string& path, const FactsRequest& request) {
    const auto kind = probe(path);
    if (!kind) return kind.error();
    return *kind == FileKind::image ? describe_image(path, request) : describe_spectral(path, request);
}

}  // namespace spectex::app
