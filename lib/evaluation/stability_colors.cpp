// Curves, matrices, Lab, halves and codes.
#include <fmt/format.h>

#include <algorithm>

#include "compare/spaces.h"
#include "evaluation/stability.h"
#include "kernels/convert.h"
#include "kernels/linear.h"
#include "spectex/color.h"
#include "spectex/methods.h"

namespace spectex::stability {
namespace {

using quad::Triple;

/// Difference in lightness of two greys, in units of L*; 0 where either is no colour.
double grey_difference(double a, Quad b) {
    if (!std::isfinite(a) || b != b || b < 0 || b > 1) return 0;
    const auto lightness = [](Quad t) { return quad::lab_of<Quad>({t, t, t}, {1, 1, 1})[0]; };
    return static_cast<double>(quad::abs(Quad(lightness(Quad(a)) - lightness(b))));
}

/// Single numbers: codes of 8 and 16 bits, notable ones, and magnitudes from the least to 1e30 of either sign.
std::vector<double> numbers(const StabilityOptions& options, bool single) {
    std::vector<double> out;
    for (int i = 0; i < 256; ++i) out.push_back(i / 255.0);
    for (int i = 0; i < 65536; i += static_cast<int>(std::min<std::uint32_t>(options.adversaries, 256))) out.push_back(i / 65535.0);
    for (const double v : notable_values(single)) out.push_back(v), out.push_back(-v);
    for (const double v : {std::nan(""), HUGE_VAL, -HUGE_VAL, 3e38, 65504.0, 65519.0, 65520.0, 1e30}) out.push_back(v);
    const std::uint64_t random = std::max<std::uint64_t>(1000, options.colors / 8);
    for (std::uint64_t i = 0; i < random; ++i) {
        const std::uint64_t h = scrambled(options.seed + 3 * i);
        const double even = unit_of(scrambled(h));
        out.push_back(h & 1 ? even : (h & 2 ? -1 : 1) * std::pow(10.0, -45 + 75 * even));
    }
    if (single)
        for (double& v : out) v = rounded(v);
    return out;
}

void curve(Study& study, const std::string& path, bool encode, Bounds bounds) {
    const auto in = numbers(study.options, false);
    const auto tally = measure(in.size(), 1024, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const double result = encode ? srgb_encode(in[i]) : srgb_decode(in[i]);
            const Quad exact = encode ? quad::linear_to_srgb(Quad(in[i])) : quad::srgb_to_linear(Quad(in[i]));
            t.add(i, ulps(result, exact), encode ? grey_difference(srgb_decode(result), quad::srgb_to_linear(exact)) : grey_difference(result, exact));
        }
    });
    study.add("colours", path, "ulp", tally, [&](std::uint64_t i) { return fmt::format("{:.17g}", in[i]); }, std::move(bounds));
}

void curve_planes(Study& study, const std::string& path, const ColorTransform& transform, bool encode, Bounds bounds) {
    const auto in = numbers(study.options, true);
    std::array<std::vector<float>, 3> out;
    for (auto& plane : out) {
        plane.clear();
        for (const double v : in) plane.push_back(static_cast<float>(v));
    }
    transform.apply({out[0].data(), out[1].data(), out[2].data()}, in.size());
    const auto tally = measure(in.size(), 1024, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
        for (std::uint64_t i = first; i < last; ++i) {
            const Quad exact = encode ? quad::linear_to_srgb(Quad(in[i])) : quad::srgb_to_linear(Quad(in[i]));
            const double r = static_cast<double>(out[1][i]);
            t.add(i, ulps(out[1][i], exact), encode ? grey_difference(srgb_decode(r), quad::srgb_to_linear(exact)) : grey_difference(r, exact));
        }
    });
    study.add("colours", path, "ulp", tally, [&](std::uint64_t i) { return fmt::format("{:.9g}", in[i]); }, std::move(bounds));
}

