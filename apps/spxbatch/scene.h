// --scene and --rewrite-scene: what a scene refers to decides what is converted.
#pragma once

#include <optional>
#include <string>

#include "options.h"
#include "spectex/batch.h"
#include "spectex/scene.h"
#include "uplift_options.h"

namespace spectex::app {

/// Restricts a batch to the textures that the scene uses as reflectances, says what it lacks, and takes the scene's lights
/// for `--bands auto` where no --for is given.
/// @param source  folder of the batch: textures outside it are named and left alone.
/// @param rewrite  file for the rewritten scene.
/// @error usage, when the scene is to be rewritten and its format takes no EXR, or with another layout than it needs, or over
///        itself.
Status apply_scene(App& app, const Scene& scene, const std::string& source, const std::optional<std::string>& rewrite,
                   BatchOptions& options, UpliftOptionSet& set);

/// Writes the scene with the outputs of the batch, and adds to its record.
Result<Json> finish_scene(App& app, const Scene& scene, const BatchReport& report, const std::optional<std::string>& output);

}  // namespace spectex::app
