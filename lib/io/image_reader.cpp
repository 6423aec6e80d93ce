#include <OpenImageIO/imageio.h>
#include <unistd.h>

#include <algorithm>
#include <mutex>

#include "io/oiio_type.h"
#include "io/png.h"

namespace spectex::io {
namespace {

PixelType nearest_wider(OIIO::TypeDesc type) {
    switch (type.basetype) {
        case OIIO::TypeDesc::UINT8: return PixelType::uint8;
        case OIIO::TypeDesc::UINT16: return PixelType::uint16;
        case OIIO::TypeDesc::HALF: return PixelType::half;
        default: return PixelType::float32;
    }
}

// Half holds every 8-bit code's quotient only approximately, so a mixture of the two is read as float.
PixelType widest(PixelType a, PixelType b) {
    if (a == b) return a;
    if (a != PixelType::float32 && b != PixelType::float32 && a != PixelType::half && b != PixelType::half)
        return PixelType::uint16;
    return PixelType::float32;
}

// Formats that are decoded as a whole take memory for all their declared pixels; a header of forty bytes must not.
std::unique_ptr<OIIO::ImageInput> open_input(const std::string& path, const FileFacts& facts, const Limits& limits) {
    static std::mutex mutex;
    OIIO::ImageSpec hints;
    hints.attribute("oiio:UnassociatedAlpha", 1);
    const double memory_mb = static_cast<double>(::sysconf(_SC_PHYS_PAGES)) * static_cast<double>(::sysconf(_SC_PAGESIZE)) /
                             (1024.0 * 1024.0);
    std::lock_guard lock(mutex);
    OIIO::attribute("limits:imagesize_MB", facts.streams ? 1 << 30 : std::max(64, static_cast<int>(memory_mb / 4)));
    OIIO::attribute("limits:channels", limits.max_channels);
    return OIIO::ImageInput::open(path, &hints);
}

bool passes_on(std::string_view name) {
    static constexpr std::string_view prefixes[] = {"oiio:", "openexr:", "png:",  "tiff:", "jpeg:", "gif:",   "bmp:",
                                                    "pnm:",  "targa:",   "dpx:",  "webp:", "psd:",  "thumbnail", "maker:",
                                                    "Exif:MakerNote", "raw:", "heif:", "GPS:", "ICCProfile", "XMP"};
    static constexpr std::string_view names[] = {
        "compression", "Compression", "CompressionQuality", "planarconfig", "Orientation", "PixelAspectRatio", "Software",
        "FramesPerSecond", "Exif:ColorSpace", "Exif:PixelXDimension", "Exif:PixelYDimension", "HostComputer", "rational:DateTime",
        "textureformat", "wrapmodes", "fovcot", "chromaticities"};
    for (std::string_view p : prefixes)
        if (name.starts_with(p)) return false;
    return std::find(std::begin(names), std::end(names), name) == std::end(names);
}

// A string of another encoding would make JSON and EXR headers unreadable.
bool is_text(std::string_view s) {
    for (std::size_t i = 0; i < s.size();) {
        const auto c = static_cast<unsigned char>(s[i]);
        std::size_t more = 0;
        if (c >= 0x20 && c < 0x7f) more = 0;
        else if (c == '\t' || c == '\n' || c == '\r') more = 0;
        else if (c >= 0xc2 && c < 0xe0) more = 1;
        else if (c >= 0xe0 && c < 0xf0) more = 2;
        else if (c >= 0xf0 && c < 0xf5) more = 3;
        else return false;
        if (i + more >= s.size() && more > 0) return false;
        for (std::size_t k = 1; k <= more; ++k)
            if ((static_cast<unsigned char>(s[i + k]) & 0xc0) != 0x80) return false;
        i += 1 + more;
    }
    return true;
}

void read_metadata(const OIIO::ImageSpec& spec, Attributes& out) {
    for (const OIIO::ParamValue& p : spec.extra_attribs) {
        const std::string name = p.name().string();
        if (out.size() >= max_attributes) return;
        if (name.empty() || name.size() > max_attribute_name || !is_text(name) || !passes_on(name)) continue;
        const OIIO::TypeDesc type = p.type();
        if (type == OIIO::TypeString) {
            const std::string value = p.get_string(static_cast<int>(max_attribute_bytes));
            if (!value.empty() && value.size() < max_attribute_bytes && is_text(value)) out.emplace(name, value);
        } else if (type.arraylen != 0 || type.aggregate != OIIO::TypeDesc::SCALAR) {
            if (type == OIIO::TypeRational) out.emplace(name, p.get_float());
        } else if (type == OIIO::TypeInt || type == OIIO::TypeInt16 || type == OIIO::TypeUInt16 || type == OIIO::TypeUInt8) {
            out.emplace(name, std::int32_t{p.get_int()});
        } else if (type == OIIO::TypeFloat) {
            out.emplace(name, p.get_float());
        } else if (type == OIIO::TypeDesc(OIIO::TypeDesc::DOUBLE)) {
            out.emplace(name, *static_cast<const double*>(p.data()));
        }
    }
}

ColorHints color_hints(const OIIO::ImageSpec& spec, const std::string& format, const FileFacts& facts) {
    ColorHints hints;
    if (const OIIO::ParamValue* icc = spec.find_attribute("ICCProfile");
        icc && icc->type().basetype == OIIO::TypeDesc::UINT8 && icc->type().size() <= (std::size_t{1} << 24)) {
        const auto* bytes = static_cast<const std::uint8_t*>(icc->data());
        hints.icc_profile.assign(bytes, bytes + icc->type().size());
    }
    if (facts.png) {
        if (facts.srgb) hints.declared = "sRGB";
        hints.gamma = facts.gamma;
        hints.chromaticities = facts.chromaticities;
        return hints;
    }
    // 1 is sRGB; 65535, uncalibrated, says nothing.
    if (spec.get_int_attribute("Exif:ColorSpace", 0) == 1) hints.declared = "sRGB";
    // Where the file can be silent and OpenImageIO answers anyway, its answer is no declaration.
    const std::string space(spec.get_string_attribute("oiio:ColorSpace"));
    if (format == "dpx" || format == "cineon" || format == "targa") {
        if (hints.declared.empty()) hints.declared = space;
        const float gamma = spec.get_float_attribute("oiio:Gamma", 0.0F);
        if (gamma > 0.0F) hints.gamma = static_cast<double>(gamma);
    }
    return hints;
}

class OiioReader final : public ImageReader {
public:
    /// @param first  channel of the file that is the first of header.channels, which follow each other in the file.
    OiioReader(std::unique_ptr<OIIO::ImageInput> input, ImageHeader header, const OIIO::ImageSpec& spec, int first)
        : input_(std::move(input)), header_(std::move(header)), spec_(spec), first_(first),
          end_(first + static_cast<int>(header_.channels.size())) {
        const int height = header_.geometry.height;
        const int block = spec.tile_width > 0 ? std::min(spec.tile_height, height)
                                              : std::clamp(spec.get_int_attribute("tiff:RowsPerStrip", 1), 1, 1024);
        rows_ = std::min(height, std::max(1, (std::max(64, block) + block - 1) / block * block));
    }
    const ImageHeader& header() const override { return header_; }
    int preferred_rows() const override { return rows_; }

