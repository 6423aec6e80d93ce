#include "pipeline/source.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "io/internal.h"
#include "kernels/convert.h"
#include "plan/coefficient_codes.h"

namespace spectex::pipeline {
namespace {

/// Interleaved samples of a file to planes of linear RGB.
class PixelDecoder {
public:
    PixelDecoder(const ImageHeader& header, std::unique_ptr<ColorTransform> transform)
        : type_(header.type), channels_(header.channels.size()), color_(header.color), transform_(std::move(transform)) {
        const bool integer = type_ == PixelType::uint8 || type_ == PixelType::uint16;
        if (!integer) return;
        const std::size_t codes = type_ == PixelType::uint8 ? 256 : 65536;
        for (auto& table : tables_) {
            table.resize(codes);
            for (std::size_t i = 0; i < codes; ++i)
                table[i] = static_cast<float>(static_cast<double>(i) / static_cast<double>(codes - 1));
        }
        if (transform_->is_per_channel()) {
            transform_->apply({tables_[0].data(), tables_[1].data(), tables_[2].data()}, codes);
            by_table_ = true;
        }
    }

    bool by_table() const { return by_table_; }

    void operator()(const std::byte* samples, std::size_t n, std::array<float*, 3> rgb) const {
        const bool grey = color_[0] == color_[1];
        for (std::size_t c = 0; c < 3; ++c) {
            if (grey && c > 0 && (by_table_ ? tables_[c] == tables_[0] : true)) {
                std::copy_n(rgb[0], n, rgb[c]);
                continue;
            }
            const auto channel = static_cast<std::size_t>(color_[c]);
            switch (type_) {
            case PixelType::uint8:
                kernels::decode_codes(reinterpret_cast<const std::uint8_t*>(samples) + channel, channels_, n,
                                      tables_[c].data(), rgb[c]);
                break;
            case PixelType::uint16:
                kernels::decode_codes(reinterpret_cast<const std::uint16_t*>(samples) + channel, channels_, n,
                                      tables_[c].data(), rgb[c]);
                break;
            case PixelType::half:
                kernels::half_to_float(reinterpret_cast<const std::uint16_t*>(samples) + channel, channels_, n, rgb[c]);
                break;
            case PixelType::float32:
                kernels::gather_floats(reinterpret_cast<const float*>(samples) + channel, channels_, n, rgb[c]);
                break;
            }
        }
        if (!by_table_ && !transform_->is_identity()) transform_->apply(rgb, n);
    }

private:
    PixelType type_;
    std::size_t channels_;
    std::array<int, 3> color_;
    std::unique_ptr<ColorTransform> transform_;
    bool by_table_ = false;
    std::array<std::vector<float>, 3> tables_;
};

class ImageSource final : public StripSource {
public:
    ImageSource(std::unique_ptr<ImageReader> reader, io::FileMark mark, ColorSpaceChoice choice, std::unique_ptr<ColorTransform> transform)
        : reader_(std::move(reader)), mark_(std::move(mark)), choice_(std::move(choice)) {
        const auto& h = header();
        for (const int other : h.others)
            others_.push_back({other == h.alpha ? "A" : h.channels[static_cast<std::size_t>(other)], h.type});
        explanation_.push_back({"input", fmt::format("{}, {} x {}, {} channels of {}", h.format, h.geometry.width,
                                                     h.geometry.height, h.channels.size(), pixel_type_name(h.type))});
        explanation_.push_back({"colour space", fmt::format("{} ({})", choice_.name, choice_.reason)});
        const std::string what = transform->describe();
        decoder_ = std::make_unique<PixelDecoder>(h, std::move(transform));
        explanation_.push_back(
            {"decode", decoder_->by_table()
                           ? fmt::format("{} through a table of {} entries", what, h.type == PixelType::uint8 ? 256 : 65536)
                           : what});
        if (h.is_grey()) explanation_.push_back({"skipped", "decoding of G and B: a grey texture has one channel"});
        if (!others_.empty()) {
            std::string names;
            for (const auto& o : others_) names += (names.empty() ? "" : ", ") + o.name;
            explanation_.push_back({"passed on", names + ": not colour, untouched"});
        }
        explain_channels(h);
        if (h.mip_levels > 1) {
            const std::int64_t pixels = std::int64_t{h.geometry.width} * h.geometry.height;
            explanation_.push_back({"skipped", fmt::format("{} of {} mip levels, all but level {}: {} of {} pixels ({:.3g}%) are never read",
                                                           h.mip_levels - 1, h.mip_levels, h.mip, h.mip_pixels - pixels, h.mip_pixels,
                                                           100 * (1 - static_cast<double>(pixels) / static_cast<double>(h.mip_pixels)))});
        }
    }

