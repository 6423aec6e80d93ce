// spxinfo: what an image, spectral or coefficient file holds, and the spectrum of a pixel.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "app.h"
#include "facts.h"
#include "options.h"
#include "spectex/color.h"
#include "spectex/heatmap.h"
#include "spectex/io.h"

namespace {

using namespace spectex;
using namespace spectex::app;

struct Options {
    std::vector<std::string> files;
    FactsRequest request;
    std::string plot;
};

/// Told apart with any colour vision. Source: Okabe and Ito 2008, "Color Universal Design".
constexpr std::array<std::array<std::uint8_t, 3>, 7> palette{
    {{0, 114, 178}, {213, 94, 0}, {0, 158, 115}, {204, 121, 167}, {86, 180, 233}, {230, 159, 0}, {0, 0, 0}}};

/// Markers closer than this hide their curve.
constexpr std::size_t most_marked_bands = 100;

Status plot(const Options& options, const std::vector<std::string>& files, const std::vector<Facts>& facts) {
    std::vector<Curve> curves;
    bool emissive = false, reflective = false;
    for (std::size_t i = 0; i < files.size(); ++i) {
        if (!facts[i].spectrum)
            return Error{ErrorKind::input, fmt::format("{}: an image has no spectra to plot; uplift it first", files[i])};
        const auto& s = *facts[i].spectrum;
        (s.emissive ? emissive : reflective) = true;
        if (std::any_of(s.values.begin(), s.values.end(), [](double v) { return !std::isfinite(v); }))
            return Error{ErrorKind::input, fmt::format("{}: the pixel's spectrum is not finite", files[i])};
        curves.push_back({escape(files[i]), s.wavelengths_nm, s.values, palette[i % palette.size()],
                          s.values.size() <= most_marked_bands});
    }
    if (emissive && reflective)
        return Error{ErrorKind::usage, "--plot: expected spectra of one quantity, got reflectance and radiance"};
    const auto& at = *options.request.at;
    auto svg = plot_spectra_svg(curves, fmt::format("Pixel {}, {}", at[0], at[1]),
                                emissive ? "Spectral radiance" : "Reflectance");
    if (!svg) return svg.error();
    return write_text_file(options.plot, *svg);
}

int run(App& app, const Options& options) {
    if (!options.plot.empty() && !options.request.at) return app.usage_error("--plot: expected --at X,Y with it");
    if (options.plot == "-") return app.usage_error("--plot: expected FILE, got '-'");
    const auto files = app.inputs(options.files);
    if (!files) return app.report(files.error());
    const std::array<NamedOutput, 2> outputs{{{"--plot", options.plot}, {"--json", app.json_path()}}};
    if (auto checked = check_outputs(*files, outputs); !checked) return app.report(checked.error());

    // All headers are read before anything is printed, so that a position outside one of them prints nothing.
    int code = exit_ok;
    std::vector<std::string> read;
    std::vector<Facts> all;
    for (const auto& file : *files) {
        auto facts = describe_file(file, options.request);
        if (!facts) {
            const int failed = app.report(facts.error(), file);
            if (failed == exit_usage) return failed;
            code = std::max(code, failed);
            app.record({{"input", file}, {"error", facts.error().message}});
            continue;
        }
        Json object{{"input", file}};
        object.update(facts->json);
        if (!options.plot.empty()) object["output"] = options.plot;
        app.record(std::move(object));
        read.push_back(file);
        all.push_back(*std::move(facts));
    }
    for (std::size_t i = 0; i < all.size(); ++i) {
        app.table(read[i], all[i].rows);
        const bool pixel = options.request.at.has_value(), formed = pixel && all[i].spectrum;
        const std::array<std::pair<std::string, std::string>, 2> plan{
            {{"read", pixel ? "the header, and one row of every channel" : "the header; no pixels"},
             {"formed", formed ? "one spectrum" : "no spectrum"}}};
        app.explain("plan", plan);
    }
    if (!options.plot.empty() && code == exit_ok)
        if (auto drawn = plot(options, read, all); !drawn) code = app.report(drawn.error());
    return code;
}

}  // namespace

int main(int argc, char** argv) {
    App app({.name = "spxinfo",
             .synopsis = "FILE... [options]",
             .summary = "Says what an image, a spectral EXR or a coefficient EXR holds: size, channels, colour space and why, "
                        "bands, method, observer, illuminant; and a pixel's channels, spectrum and linear RGB.",
             .examples = {{"spxinfo brick.png", "size, channels, and the colour space it is taken to be in"},
                          {"spxinfo brick.exr --at 10,20 --plot brick.svg", "the reflectance of a pixel, as a table and drawn"},
                          {"spxinfo --json - 'textures/*.exr'", "everything about many files, for a script"}}});
    Options options;
    app.positional("FILE...", &options.files, 1, App::unlimited, "images; wildcards in quotes are expanded");
    app.group("Pixel");
    app.add({.names = "--at", .metavar = "X,Y", .text = "print this pixel; 0,0 is the top left of the data window",
             .unit = "pixels", .set = [&](std::string_view text) -> Status {
                 auto at = parse_position(text);
                 if (!at) return at.error();
                 options.request.at = *at;
                 return {};
             }});
    app.text("--plot", "OUT.svg", &options.plot, "draw the spectrum of the pixel (with --at), one curve for each file");
    app.group("Input");
    add_input_colorspace(app, options.request.input_colorspace);
    return app.run(argc, argv, [&] {
        options.request.threads = app.threads();
        options.request.strict = app.strict();
        return run(app, options);
    });
}
