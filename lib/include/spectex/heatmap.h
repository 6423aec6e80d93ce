// Pictures for people: false-colour error maps with a legend, sheets of panels with captions, and spectra as curves.
//
// Pictures hold 8-bit sRGB. Text is UTF-8, drawn by Cairo in DejaVu Sans (or the nearest sans serif) as unhinted grey
// outlines, so that the same text gives the same pixels at any position. Invalid UTF-8 becomes U+FFFD, control characters
// become spaces, and text beyond the stated length ends in an ellipsis; none of these is an error. The notation "E*ab" and
// Unicode's subscript digits are set as subscripts. Nothing here keeps state: every function may be called from any thread.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"

namespace spectex {

/// Text from outside made safe to show: control characters and bytes that are not UTF-8 become \n, \t, \xNN.
SPECTEX_API std::string printable(std::string_view text);

/// An 8-bit sRGB colour.
using Rgb8 = std::array<std::uint8_t, 3>;

/// A colour map as 256 sRGB triples, taken from OpenImageIO's color_map: magma, inferno, plasma, viridis, turbo, ...
struct ColorMap {
    std::string name;
    std::array<Rgb8, 256> codes{};
    /// Position t in [0,1] by nearest entry, clamped beyond; NaN gives the "no value" colour.
    Rgb8 at(double t) const {
        if (t != t) return no_value;
        // Half a step up and cut off: to the nearest, for what is not negative.
        return codes[static_cast<std::size_t>((t < 0 ? 0 : t > 1 ? 1 : t) * 255 + 0.5)];
    }
    static constexpr Rgb8 no_value{128, 128, 128};
};
/// @error usage, listing the names.
SPECTEX_API Result<ColorMap> find_color_map(std::string_view name);
/// Every name, the default first.
SPECTEX_API std::vector<std::string> color_map_names();
/// magma: its lightness rises strictly from black (no error) to a pale yellow, also for colour-blind readers and in grey.
SPECTEX_API std::string_view default_color_map();

/// Range and labels of a heatmap's legend.
struct Legend {
    double low = 0, high = 1;
    std::string title;       ///< "CIE76 ΔE*ab"; up to 64 characters
    /// Small lines below: "mean 0.02  p99 0.1  max 0.3". A tab sets what is left and right of it in two columns:
    /// "mean\t0.02". Up to 64 characters each.
    std::vector<std::string> notes;
    bool extend_low = false;   ///< values below `low` exist: the bar ends in a point
    bool extend_high = false;  ///< values above `high` exist
    bool no_value = false;     ///< the map has pixels without a value: their grey gets a key
};
/// The smallest of 1, 1.5, 2, 2.5, 3, 4, 5, 6, 8 x 10^k that is >= value; 1e-6 at the least (so an all-zero map has a range)
/// and for NaN; 1.5e308 at the most.
SPECTEX_API double round_up_range(double value);
/// Tick positions for a legend or axis: 4 to 8 multiples of 1, 2, 2.5 or 5 x 10^k inside [low, high], ascending, each the
/// double nearest its decimal; steps that put a tick on both ends are preferred.
/// Empty when low and high are not finite, not ascending, beyond 1e300, or closer than 1e-12 of the larger magnitude.
SPECTEX_API std::vector<double> ticks(double low, double high);

/// Labels of ticks with one number of decimals, U+2212 as the minus sign, and a common power of ten when plain decimals
/// would be hard to read.
struct TickLabels {
    std::vector<std::string> text;
    int exponent = 0;        ///< the labels are in units of 10^exponent
    std::string multiplier;  ///< "×10⁻⁵", or empty when the exponent is 0
};
/// @param positions  as ticks() gives them.
SPECTEX_API TickLabels tick_labels(std::span<const double> positions);

/// Pixels of 8-bit sRGB, [height][width][3].
struct Picture {
    int width = 0, height = 0;
    std::vector<std::uint8_t> rgb;
};
/// The legend bar beside a map of the given pixel height, as its own picture, as wide as its text needs; text stays
/// readable: never below 11 px, and growing with the map.
/// Four notes (two beside extended ends, the key and a power of ten) fit at any allowed height.
/// @error usage, when the height is below minimum_map_height(), when ticks() has none for the range, or when the notes leave
/// too little room for the bar.
SPECTEX_API Result<Picture> draw_legend(const ColorMap& map, const Legend& legend, int map_height);
/// Smallest height at which a map with a legend is drawn; smaller maps are enlarged by whole factors.
SPECTEX_API int minimum_map_height();
/// Height in pixels of the text of a legend beside a map of that height; captions of the map look best in the same size.
SPECTEX_API double legend_text_size(int map_height);

/// How a picture is brought to another size.
enum class Filter {
    nearest,  ///< codes stay as they are
    box,      ///< mean over each new pixel's area, in linear light
};
/// A picture at another size. @error usage, unless both sizes are 1 to 65535 and the picture's buffer fits its size.
SPECTEX_API Result<Picture> resize(const Picture& picture, int width, int height, Filter filter);

enum class Anchor { left, center, right };
enum class Weight { regular, bold };

/// Extents of a line of text in pixels.
struct TextExtents {
    double width = 0;
    double ascent = 0, descent = 0;  ///< of the font, so that lines of any letters share a baseline distance
};
SPECTEX_API TextExtents measure_text(std::string_view text, double size_px, Weight weight = Weight::regular);

/// A sheet on which panels, captions and rules are put together. Coordinates are pixels from the top left corner; what
/// falls outside is cut off. A failed call (bad sizes, out of memory) is kept and reported by picture().
class SPECTEX_API Canvas {
public:
    /// @error usage, unless both sizes are 1 to 32767.
    static Result<Canvas> make(int width, int height, Rgb8 background = {255, 255, 255});
    ~Canvas();
    Canvas(Canvas&&) noexcept;
    Canvas& operator=(Canvas&&) noexcept;