    const ImageHeader& header() const { return reader_->header(); }
    const Geometry& geometry() const override { return header().geometry; }
    FileKind kind() const override { return FileKind::image; }
    PixelType type() const override { return header().type; }
    const Attributes& metadata() const override { return header().metadata; }
    bool alpha_associated() const override { return header().alpha_associated; }
    const std::vector<OtherChannel>& others() const override { return others_; }
    int preferred_rows() const override { return reader_->preferred_rows(); }
    std::size_t raw_bytes_per_row() const override { return static_cast<std::size_t>(geometry().width) * pixel_bytes_; }
    InputReport report() const override {
        InputReport report;
        report.path = header().path;
        report.width = geometry().width;
        report.height = geometry().height;
        report.colorspace = choice_.name;
        report.colorspace_reason = choice_.reason;
        return report;
    }
    const Explanation& explanation() const override { return explanation_; }
    bool grey() const override { return header().is_grey(); }

    Status read(int y, int rows, RawStrip& raw) override {
        raw.samples.resize(raw_bytes_per_row() * static_cast<std::size_t>(rows));
        if (auto s = reader_->read_rows(y, rows, raw.samples.data()); !s) return s;
        return y + rows == geometry().height ? mark_.check() : Status();
    }
    std::size_t planes() const override { return 3; }
    void decode(const RawStrip& raw, std::size_t begin, std::size_t n, std::vector<std::vector<float>>& scratch,
                std::vector<const float*>& planes) const override {
        scratch.resize(3);
        planes.resize(3);
        for (auto& plane : scratch) plane.resize(std::max(plane.size(), n));
        (*decoder_)(raw.samples.data() + begin * pixel_bytes_, n, {scratch[0].data(), scratch[1].data(), scratch[2].data()});
        for (std::size_t i = 0; i < 3; ++i) planes[i] = scratch[i].data();
    }
    void copy_other(const RawStrip& raw, std::size_t other, std::size_t begin, std::size_t n, std::byte* out) const override {
        const std::size_t size = spectex::pixel_bytes(type());
        const std::byte* in =
            raw.samples.data() + begin * pixel_bytes_ + static_cast<std::size_t>(header().others[other]) * size;
        for (std::size_t i = 0; i < n; ++i, in += pixel_bytes_, out += size) std::memcpy(out, in, size);
    }

private:
    void explain_channels(const ImageHeader& h) {
        if (h.left_out.empty()) return;
        constexpr std::size_t most_named = 8;
        std::vector<std::string> names(h.left_out.begin(), h.left_out.begin() + static_cast<std::ptrdiff_t>(std::min(most_named, h.left_out.size())));
        if (names.size() < h.left_out.size()) names.push_back("...");
        const std::size_t wanted = others_.size() + (h.is_grey() ? 1 : 3), all = wanted + h.left_out.size();
        // PNG rows come whole, and OpenImageIO hands over what lies between chosen channels.
        const auto handed_over = static_cast<std::size_t>(std::count_if(h.channels.begin(), h.channels.end(), [&](const std::string& name) {
            return std::find(h.left_out.begin(), h.left_out.end(), name) != h.left_out.end();
        }));
        explanation_.push_back({"skipped", fmt::format("{} of {} channels ({}): {}, {:.3g}% of the samples", h.left_out.size(), all, fmt::join(names, ", "),
                                                       handed_over == 0 ? "not converted" : "not looked at",
                                                       100 * static_cast<double>(h.left_out.size()) / static_cast<double>(all))});
    }

