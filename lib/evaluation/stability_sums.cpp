// Sums in any order and on any number of threads, statistics with what is not finite, and condition numbers.
#include <fmt/format.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <numeric>

#include "evaluation/stability.h"
#include "kernels/linear.h"
#include "methods/jakob2019.h"
#include "spectex/color.h"
#include "spectex/compare.h"
#include "spectex/evaluation.h"
#include "spectex/methods.h"
#include "spectral/numeric.h"

namespace spectex::stability {
namespace {

void orders(Study& study) {
    const auto& a = study.colorimetry.sensing_matrix();
    const std::size_t n = study.colorimetry.bands().size();
    const std::uint64_t cases = std::clamp<std::uint64_t>(study.options.colors, 500, 20000);
    const auto spectrum = [&](std::uint64_t i) {
        std::vector<double> r(n);
        for (std::size_t b = 0; b < n; ++b) {
            const std::uint64_t h = scrambled(i * n + b);
            // Ordinary ones, and terms of all magnitudes.
            r[b] = i % 2 ? unit_of(h) : unit_of(h) * std::exp2(-60 * unit_of(scrambled(h)));
        }
        return r;
    };
    auto tally = measure(cases, 64, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const auto r = spectrum(i);
            const Vector3 got = study.colorimetry.rgb_of(r);
            double worst = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                Quad sum = 0, size = 0;
                for (std::size_t b = 0; b < n; ++b) sum += Quad(a[c * n + b]) * Quad(r[b]), size += quad::abs(Quad(Quad(a[c * n + b]) * Quad(r[b])));
                worst = std::max(worst, terms(got[c], sum, size));
            }
            t.add(i, worst);
        }
    });
    study.add("sums", "linear RGB of a spectrum, compensated", "2^-53 of terms", tally, [](std::uint64_t i) { return fmt::format("spectrum {}", i); },
              {2.5, HUGE_VAL, "a rounding of each product, and one of the sum"});
    tally = measure(cases, 64, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const auto r = spectrum(i);
            std::vector<std::size_t> order(n);
            std::iota(order.begin(), order.end(), 0u);
            for (std::size_t k = n; k-- > 1;) std::swap(order[k], order[scrambled(i + k) % (k + 1)]);
            double worst = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                CompensatedSum forward, shuffled;
                double size = 0;
                for (std::size_t b = 0; b < n; ++b) forward.add(a[c * n + b] * r[b]), shuffled.add(a[c * n + order[b]] * r[order[b]]), size += std::fabs(a[c * n + b] * r[b]);
                worst = std::max(worst, std::fabs(forward.value() - shuffled.value()) / (size * 0x1p-53));
            }
            t.add(i, worst);
        }
    });
    study.add("sums", "the same in another order", "2^-53 of terms", tally, [](std::uint64_t i) { return fmt::format("spectrum {}", i); },
              {1, HUGE_VAL, "either order is right to a rounding of the result"});
    tally = measure(cases, 64, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const auto r = spectrum(i);
            std::vector<float> values(r.begin(), r.end());
            std::vector<const float*> planes;
            for (const float& v : values) planes.push_back(&v);
            std::array<double, 3> got;
            std::array<double*, 3> out{&got[0], &got[1], &got[2]};
            kernels::integrate_bands(planes, 1, a, 3, out.data());
            double worst = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                Quad sum = 0, size = 0;
                for (std::size_t b = 0; b < n; ++b) {
                    const Quad v = Quad(a[c * n + b]) * Quad(values[b]);
                    sum += v, size += quad::abs(v);
                }
                worst = std::max(worst, terms(got[c], sum, size));
            }
            t.add(i, worst);
        }
    });
    study.add("sums", "linear RGB of bands, by the kernel", "2^-53 of terms", tally, [](std::uint64_t i) { return fmt::format("spectrum {}", i); },
              {static_cast<double>(n) + 1, HUGE_VAL, "a rounding for each band at most"});
}

