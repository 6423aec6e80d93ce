#include "fuzz.h"
#include "spectex/spectral.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const auto bands = spectex::BandSet::parse(spectex::fuzz::text_of(data, size));
    if (!bands) {
        SPECTEX_FUZZ_CHECK(bands.error().kind == spectex::ErrorKind::usage);
        return 0;
    }
    SPECTEX_FUZZ_CHECK(bands->size() >= 3 && bands->size() <= spectex::BandSet::max_size);
    // What was parsed is a valid band set by the rule for lists.
    const auto again = spectex::BandSet::make(bands->wavelengths_nm());
    SPECTEX_FUZZ_CHECK(again && *again == *bands);
    SPECTEX_FUZZ_CHECK(!bands->describe().empty());
    // Hats of the bands against an observer: every integer nanometre between the ends.
    if (bands->back() > 2000) return 0;
    static const auto observer = *spectex::find_observer("cie1931");
    SPECTEX_FUZZ_CHECK(spectex::emission_weights(*bands, *observer).w.size() == 3 * bands->size());
    return 0;
}
