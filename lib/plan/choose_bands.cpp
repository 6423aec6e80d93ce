#include "plan/choose_bands.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "methods/tetrahedral_model.h"
#include "parallel.h"
#include "solvers/lattice.h"
#include "solvers/quadratic_programme.h"
#include "spectex/compare.h"
#include "spectex/plan.h"

namespace spectex {
namespace {

constexpr double first_nm = 380, last_nm = 780, raster_nm = 5;
constexpr std::size_t fewest_bands = 5, most_bands = 40;
/// Vertices by which positions are judged while they move; the colours themselves decide in the end.
constexpr std::size_t judged_vertices = 32;
/// A squared reflectance off the master's, against a squared CIE76: a tenth costs as much as 0.01 of a difference.
constexpr double closeness = 0.01;
/// What a vertex counts for that has no reflectance on the bands.
constexpr double impossible = 100;

/// A lattice fitted to lights; its vertices are in no table.
class FittedLattice final : public registry::TetrahedralModel {
public:
    FittedLattice(const MethodInfo& info, const Colorimetry& colorimetry, LatticeTable table, const std::vector<Illuminant>& lights)
        : TetrahedralModel(info, colorimetry, std::move(table)) {
        for (const auto& light : lights) lights_.push_back(light.name);
    }
    std::string to_json() const override {
        auto json = registry::model_json(*this);
        json["fitted_to"] = lights_;
        return json.dump(-1, ' ', false, registry::Json::error_handler_t::replace);
    }

private:
    std::vector<std::string> lights_;
};

/// [3][bands]: XYZ of a reflectance under a light as a reader of the bands gets it, by way of linear BT.709, which the
/// reference's matrix takes to XYZ.
Result<Eigen::MatrixXd> relit_xyz(const Observer& observer, const BandSet& bands, const Illuminant& light, const Matrix3& to_xyz) {
    const auto own = Colorimetry::make({observer.id, "", "BT.709", RgbMatrix::integrated}, bands);
    if (!own) return own.error();
    const auto weights = tristimulus_weights(bands, observer, light, Normalization::luminance);
    if (!weights) return weights.error();
    const Matrix3 m = to_xyz * own->xyz_to_rgb();
    Eigen::MatrixXd out(3, static_cast<Eigen::Index>(bands.size()));
    for (std::size_t b = 0; b < bands.size(); ++b) {
        const Vector3 v = m * Vector3{weights->w[b], weights->w[bands.size() + b], weights->w[2 * bands.size() + b]};
        for (int c = 0; c < 3; ++c) out(c, static_cast<Eigen::Index>(b)) = v[static_cast<std::size_t>(c)];
    }
    return out;
}

/// d Lab / d XYZ (CIE 15:2018, eq. 8.3 to 8.6).
Eigen::Matrix3d lab_slope(const Eigen::Vector3d& xyz, const Vector3& white) {
    constexpr double d = 6.0 / 29.0;
    Eigen::Vector3d f;
    for (int c = 0; c < 3; ++c) {
        const double w = white[static_cast<std::size_t>(c)], t = xyz[c] / w;
        f[c] = (t > d * d * d ? std::pow(t, -2.0 / 3.0) / 3 : 1 / (3 * d * d)) / w;
    }
    Eigen::Matrix3d m;
    m << 0, 116 * f[1], 0, 500 * f[0], -500 * f[1], 0, 0, 200 * f[1], -200 * f[2];
    return m;
}

struct Truth {
    std::shared_ptr<const Model> model;
    Matrix3 to_xyz;                       ///< linear BT.709 on the reference's bands
    std::vector<Vector3> whites;          ///< of each light
    std::vector<Eigen::MatrixXd> relit;   ///< [lights] of [3][vertices]
};

class Fitter {
public:
    static Result<Fitter> make(const Truth& truth, const Colorimetry& to, const std::vector<Illuminant>& lights) {
        Fitter fitter(truth, to);
        for (const auto& light : lights) {
            auto rows = relit_xyz(to.observer(), to.bands(), light, truth.to_xyz);
            if (!rows) return std::move(rows).error();
            fitter.rows_.push_back(*std::move(rows));
        }
        return fitter;
    }