Status threads(Study& study) {
    // The whole path from codes to statistics; every figure to the bit.
    const auto model = make_model(default_method, study.colorimetry);
    if (!model) return model.error();
    const auto stride = std::max(study.options.stride, 997u);
    std::vector<RoundTripReport> reports;
    for (const int count : {1, 2}) {
        auto report = measure_roundtrip(*model, Store::spectral, PixelType::half, stride, count);
        if (!report) return report.error();
        reports.push_back(*std::move(report));
    }
    Tally tally;
    for (std::size_t i = 0; i < reports.size(); ++i) {
        const auto &p = reports[i].difference, &q = reports[0].difference;
        tally.add(i, p.mean == q.mean && p.rms == q.rms && p.p50 == q.p50 && p.p95 == q.p95 && p.p99 == q.p99 && p.max == q.max && p.max_at == q.max_at &&
                             p.changed_codes == q.changed_codes
                         ? 0
                         : 1);
    }
    study.add("sums", "round trip of codes on one thread and on two", "figures that differ", tally, [](std::uint64_t i) { return fmt::format("case {}", i); },
              {0, HUGE_VAL, "pixels are taken by themselves, and sums by rows in order"});
    return {};
}

/// Means, percentiles and largest of values of all magnitudes, some of them no numbers.
Status statistics(Study& study) {
    const std::size_t rows = 64, width = 2048;
    Tally tally;
    for (std::uint64_t kind = 0; kind < 6; ++kind) {
        DifferenceAccumulator accumulator(kind == 5 ? 1 << 16 : 1 << 28);
        Quad sum = 0, squares = 0;
        std::uint64_t finite = 0;
        double largest = 0;
        std::vector<float> all;
        for (std::size_t y = 0; y < rows; ++y) {
            std::vector<float> values(width);
            for (std::size_t x = 0; x < width; ++x) {
                const std::uint64_t h = scrambled(kind * 1000003 + y * width + x);
                float v = static_cast<float>(unit_of(h));
                if (kind == 1) v = static_cast<float>(std::pow(10.0, -40 + 70 * unit_of(h)));  // denormals to 1e30
                if (kind == 2) v = h % 3 ? std::nanf("") : v;
                if (kind == 3) v = h % 5 ? v : (h & 64 ? HUGE_VALF : -HUGE_VALF);
                if (kind == 4) v = std::nanf("");
                values[x] = v;
                if (!std::isfinite(v)) continue;
                sum += Quad(v), squares += Quad(v) * Quad(v), ++finite;
                largest = std::max(largest, static_cast<double>(v));
                all.push_back(v);
            }
            if (const auto added = accumulator.add_row(static_cast<std::int64_t>(y), values); !added) return added.error();
        }
        const auto got = accumulator.finish();
        if (!got) return got.error();
        if (finite == 0) {
            tally.add(kind, got->mean == 0 && got->max == 0 && got->pixels == 0 && got->nonfinite == rows * width ? 0 : std::nan(""));
            continue;
        }
        std::sort(all.begin(), all.end());
        const auto rank = [&](std::uint64_t thousandths) { return static_cast<double>(all[(finite * thousandths + 999) / 1000 - 1]); };
        const bool right = got->pixels == finite && got->nonfinite == rows * width - finite && got->max == largest && got->p50 == rank(500) && got->p95 == rank(950) &&
                           got->p99 == rank(990) && got->p999 == rank(999);
        const double mean = ulps(got->mean, Quad(sum / Quad(finite)));
        const double rms = ulps(got->rms, quad::sqrt(Quad(squares / Quad(finite))));
        tally.add(kind, right ? std::max(mean, rms) : std::nan(""));
    }
    static constexpr std::array names{"even", "1e-40 to 1e30", "two thirds NaN", "infinities", "nothing but NaN", "through a temporary file"};
    study.add("sums", "statistics of differences, with NaN and infinities", "ulp", tally, [](std::uint64_t i) { return std::string(names[i]); },
              {2, HUGE_VAL, "compensated sums, a quotient and a root; percentiles are exact, and what is not finite is counted alone"});
    return {};
}

