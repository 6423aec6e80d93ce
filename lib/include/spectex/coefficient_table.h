// Tables of sigmoid coefficients over the RGB cube, as Mitsuba and rgb2spec keep them in `.coeff` files.
//
// File, little-endian: "SPEC", uint32 resolution, float scale[resolution], float data[3][resolution][resolution][resolution][3].
// A colour's block is the index of its largest component z; within it the axes are z (slowest, at scale[k]), then the
// component after the next, then the next one (cyclically), both over z and even in [0,1]; last the three coefficients
// c0, c1, c2 of r = S(c0 l^2 + c1 l + c2), with l in nm.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"
#include "spectex/spectral.h"

namespace spectex {

struct CoefficientTable {
    static constexpr std::size_t max_resolution = 256;

    std::size_t resolution = 0;
    std::vector<float> scale;  ///< [resolution], ascending
    std::vector<float> data;   ///< [3][resolution]^3[3], coefficients in nm

    /// Coefficients of one colour by trilinear interpolation, in nm.
    /// @param rgb  linear; clamped to [0,1], NaN to 0.
    Vector3 fetch(const Vector3& rgb) const;
};

/// Solves the table of a Colorimetry: every vertex exactly where its colour has a sigmoid, else the sigmoid nearest in
/// CIELab. Scale is smoothstep(smoothstep(k / (resolution - 1))). Black and white, whose sigmoids would be infinite, hold
/// those of 1/64 of the first step of the scale, and of its complement.
/// @error usage, unless resolution is in 2..max_resolution.
/// Source: Jakob and Hanika 2019, section 4, doi:10.1111/cgf.13626.
SPECTEX_API Result<CoefficientTable> make_coefficient_table(const Colorimetry& colorimetry, std::size_t resolution = 64);

/// A `.coeff` file's bytes as a table.
/// @param label  for messages.
/// @error input, unless the length is what the resolution asks for, the scale ascends strictly within [0,1] and every
///        number is finite.
SPECTEX_API Result<CoefficientTable> parse_coefficient_table(std::string_view bytes, std::string_view label);
SPECTEX_API Result<CoefficientTable> read_coefficient_table(const std::string& path);
/// The bytes of a `.coeff` file.
SPECTEX_API std::string coefficient_table_bytes(const CoefficientTable& table);
/// Writes a `.coeff` file beside its name and renames it. @error output, naming the path.
SPECTEX_API Status write_coefficient_table(const CoefficientTable& table, const std::string& path);

}  // namespace spectex
