// Inputs as strips of linear planes.
#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "spectex/pipeline.h"

namespace spectex::pipeline {

/// A strip as it was read, before any computation.
struct RawStrip {
    std::vector<std::byte> samples;           // images: interleaved
    std::vector<std::vector<float>> planes;   // spectral files: the planes that are needed
    std::vector<std::vector<std::byte>> others;
};

/// What passes through untouched: alpha and whatever else is not colour.
struct OtherChannel {
    std::string name;
    PixelType type = PixelType::half;
};

/// An image, a coefficient texture or a spectral file, as planes of float that a kernel takes.
class StripSource {
public:
    virtual ~StripSource() = default;

    virtual const Geometry& geometry() const = 0;
    virtual FileKind kind() const = 0;
    virtual PixelType type() const = 0;
    virtual const Attributes& metadata() const = 0;
    virtual bool alpha_associated() const = 0;
    virtual const std::vector<OtherChannel>& others() const = 0;
    virtual int preferred_rows() const = 0;
    virtual std::size_t raw_bytes_per_row() const = 0;
    /// Fills in path, size and colour space.
    virtual InputReport report() const = 0;
    virtual const Explanation& explanation() const = 0;
    /// Whether a pixel's colour is one number in the file.
    virtual bool grey() const { return false; }

    virtual Status read(int y, int rows, RawStrip& raw) = 0;
    /// Number of planes that decode() gives: 3 for images and coefficients (or the model's count), bands otherwise.
    virtual std::size_t planes() const = 0;
    /// Pixels [begin, begin + n) of a strip. Const and thread-safe. A plane that is not needed may come back null.
    /// @param scratch  planes() buffers of n floats that the result may point into.
    virtual void decode(const RawStrip& raw, std::size_t begin, std::size_t n, std::vector<std::vector<float>>& scratch,
                        std::vector<const float*>& planes) const = 0;
    /// Samples of an other channel in its own type.
    virtual void copy_other(const RawStrip& raw, std::size_t other, std::size_t begin, std::size_t n, std::byte* out) const = 0;
};

/// An RGB image as linear RGB of a space.
Result<std::unique_ptr<StripSource>> open_image_source(const std::string& path, const RgbSpace& space, const JobOptions& job);

/// A spectral or coefficient EXR: planes are its bands or coefficients.
struct SpectralSourceInfo {
    SpectralHeader header;
    std::shared_ptr<const Model> model;  ///< of a coefficient file
    ColorimetrySpec colorimetry;         ///< what the header says, or the defaults
};
Result<SpectralSourceInfo> spectral_source_info(const std::string& path, const JobOptions& job);
/// @param needed  planes to read; the others come back null.
Result<std::unique_ptr<StripSource>> open_spectral_source(const std::string& path, const std::vector<bool>& needed,
                                                          const JobOptions& job);

/// Three planes of linear RGB of a space from any file: images decoded, spectra and coefficients reprojected by a plan. Alpha
/// and other channels are not read.
class LinearSource {
public:
    /// Spectral files are lit by the illuminant of `space` (emission is reprojected).
    static Result<LinearSource> open(const std::string& path, const RgbSpace& space, const std::string& observer,
                                     const JobOptions& job);
    StripSource& strips() { return *source_; }
    const StripSource& strips() const { return *source_; }
    /// @param rgb  three planes of n that are written.
    void decode(const RawStrip& raw, std::size_t begin, std::size_t n, std::vector<std::vector<float>>& scratch,
                std::array<float*, 3> rgb) const;

private:
    std::unique_ptr<StripSource> source_;
    std::optional<RelightPlan> plan_;
};

/// Replaces non-finite samples (NaN and -inf by 0, +inf by 1); counts pixels.
/// @return index of the first such pixel, or n.
std::size_t replace_nonfinite(std::array<float*, 3> rgb, std::size_t n, std::uint64_t& count);

/// Samples of one type as another: integers as fractions of their largest code, to nearest, clipped.
void convert_samples(const std::byte* in, PixelType from, std::size_t n, std::byte* out, PixelType to,
                     std::size_t out_stride = 1);

}  // namespace spectex::pipeline