    /// @return the largest CIE76 of the vertex, or nothing where no reflectance has its colour.
    std::optional<double> fit(std::size_t vertex, std::span<double> out) const {
        const auto& table = *truth_->model->lattice();
        const Vector3 rgb = registry::vertex_color(table, vertex);
        const auto n = static_cast<Eigen::Index>(to_->bands().size());
        bool possible = true;
        if (rgb == Vector3{0, 0, 0} || rgb == Vector3{1, 1, 1}) {
            std::fill(out.begin(), out.end(), rgb[0]);
        } else {
            const auto& from = truth_->model->colorimetry().bands().wavelengths_nm();
            const double* stored = &table.vertices[vertex * table.values];
            solvers::QuadraticProgramme<Eigen::MatrixXd> qp;
            qp.P = Eigen::MatrixXd::Zero(n, n);
            qp.q = Eigen::VectorXd::Zero(n);
            std::vector<double> target(out.size());
            for (Eigen::Index l = 0; l < n; ++l) {
                const double at = (to_->bands()[static_cast<std::size_t>(l)] - from.front()) / raster_nm;
                const double value = stored[static_cast<std::size_t>(std::lround(at))];
                target[static_cast<std::size_t>(l)] = value;
                qp.P(l, l) += closeness;
                qp.q[l] -= closeness * value;
            }
            for (std::size_t k = 0; k < rows_.size(); ++k) {
                const Eigen::Vector3d xyz = truth_->relit[k].col(static_cast<Eigen::Index>(vertex));
                const Eigen::MatrixXd slope = lab_slope(xyz, truth_->whites[k]) * rows_[k];
                const Eigen::Vector3d lab = lab_slope(xyz, truth_->whites[k]) * xyz;
                qp.P += slope.transpose() * slope;
                qp.q -= slope.transpose() * lab;
            }
            qp.C = Eigen::MatrixXd(3, n);
            qp.d = Eigen::Vector3d(rgb[0], rgb[1], rgb[2]);
            for (Eigen::Index c = 0; c < 3; ++c)
                for (Eigen::Index l = 0; l < n; ++l) qp.C(c, l) = to_->sensing_matrix()[static_cast<std::size_t>(c * n + l)];
            qp.lower = Eigen::VectorXd::Zero(n);
            qp.upper = Eigen::VectorXd::Ones(n);
            // The interior point alone: what it leaves of the colour, the nearest metamer takes away.
            const auto solved = solvers::solve_quadratic_programme(qp, {60, 1e-8, false});
            if (solved)
                for (Eigen::Index l = 0; l < n; ++l) target[static_cast<std::size_t>(l)] = std::clamp(solved->x[l], 0.0, 1.0);
            const std::vector<double> mobility(out.size(), 1.0);
            possible = solvers::nearest_metamer(to_->sensing_matrix(), target, mobility, rgb, out);
        }
        if (!possible) return std::nullopt;
        const Eigen::Map<const Eigen::VectorXd> r(out.data(), n);
        double worst = 0;
        for (std::size_t k = 0; k < rows_.size(); ++k) {
            const Eigen::Vector3d got = rows_[k] * r, expected = truth_->relit[k].col(static_cast<Eigen::Index>(vertex));
            worst = std::max(worst, delta_e76(lab_from_xyz({expected[0], expected[1], expected[2]}, truth_->whites[k]),
                                              lab_from_xyz({got[0], got[1], got[2]}, truth_->whites[k])));
        }
        return worst;
    }

private:
    Fitter(const Truth& truth, const Colorimetry& to) : truth_(&truth), to_(&to) {}
    const Truth* truth_;
    const Colorimetry* to_;
    std::vector<Eigen::MatrixXd> rows_;
};

/// Largest CIE76 of the colours between a model and the reference: round trip and lights.
Result<double> worst_color(const Model& model, const std::shared_ptr<const Model>& shared, const Truth& truth,
                           const std::vector<Illuminant>& lights, std::span<const float> rgb) {
    RelightRequest request;
    request.observer = model.colorimetry().observer().id;
    request.illuminants = lights;
    const auto a = RelightPlan::for_model(truth.model, request), b = RelightPlan::for_model(shared, request);
    if (!a) return a.error();
    if (!b) return b.error();
    const std::size_t n = rgb.size() / 3, images = lights.size();
    const auto planes_of = [&](const Model& m) {
        std::vector<double> colors(rgb.begin(), rgb.end()), coefficients(n * static_cast<std::size_t>(m.info().coefficients));
        m.coefficients(colors, coefficients);
        const std::size_t each = coefficients.size() / n;
        std::vector<std::vector<float>> planes(each, std::vector<float>(n));
        for (std::size_t i = 0; i < each; ++i)
            for (std::size_t p = 0; p < n; ++p) planes[i][p] = static_cast<float>(coefficients[p * each + i]);
        return planes;
    };
    const auto run = [&](const RelightPlan& plan, const std::vector<std::vector<float>>& in, std::vector<std::vector<float>>& out,
                         std::size_t images_out) {
        std::vector<const float*> inputs;
        std::vector<float*> outputs;
        for (const auto& p : in) inputs.push_back(p.data());
        out.assign(3 * images_out, std::vector<float>(n));
        for (auto& p : out) outputs.push_back(p.data());
        plan.execute(inputs, n, outputs);
    };
    const auto pa = planes_of(*truth.model), pb = planes_of(model);
    std::vector<std::vector<float>> ra, rb, ta, tb;
    run(*a, pa, ra, images);
    run(*b, pb, rb, images);
    run(RelightPlan::as_stored(truth.model, false), pa, ta, 1);
    run(RelightPlan::as_stored(shared, false), pb, tb, 1);
    double worst = 0;
    std::vector<float> difference(n);
    const auto take = [&](const DifferenceKernel& kernel, const std::vector<std::vector<float>>& x,
                          const std::vector<std::vector<float>>& y, std::size_t k) {
        kernel({x[3 * k].data(), x[3 * k + 1].data(), x[3 * k + 2].data()}, {y[3 * k].data(), y[3 * k + 1].data(), y[3 * k + 2].data()},
               n, difference.data());
        for (const float d : difference) worst = std::isfinite(d) ? std::max(worst, static_cast<double>(d)) : impossible;
    };
    const auto& own = truth.model->colorimetry();
    take(DifferenceKernel(Metric::cie76, own.rgb_to_xyz(), own.rgb_to_xyz(), own.white_xyz()), ta, tb, 0);
    for (std::size_t k = 0; k < images; ++k)
        take(DifferenceKernel(Metric::cie76, truth.to_xyz, truth.to_xyz, truth.whites[k]), ra, rb, k);
    return worst;
}

/// Vertices of the cells that the colours lie in, at most `judged_vertices`, each next one farthest from those before.
std::vector<std::size_t> touched_vertices(const LatticeTable& table, std::span<const float> rgb) {
    const std::array<std::size_t, 3> size{table.knots[0].size(), table.knots[1].size(), table.knots[2].size()};
    std::vector<bool> touched(size[0] * size[1] * size[2], false);
    for (std::size_t p = 0; p + 2 < rgb.size(); p += 3) {
        std::array<std::size_t, 3> cell;
        for (std::size_t c = 0; c < 3; ++c) {
            const auto& knots = table.knots[c];
            cell[c] = static_cast<std::size_t>(std::upper_bound(knots.begin() + 1, knots.end() - 1, static_cast<double>(rgb[p + c])) -
                                               knots.begin()) - 1;
        }
        for (std::size_t corner = 0; corner < 8; ++corner)
            touched[((cell[0] + (corner & 1)) * size[1] + cell[1] + (corner >> 1 & 1)) * size[2] + cell[2] + (corner >> 2)] = true;
    }
    std::vector<std::size_t> left, chosen{touched.size() - 1};
    for (std::size_t v = 1; v + 1 < touched.size(); ++v)
        if (touched[v]) left.push_back(v);
    while (chosen.size() < judged_vertices && !left.empty()) {
        std::size_t best = 0;
        double farthest = -1;
        for (std::size_t i = 0; i < left.size(); ++i) {
            double nearest = 9;
            for (const std::size_t v : chosen) {
                const Vector3 a = registry::vertex_color(table, left[i]), b = registry::vertex_color(table, v);
                nearest = std::min(nearest, (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]));
            }
            if (nearest > farthest) farthest = nearest, best = i;
        }
        chosen.push_back(left[best]);
        left.erase(left.begin() + static_cast<std::ptrdiff_t>(best));
    }
    return chosen;
}

}  // namespace

