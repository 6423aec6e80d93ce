// Methods: from a colour to a spectrum and back, through every kind of storage, relit, and from one colour to its neighbour.
#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <mutex>

#include "evaluation/stability.h"
#include "methods/burns2020.h"
#include "methods/jakob2019.h"
#include "methods/peters2019.h"
#include "spectex/compare.h"
#include "spectex/io.h"
#include "spectex/methods.h"
#include "spectex/plan.h"

namespace spectex::stability {
namespace {

/// Methods that solve per colour take fewer colours than those that blend.
std::uint64_t thinning(std::string_view id) {
    if (id.starts_with("peters2019")) return 400;
    if (id == "burns2020") return 50;
    if (id.starts_with("jakob2019") || id.starts_with("otsu2018") || id.starts_with("macadam1935") || id.starts_with("meng2015")) return 8;
    return 1;
}

/// Sums of rows of weights over spectra, with the sizes of their terms.
template <class Real>
void integrals(const std::vector<double>& weights, const double* r, std::size_t bands, quad::Triple<Real>& sum, quad::Triple<Real>& size) {
    for (std::size_t i = 0; i < 3; ++i) {
        sum[i] = 0, size[i] = 0;
        for (std::size_t b = 0; b < bands; ++b) {
            const Real t = Real(weights[i * bands + b]) * Real(r[b]);
            sum[i] += t, size[i] += quad::abs(t);
        }
    }
}

/// CIE76 between two linear colours, right to some 1e-16.
class Difference {
public:
    explicit Difference(const Colorimetry& c)
        : m_(quad::wide<long double>(c.rgb_to_xyz())), white_(white_of_grey<long double>(c.rgb_to_xyz(), c.white_xyz())) {}
    double operator()(const quad::Triple<long double>& a, const quad::Triple<long double>& b) const {
        return static_cast<double>(quad::distance(quad::lab_of(quad::times(m_, a), white_), quad::lab_of(quad::times(m_, b), white_)));
    }

private:
    quad::Square<long double> m_;
    quad::Triple<long double> white_;
};

struct Subject {
    Study& study;
    const Model& model;
    std::shared_ptr<const Model> shared;
    std::size_t bands;
    std::string name() const { return model.info().id; }
};

constexpr std::uint64_t part = 512;

std::vector<double> flat(const Colors& colors, std::uint64_t first, std::uint64_t last) {
    std::vector<double> rgb;
    for (std::uint64_t i = first; i < last; ++i)
        for (const double v : colors[i]) rgb.push_back(v);
    return rgb;
}

/// A r = rgb in double, and r within [0,1].
void exactness(Subject& s) {
    const Colors colors(s.study.options, Colors::Range::cube, false, thinning(s.name()));
    const auto& a = s.study.colorimetry.sensing_matrix();
    const Difference difference(s.study.colorimetry);
    const bool exact = s.model.info().exact;
    const bool solved = s.model.info().pieces == Pieces::nonlinear;
    const auto tally = measure(colors.size(), part, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        const auto rgb = flat(colors, first, last);
        std::vector<double> r((last - first) * s.bands);
        s.model.reflectance(rgb, r);
        for (std::uint64_t i = first; i < last; ++i) {
            const double* spectrum = &r[(i - first) * s.bands];
            const double* colour = &rgb[3 * (i - first)];
            bool broken = false;
            for (std::size_t b = 0; b < s.bands; ++b)
                broken = broken || !std::isfinite(spectrum[b]) || (s.model.info().bounded && (spectrum[b] < 0 || spectrum[b] > 1));
            const double top = std::max({colour[0], colour[1], colour[2]});
            const auto error = [&]<class Real>() {
                quad::Triple<Real> sum, size;
                integrals(a, spectrum, s.bands, sum, size);
                double worst = 0;
                for (std::size_t c = 0; c < 3; ++c) {
                    const double miss = static_cast<double>(quad::abs(Real(sum[c] - Real(colour[c]))));
                    worst = std::max(worst, miss / (solved ? 1e-12 * top + 1e-14 : 0x1p-53 * std::max(0x1p-1000, static_cast<double>(size[c]))));
                }
                return worst;
            };
            double worst = 0, de = 0;
            if (exact && !broken) {
                worst = error.template operator()<long double>();
                if (worst > t.worst) worst = error.template operator()<Quad>();
                quad::Triple<long double> sum, size;
                integrals(a, spectrum, s.bands, sum, size);
                de = difference(sum, {colour[0], colour[1], colour[2]});
            }
            t.add(i, broken ? std::nan("") : worst, de);
        }
    });
    Bounds bounds{0, 0, "not exact: only finite, and in [0,1] where it says so"};
    if (exact && !solved) bounds = {64, 1e-11, "the spectra blended are exact to 1e-15, and a blend of four is rounded seven times"};
    if (exact && solved) bounds = {4, 1e-9, "what iterations stop at, and some roundings of sums of numbers up to 1; at black a difference of 1e-14 is a CIE76 of 5e-11"};
    s.study.add("methods", fmt::format("{}: A r = rgb, double", s.name()), solved ? "1e-12 of the colour and 1e-14" : "2^-53 of terms", tally, [&](std::uint64_t i) { return colors.describe(i); }, bounds);
}

/// What storage and reprojection in files' types add to the spectrum of the method.
void storage(Subject& s, Store store, PixelType type) {
    const Colors colors(s.study.options, Colors::Range::cube, true, thinning(s.name()) * 2);
    const auto& a = s.study.colorimetry.sensing_matrix();
    const Difference difference(s.study.colorimetry);
    const auto plan = StorePlan::make(s.shared, store, type);
    if (!plan) return;
    const std::size_t bytes = pixel_bytes(type);
    const auto tally = measure(colors.size(), part, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        const std::size_t n = last - first;
        const auto rgb = flat(colors, first, last);
        std::vector<double> r(n * s.bands);
        s.model.reflectance(rgb, r);
        std::array<std::vector<float>, 3> in, out;
        for (std::size_t c = 0; c < 3; ++c) {
            out[c].resize(n);
            for (std::size_t i = 0; i < n; ++i) in[c].push_back(static_cast<float>(rgb[3 * i + c]));
        }
        std::vector<std::byte> samples(plan->channels() * n * bytes);
        std::vector<std::byte*> planes;
        for (std::size_t b = 0; b < plan->channels(); ++b) planes.push_back(samples.data() + b * n * bytes);
        plan->store({in[0].data(), in[1].data(), in[2].data()}, n, planes);
        const std::vector<const std::byte*> stored(planes.begin(), planes.end());
        plan->reproject(stored, n, {out[0].data(), out[1].data(), out[2].data()});
        for (std::size_t i = 0; i < n; ++i) {
            quad::Triple<long double> sum, size;
            integrals(a, &r[i * s.bands], s.bands, sum, size);
            double worst = 0;
            bool broken = false;
            for (std::size_t c = 0; c < 3; ++c) {
                broken = broken || !std::isfinite(out[c][i]);
                // Of a number of the file's type, of the terms' size.
                const double scale = static_cast<double>(std::max(size[c], 1e-30L));
                const double unit = type == PixelType::half ? half_spacing(scale) : spacing<float>(scale);
                worst = std::max(worst, std::fabs(static_cast<double>(out[c][i] - sum[c])) / unit);
            }
            t.add(first + i, broken ? std::nan("") : worst, broken ? 0 : difference(sum, {out[0][i], out[1][i], out[2][i]}));
        }
    });
    Bounds bounds;
    const bool spectral = store == Store::spectral, half = type == PixelType::half;
    const bool linear = s.model.info().pieces != Pieces::nonlinear;
    if (!half) bounds = {linear || spectral ? 4.0 : 4096.0, 1e-3, linear || spectral ? "each float is rounded once, and the sum once more" : "coefficients as floats: the terms of a steep spectrum cancel by some 1e3"};
    else if (linear || spectral) bounds = {8, 0.15, "halves are rounded once; bands together, so that their errors cancel"};
    else bounds = {4096, 25, "coefficients as halves: a spectrum of steep slope moves"};
    // Its clusters' spectra are clipped near black, each to a colour of its own, and rounding changes the cluster.
    if (s.name() == "otsu2018" && half && !spectral)
        bounds = {8192, 25, "near black the clusters' clipped spectra are up to 2.6e-4 of linear RGB apart, 4300 of the least halves"};
    s.study.add("methods", fmt::format("{}: {} {} and back", s.name(), half ? "half" : "float", spectral ? "bands" : "coefficients"),
                half ? "ulp of half" : "ulp of float", tally, [&](std::uint64_t i) { return colors.describe(i); }, bounds);
}

