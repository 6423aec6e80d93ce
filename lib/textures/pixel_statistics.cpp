// What a bounded sample of rows says about an image.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>

#include "kernels/convert.h"
#include "spectex/texture_use.h"

namespace spectex {
namespace {

/// Pearson's correlation, gathered pixel by pixel.
class Correlation {
public:
    void add(double x, double y) { n_ += 1, x_ += x, y_ += y, xx_ += x * x, yy_ += y * y, xy_ += x * y; }
    double value() const {
        const double vx = n_ * xx_ - x_ * x_, vy = n_ * yy_ - y_ * y_;
        return vx > 0 && vy > 0 ? (n_ * xy_ - x_ * y_) / std::sqrt(vx * vy) : 0;
    }

private:
    double n_ = 0, x_ = 0, y_ = 0, xx_ = 0, yy_ = 0, xy_ = 0;
};

/// A 3-D table of n^3 entries laid out as n slices of n x n, `columns` of them side by side.
struct LutLayout {
    int n = 0, columns = 0;
};

/// The layouts that tools write: a strip in either direction, or a square of slices.
std::optional<LutLayout> lut_layout(int width, int height) {
    for (int n = 8; n <= 64; ++n) {
        if (height == n && width == n * n) return LutLayout{n, n};
        if (width == n && height == n * n) return LutLayout{n, 1};
        const int columns = static_cast<int>(std::lround(std::sqrt(n)));
        if (columns * columns == n && width == n * columns && height == width) return LutLayout{n, columns};
    }
    return {};
}

class Sampler {
public:
    explicit Sampler(const ImageHeader& header)
        : width_(header.geometry.width), layout_(lut_layout(header.geometry.width, header.geometry.height)) {
        statistics_.channels = header.is_grey() ? 1 : 3;
        counts_.resize(1 << 15);
    }

    /// @param rgb, alpha  [width] each; alpha may be null.
    void add_row(int y, std::array<const float*, 3> rgb, const float* alpha) {
        int last = -1;
        for (int x = 0; x < width_; ++x) {
            ++seen_;
            if (alpha && alpha[x] == 0) {
                ++transparent_;
                last = -1;
                continue;
            }
            std::array<double, 3> c{};
            for (std::size_t k = 0; k < 3; ++k) {
                const double v = rgb[k][x];
                c[k] = std::isfinite(v) ? v : 0;
            }
            add_pixel(x, y, c, last);
        }
    }

    PixelStatistics finish() {
        PixelStatistics s = statistics_;
        s.pixels = pixels_;
        if (seen_ > 0) s.transparent = static_cast<double>(transparent_) / static_cast<double>(seen_);
        if (pixels_ == 0) return s;
        const auto n = static_cast<double>(pixels_);
        for (std::size_t k = 0; k < 3; ++k) {
            s.mean[k] = sum_[k] / n;
            s.deviation[k] = std::sqrt(std::max(0.0, squares_[k] / n - s.mean[k] * s.mean[k]));
        }
        for (double* share : {&s.grey, &s.unit_length, &s.binary, &s.saturated, &s.over_one, &s.negative}) *share /= n;
        if (neighbours_ > 0) s.flat /= static_cast<double>(neighbours_);
        std::vector<std::uint32_t> largest;
        for (const auto count : counts_)
            if (count > 0) largest.push_back(count);
        s.distinct_colors = static_cast<int>(largest.size());
        const auto top = std::min<std::size_t>(16, largest.size());
        std::partial_sort(largest.begin(), largest.begin() + static_cast<std::ptrdiff_t>(top), largest.end(), std::greater<>());
        s.largest_colors = static_cast<double>(std::accumulate(largest.begin(), largest.begin() + static_cast<std::ptrdiff_t>(top),
                                                               std::uint64_t{0})) / n;
        s.constant = true;
        for (std::size_t k = 0; k < 3; ++k) s.constant = s.constant && low_[k] == high_[k];
        // A graded table still rises along its axes; a picture of the same size does not, along all three at once.
        s.lut = layout_ && !s.constant && statistics_.channels == 3 && red_.value() > 0.85 && std::abs(green_.value()) > 0.85 &&
                std::abs(blue_.value()) > 0.85;
        return s;
    }

private:
    void add_pixel(int x, int y, const std::array<double, 3>& c, int& last) {
        ++pixels_;
        const double low = std::min({c[0], c[1], c[2]}), high = std::max({c[0], c[1], c[2]});
        double length = 0;
        std::array<int, 3> code{};
        for (std::size_t k = 0; k < 3; ++k) {
            sum_[k] += c[k];
            squares_[k] += c[k] * c[k];
            low_[k] = std::min(low_[k], c[k]);
            high_[k] = std::max(high_[k], c[k]);
            length += (2 * c[k] - 1) * (2 * c[k] - 1);
            code[k] = static_cast<int>(std::clamp(c[k], 0.0, 1.0) * 31 + 0.5);
        }
        constexpr double step = 1.0 / 255;
        PixelStatistics& s = statistics_;
        s.grey += high - low <= 2 * step + 1e-9;
        s.unit_length += std::abs(std::sqrt(length) - 1) <= 0.1;
        s.binary += high <= 3 * step || low >= 1 - 3 * step;
        s.saturated += high > 0.3 && high - low > 0.9 * high;
        s.over_one += high > 1;
        s.negative += low < 0;
        const int packed = code[0] << 10 | code[1] << 5 | code[2];
        ++counts_[static_cast<std::size_t>(packed)];
        if (last >= 0) {
            ++neighbours_;
            s.flat += packed == last;
        }
        last = packed;
        if (layout_) {
            const int n = layout_->n;
            red_.add(x % n, c[0]);
            green_.add(y % n, c[1]);
            blue_.add(y / n * layout_->columns + x / n, c[2]);
        }
    }

