#include <fmt/format.h>

#include <cmath>

#include "spectex/spectral.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

/// Few bands cannot lie anywhere: on too wide a range no three reflectances are the primaries of BT.709 under D65. For these
/// numbers, the widest even grid on which they exist with room to spare (0.003 of reflectance; for seven bands there is one
/// grid with next to none). A test solves each.
struct FewBands {
    int bands;
    double start_nm, end_nm;
};
constexpr FewBands few_bands[] = {{7, 433, 646},  {8, 434, 680},  {9, 396, 680},  {10, 396, 716}, {11, 396, 752}, {12, 400, 780},
                                  {13, 380, 772}, {14, 396, 780}, {15, 380, 774}, {16, 394, 780}, {18, 390, 780}};

}  // namespace

Result<SpectralShape> SpectralShape::make(double start_nm, double end_nm, double step_nm) {
    const auto wrong = [&](const char* expected) {
        return Error{ErrorKind::usage,
                     fmt::format("spectral shape {}:{}:{}: expected {}", start_nm, end_nm, step_nm, expected)};
    };
    if (!std::isfinite(start_nm) || !std::isfinite(end_nm) || !std::isfinite(step_nm)) return wrong("finite numbers");
    if (start_nm <= 0 || end_nm < start_nm) return wrong("0 < START <= END in nm");
    if (step_nm <= 0) return wrong("a step above 0 nm");
    const double intervals = (end_nm - start_nm) / step_nm;
    if (intervals > 1e6) return wrong("at most a million steps");
    const double whole = std::round(intervals);
    if (std::fabs(intervals - whole) > 1e-6) return wrong("a step that divides END - START");
    SpectralShape shape;
    shape.start_nm_ = start_nm;
    shape.end_nm_ = end_nm;
    shape.step_nm_ = step_nm;
    shape.size_ = static_cast<std::size_t>(whole) + 1;
    return shape;
}

BandSet::BandSet() : BandSet(SpectralShape{}) {}

BandSet::BandSet(const SpectralShape& shape) {
    wavelengths_nm_.reserve(shape.size());
    for (std::size_t i = 0; i < shape.size(); ++i) wavelengths_nm_.push_back(shape.wavelength_nm(i));
}

Result<BandSet> BandSet::make(std::vector<double> wavelengths_nm) {
    if (wavelengths_nm.size() < 3 || wavelengths_nm.size() > max_size)
        return Error{ErrorKind::input,
                     fmt::format("a band set has {} bands: expected 3 to {}", wavelengths_nm.size(), max_size)};
    for (std::size_t i = 0; i < wavelengths_nm.size(); ++i) {
        if (!std::isfinite(wavelengths_nm[i]) || wavelengths_nm[i] <= 0)
            return Error{ErrorKind::input, fmt::format("band {} is at {} nm: expected a positive wavelength", i,
                                                       wavelengths_nm[i])};
        if (i > 0 && wavelengths_nm[i] <= wavelengths_nm[i - 1])
            return Error{ErrorKind::input, fmt::format("band {} at {} nm does not lie above band {} at {} nm: expected "
                                                       "wavelengths that ascend, none twice",
                                                       i, wavelengths_nm[i], i - 1, wavelengths_nm[i - 1])};
    }
    BandSet bands;
    bands.wavelengths_nm_ = std::move(wavelengths_nm);
    return bands;
}

Result<BandSet> BandSet::parse(std::string_view text) {
    const auto wrong = [&](const std::string& why) {
        return Error{ErrorKind::usage,
                     fmt::format("bands '{}': {}; expected START:END:STEP in nm (380:780:10), a number of bands from 3 to "
                                 "401, or auto",
                                 text, why)};
    };
    if (text == "auto") return BandSet(SpectralShape::make(380, 780, 10).value());
    if (text.find(':') == std::string_view::npos) {
        const auto count = parse_number(text);
        if (!count || *count != std::floor(*count)) return wrong("not a whole number");
        if (*count < 3 || *count > 401) return wrong("out of range");
        // Channel names keep 1e-6 nm: the bands are solved at the very wavelengths that a reader will parse.
        double start = 380, end = 780;
        for (const auto& few : few_bands)
            if (few.bands == static_cast<int>(*count)) start = few.start_nm, end = few.end_nm;
        std::vector<double> wavelengths_nm;
        for (int i = 0; i < static_cast<int>(*count); ++i)
            wavelengths_nm.push_back(std::round((start + (end - start) * i / (*count - 1)) * 1e6) / 1e6);
        return make(std::move(wavelengths_nm));
    }
    const auto first = text.find(':'), second = text.find(':', first + 1);
    if (second == std::string_view::npos || text.find(':', second + 1) != std::string_view::npos)
        return wrong("not three numbers");
    const auto start = parse_number(text.substr(0, first)), end = parse_number(text.substr(first + 1, second - first - 1)),
               step = parse_number(text.substr(second + 1));
    if (!start || !end || !step) return wrong("not three numbers");
    const auto shape = SpectralShape::make(*start, *end, *step);
    if (!shape) return shape.error();
    if (shape->size() < 3 || shape->size() > max_size)
        return wrong(fmt::format("gives {} bands, 3 to {} can be stored", shape->size(), max_size));
    std::vector<double> wavelengths_nm;
    for (std::size_t i = 0; i < shape->size(); ++i)
        wavelengths_nm.push_back(std::round(shape->wavelength_nm(i) * 1e6) / 1e6);
    if (auto bands = make(std::move(wavelengths_nm))) return bands;
    return wrong("the step is finer than the 1e-6 nm that channel names keep");
}

std::optional<double> BandSet::uniform_step_nm() const {
    const double step = (back() - front()) / static_cast<double>(size() - 1);
    for (std::size_t i = 0; i < size(); ++i)
        if (std::fabs(front() + step * static_cast<double>(i) - wavelengths_nm_[i]) > 1e-6) return std::nullopt;
    return std::round(step * 1e9) / 1e9;
}

std::string BandSet::describe() const {
    if (const auto step = uniform_step_nm(); step && std::fabs(*step * 1e3 - std::round(*step * 1e3)) < 1e-6)
        return fmt::format("{}:{}:{}", front(), back(), *step);
    return fmt::format("{} bands, {}..{} nm", size(), front(), back());
}

}  // namespace spectex
