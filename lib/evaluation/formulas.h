// The colour formulas once more, written from their standards and papers for any precision, and sharing no line with the code
// that they check. Decimal constants are quotients of whole numbers, exact in any type.
#pragma once

#include <array>

#include "evaluation/quad.h"
#include "spectex/base.h"
#include "spectex/spectral.h"

namespace spectex::quad {

template <class Real>
using Triple = std::array<Real, 3>;
template <class Real>
using Square = std::array<std::array<Real, 3>, 3>;

template <class Real>
Triple<Real> wide(const Vector3& v) {
    return {Real(v[0]), Real(v[1]), Real(v[2])};
}
template <class Real>
Square<Real> wide(const Matrix3& m) {
    Square<Real> out;
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j) out[i][j] = Real(m(i, j));
    return out;
}
template <class Real>
Triple<Real> times(const Square<Real>& m, const Triple<Real>& v) {
    Triple<Real> out;
    for (std::size_t i = 0; i < 3; ++i) out[i] = m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2];
    return out;
}
template <class Real>
Square<Real> times(const Square<Real>& a, const Square<Real>& b) {
    Square<Real> out;
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j) out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
    return out;
}
/// Gauss and Jordan's elimination with the largest pivot.
template <class Real>
Square<Real> inverse(Square<Real> m) {
    Square<Real> out{};
    for (std::size_t i = 0; i < 3; ++i) out[i][i] = 1;
    for (std::size_t k = 0; k < 3; ++k) {
        std::size_t pivot = k;
        for (std::size_t i = k + 1; i < 3; ++i)
            if (abs(m[i][k]) > abs(m[pivot][k])) pivot = i;
        std::swap(m[k], m[pivot]);
        std::swap(out[k], out[pivot]);
        const Real unit = 1 / m[k][k];
        for (std::size_t j = 0; j < 3; ++j) m[k][j] *= unit, out[k][j] *= unit;
        for (std::size_t i = 0; i < 3; ++i) {
            if (i == k) continue;
            const Real factor = m[i][k];
            for (std::size_t j = 0; j < 3; ++j) m[i][j] -= factor * m[k][j], out[i][j] -= factor * out[k][j];
        }
    }
    return out;
}

/// IEC 61966-2-1, 4.3 and 5.2.
template <class Real>
Real srgb_to_linear(Real v) {
    const Real size = abs(v);
    const Real linear = size <= Real(4045) / 100000 ? size / (Real(1292) / 100)
                                                    : pow(Real((size + Real(55) / 1000) / (Real(1055) / 1000)), Real(Real(24) / 10));
    return v < 0 ? -linear : linear;
}
template <class Real>
Real linear_to_srgb(Real v) {
    const Real size = abs(v);
    const Real code = size <= Real(31308) / 10000000 ? size * (Real(1292) / 100)
                                                     : Real(1055) / 1000 * pow(size, Real(Real(10) / 24)) - Real(55) / 1000;
    return v < 0 ? -code : code;
}

/// SMPTE RP 177-1993. Chromaticities are decimal: they are taken as the decimals of at most 6 places that the doubles stand for.
template <class Real>
Square<Real> rgb_to_xyz(const RgbSpace& space, const Triple<Real>& white) {
    const auto decimal = [](double v) { return Real(std::llround(v * 1e6)) / 1000000; };
    Square<Real> p;
    for (std::size_t j = 0; j < 3; ++j) {
        const Real x = decimal(space.primaries_xy[j][0]), y = decimal(space.primaries_xy[j][1]);
        p[0][j] = x, p[1][j] = y, p[2][j] = 1 - x - y;
    }
    const Triple<Real> s = times(inverse(p), white);
    for (auto& row : p)
        for (std::size_t j = 0; j < 3; ++j) row[j] *= s[j];
    return p;
}

/// CIE 15:2018, 8.2.1.1. A component of which the white has nothing tells nothing: its ratio is 0.
template <class Real>
Triple<Real> lab_of(const Triple<Real>& xyz, const Triple<Real>& white) {
    Triple<Real> f;
    for (std::size_t i = 0; i < 3; ++i) {
        const Real t = white[i] == 0 ? Real(0) : xyz[i] / white[i];
        f[i] = t > Real(216) / 24389 ? cbrt(t) : Real(841) / 108 * t + Real(4) / 29;
    }
    return {116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])};
}

