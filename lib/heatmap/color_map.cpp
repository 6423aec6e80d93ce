#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>

#include <algorithm>
#include <cmath>
#include <exception>

#include "spectex/color.h"
#include "spectex/heatmap.h"

namespace spectex {
namespace {

constexpr std::array<std::string_view, 8> names{"magma", "inferno",  "plasma",   "viridis",
                                                "turbo", "blue-red", "spectrum", "heat"};

}  // namespace

std::string_view default_color_map() { return names[0]; }

std::vector<std::string> color_map_names() { return {names.begin(), names.end()}; }

Result<ColorMap> find_color_map(std::string_view name) {
    if (std::find(names.begin(), names.end(), name) == names.end()) {
        std::string message = "there is no colour map \"" + std::string(name) + "\"; the names are";
        for (const auto n : names) message += (n == names.front() ? " " : ", ") + std::string(n);
        return Error{ErrorKind::usage, message};
    }
    ColorMap map;
    map.name = name;
    try {
        OIIO::ImageSpec ramp_spec(256, 1, 1, OIIO::TypeDesc::FLOAT);
        std::array<float, 256> ramp{};
        for (std::size_t i = 0; i < ramp.size(); ++i) ramp[i] = static_cast<float>(i) / 255.0F;
        const OIIO::ImageBuf source(ramp_spec, ramp.data());
        const OIIO::ImageBuf colored =
            OIIO::ImageBufAlgo::color_map(source, 0, OIIO::string_view(name.data(), name.size()), {}, 1);
        std::array<float, 256 * 3> rgb{};
        if (colored.has_error() || colored.nchannels() != 3 ||
            !colored.get_pixels(OIIO::ROI(0, 256, 0, 1, 0, 1, 0, 3), OIIO::TypeDesc::FLOAT, rgb.data()))
            return Error{ErrorKind::input,
                         "OpenImageIO has no colour map \"" + map.name + "\": " + colored.geterror()};
        // OpenImageIO returns linear light: encoded, viridis runs from (68,1,84) to (253,231,37) as its authors publish it.
        for (std::size_t i = 0; i < map.codes.size(); ++i)
            for (std::size_t c = 0; c < 3; ++c)
                map.codes[i][c] = static_cast<std::uint8_t>(
                    std::lround(srgb_encode(std::clamp(static_cast<double>(rgb[3 * i + c]), 0.0, 1.0)) * 255));
    } catch (const std::exception& e) {
        return Error{ErrorKind::input, "OpenImageIO's colour map \"" + map.name + "\" failed: " + e.what()};
    }
    return map;
}

}  // namespace spectex
