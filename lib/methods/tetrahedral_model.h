// The model of every method that is linear on the tetrahedra of a lattice.
#pragma once

#include "kernels/lattice.h"
#include "methods/registry.h"

namespace spectex::registry {

/// Spectra at the vertices, blended by Kuhn's subdivision in double (see kernels/lattice.h for the formula).
class TetrahedralModel : public Model {
public:
    TetrahedralModel(const MethodInfo& info, const Colorimetry& colorimetry, LatticeTable table);
    void reflectance(std::span<const double> rgb, std::span<double> out) const override;
    const LatticeTable* lattice() const override { return &table_; }
    /// The shared members, `knots` [3][...] and `vertices` [r][g][b][bands].
    std::string to_json() const override;

private:
    LatticeTable table_;
};

/// The linear RGB of a vertex, by its index in LatticeTable::vertices.
Vector3 vertex_color(const LatticeTable& table, std::size_t vertex);

/// Reads `knots` and `vertices`. @param low, high  the range of every number of a vertex.
/// @param slip  how far A r of a vertex may lie from its colour; negative: not checked.
/// @error input, naming the member.
Result<LatticeTable> read_lattice(const Colorimetry& colorimetry, const Json& json, double low, double high, double slip);

}  // namespace spectex::registry
