#include <cmath>
#include <vector>

#include "fuzz.h"
#include "spectex/methods.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const auto model = spectex::make_model_from_json(spectex::fuzz::text_of(data, size));
    if (!model) {
        SPECTEX_FUZZ_CHECK(!model.error().message.empty());
        return 0;
    }
    const std::size_t bands = (*model)->colorimetry().bands().size();
    const std::vector<double> rgb{0, 0, 0, 1, 1, 1, 1, 0, 0, 0.2, 0.5, 0.8};
    std::vector<double> spectra(rgb.size() / 3 * bands);
    (*model)->reflectance(rgb, spectra);
    for (const double r : spectra) SPECTEX_FUZZ_CHECK(std::isfinite(r));
    // What a file carries is read back as the same model.
    const auto text = (*model)->to_json();
    const auto again = spectex::make_model_from_json(text);
    SPECTEX_FUZZ_CHECK(again && (*again)->to_json() == text);
    return 0;
}
