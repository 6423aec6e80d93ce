// Run time and error of whole files, kept with a method and a store.
#include <fmt/format.h>
#include <hwy/targets.h>
#include <tbb/task_arena.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "kernels/convert.h"
#include "parallel.h"
#include "pipeline/source.h"
#include "plan/bounded_store.h"
#include "spectex/color.h"
#include "spectex/evaluation.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

/// What the kernels may differ by from sums in double: half a unit of a float near 1 for each of some hundred terms.
constexpr double reference_tolerance = 1e-5;
constexpr std::size_t checked_colours = 4096;
/// Colours of a file that are kept for timing the kernels: more than any cache holds, in bounded memory.
constexpr std::size_t computed_colours = std::size_t{1} << 22;
constexpr std::size_t pixels_per_task = 4096;

double seconds_since(std::chrono::steady_clock::time_point begin) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

/// Restores the machine's own choice of instruction set when it goes.
class ChosenKernel {
public:
    explicit ChosenKernel(KernelChoice choice) {
        if (choice == KernelChoice::widest) return;
        hwy::SetSupportedTargetsForTest(narrowest());
        hwy::GetChosenTarget().Update(narrowest());
        changed_ = true;
    }
    ~ChosenKernel() {
        if (!changed_) return;
        hwy::SetSupportedTargetsForTest(0);
        hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    }
    ChosenKernel(const ChosenKernel&) = delete;
    ChosenKernel& operator=(const ChosenKernel&) = delete;

    /// Wider sets have lower bits.
    static std::int64_t narrowest() {
        auto left = static_cast<std::uint64_t>(hwy::SupportedTargets() & HWY_TARGETS);
        std::uint64_t last = left & (~left + 1);
        for (; left != 0; left &= left - 1) last = left & (~left + 1);
        return static_cast<std::int64_t>(last);
    }

private:
    bool changed_ = false;
};

/// Largest resident memory of this process since reset(); 0 where the system does not tell.
struct PeakMemory {
    static void reset() { std::ofstream("/proc/self/clear_refs") << "5"; }
    static std::uint64_t bytes() {
        std::ifstream status("/proc/self/status");
        for (std::string line; std::getline(status, line);)
            if (line.starts_with("VmHWM:")) return std::strtoull(line.c_str() + 6, nullptr, 10) * 1024;
        return 0;
    }
};

/// A file that goes when this does.
struct ScratchFile {
    std::string path;
    ~ScratchFile() {
        std::error_code ignored;
        std::filesystem::remove(path, ignored);
    }
};

/// Colours of a texture, evenly over its rows: three planes of linear RGB, replaced and clipped as the pipeline does.
Result<std::array<std::vector<float>, 3>> colours_of(const std::string& path, const Colorimetry& c, const JobOptions& job,
                                                     GamutPolicy gamut, std::size_t most) {
    auto source = pipeline::open_image_source(path, c.rgb_space(), job);
    if (!source) return std::move(source).error();
    const auto width = static_cast<std::size_t>((*source)->geometry().width), height = static_cast<std::size_t>((*source)->geometry().height);
    const std::size_t rows = std::clamp<std::size_t>(most / width, 1, height);
    std::array<std::vector<float>, 3> out;
    pipeline::RawStrip raw;
    std::vector<std::vector<float>> scratch(3, std::vector<float>(width));
    std::vector<const float*> planes(3);
    const Matrix3& m = c.rgb_to_xyz();
    std::size_t next = 0;
    const auto preferred = static_cast<std::size_t>(std::max((*source)->preferred_rows(), 1));
    for (std::size_t y = 0; y < height && next < rows; y += preferred) {
        const std::size_t n = std::min(preferred, height - y);
        if (auto read = (*source)->read(static_cast<int>(y), static_cast<int>(n), raw); !read) return read.error();
        for (; next < rows && next * height / rows < y + n; ++next) {
            (*source)->decode(raw, (next * height / rows - y) * width, width, scratch, planes);
            for (std::size_t i = 0; i < 3; ++i) out[i].insert(out[i].end(), planes[i], planes[i] + width);
        }
    }
    std::uint64_t replaced = 0;
    GamutCounts counts;
    pipeline::replace_nonfinite({out[0].data(), out[1].data(), out[2].data()}, out[0].size(), replaced);
    if (map_into_gamut({out[0].data(), out[1].data(), out[2].data()}, out[0].size(), gamut, {m(1, 0), m(1, 1), m(1, 2)}, counts))
        return Error{ErrorKind::input, path + ": a colour lies outside the RGB cube, and the gamut policy is error"};
    return out;
}

