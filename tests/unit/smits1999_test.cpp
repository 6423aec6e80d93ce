#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "kernels/lattice.h"
#include "method_checks.h"
#include "reference.h"

using namespace method_checks;
using Json = nlohmann::ordered_json;

namespace {

/// The procedure as the paper tells it, case by case.
std::vector<double> procedure(const std::vector<std::vector<double>>& spectra, const Vector3& rgb) {
    enum { white, cyan, magenta, yellow, red, green, blue };
    std::vector<double> r(spectra[0].size(), 0.0);
    const auto add = [&](double amount, int which) {
        for (std::size_t l = 0; l < r.size(); ++l) r[l] += amount * spectra[static_cast<std::size_t>(which)][l];
    };
    const auto rest = [&](std::size_t least, std::size_t one, std::size_t two, int secondary, int primary_one, int primary_two) {
        add(rgb[least], white);
        const std::size_t less = rgb[one] <= rgb[two] ? one : two, more = less == one ? two : one;
        add(rgb[less] - rgb[least], secondary);
        add(rgb[more] - rgb[less], more == one ? primary_one : primary_two);
    };
    if (rgb[0] <= rgb[1] && rgb[0] <= rgb[2]) rest(0, 1, 2, cyan, green, blue);
    else if (rgb[1] <= rgb[0] && rgb[1] <= rgb[2]) rest(1, 0, 2, magenta, red, blue);
    else rest(2, 0, 1, yellow, red, green);
    return r;
}

std::vector<std::vector<double>> seven(const Model& m) {
    std::vector<std::vector<double>> out;
    for (const Vector3& rgb : {Vector3{1, 1, 1}, {0, 1, 1}, {1, 0, 1}, {1, 1, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}})
        out.push_back(spectrum(m, rgb));
    return out;
}

TEST(Smits1999, IsThePublishedProcedure) {
    for (const char* id : {"smits1999", "smits1999:exact"}) {
        const auto m = model(id, colorimetry());
        ASSERT_TRUE(m);
        EXPECT_EQ(m->info().pieces, Pieces::tetrahedral);
        ASSERT_NE(m->lattice(), nullptr);
        const auto spectra = seven(*m);
        for (const auto& rgb : colors(2000)) {
            const auto expected = procedure(spectra, rgb), r = spectrum(*m, rgb);
            // Four products and three sums of numbers below 1.02, twice.
            for (std::size_t l = 0; l < r.size(); ++l) ASSERT_NEAR(r[l], expected[l], 2e-15) << id;
        }
    }
}

TEST(Smits1999, KernelMakesTheSameSpectra) {
    const auto m = model("smits1999:exact", colorimetry("380:780:20"));
    ASSERT_TRUE(m);
    const kernels::LatticeKernel kernel(*m->lattice());
    const auto list = colors(500);
    std::array<std::vector<float>, 3> rgb;
    for (const auto& c : list)
        for (std::size_t k = 0; k < 3; ++k) rgb[k].push_back(static_cast<float>(c[k]));
    std::vector<std::vector<double>> planes(21, std::vector<double>(list.size()));
    std::vector<double*> out;
    for (auto& p : planes) out.push_back(p.data());
    kernel({rgb[0].data(), rgb[1].data(), rgb[2].data()}, list.size(), out.data());
    for (std::size_t i = 0; i < list.size(); ++i) {
        const auto r = spectrum(*m, {rgb[0][i], rgb[1][i], rgb[2][i]});
        for (std::size_t l = 0; l < 21; ++l) ASSERT_NEAR(planes[l][i], r[l], 1e-15);
    }
}

TEST(Smits1999, TableIsReadIntoBands) {
    const auto file = reference::read_csv(std::string(SPECTEX_LUTS_SOURCE) + "/models/smits1999_published.csv");
    // Bins of 34 nm about the centres: bands well inside a bin have its value, those on a border the mean of both.
    const auto m = model("smits1999", colorimetry("380:780:1"));
    ASSERT_TRUE(m);
    const auto red = spectrum(*m, {1, 0, 0});
    for (std::size_t k = 0; k < file.nm.size(); ++k) {
        const auto at = static_cast<std::size_t>(file.nm[k] - 380);
        EXPECT_NEAR(red[at], static_cast<double>(file.column.at("red")[k]), 1e-15) << k;
        if (k + 1 == file.nm.size()) continue;
        const auto border = (file.column.at("red")[k] + file.column.at("red")[k + 1]) / 2;
        EXPECT_NEAR(red[at + 17], static_cast<double>(border), 1e-15) << k;
    }
    EXPECT_NEAR(red.back(), static_cast<double>(file.column.at("red").back()), 1e-15);
    // What the registry says: neither exact nor bounded. Red reaches 1.0149, cyan 1.0007.
    EXPECT_FALSE(m->info().exact);
    EXPECT_FALSE(m->info().bounded);
    const auto e = extremes(*m, colors(1000));
    EXPECT_NEAR(e.high, 1.0149, 1e-12);
    EXPECT_GE(e.low, 0);
    EXPECT_GT(e.residual, 0.01);
    for (const double v : spectrum(*m, {0, 1, 1})) EXPECT_LE(v, 1.0007 + 1e-12);
    for (const double v : spectrum(*m, {0, 0, 0})) EXPECT_EQ(v, 0.0);
    const auto wide = make_model("smits1999", colorimetry("380:780:5", {"cie1931", "", "Display P3", RgbMatrix::integrated}));
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().kind, ErrorKind::usage);
}

