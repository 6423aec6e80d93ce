// Otsu, Yamamoto and Hachisuka, 'Reproducing Spectral Reflectances From Tristimulus Colours', Computer Graphics Forum 37(6), 2018,
// doi:10.1111/cgf.13332.
//
// Measured reflectances are divided by chromaticity: a binary tree of splits at one x or y, at each step the split of one leaf
// that lowers the samples' reconstruction error most. Each leaf has a mean and three principal components, whose weights follow
// from the tristimulus: exact, until the spectrum is clamped to [0,1].
//
// Trees and components are learnt on the library's 5 nm grid and interpolated to other bands, where the weights are solved
// anew. The clamp is not part of the error that the tree lowers. A leaf keeps at least 20 samples, with which sets that were
// left out are predicted best: mean CIEDE2000 1.18, against 1.20 with 10, 1.25 with 40 and 1.30 without clusters.
#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <optional>

#include "methods/registry.h"

namespace spectex::registry {
namespace {

constexpr std::size_t most_leaves = 8;  ///< as published
constexpr Eigen::Index least_samples = 20;
constexpr Eigen::Index split_candidates = 64;  ///< per axis, evenly spaced in rank
/// Components of all samples together in which splits are compared; what is left is 1e-4 of the variance.
constexpr Eigen::Index reduced = 12;

struct Node {
    int axis = -1;  ///< 0 x, 1 y, -1 a leaf
    double threshold = 0;
    std::size_t below = 0, above = 0;  ///< nodes, of a split; below is the leaf's number, of a leaf
};

/// Learnt, on the 5 nm grid.
struct Clusters {
    std::vector<Node> nodes;      ///< the root first
    std::vector<double> spectra;  ///< [leaves][4][bands]: mean and components
    std::size_t leaves() const { return (nodes.size() + 1) / 2; }
};

/// A leaf solved for a sensing matrix: before the clamp, r = offset + gain rgb.
struct Affine {
    std::vector<double> offset, gain;  ///< [bands], [bands][3]
};

/// Reflectances of all samples whose colour lies in the cube.
struct Samples {
    Eigen::MatrixXd spectra;  ///< [bands][samples]
    Eigen::Matrix2Xd xy;
};

Result<Samples> gather(const Colorimetry& c, std::span<const SampleSet> sets) {
    const auto bands = static_cast<Eigen::Index>(c.bands().size());
    std::vector<std::vector<double>> kept;
    std::vector<std::array<double, 2>> xy;
    for (const SampleSet& set : sets)
        for (const auto& sample : set.samples) {
            const auto measured = SpectralDistribution::make(set.wavelengths_nm, sample);
            if (!measured) return Error{measured.error().kind, set.name + ": " + measured.error().message};
            auto r = measured->resampled(c.bands().wavelengths_nm(), Interpolation::linear, Extrapolation::hold);
            for (double& v : r) v = std::clamp(v, 0.0, 1.0);
            const Vector3 rgb = c.rgb_of(r), xyz = c.rgb_to_xyz() * rgb;
            const double sum = xyz[0] + xyz[1] + xyz[2];
            if (!(sum > 0) || !std::all_of(rgb.begin(), rgb.end(), [](double v) { return v >= 0 && v <= 1; })) continue;
            kept.push_back(std::move(r));
            xy.push_back({xyz[0] / sum, xyz[1] / sum});
        }
    if (static_cast<Eigen::Index>(kept.size()) < 4)
        return Error{ErrorKind::input, fmt::format("otsu2018: {} measured reflectances have a colour inside the cube, expected 4 or more", kept.size())};
    Samples out;
    out.spectra.resize(bands, static_cast<Eigen::Index>(kept.size()));
    out.xy.resize(2, out.spectra.cols());
    for (Eigen::Index i = 0; i < out.spectra.cols(); ++i) {
        const auto k = static_cast<std::size_t>(i);
        out.spectra.col(i) = Eigen::Map<const Eigen::VectorXd>(kept[k].data(), bands);
        out.xy.col(i) = Eigen::Vector2d(xy[k][0], xy[k][1]);
    }
    return out;
}

/// Sums over samples, of which mean and scatter follow.
struct Moments {
    Eigen::VectorXd sum;
    Eigen::MatrixXd square;
    double count = 0;
    explicit Moments(Eigen::Index n) : sum(Eigen::VectorXd::Zero(n)), square(Eigen::MatrixXd::Zero(n, n)) {}
    void add(const Eigen::VectorXd& s) {
        sum += s;
        square += s * s.transpose();
        ++count;
    }
    Eigen::MatrixXd scatter() const { return square - sum * sum.transpose() / count; }
};

/// The sum of squared differences between samples and what their tristimulus brings back of them. @param sense  [3][n].
double reconstruction_error(const Moments& m, const Eigen::MatrixXd& sense) {
    const Eigen::MatrixXd scatter = m.scatter();
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(scatter);
    const Eigen::MatrixXd basis = solver.eigenvectors().rightCols(3);
    const Eigen::FullPivLU<Eigen::Matrix3d> seen(sense * basis);
    if (!seen.isInvertible()) return std::numeric_limits<double>::infinity();
    const Eigen::MatrixXd lost = Eigen::MatrixXd::Identity(scatter.rows(), scatter.rows()) - basis * seen.solve(sense);
    return (lost * scatter * lost.transpose()).trace();
}

struct Split {
    int axis = -1;
    double threshold = 0, gain = 0;
};

/// The best split of these samples, or none.
Split best_split(const std::vector<Eigen::Index>& members, const Eigen::MatrixXd& spectra, const Eigen::Matrix2Xd& xy,
                 const Eigen::MatrixXd& sense) {
    const auto count = static_cast<Eigen::Index>(members.size());
    Split best;
    if (count < 2 * least_samples) return best;
    Moments all(spectra.rows());
    for (const auto i : members) all.add(spectra.col(i));
    const double whole = reconstruction_error(all, sense);
    const Eigen::Index stride = std::max<Eigen::Index>(1, (count - 2 * least_samples) / split_candidates);
    for (int axis = 0; axis < 2; ++axis) {
        std::vector<Eigen::Index> order = members;
        std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return xy(axis, a) < xy(axis, b); });
        Moments low(spectra.rows());
        for (Eigen::Index k = 0; k + least_samples < count; ++k) {
            low.add(spectra.col(order[static_cast<std::size_t>(k)]));
            if (k + 1 < least_samples || (k + 1 - least_samples) % stride != 0) continue;
            const double at = xy(axis, order[static_cast<std::size_t>(k)]), next = xy(axis, order[static_cast<std::size_t>(k + 1)]);
            if (!(at < next)) continue;
            Moments high = all;
            high.sum -= low.sum;
            high.square -= low.square;
            high.count -= low.count;
            const double gain = whole - reconstruction_error(low, sense) - reconstruction_error(high, sense);
            // A threshold that its JSON keeps, and that lies between the two.
            if (gain > best.gain) best = {axis, at + (next - at) / 2, gain};
        }
    }
    return best;
}

