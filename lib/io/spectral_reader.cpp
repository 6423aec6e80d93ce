// Spectral and coefficient EXR of any writer, as planes of float.
#include <OpenEXR/ImfPartType.h>
#include <OpenEXR/ImfStringAttribute.h>

#include <algorithm>
#include <set>

#include "io/exr_input.h"

namespace spectex {

SpectralReader::~SpectralReader() = default;

namespace {

using namespace io;

struct Source {
    int part = 0;
    std::string channel;
    PixelType type = PixelType::half;
    double wavelength_nm = 0;
};

struct Layout {
    bool found = false;
    SpectralHeader header;
    std::vector<Source> data, others;
    int block_rows = 1;
};

// OpenEXR's integers are identifiers and counts: as float they keep their values, exactly below 2^24.
PixelType type_of(Imf::PixelType type) { return type == Imf::HALF ? PixelType::half : PixelType::float32; }

std::string text_attribute(const Imf::Header& h, const char* name) {
    const auto* a = h.findTypedAttribute<Imf::StringAttribute>(name);
    return a ? a->value() : std::string();
}

struct Found {
    Source source;
    std::optional<SpectralChannelName> name;
};

std::vector<Found> list_channels(const ExrInput& input) {
    std::vector<Found> all;
    for (int p = 0; p < input.parts(); ++p) {
        const Imf::Header& h = input.header(p);
        if (h.hasType() && Imf::isDeepData(h.type())) continue;
        for (auto c = h.channels().begin(); c != h.channels().end(); ++c) {
            auto name = parse_spectral_channel_name(c.name());
            const double nm = name ? name->wavelength_nm : 0;
            all.push_back({{p, c.name(), type_of(c.channel().type), nm}, std::move(name)});
        }
    }
    return all;
}

// The bands: reflective ones before emissive ones, those of no layer before those of the first layer that has any.
void take_bands(const std::vector<Found>& all, Layout& layout) {
    const auto in = [&](std::string_view stem, bool layered, std::string& layer) {
        for (const Found& f : all)
            if (f.name && f.name->stem == stem && (layered || f.name->layer.empty())) {
                layer = f.name->layer;
                return true;
            }
        return false;
    };
    std::string layer, unused;
    std::string_view stem;
    if (in("T", false, layer) || in("T", true, layer)) stem = "T";
    else if (in("S0", false, layer) || in("S0", true, layer)) stem = "S0";
    else return;
    layout.found = true;
    layout.header.kind = FileKind::spectral;
    layout.header.emissive = stem == "S0";
    layout.header.has_both = stem == "T" && in("S0", true, unused);
    for (const Found& f : all)
        if (f.name && f.name->stem == stem && f.name->layer == layer) layout.data.push_back(f.source);
    // Equal wavelengths keep file order, so that the message does not depend on the sort.
    std::stable_sort(layout.data.begin(), layout.data.end(),
                     [](const Source& a, const Source& b) { return a.wavelength_nm < b.wavelength_nm; });
    for (const Source& s : layout.data) layout.header.wavelengths_nm.push_back(s.wavelength_nm);
}

Status take_coefficients(const std::string& path, const ExrInput& input, const std::vector<Found>& all, Layout& layout) {
    for (int p = 0; p < input.parts(); ++p) {
        if (text_attribute(input.header(p), "spectex:model").empty()) continue;
        const auto find = [&](std::string_view name) {
            return std::find_if(all.begin(), all.end(),
                                [&](const Found& f) { return f.source.part == p && f.source.channel == name; });
        };
        std::string list = text_attribute(input.header(p), "spectex:coefficients");
        const bool stated = !list.empty();
        if (!stated) {
            if (find("c0") != all.end()) list = "c0,c1,c2";
            else if (find("R") != all.end()) list = "R,G,B";
            else continue;
        }
        std::set<std::string> seen;
        for (std::size_t at = 0; at <= list.size();) {
            const std::size_t comma = std::min(list.find(',', at), list.size());
            const std::string name = list.substr(at, comma - at);
            at = comma + 1;
            const auto it = find(name);
            if (it == all.end())
                return input_error(path, fmt::format("has no channel '{}', which its coefficients ({}) need", name, list));
            if (!seen.insert(name).second)
                return input_error(path, fmt::format("names the coefficient '{}' twice ({})", name, list));
            layout.data.push_back(it->source);
            layout.header.coefficients.push_back(name);
        }
        layout.found = true;
        layout.header.kind = FileKind::coefficients;
        return {};
    }
    return {};
}

Result<Layout> read_layout(const std::string& path, const ExrInput& input, const Limits& limits) {
    Layout layout;
    SpectralHeader& header = layout.header;
    header.path = path;
    header.parts = input.parts();
    const std::vector<Found> all = list_channels(input);
    take_bands(all, layout);
    if (!layout.found)
        if (auto ok = take_coefficients(path, input, all, layout); !ok) return ok.error();
    if (!layout.found) return layout;

    for (std::size_t i = 1; i < header.wavelengths_nm.size(); ++i)
        // Names keep six decimals: nearer ones are one wavelength spelled twice.
        if (header.wavelengths_nm[i] - header.wavelengths_nm[i - 1] < 0.5e-6)
            return input_error(path, fmt::format("channels '{}' and '{}' have the same wavelength",
                                                 layout.data[i - 1].channel, layout.data[i].channel));

    std::set<int> data_parts;
    for (const Source& s : layout.data) {
        data_parts.insert(s.part);
        if (s.type == PixelType::float32) header.type = PixelType::float32;
    }
    std::set<int> usable;
    bool first = true;
    std::int64_t total_bytes = 0;
    for (int p : data_parts) {
        auto info = input.describe(p, limits);
        if (!info) return info.error();
        const Geometry& g = info->geometry;
        if (first) header.geometry = g;
        first = false;
        if (g.x != header.geometry.x || g.y != header.geometry.y || !g.same_size(header.geometry))
            return input_error(path, fmt::format("its bands lie in parts of different data windows: {} x {} at {},{} and {} x "
                                                 "{} at {},{}", header.geometry.width, header.geometry.height,
                                                 header.geometry.x, header.geometry.y, g.width, g.height, g.x, g.y));
        layout.block_rows = std::max(layout.block_rows, info->block_rows);
        usable.insert(p);
        read_exr_attributes(input.header(p), header.attributes);
    }
    total_bytes = static_cast<std::int64_t>(layout.data.size()) * 4;
    if (auto ok = check_limits(path, limits, header.geometry.width, header.geometry.height,
                               static_cast<std::int64_t>(all.size()), total_bytes);
        !ok)
        return ok.error();
    // Extra channels may lie in parts of their own; those of another size cannot be passed on with these pixels.
    for (int p = 0; p < input.parts(); ++p) {
        if (usable.contains(p)) continue;
        const auto info = input.describe(p, limits);
        if (!info || info->geometry.x != header.geometry.x || info->geometry.y != header.geometry.y ||
            !info->geometry.same_size(header.geometry))
            continue;
        usable.insert(p);
        layout.block_rows = std::max(layout.block_rows, info->block_rows);
    }

    const auto is_data = [&](const Source& s) {
        return std::any_of(layout.data.begin(), layout.data.end(),
                           [&](const Source& d) { return d.part == s.part && d.channel == s.channel; });
    };
    int rgb = 0;
    for (const Found& f : all) rgb += f.source.channel == "R" || f.source.channel == "G" || f.source.channel == "B";
    header.has_rgb = rgb >= 3;
    std::set<std::string> names;
    for (const Found& f : all) {
        const Source& s = f.source;
        if (f.name || !usable.contains(s.part) || is_data(s)) continue;
        if (s.channel == "R" || s.channel == "G" || s.channel == "B") continue;
        std::string name = s.channel;
        if (!names.insert(name).second) {
            const Imf::Header& h = input.header(s.part);
            name = fmt::format("{}.{}", h.hasName() ? h.name() : fmt::format("part{}", s.part), s.channel);
            if (!names.insert(name).second) continue;
        }
        layout.others.push_back(s);
        header.others.push_back(name);
        header.other_types.push_back(s.type);
    }
    return layout;
}

class ExrSpectralReader final : public SpectralReader {
public:
    ExrSpectralReader(std::unique_ptr<ExrInput> input, Layout layout)
        : input_(std::move(input)), layout_(std::move(layout)) {}
    const SpectralHeader& header() const override { return layout_.header; }
    int preferred_rows() const override { return rows_per_call(layout_.block_rows, layout_.header.geometry.height); }