    std::unique_ptr<ImageReader> reader_;
    io::FileMark mark_;
    ColorSpaceChoice choice_;
    std::vector<OtherChannel> others_;
    std::unique_ptr<PixelDecoder> decoder_;
    Explanation explanation_;
    std::size_t pixel_bytes_ = reader_->header().channels.size() * spectex::pixel_bytes(reader_->header().type);
};

std::string text_attribute(const Attributes& attributes, const char* name) {
    const auto found = attributes.find(name);
    if (found == attributes.end()) return {};
    const auto* text = std::get_if<std::string>(&found->second);
    return text ? *text : std::string();
}

/// Attributes of a spectral or coefficient EXR that are not about its spectra, and so hold for a picture made from it.
Attributes picture_attributes(const Attributes& attributes) {
    Attributes kept;
    for (const auto& [name, value] : attributes) {
        const bool spectral = name.starts_with("spectex:") || name == "spectralLayoutVersion" || name == "EV" ||
                              name == "emissiveUnits" || name == "polarisationHandedness" || parse_spectral_channel_name(name);
        const bool encoding = name == "chromaticities" || name == "acesImageContainerFlag" || name == "ICCProfile" ||
                              name.starts_with("oiio:") || name.starts_with("openexr:");
        if (!spectral && !encoding) kept.emplace(name, value);
    }
    return kept;
}

class SpectralStripSource final : public StripSource {
public:
    SpectralStripSource(std::unique_ptr<SpectralReader> reader, io::FileMark mark, std::vector<bool> needed, bool color_only)
        : reader_(std::move(reader)), mark_(std::move(mark)), needed_(std::move(needed)), metadata_(picture_attributes(reader_->header().attributes)) {
        const auto& h = reader_->header();
        for (std::size_t i = 0; i < h.others.size() && !color_only; ++i) others_.push_back({h.others[i], h.other_types[i]});
        for (const bool plane : needed_) planes_read_ += plane ? 1 : 0;
        if (h.type == PixelType::uint8) codes_ = plan::code_table();
        explanation_.push_back(
            {"input", h.kind == FileKind::coefficients
                          ? fmt::format("coefficient {}, {} x {}, {} channels of {}", codes_ ? "PNG" : "EXR", h.geometry.width, h.geometry.height,
                                        h.coefficients.size(), pixel_type_name(h.type))
                          : fmt::format("spectral EXR, {} x {}, {} {} bands of {} from {} to {} nm", h.geometry.width,
                                        h.geometry.height, h.wavelengths_nm.size(), h.emissive ? "emissive" : "reflective",
                                        pixel_type_name(h.type), h.wavelengths_nm.front(), h.wavelengths_nm.back())});
        if (h.has_both) explanation_.push_back({"skipped", h.emissive ? "reflective bands" : "emissive bands of the same file"});
    }

    const Geometry& geometry() const override { return reader_->header().geometry; }
    FileKind kind() const override { return reader_->header().kind; }
    PixelType type() const override { return reader_->header().type; }
    const Attributes& metadata() const override { return metadata_; }
    /// EXR means associated alpha; ours say when they passed on a texture's straight one.
    bool alpha_associated() const override { return text_attribute(reader_->header().attributes, "spectex:alpha") != "straight"; }
    const std::vector<OtherChannel>& others() const override { return others_; }
    int preferred_rows() const override { return reader_->preferred_rows(); }
    std::size_t raw_bytes_per_row() const override {
        std::size_t bytes = planes_read_ * sizeof(float);
        for (const auto& o : others_) bytes += spectex::pixel_bytes(o.type);
        return bytes * static_cast<std::size_t>(geometry().width);
    }
    InputReport report() const override {
        InputReport report;
        report.path = reader_->header().path;
        report.width = geometry().width;
        report.height = geometry().height;
        report.colorspace = kind() == FileKind::coefficients ? "coefficients" : "spectral";
        report.colorspace_reason = "by its header";
        return report;
    }
    const Explanation& explanation() const override { return explanation_; }