/// Codes that come out of an encoding: how far from the border of two codes, in floats, a value of the wrong side lies.
void codes(Study& study, const ColorTransform& encode, unsigned last_code) {
    std::vector<float> in;
    for (unsigned k = 1; k <= last_code; ++k) {
        // About the border, eight floats to either side; for 16 bits a sample of borders.
        if (last_code > 255 && k % 97 != 0 && k > 300) continue;
        auto v = static_cast<float>(static_cast<double>(quad::srgb_to_linear(Quad((Quad(k) - Quad(0.5)) / last_code))));
        for (int s = 0; s < 8; ++s) v = std::nextafter(v, 0.0f);
        for (int s = 0; s < 16; ++s) in.push_back(v), v = std::nextafter(v, 2.0f);
    }
    std::array<std::vector<float>, 3> planes{in, in, in};
    encode.apply({planes[0].data(), planes[1].data(), planes[2].data()}, in.size());
    std::vector<std::uint16_t> code16(in.size());
    std::vector<std::uint8_t> code8(in.size());
    if (last_code > 255) kernels::quantize(planes[0].data(), in.size(), code16.data(), 1);
    else kernels::quantize(planes[0].data(), in.size(), code8.data(), 1);
    Tally tally;
    for (std::size_t i = 0; i < in.size(); ++i) {
        const unsigned got = last_code > 255 ? code16[i] : code8[i];
        const Quad exact = quad::linear_to_srgb(Quad(in[i])) * last_code;
        // Beyond the border of the code that came out.
        const Quad border = Quad(got) + (exact > Quad(got) ? Quad(0.5) : Quad(-0.5));
        const bool wrong = quad::abs(Quad(exact - Quad(got))) > Quad(0.5);
        const Quad at = quad::srgb_to_linear(Quad(border / last_code));
        tally.add(i, wrong ? static_cast<double>(quad::abs(Quad(Quad(in[i]) - at)) / Quad(spacing<float>(static_cast<double>(in[i])))) : 0);
    }
    study.add("colours", fmt::format("linear float to {}-bit sRGB code", last_code > 255 ? 16 : 8), "floats past the border", tally,
              [&](std::uint64_t i) { return fmt::format("{:.9g}", in[i]); },
              {2.1, HUGE_VAL,
               "the encoded float is rounded before it is quantised: its half unit is at most two units of the linear value"});
    Tally back;
    for (unsigned k = 0; k <= last_code; ++k) {
        float v = static_cast<float>(srgb_decode(static_cast<double>(k) / last_code));
        float g = v, b = v;
        encode.apply({&v, &g, &b}, 1);
        std::uint16_t c16 = 0;
        std::uint8_t c8 = 0;
        if (last_code > 255) kernels::quantize(&v, 1, &c16, 1);
        else kernels::quantize(&v, 1, &c8, 1);
        const unsigned got = last_code > 255 ? c16 : c8;
        back.add(k, std::fabs(static_cast<double>(got) - k));
    }
    study.add("colours", fmt::format("{}-bit sRGB code to linear float and back", last_code > 255 ? 16 : 8), "codes", back,
              [](std::uint64_t i) { return fmt::format("code {}", i); }, {0, HUGE_VAL, "a code is some units of the last place of a float wide"});
}

void changed_codes(Study& study) {
    // Every pair of neighbouring floats about every border.
    std::vector<float> a, b;
    for (unsigned k = 1; k <= 255; ++k) {
        auto v = static_cast<float>(static_cast<double>(quad::srgb_to_linear(Quad((Quad(k) - Quad(0.5)) / 255))));
        for (int s = 0; s < 4; ++s) v = std::nextafter(v, 0.0f);
        for (int s = 0; s < 8; ++s) {
            const float w = std::nextafter(v, 2.0f);
            a.push_back(v), b.push_back(w);
            v = w;
        }
    }
    Tally tally;
    const auto exact_code = [](float v) {
        const Quad c = quad::linear_to_srgb(Quad(v)) * 255 + Quad(0.5);
        return static_cast<int>(static_cast<double>(c));
    };
    for (std::size_t i = 0; i < a.size(); ++i) {
        const std::uint64_t changed = count_changed_codes({&a[i], &a[i], &a[i]}, {&b[i], &b[i], &b[i]}, 1);
        tally.add(i, changed == (exact_code(a[i]) != exact_code(b[i]) ? 1u : 0u) ? 0 : 1);
    }
    study.add("colours", "changed 8-bit codes, neighbouring floats", "wrong verdicts", tally,
              [&](std::uint64_t i) { return fmt::format("{:.9g}", static_cast<double>(a[i])); }, {0, HUGE_VAL, "borders are rounded upwards from long double"});
}

