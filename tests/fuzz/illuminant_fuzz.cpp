// The first byte chooses: a specification (even), or the content of a lamp's file and its suffix.
#include <algorithm>
#include <cmath>

#include "fuzz.h"
#include "spectex/spectral.h"

namespace {

void check(const spectex::Result<spectex::Illuminant>& illuminant) {
    if (!illuminant) {
        SPECTEX_FUZZ_CHECK(!illuminant.error().message.empty());
        return;
    }
    const auto& values = illuminant->power.values();
    SPECTEX_FUZZ_CHECK(!values.empty() && values.size() == illuminant->power.wavelengths_nm().size());
    SPECTEX_FUZZ_CHECK(std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v) && v >= 0; }));
    static const auto observer = *spectex::find_observer("cie1931");
    const auto weights = spectex::tristimulus_weights(spectex::BandSet(), *observer, *illuminant,
                                                      spectex::Normalization::luminance);
    if (!weights) return;
    SPECTEX_FUZZ_CHECK(std::all_of(weights->w.begin(), weights->w.end(), [](double w) { return std::isfinite(w); }));
    // 81 products of weights that sum to 1: rounding stays far below 1e-9.
    SPECTEX_FUZZ_CHECK(std::abs(weights->white[1] - 1) < 1e-9);
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size < 2) return 0;
    const std::span<const std::uint8_t> rest(data + 1, size - 1);
    if (data[0] % 2 == 0) {
        // A path would reach files of the machine, and every term of a mixture is an integration.
        const auto text = spectex::fuzz::text_of(rest.data(), rest.size());
        if (text.find('/') != std::string_view::npos || std::count(text.begin(), text.end(), '+') > 8) return 0;
        check(spectex::parse_illuminant(text));
    } else {
        static const spectex::fuzz::Folder folder;
        constexpr const char* names[] = {"lamp.csv", "lamp.spd", "lamp.sp", "lamp.spdx"};
        check(spectex::parse_illuminant(folder.write(names[data[0] / 2 % 4], rest)));
    }
    return 0;
}
