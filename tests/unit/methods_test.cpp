#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>
#include <set>

#include "plan/color_memory.h"
#include "spectex/compare.h"
#include "spectex/methods.h"
#include "spectex/plan.h"

namespace spectex {
namespace {

using Json = nlohmann::ordered_json;

ColorimetrySpec in_space(const char* space) { return {"cie1931", "", space, RgbMatrix::integrated}; }

Colorimetry colorimetry(const std::string& bands = "380:780:5", ColorimetrySpec spec = {}) {
    return Colorimetry::make(spec, BandSet::parse(bands).value()).value();
}

std::shared_ptr<const Model> model(const Colorimetry& c, std::string_view id = "mallett2019") {
    auto made = make_model(id, c);
    EXPECT_TRUE(made) << made.error().message;
    return made ? *made : nullptr;
}

std::vector<double> spectrum(const Model& m, const Vector3& rgb) {
    std::vector<double> out(m.colorimetry().bands().size());
    m.reflectance(rgb, out);
    return out;
}

TEST(Registry, NamesEveryMethodOnce) {
    std::vector<std::string> ids;
    for (const auto& info : methods()) {
        EXPECT_FALSE(info.title.empty()) << info.id;
        EXPECT_NE(info.source.find("doi:"), std::string::npos) << info.id;
        EXPECT_GT(info.coefficients, 0) << info.id;
        EXPECT_EQ(std::count(ids.begin(), ids.end(), info.id), 0) << info.id;
        ids.push_back(info.id);
        ASSERT_TRUE(find_method(info.id));
        EXPECT_EQ(find_method(info.id)->title, info.title);
    }
    ASSERT_GE(ids.size(), 2u);
    const auto unknown = find_method("malett2019");
    ASSERT_FALSE(unknown);
    EXPECT_EQ(unknown.error().kind, ErrorKind::usage);
    for (const auto& id : ids) EXPECT_NE(unknown.error().message.find(id), std::string::npos) << id;
    EXPECT_FALSE(make_model("", colorimetry()));
}

class Grids : public testing::TestWithParam<const char*> {};

TEST_P(Grids, BlackAndWhiteAreExactAndColoursStayInRange) {
    const auto m = model(colorimetry(GetParam()));
    ASSERT_TRUE(m);
    EXPECT_EQ(m->info().pieces, Pieces::linear);
    ASSERT_NE(m->basis(), nullptr);
    EXPECT_EQ(m->lattice(), nullptr);
    for (const double r : spectrum(*m, {0, 0, 0})) EXPECT_EQ(r, 0.0);
    for (const double r : spectrum(*m, {1, 1, 1})) EXPECT_EQ(r, 1.0);

    const std::size_t bands = m->colorimetry().bands().size();
    const auto& a = m->colorimetry().sensing_matrix();
    std::mt19937_64 random(20190716);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::uniform_int_distribution<int> edge(0, 3);
    double worst = 0;
    for (int trial = 0; trial < 2000; ++trial) {
        Vector3 rgb{};
        for (double& v : rgb) {
            const int kind = edge(random);
            v = kind == 0 ? 0.0 : kind == 1 ? 1.0 : uniform(random);
        }
        const auto r = spectrum(*m, rgb);
        for (const double v : r) {
            ASSERT_GE(v, 0.0);
            ASSERT_LE(v, 1.0);
        }
        for (std::size_t c = 0; c < 3; ++c) {
            long double sum = 0;
            for (std::size_t l = 0; l < bands; ++l) sum += static_cast<long double>(a[c * bands + l]) * r[l];
            worst = std::max(worst, static_cast<double>(std::abs(sum - rgb[c])));
        }
    }
    // Each value is rounded thrice by 1.1e-16 relative, and |A| sums to less than 3 over the bands.
    EXPECT_LE(worst, 2e-15);
    EXPECT_GT(worst, 0);
}

TEST_P(Grids, IsContinuous) {
    const auto m = model(colorimetry(GetParam()));
    ASSERT_TRUE(m);
    const auto from = spectrum(*m, {0.3, 0.6, 0.9}), to = spectrum(*m, {0.3 + 1e-6, 0.6, 0.9 - 1e-6});
    // |b_i| <= 1, so no value moves by more than the colour's components together.
    for (std::size_t l = 0; l < from.size(); ++l) EXPECT_LE(std::abs(from[l] - to[l]), 2e-6 + 1e-15);
}

INSTANTIATE_TEST_SUITE_P(Mallett2019, Grids,
                         testing::Values("380:780:1", "380:780:5", "380:780:10", "380:780:20", "36", "383:775:7", "433:646:35.5"));

TEST(Mallett2019, ManyColoursAreTheSameAsOneByOne) {
    const auto m = model(colorimetry());
    const std::vector<double> rgb{0.1, 0.2, 0.3, 1, 0, 0.5, 0.7, 0.7, 0.7};
    std::vector<double> all(3 * 81);
    m->reflectance(rgb, all);
    for (std::size_t i = 0; i < 3; ++i) {
        const auto one = spectrum(*m, {rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]});
        for (std::size_t l = 0; l < 81; ++l) EXPECT_EQ(one[l], all[81 * i + l]);
    }
}

TEST(Mallett2019, SaysWhereThereAreNoPrimaries) {
    const auto wide = make_model("mallett2019", colorimetry("380:780:5", in_space("Rec.2020")));
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().kind, ErrorKind::infeasible);
    EXPECT_NE(wide.error().message.find("0.2106"), std::string::npos) << wide.error().message;
    const auto standard = make_model("mallett2019", colorimetry("380:780:5", ColorimetrySpec{"cie1931", "", "BT.709", RgbMatrix::standard}));
    ASSERT_FALSE(standard);
    EXPECT_EQ(standard.error().kind, ErrorKind::infeasible);
    EXPECT_NE(standard.error().message.find("(1,1,1)"), std::string::npos) << standard.error().message;
}

