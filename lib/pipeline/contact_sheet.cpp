// One texture under many lights on one labelled picture.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "pipeline/relight_setup.h"
#include "pipeline/shrink.h"
#include "pipeline/strips.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

using namespace pipeline;

/// Pixels of a tile, and what those of all tiles may take together: three floats for each.
constexpr double tile_pixels = 256.0 * 256.0, all_tile_pixels = 16e6;
constexpr int longest_side = 1024;
/// A strip or a trim sheet keeps this many rows (or columns) where it has them, rather than shrink to a line.
constexpr int shortest_side = 16;

struct TileSize {
    int width = 1, height = 1;
};
/// As large as the texture where that is small, else of its shape with about tile_pixels; one far from square is stretched.
TileSize tile_size(int width, int height, std::size_t tiles) {
    const double most = std::min(tile_pixels, all_tile_pixels / static_cast<double>(tiles));
    const double scale = std::min({1.0, std::sqrt(most / (static_cast<double>(width) * height)),
                                   static_cast<double>(longest_side) / std::max(width, height)});
    const auto scaled = [&](int side) { return std::max(static_cast<int>(std::lround(side * scale)), std::min(side, shortest_side)); };
    return {scaled(width), scaled(height)};
}

/// One light's picture and figures, gathered row by row.
struct Tile {
    std::vector<float> linear;  // [height][width][3], sums of shares
    CompensatedSum difference;
    double largest = 0;
    std::array<std::int64_t, 2> largest_at{-1, -1};
};

/// One row of the texture under one light.
struct RowSums {
    std::vector<float> linear;  // [tile width][3]
    double difference = 0, largest = -1;
    std::int64_t largest_x = 0;
};

constexpr Rgb8 ink{20, 20, 20}, faint{105, 105, 105}, rule{200, 200, 200};

/// Text cut to a width, with an ellipsis.
std::string fitted(const std::string& text, double width, double size, Weight weight = Weight::regular) {
    if (measure_text(text, size, weight).width <= width) return text;
    for (std::size_t n = text.size(); n-- > 0;) {
        if ((static_cast<unsigned char>(text[n]) & 0xC0) == 0x80) continue;  // not inside a character
        const std::string cut = text.substr(0, n) + "…";
        if (measure_text(cut, size, weight).width <= width) return cut;
    }
    return "…";
}

/// To a tenth, for CIE A, 2856 K by name, is 2855.5 K by today's constants: whole kelvins would seem to contradict the name.
std::string kelvin_text(const std::optional<double>& kelvin) {
    return kelvin ? fmt::format("{:.1f} K", *kelvin) : std::string("no CCT");
}

std::string figures_text(const ContactSheetReport::Tile& tile) {
    return fmt::format("ΔE00 mean {:.2f}  max {:.2f}", tile.mean, tile.max);
}

Result<Picture> draw(const std::vector<Picture>& pictures, const ContactSheetReport& report, const std::string& title) {
    constexpr double size = 14, small = 12;
    constexpr int margin = 20, gap = 18, caption = 60;
    // Small textures are enlarged by whole factors, so that their texels can be seen.
    const int factor = std::max(1, std::min(128 / pictures[0].width, 128 / pictures[0].height));
    const auto enlarged = [&](int side) { return std::max(factor, (shortest_side + side - 1) / side) * side; };
    const int picture_width = enlarged(pictures[0].width), picture_height = enlarged(pictures[0].height);
    double text_width = 0;
    for (const auto& tile : report.tiles) {
        text_width = std::max(text_width, measure_text(figures_text(tile), small).width);
        text_width = std::max(text_width, std::min(190.0, measure_text(tile.illuminant, size, Weight::bold).width + 12 +
                                                              measure_text(kelvin_text(tile.kelvin), size).width));
    }
    const int cell_width = std::max(picture_width, static_cast<int>(std::ceil(text_width)));
    const int cell_height = picture_height + caption;
    // The columns whose sheet is nearest 3:2, ties to the wider one.
    const int count = static_cast<int>(pictures.size());
    int columns = 1;
    double best = 1e9;
    for (int c = 1; c <= count; ++c) {
        const int rows = (count + c - 1) / c;
        const double shape = std::fabs(std::log(static_cast<double>(c) * (cell_width + gap) / (rows * (cell_height + gap)) / 1.5)) +
                             0.3 * (rows * c - count) / count;
        if (shape <= best) {
            best = shape;
            columns = c;
        }
    }
    const int rows = (count + columns - 1) / columns;
    // The heading needs room of its own where there are few narrow tiles.
    const int width = std::max(2 * margin + columns * (cell_width + gap) - gap, 520);
    const int head = 64;
    auto canvas = Canvas::make(width, head + margin + rows * (cell_height + gap) - gap + margin);
    if (!canvas) return std::move(canvas).error();
    const double room = width - 2 * margin;
    canvas->text(margin, 30, fitted(title, room, 18, Weight::bold), 18, ink, Weight::bold);
    canvas->text(margin, 52, fitted(report.note, room, small), small, faint);
    canvas->line(margin, head + 0.5, width - margin, head + 0.5, 1, rule);
    for (int i = 0; i < count; ++i) {
        const auto& tile = report.tiles[static_cast<std::size_t>(i)];
        const int x = margin + i % columns * (cell_width + gap), y = head + margin + i / columns * (cell_height + gap);
        canvas->paste(pictures[static_cast<std::size_t>(i)], x, y, picture_width, picture_height, Filter::nearest);
        canvas->frame(x, y, picture_width, picture_height, 1, rule);
        const double below = y + picture_height;
        const std::string kelvin = kelvin_text(tile.kelvin);
        const double left = cell_width - measure_text(kelvin, size).width - 8;
        canvas->text(x, below + 18, fitted(tile.illuminant, left, size, Weight::bold), size, ink, Weight::bold);
        canvas->text(x + cell_width, below + 18, kelvin, size, ink, Weight::regular, Anchor::right);
        canvas->text(x, below + 35, fitted(tile.title, cell_width, small), small, faint);
        canvas->text(x, below + 52, figures_text(tile), small, ink);
    }
    return canvas->picture();
}

}  // namespace

