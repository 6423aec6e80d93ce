#include <OpenImageIO/imageio.h>

#include <OpenImageIO/filesystem.h>

#include <algorithm>
#include <charconv>
#include <cstdio>
#include <set>

#include "io/exr_stream.h"
#include "io/oiio_type.h"
#include "io/png.h"

namespace spectex::io {
namespace {

// What a format holds, in the order of preference for integers and for floats.
struct Format {
    std::string_view suffixes;  ///< each between two blanks
    bool uint8, uint16, half, float32;
    int max_channels;           ///< 0: any number
    bool alpha;
};
// DPX is missing since its writer stamps the time, SGI since its writer does not notice a full disk.
constexpr Format formats[] = {
    {" .exr ", false, false, true, true, 0, true},
    {" .png ", true, true, false, false, 4, true},
    {" .tif .tiff .tx ", true, true, false, true, 0, true},
    {" .jpg .jpeg .jpe .jfif ", true, false, false, false, 3, false},
    {" .tga ", true, false, false, false, 4, true},
    {" .bmp ", true, false, false, false, 4, true},
    {" .hdr .rgbe ", false, false, false, true, 3, false},
    {" .ppm .pgm .pnm ", true, false, false, false, 3, false},
    {" .webp ", true, false, false, false, 3, false},
};

const Format* find_format(std::string_view path) {
    const std::string suffix = suffix_of(path);
    if (suffix.empty()) return nullptr;
    for (const Format& f : formats)
        if (f.suffixes.find(fmt::format(" {} ", suffix)) != std::string_view::npos) return &f;
    return nullptr;
}

PixelType nearest(const Format& f, PixelType wanted) {
    const auto pick = [&](std::initializer_list<PixelType> order) {
        for (PixelType t : order) {
            const bool held = t == PixelType::uint8    ? f.uint8
                              : t == PixelType::uint16 ? f.uint16
                              : t == PixelType::half   ? f.half
                                                       : f.float32;
            if (held) return t;
        }
        return wanted;
    };
    using enum PixelType;
    switch (wanted) {
        case uint8: return pick({uint8, half, uint16, float32});
        case uint16: return pick({uint16, float32, half, uint8});
        case half: return pick({half, float32, uint16, uint8});
        case float32: break;
    }
    return pick({float32, half, uint16, uint8});
}

Error bad_compression(const std::string& path, std::string_view name, std::string_view takes) {
    return {ErrorKind::usage, fmt::format("{}: compression '{}' is not one of its format's: {}", path, name, takes)};
}

Status apply_compression(const std::string& path, std::string_view suffix, std::string_view name, OIIO::ImageSpec& spec) {
    const std::string key = lower(name);
    if (suffix == ".png") {
        int level = 6;
        if (!key.empty()) {
            const auto [end, code] = std::from_chars(key.data(), key.data() + key.size(), level);
            if (code != std::errc() || end != key.data() + key.size() || level < 0 || level > 9)
                return bad_compression(path, name, "a level, 0 to 9");
        }
        spec.attribute("png:compressionLevel", level);
    } else if (suffix == ".tif" || suffix == ".tiff" || suffix == ".tx") {
        if (!key.empty() && key != "none" && key != "lzw" && key != "zip")
            return bad_compression(path, name, "none, lzw or zip");
        spec.attribute("compression", key.empty() ? "zip" : key);
    } else if (suffix == ".jpg" || suffix == ".jpeg" || suffix == ".jpe" || suffix == ".jfif" ||
               suffix == ".webp") {
        int quality = 98;
        if (!key.empty()) {
            const auto [end, code] = std::from_chars(key.data(), key.data() + key.size(), quality);
            if (code != std::errc() || end != key.data() + key.size() || quality < 1 || quality > 100)
                return bad_compression(path, name, "a quality, 1 to 100");
        }
        spec.attribute("CompressionQuality", quality);
    } else if (!key.empty() && key != "none") {
        return bad_compression(path, name, "none");
    }
    return {};
}

// The names that OpenImageIO gives what EXR names otherwise.
std::string oiio_name(const std::string& name) {
    if (name == "capDate") return "DateTime";
    if (name == "owner") return "Copyright";
    if (name == "comments") return "ImageDescription";
    return name;
}

void apply_metadata(const Attributes& metadata, OIIO::ImageSpec& spec) {
    for (const auto& [key, value] : metadata) {
        const std::string name = oiio_name(key);
        if (name.empty() || (name != key && metadata.contains(name))) continue;
        if (const auto* s = std::get_if<std::string>(&value)) spec.attribute(name, *s);
        else if (const auto* i = std::get_if<std::int32_t>(&value)) spec.attribute(name, *i);
        else if (const auto* f = std::get_if<float>(&value)) spec.attribute(name, *f);
        else if (const auto* d = std::get_if<double>(&value)) spec.attribute(name, static_cast<float>(*d));
    }
}

// A file whose failures are kept: several of the format writers do not look at what a write returns.
class CheckedFile final : public OIIO::Filesystem::IOProxy {
public:
    explicit CheckedFile(const std::string& path) : IOProxy(path, Write), file_(std::fopen(path.c_str(), "wbe")) {
        if (!file_) fail();
        else std::setvbuf(file_, nullptr, _IOFBF, std::size_t{1} << 20);
    }
    ~CheckedFile() override { close(); }
    const char* proxytype() const override { return "spectex"; }
    void close() override {
        if (file_ && std::fclose(file_) != 0) fail();
        file_ = nullptr;
        m_mode = Closed;
    }
    bool opened() const override { return file_ != nullptr; }
    bool seek(std::int64_t offset) override {
        if (!file_ || ::fseeko(file_, offset, SEEK_SET) != 0) return fail(), false;
        m_pos = offset;
        return true;
    }
    std::size_t write(const void* data, std::size_t n) override {
        if (!file_ || !failure_.empty()) return 0;
        const std::size_t done = std::fwrite(data, 1, n, file_);
        if (done != n) fail();
        m_pos += static_cast<std::int64_t>(done);
        size_ = std::max(size_, m_pos);
        return done;
    }
    std::size_t pwrite(const void* data, std::size_t n, std::int64_t offset) override {
        const std::int64_t before = m_pos;
        if (!seek(offset)) return 0;
        const std::size_t done = write(data, n);
        return seek(before) ? done : 0;
    }
    std::size_t size() const override { return static_cast<std::size_t>(size_); }
    void flush() const override {
        if (file_) (void)std::fflush(file_);
    }
    const std::string& failure() const { return failure_; }

private:
    void fail() {
        if (failure_.empty()) failure_ = errno_text(errno);
    }
    std::FILE* file_;
    std::int64_t size_ = 0;
    std::string failure_;
};

class OiioWriter final : public ImageWriter {
public:
    OiioWriter(OutputFile file, std::unique_ptr<CheckedFile> checked, std::unique_ptr<OIIO::ImageOutput> output,
               OIIO::ImageSpec spec, PixelType type)
        : file_(std::move(file)), checked_(std::move(checked)), output_(std::move(output)), spec_(std::move(spec)), type_(type) {}
    PixelType type() const override { return type_; }

