#include <fmt/format.h>

#include <algorithm>

#include "spectex/pipeline.h"

namespace spectex {

const std::vector<ReaderInfo>& readers() {
    static const std::vector<ReaderInfo> table{
        {"spectex", true, true, Layout::single, true, "forms the method's spectra from coefficients; any spectral EXR"},
        {"pbrt", true, false, Layout::single, true, "pbrt-v4 takes R,G,B[,A] of one pixel type and ignores all else: spectra gain it nothing"},
        {"mitsuba", false, true, Layout::multipart, false, "Mitsuba 3 refuses colour and bands in one part"},
        {"spectral-exr", false, true, Layout::single, false, "the reference reader of the spectral layout takes a single part"},
    };
    return table;
}

Result<StoreChoice> choose_store(std::span<const std::string> names) {
    StoreChoice choice{Store::coefficients, Layout::single, {}};
    const ReaderInfo* fixed = nullptr;
    std::string all;
    for (const auto& name : names) {
        const auto found = std::find_if(readers().begin(), readers().end(), [&](const ReaderInfo& r) { return r.name == name; });
        if (found == readers().end()) {
            std::string known;
            for (const auto& r : readers()) known += (known.empty() ? "" : ", ") + r.name;
            return Error{ErrorKind::usage, fmt::format("reader '{}': expected one of {}", name, known)};
        }
        all += (all.empty() ? "" : ", ") + name;
        if (!found->coefficients) choice.store = Store::spectral;
        if (found->any_layout) continue;
        if (fixed && fixed->layout != found->layout)
            return Error{ErrorKind::usage, fmt::format("{} and {} read no common layout: expected a file for each", fixed->name, found->name)};
        fixed = &*found;
        choice.layout = found->layout;
    }
    choice.reason = choice.store == Store::coefficients
                        ? fmt::format("coefficients: {} can use them", all.empty() ? "every reader of this library" : all)
                        : fmt::format("spectral, {}: what {} reads ({})", choice.layout == Layout::single ? "one part" : "two parts",
                                      fixed->name, fixed->why);
    return choice;
}

}  // namespace spectex
