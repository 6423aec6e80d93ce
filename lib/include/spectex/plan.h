// Plans: a request compiled to the cheapest exact kernel.
//
// Everything done with a spectrum is an integral against weights, so a plan asks how the spectrum depends on its colour and
// moves the integral out of the pixel loop where it can. explanation() says what was chosen, what was left out, and why.
// Plans are immutable; execute() may run on any number of threads, each on pixels of its own, and gives the same bytes
// however the pixels are split.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "spectex/base.h"
#include "spectex/color.h"
#include "spectex/methods.h"
#include "spectex/spectral.h"

namespace spectex {

namespace plan {
class ColorMemoryOwner;
}
namespace kernels {
class LatticeKernel;
class HalfSpectraRounder;
}

/// One line of what `--explain` prints.
struct PlanLine {
    std::string key, text;
};
using Explanation = std::vector<PlanLine>;

struct RelightRequest {
    std::string observer = "cie1931";
    std::vector<Illuminant> illuminants;
    Adaptation adaptation = Adaptation::none;  ///< from each illuminant's white to the output space's
    Normalization normalization = Normalization::luminance;
    std::string output_space = "BT.709";       ///< linear RGB of this RgbSpace comes out
    double max_error = 0;  ///< CIE76 that methods which are not linear in pieces may be off by, for the sake of fewer bands
};

/// From a method's coefficients, or from stored bands, to linear RGB under K illuminants in one pass.
class SPECTEX_API RelightPlan {
public:
    /// Inputs are the model's coefficients (for piecewise linear methods: linear RGB).
    static Result<RelightPlan> for_model(std::shared_ptr<const Model> model, const RelightRequest& request);
    /// Inputs are planes of reflectance in bands.
    static Result<RelightPlan> for_reflectance(const BandSet& bands, const RelightRequest& request);
    /// Inputs are planes of spectral radiance: reprojected by the observer alone, the request's illuminants are not used and
    /// one image comes out. Scaled so that an equal-energy radiance of 1 has Y = 1.
    static Result<RelightPlan> for_emission(const BandSet& bands, const RelightRequest& request);

    /// The model's own linear RGB, by its Colorimetry's sensing matrix: from coefficients, or from the stored bands.
    static RelightPlan as_stored(std::shared_ptr<const Model> model, bool from_bands);

    std::size_t inputs() const { return needed_.size(); }
    /// Inputs of which some weight is not zero; the others need not be read.
    const std::vector<bool>& needed() const { return needed_; }
    std::size_t images() const { return images_; }

    /// @param in   [inputs] planes of n; a plane that is not needed may be null.
    /// @param out  [3 * images] planes of n: R, G, B of the first illuminant, then of the next.
    void execute(std::span<const float* const> in, std::size_t n, std::span<float* const> out) const;

    /// The same from linear RGB of the model's space, each in [0,1], without stored coefficients in between: of a nonlinear
    /// method it is right to the rounding of the result. For plans of a model alone.
    /// @param rgb  three planes of n.
    void execute_colors(std::array<const float*, 3> rgb, std::size_t n, std::span<float* const> out) const;
    /// The same in double, nothing rounded or remembered: the reference of the kernels, and for tables. Of any plan of a model.
    /// @param rgb  [n][3] linear, each in [0,1]. @param out  [n][3 * images].
    void relit(std::span<const double> rgb, std::span<double> out) const;

    /// The 3x3 matrix of one image, when the plan is one.
    const Matrix3* matrix(std::size_t image) const;
    /// The tetrahedral table of all images, [vertices][3 images], when the plan is one. Null otherwise.
    const LatticeTable* table() const { return table_.get(); }
    /// Whether a spectrum is formed per colour, so that a colour met again is worth remembering.
    bool forms_spectra() const { return kernel_ == Kernel::spectra; }
    const Explanation& explanation() const { return explanation_; }

private:
    enum class Kernel { matrix, lattice, bands, spectra };
    static RelightPlan of_model(std::shared_ptr<const Model> model, std::vector<double> rows, double max_error = 0, const Matrix3& to_xyz = {});
    static RelightPlan of_bands(std::size_t bands, std::vector<double> rows);
    template <class Reflectance>
    void integrate_spectra(const plan::ColorMemoryOwner& memory, std::span<const float* const> in, std::size_t n,
                           std::span<float* const> out, const Reflectance& reflectance) const;

    Kernel kernel_ = Kernel::bands;
    std::size_t images_ = 0;
    std::vector<bool> needed_;
    std::vector<Matrix3> matrices_;                          // matrix
    std::vector<double> weights_;                            // bands, spectra: [3 images][bands]
    std::vector<std::size_t> formed_;                        // spectra: the bands that are formed
    std::vector<double> formed_weights_;                     // spectra: [formed][3 images]
    std::shared_ptr<const Model> model_;                     // spectra
    std::shared_ptr<const plan::ColorMemoryOwner> of_coefficients_, of_colors_;  // spectra
    std::shared_ptr<const LatticeTable> table_;              // lattice: [vertices][3 images]
    std::shared_ptr<const kernels::LatticeKernel> lattice_;  // over table_
    Explanation explanation_;
};

/// What is stored of an uplifted texture.
enum class Store {
    coefficients,  ///< three channels and the model in the header
    spectral,      ///< one channel per band
};

/// From linear RGB to stored samples, and from those back by the file's own weights.
class SPECTEX_API StorePlan {
public:
    /// @param type  half or float32.
    static Result<StorePlan> make(std::shared_ptr<const Model> model, Store store, PixelType type);

    std::size_t channels() const { return names_.size(); }
    const std::vector<std::string>& channel_names() const { return names_; }
    PixelType type() const { return type_; }

    /// @param rgb     three planes of n, linear, in the model's space and in [0,1].
    /// @param planes  [channels] planes of n samples of type().
    void store(std::array<const float*, 3> rgb, std::size_t n, std::span<std::byte* const> planes) const;
    /// Linear RGB as a reader gets it: stored samples, the file's weights, the reference illuminant.
    void reproject(std::span<const std::byte* const> planes, std::size_t n, std::array<float*, 3> rgb) const;
    const Explanation& explanation() const { return explanation_; }

private:
    explicit StorePlan(RelightPlan reader) : reader_(std::move(reader)) {}
    void store_bands(std::array<const float*, 3> rgb, std::size_t n, std::span<std::byte* const> planes) const;
    std::shared_ptr<const Model> model_;
    Store store_ = Store::coefficients;
    PixelType type_ = PixelType::half;
    std::vector<std::string> names_;
    std::shared_ptr<const plan::ColorMemoryOwner> memory_;        // nonlinear methods
    std::shared_ptr<const kernels::HalfSpectraRounder> rounder_;  // half bands
    RelightPlan reader_;
    Explanation explanation_;
};

}  // namespace spectex