template <class Real>
Real pi() {
    return atan2(Real(0), Real(-1));
}
template <class Real>
Real length(Real a, Real b) {
    return sqrt(Real(a * a + b * b));
}
template <class Real>
Real distance(const Triple<Real>& p, const Triple<Real>& q) {
    const Triple<Real> d{p[0] - q[0], p[1] - q[1], p[2] - q[2]};
    return sqrt(Real(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]));
}
/// Squared hue difference: what the distance in a, b leaves beside the difference of chromas.
template <class Real>
Real hue_squared(Real a1, Real b1, Real a2, Real b2) {
    const Real c1 = length(a1, b1), c2 = length(a2, b2);
    if (c1 == 0 || c2 == 0) return 0;
    // 4 C1 C2 sin^2(dh / 2), of the unit vectors' distance.
    const Real x = a1 / c1 - a2 / c2, y = b1 / c1 - b2 / c2;
    return c1 * c2 * (x * x + y * y);
}
/// In degrees, 0 to 360.
template <class Real>
Real hue(Real a, Real b) {
    if (a == 0 && b == 0) return 0;
    const Real h = atan2(b, a) * 180 / pi<Real>();
    return h < 0 ? h + 360 : h;
}

template <class Real>
Real cie94(const Triple<Real>& p, const Triple<Real>& q) {
    const Real c1 = length(p[1], p[2]), c2 = length(q[1], q[2]);
    const Real l = q[0] - p[0], c = (c2 - c1) / (1 + Real(45) / 1000 * c1), s = 1 + Real(15) / 1000 * c1;
    return sqrt(Real(l * l + c * c + hue_squared(p[1], p[2], q[1], q[2]) / (s * s)));
}

/// CIE 142-2001 by Sharma, Wu and Dalal 2005. Where the hues are within `slack` degrees of opposite, the formula's mean hue
/// jumps, and where that is 0 or 360, its rotation term does: `branch` 1 takes the other mean.
template <class Real>
Real ciede2000(const Triple<Real>& p, const Triple<Real>& q, double slack, int branch, bool* opposite) {
    const auto seventh = [](Real c) {
        if (c == 0) return Real(0);
        const Real r = 25 / c, r2 = r * r;
        return sqrt(Real(1 / (1 + r2 * r2 * r2 * r)));
    };
    const Real mean_c = (length(p[1], p[2]) + length(q[1], q[2])) / 2, g = (1 - seventh(mean_c)) / 2;
    const Real a1 = (1 + g) * p[1], a2 = (1 + g) * q[1], c1 = length(a1, p[2]), c2 = length(a2, q[2]);
    const Real h1 = hue(a1, p[2]), h2 = hue(a2, q[2]);
    const bool neutral = c1 == 0 || c2 == 0;
    Real dh = h2 - h1;
    const bool jump = abs(Real(abs(dh) - 180)) < Real(slack) && !neutral;
    bool wrap = abs(dh) > 180;
    if (jump && branch == 1) wrap = !wrap;
    Real mean_h = h1 + h2;
    if (!neutral) {
        if (wrap) mean_h += mean_h < 360 ? 360 : -360;
        mean_h /= 2;
    }
    const bool seam = mean_h < Real(slack) || mean_h > 360 - Real(slack);
    if (opposite) *opposite = jump || seam;
    if (seam && branch == 1) mean_h += mean_h < 180 ? 360 : -360;
    if (wrap) dh += dh > 0 ? -360 : 360;
    Real dhh = neutral ? Real(0) : sqrt(hue_squared(a1, p[2], a2, q[2]));
    if (dh < 0) dhh = -dhh;
    const Real rad = pi<Real>() / 180;
    const Real t = 1 - Real(17) / 100 * cos(Real((mean_h - 30) * rad)) + Real(24) / 100 * cos(Real(2 * mean_h * rad)) +
                   Real(32) / 100 * cos(Real((3 * mean_h + 6) * rad)) - Real(20) / 100 * cos(Real((4 * mean_h - 63) * rad));
    const Real from = (mean_h - 275) / 25, turn = 30 * exp(Real(-from * from));
    const Real l = (p[0] + q[0]) / 2 - 50, c = (c1 + c2) / 2;
    const Real sl = 1 + Real(15) / 1000 * l * l / sqrt(Real(20 + l * l)), sc = 1 + Real(45) / 1000 * c, sh = 1 + Real(15) / 1000 * c * t;
    const Real rt = -sin(Real(2 * turn * rad)) * 2 * seventh(c);
    const Real x = (q[0] - p[0]) / sl, y = (c2 - c1) / sc, z = dhh / sh;
    const Real sum = x * x + y * y + z * z + rt * y * z;
    return sum < 0 ? Real(0) : sqrt(sum);
}

