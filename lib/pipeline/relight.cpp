#include <fmt/format.h>

#include <algorithm>
#include <atomic>

#include "kernels/convert.h"
#include "pipeline/relight_setup.h"
#include "pipeline/strips.h"

namespace spectex {

namespace pipeline {

Result<RelightSetup> RelightSetup::make(const std::string& input, const RelightOptions& options) {
    const auto kind = probe(input);
    if (!kind) return kind.error();
    const auto unlit = [&] {
        return Error{ErrorKind::usage, fmt::format("{}: no illuminant is given: expected one to relight under, such as -i A", input)};
    };
    RelightSetup setup;
    setup.kind = *kind;
    setup.gamut = options.gamut;
    RelightRequest request;
    request.illuminants = options.illuminants;
    request.adaptation = options.adaptation;
    request.normalization = options.normalization;
    request.max_error = options.max_error;

    if (*kind == FileKind::image) {
        if (options.illuminants.empty()) return unlit();
        auto colorimetry = Colorimetry::make(options.colorimetry, options.bands);
        if (!colorimetry) return std::move(colorimetry).error();
        setup.space = colorimetry->rgb_space();
        auto model = make_model(options.method, *colorimetry);
        if (!model) return std::move(model).error();
        setup.model = *std::move(model);
        request.observer = options.observer.value_or(colorimetry->observer().id);
        request.output_space = setup.space.name;
        setup.observer = request.observer;
        auto plan = RelightPlan::for_model(setup.model, request);
        if (!plan) return std::move(plan).error();
        setup.plan = *std::move(plan);
        auto source = open_image_source(input, setup.space, options.job);
        if (!source) return std::move(source).error();
        setup.source = *std::move(source);
        return setup;
    }

    const auto info = spectral_source_info(input, options.job);
    if (!info) return info.error();
    if (options.illuminants.empty() && !info->header.emissive) return unlit();
    const auto space = find_rgb_space(info->colorimetry.rgb_space);
    if (!space) return space.error();
    setup.space = *space;
    request.observer = options.observer.value_or(info->colorimetry.observer);
    request.output_space = space->name;
    setup.observer = request.observer;
    auto plan = [&]() -> Result<RelightPlan> {
        if (info->model) return RelightPlan::for_model(info->model, request);
        auto bands = BandSet::make(info->header.wavelengths_nm);
        if (!bands) return std::move(bands).error();
        setup.emissive = info->header.emissive;
        return setup.emissive ? RelightPlan::for_emission(*bands, request) : RelightPlan::for_reflectance(*bands, request);
    }();
    if (!plan) return Error{plan.error().kind, fmt::format("{}: {}", input, plan.error().message)};
    setup.plan = *std::move(plan);
    auto source = open_spectral_source(input, setup.plan->needed(), options.job);
    if (!source) return std::move(source).error();
    setup.source = *std::move(source);
    return setup;
}

Status RelightSetup::light(const RawStrip& raw, int y, std::size_t begin, std::size_t n, Buffers& buffers, std::vector<float*>& out,
                           Counts& counts) const {
    std::vector<const float*> in;
    source->decode(raw, begin, n, buffers.scratch.decode, in);
    if (model) {
        std::array<float*, 3> rgb{};
        for (std::size_t c = 0; c < 3; ++c) {
            auto& plane = buffers.scratch.rgb[c];
            plane.resize(std::max(plane.size(), n));
            std::copy_n(in[c], n, plane.data());
            rgb[c] = plane.data();
        }
        const std::string path = source->report().path;
        if (auto s = map_colors(rgb, n, gamut, model->colorimetry(), {path, y, begin, source->geometry().width}, counts); !s)
            return s;
        count_unreached(*model, {rgb[0], rgb[1], rgb[2]}, n, begin, counts);
        in.assign(rgb.begin(), rgb.end());
    }
    const std::size_t images = plan->images();
    buffers.lit.resize(3 * images);
    out.clear();
    for (auto& plane : buffers.lit) {
        plane.resize(std::max(plane.size(), n));
        out.push_back(plane.data());
    }
    if (model)
        plan->execute_colors({in[0], in[1], in[2]}, n, out);
    else
        plan->execute(in, n, out);
    for (std::size_t k = 0; k < images; ++k) {
        // A stored sample that is not finite makes its pixel so, whatever the light.
        std::uint64_t replaced = 0;
        const auto bad = replace_nonfinite({out[3 * k], out[3 * k + 1], out[3 * k + 2]}, n, replaced);
        if (k == 0 && replaced > 0 && !model) {
            counts.nonfinite += replaced;
            counts.first_nonfinite = std::min(counts.first_nonfinite, begin + bad);
        }
    }
    return {};
}

}  // namespace pipeline

namespace {

using namespace pipeline;

bool is_integer(PixelType type) { return type == PixelType::uint8 || type == PixelType::uint16; }

struct OutputFormat {
    PixelType type = PixelType::half;
    std::string colorspace;
};

Result<OutputFormat> output_format(const std::string& path, const RelightSetup& setup, const RelightOptions& options) {
    OutputFormat format;
    const PixelType wanted = options.type.value_or(setup.source->type());
    auto storable = storable_type(path, wanted);
    if (!storable)
        return Error{ErrorKind::usage, fmt::format("{}: no writer has that suffix: expected .exr, .png, .tif, .jpg or another "
                                                   "image format",
                                                   path)};
    if (options.type && *storable != *options.type)
        return Error{ErrorKind::usage, fmt::format("{}: the format cannot hold {} samples, the nearest is {}", path,
                                                   pixel_type_name(*options.type), pixel_type_name(*storable))};
    // Floats that go into a picture format are for looking at: eight bits, unless asked otherwise.
    if (!options.type && is_integer(*storable) && !is_integer(wanted)) storable = storable_type(path, PixelType::uint8);
    format.type = *storable;
    if (!options.output_colorspace.empty()) {
        format.colorspace = options.output_colorspace;
        return format;
    }
    const bool own = setup.kind == FileKind::image && is_integer(setup.source->type()) == is_integer(format.type);
    const std::string input_space = setup.source->report().colorspace;
    format.colorspace = std::string(is_integer(format.type) ? srgb_name() : linear_rec709_name());
    // A space that only the input's profile or chromaticities define cannot be named again for writing.
    if (own && ColorTransform::from_linear(setup.space, input_space)) format.colorspace = input_space;
    return format;
}

Explanation explanation_of(const RelightSetup& setup) {
    Explanation lines = setup.source->explanation();
    if (setup.model) {
        lines.push_back({"method", fmt::format("{}: {}", setup.model->info().id, setup.model->info().source)});
        lines.push_back({"colorimetry", setup.model->colorimetry().describe()});
    }
    const auto& plan = setup.plan->explanation();
    lines.insert(lines.end(), plan.begin(), plan.end());
    return lines;
}

}  // namespace

Result<Explanation> explain_relight(const std::string& input, const std::vector<std::string>& outputs,
                                    const RelightOptions& options) {
    const auto setup = RelightSetup::make(input, options);
    if (!setup) return setup.error();
    auto lines = explanation_of(*setup);
    for (const auto& path : outputs) {
        const auto format = output_format(path, *setup, options);
        if (!format) return format.error();
        lines.push_back({"output", fmt::format("{}: {} in {}", path, pixel_type_name(format->type), format->colorspace)});
    }
    if (outputs.size() > 1) lines.push_back({"passes", fmt::format("one, for {} outputs", outputs.size())});
    return lines;
}

Result<RelightReport> relight(const std::string& input, const std::vector<std::string>& outputs, const RelightOptions& options) {
    for (const auto& output : outputs)
        if (same_file(input, output)) return Error{ErrorKind::usage, fmt::format("{}: the output is the input itself", output)};
    auto made = RelightSetup::make(input, options);
    if (!made) return std::move(made).error();
    auto& setup = *made;
    const std::size_t images = setup.plan->images();
    if (images == 0)
        return Error{ErrorKind::usage, fmt::format("{}: no illuminant to light it by: expected -i with one at least", input)};
    if (outputs.size() != images)
        return Error{ErrorKind::usage,
                     setup.emissive ? fmt::format("{}: emission is reprojected, not lit: expected one output, not {}", input, outputs.size())
                                    : fmt::format("{}: {} outputs for {} illuminants: expected as many", input, outputs.size(), images)};
    const auto& geometry = setup.source->geometry();
    const auto& others = setup.source->others();
    const int width = geometry.width;

    struct Target {
        OutputFormat format;
        std::unique_ptr<ColorTransform> transform;
        std::unique_ptr<ImageWriter> writer;
        std::atomic<std::uint64_t> clipped{0};
    };
    std::vector<std::unique_ptr<Target>> targets;
    std::vector<std::string> channels{"R", "G", "B"};
    for (const auto& other : others) channels.push_back(other.name);
    std::size_t row_bytes = setup.source->raw_bytes_per_row();
    for (const auto& output : outputs) {
        auto target = std::make_unique<Target>();
        auto format = output_format(output, setup, options);
        if (!format) return std::move(format).error();
        target->format = *std::move(format);
        auto transform = ColorTransform::from_linear(setup.space, target->format.colorspace);
        if (!transform) return std::move(transform).error();
        target->transform = *std::move(transform);
        Attributes metadata = setup.source->metadata();
        auto writer = ImageWriter::create(output, geometry, channels, setup.source->alpha_associated(), metadata,
                                          {target->format.type, options.compression, options.job.threads});
        if (!writer) return std::move(writer).error();
        target->writer = *std::move(writer);
        row_bytes += static_cast<std::size_t>(width) * channels.size() * pixel_bytes(target->format.type);
        targets.push_back(std::move(target));
    }

    struct Buffers {
        RawStrip raw;
        std::vector<std::vector<std::byte>> samples;
    };
    CountTotals totals;
    const int rows = rows_per_strip(setup.source->preferred_rows(), row_bytes, geometry.height);
    const auto status = run_strips(
        options.job, width, geometry.height, rows, [] { return Buffers{}; },
        [&](Buffers& b, int y, int n) { return setup.source->read(y, n, b.raw); },
        [&](Buffers& b, int y, int n) -> Status {
            const std::size_t pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(n);
            b.samples.resize(images);
            for (std::size_t k = 0; k < images; ++k)
                b.samples[k].resize(pixels * channels.size() * pixel_bytes(targets[k]->format.type));
            FirstError error;
            for_row_groups(n, width, [&](int first, int count) {
                thread_local RelightSetup::Buffers buffers;
                const std::size_t begin = static_cast<std::size_t>(first) * static_cast<std::size_t>(width);
                const std::size_t size = static_cast<std::size_t>(count) * static_cast<std::size_t>(width);
                Counts counts;
                std::vector<float*> out;
                if (auto lit = setup.light(b.raw, y, begin, size, buffers, out, counts); !lit) {
                    error.check(lit);
                    return;
                }
                for (std::size_t k = 0; k < images; ++k) {
                    const std::array<float*, 3> rgb{out[3 * k], out[3 * k + 1], out[3 * k + 2]};
                    Target& target = *targets[k];
                    if (!target.transform->is_identity()) target.transform->apply(rgb, size);
                    const PixelType type = target.format.type;
                    const std::size_t bytes = pixel_bytes(type), stride = channels.size();
                    std::byte* samples = b.samples[k].data() + begin * stride * bytes;
                    for (std::size_t c = 0; c < 3; ++c) {
                        std::byte* at = samples + c * bytes;
                        std::size_t clipped = 0;
                        switch (type) {
                        case PixelType::uint8:
                            clipped = kernels::quantize(rgb[c], size, reinterpret_cast<std::uint8_t*>(at), stride);
                            break;
                        case PixelType::uint16:
                            clipped = kernels::quantize(rgb[c], size, reinterpret_cast<std::uint16_t*>(at), stride);
                            break;
                        case PixelType::half:
                            clipped = kernels::float_to_half(rgb[c], size, reinterpret_cast<std::uint16_t*>(at), stride);
                            break;
                        case PixelType::float32:
                            kernels::scatter_floats(rgb[c], size, reinterpret_cast<float*>(at), stride);
                            break;
                        }
                        target.clipped += clipped;
                    }
                    std::vector<std::byte> other;
                    for (std::size_t i = 0; i < others.size(); ++i) {
                        other.resize(size * pixel_bytes(others[i].type));
                        setup.source->copy_other(b.raw, i, begin, size, other.data());
                        convert_samples(other.data(), others[i].type, size, samples + (3 + i) * bytes, type, stride);
                    }
                }
                totals.add(counts, y, width);
            });
            return error.status();
        },
        [&](Buffers& b, int y, int n) -> Status {
            for (std::size_t k = 0; k < images; ++k)
                if (auto s = targets[k]->writer->write_rows(y, n, b.samples[k].data()); !s) return s;
            return {};
        });
    if (!status) return status.error();

    RelightReport report;
    report.kind = setup.kind;
    report.input = setup.source->report();
    totals.put_into(report.input);
    if (auto s = check_strict(options.job, report.input); !s) return s.error();
    for (std::size_t k = 0; k < images; ++k) {
        if (auto s = targets[k]->writer->commit(); !s) return s.error();
        report.outputs.push_back({outputs[k], setup.emissive ? "emission" : options.illuminants[k].name, targets[k]->format.type,
                                  targets[k]->format.colorspace, targets[k]->clipped.load()});
    }
    return report;
}

}  // namespace spectex
