// Ordinary EXR images, read through OpenEXR itself: it keeps the file's channel names and order, and integer channels keep
// their values.
#include <OpenEXR/ImfChromaticitiesAttribute.h>
#include <OpenEXR/ImfCompression.h>
#include <OpenEXR/ImfDoubleAttribute.h>
#include <OpenEXR/ImfFloatAttribute.h>
#include <OpenEXR/ImfFloatVectorAttribute.h>
#include <OpenEXR/ImfIntAttribute.h>
#include <OpenEXR/ImfMatrixAttribute.h>
#include <OpenEXR/ImfPartType.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <OpenEXR/ImfTileDescription.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <limits>
#include <set>

#include "io/exr_input.h"
#include "io/exr_zip.h"
#include "kernels/convert.h"
#include "parallel.h"

namespace spectex::io {
namespace {

const std::set<std::string, std::less<>> structural_attributes{
    "channels",          "compression",        "dataWindow", "displayWindow", "lineOrder", "pixelAspectRatio",
    "screenWindowWidth", "screenWindowCenter", "tiles",      "type",          "name",      "version",
    "chunkCount",        "maxSamplesPerPixel", "preview",    "multiView",     "Orientation",
    "dwaCompressionLevel"};

int block_rows(Imf::Compression c) {
    switch (c) {
        case Imf::ZIP_COMPRESSION:
        case Imf::PXR24_COMPRESSION: return 16;
        case Imf::PIZ_COMPRESSION:
        case Imf::B44_COMPRESSION:
        case Imf::B44A_COMPRESSION:
        case Imf::DWAA_COMPRESSION: return 32;
        case Imf::DWAB_COMPRESSION: return 256;
        default: return 1;
    }
}

std::int64_t imf_bytes(Imf::PixelType type) { return type == Imf::HALF ? 2 : 4; }

/// Pixels of one side at a level.
std::int64_t level_size(std::int64_t full, int level, bool up) {
    const std::int64_t step = std::int64_t{1} << level;
    return std::max<std::int64_t>((full + (up ? step - 1 : 0)) / step, 1);
}

/// Levels until one pixel; of a ripmap, as many as both sides have.
int level_count(const Imf::TileDescription& t, std::int64_t width, std::int64_t height) {
    const std::int64_t side = t.mode == Imf::RIPMAP_LEVELS ? std::min(width, height) : std::max(width, height);
    const bool up = t.roundingMode == Imf::ROUND_UP;
    int levels = 1;
    while (level_size(side, levels - 1, up) > 1) ++levels;
    return levels;
}

template <std::size_t Sample>
void spread(const std::byte* in, std::size_t n, std::byte* out, std::size_t stride) {
    for (std::size_t i = 0; i < n; ++i, in += Sample, out += stride) std::memcpy(out, in, Sample);
}

/// A row of one channel; halves widen only into a plane.
void copy_row(const std::byte* in, Imf::PixelType from, std::size_t n, std::byte* out, Imf::PixelType to, std::size_t stride) {
    const auto sample = static_cast<std::size_t>(imf_bytes(from));
    if (from != to)
        kernels::half_to_float(reinterpret_cast<const std::uint16_t*>(in), 1, n, reinterpret_cast<float*>(out));
    else if (stride == sample)
        std::memcpy(out, in, n * sample);
    else if (sample == 2)
        spread<2>(in, n, out, stride);
    else
        spread<4>(in, n, out, stride);
}

}  // namespace

void read_exr_attributes(const Imf::Header& header, Attributes& attributes) {
    const auto add = [&](const std::string& name, AttributeValue value) {
        if (attributes.size() < max_attributes) attributes.emplace(name, std::move(value));
    };
    for (auto it = header.begin(); it != header.end(); ++it) {
        const std::string name = it.name();
        if (structural_attributes.contains(name) || name.size() > max_attribute_name) continue;
        const Imf::Attribute& a = it.attribute();
        if (const auto* s = dynamic_cast<const Imf::StringAttribute*>(&a)) {
            if (s->value().size() <= (name == "spectex:model" ? max_model_bytes : max_attribute_bytes)) add(name, s->value());
        } else if (const auto* i = dynamic_cast<const Imf::IntAttribute*>(&a)) {
            add(name, std::int32_t{i->value()});
        } else if (const auto* f = dynamic_cast<const Imf::FloatAttribute*>(&a)) {
            add(name, f->value());
        } else if (const auto* d = dynamic_cast<const Imf::DoubleAttribute*>(&a)) {
            add(name, d->value());
        } else if (const auto* v = dynamic_cast<const Imf::FloatVectorAttribute*>(&a)) {
            if (v->value().size() * sizeof(float) <= max_attribute_bytes) add(name, v->value());
        } else if (const auto* c = dynamic_cast<const Imf::ChromaticitiesAttribute*>(&a)) {
            const Imf::Chromaticities& x = c->value();
            add(name, std::vector<float>{x.red.x, x.red.y, x.green.x, x.green.y, x.blue.x, x.blue.y, x.white.x, x.white.y});
        } else if (const auto* m = dynamic_cast<const Imf::M44fAttribute*>(&a)) {
            if (name == "worldToCamera" || name == "worldToNDC")
                add(name, std::vector<float>(&m->value()[0][0], &m->value()[0][0] + 16));
        }
    }
}

Imf::Slice exr_slice(Imf::PixelType type, std::byte* base, std::size_t x_stride, std::size_t y_stride,
                     const Geometry& geometry, int y) {
    const auto origin = reinterpret_cast<std::uintptr_t>(base) -
                        static_cast<std::uintptr_t>(static_cast<std::intptr_t>(geometry.x)) * x_stride -
                        static_cast<std::uintptr_t>(static_cast<std::intptr_t>(geometry.y) + y) * y_stride;
    return {type, reinterpret_cast<char*>(origin), x_stride, y_stride};
}

int rows_per_call(int block, int height) {
    const int rows = (std::max(64, block) + block - 1) / block * block;
    return std::max(1, std::min(rows, height));
}

Result<std::unique_ptr<ExrInput>> ExrInput::open(const std::string& path, int threads) {
    using Out = Result<std::unique_ptr<ExrInput>>;
    return guarded(ErrorKind::input, path, [&]() -> Out {
        if (auto ok = check_exr_header(path); !ok) return ok.error();
        const int count = prepare_threads(threads);
        auto self = std::make_unique<ExrInput>();
        self->path_ = path;
        // Without a rebuilt offset table an unfinished file is an error rather than a picture with holes.
        self->file_ = std::make_unique<Imf::MultiPartInputFile>(path.c_str(), count > 1 ? count : 0, false);
        self->inputs_.resize(static_cast<std::size_t>(self->file_->parts()));
        self->zips_.resize(self->inputs_.size());
        self->parallel_ = count > 1;
        return self;
    });
}

Result<ExrPartInfo> ExrInput::describe(int index, const Limits& limits) const {
    const Imf::Header& h = header(index);
    ExrPartInfo info;
    info.deep = h.hasType() && Imf::isDeepData(h.type());
    if (info.deep) return input_error(path_, "holds deep data, which has no single colour per pixel");
    const Imath::Box2i& data = h.dataWindow();
    const Imath::Box2i& display = h.displayWindow();
    const auto extent = [](int low, int high) { return std::int64_t{high} - low + 1; };
    const std::int64_t width = extent(data.min.x, data.max.x), height = extent(data.min.y, data.max.y);
    std::int64_t channels = 0;
    for (auto c = h.channels().begin(); c != h.channels().end(); ++c) {
        ++channels;
        info.pixel_bytes += imf_bytes(c.channel().type);
        if (c.channel().xSampling != 1 || c.channel().ySampling != 1)
            return input_error(path_, fmt::format("channel '{}' is stored at a lower resolution ({} x {}), which is not "
                                                  "supported", c.name(), c.channel().xSampling, c.channel().ySampling));
    }
    if (auto ok = check_limits(path_, limits, width, height, channels, info.pixel_bytes); !ok) return ok.error();
    Geometry& g = info.geometry;
    g.width = static_cast<int>(width);
    g.height = static_cast<int>(height);
    g.x = data.min.x;
    g.y = data.min.y;
    g.full_x = display.min.x;
    g.full_y = display.min.y;
    constexpr std::int64_t most = std::numeric_limits<int>::max();
    g.full_width = static_cast<int>(std::clamp<std::int64_t>(extent(display.min.x, display.max.x), 0, most));
    g.full_height = static_cast<int>(std::clamp<std::int64_t>(extent(display.min.y, display.max.y), 0, most));
    g.pixel_aspect = static_cast<double>(h.pixelAspectRatio());
    if (const auto* o = h.findTypedAttribute<Imf::IntAttribute>("Orientation"))
        if (o->value() >= 1 && o->value() <= 8) g.orientation = o->value();
    info.block_rows = block_rows(h.compression());
    if (h.hasTileDescription()) {
        const Imf::TileDescription& t = h.tileDescription();
        const std::int64_t tile_bytes = std::int64_t{t.xSize} * t.ySize;
        if (t.xSize < 1 || t.ySize < 1 || tile_bytes > limits.max_row_bytes / std::max<std::int64_t>(1, info.pixel_bytes))
            return input_error(path_, fmt::format("declares tiles of {} x {} pixels; the limit is {} bytes a tile", t.xSize,
                                                  t.ySize, limits.max_row_bytes));
        // A row of tiles is held as a whole; a tile may be higher than the image.
        const std::int64_t rows = std::min<std::int64_t>(t.ySize, height);
        if (width * info.pixel_bytes > 4 * limits.max_row_bytes / rows)
            return input_error(path_, fmt::format("declares rows of tiles of {} x {} pixels; the limit is {} bytes", width,
                                                  rows, 4 * limits.max_row_bytes));
        info.block_rows = static_cast<int>(rows);
        if (t.mode != Imf::ONE_LEVEL) info.mip_levels = level_count(t, width, height);
    }
    for (int level = 0; level < info.mip_levels; ++level) {
        const bool up = h.hasTileDescription() && h.tileDescription().roundingMode == Imf::ROUND_UP;
        info.mip_pixels += level_size(width, level, up) * level_size(height, level, up);
    }
    return info;
}

Imf::InputPart& ExrInput::part(int index) {
    auto& input = inputs_[static_cast<std::size_t>(index)];
    if (!input) input = std::make_unique<Imf::InputPart>(*file_, index);
    return *input;
}

/// A part of ZIP chunks.
struct ExrInput::ZipPart {
    struct Channel {
        std::string name;
        Imf::PixelType type;
        std::size_t offset = 0;  ///< of its samples in a row, bytes
    };
    std::vector<Channel> channels;
    std::size_t row_bytes = 0;
    int first_row = 0, height = 0, width = 0, x = 0, chunk_rows = 1;
    bool usable = false;
    /// The last chunk, where only some of its rows were taken.
    int kept_chunk = -1;
    std::vector<std::byte> kept;
};

ExrInput::ExrInput() = default;
ExrInput::~ExrInput() = default;

void ExrInput::read(int index, const Imf::FrameBuffer& frame, int y, int rows) {
    auto& zip = zips_[static_cast<std::size_t>(index)];
    if (!zip) {
        zip = std::make_unique<ZipPart>();
        const Imf::Header& h = header(index);
        const Imath::Box2i& window = h.dataWindow();
        const Imf::Compression c = h.compression();
        zip->chunk_rows = block_rows(c);
        zip->x = window.min.x;
        zip->first_row = window.min.y;
        zip->width = window.max.x - window.min.x + 1;
        zip->height = window.max.y - window.min.y + 1;
        for (auto it = h.channels().begin(); it != h.channels().end(); ++it) {
            zip->channels.push_back({it.name(), it.channel().type, zip->row_bytes});
            zip->row_bytes += static_cast<std::size_t>(imf_bytes(it.channel().type)) * static_cast<std::size_t>(zip->width);
        }
        // A chunk's size is a signed 32-bit number.
        zip->usable = (c == Imf::ZIP_COMPRESSION || c == Imf::ZIPS_COMPRESSION) && !h.hasTileDescription() &&
                      zip->row_bytes * static_cast<std::size_t>(zip->chunk_rows) < (std::size_t{1} << 30);
    }
    if (zip->usable) {
        if (read_zip(index, *zip, frame, y, rows)) return;
        // OpenEXR keeps rows of its own between calls, which chunks read past it would not renew: one way from here on.
        zip->usable = false;
        zip->kept = {};
    }
    Imf::InputPart& input = part(index);
    input.setFrameBuffer(frame);
    input.readPixels(zip->first_row + y, zip->first_row + y + rows - 1);
}

bool ExrInput::read_zip(int index, ZipPart& zip, const Imf::FrameBuffer& frame, int y, int rows) {
    struct Copy {
        const ZipPart::Channel* channel;
        const Imf::Slice* slice;
    };
    std::vector<Copy> copies;
    std::size_t found = 0;
    for (const ZipPart::Channel& c : zip.channels) {
        const Imf::Slice* slice = frame.findSlice(c.name);
        if (!slice) continue;
        ++found;
        const bool widened = c.type == Imf::HALF && slice->type == Imf::FLOAT && slice->xStride == sizeof(float);
        if (slice->type != c.type && !widened) return false;
        copies.push_back({&c, slice});
    }
    for (auto it = frame.begin(); it != frame.end(); ++it) found -= 1;
    if (found != 0) return false;

    struct Chunk {
        int number = 0;
        std::vector<std::uint8_t> payload;
    };
    const int first = y / zip.chunk_rows, last = (y + rows - 1) / zip.chunk_rows;
    const auto rows_of = [&](int chunk) { return std::min(zip.chunk_rows, zip.height - chunk * zip.chunk_rows); };
    std::vector<Chunk> chunks;
    for (int number = first; number <= last; ++number) {
        chunks.push_back({number, {}});
        if (number == zip.kept_chunk) continue;
        const char* bytes = nullptr;
        int size = 0;
        part(index).rawPixelData(zip.first_row + number * zip.chunk_rows, bytes, size);
        if (size < 0) return false;
        chunks.back().payload.assign(bytes, bytes + size);
    }
    std::atomic<bool> good{true};
    std::vector<std::byte> kept;
    const auto unpack = [&](std::size_t i) {
        thread_local std::vector<std::byte> buffer;
        const Chunk& chunk = chunks[i];
        const int begin = chunk.number * zip.chunk_rows;
        const std::size_t size = zip.row_bytes * static_cast<std::size_t>(rows_of(chunk.number));
        const std::byte* samples = nullptr;
        if (chunk.number == zip.kept_chunk) {
            samples = zip.kept.data();
        } else if (chunk.payload.size() == size) {
            samples = reinterpret_cast<const std::byte*>(chunk.payload.data());  // stored as it is
        } else {
            buffer.resize(std::max(buffer.size(), size));
            if (chunk.payload.size() > size || !unpack_zip_chunk(chunk.payload, {buffer.data(), size})) {
                good = false;
                return;
            }
            samples = buffer.data();
        }
        // Only the last chunk is asked for again: rows are read in their order.
        if (chunk.number == last && begin + rows_of(last) > y + rows) kept.assign(samples, samples + size);
        for (int row = std::max(begin, y); row < std::min(begin + rows_of(chunk.number), y + rows); ++row) {
            const std::byte* line = samples + zip.row_bytes * static_cast<std::size_t>(row - begin);
            for (const auto& [channel, slice] : copies) {
                auto* out = reinterpret_cast<std::byte*>(
                    reinterpret_cast<std::uintptr_t>(slice->base) +
                    static_cast<std::uintptr_t>(static_cast<std::intptr_t>(zip.x)) * slice->xStride +
                    static_cast<std::uintptr_t>(static_cast<std::intptr_t>(zip.first_row) + row) * slice->yStride);
                copy_row(line + channel->offset, channel->type, static_cast<std::size_t>(zip.width), out, slice->type, slice->xStride);
            }
        }
    };
    if (parallel_ && chunks.size() > 1)
        parallel_for(std::size_t{0}, chunks.size(), unpack);
    else
        for (std::size_t i = 0; i < chunks.size(); ++i) unpack(i);
    if (!good) return false;
    if (!kept.empty() || zip.kept_chunk != last) {
        zip.kept_chunk = kept.empty() ? -1 : last;
        zip.kept = std::move(kept);
    }
    return true;
}

namespace {

class ExrImageReader final : public ImageReader {
public:
    /// @param part  that holds the channels.
    ExrImageReader(std::unique_ptr<ExrInput> input, ImageHeader header, int rows, int part)
        : input_(std::move(input)), header_(std::move(header)), rows_(rows), part_(part) {
        if (header_.mip == 0) {
            // Everything is allocated at the first read; a part that cannot be opened must fail here.
            (void)input_->part(part_);
            return;
        }
        tiles_ = input_->tiles(part_);
        const Imath::Box2i window = tiles_->dataWindowForLevel(header_.mip, header_.mip);
        if (window.max.x - window.min.x + 1 != header_.geometry.width || window.max.y - window.min.y + 1 != header_.geometry.height)
            throw std::runtime_error(fmt::format("level {} has another size than its header says", header_.mip));
    }
    const ImageHeader& header() const override { return header_; }
    int preferred_rows() const override { return rows_; }