Eigen::MatrixXd sensing(const Colorimetry& c) {
    using Rows = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>;
    return Eigen::Map<const Rows>(c.sensing_matrix().data(), 3, static_cast<Eigen::Index>(c.bands().size()));
}

/// Six digits of a spectrum, so that a model's JSON is small and brings back the very numbers.
double rounded(double v) { return std::round(v * 1e6) / 1e6; }

Result<Clusters> learn(const Colorimetry& working, std::span<const SampleSet> sets) {
    const auto gathered = gather(working, sets);
    if (!gathered) return gathered.error();
    const Eigen::MatrixXd& spectra = gathered->spectra;
    const Eigen::MatrixXd sense = sensing(working);
    // An orthonormal frame for all samples, their mean left in.
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(spectra * spectra.transpose());
    const Eigen::MatrixXd frame = solver.eigenvectors().rightCols(std::min(reduced, spectra.rows()));
    const Eigen::MatrixXd small = frame.transpose() * spectra, seen = sense * frame;

    struct Leaf {
        std::size_t node = 0;
        std::vector<Eigen::Index> members;
        Split split;
    };
    Clusters out;
    out.nodes.emplace_back();
    std::vector<Leaf> leaves(1);
    for (Eigen::Index i = 0; i < spectra.cols(); ++i) leaves[0].members.push_back(i);
    leaves[0].split = best_split(leaves[0].members, small, gathered->xy, seen);
    while (leaves.size() < most_leaves) {
        const auto at = std::max_element(leaves.begin(), leaves.end(), [](const Leaf& a, const Leaf& b) { return a.split.gain < b.split.gain; });
        if (!(at->split.gain > 0)) break;
        Leaf below{out.nodes.size(), {}, {}}, above{out.nodes.size() + 1, {}, {}};
        out.nodes[at->node] = {at->split.axis, at->split.threshold, below.node, above.node};
        out.nodes.resize(out.nodes.size() + 2);
        for (const auto i : at->members) (gathered->xy(at->split.axis, i) < at->split.threshold ? below : above).members.push_back(i);
        for (Leaf* leaf : {&below, &above}) leaf->split = best_split(leaf->members, small, gathered->xy, seen);
        *at = std::move(below);
        leaves.push_back(std::move(above));
    }
    for (std::size_t k = 0; k < leaves.size(); ++k) {
        out.nodes[leaves[k].node].below = k;
        Moments m(spectra.rows());
        for (const auto i : leaves[k].members) m.add(spectra.col(i));
        const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> components(m.scatter());
        // What rounding leaves of samples that are all alike.
        if (!(components.eigenvalues()[spectra.rows() - 3] > 1e-10 * m.square.trace()))
            return Error{ErrorKind::input, "otsu2018: the measured reflectances of a cluster differ in fewer than three ways"};
        for (Eigen::Index l = 0; l < spectra.rows(); ++l) out.spectra.push_back(rounded(m.sum[l] / m.count));
        for (Eigen::Index j = 1; j <= 3; ++j) {
            Eigen::VectorXd v = components.eigenvectors().col(spectra.rows() - j);
            // An eigenvector has no sign.
            if (v.sum() < 0) v = -v;
            for (Eigen::Index l = 0; l < v.size(); ++l) out.spectra.push_back(rounded(v[l]));
        }
    }
    return out;
}

