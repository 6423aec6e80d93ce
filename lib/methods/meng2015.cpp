// Meng, Simon, Hanika and Dachsbacher, 'Physically Meaningful Rendering using Tristimulus Colours', Computer Graphics Forum
// 34(4), 2015, doi:10.1111/cgf.12676.
//
// On a grid of chromaticities, each point gets the smoothest non-negative spectrum of that chromaticity with X + Y + Z = 1,
// which may exceed 1. A colour takes the spectrum of its chromaticity (bilinear within cells, linear on triangles where the
// boundary of the gamut cuts a cell; at one sum X + Y + Z both keep the chromaticity exactly), scaled to its own X + Y + Z.
// Smooth spectra of bright saturated colours then reflect more than falls on them, and are clamped to 1 as published: energy
// is conserved and the colour is not.
//
// As published, the spectra of the grid have their colours under equal energy, and XYZ is taken from linear RGB as it is. A
// reflectance that is lit by anything else, white included, comes out tinted: the greater part of the method's error. Solved
// for the illuminant itself (:matched) only the clamp errs.
//
// The grid is turned so that one axis is parallel to the line of purples and a point lies on the white, whose spectrum is
// flat. Boundary points lie a thousandth of the way from the spectral locus to the white, where smooth spectra still exist.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "methods/registry.h"
#include "methods/smoothest.h"

namespace spectex::registry {
namespace {

constexpr std::string_view matched_id = "meng2015:matched";

using Point = std::array<double, 2>;

double cross(const Point& a, const Point& b, const Point& c) {
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/// The convex hull, counter-clockwise. Source: Andrew 1979, doi:10.1016/0020-0190(79)90072-3.
std::vector<Point> convex_hull(std::vector<Point> points) {
    std::sort(points.begin(), points.end());
    std::vector<Point> hull;
    for (int half = 0; half < 2; ++half) {
        const std::size_t base = hull.size();
        for (const Point& p : points) {
            while (hull.size() >= base + 2 && cross(hull[hull.size() - 2], hull.back(), p) <= 0) hull.pop_back();
            hull.push_back(p);
        }
        hull.pop_back();
        std::reverse(points.begin(), points.end());
    }
    return hull;
}

/// What of a convex polygon lies where side >= 0. Source: Sutherland and Hodgman 1974, doi:10.1145/360767.360802.
template <class Side>
std::vector<Point> clip(const std::vector<Point>& polygon, const Side& side) {
    std::vector<Point> out;
    for (std::size_t k = 0; k < polygon.size(); ++k) {
        const Point &a = polygon[k], &b = polygon[(k + 1) % polygon.size()];
        const double sa = side(a), sb = side(b);
        if (sa >= 0) out.push_back(a);
        if ((sa > 0 && sb < 0) || (sa < 0 && sb > 0)) {
            const double t = sa / (sa - sb);
            out.push_back({a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])});
        }
    }
    return out;
}

/// For which light the grid is solved.
TristimulusWeights grid_weights(const MethodInfo& info, const Colorimetry& c) {
    if (info.id == matched_id) return {c.xyz_weights(), c.white_xyz()};
    // Equal energy has power everywhere, so that nothing can fail.
    return *tristimulus_weights(c.bands(), c.observer(), *parse_illuminant("E"), Normalization::luminance);
}

/// The geometry: cells of a grid in (u, v), a turned chromaticity plane with the white at the origin.
class Grid {
public:
    static constexpr double spacing = 0.05;  ///< in xy; the published grid has 11 x 13 points over the locus

    struct Cell {
        std::vector<std::size_t> nodes;  ///< four for a whole cell, (0,0) (1,0) (0,1) (1,1); else a convex polygon
        bool whole = false;
    };

