// Groups of options that several tools take, each once.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "app.h"
#include "spectex/io.h"
#include "spectex/methods.h"
#include "spectex/spectral.h"

namespace spectex::app {

/// --observer --illuminant --rgb-space --matrix --bands. Names are looked up while parsing, so that a wrong one is a usage
/// error of its option.
struct ColorimetryOptions {
    ColorimetrySpec spec;
    std::string bands = "auto";

    Result<BandSet> band_set() const { return BandSet::parse(bands); }
};
/// @param illuminant_names  how the tool spells the option of the reference illuminant; a tool whose --illuminant means
/// another light names it otherwise.
void add_colorimetry_options(App& app, ColorimetryOptions& options,
                             const std::string& illuminant_names = "--illuminant");

/// --method --gamut
struct MethodOptions {
    std::string method{default_method};
    GamutPolicy gamut = GamutPolicy::clip;
};
void add_method_options(App& app, MethodOptions& options);

/// --half --float --uint8 --uint16 --compression --output-colorspace
struct OutputOptions {
    std::optional<PixelType> type;  ///< nothing: what follows from input and format
    std::string compression;        ///< empty: the format's default
    std::string colorspace;         ///< empty: what follows from the output
    WriteOptions write_options(PixelType fallback, int threads) const {
        return {type.value_or(fallback), compression, threads};
    }
};
enum class OutputTypes {
    any,         ///< --half --float --uint8 --uint16 and --output-colorspace
    stored,      ///< --half --float --uint8, for spectra and coefficients
};
void add_output_options(App& app, OutputOptions& options, OutputTypes types = OutputTypes::any);

/// --input-colorspace
void add_input_colorspace(App& app, std::string& name);

/// --mip --layer --channels: what of an image file is read.
struct SelectionOptions {
    std::vector<int> levels{0};  ///< of the pyramid, ascending
    ImageSelection select;       ///< without the level

    /// @error usage, when both a layer and channels are named.
    Status check() const;
    ImageSelection at(int level) const {
        ImageSelection one = select;
        one.mip = level;
        return one;
    }
};
/// @param range  whether N:M is taken: a tool that writes a file for each level.
void add_selection_options(App& app, SelectionOptions& options, bool range);

}  // namespace spectex::app
