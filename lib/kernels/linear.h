// Linear maps of pixels in planes: 3x3 matrices, spectra from three primaries, integrals of spectra.
//
// Every kernel takes any n and pointers with no more than their type's own alignment, runs on the calling thread, and treats
// each pixel alone: the bytes written depend neither on how the work is cut into calls nor on the instruction set (no fused
// multiply-add; the payload of a NaN is not specified). Terms are summed from left to right.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "spectex/base.h"

namespace spectex::kernels {

/// out = m in, in double, rounded once. A plane of `out` may be the same plane of `in`; otherwise no overlap.
void matrix3(const Matrix3& m, std::array<const float*, 3> in, std::size_t n, std::array<float*, 3> out);
void matrix3_reference(const Matrix3& m, std::array<const float*, 3> in, std::size_t n, std::array<float*, 3> out);

/// Bands band_begin .. band_end-1 of sum_i rgb_i basis_i, in double, rounded once.
/// @param basis   [3][bands] row-major.
/// @param planes  [band_end - band_begin], each [n].
void combine_basis(std::array<const float*, 3> rgb, std::size_t n, std::span<const double> basis, std::size_t band_begin,
                   std::size_t band_end, float* const* planes);
void combine_basis_reference(std::array<const float*, 3> rgb, std::size_t n, std::span<const double> basis,
                             std::size_t band_begin, std::size_t band_end, float* const* planes);
/// The same as halves, summed in float: before the rounding to half the error is at most 4 * 2^-24 * sum_i |rgb_i basis_i|
/// (a rounding each of the basis, of the product and of two sums), 1/2048 of half a unit in the last place of the half
/// when the terms share a sign.
void combine_basis(std::array<const float*, 3> rgb, std::size_t n, std::span<const double> basis, std::size_t band_begin,
                   std::size_t band_end, std::uint16_t* const* planes);

/// out_j = sum_l weights[j][l] bands_l, summed in double in the order of the bands.
/// @param bands    planes of n each; a null plane counts as zero.
/// @param weights  [rows][bands] row-major.
/// @param out      [rows] planes of n each.
void integrate_bands(std::span<const float* const> bands, std::size_t n, std::span<const double> weights, std::size_t rows,
                     float* const* out);
void integrate_bands(std::span<const float* const> bands, std::size_t n, std::span<const double> weights, std::size_t rows,
                     double* const* out);
void integrate_bands_reference(std::span<const float* const> bands, std::size_t n, std::span<const double> weights,
                               std::size_t rows, double* const* out);

}  // namespace spectex::kernels