/// Eigenvalues of a symmetric matrix by Jacobi's rotations, ascending.
std::array<Quad, 3> eigenvalues(quad::Square<Quad> m) {
    for (int sweep = 0; sweep < 40; ++sweep) {
        const Quad off = quad::abs(m[0][1]) + quad::abs(m[0][2]) + quad::abs(m[1][2]);
        if (off <= Quad(1e-32) * (m[0][0] + m[1][1] + m[2][2])) break;
        for (const auto& [p, q] : {std::pair{0u, 1u}, {0u, 2u}, {1u, 2u}}) {
            if (m[p][q] == 0) continue;
            const Quad theta = (m[q][q] - m[p][p]) / (2 * m[p][q]);
            const Quad t = (theta < 0 ? Quad(-1) : Quad(1)) / (quad::abs(theta) + quad::sqrt(Quad(theta * theta + 1)));
            const Quad c = 1 / quad::sqrt(Quad(t * t + 1)), s = t * c;
            for (std::size_t k = 0; k < 3; ++k) {
                const Quad x = m[k][p], y = m[k][q];
                m[k][p] = c * x - s * y, m[k][q] = s * x + c * y;
            }
            for (std::size_t k = 0; k < 3; ++k) {
                const Quad x = m[p][k], y = m[q][k];
                m[p][k] = c * x - s * y, m[q][k] = s * x + c * y;
            }
        }
    }
    std::array<Quad, 3> e{m[0][0], m[1][1], m[2][2]};
    std::sort(e.begin(), e.end());
    return e;
}
/// Largest singular value over the smallest, of rows whose products are these.
double condition(const quad::Square<Quad>& gram) {
    const auto e = eigenvalues(gram);
    return e[0] > 0 ? static_cast<double>(quad::sqrt(Quad(e[2] / e[0]))) : HUGE_VAL;
}
double condition(const Matrix3& m) {
    quad::Square<Quad> gram{};
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j)
            for (std::size_t k = 0; k < 3; ++k) gram[i][j] += Quad(m(i, k)) * Quad(m(j, k));
    return condition(gram);
}

void matrices(Study& study) {
    const auto& observer = study.colorimetry.observer();
    Tally forward, inverse;
    std::vector<double> conditions;
    const auto& spaces = rgb_spaces();
    for (std::size_t i = 0; i < spaces.size(); ++i) {
        const auto white = tristimulus_weights(study.colorimetry.bands(), observer, *parse_illuminant(spaces[i].illuminant), Normalization::luminance)->white;
        const Matrix3 m = rgb_to_xyz_matrix(spaces[i], white), back = m.inverse();
        const auto exact = quad::rgb_to_xyz(spaces[i], quad::wide<Quad>(white)), exact_back = quad::inverse(quad::wide<Quad>(m));
        double worst = 0, worst_back = 0;
        Quad size = 0, size_back = 0;
        for (std::size_t k = 0; k < 9; ++k)
            size = quad::larger(size, quad::abs(exact[k / 3][k % 3])), size_back = quad::larger(size_back, quad::abs(exact_back[k / 3][k % 3]));
        for (std::size_t k = 0; k < 9; ++k) {
            worst = std::max(worst, terms(m.m[k], exact[k / 3][k % 3], size));
            worst_back = std::max(worst_back, terms(back.m[k], exact_back[k / 3][k % 3], size_back));
        }
        forward.add(i, worst), inverse.add(i, worst_back);
        conditions.push_back(condition(m));
    }
    const auto name = [&](std::uint64_t i) { return spaces[i].name; };
    study.add("conditioning", "RGB-to-XYZ matrices of eight spaces", "2^-53 of the largest", forward, name,
              {64, HUGE_VAL, "primaries as doubles stand for decimals, and solving for the white magnifies their rounding by the condition, up to 40"});
    study.add("conditioning", "their inverses", "2^-53 of the largest", inverse, name, {2, HUGE_VAL, "cofactors in long double, rounded once"});
    const auto worst = std::max_element(conditions.begin(), conditions.end());
    study.figure("conditioning", "RGB-to-XYZ matrices: largest condition", "condition", *worst, spaces[static_cast<std::size_t>(worst - conditions.begin())].name,
                 {100, HUGE_VAL, "two digits of sixteen"});
}

void sensing(Study& study) {
    for (const char* text : {"380:780:1", "380:780:5", "380:780:10", "36", "7"}) {
        const auto bands = BandSet::parse(text);
        const auto c = Colorimetry::make({}, *bands);
        if (!c) continue;
        const auto& a = c->sensing_matrix();
        const std::size_t n = bands->size();
        quad::Square<Quad> gram{};
        for (std::size_t i = 0; i < 3; ++i)
            for (std::size_t j = 0; j < 3; ++j)
                for (std::size_t b = 0; b < n; ++b) gram[i][j] += Quad(a[i * n + b]) * Quad(a[j * n + b]);
        study.figure("conditioning", fmt::format("sensing matrix A, {}", bands->describe()), "condition", condition(gram), "",
                     {10, HUGE_VAL, "linear RGB is nearly orthogonal: solves for a spectrum lose a digit"});
    }
}

