// A small file the whole way: uplifted, relit, compared with itself; the first byte chooses how.
#include <cmath>

#include "fuzz.h"
#include "spectex/pipeline.h"

namespace {

using namespace spectex;

void check_statistics(const DifferenceStatistics& s) {
    SPECTEX_FUZZ_CHECK(std::isfinite(s.mean) && std::isfinite(s.max) && s.mean <= s.max && s.p50 <= s.p99 && s.p99 <= s.max);
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size < 2) return 0;
    const unsigned how = data[0];
    const std::span<const std::uint8_t> bytes(data + 1, size - 1);
    const char* suffix = fuzz::suffix_for(fuzz::text_of(bytes.data(), bytes.size()));
    if (suffix == nullptr) return 0;
    static const fuzz::Folder folder;
    const std::string input = folder.write(std::string("image") + suffix, bytes);
    Limits limits;
    limits.max_width = limits.max_height = 128;
    limits.max_pixels = 64 * 64;
    limits.max_channels = 48;
    {
        const auto reader = ImageReader::open(input, 1, limits);
        if (!reader || (*reader)->header().geometry.full_width > 4096 || (*reader)->header().geometry.full_height > 4096) return 0;
    }
    UpliftOptions uplifting;
    uplifting.job.threads = 1;
    uplifting.settings.store = how & 1 ? Store::spectral : Store::coefficients;
    uplifting.settings.bands = *BandSet::parse(how & 2 ? "12" : "380:780:20");
    uplifting.settings.method = how & 4 ? "mallett2019" : "smits1999";
    uplifting.settings.gamut = how & 8 ? GamutPolicy::desaturate : GamutPolicy::clip;
    uplifting.layout = how & 16 ? Layout::multipart : Layout::single;
    uplifting.check_all = (how & 32) != 0;
    uplifting.settings.type = how & 64 ? PixelType::float32 : PixelType::half;
    static std::map<unsigned, std::shared_ptr<const Model>> models;
    auto& model = models[how & 7];
    if (!model) model = *solve_model(uplifting.settings);
    uplifting.settings.model = model;
    const std::string stored = folder.write("stored.exr", {});
    if (const auto report = uplift(input, stored, uplifting)) {
        check_statistics(report->roundtrip);
        RelightOptions relighting;
        relighting.job.threads = 1;
        static const auto lamp = *parse_illuminant("FL11");
        relighting.illuminants = {lamp};
        const std::string lit = folder.write("lit.exr", {});
        const auto relit = relight(stored, {lit}, relighting);
        SPECTEX_FUZZ_CHECK(relit.ok());
        DifferenceOptions comparing;
        comparing.job.threads = 1;
        const auto same = compare_files(lit, lit, comparing);
        SPECTEX_FUZZ_CHECK(same.ok() && same->statistics.max == 0);
        if (const auto difference = compare_files(input, lit, comparing)) check_statistics(difference->statistics);
    } else {
        SPECTEX_FUZZ_CHECK(report.error().message.find("image.") != std::string::npos);
    }
    return 0;
}