TEST(Mallett2019Published, IsTheTableAndNearlyExact) {
    const auto c = colorimetry();
    const auto m = model(c, "mallett2019:published");
    const auto table = load_spectral_table("models/mallett2019_published_380-780-5.csv");
    ASSERT_TRUE(table);
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t l = 0; l < 81; ++l) EXPECT_EQ((*m->basis())[81 * i + l], table->columns[i][l]);
    EXPECT_FALSE(m->info().exact);
    // The table was made for point samples at 5 nm: what integration at 1 nm changes is visible, but small.
    double worst = 0;
    for (std::size_t i = 0; i < 3; ++i) {
        const Vector3 rgb = c.rgb_of(std::span<const double>(*m->basis()).subspan(81 * i, 81));
        for (std::size_t k = 0; k < 3; ++k) worst = std::max(worst, std::abs(rgb[k] - (i == k ? 1 : 0)));
    }
    EXPECT_GT(worst, 1e-6);
    EXPECT_LT(worst, 0.02);
    const auto wide = make_model("mallett2019:published", colorimetry("380:780:5", in_space("Display P3")));
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().kind, ErrorKind::usage);
}

TEST(ModelJson, BringsEveryModelBack) {
    for (const auto& [bands, spec] : std::initializer_list<std::pair<const char*, ColorimetrySpec>>{
             {"380:780:5", {}},
             {"383:775:7", {"cie2006-10", "", "BT.709", RgbMatrix::integrated}},
             {"380:780:10", {"cie1931", "D:5003", "BT.709", RgbMatrix::integrated}},
             {"380:780:10", {"cie1931", "FL11", "BT.709", RgbMatrix::integrated}},
             {"380:780:5", {"cie1931", "0.7*A+0.3*FL11", "BT.709", RgbMatrix::integrated}},
             {"380:780:5", in_space("PAL/SECAM")}}) {
        for (const char* id : {"mallett2019", "mallett2019:published"}) {
            const auto c = colorimetry(bands, spec);
            if (id == std::string_view("mallett2019:published") && c.rgb_space().name != "BT.709") continue;
            const auto m = model(c, id);
            ASSERT_TRUE(m);
            const std::string text = m->to_json();
            const auto back = make_model_from_json(text);
            ASSERT_TRUE(back) << back.error().message;
            EXPECT_EQ((*back)->info().id, id);
            EXPECT_EQ((*back)->info().exact, m->info().exact);
            EXPECT_EQ(*(*back)->basis(), *m->basis());
            EXPECT_EQ((*back)->colorimetry().sensing_matrix(), c.sensing_matrix());
            EXPECT_EQ((*back)->colorimetry().describe(), c.describe());
            EXPECT_EQ((*back)->to_json(), text);
        }
    }
}