    Status read_rows(int y, int rows, std::byte* out) override {
        const Geometry& g = header_.geometry;
        if (y < 0 || rows < 0 || rows > g.height - y)
            return input_error(header_.path, fmt::format("has no rows {}..{}", y, y + rows - 1));
        if (rows == 0) return {};
        auto status = guarded(ErrorKind::input, header_.path, [&]() -> Status {
            if (tiles_)
                read_level(y, rows, out);
            else
                input_->read(part_, frame(out, y), y, rows);
            return {};
        });
        if (status) return {};
        return Error{ErrorKind::input, fmt::format("{} (while reading rows {}..{})", status.error().message, y, y + rows - 1)};
    }

private:
    std::size_t row_bytes() const {
        return pixel_bytes(header_.type) * header_.channels.size() * static_cast<std::size_t>(header_.geometry.width);
    }
    /// Slices of interleaved samples that begin with row y.
    Imf::FrameBuffer frame(std::byte* out, int y) const {
        const std::size_t sample = pixel_bytes(header_.type), pixel = sample * header_.channels.size();
        Imf::FrameBuffer frame;
        for (std::size_t c = 0; c < header_.channels.size(); ++c)
            frame.insert(header_.channels[c], exr_slice(header_.type == PixelType::half ? Imf::HALF : Imf::FLOAT, out + c * sample, pixel,
                                                        row_bytes(), header_.geometry, y));
        return frame;
    }
    void read_level(int y, int rows, std::byte* out) {
        const int tile = static_cast<int>(tiles_->tileYSize()), height = header_.geometry.height, end = y + rows, level = header_.mip;
        const auto read = [&](int first, int last, std::byte* to) {
            tiles_->setFrameBuffer(frame(to, first));
            tiles_->readTiles(0, tiles_->numXTiles(level) - 1, first / tile, (last - 1) / tile, level, level);
        };
        while (y < end) {
            const int first = y / tile * tile, whole_end = end == height ? end : end / tile * tile;
            int count = whole_end - y;
            if (y == first && count > 0) {
                read(y, whole_end, out);
            } else {
                // Part of a row of tiles, whose other rows are asked for next.
                const int last = std::min(first + tile, height);
                if (kept_row_ != first) {
                    kept_.resize(row_bytes() * static_cast<std::size_t>(last - first));
                    kept_row_ = -1;
                    read(first, last, kept_.data());
                    kept_row_ = first;
                }
                count = std::min(end, last) - y;
                std::memcpy(out, kept_.data() + row_bytes() * static_cast<std::size_t>(y - first), row_bytes() * static_cast<std::size_t>(count));
            }
            out += row_bytes() * static_cast<std::size_t>(count);
            y += count;
        }
    }

