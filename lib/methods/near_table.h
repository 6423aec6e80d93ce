// A grid of colours over (block, w, y, x), from whose solutions those of others are guessed: the block is the index of the
// largest component z of a colour q, w = sqrt(z), x and y are the next two components (cyclically) over z; even in
// SigmoidEquations' positions, which are finest where the solutions of such methods bend.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "kernels/sigmoid.h"
#include "spectex/base.h"

namespace spectex::near_table {

/// Colours of all vertices of n steps an axis.  @param darkest  the z that stands for black.
inline std::vector<Vector3> vertices(std::size_t n, double darkest) {
    using Axes = kernels::SigmoidEquations;
    const auto at = [n](std::size_t k) { return static_cast<double>(k) / static_cast<double>(n - 1); };
    std::vector<Vector3> out(3 * n * n * n);
    for (std::size_t i = 0; i < out.size(); ++i) {
        const std::size_t block = i / (n * n * n), w = i / (n * n) % n, y = i / n % n, x = i % n;
        const double root = Axes::root_at(at(w)), z = std::max(root * root, darkest);
        out[i][block] = z;
        out[i][(block + 1) % 3] = z * Axes::ratio_at(at(x));
        out[i][(block + 2) % 3] = z * Axes::ratio_at(at(y));
    }
    return out;
}

/// The vertices about a colour, and their shares.
struct Cell {
    std::array<std::size_t, 8> vertex{};
    std::array<double, 8> share{};
};
/// @param z  largest component of q, above 0.
inline Cell cell_of(const Vector3& q, double z, std::size_t n) {
    using Axes = kernels::SigmoidEquations;
    const auto largest = static_cast<std::size_t>(std::max_element(q.begin(), q.end()) - q.begin());
    const std::array<double, 3> position{Axes::ratio_position(q[(largest + 1) % 3] / z), Axes::ratio_position(q[(largest + 2) % 3] / z),
                                         Axes::root_position(std::sqrt(z))};
    std::array<std::size_t, 3> at{};
    std::array<double, 3> fraction{};
    for (std::size_t k = 0; k < 3; ++k) {
        const double p = std::clamp(position[k], 0.0, 1.0) * static_cast<double>(n - 1);
        at[k] = std::min(static_cast<std::size_t>(p), n - 2);
        fraction[k] = p - static_cast<double>(at[k]);
    }
    Cell cell;
    for (std::size_t corner = 0; corner < 8; ++corner) {
        const std::size_t dx = corner & 1, dy = corner >> 1 & 1, dz = corner >> 2;
        cell.vertex[corner] = ((largest * n + at[2] + dz) * n + at[1] + dy) * n + at[0] + dx;
        cell.share[corner] = (dx ? fraction[0] : 1 - fraction[0]) * (dy ? fraction[1] : 1 - fraction[1]) * (dz ? fraction[2] : 1 - fraction[2]);
    }
    return cell;
}

}  // namespace spectex::near_table