TEST(ModelJson, CarriesThePowerOfALampThatItsNameDoesNotBringBack) {
    const auto flat = SpectralDistribution::make({300, 900}, {1, 1}).value();
    const Illuminant lying{"A", "file A.csv", flat};
    const auto c = Colorimetry::make({}, BandSet(), lying);
    ASSERT_TRUE(c);
    const auto m = model(*c);
    const auto back = make_model_from_json(m->to_json());
    ASSERT_TRUE(back) << back.error().message;
    EXPECT_EQ((*back)->colorimetry().illuminant().power.values(), flat.values());
    EXPECT_EQ((*back)->colorimetry().illuminant().title, "file A.csv");
    EXPECT_EQ(Json::parse(model(colorimetry())->to_json())["illuminant"].contains("power"), false);
}

TEST(ModelJson, RefusesHostileText) {
    const Json good = Json::parse(model(colorimetry("380:780:10"))->to_json());
    ASSERT_TRUE(make_model_from_json(good.dump()));
    const auto refused = [](const std::string& text, std::string_view names) {
        const auto read = make_model_from_json(text);
        ASSERT_FALSE(read) << text.substr(0, 200);
        EXPECT_EQ(read.error().kind, ErrorKind::input);
        EXPECT_NE(read.error().message.find(names), std::string::npos) << read.error().message;
    };
    const auto changed = [&](auto&& change) {
        Json json = good;
        change(json);
        return json.dump();
    };
    refused("", "JSON");
    refused("[]", "JSON");
    refused("{", "JSON");
    refused("null", "JSON");
    refused(std::string(100000, '['), "JSON");
    refused(std::string("{\"format\":1,\"method\":\"\xff\"}"), "JSON");
    for (const auto& [member, value] : good.items()) {
        refused(changed([&, &name = member](Json& j) { j.erase(name); }), member);
        refused(changed([&, &name = member](Json& j) { j[name] = nullptr; }), member);
        refused(changed([&, &name = member](Json& j) { j[name] = Json::object(); }), member);
        refused(changed([&, &name = member](Json& j) { j[name] = -1; }), member);
        refused(changed([&, &name = member](Json& j) { j[name] = std::string(10000, 'x'); }), member);
    }
    refused(changed([](Json& j) { j["format"] = 2; }), "format");
    refused(changed([](Json& j) { j["method"] = "smits"; }), "method");
    refused(changed([](Json& j) { j["bands"][1] = 380; }), "bands");
    refused(changed([](Json& j) { j["bands"][1] = "390"; }), "bands");
    refused(changed([](Json& j) { j["bands"] = Json::array({380, 390}); }), "bands");
    refused(changed([](Json& j) { j["bands"] = std::vector<double>(BandSet::max_size + 1, 1); }), "bands");
    refused(changed([](Json& j) { j["bands"].push_back(790); }), "basis");
    refused(changed([](Json& j) { j["basis"][3] = -1e-6; }), "basis");
    refused(changed([](Json& j) { j["basis"][3] = 1.5; }), "basis");
    refused(changed([](Json& j) { j["basis"][3] = j["basis"][3].get<double>() + 1e-6; }), "basis");
    refused(changed([](Json& j) { j["basis"][3] = true; }), "basis");
    refused(changed([](Json& j) { j["basis"].erase(0); }), "basis");
    refused(changed([](Json& j) {  // sums to one and lies in range, but is another set of primaries
        const auto n = j["bands"].size();
        for (std::size_t l = 0; l < n; ++l) std::swap(j["basis"][l], j["basis"][n + l]);
    }), "basis");
    refused(changed([](Json& j) { j["observer"] = "cie1932"; }), "observer");
    refused(changed([](Json& j) { j["rgb_space"] = "BT.710"; }), "rgb_space");
    refused(changed([](Json& j) { j["matrix"] = "other"; }), "matrix");
    refused(changed([](Json& j) { j["illuminant"]["name"] = "Z99"; }), "illuminant");
    const auto power = [&](Json nm, Json values) {
        return changed([&](Json& j) { j["illuminant"]["power"] = {{"wavelengths_nm", nm}, {"values", values}}; });
    };
    refused(power({400, 500}, {1}), "values");
    refused(power({400, 500}, {1, -1}), "values");
    refused(power({500, 400}, {1, 1}), "illuminant");
    refused(power({400, 500}, {0, 0}), "illuminant");
    refused(power({-400, 500}, {1, 1}), "illuminant");
    refused(power(Json::array(), Json::array()), "illuminant");
    // A number too large for a double makes the text no JSON of ours.
    std::string huge = good.dump();
    huge.replace(huge.find("380.0"), 5, "1e999");
    refused(huge, "JSON");
}

