// What the files of this room share.
#pragma once

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <exception>
#include <new>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include <fmt/format.h>

#include "spectex/io.h"

namespace spectex::io {

inline Error input_error(std::string_view path, std::string_view what) {
    return {ErrorKind::input, fmt::format("{}: {}", path, what)};
}
inline Error output_error(std::string_view path, std::string_view what) {
    return {ErrorKind::output, fmt::format("{}: {}", path, what)};
}
std::string errno_text(int code);

/// Four bytes, the most significant first.
inline std::uint32_t be32(const std::uint8_t* p) {
    return std::uint32_t{p[0]} << 24 | std::uint32_t{p[1]} << 16 | std::uint32_t{p[2]} << 8 | p[3];
}

/// Runs `body` and turns whatever it throws into an Error of that kind that names the file.
template <class Body>
auto guarded(ErrorKind kind, const std::string& path, Body&& body) -> decltype(body()) {
    try {
        return body();
    } catch (const std::bad_alloc&) {
        return Error{kind, fmt::format("{}: not enough memory", path)};
    } catch (const std::length_error&) {
        return Error{kind, fmt::format("{}: declares more than any memory holds", path)};
    } catch (const std::exception& e) {
        std::string_view what = e.what();
        // The message may bear the path already.
        return Error{kind, what.find(path) != std::string_view::npos ? std::string(what)
                                                                      : fmt::format("{}: {}", path, what)};
    } catch (...) {
        return Error{kind, fmt::format("{}: unknown failure", path)};
    }
}

/// Makes the pools of OpenEXR and OpenImageIO at least that wide; 0 asks for one thread per core. Pools never shrink,
/// since another file may be using them. Returns the count for this file.
int prepare_threads(int threads);

std::string lower(std::string_view text);
/// Suffix with its dot, in lower case: ".exr"; empty without one.
std::string suffix_of(std::string_view path);

/// Whether the file begins as an OpenEXR file does. @error input: missing or unreadable.
Result<bool> is_exr(const std::string& path);

/// Whether a file can be opened as a regular, non-empty one; says why not.
Status check_readable(const std::string& path);

/// A file as it was when this was made: half of one content and half of another must not pass for a picture.
class FileMark {
public:
    explicit FileMark(std::string path);
    /// @error input, when the name now stands for another file, for other content, or for none.
    Status check() const;

private:
    std::string path_;
    std::array<std::int64_t, 5> state_{};
};

/// Sizes against limits. @param sample_bytes  of one pixel over all channels.
Status check_limits(const std::string& path, const Limits& limits, std::int64_t width, std::int64_t height,
                    std::int64_t channels, std::int64_t pixel_bytes);

/// Finds colour and alpha among the names, or takes those that are selected, and fills header.color, alpha, others and
/// left_out. @error input, when the file has not the channels that are asked for.
Status assign_channels(ImageHeader& header, const ImageSelection& selection = {});
/// Drops the channels that are neither colour nor in `others` from header.channels. @return the old indices of those that stay.
std::vector<int> drop_left_out(ImageHeader& header);
/// @error input, when the file has fewer levels.
Status check_level(const std::string& path, const ImageSelection& selection, int levels);

/// Attributes of hostile size or number are left out.
inline constexpr std::size_t max_attribute_bytes = std::size_t{1} << 16;
/// The models of some methods are tables.
inline constexpr std::size_t max_model_bytes = std::size_t{1} << 26;
inline constexpr std::size_t max_attributes = 1024;
inline constexpr std::size_t max_attribute_name = 255;

/// What only the file itself can tell, since OpenImageIO fills in the rest.
struct FileFacts {
    bool png = false, png_interlaced = false;
    bool png_transparent = false;  ///< a colour of its own stands for transparency (tRNS)
    std::uint8_t png_bits = 0, png_color_type = 0xff;
    bool srgb = false;
    std::optional<double> gamma;
    std::optional<std::array<double, 8>> chromaticities;
    bool streams = true;  ///< OpenImageIO decodes it by rows rather than as a whole
};
/// @error input: unreadable; a PNG whose header is none, or with a chunk that is longer than the file: the library of PNG would
/// take memory for it first.
Result<FileFacts> read_file_facts(const std::string& path);
/// The same for OpenEXR, whose library takes memory for an attribute of any declared size.
/// @error input.
Status check_exr_header(const std::string& path);

Result<std::unique_ptr<ImageReader>> open_exr_image(const std::string& path, int threads, const Limits& limits,
                                                    const ImageSelection& selection);

}  // namespace spectex::io
