// MacAdam, 'Maximum Visual Efficiency of Colored Materials', JOSA 25(11), 1935, doi:10.1364/JOSA.25.000361: the optimal
// colours, whose reflectances are 0 or 1 with at most two transitions.
//
// The construction: of all optimal colours the one of the wanted chromaticity, scaled to the wanted brightness, that is
// r = s on an interval of the circle of wavelengths (through the purples it wraps around) and 0 elsewhere. The ray from black
// through the colour leaves the object-colour solid at rgb / s, so s <= 1 for every colour inside the solid, r depends on the
// colour continuously and scales with it, greys are flat, and the spectrum is exact. No reflectance of that chromaticity and
// a flat top has a lower height s: it is the brightest colour of its chromaticity, dimmed.
//
// On bands, an edge inside a band covers a fraction of it. With a_b the columns of A, colours whose edges lie in bands i and
// j are x a_i + sum(a between) + y a_j = t rgb with s = 1/t: the parallelogram facets of the solid, which is a zonohedron, and
// a 3x3 linear system each. The facets meet edge to edge, and a walk from facet to neighbouring facet finds the one that
// holds the colour. This needs the bands' chromaticities in convex position; neighbouring bands that break it (the ends of the
// spectrum, where the tables' chromaticities stand still or turn back) share one fraction.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "methods/registry.h"

namespace spectex::registry {
namespace {

/// Start and end on the circle of groups, in units of groups: 0 <= from <= m, from < to <= from + m. The end's group is
/// counted on from the start's.
struct Box {
    double from = 0, to = 0, height = 0;
};

struct Facet {
    std::size_t i = 0, j = 1;  ///< i < m, i < j < i + m
    double x = 0, y = 0, t = 0;
    /// How far x and y lie outside [0,1]; infinite where the system is singular or the ray points away.
    double violation() const {
        const double v = std::max({-x, x - 1, -y, y - 1, 0.0});
        return t > 0 && std::isfinite(v) ? v : HUGE_VAL;
    }
};

double turn(const std::array<double, 2>& a, const std::array<double, 2>& b, const std::array<double, 2>& c) {
    return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]);
}

class BoxModel final : public Model {
public:
    BoxModel(const MethodInfo& info, const Colorimetry& colorimetry) : Model(info, colorimetry) {
        make_groups();
        const std::size_t m = columns_.size();
        if (m < 3) return;  // make_boxes() refuses it
        sums_.assign(2 * m + 1, Vector3{});
        for (std::size_t k = 0; k < 2 * m; ++k)
            for (std::size_t c = 0; c < 3; ++c) sums_[k + 1][c] = sums_[k][c] + columns_[k % m][c];
        starts_.resize(cells * cells);
        // One walk through the table, boustrophedon, so that each start is a few facets from the one before.
        Facet facet = facet_at(0, m / 2, {1, 1, 1});
        for (std::size_t row = 0; row < cells; ++row)
            for (std::size_t k = 0; k < cells; ++k) {
                const std::size_t column = row % 2 ? cells - 1 - k : k;
                double r = (static_cast<double>(column) + 0.5) / cells, g = (static_cast<double>(row) + 0.5) / cells;
                if (r + g > 1) {  // not a colour: its neighbour on the diagonal
                    const double over = (r + g - 1) / 2;
                    r -= over, g -= over;
                }
                const Facet found = walk(facet, {r, g, std::max(0.0, 1 - r - g)});
                if (found.violation() < tolerance) facet = found;
                starts_[row * cells + column] = {static_cast<std::uint32_t>(facet.i), static_cast<std::uint32_t>(facet.j)};
            }
    }

    bool solvable() const { return columns_.size() >= 3; }

