#include "plan/quadrature.h"


#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

#include "parallel.h"
#include "spectex/compare.h"

namespace spectex::plan {
namespace {

/// By how much the largest error of all colours may exceed the largest that was seen.
constexpr double safety = 2;
/// Beyond this share of the bands nothing worth a difference is saved.
constexpr double worthwhile = 0.8;
constexpr std::size_t cells = 12;

/// Colours on which a quadrature is fitted, or verified: corners or centres of cells that are even in the square root, and
/// others on the faces, edges and near black and white.
std::vector<double> family(bool verify) {
    std::vector<double> rgb;
    const std::size_t points = verify ? cells : cells + 1;
    const auto at = [&](std::size_t i) {
        const double t = (static_cast<double>(i) + (verify ? 0.5 : 0)) / cells;
        return t * t;
    };
    for (std::size_t r = 0; r < points; ++r)
        for (std::size_t g = 0; g < points; ++g)
            for (std::size_t b = 0; b < points; ++b) rgb.insert(rgb.end(), {at(r), at(g), at(b)});
    std::mt19937_64 random(verify ? 29 : 23);
    const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
    for (int i = 0; i < 1200; ++i) {
        double c[3];
        for (double& v : c) {
            v = uniform();
            v *= v;
        }
        // A face, an edge, or a dark or light colour, where CIELab and spectra are steep.
        const auto axis = random() % 3;
        const int kind = i % 4;
        if (kind < 2) c[axis] = random() % 2 ? 1 : 0;
        if (kind == 1) c[(axis + 1) % 3] = random() % 2 ? 1 : 0;
        if (kind == 2)
            for (double& v : c) v *= 0.02;
        if (kind == 3)
            for (double& v : c) v = 1 - 0.05 * v;
        rgb.insert(rgb.end(), c, c + 3);
    }
    return rgb;
}

/// [colours][bands]
Eigen::MatrixXd spectra_of(const Model& model, const std::vector<double>& rgb) {
    const std::size_t bands = model.colorimetry().bands().size(), n = rgb.size() / 3;
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> out(static_cast<Eigen::Index>(n), static_cast<Eigen::Index>(bands));
    constexpr std::size_t block = 128;
    parallel_for(std::size_t{0}, (n + block - 1) / block, [&](std::size_t part) {
        const std::size_t first = part * block, count = std::min(block, n - first);
        model.reflectance({&rgb[3 * first], 3 * count}, {out.data() + first * bands, count * bands});
    });
    return out;
}

/// The largest CIE76 of any colour under any light, and per colour.
double largest(const Eigen::MatrixXd& truth, const Eigen::MatrixXd& got, const Matrix3& to_xyz, const std::vector<Vector3>& whites,
               Eigen::VectorXd* each = nullptr) {
    double most = 0;
    for (Eigen::Index i = 0; i < truth.rows(); ++i) {
        double here = 0;
        for (std::size_t k = 0; k < whites.size(); ++k) {
            const auto j = static_cast<Eigen::Index>(3 * k);
            const auto lab = [&](const Eigen::MatrixXd& m) {
                return lab_from_xyz(to_xyz * Vector3{m(i, j), m(i, j + 1), m(i, j + 2)}, whites[k]);
            };
            here = std::max(here, delta_e76(lab(truth), lab(got)));
        }
        if (each) (*each)[i] = here;
        most = std::max(most, here);
    }
    return most;
}

}  // namespace

std::optional<Quadrature> choose_quadrature(const Model& model, std::span<const double> rows, const Matrix3& to_xyz, double bound) {
    const std::size_t bands = model.colorimetry().bands().size(), values = rows.size() / bands;
    if (!model.bands_apart() || !(bound > 0)) return std::nullopt;
    const auto n = static_cast<Eigen::Index>(bands);
    const Eigen::MatrixXd w =
        Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(rows.data(), static_cast<Eigen::Index>(values), n).transpose();
    std::vector<bool> weighs(bands);
    std::size_t weighing = 0;
    for (std::size_t b = 0; b < bands; ++b) {
        weighs[b] = w.row(static_cast<Eigen::Index>(b)).cwiseAbs().maxCoeff() > 0;
        weighing += weighs[b];
    }
    std::vector<Vector3> whites;
    const Eigen::VectorXd white = w.colwise().sum();
    for (std::size_t k = 0; k < values / 3; ++k) {
        const auto j = static_cast<Eigen::Index>(3 * k);
        whites.push_back(to_xyz * Vector3{white[j], white[j + 1], white[j + 2]});
    }
    const auto fitted_rgb = family(false), others_rgb = family(true);
    const Eigen::MatrixXd spectra = spectra_of(model, fitted_rgb), others = spectra_of(model, others_rgb);
    const Eigen::MatrixXd truth = spectra * w, others_truth = others * w;

    // CIELab is as steep as the -2/3 power of the luminance: errors count by it.
    Eigen::VectorXd counts(spectra.rows());
    for (Eigen::Index i = 0; i < spectra.rows(); ++i) {
        double y = 0;
        for (std::size_t k = 0; k < whites.size(); ++k) {
            const auto j = static_cast<Eigen::Index>(3 * k);
            y += (to_xyz * Vector3{truth(i, j), truth(i, j + 1), truth(i, j + 2)})[1] / whites[k][1];
        }
        counts[i] = 1 / std::pow(std::max(y / static_cast<double>(whites.size()), 0.0) + 0.002, 2.0 / 3);
    }
    Eigen::MatrixXd free = counts.asDiagonal() * spectra, left = counts.asDiagonal() * truth;
    std::vector<std::size_t> chosen;
    const auto most = static_cast<std::size_t>(worthwhile * static_cast<double>(weighing));
    while (chosen.size() < most) {
        // The band along which most of what is left of the integrals would vanish, beside the chosen ones.
        double best = 0;
        std::size_t at = bands;
        const Eigen::MatrixXd along = free.transpose() * left;
        for (std::size_t b = 0; b < bands; ++b) {
            const auto i = static_cast<Eigen::Index>(b);
            const double size = free.col(i).squaredNorm();
            if (!weighs[b] || std::find(chosen.begin(), chosen.end(), b) != chosen.end() || !(size > 1e-20)) continue;
            if (const double gain = along.row(i).squaredNorm() / size; gain > best) best = gain, at = b;
        }
        if (at == bands) break;
        chosen.push_back(at);
        const Eigen::VectorXd direction = free.col(static_cast<Eigen::Index>(at)).normalized();
        left -= direction * (direction.transpose() * left).eval();
        free -= direction * (direction.transpose() * free).eval();
        // What least squares leave is what is left: no weights are needed to see whether they may do. The largest error is
        // lowered further below, by a third or so.
        const Eigen::MatrixXd unweighted = truth - counts.cwiseInverse().asDiagonal() * left;
        if (safety * largest(truth, unweighted, to_xyz, whites) > 1.6 * bound) continue;

        Quadrature q;
        q.bands = chosen;
        std::sort(q.bands.begin(), q.bands.end());
        Eigen::MatrixXd some(spectra.rows(), static_cast<Eigen::Index>(q.bands.size())), others_some(others.rows(), some.cols());
        for (std::size_t k = 0; k < q.bands.size(); ++k) {
            some.col(static_cast<Eigen::Index>(k)) = spectra.col(static_cast<Eigen::Index>(q.bands[k]));
            others_some.col(static_cast<Eigen::Index>(k)) = others.col(static_cast<Eigen::Index>(q.bands[k]));
        }
        // Colours that err most count more in the next fit (Lawson 1961), which lowers the largest error.
        Eigen::VectorXd emphasis = counts, each(spectra.rows());
        double reached = HUGE_VAL;
        for (int turn = 0; turn < 6; ++turn) {
            const Eigen::MatrixXd weights = (emphasis.asDiagonal() * some).householderQr().solve(emphasis.asDiagonal() * truth);
            double error = largest(truth, some * weights, to_xyz, whites, &each);
            error = std::max(error, largest(others_truth, others_some * weights, to_xyz, whites));
            if (error < reached) {
                reached = error;
                q.weights.assign(values * q.bands.size(), 0);
                for (std::size_t j = 0; j < values; ++j)
                    for (std::size_t k = 0; k < q.bands.size(); ++k)
                        q.weights[j * q.bands.size() + k] = weights(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(j));
            }
            if (safety * reached <= bound) break;
            emphasis = emphasis.cwiseProduct((each.array() / each.mean() + 0.1).sqrt().matrix());
        }
        if (!(safety * reached <= bound)) continue;
        q.error = safety * reached;
        q.colors = static_cast<std::size_t>(spectra.rows() + others.rows());
        return q;
    }
    return std::nullopt;
}

}  // namespace spectex::plan