void halves(Study& study) {
    std::vector<float> in;
    // Every half, the middle to the next one, and the floats beside that.
    for (std::uint32_t h = 0; h < 0x7c00; ++h) {
        const auto bits = static_cast<std::uint16_t>(h), above = static_cast<std::uint16_t>(h + 1);
        float v = 0, w = 0;
        kernels::half_to_float_reference(&bits, 1, 1, &v);
        kernels::half_to_float_reference(&above, 1, 1, &w);
        if (!std::isfinite(w)) w = 65536.0f;
        const float middle = v + (w - v) / 2;
        for (const float x : {v, middle, std::nextafter(middle, 0.0f), std::nextafter(middle, 1e30f)}) in.push_back(x), in.push_back(-x);
    }
    for (const float x : {1.4e-45f, 1e-38f, 1e30f, 3e38f, HUGE_VALF, -HUGE_VALF, std::nanf("")}) in.push_back(x);
    std::vector<std::uint16_t> half(in.size());
    std::vector<float> back(in.size());
    kernels::float_to_half(in.data(), in.size(), half.data(), 1);
    kernels::half_to_float(half.data(), 1, in.size(), back.data());
    Tally tally;
    for (std::size_t i = 0; i < in.size(); ++i) {
        const double v = static_cast<double>(in[i]), r = static_cast<double>(back[i]);
        if (std::isnan(v)) {
            tally.add(i, std::isnan(r) ? 0 : std::nan(""));
        } else if (std::fabs(v) >= 65520) {
            tally.add(i, std::isinf(r) && (r > 0) == (v > 0) ? 0 : std::nan(""));
        } else if (!std::isfinite(r)) {
            tally.add(i, std::nan(""));
        } else {
            // Ties go to the even one.
            const double e = std::fabs(r - v) / half_spacing(v);
            tally.add(i, e == 0.5 && (half[i] & 1) ? 1 : e, grey_difference(r, Quad(v)));
        }
    }
    study.add("colours", "float to half and back", "ulp of half", tally, [&](std::uint64_t i) { return fmt::format("{:.9g}", static_cast<double>(in[i])); },
              {0.5, 0.03, "to nearest, ties to even: half a unit of 2^-11 is at most 0.019 in L*, and 0.03 where the least halves are counted, 903 * 2^-25"});
}

