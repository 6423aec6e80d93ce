// Lights: lines, lasers, lamps and scales; whites that a cone does not see; quadratures that end early or step far.
#include <fmt/format.h>

#include <algorithm>
#include <mutex>

#include "evaluation/stability.h"
#include "spectex/color.h"
#include "spectex/compare.h"
#include "spectex/solvers.h"

namespace spectex::stability {
namespace {

using quad::Triple;

struct Light {
    Illuminant illuminant;
    bool line = false;
};

Light line_light(std::string name, std::vector<double> nm, std::vector<double> power) {
    return {{std::move(name), "", SpectralDistribution::make(std::move(nm), std::move(power)).value()}, true};
}

std::vector<Light> lights(const StabilityOptions& options) {
    std::vector<Light> out;
    const std::uint32_t step = std::min<std::uint32_t>(options.adversaries, 16);
    for (int l = 360; l <= 830; l += static_cast<int>(step))
        out.push_back(line_light(fmt::format("a line at {} nm", l), {l - 1.0, l + 0.0, l + 1.0}, {0, 1, 0}));
    for (int l = 380; l <= 740; l += 7 * static_cast<int>(step)) {
        // A tenth of a nanometre wide, and not at a whole one.
        const double at = l + 0.37;
        out.push_back(line_light(fmt::format("a laser at {} nm", at), {at - 0.1, at - 0.05, at + 0.05, at + 0.1}, {0, 1, 1, 0}));
    }
    for (const auto& [a, b] : {std::pair{445, 575}, {589, 590}, {405, 680}, {460, 640}, {500, 780}, {380, 700}})
        out.push_back(line_light(fmt::format("lines at {} and {} nm", a, b), {a - 0.5, a + 0.0, a + 0.5, b - 0.25, b + 0.0, b + 0.25}, {0, 3, 0, 0, 1, 0}));
    // Nothing that the short cones see, or the long ones.
    out.push_back(line_light("power above 650 nm", {650, 651, 780}, {0, 1, 1}));
    out.push_back(line_light("power above 560 nm", {560, 561, 780}, {0, 1, 1}));
    out.push_back(line_light("power below 450 nm", {380, 449, 450}, {1, 1, 0}));
    if (const auto all = list_illuminants())
        for (std::size_t i = 0; i < all->size(); i += step)
            if (auto lamp = parse_illuminant((*all)[i].name)) out.push_back({*std::move(lamp)});
    for (const char* name : {"D65", "FL11", "P:1000", "P:20000"})
        for (const double scale : {1.0, 1e-300, 1e-30, 1e30, 1e300}) {
            auto light = *parse_illuminant(name);
            auto values = light.power.values();
            for (double& v : values) v *= scale;
            out.push_back({{fmt::format("{} times {:g}", name, scale), "", SpectralDistribution::make(light.power.wavelengths_nm(), std::move(values)).value()}});
        }
    return out;
}

/// Linear between the table's points; where the table is finer than 1 nm, its mean under a triangle of 2 nm, by Gauss and
/// Legendre's two points a piece, exact for cubics.
Quad power_at(const SpectralDistribution& s, int nm, bool fine) {
    const auto& x = s.wavelengths_nm();
    const auto& v = s.values();
    const auto between = [&](std::size_t i, Quad at) {
        return Quad(v[i - 1]) + (Quad(v[i]) - Quad(v[i - 1])) * (at - Quad(x[i - 1])) / (Quad(x[i]) - Quad(x[i - 1]));
    };
    if (!fine) {
        if (nm < x.front() || nm > x.back()) return 0;
        if (x.size() == 1) return v[0];
        std::size_t i = 1;
        while (i + 1 < x.size() && x[i] < nm) ++i;
        return between(i, Quad(nm));
    }
    const Quad node = 1 / quad::sqrt(Quad(3));
    Quad sum = 0;
    for (std::size_t i = 1; i < x.size(); ++i)
        for (const int side : {-1, 0}) {
            const Quad from = quad::larger(Quad(x[i - 1]), Quad(nm + side)), to = Quad(x[i]) < Quad(nm + side + 1) ? Quad(x[i]) : Quad(nm + side + 1);
            if (!(from < to)) continue;
            for (const int sign : {-1, 1}) {
                const Quad at = (from + to) / 2 + sign * node * (to - from) / 2;
                sum += (to - from) / 2 * between(i, at) * (1 - quad::abs(Quad(at - nm)));
            }
        }
    return sum;
}

struct ExactWeights {
    std::vector<Quad> w;
    Triple<Quad> white{};
};

ExactWeights exact_weights(const BandSet& bands, const Observer& observer, const Illuminant& light) {
    const std::size_t n = bands.size();
    ExactWeights out;
    out.w.assign(3 * n, 0);
    double finest = 1e9;
    const auto& x = light.power.wavelengths_nm();
    for (std::size_t i = 1; i < x.size(); ++i) finest = std::min(finest, x[i] - x[i - 1]);
    const std::array<const std::vector<double>*, 3> cmf{&observer.x_bar, &observer.y_bar, &observer.z_bar};
    for (std::size_t k = 0; k < observer.x_bar.size(); ++k) {
        const int nm = static_cast<int>(observer.start_nm) + static_cast<int>(k);
        if (nm < bands.front() || nm > bands.back()) continue;
        const Quad p = power_at(light.power, nm, finest < 1 - 1e-9);
        std::size_t b = 0;
        while (b + 2 < n && bands[b + 1] <= nm) ++b;
        const Quad t = (Quad(nm) - Quad(bands[b])) / (Quad(bands[b + 1]) - Quad(bands[b]));
        for (std::size_t c = 0; c < 3; ++c) {
            const Quad v = p * Quad((*cmf[c])[k]);
            out.w[c * n + b] += (1 - t) * v, out.w[c * n + b + 1] += t * v, out.white[c] += v;
        }
    }
    const Quad y = out.white[1];
    if (y > 0) {
        for (auto& w : out.w) w /= y;
        for (auto& w : out.white) w /= y;
    }
    return out;
}

void weights(Study& study, const std::vector<Light>& all) {
    std::vector<std::shared_ptr<const Observer>> observers;
    for (const auto& id : observer_ids()) observers.push_back(*find_observer(id));
    const BandSet& bands = study.colorimetry.bands();
    const auto describe = [&](std::uint64_t i) { return all[i / observers.size()].illuminant.name + ", " + observers[i % observers.size()]->title; };
    const auto tally = measure(all.size() * observers.size(), 4, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const auto& light = all[i / observers.size()].illuminant;
            const Observer& observer = *observers[i % observers.size()];
            const auto exact = exact_weights(bands, observer, light);
            const auto got = tristimulus_weights(bands, observer, light, Normalization::luminance);
            // Nothing that can be seen is an error, and nothing else is.
            if (!got || !(exact.white[1] > 0)) {
                t.add(i, !got && !(exact.white[1] > 0) ? 0 : std::nan(""));
                continue;
            }
            double worst = 0;
            bool broken = false;
            for (std::size_t k = 0; k < exact.w.size(); ++k) {
                const double u = ulps(got->w[k], exact.w[k], 1e-200);
                broken = broken || std::isnan(u), worst = std::max(worst, u);
            }
            for (std::size_t c = 0; c < 3; ++c) {
                const double u = ulps(got->white[c], exact.white[c], 1e-200);
                broken = broken || std::isnan(u), worst = std::max(worst, u);
            }
            t.add(i, broken ? std::nan("") : worst);
        }
    });
    study.add("lights", "tristimulus weights of lines, lasers, lamps and scales from 1e-300 to 1e300", "ulp", tally, describe,
              {8, HUGE_VAL, "no term is negative and sums are compensated: power, product, share of the band and scale are rounded once each"});
}

