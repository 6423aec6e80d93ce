// Names of colour spaces as options and headers give them.
#include <cmath>

#include "fuzz.h"
#include "spectex/color.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const std::string name(spectex::fuzz::text_of(data, size));
    static const auto space = *spectex::find_rgb_space("BT.709");
    const auto run = [](const spectex::ColorTransform& transform) {
        float r[] = {0, 1e-30f, 0.25f, 1, 2, -1}, g[] = {0, 0.5f, 0.25f, 1, 0, 1}, b[] = {0, 0.75f, 0.25f, 1, 0.5f, 3};
        transform.apply({r, g, b}, 6);
        SPECTEX_FUZZ_CHECK(!transform.describe().empty());
        // Middle grey has a finite value in whatever has a name.
        SPECTEX_FUZZ_CHECK(std::isfinite(r[2]) && std::isfinite(g[2]) && std::isfinite(b[2]));
    };
    for (const bool declared : {false, true}) {
        spectex::ImageHeader header;
        header.path = "image.exr";
        header.type = spectex::PixelType::float32;
        header.channels = {"R", "G", "B"};
        header.color = {0, 1, 2};
        if (declared) header.color_hints.declared = name;
        const auto choice = spectex::choose_input_space(header, declared ? "" : name);
        if (!choice) {
            SPECTEX_FUZZ_CHECK(!choice.error().message.empty() && choice.error().message.size() < name.size() + 4000);
            continue;
        }
        const auto transform = spectex::ColorTransform::to_linear(*choice, header, space);
        if (transform) run(**transform);
    }
    if (const auto transform = spectex::ColorTransform::from_linear(space, name)) run(**transform);
    (void)spectex::parse_adaptation(name);
    return 0;
}
