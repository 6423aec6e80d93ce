// The solver behind the method burns2020, for its model and for the stress suite, which counts its steps.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "spectex/base.h"
#include "spectex/spectral.h"

namespace spectex::burns2020 {

struct Solution {
    double error = 0;  ///< largest |A r - rgb| over the largest component of the colour or of its complement, whichever was solved
    int steps = 0;     ///< of Newton's method; 0: in closed form
};

/// Spectra of least hyperbolic tangent slope squared. Immutable and thread-safe.
class Solver {
public:
    explicit Solver(const Colorimetry& colorimetry);

    struct Work {
        explicit Work(std::size_t n) : z(n), r(n), diagonal(n), inverse(n), right(4 * n), best(n) {}
        std::vector<double> z, r, diagonal, inverse, right, best;
        Vector3 y{};  ///< the multipliers
    };
    std::size_t bands() const { return slope_.size() + 1; }
    /// @param rgb  [3] linear, in [0,1]. @param out  [bands], in [0,1]. @param work  of bands().
    Solution solve(const double* rgb, double* out, Work& work) const;
    /// The same for n colours, by vectors from a table of guesses that the first call makes; one by one where that fails.
    /// @param rgb  [n][3].  @param out  [n][bands].
    void solve(std::span<const double> rgb, std::span<double> out) const;

private:
    struct Guesses;
    Solution newton(const Vector3& color, Work& work) const;
    void tabulate(std::size_t resolution) const;
    std::vector<double> slope_;  ///< [bands - 1], weight of each squared difference
    std::vector<double> a_;      ///< [3][bands]
    std::shared_ptr<Guesses> guesses_;
};

}  // namespace spectex::burns2020
