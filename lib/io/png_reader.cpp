#include <fcntl.h>
#include <isa-l/crc.h>
#include <isa-l/igzip_lib.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <stdexcept>

#include "io/png.h"

namespace spectex::io {
namespace {

std::uint8_t byte(int v) { return static_cast<std::uint8_t>(v); }

// Section 9.2: filter types 0 to 4; B is the distance to the pixel on the left.
template <std::size_t B>
void unfilter(int filter, const std::uint8_t* in, const std::uint8_t* above, std::size_t n, std::uint8_t* out) {
    switch (filter) {
    case 0: std::memcpy(out, in, n); return;
    case 1: {
        std::array<std::uint8_t, B> left{};
        for (std::size_t i = 0; i < n; i += B)
            for (std::size_t k = 0; k < B; ++k) out[i + k] = left[k] = byte(in[i + k] + left[k]);
        return;
    }
    case 2:
        for (std::size_t i = 0; i < n; ++i) out[i] = byte(in[i] + above[i]);
        return;
    case 3: {
        std::array<std::uint8_t, B> left{};
        for (std::size_t i = 0; i < n; i += B)
            for (std::size_t k = 0; k < B; ++k) out[i + k] = left[k] = byte(in[i + k] + (left[k] + above[i + k]) / 2);
        return;
    }
    default: {
        std::array<int, B> left{}, corner{};
        for (std::size_t i = 0; i < n; i += B)
            for (std::size_t k = 0; k < B; ++k) {
                const int a = left[k], b = above[i + k], c = corner[k];
                const int pa = std::abs(b - c), pb = std::abs(a - c), pc = std::abs(a + b - 2 * c);
                int nearest = pb <= pc ? b : c;
                nearest = pa <= std::min(pb, pc) ? a : nearest;
                out[i + k] = byte(in[i + k] + nearest);
                left[k] = out[i + k];
                corner[k] = b;
            }
    }
    }
}

using Unfilter = void (*)(int, const std::uint8_t*, const std::uint8_t*, std::size_t, std::uint8_t*);

Unfilter unfilter_of(std::size_t pixel) {
    switch (pixel) {
    case 1: return unfilter<1>;
    case 2: return unfilter<2>;
    case 3: return unfilter<3>;
    case 4: return unfilter<4>;
    case 6: return unfilter<6>;
    case 8: return unfilter<8>;
    default: return nullptr;
    }
}

/// The bytes of all IDAT chunks in turn, each chunk's checksum checked at its end.
class ImageData {
public:
    explicit ImageData(const std::string& path) : fd_(::open(path.c_str(), O_RDONLY | O_CLOEXEC)), buffer_(std::size_t{1} << 18) {
        if (fd_ < 0) throw std::runtime_error(errno_text(errno));
    }
    ~ImageData() { ::close(fd_); }
    ImageData(const ImageData&) = delete;
    ImageData& operator=(const ImageData&) = delete;

    void rewind() {
        at_ = 8;
        left_ = 0;
        open_ = begun_ = ended_ = false;
    }
    /// The next bytes, or none after the last IDAT.
    std::span<std::uint8_t> next() {
        while (left_ == 0) {
            if (!next_chunk()) return {};
        }
        const std::size_t n = std::min<std::size_t>(left_, buffer_.size());
        read(buffer_.data(), n);
        left_ -= static_cast<std::uint32_t>(n);
        crc_ = crc32_gzip_refl(crc_, buffer_.data(), n);
        if (left_ == 0) close_chunk();
        return {buffer_.data(), n};
    }

private:
    void read(std::uint8_t* to, std::size_t n) {
        for (std::size_t done = 0; done < n;) {
            const ssize_t got = ::pread(fd_, to + done, n - done, static_cast<off_t>(at_ + done));
            if (got < 0 && errno == EINTR) continue;
            if (got < 0) throw std::runtime_error(errno_text(errno));
            if (got == 0) throw std::runtime_error("truncated: the file ends within its image data");
            done += static_cast<std::size_t>(got);
        }
        at_ += n;
    }
    void close_chunk() {
        std::array<std::uint8_t, 4> stored{};
        read(stored.data(), stored.size());
        if (be32(stored.data()) != crc_) throw std::runtime_error("damaged: the checksum of a chunk of image data is wrong");
        open_ = false;
    }
    bool next_chunk() {
        if (open_) close_chunk();
        while (!ended_) {
            std::array<std::uint8_t, 8> head{};
            read(head.data(), head.size());
            const std::uint32_t length = be32(head.data());
            if (length > 0x7fffffffU) throw std::runtime_error("damaged: a chunk declares more than 2^31 bytes");
            if (std::memcmp(head.data() + 4, "IDAT", 4) == 0) {
                begun_ = open_ = true;
                left_ = length;
                crc_ = crc32_gzip_refl(0, head.data() + 4, 4);
                if (length > 0) return true;
                close_chunk();
                continue;
            }
            // Chunks of image data follow each other.
            if (begun_ || std::memcmp(head.data() + 4, "IEND", 4) == 0) ended_ = true;
            at_ += std::uint64_t{length} + 4;
        }
        return false;
    }

    int fd_;
    std::vector<std::uint8_t> buffer_;
    std::uint64_t at_ = 8;
    std::uint32_t left_ = 0, crc_ = 0;
    bool open_ = false, begun_ = false, ended_ = false;
};

class PngReader final : public ImageReader {
public:
    PngReader(ImageHeader header, std::size_t pixel, Unfilter unfilter)
        : header_(std::move(header)), data_(header_.path), unfilter_(unfilter),
          row_(static_cast<std::size_t>(header_.geometry.width) * pixel) {
        // A call of the decoder costs a copy of its window of 32 KiB.
        const std::size_t rows = std::clamp<std::size_t>((std::size_t{1} << 19) / (row_ + 1), 1,
                                                         static_cast<std::size_t>(header_.geometry.height));
        filtered_.resize(rows * (row_ + 1));
        above_.resize(row_);
        rewind();
    }
    const ImageHeader& header() const override { return header_; }
    int preferred_rows() const override { return std::min(64, header_.geometry.height); }

