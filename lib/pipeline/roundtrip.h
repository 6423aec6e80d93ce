// A texture on its way into storage and back: what uplift, and the measure of its round trip, share.
#pragma once

#include <atomic>
#include <limits>
#include <memory>
#include <mutex>
#include <span>

#include "pipeline/greys.h"
#include "pipeline/source.h"
#include "plan/bounded_store.h"
#include "spectex/pipeline.h"

namespace spectex::pipeline {

/// Buffers of one thread.
struct Scratch {
    std::vector<std::vector<float>> decode;
    std::array<std::vector<float>, 3> input;  ///< linearised input, as it was
    std::array<std::vector<float>, 3> rgb;    ///< the same, finite and inside the gamut
    std::array<std::vector<float>, 3> back;   ///< what a reader of the stored samples gets
    DistinctGreys greys;                      ///< of rgb, where convert() found no colour
    std::vector<std::byte> of_greys;
};

/// Of one group of pixels.
struct Counts {
    std::uint64_t nonfinite = 0, out_of_gamut = 0;
    std::size_t first_nonfinite = std::numeric_limits<std::size_t>::max();  ///< index within the strip
    std::uint64_t transparent = 0, unreached = 0, grey = 0;
    std::size_t first_unreached = std::numeric_limits<std::size_t>::max();  ///< index within the strip
    BoundedStore::Outcome bounded;
};

/// Where a group of pixels lies, so that a message can name one of them.
struct GroupPlace {
    const std::string& path;
    int strip_y;
    std::size_t begin;  ///< of the group within the strip, in pixels
    int width;
};
/// Makes n colours finite and puts them into the gamut, in place; counts.
/// @error input, naming file, pixel and value, under GamutPolicy::error.
Status map_colors(std::array<float*, 3> rgb, std::size_t n, GamutPolicy policy, const Colorimetry& colorimetry,
                  const GroupPlace& place, Counts& counts);

/// Counts the colours for which the method has no spectrum and takes the nearest. @param begin  of the group, as in GroupPlace.
void count_unreached(const Model& model, std::array<const float*, 3> rgb, std::size_t n, std::size_t begin, Counts& counts);

/// Sums over groups that finish in any order.
class CountTotals {
public:
    void add(const Counts& counts, int strip_y, int width);
    void put_into(InputReport& report) const;
    const BoundedStore::Outcome& bounded() const { return bounded_; }
    std::uint64_t transparent() const { return transparent_; }
    std::uint64_t grey() const { return grey_; }

private:
    std::mutex mutex_;
    std::uint64_t nonfinite_ = 0, out_of_gamut_ = 0, first_ = std::numeric_limits<std::uint64_t>::max();
    std::uint64_t transparent_ = 0, grey_ = 0, unreached_ = 0, first_unreached_ = std::numeric_limits<std::uint64_t>::max();
    BoundedStore::Outcome bounded_;
};

/// An opened texture with the model and the plan by which it is stored.
struct UpliftSetup {
    static Result<UpliftSetup> make(const std::string& input, const UpliftSettings& settings, const JobOptions& job);

    std::unique_ptr<StripSource> source;
    std::shared_ptr<const Model> model;
    StorePlan plan;
    GamutPolicy gamut;
    std::shared_ptr<const BoundedStore> bounded;  ///< in place of plan.store, under max_error
    std::optional<std::size_t> alpha;             ///< the other channel by which texels are skipped
    Explanation chosen;                           ///< the bands that were chosen for this texture
    /// Whether some pixel missed the bound.
    std::shared_ptr<std::atomic<bool>> over_bound = std::make_shared<std::atomic<bool>>(false);

    /// Pixels [begin, begin + n) of the strip at row y to stored samples; leaves the linearised input and the mapped colours in scratch.
    Status convert(const RawStrip& raw, int y, std::size_t begin, std::size_t n, Scratch& scratch, std::span<std::byte* const> planes,
                   Counts& counts) const;
    /// Stored samples to scratch.back.
    void reproject(std::span<const std::byte* const> planes, std::size_t n, Scratch& scratch) const;
    /// The colours that convert() left in scratch by another plan of the same model to scratch.back, no component below 0.
    void preview(const RelightPlan& to_preview, std::array<const float*, 3> rgb, std::size_t n, Scratch& scratch) const;
    Explanation explanation() const;

private:
    /// Whether a stored sample costs more than to look it up: linear RGB itself is only rounded.
    bool forms_samples() const;
    /// To stored samples, all of one run. @param times  how many pixels each colour stands for; empty: one.
    std::optional<BoundedStore::Failure> store(std::array<const float*, 3> rgb, std::size_t n, std::span<std::byte* const> planes,
                                               std::span<const std::uint32_t> times, Counts& counts) const;

    UpliftSetup(std::unique_ptr<StripSource> s, std::shared_ptr<const Model> m, StorePlan p, GamutPolicy g)
        : source(std::move(s)), model(std::move(m)), plan(std::move(p)), gamut(g) {}
};

/// Round trip of a run of pixels that convert() has just stored.
/// @param planes  where the group's samples begin; @param offset  of the run within the group.
void measure_row(const UpliftSetup& setup, const DifferenceKernel& kernel, Scratch& scratch, std::span<std::byte* const> planes,
                 std::size_t offset, std::size_t n, float* difference, std::uint64_t& changed);

/// @error input, under strict, when any pixel was not finite.
Status check_strict(const JobOptions& job, const InputReport& report);

/// Model coefficients of colours as planes, for plans that take them.
void coefficient_planes(const Model& model, std::array<const float*, 3> rgb, std::size_t n, std::vector<std::vector<float>>& out);

}  // namespace spectex::pipeline