Result<ContactSheetReport> contact_sheet(const std::string& input, const std::string& output, const RelightOptions& options) {
    if (same_file(input, output)) return Error{ErrorKind::usage, fmt::format("{}: the output is the input itself", output)};
    const auto stored = storable_type(output, PixelType::uint8);
    if (!stored || *stored != PixelType::uint8)
        return Error{ErrorKind::usage, fmt::format("{}: expected a picture format of 8 bits, such as .png, .tif or .jpg", output)};
    const std::size_t lights = options.illuminants.size();
    constexpr std::size_t most_lights = 1000;
    if (lights == 0 || lights > most_lights)
        return Error{ErrorKind::usage, fmt::format("a contact sheet of {} lights: expected 1 to {}", lights, most_lights)};
    RelightOptions with_reference = options;
    auto d65 = parse_illuminant("D65");
    if (!d65) return std::move(d65).error();
    with_reference.illuminants.push_back(*std::move(d65));
    with_reference.job.select.color_only = true;
    auto made = RelightSetup::make(input, with_reference);
    if (!made) return std::move(made).error();
    const RelightSetup& setup = *made;
    if (setup.emissive)
        return Error{ErrorKind::usage, fmt::format("{}: emission is reprojected, not lit: expected reflectance for a contact sheet", input)};

    ContactSheetReport report;
    // Lab of the tiles as they are shown, all against the white of D65.
    auto colorimetry = Colorimetry::make({setup.observer, "", setup.space.name, RgbMatrix::integrated},
                                         BandSet(SpectralShape::make(380, 780, 1).value()));
    if (!colorimetry) return std::move(colorimetry).error();
    auto white = tristimulus_weights(colorimetry->bands(), colorimetry->observer(), with_reference.illuminants.back(),
                                     Normalization::luminance);
    if (!white) return std::move(white).error();
    const DifferenceKernel difference(Metric::ciede2000, colorimetry->rgb_to_xyz(), colorimetry->rgb_to_xyz(), white->white);
    auto transform = ColorTransform::from_linear(setup.space, srgb_name());
    if (!transform) return std::move(transform).error();

    const auto& geometry = setup.source->geometry();
    const int width = geometry.width, height = geometry.height;
    const TileSize size = tile_size(width, height, lights);
    const Box across{size.width, static_cast<double>(width) / size.width}, down{size.height, static_cast<double>(height) / size.height};
    const auto tile_width = static_cast<std::size_t>(size.width), tile_height = static_cast<std::size_t>(size.height);
    std::vector<Tile> tiles(lights);
    for (auto& tile : tiles) tile.linear.assign(3 * tile_width * tile_height, 0.0F);

    struct Strip {
        RawStrip raw;
        std::vector<RowSums> rows;  // [rows][lights]
    };
    CountTotals totals;
    const std::size_t row_bytes = setup.source->raw_bytes_per_row() + lights * (12 * tile_width + sizeof(RowSums));
    const auto status = run_strips(
        options.job, width, height, rows_per_strip(setup.source->preferred_rows(), row_bytes, height), [] { return Strip{}; },
        [&](Strip& s, int y, int n) { return made->source->read(y, n, s.raw); },
        [&](Strip& s, int y, int n) -> Status {
            s.rows.resize(static_cast<std::size_t>(n) * lights);
            FirstError error;
            for_row_groups(n, width, [&](int first, int count) {
                thread_local RelightSetup::Buffers buffers;
                thread_local std::vector<float> differences;
                thread_local std::vector<double> sums;
                const auto w = static_cast<std::size_t>(width);
                const std::size_t begin = static_cast<std::size_t>(first) * w, pixels = static_cast<std::size_t>(count) * w;
                Counts counts;
                std::vector<float*> out;
                if (auto lit = setup.light(s.raw, y, begin, pixels, buffers, out, counts); !lit) {
                    error.check(lit);
                    return;
                }
                totals.add(counts, y, width);
                differences.resize(w);
                for (std::size_t row = 0; row < static_cast<std::size_t>(count); ++row)
                    for (std::size_t k = 0; k < lights; ++k) {
                        const auto plane = [&](std::size_t image, std::size_t c) { return out[3 * image + c] + row * w; };
                        difference({plane(lights, 0), plane(lights, 1), plane(lights, 2)}, {plane(k, 0), plane(k, 1), plane(k, 2)}, w,
                                   differences.data());
                        RowSums& sum = s.rows[(static_cast<std::size_t>(first) + row) * lights + k];
                        CompensatedSum total;
                        sum.largest = -1;
                        for (std::size_t x = 0; x < w; ++x) {
                            total.add(differences[x]);
                            if (differences[x] > sum.largest) {
                                sum.largest = differences[x];
                                sum.largest_x = static_cast<std::int64_t>(x);
                            }
                        }
                        sum.difference = total.value();
                        sums.assign(3 * tile_width, 0.0);
                        for (std::size_t c = 0; c < 3; ++c) {
                            const float* const from = plane(k, c);
                            for (int x = 0; x < width; ++x)
                                across.spread(x, [&](std::size_t t, double share) { sums[3 * t + c] += share * from[x]; });
                        }
                        sum.linear.assign(sums.begin(), sums.end());
                    }
            });
            return error.status();
        },
        [&](Strip& s, int y, int n) -> Status {
            for (int row = 0; row < n; ++row)
                for (std::size_t k = 0; k < lights; ++k) {
                    const RowSums& sum = s.rows[static_cast<std::size_t>(row) * lights + k];
                    Tile& tile = tiles[k];
                    tile.difference.add(sum.difference);
                    if (sum.largest > tile.largest || tile.largest_at[0] < 0) {
                        tile.largest = sum.largest;
                        tile.largest_at = {sum.largest_x, y + row};
                    }
                    down.spread(y + row, [&](std::size_t t, double share) {
                        float* const to = &tile.linear[3 * tile_width * t];
                        for (std::size_t i = 0; i < 3 * tile_width; ++i) to[i] += static_cast<float>(share) * sum.linear[i];
                    });
                }
            return {};
        });
    if (!status) return status.error();
    report.input = setup.source->report();
    totals.put_into(report.input);
    if (auto s = check_strict(options.job, report.input); !s) return s.error();

    std::vector<Picture> pictures;
    for (std::size_t k = 0; k < lights; ++k) {
        const auto& light = options.illuminants[k];
        auto temperature = correlated_color_temperature(light);
        if (!temperature) return std::move(temperature).error();
        ContactSheetReport::Tile figures;
        figures.illuminant = light.name;
        figures.title = light.title;
        figures.kelvin = temperature->kelvin;
        figures.duv = temperature->duv;
        figures.mean = tiles[k].difference.value() / (static_cast<double>(width) * height);
        figures.max = tiles[k].largest;
        figures.max_at = tiles[k].largest_at;
        pictures.push_back(shown(tiles[k].linear, size.width, size.height, **transform, figures.clipped));
        report.tiles.push_back(std::move(figures));
    }
    static constexpr const char* adaptations[] = {"no adaptation", "von Kries adaptation", "Bradford adaptation", "CAT02 adaptation",
                                                  "CAT16 adaptation"};
    report.note = fmt::format("ΔE00 from the same under D65, against its white; {}{}",
                              adaptations[static_cast<std::size_t>(options.adaptation)],
                              options.adaptation == Adaptation::none ? ", so casts count" : " to it");
    auto sheet = draw(pictures, report, std::filesystem::path(input).filename().string());
    if (!sheet) return std::move(sheet).error();
    report.output = output;
    report.width = sheet->width;
    report.height = sheet->height;
    if (auto s = write_picture(output, *sheet, options.job.threads); !s) return s.error();
    return report;
}

}  // namespace spectex
