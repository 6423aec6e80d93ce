#include <OpenImageIO/filesystem.h>
#include <isa-l/crc.h>

#include <algorithm>
#include <array>
#include <cstdlib>

#include "io/deflate.h"
#include "io/exr_stream.h"
#include "io/png.h"
#include "parallel.h"

namespace spectex::io {
namespace {

void put32(std::uint8_t* p, std::uint32_t v) {
    for (int i = 0; i < 4; ++i) p[i] = static_cast<std::uint8_t>(v >> (24 - 8 * i));
}

using Row = std::span<const std::uint8_t>;

/// Section 9.2 of the standard; bytes to the left of a row are 0. @param left  the row from one pixel before, `corner` that
/// of the row above.
void filter_row(int filter, std::size_t n, const std::uint8_t* x, const std::uint8_t* left, const std::uint8_t* above,
                const std::uint8_t* corner, std::uint8_t* out) {
    const auto byte = [](int v) { return static_cast<std::uint8_t>(v); };
    switch (filter) {
    case 0: std::memcpy(out, x, n); break;
    case 1:
        for (std::size_t i = 0; i < n; ++i) out[i] = byte(x[i] - left[i]);
        break;
    case 2:
        for (std::size_t i = 0; i < n; ++i) out[i] = byte(x[i] - above[i]);
        break;
    case 3:
        for (std::size_t i = 0; i < n; ++i) out[i] = byte(x[i] - (left[i] + above[i]) / 2);
        break;
    default:
        for (std::size_t i = 0; i < n; ++i) {
            const auto a = static_cast<short>(left[i]), b = static_cast<short>(above[i]), c = static_cast<short>(corner[i]);
            const auto pa = static_cast<short>(std::abs(b - c)), pb = static_cast<short>(std::abs(a - c)),
                       pc = static_cast<short>(std::abs(a + b - 2 * c));
            const short far = pb <= pc ? b : c;
            const short nearest = pa <= pb && pa <= pc ? a : far;
            out[i] = byte(x[i] - nearest);
        }
    }
}

/// Sum of the absolute values of signed bytes: the measure of the standard's section 12.8.
std::uint64_t cost(const std::uint8_t* p, std::size_t n) {
    std::uint64_t total = 0;
    while (n > 0) {
        // 255 sums of at most 128 each would not fill 16 bits; whole vectors of them are added at once.
        const std::size_t run = std::min<std::size_t>(n, 8192);
        std::uint32_t sum = 0;
        for (std::size_t i = 0; i < run; ++i) sum += p[i] < 128 ? p[i] : 256U - p[i];
        total += sum;
        p += run;
        n -= run;
    }
    return total;
}

class PngWriter final : public ImageWriter {
public:
    PngWriter(OutputFile file, PixelType type, int height, std::size_t pixel, std::size_t row, std::vector<std::uint8_t> tail,
              bool parallel)
        : file_(std::move(file)), stream_(file_.temporary_path()), type_(type), height_(height), pixel_(pixel), row_(row),
          tail_(std::move(tail)), parallel_(parallel) {
        segment_rows_ = static_cast<int>(std::clamp<std::size_t>(deflate_segment / (row_ + 1), 1, static_cast<std::size_t>(height)));
        // Padding of zeros ahead of each row and a row of them above the first.
        stride_ = pixel_ + row_;
        kept_.resize(stride_ * static_cast<std::size_t>(1 + 4 * segment_rows_));
    }
    PixelType type() const override { return type_; }

    void begin(Row head) { put(head); }

