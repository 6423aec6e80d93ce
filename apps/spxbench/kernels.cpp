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

}  // namespace spectex::bench
