#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <vector>

#include <Eigen/Dense>
#include <nlohmann/json.hpp>

#include "method_checks.h"
#include "reference.h"
#include "spectex/solvers.h"

using namespace method_checks;
using Json = nlohmann::ordered_json;

namespace {

#ifdef SPECTEX_SLOW_BUILD
constexpr std::size_t many = 300;
constexpr std::array thresholds{0.32};
#else
constexpr std::size_t many = 5000;
constexpr std::array thresholds{0.26, 0.3, 0.32, 0.34, 0.38, 0.42};
#endif

class Otsu : public testing::TestWithParam<const char*> {};

TEST_P(Otsu, ErrsOnlyWhereItClamps) {
    const auto m = model("otsu2018", colorimetry(GetParam()));
    ASSERT_TRUE(m);
    EXPECT_FALSE(m->info().exact);
    EXPECT_TRUE(m->info().bounded);
    const std::size_t n = m->colorimetry().bands().size();
    const auto& a = m->colorimetry().sensing_matrix();
    std::size_t clamped = 0, exact = 0;
    for (const auto& rgb : colors(many)) {
        const auto r = spectrum(*m, rgb);
        bool any = false;
        for (const double v : r) {
            ASSERT_TRUE(v >= 0 && v <= 1);
            any = any || v == 0 || v == 1;
        }
        if (any) {
            ++clamped;
            continue;
        }
        ++exact;
        for (std::size_t c = 0; c < 3; ++c) {
            reference::Real sum = 0;
            for (std::size_t l = 0; l < n; ++l) sum += static_cast<reference::Real>(a[c * n + l]) * r[l];
            // Three components whose 3x3 system has a condition of some hundreds.
            ASSERT_NEAR(static_cast<double>(sum), rgb[c], 1e-12);
        }
    }
    printf("otsu2018 %-10s clamps %zu of %zu\n", GetParam(), clamped, clamped + exact);
    EXPECT_GT(clamped, many / 50);
    EXPECT_GT(exact, many / 50);
    for (const double v : spectrum(*m, {0, 0, 0})) EXPECT_EQ(v, 0.0);
}

INSTANTIATE_TEST_SUITE_P(Otsu2018, Otsu, testing::Values("380:780:5", "380:780:20", "36", "400:700:10"));

/// Measured reflectances inside the cube, and their chromaticities.
struct Measured {
    std::vector<Eigen::VectorXd> r;
    std::vector<std::array<double, 2>> xy;
};
Measured measured(const Colorimetry& c) {
    Measured out;
    const auto sets = lattice_sample_sets().value();
    for (const auto& set : sets)
        for (const auto& sample : set.samples) {
            auto v = SpectralDistribution::make(set.wavelengths_nm, sample).value().resampled(c.bands().wavelengths_nm(), Interpolation::linear,
                                                                                           Extrapolation::hold);
            for (double& x : v) x = std::clamp(x, 0.0, 1.0);
            const Vector3 rgb = c.rgb_of(v), xyz = c.rgb_to_xyz() * rgb;
            if (*std::min_element(rgb.begin(), rgb.end()) < 0 || *std::max_element(rgb.begin(), rgb.end()) > 1) continue;
            out.r.emplace_back(Eigen::Map<const Eigen::VectorXd>(v.data(), static_cast<Eigen::Index>(v.size())));
            const double sum = xyz[0] + xyz[1] + xyz[2];
            out.xy.push_back({xyz[0] / sum, xyz[1] / sum});
        }
    return out;
}

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// The three singular vectors of the largest singular values, by rotating rows until all are orthogonal.
/// Source: Hestenes 1958, doi:10.1137/0106005; none of Eigen's decompositions, which the library uses.
Eigen::MatrixXd leading_three(RowMajor rows) {
    const Eigen::Index n = rows.rows();
    RowMajor turned = RowMajor::Identity(n, n);
    // Rows without power have no direction to speak of.
    const double least = 1e-20 * rows.squaredNorm();
    double off = 1;
    // Converges quadratically, and what is compared is kept with six digits.
    for (int sweep = 0; off > 1e-9 && sweep < 40; ++sweep) {
        off = 0;
        for (Eigen::Index i = 0; i < n; ++i)
            for (Eigen::Index j = i + 1; j < n; ++j) {
                const double a = rows.row(i).squaredNorm(), b = rows.row(j).squaredNorm(), c = rows.row(i).dot(rows.row(j));
                if (std::min(a, b) < least || !(std::abs(c) > 1e-15 * std::sqrt(a * b))) continue;
                off = std::max(off, std::abs(c) / std::sqrt(a * b));
                const double zeta = (b - a) / (2 * c), t = std::copysign(1 / (std::abs(zeta) + std::hypot(1.0, zeta)), zeta);
                const double cosine = 1 / std::hypot(1.0, t), sine = cosine * t;
                for (RowMajor* m : {&rows, &turned}) {
                    const Eigen::RowVectorXd first = m->row(i);
                    m->row(i) = cosine * first - sine * m->row(j);
                    m->row(j) = sine * first + cosine * m->row(j);
                }
            }
    }
    EXPECT_LE(off, 1e-9);
    std::vector<Eigen::Index> order(static_cast<std::size_t>(n));
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](auto i, auto j) { return rows.row(i).squaredNorm() > rows.row(j).squaredNorm(); });
    Eigen::MatrixXd out(n, 3);
    for (Eigen::Index k = 0; k < 3; ++k) out.col(k) = turned.row(order[static_cast<std::size_t>(k)]).transpose();
    return out;
}

