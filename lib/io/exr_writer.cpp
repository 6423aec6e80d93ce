#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfChromaticitiesAttribute.h>
#include <OpenEXR/ImfDoubleAttribute.h>
#include <OpenEXR/ImfFloatAttribute.h>
#include <OpenEXR/ImfFloatVectorAttribute.h>
#include <OpenEXR/ImfIntAttribute.h>
#include <OpenEXR/ImfMatrixAttribute.h>
#include <OpenEXR/ImfPartType.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <set>
#include <stdexcept>

#include "io/exr_zip.h"

namespace spectex::io {
namespace {

constexpr std::size_t buffer_bytes = std::size_t{1} << 20;

const std::set<std::string, std::less<>> reserved_attributes{
    "channels",         "compression",        "dataWindow",        "displayWindow", "lineOrder",  "pixelAspectRatio",
    "screenWindowWidth", "screenWindowCenter", "tiles",             "type",          "name",       "version",
    "chunkCount",       "maxSamplesPerPixel", "preview",           "multiView",     "Orientation"};

Result<Imf::Compression> parse_compression(const std::string& path, std::string_view name) {
    const std::string key = lower(name);
    if (key.empty() || key == "zip") return Imf::ZIP_COMPRESSION;
    if (key == "none") return Imf::NO_COMPRESSION;
    if (key == "rle") return Imf::RLE_COMPRESSION;
    if (key == "zips") return Imf::ZIPS_COMPRESSION;
    if (key == "piz") return Imf::PIZ_COMPRESSION;
    for (std::string_view lossy : {"pxr24", "b44", "b44a", "dwaa", "dwab"})
        if (key.substr(0, key.find(':')) == lossy)
            return Error{ErrorKind::usage, fmt::format("{}: compression '{}' changes samples; EXR takes none, rle, zips, zip "
                                                       "or piz here", path, name)};
    return Error{ErrorKind::usage,
                 fmt::format("{}: unknown compression '{}'; EXR takes none, rle, zips, zip or piz", path, name)};
}

struct InsertAttribute {
    Imf::Header& header;
    const std::string& name;
    void operator()(const std::string& v) const { header.insert(name, Imf::StringAttribute(v)); }
    void operator()(std::int32_t v) const { header.insert(name, Imf::IntAttribute(v)); }
    void operator()(float v) const { header.insert(name, Imf::FloatAttribute(v)); }
    void operator()(double v) const { header.insert(name, Imf::DoubleAttribute(v)); }
    void operator()(const std::vector<float>& v) const {
        // The types that the format's own documents give these names.
        if (name == "chromaticities" && v.size() == 8) {
            header.insert(name, Imf::ChromaticitiesAttribute(Imf::Chromaticities(
                                    {v[0], v[1]}, {v[2], v[3]}, {v[4], v[5]}, {v[6], v[7]})));
        } else if ((name == "worldToCamera" || name == "worldToNDC") && v.size() == 16) {
            Imath::M44f m;
            for (int i = 0; i < 16; ++i) m[i / 4][i % 4] = v[static_cast<std::size_t>(i)];
            header.insert(name, Imf::M44fAttribute(m));
        } else {
            header.insert(name, Imf::FloatVectorAttribute(v));
        }
    }
};

Imf::PixelType imf_type(PixelType type) { return type == PixelType::float32 ? Imf::FLOAT : Imf::HALF; }

Result<Imf::Header> make_header(const std::string& path, const Geometry& g, const ExrPart& part, bool multipart,
                                Imf::Compression compression) {
    const Imath::Box2i data({g.x, g.y}, {g.x + g.width - 1, g.y + g.height - 1});
    Imath::Box2i display = data;
    if (g.full_width > 0 && g.full_height > 0)
        display = Imath::Box2i({g.full_x, g.full_y}, {g.full_x + g.full_width - 1, g.full_y + g.full_height - 1});
    const bool sane_aspect = std::isfinite(g.pixel_aspect) && g.pixel_aspect > 0;
    Imf::Header header(display, data, sane_aspect ? static_cast<float>(g.pixel_aspect) : 1.0F, {0, 0}, 1,
                       Imf::INCREASING_Y, compression);
    if (part.channels.empty()) return output_error(path, "an EXR part needs a channel");
    for (const ExrChannel& c : part.channels) {
        if (c.name.empty() || c.name.size() > max_attribute_name)
            return output_error(path, fmt::format("channel name '{}' is empty or longer than 255 bytes", c.name));
        if (c.type != PixelType::half && c.type != PixelType::float32)
            return output_error(path, fmt::format("channel '{}': EXR holds half or float, not {}", c.name,
                                                  pixel_type_name(c.type)));
        if (header.channels().findChannel(c.name))
            return output_error(path, fmt::format("two channels are named '{}'", c.name));
        header.channels().insert(c.name, Imf::Channel(imf_type(c.type)));
    }
    header.setType(Imf::SCANLINEIMAGE);
    if (multipart) header.setName(part.name);
    if (g.orientation > 1 && g.orientation <= 8) header.insert("Orientation", Imf::IntAttribute(g.orientation));
    for (const auto& [name, value] : part.attributes) {
        if (name.empty() || reserved_attributes.contains(name)) continue;
        if (name.size() > max_attribute_name)
            return output_error(path, fmt::format("attribute name '{}' is longer than 255 bytes", name));
        std::visit(InsertAttribute{header, name}, value);
    }
    return header;
}

}  // namespace

DescriptorStream::DescriptorStream(const std::string& path) : Imf::OStream(path.c_str()) {
    buffer_.reserve(buffer_bytes);
    fd_ = ::open(path.c_str(), O_WRONLY | O_TRUNC | O_CLOEXEC);
    if (fd_ < 0) fail(errno);
}

DescriptorStream::~DescriptorStream() {
    if (fd_ >= 0) ::close(fd_);
}

void DescriptorStream::fail(int code) {
    if (error_.empty()) error_ = errno_text(code);
    throw std::runtime_error(error_);
}

void DescriptorStream::put(const char* bytes, std::size_t size) {
    std::size_t done = 0;
    while (done < size) {
        const ssize_t n = ::write(fd_, bytes + done, size - done);
        if (n < 0) {
            if (errno == EINTR) continue;
            fail(errno);
        }
        done += static_cast<std::size_t>(n);
    }
    position_ += done;
}

void DescriptorStream::flush() {
    put(buffer_.data(), buffer_.size());
    buffer_.clear();
}

void DescriptorStream::write(const char c[], int n) {
    if (!error_.empty()) throw std::runtime_error(error_);
    const auto size = static_cast<std::size_t>(n);
    if (buffer_.size() + size > buffer_bytes) flush();
    if (size <= buffer_bytes) {
        buffer_.insert(buffer_.end(), c, c + size);
        return;
    }
    put(c, size);
}

void DescriptorStream::seekp(std::uint64_t position) {
    if (!error_.empty()) throw std::runtime_error(error_);
    flush();
    if (::lseek(fd_, static_cast<off_t>(position), SEEK_SET) < 0) fail(errno);
    position_ = position;
}

std::optional<std::string> DescriptorStream::close() {
    try {
        if (error_.empty()) flush();
    } catch (const std::exception&) {
        // flush kept the reason
    }
    if (fd_ >= 0 && ::close(fd_) != 0 && error_.empty()) error_ = errno_text(errno);
    fd_ = -1;
    if (error_.empty()) return std::nullopt;
    return error_;
}

/// Writes the chunks of all parts by blocks of rows, and at the end the tables of their offsets.
class ExrOutput::ZipChunks {
public:
    ZipChunks(DescriptorStream& stream, const Geometry& geometry, const std::vector<ExrPart>& parts, bool parallel)
        : stream_(stream), geometry_(geometry), parallel_(parallel), channels_(parts.size()), offsets_(parts.size()) {
        std::size_t index = 0;
        for (std::size_t p = 0; p < parts.size(); ++p) {
            // The file has its channels in the order of their names' bytes.
            std::map<std::string, PackedChannel> sorted;
            for (const ExrChannel& c : parts[p].channels) {
                sorted[c.name] = {pixel_bytes(c.type), index++};
                samples_.push_back(pixel_bytes(c.type));
                row_bytes_ += samples_.back() * static_cast<std::size_t>(geometry.width);
            }
            for (const auto& [name, channel] : sorted) channels_[p].push_back(channel);
        }
        const std::size_t block = row_bytes_ * zip_rows;
        // One row at a time would leave all but one thread idle.
        kept_capacity_ = zip_rows * static_cast<int>(std::clamp<std::size_t>((std::size_t{4} << 20) / block, 1, 16));
    }