    Box box(const double* rgb) const {
        const double top = std::max({rgb[0], rgb[1], rgb[2]}), low = std::min({rgb[0], rgb[1], rgb[2]});
        const auto m = static_cast<double>(columns_.size());
        if (!(top > 0)) return {0, m, 0};
        // At grey every facet around the white corner is met in its corner.
        if (top - low <= 1e-13 * top) return {0, m, std::min(1.0, (rgb[0] + rgb[1] + rgb[2]) / 3)};
        const Vector3 color{rgb[0] / top, rgb[1] / top, rgb[2] / top};
        const Facet facet = find(color);
        const double x = std::clamp(facet.x, 0.0, 1.0), y = std::clamp(facet.y, 0.0, 1.0);
        return {static_cast<double>(facet.i + 1) - x, static_cast<double>(facet.j) + y, std::min(1.0, top / facet.t)};
    }

    /// The facet of a colour, by the walk or, should the walk not end or, as near white, end beside it, by looking at every one.
    Facet find(const Vector3& color) const {
        const double sum = color[0] + color[1] + color[2];
        const auto cell = [&](double v) { return std::min(cells - 1, static_cast<std::size_t>(v / sum * cells)); };
        const auto start = starts_[cell(color[1]) * cells + cell(color[0])];
        const Facet facet = walk(facet_at(start[0], start[1], color), color);
        if (facet.violation() < rounding) return facet;
        const Facet best = search(color);
        return best.violation() < facet.violation() ? best : facet;
    }

    void reflectance(std::span<const double> rgb, std::span<double> out) const override {
        const std::size_t bands = colorimetry().bands().size();
        for (std::size_t p = 0; 3 * p + 2 < rgb.size(); ++p) fill(box(&rgb[3 * p]), &out[p * bands]);
    }
    bool bands_apart() const override { return true; }
    void reflectance_in(std::span<const std::size_t> bands, std::span<const double> rgb, std::span<double> out) const override {
        for (std::size_t p = 0; 3 * p + 2 < rgb.size(); ++p) fill_some(box(&rgb[3 * p]), bands, &out[p * bands.size()]);
    }
    void reflectance_of_coefficients_in(std::span<const std::size_t> bands, std::span<const double> coefficients,
                                        std::span<double> out) const override {
        for (std::size_t p = 0; 3 * p + 2 < coefficients.size(); ++p) fill_some(box_of(&coefficients[3 * p]), bands, &out[p * bands.size()]);
    }
    std::vector<std::string> coefficient_names() const override { return {"c0", "c1", "c2"}; }
    void coefficients(std::span<const double> rgb, std::span<double> out) const override {
        const auto m = static_cast<double>(columns_.size());
        for (std::size_t p = 0; 3 * p + 2 < rgb.size(); ++p) {
            const Box b = box(&rgb[3 * p]);
            out[3 * p] = b.from / m;
            out[3 * p + 1] = b.to > m ? (b.to - m) / m : b.to / m;
            out[3 * p + 2] = b.height;
        }
    }
    void reflectance_of_coefficients(std::span<const double> coefficients, std::span<double> out) const override {
        const std::size_t bands = colorimetry().bands().size();
        for (std::size_t p = 0; 3 * p + 2 < coefficients.size(); ++p) fill(box_of(&coefficients[3 * p]), &out[p * bands]);
    }
    std::string to_json() const override { return model_json(*this).dump(-1, ' ', false, Json::error_handler_t::replace); }

    /// How far outside [0,1] the shares of a facet's two groups may lie; and what is no more than their rounding.
    static constexpr double tolerance = 1e-9, rounding = 1e-14;

private:
    static constexpr std::size_t cells = 96;