/// RGB to XYZ, then Lab; in double, from float planes by the kernels.
void matrix_and_lab(Study& study) {
    const Matrix3& m = study.colorimetry.rgb_to_xyz();
    const Vector3 white = study.colorimetry.white_xyz();
    const auto exact_white = white_of_grey<Quad>(m, white);
    const auto quick_white = white_of_grey<long double>(m, white);
    for (const bool single : {false, true}) {
        const Colors colors(study.options, Colors::Range::any, single);
        const auto describe = [&](std::uint64_t i) { return colors.describe(i); };
        constexpr std::uint64_t part = 4096;
        // Screened in long double; what could be the worst is done again in 113 bits.
        const auto exact_terms = [&]<class Real>(const Vector3& rgb, std::size_t row, Real& sum, Real& size) {
            sum = 0, size = 0;
            for (std::size_t k = 0; k < 3; ++k) {
                const Real t = Real(m(row, k)) * Real(rgb[k]);
                sum += t, size += quad::abs(t);
            }
        };
        const auto finite = [](const Vector3& v) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); };
        auto tally = measure(colors.size(), part, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            std::array<std::vector<float>, 3> in, out;
            if (single) {
                for (std::size_t c = 0; c < 3; ++c) in[c].resize(part), out[c].resize(part);
                for (std::uint64_t i = first; i < last; ++i)
                    for (std::size_t c = 0; c < 3; ++c) in[c][i - first] = static_cast<float>(colors[i][c]);
                kernels::matrix3(m, {in[0].data(), in[1].data(), in[2].data()}, last - first, {out[0].data(), out[1].data(), out[2].data()});
            }
            for (std::uint64_t i = first; i < last; ++i) {
                const Vector3 rgb = colors[i];
                const Vector3 xyz = m * rgb;
                double worst = 0;
                for (std::size_t row = 0; row < 3; ++row) {
                    if (!finite(rgb)) {
                        // What is not finite must not come out finite.
                        const double v = single ? static_cast<double>(out[row][i - first]) : xyz[row];
                        if (std::isfinite(v)) worst = std::nan("");
                        continue;
                    }
                    if (single) {
                        Quad sum, size;
                        exact_terms(rgb, row, sum, size);
                        worst = std::max(worst, ulps(out[row][i - first], sum));
                        if (std::isnan(ulps(out[row][i - first], sum))) worst = std::nan("");
                    } else {
                        Quad sum, size;
                        exact_terms(rgb, row, sum, size);
                        worst = std::max(worst, terms(xyz[row], sum, size));
                    }
                }
                t.add(i, worst);
            }
        });
        if (single)
            study.add("colours", "linear RGB to XYZ, float planes", "ulp", tally, describe,
                      {0.51, HUGE_VAL, "double inside, rounded once"});
        else
            study.add("colours", "linear RGB to XYZ, double", "2^-53 of terms", tally, describe, {3, HUGE_VAL, "a product and two sums are rounded"});

        // Lab of what lies within the magnitudes that reach it.
        const auto to_white = [&] {
            Matrix3 r = m;
            for (std::size_t i = 0; i < 3; ++i)
                for (std::size_t j = 0; j < 3; ++j) r(i, j) /= white[i];
            return r;
        }();
        tally = measure(colors.size(), part, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            std::array<std::vector<float>, 3> in;
            std::array<std::vector<double>, 3> wide, lab;
            for (std::size_t c = 0; c < 3; ++c) in[c].resize(part), wide[c].resize(part), lab[c].resize(part);
            for (std::uint64_t i = first; i < last; ++i) {
                const Vector3 rgb = colors[i];
                for (std::size_t c = 0; c < 3; ++c) in[c][i - first] = static_cast<float>(rgb[c]), wide[c][i - first] = rgb[c];
            }
            const std::array<double*, 3> out{lab[0].data(), lab[1].data(), lab[2].data()};
            if (single) lab_planes(to_white, std::array<const float*, 3>{in[0].data(), in[1].data(), in[2].data()}, last - first, out);
            else lab_planes(to_white, std::array<const double*, 3>{wide[0].data(), wide[1].data(), wide[2].data()}, last - first, out);
            for (std::uint64_t i = first; i < last; ++i) {
                const Vector3 rgb = colors[i];
                const Vector3 got{lab[0][i - first], lab[1][i - first], lab[2][i - first]};
                const Vector3 scalar = lab_from_xyz(m * rgb, white);
                if (!finite(rgb)) {
                    t.add(i, finite(got) || finite(scalar) ? std::nan("") : 0);
                    continue;
                }
                const auto errors = [&]<class Real>(double& ulp, double& de) {
                    const auto xyz = quad::times(quad::wide<Real>(m), quad::wide<Real>(rgb));
                    Triple<Real> w;
                    if constexpr (sizeof(Real) == sizeof(Quad) && std::is_same_v<Real, Quad>) w = exact_white;
                    else w = quick_white;
                    const auto exact = quad::lab_of(xyz, w);
                    // What the sums are made of: f of each component's terms, magnified as the coordinates are.
                    double size = 100;
                    for (std::size_t k = 0; k < 3; ++k) size = std::max(size, std::fabs(static_cast<double>(exact[k])));
                    double most = 0;
                    const auto f = [](long double v) { return v > 216.0L / 24389 ? std::cbrt(v) : 841.0L / 108 * v + 4.0L / 29; };
                    for (std::size_t row = 0; row < 3; ++row) {
                        double sum = 0;
                        for (std::size_t k = 0; k < 3; ++k) sum += std::fabs(m(row, k) * rgb[k]);
                        sum /= white[row];
                        most = std::max(most, sum);
                        // Terms that have cancelled leave a root far steeper than that of their size: what it makes of one unit of them.
                        const auto v = static_cast<long double>(xyz[row] / w[row]), unit = 0x1p-53L * sum;
                        size = std::max(size, static_cast<double>(500 * (f(v + unit) - f(v - unit)) / 0x1p-52L));
                    }
                    size = std::max(size, 500 * static_cast<double>(f(most)));
                    ulp = de = 0;
                    for (const Vector3& v : {got, scalar}) {
                        const auto d = quad::distance(quad::wide<Real>(v), exact);
                        if (!(d == d)) ulp = std::nan("");
                        de = std::max(de, static_cast<double>(d));
                    }
                    ulp = std::isnan(ulp) ? ulp : de / (size * 0x1p-53);
                };
                double u, de;
                errors.template operator()<long double>(u, de);
                if (u > t.worst || de > t.delta_e) errors.template operator()<Quad>(u, de);
                const bool colour = std::fabs(rgb[0]) <= 2 && std::fabs(rgb[1]) <= 2 && std::fabs(rgb[2]) <= 2;
                t.add(i, u, colour ? de : 0);
            }
        });
        study.add("colours", single ? "linear RGB to Lab, float planes" : "linear RGB to Lab, double", "2^-53 of terms", tally, describe,
                  {16, 1e-11,
                   "three products and three sums, some of differences twice as large, in units of what one rounding of the terms makes of the "
                   "coordinates"});
    }
}