/// A store plan and its samples for some colours.
struct Stored {
    std::vector<std::byte> samples;
    std::vector<std::byte*> planes;
    Stored(const StorePlan& plan, std::size_t n) : samples(plan.channels() * n * pixel_bytes(plan.type())) {
        for (std::size_t i = 0; i < plan.channels(); ++i) planes.push_back(samples.data() + i * n * pixel_bytes(plan.type()));
    }
    double sample(const StorePlan& plan, std::size_t channel, std::size_t i) const {
        if (plan.type() == PixelType::uint8) return srgb_decode(std::to_integer<int>(planes[channel][i]) / 255.0);
        if (plan.type() == PixelType::float32) return static_cast<double>(reinterpret_cast<const float*>(planes[channel])[i]);
        float value = 0;
        kernels::half_to_float(reinterpret_cast<const std::uint16_t*>(planes[channel]) + i, 1, 1, &value);
        return static_cast<double>(value);
    }
};

/// What the pipeline does to a block of colours: by the plan, or to the fewest bits within a bound.
void store_block(const StorePlan& plan, const BoundedStore* bounded, std::array<const float*, 3> rgb, std::size_t n, std::span<std::byte* const> planes) {
    if (!bounded) return plan.store(rgb, n, planes);
    BoundedStore::Outcome outcome;
    bounded->store(rgb, n, planes, outcome);
}

struct Sums {
    CompensatedSum relight;
    std::uint64_t relit = 0;
    double relight_max = 0, reference_error = 0;
};

/// Kernels against sums in double, and stored spectra under the lights against the method's own.
Status check_colours(const std::string& path, const StorePlan& plan, const BoundedStore* bounded, const Model& model, const Model& master, Store store,
                     std::span<const TristimulusWeights> stored_weights, std::span<const TristimulusWeights> master_weights,
                     const std::array<std::vector<float>, 3>& colours, Sums& sums) {
    const std::size_t all = colours[0].size(), step = std::max<std::size_t>(all / checked_colours, 1);
    std::array<std::vector<float>, 3> picked, back;
    for (std::size_t i = 0; i < all && picked[0].size() < checked_colours; i += step)
        for (std::size_t c = 0; c < 3; ++c) picked[c].push_back(colours[c][i]);
    const std::size_t n = picked[0].size(), bands = model.colorimetry().bands().size(), full = master.colorimetry().bands().size();
    for (auto& plane : back) plane.assign(n, 0.0f);
    Stored stored(plan, n);
    store_block(plan, bounded, {picked[0].data(), picked[1].data(), picked[2].data()}, n, stored.planes);
    plan.reproject(std::vector<const std::byte*>(stored.planes.begin(), stored.planes.end()), n,
                   {back[0].data(), back[1].data(), back[2].data()});
    std::vector<double> kept(plan.channels()), spectrum(bands), own(full), rgb(3);
    for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = stored.sample(plan, k, i);
        if (store == Store::spectral)
            spectrum = kept;
        else
            model.reflectance_of_coefficients(kept, spectrum);
        const Vector3 expected = model.colorimetry().rgb_of(spectrum);
        for (std::size_t c = 0; c < 3; ++c) {
            const double error = std::abs(static_cast<double>(back[c][i]) - expected[c]);
            sums.reference_error = std::max(sums.reference_error, error);
            if (!(error <= reference_tolerance))
                return Error{ErrorKind::input, fmt::format("{}: colour {} of the check: the kernels give {} where sums in double give {}: not timed",
                                                           path, i, back[c][i], expected[c])};
            rgb[c] = static_cast<double>(picked[c][i]);
        }
        master.reflectance(rgb, own);
        for (std::size_t l = 0; l < master_weights.size(); ++l) {
            Vector3 xyz{}, wanted{};
            for (std::size_t c = 0; c < 3; ++c) {
                CompensatedSum a, b;
                for (std::size_t k = 0; k < bands; ++k) a.add(stored_weights[l].w[c * bands + k] * spectrum[k]);
                for (std::size_t k = 0; k < full; ++k) b.add(master_weights[l].w[c * full + k] * own[k]);
                xyz[c] = a.value(), wanted[c] = b.value();
            }
            const auto& white = master_weights[l].white;
            const double de = delta_e2000(lab_from_xyz(wanted, white), lab_from_xyz(xyz, white));
            sums.relight.add(de);
            sums.relight_max = std::max(sums.relight_max, de);
            ++sums.relit;
        }
    }
    return {};
}