    void make_groups() {
        const std::size_t n = colorimetry().bands().size();
        const auto &a = colorimetry().sensing_matrix(), &w = colorimetry().xyz_weights();
        struct Group {
            std::size_t bands = 0;
            Vector3 xyz{}, rgb{};
            std::array<double, 2> xy() const {
                const double sum = xyz[0] + xyz[1] + xyz[2];
                return {xyz[0] / sum, xyz[1] / sum};
            }
        };
        std::vector<Group> groups;
        std::size_t dark = 0;
        for (std::size_t l = 0; l < n; ++l) {
            Group g{1, {w[l], w[n + l], w[2 * n + l]}, {a[l], a[n + l], a[2 * n + l]}};
            const bool unseen = !(g.xyz[0] + g.xyz[1] + g.xyz[2] > 0);
            // Bands that weigh nothing take the value of the band before, the first ones that of the band behind.
            if (unseen && groups.empty()) {
                ++dark;
            } else if (unseen) {
                ++groups.back().bands;
            } else {
                g.bands += dark;
                dark = 0;
                groups.push_back(g);
            }
        }
        const auto weight = [](const Group& g) { return g.xyz[0] + g.xyz[1] + g.xyz[2]; };
        const auto breaks = [&](std::size_t k) {
            const std::size_t m = groups.size();
            // The locus runs clockwise in (x, y). 1e-12 is a turn that rounding of the weights could make.
            return !(turn(groups[(k + m - 1) % m].xy(), groups[k].xy(), groups[(k + 1) % m].xy()) < -1e-12);
        };
        for (std::size_t k = 0; k < groups.size() && groups.size() > 3;) {
            if (!breaks(k)) {
                ++k;
                continue;
            }
            // With the fainter neighbour, that is towards the ends of the spectrum, where nothing is lost by it.
            const bool before = k > 0 && (k + 1 == groups.size() || weight(groups[k - 1]) < weight(groups[k + 1]));
            const std::size_t into = before ? k - 1 : k, from = into + 1;
            groups[into].bands += groups[from].bands;
            for (std::size_t c = 0; c < 3; ++c) {
                groups[into].xyz[c] += groups[from].xyz[c];
                groups[into].rgb[c] += groups[from].rgb[c];
            }
            groups.erase(groups.begin() + static_cast<std::ptrdiff_t>(from));
            k = 0;
        }
        for (std::size_t g = 0; g < groups.size(); ++g) {
            columns_.push_back(groups[g].rgb);
            for (std::size_t k = 0; k < groups[g].bands; ++k) group_of_.push_back(g);
        }
    }

    Facet facet_at(std::size_t i, std::size_t j, const Vector3& color) const {
        const std::size_t m = columns_.size();
        const Vector3 &a = columns_[i], &b = columns_[j % m];
        Vector3 between;
        for (std::size_t c = 0; c < 3; ++c) between[c] = sums_[j][c] - sums_[i + 1][c];
        // x a + y b + between = t color: take the products with what is normal to two of the unknowns' columns.
        const auto product = [](const Vector3& u, const Vector3& v) {
            return Vector3{u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
        };
        const auto dot = [](const Vector3& u, const Vector3& v) { return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]; };
        const Vector3 bc = product(b, color), ab = product(a, b);
        const double det = dot(a, bc);
        return {i, j, -dot(between, bc) / det, -dot(product(color, a), between) / det, dot(ab, between) / dot(ab, color)};
    }

    Facet walk(Facet facet, const Vector3& color) const {
        const std::size_t m = columns_.size();
        facet = facet_at(facet.i, facet.j, color);
        // Near white, where all facets meet, many are within the tolerance, and one holds the colour: once there, a few more
        // steps look for it.
        Facet best = facet;
        for (std::size_t step = 0, more = 0; step < 4 * m && more < 24; ++step) {
            if (facet.violation() < best.violation()) best = facet;
            if (best.violation() < rounding) return best;
            more += best.violation() < tolerance;
            std::size_t i = facet.i + m, j = facet.j + m;
            if (facet.x > 1) --i;
            else if (facet.x < 0) ++i;
            if (facet.y > 1) ++j;
            else if (facet.y < 0) --j;
            if (j <= i) j = i + 1;
            if (j >= i + m) j = i + m - 1;
            const std::size_t turns = i / m * m;
            const Facet next = facet_at(i - turns, j - turns, color);
            if (next.i == facet.i && next.j == facet.j) return best;
            facet = next;
        }
        return facet.violation() < best.violation() ? facet : best;
    }

    Facet search(const Vector3& color) const {
        const std::size_t m = columns_.size();
        Facet best;
        double least = HUGE_VAL;
        for (std::size_t i = 0; i < m; ++i)
            for (std::size_t j = i + 1; j < i + m; ++j) {
                const Facet facet = facet_at(i, j, color);
                if (facet.violation() < least) least = facet.violation(), best = facet;
            }
        return best;
    }