    Status write_rows(int y, int rows, const std::byte* samples) override {
        const std::string& path = file_.destination();
        return guarded(ErrorKind::output, path, [&]() -> Status {
            if (!output_) return output_error(path, "rows come after the end");
            if (y != next_row_ || rows < 0 || rows > spec_.height - y)
                return output_error(path, fmt::format("rows {}..{} are out of order: {} is next of {}", y, y + rows - 1,
                                                      next_row_, spec_.height));
            if (rows == 0) return {};
            if (!output_->write_scanlines(spec_.y + y, spec_.y + y + rows, 0, oiio_type(type_), samples) ||
                (checked_ && !checked_->failure().empty()))
                return failure();
            next_row_ += rows;
            return {};
        });
    }
    Status commit() override {
        const std::string& path = file_.destination();
        return guarded(ErrorKind::output, path, [&]() -> Status {
            if (!output_) return output_error(path, "is committed already");
            if (next_row_ != spec_.height)
                return output_error(path, fmt::format("{} of {} rows were written", next_row_, spec_.height));
            if (!output_->close()) return failure();
            if (checked_) {
                checked_->close();
                if (!checked_->failure().empty()) return failure();
            }
            output_.reset();
            return file_.commit();
        });
    }

private:
    Error failure() {
        std::string why = output_->geterror();
        if (checked_ && !checked_->failure().empty()) why = checked_->failure();
        while (!why.empty() && (why.back() == '\n' || why.back() == '.')) why.pop_back();
        return output_error(file_.destination(), why.empty() ? "cannot be written" : why);
    }
    OutputFile file_;  // these outlive the output, whose destructor may still write
    std::unique_ptr<CheckedFile> checked_;
    std::unique_ptr<OIIO::ImageOutput> output_;
    OIIO::ImageSpec spec_;
    PixelType type_;
    int next_row_ = 0;
};

class InterleavedExrWriter final : public ImageWriter {
public:
    InterleavedExrWriter(std::unique_ptr<ExrOutput> output, PixelType type, std::size_t channels, int width)
        : output_(std::move(output)), type_(type), channels_(channels), width_(width) {}
    PixelType type() const override { return type_; }
    Status write_rows(int y, int rows, const std::byte* samples) override {
        const std::size_t sample = pixel_bytes(type_), pixel = sample * channels_;
        std::vector<SampleLayout> layouts;
        for (std::size_t c = 0; c < channels_; ++c)
            layouts.push_back({samples + c * sample, pixel, pixel * static_cast<std::size_t>(width_)});
        return output_->write(y, rows, layouts);
    }
    Status commit() override { return output_->commit(); }

private:
    std::unique_ptr<ExrOutput> output_;
    PixelType type_;
    std::size_t channels_;
    int width_;
};

Result<std::unique_ptr<ImageWriter>> create_writer(const std::string& path, const Geometry& g,
                                                   const std::vector<std::string>& channels, bool alpha_associated,
                                                   const Attributes& metadata, const WriteOptions& options) {
    const Format* format = find_format(path);
    const std::string suffix = suffix_of(path);
    if (!format)
        return output_error(path, suffix.empty() ? "has no suffix that names an image format"
                                                 : fmt::format("no image format that can be written has the suffix '{}'", suffix));
    const PixelType type = nearest(*format, options.type);
    if (channels.empty()) return output_error(path, "an image needs a channel");
    if (suffix == ".exr") {
        ExrPart part;
        for (const std::string& name : channels) part.channels.push_back({name, type});
        part.attributes = metadata;
        auto output = ExrOutput::create(path, g, {part}, options);
        if (!output) return output.error();
        return std::unique_ptr<ImageWriter>(
            std::make_unique<InterleavedExrWriter>(std::move(*output), type, channels.size(), g.width));
    }
    const auto a = std::find(channels.begin(), channels.end(), "A");
    const int alpha = a == channels.end() ? -1 : static_cast<int>(a - channels.begin());
    if (alpha >= 0 && !format->alpha) return output_error(path, fmt::format("{} holds no alpha channel", suffix));
    const int count = static_cast<int>(channels.size()), colors = count - (alpha >= 0 ? 1 : 0);
    if (format->max_channels > 0 && (count > format->max_channels || (colors != 1 && colors != 3)))
        return output_error(path, fmt::format("{} cannot hold {} channels ({})", suffix, count, fmt::join(channels, ", ")));
    if (g.width < 1 || g.height < 1) return output_error(path, fmt::format("cannot write {} x {} pixels", g.width, g.height));

    OIIO::ImageSpec spec(g.width, g.height, count, oiio_type(type));
    apply_metadata(metadata, spec);
    if (auto ok = apply_compression(path, suffix, options.compression, spec); !ok) return ok.error();
    spec.channelnames = channels;
    spec.alpha_channel = alpha;
    if (suffix != ".bmp" && suffix != ".hdr") {
        spec.x = g.x;
        spec.y = g.y;
    }
    if (g.full_width > 0 && g.full_height > 0) {
        spec.full_x = g.full_x;
        spec.full_y = g.full_y;
        spec.full_width = g.full_width;
        spec.full_height = g.full_height;
    }
    if (g.orientation > 1 && g.orientation <= 8) spec.attribute("Orientation", g.orientation);
    if (g.pixel_aspect > 0 && g.pixel_aspect != 1) spec.attribute("PixelAspectRatio", static_cast<float>(g.pixel_aspect));
    spec.attribute("oiio:UnassociatedAlpha", alpha_associated ? 0 : 1);
    // Both are otherwise filled in by the library: with the time of day, and with its own version.
    if (!spec.find_attribute("DateTime") && (suffix == ".tif" || suffix == ".tiff" || suffix == ".tx"))
        spec.attribute("DateTime", "");
    spec.attribute("Software", "Spectex");

    auto file = OutputFile::create(path);
    if (!file) return file.error();
    const int threads = prepare_threads(options.threads);
    // A level is asked of the format's own library, and so is the division by alpha.
    if (suffix == ".png" && options.compression.empty() && !(alpha >= 0 && alpha_associated)) {
        auto png = create_png(*file, spec, type, threads);
        if (!png || *png) return png;
    }
    auto output = OIIO::ImageOutput::create(file->temporary_path());
    if (!output) {
        const std::string why = OIIO::geterror();
        return output_error(path, why.empty() ? fmt::format("no image format has the suffix '{}'", suffix) : why);
    }
    output->threads(threads);
    std::unique_ptr<CheckedFile> checked;
    if (output->supports("ioproxy")) {
        checked = std::make_unique<CheckedFile>(file->temporary_path());
        if (!checked->failure().empty()) return output_error(path, checked->failure());
        output->set_ioproxy(checked.get());
    }
    if (!output->open(file->temporary_path(), spec)) {
        std::string why = output->geterror();
        return output_error(path, why.empty() ? "cannot be opened for writing" : why);
    }
    if (output->spec().format != oiio_type(type) || output->spec().nchannels != count)
        return output_error(path, fmt::format("{} stored {} x {} instead of {} channels of {}", suffix,
                                              output->spec().nchannels, output->spec().format.c_str(), count,
                                              pixel_type_name(type)));
    OIIO::ImageSpec stored = output->spec();
    return std::unique_ptr<ImageWriter>(
        std::make_unique<OiioWriter>(std::move(*file), std::move(checked), std::move(output), std::move(stored), type));
}

}  // namespace
}  // namespace spectex::io

namespace spectex {

ImageWriter::~ImageWriter() = default;

std::optional<PixelType> storable_type(std::string_view path, PixelType wanted) {
    const io::Format* format = io::find_format(path);
    if (!format) return std::nullopt;
    return io::nearest(*format, wanted);
}

Result<std::unique_ptr<ImageWriter>> ImageWriter::create(const std::string& path, const Geometry& geometry,
                                                         const std::vector<std::string>& channels, bool alpha_associated,
                                                         const Attributes& metadata, const WriteOptions& options) {
    using Out = Result<std::unique_ptr<ImageWriter>>;
    return io::guarded(ErrorKind::output, path, [&]() -> Out {
        return io::create_writer(path, geometry, channels, alpha_associated, metadata, options);
    });
}

}  // namespace spectex
