// Reflectance methods: from linear RGB to a spectrum, one per paper.
//
// A Method is named in the registry; solved for a Colorimetry it is a Model. Models are immutable and thread-safe.
// Colours are linear RGB in the Colorimetry's space, in [0,1]; what lies outside is mapped first (map_into_gamut), never
// silently inside a model.
#pragma once

#include <algorithm>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"
#include "spectex/spectral.h"

namespace spectex {

/// How a spectrum depends on its colour, which decides what a Plan may leave out.
enum class Pieces {
    linear,       ///< r = B rgb: relighting is one 3x3 matrix
    tetrahedral,  ///< linear on each tetrahedron of a lattice: relighting is a tetrahedral 3-D table
    nonlinear,    ///< a spectrum must be formed
};

struct MethodInfo {
    std::string id;      ///< as typed: mallett2019
    std::string title;   ///< for people
    std::string source;  ///< author, year, venue, doi
    Pieces pieces = Pieces::nonlinear;
    bool exact = false;    ///< A r = rgb to rounding for every colour of [0,1]^3
    bool bounded = false;  ///< 0 <= r <= 1 for every colour of [0,1]^3
    int coefficients = 3;  ///< stored per texel in a coefficient texture
};

/// Spectra at the vertices of a lattice over the RGB cube; inside a cell, Kuhn's six tetrahedra (the order of the
/// components of the position within the cell picks one).
struct LatticeTable {
    std::array<std::vector<double>, 3> knots;  ///< per axis, ascending from 0 to 1, at least two
    std::size_t values = 0;                    ///< numbers per vertex: bands, or 3 for a relit table
    std::vector<double> vertices;              ///< [r][g][b][values], b fastest of the axes
};

/// A method solved for one Colorimetry.
class SPECTEX_API Model {
public:
    virtual ~Model();
    const MethodInfo& info() const { return info_; }
    const Colorimetry& colorimetry() const { return colorimetry_; }

    /// Reflectances of n colours.
    /// @param rgb  [n][3] linear, each in [0,1].
    /// @param out  [n][bands], dimensionless.
    virtual void reflectance(std::span<const double> rgb, std::span<double> out) const = 0;

    /// Names of the channels of a coefficient texture, in order. Piecewise linear methods keep linear RGB itself.
    virtual std::vector<std::string> coefficient_names() const { return {"R", "G", "B"}; }
    /// What a coefficient texture keeps of n colours. @param out  [n][info().coefficients].
    virtual void coefficients(std::span<const double> rgb, std::span<double> out) const {
        std::copy(rgb.begin(), rgb.end(), out.begin());
    }
    /// Indices of the colours for which the method finds no spectrum and takes the nearest one. A method that has a spectrum
    /// for each, as where info().exact, and one that is not exact by design, names none.
    virtual std::vector<std::size_t> unreached([[maybe_unused]] std::span<const double> rgb) const { return {}; }
    /// Draws coefficients to those nearest in colour whose magnitude a file's type holds.
    /// @param coefficients  [n][info().coefficients]. @param most  largest finite number of that type.
    virtual void limit_coefficients([[maybe_unused]] std::span<double> coefficients, [[maybe_unused]] double most) const {}
    /// Reflectances from stored coefficients. @param out  [n][bands].
    virtual void reflectance_of_coefficients(std::span<const double> coefficients, std::span<double> out) const {
        reflectance(coefficients, out);
    }

    /// Whether one band is formed without the others, so that who needs few bands pays for few.
    virtual bool bands_apart() const { return false; }
    /// The reflectances of n colours, or of stored coefficients, in some bands; where bands are not apart all are formed.
    /// @param bands  indices, ascending. @param out  [n][bands.size()], the very numbers that the whole spectrum has there.
    virtual void reflectance_in(std::span<const std::size_t> bands, std::span<const double> rgb, std::span<double> out) const;
    virtual void reflectance_of_coefficients_in(std::span<const std::size_t> bands, std::span<const double> coefficients,
                                                std::span<double> out) const;

    /// [3][bands] row-major for Pieces::linear: r = sum_i rgb_i basis_i. Null otherwise.
    virtual const std::vector<double>* basis() const { return nullptr; }
    /// For Pieces::tetrahedral. Null otherwise.
    virtual const LatticeTable* lattice() const { return nullptr; }

    /// The model as JSON text, enough for make_model_from_json to rebuild it: what a file carries for its reader.
    virtual std::string to_json() const = 0;

protected:
    Model(MethodInfo info, Colorimetry colorimetry) : info_(std::move(info)), colorimetry_(std::move(colorimetry)) {}

private:
    MethodInfo info_;
    Colorimetry colorimetry_;
};

/// What the tools take where no method is named: exact, and measured to predict measured reflectances best.
inline constexpr std::string_view default_method = "lattice";

/// All registered methods, in the order of the README's table.
SPECTEX_API const std::vector<MethodInfo>& methods();
/// @error usage, listing the ids.
SPECTEX_API Result<MethodInfo> find_method(std::string_view id);
/// Solves a method for a Colorimetry.
/// @error usage for an unknown id; infeasible, with the least violation, where no spectra satisfy the constraints.
SPECTEX_API Result<std::shared_ptr<const Model>> make_model(std::string_view id, const Colorimetry& colorimetry);
/// The same, but a method that learns from measured reflectances learns from these; for tests of how it does on others.
/// Such a model's JSON does not bring it back.
SPECTEX_API Result<std::shared_ptr<const Model>> train_model(std::string_view id, const Colorimetry& colorimetry,
                                                             std::span<const SampleSet> sets);
/// Rebuilds a model from Model::to_json. Text from a file is hostile: everything is checked.
/// @error input, naming the member.
SPECTEX_API Result<std::shared_ptr<const Model>> make_model_from_json(std::string_view json);

/// What to do with colours outside [0,1]^3, which no reflectance has.
enum class GamutPolicy {
    clip,        ///< each component to [0,1] (the default; counted)
    desaturate,  ///< towards the grey of the same luminance, itself clamped to [0,1]
    error,       ///< the first such colour is an error
};
struct GamutCounts {
    std::uint64_t out_of_gamut = 0, nonfinite = 0;
};
/// Puts n colours into [0,1]^3 in place. NaN becomes 0, +inf 1, -inf 0 (counted as nonfinite, not as out of gamut).
/// @param rgb  three planes of n floats.
/// @param luminance  the Y row of the space's RGB-to-XYZ matrix.
/// @return index of the first colour outside under GamutPolicy::error, else nothing.
SPECTEX_API std::optional<std::size_t> map_into_gamut(std::array<float*, 3> rgb, std::size_t n, GamutPolicy policy,
                                                      const Vector3& luminance, GamutCounts& counts);

}  // namespace spectex
