// The colour bar of a heatmap. Lengths follow from the text size, so that the bar looks alike beside a map of any height.
#include <algorithm>
#include <cmath>

#include "heatmap/text.h"
#include "spectex/heatmap.h"

namespace spectex {
namespace {

constexpr int smallest_map = 192;
// Above this the bar is drawn smaller and enlarged: Cairo's surfaces end at 32767 pixels.
constexpr int tallest_drawn = 16384;
constexpr double smallest_text = 11;
constexpr std::size_t longest_line = 64;
constexpr Rgb8 dark_ink{34, 34, 34}, quiet_ink{85, 85, 85}, outline{64, 64, 64};

struct NoteLine {
    std::string name, value;  ///< without a value the name has the whole line
    bool columns = false;
};

NoteLine note_line(const std::string& note) {
    const std::size_t tab = note.find('\t');
    if (tab == std::string::npos) return {heatmap::elide(heatmap::clean_utf8(note), longest_line), {}, false};
    const std::string_view view = note;
    return {heatmap::elide(heatmap::clean_utf8(view.substr(0, tab)), longest_line / 2),
            heatmap::elide(heatmap::clean_utf8(view.substr(tab + 1)), longest_line / 2), true};
}

}  // namespace

int minimum_map_height() { return smallest_map; }

double legend_text_size(int map_height) { return std::max(smallest_text, map_height / 48.0); }

Result<Picture> draw_legend(const ColorMap& map, const Legend& legend, int map_height) {
    if (map_height < smallest_map)
        return Error{ErrorKind::usage, "a legend beside a map of " + std::to_string(map_height) +
                                           " rows would not be readable: " + std::to_string(smallest_map) +
                                           " are the least"};
    if (map_height > tallest_drawn) {
        const int factor = (map_height + tallest_drawn - 1) / tallest_drawn;
        auto small = draw_legend(map, legend, map_height / factor);
        if (!small) return small;
        return resize(*small, small->width * factor, map_height, Filter::nearest);
    }
    const auto positions = ticks(legend.low, legend.high);
    if (positions.empty())
        return Error{ErrorKind::usage, "a legend from " + std::to_string(legend.low) + " to " +
                                           std::to_string(legend.high) + " has no room for ticks: finite ascending "
                                           "ends were expected"};
    const auto labels = tick_labels(positions);

    const double em = legend_text_size(map_height);
    const double note_em = std::max(smallest_text, 0.85 * em);
    const double margin = std::round(1.1 * em);
    const double bar_width = std::round(1.5 * em), tick = std::round(0.4 * em), label_gap = std::round(0.35 * em);
    const double rule = std::max(1.0, std::round(em / 14));
    const double point = std::round(0.75 * bar_width);

    const std::string title = heatmap::elide(heatmap::clean_utf8(legend.title), longest_line);
    std::vector<NoteLine> notes;
    for (const auto& note : legend.notes) notes.push_back(note_line(note));

    double label_width = 0;
    for (const auto& text : labels.text) label_width = std::max(label_width, measure_text(text, em).width);
    const double label_left = bar_width + tick + label_gap, label_right = label_left + label_width;
    const double multiplier_right = label_left + measure_text(labels.multiplier, note_em).width;
    double name_width = 0, value_width = 0, line_width = measure_text(title, em, Weight::bold).width;
    for (const auto& note : notes) {
        const double width = measure_text(note.name, note_em).width;
        if (note.columns) {
            name_width = std::max(name_width, width);
            value_width = std::max(value_width, measure_text(note.value, note_em).width);
        } else {
            line_width = std::max(line_width, width);
        }
    }
    const double column_gap = name_width > 0 ? note_em : 0;
    const std::string_view no_value = "no value";
    const double key_width = legend.no_value ? label_left + measure_text(no_value, note_em).width : 0;
    const double content = std::max({label_right, multiplier_right, line_width, name_width + column_gap + value_width, key_width});
    const int width = static_cast<int>(std::ceil(content + 2 * margin));

    double top = margin;
    double title_baseline = 0, multiplier_baseline = 0;
    if (!title.empty()) {
        title_baseline = top + std::round(0.8 * em);
        top = title_baseline + std::round(0.95 * em);
    }
    if (!labels.multiplier.empty()) {
        multiplier_baseline = top + std::round(0.6 * note_em);
        top = multiplier_baseline + std::round(0.6 * em);
    }
    // Half a line for the label at the bar's very end.
    top += legend.extend_high ? point : std::round(0.4 * em);
    double bottom = map_height - margin;
    const double note_pitch = std::round(1.4 * note_em);
    double note_baseline = 0, key_top = 0;
    if (!notes.empty()) {
        note_baseline = std::round(bottom - 0.1 * note_em - note_pitch * (static_cast<double>(notes.size()) - 1));
        bottom = note_baseline - std::round(1.5 * note_em);
    }
    const double key_height = std::round(0.9 * note_em);
    if (legend.no_value) {
        key_top = bottom - key_height;
        bottom = key_top - std::round(0.7 * note_em);
    }
    bottom -= legend.extend_low ? point : std::round(0.4 * em);
    const double bar_height = bottom - top;
    if (bar_height < 4 * em)
        return Error{ErrorKind::usage, "a legend of " + std::to_string(map_height) + " rows has no room for its bar below " +
                                           std::to_string(notes.size()) + " notes"};

    auto canvas = Canvas::make(width, map_height);
    if (!canvas) return canvas.error();
    const double left = margin;
    if (!title.empty()) canvas->text(left, title_baseline, title, em, dark_ink, Weight::bold);

    // The bar with its pointed ends, `outset` pixels larger on every side: drawn once as the outline, once as what it holds.
    const double slope = std::hypot(bar_width / 2, point) / (bar_width / 2);  // rise of a point's tip per pixel of outset
    const auto point_end = [&](double base, double direction, double outset, Rgb8 color) {
        // The shoulder moves along the base as the slanting side moves out.
        const double side = bar_width / 2 + outset * slope * (bar_width / 2) / point;
        const double center = left + bar_width / 2;
        const std::array<std::array<double, 2>, 3> corners{
            {{center - side, base}, {center, base + direction * (point + outset * slope)}, {center + side, base}}};
        canvas->polygon(corners, color);
    };
    if (legend.extend_high) point_end(top, -1, rule, outline);
    if (legend.extend_low) point_end(bottom, 1, rule, outline);
    canvas->frame(left, top, bar_width, bar_height, rule, outline);
    if (legend.extend_high) point_end(top, -1, 0, map.at(1));
    if (legend.extend_low) point_end(bottom, 1, 0, map.at(0));
    for (int y = 0; y < static_cast<int>(bar_height); ++y)
        canvas->fill(left, bottom - y - 1, bar_width, 1, map.at((y + 0.5) / bar_height));

    // Every tick has its mark. Where labels would touch, those of both ends and of zero come first.
    const double pitch = bar_height * (positions[1] - positions[0]) / (legend.high - legend.low);
    const double apart = 1.15 * em / pitch;  // in ticks
    std::vector<std::size_t> order{positions.size() - 1, 0};
    if (const auto zero = std::find(positions.begin(), positions.end(), 0.0); zero != positions.end())
        order.push_back(static_cast<std::size_t>(zero - positions.begin()));
    const std::size_t stride = static_cast<std::size_t>(std::ceil(apart));
    for (std::size_t i = order.back() % stride; i < positions.size(); i += stride) order.push_back(i);
    std::vector<bool> labelled(positions.size());
    for (const std::size_t i : order) {
        bool free = true;
        for (std::size_t j = 0; j < positions.size(); ++j)
            if (labelled[j] && std::abs(static_cast<double>(i) - static_cast<double>(j)) < apart) free = false;
        if (free) labelled[i] = true;
    }
    for (std::size_t i = 0; i < positions.size(); ++i) {
        const double t = (positions[i] - legend.low) / (legend.high - legend.low);
        // Whole pixels, as a blurred mark is hard to place; the marks at the ends continue the frame.
        const double y = std::round(bottom - t * bar_height);
        const double mark = t == 0 ? y : t == 1 ? y - rule : y - std::ceil(rule / 2);
        canvas->fill(left + bar_width + rule, mark, tick - rule, rule, outline);
        // Digits of DejaVu Sans are 0.729 em high.
        if (labelled[i])
            canvas->text(left + label_right, y + 0.365 * em, labels.text[i], em, dark_ink, Weight::regular, Anchor::right);
    }
    if (!labels.multiplier.empty())
        canvas->text(left + label_left, multiplier_baseline, labels.multiplier, note_em, dark_ink);
    if (legend.no_value) {
        canvas->frame(left, key_top, bar_width, key_height, rule, outline);
        canvas->fill(left, key_top, bar_width, key_height, ColorMap::no_value);
        canvas->text(left + label_left, key_top + key_height / 2 + 0.28 * note_em, no_value, note_em, dark_ink);
    }
    for (std::size_t i = 0; i < notes.size(); ++i) {
        const double y = note_baseline + note_pitch * static_cast<double>(i);
        canvas->text(left, y, notes[i].name, note_em, quiet_ink);
        if (notes[i].columns)
            canvas->text(left + name_width + column_gap, y, notes[i].value, note_em, quiet_ink);
    }
    return canvas->picture();
}

}  // namespace spectex