Result<BandChoice> choose_bands(std::string_view method, const ColorimetrySpec& spec, const std::vector<Illuminant>& lights,
                                double bound, std::span<const float> rgb, std::size_t least) {
    const auto master = Colorimetry::make(spec, BandSet());
    if (!master) return master.error();
    auto reference = make_model(method, *master);
    if (!reference) return std::move(reference).error();
    Truth truth{*reference, {}, {}, {}};
    const auto output = Colorimetry::make({spec.observer, "", "BT.709", RgbMatrix::integrated}, BandSet());
    if (!output) return output.error();
    truth.to_xyz = output->rgb_to_xyz();
    const auto* table = truth.model->lattice();
    for (const auto& light : lights) {
        const auto weights = tristimulus_weights(BandSet(), master->observer(), light, Normalization::luminance);
        if (!weights) return weights.error();
        truth.whites.push_back(weights->white);
        if (!table) continue;
        const auto rows = relit_xyz(master->observer(), BandSet(), light, truth.to_xyz);
        if (!rows) return rows.error();
        const Eigen::Map<const Eigen::MatrixXd> vertices(table->vertices.data(), static_cast<Eigen::Index>(table->values),
                                                         static_cast<Eigen::Index>(table->vertices.size() / table->values));
        truth.relit.push_back(*rows * vertices);
    }
    BandChoice choice;
    choice.reference = truth.model;
    choice.colors = rgb.size() / 3;
    const auto nothing = [&] {
        return Error{ErrorKind::input, fmt::format("no set of {} bands or fewer shows this texture within a CIE76 of {:g} under these "
                                                   "lights: expected a larger --max-error, or --bands {}:{}:{}",
                                                   most_bands, bound, first_nm, last_nm, raster_nm)};
    };

    if (method != "lattice") {
        for (std::size_t n = std::max<std::size_t>(least, fewest_bands); n <= most_bands; ++n) {
            const auto bands = BandSet::parse(std::to_string(n));
            if (!bands) return bands.error();
            const auto to = Colorimetry::make(spec, *bands);
            if (!to) return to.error();
            const auto model = make_model(method, *to);
            if (!model) continue;  // few bands have no primaries
            const auto error = worst_color(**model, *model, truth, lights, rgb);
            if (!error) return error.error();
            if (*error > bound) continue;
            choice.model = *model;
            choice.error = *error;
            return choice;
        }
        return nothing();
    }

    const auto judged = touched_vertices(*table, rgb);
    const auto cost = [&](const std::vector<double>& nm) {
        const auto bands = BandSet::make(nm);
        const auto to = bands ? Colorimetry::make(spec, *bands) : Result<Colorimetry>(bands.error());
        if (!to) return impossible;
        const auto fitter = Fitter::make(truth, *to, lights);
        if (!fitter) return impossible;
        std::vector<double> errors(judged.size());
        parallel_for(std::size_t{0}, judged.size(), [&](std::size_t i) {
            std::vector<double> r(nm.size());
            errors[i] = fitter->fit(judged[i], r).value_or(impossible);
        });
        double sum = 0;
        for (const double e : errors) sum += e * e * e * e;
        return std::pow(sum / static_cast<double>(errors.size()), 0.25);
    };
    std::vector<double> nm{400, 450, 530, 610, 680};
    double now = cost(nm);
    for (;;) {
        for (bool better = true; better;) {
            better = false;
            for (std::size_t i = 0; i < nm.size(); ++i)
                for (const double step : {-20.0, -5.0, 5.0, 20.0}) {
                    auto moved = nm;
                    moved[i] += step;
                    if (moved[i] < (i == 0 ? first_nm : nm[i - 1] + raster_nm) ||
                        moved[i] > (i + 1 == nm.size() ? last_nm : nm[i + 1] - raster_nm))
                        continue;
                    // A hundredth at least, so that the search ends soon.
                    if (const double c = cost(moved); c < 0.99 * now) nm = moved, now = c, better = true;
                }
        }
        // A mean of judged vertices is far below the worst colour only where it cannot matter.
        if (nm.size() >= least && now <= bound) {
            const auto bands = BandSet::make(nm);
            if (!bands) return bands.error();
            const auto to = Colorimetry::make(spec, *bands);
            if (!to) return to.error();
            const auto fitter = Fitter::make(truth, *to, lights);
            if (!fitter) return fitter.error();
            LatticeTable fitted{table->knots, nm.size(), std::vector<double>(static_cast<std::size_t>(truth.relit[0].cols()) * nm.size())};
            // A vertex without a reflectance keeps the nearest one; colours that need it show in what follows.
            parallel_for(std::size_t{0}, static_cast<std::size_t>(truth.relit[0].cols()), [&](std::size_t v) {
                (void)fitter->fit(v, {&fitted.vertices[v * nm.size()], nm.size()});
            });
            const std::shared_ptr<const Model> model = std::make_shared<FittedLattice>(truth.model->info(), *to, std::move(fitted), lights);
            const auto error = worst_color(*model, model, truth, lights, rgb);
            if (!error) return error.error();
            if (*error <= bound) {
                choice.model = model;
                choice.error = *error;
                return choice;
            }
        }
        if (nm.size() >= most_bands) return nothing();
        std::vector<double> best;
        double lowest = INFINITY;
        for (std::size_t gap = 0; gap <= nm.size(); ++gap) {
            const double low = gap == 0 ? first_nm - raster_nm : nm[gap - 1], high = gap == nm.size() ? last_nm + raster_nm : nm[gap];
            const double middle = std::round((low + high) / 2 / raster_nm) * raster_nm;
            if (middle <= low || middle >= high) continue;
            auto grown = nm;
            grown.insert(grown.begin() + static_cast<std::ptrdiff_t>(gap), middle);
            if (const double c = cost(grown); c < lowest) best = grown, lowest = c;
        }
        if (best.empty()) return nothing();
        nm = best;
        now = lowest;
    }
}

}  // namespace spectex