Result<Colorimetry> working_colorimetry(const Colorimetry& c) {
    return Colorimetry::make({c.observer().id, "", c.rgb_space().name, c.matrix_kind()}, BandSet(), c.illuminant());
}

class ClusterModel final : public Model {
public:
    ClusterModel(const MethodInfo& info, const Colorimetry& colorimetry, Clusters clusters, std::vector<Affine> leaves)
        : Model(info, colorimetry), clusters_(std::move(clusters)), leaves_(std::move(leaves)) {
        const Vector3& w = colorimetry.white_xyz();
        white_ = {w[0] / (w[0] + w[1] + w[2]), w[1] / (w[0] + w[1] + w[2])};
    }

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
        Json tree = Json::array();
        for (const Node& node : clusters_.nodes) {
            if (node.axis < 0)
                tree.push_back(Json::array({node.below}));
            else
                tree.push_back(Json::array({node.axis, node.threshold, node.below, node.above}));
        }
        json["tree"] = std::move(tree);
        json["spectra"] = clusters_.spectra;
        return json.dump(-1, ' ', false, Json::error_handler_t::replace);
    }

private:
    /// @param band_of  the band that is the l-th of `bands`.
    template <class BandOf>
    void evaluate(std::size_t bands, const BandOf& band_of, std::span<const double> rgb, std::span<double> out) const {
        for (std::size_t p = 0; 3 * p + 2 < rgb.size(); ++p) {
            const Vector3 color{rgb[3 * p], rgb[3 * p + 1], rgb[3 * p + 2]};
            double* r = &out[p * bands];
            // Black has no chromaticity, and one reflectance.
            if (color[0] == 0 && color[1] == 0 && color[2] == 0) {
                std::fill_n(r, bands, 0.0);
                continue;
            }
            const Affine& leaf = leaves_[find(color)];
            for (std::size_t l = 0; l < bands; ++l) {
                const std::size_t b = band_of(l);
                const double* g = &leaf.gain[3 * b];
                r[l] = std::clamp(leaf.offset[b] + ((g[0] * color[0] + g[1] * color[1]) + g[2] * color[2]), 0.0, 1.0);
            }
        }
    }
    std::size_t find(const Vector3& rgb) const {
        const Vector3 xyz = colorimetry().rgb_to_xyz() * rgb;
        const double sum = xyz[0] + xyz[1] + xyz[2];
        // Below the smallest normal number a chromaticity has no digits.
        const bool seen = sum > std::numeric_limits<double>::min();
        const std::array<double, 2> xy{seen ? xyz[0] / sum : white_[0], seen ? xyz[1] / sum : white_[1]};
        const Node* node = &clusters_.nodes[0];
        while (node->axis >= 0)
            node = &clusters_.nodes[xy[static_cast<std::size_t>(node->axis)] < node->threshold ? node->below : node->above];
        return node->below;
    }

    Clusters clusters_;
    std::vector<Affine> leaves_;
    std::array<double, 2> white_{};
};

