#include "uplift_options.h"

namespace spectex::app {

void add_uplift_options(App& app, UpliftOptionSet& options) {
    add_method_options(app, options.method);
    app.choice("--store", "WHAT", &options.store, {"coefficients", "spectral", "auto"},
               "what the file holds: three coefficients per texel with the model in the header, one channel per band, or what "
               "--for-reader can use");
    std::string names;
    for (const auto& reader : readers()) names += (names.empty() ? "" : ", ") + reader.name;
    app.list("--for-reader", "NAME[,NAME]", &options.readers, "programs that will read the file, for --store auto: " + names);
    app.flag("--skip-transparent", &options.skip_transparent, "store texels of alpha 0 as black instead of uplifting their colours");
    app.number("--max-error", "DE", &options.max_error, 1e-4, 100, "CIE76",
               "round mantissas, of each pixel as far as its stored colour stays within this of the exact one: smaller files");
    app.add({.names = "--for", .metavar = "ILLUMINANT[,ILLUMINANT...]",
             .text = "lights that the file is meant for: --max-error holds under each, and --bands auto stores the fewest bands "
                     "that show this texture under them (within 0.5 where no --max-error is given)",
             .set = [&options](std::string_view value) -> Status {
                 auto items = parse_list(value);
                 if (!items) return items.error();
                 for (const auto& item : *items)
                     if (auto light = parse_illuminant(item); !light) return light.error();
                 options.lights = *std::move(items);
                 return {};
             }});
    add_colorimetry_options(app, options.colorimetry);
    add_output_options(app, options.output, OutputTypes::stored);
}

Result<std::optional<StoreChoice>> UpliftOptionSet::store_choice() const {
    if (store != "auto") {
        if (!readers.empty()) return Error{ErrorKind::usage, "--for-reader chooses what is stored: expected --store auto"};
        return std::optional<StoreChoice>{};
    }
    auto choice = choose_store(readers);
    if (!choice) return std::move(choice).error();
    return std::optional<StoreChoice>(*std::move(choice));
}

Result<Layout> UpliftOptionSet::layout(const App& app, Layout named) const {
    const auto choice = store_choice();
    if (!choice) return choice.error();
    if (!*choice) return named;
    if (!app.given("--layout")) return (*choice)->layout;
    if (named != (*choice)->layout && (*choice)->store == Store::spectral)
        return Error{ErrorKind::usage, "--layout: the readers named by --for-reader need the other layout"};
    return named;
}

Result<UpliftSettings> UpliftOptionSet::settings(const App& app) const {
    UpliftSettings s;
    const auto choice = store_choice();
    if (!choice) return choice.error();
    s.method = method.method;
    s.gamut = method.gamut;
    s.store = *choice ? (*choice)->store : store == "spectral" ? Store::spectral : Store::coefficients;
    s.skip_transparent = skip_transparent;
    s.colorimetry = colorimetry.spec;
    s.type = output.type;
    s.max_error = max_error;
    for (const auto& name : lights) {
        auto light = parse_illuminant(name);
        if (!light) return std::move(light).error();
        s.lights.push_back(*std::move(light));
    }
    s.choose_bands = !lights.empty() && s.store == Store::spectral && app.given("--bands") && colorimetry.bands == "auto";
    if (!lights.empty() && !max_error && !s.choose_bands)
        return Error{ErrorKind::usage, "--for names lights for a bound: expected --max-error DE, or --store spectral --bands auto"};
    // A coefficient texture stores no bands: its model is solved on the finer grid of the library unless asked otherwise.
    if (s.store == Store::spectral || app.given("--bands")) {
        auto bands = colorimetry.band_set();
        if (!bands) return std::move(bands).error();
        s.bands = *std::move(bands);
    }
    return s;
}

}  // namespace spectex::app
