// JSON and text of the pipeline's reports, each once.
#pragma once

#include "app.h"
#include "spectex/pipeline.h"

namespace spectex::app {

/// metric, pixels, mean, rms, p50, p95, p99, max, max_at, nonfinite, changed_codes.
Json to_json(const DifferenceStatistics& statistics, Metric metric);
/// width, height, colorspace, colorspace_reason, nonfinite, first_nonfinite, out_of_gamut.
Json to_json(const InputReport& report);
/// bound, mean_bits, kept_bits (pixels by mantissa bits, from 0), checks [{name, max}].
Json to_json(const BoundedReport& report);
/// A line of figures for people: "mean 0.01  p99 0.03  max 0.05 at 17,4".
std::string summary(const DifferenceStatistics& statistics);
/// Warns of pixels that were replaced or mapped.
void warn_about(App& app, const InputReport& report);
void explain(App& app, std::string_view title, const Explanation& lines);
JobOptions job_options(const App& app, const Progress& progress, const std::string& input_colorspace);

}  // namespace spectex::app
