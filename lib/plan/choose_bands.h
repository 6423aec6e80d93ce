// The fewest bands that show a texture right under given lights.
#pragma once

#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "spectex/methods.h"
#include "spectex/spectral.h"

namespace spectex {

struct BandChoice {
    std::shared_ptr<const Model> model;      ///< on the chosen bands
    std::shared_ptr<const Model> reference;  ///< the same method on the library's own grid
    double error = 0;                        ///< largest CIE76 of the colours, over the round trip and the lights
    std::size_t colors = 0;
};

/// Finds few bands, at uneven positions, such that the method on them, lit by the file's own weights, agrees with the method
/// on 380:780:5 within `bound` for every one of the colours. The lattice's vertices are fitted to the band set: of all
/// reflectances in [0,1] of the exact colour, the one whose relit colours are nearest. Positions grow one by one and are
/// exchanged on a raster of 5 nm while that helps. Other methods are solved on even sets as they are.
/// @param rgb    [n][3] linear, in [0,1].
/// @param least  bands to begin with.
/// @error input, when the library's own grid is needed.
Result<BandChoice> choose_bands(std::string_view method, const ColorimetrySpec& spec, const std::vector<Illuminant>& lights,
                                double bound, std::span<const float> rgb, std::size_t least);

}  // namespace spectex