/// Colours under a light and their differences against its white are finite, whatever the light lacks.
void differences_under(Study& study, const std::vector<Light>& all) {
    const BandSet& bands = study.colorimetry.bands();
    const std::size_t n = bands.size();
    constexpr std::array metrics{Metric::cie76, Metric::cie94, Metric::ciede2000, Metric::cmc, Metric::din99, Metric::itp, Metric::oklab};
    const Matrix3 &to_xyz = study.colorimetry.rgb_to_xyz(), &from_xyz = study.colorimetry.xyz_to_rgb();
    const auto tally = measure(all.size(), 4, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const auto w = tristimulus_weights(bands, study.colorimetry.observer(), all[i].illuminant, Normalization::luminance);
            if (!w) continue;
            std::array<std::vector<double>, 3> a, b;
            for (int k = 0; k < 24; ++k) {
                Vector3 xyz{};
                for (std::size_t l = 0; l < n; ++l) {
                    const double r = k == 0 ? 1 : k == 1 ? 0 : unit_of(scrambled(static_cast<std::uint64_t>(k) * n + l));
                    for (std::size_t c = 0; c < 3; ++c) xyz[c] += w->w[c * n + l] * r;
                }
                const Vector3 rgb = from_xyz * xyz;
                for (std::size_t c = 0; c < 3; ++c) a[c].push_back(rgb[c]), b[c].push_back(rgb[c] * (k % 2 ? 0.9 : 1));
            }
            std::rotate(b[0].begin(), b[0].begin() + 3, b[0].end());
            std::array<double, 24> out;
            double most = 0;
            bool broken = false;
            for (const Metric metric : metrics) {
                const DifferenceKernel kernel(metric, to_xyz, to_xyz, w->white);
                kernel(std::array<const double*, 3>{a[0].data(), a[1].data(), a[2].data()}, std::array<const double*, 3>{b[0].data(), b[1].data(), b[2].data()},
                       out.size(), out.data());
                for (const double d : out) broken = broken || !std::isfinite(d), most = std::max(most, d);
            }
            t.add(i, broken ? std::nan("") : 0);
        }
    });
    study.add("lights", "seven differences against the white of every light", "", tally, [&](std::uint64_t i) { return all[i].illuminant.name; },
              {0, HUGE_VAL, "a light may lack what a receptor sees: no difference is made of it, and no NaN"});
}