TEST(ModelJson, OpensNoFileThatTheTextNames) {
    Json json = Json::parse(model(colorimetry("380:780:10"))->to_json());
    // A lamp by name would be found; the same as a path must not be looked for.
    const std::string path = std::string(SPECTEX_LUTS_SOURCE) + "/../tests/unit/data/illuminant_A_380-780-5.csv";
    ASSERT_TRUE(parse_illuminant(path)) << "the test needs a file that can be read as an illuminant";
    json["illuminant"] = {{"name", path}};
    const auto read = make_model_from_json(json.dump());
    ASSERT_FALSE(read);
    EXPECT_NE(read.error().message.find("no named illuminant"), std::string::npos) << read.error().message;
    json["illuminant"]["name"] = "A+" + path;
    EXPECT_FALSE(make_model_from_json(json.dump()));
    json["illuminant"]["name"] = "D:5003+" + path;
    EXPECT_FALSE(make_model_from_json(json.dump()));
}

struct Planes {
    std::vector<float> r, g, b;
    std::array<float*, 3> pointers() { return {r.data(), g.data(), b.data()}; }
};
constexpr Vector3 rec709{0.2126, 0.7152, 0.0722};
constexpr float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();

TEST(Gamut, LeavesColoursInsideAlone) {
    std::mt19937 random(7);
    std::uniform_real_distribution<float> uniform(0, 1);
    Planes p;
    for (int i = 0; i < 1000; ++i) p.r.push_back(uniform(random)), p.g.push_back(uniform(random)), p.b.push_back(uniform(random));
    p.r[3] = 0, p.g[4] = 1;
    const Planes before = p;
    for (const auto policy : {GamutPolicy::clip, GamutPolicy::desaturate, GamutPolicy::error}) {
        GamutCounts counts;
        EXPECT_FALSE(map_into_gamut(p.pointers(), 1000, policy, rec709, counts));
        EXPECT_EQ(counts.out_of_gamut + counts.nonfinite, 0u);
        EXPECT_EQ(p.r, before.r);
        EXPECT_EQ(p.g, before.g);
        EXPECT_EQ(p.b, before.b);
    }
}

TEST(Gamut, ClipsEachComponent) {
    Planes p{{-0.5f, 2, 0.25f}, {0.5f, 0.5f, 1.0000001f}, {3, -0.0f, 0.5f}};
    GamutCounts counts;
    EXPECT_FALSE(map_into_gamut(p.pointers(), 3, GamutPolicy::clip, rec709, counts));
    EXPECT_EQ(p.r, (std::vector<float>{0, 1, 0.25f}));
    EXPECT_EQ(p.g, (std::vector<float>{0.5f, 0.5f, 1}));
    EXPECT_EQ(p.b, (std::vector<float>{1, 0, 0.5f}));
    EXPECT_EQ(counts.out_of_gamut, 3u);
}

TEST(Gamut, GivesNumbersForWhatIsNotFinite) {
    for (const auto policy : {GamutPolicy::clip, GamutPolicy::desaturate, GamutPolicy::error}) {
        Planes p{{nan, inf, 0.5f}, {0.5f, -inf, nan}, {0.25f, 0.5f, 2}};
        GamutCounts counts;
        EXPECT_FALSE(map_into_gamut(p.pointers(), 3, policy, rec709, counts));
        EXPECT_EQ(p.r, (std::vector<float>{0, 1, 0.5f}));
        EXPECT_EQ(p.g, (std::vector<float>{0.5f, 0, 0}));
        EXPECT_EQ(p.b, (std::vector<float>{0.25f, 0.5f, 1}));
        EXPECT_EQ(counts.nonfinite, 3u);
        EXPECT_EQ(counts.out_of_gamut, 0u);
    }
}