class SmitsExact : public testing::TestWithParam<const char*> {};

TEST_P(SmitsExact, IsExactInRangeAndContinuous) {
    const auto m = model("smits1999:exact", colorimetry(GetParam()));
    ASSERT_TRUE(m);
    const auto e = extremes(*m, colors(3000));
    EXPECT_TRUE(e.finite);
    EXPECT_GE(e.low, 0.0);
    // Four weights that sum to 1 within two roundings, each product rounded once.
    EXPECT_LE(e.high, 1 + 1e-15);
    // The vertices are rounded from long double, 1.1e-16 each, times sum |A| < 3, and the blend adds four roundings.
    EXPECT_LE(e.residual, 3e-15);
    for (const double v : spectrum(*m, {0, 0, 0})) EXPECT_EQ(v, 0.0);
    for (const double v : spectrum(*m, {1, 1, 1})) EXPECT_EQ(v, 1.0);
    // Each component moves by at most the step, along edges between spectra in [0,1].
    EXPECT_LE(largest_change(*m, 1e-6, 1000), 3e-6);
}

TEST_P(SmitsExact, VerticesAreTheSmoothest) {
    const auto c = colorimetry(GetParam());
    const auto m = model("smits1999:exact", c);
    ASSERT_TRUE(m);
    const std::size_t n = c.bands().size();
    const auto& a = c.sensing_matrix();
    // First-order optimality without the solver: a feasible direction d (A d = 0, zero where r is at a bound) has slope 0.
    // Such directions are made of four neighbouring free bands.
    for (const auto& r : seven(*m)) {
        double scale = 0;
        for (std::size_t l = 0; l + 1 < n; ++l) scale = std::max(scale, std::abs(r[l + 1] - r[l]));
        for (std::size_t l = 0; l + 4 < n; ++l) {
            bool free = true;
            for (std::size_t k = 0; k < 4; ++k) free = free && r[l + k] > 0 && r[l + k] < 1;
            if (!free) continue;
            reference::Mat3 matrix{};
            reference::Vec3 right{};
            for (std::size_t i = 0; i < 3; ++i) {
                for (std::size_t k = 0; k < 3; ++k) matrix[i][k] = a[i * n + l + k];
                right[i] = -a[i * n + l + 3];
            }
            const auto d3 = reference::solve(matrix, right);
            std::array<reference::Real, 4> d{d3[0], d3[1], d3[2], 1};
            reference::Real norm = 0, slope = 0;
            for (const auto v : d) norm = std::max(norm, std::fabs(v));
            for (std::size_t k = 0; k < 4; ++k) {
                const std::size_t at = l + k;
                reference::Real gradient = 0;
                if (at > 0) gradient += static_cast<reference::Real>(r[at]) - r[at - 1];
                if (at + 1 < n) gradient += static_cast<reference::Real>(r[at]) - r[at + 1];
                slope += gradient * d[k] / norm;
            }
            // Only even grids weigh all differences alike; differences of doubles near 1 carry 2.2e-16 each.
            ASSERT_LE(std::fabs(slope), 1e-13 + 1e-9 * scale) << GetParam() << " " << l;
        }
    }
}

