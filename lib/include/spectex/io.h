// Image files: rows in, rows out, in bounded memory.
//
// A stage of the pipeline never sees a file; it sees rows. Rows are read and written in ascending order, whole rows at a
// time, `preferred_rows` of them where the caller can choose. No exception of a file library passes this room. Outputs are
// written beside their destination under a temporary name, flushed to disk and renamed by commit(); an output that is not
// committed leaves nothing behind. Files are hostile: declared sizes are checked against Limits before memory is taken.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "spectex/base.h"
#include "spectex/spectral.h"

namespace spectex {

enum class PixelType { uint8, uint16, half, float32 };
SPECTEX_API std::size_t pixel_bytes(PixelType type);
SPECTEX_API std::string_view pixel_type_name(PixelType type);

/// Declared sizes beyond these are refused with a message, before allocation.
struct Limits {
    std::int64_t max_width = 1 << 20, max_height = 1 << 20;
    std::int64_t max_pixels = std::int64_t{1} << 36;
    int max_channels = 4096;
    std::int64_t max_row_bytes = std::int64_t{1} << 30;
};

/// Size, windows and placement of an image, in pixels.
struct Geometry {
    int width = 0, height = 0;
    int x = 0, y = 0;                                     ///< origin of the data window
    int full_x = 0, full_y = 0, full_width = 0, full_height = 0;  ///< display window
    double pixel_aspect = 1;
    int orientation = 1;                                  ///< Exif 1..8, passed on, never applied
    bool same_size(const Geometry& o) const { return width == o.width && height == o.height; }
};

/// A header value that is passed on from input to output.
using AttributeValue = std::variant<std::string, std::int32_t, float, double, std::vector<float>>;
using Attributes = std::map<std::string, AttributeValue>;

/// What a file says about its own colours; the colour room decides.
struct ColorHints {
    std::string declared;                                 ///< OIIO's oiio:ColorSpace, only where the file itself said so
    std::vector<std::uint8_t> icc_profile;
    std::optional<std::array<double, 8>> chromaticities;  ///< EXR: R, G, B, white x,y
    std::optional<double> gamma;
};

/// What of an image file is wanted; by default all channels at full size.
struct ImageSelection {
    int mip = 0;                        ///< level of the pyramid: 0 full size, each next one half as wide and as high
    /// Colour is this layer's R, G, B (or Y) and alpha its A; in OpenEXR also those of a part of this name.
    std::string layer;
    /// Colour by the names of its channels: R, G, B and perhaps alpha; or grey and perhaps alpha. In place of `layer`.
    std::vector<std::string> channels;
    bool color_only = false;            ///< neither alpha nor any other channel is read

    /// Channels beside the chosen ones are left out rather than passed on.
    bool names_channels() const { return !layer.empty() || !channels.empty(); }
};

/// Header of an ordinary image.
struct ImageHeader {
    std::string path, format;             ///< format as OIIO names it: png, jpeg, openexr, ...
    Geometry geometry;
    std::vector<std::string> channels;    ///< in the order of the rows' samples
    PixelType type = PixelType::uint8;    ///< of the rows: the widest of the channels' types
    std::array<int, 3> color{-1, -1, -1}; ///< indices of R, G, B; one index three times for grey; -1 without colour
    int alpha = -1;
    bool alpha_associated = false;        ///< colour is premultiplied in the file (EXR); straight in PNG, TGA
    std::vector<int> others;              ///< every channel that is not colour, alpha included, in file order
    std::vector<std::string> left_out;    ///< channels of the file that the selection does not want; not in `channels`, or not in `others`
    int subimages = 1;
    int mip = 0, mip_levels = 1;          ///< the level that is read, of so many
    std::int64_t mip_pixels = 0;          ///< over all levels
    ColorHints color_hints;
    Attributes metadata;                  ///< what is worth passing on (no time of day, no library's own marks)