    int width() const;
    int height() const;
    void fill(double x, double y, double w, double h, Rgb8 color);
    void polygon(std::span<const std::array<double, 2>> points, Rgb8 color);
    /// A frame of the given thickness just outside the rectangle.
    void frame(double x, double y, double w, double h, double thickness, Rgb8 color);
    void line(double x0, double y0, double x1, double y1, double thickness, Rgb8 color);
    /// The picture resized to w x h with its corner at x, y.
    void paste(const Picture& picture, int x, int y, int w, int h, Filter filter);
    void paste(const Picture& picture, int x, int y);
    /// One line with its baseline at y; x is its left end, middle or right end. Up to 256 characters.
    void text(double x, double y, std::string_view text, double size_px, Rgb8 color = {0, 0, 0},
              Weight weight = Weight::regular, Anchor anchor = Anchor::left);
    /// What has been drawn. @error output, with what went wrong first.
    Result<Picture> picture() const;

private:
    struct State;
    explicit Canvas(std::unique_ptr<State> state);
    std::unique_ptr<State> state_;
};

/// One curve of a spectrum plot.
struct Curve {
    std::string label;  ///< up to 64 characters
    std::vector<double> wavelengths_nm, values;  ///< a value that is not finite leaves a gap
    Rgb8 color{0, 0, 0};
    bool markers = false;  ///< draw the band centres, where there are at most 120
};
/// The i-th of eight colours that colour-blind readers can tell apart, black first, then repeating. Source: Okabe and Ito
/// 2008, "Color universal design", with a grey in place of their yellow, which is too pale for a line on white.
SPECTEX_API Rgb8 curve_color(std::size_t i);
/// Reflectance or power against wavelength as an SVG document with editable text: axes in nm, a spectrum strip below
/// (CIE 1931 2° in sRGB, desaturated into gamut), a legend above when a curve has a label. The axis runs from 0 to 1 and
/// grows for values outside, or shrinks when all are below 0.1.
/// @error usage, without a curve or when a curve's lists differ in length, are empty, exceed 1e300, or have wavelengths that
/// are not finite and strictly ascending; or the error of the observer's table.
SPECTEX_API Result<std::string> plot_spectra_svg(std::span<const Curve> curves, std::string_view title,
                                                 std::string_view y_label);

/// A point of a chart with logarithmic axes.
struct ChartPoint {
    std::string label;  ///< up to 64 characters; empty: none
    double x = 0, y = 0;
};
/// Points of one kind, in one colour.
struct ChartSeries {
    std::string label;  ///< for the legend; up to 64 characters
    std::vector<ChartPoint> points;
    Rgb8 color{0, 0, 0};
    bool joined = false;  ///< by lines, in the order of the points
};
/// A chart on two logarithmic axes, as figures of cost against error are.
struct Chart {
    std::string title, x_label, y_label;
    std::vector<ChartSeries> series;
    std::vector<std::array<double, 2>> front;  ///< drawn as a staircase below and left of which nothing lies; ascending x
    double least_y = 0;  ///< smaller values, zero among them, stand on the lower edge, whose tick says "<="; 0: none are
};
/// As an SVG document with editable text. Every label stands near its point and off the others, joined to it by a thin line
/// where it had to move. @error usage, without a point, or for values that are not finite or, but for least_y, not positive.
SPECTEX_API Result<std::string> draw_chart_svg(const Chart& chart);
/// The same as a picture. @param scale  of the 1200 x 800 units that the SVG has, 0.25 to 8.
SPECTEX_API Result<Picture> draw_chart(const Chart& chart, double scale);

}  // namespace spectex