/// Relit by the plan that the tools run, in floats, against sums over the method's own spectra.
void relit(Subject& s) {
    const Colors colors(s.study.options, Colors::Range::cube, true, thinning(s.name()) * 2);
    RelightRequest request;
    request.observer = s.study.colorimetry.observer().id;
    for (const char* name : {"A", "FL11"}) request.illuminants.push_back(*parse_illuminant(name));
    const auto plan = RelightPlan::for_model(s.shared, request);
    const auto output = Colorimetry::make({}, s.study.colorimetry.bands());
    if (!plan || !output) return;
    std::vector<std::vector<double>> weights;
    for (const auto& light : request.illuminants) {
        const auto w = tristimulus_weights(s.study.colorimetry.bands(), s.study.colorimetry.observer(), light, Normalization::luminance);
        std::vector<double> rows(3 * s.bands);
        for (std::size_t i = 0; i < 3; ++i)
            for (std::size_t b = 0; b < s.bands; ++b) {
                long double sum = 0;
                for (std::size_t k = 0; k < 3; ++k)
                    sum += static_cast<long double>(output->xyz_to_rgb()(i, k)) * static_cast<long double>(w->w[k * s.bands + b]);
                rows[i * s.bands + b] = static_cast<double>(sum);
            }
        weights.push_back(std::move(rows));
    }
    const auto tally = measure(colors.size(), part, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        const std::size_t n = last - first;
        const auto rgb = flat(colors, first, last);
        std::vector<double> r(n * s.bands);
        s.model.reflectance(rgb, r);
        std::array<std::vector<float>, 3> in;
        std::array<std::vector<float>, 6> out;
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t i = 0; i < n; ++i) in[c].push_back(static_cast<float>(rgb[3 * i + c]));
        std::vector<float*> planes;
        for (auto& plane : out) plane.resize(n), planes.push_back(plane.data());
        plan->execute_colors({in[0].data(), in[1].data(), in[2].data()}, n, planes);
        for (std::size_t i = 0; i < n; ++i) {
            double worst = 0;
            for (std::size_t k = 0; k < weights.size(); ++k) {
                quad::Triple<long double> sum, size;
                integrals(weights[k], &r[i * s.bands], s.bands, sum, size);
                for (std::size_t c = 0; c < 3; ++c) {
                    const float got = out[3 * k + c][i];
                    const double e = std::fabs(static_cast<double>(got - sum[c])) / spacing<float>(static_cast<double>(std::max(size[c], 1e-38L)));
                    worst = std::isfinite(got) ? std::max(worst, e) : std::nan("");
                }
            }
            t.add(first + i, worst);
        }
    });
    s.study.add("methods", fmt::format("{}: relit under A and FL11, float planes", s.name()), "ulp of float, of terms", tally,
                [&](std::uint64_t i) { return colors.describe(i); }, {0.51, HUGE_VAL, "double inside, rounded once"});
}

