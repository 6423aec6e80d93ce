// Configurations that a relight is to be added to: refused with one sentence, or kept whole and extended.
#include "color/baked_files.h"
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const std::string text(spectex::fuzz::text_of(data, size));
    if (text.empty()) return 0;
    static const auto space = *spectex::find_rgb_space("BT.709");
    const std::vector<spectex::color::Relight> relights{{"A", "config_A.clf", "", "relit under A"},
                                                        {"FL 11", "config_FL11.clf", "", "relit \"under\" FL11"}};
    const auto made = spectex::color::config_text(text, "config.ocio", space, relights);
    if (!made) {
        SPECTEX_FUZZ_CHECK(made.error().message.starts_with("config.ocio: "));
        return 0;
    }
    // What was added once is there, and is left alone.
    const auto again = spectex::color::config_text(*made, "config.ocio", space, relights);
    SPECTEX_FUZZ_CHECK(again && *again == *made);
    return 0;
}
