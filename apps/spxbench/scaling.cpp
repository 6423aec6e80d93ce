#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <map>
#include <thread>

#include "../common/files.h"
#include "grid.h"
#include "spectex/evaluation.h"
#include "spectex/pipeline.h"
#include "table.h"
#include "whole_files.h"

namespace spectex::bench {

using app::Json;

namespace {

/// Seconds of a conversion.
struct Times {
    double wall = 0;
    double processor = 0;  ///< all threads
    double system = 0;     ///< of these in the kernel: mostly its copies of what is read and written
};

/// Of this process until now.
Times times_so_far() {
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    const auto of = [](const timeval& t) { return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec); };
    return {std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(), of(usage.ru_utime) + of(usage.ru_stime), of(usage.ru_stime)};
}

}  // namespace

int scaling(app::App& tool, const GridRequest& request) {
    if (const auto made = make_folder(request.folder); !made) return tool.report(made.error(), request.folder);
    const ScratchFolder scratch(request.folder);
    if (auto made = scratch.status(); !made) return tool.report(made.error());
    const auto baseline = read_baseline(request.baseline, "scaling");
    if (!baseline) return tool.report(baseline.error());
    const std::string method = request.methods.empty() ? std::string(default_method) : request.methods.front();
    std::vector<std::string> header{"what", "at", "seconds", "processor seconds", "system seconds", "ns per pixel", "times the first"};
    if (!request.baseline.empty()) header.emplace_back("times the baseline");
    Table table(header);
    Json json{{"what", "scaling"}, {"method", method}, {"runs", request.runs}, {"rows", Json::array()}};
    Chart chart{"Cost of a texture to spectra", "million pixels", "seconds, whole file", {}, {}, 0};

    const std::string output = scratch.path() + "/out.exr", of_one_thread = scratch.path() + "/one.exr";
    const auto measure = [&](const std::string& input, Store store, const BandSet& bands, int threads, bool compared = false) -> Result<Times> {
        UpliftOptions options;
        options.job.threads = threads;
        options.settings.method = method;
        options.settings.store = store;
        options.settings.bands = bands;
        options.settings.colorimetry = request.colorimetry;
        // Solved ahead, for it costs the same at every size.
        auto model = solve_model(options.settings);
        if (!model) return std::move(model).error();
        options.settings.model = *std::move(model);
        std::array<std::vector<double>, 3> runs;
        std::error_code ignored;
        for (int run = 0; run <= request.runs; ++run) {
            const Times begin = times_so_far();
            if (const auto report = uplift(input, output, options); !report) return report.error();
            const Times end = times_so_far();
            if (compared && run == 0) {
                if (threads == 1) std::filesystem::rename(output, of_one_thread, ignored);
                else if (!app::same_bytes(output, of_one_thread))
                    return Error{ErrorKind::output, fmt::format("{}: {} threads wrote other bytes than one: expected the same", input, threads)};
            }
            // Here, lest the next run be charged with forgetting what this one wrote.
            std::filesystem::remove(output, ignored);
            // The first warms what is kept of models and disks.
            if (run == 0) continue;
            runs[0].push_back(end.wall - begin.wall), runs[1].push_back(end.processor - begin.processor), runs[2].push_back(end.system - begin.system);
        }
        const auto median = [](std::vector<double>& v) {
            std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
            return v[v.size() / 2];
        };
        return Times{median(runs[0]), median(runs[1]), median(runs[2])};
    };
    std::map<std::string, double> first;
    const auto add = [&](const std::string& what, const std::string& at, const Times& times, double pixels, double unit) {
        // Of several threads the wall's clock is asked, else the processors': a busy machine does not change them.
        const double seconds = times.wall, per = (what == "threads" ? times.wall : times.processor) / unit;
        const double ratio = per / first.try_emplace(what, per).first->second;
        const std::string key = what + " " + at;
        std::vector<std::string> cells{what, at, fmt::format("{:.3g}", seconds), fmt::format("{:.3g}", times.processor), fmt::format("{:.3g}", times.system),
                                       fmt::format("{:.2f}", 1e9 * times.processor / pixels), fmt::format("{:.2f}", ratio)};
        if (!request.baseline.empty()) cells.push_back(against(*baseline, key, "seconds", seconds));
        table.add(std::move(cells));
        json["rows"].push_back({{"key", key}, {"series", what}, {"at", at}, {"seconds", seconds}, {"processor_seconds", times.processor}, {"system_seconds", times.system}, {"pixels", pixels}, {"times_first", ratio}});
    };
    const std::string texture = scratch.path() + "/texture.tif";
    const std::string coefficients = "pixels, to half coefficients", spectra = "pixels, to 36 half bands";
    const BandSet own, bands36 = *BandSet::parse("36");
    ChartSeries to_coefficients{coefficients, {}, curve_color(1), true}, to_spectra{spectra, {}, curve_color(2), true};
    for (int size = 1024; static_cast<double>(size) * size <= request.max_megapixels * 1048576; size *= 2) {
        if (auto written = write_test_texture(texture, size, size); !written) return tool.report(written.error());
        const double pixels = static_cast<double>(size) * size;
        const auto few = measure(texture, Store::coefficients, own, tool.threads());
        if (!few) return tool.report(few.error());
        const std::string at = fmt::format("{} Mpixel", static_cast<long long>(pixels / 1048576));
        add(coefficients, at, *few, pixels, pixels);
        to_coefficients.points.push_back({"", pixels / 1e6, few->wall});
        // Spectra of the largest sizes would fill a disk.
        if (pixels > 17e6) continue;
        const auto many = measure(texture, Store::spectral, bands36, tool.threads());
        if (!many) return tool.report(many.error());
        add(spectra, at, *many, pixels, pixels);
        to_spectra.points.push_back({"", pixels / 1e6, many->wall});
    }
    const int size = request.max_megapixels < 4 ? 1024 : 2048;
    if (auto written = write_test_texture(texture, size, size); !written) return tool.report(written.error());
    const double pixels = static_cast<double>(size) * size;
    for (const char* bands : {"4", "8", "16", "36", "81"}) {
        const auto parsed = BandSet::parse(bands);
        if (!parsed) return tool.report(parsed.error());
        const auto seconds = measure(texture, Store::spectral, *parsed, tool.threads());
        if (!seconds && seconds.error().kind == ErrorKind::infeasible) {
            tool.note(fmt::format("bands {}: {}", bands, seconds.error().message));
            continue;
        }
        if (!seconds) return tool.report(seconds.error());
        add("bands", bands, *seconds, pixels, static_cast<double>(parsed->size()));
    }
    const int most = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
    for (int threads = 1; threads <= most; threads *= 2) {
        const auto seconds = measure(texture, Store::spectral, bands36, threads, true);
        if (!seconds) return tool.report(seconds.error());
        add("threads", std::to_string(threads), *seconds, pixels, 1);
    }
    chart.series = {std::move(to_coefficients), std::move(to_spectra)};
    if (!request.folder.empty())
        if (const auto drawn = draw(request.folder, "scaling", chart); !drawn) return tool.report(drawn.error(), request.folder);
    return deliver(tool, request.folder, "scaling", table, std::move(json));
}

}  // namespace spectex::bench
