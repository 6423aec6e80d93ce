// How a texture is uplifted and stored: what spxuplift and spxdiff --roundtrip both take.
#pragma once

#include "options.h"
#include "spectex/pipeline.h"

namespace spectex::app {

struct UpliftOptionSet {
    ColorimetryOptions colorimetry;
    MethodOptions method;
    OutputOptions output;
    std::string store = "coefficients";
    std::optional<double> max_error;
    std::vector<std::string> lights, readers;
    bool skip_transparent = false;

    /// What --store auto comes to; nothing where it is named. @error usage, as choose_store.
    Result<std::optional<StoreChoice>> store_choice() const;
    /// The layout: that of the readers of --for-reader, unless --layout names it. @error usage where the two disagree.
    Result<Layout> layout(const App& app, Layout named) const;
    /// @error usage.
    Result<UpliftSettings> settings(const App& app) const;
};
/// --method --gamut --store --for-reader --skip-transparent --max-error --for --bands --observer --illuminant --rgb-space --matrix --half --float --compression
void add_uplift_options(App& app, UpliftOptionSet& options);

}  // namespace spectex::app
