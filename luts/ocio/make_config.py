#!/usr/bin/env python3
"""Writes spectex.ocio beside itself. The chromaticities are read from the library's one table of RGB spaces."""
import os
import re

HERE = os.path.dirname(os.path.abspath(__file__))
TABLE = os.path.join(HERE, "..", "..", "lib", "spectral", "rgb_spaces.cpp")

# Name, aliases, RGB space, curve, description. Names and aliases are those of the ACES/OCIO studio configurations where
# these have the space.
SPACES = [
    ("CIE XYZ-D65 - Scene-referred", ["lin_ciexyzd65_scene", "CIE XYZ-D65", "CIE XYZ (D65)", "CIE XYZ", "XYZ"], "XYZ", "linear",
     "CIE 1931 XYZ, Y = 1 for the white 0.3127, 0.3290; the reference space"),
    ("ACES2065-1", ["aces2065_1", "lin_ap0", "lin_ap0_scene", "ap0", "ACES - ACES2065-1"], "ACES2065-1", "linear",
     "SMPTE ST 2065-1, AP0"),
    ("ACEScg", ["lin_ap1", "lin_ap1_scene", "ap1", "ACES - ACEScg"], "ACEScg", "linear", "S-2014-004, AP1"),
    ("Linear Rec.709 (sRGB)", ["lin_rec709", "lin_rec709_srgb", "lin_rec709_scene", "lin_srgb", "Linear Rec.709", "linear",
                               "Utility - Linear - sRGB", "Utility - Linear - Rec.709"], "BT.709", "linear",
     "linear, primaries of ITU-R BT.709"),
    ("Linear P3-D65", ["lin_p3d65", "lin_p3d65_scene", "lin_displayp3", "Linear Display P3", "Utility - Linear - P3-D65"],
     "Display P3", "linear", "linear, primaries of Display P3"),
    ("Linear Rec.2020", ["lin_rec2020", "lin_rec2020_scene", "Utility - Linear - Rec.2020"], "Rec.2020", "linear",
     "linear, primaries of ITU-R BT.2020"),
    ("Linear AdobeRGB", ["lin_adobergb", "lin_adobergb_scene", "Utility - Linear - Adobe RGB"], "Adobe RGB", "linear",
     "linear, primaries of Adobe RGB (1998)"),
    ("Linear ProPhoto", ["lin_prophoto", "lin_romm", "Linear ROMM RGB"], "ProPhoto", "linear",
     "linear, primaries of ROMM RGB (ISO 22028-2)"),
    ("Linear PAL-SECAM", ["lin_pal", "lin_ebu", "lin_bt470bg", "PAL/SECAM"], "PAL/SECAM", "linear",
     "linear, primaries of EBU Tech 3213"),
    ("sRGB - Texture", ["sRGB", "srgb_texture", "srgb_tx", "srgb_rec709_scene", "sRGB Encoded Rec.709 (sRGB)",
                        "Utility - sRGB - Texture", "Input - Generic - sRGB - Texture"], "BT.709", "srgb", "IEC 61966-2-1"),
    ("sRGB Encoded P3-D65 - Texture", ["srgb_encoded_p3d65_tx", "srgb_p3d65_scene", "sRGB Encoded P3-D65", "Display P3",
                                       "displayp3"], "Display P3", "srgb", "Display P3 with the curve of sRGB"),
    ("Adobe RGB (1998)", ["Adobe RGB", "adobergb", "adobergb1998"], "Adobe RGB", 563 / 256, "Adobe RGB (1998), gamma 563/256"),
    ("ProPhoto RGB", ["ProPhoto", "ROMM RGB", "romm"], "ProPhoto", 1.8,
     "gamma 1.8; the linear toe of ISO 22028-2 below 1/512 is added by the library, since no transform of this version has it"),
    ("Camera Rec.709", ["rec709_camera", "rec709", "BT.709"], "BT.709", "bt709", "ITU-R BT.709 camera curve"),
    ("Camera Rec.2020", ["rec2020_camera", "rec2020", "Rec.2020", "BT.2020"], "Rec.2020", "bt709",
     "ITU-R BT.2020 camera curve"),
    ("Gamma 1.8 Rec.709 - Texture", ["g18_rec709_tx", "g18_rec709", "g18_rec709_scene"], "BT.709", 1.8, "gamma 1.8"),
    ("Gamma 2.2 Rec.709 - Texture", ["g22_rec709_tx", "g22_rec709", "g22_rec709_scene"], "BT.709", 2.2, "gamma 2.2"),
    ("Gamma 2.4 Rec.709 - Texture", ["g24_rec709_tx", "g24_rec709", "g24_rec709_scene"], "BT.709", 2.4, "gamma 2.4"),
]
CURVES = {
    "srgb": "!<ExponentWithLinearTransform> {gamma: 2.4, offset: 0.055, style: mirror}",
    "bt709": "!<ExponentWithLinearTransform> {gamma: 2.2222222222222222, offset: 0.09929682680944, style: mirror}",
}
BRADFORD = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
D65 = (0.3127, 0.3290)


