#include "reports.h"

#include <fmt/format.h>

namespace spectex::app {

Json to_json(const DifferenceStatistics& s, Metric metric) {
    return {{"metric", metric_name(metric)}, {"pixels", s.pixels},
            {"mean", s.mean},               {"rms", s.rms},
            {"p50", s.p50},                 {"p95", s.p95},
            {"p99", s.p99},                 {"p999", s.p999},
            {"max", s.max},                 {"max_at", s.max_at},
            {"nonfinite", s.nonfinite},     {"changed_codes", s.changed_codes}};
}

Json to_json(const InputReport& r) {
    Json json{{"input", r.path},
              {"width", r.width},
              {"height", r.height},
              {"colorspace", r.colorspace},
              {"colorspace_reason", r.colorspace_reason},
              {"nonfinite", r.nonfinite},
              {"out_of_gamut", r.out_of_gamut},
              {"unreached", r.unreached}};
    if (r.unreached > 0) json["first_unreached"] = r.first_unreached;
    if (r.nonfinite > 0) json["first_nonfinite"] = r.first_nonfinite;
    return json;
}

Json to_json(const BoundedReport& r) {
    Json checks = Json::array();
    for (const auto& check : r.checks) checks.push_back({{"name", check.name}, {"max", check.max}});
    return {{"bound", r.bound}, {"mean_bits", r.mean_bits}, {"kept_bits", r.kept_bits}, {"checks", std::move(checks)}};
}

std::string summary(const DifferenceStatistics& s) {
    if (s.pixels == 0) return "no finite pixels";
    return fmt::format("mean {:.4g}  p99 {:.4g}  max {:.4g} at {},{}", s.mean, s.p99, s.max, s.max_at[0], s.max_at[1]);
}

void warn_about(App& app, const InputReport& r) {
    if (r.nonfinite > 0)
        app.warn(fmt::format("{}: {} pixels were not finite, the first at {},{}: NaN and -inf taken as 0, +inf as 1", r.path,
                             r.nonfinite, r.first_nonfinite[0], r.first_nonfinite[1]));
    if (r.out_of_gamut > 0)
        app.warn(fmt::format("{}: {} of {} pixels were outside 0..1, where no reflectance lies: mapped as --gamut says", r.path,
                             r.out_of_gamut, std::uint64_t(r.width) * std::uint64_t(r.height)));
    if (r.unreached > 0)
        app.warn(fmt::format("{}: {} pixels have no spectrum of this method, the first at {},{}: the nearest was taken; spxdiff --roundtrip --map "
                             "shows by how much each is off",
                             r.path, r.unreached, r.first_unreached[0], r.first_unreached[1]));
}

void explain(App& app, std::string_view title, const Explanation& lines) {
    std::vector<std::pair<std::string, std::string>> rows;
    for (const auto& line : lines) rows.emplace_back(line.key, line.text);
    app.explain(title, rows);
}

JobOptions job_options(const App& app, const Progress& progress, const std::string& input_colorspace) {
    JobOptions job;
    job.threads = app.threads();
    job.strict = app.strict();
    job.progress = progress.function();
    job.input_colorspace = input_colorspace;
    return job;
}

}  // namespace spectex::app