/// The largest change of a band, for one unit in the last place of a component as a float.
void sensitivity(Subject& s) {
    const Colors colors(s.study.options, Colors::Range::cube, true, thinning(s.name()) * 2);
    const auto tally = measure(colors.size(), part, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        auto rgb = flat(colors, first, last);
        std::vector<double> r((last - first) * s.bands), moved(r.size());
        s.model.reflectance(rgb, r);
        for (std::uint64_t i = first; i < last; ++i) {
            const std::uint64_t h = scrambled(i);
            double& v = rgb[3 * (i - first) + h % 3];
            v = static_cast<double>(std::nextafter(static_cast<float>(v), h & 64 ? (v == 1 ? 0.0f : 1.0f) : (v == 0 ? 1.0f : 0.0f)));
        }
        s.model.reflectance(rgb, moved);
        for (std::uint64_t i = first; i < last; ++i) {
            double most = 0;
            for (std::size_t b = 0; b < s.bands; ++b) {
                const double d = std::fabs(r[(i - first) * s.bands + b] - moved[(i - first) * s.bands + b]);
                most = std::isnan(d) ? d : std::max(most, d);
            }
            t.add(i, most / 0x1p-24);
        }
    });
    Bounds bounds{64, HUGE_VAL, "continuous, with a slope of at most some tens"};
    if (s.name().starts_with("jakob2019") || s.name().starts_with("macadam1935") || s.name().starts_with("otsu2018"))
        bounds = {0x1p24, HUGE_VAL, "a figure, not an error: the method's own spectrum jumps at black and white (otsu2018: between clusters)"};
    if (s.name().starts_with("peters2019"))
        bounds = {4096, HUGE_VAL, "as the others, of a narrow peak that is some tens of times its colour: a unit near 1 is much of what is left of the complement"};
    if (s.model.info().pieces == Pieces::linear) bounds = {1.01, HUGE_VAL, "no band of a primary exceeds 1"};
    s.study.add("methods", fmt::format("{}: change of a band per ulp of a component", s.name()), "2^-24", tally,
                [&](std::uint64_t i) { return colors.describe(i); }, bounds);
}

}  // namespace

