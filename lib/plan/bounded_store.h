// Storage with fewer bits, within a bound on the colour difference that each pixel is held to.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "spectex/compare.h"
#include "spectex/plan.h"

namespace spectex {

/// Rounds the mantissas of what is stored, each pixel to the fewest bits with which every check holds: the round trip, and
/// the relit colour under each named light, all as CIE76 relative to the light's own white. Of the ways to choose bits
/// (one number per file, a floor and more where needed, the fewest per pixel) the last gave the smallest files by ZIP and
/// by PIZ at every bound. Errors are given from band to band only at the type's full precision: coarser, what cancels under
/// the reference light adds up under others.
///
/// The reference of the round trip is the colour itself for an exact method and the method's own for another; of a light,
/// the method's spectrum before rounding, or of another model of the same method. Immutable and thread-safe; a pixel's
/// bytes depend on that pixel alone.
class BoundedStore {
public:
    /// With lights to hold to, spectra may be rounded to powers of two; without, each stored number keeps four bits (3% of
    /// its value), so that lights that were not named see no other spectrum.
    static constexpr int least_bits_without_lights = 4;

    /// @param plan       how the final samples are stored. @param bound  CIE76, above 0.
    /// @param reference  null, or a model of finer bands whose relit colours are the reference.
    /// @param full       keep the type's full precision: only hold each pixel to the bound.
    static Result<BoundedStore> make(StorePlan plan, std::shared_ptr<const Model> model, Store store, double bound,
                                     const std::vector<Illuminant>& lights, std::shared_ptr<const Model> reference, bool full = false);

    struct Outcome {
        std::array<std::uint64_t, 24> kept_bits{};  ///< pixels by mantissa bits kept
        std::vector<double> worst;                  ///< largest CIE76 of each check: the round trip, then each light
        void add(const Outcome& other);
    };
    /// A pixel that no rounding holds within the bound.
    struct Failure {
        std::size_t pixel = 0;
        std::size_t check = 0;  ///< 0 the round trip, then each light
        double error = 0;
    };
    /// As StorePlan::store. @param times  how many pixels each colour counts for; empty: one. @return the first pixel that cannot be kept, if any.
    std::optional<Failure> store(std::array<const float*, 3> rgb, std::size_t n, std::span<std::byte* const> planes,
                                 Outcome& outcome, std::span<const std::uint32_t> times = {}) const;

    double bound() const { return bound_; }
    std::string check_name(std::size_t check) const { return check == 0 ? "round trip" : lights_[check - 1].name; }
    Explanation explanation() const;

private:
    BoundedStore(StorePlan plan, StorePlan exact) : plan_(std::move(plan)), exact_(std::move(exact)) {}
    struct Workspace;

    StorePlan plan_, exact_;  ///< exact_: the same in float
    std::shared_ptr<const Model> model_, reference_;
    Store store_ = Store::coefficients;
    double bound_ = 0, inner_ = 0;
    bool full_ = false;
    std::vector<Illuminant> lights_;
    std::optional<RelightPlan> relit_, relit_reference_;
    std::vector<DifferenceKernel> kernels_;
};

}  // namespace spectex