    bool has_color() const { return color[0] >= 0; }
    bool is_grey() const { return color[0] >= 0 && color[0] == color[1]; }
};

/// Reads any format of OpenImageIO row by row; samples are the file's own, no colour management, no premultiplication.
/// Tiled files are read by whole rows of tiles.
class SPECTEX_API ImageReader {
public:
    virtual ~ImageReader();
    /// @error input: missing, unreadable, truncated header, deep or volume image, over Limits, or without the level, layer or
    /// channels that are selected; the message names the file.
    static Result<std::unique_ptr<ImageReader>> open(const std::string& path, int threads = 0, const Limits& limits = {},
                                                     const ImageSelection& selection = {});
    virtual const ImageHeader& header() const = 0;
    /// Rows that suit the file: a multiple of its tile height or compression block, at least 64 where height allows.
    virtual int preferred_rows() const = 0;
    /// @param y     first row, from 0 at the top of the data window.
    /// @param out   [rows][width][channels] samples of header().type.
    virtual Status read_rows(int y, int rows, std::byte* out) = 0;
};

/// Compression of EXR (none rle zips zip piz) or of what another format knows (TIFF: none, lzw, zip; PNG: a level);
/// empty for the format's default.
struct WriteOptions {
    PixelType type = PixelType::half;
    std::string compression;
    int threads = 0;
};

/// Writes an ordinary image row by row, to any format of OpenImageIO by the destination's suffix.
class SPECTEX_API ImageWriter {
public:
    virtual ~ImageWriter();
    /// @param channels  names in the order of the rows' samples; R, G, B first, an alpha named A.
    /// @error output: unknown suffix, a type or channel count that the format cannot hold, unwritable folder.
    static Result<std::unique_ptr<ImageWriter>> create(const std::string& path, const Geometry& geometry,
                                                       const std::vector<std::string>& channels, bool alpha_associated,
                                                       const Attributes& metadata, const WriteOptions& options);
    /// The type that the format really stores for what was asked (PNG: uint8 or uint16).
    virtual PixelType type() const = 0;
    virtual Status write_rows(int y, int rows, const std::byte* samples) = 0;
    /// Flushes, closes, renames onto the destination.
    virtual Status commit() = 0;
};
/// The nearest type that the suffix's format can store (png: uint8 or uint16; jpg: uint8; exr: half or float32), or nothing
/// when no writer has that suffix.
SPECTEX_API std::optional<PixelType> storable_type(std::string_view path, PixelType wanted);

/// One channel of an EXR as it is written: planar.
struct ExrChannel {
    std::string name;
    PixelType type = PixelType::half;  ///< half or float32
};
struct ExrPart {
    std::string name;  ///< needed when there are several
    std::vector<ExrChannel> channels;
    Attributes attributes;
};

/// Writes single- and multi-part scan line EXR from planes.
class SPECTEX_API ExrWriter {
public:
    virtual ~ExrWriter();
    /// @error output, naming the file; usage for an unknown or lossy compression.
    static Result<std::unique_ptr<ExrWriter>> create(const std::string& path, const Geometry& geometry,
                                                     const std::vector<ExrPart>& parts, const WriteOptions& options);
    /// @param planes  one pointer per channel over all parts in order, each [rows][width] samples of the channel's type.
    virtual Status write_rows(int y, int rows, std::span<const std::byte* const> planes) = 0;
    /// Replaces the text of a string attribute by another of the same length in every part that has it: for figures that
    /// are known only when all rows are written. @error output, when the lengths differ or there is no such attribute.
    virtual Status replace_text(const std::string& attribute, const std::string& text) = 0;
    virtual Status commit() = 0;
};

/// What a file holds for this library.
enum class FileKind {
    image,         ///< colour, encoded or linear
    coefficients,  ///< a coefficient EXR of ours
    spectral,      ///< any writer's spectral EXR (Fichet, Pacanowski and Wilkie 2021)
};

/// Channel name of a band, `T.400,000000nm` or `S0.400,000000nm`: six decimals, decimal comma, any locale.
SPECTEX_API std::string spectral_channel_name(std::string_view prefix, double wavelength_nm);
/// A parsed spectral channel name. Accepts comma or point, any digits, an exponent, the length units nm um mm m with SI
/// prefixes and frequencies in Hz with SI prefixes (converted by the speed of light), and a leading layer.
struct SpectralChannelName {
    std::string layer;   ///< text before the stem, without the dot
    std::string stem;    ///< T, S0, S1, S2, S3
    double wavelength_nm = 0;
};
SPECTEX_API std::optional<SpectralChannelName> parse_spectral_channel_name(std::string_view name);

/// Header of a spectral or coefficient EXR.
struct SpectralHeader {
    std::string path;
    FileKind kind = FileKind::spectral;
    Geometry geometry;
    PixelType type = PixelType::half;        ///< widest of the data channels
    std::vector<double> wavelengths_nm;      ///< of the bands, ascending; empty for coefficients
    bool emissive = false;                   ///< bands are S0 (radiance) rather than T (reflectance)
    bool has_both = false;                   ///< the file also holds the other kind, which is not read
    std::vector<std::string> coefficients;   ///< channel names in model order, for coefficients
    bool has_rgb = false;                    ///< an R,G,B preview
    std::vector<std::string> others;         ///< channels that are none of these (alpha, AOVs)
    std::vector<PixelType> other_types;
    int parts = 1;
    Attributes attributes;                   ///< of all parts that have data; includes spectex:*
};

/// Reads bands or coefficients as planes of float.
class SPECTEX_API SpectralReader {
public:
    virtual ~SpectralReader();
    /// @error input: not an EXR, no bands and no coefficients, repeated wavelengths, deep data, over Limits.
    static Result<std::unique_ptr<SpectralReader>> open(const std::string& path, int threads = 0, const Limits& limits = {});
    virtual const SpectralHeader& header() const = 0;
    virtual int preferred_rows() const = 0;
    /// Planes of the bands (or coefficients) with these indices; a null plane is skipped, and channels never asked for are
    /// not converted; those of 8-bit files are code / 255 on the curve of sRGB. @param planes  [bands], each [rows][width].
    /// @param others  [others] planes in their own type, or empty.
    virtual Status read_rows(int y, int rows, std::span<float* const> planes, std::span<std::byte* const> others) = 0;
};

/// Looks at a file's header. @error input, when no reader knows it.
SPECTEX_API Result<FileKind> probe(const std::string& path);

/// A destination written under a temporary name beside it; for text outputs (CSV, JSON, SVG, cube) and as the base of the
/// image writers. Destroyed without commit(), it leaves nothing. A symbolic link is written through; an existing file keeps
/// its permissions; folders and devices are refused.
class SPECTEX_API OutputFile {
public:
    ~OutputFile();
    OutputFile(OutputFile&&) noexcept;
    OutputFile& operator=(OutputFile&&) noexcept;
    /// @error usage when the folder is missing; output when it cannot be written.
    static Result<OutputFile> create(const std::string& destination);
    const std::string& temporary_path() const { return temporary_; }
    const std::string& destination() const { return destination_; }
    /// fsync, then rename.
    Status commit();

private:
    OutputFile() = default;
    std::string temporary_, destination_, target_;
    int slot_ = -1;  ///< in the registry of temporary files
};
/// The bytes of a file under another name, complete or not at all; where the file system can, both share their blocks until
/// one is changed.
SPECTEX_API Status copy_output(const std::string& from, const std::string& to);
SPECTEX_API Status write_text_file(const std::string& destination, std::string_view text);
/// Removes every uncommitted temporary file of this process; async-signal-safe, for a handler of SIGINT and SIGTERM.
SPECTEX_API void remove_temporary_files_from_signal() noexcept;
/// Whether two paths are one file (resolved links, device and inode).
SPECTEX_API bool same_file(const std::string& a, const std::string& b);

}  // namespace spectex
