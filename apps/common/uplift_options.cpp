#include "uplift_options.h"

namespace spectex::app {

void add_uplift_options(App& app, UpliftOptionSet& options) {
    add_method_options(app, options.method);
    app.choice("--store", "WHAT", &options.store, {"coefficients", "spectral"},
               "what the file holds: three coefficients per texel with the model in the header, or one channel per band");
    add_colorimetry_options(app, options.colorimetry);
    add_output_options(app, options.output, OutputTypes::float_only);
}

Result<UpliftSettings> UpliftOptionSet::settings(const App& app) const {
    UpliftSettings s;
    s.method = method.method;
    s.gamut = method.gamut;
    s.store = store == "spectral" ? Store::spectral : Store::coefficients;
    s.colorimetry = colorimetry.spec;
    s.type = output.type;
    // A coefficient texture stores no bands: its model is solved on the finer grid of the library unless asked otherwise.
    if (s.store == Store::spectral || app.given("--bands")) {
        auto bands = colorimetry.band_set();
        if (!bands) return std::move(bands).error();
        s.bands = *std::move(bands);
    }
    return s;
}

}  // namespace spectex::app
