#include <cmath>

#include "fuzz.h"
#include "spectex/spectral.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const auto table = spectex::parse_spectral_csv(spectex::fuzz::text_of(data, size), "input");
    if (!table) {
        SPECTEX_FUZZ_CHECK(table.error().kind == spectex::ErrorKind::input && table.error().message.starts_with("input"));
        return 0;
    }
    SPECTEX_FUZZ_CHECK(!table->names.empty() && table->names.size() == table->columns.size());
    for (std::size_t i = 0; i < table->wavelengths_nm.size(); ++i) {
        SPECTEX_FUZZ_CHECK(std::isfinite(table->wavelengths_nm[i]) && table->wavelengths_nm[i] > 0);
        SPECTEX_FUZZ_CHECK(i == 0 || table->wavelengths_nm[i] > table->wavelengths_nm[i - 1]);
    }
    for (const auto& column : table->columns) {
        SPECTEX_FUZZ_CHECK(column.size() == table->wavelengths_nm.size());
        const auto spectrum = spectex::SpectralDistribution::make(table->wavelengths_nm, column);
        SPECTEX_FUZZ_CHECK(spectrum.ok() == !column.empty());
        if (!spectrum) continue;
        const double nm[] = {1, 380, 555.5, 780, 1e5};
        for (const auto between : {spectex::Interpolation::linear, spectex::Interpolation::sprague, spectex::Interpolation::cubic})
            SPECTEX_FUZZ_CHECK(spectrum->resampled(nm, between, spectex::Extrapolation::hold).size() == std::size(nm));
    }
    return 0;
}
