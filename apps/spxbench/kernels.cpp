#include "kernels.h"

#include <fmt/format.h>

#include "spectex/evaluation.h"
#include "spectex/kernel_speed.h"
#include "table.h"

namespace spectex::bench {

int kernels(app::App& tool, int rounds, const std::string& folder) {
    const auto measured = measure_kernels(rounds);
    if (!measured) return tool.report(measured.error());
    Table table({"kernel", "Mpixel/s", "of a copy", "target", "met", "largest error"});
    const std::string instructions = kernel_choice_name(KernelChoice::widest);
    app::Json json{{"what", "kernels"}, {"instructions", instructions}, {"threads", 1}, {"rounds", rounds}, {"rows", app::Json::array()}};
    for (const KernelSpeed& k : *measured) {
        const bool asked = k.target > 0, met = k.ratio >= k.target;
        table.add({k.kernel, fmt::format("{:.0f}", k.megapixels), fmt::format("{:.3f}", k.ratio), asked ? fmt::format("{:.2f}", k.target) : "",
                   asked ? met ? "yes" : "NO" : "", k.unit.empty() ? "" : fmt::format("{:.2g} {}", k.error, k.unit)});
        json["rows"].push_back({{"kernel", k.kernel}, {"megapixels_per_second", k.megapixels}, {"ratio", k.ratio}, {"error", k.error}, {"unit", k.unit}});
        if (asked) {
            json["rows"].back()["target"] = k.target;
            json["rows"].back()["met"] = met;
        }
    }
    return deliver(tool, folder, "kernels", table, std::move(json));
}

int memory(app::App& tool, std::vector<std::string> methods, int rounds, const std::string& folder) {
    if (methods.empty())
        for (const auto& info : spectex::methods()) methods.push_back(info.id);
    const auto measured = measure_color_memory(methods, rounds);
    if (!measured) return tool.report(measured.error());
    if (measured->empty()) return tool.usage_error("--methods: expected one that is not linear in pieces: the others remember no colours");
    std::vector<std::string> header{"method", "of a colour", "ns computed"};
    for (const auto& point : measured->front().points) header.push_back(fmt::format("{:g}% again", 100 * point.share));
    header.push_back("pays from");
    Table table(header);
    app::Json json{{"what", "memory"}, {"threads", 1}, {"rounds", rounds}, {"rows", app::Json::array()}};
    for (const MemorySpeed& m : *measured) {
        std::vector<std::string> cells{m.method, m.work, fmt::format("{:.0f}", m.points.front().computed_ns)};
        app::Json points = app::Json::array();
        for (const auto& point : m.points) {
            cells.push_back(fmt::format("{:.2f}", point.remembered_ns / point.computed_ns));
            points.push_back({{"share", point.share}, {"computed_ns", point.computed_ns}, {"remembered_ns", point.remembered_ns}});
        }
        cells.push_back(m.break_even < 1 ? fmt::format("{:.1f}%", 100 * m.break_even) : "never");
        table.add(std::move(cells));
        json["rows"].push_back({{"method", m.method}, {"work", m.work}, {"break_even", m.break_even}, {"decision", m.decision}, {"points", std::move(points)}});
    }
    return deliver(tool, folder, "memory", table, std::move(json));
}

}  // namespace spectex::bench