TEST(Gamut, ErrorNamesTheFirstColourOutside) {
    Planes p{std::vector<float>(700, 0.5f), std::vector<float>(700, 0.5f), std::vector<float>(700, 0.5f)};
    p.g[600] = 1.5f;
    p.r[650] = -1;
    GamutCounts counts;
    EXPECT_EQ(map_into_gamut(p.pointers(), 700, GamutPolicy::error, rec709, counts), std::optional<std::size_t>(600));
    EXPECT_EQ(map_into_gamut(p.pointers(), 600, GamutPolicy::error, rec709, counts), std::nullopt);
}

TEST(Gamut, DesaturationKeepsLuminanceAndHue) {
    std::mt19937 random(11);
    std::uniform_real_distribution<float> uniform(-1, 2);
    Planes p;
    for (int i = 0; i < 20000; ++i) p.r.push_back(uniform(random)), p.g.push_back(uniform(random)), p.b.push_back(uniform(random));
    const Planes before = p;
    GamutCounts counts;
    EXPECT_FALSE(map_into_gamut(p.pointers(), p.r.size(), GamutPolicy::desaturate, rec709, counts));
    std::uint64_t outside = 0;
    for (std::size_t i = 0; i < p.r.size(); ++i) {
        const double from[3] = {before.r[i], before.g[i], before.b[i]}, to[3] = {p.r[i], p.g[i], p.b[i]};
        double y0 = 0, y1 = 0, least = 1, most = 0;
        for (int c = 0; c < 3; ++c) {
            ASSERT_TRUE(to[c] >= 0 && to[c] <= 1);
            y0 += rec709[static_cast<std::size_t>(c)] * from[c];
            y1 += rec709[static_cast<std::size_t>(c)] * to[c];
            least = std::min(least, to[c]);
            most = std::max(most, to[c]);
        }
        const bool out = *std::min_element(from, from + 3) < 0 || *std::max_element(from, from + 3) > 1;
        outside += out;
        // Three floats in [0,1], each rounded by 6e-8 at most.
        ASSERT_NEAR(y1, std::clamp(y0, 0.0, 1.0), 1e-7);
        if (!out || y0 <= 0 || y0 >= 1) continue;
        // No further than to the cube's surface.
        ASSERT_TRUE(least < 1e-7 || most > 1 - 1e-7);
        // Differences from grey keep their proportions.
        for (int c = 0; c < 3; ++c)
            for (int d = 0; d < 3; ++d) ASSERT_NEAR((from[c] - y0) * (to[d] - y0), (from[d] - y0) * (to[c] - y0), 1e-6);
    }
    EXPECT_EQ(counts.out_of_gamut, outside);
}

}  // namespace
/// Counts the colours that it is asked for.
class Counted final : public Model {
public:
    explicit Counted(const Colorimetry& c) : Model({.id = "counted", .title = "", .source = "", .pieces = Pieces::nonlinear}, c) {}
    void reflectance(std::span<const double> rgb, std::span<double> out) const override {
        asked += rgb.size() / 3;
        const std::size_t bands = colorimetry().bands().size();
        for (std::size_t i = 0; i < out.size(); ++i) out[i] = rgb[i / bands * 3] * 0.5 + rgb[i / bands * 3 + 1] * 0.25 + rgb[i / bands * 3 + 2] * 0.125;
    }
    std::string to_json() const override { return "{}"; }
    mutable std::size_t asked = 0;
};