    Grid(const Colorimetry& c, const TristimulusWeights& light) {
        const std::size_t n = c.bands().size();
        const auto& w = light.w;
        std::vector<Point> locus;
        for (std::size_t l = 0; l < n; ++l) {
            const double sum = w[l] + w[n + l] + w[2 * n + l];
            if (sum > 0) locus.push_back({w[l] / sum, w[n + l] / sum});
        }
        if (locus.size() < 3) return;
        const Vector3& white = light.white;
        const double sum = white[0] + white[1] + white[2];
        white_ = {white[0] / sum, white[1] / sum};
        const Point purple{locus.back()[0] - locus.front()[0], locus.back()[1] - locus.front()[1]};
        const double length = std::hypot(purple[0], purple[1]);
        axis_ = length > 0 ? Point{purple[0] / length, purple[1] / length} : Point{1, 0};
        boundary_ = convex_hull(locus);
        for (Point& p : boundary_) {
            const Point uv = to_uv(p);
            p = {uv[0] * shrink, uv[1] * shrink};
        }
        // Only cells that a colour of the RGB space can lie in are needed.
        std::vector<Point> triangle;
        for (std::size_t k = 0; k < 3; ++k) triangle.push_back(to_uv(c.rgb_space().primaries_xy[k]));
        if (cross(triangle[0], triangle[1], triangle[2]) < 0) std::swap(triangle[1], triangle[2]);
        const auto inside = [](const std::vector<Point>& polygon, const Point& p, double slack) {
            for (std::size_t k = 0; k < polygon.size(); ++k)
                if (cross(polygon[k], polygon[(k + 1) % polygon.size()], p) < slack) return false;
            return !polygon.empty();
        };
        covered_ = std::all_of(triangle.begin(), triangle.end(), [&](const Point& p) { return inside(boundary_, p, 0); });
        if (!covered_) return;
        for (int j = -reach; j < reach; ++j)
            for (int i = -reach; i < reach; ++i) {
                const Point low{i * spacing, j * spacing}, high{low[0] + spacing, low[1] + spacing};
                const std::vector<Point> corners{low, {high[0], low[1]}, high, {low[0], high[1]}};
                std::vector<Point> seen = corners, part = corners;
                const auto clip_by = [](std::vector<Point> polygon, const std::vector<Point>& by) {
                    for (std::size_t k = 0; k < by.size(); ++k)
                        polygon = clip(polygon, [&](const Point& p) { return cross(by[k], by[(k + 1) % by.size()], p); });
                    return polygon;
                };
                if (clip_by(corners, triangle).size() < 3) continue;
                Cell cell;
                cell.whole = std::all_of(corners.begin(), corners.end(), [&](const Point& p) { return inside(boundary_, p, 0); });
                if (cell.whole) {
                    for (const Point& p : {corners[0], corners[1], corners[3], corners[2]}) cell.nodes.push_back(node(p));
                } else {
                    for (const Point& p : clip_by(corners, boundary_))
                        if (const auto at = node(p); std::find(cell.nodes.begin(), cell.nodes.end(), at) == cell.nodes.end())
                            cell.nodes.push_back(at);
                }
                cells_[index(i, j)] = std::move(cell);
            }
    }

    bool covered() const { return covered_; }
    const std::vector<Point>& nodes() const { return nodes_; }
    Point to_xy(const Point& uv) const {
        return {white_[0] + uv[0] * axis_[0] - uv[1] * axis_[1], white_[1] + uv[0] * axis_[1] + uv[1] * axis_[0]};
    }