    Status read(int y, int rows, RawStrip& raw) override {
        const std::size_t pixels = static_cast<std::size_t>(geometry().width) * static_cast<std::size_t>(rows);
        raw.planes.resize(needed_.size());
        std::vector<float*> planes(needed_.size(), nullptr);
        for (std::size_t i = 0; i < needed_.size(); ++i)
            if (needed_[i]) {
                raw.planes[i].resize(pixels);
                planes[i] = raw.planes[i].data();
            }
        raw.others.resize(others_.size());
        std::vector<std::byte*> others(others_.size());
        for (std::size_t i = 0; i < others_.size(); ++i) {
            raw.others[i].resize(pixels * spectex::pixel_bytes(others_[i].type));
            others[i] = raw.others[i].data();
        }
        if (auto s = reader_->read_rows(y, rows, planes, others); !s) return s;
        for (float* plane : planes)
            for (std::size_t p = 0; codes_ && plane && p < pixels; ++p) plane[p] = codes_[std::lround(plane[p] * 255)];
        return y + rows == geometry().height ? mark_.check() : Status();
    }
    std::size_t planes() const override { return needed_.size(); }
    void decode(const RawStrip& raw, std::size_t begin, std::size_t, std::vector<std::vector<float>>&,
                std::vector<const float*>& planes) const override {
        planes.resize(needed_.size());
        for (std::size_t i = 0; i < needed_.size(); ++i) planes[i] = needed_[i] ? raw.planes[i].data() + begin : nullptr;
    }
    void copy_other(const RawStrip& raw, std::size_t other, std::size_t begin, std::size_t n, std::byte* out) const override {
        const std::size_t size = spectex::pixel_bytes(others_[other].type);
        std::memcpy(out, raw.others[other].data() + begin * size, n * size);
    }

private:
    std::unique_ptr<SpectralReader> reader_;
    io::FileMark mark_;
    std::vector<bool> needed_;
    Attributes metadata_;
    std::size_t planes_read_ = 0;
    const float* codes_ = nullptr;  ///< what 8-bit coefficients stand for
    std::vector<OtherChannel> others_;
    Explanation explanation_;
};

}  // namespace

Result<std::unique_ptr<StripSource>> open_image_source(const std::string& path, const RgbSpace& space, const JobOptions& job) {
    io::FileMark mark(path);
    auto reader = ImageReader::open(path, job.threads, {}, job.select);
    if (!reader) return std::move(reader).error();
    const auto& header = (*reader)->header();
    if (!header.has_color())
        return Error{ErrorKind::input, fmt::format("{}: no colour channels (it has {}): expected R, G, B or a grey channel", path,
                                                   fmt::join(header.channels, ", "))};
    auto choice = choose_input_space(header, job.input_colorspace);
    if (!choice) return Error{choice.error().kind, fmt::format("{}: {}", path, choice.error().message)};
    auto transform = ColorTransform::to_linear(*choice, header, space);
    if (!transform) return Error{transform.error().kind, fmt::format("{}: {}", path, transform.error().message)};
    return std::unique_ptr<StripSource>(
        std::make_unique<ImageSource>(*std::move(reader), std::move(mark), *std::move(choice), *std::move(transform)));
}

Result<SpectralSourceInfo> spectral_source_info(const std::string& path, const JobOptions& job) {
    if (job.select.mip > 0 || job.select.names_channels())
        return Error{ErrorKind::input, fmt::format("{}: holds spectra or coefficients, which are read as they are: a mip level, a layer or channels are "
                                                   "chosen of textures only",
                                                   path)};
    auto reader = SpectralReader::open(path, job.threads);
    if (!reader) return std::move(reader).error();
    SpectralSourceInfo info;
    info.header = (*reader)->header();
    const auto& attributes = info.header.attributes;
    if (info.header.kind == FileKind::coefficients) {
        auto model = make_model_from_json(text_attribute(attributes, "spectex:model"));
        if (!model)
            return Error{ErrorKind::input, fmt::format("{}: attribute spectex:model: {}", path, model.error().message)};
        info.model = *std::move(model);
        if (info.header.coefficients.size() != static_cast<std::size_t>(info.model->info().coefficients))
            return Error{ErrorKind::input,
                         fmt::format("{}: {} coefficient channels, expected {} for {}", path, info.header.coefficients.size(),
                                     info.model->info().coefficients, info.model->info().id)};
        const auto& c = info.model->colorimetry();
        info.colorimetry = {c.observer().id, c.illuminant().name, c.rgb_space().name, c.matrix_kind()};
        return info;
    }
    if (const auto v = text_attribute(attributes, "spectex:observer"); !v.empty() && find_observer(v)) info.colorimetry.observer = v;
    if (const auto v = text_attribute(attributes, "spectex:rgbSpace"); !v.empty() && find_rgb_space(v))
        info.colorimetry.rgb_space = v;
    return info;
}

Result<std::unique_ptr<StripSource>> open_spectral_source(const std::string& path, const std::vector<bool>& needed,
                                                          const JobOptions& job) {
    io::FileMark mark(path);
    auto reader = SpectralReader::open(path, job.threads);
    if (!reader) return std::move(reader).error();
    return std::unique_ptr<StripSource>(std::make_unique<SpectralStripSource>(*std::move(reader), std::move(mark), needed, job.select.color_only));
}

Result<LinearSource> LinearSource::open(const std::string& path, const RgbSpace& space, const std::string& observer,
                                        const JobOptions& options) {
    const auto kind = probe(path);
    if (!kind) return kind.error();
    JobOptions job = options;
    job.select.color_only = true;
    LinearSource result;
    if (*kind == FileKind::image) {
        auto source = open_image_source(path, space, job);
        if (!source) return std::move(source).error();
        result.source_ = *std::move(source);
        return result;
    }
    const auto info = spectral_source_info(path, job);
    if (!info) return info.error();
    auto illuminant = parse_illuminant(space.illuminant);
    if (!illuminant) return std::move(illuminant).error();
    RelightRequest request;
    request.observer = observer;
    request.illuminants = {*std::move(illuminant)};
    request.output_space = space.name;
    auto plan = [&]() -> Result<RelightPlan> {
        if (info->model) return RelightPlan::for_model(info->model, request);
        auto bands = BandSet::make(info->header.wavelengths_nm);
        if (!bands) return std::move(bands).error();
        return info->header.emissive ? RelightPlan::for_emission(*bands, request)
                                     : RelightPlan::for_reflectance(*bands, request);
    }();
    if (!plan) return Error{plan.error().kind, fmt::format("{}: {}", path, plan.error().message)};
    auto source = open_spectral_source(path, plan->needed(), job);
    if (!source) return std::move(source).error();
    result.source_ = *std::move(source);
    result.plan_ = *std::move(plan);
    return result;
}

void LinearSource::decode(const RawStrip& raw, std::size_t begin, std::size_t n, std::vector<std::vector<float>>& scratch,
                          std::array<float*, 3> rgb) const {
    std::vector<const float*> planes;
    source_->decode(raw, begin, n, scratch, planes);
    if (plan_) {
        plan_->execute(planes, n, rgb);
        return;
    }
    for (std::size_t i = 0; i < 3; ++i) std::copy_n(planes[i], n, rgb[i]);
}

std::size_t replace_nonfinite(std::array<float*, 3> rgb, std::size_t n, std::uint64_t& count) {
    std::size_t first = n;
    for (std::size_t p = 0; p < n; ++p) {
        // One sum decides for nearly every pixel: it is finite only when all three are (or when they overflow together).
        if (std::isfinite(rgb[0][p] + rgb[1][p] + rgb[2][p])) continue;
        bool any = false;
        for (std::size_t c = 0; c < 3; ++c) {
            float& v = rgb[c][p];
            if (std::isfinite(v)) continue;
            any = true;
            v = v > 0 ? 1.0f : 0.0f;
        }
        if (any) {
            ++count;
            first = std::min(first, p);
        }
    }
    return first;
}

void convert_samples(const std::byte* in, PixelType from, std::size_t n, std::byte* out, PixelType to, std::size_t out_stride) {
    if (from == to) {
        const std::size_t size = pixel_bytes(from);
        for (std::size_t i = 0; i < n; ++i) std::memcpy(out + i * out_stride * size, in + i * size, size);
        return;
    }
    std::vector<float> values(n);
    switch (from) {
    case PixelType::uint8:
        for (std::size_t i = 0; i < n; ++i) values[i] = static_cast<float>(std::to_integer<unsigned>(in[i])) / 255.0f;
        break;
    case PixelType::uint16: {
        const auto* codes = reinterpret_cast<const std::uint16_t*>(in);
        for (std::size_t i = 0; i < n; ++i) values[i] = static_cast<float>(codes[i]) / 65535.0f;
        break;
    }
    case PixelType::half:
        kernels::half_to_float(reinterpret_cast<const std::uint16_t*>(in), 1, n, values.data());
        break;
    case PixelType::float32: std::memcpy(values.data(), in, n * sizeof(float)); break;
    }
    switch (to) {
    case PixelType::uint8: kernels::quantize(values.data(), n, reinterpret_cast<std::uint8_t*>(out), out_stride); break;
    case PixelType::uint16: kernels::quantize(values.data(), n, reinterpret_cast<std::uint16_t*>(out), out_stride); break;
    case PixelType::half:
        kernels::float_to_half(values.data(), n, reinterpret_cast<std::uint16_t*>(out), out_stride);
        break;
    case PixelType::float32: kernels::scatter_floats(values.data(), n, reinterpret_cast<float*>(out), out_stride); break;
    }
}

}  // namespace spectex::pipeline
