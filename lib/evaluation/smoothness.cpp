#include <algorithm>
#include <cmath>
#include <random>

#include "spectex/color.h"
#include "spectex/evaluation.h"
#include "spectral/numeric.h"

namespace spectex {
namespace {

constexpr double last_code = 255;

struct Line {
    Vector3 from{}, to{};  // codes, 0..255
};

std::vector<Line> make_lines(std::size_t random_lines, std::uint64_t seed) {
    std::vector<Line> out;
    for (int i = 0; i < 8; ++i)
        for (int j = i + 1; j < 8; ++j) {
            // Edges, diagonals of faces and of the cube.
            const auto corner = [](int k) {
                return Vector3{k & 1 ? last_code : 0, k & 2 ? last_code : 0, k & 4 ? last_code : 0};
            };
            out.push_back({corner(i), corner(j)});
        }
    for (std::size_t axis = 0; axis < 3; ++axis)
        for (int a = 0; a <= 8; ++a)
            for (int b = 0; b <= 8; ++b) {
                // Along an axis at linear multiples of 1/8, where lattices have their cells' edges; crosses cell walls and,
                // between them, walls of tetrahedra.
                Line line;
                line.to[axis] = last_code;
                line.from[(axis + 1) % 3] = line.to[(axis + 1) % 3] = last_code * srgb_encode(a / 8.0);
                line.from[(axis + 2) % 3] = line.to[(axis + 2) % 3] = last_code * srgb_encode(b / 8.0);
                out.push_back(line);
            }
    for (std::size_t axis = 0; axis < 3; ++axis)
        for (int sum = 32; sum < 510; sum += 32) {
            // Across the wall of two equal components, at right angles.
            Line line;
            const double low = std::max(0.0, sum - last_code), high = std::min<double>(sum, last_code);
            line.from[axis] = low, line.to[axis] = high;
            line.from[(axis + 1) % 3] = high, line.to[(axis + 1) % 3] = low;
            line.from[(axis + 2) % 3] = line.to[(axis + 2) % 3] = sum / 2.0;
            out.push_back(line);
        }
    std::mt19937_64 random(seed);
    // 53 random bits: std::uniform_real_distribution is not the same everywhere.
    const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
    for (std::size_t i = 0; i < random_lines; ++i) {
        Line line;
        for (std::size_t c = 0; c < 3; ++c) line.from[c] = last_code * uniform(), line.to[c] = last_code * uniform();
        // From face to opposite face of one axis.
        const std::size_t axis = random() % 3;
        line.from[axis] = 0, line.to[axis] = last_code;
        out.push_back(line);
    }
    return out;
}

Vector3 at(const Line& line, double t) {
    Vector3 out;
    for (std::size_t c = 0; c < 3; ++c) out[c] = std::clamp(line.from[c] + t * (line.to[c] - line.from[c]), 0.0, last_code);
    return out;
}

void spectra(const Model& model, const std::vector<Vector3>& codes, std::vector<double>& out) {
    std::vector<double> rgb;
    for (const auto& code : codes)
        for (const double v : code) rgb.push_back(std::clamp(srgb_decode(v / last_code), 0.0, 1.0));
    out.resize(codes.size() * model.colorimetry().bands().size());
    model.reflectance(rgb, out);
}

/// A spectrum that is no number is infinitely far from any.
double change(std::span<const double> a, std::span<const double> b) {
    double most = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        const double d = std::abs(a[i] - b[i]);
        most = std::isnan(d) ? HUGE_VAL : std::max(most, d);
    }
    return most;
}

/// Halves a step ten times, following the larger half.
double halved(const Model& model, const Line& line, double t0, double t1) {
    const std::size_t bands = model.colorimetry().bands().size();
    double left = 0;
    std::vector<double> r;
    for (int k = 0; k < 10; ++k) {
        const double middle = (t0 + t1) / 2;
        spectra(model, {at(line, t0), at(line, middle), at(line, t1)}, r);
        const std::span<const double> all(r);
        const double first = change(all.subspan(0, bands), all.subspan(bands, bands)),
                     second = change(all.subspan(bands, bands), all.subspan(2 * bands, bands));
        (first >= second ? t1 : t0) = middle;
        left = std::max(first, second);
    }
    return left;
}

}  // namespace

SmoothnessReport measure_smoothness(const Model& model, std::size_t random_lines, std::uint64_t seed) {
    const std::size_t bands = model.colorimetry().bands().size();
    struct Largest {
        double value;
        std::size_t line;
        double t0, t1;
    };
    const auto lines = make_lines(random_lines, seed);
    std::vector<double> all;
    std::vector<Largest> largest;  // one of each line
    CompensatedSum sum;
    for (std::size_t i = 0; i < lines.size(); ++i) {
        double length = 0;
        for (std::size_t c = 0; c < 3; ++c) length = std::max(length, std::abs(lines[i].to[c] - lines[i].from[c]));
        const auto steps = static_cast<std::size_t>(std::floor(length));
        if (steps == 0) continue;
        std::vector<Vector3> codes;
        for (std::size_t k = 0; k <= steps; ++k) codes.push_back(at(lines[i], static_cast<double>(k) / length));
        std::vector<double> r;
        spectra(model, codes, r);
        Largest here{-1, i, 0, 0};
        for (std::size_t k = 0; k < steps; ++k) {
            const double d = change({&r[k * bands], bands}, {&r[(k + 1) * bands], bands});
            all.push_back(d);
            sum.add(d);
            if (d > here.value)
                here = {d, i, static_cast<double>(k) / length, static_cast<double>(k + 1) / length};
        }
        largest.push_back(here);
    }
    SmoothnessReport report;
    report.method = model.info().id;
    report.steps = all.size();
    report.mean = sum.value() / static_cast<double>(all.size());
    std::stable_sort(largest.begin(), largest.end(), [](const Largest& a, const Largest& b) { return a.value > b.value; });
    report.max = largest.front().value;
    report.max_at = at(lines[largest.front().line], largest.front().t0);
    // A jump need not lie in the largest step: steep places are no jumps.
    for (const auto& l : largest) report.jump = std::max(report.jump, halved(model, lines[l.line], l.t0, l.t1));
    const auto rank = all.begin() + static_cast<std::ptrdiff_t>((all.size() * 99 + 99) / 100 - 1);
    std::nth_element(all.begin(), rank, all.end());
    report.p99 = *rank;
    return report;
}

}  // namespace spectex