void adaptation(Study& study, const std::vector<Light>& all) {
    constexpr std::array methods{Adaptation::vonkries, Adaptation::bradford, Adaptation::cat02, Adaptation::cat16};
    constexpr std::array names{"von Kries", "Bradford", "CAT02", "CAT16"};
    // The published matrices once more, as decimals.
    static constexpr long long millionths[4][9] = {
        {389710, 688980, -78680, -229810, 1183400, 46410, 0, 0, 1000000}, {895100, 266400, -161400, -750200, 1713500, 36700, 38900, -68500, 1029600},
        {732800, 429600, -162400, -703600, 1697500, 6100, 3000, 13600, 983400}, {401288, 650173, -51461, -250268, 1204414, 45854, -2079, 48952, 953127}};
    const auto d65 = tristimulus_weights(study.colorimetry.bands(), study.colorimetry.observer(), *parse_illuminant("D65"), Normalization::luminance);
    const Vector3 target = d65->white;
    std::uint64_t refused = 0;
    std::mutex mutex;
    const auto tally = measure(all.size() * 4, 16, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const std::size_t k = i % 4;
            const auto w = tristimulus_weights(study.colorimetry.bands(), study.colorimetry.observer(), all[i / 4].illuminant, Normalization::luminance);
            if (!w) continue;
            quad::Square<Quad> m;
            for (std::size_t e = 0; e < 9; ++e) m[e / 3][e % 3] = Quad(millionths[k][e]) / 1000000;
            const auto from = quad::times(m, quad::wide<Quad>(w->white)), to = quad::times(m, quad::wide<Quad>(target));
            const auto got = adaptation_matrix(methods[k], w->white, target);
            const bool possible = from[0] > Quad(1e-6) && from[1] > Quad(1e-6) && from[2] > Quad(1e-6);
            if (!got) {
                // A response within rounding of the least may go either way.
                const Quad least = std::min({from[0], from[1], from[2]});
                t.add(i, possible && least > Quad(1.0001e-6) ? std::nan("") : 0);
                const std::lock_guard lock(mutex);
                ++refused;
                continue;
            }
            if (!possible) {
                t.add(i, std::nan(""));
                continue;
            }
            auto scaled = m;
            for (std::size_t r = 0; r < 3; ++r)
                for (std::size_t c = 0; c < 3; ++c) scaled[r][c] *= to[r] / from[r];
            const auto back = quad::inverse(m);
            const auto exact = quad::times(back, scaled);
            double worst = 0;
            // An entry of the inverse may have cancelled; its row's largest tells of what.
            const auto row_size = [&](std::size_t r) { return std::max({quad::abs(back[r][0]), quad::abs(back[r][1]), quad::abs(back[r][2])}); };
            for (std::size_t r = 0; r < 3; ++r)
                for (std::size_t c = 0; c < 3; ++c) {
                    Quad size = 0;
                    for (std::size_t e = 0; e < 3; ++e) {
                        // A response is a sum that may have cancelled: its own terms count.
                        Quad terms = 0;
                        for (std::size_t q = 0; q < 3; ++q) terms += quad::abs(Quad(m[e][q] * Quad(w->white[q])));
                        size += row_size(r) * quad::abs(scaled[e][c]) * terms / from[e];
                    }
                    const double u = terms((*got)(r, c), exact[r][c], size);
                    worst = std::isnan(u) ? u : std::max(worst, u);
                }
            t.add(i, worst);
        }
    });
    study.add("lights", "adaptation of every light to D65, four transforms", "2^-53 of terms", tally,
              [&](std::uint64_t i) { return all[i / 4].illuminant.name + ", " + names[i % 4]; },
              {16, HUGE_VAL, fmt::format("two products of three terms each and a quotient of sums of three; {} whites without a cone's response are refused", refused)});
}

