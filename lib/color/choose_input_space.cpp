#include <fmt/format.h>

#include "color/icc.h"
#include "color/spaces.h"
#include "spectral/names.h"

namespace spectex {
namespace {

bool is_linear_type(PixelType type) { return type == PixelType::half || type == PixelType::float32; }

ColorSpaceChoice choice(std::string_view name, std::string reason) {
    ColorSpaceChoice out;
    out.name = name;
    out.reason = std::move(reason);
    return out;
}

/// A known RgbSpace whose chromaticities are these within 1e-3: writers print three decimals, or pass through float.
const RgbSpace* space_of(const std::array<double, 8>& c) {
    for (const auto& space : rgb_spaces()) {
        double worst = 0;
        for (std::size_t i = 0; i < 4; ++i)
            for (std::size_t k = 0; k < 2; ++k) {
                const double expected = i < 3 ? space.primaries_xy[i][k] : space.white_xy[k];
                worst = std::max(worst, std::fabs(c[2 * i + k] - expected));
            }
        if (worst <= 1e-3) return &space;
    }
    return nullptr;
}

/// Whether these chromaticities span a triangle with a white that has luminance.
bool usable(const std::array<double, 8>& c) {
    for (const double v : c)
        if (!std::isfinite(v) || std::fabs(v) > 10) return false;
    const double area = (c[2] - c[0]) * (c[5] - c[1]) - (c[4] - c[0]) * (c[3] - c[1]);
    if (!(std::fabs(area) > 1e-3) || !(c[7] > 0.01) || !(c[6] > 0.01) || !(c[6] + c[7] < 0.99)) return false;
    // The white must be a mixture of positive amounts; AP0's imaginary primaries pass.
    RgbSpace space;
    space.primaries_xy = {{{c[0], c[1]}, {c[2], c[3]}, {c[4], c[5]}}};
    const auto white = xyz_from_xy(c[6], c[7]);
    const auto matrix = rgb_to_xyz_matrix(space, white);
    for (std::size_t j = 0; j < 3; ++j)
        if (!(matrix(0, j) + matrix(1, j) + matrix(2, j) > 1e-6)) return false;
    return true;
}

}  // namespace

Result<ColorSpaceChoice> choose_input_space(const ImageHeader& header, std::string_view by_option) {
    if (!by_option.empty()) {
        const auto found = color::resolve_space(by_option);
        if (!found) return found.error();
        return choice(found->name, found->note.empty() ? "by option" : "by option: " + found->note);
    }
    // An unreadable $OCIO is a mistake to be told of, even where a file's own tag would do without it.
    if (const auto user = color::user_config(); !user) return user.error();

    const auto& hints = header.color_hints;
    const bool linear_type = is_linear_type(header.type);
    const bool exr = header.format == "openexr";
    std::string ignored;
    const auto ignore = [&ignored](const std::string& why) { ignored += "; " + why; };

    const auto by_icc = [&]() -> std::optional<ColorSpaceChoice> {
        if (hints.icc_profile.empty()) return std::nullopt;
        const auto profile = color::IccProfile::read(hints.icc_profile);
        if (!profile) {
            ignore(profile.error().message + " and is ignored");
            return std::nullopt;
        }
        const auto& icc = **profile;
        if (icc.is_grey() && header.has_color() && !header.is_grey()) {
            ignore(fmt::format("the ICC profile '{}' is for grey and is ignored for an image in colour", icc.description()));
            return std::nullopt;
        }
        if (!icc.known_name().empty())
            return choice(icc.known_name(), fmt::format("ICC profile '{}', whose {} those of this space", icc.description(),
                                                        icc.is_grey() ? "curve is" : "colorants and curves are"));
        auto out = choice("ICC profile: " + icc.description(), "ICC profile of the file");
        out.icc = true;
        return out;
    };
    const auto by_chromaticities = [&]() -> std::optional<ColorSpaceChoice> {
        // They give the primaries alone; the samples of an integer file are encoded by a curve that they do not tell.
        if (!hints.chromaticities || !linear_type) return std::nullopt;
        if (!usable(*hints.chromaticities)) {
            ignore("chromaticities that are no RGB space are ignored");
            return std::nullopt;
        }
        if (const auto* space = space_of(*hints.chromaticities))
            return choice(linear_space_name(*space), fmt::format("chromaticities of the file, those of {}", space->name));
        const auto& c = *hints.chromaticities;
        auto out = choice(fmt::format("linear RGB of R {:.4g} {:.4g}, G {:.4g} {:.4g}, B {:.4g} {:.4g}, white {:.4g} {:.4g}", c[0],
                                      c[1], c[2], c[3], c[4], c[5], c[6], c[7]),
                          "chromaticities of the file");
        out.chromaticities = hints.chromaticities;
        return out;
    };
    const auto by_declaration = [&]() -> std::optional<ColorSpaceChoice> {
        if (hints.declared.empty()) return std::nullopt;
        const auto folded = folded_name(hints.declared);
        // OIIO says "Linear" and "scene_linear" of any linear file: the primaries are told by chromaticities, if at all.
        const bool merely_linear = folded == "linear" || folded == "scenelinear" || folded == "lin";
        if (merely_linear) {
            if (auto precise = by_chromaticities()) return precise;
            return choice(linear_rec709_name(), fmt::format("the file declares '{}'", hints.declared));
        }
        const auto found = color::resolve_space(hints.declared);
        if (!found) {
            ignore(fmt::format("the file's colour space '{}' is not known and is ignored", hints.declared));
            return std::nullopt;
        }
        return choice(found->name, fmt::format("the file declares '{}'", hints.declared));
    };

    // PNG (third edition, 4.3) and common practice let a profile override a name of the same file: libraries put
    // "sRGB" on every JPEG. In EXR the declared name and the chromaticities are the format's own means.
    std::optional<ColorSpaceChoice> found;
    if (exr) {
        found = by_declaration();
        if (!found) found = by_chromaticities();
        if (!found) found = by_icc();
    } else {
        found = by_icc();
        if (!found) found = by_declaration();
        if (!found) found = by_chromaticities();
    }
    if (!found && hints.gamma && std::isfinite(*hints.gamma)) {
        const double gamma = *hints.gamma;
        if (std::fabs(gamma - 1) < 5e-3)
            found = choice(linear_rec709_name(), fmt::format("the file's gamma of {:g}", gamma));
        else if (!linear_type && std::fabs(gamma - 2.2) < 5e-3)
            // PNG's table 12 has writers of sRGB put a gamma of 1/2.2 for readers that do not know the sRGB chunk.
            found = choice(srgb_name(), fmt::format("the file's gamma of {:g}, as sRGB files give it", gamma));
        else if (const auto resolved = color::resolve_space(fmt::format("gamma {:g}", gamma)))
            found = choice(resolved->name, fmt::format("the file's gamma of {:g}", gamma));
        else
            ignore(fmt::format("a gamma of {:g} is ignored", gamma));
    }
    if (!found)
        found = linear_type ? choice(linear_rec709_name(), "floating-point file without a usable tag")
                            : choice(srgb_name(), "integer file without a usable tag");
    found->reason += ignored;
    return *found;
}

}  // namespace spectex