/// Errors of reconstructing these samples, one by one, by components of a decomposition of their scatter.
double error_of(const std::vector<const Eigen::VectorXd*>& samples, const Eigen::MatrixXd& sense, std::vector<Eigen::VectorXd>* back = nullptr) {
    Eigen::MatrixXd x(samples[0]->size(), static_cast<Eigen::Index>(samples.size()));
    for (std::size_t i = 0; i < samples.size(); ++i) x.col(static_cast<Eigen::Index>(i)) = *samples[i];
    const Eigen::VectorXd mean = x.rowwise().mean();
    x.colwise() -= mean;
    const Eigen::MatrixXd basis = leading_three(x.lazyProduct(x.transpose()));
    const Eigen::Matrix3d seen = sense.lazyProduct(basis);
    const Eigen::Matrix3Xd weights = seen.inverse().lazyProduct(sense.lazyProduct(x).eval());
    const Eigen::MatrixXd guess = basis.lazyProduct(weights);
    if (back)
        for (Eigen::Index i = 0; i < x.cols(); ++i) back->push_back(mean + guess.col(i));
    return (x - guess).squaredNorm();
}

TEST(Otsu2018, LeavesHaveTheComponentsOfTheirSamplesAndTheFirstSplitPays) {
    const auto c = colorimetry();
    const auto m = model("otsu2018", c);
    ASSERT_TRUE(m);
    const Json tree = Json::parse(m->to_json())["tree"];
    ASSERT_EQ(tree.size() % 2, 1u);
    ASSERT_GT(tree.size(), 1u);
    EXPECT_LE(tree.size(), 15u);
    const auto samples = measured(c);
    using Rows = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>;
    const Eigen::MatrixXd sense = Eigen::Map<const Rows>(c.sensing_matrix().data(), 3, 81);
    std::vector<std::vector<const Eigen::VectorXd*>> leaves((tree.size() + 1) / 2);
    const auto side = [&](std::size_t i, const Json& node) { return samples.xy[i][node[0].get<std::size_t>()] < node[1].get<double>(); };
    for (std::size_t i = 0; i < samples.r.size(); ++i) {
        std::size_t at = 0;
        while (tree[at].size() == 4) at = tree[at][side(i, tree[at]) ? 2 : 3].get<std::size_t>();
        leaves[tree[at][0].get<std::size_t>()].push_back(&samples.r[i]);
    }
    double split_error = 0;
    for (const auto& leaf : leaves) {
        EXPECT_GE(leaf.size(), 20u);
        std::vector<Eigen::VectorXd> back;
        split_error += error_of(leaf, sense, &back);
        for (std::size_t i = 0; i < leaf.size(); i += 7) {
            const std::vector<double> r(leaf[i]->data(), leaf[i]->data() + 81);
            const auto predicted = spectrum(*m, c.rgb_of(r));
            // Components are kept with six digits, and weights are a few times the spectrum.
            for (std::size_t l = 0; l < 81; ++l) ASSERT_NEAR(predicted[l], std::clamp(back[i][static_cast<Eigen::Index>(l)], 0.0, 1.0), 2e-4);
        }
    }
    std::vector<const Eigen::VectorXd*> all;
    for (const auto& r : samples.r) all.push_back(&r);
    const double whole = error_of(all, sense);
    const auto error_when_split = [&](std::size_t axis, double threshold) {
        std::vector<const Eigen::VectorXd*> below, above;
        for (std::size_t i = 0; i < samples.r.size(); ++i) (samples.xy[i][axis] < threshold ? below : above).push_back(&samples.r[i]);
        return below.size() < 20 || above.size() < 20 ? HUGE_VAL : error_of(below, sense) + error_of(above, sense);
    };
    const double first = error_when_split(tree[0][0].get<std::size_t>(), tree[0][1].get<double>());
    EXPECT_LT(split_error, first);
    EXPECT_LT(first, whole);
    for (const std::size_t axis : {std::size_t{0}, std::size_t{1}})
        for (const double at : thresholds)
            // The solver tries one threshold in several and looks at twelve components: a percent is left to that.
            EXPECT_GE(error_when_split(axis, at), 0.99 * first) << axis << " " << at;
}

