#include <fmt/format.h>
#include <fmt/ranges.h>
#include <xxhash.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <limits>
#include <map>

#include "kernels/convert.h"
#include "pipeline/roundtrip.h"
#include "pipeline/source.h"
#include "pipeline/strips.h"
#include "plan/choose_bands.h"

namespace spectex {
namespace {

using namespace pipeline;

/// Without --check, one row in so many is measured: enough to put a figure into the header at a few percent of the time.
constexpr int sampled_row_stride = 16;

/// A fixed-width text that the writer replaces once the figures are known.
constexpr std::size_t roundtrip_text_size = 160;

std::string padded(std::string text) {
    text.resize(roundtrip_text_size, ' ');
    return text;
}

std::string roundtrip_text(const DifferenceStatistics& s, bool all) {
    return padded(fmt::format("CIE76 mean {:.6g} p99 {:.6g} max {:.6g} changed8bit {} over {} pixels, {}", s.mean, s.p99, s.max,
                              s.changed_codes, s.pixels, all ? "all rows" : fmt::format("every {}th row", sampled_row_stride)));
}

/// The same for what --max-error came to.
std::string bounded_text(const BoundedReport& b) {
    std::string text = fmt::format("CIE76 bound {:g} on every pixel, kept bits mean {:.3g}, max", b.bound, b.mean_bits);
    for (const auto& check : b.checks) text += fmt::format(" {} {:.6g}", check.name, check.max);
    return text;
}

/// Room for bounded_text: as long a text as it can become.
std::string bounded_placeholder(const BoundedStore& store, std::size_t checks) {
    BoundedReport longest{store.bound(), -1.23456e-100, {}, {}};
    for (std::size_t c = 0; c < checks; ++c) longest.checks.push_back({store.check_name(c), -1.23456e-100});
    return bounded_text(longest);
}

/// R, G, B preview: the stored reflectance under D65 for CIE 1931, linear BT.709.
Result<RelightPlan> preview_plan(const std::shared_ptr<const Model>& model) {
    RelightRequest request;
    auto d65 = parse_illuminant("D65");
    if (!d65) return std::move(d65).error();
    request.illuminants = {*std::move(d65)};
    return RelightPlan::for_model(model, request);
}

/// A bound for --bands auto --for where none is named: a quarter of what is seen side by side.
constexpr double default_band_bound = 0.5;
/// What half precision may take of a bound; the bands have the rest.
constexpr double half_share = 0.25;
/// Colours by which bands are chosen; a texture of fewer is covered whole.
constexpr std::size_t most_sampled_colors = 16384;

/// The texture's colours whose hashes are smallest: all of them, or an even sample, whatever their order.
Result<std::vector<float>> sample_colors(StripSource& source, const Colorimetry& colorimetry, GamutPolicy gamut) {
    std::map<std::uint64_t, std::array<float, 3>> kept;
    const int width = source.geometry().width, height = source.geometry().height;
    const int rows = rows_per_strip(source.preferred_rows(), source.raw_bytes_per_row() + static_cast<std::size_t>(width) * 24, height);
    RawStrip raw;
    std::vector<std::vector<float>> scratch;
    std::vector<const float*> planes;
    std::array<std::vector<float>, 3> rgb;
    const GamutPolicy mapped = gamut == GamutPolicy::error ? GamutPolicy::clip : gamut;
    for (int y = 0; y < height; y += rows) {
        const int count = std::min(rows, height - y);
        if (auto s = source.read(y, count, raw); !s) return s.error();
        const std::size_t n = static_cast<std::size_t>(count) * static_cast<std::size_t>(width);
        source.decode(raw, 0, n, scratch, planes);
        for (std::size_t c = 0; c < 3; ++c) rgb[c].assign(planes[c], planes[c] + n);
        Counts counts;
        const std::string path;
        if (auto s = map_colors({rgb[0].data(), rgb[1].data(), rgb[2].data()}, n, mapped, colorimetry, {path, y, 0, width}, counts); !s)
            return s.error();
        for (std::size_t p = 0; p < n; ++p) {
            const std::array<float, 3> color{rgb[0][p], rgb[1][p], rgb[2][p]};
            const std::uint64_t hash = XXH3_64bits(color.data(), sizeof color);
            if (kept.size() == most_sampled_colors) {
                if (hash >= kept.rbegin()->first) continue;
                if (kept.emplace(hash, color).second) kept.erase(std::prev(kept.end()));
            } else {
                kept.emplace(hash, color);
            }
        }
    }
    std::vector<float> colors;
    for (const auto& [hash, color] : kept) colors.insert(colors.end(), color.begin(), color.end());
    return colors;
}

/// Planes of codes into an ordinary 8-bit picture: R, G, B and perhaps alpha.
class CodeWriter final : public ExrWriter {
public:
    static Result<std::unique_ptr<ExrWriter>> create(const std::string& path, const Geometry& geometry, const ExrPart& part, const WriteOptions& options) {
        std::vector<std::string> names;
        for (const auto& channel : part.channels) names.push_back(channel.name);
        if (names.size() > 3 && (names.size() > 4 || names[3] != "A"))
            return Error{ErrorKind::output, fmt::format("{}: 8-bit coefficients leave room for alpha alone beside them, not for {}: --channels leaves them out", path,
                                                        fmt::join(names.begin() + 3, names.end(), ", "))};
        Attributes metadata = part.attributes;
        // Known when the header is long written.
        metadata.erase("spectex:roundtrip");
        // Codes are kept as they are, whatever alpha says of them.
        auto writer = ImageWriter::create(path, geometry, names, false, metadata, options);
        if (!writer) return std::move(writer).error();
        if ((*writer)->type() != PixelType::uint8) return Error{ErrorKind::output, fmt::format("{}: holds no 8-bit samples", path)};
        return std::unique_ptr<ExrWriter>(std::make_unique<CodeWriter>(*std::move(writer), geometry.width, names.size()));
    }
    CodeWriter(std::unique_ptr<ImageWriter> writer, int width, std::size_t channels) : writer_(std::move(writer)), width_(static_cast<std::size_t>(width)), channels_(channels) {}