    Box box_of(const double* coefficients) const {
        const auto m = static_cast<double>(columns_.size());
        // From a file, so anything may come; NaN compares false and becomes 0.
        const auto unit = [](double v) { return v > 0 ? std::min(v, 1.0) : 0.0; };
        Box b{unit(coefficients[0]) * m, unit(coefficients[1]) * m, unit(coefficients[2])};
        // Boxes are never empty, so equal edges, as float or half may round them, are the whole circle.
        if (b.to <= b.from) b.to += m;
        return b;
    }
    double reflectance_of_group(const Box& b, std::size_t group) const {
        const auto m = static_cast<double>(columns_.size()), k = static_cast<double>(group);
        const auto covered = [&](double at) { return std::max(0.0, std::min(b.to, at + 1) - std::max(b.from, at)); };
        return b.height * std::min(1.0, covered(k) + covered(k + m));
    }
    void fill(const Box& b, double* r) const {
        for (std::size_t l = 0; l < group_of_.size(); ++l) r[l] = reflectance_of_group(b, group_of_[l]);
    }
    void fill_some(const Box& b, std::span<const std::size_t> bands, double* r) const {
        for (std::size_t k = 0; k < bands.size(); ++k) r[k] = reflectance_of_group(b, group_of_[bands[k]]);
    }

    std::vector<Vector3> columns_;          ///< of A, by group
    std::vector<std::size_t> group_of_;     ///< by band
    std::vector<Vector3> sums_;             ///< of the columns before, twice around the circle
    std::vector<std::array<std::uint32_t, 2>> starts_;
};

ModelResult make_boxes(const MethodInfo& info, const Colorimetry& colorimetry) {
    const std::size_t bands = colorimetry.bands().size();
    const auto infeasible = [&](std::string why) {
        return Error{ErrorKind::infeasible, fmt::format("{}: {} ({})", info.id, why, colorimetry.describe())};
    };
    const Vector3 diffuser = colorimetry.rgb_of(std::vector<double>(bands, 1.0));
    for (const double v : diffuser)
        if (!(std::abs(v - 1) <= 1e-9))
            return infeasible(fmt::format("the perfect diffuser is RGB ({}, {}, {}), not (1,1,1); the integrated matrix makes it so",
                                          diffuser[0], diffuser[1], diffuser[2]));
    auto model = std::make_shared<BoxModel>(info, colorimetry);
    if (!model->solvable()) return infeasible("fewer than three bands are seen");
    // The height is a convex function of the colour, so the cube's vertices have its largest values.
    for (int v = 1; v < 7; ++v) {
        const Vector3 rgb{double(v & 1), double(v >> 1 & 1), double(v >> 2)};
        const Facet facet = model->find(rgb);
        const bool found = facet.violation() < BoxModel::tolerance;
        if (!found || facet.t < 1 - 1e-9)
            return infeasible(fmt::format("RGB ({}, {}, {}) is no object colour: {}", rgb[0], rgb[1], rgb[2],
                                          found ? fmt::format("its box would have height {:.4g}", 1 / facet.t)
                                                : std::string("no box has its chromaticity")));
    }
    return std::shared_ptr<const Model>(std::move(model));
}

ModelResult read_boxes(const MethodInfo& info, const Colorimetry& colorimetry, const Json&) {
    auto made = make_boxes(info, colorimetry);
    if (!made) return Error{ErrorKind::input, "model: " + made.error().message};
    return made;
}

}  // namespace

Entry macadam1935() {
    MethodInfo info;
    info.id = "macadam1935";
    info.title = "Box spectra: optimal colours, dimmed";
    info.source = "MacAdam 1935, JOSA 25(11), doi:10.1364/JOSA.25.000361";
    info.pieces = Pieces::nonlinear;
    info.exact = true;
    info.bounded = true;
    return {std::move(info), make_boxes, read_boxes};
}

}  // namespace spectex::registry
