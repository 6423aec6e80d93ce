// Spectra to halves whose integrals stay right.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace spectex::kernels {

/// Rounds reflectances to half so that the rounding errors of a pixel's bands do not add up in three integrals. Bands are
/// rounded to nearest; where a pixel's integrals lose more by that than a small bound, its bands are rounded once more, each
/// after adding what would cancel the error that the bands before it left (error diffusion, as Floyd and Steinberg 1976 in space, here over wavelength with vector
/// errors), at most one unit in the last place. Errors count relative to their component, so that a dark one is kept as well. Bands go from the largest weights to the smallest, so that the last ones
/// leave next to nothing. Values stay in [0, 1] where they were.
///
/// Pixels are independent; the bytes depend neither on how the work is cut nor on the instruction set.
class HalfSpectraRounder {
public:
    /// @param weights  [3][bands] row-major: the integrals that matter.
    HalfSpectraRounder(std::span<const double> weights, std::size_t bands);
    /// @param in   [bands] planes of n. @param out  [bands] planes of n halves.
    void operator()(const float* const* in, std::size_t n, std::uint16_t* const* out) const;
    void reference(const float* const* in, std::size_t n, std::uint16_t* const* out) const;

private:
    std::size_t bands_;
    std::vector<std::size_t> order_;
    std::vector<float> weights_;  ///< [bands in order][3]
};

}  // namespace spectex::kernels