/// Whatever comes, reflectances can be made of what is left, and it is counted.
void into_gamut(Study& study) {
    const Colors colors(study.options, Colors::Range::any, true);
    const Vector3 luminance{study.colorimetry.rgb_to_xyz()(1, 0), study.colorimetry.rgb_to_xyz()(1, 1), study.colorimetry.rgb_to_xyz()(1, 2)};
    for (const GamutPolicy policy : {GamutPolicy::clip, GamutPolicy::desaturate}) {
        const auto tally = measure(colors.size(), 1024, [&](std::uint64_t first, std::uint64_t last, Tally& t) {
            for (std::uint64_t i = first; i < last; ++i) {
                const Vector3 rgb = colors[i];
                std::array<float, 3> v;
                bool finite = true, inside = true;
                double size = 0;
                for (std::size_t c = 0; c < 3; ++c) {
                    v[c] = static_cast<float>(rgb[c]);
                    finite = finite && std::isfinite(rgb[c]), inside = inside && rgb[c] >= 0 && rgb[c] <= 1;
                    size = std::max(size, std::fabs(rgb[c]));
                }
                GamutCounts counts;
                map_into_gamut({&v[0], &v[1], &v[2]}, 1, policy, luminance, counts);
                bool broken = counts.nonfinite != (finite ? 0u : 1u) || counts.out_of_gamut != (finite && !inside ? 1u : 0u);
                for (const float x : v) broken = broken || !(x >= 0 && x <= 1);
                double worst = 0;
                // Of larger numbers the luminance cancels to no digits.
                if (!broken && finite && size < 1e6) {
                    Quad y = 0, keep = 1;
                    for (std::size_t c = 0; c < 3; ++c) y += Quad(luminance[c]) * Quad(rgb[c]);
                    const Quad grey = y < 0 ? Quad(0) : y > 1 ? Quad(1) : y;
                    for (const double x : rgb) {
                        if (x > 1) keep = std::min(keep, Quad((1 - grey) / (Quad(x) - grey)));
                        if (x < 0) keep = std::min(keep, Quad(grey / (grey - Quad(x))));
                    }
                    for (std::size_t c = 0; c < 3; ++c) {
                        Quad exact = policy == GamutPolicy::clip ? Quad(rgb[c]) : Quad(grey + keep * (Quad(rgb[c]) - grey));
                        exact = exact < 0 ? Quad(0) : exact > 1 ? Quad(1) : exact;
                        worst = std::max(worst, static_cast<double>(quad::abs(Quad(Quad(v[c]) - exact))) / 0x1p-24);
                    }
                }
                t.add(i, broken ? std::nan("") : worst);
            }
        });
        study.add("colours", policy == GamutPolicy::clip ? "into the gamut by clipping" : "into the gamut by desaturation", "2^-24", tally,
                  [&](std::uint64_t i) { return colors.describe(i); },
                  {policy == GamutPolicy::clip ? 0 : 0.51, HUGE_VAL, "in [0,1] and counted, whatever comes; double inside, rounded once"});
    }
}

}  // namespace

void study_colors(Study& study) {
    curve(study, "sRGB to linear, double", false, {8, 1e-12, "a sum and a quotient are rounded before the power of 2.4 magnifies them"});
    curve(study, "linear to sRGB, double", true, {6, 1e-12, "what is taken off, 0.055, is more than half of the least power that it is taken from"});
    ImageHeader header;
    header.color = {0, 1, 2};
    const auto bt709 = find_rgb_space("BT.709");
    ColorSpaceChoice srgb;
    srgb.name = srgb_name();
    const auto decode = ColorTransform::to_linear(srgb, header, *bt709);
    const auto encode = ColorTransform::from_linear(*bt709, srgb_name());
    curve_planes(study, "sRGB to linear, float planes", **decode, false, {0.501, 1e-4, "double inside, rounded once; 2^-25 of a component is 3e-6 of L*, at the toe 3e-5"});
    curve_planes(study, "linear to sRGB, float planes", **encode, true, {0.501, 1e-4, "double inside, rounded once"});
    codes(study, **encode, 255);
    codes(study, **encode, 65535);
    changed_codes(study);
    halves(study);
    matrix_and_lab(study);
    into_gamut(study);
}

}  // namespace spectex::stability