    Status read_rows(int y, int rows, std::span<float* const> planes, std::span<std::byte* const> others) override {
        const SpectralHeader& h = layout_.header;
        const Geometry& g = h.geometry;
        if (y < 0 || rows < 0 || rows > g.height - y)
            return input_error(h.path, fmt::format("has no rows {}..{}", y, y + rows - 1));
        if (planes.size() != layout_.data.size() || (!others.empty() && others.size() != layout_.others.size()))
            return input_error(h.path, fmt::format("has {} planes and {} other channels, not {} and {}", layout_.data.size(),
                                                   layout_.others.size(), planes.size(), others.size()));
        if (rows == 0) return {};
        auto status = guarded(ErrorKind::input, h.path, [&]() -> Status {
            std::map<int, Imf::FrameBuffer> frames;
            const auto width = static_cast<std::size_t>(g.width);
            const auto add = [&](const Source& s, std::byte* plane, PixelType type) {
                if (!plane) return;
                const std::size_t sample = pixel_bytes(type);
                frames[s.part].insert(s.channel, exr_slice(type == PixelType::half ? Imf::HALF : Imf::FLOAT, plane, sample,
                                                           sample * width, g, y));
            };
            for (std::size_t i = 0; i < planes.size(); ++i)
                add(layout_.data[i], reinterpret_cast<std::byte*>(planes[i]), PixelType::float32);
            for (std::size_t i = 0; i < others.size(); ++i) add(layout_.others[i], others[i], layout_.others[i].type);
            for (const auto& [index, frame] : frames) input_->read(index, frame, y, rows);
            return {};
        });
        if (status) return {};
        return Error{ErrorKind::input, fmt::format("{} (while reading rows {}..{})", status.error().message, y, y + rows - 1)};
    }

private:
    std::unique_ptr<ExrInput> input_;
    Layout layout_;
};

/// Whether a picture is a coefficient texture in eight bits, as this library writes them.
bool holds_codes(const ImageHeader& header) {
    const auto encoding = header.metadata.find("spectex:encoding");
    const auto* curve = encoding == header.metadata.end() ? nullptr : std::get_if<std::string>(&encoding->second);
    return header.type == PixelType::uint8 && header.has_color() && header.metadata.contains("spectex:model") && curve && *curve == "srgb";
}

/// Codes of coefficients as fractions of 255, by the curve of sRGB.
class CodeReader final : public SpectralReader {
public:
    explicit CodeReader(std::unique_ptr<ImageReader> reader) : reader_(std::move(reader)) {
        const ImageHeader& image = reader_->header();
        header_.path = image.path;
        header_.kind = FileKind::coefficients;
        header_.geometry = image.geometry;
        header_.type = image.type;
        header_.coefficients = {"R", "G", "B"};
        header_.has_rgb = true;
        for (const int other : image.others) {
            header_.others.push_back(other == image.alpha ? "A" : image.channels[static_cast<std::size_t>(other)]);
            header_.other_types.push_back(image.type);
        }
        header_.attributes = image.metadata;
    }
    const SpectralHeader& header() const override { return header_; }
    int preferred_rows() const override { return reader_->preferred_rows(); }
    Status read_rows(int y, int rows, std::span<float* const> planes, std::span<std::byte* const> others) override {
        const ImageHeader& image = reader_->header();
        if (planes.size() != 3 || (!others.empty() && others.size() != image.others.size()))
            return input_error(header_.path, fmt::format("has 3 planes and {} other channels, not {} and {}", image.others.size(), planes.size(), others.size()));
        const std::size_t stride = image.channels.size(), pixels = static_cast<std::size_t>(image.geometry.width) * static_cast<std::size_t>(std::max(rows, 0));
        samples_.resize(pixels * stride);
        if (auto s = reader_->read_rows(y, rows, samples_.data()); !s) return s;
        for (std::size_t i = 0; i < 3; ++i) {
            const std::byte* at = samples_.data() + image.color[i];
            for (std::size_t p = 0; planes[i] && p < pixels; ++p) planes[i][p] = static_cast<float>(std::to_integer<int>(at[p * stride])) / 255.0f;
        }
        for (std::size_t i = 0; i < others.size(); ++i) {
            const std::byte* at = samples_.data() + image.others[i];
            for (std::size_t p = 0; others[i] && p < pixels; ++p) others[i][p] = at[p * stride];
        }
        return {};
    }

private:
    std::unique_ptr<ImageReader> reader_;
    SpectralHeader header_;
    std::vector<std::byte> samples_;
};

}  // namespace

Result<std::unique_ptr<SpectralReader>> SpectralReader::open(const std::string& path, int threads, const Limits& limits) {
    using Out = Result<std::unique_ptr<SpectralReader>>;
    return io::guarded(ErrorKind::input, path, [&]() -> Out {
        auto exr = is_exr(path);
        if (!exr) return exr.error();
        if (!*exr) {
            auto image = ImageReader::open(path, threads, limits);
            if (!image) return image.error();
            if (!holds_codes((*image)->header())) return input_error(path, "is not an OpenEXR file, nor 8-bit coefficients with their model");
            return std::unique_ptr<SpectralReader>(std::make_unique<CodeReader>(*std::move(image)));
        }
        auto input = ExrInput::open(path, threads);
        if (!input) return input.error();
        auto layout = read_layout(path, **input, limits);
        if (!layout) return layout.error();
        if (!layout->found)
            return input_error(path, "holds neither spectral channels (such as T.400,000000nm) nor coefficients of a model");
        for (const Source& s : layout->data) (void)(*input)->part(s.part);
        return std::unique_ptr<SpectralReader>(std::make_unique<ExrSpectralReader>(std::move(*input), std::move(*layout)));
    });
}

Result<FileKind> probe(const std::string& path) {
    return io::guarded(ErrorKind::input, path, [&]() -> Result<FileKind> {
        auto exr = is_exr(path);
        if (!exr) return exr.error();
        if (*exr) {
            auto input = ExrInput::open(path, 1);
            if (!input) return input.error();
            auto layout = read_layout(path, **input, {});
            if (!layout) return layout.error();
            return layout->found ? layout->header.kind : FileKind::image;
        }
        auto image = ImageReader::open(path, 1);
        if (!image) return image.error();
        return holds_codes((*image)->header()) ? FileKind::coefficients : FileKind::image;
    });
}

}  // namespace spectex
