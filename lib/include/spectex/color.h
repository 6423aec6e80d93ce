// Colour encodings and spaces: which space a file is in, and linear RGB from it.
//
// The sRGB curve is the IEC's (61966-2-1), ours, right to float rounding; everything else goes through OpenColorIO with the
// configuration of luts/ocio, or $OCIO when set, or through the file's ICC profile. No exception of a colour library passes
// this room. NaN and infinities pass through unchanged.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"
#include "spectex/io.h"
#include "spectex/spectral.h"

namespace spectex {

/// IEC 61966-2-1 curve, code value in [0,1] to linear; odd beyond (negative values mirror). Double.
SPECTEX_API double srgb_decode(double encoded);
SPECTEX_API double srgb_encode(double linear);

/// Which colour space an input is taken to be in, and why; `--explain` prints both.
struct ColorSpaceChoice {
    std::string name;    ///< OCIO name, or "ICC profile: <description>"
    std::string reason;  ///< "by option", "EXR chromaticities", "ICC profile", "integer file without a tag", ...
    bool icc = false;    ///< convert by the file's profile
    std::optional<std::array<double, 8>> chromaticities;  ///< linear RGB of these primaries, when no named space matches
};
/// By option; else metadata, ICC, EXR chromaticities; else sRGB for integer files and linear Rec.709 for float ones.
/// @error usage, when the named space is in no configuration: the message lists near names.
SPECTEX_API Result<ColorSpaceChoice> choose_input_space(const ImageHeader& header, std::string_view by_option);

/// From a file's samples to linear RGB of an RgbSpace, or back from linear RGB to an output space.
class SPECTEX_API ColorTransform {
public:
    virtual ~ColorTransform();
    /// From the choice to linear RGB. `adapt_white`: spaces of other whites are adapted by Bradford (as ICC and OCIO do).
    static Result<std::unique_ptr<ColorTransform>> to_linear(const ColorSpaceChoice& from, const ImageHeader& header,
                                                             const RgbSpace& to);
    /// From linear RGB of a space to an OCIO space by name.
    static Result<std::unique_ptr<ColorTransform>> from_linear(const RgbSpace& from, std::string_view to);

    virtual bool is_identity() const = 0;
    /// True when each component depends on itself alone: 8- and 16-bit files are then decoded by a table of `apply`.
    virtual bool is_per_channel() const = 0;
    /// In place; n pixels in three planes.
    virtual void apply(std::array<float*, 3> rgb, std::size_t n) const = 0;
    /// What it does, for --explain: "sRGB curve (IEC 61966-2-1)", "OCIO: Display P3 -> linear Rec.709", ...
    virtual std::string describe() const = 0;
};

/// Linear Rec.709, the interchange of previews and relit float files, as an OCIO name.
SPECTEX_API std::string_view linear_rec709_name();
SPECTEX_API std::string_view srgb_name();
/// OCIO name of an RgbSpace's linear space in the library's configuration.
SPECTEX_API std::string_view linear_space_name(const RgbSpace& space);

enum class Adaptation { none, vonkries, bradford, cat02, cat16 };
/// @error usage, listing the names.
SPECTEX_API Result<Adaptation> parse_adaptation(std::string_view name);
/// XYZ to XYZ from one white to another, each with Y = 1. Sources: von Kries with Hunt-Pointer-Estevez; Bradford as ICC.1
/// annex E; CAT02, CIE 159:2004; CAT16, Li et al. 2017.
/// @error input, when the source white has a cone response of zero or less (near-monochromatic lamps).
SPECTEX_API Result<Matrix3> adaptation_matrix(Adaptation method, const Vector3& from_white, const Vector3& to_white);

}  // namespace spectex
