// Mallett and Yuksel, 'Spectral Primary Decomposition for Rendering with sRGB Reflectance', EGSR 2019,
// doi:10.2312/sr.20191216: r = R b_r + G b_g + B b_b (eq. 1).
//
// Solved here for the Colorimetry at hand with first differences, the paper's own objective: second differences round the
// curves' corners more but predict measured reflectances under other lamps no better (mean CIEDE2000 over five sets and 400
// lamps 1.56 against 1.54; the published table has 1.65).
#include <fmt/format.h>

#include <cmath>

#include "methods/registry.h"
#include "spectex/solvers.h"

namespace spectex::registry {
namespace {

constexpr std::string_view published_primaries_lut = "models/mallett2019_published_380-780-5.csv";

class LinearModel final : public Model {
public:
    LinearModel(const MethodInfo& info, const Colorimetry& colorimetry, std::vector<double> basis)
        : Model(info, colorimetry), basis_(std::move(basis)) {}

    void reflectance(std::span<const double> rgb, std::span<double> out) const override {
        const std::size_t bands = colorimetry().bands().size();
        const double *red = basis_.data(), *green = red + bands, *blue = green + bands;
        // This order of addition is the one in which the solver made the three sum to exactly 1.
        for (std::size_t i = 0; 3 * i + 2 < rgb.size(); ++i)
            for (std::size_t l = 0; l < bands; ++l)
                out[i * bands + l] = (rgb[3 * i] * red[l] + rgb[3 * i + 1] * green[l]) + rgb[3 * i + 2] * blue[l];
    }
    const std::vector<double>* basis() const override { return &basis_; }
    std::string to_json() const override {
        Json json = model_json(*this);
        json["basis"] = basis_;
        // A file's stem may hold any bytes; those that are not UTF-8 become the replacement character.
        return json.dump(-1, ' ', false, Json::error_handler_t::replace);
    }

private:
    std::vector<double> basis_;
};

ModelResult make_solved(const MethodInfo& info, const Colorimetry& colorimetry) {
    auto outcome = solve_primaries(colorimetry, Smoothness::first);
    if (!outcome) return std::move(outcome).error();
    if (!outcome->feasible) {
        const double t = outcome->solution.least_violation;
        return Error{ErrorKind::infeasible,
                     std::isfinite(t)
                         ? fmt::format("{}: no three reflectances in [0,1] that sum to 1 are the primaries ({}): the best "
                                       "violate [0,1] by {:.4g}; spxsolve primaries --certificate gives the proof",
                                       info.id, colorimetry.describe(), t)
                         : fmt::format("{}: no three reflectances that sum to 1 are the primaries ({}): the perfect diffuser is "
                                       "not RGB (1,1,1) with this matrix; the integrated one makes it so",
                                       info.id, colorimetry.describe())};
    }
    return std::shared_ptr<const Model>(
        std::make_shared<LinearModel>(info, colorimetry, std::move(outcome->solution.basis)));
}

ModelResult read_solved(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    // Every number that this library wrote meets these to rounding; the room is for other writers' decimals.
    constexpr double slip = 1e-9;
    const std::size_t bands = colorimetry.bands().size();
    auto basis = read_numbers(json, "basis", 3 * bands, -slip, 1 + slip);
    if (!basis) return std::move(basis).error();
    for (std::size_t l = 0; l < bands; ++l) {
        const double sum = (*basis)[l] + (*basis)[bands + l] + (*basis)[2 * bands + l];
        if (!(std::abs(sum - 1) <= slip))
            return Error{ErrorKind::input, fmt::format("model: member 'basis': the primaries sum to {} at {} nm, expected 1", sum,
                                                       colorimetry.bands()[l])};
    }
    for (std::size_t i = 0; i < 3; ++i) {
        const Vector3 rgb = colorimetry.rgb_of(std::span<const double>(*basis).subspan(i * bands, bands));
        for (std::size_t c = 0; c < 3; ++c)
            if (!(std::abs(rgb[c] - (i == c ? 1 : 0)) <= slip))
                return Error{ErrorKind::input,
                             fmt::format("model: member 'basis': primary {} has linear RGB ({}, {}, {}) in this colorimetry", i,
                                         rgb[0], rgb[1], rgb[2])};
    }
    return std::shared_ptr<const Model>(std::make_shared<LinearModel>(info, colorimetry, *std::move(basis)));
}

Status check_published(const MethodInfo& info, const Colorimetry& colorimetry) {
    if (colorimetry.rgb_space().name == "BT.709") return {};
    return Error{ErrorKind::usage, fmt::format("{}: the published table is for BT.709, not {}; mallett2019 solves for any space",
                                               info.id, colorimetry.rgb_space().name)};
}

ModelResult make_published(const MethodInfo& info, const Colorimetry& colorimetry) {
    if (auto fits = check_published(info, colorimetry); !fits) return fits.error();
    auto table = load_spectral_table(published_primaries_lut);
    if (!table) return std::move(table).error();
    if (table->columns.size() != 3) return Error{ErrorKind::input, fmt::format("{}: expected columns r, g, b", published_primaries_lut)};
    std::vector<double> basis;
    for (auto& column : table->columns) {
        const auto spectrum = SpectralDistribution::make(table->wavelengths_nm, std::move(column));
        if (!spectrum) return spectrum.error();
        const auto values = spectrum->resampled(colorimetry.bands().wavelengths_nm(), Interpolation::linear, Extrapolation::hold);
        basis.insert(basis.end(), values.begin(), values.end());
    }
    return std::shared_ptr<const Model>(std::make_shared<LinearModel>(info, colorimetry, std::move(basis)));
}

ModelResult read_published(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    if (auto fits = check_published(info, colorimetry); !fits) return fits.error();
    // The table's rows sum to 1 within 1e-5.
    auto basis = read_numbers(json, "basis", 3 * colorimetry.bands().size(), 0, 1);
    if (!basis) return std::move(basis).error();
    for (std::size_t l = 0, n = basis->size() / 3; l < n; ++l) {
        const double sum = (*basis)[l] + (*basis)[n + l] + (*basis)[2 * n + l];
        if (!(std::abs(sum - 1) <= 1e-4))
            return Error{ErrorKind::input, fmt::format("model: member 'basis': the primaries sum to {} at {} nm, expected 1", sum,
                                                       colorimetry.bands()[l])};
    }
    return std::shared_ptr<const Model>(std::make_shared<LinearModel>(info, colorimetry, *std::move(basis)));
}

MethodInfo primaries_info(std::string id, std::string title, bool exact, bool bounded) {
    MethodInfo info;
    info.id = std::move(id);
    info.title = std::move(title);
    info.source = "Mallett and Yuksel 2019, EGSR, doi:10.2312/sr.20191216";
    info.pieces = Pieces::linear;
    info.exact = exact;
    info.bounded = bounded;
    info.coefficients = 3;
    return info;
}

}  // namespace

Entry mallett2019() {
    return {primaries_info("mallett2019", "Spectral primaries, solved to the optimum", true, true), make_solved, read_solved};
}

Entry mallett2019_published() {
    // Not bounded: the table's rows reach a sum of 1 + 6e-9, so that a white exceeds 1 by as much.
    return {primaries_info("mallett2019:published", "Spectral primaries, the published table", false, false), make_published,
            read_published};
}

}  // namespace spectex::registry
