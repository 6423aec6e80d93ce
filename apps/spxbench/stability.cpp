#include "stability.h"

#include <fmt/format.h>

#include "spectex/io.h"
#include "table.h"

namespace spectex::bench {
namespace {

std::string figure(double v) { return std::isnan(v) ? "" : v == 0 ? "0" : fmt::format("{:.3g}", v); }

app::Json finite_or_null(double v) { return std::isfinite(v) ? app::Json(v) : app::Json(); }

/// Of each group the path that comes nearest to its bound.
Table by_group(const StabilityReport& report) {
    Table table({"group", "paths", "cases", "nearest to its bound", "worst", "of", "bound", "at", "kept"});
    for (const auto& group : stability_groups()) {
        const StabilityRow* nearest = nullptr;
        std::uint64_t paths = 0, cases = 0, kept = 0;
        double most = -1;
        for (const auto& r : report.rows) {
            if (r.group != group) continue;
            ++paths, cases += r.cases, kept += r.kept();
            // What a bound cannot be neared by, a share of nothing, leaves the first of its group.
            const double near = !r.kept() ? HUGE_VAL : r.most > 0 && std::isfinite(r.most) ? r.worst / r.most : 0;
            if (near > most) most = near, nearest = &r;
        }
        if (nearest)
            table.add({group, std::to_string(paths), std::to_string(cases), nearest->path, figure(nearest->worst), nearest->unit, figure(nearest->most),
                       nearest->worst_at, kept == paths ? "all" : fmt::format("{} of {}", kept, paths)});
    }
    return table;
}

}  // namespace

int stability(app::App& tool, const StabilityRequest& request, const Colorimetry& colorimetry) {
    const auto report = measure_stability(colorimetry, request.options);
    if (!report) return tool.report(report.error());
    Table table({"path", "cases", "worst", "of", "bound", "ΔE76", "bound ", "at", "kept"}), solvers({"method", "colours", "by", "count"});
    app::Json json{{"what", "stability"}, {"colorimetry", colorimetry.describe()}, {"stride", request.options.stride},
                   {"colors", request.options.colors}, {"failures", report->failures()}, {"rows", app::Json::array()},
                   {"solvers", app::Json::array()}};
    for (const auto& r : report->rows) {
        const std::string at = r.broken > 0 ? fmt::format("{} broken, first {}", r.broken, r.broken_at) : r.worst_at.empty() ? r.delta_e_at : r.worst_at;
        table.add({r.path, std::to_string(r.cases), figure(r.worst), r.unit, std::isfinite(r.most) ? figure(r.most) : "", figure(r.delta_e),
                   std::isfinite(r.most_delta_e) ? figure(r.most_delta_e) : "", at, r.kept() ? "yes" : "NO"});
        json["rows"].push_back({{"group", r.group}, {"path", r.path}, {"cases", r.cases}, {"worst", r.worst}, {"unit", r.unit}, {"worst_at", r.worst_at},
                                {"bound", finite_or_null(r.most)}, {"delta_e", finite_or_null(r.delta_e)}, {"delta_e_at", r.delta_e_at},
                                {"delta_e_bound", finite_or_null(r.most_delta_e)}, {"broken", r.broken}, {"broken_at", r.broken_at},
                                {"kept", r.kept()}, {"reason", r.reason}});
    }
    for (const auto& s : report->solvers) {
        app::Json counts = app::Json::object();
        for (const auto& [by, count] : s.counts) {
            solvers.add({"`" + s.method + "`", std::to_string(s.colors), by, std::to_string(count)});
            counts[by] = count;
        }
        json["solvers"].push_back({{"method", s.method}, {"colors", s.colors}, {"unreached", s.unreached}, {"counts", std::move(counts)}});
    }
    if (!request.csv.empty())
        if (const auto written = write_text_file(request.csv, table.csv()); !written) return tool.report(written.error(), request.csv);
    const int code = deliver(tool, request.folder, "stability", request.brief ? by_group(*report) : table, std::move(json));
    if (!report->solvers.empty()) tool.out(fmt::format("\n{}", solvers.markdown()));
    if (code == app::exit_ok && report->failures() > 0) {
        tool.warn(fmt::format("{} of {} bounds do not hold", report->failures(), report->rows.size()));
        return app::exit_threshold;
    }
    return code;
}

}  // namespace spectex::bench