TEST(RepeatedColours, AreComputedOnceAndGiveTheSame) {
    const auto c = Colorimetry::make({}, BandSet());
    ASSERT_TRUE(c);
    const auto model = std::make_shared<Counted>(*c);
    RelightRequest request;
    request.illuminants.push_back(*parse_illuminant("A"));
    const auto plan = RelightPlan::for_model(model, request);
    ASSERT_TRUE(plan) << plan.error().message;
    // 300 colours in an order of no pattern, over several blocks; -0 and 0 are two.
    constexpr std::size_t n = 10000;
    std::array<std::vector<float>, 3> rgb, out;
    for (std::size_t p = 0; p < n; ++p) {
        const std::size_t k = p * p % 300;
        rgb[0].push_back(static_cast<float>(k) / 300), rgb[1].push_back(static_cast<float>(k * 7 % 300) / 300), rgb[2].push_back(k == 0 && p > 5000 ? -0.0f : 0.0f);
    }
    std::set<std::array<std::uint32_t, 3>> distinct;
    for (std::size_t p = 0; p < n; ++p)
        distinct.insert({std::bit_cast<std::uint32_t>(rgb[0][p]), std::bit_cast<std::uint32_t>(rgb[1][p]), std::bit_cast<std::uint32_t>(rgb[2][p])});
    for (auto& plane : out) plane.resize(n);
    // Whether so cheap a model pays is the machine's to say, and the plan asked it some colours to find out.
    plan::ColorMemory::use = plan::ColorMemory::Use::always;
    model->asked = 0;
    plan->execute(std::array<const float*, 3>{rgb[0].data(), rgb[1].data(), rgb[2].data()}, n, std::array<float*, 3>{out[0].data(), out[1].data(), out[2].data()});
    plan::ColorMemory::use = plan::ColorMemory::Use::as_it_pays;
    EXPECT_GE(model->asked, distinct.size());
    // Two colours may share a place now and then.
    EXPECT_LE(model->asked, distinct.size() + 200);
    for (std::size_t p = 0; p < n; p += 97) {
        const auto fresh = RelightPlan::for_model(model, request);  // remembers nothing
        std::array<float, 3> alone{};
        fresh->execute(std::array<const float*, 3>{&rgb[0][p], &rgb[1][p], &rgb[2][p]}, 1, std::array<float*, 3>{&alone[0], &alone[1], &alone[2]});
        for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(out[i][p], alone[i]) << p;
    }
}

TEST(BandsApart, AreTheBandsOfTheWholeSpectrum) {
    const auto c = colorimetry("380:780:20");
    const std::vector<std::size_t> bands{0, 3, 4, 11, 20};
    const std::vector<double> rgb{0, 0, 0, 1, 1, 1, 1, 0, 0, 0.2, 0.5, 0.1, 1e-6, 0, 1e-5, 0.9, 0.95, 1};
    const std::size_t n = rgb.size() / 3;
    std::size_t apart = 0;
    for (const auto& info : methods()) {
        const auto m = model(c, info.id);
        ASSERT_TRUE(m);
        apart += m->bands_apart();
        std::vector<double> whole(n * 21), some(n * bands.size()), kept(n * static_cast<std::size_t>(info.coefficients));
        const auto same = [&](const char* what) {
            for (std::size_t p = 0; p < n; ++p)
                for (std::size_t k = 0; k < bands.size(); ++k)
                    EXPECT_EQ(some[p * bands.size() + k], whole[p * 21 + bands[k]]) << info.id << ' ' << what << ' ' << p << ' ' << bands[k];
        };
        m->reflectance(rgb, whole);
        m->reflectance_in(bands, rgb, some);
        same("colour");
        m->coefficients(rgb, kept);
        m->reflectance_of_coefficients(kept, whole);
        m->reflectance_of_coefficients_in(bands, kept, some);
        same("coefficients");
    }
    EXPECT_GE(apart, 7u);
}

/// Remembers which bands it is asked for.
class Apart final : public Model {
public:
    explicit Apart(const Colorimetry& c) : Model({.id = "apart", .title = "", .source = "", .pieces = Pieces::nonlinear}, c) {}
    void reflectance(std::span<const double>, std::span<double> out) const override {
        std::fill(out.begin(), out.end(), 0.5);
        whole = true;
    }
    bool bands_apart() const override { return true; }
    void reflectance_in(std::span<const std::size_t> bands, std::span<const double>, std::span<double> out) const override {
        std::fill(out.begin(), out.end(), 0.5);
        asked.assign(bands.begin(), bands.end());
    }
    std::string to_json() const override { return "{}"; }
    mutable bool whole = false;
    mutable std::vector<std::size_t> asked;
};