    /// Up to four nodes and their weights, which sum to 1; colours outside all cells by rounding take the nearest cell.
    struct Blend {
        std::array<std::size_t, 4> node{};
        std::array<double, 4> weight{};
    };
    Blend blend(const Point& xy) const {
        const Point uv = to_uv(xy);
        const auto cell_of = [](double v) { return std::clamp(static_cast<int>(std::floor(v / spacing)), -reach, reach - 1); };
        int i = cell_of(uv[0]), j = cell_of(uv[1]);
        const Cell* cell = &cells_[index(i, j)];
        // On an edge of the gamut that is an edge of a cell, rounding may choose the cell outside.
        for (int k = 0; cell->nodes.empty() && k < 9; ++k) {
            const int a = std::clamp(i + k % 3 - 1, -reach, reach - 1), b = std::clamp(j + k / 3 - 1, -reach, reach - 1);
            if (const Cell& other = cells_[index(a, b)]; !other.nodes.empty()) cell = &other, i = a, j = b;
        }
        const auto& n = cell->nodes;
        if (cell->whole) {
            const double s = std::clamp(uv[0] / spacing - i, 0.0, 1.0), t = std::clamp(uv[1] / spacing - j, 0.0, 1.0);
            return {{n[0], n[1], n[2], n[3]}, {(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t}};
        }
        Blend best;
        double least = -HUGE_VAL;
        for (std::size_t k = 1; k + 1 < n.size(); ++k) {
            const Point &a = nodes_[n[0]], &b = nodes_[n[k]], &c = nodes_[n[k + 1]];
            const double area = cross(a, b, c);
            if (!(area > 1e-14)) continue;
            const double wa = cross(b, c, uv) / area, wb = cross(c, a, uv) / area, wc = 1 - wa - wb;
            const double low = std::min({wa, wb, wc});
            if (low > least) least = low, best = {{n[0], n[k], n[k + 1], n[0]}, {wa, wb, wc, 0}};
        }
        return best;
    }

private:
    static constexpr double shrink = 0.999;
    static constexpr int reach = 20;  ///< cells on each side of the white: 1 in xy

    Point to_uv(const Point& xy) const {
        const double x = xy[0] - white_[0], y = xy[1] - white_[1];
        return {x * axis_[0] + y * axis_[1], y * axis_[0] - x * axis_[1]};
    }
    static std::size_t index(int i, int j) { return static_cast<std::size_t>((j + reach) * 2 * reach + i + reach); }
    std::size_t node(const Point& uv) {
        // Points nearer than 1e-9 are one: cells meet in them.
        const std::pair<long long, long long> key{std::llround(uv[0] * 1e9), std::llround(uv[1] * 1e9)};
        const auto [at, added] = index_.try_emplace(key, nodes_.size());
        if (added) nodes_.push_back(uv);
        return at->second;
    }

    Point white_{}, axis_{1, 0};
    bool covered_ = false;
    std::vector<Point> boundary_, nodes_;
    std::map<std::pair<long long, long long>, std::size_t> index_;
    std::vector<Cell> cells_ = std::vector<Cell>(static_cast<std::size_t>(4 * reach * reach));
};

class MengModel final : public Model {
public:
    MengModel(const MethodInfo& info, const Colorimetry& colorimetry, Grid grid, std::vector<double> spectra)
        : Model(info, colorimetry), grid_(std::move(grid)), spectra_(std::move(spectra)) {}

    void reflectance(std::span<const double> rgb, std::span<double> out) const override {
        evaluate(colorimetry().bands().size(), [](std::size_t l) { return l; }, rgb, out);
    }
    bool bands_apart() const override { return true; }
    void reflectance_in(std::span<const std::size_t> bands, std::span<const double> rgb, std::span<double> out) const override {
        evaluate(bands.size(), [&](std::size_t l) { return bands[l]; }, rgb, out);
    }
    void reflectance_of_coefficients_in(std::span<const std::size_t> bands, std::span<const double> coefficients,
                                        std::span<double> out) const override {
        reflectance_in(bands, coefficients, out);
    }
    std::string to_json() const override {
        Json json = model_json(*this);
        json["spectra"] = spectra_;
        return json.dump(-1, ' ', false, Json::error_handler_t::replace);
    }

private:
    /// @param band_of  the band that is the l-th of `bands`.
    template <class BandOf>
    void evaluate(std::size_t bands, const BandOf& band_of, std::span<const double> rgb, std::span<double> out) const {
        const std::size_t all = colorimetry().bands().size();
        for (std::size_t p = 0; 3 * p + 2 < rgb.size(); ++p) {
            double* r = &out[p * bands];
            const Vector3 xyz = colorimetry().rgb_to_xyz() * Vector3{rgb[3 * p], rgb[3 * p + 1], rgb[3 * p + 2]};
            const double sum = xyz[0] + xyz[1] + xyz[2];
            // Below the smallest normal number a chromaticity has no digits.
            if (!(sum > std::numeric_limits<double>::min())) {
                std::fill_n(r, bands, 0.0);
                continue;
            }
            const auto blend = grid_.blend({xyz[0] / sum, xyz[1] / sum});
            std::fill_n(r, bands, 0.0);
            for (std::size_t k = 0; k < 4; ++k) {
                const double weight = blend.weight[k] * sum;
                const double* spectrum = &spectra_[blend.node[k] * all];
                for (std::size_t l = 0; l < bands; ++l) r[l] += weight * spectrum[band_of(l)];
            }
            for (std::size_t l = 0; l < bands; ++l) r[l] = std::clamp(r[l], 0.0, 1.0);
        }
    }

