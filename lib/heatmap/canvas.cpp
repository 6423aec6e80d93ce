// Resizing of pictures, measured text, and the sheet, on Cairo's image surface.
#include <cairo.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "heatmap/text.h"
#include "spectex/color.h"
#include "spectex/heatmap.h"

namespace spectex {
namespace {

constexpr int largest_canvas = 32767;  // Cairo's image surfaces have 16-bit coordinates
constexpr int largest_picture = 65535;
constexpr std::size_t longest_text = 256;

struct CairoRelease {
    void operator()(cairo_t* c) const { cairo_destroy(c); }
    void operator()(cairo_surface_t* s) const { cairo_surface_destroy(s); }
};
using Surface = std::unique_ptr<cairo_surface_t, CairoRelease>;
using Context = std::unique_ptr<cairo_t, CairoRelease>;

void set_font(cairo_t* c, double size_px, Weight weight) {
    cairo_select_font_face(c, heatmap::font_family, CAIRO_FONT_SLANT_NORMAL,
                           weight == Weight::bold ? CAIRO_FONT_WEIGHT_BOLD : CAIRO_FONT_WEIGHT_NORMAL);
    cairo_set_font_size(c, size_px);
    cairo_font_options_t* options = cairo_font_options_create();
    cairo_font_options_set_antialias(options, CAIRO_ANTIALIAS_GRAY);
    cairo_font_options_set_hint_style(options, CAIRO_HINT_STYLE_NONE);
    cairo_font_options_set_hint_metrics(options, CAIRO_HINT_METRICS_OFF);
    cairo_set_font_options(c, options);
    cairo_font_options_destroy(options);
}

std::vector<heatmap::Run> prepared(std::string_view text) {
    return heatmap::split_runs(heatmap::elide(heatmap::clean_utf8(text), longest_text));
}

double advance(cairo_t* c, const std::vector<heatmap::Run>& runs, double size_px, Weight weight) {
    double x = 0;
    for (const auto& run : runs) {
        set_font(c, run.subscript ? size_px * heatmap::subscript_scale : size_px, weight);
        cairo_text_extents_t extents;
        cairo_text_extents(c, run.text.c_str(), &extents);
        x += extents.x_advance;
    }
    return x;
}

void set_color(cairo_t* c, Rgb8 color) {
    cairo_set_source_rgb(c, color[0] / 255.0, color[1] / 255.0, color[2] / 255.0);
}

/// Which old pixels a new one covers, along one axis, and how much of each.
struct Coverage {
    int first = 0;
    std::vector<float> weights;
};
std::vector<Coverage> coverages(int from, int to) {
    std::vector<Coverage> all(static_cast<std::size_t>(to));
    const double ratio = static_cast<double>(from) / to;
    for (int i = 0; i < to; ++i) {
        const double low = i * ratio, high = i + 1 == to ? from : (i + 1) * ratio;
        Coverage& cover = all[static_cast<std::size_t>(i)];
        cover.first = std::min(static_cast<int>(low), from - 1);
        for (int j = cover.first; j < from && (j < high || j == cover.first); ++j) {
            const double part = std::min<double>(j + 1, high) - std::max<double>(j, low);
            cover.weights.push_back(static_cast<float>(part / (high - low)));
        }
    }
    return all;
}

/// Linear light of every code, and back.
const std::array<float, 256>& linear_of_codes() {
    static const std::array<float, 256> table = [] {
        std::array<float, 256> t{};
        for (std::size_t i = 0; i < t.size(); ++i) t[i] = static_cast<float>(srgb_decode(static_cast<double>(i) / 255));
        return t;
    }();
    return table;
}
std::uint8_t code_of_linear(float linear) {
    return static_cast<std::uint8_t>(std::lround(std::clamp(srgb_encode(linear), 0.0, 1.0) * 255));
}

void resize_box(const Picture& in, Picture& out) {
    const auto columns = coverages(in.width, out.width), rows = coverages(in.height, out.height);
    const auto& linear = linear_of_codes();
    const std::size_t in_stride = 3 * static_cast<std::size_t>(in.width);
    const std::size_t out_stride = 3 * static_cast<std::size_t>(out.width);
    std::vector<float> mixed(in_stride);
    for (std::size_t y = 0; y < rows.size(); ++y) {
        std::fill(mixed.begin(), mixed.end(), 0.0F);
        for (std::size_t j = 0; j < rows[y].weights.size(); ++j) {
            const std::uint8_t* source = in.rgb.data() + (static_cast<std::size_t>(rows[y].first) + j) * in_stride;
            for (std::size_t i = 0; i < in_stride; ++i) mixed[i] += rows[y].weights[j] * linear[source[i]];
        }
        for (std::size_t x = 0; x < columns.size(); ++x)
            for (std::size_t c = 0; c < 3; ++c) {
                float sum = 0;
                for (std::size_t j = 0; j < columns[x].weights.size(); ++j)
                    sum += columns[x].weights[j] * mixed[3 * (static_cast<std::size_t>(columns[x].first) + j) + c];
                out.rgb[y * out_stride + 3 * x + c] = code_of_linear(sum);
            }
    }
}

void resize_nearest(const Picture& in, Picture& out) {
    for (int y = 0; y < out.height; ++y) {
        const auto v = static_cast<std::size_t>((2LL * y + 1) * in.height / (2LL * out.height));
        for (int x = 0; x < out.width; ++x) {
            const auto u = static_cast<std::size_t>((2LL * x + 1) * in.width / (2LL * out.width));
            std::memcpy(out.rgb.data() + 3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(out.width) +
                                              static_cast<std::size_t>(x)),
                        in.rgb.data() + 3 * (v * static_cast<std::size_t>(in.width) + u), 3);
        }
    }
}

}  // namespace

