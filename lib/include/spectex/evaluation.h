// Methods held against measured reflectances, against neighbouring colours, and against the clock.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "spectex/base.h"
#include "spectex/compare.h"
#include "spectex/methods.h"
#include "spectex/plan.h"
#include "spectex/spectral.h"

namespace spectex {

/// How a method predicts the samples of one set that it has not seen.
struct AccuracyRow {
    std::string method, set;
    std::size_t samples = 0;  ///< those whose colour lies inside the RGB cube
    double mean = 0, p95 = 0; ///< CIEDE2000 over all samples and lamps; p95 by nearest rank
    double rms = 0;           ///< spectral: root mean square over the bands, mean over the samples
    std::vector<double> mean_under;  ///< CIEDE2000, one for each of `probes`
};
struct AccuracyOptions {
    std::vector<std::string> methods;
    std::vector<SampleSet> sets;       ///< each is left out in turn; the others train the methods that learn
    std::vector<SampleSet> unseen;     ///< predicted by what all of `sets` trained; never trains
    std::vector<Illuminant> lamps;     ///< those without power where the observer sees are left out
    std::vector<Illuminant> probes;    ///< reported by themselves, and counted among the lamps
};
struct AccuracyReport {
    std::size_t lamps = 0;  ///< over which mean and p95 are taken, probes included
    std::vector<AccuracyRow> rows;  ///< methods x (sets, then unseen)
};
/// Leaves each set out in turn, trains on the others, and from each left-out sample's colour under the colorimetry's own
/// illuminant alone predicts its colour under every lamp: CIEDE2000 against the sample's own, relative to the lamp's white,
/// no adaptation. Samples are held at their ends and clamped to [0,1].
/// @error usage without methods, sets or lamps, or with a set twice; input for a set without a sample inside the cube; that
///        of a method which cannot be made.
SPECTEX_API Result<AccuracyReport> measure_accuracy(const Colorimetry& colorimetry, const AccuracyOptions& options);

/// Change of the spectrum between neighbouring 8-bit sRGB codes: largest |r(a) - r(b)| of any band.
struct SmoothnessReport {
    std::string method;
    std::uint64_t steps = 0;
    double mean = 0, p99 = 0, max = 0;
    Vector3 max_at{};  ///< code before the largest step, 0..255, not rounded
    /// What is left of the largest steps after ten halvings, each towards the half that changes more: a continuous map
    /// leaves about max / 1024, a jump stays.
    double jump = 0;
};
/// Walks along lines through the cube of codes by one code of the fastest component: `lines` random ones from face to face,
/// the edges, the diagonals of faces and cube, and for each axis lines across the borders of lattice cells and of Kuhn's
/// tetrahedra (r = g, g = b, b = r). Deterministic.
SPECTEX_API SmoothnessReport measure_smoothness(const Model& model, std::size_t lines, std::uint64_t seed);

/// Round trip of sRGB codes through storage, the very path of the tools, and what it took.
struct RoundTripReport {
    DifferenceStatistics difference;  ///< CIE76, white of the colorimetry; max_at is red, and green * 256 + blue
    std::size_t channels = 0;
    double store_seconds = 0, relight_seconds = 0;  ///< wall time of all threads together
    std::uint64_t pixels = 0;
    std::uint64_t outside = 0;  ///< of Store::spectral as float32: samples that are not in [0,1]
};
/// @param stride  every stride-th of the 2^24 codes; 1 takes all. @error that of the plan.
SPECTEX_API Result<RoundTripReport> measure_roundtrip(std::shared_ptr<const Model> model, Store store, PixelType type,
                                                      std::uint32_t stride, int threads);

/// What figure 1 of Mallett and Yuksel 2019 shows of a method, over a texture that holds every colour once.
struct GamutPanel {
    std::string method, title, source;
    DifferenceStatistics noise;       ///< CIE76 of the Monte Carlo rendering against the same spectra without noise
    DifferenceStatistics distortion;  ///< CIE76 of the spectra, without noise, against the texture
    std::vector<float> rendering;     ///< [panel][panel][3] linear RGB in [0,1], means over the texels of a pixel
    std::vector<float> noise_map, distortion_map;  ///< [panel][panel], likewise
};
struct GamutRendering {
    int panel = 0;             ///< width and height of the panels
    std::uint64_t texels = 0;
    std::vector<float> truth;  ///< [panel][panel][3] linear RGB: the texture itself
    std::vector<GamutPanel> methods;
};
struct GamutRenderingOptions {
    std::vector<std::string> methods;
    int bits = 8;  ///< of a texture's component: 2, 4, 6 or 8; the texture is 2^(3 bits / 2) wide and high
    int samples_per_pixel = 64;
    std::uint64_t seed = 1;
    int panel = 1024;
    int threads = 0;
    std::function<void(std::uint64_t done, std::uint64_t total)> progress;  ///< texels, from one thread at a time
};
/// Renders a plane whose Lambertian albedo is that texture, seen from above under the colorimetry's illuminant from all sides:
/// radiance is albedo times illuminant, so that wavelengths are all that is left to sample. Each sample takes a hero
/// wavelength, uniform over the whole nanometres of the bands' range, and three more at equal distances from it (Wilkie et al.
/// 2014, doi:10.1111/cgf.12419), so that the mean tends to the colorimetry's own quadrature.
/// The texture holds every code once, in sixteen tiles of red across and green down whose edges meet in equal colours, blue
/// rising from tile to tile. The same bytes for any number of threads.
/// @error usage for a value out of range or no method; that of a method which cannot be made.
SPECTEX_API Result<GamutRendering> render_gamut(const Colorimetry& colorimetry, const GamutRenderingOptions& options);

}  // namespace spectex
