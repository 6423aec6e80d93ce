// Tetrahedral interpolation of a table over the RGB cube.
#pragma once

#include <array>
#include <cstddef>
#include <vector>
#include <span>

#include "spectex/methods.h"

namespace spectex::kernels {

/// Kuhn's subdivision: within a cell the positions sorted in descending order, f1 >= f2 >= f3, pick the tetrahedron, and the
/// value is (1 - f1) v0 + (f1 - f2) v1 + (f2 - f3) v2 + f3 v3, where v0 is the cell's lowest vertex and each next one goes
/// a step along the axis of the next position (equal positions: R before G before B, which changes no value).
/// Source: Kuhn 1960, doi:10.1147/rd.45.0518.
///
/// Evaluated in double and rounded once to float. Components are clamped to [0,1] and NaN counts as 0, so that nothing
/// outside the table is read; callers that care map colours first. Any n and alignment; the bytes depend neither on the
/// split into calls nor on the instruction set. Keeps a reference to the table.
class LatticeKernel {
public:
    explicit LatticeKernel(const LatticeTable& table);

    /// @param rgb  three planes of n, linear. @param planes  [values], each [n]; a null plane is skipped.
    void operator()(std::array<const float*, 3> rgb, std::size_t n, float* const* planes) const;
    void operator()(std::array<const float*, 3> rgb, std::size_t n, double* const* planes) const;
    void reference(std::array<const float*, 3> rgb, std::size_t n, double* const* planes) const;

private:
    const LatticeTable* table_;
    std::array<bool, 3> uniform_{};
    std::array<std::size_t, 3> strides_{};  ///< from vertex to vertex along each axis, in numbers
    std::vector<double> padded_;            ///< of three values: the vertices, four numbers each
};

/// The same from colours in double, not rounded, a colour at a time.
/// @param rgb  [n][3] linear; clamped to [0,1]. @param out  [n][values].
void interpolate_lattice(const LatticeTable& table, std::span<const double> rgb, std::span<double> out);

}  // namespace spectex::kernels