    Status write_rows(int y, int rows, std::span<const std::byte* const> planes) override {
        const std::size_t pixels = width_ * static_cast<std::size_t>(rows);
        samples_.resize(pixels * channels_);
        for (std::size_t c = 0; c < channels_; ++c)
            for (std::size_t p = 0; p < pixels; ++p) samples_[p * channels_ + c] = planes[c][p];
        return writer_->write_rows(y, rows, samples_.data());
    }
    Status replace_text(const std::string&, const std::string&) override { return {}; }
    Status commit() override { return writer_->commit(); }

private:
    std::unique_ptr<ImageWriter> writer_;
    std::size_t width_, channels_;
    std::vector<std::byte> samples_;
};

struct Layouts {
    std::vector<ExrPart> parts;
    std::vector<std::size_t> order;  ///< for each plane handed to the writer, its index in the strip's planes
};

}  // namespace

namespace pipeline {

Result<UpliftSetup> UpliftSetup::make(const std::string& input, const UpliftSettings& settings, const JobOptions& job) {
    const auto kind = probe(input);
    if (!kind) return kind.error();
    if (*kind != FileKind::image)
        return Error{ErrorKind::input, fmt::format("{}: holds {} already: expected an RGB texture", input,
                                                   *kind == FileKind::spectral ? "spectra" : "coefficients")};
    auto solved = settings.model ? Result<std::shared_ptr<const Model>>(settings.model) : solve_model(settings);
    if (!solved) return std::move(solved).error();
    const Colorimetry& colorimetry = (*solved)->colorimetry();
    auto source = open_image_source(input, colorimetry.rgb_space(), job);
    if (!source) return std::move(source).error();
    const PixelType type = settings.type.value_or(default_stored_type((*source)->type()));
    if (type == PixelType::uint8 && settings.max_error)
        return Error{ErrorKind::usage, "a largest error rounds mantissas, which 8-bit codes do not have: expected half or float"};
    std::optional<BandChoice> choice;
    const double bound = settings.max_error.value_or(default_band_bound);
    if (settings.choose_bands && settings.store == Store::spectral) {
        if (settings.lights.empty())
            return Error{ErrorKind::usage, "bands are chosen for lights: expected at least one"};
        const auto colors = sample_colors(**source, colorimetry, settings.gamut);
        if (!colors) return colors.error();
        auto chosen = choose_bands(settings.method, settings.colorimetry, settings.lights,
                                   type == PixelType::half ? bound * (1 - half_share) : bound * 0.999, *colors, settings.least_bands);
        if (!chosen) return Error{chosen.error().kind, fmt::format("{}: {}", input, chosen.error().message)};
        choice = *std::move(chosen);
        source = open_image_source(input, colorimetry.rgb_space(), job);
        if (!source) return std::move(source).error();
    }
    auto model = choice ? choice->model : *solved;
    auto plan = StorePlan::make(model, settings.store, type);
    if (!plan) return std::move(plan).error();
    UpliftSetup setup(*std::move(source), std::move(model), *std::move(plan), settings.gamut);
    const auto& others = setup.source->others();
    for (std::size_t i = 0; settings.skip_transparent && i < others.size(); ++i)
        if (others[i].name == "A") setup.alpha = i;
    if (settings.skip_transparent)
        setup.chosen.push_back({"skipped", setup.alpha ? "colours of texels whose alpha is 0: stored as black"
                                                       : "no texel: the texture has no alpha"});
    if (choice) {
        const auto& nm = setup.model->colorimetry().bands().wavelengths_nm();
        setup.chosen.push_back({"bands", fmt::format("{} chosen for this texture's colours and lights: {} nm; largest CIE76 {:.3g} over {} "
                                                     "colours, against 380:780:5",
                                                     nm.size(), fmt::join(nm, ", "), choice->error, choice->colors)});
        const double of = static_cast<double>(choice->reference->colorimetry().bands().size());
        setup.chosen.push_back({"skipped", fmt::format("{} of {} bands: {:.0f}% of what they would take", of - static_cast<double>(nm.size()), of,
                                                       100 * (1 - static_cast<double>(nm.size()) / of))});
    }
    if (settings.max_error || choice) {
        auto bounded = BoundedStore::make(setup.plan, setup.model, settings.store, bound, settings.lights,
                                          choice ? choice->reference : nullptr, !settings.max_error);
        if (!bounded) return std::move(bounded).error();
        setup.bounded = std::make_shared<const BoundedStore>(*std::move(bounded));
    }
    return setup;
}

void count_unreached(const Model& model, std::array<const float*, 3> rgb, std::size_t n, std::size_t begin, Counts& counts) {
    if (model.info().pieces != Pieces::nonlinear || model.info().exact) return;
    std::vector<double> colors(3 * n);
    for (std::size_t p = 0; p < n; ++p)
        for (std::size_t c = 0; c < 3; ++c) colors[3 * p + c] = static_cast<double>(rgb[c][p]);
    const auto unreached = model.unreached(colors);
    counts.unreached += unreached.size();
    if (!unreached.empty()) counts.first_unreached = std::min(counts.first_unreached, begin + unreached.front());
}

Status map_colors(std::array<float*, 3> rgb, std::size_t n, GamutPolicy policy, const Colorimetry& colorimetry,
                  const GroupPlace& place, Counts& counts) {
    std::uint64_t replaced = 0;
    if (const auto first = replace_nonfinite(rgb, n, replaced); replaced > 0)
        counts.first_nonfinite = std::min(counts.first_nonfinite, place.begin + first);
    counts.nonfinite += replaced;
    const auto& to_xyz = colorimetry.rgb_to_xyz();
    GamutCounts gamut;
    const auto outside = map_into_gamut(rgb, n, policy, {to_xyz(1, 0), to_xyz(1, 1), to_xyz(1, 2)}, gamut);
    counts.out_of_gamut += gamut.out_of_gamut;
    if (!outside) return {};
    const auto width = static_cast<std::size_t>(place.width), p = place.begin + *outside;
    return Error{ErrorKind::input,
                 fmt::format("{}: pixel {},{} is ({}, {}, {}) in linear {}: expected 0 to 1, where reflectances lie; --gamut clip "
                             "or desaturate maps it",
                             place.path, p % width, p / width + static_cast<std::size_t>(place.strip_y), rgb[0][*outside],
                             rgb[1][*outside], rgb[2][*outside], colorimetry.rgb_space().name)};
}

Status UpliftSetup::convert(const RawStrip& raw, int y, std::size_t begin, std::size_t n, Scratch& scratch,
                            std::span<std::byte* const> planes, Counts& counts) const {
    std::vector<const float*> decoded;
    source->decode(raw, begin, n, scratch.decode, decoded);
    for (std::size_t c = 0; c < 3; ++c) {
        scratch.rgb[c].resize(std::max(scratch.rgb[c].size(), n));
        scratch.input[c].resize(std::max(scratch.input[c].size(), n));
        std::copy_n(decoded[c], n, scratch.input[c].data());
        std::copy_n(decoded[c], n, scratch.rgb[c].data());
    }
    if (alpha) {
        const std::size_t size = pixel_bytes(source->others()[*alpha].type);
        const std::byte zero[sizeof(float)] = {};
        std::vector<std::byte> values(n * size);
        source->copy_other(raw, *alpha, begin, n, values.data());
        for (std::size_t p = 0; p < n; ++p) {
            if (std::memcmp(&values[p * size], zero, size) != 0) continue;
            ++counts.transparent;
            for (std::size_t c = 0; c < 3; ++c) scratch.rgb[c][p] = scratch.input[c][p] = 0;
        }
    }
    const std::array<float*, 3> rgb{scratch.rgb[0].data(), scratch.rgb[1].data(), scratch.rgb[2].data()};
    const auto report = source->report();
    if (auto s = map_colors(rgb, n, gamut, model->colorimetry(), {report.path, y, begin, report.width}, counts); !s) return s;
    count_unreached(*model, {rgb[0], rgb[1], rgb[2]}, n, begin, counts);
    const std::array<const float*, 3> colors{rgb[0], rgb[1], rgb[2]};
    std::optional<BoundedStore::Failure> failure;
    scratch.greys.clear();
    if (forms_samples() && scratch.greys.find(colors, n)) {
        const DistinctGreys& greys = scratch.greys;
        const std::size_t size = pixel_bytes(plan.type());
        scratch.of_greys.resize(std::max(scratch.of_greys.size(), planes.size() * greys.size() * size));
        std::vector<std::byte*> distinct(planes.size());
        for (std::size_t i = 0; i < planes.size(); ++i) distinct[i] = scratch.of_greys.data() + i * greys.size() * size;
        failure = store(greys.rgb(), greys.size(), distinct, greys.counts(), counts);
        if (failure)
            failure->pixel = greys.first_of(failure->pixel);
        else
            for (std::size_t i = 0; i < planes.size(); ++i) {
                if (size == 1)
                    greys.spread(distinct[i], n, planes[i]);
                else if (size == sizeof(std::uint16_t))
                    greys.spread(reinterpret_cast<const std::uint16_t*>(distinct[i]), n, reinterpret_cast<std::uint16_t*>(planes[i]));
                else
                    greys.spread(reinterpret_cast<const float*>(distinct[i]), n, reinterpret_cast<float*>(planes[i]));
            }
        counts.grey += n;
    } else {
        failure = store(colors, n, planes, {}, counts);
    }
    if (!failure) return {};
    *over_bound = true;
    const auto width = static_cast<std::size_t>(report.width), p = begin + failure->pixel;
    return Error{ErrorKind::input,
                 fmt::format("{}: pixel {},{} stored as {} has a CIE76 of {:.3g} in its {}: more than --max-error {:g} allows; expected a "
                             "larger bound{}",
                             report.path, p % width, p / width + static_cast<std::size_t>(y), pixel_type_name(plan.type()),
                             failure->error, failure->check == 0 ? std::string("round trip") : "colour under " + bounded->check_name(failure->check), bounded->bound(),
                             plan.type() == PixelType::half ? " or --float" : "")};
}

std::optional<BoundedStore::Failure> UpliftSetup::store(std::array<const float*, 3> rgb, std::size_t n, std::span<std::byte* const> planes,
                                                        std::span<const std::uint32_t> times, Counts& counts) const {
    if (bounded) return bounded->store(rgb, n, planes, counts.bounded, times);
    plan.store(rgb, n, planes);
    return std::nullopt;
}

bool UpliftSetup::forms_samples() const {
    return bounded || plan.channels() != 3 || model->info().pieces == Pieces::nonlinear;
}

void UpliftSetup::reproject(std::span<const std::byte* const> planes, std::size_t n, Scratch& scratch) const {
    for (auto& plane : scratch.back) plane.resize(std::max(plane.size(), n));
    plan.reproject(planes, n, {scratch.back[0].data(), scratch.back[1].data(), scratch.back[2].data()});
}

void coefficient_planes(const Model& model, std::array<const float*, 3> rgb, std::size_t n, std::vector<std::vector<float>>& out) {
    const auto count = static_cast<std::size_t>(model.info().coefficients);
    out.resize(count);
    for (auto& plane : out) plane.resize(std::max(plane.size(), n));
    if (model.info().pieces != Pieces::nonlinear) {
        for (std::size_t i = 0; i < 3; ++i) std::copy_n(rgb[i], n, out[i].data());
        return;
    }
    std::vector<double> colors(3 * n), coefficients(count * n);
    for (std::size_t p = 0; p < n; ++p)
        for (std::size_t i = 0; i < 3; ++i) colors[3 * p + i] = rgb[i][p];
    model.coefficients(colors, coefficients);
    for (std::size_t i = 0; i < count; ++i)
        for (std::size_t p = 0; p < n; ++p) out[i][p] = static_cast<float>(coefficients[p * count + i]);
}

void UpliftSetup::preview(const RelightPlan& to_preview, std::array<const float*, 3> rgb, std::size_t n, Scratch& scratch) const {
    const DistinctGreys& greys = scratch.greys;
    std::vector<std::vector<float>> coefficients, lit(greys.found() ? 3 : 0, std::vector<float>(greys.size()));
    coefficient_planes(*model, greys.found() ? greys.rgb() : rgb, greys.found() ? greys.size() : n, coefficients);
    std::vector<const float*> in;
    for (const auto& plane : coefficients) in.push_back(plane.data());
    for (auto& plane : scratch.back) plane.resize(std::max(plane.size(), n));
    const std::array<float*, 3> out{scratch.back[0].data(), scratch.back[1].data(), scratch.back[2].data()};
    if (greys.found()) {
        to_preview.execute(in, greys.size(), std::array<float*, 3>{lit[0].data(), lit[1].data(), lit[2].data()});
        for (std::size_t c = 0; c < 3; ++c) greys.spread(lit[c].data(), n, out[c]);
    } else {
        to_preview.execute(in, n, out);
    }
    for (float* plane : out)
        for (std::size_t p = 0; p < n; ++p) plane[p] = std::max(plane[p], 0.0f);
}

void measure_row(const UpliftSetup& setup, const DifferenceKernel& kernel, Scratch& scratch, std::span<std::byte* const> planes,
                 std::size_t offset, std::size_t n, float* difference, std::uint64_t& changed) {
    std::vector<const std::byte*> run;
    const std::size_t size = pixel_bytes(setup.plan.type());
    for (const std::byte* plane : planes) run.push_back(plane + offset * size);
    setup.reproject(run, n, scratch);
    const std::array<const float*, 3> a{scratch.input[0].data() + offset, scratch.input[1].data() + offset,
                                        scratch.input[2].data() + offset};
    const std::array<const float*, 3> b{scratch.back[0].data(), scratch.back[1].data(), scratch.back[2].data()};
    kernel(a, b, n, difference);
    changed = count_changed_codes(a, b, n);
}

Explanation UpliftSetup::explanation() const {
    Explanation lines = source->explanation();
    lines.push_back({"method", fmt::format("{}: {}", model->info().id, model->info().source)});
    lines.push_back({"colorimetry", model->colorimetry().describe()});
    lines.push_back({"outside [0,1]", gamut == GamutPolicy::clip         ? "each component clipped, counted"
                                      : gamut == GamutPolicy::desaturate ? "towards the grey of the same luminance, counted"
                                                                         : "an error"});
    lines.insert(lines.end(), chosen.begin(), chosen.end());
    lines.insert(lines.end(), plan.explanation().begin(), plan.explanation().end());
    if (forms_samples())
        lines.push_back(source->grey() && source->type() == PixelType::uint8
                            ? PlanLine{"skipped", "all but 256 greys of each 8192 pixels: 97% are not uplifted but copied from those that are"}
                            : PlanLine{"greys", "where 8192 pixels hold no colour, each distinct grey is uplifted once and copied to the others"});
    if (bounded) {
        std::erase_if(lines, [](const PlanLine& line) { return line.key == "rounding"; });
        const auto more = bounded->explanation();
        lines.insert(lines.end(), more.begin(), more.end());
    }
    return lines;
}

Status check_strict(const JobOptions& job, const InputReport& report) {
    if (!job.strict || report.nonfinite == 0) return {};
    return Error{ErrorKind::input,
                 fmt::format("{}: {} pixels are not finite, the first at {},{}: expected numbers, with --strict", report.path,
                             report.nonfinite, report.first_nonfinite[0], report.first_nonfinite[1])};
}

void CountTotals::add(const Counts& counts, int strip_y, int width) {
    const std::lock_guard lock(mutex_);
    nonfinite_ += counts.nonfinite;
    out_of_gamut_ += counts.out_of_gamut;
    bounded_.add(counts.bounded);
    transparent_ += counts.transparent;
    grey_ += counts.grey;
    unreached_ += counts.unreached;
    if (counts.first_unreached != std::numeric_limits<std::size_t>::max())
        first_unreached_ = std::min(first_unreached_, static_cast<std::uint64_t>(strip_y) * static_cast<std::uint64_t>(width) + counts.first_unreached);
    if (counts.first_nonfinite != std::numeric_limits<std::size_t>::max())
        first_ = std::min(first_, static_cast<std::uint64_t>(strip_y) * static_cast<std::uint64_t>(width) + counts.first_nonfinite);
}

void CountTotals::put_into(InputReport& report) const {
    report.nonfinite = nonfinite_;
    report.out_of_gamut = out_of_gamut_;
    report.unreached = unreached_;
    if (unreached_ > 0) {
        const auto width = static_cast<std::uint64_t>(report.width);
        report.first_unreached = {static_cast<std::int64_t>(first_unreached_ % width), static_cast<std::int64_t>(first_unreached_ / width)};
    }
    if (nonfinite_ > 0) {
        const auto width = static_cast<std::uint64_t>(report.width);
        report.first_nonfinite = {static_cast<std::int64_t>(first_ % width), static_cast<std::int64_t>(first_ / width)};
    }
}

}  // namespace pipeline

namespace {

Layouts lay_out(const UpliftSetup& setup, const UpliftOptions& options, bool preview) {
    const auto& colorimetry = setup.model->colorimetry();
    const PixelType type = setup.plan.type();
    Attributes common = setup.source->metadata();
    common["spectex:version"] = std::string(version());
    common["spectex:method"] = setup.model->info().id;
    common["spectex:observer"] = colorimetry.observer().id;
    common["spectex:illuminant"] = colorimetry.illuminant().name;
    common["spectex:rgbSpace"] = colorimetry.rgb_space().name;
    common["spectex:matrix"] = std::string("integrated");
    common["spectex:alpha"] = std::string(setup.source->alpha_associated() ? "associated" : "straight");
    common["spectex:roundtrip"] = padded("not measured");
    if (setup.bounded) common["spectex:maxError"] = bounded_placeholder(*setup.bounded, 1 + options.settings.lights.size());

    ExrPart color, data;
    std::vector<std::size_t> color_planes, data_planes;
    const std::size_t stored = setup.plan.channels();
    if (options.settings.store == Store::coefficients) {
        common["spectex:coefficients"] = fmt::format("{}", fmt::join(setup.plan.channel_names(), ","));
        common["spectex:model"] = setup.model->to_json();
        for (std::size_t i = 0; i < stored; ++i) {
            data.channels.push_back({setup.plan.channel_names()[i], type});
            data_planes.push_back(i);
        }
        // Piecewise linear methods store linear RGB itself: any viewer shows it, in its own primaries.
        if (setup.model->info().pieces != Pieces::nonlinear && colorimetry.rgb_space().name != "BT.709") {
            std::vector<float> xy;
            for (const auto& p : colorimetry.rgb_space().primaries_xy)
                for (const double v : p) xy.push_back(static_cast<float>(v));
            for (const double v : colorimetry.rgb_space().white_xy) xy.push_back(static_cast<float>(v));
            common["chromaticities"] = xy;
        }
    } else {
        common["spectralLayoutVersion"] = std::string("1.0");
        common["EV"] = 0.0f;
        common["spectex:kernel"] = std::string("linear");
        // What the bands were solved for, a lamp of the user's own included.
        common["spectex:solvedFor"] = setup.model->to_json();
        for (std::size_t i = 0; i < stored; ++i) {
            data.channels.push_back({setup.plan.channel_names()[i], type});
            data_planes.push_back(i);
        }
    }
    if (preview)
        for (std::size_t i = 0; i < 3; ++i) {
            color.channels.push_back({std::string(1, "RGB"[i]), type});
            color_planes.push_back(stored + i);
        }
    const std::size_t first_other = stored + (preview ? 3 : 0);
    const auto& others = setup.source->others();
    for (std::size_t i = 0; i < others.size(); ++i) {
        // One pixel type for all where no value can change by it; a float AOV keeps its floats.
        const bool wide = type != PixelType::uint8 && (others[i].type == PixelType::float32 || (others[i].type == PixelType::uint16 && others[i].name != "A"));
        color.channels.push_back({others[i].name, wide ? PixelType::float32 : type});
        color_planes.push_back(first_other + i);
    }

    Layouts result;
    if (type == PixelType::uint8) {
        data.attributes = common;
        data.attributes["spectex:encoding"] = std::string("srgb");
        data.channels.insert(data.channels.end(), color.channels.begin(), color.channels.end());
        result.order = data_planes;
        result.order.insert(result.order.end(), color_planes.begin(), color_planes.end());
        result.parts = {std::move(data)};
    } else if (options.layout == Layout::single || color.channels.empty()) {
        ExrPart part;
        part.name = options.settings.store == Store::spectral ? "spectrum" : "coefficients";
        part.attributes = common;
        part.channels = color.channels;
        part.channels.insert(part.channels.end(), data.channels.begin(), data.channels.end());
        result.order = color_planes;
        result.order.insert(result.order.end(), data_planes.begin(), data_planes.end());
        result.parts = {std::move(part)};
    } else {
        color.name = "rgb";
        color.attributes = setup.source->metadata();
        data.name = options.settings.store == Store::spectral ? "spectrum" : "coefficients";
        data.attributes = common;
        result.order = color_planes;
        result.order.insert(result.order.end(), data_planes.begin(), data_planes.end());
        result.parts = {std::move(color), std::move(data)};
    }
    return result;
}

/// Whether every pixel of a texture has the bytes of its first one, in all channels.
Result<bool> is_constant(const std::string& input, const RgbSpace& space, const JobOptions& job) {
    auto source = open_image_source(input, space, job);
    if (!source) return std::move(source).error();
    const int height = (*source)->geometry().height;
    const std::size_t row = (*source)->raw_bytes_per_row(), size = row / static_cast<std::size_t>((*source)->geometry().width);
    const int rows = rows_per_strip((*source)->preferred_rows(), row, height);
    RawStrip raw;
    std::vector<std::byte> first;
    for (int y = 0; y < height; y += rows) {
        const int count = std::min(rows, height - y);
        if (auto s = (*source)->read(y, count, raw); !s) return s.error();
        if (first.empty()) first.assign(raw.samples.begin(), raw.samples.begin() + static_cast<std::ptrdiff_t>(size));
        // Equal to the first pixel and each to the one before it: every one is the same.
        const std::size_t bytes = row * static_cast<std::size_t>(count);
        if (std::memcmp(raw.samples.data(), first.data(), size) != 0 ||
            std::memcmp(raw.samples.data(), raw.samples.data() + size, bytes - size) != 0)
            return false;
    }
    return true;
}

PlanLine constant_line(bool constant, const Geometry& geometry) {
    if (!constant) return {"constant", "no: every pixel is stored"};
    return {"skipped", fmt::format("{} of {} pixels: the texture is constant and stored as 1 x 1",
                                   std::int64_t{geometry.width} * geometry.height - 1, std::int64_t{geometry.width} * geometry.height)};
}

bool has_suffix(const std::string& path, std::string_view suffix) {
    if (path.size() < suffix.size()) return false;
    for (std::size_t i = 0; i < suffix.size(); ++i) {
        const char c = path[path.size() - suffix.size() + i];
        if ((c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c) != suffix[i]) return false;
    }
    return true;
}

}  // namespace

PixelType default_stored_type(PixelType input) {
    return input == PixelType::uint8 || input == PixelType::half ? PixelType::half : PixelType::float32;
}

Result<std::shared_ptr<const Model>> solve_model(const UpliftSettings& settings) {
    auto colorimetry = Colorimetry::make(settings.colorimetry, settings.bands);
    if (!colorimetry) return std::move(colorimetry).error();
    return make_model(settings.method, *colorimetry);
}

Result<Explanation> explain_uplift(const std::string& input, const UpliftOptions& options) {
    const auto setup = UpliftSetup::make(input, options.settings, options.job);
    if (!setup) return setup.error();
    auto lines = setup->explanation();
    if (options.constant_to_pixel) {
        const auto constant = is_constant(input, setup->model->colorimetry().rgb_space(), options.job);
        if (!constant) return constant.error();
        lines.push_back(constant_line(*constant, setup->source->geometry()));
    }
    lines.push_back({"check", options.check_all ? "round trip of every pixel" : "round trip of every 16th row, into the header"});
    return lines;
}

namespace {

/// @param missed  the number of bands that were chosen, where some pixel is off by more than the bound with them; else 0.
Result<UpliftReport> uplift_once(const std::string& input, const std::string& output, const UpliftOptions& options, std::size_t& missed) {
    const bool codes = options.settings.type == PixelType::uint8;
    if (codes && !has_suffix(output, ".png"))
        return Error{ErrorKind::usage, fmt::format("{}: 8-bit coefficients are stored as PNG, which keeps their model: expected a name that ends in .png", output)};
    if (codes && options.layout == Layout::multipart)
        return Error{ErrorKind::usage, fmt::format("{}: 8-bit coefficients have one part: expected the single layout", output)};
    if (!codes && !has_suffix(output, ".exr"))
        return Error{ErrorKind::usage, fmt::format("{}: spectra and coefficients are stored as OpenEXR: expected a name that ends "
                                                   "in .exr",
                                                   output)};
    if (same_file(input, output)) return Error{ErrorKind::usage, fmt::format("{}: the output is the input itself", output)};
    auto setup = UpliftSetup::make(input, options.settings, options.job);
    if (!setup) return std::move(setup).error();
    const bool spectral = options.settings.store == Store::spectral;
    // Spectra, and coefficients that no viewer can show, get a preview; linear RGB, which some methods keep, is one.
    const auto& names = setup->plan.channel_names();
    const bool preview = spectral || std::find(names.begin(), names.end(), "R") == names.end();
    std::optional<RelightPlan> to_preview;
    if (preview) {
        auto plan = preview_plan(setup->model);
        if (!plan) return std::move(plan).error();
        to_preview = *std::move(plan);
    }
    const Layouts layout = lay_out(*setup, options, preview);
    Geometry geometry = setup->source->geometry();
    bool constant = false;
    if (options.constant_to_pixel) {
        const auto found = is_constant(input, setup->model->colorimetry().rgb_space(), options.job);
        if (!found) return found.error();
        constant = *found;
    }
    if (constant) {
        // The windows go with the size: what was a frame has no place around one texel.
        geometry.x = geometry.y = geometry.full_x = geometry.full_y = 0;
        geometry.width = geometry.height = geometry.full_width = geometry.full_height = 1;
    }
    const PixelType type = setup->plan.type();
    const WriteOptions write{type, options.compression, options.job.threads};
    auto writer = codes ? CodeWriter::create(output, geometry, layout.parts[0], write) : ExrWriter::create(output, geometry, layout.parts, write);
    if (!writer) return std::move(writer).error();

    const std::size_t stored = setup->plan.channels(), first_other = stored + (preview ? 3u : 0u);
    const auto& others = setup->source->others();
    std::vector<PixelType> types(first_other + others.size(), type);
    {
        std::size_t at = 0;
        for (const auto& part : layout.parts)
            for (const auto& channel : part.channels) types[layout.order[at++]] = channel.type;
    }
    const int width = geometry.width, stride = options.check_all ? 1 : sampled_row_stride;
    struct Buffers {
        RawStrip raw;
        std::vector<std::vector<std::byte>> planes;
        std::vector<float> difference;
        std::vector<std::uint64_t> changed;
    };
    std::size_t row_bytes = setup->source->raw_bytes_per_row();
    for (const auto t : types) row_bytes += static_cast<std::size_t>(width) * pixel_bytes(t);
    const int rows = rows_per_strip(setup->source->preferred_rows(), row_bytes, geometry.height);

    const auto& colorimetry = setup->model->colorimetry();
    const DifferenceKernel difference(Metric::cie76, colorimetry.rgb_to_xyz(), colorimetry.rgb_to_xyz(), colorimetry.white_xyz());
    DifferenceAccumulator accumulator;
    CountTotals totals;

    const auto status = run_strips(
        options.job, width, geometry.height, rows, [] { return Buffers{}; },
        [&](Buffers& b, int y, int n) { return setup->source->read(y, n, b.raw); },
        [&](Buffers& b, int y, int n) -> Status {
            const std::size_t pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(n);
            b.planes.resize(types.size());
            for (std::size_t i = 0; i < types.size(); ++i) b.planes[i].resize(pixels * pixel_bytes(types[i]));
            b.difference.resize(pixels);
            b.changed.assign(static_cast<std::size_t>(n), 0);
            FirstError error;
            for_row_groups(n, width, [&](int first, int count) {
                thread_local Scratch scratch;
                const std::size_t begin = static_cast<std::size_t>(first) * static_cast<std::size_t>(width);
                const std::size_t size = static_cast<std::size_t>(count) * static_cast<std::size_t>(width);
                std::vector<std::byte*> planes(stored);
                for (std::size_t i = 0; i < stored; ++i) planes[i] = b.planes[i].data() + begin * pixel_bytes(types[i]);
                Counts counts;
                error.check(setup->convert(b.raw, y, begin, size, scratch, planes, counts));
                totals.add(counts, y, width);
                if (to_preview) {
                    const std::array<const float*, 3> rgb{scratch.rgb[0].data(), scratch.rgb[1].data(), scratch.rgb[2].data()};
                    setup->preview(*to_preview, rgb, size, scratch);
                    for (std::size_t i = 0; i < 3; ++i)
                        convert_samples(reinterpret_cast<const std::byte*>(scratch.back[i].data()), PixelType::float32, size,
                                        b.planes[stored + i].data() + begin * pixel_bytes(type), type);
                }
                std::vector<std::byte> other;
                for (std::size_t i = 0; i < others.size(); ++i) {
                    other.resize(size * pixel_bytes(others[i].type));
                    setup->source->copy_other(b.raw, i, begin, size, other.data());
                    const auto to = types[first_other + i];
                    convert_samples(other.data(), others[i].type, size, b.planes[first_other + i].data() + begin * pixel_bytes(to), to);
                }
                for (int row = first; row < first + count; ++row) {
                    if ((y + row) % stride != 0) continue;
                    const std::size_t at = static_cast<std::size_t>(row) * static_cast<std::size_t>(width);
                    measure_row(*setup, difference, scratch, planes, at - begin, static_cast<std::size_t>(width),
                                b.difference.data() + at, b.changed[static_cast<std::size_t>(row)]);
                }
            });
            return error.status();
        },
        [&](Buffers& b, int y, int n) -> Status {
            for (int row = 0; row < n; ++row) {
                if ((y + row) % stride != 0) continue;
                const std::size_t at = static_cast<std::size_t>(row) * static_cast<std::size_t>(width);
                if (auto s = accumulator.add_row(y + row, {b.difference.data() + at, static_cast<std::size_t>(width)}); !s) return s;
                accumulator.add_changed_codes(b.changed[static_cast<std::size_t>(row)]);
            }
            std::vector<const std::byte*> planes;
            for (const std::size_t i : layout.order) planes.push_back(b.planes[i].data());
            return (*writer)->write_rows(y, n, planes);
        });
    if (!status) {
        const auto& e = status.error();
        if (options.settings.choose_bands && spectral && *setup->over_bound) missed = setup->model->colorimetry().bands().size();
        const bool named = e.message.find(input) != std::string::npos || e.message.find(output) != std::string::npos;
        return named ? e : Error{e.kind, fmt::format("{}: {}", input, e.message)};
    }

    UpliftReport report;
    report.input = setup->source->report();
    totals.put_into(report.input);
    if (auto s = check_strict(options.job, report.input); !s) return s.error();
    auto statistics = accumulator.finish();
    if (!statistics) return std::move(statistics).error();
    report.roundtrip = *std::move(statistics);
    report.checked_all = options.check_all;
    if (auto s = (*writer)->replace_text("spectex:roundtrip", roundtrip_text(report.roundtrip, options.check_all)); !s)
        return s.error();
    if (setup->bounded) {
        const auto& outcome = totals.bounded();
        BoundedReport bounded{setup->bounded->bound(), 0, outcome.kept_bits, {}};
        std::uint64_t pixels = 0, bits = 0;
        for (std::size_t i = 0; i < outcome.kept_bits.size(); ++i) {
            pixels += outcome.kept_bits[i];
            bits += i * outcome.kept_bits[i];
        }
        bounded.mean_bits = pixels > 0 ? static_cast<double>(bits) / static_cast<double>(pixels) : 0;
        for (std::size_t c = 0; c < outcome.worst.size(); ++c) bounded.checks.push_back({setup->bounded->check_name(c), outcome.worst[c]});
        std::string text = bounded_text(bounded);
        text.resize(bounded_placeholder(*setup->bounded, bounded.checks.size()).size(), ' ');
        if (auto s = (*writer)->replace_text("spectex:maxError", text); !s) return s.error();
        report.bounded = std::move(bounded);
    }
    if (auto s = (*writer)->commit(); !s) return s.error();
    std::error_code ignored;
    const auto bytes = std::filesystem::file_size(output, ignored);
    report.file_bytes = ignored ? 0 : static_cast<std::uint64_t>(bytes);
    for (const auto t : types) report.raw_bytes += pixel_bytes(t) * static_cast<std::uint64_t>(width) * static_cast<std::uint64_t>(geometry.height);
    report.output = output;
    report.constant = constant;
    report.transparent = totals.transparent();
    report.grey = totals.grey();
    if (spectral) report.bands_nm = colorimetry.bands().wavelengths_nm();
    report.model = fmt::format("{}, {}", setup->model->info().id, colorimetry.describe());
    for (const auto& part : layout.parts)
        for (const auto& channel : part.channels) report.channels.push_back(channel.name);
    report.type = type;
    return report;
}

}  // namespace

Result<UpliftReport> uplift(const std::string& input, const std::string& output, const UpliftOptions& options) {
    UpliftOptions tried = options;
    for (std::size_t more = 1;; more *= 2) {
        std::size_t missed = 0;
        auto report = uplift_once(input, output, tried, missed);
        if (report || missed == 0) return report;
        // The bands were chosen by a sample of the colours: some other needs more. The choice ends by itself at its most bands.
        tried.settings.least_bands = missed + more;
    }
}

}  // namespace spectex
