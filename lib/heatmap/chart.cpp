// Charts on logarithmic axes: laid out once as marks, which become SVG or pixels.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>
#include <variant>

#include "heatmap/text.h"
#include "spectex/heatmap.h"

namespace spectex {
namespace {

constexpr double width = 1200, height = 800;
constexpr double left = 92, right = 1168, top = 112, bottom = 716;
constexpr double title_px = 20, axis_px = 15, tick_px = 13.5, label_px = 12.5, legend_px = 14;
constexpr double dot = 4.5, gap = 4;
constexpr std::size_t longest = 64;
constexpr Rgb8 black{0, 0, 0}, ink{60, 60, 60}, grid{226, 226, 226}, faint{150, 150, 150}, front_color{0, 0, 0};

struct Line {
    double x0, y0, x1, y1, thickness;
    Rgb8 color;
};
struct Dot {
    double x, y;
    Rgb8 color;
};
struct Text {
    double x, y;
    std::string text;  // clean
    double size;
    Rgb8 color;
    Weight weight;
    Anchor anchor;
};
using Mark = std::variant<Line, Dot, Text>;

struct Box {
    double x0, y0, x1, y1;
    bool overlaps(const Box& o) const { return x0 < o.x1 && o.x0 < x1 && y0 < o.y1 && o.y0 < y1; }
};

std::string clean(const std::string& text) { return heatmap::elide(heatmap::clean_utf8(text), longest); }

/// A logarithmic axis from a power of ten or a half of one to another.
struct LogAxis {
    double low = 0, high = 1;  // log10
    double from = 0, to = 1;   // units
    double at(double value) const { return from + (std::log10(value) - low) / (high - low) * (to - from); }
};

LogAxis axis(double least, double greatest, double from, double to) {
    double low = std::floor(std::log10(least) * 2 - 1e-9) / 2, high = std::ceil(std::log10(greatest) * 2 + 1e-9) / 2;
    if (high - low < 1) low -= 0.5, high += 0.5;
    return {low, high, from, to};
}

std::string power_label(int exponent) {
    if (exponent < -3 || exponent > 4) return "10" + heatmap::superscript(exponent);
    return fmt::format("{:g}", std::pow(10.0, exponent));
}

/// The decades within an axis, and every so many of them a label.
std::vector<int> decades(const LogAxis& a) {
    std::vector<int> out;
    for (int k = static_cast<int>(std::ceil(a.low - 1e-9)); k <= static_cast<int>(std::floor(a.high + 1e-9)); ++k) out.push_back(k);
    return out;
}

Status check(const Chart& chart) {
    bool any = false;
    for (const auto& s : chart.series)
        for (const auto& p : s.points) {
            any = true;
            const bool y_fits = std::isfinite(p.y) && (p.y > 0 || (p.y == 0 && chart.least_y > 0));
            if (!(std::isfinite(p.x) && p.x > 0 && y_fits))
                return Error{ErrorKind::usage, fmt::format("chart: the point '{}' at {}, {} has no place on logarithmic axes",
                                                           clean(p.label), p.x, p.y)};
        }
    if (!any) return Error{ErrorKind::usage, "chart: expected at least one point"};
    return {};
}

std::vector<Mark> lay_out(const Chart& chart) {
    std::vector<Mark> marks;
    double x_least = INFINITY, x_most = 0, y_least = INFINITY, y_most = 0;
    bool clamped = false;
    for (const auto& s : chart.series)
        for (const auto& p : s.points) {
            const double y = std::max(p.y, chart.least_y);
            clamped |= p.y < chart.least_y;
            x_least = std::min(x_least, p.x), x_most = std::max(x_most, p.x);
            y_least = std::min(y_least, y), y_most = std::max(y_most, y);
        }
    const LogAxis ax = axis(x_least, x_most, left, right), ay = axis(y_least, y_most, bottom, top);
    const auto place = [&](double x, double y) {
        return std::array<double, 2>{ax.at(x), std::min(ay.at(std::max({y, chart.least_y, 1e-300})), bottom)};
    };

    const std::string title = clean(chart.title), x_title = clean(chart.x_label), y_title = clean(chart.y_label);
    marks.push_back(Text{left, 34, title, title_px, black, Weight::bold, Anchor::left});
    double legend_x = left;
    for (const auto& s : chart.series) {
        if (s.label.empty()) continue;
        const auto label = clean(s.label);
        marks.push_back(Dot{legend_x + dot, 58, s.color});
        marks.push_back(Text{legend_x + 2 * dot + 6, 58 + 0.36 * legend_px, label, legend_px, ink, Weight::regular, Anchor::left});
        legend_x += 2 * dot + 6 + measure_text(label, legend_px).width + 22;
    }
    marks.push_back(Text{left, top - 16, y_title, axis_px, ink, Weight::regular, Anchor::left});
    marks.push_back(Text{(left + right) / 2, bottom + 56, x_title, axis_px, ink, Weight::regular, Anchor::center});
    const auto x_decades = decades(ax), y_decades = decades(ay);
    for (const auto* side : {&x_decades, &y_decades}) {
        const bool is_x = side == &x_decades;
        const LogAxis& a = is_x ? ax : ay;
        // Few decades need the numbers in between.
        const bool fine = side->size() < 4;
        const std::size_t every = std::max<std::size_t>((side->size() + 9) / 10, 1);
        for (int k = static_cast<int>(std::floor(a.low)); k <= static_cast<int>(std::ceil(a.high)); ++k)
            for (const int m : {1, 2, 5}) {
                if (m != 1 && !fine) continue;
                const double value = m * std::pow(10.0, k), logged = std::log10(value);
                if (logged < a.low - 1e-9 || logged > a.high + 1e-9) continue;
                const double at = a.at(value);
                if (is_x)
                    marks.push_back(Line{at, top, at, bottom, m == 1 ? 1.0 : 0.6, grid});
                else
                    marks.push_back(Line{left, at, right, at, m == 1 ? 1.0 : 0.6, grid});
                if (m == 1 && std::abs(k - side->front()) % static_cast<int>(every) != 0) continue;
                std::string label = m == 1 || k < -3 || k > 4 ? power_label(k) : fmt::format("{:g}", value);
                if (m != 1 && (k < -3 || k > 4)) continue;
                if (!is_x && clamped && std::abs(logged - std::log10(chart.least_y)) < 1e-9) label = "≤ " + label;
                if (is_x)
                    marks.push_back(Text{at, bottom + 24, label, tick_px, ink, Weight::regular, Anchor::center});
                else
                    marks.push_back(Text{left - 10, at + 0.36 * tick_px, label, tick_px, ink, Weight::regular, Anchor::right});
            }
    }
    marks.push_back(Line{left, top, left, bottom, 1.2, ink});
    marks.push_back(Line{left, bottom, right, bottom, 1.2, ink});

    std::vector<Box> taken;
    for (std::size_t i = 0; i < chart.front.size(); ++i) {
        const auto p = place(chart.front[i][0], chart.front[i][1]);
        const double from_y = i == 0 ? top : place(chart.front[i - 1][0], chart.front[i - 1][1])[1];
        const double to_x = i + 1 < chart.front.size() ? place(chart.front[i + 1][0], chart.front[i + 1][1])[0] : right;
        marks.push_back(Line{p[0], from_y, p[0], p[1], 1.6, front_color});
        marks.push_back(Line{p[0], p[1], to_x, p[1], 1.6, front_color});
        taken.push_back({p[0] - 1, from_y, p[0] + 1, p[1]});
        taken.push_back({p[0], p[1] - 1, to_x, p[1] + 1});
    }

    for (const auto& s : chart.series)
        for (std::size_t i = 0; i < s.points.size(); ++i) {
            const auto p = place(s.points[i].x, s.points[i].y);
            taken.push_back({p[0] - dot, p[1] - dot, p[0] + dot, p[1] + dot});
            if (s.joined && i > 0) {
                const auto q = place(s.points[i - 1].x, s.points[i - 1].y);
                marks.push_back(Line{q[0], q[1], p[0], p[1], 1.6, s.color});
            }
        }
    std::vector<Mark> dots, labels;
    for (const auto& s : chart.series)
        for (const auto& point : s.points) {
            const auto p = place(point.x, point.y);
            dots.push_back(Dot{p[0], p[1], s.color});
            const auto label = clean(point.label);
            if (label.empty()) continue;
            const auto extents = measure_text(label, label_px);
            const double w = extents.width, h = 0.95 * label_px;
            // Around the point, then further out; the first free place is the nearest.
            for (double reach = dot + gap; reach < 240; reach += reach < 20 ? 12 : 9) {
                bool placed = false;
                for (int k = 0; k < 16 && !placed; ++k) {
                    static constexpr std::array<int, 16> order{0, 8, 4, 12, 2, 14, 6, 10, 1, 15, 3, 13, 5, 11, 7, 9};
                    const double angle = order[static_cast<std::size_t>(k)] * std::numbers::pi / 8;
                    const double cx = p[0] + std::cos(angle) * (reach + w / 2 * std::abs(std::cos(angle)));
                    const double cy = p[1] - std::sin(angle) * (reach + h / 2);
                    const double x0 = std::cos(angle) > 0.3 ? p[0] + std::cos(angle) * reach : std::cos(angle) < -0.3 ? p[0] + std::cos(angle) * reach - w : cx - w / 2;
                    const Box box{x0 - 2, cy - h / 2 - 1, x0 + w + 2, cy + h / 2 + 1};
                    if (box.x0 < left + 3 || box.x1 > right + 2 || box.y0 < top - 8 || box.y1 > bottom - 3) continue;
                    if (std::any_of(taken.begin(), taken.end(), [&](const Box& o) { return box.overlaps(o); })) continue;
                    taken.push_back(box);
                    if (reach > 2 * (dot + gap))
                        labels.push_back(Line{p[0], p[1], std::clamp(p[0], box.x0 + 2, box.x1 - 2), std::clamp(p[1], box.y0, box.y1), 0.7, faint});
                    labels.push_back(Text{x0, cy + 0.36 * label_px, label, label_px, s.color, Weight::regular, Anchor::left});
                    placed = true;
                }
                if (placed) break;
            }
        }
    marks.insert(marks.end(), labels.begin(), labels.end());
    marks.insert(marks.end(), dots.begin(), dots.end());
    return marks;
}

}  // namespace

Result<std::string> draw_chart_svg(const Chart& chart) {
    if (auto valid = check(chart); !valid) return valid.error();
    std::string svg;
    const auto out = std::back_inserter(svg);
    fmt::format_to(out,
                   "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0}\" height=\"{1}\" "
                   "viewBox=\"0 0 {0} {1}\" font-family=\"{2}, sans-serif\">\n<title>{3}</title>\n"
                   "<rect width=\"{0}\" height=\"{1}\" fill=\"#fff\"/>\n",
                   width, height, heatmap::font_family, heatmap::escape_xml(clean(chart.title)));
    for (const auto& mark : lay_out(chart)) {
        if (const auto* line = std::get_if<Line>(&mark)) {
            fmt::format_to(out, "<path d=\"M{:.2f} {:.2f}L{:.2f} {:.2f}\" stroke=\"{}\" stroke-width=\"{:.2f}\"/>\n", line->x0, line->y0,
                           line->x1, line->y1, heatmap::hex(line->color), line->thickness);
        } else if (const auto* point = std::get_if<Dot>(&mark)) {
            fmt::format_to(out, "<circle cx=\"{:.2f}\" cy=\"{:.2f}\" r=\"{:.2f}\" fill=\"{}\" stroke=\"#fff\"/>\n", point->x, point->y, dot,
                           heatmap::hex(point->color));
        } else if (const auto* text = std::get_if<Text>(&mark)) {
            const char* anchor = text->anchor == Anchor::left ? "start" : text->anchor == Anchor::center ? "middle" : "end";
            fmt::format_to(out, "<text x=\"{:.2f}\" y=\"{:.2f}\" font-size=\"{:.2f}\" fill=\"{}\" text-anchor=\"{}\"{}>{}</text>\n", text->x,
                           text->y, text->size, heatmap::hex(text->color), anchor, text->weight == Weight::bold ? " font-weight=\"bold\"" : "",
                           heatmap::escape_xml(text->text));
        }
    }
    svg += "</svg>\n";
    return svg;
}

Result<Picture> draw_chart(const Chart& chart, double scale) {
    if (!(scale >= 0.25 && scale <= 8)) return Error{ErrorKind::usage, fmt::format("chart: expected a scale of 0.25 to 8, got {}", scale)};
    if (auto valid = check(chart); !valid) return valid.error();
    auto canvas = Canvas::make(static_cast<int>(std::lround(width * scale)), static_cast<int>(std::lround(height * scale)));
    if (!canvas) return std::move(canvas).error();
    const auto disc = [&](double x, double y, double r, Rgb8 color) {
        std::array<std::array<double, 2>, 32> points;
        for (std::size_t i = 0; i < points.size(); ++i) {
            const double a = 2 * std::numbers::pi * static_cast<double>(i) / static_cast<double>(points.size());
            points[i] = {(x + r * std::cos(a)) * scale, (y + r * std::sin(a)) * scale};
        }
        canvas->polygon(points, color);
    };
    for (const auto& mark : lay_out(chart)) {
        if (const auto* line = std::get_if<Line>(&mark)) {
            canvas->line(line->x0 * scale, line->y0 * scale, line->x1 * scale, line->y1 * scale, line->thickness * scale, line->color);
        } else if (const auto* point = std::get_if<Dot>(&mark)) {
            disc(point->x, point->y, dot + 1, {255, 255, 255});
            disc(point->x, point->y, dot, point->color);
        } else if (const auto* text = std::get_if<Text>(&mark)) {
            canvas->text(text->x * scale, text->y * scale, text->text, text->size * scale, text->color, text->weight, text->anchor);
        }
    }
    return canvas->picture();
}

}  // namespace spectex