Result<Picture> resize(const Picture& picture, int width, int height, Filter filter) {
    const auto bad = [](int size) { return size < 1 || size > largest_picture; };
    if (bad(picture.width) || bad(picture.height) || bad(width) || bad(height))
        return Error{ErrorKind::usage, "a picture of " + std::to_string(picture.width) + "x" +
                                           std::to_string(picture.height) + " cannot become " + std::to_string(width) +
                                           "x" + std::to_string(height) + ": sizes are 1 to 65535"};
    if (picture.rgb.size() != 3 * static_cast<std::size_t>(picture.width) * static_cast<std::size_t>(picture.height))
        return Error{ErrorKind::usage, "a picture of " + std::to_string(picture.width) + "x" +
                                           std::to_string(picture.height) + " holds " +
                                           std::to_string(picture.rgb.size()) + " bytes, not 3 for each pixel"};
    if (width == picture.width && height == picture.height) return picture;
    Picture out{width, height, {}};
    out.rgb.resize(3 * static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
    if (filter == Filter::box)
        resize_box(picture, out);
    else
        resize_nearest(picture, out);
    return out;
}

TextExtents measure_text(std::string_view text, double size_px, Weight weight) {
    const Surface surface(cairo_image_surface_create(CAIRO_FORMAT_RGB24, 1, 1));
    const Context context(cairo_create(surface.get()));
    TextExtents extents;
    extents.width = advance(context.get(), prepared(text), size_px, weight);
    set_font(context.get(), size_px, weight);
    cairo_font_extents_t font;
    cairo_font_extents(context.get(), &font);
    extents.ascent = font.ascent;
    extents.descent = font.descent;
    return extents;
}

struct Canvas::State {
    Surface surface;
    Context context;
    int width = 0, height = 0;
    std::string failure;  ///< the first one

    cairo_t* c() { return context.get(); }
    void fail(const std::string& what) {
        if (failure.empty()) failure = what;
    }
};

Canvas::Canvas(std::unique_ptr<State> state) : state_(std::move(state)) {}
Canvas::~Canvas() = default;
Canvas::Canvas(Canvas&&) noexcept = default;
Canvas& Canvas::operator=(Canvas&&) noexcept = default;

Result<Canvas> Canvas::make(int width, int height, Rgb8 background) {
    if (width < 1 || height < 1 || width > largest_canvas || height > largest_canvas)
        return Error{ErrorKind::usage, "a sheet of " + std::to_string(width) + "x" + std::to_string(height) +
                                           " pixels cannot be drawn: sizes are 1 to 32767"};
    auto state = std::make_unique<State>();
    state->width = width;
    state->height = height;
    state->surface.reset(cairo_image_surface_create(CAIRO_FORMAT_RGB24, width, height));
    state->context.reset(cairo_create(state->surface.get()));
    if (const auto status = cairo_status(state->c()); status != CAIRO_STATUS_SUCCESS)
        return Error{ErrorKind::output, std::string("Cairo cannot draw a sheet: ") + cairo_status_to_string(status)};
    // Curves of large letters are cut into straight pieces this long at the most off, in pixels.
    cairo_set_tolerance(state->c(), 0.05);
    set_color(state->c(), background);
    cairo_paint(state->c());
    return Canvas(std::move(state));
}

int Canvas::width() const { return state_->width; }
int Canvas::height() const { return state_->height; }

void Canvas::fill(double x, double y, double w, double h, Rgb8 color) {
    set_color(state_->c(), color);
    cairo_rectangle(state_->c(), x, y, w, h);
    cairo_fill(state_->c());
}

void Canvas::polygon(std::span<const std::array<double, 2>> points, Rgb8 color) {
    set_color(state_->c(), color);
    cairo_new_path(state_->c());
    for (const auto& p : points) cairo_line_to(state_->c(), p[0], p[1]);
    cairo_close_path(state_->c());
    cairo_fill(state_->c());
}

void Canvas::frame(double x, double y, double w, double h, double thickness, Rgb8 color) {
    fill(x - thickness, y - thickness, w + 2 * thickness, thickness, color);
    fill(x - thickness, y + h, w + 2 * thickness, thickness, color);
    fill(x - thickness, y, thickness, h, color);
    fill(x + w, y, thickness, h, color);
}

void Canvas::line(double x0, double y0, double x1, double y1, double thickness, Rgb8 color) {
    set_color(state_->c(), color);
    cairo_set_line_width(state_->c(), thickness);
    cairo_move_to(state_->c(), x0, y0);
    cairo_line_to(state_->c(), x1, y1);
    cairo_stroke(state_->c());
}

void Canvas::paste(const Picture& picture, int x, int y) { paste(picture, x, y, picture.width, picture.height, Filter::nearest); }

void Canvas::paste(const Picture& picture, int x, int y, int w, int h, Filter filter) {
    const auto resized = resize(picture, w, h, filter);
    if (!resized) return state_->fail(resized.error().message);
    cairo_surface_flush(state_->surface.get());
    std::uint8_t* data = cairo_image_surface_get_data(state_->surface.get());
    const auto stride = static_cast<std::ptrdiff_t>(cairo_image_surface_get_stride(state_->surface.get()));
    const long long left = std::max(0, x), right = std::min<long long>(state_->width, static_cast<long long>(x) + w);
    const long long top = std::max(0, y), bottom = std::min<long long>(state_->height, static_cast<long long>(y) + h);
    for (long long v = top; v < bottom; ++v)
        for (long long u = left; u < right; ++u) {
            const std::uint8_t* source =
                resized->rgb.data() + 3 * static_cast<std::size_t>((v - y) * static_cast<long long>(w) + (u - x));
            const std::uint32_t pixel = (std::uint32_t{source[0]} << 16) | (std::uint32_t{source[1]} << 8) | source[2];
            std::memcpy(data + v * stride + 4 * u, &pixel, sizeof pixel);
        }
    cairo_surface_mark_dirty(state_->surface.get());
}

void Canvas::text(double x, double y, std::string_view text, double size_px, Rgb8 color, Weight weight, Anchor anchor) {
    const auto runs = prepared(text);
    if (anchor != Anchor::left) {
        const double width = advance(state_->c(), runs, size_px, weight);
        x -= anchor == Anchor::center ? width / 2 : width;
    }
    set_color(state_->c(), color);
    for (const auto& run : runs) {
        set_font(state_->c(), run.subscript ? size_px * heatmap::subscript_scale : size_px, weight);
        cairo_text_extents_t extents;
        cairo_text_extents(state_->c(), run.text.c_str(), &extents);
        // Outlines, not glyph images: Cairo rounds the position of those to whole pixels, which spoils small sizes.
        cairo_move_to(state_->c(), x, run.subscript ? y + size_px * heatmap::subscript_drop : y);
        cairo_text_path(state_->c(), run.text.c_str());
        cairo_fill(state_->c());
        x += extents.x_advance;
    }
}

Result<Picture> Canvas::picture() const {
    if (!state_->failure.empty()) return Error{ErrorKind::output, "the sheet could not be drawn: " + state_->failure};
    if (const auto status = cairo_status(state_->c()); status != CAIRO_STATUS_SUCCESS)
        return Error{ErrorKind::output,
                     std::string("the sheet could not be drawn: ") + cairo_status_to_string(status)};
    cairo_surface_flush(state_->surface.get());
    const std::uint8_t* data = cairo_image_surface_get_data(state_->surface.get());
    const auto stride = static_cast<std::ptrdiff_t>(cairo_image_surface_get_stride(state_->surface.get()));
    Picture out{state_->width, state_->height, {}};
    out.rgb.resize(3 * static_cast<std::size_t>(out.width) * static_cast<std::size_t>(out.height));
    std::uint8_t* to = out.rgb.data();
    for (std::ptrdiff_t y = 0; y < out.height; ++y)
        for (std::ptrdiff_t x = 0; x < out.width; ++x) {
            std::uint32_t pixel = 0;
            std::memcpy(&pixel, data + y * stride + 4 * x, sizeof pixel);
            *to++ = static_cast<std::uint8_t>(pixel >> 16);
            *to++ = static_cast<std::uint8_t>(pixel >> 8);
            *to++ = static_cast<std::uint8_t>(pixel);
        }
    return out;
}

}  // namespace spectex