/// @param kind  of the error, where a leaf's components do not tell colours apart.
ModelResult build(const MethodInfo& info, const Colorimetry& colorimetry, Clusters clusters, ErrorKind kind) {
    const BandSet grid;
    const auto n = static_cast<Eigen::Index>(colorimetry.bands().size());
    const Eigen::MatrixXd sense = sensing(colorimetry);
    std::vector<Affine> leaves;
    for (std::size_t k = 0; k < clusters.leaves(); ++k) {
        Eigen::MatrixXd spectra(n, 4);
        for (std::size_t j = 0; j < 4; ++j) {
            const auto first = clusters.spectra.begin() + static_cast<std::ptrdiff_t>((4 * k + j) * grid.size());
            const auto learnt = SpectralDistribution::make(grid.wavelengths_nm(), {first, first + static_cast<std::ptrdiff_t>(grid.size())});
            if (!learnt) return learnt.error();
            const auto r = learnt->resampled(colorimetry.bands().wavelengths_nm(), Interpolation::linear, Extrapolation::hold);
            spectra.col(static_cast<Eigen::Index>(j)) = Eigen::Map<const Eigen::VectorXd>(r.data(), n);
        }
        Eigen::FullPivLU<Eigen::Matrix3d> seen;
        // Beyond it weights would have lost half their digits.
        seen.setThreshold(1e-8);
        seen.compute(sense * spectra.rightCols(3));
        if (!seen.isInvertible())
            return Error{kind, fmt::format("{}: the components of cluster {} do not tell colours apart ({})", info.id, k, colorimetry.describe())};
        const Eigen::MatrixXd gain = spectra.rightCols(3) * seen.inverse();
        const Eigen::VectorXd offset = spectra.col(0) - gain * (sense * spectra.col(0));
        Affine affine;
        for (Eigen::Index l = 0; l < n; ++l) {
            affine.offset.push_back(offset[l]);
            for (Eigen::Index c = 0; c < 3; ++c) affine.gain.push_back(gain(l, c));
        }
        leaves.push_back(std::move(affine));
    }
    return std::shared_ptr<const Model>(std::make_shared<ClusterModel>(info, colorimetry, std::move(clusters), std::move(leaves)));
}

ModelResult train(const MethodInfo& info, const Colorimetry& colorimetry, std::span<const SampleSet> sets) {
    const auto working = working_colorimetry(colorimetry);
    if (!working) return working.error();
    auto clusters = learn(*working, sets);
    if (!clusters) return std::move(clusters).error();
    return build(info, colorimetry, *std::move(clusters), ErrorKind::infeasible);
}