    void write(int rows, std::span<const SampleLayout> layouts) {
        int at = 0;
        while (at < rows) {
            const int left = rows - at, to_end = geometry_.height - next_;
            if (kept_rows_ == 0 && (left >= zip_rows || left == to_end)) {
                const int n = left == to_end ? left : left / zip_rows * zip_rows;
                compress(n, advanced(layouts, at));
                at += n;
                continue;
            }
            const int n = std::min({left, kept_capacity_ - kept_rows_, to_end - kept_rows_});
            keep(n, advanced(layouts, at));
            at += n;
            if (kept_rows_ == kept_capacity_ || kept_rows_ == to_end) {
                const int all = kept_rows_;
                kept_rows_ = 0;
                compress(all, kept_layouts());
            }
        }
    }

    /// @param table  where the first part's offsets lie in the file.
    void finish(std::size_t table) {
        stream_.seekp(table);
        for (const auto& part : offsets_)
            for (const std::uint64_t offset : part) stream_.write(reinterpret_cast<const char*>(&offset), sizeof offset);
    }
    std::size_t table_bytes() const {
        return sizeof(std::uint64_t) * channels_.size() * static_cast<std::size_t>((geometry_.height + zip_rows - 1) / zip_rows);
    }

private:
    static std::vector<SampleLayout> advanced(std::span<const SampleLayout> layouts, int rows) {
        std::vector<SampleLayout> moved(layouts.begin(), layouts.end());
        for (SampleLayout& l : moved) l.base += l.y_stride * static_cast<std::size_t>(rows);
        return moved;
    }
    std::vector<SampleLayout> kept_layouts() const {
        std::vector<SampleLayout> layouts;
        std::size_t at = 0;
        for (const std::size_t sample : samples_) {
            layouts.push_back({kept_.data() + at, sample, row_bytes_});
            at += sample * static_cast<std::size_t>(geometry_.width);
        }
        return layouts;
    }
    void keep(int rows, std::span<const SampleLayout> layouts) {
        kept_.resize(row_bytes_ * static_cast<std::size_t>(kept_capacity_));
        for (int row = 0; row < rows; ++row) {
            std::byte* out = kept_.data() + row_bytes_ * static_cast<std::size_t>(kept_rows_ + row);
            for (std::size_t c = 0; c < samples_.size(); ++c) {
                const SampleLayout& l = layouts[c];
                const std::byte* in = l.base + l.y_stride * static_cast<std::size_t>(row);
                for (int x = 0; x < geometry_.width; ++x, in += l.x_stride, out += samples_[c]) std::memcpy(out, in, samples_[c]);
            }
        }
        kept_rows_ += rows;
    }
    void compress(int rows, std::span<const SampleLayout> layouts) {
        // What is packed at once has a memory of its own beside the caller's.
        constexpr std::size_t budget = std::size_t{16} << 20;
        const int step = zip_rows * static_cast<int>(std::max<std::size_t>(budget / (row_bytes_ * zip_rows), 1));
        for (int first = 0; first < rows; first += step) {
            std::vector<ChunkRequest> requests;
            for (int y = first; y < std::min(first + step, rows); y += zip_rows)
                for (const auto& channels : channels_) requests.push_back({channels, y, std::min(zip_rows, rows - y)});
            pack_zip_chunks(requests, layouts, geometry_.width, parallel_, scratch_, payloads_);
            for (std::size_t i = 0; i < requests.size(); ++i) put(i % channels_.size(), requests[i].first_row, payloads_[i]);
        }
        next_ += rows;
    }
    void put(std::size_t part, int row, const std::vector<std::uint8_t>& payload) {
        offsets_[part].push_back(stream_.tellp());
        std::array<std::int32_t, 3> head{static_cast<std::int32_t>(part), geometry_.y + next_ + row,
                                         static_cast<std::int32_t>(payload.size())};
        const std::size_t skipped = channels_.size() > 1 ? 0 : 1;
        stream_.write(reinterpret_cast<const char*>(head.data() + skipped), static_cast<int>(4 * (head.size() - skipped)));
        stream_.write(reinterpret_cast<const char*>(payload.data()), static_cast<int>(payload.size()));
    }