def multiply(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(len(b[0]))] for i in range(3)]


def inverse(m):
    def cofactor(i, j):
        a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return m[a][c] * m[b][d] - m[a][d] * m[b][c]
    determinant = sum(m[0][j] * cofactor(0, j) for j in range(3))
    return [[cofactor(j, i) / determinant for j in range(3)] for i in range(3)]


def white_xyz(xy):
    return [[xy[0] / xy[1]], [1.0], [(1 - xy[0] - xy[1]) / xy[1]]]


def diagonal(values):
    return [[values[i] if i == j else 0.0 for j in range(3)] for i in range(3)]


def rgb_to_xyz_d65(primaries, white):
    """SMPTE RP 177-1993 section 3, then Bradford to D65 where the white is another."""
    columns = [[p[0] for p in primaries], [p[1] for p in primaries], [1 - p[0] - p[1] for p in primaries]]
    scale = multiply(inverse(columns), white_xyz(white))
    matrix = multiply(columns, diagonal([s[0] for s in scale]))
    if white != D65:
        source, target = multiply(BRADFORD, white_xyz(white)), multiply(BRADFORD, white_xyz(D65))
        gains = diagonal([target[i][0] / source[i][0] for i in range(3)])
        matrix = multiply(multiply(multiply(inverse(BRADFORD), gains), BRADFORD), matrix)
    return matrix


def read_table():
    number = r"(-?[0-9.]+)"
    pair = r"\{" + number + r",\s*" + number + r"\}"
    row = re.compile(r'\{"([^"]+)",\s*\{\{' + pair + r",\s*" + pair + r",\s*" + pair + r"\}\},\s*" + pair)
    spaces = {}
    for found in row.finditer(open(TABLE, encoding="utf-8").read()):
        v = [float(x) for x in found.groups()[1:]]
        spaces[found.group(1)] = ([(v[0], v[1]), (v[2], v[3]), (v[4], v[5])], (v[6], v[7]))
    return spaces


def main():
    table = read_table()
    out = ["# Made by make_config.py; not to be edited by hand.", "ocio_profile_version: 2", "", "environment: {}",
           "search_path: \"\"", "strictparsing: true", "luma: [0.2126, 0.7152, 0.0722]",
           "name: spectex", "description: Colour spaces of textures, about CIE XYZ of D65", "", "roles:",
           "  aces_interchange: ACES2065-1", "  color_picking: sRGB - Texture", "  data: Raw", "  default: Raw",
           "  scene_linear: Linear Rec.709 (sRGB)", "  texture_paint: sRGB - Texture", "", "file_rules:",
           "  - !<Rule> {name: Default, colorspace: default}", "", "displays:", "  sRGB:",
           "    - !<View> {name: Standard, colorspace: sRGB - Texture}", "    - !<View> {name: Raw, colorspace: Raw}", "",
           "active_displays: []", "active_views: []", "", "colorspaces:"]
    for name, aliases, rgb, curve, description in SPACES:
        encoding = "scene-linear" if curve == "linear" else "sdr-video"
        family = "Linear" if curve == "linear" else "Texture"
        out += ["  - !<ColorSpace>", f"    name: {name}", "    aliases: [" + ", ".join(aliases) + "]", f"    family: {family}",
                "    equalitygroup: \"\"", "    bitdepth: 32f", f"    description: {description}", "    isdata: false",
                f"    encoding: {encoding}", "    allocation: uniform"]
        steps = []
        if isinstance(curve, float):
            steps.append(f"!<ExponentTransform> {{value: {curve!r}, style: mirror}}")
        elif curve != "linear":
            steps.append(CURVES[curve])
        if rgb != "XYZ":
            matrix = rgb_to_xyz_d65(*table[rgb])
            rows = ", ".join(", ".join(repr(v) for v in row) + ", 0" for row in matrix)
            steps.append(f"!<MatrixTransform> {{matrix: [{rows}, 0, 0, 0, 1]}}")
        if len(steps) == 1:
            out.append("    to_scene_reference: " + steps[0])
        elif steps:
            out += ["    to_scene_reference: !<GroupTransform>", "      children:"] + ["        - " + s for s in steps]
        out.append("")
    out += ["  - !<ColorSpace>", "    name: Raw", "    aliases: [Utility - Raw, none, Non-Color]", "    family: Utility",
            "    equalitygroup: \"\"", "    bitdepth: 32f", "    description: numbers that are no colours", "    isdata: true",
            "    encoding: data", "    allocation: uniform", ""]
    with open(os.path.join(HERE, "spectex.ocio"), "w", encoding="utf-8") as file:
        file.write("\n".join(out))


if __name__ == "__main__":
    main()