/// Learning takes a part of a second, once for each light, observer and space that a process has used last.
ModelResult make_clusters(const MethodInfo& info, const Colorimetry& colorimetry) {
    const auto working = working_colorimetry(colorimetry);
    if (!working) return working.error();
    static std::mutex mutex;
    static std::vector<std::pair<std::vector<double>, Clusters>> recent;  // latest last
    constexpr std::size_t most = 4;
    std::optional<Clusters> clusters;
    {
        const std::lock_guard lock(mutex);
        const auto found = std::find_if(recent.begin(), recent.end(), [&](const auto& r) { return r.first == working->sensing_matrix(); });
        if (found != recent.end()) {
            std::rotate(found, found + 1, recent.end());
        } else {
            const auto sets = lattice_sample_sets();
            if (!sets) return sets.error();
            auto learnt = learn(*working, *sets);
            if (!learnt) return std::move(learnt).error();
            if (recent.size() == most) recent.erase(recent.begin());
            recent.emplace_back(working->sensing_matrix(), *std::move(learnt));
        }
        clusters = recent.back().second;
    }
    return build(info, colorimetry, *std::move(clusters), ErrorKind::infeasible);
}

ModelResult read_clusters(const MethodInfo& info, const Colorimetry& colorimetry, const Json& json) {
    const auto wrong = [](std::string why) { return Error{ErrorKind::input, "model: member 'tree': " + why}; };
    const auto tree = json.find("tree");
    constexpr std::size_t most_nodes = 2 * most_leaves - 1;
    if (tree == json.end() || !tree->is_array() || tree->empty() || tree->size() > most_nodes)
        return wrong(fmt::format("expected a list of 1 to {} nodes", most_nodes));
    Clusters clusters;
    std::vector<bool> led(tree->size(), false), named(tree->size(), false);
    const auto number = [](const Json& entry, std::size_t below) {
        return entry.is_number_unsigned() && entry.get<std::uint64_t>() < below ? std::optional<std::size_t>(entry.get<std::size_t>()) : std::nullopt;
    };
    led[0] = true;
    for (std::size_t i = 0; i < tree->size(); ++i) {
        const Json& entry = (*tree)[i];
        Node node;
        if (entry.is_array() && entry.size() == 1) {
            const auto leaf = number(entry[0], (tree->size() + 1) / 2);
            if (!leaf || named[*leaf]) return wrong(fmt::format("node {} is no leaf of its own", i));
            node.below = *leaf;
            named[*leaf] = true;
        } else if (entry.is_array() && entry.size() == 4 && entry[1].is_number()) {
            const auto axis = number(entry[0], 2), below = number(entry[2], tree->size()), above = number(entry[3], tree->size());
            node.threshold = entry[1].get<double>();
            // Nodes lead onward, each is led to once: no way through the tree has a loop.
            if (!axis || !below || !above || *below <= i || *above <= i || *below == *above || led[*below] || led[*above] ||
                !(std::abs(node.threshold) <= 1))
                return wrong(fmt::format("node {} is no split", i));
            node.axis = static_cast<int>(*axis);
            node.below = *below;
            node.above = *above;
            led[*below] = led[*above] = true;
        } else {
            return wrong(fmt::format("node {} is neither a leaf nor a split", i));
        }
        clusters.nodes.push_back(node);
    }
    if (std::find(led.begin(), led.end(), false) != led.end()) return wrong("a node is led to by none");
    auto spectra = read_numbers(json, "spectra", clusters.leaves() * 4 * BandSet().size(), -1, 1);
    if (!spectra) return std::move(spectra).error();
    clusters.spectra = *std::move(spectra);
    auto made = build(info, colorimetry, std::move(clusters), ErrorKind::input);
    if (!made) return Error{ErrorKind::input, "model: member 'spectra': " + made.error().message};
    return made;
}

}  // namespace

Entry otsu2018() {
    MethodInfo info;
    info.id = "otsu2018";
    info.title = "Clustered principal components, clamped";
    info.source = "Otsu, Yamamoto and Hachisuka 2018, CGF 37(6), doi:10.1111/cgf.13332";
    info.pieces = Pieces::nonlinear;
    info.exact = false;
    info.bounded = true;
    return {std::move(info), make_clusters, read_clusters, train};
}

}  // namespace spectex::registry
