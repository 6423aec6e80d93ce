#include <fmt/format.h>

#include "spectex/spectral.h"
#include "spectral/names.h"

namespace spectex {

const std::vector<RgbSpace>& rgb_spaces() {
    static const std::vector<RgbSpace> spaces = {
        {"BT.709", {{{0.64, 0.33}, {0.30, 0.60}, {0.15, 0.06}}}, {0.3127, 0.3290}, "D65", "ITU-R BT.709-6; IEC 61966-2-1"},
        {"Display P3", {{{0.680, 0.320}, {0.265, 0.690}, {0.150, 0.060}}}, {0.3127, 0.3290}, "D65", "SMPTE EG 432-1; Apple"},
        {"Adobe RGB", {{{0.64, 0.33}, {0.21, 0.71}, {0.15, 0.06}}}, {0.3127, 0.3290}, "D65", "Adobe RGB (1998), 2005-05"},
        {"Rec.2020", {{{0.708, 0.292}, {0.170, 0.797}, {0.131, 0.046}}}, {0.3127, 0.3290}, "D65", "ITU-R BT.2020-2"},
        {"ACEScg", {{{0.713, 0.293}, {0.165, 0.830}, {0.128, 0.044}}}, {0.32168, 0.33767}, "D60", "S-2014-004 (AP1)"},
        {"ACES2065-1", {{{0.7347, 0.2653}, {0.0, 1.0}, {0.0001, -0.0770}}}, {0.32168, 0.33767}, "D60", "SMPTE ST 2065-1 (AP0)"},
        {"ProPhoto", {{{0.734699, 0.265301}, {0.159597, 0.840403}, {0.036598, 0.000105}}}, {0.345704, 0.358540}, "D50",
         "ISO 22028-2 (ROMM RGB)"},
        {"PAL/SECAM", {{{0.64, 0.33}, {0.29, 0.60}, {0.15, 0.06}}}, {0.3127, 0.3290}, "D65", "ITU-R BT.470-6; EBU Tech 3213"},
    };
    return spaces;
}

Result<RgbSpace> find_rgb_space(std::string_view name) {
    static constexpr std::pair<const char*, const char*> aliases[] = {
        {"srgb", "BT.709"},      {"rec709", "BT.709"},      {"linrec709", "BT.709"}, {"709", "BT.709"},
        {"p3", "Display P3"},    {"p3d65", "Display P3"},   {"dcip3d65", "Display P3"}, {"adobergb1998", "Adobe RGB"},
        {"bt2020", "Rec.2020"},  {"2020", "Rec.2020"},      {"ap1", "ACEScg"},       {"acescgap1", "ACEScg"},
        {"ap0", "ACES2065-1"},   {"aces", "ACES2065-1"},    {"aces20651ap0", "ACES2065-1"}, {"prophotorgb", "ProPhoto"},
        {"romm", "ProPhoto"},    {"rommrgb", "ProPhoto"},   {"pal", "PAL/SECAM"},    {"secam", "PAL/SECAM"},
        {"ebu", "PAL/SECAM"},    {"bt470bg", "PAL/SECAM"},
    };
    auto wanted = folded_name(name);
    for (const auto& [alias, target] : aliases)
        if (wanted == alias) wanted = folded_name(target);
    std::string known;
    for (const auto& space : rgb_spaces()) {
        if (wanted == folded_name(space.name)) return space;
        known += (known.empty() ? "" : ", ") + space.name;
    }
    return Error{ErrorKind::usage, fmt::format("RGB space '{}' is not known: expected one of {}", name, known)};
}

Vector3 xyz_from_xy(double x, double y) { return {x / y, 1, (1 - x - y) / y}; }

Matrix3 rgb_to_xyz_matrix(const RgbSpace& space, const Vector3& white_xyz) {
    Matrix3 primaries;
    for (std::size_t j = 0; j < 3; ++j) {
        const auto [x, y] = space.primaries_xy[j];
        // AP0's green has y = 1 and its blue a negative one: x, y, z themselves are as good a scale as any.
        primaries(0, j) = x;
        primaries(1, j) = y;
        primaries(2, j) = 1 - x - y;
    }
    const Vector3 scale = primaries.inverse() * white_xyz;
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j) primaries(i, j) *= scale[j];
    return primaries;
}

}  // namespace spectex
