// spxsolve: the programmes behind the methods, solved for any observer, illuminant, RGB space and bands.
#include <fmt/format.h>

#include <cmath>

#include "../common/app.h"
#include "../common/options.h"
#include "spectex/coefficient_table.h"
#include "spectex/io.h"
#include "spectex/solvers.h"

namespace {

using namespace spectex;
using app::Json;

struct Request {
    std::vector<std::string> what;
    app::ColorimetryOptions colorimetry;
    std::string objective = "first", output, certificate;
    std::int64_t n = 9;
};

Json describe(const Colorimetry& c) {
    return {{"bands", c.bands().describe()},
            {"observer", c.observer().id},
            {"illuminant", c.illuminant().name},
            {"rgb_space", c.rgb_space().name},
            {"matrix", c.matrix_kind() == RgbMatrix::integrated ? "integrated" : "standard"}};
}

std::string csv(const std::vector<double>& basis, const BandSet& bands) {
    std::string text = "wavelength_nm,r,g,b\n";
    const std::size_t n = bands.size();
    for (std::size_t l = 0; l < n; ++l)
        text += fmt::format("{},{:.17g},{:.17g},{:.17g}\n", app::number_text(bands[l]), basis[l], basis[n + l], basis[2 * n + l]);
    return text;
}

Json certificate_json(const Colorimetry& c, const FarkasCertificate& certificate) {
    Json json = describe(c);
    json["statement"] = "Every b in [0,1] with A b_i = e_i and b_r + b_g + b_b = 1 would give sum_i c_i . b_i = sum_i y_i . e_i + "
                        "sum s = constraint_value, where c_i = A^T y_i + s; but no b in [0,1] gives more than sum max(c, 0) = "
                        "box_maximum.";
    json["wavelengths_nm"] = c.bands().wavelengths_nm();
    json["sensing_matrix"] = c.sensing_matrix();
    json["y"] = certificate.y;
    json["s"] = certificate.s;
    json["constraint_value"] = certificate.constraint_value;
    json["box_maximum"] = certificate.box_maximum;
    return json;
}

int primaries(app::App& tool, const Request& request) {
    const Smoothness smoothness = request.objective == "first" ? Smoothness::first : Smoothness::second;
    const auto bands = request.colorimetry.band_set();
    if (!bands) return tool.report(bands.error());
    const auto c = Colorimetry::make(request.colorimetry.spec, *bands);
    if (!c) return tool.report(c.error());
    tool.explain("spxsolve primaries",
                 std::vector<std::pair<std::string, std::string>>{
                     {"colorimetry", c->describe()},
                     {"objective", fmt::format("sum of squared {} differences of b_r, b_g, b_b", request.objective)},
                     {"subject to", "b_r + b_g + b_b = 1, 0 <= b <= 1, A b_i = e_i"},
                     {"unknowns", fmt::format("{} in {} equations", 3 * bands->size(), bands->size() + 6)},
                     {"first", "the least violation of [0,1], as a linear programme: its multipliers are the certificate"},
                     {"then", "primal-dual interior point, and a polish of the active set in long double"}});
    const auto outcome = solve_primaries(*c, smoothness);
    if (!outcome) return tool.report(outcome.error());
    const PrimariesSolution& s = outcome->solution;

    Json json{{"what", "primaries"}};
    json.update(describe(*c));
    json["feasible"] = outcome->feasible;
    json["least_violation"] = s.least_violation;
    if (!outcome->feasible) {
        json["certificate"] = {{"constraint_value", outcome->certificate.constraint_value},
                               {"box_maximum", outcome->certificate.box_maximum},
                               {"y", outcome->certificate.y},
                               {"s", outcome->certificate.s}};
        tool.record(std::move(json));
        std::string how = "--certificate FILE.json writes the proof";
        if (!request.certificate.empty()) {
            const auto text = certificate_json(*c, outcome->certificate).dump(1) + "\n";
            if (const auto written = write_text_file(request.certificate, text); !written)
                return tool.report(written.error(), request.certificate);
            how = "the proof is in " + app::escape(request.certificate);
        }
        return tool.report({ErrorKind::infeasible,
                            std::isfinite(s.least_violation)
                                ? fmt::format("no three reflectances in [0,1] that sum to 1 are the primaries ({}): the least "
                                              "violation of [0,1] is {:.6f}; {}",
                                              c->describe(), s.least_violation, how)
                                : fmt::format("no three reflectances that sum to 1 are the primaries ({}): this matrix does not "
                                              "give the perfect diffuser RGB (1,1,1), so the violation has no least; {}",
                                              c->describe(), how)});
    }
    json["objective"] = request.objective;
    json["first_differences"] = squared_differences(s.basis, *bands, Smoothness::first);
    json["second_differences"] = squared_differences(s.basis, *bands, Smoothness::second);
    json["sensing_residual"] = s.sensing_residual;
    json["sum_residual"] = s.sum_residual;
    json["minimum"] = s.minimum;
    json["maximum"] = s.maximum;
    json["duality_gap"] = s.duality_gap;
    json["iterations"] = s.iterations;
    json["certificate"] = nullptr;
    json["multipliers"] = s.multipliers;

    std::string text;
    if (request.output.ends_with(".json")) {
        Json file = describe(*c);
        file["objective"] = request.objective;
        file["wavelengths_nm"] = bands->wavelengths_nm();
        const auto n = static_cast<std::ptrdiff_t>(bands->size());
        for (const auto& [name, at] : {std::pair{"r", 0}, std::pair{"g", 1}, std::pair{"b", 2}})
            file[name] = std::vector<double>(s.basis.begin() + at * n, s.basis.begin() + (at + 1) * n);
        text = file.dump(1) + "\n";
    } else {
        text = csv(s.basis, *bands);
    }
    if (const auto written = write_text_file(request.output, text); !written) return tool.report(written.error(), request.output);
    json["output"] = request.output;
    tool.note(fmt::format("{}: {}", request.output, c->describe()));
    tool.note(fmt::format("sum of squared differences: first {:.8g}, second {:.8g}; slack {:.4g}",
                          json["first_differences"].get<double>(), json["second_differences"].get<double>(),
                          -s.least_violation));
    tool.note(fmt::format("residual of A b = e {:.1e}, of the sum {:.1e}; values {:g} to {:g}; duality gap {:.1e} after {} "
                          "iterations",
                          s.sensing_residual, s.sum_residual, s.minimum, s.maximum, s.duality_gap, s.iterations));
    tool.record(std::move(json));
    return app::exit_ok;
}

int lattice(app::App& tool, const Request& request) {
    const auto bands = request.colorimetry.band_set();
    if (!bands) return tool.report(bands.error());
    const auto c = Colorimetry::make(request.colorimetry.spec, *bands);
    if (!c) return tool.report(c.error());
    LatticeOptions options;
    options.n = static_cast<std::size_t>(request.n);
    const auto sets = lattice_sample_sets();
    if (!sets) return tool.report(sets.error());
    std::string names;
    for (const auto& set : *sets) names += fmt::format("{}{} ({})", names.empty() ? "" : ", ", set.name, set.samples.size());
    tool.explain("spxsolve lattice",
                 std::vector<std::pair<std::string, std::string>>{
                     {"colorimetry", c->describe()},
                     {"samples", fmt::format("{}; smoothed, {:g} times squared second differences", names, options.denoising)},
                     {"vertices", fmt::format("{}^3, uniform in linear RGB", options.n)},
                     {"objective", fmt::format("distance from the samples near the vertex's colour, under their covariance plus "
                                               "{:g}, and {:g} times squared first differences",
                                               options.ridge, options.smoothness)},
                     {"subject to", "A r = rgb, 0 <= r <= 1"},
                     {"then", "the nearest spectrum that meets A r = rgb to rounding"}});
    const auto table = solve_lattice(*c, *sets, options);
    if (!table) return tool.report(table.error());
    // The largest step between neighbouring bands, and how many values lie on a bound.
    double step = 0;
    std::size_t bounds = 0;
    for (std::size_t i = 0; i < table->vertices.size(); ++i) {
        const double r = table->vertices[i];
        bounds += r == 0 || r == 1;
        if (i % table->values != 0) step = std::max(step, std::abs(r - table->vertices[i - 1]));
    }
    const auto bytes = encode_lattice(*table, *c);
    if (const auto written = write_text_file(request.output, bytes); !written) return tool.report(written.error(), request.output);
    Json json{{"what", "lattice"}};
    json.update(describe(*c));
    json["n"] = options.n;
    json["vertices"] = table->vertices.size() / table->values;
    json["largest_step"] = step;
    json["values_at_a_bound"] = bounds;
    json["bytes"] = bytes.size();
    json["output"] = request.output;
    tool.note(fmt::format("{}: {} vertices of {} bands, {} bytes; {}", request.output, table->vertices.size() / table->values,
                          table->values, bytes.size(), c->describe()));
    tool.note(fmt::format("largest step between bands {:.3f}; {} values at a bound", step, bounds));
    tool.record(std::move(json));
    return app::exit_ok;
}

/// The table of a Colorimetry as Mitsuba and rgb2spec read it, and what it leaves of random colours.
int table(app::App& tool, const Request& request) {
    const auto bands = request.colorimetry.band_set();
    if (!bands) return tool.report(bands.error());
    const auto c = Colorimetry::make(request.colorimetry.spec, *bands);
    if (!c) return tool.report(c.error());
    const auto n = static_cast<std::size_t>(request.n);
    tool.explain("spxsolve table",
                 std::vector<std::pair<std::string, std::string>>{
                     {"colorimetry", c->describe()},
                     {"vertices", fmt::format("3 x {}^3: by the largest component, and the other two over it", n)},
                     {"solved", "A r = rgb by Newton's method; where no sigmoid has the colour, the nearest in CIELab by "
                                "Levenberg and Marquardt"}});
    const auto made = make_coefficient_table(*c, n);
    if (!made) return tool.report(made.error());
    if (const auto written = write_coefficient_table(*made, request.output); !written)
        return tool.report(written.error(), request.output);
    Json json{{"what", "table"}};
    json.update(describe(*c));
    json["n"] = n;
    json["bytes"] = coefficient_table_bytes(*made).size();
    json["output"] = request.output;
    tool.note(fmt::format("{}: sigmoid coefficients at 3 x {}^3 colours, {} bytes; {}", request.output, n,
                          json["bytes"].get<std::size_t>(), c->describe()));
    tool.record(std::move(json));
    return app::exit_ok;
}

}  // namespace