    Status read_rows(int y, int rows, std::byte* out) override {
        const std::string& path = header_.path;
        if (y < 0 || rows < 0 || rows > header_.geometry.height - y)
            return input_error(path, fmt::format("has no rows {}..{}", y, y + rows - 1));
        if (rows == 0) return {};
        return guarded(ErrorKind::input, path, [&]() -> Status {
            return spec_.tile_width > 0 ? read_tiles(y, rows, out) : read_lines(y, y + rows, out);
        });
    }

private:
    std::size_t row_bytes() const {
        return static_cast<std::size_t>(header_.geometry.width) * header_.channels.size() * pixel_bytes(header_.type);
    }
    Error failure(int y0, int y1) {
        std::string why = input_->geterror();
        while (!why.empty() && (why.back() == '\n' || why.back() == '.')) why.pop_back();
        return input_error(header_.path, fmt::format("cannot read rows {}..{}: {}", y0, y1 - 1,
                                                     why.empty() ? "truncated or damaged" : why));
    }
    Status read_lines(int y0, int y1, std::byte* out) {
        if (!input_->read_scanlines(0, header_.mip, spec_.y + y0, spec_.y + y1, 0, first_, end_, oiio_type(header_.type), out))
            return failure(y0, y1);
        // libpng and others put a warning here and go on with what they have.
        if (input_->has_error()) return failure(y0, y1);
        return {};
    }
    Status read_tile_rows(int y0, int y1, std::byte* out) {
        if (!input_->read_tiles(0, header_.mip, spec_.x, spec_.x + spec_.width, spec_.y + y0, spec_.y + y1, 0, 1, first_, end_,
                                oiio_type(header_.type), out) ||
            input_->has_error())
            return failure(y0, y1);
        return {};
    }
    Status read_tiles(int y, int rows, std::byte* out) {
        const int th = spec_.tile_height, height = header_.geometry.height;
        const std::size_t stride = row_bytes();
        const int end = y + rows;
        while (y < end) {
            const int first = y / th * th, aligned_end = end == height ? end : end / th * th;
            if (y == first && aligned_end > y) {
                if (auto ok = read_tile_rows(y, aligned_end, out); !ok) return ok;
                out += stride * static_cast<std::size_t>(aligned_end - y);
                y = aligned_end;
                continue;
            }
            const int last = std::min(first + th, height);
            if (cached_ != first) {
                cache_.resize(stride * static_cast<std::size_t>(last - first));
                cached_ = -1;
                if (auto ok = read_tile_rows(first, last, cache_.data()); !ok) return ok;
                cached_ = first;
            }
            const int n = std::min(end, last) - y;
            std::memcpy(out, cache_.data() + stride * static_cast<std::size_t>(y - first), stride * static_cast<std::size_t>(n));
            out += stride * static_cast<std::size_t>(n);
            y += n;
        }
        return {};
    }

