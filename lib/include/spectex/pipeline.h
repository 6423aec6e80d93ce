// The whole path: files in, plans, files out. The only room that joins the others.
//
// Images stream through in strips of rows: reading, computing and writing overlap, memory is bounded by a few strips
// whatever the size, and the bytes written are the same for any number of threads. Outputs appear under their names only
// when complete; inputs are never modified. Non-finite samples become 0 (NaN, -inf) or 1 (+inf) and are counted.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "spectex/base.h"
#include "spectex/color.h"
#include "spectex/compare.h"
#include "spectex/heatmap.h"
#include "spectex/io.h"
#include "spectex/methods.h"
#include "spectex/plan.h"
#include "spectex/spectral.h"

namespace spectex {

/// Called from one thread at a time with pixels done and pixels in all.
using ProgressFunction = std::function<void(std::uint64_t done, std::uint64_t total)>;

/// What every job takes.
struct JobOptions {
    int threads = 0;      ///< 0: all processors
    /// Strips are computed by the threads of the TBB arena that the caller is in, which several jobs may share; `threads` is
    /// then what the file libraries take.
    bool in_callers_arena = false;
    bool strict = false;  ///< a non-finite sample is an error instead of a replacement
    ProgressFunction progress;
    std::string input_colorspace;  ///< empty: as the file says (choose_input_space)
    ImageSelection select;         ///< of an ordinary image; spectral and coefficient files are read as they are
};

/// Size and colour space of an input, and what was met in its pixels.
struct InputReport {
    std::string path;
    int width = 0, height = 0;
    std::string colorspace, colorspace_reason;
    std::uint64_t nonfinite = 0, out_of_gamut = 0;
    std::array<std::int64_t, 2> first_nonfinite{-1, -1};
    std::uint64_t unreached = 0;  ///< uplifted pixels for which the method found no spectrum and took the nearest one
    std::array<std::int64_t, 2> first_unreached{-1, -1};
};

/// How colours are uplifted and kept; what spxuplift and spxdiff --roundtrip share.
struct UpliftSettings {
    std::string method{default_method};
    Store store = Store::coefficients;
    BandSet bands;  ///< of the stored spectra, or on which a coefficient texture's model is solved
    ColorimetrySpec colorimetry;
    GamutPolicy gamut = GamutPolicy::clip;
    std::optional<PixelType> type;  ///< half or float32; by default default_stored_type of the input's
    /// Largest CIE76 that storage may cost any pixel, in its round trip and under each of `lights`; mantissas are rounded to
    /// the fewest bits that keep it. Nothing: stored at the type's full precision.
    std::optional<double> max_error;
    std::vector<Illuminant> lights;  ///< those that the file will be lit by, for max_error and choose_bands
    /// For stored spectra, in place of `bands`: the fewest that show this texture under `lights` as 380:780:5 would, within
    /// max_error (0.5 where that is not given); then verified on every pixel.
    bool choose_bands = false;
    std::size_t least_bands = 0;     ///< where choose_bands begins
    /// By solve_model of these very settings, to share one among many files; empty: solved for each.
    std::shared_ptr<const Model> model;
    /// Colours of texels whose alpha is 0 are stored as black instead of being uplifted. Off by default: filters that look
    /// across the edge of what is opaque may want the colour behind it.
    bool skip_transparent = false;
};

/// What UpliftSettings::max_error came to.
struct BoundedReport {
    double bound = 0;
    double mean_bits = 0;                       ///< mantissa bits kept, over all pixels
    std::array<std::uint64_t, 24> kept_bits{};  ///< pixels by mantissa bits kept
    struct Check {
        std::string name;  ///< "round trip", or a light
        double max = 0;    ///< CIE76
    };
    std::vector<Check> checks;
};
/// half for 8-bit and half inputs, else float32.
SPECTEX_API PixelType default_stored_type(PixelType input);
/// The model by which these settings uplift.
/// @error usage or infeasible, as make_model.
SPECTEX_API Result<std::shared_ptr<const Model>> solve_model(const UpliftSettings& settings);

enum class Layout {
    single,     ///< one part: R,G,B preview and bands
    multipart,  ///< part "rgb", part "spectrum" (or "coefficients"), which Mitsuba reads
};

/// What is known of a program that reads our files.
struct ReaderInfo {
    std::string name;
    bool coefficients = false;  ///< can use a coefficient EXR
    bool spectral = false;      ///< can use a spectral EXR
    Layout layout = Layout::single;
    bool any_layout = false;    ///< `layout` does not matter to it
    std::string why;
};
SPECTEX_API const std::vector<ReaderInfo>& readers();
struct StoreChoice {
    Store store = Store::coefficients;
    Layout layout = Layout::single;
    std::string reason;
};
/// Coefficients where every named reader can use them, else spectra in the layout that they need.
/// @error usage, for an unknown reader and for readers that no one layout serves.
SPECTEX_API Result<StoreChoice> choose_store(std::span<const std::string> names);

struct UpliftOptions {
    JobOptions job;
    UpliftSettings settings;
    Layout layout = Layout::single;
    std::string compression;  ///< empty: zip
    bool check_all = false;   ///< measure the round trip of every pixel; otherwise of one row in sixteen
    bool constant_to_pixel = false;  ///< a texture of one colour (and one alpha, one of all else) becomes 1 x 1
};

struct UpliftReport {
    InputReport input;
    std::string output;
    std::string model;  ///< one line: method and colorimetry
    std::vector<std::string> channels;
    PixelType type = PixelType::half;
    DifferenceStatistics roundtrip;  ///< CIE76 against the linearised input
    bool checked_all = false;
    std::uint64_t file_bytes = 0, raw_bytes = 0;  ///< of the output, and of its samples uncompressed
    std::optional<BoundedReport> bounded;         ///< under max_error or choose_bands
    std::vector<double> bands_nm;                 ///< of stored spectra
    std::uint64_t transparent = 0;                ///< pixels under skip_transparent
    bool constant = false;                        ///< written as 1 x 1
    std::uint64_t grey = 0;                       ///< pixels whose stored samples were looked up as those of a grey
};

/// A plan made and not run: what `--explain` prints.
SPECTEX_API Result<Explanation> explain_uplift(const std::string& input, const UpliftOptions& options);
/// Texture to spectral or coefficient EXR.
SPECTEX_API Result<UpliftReport> uplift(const std::string& input, const std::string& output, const UpliftOptions& options);

struct RelightOptions {
    JobOptions job;
    std::string method{default_method};  ///< for RGB textures
    ColorimetrySpec colorimetry;         ///< in which an RGB texture is understood, and the observer under the new light
    BandSet bands;                       ///< on which the method is solved for an RGB texture
    GamutPolicy gamut = GamutPolicy::clip;
    std::vector<Illuminant> illuminants;
    std::optional<std::string> observer;  ///< under the new light; by default the input's own
    Adaptation adaptation = Adaptation::none;
    Normalization normalization = Normalization::luminance;
    double max_error = 0;                 ///< CIE76 that a method which is not linear in pieces may be off by: see RelightRequest
    std::string output_colorspace;        ///< empty: see RelightReport
    std::optional<PixelType> type;
    std::string compression;
};

struct RelightReport {
    InputReport input;
    FileKind kind = FileKind::image;
    struct Output {
        std::string path, illuminant;
        PixelType type = PixelType::half;
        std::string colorspace;
        std::uint64_t clipped = 0;  ///< samples outside what an integer format holds
    };
    std::vector<Output> outputs;
};

SPECTEX_API Result<Explanation> explain_relight(const std::string& input, const std::vector<std::string>& outputs,
                                                const RelightOptions& options);
/// RGB texture, coefficient EXR or anybody's spectral EXR to one image per illuminant, in one pass.
/// The output's space, unless said: the input's own where both are encoded integers or both are linear floats, sRGB for
/// integer outputs, linear Rec.709 for float ones. Its type: the input's where the format can hold it.
/// @param outputs  as many as illuminants (one for emissive inputs).
SPECTEX_API Result<RelightReport> relight(const std::string& input, const std::vector<std::string>& outputs,
                                          const RelightOptions& options);

/// How far the table of a method that is not linear in pieces may be from the method.
inline constexpr double default_bake_error = 1;

struct BakeReport {
    std::string model;  ///< one line: method and colorimetry
    struct Output {
        std::string path, illuminant, form;  ///< form: "matrix" or "tetrahedral table"
        int grid = 0;                        ///< vertices per axis of a table
        bool exact = true;                   ///< the method itself, to float rounding
        double mean = 0, max = 0;            ///< CIE76 of the tables of others against the method, relative to the relit white
    };
    std::vector<Output> outputs;
};
/// The plan of a relight as a file: .spimtx (methods linear in RGB alone), .cube or .clf, one per illuminant; or one .ocio, a
/// configuration to which every illuminant is added, with its CLF beside. They take and give linear RGB of the options'
/// RGB space; tables hold for [0,1] and clamp beyond. Methods that are not linear in pieces get the smallest grid of at
/// most 65 vertices an axis that keeps within `max_error`.
/// @param outputs  as many as illuminants, or one .ocio.
/// @error usage for other suffixes and for a form that cannot hold the method; input when no grid is fine enough.
SPECTEX_API Result<BakeReport> bake(const std::vector<std::string>& outputs, const RelightOptions& options,
                                    double max_error = default_bake_error);

/// One texture under many lights, side by side.
struct ContactSheetReport {
    InputReport input;
    std::string output, note;  ///< the note says what the differences are
    int width = 0, height = 0;
    struct Tile {
        std::string illuminant, title;
        std::optional<double> kelvin;  ///< correlated_color_temperature
        double duv = 0;
        double mean = 0, max = 0;      ///< CIEDE2000 over all pixels of the texture
        std::array<std::int64_t, 2> max_at{-1, -1};
        std::uint64_t clipped = 0;     ///< samples of the tile that sRGB does not hold
    };
    std::vector<Tile> tiles;
};
/// A labelled picture of one tile per light: name, correlated colour temperature, and mean and largest CIEDE2000 between
/// the texture relit under the light and relit under D65 (both by the same method, observer, adaptation and
/// normalisation), both relative to the white of D65. Tiles are box-filtered in linear light and shown in sRGB; those of
/// textures far from square are stretched to 16 pixels at least.
/// @param output  a picture format of 8 bits. @error usage for 0 or more than 1000 lights, and for emission.
SPECTEX_API Result<ContactSheetReport> contact_sheet(const std::string& input, const std::string& output,
                                                     const RelightOptions& options);

struct DifferenceOptions {
    JobOptions job;
    Metric metric = Metric::ciede2000;
    std::string map;  ///< EXR of the differences, one float channel Y; empty: none
    RgbMatrix matrix = RgbMatrix::integrated;
    std::string observer = "cie1931";
};

struct DifferenceReport {
    InputReport a, b;  ///< b is empty for a round trip
    DifferenceStatistics statistics;
    std::string white;  ///< which reference white and matrix were used
    std::optional<DifferenceStatistics> standard_matrix;  ///< round trip: the same under the standard's matrix
    std::string path;   ///< round trip: one line of what was done
};

/// Differences of two files, A the reference, each in its own colour space (spectra and coefficients as reprojected under
/// D65), relative to integrated D65. @error input, when sizes differ.
SPECTEX_API Result<DifferenceReport> compare_files(const std::string& a, const std::string& b,
                                                   const DifferenceOptions& options);
/// The whole path of uplift, storage and reprojection in memory, against the linearised input; white of the illuminant.
SPECTEX_API Result<DifferenceReport> compare_roundtrip(const std::string& input, const UpliftSettings& settings,
                                                       const DifferenceOptions& options);

struct MetamerismOptions {
    JobOptions job;
    Metric metric = Metric::ciede2000;
    std::string map;  ///< EXR of the differences, one float channel Y; empty: none
    std::vector<std::string> methods;
    std::vector<Illuminant> illuminants;
    ColorimetrySpec colorimetry;
    BandSet bands;  ///< on which the methods are solved
    GamutPolicy gamut = GamutPolicy::clip;
};

struct MetamerismReport {
    InputReport input;
    DifferenceStatistics statistics;
    std::string white;
    struct Combination {
        std::string illuminant;
        std::array<std::string, 2> methods;
        std::uint64_t pixels = 0;  ///< for which this is the worst
        double max = 0;            ///< over these pixels
    };
    Combination worst;                       ///< where the largest difference of all was met
    std::vector<Combination> combinations;  ///< those that are the worst of some pixel, most pixels first
    Explanation explanation;
};
/// Per pixel of an RGB texture, the largest difference between any two methods' spectra of its colour under any of the
/// lights, against the white of each: where no uplift can be trusted. The first method of a pair is the reference.
/// @error usage for fewer than two methods or no light; input for files that hold spectra.
SPECTEX_API Result<MetamerismReport> compare_metamerism(const std::string& input, const MetamerismOptions& options);

struct HeatmapOptions {
    JobOptions job;
    Metric metric = Metric::cie76;        ///< when two images are given
    std::optional<std::array<double, 2>> range;  ///< empty: 0 to the 99.9th percentile, rounded up
    std::string colormap = "magma";
    bool legend = false;
};
struct HeatmapReport {
    InputReport input;
    double low = 0, high = 0;
    std::uint64_t above = 0, below = 0;  ///< pixels outside the range
    DifferenceStatistics statistics;
    int width = 0, height = 0;           ///< of the picture
};
/// False-colour picture of a one-channel map (as compare_files writes), or of the differences of two images when `b` is not
/// empty.
SPECTEX_API Result<HeatmapReport> heatmap(const std::string& map_or_a, const std::string& b, const std::string& output,
                                          const HeatmapOptions& options);

/// A texture's picture, the picture of what was made of it, and where they differ.
struct ThumbnailOptions {
    JobOptions job;
    UpliftSettings settings;  ///< by which the output was made
    Illuminant light;         ///< that the output is shown under
    int side = 64;            ///< pixels of the longer side, at most; smaller textures keep their size
};
struct Thumbnails {
    Picture source;  ///< as it looks
    Picture relit;   ///< the output under the light, not adapted to it
    Picture errors;  ///< thumbnail_error_color of the largest CIE76 of the round trip within each pixel
};
/// Colour of a difference on a logarithmic scale that all thumbnails share, so that they can be compared.
inline constexpr double thumbnail_error_low = 1e-3, thumbnail_error_high = 10;
SPECTEX_API Rgb8 thumbnail_error_color(const ColorMap& map, double difference);
/// Small pictures of a texture and of the file that uplift() made of it, by one pass over each.
/// @error usage for a side beyond 1 to 1024; input for a file that cannot be read.
SPECTEX_API Result<Thumbnails> thumbnails(const std::string& input, const std::string& output, const ThumbnailOptions& options);

/// A picture to a file of 8 bits, by its suffix. @error usage for a format of another type; output when it cannot be written.
SPECTEX_API Status write_picture(const std::string& output, const Picture& picture, int threads);

}  // namespace spectex
