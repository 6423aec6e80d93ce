// Colour differences: where their formulas are singular, and from linear RGB by the kernels.
#include <fmt/format.h>

#include <algorithm>

#include "compare/spaces.h"
#include "evaluation/stability.h"
#include "spectex/compare.h"

namespace spectex::stability {
namespace {

using quad::Triple;

constexpr std::array metrics{Metric::cie76, Metric::cie94, Metric::ciede2000, Metric::cmc, Metric::din99, Metric::itp, Metric::oklab};

struct Pair {
    Vector3 a, b;
    std::string text() const { return text_of(a) + " against " + text_of(b); }
};

/// The formula of a metric over Lab, on either branch where it jumps.
template <class Real>
Real formula(Metric metric, const Triple<Real>& p, const Triple<Real>& q, double slack, int branch, bool* jumps) {
    switch (metric) {
        case Metric::cie76: return quad::distance(p, q);
        case Metric::cie94: return quad::cie94(p, q);
        case Metric::ciede2000: return quad::ciede2000(p, q, slack, branch, jumps);
        case Metric::cmc: return quad::cmc(p, q, slack, branch, jumps);
        default: return quad::distance(quad::din99_of(p), quad::din99_of(q));
    }
}
double library(Metric metric, const Vector3& p, const Vector3& q) {
    switch (metric) {
        case Metric::cie76: return delta_e76(p, q);
        case Metric::cie94: return delta_e94(p, q);
        case Metric::ciede2000: return delta_e2000(p, q);
        case Metric::cmc: return delta_cmc(p, q);
        default: return delta_e_din99(p, q);
    }
}

/// Pairs of Lab about every singularity.
std::vector<Pair> singular_pairs(const StabilityOptions& options) {
    std::vector<Pair> out;
    const std::array lightness{-8e3, -8.0, 0.0, 5e-324, 1e-12, 15.999, 16.0, 50.0, 100.0, 3e4};
    const std::array chroma{0.0, 5e-324, 1e-170, 1e-20, 1e-9, 1e-3, 25.0, 120.0, 1e4, 1e100};
    const double degree = std::atan(1.0) / 45;
    std::uint64_t h = options.seed;
    const auto next = [&] { return unit_of(h = scrambled(h)); };
    for (const double l : lightness)
        for (const double c : chroma)
            for (int k = 0; k < 24; ++k) {
                // Axes, the rotation term's 275 degrees, the jumps of CMC at 164 and 345, and others.
                const std::array special{0.0, 90.0, 180.0, 270.0, 275.0, 164.0, 345.0, 30.0, 63.0};
                const double hue = k < 9 ? special[static_cast<std::size_t>(k)] : 360 * next();
                Vector3 a{l, c * std::cos(hue * degree), c * std::sin(hue * degree)};
                if (k < 4 && k % 2 == 0) a[2] = 0;
                if (k < 4 && k % 2 == 1) a[1] = 0;
                out.push_back({a, a});
                // Neutral, opposite exactly, opposite nearly, of another size.
                out.push_back({a, {l, 0, 0}});
                out.push_back({{l, 0, 0}, a});
                out.push_back({a, {l, -a[1], -a[2]}});
                out.push_back({a, {50, -0.5 * a[1], -0.5 * a[2]}});
                out.push_back({a, {l, std::nextafter(-a[1], 0), -a[2]}});
                out.push_back({a, {l, -a[1] * (1 + 1e-9), -a[2]}});
                // Nearly the same.
                for (const double e : {0x1p-52, 1e-12, 1e-8, 1e-4, 0.1}) {
                    const double m = std::max(c, 1e-300);
                    out.push_back({a, {l + e * std::fabs(l), a[1] + e * m * (next() - 0.5), a[2] + e * m * (next() - 0.5)}});
                    out.push_back({a, {l, a[1] * (1 + e), a[2] * (1 + e)}});
                    out.push_back({a, {l, a[1] + e * a[2], a[2] - e * a[1]}});
                }
                // Anything.
                out.push_back({a, {100 * next(), 240 * next() - 120, 240 * next() - 120}});
            }
    const std::size_t step = std::min<std::size_t>(options.adversaries, 32);
    std::vector<Pair> some;
    for (std::size_t i = 0; i < out.size(); i += step) some.push_back(out[i]);
    return some;
}

Bounds formula_bounds(Metric metric) {
    switch (metric) {
        case Metric::cie76: return {2, 1e-11, "three differences that are exact for near colours, their squares, and a root"};
        case Metric::cie94: return {12, 1e-11, "the chromas' and hues' differences by forms that do not cancel; hues just under 90 degrees apart lose a digit"};
        case Metric::ciede2000: return {64, 1e-11, "as CIE94, with weights of some ten roundings, and the rotation term, which leaves at least 0.13 of the sum"};
        case Metric::cmc: return {16, 1e-11, "as CIE94, with weights of some five roundings"};
        default: return {16, 1e-11, "a distance of two coordinates, each right to some units"};
    }
}

Bounds kernel_bounds(Metric metric, bool single) {
    const bool pq = metric == Metric::itp;
    if (single && metric == Metric::ciede2000)
        return {128, 1e-3, "what weighs the differences is float: 5e-6 of the result where the rotation term cancels, below 1e-6 elsewhere"};
    if (single)
        return {pq ? 64.0 : 32.0, 1e-10,
                pq ? "1 of the last rounding, and for differences near 1e-6 what 720 times the PQ curve, of slope 79, leaves in double"
                   : "1 of the last rounding, and for differences near 1e-6 what Lab in double leaves, 1e-12"};
    if (metric == Metric::cmc) return {516, 6e-11, "as the others, which are right to 256, over weights that go down to 0.497 for references of little chroma"};
    return {pq ? 512.0 : 256.0, 3e-11, pq ? "720 times the PQ curve, whose power is 79" : "Lab of colours up to 2 is right to 1e-12; weights are continuous there"};
}

}  // namespace

void study_differences(Study& study) {
    const auto pairs = singular_pairs(study.options);
    const auto describe = [&](std::uint64_t i) { return pairs[i].text(); };
    for (const Metric metric : metrics) {
        if (metric == Metric::itp || metric == Metric::oklab) continue;
        const auto tally = measure(pairs.size(), 256, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            for (std::uint64_t i = first; i < last; ++i) {
                const auto& [a, b] = pairs[i];
                const double got = library(metric, a, b);
                if (a == b) {
                    t.add(i, got == 0 ? 0 : std::nan(""));
                    continue;
                }
                bool jumps = false;
                const auto p = quad::wide<Quad>(a), q = quad::wide<Quad>(b);
                // The hue angles in double are right to 1e-13 degrees.
                constexpr double slack = 1e-12;
                Quad exact = formula(metric, p, q, slack, 0, &jumps);
                // Where a weight depends on a hue that lies nearly on a jump, either side is right.
                if (jumps) {
                    const Quad other = formula(metric, p, q, slack, 1, nullptr);
                    if (quad::abs(Quad(Quad(got) - other)) < quad::abs(Quad(Quad(got) - exact))) exact = other;
                }
                const double magnitude = std::max({1.0, std::fabs(a[1]), std::fabs(a[2]), std::fabs(b[1]), std::fabs(b[2])});
                const double least = metric == Metric::din99 ? std::max(1.0, static_cast<double>(quad::distance(quad::din99_of(p), {0, 0, 0}))) : 1e-100;
                t.add(i, ulps(got, exact, least), magnitude > 1e5 || std::fabs(a[0]) > 1e3 ? 0 : static_cast<double>(quad::abs(Quad(Quad(got) - exact))));
            }
        });
        study.add("differences", fmt::format("{} of Lab, double", metric_name(metric)), metric == Metric::din99 ? "ulp of coordinates" : "ulp", tally, describe, formula_bounds(metric));
    }
    // From linear RGB: neighbours in the last place, neighbours in code, opposites, and anything.
    const Matrix3& m = study.colorimetry.rgb_to_xyz();
    const Vector3 white = study.colorimetry.white_xyz();
    for (const bool single : {false, true}) {
        const Colors colors(study.options, Colors::Range::any, single, 8);
        const auto partner = [&](std::uint64_t i) {
            Vector3 v = colors[i];
            const std::uint64_t h = scrambled(i ^ 0x5eed);
            const auto axis = h % 3;
            const auto nudged = [&](double x) {
                return single ? static_cast<double>(std::nextafter(static_cast<float>(x), h & 64 ? 2.0f : -1.0f)) : std::nextafter(x, h & 64 ? 2.0 : -1.0);
            };
            switch (h >> 3 & 7) {
                case 0: return v;
                case 1: case 2: v[axis] = nudged(v[axis]); return v;
                case 3: for (double& x : v) x = nudged(x); return v;
                case 4: v[axis] *= 1 + 1e-3; break;
                case 5: std::swap(v[axis], v[(axis + 1) % 3]); break;
                default: v = colors[scrambled(h) % colors.size()]; break;
            }
            if (single) for (double& x : v) x = rounded(x);
            return v;
        };
        const auto text = [&](std::uint64_t i) { return Pair{colors[i], partner(i)}.text(); };
        for (const Metric metric : metrics) {
            const DifferenceKernel kernel(metric, m, m, white);
            constexpr std::uint64_t part = 1024;
            const auto tally = measure(colors.size(), part, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
                std::array<std::array<float, part>, 6> fs;
                std::array<std::array<double, part>, 6> ds;
                std::array<float, part> fo;
                std::array<double, part> dout;
                for (std::uint64_t i = first; i < last; ++i) {
                    const Vector3 a = colors[i], b = partner(i);
                    for (std::size_t c = 0; c < 3; ++c) {
                        ds[c][i - first] = a[c], ds[3 + c][i - first] = b[c];
                        fs[c][i - first] = static_cast<float>(a[c]), fs[3 + c][i - first] = static_cast<float>(b[c]);
                    }
                }
                if (single)
                    kernel(std::array<const float*, 3>{fs[0].data(), fs[1].data(), fs[2].data()},
                           std::array<const float*, 3>{fs[3].data(), fs[4].data(), fs[5].data()}, last - first, fo.data());
                else
                    kernel(std::array<const double*, 3>{ds[0].data(), ds[1].data(), ds[2].data()},
                           std::array<const double*, 3>{ds[3].data(), ds[4].data(), ds[5].data()}, last - first, dout.data());
                for (std::uint64_t i = first; i < last; ++i) {
                    const Vector3 a = colors[i], b = partner(i);
                    const double got = single ? static_cast<double>(fo[i - first]) : dout[i - first];
                    bool finite = true;
                    double size = 0;
                    for (std::size_t c = 0; c < 3; ++c) {
                        finite = finite && std::isfinite(a[c]) && std::isfinite(b[c]);
                        size = std::max({size, std::fabs(a[c]), std::fabs(b[c])});
                    }
                    if (!finite) {
                        t.add(i, std::isfinite(got) ? std::nan("") : 0);
                        continue;
                    }
                    if (a == b) {
                        t.add(i, got == 0 ? 0 : std::nan(""));
                        continue;
                    }
                    const auto error = [&]<class Real>() {
                        const auto wm = quad::wide<Real>(m);
                        const auto ww = white_of_grey<Real>(m, white);
                        const auto xa = quad::times(wm, quad::wide<Real>(a)), xb = quad::times(wm, quad::wide<Real>(b));
                        if (metric == Metric::itp) return static_cast<double>(quad::abs(Real(Real(got) - quad::distance(quad::itp_of(xa, ww), quad::itp_of(xb, ww)))));
                        if (metric == Metric::oklab) return static_cast<double>(quad::abs(Real(Real(got) - quad::distance(quad::oklab_of(xa, ww), quad::oklab_of(xb, ww)))));
                        const auto p = quad::lab_of(xa, ww), q = quad::lab_of(xb, ww);
                        // Lab right to some 1e-13 turns the hue of a nearly neutral colour by this much.
                        const double chroma = std::min(static_cast<double>(quad::length(p[1], p[2])), static_cast<double>(quad::length(q[1], q[2])));
                        const double largest = std::max({100.0, std::fabs(static_cast<double>(p[0])), std::fabs(static_cast<double>(q[0]))});
                        // Float planes weigh by hues of float.
                        const double slack = std::min(400.0, 60 * largest * 1e-13 / std::max(chroma, 1e-300) + (single ? 1e-3 : 1e-12));
                        bool jumps = false;
                        auto e = quad::abs(Real(Real(got) - formula(metric, p, q, slack, 0, &jumps)));
                        if (jumps) e = std::min(e, quad::abs(Real(Real(got) - formula(metric, p, q, slack, 1, nullptr))));
                        // The rotation term of a blue has a root of the other's chroma: 1e-13 there is no error of the formula's.
                        const double other = std::max(static_cast<double>(quad::length(p[1], p[2])), static_cast<double>(quad::length(q[1], q[2])));
                        const double singular = metric == Metric::ciede2000 && chroma > 0 ? 2 * std::sqrt(other) * (std::sqrt(chroma + 4e-15 * largest) - std::sqrt(chroma)) : 0;
                        return std::max(0.0, static_cast<double>(e) - singular);
                    };
                    if (!std::isfinite(got)) {
                        t.add(i, std::nan(""));
                        continue;
                    }
                    const auto in_units = [&](double e) { return e / (single ? 0x1p-24 * std::max(got, 1e-6) : 0x1p-53 * 500); };
                    double e = size <= 2 ? error.template operator()<long double>() : 0;
                    // Without what the last rounding to a float makes.
                    if (in_units(e) > t.worst || e > t.delta_e) e = size <= 2 ? error.template operator()<Quad>() : 0;
                    t.add(i, in_units(e), e - (single ? 0x1p-24 * got : 0));
                }
            });
            study.add("differences", fmt::format("{} of linear RGB, {}", metric_name(metric), single ? "float planes" : "double"),
                      single ? "ulp of a float, at least of 1e-6" : "2^-53 of 500", tally, text, kernel_bounds(metric, single));
        }
    }
}

}  // namespace spectex::stability
