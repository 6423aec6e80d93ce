// What a texture file is for: colour that can be uplifted, or data that must not be.
//
// Three kinds of evidence are weighed, each a score for each use, and summed; the strongest use wins and its strongest
// witness gives the reason:
//   names     tokens of the file's name, cut at separators, digits and camelCase, as texture libraries write them; the last
//             telling token weighs most, folder names weigh a third. A token names a use by itself (`roughness`, `nor_gl`);
//             one or two letters (`n`, `s`, `ao`) count only at the end of the name, and only where the pixels agree or
//             say nothing;
//   metadata  what the header says: float channels in a 16-bit or float file, grey height maps, Radiance .hdr files,
//             image formats that hold photographs only, a declared colour space (an ICC profile or a space other than raw);
//   pixels    statistics of at most a few dozen rows: unit length and a blue mean for a tangent-space normal map, grey
//             only, two values only, one value only, ramps of a look-up table, few saturated flat colours.
// A rule of the caller's (`--treat-as`) stands above all. No statistics of pixels turn a file whose name states a colour use
// into data, but for a normal map's, which are unmistakable.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"
#include "spectex/io.h"

namespace spectex {

enum class TextureUse {
    color,         ///< reflectance: albedo, diffuse, base colour, photographs
    emission,      ///< radiance as colour: emissive maps; colour, though not a reflectance
    normal,        ///< tangent- or object-space normals
    roughness,     ///< or gloss
    metallic,
    displacement,  ///< height, bump, parallax
    occlusion,     ///< ambient occlusion, cavity, curvature, thickness
    mask,          ///< opacity, alpha, blend weights
    id,            ///< flat colours that name parts
    lut,           ///< look-up tables
    packed,        ///< several scalars in one image: ORM, ARM, metallic-roughness
    specular,      ///< specular level as a scalar
    environment,   ///< high-dynamic-range surroundings: light, not a surface
    data,          ///< something else that is no colour
};
/// "color", "normal", ...; the names that `--treat-as` and reports use.
SPECTEX_API std::string_view texture_use_name(TextureUse use);
/// @error usage, listing the names.
SPECTEX_API Result<TextureUse> parse_texture_use(std::string_view name);
/// Whether files of this use are uplifted: color and emission.
SPECTEX_API bool is_color(TextureUse use);

/// A rule of the user's: files whose path matches are of that use.
struct TreatAs {
    std::string pattern;  ///< fnmatch(3) pattern, tried on the path as given, on the path below the root, and on the name
    TextureUse use = TextureUse::color;
};
/// "PATTERN=USE", for example `*_mask*=mask` or `decals/*=color`; `data` is any data map.
/// @error usage, naming what is wrong.
SPECTEX_API Result<TreatAs> parse_treat_as(std::string_view text);

/// Statistics of a bounded sample of rows; samples as the file has them, integers scaled to [0,1].
struct PixelStatistics {
    std::uint64_t pixels = 0;             ///< looked at, not transparent
    int channels = 0;                     ///< of colour: 1 or 3
    std::array<double, 3> mean{}, deviation{};
    double grey = 0;                      ///< share of pixels whose channels differ by at most 2/255
    double unit_length = 0;               ///< share of pixels whose decoded length |2c - 1| is within 0.1 of 1
    double binary = 0;                    ///< share of pixels within 3/255 of black or of white in every channel
    double saturated = 0;                 ///< share of pixels with a saturation (max - min) / max over 0.9 and max over 0.3
    double largest_colors = 0;            ///< share of the 16 commonest colours (5 bits a channel)
    int distinct_colors = 0;              ///< of 15-bit colours, at most 32768
    double flat = 0;                      ///< share of pixels equal to their left neighbour
    double transparent = 0;               ///< share of all pixels with alpha 0
    double over_one = 0;                  ///< share of pixels with a sample over 1
    double negative = 0;                  ///< share of pixels with a sample under 0
    bool constant = false;
    bool lut = false;                     ///< a strip or square of slices in which red rises along x as an identity's does
};
/// @param rows  at most so many rows, spread evenly and in blocks of two; the whole file may have to be decoded for formats
///              that cannot seek, but memory stays bounded by a strip.
/// @error input.
SPECTEX_API Result<PixelStatistics> sample_pixels(ImageReader& reader, int rows = 64);

struct TextureVerdict {
    TextureUse use = TextureUse::color;
    bool by_option = false;   ///< a TreatAs rule decided
    double confidence = 1;    ///< share of the winner among the two strongest uses, 0.5 to 1
    std::string reason;       ///< one sentence
    bool color() const { return is_color(use); }
};

struct TextureUseOptions {
    std::string root;              ///< folder names above it say nothing; empty: only the file's own folder counts
    std::vector<TreatAs> treat_as; ///< the last that matches wins
    int sample_rows = 64;          ///< 0: names and metadata alone
    int threads = 1;
};

/// From evidence at hand. @param header, pixels  null where unknown.
SPECTEX_API TextureVerdict judge_texture(std::string_view path, const ImageHeader* header, const PixelStatistics* pixels,
                                         const TextureUseOptions& options = {});
/// Looks at the file; reads pixels only where no rule of the caller's has decided.
/// @error input: unreadable.
SPECTEX_API Result<TextureVerdict> classify_texture(const std::string& path, const TextureUseOptions& options = {});

}  // namespace spectex