/// A Colorimetry under every light either is refused or makes the perfect diffuser (1,1,1).
void colorimetries(Study& study, const std::vector<Light>& all) {
    const auto tally = measure(all.size(), 4, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const auto c = Colorimetry::make({}, study.colorimetry.bands(), all[i].illuminant);
            if (!c) {
                // Only lights of one line or two are no white of an RGB space.
                t.add(i, all[i].line ? 0 : std::nan(""));
                continue;
            }
            const Vector3 one = c->rgb_of(std::vector<double>(c->bands().size(), 1.0));
            double worst = 0;
            for (const double v : one) worst = std::isfinite(v) ? std::max(worst, std::fabs(v - 1)) : std::nan("");
            t.add(i, worst / 0x1p-53);
        }
    });
    study.add("lights", "RGB of the perfect diffuser under every light", "2^-53", tally, [&](std::uint64_t i) { return all[i].illuminant.name; },
              {1e5, HUGE_VAL, "the matrix of a white far outside the primaries' triangle is refused where it would lose more than five digits"});
}

/// The CIE76 that one quadrature differs by from another, over measured-like reflectances under every lamp.
void grids(Study& study, const std::vector<Light>& all) {
    const Observer& observer = study.colorimetry.observer();
    const auto sets = lattice_sample_sets();
    const BandSet fine(SpectralShape::make(380, 780, 1).value()), wide(SpectralShape::make(360, 830, 1).value());
    struct Grid {
        std::string path, reason;
        BandSet bands;
        const BandSet* against;
        double bound;
    };
    const std::vector<Grid> grids{
        {"380 to 780 nm for 360 to 830 nm, at 1 nm, every lamp", "lamps have power, and observers a little sight, beyond; the most that any lamp here loses",
         fine, &wide, 0.6},
        {"5 nm bands for 1 nm, every lamp", "measured reflectances bend little within 5 nm, and the light is integrated at 1 nm",
         BandSet(SpectralShape::make(380, 780, 5).value()), &fine, 0.6},
        {"10 nm bands for 1 nm, every lamp", "the same within 10 nm; under sodium light all hangs on one wavelength", BandSet(SpectralShape::make(380, 780, 10).value()), &fine, 8},
        {"20 nm bands for 1 nm, every lamp", "the same within 20 nm", BandSet(SpectralShape::make(380, 780, 20).value()), &fine, 15}};
    std::vector<SpectralDistribution> samples;
    for (const auto& set : *sets)
        for (std::size_t k = 0; k < set.samples.size(); k += 5 * std::min<std::uint32_t>(study.options.adversaries, 8))
            samples.push_back(SpectralDistribution::make(set.wavelengths_nm, set.samples[k]).value());
    for (const auto& g : grids) {
        const auto resampled = [&](const BandSet& b) {
            std::vector<std::vector<double>> out;
            for (const auto& s : samples) out.push_back(s.resampled(b.wavelengths_nm(), Interpolation::linear, Extrapolation::hold));
            return out;
        };
        const auto coarse = resampled(g.bands), exact = resampled(*g.against);
        const auto tally = measure(all.size(), 2, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            for (std::uint64_t i = first; i < last; ++i) {
                if (all[i].line) continue;
                const auto a = tristimulus_weights(*g.against, observer, all[i].illuminant, Normalization::luminance);
                const auto b = tristimulus_weights(g.bands, observer, all[i].illuminant, Normalization::luminance);
                if (!a || !b) continue;
                double most = 0;
                for (std::size_t s = 0; s < samples.size(); ++s) {
                    const auto lab = [&](const TristimulusWeights& w, const std::vector<double>& r) {
                        Vector3 xyz{};
                        for (std::size_t c = 0; c < 3; ++c)
                            for (std::size_t l = 0; l < r.size(); ++l) xyz[c] += w.w[c * r.size() + l] * r[l];
                        return lab_from_xyz(xyz, w.white);
                    };
                    most = std::max(most, delta_e76(lab(*a, exact[s]), lab(*b, coarse[s])));
                }
                t.add(i, 0, most);
            }
        });
        study.add("lights", g.path, "", tally, [&](std::uint64_t i) { return all[i].illuminant.name; }, {0, g.bound, "a figure: " + g.reason});
    }
}

}  // namespace

Status study_lights(Study& study) {
    const auto all = lights(study.options);
    weights(study, all);
    differences_under(study, all);
    adaptation(study, all);
    colorimetries(study, all);
    grids(study, all);
    return {};
}

}  // namespace spectex::stability
