// Coordinates in which differences are taken.
#pragma once

#include <cmath>

#include "spectex/compare.h"

namespace spectex {

/// CIE 15:2018 eq. 8.6 and 8.7; the linear branch continues below zero.
inline double lab_f(double t) {
    constexpr double border = (24.0 / 116) * (24.0 / 116) * (24.0 / 116);
    return t > border ? std::cbrt(t) : 841.0 / 108 * t + 16.0 / 116;
}
inline Vector3 lab_from_f(const Vector3& f) { return {116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])}; }

/// L99, a99, b99 of DIN 6176:2001 with kE = kCH = 1. Below L* = 0 the lightness goes on with its slope at 0.
Vector3 din99_from_lab(const Vector3& lab);

/// Perceptual quantizer, ITU-R BT.2100 table 4, of a luminance in cd/m2; mirrored about its value at 0 for negative light.
double pq_encode(double luminance);

/// Relative XYZ, times 1, to I, T, P of ITU-R BT.2124 annex 1.
struct ItpSpace {
    explicit ItpSpace(const Vector3& white);
    Vector3 operator()(const Vector3& xyz) const;
    Matrix3 xyz_to_lms;  ///< to cd/m2
};

/// Relative XYZ to Oklab.
struct OklabSpace {
    explicit OklabSpace(const Vector3& white);
    Vector3 operator()(const Vector3& xyz) const;
    Matrix3 xyz_to_lms;
    /// From cube roots.
    static constexpr Matrix3 lms_to_lab{{0.2104542553, 0.7936177850, -0.0040720468, 1.9779984951, -2.4285922050, 0.4505937099,
                                         0.0259040371, 0.7827717662, -0.8086757660}};
};

/// A row of a matrix as sum * v[base] + first * (v[the next one] - v[base]) + second * (v[the last one] - v[base]): where the
/// rows sum to 1, as those of XYZ over the white's do, grey comes out with three equal components, to the bit, and so with
/// a* = b* = 0, whose hue no rounding makes up. The base has the largest coefficient, so that nothing cancels.
struct GreyRow {
    GreyRow() = default;
    explicit GreyRow(const double* row);
    int base = 0;
    double sum = 0, first = 0, second = 0;
};

/// Lab of n colours, with t = `to_relative` rgb the XYZ over the white's; every instruction set gives the same bytes.
/// Cube roots within 2^-50 of lab_f, relative.
void lab_planes(const Matrix3& to_relative, std::array<const float*, 3> rgb, std::size_t n, std::array<double*, 3> lab);
void lab_planes(const Matrix3& to_relative, std::array<const double*, 3> rgb, std::size_t n, std::array<double*, 3> lab);

/// The coordinates of n colours: as din99_from_lab of `lab`, in place, and as ItpSpace and OklabSpace of to_xyz rgb, all to
/// some units in the last place; every instruction set gives the same bytes.
void din99_planes(std::array<double*, 3> lab, std::size_t n);
void space_planes(const ItpSpace& space, const Matrix3& to_xyz, std::array<const float*, 3> rgb, std::size_t n, std::array<double*, 3> out);
void space_planes(const OklabSpace& space, const Matrix3& to_xyz, std::array<const float*, 3> rgb, std::size_t n, std::array<double*, 3> out);

/// `unit` times the distance of n pairs, delta_e94 and delta_cmc of n pairs of Lab: in double, rounded once; the very numbers
/// of the formulas for one pair, and of CMC those to some units in the last place before that rounding.
void distance_planes(double unit, std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, float* out);
void delta_e94_planes(std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, float* out);
void delta_cmc_planes(std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, float* out);

/// delta_e2000 of n pairs of Lab in float: within 5e-6 of it, relative, plus 1e-11 (1e-7 but for blues, whose rotation
/// term cancels), save where the formula itself jumps: opposite hues. Exactly 0 for equal colours, symmetric; every instruction set gives the same bytes.
void delta_e2000_planes(std::array<const double*, 3> a, std::array<const double*, 3> b, std::size_t n, float* out);

}  // namespace spectex