/// One file: the kernels alone. @return {store, reproject} seconds.
std::array<double, 2> time_kernels(const StorePlan& plan, const BoundedStore* bounded, const std::array<std::vector<float>, 3>& colours, int threads) {
    const std::size_t n = colours[0].size(), blocks = (n + pixels_per_task - 1) / pixels_per_task;
    std::array<double, 2> total{};
    tbb::task_arena arena(threads > 0 ? threads : tbb::task_arena::automatic);
    // What the timing writes stays in the caches, as in the pipeline, whose strips are sized to them.
    const auto run = [&](bool reproject) {
        arena.execute([&] {
            parallel_for(std::size_t{0}, blocks, [&](std::size_t b) {
                thread_local std::array<std::vector<float>, 3> out;
                const std::size_t begin = b * pixels_per_task, count = std::min(pixels_per_task, n - begin);
                Stored stored(plan, count);
                store_block(plan, bounded, {colours[0].data() + begin, colours[1].data() + begin, colours[2].data() + begin}, count, stored.planes);
                if (!reproject) return;
                for (auto& plane : out) plane.resize(pixels_per_task);
                plan.reproject(std::vector<const std::byte*>(stored.planes.begin(), stored.planes.end()), count,
                               {out[0].data(), out[1].data(), out[2].data()});
            });
        });
    };
    run(true);  // whatever a model makes at its first colour
    auto begin = std::chrono::steady_clock::now();
    run(false);
    total[0] = seconds_since(begin);
    begin = std::chrono::steady_clock::now();
    run(true);
    total[1] = std::max(seconds_since(begin) - total[0], 0.0);
    return total;
}

Result<std::vector<TristimulusWeights>> weights_of(const BandSet& bands, const Colorimetry& c, std::span<const Illuminant> lights) {
    std::vector<TristimulusWeights> out;
    for (const auto& light : lights) {
        // The same scale on both grids: what a band set does not cover is missing from its colours.
        auto weights = tristimulus_weights(bands, c.observer(), light, Normalization::none);
        if (!weights) return std::move(weights).error();
        out.push_back(*std::move(weights));
    }
    return out;
}

std::uint32_t hash_of(std::uint32_t x, std::uint32_t y, std::uint32_t c) {
    std::uint32_t h = x * 0x9e3779b1u ^ (y * 0x85ebca77u + 0x165667b1u) ^ c * 0xc2b2ae3du;
    h = (h ^ h >> 15) * 0x2c1b3c6du;
    h = (h ^ h >> 12) * 0x297a2d39u;
    return h ^ h >> 15;
}

}  // namespace

std::string kernel_choice_name(KernelChoice choice) {
    const auto supported = static_cast<std::uint64_t>(hwy::SupportedTargets() & HWY_TARGETS);
    const std::int64_t target = choice == KernelChoice::narrowest ? ChosenKernel::narrowest() : static_cast<std::int64_t>(supported & (~supported + 1));
    return hwy::TargetName(target);
}

