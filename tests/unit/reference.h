// An independent reference in long double: reads the CSV tables by itself, sums by itself, and shares no code with the library
// but the names of files.
#pragma once

#include <array>
#include <cmath>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace reference {

using Real = long double;

struct Table {
    std::vector<Real> nm;
    std::map<std::string, std::vector<Real>> column;
};

inline Table read_csv(const std::string& path) {
    std::ifstream in(path);
    if (!in) throw std::runtime_error("no file " + path);
    Table table;
    std::vector<std::string> names;
    std::string line;
    while (std::getline(in, line)) {
        std::vector<std::string> fields;
        std::stringstream row(line);
        for (std::string field; std::getline(row, field, ',');) fields.push_back(field);
        if (names.empty()) {
            names = fields;
            continue;
        }
        table.nm.push_back(std::stold(fields[0]));
        for (std::size_t i = 1; i < fields.size(); ++i) table.column[names[i]].push_back(std::stold(fields[i]));
    }
    return table;
}

/// Piecewise linear, zero outside.
inline Real interpolate(const std::vector<Real>& x, const std::vector<Real>& y, Real at) {
    if (at < x.front() || at > x.back()) return 0;
    std::size_t i = 0;
    while (i + 2 < x.size() && x[i + 1] <= at) ++i;
    return y[i] + (y[i + 1] - y[i]) * (at - x[i]) / (x[i + 1] - x[i]);
}

struct Light {
    std::vector<Real> nm, power;
    Real operator()(Real at) const { return interpolate(nm, power, at); }
};

/// CIE D65 from the tabulated values at 5 nm, an independent source beside the daylight components.
inline Light d65_table(const std::string& folder) {
    const Table t = read_csv(folder + "/illuminant_D65_380-780-5.csv");
    return {t.nm, t.column.begin()->second};
}

using Vec3 = std::array<Real, 3>;
using Mat3 = std::array<std::array<Real, 3>, 3>;

inline Vec3 multiply(const Mat3& m, const Vec3& v) {
    Vec3 r{};
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j) r[i] += m[i][j] * v[j];
    return r;
}

/// Solves m x = v by Gaussian elimination with pivoting.
inline Vec3 solve(Mat3 m, Vec3 v) {
    for (std::size_t k = 0; k < 3; ++k) {
        std::size_t pivot = k;
        for (std::size_t i = k + 1; i < 3; ++i)
            if (std::fabs(m[i][k]) > std::fabs(m[pivot][k])) pivot = i;
        std::swap(m[k], m[pivot]);
        std::swap(v[k], v[pivot]);
        for (std::size_t i = k + 1; i < 3; ++i) {
            const Real f = m[i][k] / m[k][k];
            for (std::size_t j = k; j < 3; ++j) m[i][j] -= f * m[k][j];
            v[i] -= f * v[k];
        }
    }
    Vec3 x{};
    for (std::size_t i = 3; i-- > 0;) {
        x[i] = v[i];
        for (std::size_t j = i + 1; j < 3; ++j) x[i] -= m[i][j] * x[j];
        x[i] /= m[i][i];
    }
    return x;
}

/// XYZ of a reflectance given as a function of wavelength, summed at 1 nm over [start, end], not normalised.
template <class Reflectance>
Vec3 xyz(const Table& cmf, const Light& light, int start, int end, const Reflectance& r) {
    Vec3 sum{};
    static const char* names[] = {"x_bar", "y_bar", "z_bar"};
    for (std::size_t i = 0; i < cmf.nm.size(); ++i) {
        if (cmf.nm[i] < start || cmf.nm[i] > end) continue;
        const Real p = light(cmf.nm[i]) * r(cmf.nm[i]);
        for (std::size_t c = 0; c < 3; ++c) sum[c] += p * cmf.column.at(names[c])[i];
    }
    return sum;
}

/// RGB-to-XYZ of BT.709's primaries scaled to a white.
inline Mat3 bt709_to_xyz(const Vec3& white) {
    const Real xy[3][2] = {{0.64L, 0.33L}, {0.30L, 0.60L}, {0.15L, 0.06L}};
    Mat3 p{};
    for (std::size_t j = 0; j < 3; ++j) {
        p[0][j] = xy[j][0] / xy[j][1];
        p[1][j] = 1;
        p[2][j] = (1 - xy[j][0] - xy[j][1]) / xy[j][1];
    }
    const Vec3 s = solve(p, white);
    for (auto& row : p)
        for (std::size_t j = 0; j < 3; ++j) row[j] *= s[j];
    return p;
}

inline Real lab_f(Real t) {
    const Real d = 6.0L / 29.0L;
    return t > d * d * d ? std::cbrt(t) : t / (3 * d * d) + 4.0L / 29.0L;
}
inline Vec3 lab(const Vec3& xyz, const Vec3& white) {
    const Real fx = lab_f(xyz[0] / white[0]), fy = lab_f(xyz[1] / white[1]), fz = lab_f(xyz[2] / white[2]);
    return {116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)};
}
inline Real delta_e76(const Vec3& a, const Vec3& b) {
    return std::sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]));
}

/// IEC 61966-2-1.
inline Real srgb_to_linear(Real v) { return v <= 0.04045L ? v / 12.92L : std::pow((v + 0.055L) / 1.055L, 2.4L); }

}  // namespace reference
