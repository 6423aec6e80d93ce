#include <cmath>

#include "fuzz.h"
#include "spectex/coefficient_table.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const auto bytes = spectex::fuzz::text_of(data, size);
    const auto table = spectex::parse_coefficient_table(bytes, "input");
    if (!table) {
        SPECTEX_FUZZ_CHECK(table.error().kind == spectex::ErrorKind::input && table.error().message.starts_with("input"));
        return 0;
    }
    SPECTEX_FUZZ_CHECK(spectex::coefficient_table_bytes(*table) == bytes);
    constexpr double values[] = {0, 1e-300, 1e-9, 0.25, 0.5, 1 - 1e-16, 1, 2, -1, NAN, INFINITY};
    for (const double r : values)
        for (const double g : values)
            for (const double b : values)
                for (std::size_t i = 0; i < 3; ++i) SPECTEX_FUZZ_CHECK(std::isfinite(table->fetch({r, g, b})[i]));
    return 0;
}