Result<TradeoffRow> measure_tradeoff(const TradeoffOptions& options) {
    if (options.corpus.empty() || options.lights.empty() || options.scratch.empty() || options.runs < 1)
        return Error{ErrorKind::usage, "tradeoff: expected textures, lights, a folder and at least one run"};
    const auto& settings = options.settings;
    const auto c = Colorimetry::make(settings.colorimetry, settings.bands);
    if (!c) return c.error();
    const auto model = make_model(settings.method, *c);
    if (!model) return model.error();
    const auto full = Colorimetry::make(settings.colorimetry, BandSet());
    if (!full) return full.error();
    const auto master = make_model(settings.method, *full);
    if (!master) return master.error();
    const auto stored_weights = weights_of(settings.bands, *c, options.lights);
    if (!stored_weights) return stored_weights.error();
    const auto master_weights = weights_of(full->bands(), *full, options.lights);
    if (!master_weights) return master_weights.error();

    const ChosenKernel kernel(options.kernel);
    JobOptions job;
    job.threads = options.threads;
    TradeoffRow row;
    Sums sums;
    CompensatedSum mean, squares;
    std::uint64_t bytes = 0;
    for (const auto& path : options.corpus) {
        UpliftOptions uplifting;
        uplifting.job = job;
        uplifting.settings = settings;
        uplifting.settings.model = *model;  // a part of the set-up, as for whoever converts many files
        uplifting.compression = options.compression;
        const ScratchFile file{fmt::format("{}/.spxbench-{}{}", options.scratch, ::getpid(), settings.type == PixelType::uint8 ? ".png" : ".exr")};
        const auto colours = colours_of(path, *c, job, settings.gamut, computed_colours);
        if (!colours) return colours.error();
        auto type = settings.type;
        {
            // Written once without being timed: the type follows from the file, and the disk's cache is warm for all alike.
            const auto report = uplift(path, file.path, uplifting);
            if (!report) return report.error();
            type = report->type;
            row.pixels += static_cast<std::uint64_t>(report->input.width) * static_cast<std::uint64_t>(report->input.height);
            bytes += report->file_bytes;
        }
        const auto plan = StorePlan::make(*model, settings.store, *type);
        if (!plan) return plan.error();
        row.channels = plan->channels();
        std::optional<BoundedStore> bounded;
        if (settings.max_error) {
            auto made = BoundedStore::make(*plan, *model, settings.store, *settings.max_error, settings.lights, nullptr);
            if (!made) return std::move(made).error();
            bounded = *std::move(made);
        }
        const BoundedStore* bound = bounded ? &*bounded : nullptr;
        if (auto checked = check_colours(path, *plan, bound, **model, **master, settings.store, *stored_weights, *master_weights, *colours, sums); !checked)
            return checked.error();
        const auto [store, reproject] = time_kernels(*plan, bound, *colours, options.threads);
        row.store_seconds += store;
        row.reproject_seconds += reproject;
        row.computed += (*colours)[0].size();
        std::vector<double> seconds;
        PeakMemory::reset();
        for (int run = 0; run < options.runs; ++run) {
            const auto begin = std::chrono::steady_clock::now();
            if (const auto report = uplift(path, file.path, uplifting); !report) return report.error();
            seconds.push_back(seconds_since(begin));
        }
        row.peak_bytes = std::max(row.peak_bytes, PeakMemory::bytes());
        std::nth_element(seconds.begin(), seconds.begin() + options.runs / 2, seconds.end());
        row.file_seconds += seconds[static_cast<std::size_t>(options.runs / 2)];
        DifferenceOptions comparing;
        comparing.job = job;
        comparing.observer = settings.colorimetry.observer;
        const auto difference = compare_files(path, file.path, comparing);
        if (!difference) return difference.error();
        const auto& d = difference->statistics;
        mean.add(d.mean * static_cast<double>(d.pixels));
        squares.add(d.rms * d.rms * static_cast<double>(d.pixels));
        auto& all = row.roundtrip;
        all.pixels += d.pixels, all.nonfinite += d.nonfinite, all.changed_codes += d.changed_codes;
        all.p50 = std::max(all.p50, d.p50), all.p95 = std::max(all.p95, d.p95), all.p99 = std::max(all.p99, d.p99);
        all.p999 = std::max(all.p999, d.p999), all.max = std::max(all.max, d.max);
    }
    const auto pixels = static_cast<double>(std::max<std::uint64_t>(row.roundtrip.pixels, 1));
    row.roundtrip.mean = mean.value() / pixels;
    row.roundtrip.rms = std::sqrt(squares.value() / pixels);
    row.bytes_per_texel = static_cast<double>(bytes) / static_cast<double>(row.pixels);
    row.relight_mean = sums.relight.value() / static_cast<double>(std::max<std::uint64_t>(sums.relit, 1));
    row.relight_max = sums.relight_max;
    row.reference_error = sums.reference_error;
    return row;
}

Status write_test_texture(const std::string& path, int width, int height) {
    Geometry geometry;
    geometry.width = geometry.full_width = width;
    geometry.height = geometry.full_height = height;
    WriteOptions options;
    options.type = PixelType::uint8;
    auto writer = ImageWriter::create(path, geometry, {"R", "G", "B"}, false, {}, options);
    if (!writer) return writer.error();
    const int rows = std::max(1, std::min(height, (1 << 20) / std::max(width, 1)));
    std::vector<std::byte> strip(static_cast<std::size_t>(rows) * static_cast<std::size_t>(width) * 3);
    for (int y = 0; y < height; y += rows) {
        const int n = std::min(rows, height - y);
        parallel_for(0, n, [&](int row) {
            std::byte* out = strip.data() + static_cast<std::size_t>(row) * static_cast<std::size_t>(width) * 3;
            for (int x = 0; x < width; ++x)
                for (std::uint32_t c = 0; c < 3; ++c) {
                    const auto u = static_cast<std::uint32_t>(x), v = static_cast<std::uint32_t>(y + row);
                    // Hills of different widths for each component, and grain of a photograph's strength.
                    const double hill = std::sin(static_cast<double>(u) / (61 + 17 * c) + c) * std::cos(static_cast<double>(v) / (83 - 13 * c)) +
                                        0.5 * std::sin(static_cast<double>(u + v) / (19 + 5 * c));
                    const double grain = static_cast<double>(hash_of(u, v, c) & 7) - 3.5;
                    *out++ = static_cast<std::byte>(std::lround(std::clamp(127.5 + 85 * hill + grain, 0.0, 255.0)));
                }
        });
        if (auto written = (*writer)->write_rows(y, n, strip.data()); !written) return written;
    }
    return (*writer)->commit();
}

std::vector<std::size_t> pareto_front(std::span<const std::array<double, 2>> points) {
    std::vector<std::size_t> order(points.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return points[a] < points[b]; });
    std::vector<std::size_t> front;
    for (const std::size_t i : order)
        if (front.empty() || points[i][1] < points[front.back()][1]) front.push_back(i);
    return front;
}

}  // namespace spectex
