#include "spectex/heatmap.h"

#include <fmt/format.h>

#include <atomic>
#include <cmath>
#include <cstring>
#include <functional>

#include "io/internal.h"
#include "kernels/convert.h"
#include "pipeline/difference.h"

namespace spectex {
namespace {

using namespace pipeline;

using TakeRows = std::function<Status(int y, int rows, std::span<const float>)>;

/// Strips of differences in their order, as often as asked for.
struct MapSource {
    Geometry geometry;
    InputReport report;
    std::string title;
    std::function<Status(const TakeRows&)> run;
};

/// Runs what is parallel inside by the threads of the job.
template <class Body>
void in_arena(const JobOptions& job, const Body& body) {
    if (job.in_callers_arena) body();
    else tbb::task_arena(job.threads > 0 ? job.threads : tbb::info::default_concurrency()).execute(body);
}

Result<MapSource> open_map(const std::string& path, const JobOptions& job) {
    const io::FileMark mark(path);
    auto opened = ImageReader::open(path, job.threads);
    if (!opened) return std::move(opened).error();
    const std::shared_ptr<ImageReader> reader = *std::move(opened);
    const auto& header = reader->header();
    if (header.channels.size() != 1)
        return Error{ErrorKind::input, fmt::format("{}: {} channels ({}): expected a map of one channel, or two images", path,
                                                   header.channels.size(), fmt::join(header.channels, ", "))};
    MapSource source;
    source.geometry = header.geometry;
    source.report.path = path;
    source.report.width = header.geometry.width;
    source.report.height = header.geometry.height;
    source.title = header.channels[0];
    if (const auto found = header.metadata.find("spectex:metric"); found != header.metadata.end())
        if (const auto* name = std::get_if<std::string>(&found->second))
            if (const auto metric = parse_metric(*name)) source.title = metric_title(*metric);
    source.run = [reader, mark, job](const TakeRows& take) -> Status {
        const auto& h = reader->header();
        const auto width = static_cast<std::size_t>(h.geometry.width);
        const std::size_t sample = pixel_bytes(h.type);
        const int rows = rows_per_strip(reader->preferred_rows(), width * (sample + sizeof(float)), h.geometry.height);
        struct Buffers {
            std::vector<std::byte> samples;
            std::vector<float> values;
        };
        return run_strips(
            job, h.geometry.width, h.geometry.height, rows, [] { return Buffers{}; },
            [&](Buffers& b, int y, int n) -> Status {
                b.samples.resize(width * static_cast<std::size_t>(n) * sample);
                if (auto s = reader->read_rows(y, n, b.samples.data()); !s) return s;
                return y + n == h.geometry.height ? mark.check() : Status();
            },
            [&](Buffers& b, int, int n) -> Status {
                b.values.resize(width * static_cast<std::size_t>(n));
                // A map in an integer format holds codes, not fractions: 7 is 7.
                if (h.type == PixelType::uint8)
                    for (std::size_t i = 0; i < b.values.size(); ++i)
                        b.values[i] = static_cast<float>(std::to_integer<unsigned>(b.samples[i]));
                else if (h.type == PixelType::uint16)
                    for (std::size_t i = 0; i < b.values.size(); ++i)
                        b.values[i] = reinterpret_cast<const std::uint16_t*>(b.samples.data())[i];
                else
                    convert_samples(b.samples.data(), h.type, b.values.size(), reinterpret_cast<std::byte*>(b.values.data()),
                                    PixelType::float32);
                return {};
            },
            [&](Buffers& b, int y, int n) { return take(y, n, b.values); });
    };
    return source;
}

/// Differences above this many pixels are computed twice rather than kept.
constexpr std::int64_t kept_pixels = std::int64_t{1} << 26;

Result<MapSource> open_pair(const std::string& a, const std::string& b, const HeatmapOptions& options) {
    DifferenceOptions differences;
    differences.job = options.job;
    differences.metric = options.metric;
    auto opened = DifferencePair::open(a, b, differences);
    if (!opened) return std::move(opened).error();
    const auto pair = std::make_shared<DifferencePair>(*std::move(opened));
    MapSource source;
    source.geometry = pair->a.strips().geometry();
    source.report = pair->report_a;
    source.title = metric_title(options.metric);
    const auto kept = std::make_shared<std::vector<float>>();
    const JobOptions job = options.job;
    source.run = [pair, kept, job](const TakeRows& take) -> Status {
        const auto& g = pair->a.strips().geometry();
        const auto width = static_cast<std::size_t>(g.width);
        if (!kept->empty()) {
            Status status;
            constexpr int step = 256;
            in_arena(job, [&] {
                for (int y = 0; y < g.height && status; y += step) {
                    const int n = std::min(step, g.height - y);
                    status = take(y, n, {kept->data() + static_cast<std::size_t>(y) * width, static_cast<std::size_t>(n) * width});
                }
            });
            return status;
        }
        const bool keep = static_cast<std::int64_t>(g.width) * g.height <= kept_pixels;
        std::vector<float> rows;
        if (keep) rows.reserve(static_cast<std::size_t>(g.height) * width);
        const auto status = run_differences(*pair, job, false, [&](int y, int n, std::span<const float> values, std::span<const std::uint64_t>) {
            if (keep) rows.insert(rows.end(), values.begin(), values.end());
            return take(y, n, values);
        });
        if (status) *kept = std::move(rows);
        return status;
    };
    return source;
}

Result<std::unique_ptr<ImageWriter>> picture_writer(const std::string& output, int width, int height, int threads) {
    const auto stored = storable_type(output, PixelType::uint8);
    if (!stored || *stored != PixelType::uint8)
        return Error{ErrorKind::usage, fmt::format("{}: expected a picture format of 8 bits, such as .png, .tif or .jpg", output)};
    Geometry geometry;
    geometry.width = geometry.full_width = width;
    geometry.height = geometry.full_height = height;
    return ImageWriter::create(output, geometry, {"R", "G", "B"}, false, {}, {PixelType::uint8, "", threads});
}

}  // namespace

Status write_picture(const std::string& output, const Picture& picture, int threads) {
    auto writer = picture_writer(output, picture.width, picture.height, threads);
    if (!writer) return writer.error();
    if (auto s = (*writer)->write_rows(0, picture.height, reinterpret_cast<const std::byte*>(picture.rgb.data())); !s) return s;
    return (*writer)->commit();
}

Result<HeatmapReport> heatmap(const std::string& map_or_a, const std::string& b, const std::string& output,
                              const HeatmapOptions& options) {
    const auto colors = find_color_map(options.colormap);
    if (!colors) return colors.error();
    if (options.range && !((*options.range)[0] < (*options.range)[1]))
        return Error{ErrorKind::usage, fmt::format("range {}:{}: expected LO below HI", (*options.range)[0], (*options.range)[1])};
    for (const auto& input : {map_or_a, b})
        if (!input.empty() && same_file(input, output))
            return Error{ErrorKind::usage, fmt::format("{}: the output is an input itself", output)};
    auto source = b.empty() ? open_map(map_or_a, options.job) : open_pair(map_or_a, b, options);
    if (!source) return std::move(source).error();

    HeatmapReport report;
    report.input = source->report;
    DifferenceAccumulator accumulator;
    const auto gathered = source->run([&](int y, int rows, std::span<const float> values) -> Status {
        const std::size_t width = values.size() / static_cast<std::size_t>(rows);
        for (int row = 0; row < rows; ++row)
            if (auto s = accumulator.add_row(y + row, values.subspan(static_cast<std::size_t>(row) * width, width)); !s) return s;
        return {};
    });
    if (!gathered) return gathered.error();
    auto statistics = accumulator.finish();
    if (!statistics) return std::move(statistics).error();
    report.statistics = *statistics;
    report.input.nonfinite = statistics->nonfinite;
    if (options.job.strict && statistics->nonfinite > 0)
        return Error{ErrorKind::input, fmt::format("{}: {} pixels are not finite: expected numbers, with --strict", map_or_a,
                                                   statistics->nonfinite)};
    report.low = options.range ? (*options.range)[0] : 0;
    report.high = options.range ? (*options.range)[1] : round_up_range(statistics->p999);

    const int height = source->geometry.height, width = source->geometry.width;
    int factor = 1;
    Picture legend;
    if (options.legend) {
        factor = std::max(1, (minimum_map_height() + height - 1) / height);
        Legend text;
        text.low = report.low;
        text.high = report.high;
        text.title = source->title;
        text.notes = {fmt::format("mean {:.3g}", statistics->mean), fmt::format("p99 {:.3g}", statistics->p99),
                      fmt::format("max {:.3g}", statistics->max)};
        if (statistics->nonfinite > 0) text.notes.push_back(fmt::format("{} without value", statistics->nonfinite));
        auto drawn = draw_legend(*colors, text, height * factor);
        if (!drawn) return std::move(drawn).error();
        legend = *std::move(drawn);
    }
    const auto map_width = static_cast<std::size_t>(width) * static_cast<std::size_t>(factor);
    report.width = width * factor + legend.width;
    report.height = height * factor;
    auto writer = picture_writer(output, report.width, report.height, options.job.threads);
    if (!writer) return std::move(writer).error();

    const std::size_t row_bytes = static_cast<std::size_t>(report.width) * 3;
    const auto wide = static_cast<std::size_t>(factor);
    const double scale = 1 / (report.high - report.low);
    std::vector<std::byte> picture;
    const auto status = source->run([&](int y, int n, std::span<const float> values) -> Status {
        const auto row_width = static_cast<std::size_t>(width);
        picture.resize(row_bytes * wide * static_cast<std::size_t>(n));
        std::atomic<std::uint64_t> above{0}, below{0};
        for_row_groups(n, width, [&](int first, int count) {
            std::uint64_t over = 0, under = 0;
            for (int row = first; row < first + count; ++row) {
                const float* in = values.data() + static_cast<std::size_t>(row) * row_width;
                std::byte* line = picture.data() + static_cast<std::size_t>(row) * wide * row_bytes;
                std::byte* out = line;
                for (std::size_t x = 0; x < row_width; ++x) {
                    const double v = in[x];
                    over += v > report.high;
                    under += v < report.low;
                    const auto code = colors->at(std::isinf(v) ? std::nan("") : (v - report.low) * scale);
                    for (std::size_t i = 0; i < wide; ++i)
                        for (const std::uint8_t c : code) *out++ = std::byte{c};
                }
                for (std::size_t i = 1; i < wide; ++i) std::memcpy(line + i * row_bytes, line, map_width * 3);
                for (std::size_t i = 0; legend.width > 0 && i < wide; ++i) {
                    const std::size_t of = static_cast<std::size_t>(y + row) * wide + i, size = static_cast<std::size_t>(legend.width) * 3;
                    std::memcpy(line + i * row_bytes + map_width * 3, legend.rgb.data() + of * size, size);
                }
            }
            above += over;
            below += under;
        });
        report.above += above;
        report.below += below;
        return (*writer)->write_rows(y * factor, n * factor, picture.data());
    });
    if (!status) return status.error();
    if (auto s = (*writer)->commit(); !s) return s.error();
    return report;
}

}  // namespace spectex
