// Few bands in place of many, for methods of which each spectrum must be formed.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "spectex/methods.h"

namespace spectex::plan {

struct Quadrature {
    std::vector<std::size_t> bands;  ///< ascending
    std::vector<double> weights;     ///< [values][bands.size()]
    /// Twice the largest CIE76 that was seen of `colors` colours, half of which the weights were not fitted to. No theorem: the
    /// spectra of a method's most saturated colours are as steep as its bands are fine, and those are among the colours.
    double error = 0;
    std::size_t colors = 0;
};

/// The fewest bands, found one by one (pivoted orthogonalisation, by what is left of the integrals), whose fitted weights give the
/// integrals of all the method's spectra within a bound. Nothing where the method does not form bands apart, or where what is
/// saved is less than a fifth.
/// @param rows    [values][bands]: linear RGB under each light, as values = 3 lights.
/// @param to_xyz  of that linear RGB. @param bound  CIE76, above 0, relative to each light's white.
std::optional<Quadrature> choose_quadrature(const Model& model, std::span<const double> rows, const Matrix3& to_xyz, double bound);

}  // namespace spectex::plan
