// Smits, 'An RGB-to-Spectrum Conversion for Reflectances', Journal of Graphics Tools 4(4), 1999,
// doi:10.1080/10867651.1999.10487511: seven spectra (white, cyan, magenta, yellow, red, green, blue).
//
// The paper's procedure takes out as much white as the least component allows, then as much as possible of the secondary
// colour of the two larger components, then the primary of the largest: with f1 >= f2 >= f3 the sorted components it adds
// f3 white + (f2 - f3) secondary + (f1 - f2) primary. That is Kuhn's subdivision of the one cell whose vertices are black,
// the six spectra and white, so the lattice kernel relights it without forming a spectrum.
//
// smits1999 keeps the published spectra of ten bins, 380 to 720 nm: made by hand for other phosphors' colours, not exact for
// any standard space, and with red, cyan up to 1.0149 and 1.0007. smits1999:exact has the smoothest exact reflectances.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "methods/smoothest.h"
#include "methods/tetrahedral_model.h"

namespace spectex::registry {
namespace {

constexpr std::string_view seven_spectra_lut = "models/smits1999_published.csv";
/// In the order of LatticeTable's vertices.
constexpr std::array<std::string_view, 8> vertex_names{"black", "blue", "green", "cyan", "red", "magenta", "yellow", "white"};

LatticeTable cube(std::size_t bands) {
    LatticeTable table;
    for (auto& knots : table.knots) knots = {0, 1};
    table.values = bands;
    table.vertices.assign(8 * bands, 0.0);
    return table;
}

ModelResult make_exact(const MethodInfo& info, const Colorimetry& colorimetry) {
    const std::size_t bands = colorimetry.bands().size();
    LatticeTable table = cube(bands);
    const auto white = table.vertices.end() - static_cast<std::ptrdiff_t>(bands);
    std::fill(white, table.vertices.end(), 1.0);
    const Vector3 diffuser = colorimetry.rgb_of({&*white, bands});
    for (const double v : diffuser)
        if (!(std::abs(v - 1) <= 1e-9))
            return Error{ErrorKind::infeasible, fmt::format("{}: the perfect diffuser is RGB ({}, {}, {}), not (1,1,1) ({}); the "
                                                            "integrated matrix makes it so",
                                                            info.id, diffuser[0], diffuser[1], diffuser[2], colorimetry.describe())};
    for (std::size_t v = 1; v < 7; ++v) {
        const auto solved = smoothest_spectrum(colorimetry.sensing_matrix(), colorimetry.bands().wavelengths_nm(), vertex_color(table, v), 1);
        if (!solved)
            return Error{solved.error().kind, fmt::format("{}: no reflectance in [0,1] is found for {} ({}): {}", info.id,
                                                          vertex_names[v], colorimetry.describe(), solved.error().message)};
        std::copy(solved->begin(), solved->end(), table.vertices.begin() + static_cast<std::ptrdiff_t>(v * bands));
    }
    return std::shared_ptr<const Model>(std::make_shared<TetrahedralModel>(info, colorimetry, std::move(table)));
}

ModelResult read_exact(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    auto table = read_lattice(colorimetry, json, 0, 1, 1e-9);
    if (!table) return std::move(table).error();
    if (table->vertices.size() != 8 * table->values) return Error{ErrorKind::input, "model: member 'knots': expected two per axis"};
    return std::shared_ptr<const Model>(std::make_shared<TetrahedralModel>(info, colorimetry, *std::move(table)));
}

/// Integral over [from, to] of the hat that rises from `left` to 1 at `centre` and falls to 0 at `right`.
double hat_integral(double left, double centre, double right, double from, double to) {
    const auto up_to = [&](double x) {
        x = std::clamp(x, left, right);
        double sum = 0;
        if (centre > left) {
            const double t = (std::min(x, centre) - left) / (centre - left);
            sum += 0.5 * t * t * (centre - left);
        }
        if (right > centre && x > centre) {
            const double t = (right - x) / (right - centre);
            sum += 0.5 * (1 - t * t) * (right - centre);
        }
        return sum;
    };
    return up_to(to) - up_to(from);
}

Status check_monitor(const MethodInfo& info, const Colorimetry& colorimetry) {
    if (colorimetry.rgb_space().name == "BT.709") return {};
    return Error{ErrorKind::usage, fmt::format("{}: the published table is for monitors like BT.709, not {}; smits1999:exact solves "
                                               "for any space",
                                               info.id, colorimetry.rgb_space().name)};
}

ModelResult make_classic(const MethodInfo& info, const Colorimetry& colorimetry) {
    if (auto fits = check_monitor(info, colorimetry); !fits) return fits.error();
    const auto file = load_spectral_table(seven_spectra_lut);
    if (!file) return file.error();
    const auto& centres = file->wavelengths_nm;
    const BandSet& bands = colorimetry.bands();
    const std::size_t n = bands.size();
    LatticeTable table = cube(n);
    for (std::size_t v = 1; v < 8; ++v) {
        const auto column = std::find(file->names.begin(), file->names.end(), vertex_names[v]);
        if (column == file->names.end() || centres.size() < 2)
            return Error{ErrorKind::input, fmt::format("{}: expected a column {} of at least two bins", seven_spectra_lut, vertex_names[v])};
        const auto& values = file->columns[static_cast<std::size_t>(column - file->names.begin())];
        // A band is the mean of the bins' steps under the band's own kernel; the outer bins reach on for ever.
        for (std::size_t b = 0; b < n; ++b) {
            const double left = b == 0 ? bands[0] : bands[b - 1], right = b + 1 == n ? bands[b] : bands[b + 1];
            double sum = 0;
            for (std::size_t k = 0; k < centres.size(); ++k) {
                const double from = k == 0 ? left : 0.5 * (centres[k - 1] + centres[k]);
                const double to = k + 1 == centres.size() ? right : 0.5 * (centres[k] + centres[k + 1]);
                if (to > from) sum += values[k] * hat_integral(left, bands[b], right, from, to);
            }
            table.vertices[v * n + b] = sum / (0.5 * (right - left));
        }
    }
    return std::shared_ptr<const Model>(std::make_shared<TetrahedralModel>(info, colorimetry, std::move(table)));
}

ModelResult read_classic(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    if (auto fits = check_monitor(info, colorimetry); !fits) return fits.error();
    // The table's largest entry is 1.0149.
    auto table = read_lattice(colorimetry, json, 0, 1.015, -1);
    if (!table) return std::move(table).error();
    if (table->vertices.size() != 8 * table->values) return Error{ErrorKind::input, "model: member 'knots': expected two per axis"};
    return std::shared_ptr<const Model>(std::make_shared<TetrahedralModel>(info, colorimetry, *std::move(table)));
}

MethodInfo seven_spectra_info(std::string id, std::string title, bool exact) {
    MethodInfo info;
    info.id = std::move(id);
    info.title = std::move(title);
    info.source = "Smits 1999, JGT 4(4), doi:10.1080/10867651.1999.10487511";
    info.pieces = Pieces::tetrahedral;
    info.exact = exact;
    info.bounded = exact;
    return info;
}

}  // namespace

Entry smits1999() { return {seven_spectra_info("smits1999", "Seven spectra, the published table", false), make_classic, read_classic}; }

Entry smits1999_exact() {
    return {seven_spectra_info("smits1999:exact", "Seven spectra, each the smoothest exact one", true), make_exact, read_exact};
}

}  // namespace spectex::registry
