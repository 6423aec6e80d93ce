// Every registered method on a million random colours, and on all corners, edges and greys: finite, in [0,1] where it says so,
// with the colour itself where it says so; and relit by every illuminant against sums that share no code with the library.
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <random>
#include <set>

#include "reference.h"
#include "spectex/methods.h"
#include "spectex/plan.h"

using namespace spectex;

namespace {

/// Three components each, in [0,1].
std::vector<double> colours() {
    std::vector<double> out;
    const auto add = [&](double r, double g, double b) { out.insert(out.end(), {r, g, b}); };
    for (int corner = 0; corner < 8; ++corner) add(corner & 1, corner >> 1 & 1, corner >> 2);
    // Close to each corner from inside: a whole step of eight bits, one ulp, and numbers whose squares vanish.
    for (const double e : {1e-3, 1e-7, 0x1p-53, 1e-30, 1e-170, 5e-324})
        for (int corner = 0; corner < 8; ++corner)
            for (int toward = 1; toward < 8; ++toward) {
                double rgb[3];
                for (int c = 0; c < 3; ++c) rgb[c] = (corner >> c & 1) ? 1 - e * (toward >> c & 1) : e * (toward >> c & 1);
                add(rgb[0], rgb[1], rgb[2]);
            }
    for (int i = 0; i <= 1024; ++i) {
        const double t = i / 1024.0;
        add(t, t, t);
        // One component a rounding away from the others.
        add(t, t, std::nextafter(t, 0.5));
        for (int axis = 0; axis < 3; ++axis)
            for (int ends = 0; ends < 4; ++ends) {
                double rgb[3];
                rgb[axis] = t, rgb[(axis + 1) % 3] = ends & 1, rgb[(axis + 2) % 3] = ends >> 1;
                add(rgb[0], rgb[1], rgb[2]);
            }
    }
    std::mt19937_64 random(20260725);
    std::uniform_real_distribution<double> uniform(0, 1);
    for (int i = 0; i < 1000000; ++i) {
        // Three quarters inside, one sixth on faces, one twelfth dark: cubes of uniform numbers.
        double rgb[3];
        for (double& v : rgb) v = uniform(random);
        if (i % 6 == 1) rgb[random() % 3] = static_cast<double>(random() % 2);
        if (i % 12 == 2)
            for (double& v : rgb) v = v * v * v;
        add(rgb[0], rgb[1], rgb[2]);
    }
    return out;
}

std::vector<std::string> ids() {
    std::vector<std::string> out;
    for (const auto& info : methods()) out.push_back(info.id);
    return out;
}

class EveryMethod : public testing::TestWithParam<std::string> {};

TEST_P(EveryMethod, GivesReflectancesOnAMillionColours) {
    static const std::vector<double> rgb = colours();
    const auto colorimetry = *Colorimetry::make({}, *BandSet::parse("380:780:20"));
    const auto made = make_model(GetParam(), colorimetry);
    ASSERT_TRUE(made) << made.error().message;
    const Model& model = **made;
    const std::size_t bands = colorimetry.bands().size();
    // Random ones come last. Some ten thousand colours a second and thread, or half a million, do not take a million in a short
    // test: SPECTEX_THOROUGH=1 does.
    const std::size_t most = GetParam().starts_with("peters2019") ? 25000 : GetParam() == "burns2020" ? 250000 : rgb.size() / 3;
    const std::size_t count = std::getenv("SPECTEX_THOROUGH") ? rgb.size() / 3 : most;
    const auto& a = colorimetry.sensing_matrix();
    constexpr std::size_t block = 4096;
    std::atomic<std::uint64_t> outside{0}, broken{0};
    std::mutex mutex;
    double low = 0, high = 0, residual = 0;
    std::size_t worst = 0;
    tbb::parallel_for(std::size_t{0}, (count + block - 1) / block, [&](std::size_t part) {
        const std::size_t first = part * block, n = std::min(block, count - first);
        std::vector<double> spectra(n * bands);
        model.reflectance({&rgb[3 * first], 3 * n}, spectra);
        double least = 0, greatest = 0, misses = 0;
        std::size_t at = first;
        for (std::size_t i = 0; i < n; ++i) {
            bool is_outside = false, is_broken = false;
            const double* r = &spectra[i * bands];
            double sum[3] = {-rgb[3 * (first + i)], -rgb[3 * (first + i) + 1], -rgb[3 * (first + i) + 2]};
            for (std::size_t b = 0; b < bands; ++b) {
                is_broken = is_broken || !std::isfinite(r[b]);
                is_outside = is_outside || r[b] < 0 || r[b] > 1;
                least = std::min(least, r[b]), greatest = std::max(greatest, r[b]);
                for (std::size_t c = 0; c < 3; ++c) sum[c] += a[c * bands + b] * r[b];
            }
            outside += is_outside, broken += is_broken;
            for (const double s : sum)
                if (std::abs(s) > misses) misses = std::abs(s), at = first + i;
        }
        const std::lock_guard lock(mutex);
        low = std::min(low, least), high = std::max(high, greatest);
        if (misses > residual) residual = misses, worst = at;
    });
    EXPECT_EQ(broken, 0u);
    printf("%s: %zu colours, reflectance %.17g to %.17g, %llu spectra not in [0,1]; A r misses the colour by %.2g\n", GetParam().c_str(), count,
           low, high, static_cast<unsigned long long>(outside), residual);
    if (model.info().bounded) {
        EXPECT_EQ(outside, 0u);
    } else {
        // What the published tables exceed 1 by; a method that may leave the range does, or its promise is too weak.
        EXPECT_GT(outside, 0u);
        EXPECT_GT(low, -0.1);
        EXPECT_LT(high, 1.1);
    }
    // A difference of 1e-9 in linear RGB is a CIE76 of 1e-6 at black, where it weighs most: nobody's iteration may stop earlier.
    if (model.info().exact) {
        EXPECT_LE(residual, 1e-9) << rgb[3 * worst] << ' ' << rgb[3 * worst + 1] << ' ' << rgb[3 * worst + 2];
    } else {
        EXPECT_GT(residual, 1e-6) << "it is exact, and should say so";
    }
}

using Real = reference::Real;

/// A light by its name, and its power at 380 to 780 nm computed here.
struct Lamp {
    std::string name;
    std::vector<Real> power;
};

/// Values of a table or formula at whole nanometres.
template <class Power>
std::vector<Real> at_whole_nm(const Power& power) {
    std::vector<Real> out;
    for (int nm = 380; nm <= 780; ++nm) out.push_back(power(static_cast<Real>(nm)));
    return out;
}

/// CIE 15:2018 eq. 4.3 to 4.6; the standard illuminants with M1 and M2 to three decimals, as their tables were made.
std::vector<Real> daylight(Real kelvin, bool rounded) {
    const auto table = reference::read_csv(std::string(SPECTEX_LUTS_SOURCE) + "/cie/daylight_components_300-830-5.csv");
    const Real t = kelvin;
    const Real x = t <= 7000 ? -4.6070e9L / (t * t * t) + 2.9678e6L / (t * t) + 0.09911e3L / t + 0.244063L
                             : -2.0064e9L / (t * t * t) + 1.9018e6L / (t * t) + 0.24748e3L / t + 0.237040L;
    const Real y = -3 * x * x + 2.870L * x - 0.275L, m = 0.0241L + 0.2562L * x - 0.7341L * y;
    Real m1 = (-1.3515L - 1.7703L * x + 5.9114L * y) / m, m2 = (0.0300L - 31.4424L * x + 30.0717L * y) / m;
    if (rounded) m1 = std::round(m1 * 1000) / 1000, m2 = std::round(m2 * 1000) / 1000;
    std::vector<Real> values;
    for (std::size_t i = 0; i < table.nm.size(); ++i)
        values.push_back(std::max(table.column.at("s0")[i] + m1 * table.column.at("s1")[i] + m2 * table.column.at("s2")[i], 0.0L));
    return at_whole_nm([&](Real nm) { return reference::interpolate(table.nm, values, nm); });
}

std::vector<Real> planck(Real kelvin, Real c2) {
    return at_whole_nm([&](Real nm) { return std::pow(560 / nm, 5.0L) / std::expm1(c2 / (nm * kelvin)) * std::expm1(c2 / (560 * kelvin)); });
}

/// Every illuminant that has a name, samples of those that are computed, mixtures, and one lamp as a file of each format.
std::vector<Lamp> every_lamp(const std::filesystem::path& folder) {
    const std::string luts = SPECTEX_LUTS_SOURCE;
    std::vector<Lamp> lamps{{"A", planck(2848, 1.435e7L)}, {"E", at_whole_nm([](Real) { return 1.0L; })}};
    for (const auto& [name, kelvin] : std::vector<std::pair<std::string, Real>>{
             {"D50", 5000}, {"D55", 5500}, {"D60", 6000}, {"D65", 6500}, {"D75", 7500}, {"D93", 9300}})
        lamps.push_back({name, daylight(kelvin * 1.4388L / 1.4380L, true)});
    for (const int kelvin : {4000, 5003, 7000, 7001, 12000, 25000}) lamps.push_back({"D:" + std::to_string(kelvin), daylight(kelvin, false)});
    for (const int kelvin : {500, 1000, 2856, 6504, 100000}) lamps.push_back({"P:" + std::to_string(kelvin), planck(kelvin, 1.438776877e7L)});
    const auto tables = reference::read_csv(luts + "/illuminants/cie_tables_380-780-5.csv");
    for (const auto& [name, values] : tables.column)
        lamps.push_back({name, at_whole_nm([&, &column = values](Real nm) { return reference::interpolate(tables.nm, column, nm); })});
    // Columns by their place: the index of a lamp.
    std::ifstream in(luts + "/illuminants/lamps_380-780-5.csv");
    std::string line, field;
    std::getline(in, line);
    std::vector<Real> nm;
    std::vector<std::vector<Real>> columns;
    while (std::getline(in, line)) {
        std::stringstream row(line);
        std::getline(row, field, ',');
        nm.push_back(std::stold(field));
        for (std::size_t i = 0; std::getline(row, field, ','); ++i) {
            if (columns.size() <= i) columns.emplace_back();
            columns[i].push_back(std::stold(field));
        }
    }
    const auto column = [&](std::size_t i) { return at_whole_nm([&](Real l) { return reference::interpolate(nm, columns[i], l); }); };
    for (std::size_t i = 0; i < columns.size(); ++i) lamps.push_back({"lamp:" + std::to_string(i + 1), column(i)});
    std::ifstream names(luts + "/illuminants/names.csv");
    std::getline(names, line);
    std::map<std::string, std::size_t> named;
    while (std::getline(names, line)) {
        std::stringstream row(line);
        std::string name, index;
        std::getline(row, name, ',');
        std::getline(row, index, ',');
        named[name] = std::stoul(index) - 1;
        lamps.push_back({name, column(named[name])});
    }
    // Parts count by their luminance; a lamp's table that ends at 780 nm has none beyond, A has.
    const auto cmf = reference::read_csv(luts + "/cie/cie1931_2deg_360-830-1.csv");
    const auto luminance = [&](const auto& power) {
        Real sum = 0;
        for (std::size_t i = 0; i < cmf.nm.size(); ++i) sum += power(cmf.nm[i]) * cmf.column.at("y_bar")[i];
        return sum;
    };
    const auto a = [](Real l) { return std::pow(560 / l, 5.0L) / std::expm1(1.435e7L / (2848 * l)) * std::expm1(1.435e7L / (2848 * 560.0L)); };
    for (const auto& [text, share, name] : std::vector<std::tuple<std::string, Real, std::string>>{
             {"0.7*A+0.3*FL11", 0.7L, "FL11"}, {"1*A+1*HP1", 0.5L, "HP1"}, {"0.25*A+2.25*FL3.4", 0.1L, "FL3.4"}}) {
        const auto& other = columns[named.at(name)];
        const Real ya = luminance(a), yb = luminance([&](Real l) { return reference::interpolate(nm, other, l); });
        lamps.push_back({text, at_whole_nm([&, part = share](Real l) { return part * a(l) / ya + (1 - part) * reference::interpolate(nm, other, l) / yb; })});
    }
    // Wavelengths at no even step, in and out of the range that is seen.
    const std::vector<Real> places{350, 391, 410.5L, 433.25L, 435.75L, 438, 480, 543.5L, 546.25L, 549, 610.125L, 612, 640, 700.5L, 760, 900};
    const std::vector<Real> heights{0, 0.1L, 0.5L, 0.25L, 4, 0.25L, 1, 0.75L, 8, 0.5L, 5, 3.5L, 0.125L, 0.25L, 0, 0.5L};
    std::string pairs, ies = "<IESTM2714 version=\"1.0\"><SpectralDistribution>\n", fields, row;
    for (std::size_t i = 0; i < places.size(); ++i) {
        const std::string x = std::to_string(places[i]), y = std::to_string(heights[i]);
        pairs += x + " " + y + "\n";
        ies += "<SpectralData wavelength=\"" + x + "\">" + y + "</SpectralData>\n";
        fields += "SPEC_" + x + " ";
        row += y + " ";
    }
    const auto file = [&](const char* name, const std::string& text) {
        std::ofstream(folder / name) << text;
        lamps.push_back({(folder / name).string(), at_whole_nm([&](Real l) { return reference::interpolate(places, heights, l); })});
    };
    file("lines.csv", pairs);
    file("lines.txt", "# a comment\n" + pairs);
    file("lines.spd", pairs);
    file("lines.spdx", ies + "</SpectralDistribution></IESTM2714>\n");
    file("lines.sp", "CGATS.17\nNUMBER_OF_FIELDS " + std::to_string(places.size()) + "\nBEGIN_DATA_FORMAT\n" + fields +
                         "\nEND_DATA_FORMAT\nNUMBER_OF_SETS 1\nBEGIN_DATA\n" + row + "\nEND_DATA\n");
    return lamps;
}

struct Lights : testing::Test {
    static void SetUpTestSuite() {
        folder = std::filesystem::temp_directory_path() / ("spectex_every_lamp_" + std::to_string(::getpid()));
        std::filesystem::create_directories(folder);
        lamps = every_lamp(folder);
        for (const auto& lamp : lamps) {
            const auto parsed = parse_illuminant(lamp.name);
            ASSERT_TRUE(parsed) << parsed.error().message;
            illuminants.push_back(*parsed);
        }
    }
    static void TearDownTestSuite() { std::filesystem::remove_all(folder); }
    static inline std::filesystem::path folder;
    static inline std::vector<Lamp> lamps;
    static inline std::vector<Illuminant> illuminants;
};

/// An observer's functions at 380 to 780 nm, zero where its table has not begun.
std::array<std::vector<Real>, 3> functions_of(const std::string& file) {
    const auto table = reference::read_csv(std::string(SPECTEX_LUTS_SOURCE) + "/cie/" + file);
    std::array<std::vector<Real>, 3> out;
    static const char* names[] = {"x_bar", "y_bar", "z_bar"};
    for (std::size_t c = 0; c < 3; ++c)
        for (int nm = 380; nm <= 780; ++nm) {
            const auto at = std::find(table.nm.begin(), table.nm.end(), static_cast<Real>(nm));
            out[c].push_back(at == table.nm.end() ? 0 : table.column.at(names[c])[static_cast<std::size_t>(at - table.nm.begin())]);
        }
    return out;
}

/// Every name, every lamp and every file under every method by every observer, against long double sums over whole nanometres.
TEST_F(Lights, EveryOneOfEveryMethodAgreesWithIndependentSums) {
    // Corners, near black and near white, a dark saturated one, greys, and ordinary ones; all are floats.
    std::vector<double> rgb;
    for (int corner = 0; corner < 8; ++corner)
        for (int c = 0; c < 3; ++c) rgb.push_back(corner >> c & 1);
    for (const double v : {0x1p-20, 0x1p-12, 0.0, 0.18, 0.18, 0.18, 1 - 0x1p-12, 1.0, 1 - 0x1p-20, 0x1p-10, 0.0, 0x1p-11, 0.5, 0.25, 0.03, 0.8, 0.7, 0.1})
        rgb.push_back(static_cast<double>(static_cast<float>(v)));
    const std::size_t colours = rgb.size() / 3, lights = lamps.size();
    ASSERT_GT(lights, 401u + 40u);
    std::array<std::vector<float>, 3> planes;
    for (std::size_t i = 0; i < rgb.size(); ++i) planes[i % 3].push_back(static_cast<float>(rgb[i]));
    const auto colorimetry = *Colorimetry::make({}, *BandSet::parse("380:780:5"));
    std::vector<Real> nodes(colorimetry.bands().wavelengths_nm().begin(), colorimetry.bands().wavelengths_nm().end());

    std::set<std::string> beyond_floats;
    // Spectra of every method at whole nanometres.
    std::vector<std::shared_ptr<const Model>> models;
    std::vector<std::vector<std::vector<Real>>> spectra;
    for (const auto& id : ids()) {
        const auto made = make_model(id, colorimetry);
        ASSERT_TRUE(made) << made.error().message;
        models.push_back(*made);
        std::vector<double> bands(colours * nodes.size());
        (*made)->reflectance(rgb, bands);
        spectra.emplace_back();
        for (std::size_t p = 0; p < colours; ++p) {
            const std::vector<Real> r(bands.begin() + static_cast<std::ptrdiff_t>(p * nodes.size()), bands.begin() + static_cast<std::ptrdiff_t>((p + 1) * nodes.size()));
            spectra.back().push_back(at_whole_nm([&](Real nm) { return reference::interpolate(nodes, r, nm); }));
        }
    }
    for (const auto& [observer, file] : std::vector<std::pair<std::string, std::string>>{
             {"cie1931", "cie1931_2deg_360-830-1.csv"}, {"cie1964", "cie1964_10deg_360-830-1.csv"},
             {"cie2006-2", "cie2006_2deg_390-830-1.csv"}, {"cie2006-10", "cie2006_10deg_390-830-1.csv"}}) {
        const auto cmf = functions_of(file);
        const auto weights_of = [&](const std::vector<Real>& power) {
            std::array<std::vector<Real>, 3> w = cmf;
            Real y = 0;
            for (std::size_t l = 0; l < power.size(); ++l) y += power[l] * cmf[1][l];
            for (auto& row : w)
                for (std::size_t l = 0; l < power.size(); ++l) row[l] *= power[l] / y;
            return w;
        };
        const auto sum_of = [](const std::array<std::vector<Real>, 3>& w, const std::vector<Real>& r) {
            reference::Vec3 xyz{};
            for (std::size_t c = 0; c < 3; ++c)
                for (std::size_t l = 0; l < r.size(); ++l) xyz[c] += w[c][l] * r[l];
            return xyz;
        };
        const std::vector<Real> ones(401, 1);
        const auto to_xyz = reference::bt709_to_xyz(sum_of(weights_of(daylight(6500 * 1.4388L / 1.4380L, true)), ones));
        RelightRequest request;
        request.observer = observer;
        request.illuminants = illuminants;
        for (std::size_t m = 0; m < models.size(); ++m) {
            // The observer changes weights alone: one method of each kind of kernel will do for the others.
            const auto& id = models[m]->info().id;
            if (observer != "cie1931" && id != "mallett2019" && id != "lattice" && id != "jakob2019") continue;
            const auto plan = RelightPlan::for_model(models[m], request);
            ASSERT_TRUE(plan) << plan.error().message;
            std::vector<double> doubles(colours * 3 * lights);
            plan->relit(rgb, doubles);
            std::vector<std::vector<float>> floats(3 * lights, std::vector<float>(colours));
            std::vector<float*> out;
            for (auto& plane : floats) out.push_back(plane.data());
            plan->execute_colors({planes[0].data(), planes[1].data(), planes[2].data()}, colours, out);
            std::mutex mutex;
            Real worst_double = 0, worst_float = 0;
            std::string where, where_float;
            tbb::parallel_for(std::size_t{0}, lights, [&](std::size_t k) {
                const auto w = weights_of(lamps[k].power);
                const auto white = sum_of(w, ones);
                for (std::size_t p = 0; p < colours; ++p) {
                    const auto truth = reference::lab(sum_of(w, spectra[m][p]), white);
                    reference::Vec3 d{}, f{};
                    for (std::size_t c = 0; c < 3; ++c) d[c] = doubles[(p * lights + k) * 3 + c], f[c] = floats[3 * k + c][p];
                    const Real in_double = reference::delta_e76(truth, reference::lab(reference::multiply(to_xyz, d), white));
                    const Real in_float = reference::delta_e76(truth, reference::lab(reference::multiply(to_xyz, f), white));
                    // Under a light without any blue, Z is what is left of larger numbers: no three floats hold it to 1e-3.
                    auto nearest = reference::solve(to_xyz, sum_of(w, spectra[m][p]));
                    for (Real& v : nearest) v = static_cast<float>(v);
                    const Real held = reference::delta_e76(truth, reference::lab(reference::multiply(to_xyz, nearest), white));
                    const std::lock_guard lock(mutex);
                    const auto place = lamps[k].name + ", colour " + std::to_string(p);
                    if (!(in_double <= worst_double)) worst_double = in_double, where = place;
                    if (held > 5e-4L) {
                        beyond_floats.insert(lamps[k].name);
                        EXPECT_LE(in_float, 3 * held + 1e-3L) << place;
                    } else if (!(in_float <= worst_float)) {
                        worst_float = in_float, where_float = place;
                    }
                }
            });
            printf("%s, %s: %zu lights, double off by %.2Lg (%s), float by %.2Lg (%s)\n", id.c_str(), observer.c_str(), lights,
                   worst_double, where.c_str(), worst_float, where_float.c_str());
            EXPECT_LE(worst_double, 1e-6L) << id << ", " << observer << ": " << where;
            EXPECT_LE(worst_float, 1e-3L) << id << ", " << observer << ": " << where_float;
        }
    }
    for (const auto& name : beyond_floats) printf("no floats in linear BT.709 hold it: %s\n", name.c_str());
    EXPECT_LE(beyond_floats.size(), 2u);
}

INSTANTIATE_TEST_SUITE_P(Registered, EveryMethod, testing::ValuesIn(ids()), [](const auto& info) {
    std::string name = info.param;
    for (char& c : name) c = std::isalnum(static_cast<unsigned char>(c)) ? c : '_';
    return name;
});

}  // namespace