    DescriptorStream& stream_;
    Geometry geometry_;
    bool parallel_;
    std::vector<std::vector<PackedChannel>> channels_;  // [parts]
    std::vector<std::vector<std::uint64_t>> offsets_;
    std::vector<std::size_t> samples_;  // bytes, in the order of the layouts
    std::size_t row_bytes_ = 0;         // over all parts
    int next_ = 0;                      // first row that is not yet compressed
    std::vector<std::byte> kept_;
    int kept_rows_ = 0, kept_capacity_ = zip_rows;
    std::vector<std::vector<std::uint8_t>> scratch_, payloads_;
};

ExrOutput::ExrOutput(OutputFile file) : file_(std::move(file)) {}

Result<std::unique_ptr<ExrOutput>> ExrOutput::create(const std::string& path, const Geometry& geometry,
                                                     const std::vector<ExrPart>& parts, const WriteOptions& options) {
    using Out = Result<std::unique_ptr<ExrOutput>>;
    return guarded(ErrorKind::output, path, [&]() -> Out {
        auto compression = parse_compression(path, options.compression);
        if (!compression) return compression.error();
        if (geometry.width < 1 || geometry.height < 1)
            return output_error(path, fmt::format("cannot write {} x {} pixels", geometry.width, geometry.height));
        if (parts.empty()) return output_error(path, "an EXR needs a part");
        std::set<std::string> names;
        std::vector<Imf::Header> headers;
        for (const ExrPart& part : parts) {
            if (parts.size() > 1 && (part.name.empty() || !names.insert(part.name).second))
                return output_error(path, fmt::format("the parts of an EXR need different names, not '{}'", part.name));
            auto header = make_header(path, geometry, part, parts.size() > 1, *compression);
            if (!header) return header.error();
            headers.push_back(*header);
        }
        auto file = OutputFile::create(path);
        if (!file) return file.error();
        std::unique_ptr<ExrOutput> self(new ExrOutput(std::move(*file)));
        const int threads = prepare_threads(options.threads);
        self->geometry_ = geometry;
        self->parts_ = parts;
        self->headers_ = std::move(headers);
        self->stream_ = std::make_unique<DescriptorStream>(self->file_.temporary_path());
        self->output_ = std::make_unique<Imf::MultiPartOutputFile>(
            *self->stream_, self->headers_.data(), static_cast<int>(self->headers_.size()), false, threads > 1 ? threads : 0);
        self->header_bytes_ = static_cast<std::size_t>(self->stream_->tellp());
        // A chunk's size is a signed 32-bit number, of its samples too.
        std::int64_t row_bytes = 0;
        for (const ExrPart& part : parts)
            for (const ExrChannel& c : part.channels) row_bytes += static_cast<std::int64_t>(pixel_bytes(c.type)) * geometry.width;
        if (*compression == Imf::ZIP_COMPRESSION && row_bytes * zip_rows < (std::int64_t{1} << 30)) {
            self->zip_ = std::make_unique<ZipChunks>(*self->stream_, geometry, parts, threads > 1);
            return self;
        }
        for (int i = 0; i < static_cast<int>(parts.size()); ++i) self->outputs_.emplace_back(*self->output_, i);
        return self;
    });
}

ExrOutput::~ExrOutput() {
    // The file's destructor writes to the stream, which must outlive it.
    outputs_.clear();
    output_.reset();
}

Status ExrOutput::write(int y, int rows, const std::vector<SampleLayout>& layouts) {
    const std::string& path = file_.destination();
    return guarded(ErrorKind::output, path, [&]() -> Status {
        if (!output_) return output_error(path, "rows come after the end");
        if (y != next_row_ || rows < 0 || rows > geometry_.height - y)
            return output_error(path, fmt::format("rows {}..{} are out of order: {} is next of {}", y, y + rows - 1,
                                                  next_row_, geometry_.height));
        if (rows == 0) return {};
        if (zip_) {
            std::size_t i = 0;
            for (const ExrPart& part : parts_)
                for (const ExrChannel& c : part.channels)
                    if (i >= layouts.size() || layouts[i++].base == nullptr)
                        return output_error(path, fmt::format("no samples for channel '{}'", c.name));
            zip_->write(rows, layouts);
            next_row_ += rows;
            return {};
        }
        std::size_t channel = 0;
        for (std::size_t p = 0; p < parts_.size(); ++p) {
            Imf::FrameBuffer frame;
            for (const ExrChannel& c : parts_[p].channels) {
                if (channel >= layouts.size() || layouts[channel].base == nullptr)
                    return output_error(path, fmt::format("no samples for channel '{}'", c.name));
                const SampleLayout& l = layouts[channel++];
                // OpenEXR addresses pixels from the display origin, which need not lie inside the buffer: unsigned
                // arithmetic, as pointers may not leave their array.
                const auto origin = reinterpret_cast<std::uintptr_t>(l.base) -
                                    static_cast<std::uintptr_t>(static_cast<std::intptr_t>(geometry_.x)) * l.x_stride -
                                    static_cast<std::uintptr_t>(static_cast<std::intptr_t>(geometry_.y) + y) * l.y_stride;
                frame.insert(c.name, Imf::Slice(imf_type(c.type), reinterpret_cast<char*>(origin), l.x_stride, l.y_stride));
            }
            outputs_[p].setFrameBuffer(frame);
            outputs_[p].writePixels(rows);
        }
        next_row_ += rows;
        return {};
    });
}

namespace {

/// A string attribute as the file holds it: name, type, size, text.
std::string string_attribute_bytes(const std::string& name, const std::string& text) {
    std::string bytes = name + '\0' + "string" + '\0';
    for (int shift = 0; shift < 32; shift += 8) bytes += static_cast<char>((text.size() >> shift) & 0xff);
    return bytes + text;
}

/// Replaces byte strings by others of their lengths within a file's first `limit` bytes.
std::optional<std::string> replace_bytes(const std::string& path, std::size_t limit,
                                         const std::vector<std::pair<std::string, std::string>>& replacements) {
    std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
    std::string head(limit, '\0');
    file.read(head.data(), static_cast<std::streamsize>(limit));
    head.resize(static_cast<std::size_t>(file.gcount()));
    file.clear();
    for (const auto& [from, to] : replacements)
        for (std::size_t at = head.find(from); at != std::string::npos; at = head.find(from, at + from.size())) {
            file.seekp(static_cast<std::streamoff>(at));
            file.write(to.data(), static_cast<std::streamsize>(to.size()));
        }
    file.close();
    if (file.fail()) return "the header's figures cannot be written";
    return std::nullopt;
}

}  // namespace

Status ExrOutput::replace_text(const std::string& attribute, const std::string& text) {
    bool found = false;
    for (ExrPart& part : parts_) {
        const auto at = part.attributes.find(attribute);
        const auto* old = at == part.attributes.end() ? nullptr : std::get_if<std::string>(&at->second);
        if (!old) continue;
        if (old->size() != text.size())
            return output_error(file_.destination(), fmt::format("attribute '{}' has {} bytes, its replacement {}", attribute,
                                                                 old->size(), text.size()));
        const std::pair<std::string, std::string> change{string_attribute_bytes(attribute, *old),
                                                         string_attribute_bytes(attribute, text)};
        if (std::find(replacements_.begin(), replacements_.end(), change) == replacements_.end())
            replacements_.push_back(change);
        found = true;
    }
    if (found) return {};
    return output_error(file_.destination(), fmt::format("has no string attribute '{}'", attribute));
}

Status ExrOutput::commit() {
    const std::string& path = file_.destination();
    return guarded(ErrorKind::output, path, [&]() -> Status {
        if (!output_) return output_error(path, "is committed already");
        if (next_row_ != geometry_.height)
            return output_error(path, fmt::format("{} of {} rows were written", next_row_, geometry_.height));
        outputs_.clear();
        output_.reset();
        if (zip_) zip_->finish(header_bytes_ - zip_->table_bytes());
        if (auto error = stream_->close()) return output_error(path, *error);
        if (!replacements_.empty())
            if (auto error = replace_bytes(file_.temporary_path(), header_bytes_, replacements_)) return output_error(path, *error);
        return file_.commit();
    });
}

}  // namespace spectex::io