TEST(Nodes, OfZeroWeightAreNeverComputed) {
    const auto c = colorimetry();
    const auto m = std::make_shared<Apart>(c);
    RelightRequest request;
    request.observer = "cie2006-2";  // which begins at 390 nm
    request.illuminants.push_back({"narrow", "", SpectralDistribution::make({500, 510, 590, 600}, {0, 1, 1, 0}).value()});
    const auto plan = RelightPlan::for_model(m, request);
    ASSERT_TRUE(plan) << plan.error().message;
    const float rgb[] = {0.5f};
    float out[3];
    m->whole = false;  // the plan timed both ways to a spectrum
    m->asked.clear();
    plan->execute_colors({rgb, rgb, rgb}, 1, std::array<float*, 3>{&out[0], &out[1], &out[2]});
    EXPECT_FALSE(m->whole);
    // The kernel of a band reaches to its neighbours: the light is dark at 500 and at 600 nm itself.
    ASSERT_FALSE(m->asked.empty());
    EXPECT_EQ(c.bands()[m->asked.front()], 500.0);
    EXPECT_EQ(c.bands()[m->asked.back()], 600.0);
    EXPECT_EQ(m->asked.size(), 21u);
    const auto& lines = plan->explanation();
    EXPECT_TRUE(std::any_of(lines.begin(), lines.end(), [](const auto& l) { return l.text == "60 bands of zero weight: never computed"; }));
}

TEST(Nodes, KeepTheirBoundOnColoursThatTheyWereNotChosenBy) {
    const auto c = colorimetry();
    RelightRequest request;
    for (const char* name : {"FL11", "A"}) request.illuminants.push_back(*parse_illuminant(name));
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> uniform(0, 1);
#ifdef SPECTEX_SLOW_BUILD
    constexpr std::size_t n = 500;
    const std::vector<const char*> ids{"otsu2018"};
#else
    constexpr std::size_t n = 6000;
    const std::vector<const char*> ids{"otsu2018", "jakob2019"};
#endif
    std::array<std::vector<float>, 3> rgb;
    for (std::size_t p = 0; p < n; ++p) {
        double v[3] = {uniform(random), uniform(random), uniform(random)};
        if (p % 3 == 1) v[random() % 3] = static_cast<double>(random() % 2);
        if (p % 3 == 2)
            for (double& x : v) x *= x * x;
        for (std::size_t k = 0; k < 3; ++k) rgb[k].push_back(static_cast<float>(v[k]));
    }
    for (const char* id : ids) {
        std::vector<std::vector<float>> lit[2];
        std::string bound, kernel;
        for (const bool few : {false, true}) {
            request.max_error = few ? 0.5 : 0;
            const auto plan = RelightPlan::for_model(model(c, id), request);
            ASSERT_TRUE(plan);
            lit[few].assign(6, std::vector<float>(n));
            std::vector<float*> out;
            for (auto& plane : lit[few]) out.push_back(plane.data());
            plan->execute_colors({rgb[0].data(), rgb[1].data(), rgb[2].data()}, n, out);
            for (const auto& line : plan->explanation()) {
                if (line.key == "bound") bound = line.text;
                if (line.key == "kernel") kernel = line.text;
            }
        }
        ASSERT_EQ(bound.find("CIE76 0."), 0u) << bound;
        const double stated = std::stod(bound.substr(6));
        EXPECT_LE(stated, 0.5);
        EXPECT_LT(std::stoi(kernel.substr(kernel.find("of ") + 3)), 65) << kernel;
        double worst = 0;
        for (std::size_t k = 0; k < 2; ++k) {
            const auto w = *tristimulus_weights(c.bands(), c.observer(), request.illuminants[k], Normalization::luminance);
            const Matrix3 to_xyz = c.rgb_to_xyz();
            for (std::size_t p = 0; p < n; ++p) {
                Vector3 lab[2];
                for (const bool few : {false, true})
                    lab[few] = lab_from_xyz(to_xyz * Vector3{lit[few][3 * k][p], lit[few][3 * k + 1][p], lit[few][3 * k + 2][p]}, w.white);
                worst = std::max(worst, delta_e76(lab[0], lab[1]));
            }
        }
        EXPECT_LE(worst, stated) << id;
        EXPECT_GT(worst, 0) << id;
        printf("%s: %s; CIE76 of %zu other colours at most %.3g, stated %.3g\n", id, kernel.c_str(), n, worst, stated);
    }
}