Status study_methods(Study& study) {
    for (const auto& id : study.options.methods) {
        const auto made = make_model(id, study.colorimetry);
        if (!made) return made.error();
        Subject subject{study, **made, *made, study.colorimetry.bands().size()};
        exactness(subject);
        for (const Store store : {Store::coefficients, Store::spectral})
            for (const PixelType type : {PixelType::float32, PixelType::half}) storage(subject, store, type);
        relit(subject);
        sensitivity(subject);
    }
    return {};
}

Status study_solvers(Study& study) {
    const auto chosen = [&](std::string_view prefix) {
        return std::any_of(study.options.methods.begin(), study.options.methods.end(), [&](const auto& id) { return id.starts_with(prefix); });
    };
    StabilityOptions only_codes = study.options;
    only_codes.colors = 0, only_codes.adversaries = 1u << 30;
    if (chosen("jakob2019")) {
        const auto solver = jakob2019::Solver::shared(study.colorimetry);
        const Colors colors(only_codes, Colors::Range::cube, true);
        std::mutex mutex;
        jakob2019::Counts all;
        const auto& a = study.colorimetry.sensing_matrix();
        const std::size_t bands = study.colorimetry.bands().size();
        const auto tally = measure(colors.size(), 4096, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            const auto rgb = flat(colors, first, last);
            std::vector<double> c(rgb.size());
            jakob2019::Counts mine;
            solver->solve(rgb, c, &mine);
            for (std::uint64_t i = first; i < last; ++i) {
                // The spectrum of the coefficients by another formula, and its colour.
                const double* k = &c[3 * (i - first)];
                double worst = 0;
                const double top = std::max({rgb[3 * (i - first)], rgb[3 * (i - first) + 1], rgb[3 * (i - first) + 2]});
                for (std::size_t row = 0; row < 3; ++row) {
                    long double sum = 0;
                    for (std::size_t b = 0; b < bands; ++b) {
                        const long double x = (static_cast<long double>(k[0]) * solver->nodes()[b] + k[1]) * solver->nodes()[b] + k[2];
                        sum += a[row * bands + b] * (0.5L + x / (2 * std::sqrt(1 + x * x)));
                    }
                    worst = std::max(worst, std::fabs(static_cast<double>(sum - static_cast<long double>(rgb[3 * (i - first) + row]))));
                }
                t.add(i, worst / (1e-12 * top + 1e-14));
            }
            const std::lock_guard lock(mutex);
            for (std::size_t p = 0; p < 4; ++p) all.passes[p] += mine.passes[p];
            all.closed += mine.closed, all.damped += mine.damped, all.nearest += mine.nearest;
        });
        study.report.solvers.push_back({"jakob2019", tally.cases, all.nearest,
                                        {{"closed form", all.closed}, {"3 Newton steps", all.passes[0]}, {"5 steps", all.passes[1]}, {"7 steps", all.passes[2]},
                                         {"9 steps", all.passes[3]}, {"damped, one by one", all.damped}, {"none found: the nearest", all.nearest}}});
        study.add("solvers", "jakob2019: A r(c) = rgb for every code", "1e-12 of the colour and 1e-14", tally, [&](std::uint64_t i) { return colors.describe(i); },
                  {4, HUGE_VAL, "the steps foretell 1e-12 beside the rounding of the sums"});
        study.figure("solvers", "jakob2019: codes without a solution", "codes", static_cast<double>(all.nearest), "",
                     {0, HUGE_VAL, "every colour of the cube of BT.709 has a sigmoid"});
    }
    // Outside the solid of object colours there is no spectrum: the nearest is taken, named, and finite.
    if (chosen("jakob2019")) {
        ColorimetrySpec wide;
        wide.rgb_space = "Rec.2020";
        const auto colorimetry = Colorimetry::make(wide, study.colorimetry.bands());
        const auto model = colorimetry ? make_model("jakob2019", *colorimetry) : Result<std::shared_ptr<const Model>>(colorimetry.error());
        if (!model) return model.error();
        only_codes.stride = std::max(study.options.stride, 4099u);
        const Colors colors(only_codes, Colors::Range::cube, true);
        const std::size_t bands = colorimetry->bands().size();
        const auto& a = colorimetry->sensing_matrix();
        std::atomic<std::uint64_t> missed{0};
        const auto tally = measure(colors.size(), 256, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            const auto rgb = flat(colors, first, last);
            std::vector<double> r((last - first) * bands);
            (*model)->reflectance(rgb, r);
            const auto named = (*model)->unreached(rgb);
            missed += named.size();
            for (std::uint64_t i = first; i < last; ++i) {
                quad::Triple<long double> sum, size;
                integrals(a, &r[(i - first) * bands], bands, sum, size);
                double miss = 0;
                bool broken = false;
                for (std::size_t c = 0; c < 3; ++c) miss = std::max(miss, std::fabs(static_cast<double>(sum[c]) - rgb[3 * (i - first) + c]));
                for (std::size_t b = 0; b < bands; ++b) broken = broken || !(r[(i - first) * bands + b] >= 0 && r[(i - first) * bands + b] <= 1);
                const bool is_named = std::binary_search(named.begin(), named.end(), i - first);
                // Named where it is off, and nowhere else.
                t.add(i, broken || (miss > 1e-9 && !is_named) || (miss < 1e-13 * std::max({rgb[3 * (i - first)], rgb[3 * (i - first) + 1], rgb[3 * (i - first) + 2]}) && is_named) ? std::nan("") : is_named ? miss : 0);
            }
        });
        study.report.solvers.push_back({"jakob2019, Rec.2020", tally.cases, missed.load(), {{"none found: the nearest", missed.load()}}});
        study.add("solvers", "jakob2019 in Rec.2020: the nearest where there is none, and named", "linear RGB", tally,
                  [&](std::uint64_t i) { return colors.describe(i); }, {0.5, HUGE_VAL, "finite, in [0,1] and off by what the solid of object colours lacks"});
    }
    if (chosen("burns2020")) {
        only_codes.stride = std::max<std::uint32_t>(study.options.stride, 2003);
        const Colors colors(only_codes, Colors::Range::cube, true);
        const burns2020::Solver solver(study.colorimetry);
        std::array<std::atomic<std::uint64_t>, 5> steps{};
        std::atomic<std::uint64_t> missed{0};
        const auto tally = measure(colors.size(), 64, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            burns2020::Solver::Work work(solver.bands());
            std::vector<double> r(solver.bands());
            for (std::uint64_t i = first; i < last; ++i) {
                const auto s = solver.solve(colors[i].data(), r.data(), work);
                ++steps[static_cast<std::size_t>(s.steps <= 0 ? 0 : s.steps <= 8 ? 1 : s.steps <= 16 ? 2 : s.steps <= 32 ? 3 : 4)];
                missed += s.error > 1e-9;
                t.add(i, s.error);
            }
        });
        study.report.solvers.push_back({"burns2020", tally.cases, missed.load(),
                                        {{"closed form", steps[0]}, {"1 to 8 Newton steps", steps[1]}, {"9 to 16", steps[2]}, {"17 to 32", steps[3]},
                                         {"more", steps[4]}, {"none found: the nearest", missed.load()}}});
        study.add("solvers", "burns2020: error of what the solver found", "of the colour", tally, [&](std::uint64_t i) { return colors.describe(i); },
                  {1e-11, HUGE_VAL, "Newton's steps go on to rounding: sums of 81 terms, over the lesser of a colour and its complement"});
    }
    if (chosen("peters2019")) {
        only_codes.stride = std::max<std::uint32_t>(study.options.stride, 20011);
        const Colors colors(only_codes, Colors::Range::cube, true);
        const peters2019::Solver solver(study.colorimetry);
        std::array<std::atomic<std::uint64_t>, 5> steps{};
        std::atomic<std::uint64_t> missed{0};
        const auto tally = measure(colors.size(), 64, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            for (std::uint64_t i = first; i < last; ++i) {
                const auto s = solver.solve(colors[i]);
                ++steps[static_cast<std::size_t>(s.steps <= 0 ? 0 : s.steps <= 8 ? 1 : s.steps <= 16 ? 2 : s.steps <= 32 ? 3 : 4)];
                missed += s.error > 1e-9;
                t.add(i, s.error);
            }
        });
        study.report.solvers.push_back({"peters2019", tally.cases, missed.load(),
                                        {{"closed form", steps[0]}, {"1 to 8 Newton steps", steps[1]}, {"9 to 16", steps[2]}, {"17 to 32", steps[3]},
                                         {"more", steps[4]}, {"none found: the nearest", missed.load()}}});
        study.add("solvers", "peters2019: error of what the solver found", "of the colour", tally, [&](std::uint64_t i) { return colors.describe(i); },
                  {1e-11, HUGE_VAL, "Newton's steps end at 1e-12, or rounding"});
    }
    return {};
}

}  // namespace spectex::stability