    Status read_rows(int y, int rows, std::byte* out) override {
        const std::string& path = header_.path;
        if (y < 0 || rows < 0 || rows > header_.geometry.height - y)
            return input_error(path, fmt::format("has no rows {}..{}", y, y + rows - 1));
        auto status = guarded(ErrorKind::input, path, [&]() -> Status {
            if (y < next_) rewind();
            skipped_.resize(next_ < y ? row_ : 0);
            while (next_ < y) decode_row(skipped_.data());
            for (int i = 0; i < rows; ++i) decode_row(reinterpret_cast<std::uint8_t*>(out) + row_ * static_cast<std::size_t>(i));
            if (header_.type == PixelType::uint16) swap(out, row_ * static_cast<std::size_t>(rows));
            return {};
        });
        if (status) return {};
        next_ = header_.geometry.height;  // whatever comes next begins anew
        std::string why = status.error().message;
        if (why.starts_with(path + ": ")) why.erase(0, path.size() + 2);
        return input_error(path, fmt::format("cannot read rows {}..{}: {}", y, y + rows - 1, why));
    }

private:
    static void swap(std::byte* samples, std::size_t n) {
        for (std::size_t i = 0; i < n; i += 2) std::swap(samples[i], samples[i + 1]);
    }
    void rewind() {
        data_.rewind();
        isal_inflate_init(&inflate_);
        inflate_.crc_flag = ISAL_ZLIB;
        inflate_.next_in = nullptr;
        inflate_.avail_in = 0;
        next_ = 0;
        first_ = filled_ = 0;
        std::fill(above_.begin(), above_.end(), std::uint8_t{0});
    }
    /// One step of the decoder. @return false at the end of the stream.
    bool inflate_some() {
        if (inflate_.block_state == ISAL_BLOCK_FINISH) return false;
        bool exhausted = false;
        if (inflate_.avail_in == 0) {
            const auto more = data_.next();
            exhausted = more.empty();
            inflate_.next_in = more.data();
            inflate_.avail_in = static_cast<std::uint32_t>(more.size());
        }
        // The decoder may hold the last bytes itself, and rows that they stand for.
        const auto room = inflate_.avail_out;
        if (isal_inflate(&inflate_) != ISAL_DECOMP_OK) throw std::runtime_error("damaged: its compressed data are no zlib stream");
        if (exhausted && inflate_.avail_out == room && inflate_.block_state != ISAL_BLOCK_FINISH)
            throw std::runtime_error("truncated: its compressed data end before its rows");
        return true;
    }
    void fill() {
        const auto left = static_cast<std::size_t>(header_.geometry.height - next_);
        filled_ = std::min(filtered_.size(), left * (row_ + 1));
        first_ = 0;
        inflate_.next_out = filtered_.data();
        inflate_.avail_out = static_cast<std::uint32_t>(filled_);
        while (inflate_.avail_out > 0)
            if (!inflate_some()) throw std::runtime_error("truncated: its compressed data hold fewer rows than its header declares");
        if (filled_ < left * (row_ + 1)) return;
        // The end of the stream bears the checksum of all rows.
        std::array<std::uint8_t, 1024> surplus{};
        do {
            inflate_.next_out = surplus.data();
            inflate_.avail_out = static_cast<std::uint32_t>(surplus.size());
        } while (inflate_some());
    }
    void decode_row(std::uint8_t* out) {
        if (first_ == filled_) fill();
        const std::uint8_t* in = filtered_.data() + first_;
        if (in[0] > 4) throw std::runtime_error(fmt::format("damaged: row {} has the unknown filter {}", next_, in[0]));
        unfilter_(in[0], in + 1, above_.data(), row_, out);
        std::memcpy(above_.data(), out, row_);
        first_ += row_ + 1;
        ++next_;
    }

    ImageHeader header_;
    ImageData data_;
    Unfilter unfilter_;
    std::size_t row_;
    std::vector<std::uint8_t> filtered_, above_, skipped_;
    std::size_t first_ = 0, filled_ = 0;  // of the filtered bytes
    int next_ = 0;
    inflate_state inflate_{};
};

}  // namespace

std::unique_ptr<ImageReader> open_png(const ImageHeader& header, const FileFacts& facts) {
    constexpr std::array<std::size_t, 7> channels{1, 0, 3, 0, 2, 0, 4};  // by colour type
    if (!facts.png || facts.png_interlaced || facts.png_transparent || facts.png_color_type >= channels.size()) return nullptr;
    const std::size_t bytes = pixel_bytes(header.type);
    const bool integer = header.type == PixelType::uint8 || header.type == PixelType::uint16;
    if (!integer || channels[facts.png_color_type] != header.channels.size() || facts.png_bits != 8 * bytes) return nullptr;
    const std::size_t pixel = bytes * header.channels.size();
    // The decoder counts its output in 32 bits.
    const Unfilter unfilter = unfilter_of(pixel);
    if (!unfilter || static_cast<std::size_t>(header.geometry.width) > (std::size_t{1} << 30) / pixel) return nullptr;
    return std::make_unique<PngReader>(header, pixel, unfilter);
}

}  // namespace spectex::io
