#include "grid.h"

#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <thread>

#include "spectex/evaluation.h"
#include "spectex/heatmap.h"
#include "spectex/pipeline.h"
#include "table.h"

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

Result<StoreSpec> parse_store(const std::string& text) {
    const auto wrong = [&] {
        return Error{ErrorKind::usage, fmt::format("--stores: expected KIND-TYPE[:BANDS][:max-error=DE] with KIND coefficients or spectral and "
                                                   "TYPE half or float, as spectral-half:36, got '{}'",
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

/// A folder of its own for textures and outputs, removed at the end.
class ScratchFolder {
public:
    explicit ScratchFolder(const std::string& beside) {
        std::error_code failed;
        const auto base = beside.empty() ? std::filesystem::temp_directory_path(failed) : std::filesystem::path(beside);
        path_ = (base / fmt::format(".spxbench-{}", ::getpid())).string();
        std::filesystem::create_directory(path_, failed);
        if (failed) error_ = failed.message();
    }
    ~ScratchFolder() {
        std::error_code ignored;
        std::filesystem::remove_all(path_, ignored);
    }
    ScratchFolder(const ScratchFolder&) = delete;
    ScratchFolder& operator=(const ScratchFolder&) = delete;
    const std::string& path() const { return path_; }
    Status status() const {
        if (error_.empty()) return {};
        return Error{ErrorKind::output, fmt::format("{}: {}", path_, error_)};
    }

private:
    std::string path_, error_;
};

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

/// An earlier run's rows by what they measured.
Result<std::map<std::string, Json>> read_baseline(const std::string& path, std::string_view what) {
    std::map<std::string, Json> rows;
    if (path.empty()) return rows;
    std::error_code failed;
    std::ifstream file;
    // A named pipe would be waited for.
    if (std::filesystem::is_regular_file(path, failed)) file.open(path, std::ios::binary);
    if (!file.is_open()) return Error{ErrorKind::input, fmt::format("{}: cannot be read", path)};
    const auto json = Json::parse(file, nullptr, false);
    if (!json.is_object() || !json.contains("what") || json["what"] != what || !json.contains("rows") || !json["rows"].is_array())
        return Error{ErrorKind::input, fmt::format("{}: expected the JSON of an earlier spxbench {}", path, what)};
    for (const auto& row : json["rows"])
        if (row.is_object() && row.contains("key") && row["key"].is_string()) rows[row["key"].get<std::string>()] = row;
    return rows;
}

/// How many times as fast as the earlier run; empty where it has no such row.
std::string against(const std::map<std::string, Json>& baseline, const std::string& key, const char* member, double now) {
    const auto found = baseline.find(key);
    if (found == baseline.end() || !found->second.contains(member) || !found->second[member].is_number()) return "";
    const double before = found->second[member].get<double>();
    return before > 0 && now > 0 ? fmt::format("{:.2f}", before / now) : "";
}

std::string shown(double v) { return v == 0 ? "0" : v < 1e-3 ? fmt::format("{:.0e}", v) : fmt::format("{:.3g}", v); }

/// Bounds that no figure can reach are of rounding, and mean exact.
constexpr double exact_below = 1e-6;

Status draw(const std::string& folder, const std::string& name, const Chart& chart) {
    const auto svg = draw_chart_svg(chart);
    if (!svg) return svg.error();
    if (auto written = write_text_file(folder + "/" + name + ".svg", *svg); !written) return written;
    const auto picture = draw_chart(chart, 1.5);
    if (!picture) return picture.error();
    return write_picture(folder + "/" + name + ".png", *picture, 0);
}

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
    Chart chart{"Run time against error", "seconds per million pixels, whole file", "mean CIEDE2000 relit under A, FL11 and D50", {}, {}, exact_below};
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
                series.points.push_back({spec.name + (kernels.size() > 1 ? " " + instructions : ""), file, row->relight_mean});
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

namespace {

/// Of this process, in user and system mode, over all its threads.
double processor_seconds() {
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    const auto of = [](const timeval& t) { return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec); };
    return of(usage.ru_utime) + of(usage.ru_stime);
}

}  // namespace

int scaling(app::App& tool, const GridRequest& request) {
    if (const auto made = make_folder(request.folder); !made) return tool.report(made.error(), request.folder);
    const ScratchFolder scratch(request.folder);
    if (auto made = scratch.status(); !made) return tool.report(made.error());
    const auto baseline = read_baseline(request.baseline, "scaling");
    if (!baseline) return tool.report(baseline.error());
    const std::string method = request.methods.empty() ? std::string(default_method) : request.methods.front();
    std::vector<std::string> header{"what", "at", "seconds", "processor seconds", "ns per pixel", "times the first"};
    if (!request.baseline.empty()) header.emplace_back("times the baseline");
    Table table(header);
    Json json{{"what", "scaling"}, {"method", method}, {"runs", request.runs}, {"rows", Json::array()}};
    Chart chart{"Cost of a texture to spectra", "million pixels", "seconds, whole file", {}, {}, 0};

    struct Times {
        double wall = 0, processor = 0;
    };
    const auto measure = [&](const std::string& input, Store store, const BandSet& bands, int threads) -> Result<Times> {
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
        const std::string output = scratch.path() + "/out.exr";
        std::vector<double> seconds, busy;
        for (int run = 0; run <= request.runs; ++run) {
            const auto begin = std::chrono::steady_clock::now();
            const double used = processor_seconds();
            if (const auto report = uplift(input, output, options); !report) return report.error();
            // The first warms what is kept of models and disks.
            if (run == 0) continue;
            seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
            busy.push_back(processor_seconds() - used);
        }
        std::error_code ignored;
        std::filesystem::remove(output, ignored);
        const auto median = [](std::vector<double>& v) {
            std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
            return v[v.size() / 2];
        };
        return Times{median(seconds), median(busy)};
    };
    std::map<std::string, double> first;
    const auto add = [&](const std::string& what, const std::string& at, const Times& times, double pixels, double unit) {
        // Of several threads the wall's clock is asked, else the processors': a busy machine does not change them.
        const double seconds = times.wall, per = (what == "threads" ? times.wall : times.processor) / unit;
        const double ratio = per / first.try_emplace(what, per).first->second;
        const std::string key = what + " " + at;
        std::vector<std::string> cells{what, at, fmt::format("{:.3g}", seconds), fmt::format("{:.3g}", times.processor),
                                       fmt::format("{:.2f}", 1e9 * times.processor / pixels), fmt::format("{:.2f}", ratio)};
        if (!request.baseline.empty()) cells.push_back(against(*baseline, key, "seconds", seconds));
        table.add(std::move(cells));
        json["rows"].push_back({{"key", key}, {"series", what}, {"at", at}, {"seconds", seconds}, {"processor_seconds", times.processor}, {"pixels", pixels}, {"times_first", ratio}});
    };
    const std::string texture = scratch.path() + "/texture.tif";
    const std::string coefficients = "pixels, to half coefficients", spectra = "pixels, to 36 half bands";
    const BandSet own, bands36 = *BandSet::parse("36");
    ChartSeries to_coefficients{coefficients, {}, curve_color(1), true}, to_spectra{spectra, {}, curve_color(2), true};
    std::string of_bands;
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
    const int size = 2048;
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
        const auto seconds = measure(texture, Store::spectral, bands36, threads);
        if (!seconds) return tool.report(seconds.error());
        add("threads", std::to_string(threads), *seconds, pixels, 1);
    }
    chart.series = {std::move(to_coefficients), std::move(to_spectra)};
    if (!request.folder.empty())
        if (const auto drawn = draw(request.folder, "scaling", chart); !drawn) return tool.report(drawn.error(), request.folder);
    return deliver(tool, request.folder, "scaling", table, std::move(json));
}

}  // namespace spectex::bench
