// The solver behind the method jakob2019, shared by its model, its published table and the tests.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "kernels/sigmoid.h"
#include "spectex/base.h"
#include "spectex/methods.h"
#include "spectex/spectral.h"

namespace spectex::jakob2019 {

/// Coefficients are kept for t = (l - 580 nm) / 200 nm: centred, so that the terms of the quadratic do not cancel. As halves
/// over all sRGB codes they lose on average 5 times less than for (l - 380) / 400 and 6 times less than for (l - 360) / 470.
inline constexpr double origin_nm = 580, unit_nm = 200;
/// c2 of the reflectances 0 and 1, with c0 = c1 = 0: finite as a float, and evaluated to exactly 0 and 1.
inline constexpr double saturated = 0x1p100;

/// How the colours of a call were solved.
struct Counts {
    std::array<std::uint64_t, 4> passes{};  ///< by the kernel, in 1..4 passes: 3, 5, 7, 9 Newton steps
    std::uint64_t closed = 0;               ///< greys, black and white
    std::uint64_t damped = 0;               ///< one by one, by damped Newton
    std::uint64_t nearest = 0;              ///< no sigmoid was found: the nearest in CIELab
};

/// Finds sigmoids for a Colorimetry. Immutable and thread-safe.
class Solver {
public:
    explicit Solver(const Colorimetry& colorimetry);

    /// The solver of a Colorimetry's bands and sensing matrix, shared by all that ask while one holds it, and a few beyond.
    static std::shared_ptr<const Solver> shared(const Colorimetry& colorimetry);

    /// Coefficients of n colours.
    /// @param rgb  [n][3] linear; clamped to [0,1], NaN to 0.
    /// @param out  [n][3] c0, c1, c2; at most 2^100 in magnitude.
    /// @param nearest  indices of the colours for which none was found.
    void solve(std::span<const double> rgb, std::span<double> out, Counts* counts = nullptr,
               std::vector<std::size_t>* nearest = nullptr) const;

    /// The same for one colour without the table and the vector kernel. `reached`: A r = rgb to 1e-12 of the largest
    /// component of rgb, or of 1 - rgb for light colours.
    struct Solution {
        Vector3 c{};
        bool reached = false;
    };
    Solution solve_one(const Vector3& rgb) const;

    const kernels::SigmoidEquations& equations() const { return equations_; }
    const std::vector<double>& nodes() const { return nodes_; }

private:
    friend bool reaches_all_corners(const Colorimetry& colorimetry);
    struct Bare {};
    Solver(const Colorimetry& colorimetry, Bare);
    struct Mirrored {
        Vector3 q{};
        bool flipped = false;
        double z = 0;  ///< largest component of q
    };
    Mirrored mirror(Vector3 rgb) const;
    bool closed_form(const Mirrored& m, Vector3& c) const;
    Vector3 guess(const Vector3& q) const;
    Vector3 from_grey(const Vector3& q) const;
    bool newton(const Vector3& q, Vector3& c) const;
    bool newton_or_nearest(const Mirrored& m, const Vector3& start, Vector3& c) const;
    Vector3 towards(const Vector3& q) const;
    double nearest(const Vector3& rgb, Vector3& c) const;
    void residual(const Vector3& c, Vector3& f, Matrix3& jacobian) const;
    void tabulate(std::size_t resolution);

    kernels::SigmoidEquations equations_;
    std::vector<double> nodes_;
    Matrix3 rgb_to_xyz_;
    Vector3 white_{};
    bool diffuser_is_white_ = false;  ///< r = 1 is (1,1,1)
};

/// Whether every colour of the cube has a sigmoid: so it is when its corners have, for the colours of reflectances form a
/// convex set.
bool reaches_all_corners(const Colorimetry& colorimetry);

}  // namespace spectex::jakob2019
