// The bounded maximum entropy spectral estimate behind the method peters2019, shared by its models and the tests.
//
// A reflectance is an even function of a phase, g(phi) = 1/2 + arctan(P(cos phi)) / pi with P(x) = a + b x + c x^2: the form
// that bounded entropy is greatest in, where three real trigonometric moments (1/pi) int_0^pi g(phi) cos(j phi) dphi are given.
// Multipliers (a, b, c) and moments determine each other in closed form.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "spectex/base.h"
#include "spectex/spectral.h"

namespace spectex::peters2019 {

/// g where P has this value; full relative precision towards 0.
double bounded(double p);

/// Moments of the g of these multipliers, finite and at most 2^24 in magnitude.
Vector3 moments_of(const Vector3& multipliers);
/// Multipliers of moments with 0 < m0 <= 1/2. Moments that no bounded function has are drawn to those of one: the
/// reflection coefficients of their Toeplitz matrix to a modulus of 1 - 1e-12.
Vector3 multipliers_of(const Vector3& moments);

/// cos phi at a band's centre, phi in [0, pi] rising with wavelength: even steps of phase take even shares of the square root
/// of x + y + z, the observer's three functions, from 360 to 830 nm.
double phase_cosine(const Observer& observer, double wavelength_nm);

/// A spectrum as multipliers: g, or 1 - g, times a scale for the very dark.
struct Solution {
    Vector3 multipliers{};
    double scale = 1;         ///< of a colour below 2^-12; 0 for black
    bool complement = false;  ///< 1 - scale * g
    double error = 0;         ///< largest |A r - rgb| over the largest component of what was solved
    int steps = 0;            ///< of Newton's method
};

/// Finds multipliers for colours, and spectra for multipliers. Immutable and thread-safe.
class Solver {
public:
    explicit Solver(const Colorimetry& colorimetry);
    /// @param rgb  linear; clamped to [0,1], NaN to 0.
    Solution solve(const Vector3& rgb) const;
    /// The same for n colours, by vectors from a table of near solutions that the first call makes; those of which that fails
    /// one by one. `error` and `steps` are left as they are.
    /// @param rgb  [n][3].  @param out  [n].
    void solve(std::span<const double> rgb, Solution* out) const;
    /// At bands' phases.  @param x  their cosines.  @param out  [x], each in [0,1].
    static void reflectances(const Solution& solution, std::span<const double> x, double* out);
    const std::vector<double>& phase_cosines() const { return x_; }
    static Vector3 moments(const Solution& solution);
    /// Any three numbers; NaN counts as 0.
    static Solution of_moments(Vector3 moments);

private:
    struct Near;
    /// q is the darker half's, z its largest component.
    struct Prepared {
        Vector3 q{};
        double top = 0, low = 0;
    };
    /// @return false where it is black, or its complement is.
    static bool prepare(const Vector3& rgb, Solution& s, Prepared& out);
    bool newton(const Vector3& q, Vector3& v, Solution& report) const;
    void solve(std::span<const double> rgb, Solution* out, const Near& near) const;
    const Near& near() const;
    std::shared_ptr<Near> near_;  ///< made when it is first asked for
    std::vector<double> x_;                     ///< [bands] cos phi
    std::vector<std::array<double, 3>> sense_;  ///< [bands] columns of A
};

}  // namespace spectex::peters2019
