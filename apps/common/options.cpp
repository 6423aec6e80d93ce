#include "options.h"

#include <fmt/format.h>

#include <array>
#include <string_view>

namespace spectex::app {
namespace {

/// A picture halved this often is one pixel, whatever its size.
constexpr int deepest_level = 31;

/// An option whose value is kept as text once `check` accepts it.
template <class Check>
Option checked(std::string names, std::string metavar, std::string text, std::string default_value, std::string* out,
               Check check) {
    return {.names = std::move(names),
            .metavar = std::move(metavar),
            .text = std::move(text),
            .default_value = std::move(default_value),
            .set = [out, check](std::string_view value) -> Status {
                if (auto found = check(value); !found) return found.error();
                *out = value;
                return {};
            }};
}

void add_type(App& app, const char* name, PixelType type, OutputOptions& options, const char* text) {
    app.add({.names = name, .text = text, .set = [type, &options](std::string_view) -> Status {
                 if (options.type)
                     return Error{ErrorKind::usage, "excludes the other sample type " +
                                                        std::string(pixel_type_name(*options.type))};
                 options.type = type;
                 return {};
             }});
}

}  // namespace

void add_colorimetry_options(App& app, ColorimetryOptions& options, const std::string& illuminant_names) {
    app.group("Colorimetry");
    app.add(checked("--observer", "O", "standard observer: cie1931, cie1964, cie2006-2, cie2006-10", options.spec.observer,
                    &options.spec.observer, [](std::string_view v) { return find_observer(v); }));
    app.add(checked(illuminant_names, "ILLUMINANT",
                    "light under which the texture's colours are meant: a name, D:KELVIN, P:KELVIN, a file, or a mixture "
                    "as 0.7*A+0.3*FL11",
                    options.spec.illuminant.empty() ? "the RGB space's own" : options.spec.illuminant,
                    &options.spec.illuminant, [](std::string_view v) { return parse_illuminant(v); }));
    app.add(checked("--rgb-space", "S",
                    "RGB space of the linear colours: BT.709, Display P3, Adobe RGB, Rec.2020, ACEScg, ACES2065-1, "
                    "ProPhoto, PAL/SECAM",
                    options.spec.rgb_space, &options.spec.rgb_space, [](std::string_view v) { return find_rgb_space(v); }));
    app.add({.names = "--matrix", .metavar = "KIND",
             .text = "RGB to XYZ matrix: integrated (from the illuminant's white on the bands' grid) or standard (from the "
                     "white as the standard prints it)",
             .default_value = "integrated", .set = [&options](std::string_view value) -> Status {
                 static constexpr std::array<std::string_view, 2> kinds{"integrated", "standard"};
                 auto index = parse_choice(value, kinds);
                 if (!index) return index.error();
                 options.spec.matrix = *index == 0 ? RgbMatrix::integrated : RgbMatrix::standard;
                 return {};
             }});
    auto bands = checked("--bands", "START:END:STEP|N|auto", "band centres: a grid, a number of bands, or auto: 380:780:10 where bands are stored, else 380:780:5",
                         options.bands, &options.bands, [](std::string_view v) { return BandSet::parse(v); });
    bands.unit = "nm";
    app.add(std::move(bands));
}

void add_method_options(App& app, MethodOptions& options) {
    app.group("Method");
    std::string ids;
    for (const auto& info : methods()) ids += (ids.empty() ? "" : ", ") + info.id;
    app.add(checked("--method", "M", "reflectance method: " + ids, options.method, &options.method,
                    [](std::string_view v) { return find_method(v); }));
    app.add({.names = "--gamut", .metavar = "POLICY",
             .text = "colours outside [0,1], which no reflectance has: clip, desaturate, or error", .default_value = "clip",
             .set = [&options](std::string_view value) -> Status {
                 static constexpr std::array<std::string_view, 3> names{"clip", "desaturate", "error"};
                 static constexpr std::array policies{GamutPolicy::clip, GamutPolicy::desaturate, GamutPolicy::error};
                 auto index = parse_choice(value, names);
                 if (!index) return index.error();
                 options.gamut = policies[*index];
                 return {};
             }});
}

void add_output_options(App& app, OutputOptions& options, OutputTypes types) {
    app.group("Output");
    add_type(app, "--half", PixelType::half, options, "write 16-bit floating-point samples");
    add_type(app, "--float", PixelType::float32, options, "write 32-bit floating-point samples");
    if (types == OutputTypes::stored)
        add_type(app, "--uint8", PixelType::uint8, options,
                 "write coefficients as 8-bit codes into a PNG, by the curve of sRGB: for methods whose coefficients are linear RGB or within [0,1]");
    if (types == OutputTypes::any) {
        add_type(app, "--uint8", PixelType::uint8, options, "write 8-bit integer samples");
        add_type(app, "--uint16", PixelType::uint16, options, "write 16-bit integer samples");
    }
    app.text("--compression", "C", &options.compression,
             types == OutputTypes::any ? "EXR: none, rle, zips, zip, piz; TIFF: none, lzw, zip; PNG: a level 0..9"
                                       : "none, rle, zips, zip, piz");
    if (types == OutputTypes::any)
        app.text("--output-colorspace", "CS", &options.colorspace, "OCIO colour space of the output");
}

void add_input_colorspace(App& app, std::string& name) {
    app.text("--input-colorspace", "CS", &name,
             "OCIO colour space of the input; otherwise by its metadata, ICC profile or chromaticities, else sRGB for "
             "integer and linear Rec.709 for float files");
}

Status SelectionOptions::check() const {
    if (select.layer.empty() || select.channels.empty()) return {};
    return Error{ErrorKind::usage, "--layer excludes --channels: expected one of them"};
}

void add_selection_options(App& app, SelectionOptions& options, bool range) {
    app.add({.names = "--mip", .metavar = range ? "N|N:M" : "N",
             .text = range ? "read only this level of mip-mapped files, or each from N to M into a file of its own: {mip} in the output's name expands, "
                             "in a folder _mipN follows the stem"
                           : "read only this level of mip-mapped files",
             .range = "0..31", .default_value = "0", .set = [range, &options](std::string_view value) -> Status {
                 const auto wrong = [&] {
                     return Error{ErrorKind::usage, fmt::format("expected a mip level 0 to {}{}, got '{}'", deepest_level,
                                                                range ? ", or two with a colon in ascending order" : "", value)};
                 };
                 const auto level = [&](std::string_view text) -> std::optional<int> {
                     const auto number = parse_integer(text, 0, deepest_level);
                     return number ? std::optional<int>(static_cast<int>(*number)) : std::nullopt;
                 };
                 const auto colon = range ? value.find(':') : std::string_view::npos;
                 const auto first = level(value.substr(0, colon));
                 const auto last = colon == std::string_view::npos ? first : level(value.substr(colon + 1));
                 if (!first || !last || *first > *last) return wrong();
                 options.levels.clear();
                 for (int l = *first; l <= *last; ++l) options.levels.push_back(l);
                 return {};
             }});
    app.add({.names = "--layer", .metavar = "NAME",
             .text = "colour is this layer's: channels NAME.R, NAME.G, NAME.B (or NAME.Y), or those of the EXR part NAME; no other channel is read",
             .set = [&options](std::string_view value) -> Status {
                 if (value.empty()) return Error{ErrorKind::usage, "expected a layer's name, got an empty one"};
                 options.select.layer = value;
                 return {};
             }});
    app.add({.names = "--channels", .metavar = "R,G,B[,A]|Y[,A]",
             .text = "colour is in the channels of these names, in this order; no other channel is read",
             .set = [&options](std::string_view value) -> Status {
                 auto names = parse_list(value);
                 if (!names) return names.error();
                 if (names->size() > 4)
                     return Error{ErrorKind::usage, fmt::format("expected three channels or one, and perhaps alpha, got {}", names->size())};
                 options.select.channels = *std::move(names);
                 return {};
             }});
}

}  // namespace spectex::app