/// Colours of which some were met before, and what a memory makes of a function that counts.
struct Remembered {
    std::vector<float> out;
    std::size_t computed = 0;
};
Remembered remember(const plan::ColorMemoryOwner& owner, const std::vector<float>& grey) {
    Remembered result;
    result.out.resize(2 * grey.size());
    const std::array<const float*, 3> in{grey.data(), grey.data(), grey.data()};
    const auto compute = [&](std::span<const double> colors, std::span<float> results) {
        result.computed += colors.size() / 3;
        for (std::size_t p = 0; p < colors.size() / 3; ++p)
            for (std::size_t j = 0; j < 2; ++j) results[2 * p + j] = static_cast<float>(std::sqrt(colors[3 * p]) + static_cast<double>(j));
    };
    constexpr std::size_t block = 1024;
    for (std::size_t at = 0; at < grey.size(); at += block)
        plan::ColorMemory::apply(owner, in, at, std::min(block, grey.size() - at), 2, compute, result.out.data() + 2 * at);
    return result;
}

TEST(ColorMemory, IsUsedWhereColoursComeAgainOftenEnough) {
    constexpr std::size_t n = std::size_t{1} << 18;
    std::mt19937 random(3);
    for (const double share : {0.1, 0.6}) {
        std::vector<float> grey;
        for (std::size_t p = 0; p < n; ++p) {
            const bool again = p > 0 && static_cast<double>(random()) < share * 4294967296.0;
            grey.push_back(again ? grey[p - 1 - random() % std::min<std::size_t>(p, 512)] : static_cast<float>(random() >> 8) * 0x1p-24f);
        }
        const auto never = remember(plan::ColorMemoryOwner(1), grey);
        const auto always = remember(plan::ColorMemoryOwner(0), grey);
        const auto pays = remember(plan::ColorMemoryOwner(0.3), grey);
        EXPECT_EQ(never.computed, n);
        EXPECT_NEAR(static_cast<double>(always.computed), (1 - share) * n, 0.05 * n);  // colours share places of the table, some of 512
        if (share < 0.3)
            EXPECT_GT(pays.computed, always.computed + n / 20);  // looked up for 32768 of 262144, then let be
        else
            EXPECT_EQ(pays.computed, always.computed);
        EXPECT_EQ(never.out, always.out);
        EXPECT_EQ(never.out, pays.out);
    }
}

TEST(ColorMemory, BreaksEvenWhereBothWaysCostTheSame) {
    for (const plan::BreakEven& b : {plan::BreakEven{100, 2, 12, 7}, plan::BreakEven{5000, 3, 40, 20}, plan::BreakEven{30, 5, 15, 10}}) {
        const double s = b.share();
        EXPECT_GT(s, 0);
        EXPECT_LT(s, 1);
        EXPECT_NEAR(s * b.found + (1 - s) * (b.missed + b.compute), b.plain + b.compute, 1e-9 * b.compute);
    }
    // Trials in vain and the colours between them: a fiftieth more than the colours alone.
    const plan::BreakEven b{100, 2, 12, 7};
    EXPECT_NEAR((b.missed - b.plain) / (b.rest() * (b.plain + b.compute)), 0.02, 1e-9);
    EXPECT_EQ((plan::BreakEven{1, 2, 12, 20}.share()), 1);
    EXPECT_EQ((plan::BreakEven{1, 2, 30, 20}.share()), 1);
}

TEST(ColorMemory, MeasuresWhatAFunctionCosts) {
    const auto of = [](int work) {
        return plan::measure_break_even(3, [work](std::span<const double> colors, std::span<float> results) {
            for (std::size_t i = 0; i < results.size(); ++i) {
                double v = colors[i];
                for (int k = 0; k < work; ++k) v = std::sin(v);
                results[i] = static_cast<float>(v);
            }
        });
    };
    const auto dear = of(2000), cheap = of(0);
    EXPECT_GT(dear.compute, 100 * cheap.compute);
    EXPECT_LT(dear.share(), 0.05);  // some ten microseconds against some ten nanoseconds, whatever the build
    EXPECT_GT(cheap.share(), 0.5);
}

}  // namespace spectex