INSTANTIATE_TEST_SUITE_P(Smits1999, SmitsExact,
                         testing::Values("380:780:1", "380:780:5", "380:780:10", "380:780:20", "36", "433:646:35.5"));

TEST(Smits1999, SaysWhereASpectrumIsMissing) {
    for (const char* id : {"smits1999:exact"}) {
        const auto wide = make_model(id, colorimetry("380:780:5", {"cie1931", "", "ProPhoto", RgbMatrix::integrated}));
        ASSERT_FALSE(wide);
        EXPECT_EQ(wide.error().kind, ErrorKind::infeasible) << wide.error().message;
        EXPECT_NE(wide.error().message.find("violates"), std::string::npos) << wide.error().message;
        const auto standard = make_model(id, colorimetry("380:780:5", {"cie1931", "", "BT.709", RgbMatrix::standard}));
        ASSERT_FALSE(standard);
        EXPECT_EQ(standard.error().kind, ErrorKind::infeasible);
    }
}

TEST(Smits1999, JsonBringsBothBack) {
    for (const char* id : {"smits1999", "smits1999:exact"}) {
        const auto m = model(id, colorimetry("380:780:10"));
        ASSERT_TRUE(m);
        expect_round_trip(*m);
        const Json good = Json::parse(m->to_json());
        const auto refused = [&](auto&& change, std::string_view member) {
            Json json = good;
            change(json);
            const auto read = make_model_from_json(json.dump());
            ASSERT_FALSE(read) << id << " " << member;
            EXPECT_EQ(read.error().kind, ErrorKind::input);
            EXPECT_NE(read.error().message.find(member), std::string::npos) << read.error().message;
        };
        refused([](Json& j) { j.erase("knots"); }, "knots");
        refused([](Json& j) { j["knots"] = 1; }, "knots");
        refused([](Json& j) { j["knots"][1] = Json::array({0}); }, "knots");
        refused([](Json& j) { j["knots"][1] = Json::array({0, 0.5}); }, "knots");
        refused([](Json& j) { j["knots"][1] = Json::array({0, 0, 1}); }, "knots");
        refused([](Json& j) { j["knots"][1] = Json::array({0, "x", 1}); }, "knots");
        refused([](Json& j) { j["knots"][1] = Json::array({0, 0.5, 1}); }, "vertices");
        refused([](Json& j) { j.erase("vertices"); }, "vertices");
        refused([](Json& j) { j["vertices"][100] = -0.1; }, "vertices");
        refused([](Json& j) { j["vertices"][100] = 1.1; }, "vertices");
        refused([](Json& j) { j["vertices"].push_back(0); }, "vertices");
    }
    Json json = Json::parse(model("smits1999:exact", colorimetry("380:780:10"))->to_json());
    json["vertices"][60] = 0.5;
    const auto read = make_model_from_json(json.dump());
    ASSERT_FALSE(read);
    EXPECT_NE(read.error().message.find("vertex 1"), std::string::npos) << read.error().message;
}

}  // namespace
