// Spectra as curves in an SVG document. Text stays text, groups have names, so that the figure can be edited.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>

#include "heatmap/text.h"
#include "spectex/color.h"
#include "spectex/heatmap.h"
#include "spectex/spectral.h"

namespace spectex {
namespace {

constexpr double limit = 1e300;
constexpr double page_width = 860, plot_height = 380;
constexpr double margin = 22, strip_height = 12;
constexpr double heading_px = 17, axis_title_px = 13.5, tick_label_px = 12.5, entry_px = 13;
constexpr std::size_t longest_title = 80, longest_axis_label = 48, longest_label = 64;
constexpr std::size_t most_description = 1000;
// Beyond, dots touch and hide the line; beyond half of that their white rims would cut it into dashes.
constexpr std::size_t most_markers = 120, most_rims = 60;

struct Range {
    double low = 0, high = 1;
};

Status check(const Curve& curve, std::size_t index) {
    const auto fail = [&](const std::string& what) {
        return Error{ErrorKind::usage, fmt::format("curve {} (\"{}\") {}", index + 1,
                                                   heatmap::elide(heatmap::clean_utf8(curve.label), longest_label), what)};
    };
    if (curve.wavelengths_nm.size() != curve.values.size())
        return fail(fmt::format("has {} wavelengths and {} values", curve.wavelengths_nm.size(), curve.values.size()));
    if (curve.values.empty()) return fail("is empty");
    for (std::size_t i = 0; i < curve.values.size(); ++i) {
        const double l = curve.wavelengths_nm[i];
        if (!(std::abs(l) <= limit) || (i > 0 && !(l > curve.wavelengths_nm[i - 1])))
            return fail(fmt::format("has the wavelength {} at entry {}, where finite ascending ones were expected", l, i));
        if (std::isfinite(curve.values[i]) && std::abs(curve.values[i]) > limit)
            return fail(fmt::format("has the value {} at {} nm, beyond 1e300", curve.values[i], l));
    }
    return {};
}

/// 0..1, or more where values ask for it; rounded outwards to whole ticks.
Range value_range(std::span<const Curve> curves) {
    double low = 0, high = 0;
    for (const auto& curve : curves)
        for (const double v : curve.values)
            if (std::isfinite(v)) {
                low = std::min(low, v);
                high = std::max(high, v);
            }
    Range range;
    // An overshoot below a thousandth of the axis is invisible; an axis of its own would only spoil the picture.
    const double reach = std::max(high, -low);
    const double slack = 1e-3 * (reach < 0.1 ? reach : std::max(reach, 1.0));
    if (high <= 1 + slack && reach >= 0.1)
        range.high = 1;
    else if (reach > 0)
        range.high = high > slack ? round_up_range(high) : 0;
    if (low < -slack) range.low = -round_up_range(-low);
    const auto positions = ticks(range.low, range.high);
    if (positions.size() >= 2 && range.low < 0) {
        const double step = positions[1] - positions[0];
        range.low = std::floor(range.low / step + 1e-9) * step;
        range.high = std::ceil(range.high / step - 1e-9) * step;
    }
    return range;
}

Range wavelength_range(std::span<const Curve> curves) {
    Range range{curves.front().wavelengths_nm.front(), curves.front().wavelengths_nm.back()};
    for (const auto& curve : curves) {
        range.low = std::min(range.low, curve.wavelengths_nm.front());
        range.high = std::max(range.high, curve.wavelengths_nm.back());
    }
    if (ticks(range.low, range.high).empty()) {
        // One wavelength, or several that no axis can tell apart.
        const double around = std::max(10.0, 0.01 * std::abs(range.low));
        range = {range.low - around, range.low + around};
    }
    return range;
}

/// Colours of the monochromatic lights at every `step` nm: desaturated towards equal RGB until none is negative, on one
/// scale for all, so that the ends fade as they do to the eye.
Result<std::vector<Rgb8>> spectrum_colors(std::span<const double> wavelengths_nm) {
    const auto observer = find_observer("cie1931");
    if (!observer) return observer.error();
    const auto space = find_rgb_space("BT.709");
    if (!space) return space.error();
    const Matrix3 from_xyz = rgb_to_xyz_matrix(*space, xyz_from_xy(space->white_xy[0], space->white_xy[1])).inverse();
    const Observer& cmf = **observer;
    const auto color_at = [&](double l) {
        const double position = l - cmf.start_nm;
        if (!(position >= 0) || position > static_cast<double>(cmf.x_bar.size() - 1)) return Vector3{};
        const auto i = std::min(static_cast<std::size_t>(position), cmf.x_bar.size() - 2);
        const double t = position - static_cast<double>(i);
        const auto mix = [&](const std::vector<double>& f) { return f[i] + t * (f[i + 1] - f[i]); };
        Vector3 rgb = from_xyz * Vector3{mix(cmf.x_bar), mix(cmf.y_bar), mix(cmf.z_bar)};
        const double least = std::min({0.0, rgb[0], rgb[1], rgb[2]});
        for (double& c : rgb) c -= least;
        return rgb;
    };
    double largest = 0;
    for (std::size_t i = 0; i < cmf.x_bar.size(); ++i) {
        const Vector3 rgb = color_at(cmf.start_nm + static_cast<double>(i));
        largest = std::max({largest, rgb[0], rgb[1], rgb[2]});
    }
    std::vector<Rgb8> colors;
    for (const double l : wavelengths_nm) {
        const Vector3 rgb = color_at(l);
        Rgb8 code{};
        for (std::size_t c = 0; c < 3; ++c)
            code[c] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(srgb_encode(rgb[c] / largest), 0.0, 1.0)));
        colors.push_back(code);
    }
    return colors;
}

