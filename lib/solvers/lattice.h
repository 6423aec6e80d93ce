// The lattice's vertices one at a time, and the exact metamer nearest to a spectrum.
#pragma once

#include <Eigen/Dense>
#include <memory>
#include <span>
#include <vector>

#include "spectex/solvers.h"

namespace spectex::solvers {

/// The programme behind solve_lattice with everything prepared that does not depend on the vertex. Thread-safe.
class LatticeSolver {
public:
    /// @error as solve_lattice.
    static Result<LatticeSolver> make(const Colorimetry& colorimetry, std::span<const SampleSet> sets,
                                      const LatticeOptions& options);

    /// The most natural reflectance of a linear RGB colour of [0,1]^3, [bands]. Black is 0 and white is 1.
    /// @error input, when the programme does not converge.
    Result<std::vector<double>> reflectance(const Vector3& rgb) const;

private:
    Colorimetry colorimetry_;
    LatticeOptions options_;
    Eigen::MatrixXd samples_;   ///< [bands][samples]
    Eigen::MatrixXd features_;  ///< [3][samples]
    Eigen::VectorXd weights_;   ///< [samples], one over the size of the set
    Eigen::MatrixXd smoothness_;
    Eigen::VectorXd ridge_;

    explicit LatticeSolver(Colorimetry colorimetry) : colorimetry_(std::move(colorimetry)) {}
    Eigen::Vector3d feature(const Vector3& rgb) const;
};

/// Reflectance r in [0,1] with A r = rgb that is nearest to `target`: sum_l (r_l - target_l)^2 / mobility_l is least, by
/// Newton's method on the dual, which has three unknowns. Bands of mobility 0 stay as they are.
/// @param sensing   [3][bands] row-major.
/// @param target    [bands], in [0,1].
/// @param mobility  [bands], >= 0.
/// @return whether |A r - rgb| <= 1e-13 was reached; `out` is in [0,1] either way.
bool nearest_metamer(std::span<const double> sensing, std::span<const double> target, std::span<const double> mobility,
                     const Vector3& rgb, std::span<double> out);

/// Least t with -t <= r <= 1 + t and A r = rgb. @error input, when the linear programme does not converge.
Result<double> least_violation(std::span<const double> sensing, const Vector3& rgb);

/// Whether every colour of the cube has a reflectance in [0,1].
/// @error infeasible, naming the corner of the cube and its least violation.
Status check_cube(const Colorimetry& colorimetry);

/// For every vertex the exact metamer on `to` that is nearest to the spectrum of `table` (on `from`), linear between bands.
/// Costs milliseconds, and nothing changes where the bands of `to` include those of `from`.
/// @error infeasible as check_cube.
Result<LatticeTable> transfer_lattice(const LatticeTable& table, const BandSet& from, const Colorimetry& to);

/// Reads what encode_lattice wrote. Hostile input is refused. Bounds are exact in storage; what rounding to 16 bits took from
/// A r = rgb is given back by the bands in between. @error input, naming `label`.
Result<LatticeTable> decode_lattice(std::string_view bytes, std::string_view label, const Colorimetry& colorimetry);

}  // namespace spectex::solvers
