// Samples of files to planes of float, and back.
//
// Every kernel takes any n and pointers with no more than their type's own alignment, runs on the calling thread, and treats
// each sample alone: the bytes written depend neither on how the work is cut into calls nor on the instruction set. Samples
// on the file's side lie `stride` samples apart (1: planar). Half floats are passed as their 16 bits. Ranges must not overlap.
#pragma once

#include <cstddef>
#include <cstdint>

namespace spectex::kernels {

/// out[i] = table[src[i * stride]]. @param table  256 entries. @param out  [n].
void decode_codes(const std::uint8_t* src, std::size_t stride, std::size_t n, const float* table, float* out);
/// @param table  65536 entries.
void decode_codes(const std::uint16_t* src, std::size_t stride, std::size_t n, const float* table, float* out);

/// Exact; signalling NaNs become quiet and keep sign and payload.
void half_to_float(const std::uint16_t* src, std::size_t stride, std::size_t n, float* out);
void half_to_float_reference(const std::uint16_t* src, std::size_t stride, std::size_t n, float* out);
void gather_floats(const float* src, std::size_t stride, std::size_t n, float* out);

/// Rounds to nearest, ties to even, subnormal halves included; from 65520 on magnitudes become infinite, as IEEE 754
/// demands; a NaN stays a (quiet) NaN. @return how many finite values became infinite.
std::size_t float_to_half(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride);
std::size_t float_to_half_reference(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride);
void scatter_floats(const float* src, std::size_t n, float* out, std::size_t stride);

/// Code = floor(value * 255 + 1/2) clipped to 0..255, evaluated in double, where it is exact for every float; NaN becomes 0.
/// @return how many samples no code stands for: NaN, or more than half a code outside [0,1].
std::size_t quantize(const float* src, std::size_t n, std::uint8_t* out, std::size_t stride);
std::size_t quantize_reference(const float* src, std::size_t n, std::uint8_t* out, std::size_t stride);
/// The same with 65535.
std::size_t quantize(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride);
std::size_t quantize_reference(const float* src, std::size_t n, std::uint16_t* out, std::size_t stride);

}  // namespace spectex::kernels