bool has_markers(const Curve& curve) { return curve.markers && curve.values.size() <= most_markers; }

/// Escaped text with the notation's subscripts as tspans.
std::string marked_up(const std::string& clean, double size_px) {
    std::string out;
    const double drop = heatmap::subscript_drop * size_px;
    bool lowered = false;
    for (const auto& run : heatmap::split_runs(clean)) {
        if (run.subscript)
            out += fmt::format("<tspan dy=\"{:.2f}\" font-size=\"{:.2f}\">{}</tspan>", drop,
                               heatmap::subscript_scale * size_px, heatmap::escape_xml(run.text));
        else if (lowered)
            out += fmt::format("<tspan dy=\"{:.2f}\">{}</tspan>", -drop, heatmap::escape_xml(run.text));
        else
            out += heatmap::escape_xml(run.text);
        lowered = run.subscript;
    }
    return out;
}

struct Entry {
    std::string label;
    Rgb8 color;
    bool markers = false;
    double x = 0, row = 0;
};
constexpr double swatch = 24, swatch_gap = 7, entry_gap = 22, row_height = 21;

}  // namespace

Rgb8 curve_color(std::size_t i) {
    constexpr std::array<Rgb8, 8> colors{{{0, 0, 0},
                                          {0, 114, 178},
                                          {213, 94, 0},
                                          {0, 158, 115},
                                          {204, 121, 167},
                                          {230, 159, 0},
                                          {86, 180, 233},
                                          {128, 128, 128}}};
    return colors[i % colors.size()];
}

