// Small pictures of a texture before and after.
#include <fmt/format.h>

#include "pipeline/relight_setup.h"
#include "pipeline/shrink.h"
#include "pipeline/strips.h"

namespace spectex {
namespace {

using namespace pipeline;

struct Size {
    int width = 1, height = 1;
};
Size small_size(int width, int height, int side) {
    const double scale = std::min(1.0, static_cast<double>(side) / std::max(width, height));
    const auto scaled = [&](int n) { return std::max(1, static_cast<int>(std::lround(n * scale))); };
    return {scaled(width), scaled(height)};
}

/// Rows of linear RGB, and differences where there are any, brought together into few.
class Shrinker {
public:
    Shrinker(int width, int height, int side)
        : width_(width), size_(small_size(width, height, side)), across_{size_.width, static_cast<double>(width) / size_.width},
          down_{size_.height, static_cast<double>(height) / size_.height}, linear_(3 * count(), 0.0), largest_(count(), -1.0F) {}

    struct Row {
        std::vector<double> linear;  // [width][3]
        std::vector<float> largest;  // [width]; -1 where no difference is a number
    };
    /// One row of the texture; const and thread-safe.
    void shrink_row(std::array<const float*, 3> rgb, const float* differences, Row& row) const {
        const auto w = static_cast<std::size_t>(size_.width);
        row.linear.assign(3 * w, 0.0);
        row.largest.assign(w, -1.0F);
        for (int x = 0; x < width_; ++x)
            across_.spread(x, [&](std::size_t t, double share) {
                for (std::size_t c = 0; c < 3; ++c) row.linear[3 * t + c] += share * static_cast<double>(rgb[c][x]);
                // A comparison that a NaN fails.
                if (differences && differences[x] > row.largest[t]) row.largest[t] = differences[x];
            });
    }
    void add_row(int y, const Row& row) {
        const auto w = static_cast<std::size_t>(size_.width);
        down_.spread(y, [&](std::size_t t, double share) {
            for (std::size_t i = 0; i < 3 * w; ++i) linear_[3 * w * t + i] += share * row.linear[i];
            for (std::size_t i = 0; i < w; ++i) largest_[w * t + i] = std::max(largest_[w * t + i], row.largest[i]);
        });
    }
    Result<Picture> picture(const RgbSpace& space) const {
        auto transform = ColorTransform::from_linear(space, srgb_name());
        if (!transform) return std::move(transform).error();
        const std::vector<float> linear(linear_.begin(), linear_.end());
        std::uint64_t clipped = 0;
        return shown(linear, size_.width, size_.height, **transform, clipped);
    }
    Picture errors(const ColorMap& map) const {
        Picture picture{size_.width, size_.height, {}};
        picture.rgb.reserve(3 * count());
        for (const float v : largest_) {
            const Rgb8 code = v < 0 ? ColorMap::no_value : thumbnail_error_color(map, static_cast<double>(v));
            picture.rgb.insert(picture.rgb.end(), code.begin(), code.end());
        }
        return picture;
    }

private:
    std::size_t count() const { return static_cast<std::size_t>(size_.width) * static_cast<std::size_t>(size_.height); }
    int width_;
    Size size_;
    Box across_, down_;
    std::vector<double> linear_;
    std::vector<float> largest_;
};

struct Strip {
    RawStrip raw;
    std::vector<Shrinker::Row> rows;
};

/// One pass over a file. @param rows  (raw, y, first row of the strip, count, rows out) -> Status, thread-safe.
template <class Rows>
Status shrink(StripSource& source, const JobOptions& job, Shrinker& shrinker, const Rows& rows) {
    const auto& geometry = source.geometry();
    return run_strips(
        job, geometry.width, geometry.height,
        rows_per_strip(source.preferred_rows(), source.raw_bytes_per_row(), geometry.height), [] { return Strip{}; },
        [&](Strip& s, int y, int n) { return source.read(y, n, s.raw); },
        [&](Strip& s, int y, int n) -> Status {
            s.rows.resize(static_cast<std::size_t>(n));
            FirstError error;
            for_row_groups(n, geometry.width, [&](int first, int count) {
                error.check(rows(s.raw, y, first, count, s.rows.data() + first));
            });
            return error.status();
        },
        [&](Strip& s, int y, int n) -> Status {
            for (int row = 0; row < n; ++row) shrinker.add_row(y + row, s.rows[static_cast<std::size_t>(row)]);
            return {};
        });
}

}  // namespace

Rgb8 thumbnail_error_color(const ColorMap& map, double difference) {
    static const double span = std::log(thumbnail_error_high / thumbnail_error_low);
    return map.at(difference <= thumbnail_error_low ? 0 : std::log(difference / thumbnail_error_low) / span);
}

Result<Thumbnails> thumbnails(const std::string& input, const std::string& output, const ThumbnailOptions& options) {
    constexpr int largest_side = 1024;
    if (options.side < 1 || options.side > largest_side)
        return Error{ErrorKind::usage, fmt::format("a thumbnail of {} pixels: expected 1 to {}", options.side, largest_side)};
    const auto colors = find_color_map(default_color_map());
    if (!colors) return colors.error();

    auto uplifting = UpliftSetup::make(input, options.settings, options.job);
    if (!uplifting) return std::move(uplifting).error();
    const UpliftSetup& setup = *uplifting;
    const auto& colorimetry = setup.model->colorimetry();
    const DifferenceKernel kernel(Metric::cie76, colorimetry.rgb_to_xyz(), colorimetry.rgb_to_xyz(), colorimetry.white_xyz());
    const auto& geometry = setup.source->geometry();
    const int width = geometry.width;
    const std::size_t stored = setup.plan.channels(), sample = pixel_bytes(setup.plan.type());
    Shrinker before(width, geometry.height, options.side);
    auto status = shrink(*setup.source, options.job, before, [&](const RawStrip& raw, int y, int first, int count, Shrinker::Row* rows) -> Status {
        thread_local Scratch scratch;
        thread_local std::vector<std::byte> samples;
        thread_local std::vector<float> differences;
        const auto w = static_cast<std::size_t>(width);
        const std::size_t size = static_cast<std::size_t>(count) * w;
        samples.resize(std::max(samples.size(), stored * size * sample));
        differences.resize(std::max(differences.size(), w));
        std::vector<std::byte*> planes;
        for (std::size_t i = 0; i < stored; ++i) planes.push_back(samples.data() + i * size * sample);
        Counts counts;
        if (auto s = setup.convert(raw, y, static_cast<std::size_t>(first) * w, size, scratch, planes, counts); !s) return s;
        std::uint64_t changed = 0, replaced = 0;
        for (std::size_t row = 0; row < static_cast<std::size_t>(count); ++row) {
            measure_row(setup, kernel, scratch, planes, row * w, w, differences.data(), changed);
            const auto at = [&](std::size_t c) { return scratch.input[c].data() + row * w; };
            // One sample that is not finite would spread over its tile pixel.
            replace_nonfinite({at(0), at(1), at(2)}, w, replaced);
            before.shrink_row({at(0), at(1), at(2)}, differences.data(), rows[row]);
        }
        return {};
    });
    if (!status) return status.error();

    RelightOptions relight;
    relight.job = options.job;
    relight.job.select = {};
    relight.job.select.color_only = true;
    relight.illuminants = {options.light};
    auto relighting = RelightSetup::make(output, relight);
    if (!relighting) return std::move(relighting).error();
    const RelightSetup& lit = *relighting;
    const int lit_width = lit.source->geometry().width;
    Shrinker after(lit_width, lit.source->geometry().height, options.side);
    status = shrink(*lit.source, options.job, after, [&](const RawStrip& raw, int y, int first, int count, Shrinker::Row* rows) -> Status {
        thread_local RelightSetup::Buffers buffers;
        const auto w = static_cast<std::size_t>(lit_width);
        std::vector<float*> out;
        Counts counts;
        if (auto s = lit.light(raw, y, static_cast<std::size_t>(first) * w, static_cast<std::size_t>(count) * w, buffers, out, counts); !s)
            return s;
        for (std::size_t row = 0; row < static_cast<std::size_t>(count); ++row)
            after.shrink_row({out[0] + row * w, out[1] + row * w, out[2] + row * w}, nullptr, rows[row]);
        return {};
    });
    if (!status) return status.error();

    auto source = before.picture(colorimetry.rgb_space());
    if (!source) return std::move(source).error();
    auto relit = after.picture(lit.space);
    if (!relit) return std::move(relit).error();
    return Thumbnails{*std::move(source), *std::move(relit), before.errors(*colors)};
}

}  // namespace spectex
