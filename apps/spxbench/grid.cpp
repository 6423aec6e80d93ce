#include "grid.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <map>

#include "spectex/evaluation.h"
#include "spectex/heatmap.h"
#include "spectex/pipeline.h"
#include "table.h"
#include "whole_files.h"

namespace spectex::bench {
namespace {

using app::Json;

/// Of the built-in texture: the size of a game's, small enough for a grid of dozens.
constexpr int texture_size = 1024;

/// KIND-TYPE[:BANDS][:max-error=DE]
struct StoreSpec {
    std::string name;
    Store store = Store::coefficients;
    PixelType type = PixelType::half;
    std::string bands = "380:780:5";
    std::optional<double> max_error;
};

/// For a chart, whose labels are many: 36 half bands, ΔE ≤ 0.5.
std::string label_of(const StoreSpec& spec) {
    const char* type = spec.type == PixelType::half ? "half" : spec.type == PixelType::uint8 ? "8-bit" : "float";
    std::string label = spec.store == Store::coefficients ? fmt::format("{} coefficients", type) : fmt::format("{} {} bands", spec.bands, type);
    if (spec.max_error) label += fmt::format(", ΔE ≤ {:g}", *spec.max_error);
    return label;
}

Result<StoreSpec> parse_store(const std::string& text) {
    const auto wrong = [&] {
        return Error{ErrorKind::usage, fmt::format("--stores: expected KIND-TYPE[:BANDS][:max-error=DE] with KIND coefficients or spectral and "
                                                   "TYPE half, float or (of coefficients) uint8, as spectral-half:36, got '{}'",
                                                   app::escape(text))};
    };
    StoreSpec out;
    out.name = text;
    const auto colon = text.find(':');
    const std::string kind = text.substr(0, colon);
    std::string rest = colon == std::string::npos ? "" : text.substr(colon + 1);
    if (kind.starts_with("spectral-")) out.store = Store::spectral, out.bands = "36";
    else if (!kind.starts_with("coefficients-")) return wrong();
    const auto type = kind.substr(kind.find('-') + 1);
    if (type == "float") out.type = PixelType::float32;
    else if (type == "uint8" && out.store == Store::coefficients) out.type = PixelType::uint8;
    else if (type != "half") return wrong();
    if (const auto at = rest.find("max-error="); at != std::string::npos) {
        if (at > 0 && rest[at - 1] != ':') return wrong();
        const std::string number = rest.substr(at + 10);
        double value = 0;
        const auto [end, failed] = std::from_chars(number.data(), number.data() + number.size(), value);
        if (failed != std::errc() || end != number.data() + number.size() || !(value > 0) || !std::isfinite(value)) return wrong();
        out.max_error = value;
        rest = at == 0 ? "" : rest.substr(0, at - 1);
    }
    if (!rest.empty()) out.bands = rest;
    if (const auto bands = BandSet::parse(out.bands); !bands) return wrong();
    return out;
}

Result<std::vector<std::string>> corpus_of(const GridRequest& request, const ScratchFolder& scratch) {
    std::vector<std::string> out;
    for (const auto& path : request.corpus) {
        std::error_code failed;
        if (!std::filesystem::is_directory(path, failed)) {
            out.push_back(path);
            continue;
        }
        std::vector<std::string> inside;
        for (auto it = std::filesystem::directory_iterator(path, failed); !failed && it != std::filesystem::directory_iterator(); it.increment(failed))
            if (it->is_regular_file(failed))
                if (const auto kind = probe(it->path().string()); kind && *kind == FileKind::image)
                    if (const auto image = ImageReader::open(it->path().string()); image && (*image)->header().has_color()) inside.push_back(it->path().string());
        if (inside.empty()) return Error{ErrorKind::input, fmt::format("{}: no picture with colours in this folder", path)};
        std::sort(inside.begin(), inside.end());
        out.insert(out.end(), inside.begin(), inside.end());
    }
    if (!out.empty()) return out;
    const auto made = scratch.path() + "/texture.png";
    if (auto written = write_test_texture(made, texture_size, texture_size); !written) return written.error();
    return std::vector<std::string>{made};
}

std::string shown(double v) { return v == 0 ? "0" : v < 1e-3 ? fmt::format("{:.0e}", v) : fmt::format("{:.3g}", v); }

/// Bounds that no figure can reach are of rounding, and mean exact.
constexpr double exact_below = 1e-6;

}  // namespace

int grid(app::App& tool, const GridRequest& request) {
    std::vector<StoreSpec> stores;
    for (const auto& text : request.stores.empty() ? std::vector<std::string>{"coefficients-half", "coefficients-float", "spectral-half:36",
                                                                              "spectral-half:36:max-error=0.5", "spectral-half:16"}
                                                   : request.stores) {
        auto store = parse_store(text);
        if (!store) return tool.report(store.error());
        stores.push_back(*std::move(store));
    }
    std::vector<KernelChoice> kernels;
    for (const auto& text : request.kernels.empty() ? std::vector<std::string>{"widest"} : request.kernels) {
        if (text != "widest" && text != "narrowest")
            return tool.usage_error(fmt::format("--kernels: expected widest or narrowest, got '{}'", app::escape(text)));
        kernels.push_back(text == "widest" ? KernelChoice::widest : KernelChoice::narrowest);
    }
    if (const auto made = make_folder(request.folder); !made) return tool.report(made.error(), request.folder);
    const ScratchFolder scratch(request.folder);
    if (auto made = scratch.status(); !made) return tool.report(made.error());
    const auto corpus = corpus_of(request, scratch);
    if (!corpus) return tool.report(corpus.error());
    const auto baseline = read_baseline(request.baseline, "grid");
    if (!baseline) return tool.report(baseline.error());
    std::vector<std::string> methods = request.methods;
    if (methods.empty()) methods = {"mallett2019", "lattice", "smits1999", "jakob2019", "jakob2019:table", "meng2015"};

    std::vector<std::string> header{"method", "stored as", "kernel", "compute Mpixel/s", "whole file Mpixel/s", "bytes per texel", "mean ΔE2000", "p99",
                                    "max", "relight ΔE2000", "peak MB"};
    if (!request.baseline.empty()) header.insert(header.end(), {"compute, times the baseline", "file, times", "bytes, times"});
    Table table(header);
    Json json{{"what", "grid"}, {"corpus", request.corpus.empty() ? Json(fmt::format("built in, {0} x {0}", texture_size)) : Json(*corpus)},
              {"runs", request.runs}, {"rows", Json::array()}};
    Chart chart{"Run time against error", "seconds per million pixels, whole file", "mean CIEDE2000 of what is stored under A, FL11 and D50, against the same method at 5 nm", {}, {}, exact_below};
    std::vector<std::array<double, 2>> points;
    for (std::size_t m = 0; m < methods.size(); ++m) {
        ChartSeries series{methods[m], {}, curve_color(m), false};
        for (const auto& spec : stores)
            for (const auto kernel : kernels) {
                TradeoffOptions options;
                options.corpus = *corpus;
                options.settings.method = methods[m];
                options.settings.store = spec.store;
                options.settings.bands = *BandSet::parse(spec.bands);
                options.settings.colorimetry = request.colorimetry;
                options.settings.type = spec.type;
                options.settings.max_error = spec.max_error;
                options.kernel = kernel;
                for (const char* light : {"A", "FL11", "D50"}) options.lights.push_back(*parse_illuminant(light));
                if (spec.max_error) options.settings.lights = options.lights;
                options.scratch = scratch.path();
                options.runs = static_cast<int>(request.runs);
                options.threads = tool.threads();
                const auto row = measure_tradeoff(options);
                // Not every method's coefficients fit into eight bits; the others have their rows all the same.
                if (!row && spec.type == PixelType::uint8 && row.error().kind == ErrorKind::usage) {
                    tool.note(fmt::format("{} {}: {}", methods[m], spec.name, row.error().message));
                    continue;
                }
                if (!row) return tool.report(row.error());
                const auto computed = static_cast<double>(row->computed) / 1e6, all = static_cast<double>(row->pixels) / 1e6;
                const double compute = row->store_seconds / computed, file = row->file_seconds / all;
                const std::string instructions = kernel_choice_name(kernel), key = methods[m] + " " + spec.name + " " + instructions;
                std::vector<std::string> cells{"`" + methods[m] + "`", spec.name, instructions, fmt::format("{:.3g}", 1 / std::max(compute, 1e-9)),
                                               fmt::format("{:.3g}", 1 / std::max(file, 1e-9)), fmt::format("{:.3g}", row->bytes_per_texel),
                                               shown(row->roundtrip.mean), shown(row->roundtrip.p99), shown(row->roundtrip.max),
                                               shown(row->relight_mean), fmt::format("{:.0f}", static_cast<double>(row->peak_bytes) / 1e6)};
                if (!request.baseline.empty()) {
                    cells.push_back(against(*baseline, key, "compute_seconds_per_megapixel", compute));
                    cells.push_back(against(*baseline, key, "file_seconds_per_megapixel", file));
                    cells.push_back(against(*baseline, key, "bytes_per_texel", row->bytes_per_texel));
                }
                table.add(std::move(cells));
                json["rows"].push_back({{"key", key}, {"method", methods[m]}, {"store", spec.name}, {"kernel", instructions}, {"channels", row->channels},
                                        {"pixels", row->pixels}, {"compute_seconds_per_megapixel", compute},
                                        {"reproject_seconds_per_megapixel", row->reproject_seconds / computed}, {"file_seconds_per_megapixel", file},
                                        {"bytes_per_texel", row->bytes_per_texel}, {"metric", "ciede2000"}, {"mean", row->roundtrip.mean},
                                        {"p99", row->roundtrip.p99}, {"max", row->roundtrip.max}, {"changed_codes", row->roundtrip.changed_codes},
                                        {"relight_mean", row->relight_mean}, {"relight_max", row->relight_max}, {"peak_bytes", row->peak_bytes},
                                        {"reference_error", row->reference_error}});
                series.points.push_back({label_of(spec) + (kernels.size() > 1 ? " " + instructions : ""), file, row->relight_mean});
                points.push_back({file, std::max(row->relight_mean, exact_below)});
            }
        chart.series.push_back(std::move(series));
    }
    Json front = Json::array();
    for (const std::size_t i : pareto_front(points)) {
        chart.front.push_back(points[i]);
        front.push_back(json["rows"][i]["key"]);
    }
    json["front"] = std::move(front);
    if (!request.folder.empty())
        if (const auto drawn = draw(request.folder, "grid", chart); !drawn) return tool.report(drawn.error(), request.folder);
    return deliver(tool, request.folder, "grid", table, std::move(json));
}

}  // namespace spectex::bench