    std::unique_ptr<ExrInput> input_;
    ImageHeader header_;
    int rows_;
    int part_ = 0;
    std::unique_ptr<Imf::TiledInputPart> tiles_;  // of a level other than the first
    std::vector<std::byte> kept_;
    int kept_row_ = -1;
};

/// The part that holds the layer or the channels that are asked for; the first one otherwise.
/// @param selection  loses its layer where that is the part's own name.
Result<int> choose_part(const std::string& path, const ExrInput& input, ImageSelection& selection) {
    if (!selection.names_channels()) return 0;
    const auto names_of = [&](int part) {
        ImageHeader header;
        header.path = path;
        for (auto c = input.header(part).channels().begin(); c != input.header(part).channels().end(); ++c) header.channels.emplace_back(c.name());
        return header;
    };
    Error why;
    for (int part = 0; part < input.parts(); ++part) {
        auto header = names_of(part);
        const auto found = assign_channels(header, selection);
        if (found) return part;
        if (part == 0) why = found.error();
    }
    for (int part = 0; part < input.parts() && !selection.layer.empty(); ++part) {
        if (!input.header(part).hasName() || input.header(part).name() != selection.layer) continue;
        auto header = names_of(part);
        if (assign_channels(header) && header.has_color()) {
            selection.layer.clear();
            // Beside colour and alpha nothing of the part was asked for.
            for (const int index : header.color)
                if (selection.channels.empty() || header.color[0] != header.color[1])
                    selection.channels.push_back(header.channels[static_cast<std::size_t>(index)]);
            if (header.alpha >= 0) selection.channels.push_back(header.channels[static_cast<std::size_t>(header.alpha)]);
            return part;
        }
    }
    if (input.parts() > 1) {
        std::string parts;
        for (int part = 0; part < input.parts(); ++part) parts += (part > 0 ? ", " : "") + (input.header(part).hasName() ? input.header(part).name() : fmt::format("part {}", part));
        why.message += fmt::format(" or those of its parts {}", parts);
    }
    return why;
}

}  // namespace

Result<std::unique_ptr<ImageReader>> open_exr_image(const std::string& path, int threads, const Limits& limits,
                                                    const ImageSelection& wanted) {
    using Out = Result<std::unique_ptr<ImageReader>>;
    auto input = ExrInput::open(path, threads);
    if (!input) return input.error();
    return guarded(ErrorKind::input, path, [&]() -> Out {
        ImageSelection selection = wanted;
        const auto part = choose_part(path, **input, selection);
        if (!part) return part.error();
        auto info = (*input)->describe(*part, limits);
        if (!info) return info.error();
        const Imf::Header& h = (*input)->header(*part);
        ImageHeader header;
        header.path = path;
        header.format = "openexr";
        header.geometry = info->geometry;
        header.subimages = (*input)->parts();
        for (auto c = h.channels().begin(); c != h.channels().end(); ++c) header.channels.emplace_back(c.name());
        if (auto ok = assign_channels(header, selection); !ok) return ok.error();
        if (!header.left_out.empty()) (void)drop_left_out(header);
        header.type = PixelType::half;
        for (const auto& name : header.channels)
            if (h.channels().findChannel(name)->type != Imf::HALF) header.type = PixelType::float32;
        for (int other = 0; other < (*input)->parts() && selection.names_channels(); ++other) {
            if (other == *part) continue;
            const Imf::Header& o = (*input)->header(other);
            for (auto c = o.channels().begin(); c != o.channels().end(); ++c)
                header.left_out.push_back(fmt::format("{}:{}", o.hasName() ? o.name() : std::to_string(other), c.name()));
        }
        if (auto ok = check_level(path, selection, info->mip_levels); !ok) return ok.error();
        header.mip = selection.mip;
        header.mip_levels = info->mip_levels;
        header.mip_pixels = info->mip_pixels;
        if (header.mip > 0) {
            const bool up = h.tileDescription().roundingMode == Imf::ROUND_UP;
            Geometry& g = header.geometry;
            g.width = static_cast<int>(level_size(g.width, header.mip, up));
            g.height = static_cast<int>(level_size(g.height, header.mip, up));
            // OpenEXR leaves a level's origin where that of the full size is, so no window around it keeps its place.
            g.full_x = g.x, g.full_y = g.y, g.full_width = g.width, g.full_height = g.height;
        }
        // The widened row may be larger than the file's own.
        if (auto ok = check_limits(path, limits, info->geometry.width, info->geometry.height,
                                   static_cast<std::int64_t>(header.channels.size()),
                                   static_cast<std::int64_t>(header.channels.size() * pixel_bytes(header.type)));
            !ok)
            return ok.error();
        header.alpha_associated = header.alpha >= 0;

        read_exr_attributes(h, header.metadata);
        ColorHints& hints = header.color_hints;
        if (Imf::hasChromaticities(h)) {
            const Imf::Chromaticities& c = Imf::chromaticities(h);
            hints.chromaticities = {c.red.x, c.red.y, c.green.x, c.green.y, c.blue.x, c.blue.y, c.white.x, c.white.y};
        }
        const auto declared = header.metadata.find("oiio:ColorSpace");
        if (declared != header.metadata.end()) {
            // OpenImageIO marks every EXR as linear, whatever its primaries.
            if (const auto* name = std::get_if<std::string>(&declared->second); name && lower(*name) != "linear")
                hints.declared = *name;
        }
        if (const auto* aces = h.findTypedAttribute<Imf::IntAttribute>("acesImageContainerFlag"); aces && aces->value() == 1)
            hints.declared = "ACES2065-1";
        for (auto it = header.metadata.begin(); it != header.metadata.end();) {
            const bool ours = it->first == "chromaticities" || it->first == "acesImageContainerFlag" ||
                              it->first.starts_with("oiio:") || it->first.starts_with("openexr:") || it->first == "ICCProfile";
            it = ours ? header.metadata.erase(it) : std::next(it);
        }
        const int rows = rows_per_call(info->block_rows, header.geometry.height);
        return std::unique_ptr<ImageReader>(std::make_unique<ExrImageReader>(std::move(*input), std::move(header), rows, *part));
    });
}

}  // namespace spectex::io