TEST(Otsu2018, LearnsFromWhatItIsGivenAndTheSameTwice) {
    const auto c = colorimetry("380:780:10");
    auto sets = lattice_sample_sets().value();
    sets.resize(2);
    const auto a = train_model("otsu2018", c, sets), b = train_model("otsu2018", c, sets);
    ASSERT_TRUE(a && b);
    EXPECT_EQ((*a)->to_json(), (*b)->to_json());
    EXPECT_NE((*a)->to_json(), model("otsu2018", c)->to_json());
    expect_round_trip(**a);
    // Too few for a split, and for components.
    SampleSet few = sets[0];
    few.samples.resize(30);
    const auto small = train_model("otsu2018", c, std::vector{few});
    ASSERT_TRUE(small) << small.error().message;
    EXPECT_EQ(Json::parse((*small)->to_json())["tree"].size(), 1u);
    few.samples.resize(2);
    const auto none = train_model("otsu2018", c, std::vector{few});
    ASSERT_FALSE(none);
    EXPECT_EQ(none.error().kind, ErrorKind::input);
    few.samples.assign(10, few.samples[0]);
    EXPECT_FALSE(train_model("otsu2018", c, std::vector{few})) << "ten times one spectrum has no components";
}

TEST(Otsu2018, JsonIsReadWithSuspicion) {
    const auto m = model("otsu2018", colorimetry("380:780:20"));
    ASSERT_TRUE(m);
    expect_round_trip(*m);
    EXPECT_EQ(coefficient_difference(*m, colors(50)), 0.0);
    const Json good = Json::parse(m->to_json());
    const auto refused = [&](const char* names, auto&& change) {
        Json json = good;
        change(json);
        const auto read = make_model_from_json(json.dump());
        ASSERT_FALSE(read) << names;
        EXPECT_EQ(read.error().kind, ErrorKind::input);
        EXPECT_NE(read.error().message.find(names), std::string::npos) << read.error().message;
    };
    const std::size_t nodes = good["tree"].size();
    std::size_t leaf = 0;
    while (good["tree"][leaf].size() == 4) ++leaf;
    refused("tree", [](Json& j) { j.erase("tree"); });
    refused("tree", [](Json& j) { j["tree"] = Json::array(); });
    refused("tree", [](Json& j) { j["tree"][0][2] = 0; });
    refused("tree", [](Json& j) { j["tree"][0][2] = -1; });
    refused("tree", [](Json& j) { j["tree"][0][3] = j["tree"][0][2]; });
    refused("tree", [](Json& j) { j["tree"][0][0] = 2; });
    refused("tree", [](Json& j) { j["tree"][0][1] = 2; });
    refused("tree", [](Json& j) { j["tree"][0][1] = nullptr; });
    refused("tree", [&](Json& j) { j["tree"][0][3] = nodes; });
    refused("tree", [&](Json& j) { j["tree"][leaf][0] = nodes; });
    refused("tree", [&](Json& j) { j["tree"][leaf] = "leaf"; });
    refused("tree", [&](Json& j) { j["tree"][0] = Json::array({0}); });
    refused("tree", [](Json& j) { for (int i = 0; i < 20; ++i) j["tree"].push_back(Json::array({0})); });
    refused("spectra", [](Json& j) { j.erase("spectra"); });
    refused("spectra", [](Json& j) { j["spectra"].push_back(0); });
    refused("spectra", [](Json& j) { j["spectra"][5] = 2; });
    refused("spectra", [](Json& j) { for (auto& v : j["spectra"]) v = 0.5; });
}

}  // namespace