    Grid grid_;
    std::vector<double> spectra_;  ///< [nodes][bands], each with X + Y + Z = 1
};

Result<Grid> make_grid(const MethodInfo& info, const Colorimetry& colorimetry, const TristimulusWeights& light) {
    Grid grid(colorimetry, light);
    if (!grid.covered())
        return Error{ErrorKind::infeasible, fmt::format("{}: a primary lies outside the chromaticities of the bands ({})", info.id,
                                                        colorimetry.describe())};
    return grid;
}

ModelResult make_grid(const MethodInfo& info, const Colorimetry& colorimetry) {
    const auto light = grid_weights(info, colorimetry);
    auto grid = make_grid(info, colorimetry, light);
    if (!grid) return std::move(grid).error();
    std::vector<double> spectra;
    for (const Point& uv : grid->nodes()) {
        const Point xy = grid->to_xy(uv);
        const auto solved = smoothest_spectrum(light.w, colorimetry.bands().wavelengths_nm(),
                                               {xy[0], xy[1], 1 - xy[0] - xy[1]}, std::numeric_limits<double>::infinity());
        if (!solved)
            return Error{solved.error().kind, fmt::format("{}: no spectrum for xy ({}, {}): {}", info.id, xy[0], xy[1], solved.error().message)};
        spectra.insert(spectra.end(), solved->begin(), solved->end());
    }
    return std::shared_ptr<const Model>(std::make_shared<MengModel>(info, colorimetry, *std::move(grid), std::move(spectra)));
}

ModelResult read_grid(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    const auto light = grid_weights(info, colorimetry);
    auto grid = make_grid(info, colorimetry, light);
    if (!grid) return Error{ErrorKind::input, "model: " + grid.error().message};
    const std::size_t n = colorimetry.bands().size();
    // A spectrum that is one spike of the faintest band may be as high as the band is faint.
    auto spectra = read_numbers(json, "spectra", grid->nodes().size() * n, 0, 1e12);
    if (!spectra) return std::move(spectra).error();
    const auto& w = light.w;
    for (std::size_t k = 0; k < grid->nodes().size(); ++k) {
        const Point xy = grid->to_xy(grid->nodes()[k]);
        for (std::size_t c = 0; c < 3; ++c) {
            double sum = 0;
            for (std::size_t l = 0; l < n; ++l) sum += w[c * n + l] * (*spectra)[k * n + l];
            const double expected = c < 2 ? xy[c] : 1 - xy[0] - xy[1];
            if (!(std::abs(sum - expected) <= 1e-9))
                return Error{ErrorKind::input, fmt::format("model: member 'spectra': spectrum {} has component {} of XYZ {}, expected {}",
                                                           k, c, sum, expected)};
        }
    }
    return std::shared_ptr<const Model>(std::make_shared<MengModel>(info, colorimetry, *std::move(grid), *std::move(spectra)));
}

Entry entry(std::string_view id, std::string title) {
    MethodInfo info;
    info.id = id;
    info.title = std::move(title);
    info.source = "Meng, Simon, Hanika and Dachsbacher 2015, CGF 34(4), doi:10.1111/cgf.12676";
    info.pieces = Pieces::nonlinear;
    info.exact = false;
    info.bounded = true;
    return {std::move(info), make_grid, read_grid};
}

}  // namespace

Entry meng2015() { return entry("meng2015", "Smoothest spectra on a grid, clamped"); }
Entry meng2015_matched() { return entry(matched_id, "The same, for the illuminant itself"); }

}  // namespace spectex::registry
