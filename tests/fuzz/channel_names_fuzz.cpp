#include <cmath>

#include "fuzz.h"
#include "spectex/io.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const auto name = spectex::fuzz::text_of(data, size);
    const auto parsed = spectex::parse_spectral_channel_name(name);
    if (!parsed) return 0;
    SPECTEX_FUZZ_CHECK(std::isfinite(parsed->wavelength_nm) && parsed->wavelength_nm > 0);
    SPECTEX_FUZZ_CHECK(name.starts_with(parsed->layer));
    SPECTEX_FUZZ_CHECK(name.find(parsed->stem) != std::string_view::npos);
    // Our own spelling keeps 1e-6 nm; below that it would be zero, above 1e9 a double has fewer decimals than the name.
    if (parsed->wavelength_nm < 1e-3 || parsed->wavelength_nm > 1e9) return 0;
    const auto again = spectex::parse_spectral_channel_name(
        spectex::spectral_channel_name(parsed->stem, parsed->wavelength_nm));
    SPECTEX_FUZZ_CHECK(again && again->stem == parsed->stem);
    SPECTEX_FUZZ_CHECK(std::abs(again->wavelength_nm - parsed->wavelength_nm) <= 1e-6);
    return 0;
}
