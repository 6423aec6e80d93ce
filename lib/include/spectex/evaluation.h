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
#include "spectex/pipeline.h"
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

/// Which code of a kernel runs.
enum class KernelChoice {
    widest,    ///< the widest instruction set of this machine: what the tools do
    narrowest, ///< the narrowest that this binary holds
};
/// The name of the instruction set that a choice means here: "AVX3", "SSE2", "NEON", ...
SPECTEX_API std::string kernel_choice_name(KernelChoice choice);

/// Run time and error of keeping a corpus one way.
struct TradeoffRow {
    std::uint64_t pixels = 0;               ///< of all files
    std::size_t channels = 0;
    double store_seconds = 0, reproject_seconds = 0;  ///< computing only, of `computed` pixels
    std::uint64_t computed = 0;
    double file_seconds = 0;                ///< reading, computing, compressing and writing all files; median of the runs
    double bytes_per_texel = 0;             ///< of the files as written
    DifferenceStatistics roundtrip;         ///< CIEDE2000 of the files, read back, against the textures; p99 the worst file's
    double relight_mean = 0, relight_max = 0;  ///< CIEDE2000, see measure_tradeoff
    std::uint64_t peak_bytes = 0;           ///< resident memory while the files were made; 0 where the system does not tell
    double reference_error = 0;             ///< largest |kernel - reference| in linear RGB over the checked colours
};
struct TradeoffOptions {
    std::vector<std::string> corpus;  ///< textures
    UpliftSettings settings;
    std::string compression;          ///< empty: zip
    KernelChoice kernel = KernelChoice::widest;
    std::vector<Illuminant> lights;   ///< under which relight_mean is taken
    std::string scratch;              ///< folder for the files, which are removed again
    int runs = 3;
    int threads = 0;
};
/// Keeps every file of a corpus with one method and store, and measures time, size and error.
/// Before anything is timed, up to 4096 colours of each file are stored and reprojected by the kernels and compared with sums
/// in double over the stored samples themselves: more than 1e-5 apart is an error. The same colours give the relight error:
/// the stored spectrum under every light against the method's own on 380:780:5, by 1 nm integration of each, both relative
/// to the white of the latter.
/// @error usage without corpus, lights or folder; input and output, naming the file; that of the method.
SPECTEX_API Result<TradeoffRow> measure_tradeoff(const TradeoffOptions& options);

/// Writes a texture of width x height sRGB codes by the suffix of its name: neighbouring pixels have neighbouring colours,
/// and grain from a hash of their place, so that compression finds what it finds in a photograph. The same bytes anywhere.
/// @error output.
SPECTEX_API Status write_test_texture(const std::string& path, int width, int height);

/// Points that no other beats: none is as small in both and smaller in one. Ascending in x.
/// @param points  [n] of x, y.  @return indices.
SPECTEX_API std::vector<std::size_t> pareto_front(std::span<const std::array<double, 2>> points);

}  // namespace spectex