namespace spectex {

ExrWriter::~ExrWriter() = default;

namespace {

class PlanarExrWriter final : public ExrWriter {
public:
    explicit PlanarExrWriter(std::unique_ptr<io::ExrOutput> output) : output_(std::move(output)) {
        for (const ExrPart& part : output_->parts())
            for (const ExrChannel& c : part.channels) strides_.push_back(pixel_bytes(c.type));
    }
    Status write_rows(int y, int rows, std::span<const std::byte* const> planes) override {
        std::vector<io::SampleLayout> layouts(planes.size());
        for (std::size_t i = 0; i < planes.size() && i < strides_.size(); ++i)
            layouts[i] = {planes[i], strides_[i], strides_[i] * static_cast<std::size_t>(output_->width())};
        return output_->write(y, rows, layouts);
    }
    Status replace_text(const std::string& attribute, const std::string& text) override {
        return output_->replace_text(attribute, text);
    }
    Status commit() override { return output_->commit(); }

private:
    std::unique_ptr<io::ExrOutput> output_;
    std::vector<std::size_t> strides_;
};

}  // namespace

Result<std::unique_ptr<ExrWriter>> ExrWriter::create(const std::string& path, const Geometry& geometry,
                                                     const std::vector<ExrPart>& parts, const WriteOptions& options) {
    auto output = io::ExrOutput::create(path, geometry, parts, options);
    if (!output) return output.error();
    return std::unique_ptr<ExrWriter>(std::make_unique<PlanarExrWriter>(std::move(*output)));
}

}  // namespace spectex