    Status write_rows(int y, int rows, const std::byte* samples) override {
        const std::string& path = file_.destination();
        return guarded(ErrorKind::output, path, [&]() -> Status {
            if (committed_) return output_error(path, "rows come after the end");
            if (y != next_row_ || rows < 0 || rows > height_ - y)
                return output_error(path, fmt::format("rows {}..{} are out of order: {} is next of {}", y, y + rows - 1, next_row_,
                                                      height_));
            for (int i = 0; i < rows; ++i) {
                std::uint8_t* to = kept_.data() + stride_ * static_cast<std::size_t>(1 + kept_rows_) + pixel_;
                const auto* from = reinterpret_cast<const std::uint8_t*>(samples) + row_ * static_cast<std::size_t>(i);
                if (type_ == PixelType::uint8)
                    std::memcpy(to, from, row_);
                else
                    for (std::size_t k = 0; k < row_; k += 2) to[k] = from[k + 1], to[k + 1] = from[k];
                ++next_row_;
                if (++kept_rows_ == 4 * segment_rows_ || next_row_ == height_) encode();
            }
            return {};
        });
    }
    Status commit() override {
        const std::string& path = file_.destination();
        return guarded(ErrorKind::output, path, [&]() -> Status {
            if (committed_) return output_error(path, "is committed already");
            if (next_row_ != height_) return output_error(path, fmt::format("{} of {} rows were written", next_row_, height_));
            put(tail_);
            committed_ = true;
            if (auto error = stream_.close()) return output_error(path, *error);
            return file_.commit();
        });
    }

private:
    struct Segment {
        std::uint32_t sum = 1;
        std::size_t length = 0;
        std::vector<std::uint8_t> chunk;  // length, type, data
    };
    void put(Row bytes) { stream_.write(reinterpret_cast<const char*>(bytes.data()), static_cast<int>(bytes.size())); }

    void encode() {
        const int first_row = next_row_ - kept_rows_, count = (kept_rows_ + segment_rows_ - 1) / segment_rows_;
        std::vector<Segment> segments(static_cast<std::size_t>(count));
        const auto work = [&](int i) {
            const int first = i * segment_rows_, rows = std::min(segment_rows_, kept_rows_ - first);
            encode_segment(first, rows, first_row + first == 0, first_row + first + rows == height_, segments[static_cast<std::size_t>(i)]);
        };
        if (parallel_ && count > 1)
            parallel_for(0, count, work);
        else
            for (int i = 0; i < count; ++i) work(i);
        for (int i = 0; i < count; ++i) {
            Segment& s = segments[static_cast<std::size_t>(i)];
            sum_ = adler32_join(sum_, s.sum, s.length);
            auto& c = s.chunk;
            if (i == count - 1 && next_row_ == height_) {
                c.resize(c.size() + 4);
                put32(c.data() + c.size() - 4, sum_);
            }
            put32(c.data(), static_cast<std::uint32_t>(c.size() - 8));
            std::array<std::uint8_t, 4> crc{};
            put32(crc.data(), crc32_gzip_refl(0, c.data() + 4, c.size() - 4));
            put(c);
            put(crc);
        }
        std::memcpy(kept_.data(), kept_.data() + stride_ * static_cast<std::size_t>(kept_rows_), stride_);
        kept_rows_ = 0;
    }
    void encode_segment(int first, int rows, bool begins, bool ends, Segment& s) const {
        thread_local std::vector<std::uint8_t> filtered, trial;
        s.length = (row_ + 1) * static_cast<std::size_t>(rows);
        filtered.resize(std::max(filtered.size(), s.length));
        trial.resize(std::max(trial.size(), row_));
        for (int i = 0; i < rows; ++i) {
            const std::uint8_t* above = kept_.data() + stride_ * static_cast<std::size_t>(first + i) + pixel_;
            const std::uint8_t* x = above + stride_;
            std::uint8_t* out = filtered.data() + (row_ + 1) * static_cast<std::size_t>(i);
            std::uint64_t least = ~std::uint64_t{0};
            for (const int filter : {2, 1, 4, 0}) {
                filter_row(filter, row_, x, x - pixel_, above, above - pixel_, trial.data());
                const std::uint64_t c = cost(trial.data(), row_);
                if (c >= least) continue;
                least = c;
                out[0] = static_cast<std::uint8_t>(filter);
                std::memcpy(out + 1, trial.data(), row_);
                if (c == 0) break;
            }
        }
        s.sum = adler32(filtered.data(), s.length);
        s.chunk = {0, 0, 0, 0, 'I', 'D', 'A', 'T'};
        if (begins) s.chunk.insert(s.chunk.end(), std::begin(zlib_head), std::end(zlib_head));
        deflate_append(filtered.data(), s.length, ends, s.chunk);
    }