    int width_;
    std::optional<LutLayout> layout_;
    PixelStatistics statistics_;
    std::uint64_t seen_ = 0, pixels_ = 0, transparent_ = 0, neighbours_ = 0;
    std::array<double, 3> sum_{}, squares_{};
    std::array<double, 3> low_{1e300, 1e300, 1e300}, high_{-1e300, -1e300, -1e300};
    std::vector<std::uint32_t> counts_;
    Correlation red_, green_, blue_;
};

/// One channel of interleaved rows as floats, integers scaled to [0,1].
void to_floats(const std::byte* row, PixelType type, std::size_t channel, std::size_t channels, std::size_t n, float* out) {
    const std::byte* first = row + channel * pixel_bytes(type);
    switch (type) {
        case PixelType::uint8:
            for (std::size_t i = 0; i < n; ++i)
                out[i] = static_cast<float>(std::to_integer<int>(first[i * channels])) / 255;
            break;
        case PixelType::uint16:
            for (std::size_t i = 0; i < n; ++i) {
                std::uint16_t v;
                std::memcpy(&v, first + i * channels * sizeof v, sizeof v);
                out[i] = static_cast<float>(v) / 65535;
            }
            break;
        case PixelType::half: kernels::half_to_float(reinterpret_cast<const std::uint16_t*>(first), channels, n, out); break;
        case PixelType::float32: kernels::gather_floats(reinterpret_cast<const float*>(first), channels, n, out); break;
    }
}

}  // namespace

Result<PixelStatistics> sample_pixels(ImageReader& reader, int rows) {
    const ImageHeader& header = reader.header();
    if (!header.has_color())
        return Error{ErrorKind::input, header.path + ": has no colour channels to look at"};
    constexpr int block = 2;
    const int height = header.geometry.height;
    const int blocks = std::max(1, std::min(rows / block, (height + block - 1) / block));
    const auto width = static_cast<std::size_t>(header.geometry.width);
    const std::size_t channels = header.channels.size(), row_bytes = width * channels * pixel_bytes(header.type);
    std::vector<std::byte> samples(row_bytes * block);
    std::vector<float> planes(width * 4);
    Sampler sampler(header);
    for (int i = 0; i < blocks; ++i) {
        const int y = static_cast<int>(std::int64_t{i} * height / blocks);
        const int count = std::min(block, height - y);
        if (auto read = reader.read_rows(y, count, samples.data()); !read) return read.error();
        for (int r = 0; r < count; ++r) {
            const std::byte* row = samples.data() + static_cast<std::size_t>(r) * row_bytes;
            std::array<const float*, 3> rgb{};
            for (std::size_t k = 0; k < 3; ++k) {
                to_floats(row, header.type, static_cast<std::size_t>(header.color[k]), channels, width, planes.data() + k * width);
                rgb[k] = planes.data() + k * width;
            }
            float* alpha = header.alpha >= 0 ? planes.data() + 3 * width : nullptr;
            if (alpha) to_floats(row, header.type, static_cast<std::size_t>(header.alpha), channels, width, alpha);
            sampler.add_row(y + r, rgb, alpha);
        }
    }
    return sampler.finish();
}

}  // namespace spectex
