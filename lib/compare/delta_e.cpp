// Colour-difference formulas, one pair at a time, in double.
#include <algorithm>
#include <cmath>
#include <numbers>

#include "compare/spaces.h"
#include "spectex/compare.h"

namespace spectex {

namespace {

constexpr double degree = std::numbers::pi / 180;
const double cos6 = std::cos(6 * degree), sin6 = std::sin(6 * degree);
const double cos30 = std::cos(30 * degree), sin30 = std::sin(30 * degree);
const double cos63 = std::cos(63 * degree), sin63 = std::sin(63 * degree);

double square(double x) { return x * x; }
double distance(const Vector3& p, const Vector3& q) {
    return std::sqrt(square(p[0] - q[0]) + square(p[1] - q[1]) + square(p[2] - q[2]));
}

// C2 - C1 by the difference of squares: the roots of near colours would cancel.
double chroma_difference(double a1, double b1, double c1, double a2, double b2, double c2, double da, double db) {
    const double sum = c1 + c2;
    return sum == 0 ? 0 : da * ((a1 + a2) / sum) + db * ((b1 + b2) / sum);
}

// The metric hue difference, the root of 2 (C1 C2 - a1 a2 - b1 b2), without its cancellation for near hues (Sève 1991), and
// with the cross product of a colour and a difference, which near colours leave its digits. No square of a square overflows.
// Signed, positive anticlockwise, where the hues are less than 90 degrees apart; else without a sign.
double hue_difference(double a1, double b1, double c1, double a2, double b2, double c2, double da, double db) {
    const double dot = a1 * a2 + b1 * b2;
    if (!(dot > 0)) return std::sqrt(2 * (c1 * c2 - dot));
    return std::numbers::sqrt2 * (a1 * db - b1 * da) / std::sqrt(c1 * c2 + dot);
}

// Hue angle in degrees, [0, 360); 0 for a neutral.
double hue_degrees(double a, double b) {
    if (a == 0 && b == 0) return 0;
    const double h = std::atan2(b, a) / degree;
    return h < 0 ? h + 360 : h;
}

}  // namespace

Vector3 lab_from_xyz(const Vector3& xyz, const Vector3& white) {
    Vector3 f{};
    for (std::size_t k = 0; k < 3; ++k) f[k] = lab_f(white[k] == 0 ? 0 : xyz[k] / white[k]);
    return lab_from_f(f);
}

double delta_e76(const Vector3& lab_reference, const Vector3& lab_sample) { return distance(lab_reference, lab_sample); }

double delta_e94(const Vector3& lab_reference, const Vector3& lab_sample) {
    const auto& [l1, a1, b1] = lab_reference;
    const auto& [l2, a2, b2] = lab_sample;
    const double c1 = std::sqrt(a1 * a1 + b1 * b1), c2 = std::sqrt(a2 * a2 + b2 * b2);
    const double da = a2 - a1, db = b2 - b1;
    const double hue = hue_difference(a1, b1, c1, a2, b2, c2, da, db), chroma = chroma_difference(a1, b1, c1, a2, b2, c2, da, db);
    return std::sqrt(square(l2 - l1) + square(chroma / (1 + 0.045 * c1)) + square(hue / (1 + 0.015 * c1)));
}

double delta_e2000(const Vector3& lab_reference, const Vector3& lab_sample) {
    // Names and equation numbers as in Sharma, Wu and Dalal 2005, doi:10.1002/col.20070.
    const auto& [l1, a1, b1] = lab_reference;
    const auto& [l2, a2, b2] = lab_sample;
    // C^7 / (C^7 + 25^7), written so that no chroma overflows.
    const auto seventh = [](double c) {
        const double q = 25 / c, q3 = q * q * q;
        return 1 / (1 + q3 * q3 * q);
    };
    const double mean_c = (std::sqrt(a1 * a1 + b1 * b1) + std::sqrt(a2 * a2 + b2 * b2)) / 2;  // eq. 2, 3
    const double g = 0.5 * (1 - std::sqrt(seventh(mean_c)));                                 // eq. 4
    const double ap1 = (1 + g) * a1, ap2 = (1 + g) * a2;                                     // eq. 5
    const double cp1 = std::sqrt(ap1 * ap1 + b1 * b1), cp2 = std::sqrt(ap2 * ap2 + b2 * b2);  // eq. 6
    const double h1 = hue_degrees(ap1, b1), h2 = hue_degrees(ap2, b2);                       // eq. 7
    const bool neutral = cp1 == 0 || cp2 == 0;

    const double da = (1 + g) * (a2 - a1), db = b2 - b1;
    const double dl = l2 - l1;   // eq. 8
    const double dc = chroma_difference(ap1, b1, cp1, ap2, b2, cp2, da, db);  // eq. 9
    // Eq. 10 and 11: only the sign of far hues needs the angles, which near ones may share to the last bit; the size is Sève's
    // form, exact for near hues.
    double turn = h2 - h1;
    if (turn > 180) turn -= 360;
    else if (turn < -180) turn += 360;
    double dh = neutral ? 0 : hue_difference(ap1, b1, cp1, ap2, b2, cp2, da, db);
    if (turn < 0 && std::fabs(turn) > 60) dh = -std::fabs(dh);

    const double mean_l = (l1 + l2) / 2;     // eq. 12
    const double mean_cp = (cp1 + cp2) / 2;  // eq. 13
    double mean_h = h1 + h2;                 // eq. 14
    if (!neutral) {
        if (std::fabs(h1 - h2) > 180) mean_h += mean_h < 360 ? 360 : -360;
        mean_h /= 2;
    }
    // Eq. 15, its multiple angles from one cosine and sine: cos(k h + p) = cos p cos k h - sin p sin k h.
    const double c = std::cos(mean_h * degree), s = std::sin(mean_h * degree);
    const double c2 = c * c - s * s, s2 = 2 * s * c;
    const double c3 = c2 * c - s2 * s, s3 = s2 * c + c2 * s;
    const double c4 = c2 * c2 - s2 * s2, s4 = 2 * s2 * c2;
    const double t = 1 - 0.17 * (cos30 * c + sin30 * s) + 0.24 * c2 + 0.32 * (cos6 * c3 - sin6 * s3) -
                     0.20 * (cos63 * c4 + sin63 * s4);
    // Eq. 16; beyond 40 the exponential is below the rounding of a difference.
    const double from_275 = square((mean_h - 275) / 25);
    const double rotation = from_275 < 40 ? 30 * std::exp(-from_275) : 0;
    const double rc = 2 * std::sqrt(seventh(mean_cp));                                       // eq. 17
    const double from_50 = square(mean_l - 50);
    const double sl = 1 + 0.015 * from_50 / std::sqrt(20 + from_50);  // eq. 18
    const double sc = 1 + 0.045 * mean_cp;                            // eq. 19
    const double sh = 1 + 0.015 * mean_cp * t;                        // eq. 20
    const double rt = -std::sin(2 * rotation * degree) * rc;          // eq. 21
    const double x = dl / sl, y = dc / sc, z = dh / sh;
    const double sum = x * x + y * y + z * z + rt * y * z;  // eq. 22
    // The rotation term can take the sum below zero by a rounding.
    return sum < 0 ? 0 : std::sqrt(sum);
}

double delta_cmc(const Vector3& lab_reference, const Vector3& lab_sample) {
    // Clarke, McDonald and Rigg 1984, doi:10.1111/j.1478-4408.1984.tb00950.x.
    const auto& [l1, a1, b1] = lab_reference;
    const auto& [l2, a2, b2] = lab_sample;
    const double c1 = std::sqrt(a1 * a1 + b1 * b1), c2 = std::sqrt(a2 * a2 + b2 * b2);
    const double h1 = hue_degrees(a1, b1);
    const double sl = l1 < 16 ? 0.511 : 0.040975 * l1 / (1 + 0.01765 * l1);
    const double sc = 0.0638 * c1 / (1 + 0.0131 * c1) + 0.638;
    const double t = h1 >= 164 && h1 <= 345 ? 0.56 + std::fabs(0.2 * std::cos((h1 + 168) * degree))
                                            : 0.36 + std::fabs(0.4 * std::cos((h1 + 35) * degree));
    const double f = std::sqrt(1 / (1 + 1900 / square(square(c1))));
    const double sh = sc * (f * t + 1 - f);
    const double da = a2 - a1, db = b2 - b1;
    const double hue = hue_difference(a1, b1, c1, a2, b2, c2, da, db), chroma = chroma_difference(a1, b1, c1, a2, b2, c2, da, db);
    return std::sqrt(square((l2 - l1) / (2 * sl)) + square(chroma / sc) + square(hue / sh));
}

Vector3 din99_from_lab(const Vector3& lab) {
    static const double cos16 = std::cos(16 * degree), sin16 = std::sin(16 * degree);
    const auto& [l, a, b] = lab;
    const double l99 = l < 0 ? 105.51 * 0.0158 * l : 105.51 * std::log1p(0.0158 * l);
    const double e = a * cos16 + b * sin16;
    const double f = 0.7 * (b * cos16 - a * sin16);
    const double g = 0.045 * std::sqrt(e * e + f * f);
    const double k = g == 0 ? 1 : std::log1p(g) / g;
    return {l99, k * e, k * f};
}

double delta_e_din99(const Vector3& lab_reference, const Vector3& lab_sample) {
    return distance(din99_from_lab(lab_reference), din99_from_lab(lab_sample));
}

}  // namespace spectex