    OutputFile file_;
    DescriptorStream stream_;
    PixelType type_;
    int height_;
    std::size_t pixel_, row_, stride_ = 0;  // bytes
    std::vector<std::uint8_t> tail_;
    bool parallel_, committed_ = false;
    int segment_rows_ = 1, next_row_ = 0, kept_rows_ = 0;
    std::vector<std::uint8_t> kept_;  // the row above and the rows of several segments
    std::uint32_t sum_ = 1;
};

}  // namespace

Result<std::unique_ptr<ImageWriter>> create_png(OutputFile& file, const OIIO::ImageSpec& spec, PixelType type, int threads) {
    using Out = Result<std::unique_ptr<ImageWriter>>;
    std::unique_ptr<ImageWriter> none;
    const std::size_t pixel = pixel_bytes(type) * static_cast<std::size_t>(spec.nchannels);
    const std::size_t row = pixel * static_cast<std::size_t>(spec.width);
    if (row > std::size_t{1} << 28) return Out(std::move(none));

    // OpenImageIO writes one row; all but its image data serve the whole image.
    OIIO::ImageSpec one = spec;
    one.height = one.full_height = 1;
    std::vector<std::uint8_t> bytes;
    OIIO::Filesystem::IOVecOutput memory(bytes);
    auto output = OIIO::ImageOutput::create("png");
    if (!output || !output->supports("ioproxy")) return Out(std::move(none));
    output->set_ioproxy(&memory);
    const std::vector<std::byte> black(row);
    const OIIO::TypeDesc samples = type == PixelType::uint16 ? OIIO::TypeUInt16 : OIIO::TypeUInt8;
    if (!output->open("header.png", one) || output->spec().format != samples || output->spec().nchannels != spec.nchannels ||
        !output->write_scanline(one.y, 0, samples, black.data()) || !output->close())
        return Out(std::move(none));
    output.reset();
    constexpr std::size_t ihdr_data = 16, ihdr_end = 33;
    constexpr std::array<std::uint8_t, 5> color_types{0xff, 0, 4, 2, 6};  // by channels
    if (bytes.size() < ihdr_end || spec.nchannels > 4 || bytes[24] != 8 * pixel_bytes(type) ||
        bytes[25] != color_types[static_cast<std::size_t>(spec.nchannels)] || bytes[28] != 0)
        return Out(std::move(none));
    put32(bytes.data() + ihdr_data + 4, static_cast<std::uint32_t>(spec.height));
    put32(bytes.data() + ihdr_end - 4, crc32_gzip_refl(0, bytes.data() + 12, 17));
    std::size_t first = 0, end = 0;
    for (std::size_t at = 8; at + 12 <= bytes.size();) {
        const std::size_t next = at + 12 + be32(bytes.data() + at);
        if (std::memcmp(bytes.data() + at + 4, "IDAT", 4) == 0) {
            if (first == 0) first = at;
            end = next;
        }
        at = next;
    }
    if (first == 0 || end > bytes.size()) return Out(std::move(none));
    std::vector<std::uint8_t> tail(bytes.begin() + static_cast<std::ptrdiff_t>(end), bytes.end());
    auto writer = std::make_unique<PngWriter>(std::move(file), type, spec.height, pixel, row, std::move(tail), threads > 1);
    writer->begin({bytes.data(), first});
    return std::unique_ptr<ImageWriter>(std::move(writer));
}

}  // namespace spectex::io
