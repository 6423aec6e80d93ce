// What the README shows: one colour to a spectrum and back.
#include <cmath>
#include <cstdio>
#include <vector>

#include "spectex/spectex.h"

int main() {
    const auto colorimetry = spectex::Colorimetry::make({}, spectex::BandSet());
    if (!colorimetry) return std::puts(colorimetry.error().message.c_str()), 2;
    const auto model = spectex::make_model("mallett2019", *colorimetry);
    if (!model) return std::puts(model.error().message.c_str()), 2;

    const std::vector<double> rgb{0.8, 0.3, 0.1};
    std::vector<double> reflectance(colorimetry->bands().size());
    (*model)->reflectance(rgb, reflectance);
    const auto back = colorimetry->rgb_of(reflectance);
    std::printf("%g %g %g\n", back[0], back[1], back[2]);
    for (int i = 0; i < 3; ++i)
        if (std::fabs(back[i] - rgb[i]) > 1e-12) return 1;
    return 0;
}