void solves(Study& study) {
    const auto chosen = [&](std::string_view id) { return std::find(study.options.methods.begin(), study.options.methods.end(), id) != study.options.methods.end(); };
    const auto& a = study.colorimetry.sensing_matrix();
    const std::size_t n = study.colorimetry.bands().size();
    if (chosen("jakob2019")) {
        const auto solver = jakob2019::Solver::shared(study.colorimetry);
        StabilityOptions some = study.options;
        some.colors = std::min<std::uint64_t>(some.colors, 20000), some.stride = std::max(some.stride, 1021u), some.adversaries = std::max(some.adversaries, 16u);
        const Colors colors(some, Colors::Range::cube, true);
        const auto tally = measure(colors.size(), 256, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            for (std::uint64_t i = first; i < last; ++i) {
                const Vector3 rgb = colors[i];
                std::array<double, 3> c;
                solver->solve(rgb, c);
                if (std::fabs(c[2]) >= jakob2019::saturated / 2 || (rgb[0] == rgb[1] && rgb[1] == rgb[2])) continue;
                // Of the Jacobian with columns of unit length, which no scaling of coefficients changes.
                Matrix3 j{{0, 0, 0, 0, 0, 0, 0, 0, 0}};
                for (std::size_t b = 0; b < n; ++b) {
                    const double node = solver->nodes()[b], x = (c[0] * node + c[1]) * node + c[2], y = 1 / std::sqrt(1 + x * x), slope = 0.5 * y * y * y;
                    for (std::size_t r = 0; r < 3; ++r) {
                        const double w = a[r * n + b] * slope;
                        j(r, 0) += w * node * node, j(r, 1) += w * node, j(r, 2) += w;
                    }
                }
                for (std::size_t k = 0; k < 3; ++k) {
                    const double length = std::sqrt(j(0, k) * j(0, k) + j(1, k) * j(1, k) + j(2, k) * j(2, k));
                    for (std::size_t r = 0; r < 3; ++r) j(r, k) /= length;
                }
                t.add(i, condition(j));
            }
        });
        study.add("conditioning", "jakob2019: Newton's Jacobian", "condition", tally, [&](std::uint64_t i) { return colors.describe(i); },
                  {1e9, HUGE_VAL, "a step in double keeps at least six digits, so that steps converge; residuals are what is held to rounding"});
    }
    if (chosen("lattice")) {
        const auto model = make_model("lattice", study.colorimetry);
        if (!model || !(*model)->lattice()) return;
        const auto& table = *(*model)->lattice();
        const std::size_t vertices = table.vertices.size() / table.values;
        Tally tally;
        for (std::size_t v = 1; v + 1 < vertices; ++v) {
            // Bands at a bound do not move: what moves must span the colours.
            quad::Square<Quad> gram{};
            for (std::size_t b = 0; b < n; ++b) {
                const double r = table.vertices[v * table.values + b];
                if (r <= 0 || r >= 1) continue;
                for (std::size_t i = 0; i < 3; ++i)
                    for (std::size_t k = 0; k < 3; ++k) gram[i][k] += Quad(a[i * n + b]) * Quad(a[k * n + b]);
            }
            tally.add(v, condition(gram));
        }
        study.add("conditioning", "lattice: A over the bands free at a vertex", "condition", tally, [](std::uint64_t v) { return fmt::format("vertex {}", v); },
                  {1e4, HUGE_VAL, "corners of the cube are nearly optimal colours and leave few bands free; residuals of 1e-12 want less than 1e4"});
    }
    for (const char* name : {"vonkries", "bradford", "cat02", "cat16"}) {
        // The transform from E to D65 has the cone matrix's own condition in it.
        const auto m = adaptation_matrix(*parse_adaptation(name), {1, 1, 1}, {0.95047, 1, 1.08883});
        study.figure("conditioning", fmt::format("{}: adaptation from E to D65", name), "condition", condition(*m), "", {2, HUGE_VAL, "near the identity"});
    }
}

}  // namespace

Status study_sums(Study& study) {
    orders(study);
    if (auto done = threads(study); !done) return done;
    return statistics(study);
}

Status study_conditioning(Study& study) {
    sensing(study);
    matrices(study);
    solves(study);
    return {};
}

}  // namespace spectex::stability