/// CMC(2:1). Within `slack` degrees of hue 164 or 345, where T jumps, `branch` 1 takes the other one.
template <class Real>
Real cmc(const Triple<Real>& p, const Triple<Real>& q, double slack, int branch, bool* at_jump) {
    const Real c1 = length(p[1], p[2]), c2 = length(q[1], q[2]), h = hue(p[1], p[2]), rad = pi<Real>() / 180;
    const Real sl = p[0] < 16 ? Real(511) / 1000 : Real(40975) / 1000000 * p[0] / (1 + Real(1765) / 100000 * p[0]);
    const Real sc = Real(638) / 10000 * c1 / (1 + Real(131) / 10000 * c1) + Real(638) / 1000;
    bool middle = h >= 164 && h <= 345;
    const bool jump = abs(Real(h - 164)) < Real(slack) || abs(Real(h - 345)) < Real(slack);
    if (at_jump) *at_jump = jump;
    if (jump && branch == 1) middle = !middle;
    const Real t = middle ? Real(56) / 100 + abs(Real(Real(2) / 10 * cos(Real((h + 168) * rad))))
                          : Real(36) / 100 + abs(Real(Real(4) / 10 * cos(Real((h + 35) * rad))));
    const Real c4 = c1 * c1 * c1 * c1, f = sqrt(Real(c4 / (c4 + 1900))), sh = sc * (f * t + 1 - f);
    const Real l = (q[0] - p[0]) / (2 * sl), c = (c2 - c1) / sc;
    return sqrt(Real(l * l + c * c + hue_squared(p[1], p[2], q[1], q[2]) / (sh * sh)));
}

/// DIN 6176:2001.
template <class Real>
Triple<Real> din99_of(const Triple<Real>& lab) {
    const Real rad = pi<Real>() / 180, k = Real(10551) / 100, s = Real(158) / 10000;
    const Real l = lab[0] < 0 ? k * s * lab[0] : k * log1p(Real(s * lab[0]));
    const Real e = lab[1] * cos(Real(16 * rad)) + lab[2] * sin(Real(16 * rad));
    const Real f = Real(7) / 10 * (-lab[1] * sin(Real(16 * rad)) + lab[2] * cos(Real(16 * rad)));
    const Real g = length(e, f);
    if (g == 0) return {l, 0, 0};
    const Real c = log1p(Real(Real(45) / 1000 * g)) / (Real(45) / 1000);
    return {l, c * e / g, c * f / g};
}

/// ITU-R BT.2100 table 4, of cd/m2; mirrored about its value at 0.
template <class Real>
Real pq(Real luminance) {
    const Real m1 = Real(2610) / 16384, m2 = Real(2523) / 32, c1 = Real(3424) / 4096, c2 = Real(2413) / 128, c3 = Real(2392) / 128;
    const Real y = luminance == 0 ? Real(0) : pow(Real(abs(luminance) / 10000), m1);
    const Real code = pow(Real((c1 + c2 * y) / (1 + c3 * y)), m2);
    return luminance < 0 ? 2 * pow(c1, m2) - code : code;
}
/// ITU-R BT.2124 annex 1: 720 times I, T, P, with the white at 203 cd/m2.
template <class Real>
Triple<Real> itp_of(const Triple<Real>& xyz, const Triple<Real>& white) {
    static const RgbSpace bt2020 = *find_rgb_space("Rec.2020");
    const auto rgb = times(inverse(rgb_to_xyz<Real>(bt2020, white)), xyz);
    const Square<Real> lms{{{1688, 2146, 262}, {683, 2951, 462}, {99, 309, 3688}}};
    auto v = times(lms, rgb);
    for (auto& x : v) x = pq(Real(x * 203 / 4096));
    return {720 * (v[0] + v[1]) / 2, 720 * (6610 * v[0] - 13613 * v[1] + 7003 * v[2]) / 8192,
            720 * (17933 * v[0] - 17390 * v[1] - 543 * v[2]) / 4096};
}
/// Ottosson 2020, the cone responses relative to the white's.
template <class Real>
Triple<Real> oklab_of(const Triple<Real>& xyz, const Triple<Real>& white) {
    const Real e = Real(1) / 10000000000ll;
    const Square<Real> to_lms{{{8189330101ll * e, 3618667424ll * e, -1288597137ll * e},
                               {329845436ll * e, 9293118715ll * e, 361456387ll * e},
                               {482003018ll * e, 2643662691ll * e, 6338517070ll * e}}};
    const Square<Real> to_lab{{{2104542553ll * e, 7936177850ll * e, -40720468ll * e},
                               {19779984951ll * e, -24285922050ll * e, 4505937099ll * e},
                               {259040371ll * e, 7827717662ll * e, -8086757660ll * e}}};
    auto v = times(to_lms, xyz);
    const auto w = times(to_lms, white);
    for (std::size_t i = 0; i < 3; ++i) v[i] = cbrt(Real(v[i] / w[i]));
    return times(to_lab, v);
}

}  // namespace spectex::quad
