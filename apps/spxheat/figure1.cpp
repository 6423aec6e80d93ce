#include "figure1.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "spectex/color.h"

namespace spectex::app {
namespace {

constexpr Rgb8 ink{20, 20, 20}, faint{110, 110, 110}, rule{205, 205, 205};

/// All lengths follow the width of the figure; text is 11 px at 1200.
struct Measures {
    double u;  // one pixel of a figure of 1200
    int margin, gap, legend, panel, heading, foot;
    Measures(int width, std::size_t methods) : u(width / 1200.0) {
        const auto px = [&](double v) { return static_cast<int>(std::lround(v * u)); };
        margin = px(24), gap = px(18), legend = px(96), heading = px(46), foot = px(44);
        const int columns = static_cast<int>(methods) + 1;
        panel = (width - 2 * margin - gap * (columns - 1) - legend) / columns;
    }
    double text() const { return 12 * u; }
    double small() const { return 11 * u; }
    int x(std::size_t column) const { return margin + static_cast<int>(column) * (panel + gap); }
    int y(std::size_t row) const { return margin / 2 + static_cast<int>(row) * (panel + heading) + heading; }
};

std::uint8_t code(double linear) { return static_cast<std::uint8_t>(std::lround(255 * srgb_encode(std::clamp(linear, 0.0, 1.0)))); }

Picture rendered(const std::vector<float>& linear, int panel) {
    Picture out{panel, panel, {}};
    for (const float v : linear) out.rgb.push_back(code(static_cast<double>(v)));
    return out;
}

Picture mapped(const std::vector<float>& values, int panel, const ColorMap& colors, const std::array<double, 2>& range) {
    Picture out{panel, panel, {}};
    for (const float v : values) {
        const auto c = colors.at((static_cast<double>(v) - range[0]) / (range[1] - range[0]));
        out.rgb.insert(out.rgb.end(), c.begin(), c.end());
    }
    return out;
}

/// As much of the text as fits.
std::string fitted(std::string text, double size, double width, Weight weight = Weight::regular) {
    if (measure_text(text, size, weight).width <= width) return text;
    while (!text.empty() && measure_text(text + "…", size, weight).width > width) {
        // A character of UTF-8 at a time.
        while (text.size() > 1 && (static_cast<unsigned char>(text.back()) & 0xc0) == 0x80) text.pop_back();
        text.pop_back();
    }
    while (!text.empty() && (text.back() == ' ' || text.back() == ',')) text.pop_back();
    return text + "…";
}

/// The size at which the text has that width: no larger than `size`, no smaller than `least` of it.
double fitting_size(const std::string& text, double size, double width, double least = 0.72) {
    const double wide = measure_text(text, size, Weight::regular).width;
    return wide <= width ? size : size * std::max(least, width / wide * 0.99);
}

std::string figure(double v) {
    if (v == 0) return "0";
    // What rounding leaves is shown as such.
    if (v < 0.005) return fmt::format("{:.0e}", v);
    return fmt::format("{:.{}f}", v, v < 9.95 ? 2 : 1);
}

std::string grouped(std::uint64_t n) {
    auto digits = std::to_string(n);
    for (std::size_t i = digits.size(); i > 3; i -= 3) digits.insert(i - 3, 1, ',');
    return digits;
}

std::string figures(const DifferenceStatistics& s) {
    return fmt::format("mean {}   p99 {}   max {}", figure(s.mean), figure(s.p99), figure(s.max));
}

/// Means with whiskers to the 99th percentile, on the scale of the maps.
void draw_bars(Canvas& canvas, const Measures& m, int x, int y, const std::vector<std::pair<std::string, const DifferenceStatistics*>>& bars,
               const ColorMap& colors, const std::array<double, 2>& range, const std::string& unit) {
    const double left = x + 34 * m.u, right = x + m.panel, top = y + 30 * m.u, bottom = y + m.panel - 34 * m.u;
    const auto at = [&](double v) {
        return bottom - (std::clamp(v, range[0], range[1]) - range[0]) / (range[1] - range[0]) * (bottom - top);
    };
    canvas.text(left, top - 12 * m.u, unit, m.small(), faint);
    const auto positions = ticks(range[0], range[1]);
    const auto labels = tick_labels(positions);
    for (std::size_t i = 0; i < positions.size(); ++i) {
        canvas.line(left, at(positions[i]), right, at(positions[i]), std::max(1.0, 0.6 * m.u), rule);
        canvas.text(left - 6 * m.u, at(positions[i]) + 4 * m.u, labels.text[i], m.small(), faint, Weight::regular, Anchor::right);
    }
    const double step = (right - left) / static_cast<double>(bars.size()), half = std::min(0.28 * step, 34 * m.u);
    double size = m.small();
    for (const auto& bar : bars) size = std::min(size, fitting_size(bar.first, m.small(), step - 3 * m.u, 0.6));
    for (std::size_t i = 0; i < bars.size(); ++i) {
        const auto& [label, s] = bars[i];
        const double middle = left + (static_cast<double>(i) + 0.5) * step;
        const auto color = colors.at(std::clamp((s->mean - range[0]) / (range[1] - range[0]), 0.35, 0.75));
        canvas.fill(middle - half, at(s->mean), 2 * half, bottom - at(s->mean), color);
        const bool beyond = s->p99 > range[1];
        if (at(s->p99) < at(s->mean)) {
            canvas.line(middle, at(s->mean), middle, at(s->p99), 1.3 * m.u, ink);
            if (beyond) {
                const std::array<std::array<double, 2>, 3> head{{{middle - 4 * m.u, top + 7 * m.u}, {middle + 4 * m.u, top + 7 * m.u}, {middle, top}}};
                canvas.polygon(head, ink);
            } else {
                canvas.line(middle - 6 * m.u, at(s->p99), middle + 6 * m.u, at(s->p99), 1.3 * m.u, ink);
            }
        }
        canvas.text(middle, bottom + 15 * m.u, fitted(label, size, step - 3 * m.u), size, ink, Weight::regular, Anchor::center);
        canvas.text(middle, bottom + 30 * m.u, figure(s->mean), size, ink, Weight::bold, Anchor::center);
    }
    canvas.line(left, bottom, right, bottom, std::max(1.0, m.u), ink);
}

}  // namespace

int figure1_panel(int width, std::size_t methods) { return Measures(width, methods).panel; }

Result<Picture> draw_figure1(const GamutRendering& rendering, const Figure1Style& style) {
    const auto colors = find_color_map(style.colormap);
    if (!colors) return colors.error();
    const Measures m(style.width, rendering.methods.size());
    const int height = m.y(2) + m.panel + m.foot;
    auto canvas = Canvas::make(style.width, height);
    if (!canvas) return std::move(canvas).error();

    const auto heading = [&](std::size_t column, std::size_t row, const std::string& title, const std::string& below) {
        const double x = m.x(column), y = m.y(row);
        canvas->text(x, y - 23 * m.u, fitted(title, m.text(), m.panel, Weight::bold), m.text(), ink, Weight::bold);
        const double size = fitting_size(below, m.small(), m.panel);
        canvas->text(x, y - 8 * m.u, fitted(below, size, m.panel), size, faint);
    };
    const auto paste = [&](std::size_t column, std::size_t row, const Picture& picture) {
        canvas->paste(picture, m.x(column), m.y(row), m.panel, m.panel, Filter::box);
        canvas->frame(m.x(column), m.y(row), m.panel, m.panel, std::max(1.0, m.u), rule);
    };

    heading(0, 0, "Ground truth", grouped(rendering.texels) + " colours as albedo, in RGB");
    paste(0, 0, rendered(rendering.truth, rendering.panel));
    std::vector<std::pair<std::string, const DifferenceStatistics*>> noise, distortion;
    bool beyond = false;
    for (std::size_t i = 0; i < rendering.methods.size(); ++i) {
        const auto& method = rendering.methods[i];
        heading(i + 1, 0, method.method, method.title);
        heading(i + 1, 1, "Noise and imprecision", figures(method.noise));
        heading(i + 1, 2, "Colour distortion", figures(method.distortion));
        paste(i + 1, 0, rendered(method.rendering, rendering.panel));
        paste(i + 1, 1, mapped(method.noise_map, rendering.panel, *colors, style.range));
        paste(i + 1, 2, mapped(method.distortion_map, rendering.panel, *colors, style.range));
        noise.emplace_back(method.method, &method.noise);
        distortion.emplace_back(method.method, &method.distortion);
        beyond = beyond || method.noise.max > style.range[1] || method.distortion.max > style.range[1];
    }
    heading(0, 1, "Noise and imprecision", "against the same spectra, integrated");
    heading(0, 2, "Colour distortion", "integrated, against ground truth");
    const std::string unit = "ΔE*ab", whisker = "ΔE*ab: mean, whisker to p99";
    draw_bars(*canvas, m, m.x(0), m.y(1), noise, *colors, style.range, whisker);
    draw_bars(*canvas, m, m.x(0), m.y(2), distortion, *colors, style.range, whisker);

    Legend legend;
    legend.low = style.range[0], legend.high = style.range[1];
    legend.title = unit;
    legend.extend_high = beyond;
    auto scale = draw_legend(*colors, legend, m.y(2) + m.panel - m.y(1));
    if (!scale) return std::move(scale).error();
    const int legend_x = m.x(rendering.methods.size() + 1) - m.gap / 2;
    canvas->paste(*scale, legend_x, m.y(1));
    canvas->text(m.margin, height - 14 * m.u, fitted(style.caption, m.small(), style.width - 2 * m.margin), m.small(), faint);
    return canvas->picture();
}

}  // namespace spectex::app
