// A file opened to be lit: what relighting, contact sheets and their explanations share.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "pipeline/roundtrip.h"
#include "pipeline/source.h"

namespace spectex::pipeline {

/// Everything that one pass needs, whatever the input holds.
struct RelightSetup {
    std::unique_ptr<StripSource> source;
    std::shared_ptr<const Model> model;  ///< of an RGB texture, whose colours become its coefficients
    std::optional<RelightPlan> plan;
    RgbSpace space;        ///< of the plan's output
    std::string observer;  ///< under the new light
    GamutPolicy gamut = GamutPolicy::clip;
    FileKind kind = FileKind::image;
    bool emissive = false;

    static Result<RelightSetup> make(const std::string& input, const RelightOptions& options);

    /// Buffers of one thread.
    struct Buffers {
        Scratch scratch;
        std::vector<std::vector<float>> lit;
    };
    /// Pixels [begin, begin + n) of the strip at row y under every light, finite, in linear RGB of `space`.
    /// @param out  [3 images] planes of n, inside the buffers.
    Status light(const RawStrip& raw, int y, std::size_t begin, std::size_t n, Buffers& buffers, std::vector<float*>& out,
                 Counts& counts) const;
};

}  // namespace spectex::pipeline