    std::unique_ptr<OIIO::ImageInput> input_;
    ImageHeader header_;
    OIIO::ImageSpec spec_;
    int first_ = 0, end_ = 0;
    int rows_ = 1;
    std::vector<std::byte> cache_;
    int cached_ = -1;
};

Status refuse_unusable(const std::string& path, const OIIO::ImageSpec& spec) {
    if (spec.depth > 1 || spec.full_depth > 1) return input_error(path, "is a volume, not an image");
    if (spec.deep) return input_error(path, "holds deep data, which has no single colour per pixel");
    // OpenImageIO turns these into RGB by a rule of thumb.
    const std::string space = lower(std::string(spec.get_string_attribute(
        "jpeg:ColorSpace", spec.get_string_attribute("tiff:ColorSpace", spec.get_string_attribute("psd:ColorMode", "")))));
    const int photometric = spec.get_int_attribute("tiff:PhotometricInterpretation", -1);
    if (space == "cmyk" || space == "ycck" || space == "ycbcrk" || photometric == 5)
        return input_error(path, "holds CMYK; convert it to RGB by its profile first");
    if (photometric >= 8 && photometric <= 10) return input_error(path, "holds CIELAB; convert it to RGB first");
    return {};
}

int tiff_subimages(OIIO::ImageInput& input) {
    int n = 1;
    while (n < 1000 && input.seek_subimage(n, 0)) ++n;
    (void)input.geterror();
    return n;
}

/// Sizes of the levels of the first picture. Leaves the input at one of them.
std::vector<std::array<int, 2>> mip_sizes(OIIO::ImageInput& input) {
    std::vector<std::array<int, 2>> sizes;
    // A picture halved this often is one pixel.
    while (sizes.size() < 32 && input.seek_subimage(0, static_cast<int>(sizes.size())))
        sizes.push_back({input.spec().width, input.spec().height});
    (void)input.geterror();
    return sizes;
}

Result<std::unique_ptr<ImageReader>> open_oiio(const std::string& path, int threads, const Limits& limits, const ImageSelection& selection) {
    auto facts = read_file_facts(path);
    if (!facts) return facts.error();
    const int count = prepare_threads(threads);
    auto input = open_input(path, *facts, limits);
    if (!input) {
        std::string why = OIIO::geterror();
        while (!why.empty() && (why.back() == '\n' || why.back() == '.')) why.pop_back();
        return input_error(path, why.empty() ? "is in no format that can be read" : why);
    }
    input->threads(count);
    const OIIO::ImageSpec whole = input->spec();
    if (auto ok = refuse_unusable(path, whole); !ok) return ok.error();

    ImageHeader header;
    header.path = path;
    header.format = input->format_name();
    header.mip = selection.mip;
    header.mip_pixels = std::int64_t{whole.width} * whole.height;
    if (header.format == "tiff" || header.format == "dds") {
        const auto sizes = mip_sizes(*input);
        if (auto ok = check_level(path, selection, static_cast<int>(sizes.size())); !ok) return ok.error();
        header.mip_levels = static_cast<int>(sizes.size());
        header.mip_pixels = 0;
        for (const auto& [width, height] : sizes) header.mip_pixels += std::int64_t{width} * height;
        if (!input->seek_subimage(0, selection.mip)) return input_error(path, fmt::format("cannot go to its level {}", selection.mip));
    } else if (auto ok = check_level(path, selection, 1); !ok) {
        return ok.error();
    }
    const OIIO::ImageSpec spec = input->spec();
    Geometry& g = header.geometry;
    g.width = spec.width;
    g.height = spec.height;
    g.x = spec.x;
    g.y = spec.y;
    g.full_x = spec.full_x;
    g.full_y = spec.full_y;
    g.full_width = spec.full_width > 0 ? spec.full_width : spec.width;
    g.full_height = spec.full_height > 0 ? spec.full_height : spec.height;
    const float aspect = spec.get_float_attribute("PixelAspectRatio", 1.0F);
    if (aspect > 0.0F && aspect < 1e6F) g.pixel_aspect = static_cast<double>(aspect);
    const int orientation = spec.get_int_attribute("Orientation", 1);
    if (orientation >= 1 && orientation <= 8) g.orientation = orientation;

    header.type = nearest_wider(spec.format);
    if (!spec.channelformats.empty()) {
        header.type = nearest_wider(spec.channelformats[0]);
        for (const OIIO::TypeDesc& t : spec.channelformats) header.type = widest(header.type, nearest_wider(t));
    }
    const std::int64_t pixel = std::int64_t{spec.nchannels} * static_cast<std::int64_t>(pixel_bytes(header.type));
    if (auto ok = check_limits(path, limits, spec.width, spec.height, spec.nchannels, pixel); !ok) return ok.error();
    if (spec.tile_width > 0 && (spec.tile_height < 1 || std::int64_t{spec.width} * pixel >
                                                            4 * limits.max_row_bytes / std::min(spec.tile_height, spec.height)))
        return input_error(path, fmt::format("declares rows of tiles of {} x {} pixels; the limit is {} bytes", spec.width,
                                             spec.tile_height, 4 * limits.max_row_bytes));
    header.channels.assign(spec.channelnames.begin(), spec.channelnames.end());
    if (auto ok = assign_channels(header, selection); !ok) return ok.error();
    // OpenImageIO's WebP decoder premultiplies whatever is asked of it.
    header.alpha_associated = header.alpha >= 0 && (header.format == "webp" || (header.format == "tiff" &&
                              whole.get_int_attribute("oiio:UnassociatedAlpha", 0) == 0));
    // What is said once is said of the full size.
    header.color_hints = color_hints(whole, header.format, *facts);
    read_metadata(whole, header.metadata);
    if (auto png = open_png(header, *facts)) return png;
    if (header.format == "tiff" || header.format == "gif") {
        header.subimages = tiff_subimages(*input);
        if (!input->seek_subimage(0, header.mip)) return input_error(path, "cannot go back to its first image");
    }
    int first = 0;
    if (!header.left_out.empty()) {
        // OpenImageIO hands over channels that follow each other; those between chosen ones come along and are passed over.
        const std::size_t all = header.channels.size();
        ImageHeader narrow = header;
        const auto kept = drop_left_out(narrow);
        first = kept.front();
        const auto count = static_cast<std::size_t>(kept.back() - first + 1);
        if (count < all) {
            const auto begin = header.channels.begin() + first;
            header.channels = std::vector<std::string>(begin, begin + static_cast<std::ptrdiff_t>(count));
            for (int& index : header.color) index -= first;
            for (int& index : header.others) index -= first;
            if (header.alpha >= 0) header.alpha -= first;
        }
    }
    return std::unique_ptr<ImageReader>(std::make_unique<OiioReader>(std::move(input), std::move(header), spec, first));
}

}  // namespace
}  // namespace spectex::io

namespace spectex {

ImageReader::~ImageReader() = default;

Result<std::unique_ptr<ImageReader>> ImageReader::open(const std::string& path, int threads, const Limits& limits,
                                                       const ImageSelection& selection) {
    using Out = Result<std::unique_ptr<ImageReader>>;
    return io::guarded(ErrorKind::input, path, [&]() -> Out {
        auto exr = io::is_exr(path);
        if (!exr) return exr.error();
        return *exr ? io::open_exr_image(path, threads, limits, selection) : io::open_oiio(path, threads, limits, selection);
    });
}

}  // namespace spectex