int main(int argc, char** argv) {
    app::App tool({"spxsolve",
                   "primaries -o FILE.csv|FILE.json [options]\nlattice -o FILE.bin [options]\ntable -o FILE.coeff [options]",
                   "Solves for the spectra behind a method, to the optimum, or proves that there are none.",
                   {{"spxsolve primaries -o srgb.csv", "the three spectra of mallett2019 at 5 nm"},
                    {"spxsolve primaries --observer cie2006-10 --bands 380:780:1 --objective second -o b.json", ""},
                    {"spxsolve primaries --rgb-space Rec.2020 --certificate proof.json -o b.csv",
                     "why there are none for Rec.2020 (exit 2)"},
                    {"spxsolve lattice -o lattice.bin", "the spectra at the 729 vertices of the method lattice"},
                    {"spxsolve table -o srgb.coeff", "the 64^3 table of jakob2019, as Mitsuba and rgb2spec read it"}}});
    Request request;
    request.colorimetry.bands = "380:780:5";
    tool.positional("WHAT", &request.what, 1, 1, "primaries: three reflectances in [0,1] that sum to 1 and are the RGB primaries; lattice: one at each vertex of a "
                    "lattice over the RGB cube; table: the sigmoid coefficients of jakob2019:table");
    tool.choice("--objective", "ORDER", &request.objective, {"first", "second"},
                "primaries: the squared differences of this order are least");
    tool.integer("--n", "N", &request.n, 2, 256, "vertices along each axis; lattice: 9, at most 65; table: 64");
    tool.add({.names = "-o,--output", .metavar = "FILE", .text = "primaries: CSV (wavelength_nm,r,g,b), or JSON by its suffix; lattice: .bin; table: .coeff",
              .required = true, .set = [&](std::string_view value) -> Status {
                  if (!value.ends_with(".csv") && !value.ends_with(".json") && !value.ends_with(".bin") &&
                      !value.ends_with(".coeff"))
                      return app::expected("FILE.csv, FILE.json, FILE.bin or FILE.coeff", value);
                  request.output = value;
                  return {};
              }});
    tool.text("--certificate", "FILE", &request.certificate, "where there are no such spectra, write the proof as JSON");
    app::add_colorimetry_options(tool, request.colorimetry);
    return tool.run(argc, argv, [&]() -> int {
        const std::string& what = request.what[0];
        const bool wants_primaries = what == "primaries", wants_lattice = what == "lattice";
        if (!wants_primaries && !wants_lattice && what != "table")
            return tool.usage_error(fmt::format("expected primaries, lattice or table, got '{}'", app::escape(what)));
        const bool binary = request.output.ends_with(".bin"), coefficients = request.output.ends_with(".coeff");
        if (wants_lattice != binary || (what == "table") != coefficients)
            return tool.usage_error(fmt::format("-o: expected {} for {}, got '{}'",
                                                wants_primaries ? "FILE.csv or FILE.json" : wants_lattice ? "FILE.bin" : "FILE.coeff",
                                                what, app::escape(request.output)));
        for (const char* option : {"--objective", "--certificate"})
            if (!wants_primaries && tool.given(option)) return tool.usage_error(fmt::format("{} is for primaries", option));
        if (wants_primaries && tool.given("--n")) return tool.usage_error("--n is for lattice and table");
        if (wants_lattice && request.n > 65) return tool.usage_error(fmt::format("--n: expected 2..65 for lattice, got {}", request.n));
        if (!tool.given("--n")) request.n = wants_lattice ? 9 : 64;
        const std::array<app::NamedOutput, 2> outputs{{{"-o", request.output}, {"--certificate", request.certificate}}};
        if (auto fine = app::check_outputs({}, outputs); !fine) return tool.report(fine.error());
        if (app::App::lines_only) return app::exit_ok;
        return wants_primaries ? primaries(tool, request) : wants_lattice ? lattice(tool, request) : table(tool, request);
    });
}
