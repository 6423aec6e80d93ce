// What spxinfo says of one file: header, colour space, and one pixel.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app.h"
#include "spectex/base.h"

namespace spectex::app {

using Rows = std::vector<std::pair<std::string, std::string>>;

/// The spectrum of a pixel.
struct PixelSpectrum {
    std::vector<double> wavelengths_nm, values;
    bool emissive = false;  ///< radiance rather than reflectance
};

/// Facts for people, and the same for scripts.
struct Facts {
    Rows rows;
    Json json;
    std::optional<PixelSpectrum> spectrum;         ///< with a position, where the file has spectra
    std::optional<Vector3> linear_bt709;           ///< of the pixel, for the colour of its curve
};

struct FactsRequest {
    std::optional<std::array<std::int64_t, 2>> at;  ///< x, y from the top left of the data window
    std::string input_colorspace;
    bool strict = false;  ///< a sample that is NaN or infinite is an error
    int threads = 0;
};

/// @error input, for what cannot be read, and for non-finite samples under `strict`; usage, for a position outside the image or a colour space that is not known.
Result<Facts> describe_file(const std::string& path, const FactsRequest& request);

}  // namespace spectex::app