Result<std::string> plot_spectra_svg(std::span<const Curve> curves, std::string_view title, std::string_view y_label) {
    if (curves.empty()) return Error{ErrorKind::usage, "a plot needs at least one curve"};
    for (std::size_t i = 0; i < curves.size(); ++i)
        if (auto status = check(curves[i], i); !status) return status.error();

    const Range x_range = wavelength_range(curves), y_range = value_range(curves);
    const auto x_ticks = ticks(x_range.low, x_range.high), y_ticks = ticks(y_range.low, y_range.high);
    const auto x_labels = tick_labels(x_ticks), y_labels = tick_labels(y_ticks);

    const std::string full_title = heatmap::clean_utf8(title);
    const std::string heading = heatmap::elide(full_title, longest_title);
    const std::string y_title = heatmap::elide(heatmap::clean_utf8(y_label), longest_axis_label);

    double y_label_width = 0;
    for (const auto& text : y_labels.text) y_label_width = std::max(y_label_width, measure_text(text, tick_label_px).width);
    const double left = std::ceil(margin + (y_title.empty() ? 0 : axis_title_px + 12) + y_label_width + 9);
    const double right = page_width - margin - 8;

    std::vector<Entry> entries;
    double row = 0, x = left;
    for (const auto& curve : curves) {
        if (curve.label.empty()) continue;
        Entry entry{heatmap::elide(heatmap::clean_utf8(curve.label), longest_label), curve.color, has_markers(curve)};
        const double entry_width = swatch + swatch_gap + measure_text(entry.label, entry_px).width;
        if (x > left && x + entry_width > right) {
            row += 1;
            x = left;
        }
        entry.x = x;
        entry.row = row;
        x += entry_width + entry_gap;
        entries.push_back(std::move(entry));
    }

    double y = margin;
    double title_y = 0, legend_y = 0, multiplier_y = 0;
    // A wide title is set smaller rather than cut off.
    double title_size = heading_px;
    if (!heading.empty()) {
        const double natural = measure_text(heading, heading_px, Weight::bold).width;
        title_size = heading_px * std::min(1.0, (right - left) / natural);
        title_y = y + 0.75 * heading_px;
        y = title_y + 15;
    }
    if (!entries.empty()) {
        legend_y = y + row_height / 2;
        y += row_height * (row + 1) + 6;
    }
    if (!y_labels.multiplier.empty()) {
        multiplier_y = y + tick_label_px * 0.5 + (entries.empty() ? 0 : 6);
        y = multiplier_y + 6;
    }
    const double top = std::round(y + 6), bottom = top + plot_height, strip_bottom = bottom + strip_height;
    const double x_tick_y = strip_bottom + 5 + 0.95 * tick_label_px, x_title_y = x_tick_y + 24;
    const double height = std::ceil(x_title_y + margin * 0.7);
    const double plot_width = right - left;

    const auto px = [&](double nm) { return left + plot_width * ((nm - x_range.low) / (x_range.high - x_range.low)); };
    const auto py = [&](double v) { return bottom - plot_height * ((v - y_range.low) / (y_range.high - y_range.low)); };

    std::vector<double> stops_nm;
    constexpr int stops = 96;
    for (int i = 0; i <= stops; ++i)
        stops_nm.push_back(x_range.low + (x_range.high - x_range.low) * static_cast<double>(i) / stops);
    const auto colors = spectrum_colors(stops_nm);
    if (!colors) return colors.error();

    std::string svg;
    auto out = std::back_inserter(svg);
    fmt::format_to(out,
                   "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
                   "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0:.0f}\" height=\"{1:.0f}\" viewBox=\"0 0 {0:.0f} "
                   "{1:.0f}\" font-family=\"'DejaVu Sans', Verdana, 'Segoe UI', sans-serif\" fill=\"#222\" xml:space=\"preserve\">\n",
                   page_width, height);
    if (!full_title.empty())
        fmt::format_to(out, "<title>{}</title>\n", heatmap::escape_xml(heatmap::elide(full_title, most_description)));
    fmt::format_to(out, "<rect width=\"{:.0f}\" height=\"{:.0f}\" fill=\"#fff\"/>\n", page_width, height);

    // The range in the name keeps the gradients of several plots in one page apart.
    const std::string gradient = fmt::format("spectrum-{:.6g}-{:.6g}", x_range.low, x_range.high);
    fmt::format_to(out, "<defs><linearGradient id=\"{}\">", gradient);
    for (int i = 0; i <= stops; ++i)
        fmt::format_to(out, "<stop offset=\"{:.4f}\" stop-color=\"{}\"/>", static_cast<double>(i) / stops,
                       heatmap::hex((*colors)[static_cast<std::size_t>(i)]));
    fmt::format_to(out, "</linearGradient></defs>\n");

    if (!heading.empty())
        fmt::format_to(out, "<text id=\"title\" x=\"{:.2f}\" y=\"{:.2f}\" font-size=\"{:.2f}\" font-weight=\"bold\">{}</text>\n",
                       left, title_y, title_size, marked_up(heading, title_size));

    if (!entries.empty()) {
        fmt::format_to(out, "<g id=\"legend\" font-size=\"{:.2f}\">\n", entry_px);
        for (const auto& entry : entries) {
            const double ey = legend_y + entry.row * row_height;
            fmt::format_to(out,
                           "<path d=\"M{:.2f} {:.2f}h{:.2f}\" stroke=\"{}\" stroke-width=\"2.4\" "
                           "stroke-linecap=\"round\"/>",
                           entry.x, ey, swatch, heatmap::hex(entry.color));
            if (entry.markers)
                fmt::format_to(out, "<circle cx=\"{:.2f}\" cy=\"{:.2f}\" r=\"3.2\" fill=\"{}\" stroke=\"#fff\"/>",
                               entry.x + swatch / 2, ey, heatmap::hex(entry.color));
            fmt::format_to(out, "<text x=\"{:.2f}\" y=\"{:.2f}\">{}</text>\n", entry.x + swatch + swatch_gap,
                           ey + 0.365 * entry_px, marked_up(entry.label, entry_px));
        }
        fmt::format_to(out, "</g>\n");
    }

    fmt::format_to(out, "<g id=\"grid\" stroke=\"#e3e3e3\" fill=\"none\">\n");
    for (const double t : x_ticks) fmt::format_to(out, "<path d=\"M{:.2f} {:.2f}V{:.2f}\"/>", px(t), top, bottom);
    for (const double t : y_ticks) fmt::format_to(out, "<path d=\"M{:.2f} {:.2f}H{:.2f}\"/>", left, py(t), right);
    if (y_range.low < 0 && y_range.high > 0)
        fmt::format_to(out, "<path id=\"zero\" d=\"M{:.2f} {:.2f}H{:.2f}\" stroke=\"#999\"/>", left, py(0), right);
    fmt::format_to(out, "\n</g>\n");

    fmt::format_to(out,
                   "<rect id=\"spectrum\" x=\"{:.2f}\" y=\"{:.2f}\" width=\"{:.2f}\" height=\"{:.2f}\" fill=\"url(#{})\"/>\n",
                   left, bottom, plot_width, strip_height, gradient);

    fmt::format_to(out, "<g id=\"axes\" font-size=\"{:.2f}\">\n<path d=\"M{:.2f} {:.2f}V{:.2f}H{:.2f}\" fill=\"none\" "
                        "stroke=\"#444\"/>\n<g text-anchor=\"middle\">",
                   tick_label_px, left, top, bottom, right);
    for (std::size_t i = 0; i < x_ticks.size(); ++i)
        fmt::format_to(out, "<path d=\"M{0:.2f} {1:.2f}v4\" stroke=\"#444\"/><text x=\"{0:.2f}\" y=\"{2:.2f}\">{3}</text>",
                       px(x_ticks[i]), strip_bottom, x_tick_y, x_labels.text[i]);
    fmt::format_to(out, "</g>\n<g text-anchor=\"end\">");
    for (std::size_t i = 0; i < y_ticks.size(); ++i)
        fmt::format_to(out, "<path d=\"M{:.2f} {:.2f}h-4\" stroke=\"#444\"/><text x=\"{:.2f}\" y=\"{:.2f}\">{}</text>", left,
                       py(y_ticks[i]), left - 8, py(y_ticks[i]) + 0.365 * tick_label_px, y_labels.text[i]);
    fmt::format_to(out, "</g>\n");
    if (!y_labels.multiplier.empty())
        fmt::format_to(out, "<text x=\"{:.2f}\" y=\"{:.2f}\">{}</text>\n", left, multiplier_y, y_labels.multiplier);
    fmt::format_to(out, "<text x=\"{:.2f}\" y=\"{:.2f}\" font-size=\"{:.2f}\" text-anchor=\"middle\">Wavelength{} [nm]</text>\n",
                   (left + right) / 2, x_title_y, axis_title_px, x_labels.multiplier.empty() ? "" : " " + x_labels.multiplier);
    if (!y_title.empty()) {
        const double natural = measure_text(y_title, axis_title_px).width;
        const double size = axis_title_px * std::min(1.0, plot_height / natural);
        const double tx = margin + 0.5 * axis_title_px, ty = (top + bottom) / 2;
        fmt::format_to(out, "<text transform=\"translate({:.2f} {:.2f}) rotate(-90)\" font-size=\"{:.2f}\" "
                            "text-anchor=\"middle\">{}</text>\n",
                       tx, ty, size, marked_up(y_title, size));
    }
    fmt::format_to(out, "</g>\n");

    fmt::format_to(out, "<g id=\"curves\" fill=\"none\" stroke-width=\"2\" stroke-linejoin=\"round\" stroke-linecap=\"round\">\n");
    for (const auto& curve : curves) {
        std::string path, dots;
        const std::size_t n = curve.values.size();
        const auto drawn = [&](std::size_t i) { return i < n && std::isfinite(curve.values[i]); };
        const bool markers = has_markers(curve), rims = n <= most_rims;
        const double radius = rims ? 3.2 : 2.2;
        for (std::size_t i = 0; i < n; ++i) {
            if (!drawn(i)) continue;
            const bool starts = i == 0 || !drawn(i - 1);
            const double cx = px(curve.wavelengths_nm[i]), cy = py(curve.values[i]);
            fmt::format_to(std::back_inserter(path), "{}{:.2f} {:.2f}", starts ? "M" : "L", cx, cy);
            if (markers || (starts && !drawn(i + 1)))
                fmt::format_to(std::back_inserter(dots), "<circle cx=\"{:.2f}\" cy=\"{:.2f}\" r=\"{:.2f}\"/>", cx, cy, radius);
        }
        if (!path.empty()) fmt::format_to(out, "<path d=\"{}\" stroke=\"{}\"/>\n", path, heatmap::hex(curve.color));
        if (!dots.empty())
            fmt::format_to(out, "<g fill=\"{}\" stroke=\"#fff\" stroke-width=\"{:.2f}\">{}</g>\n", heatmap::hex(curve.color),
                           rims ? 1.0 : 0.0, dots);
    }
    fmt::format_to(out, "</g>\n</svg>\n");
    return svg;
}

}  // namespace spectex
