// File arguments: wildcards, names of outputs, and the refusals that come before any work.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"

namespace spectex::app {

/// Expands arguments that name no file but hold a wildcard (* ? [ ]), each in byte order.
/// @error usage for an empty name or a folder; input for a wildcard that matches nothing. A missing file is left to its
/// reader, which says more.
Result<std::vector<std::string>> expand_inputs(std::span<const std::string> arguments);

/// What shows that a file is still the one it was: device, inode, size, time of change in seconds and nanoseconds.
using FileStamp = std::array<std::int64_t, 5>;

/// An input with its outputs, one per variant.
struct Job {
    std::string input;
    std::vector<std::string> outputs;
    int mip = 0;  ///< the level of the input
};

/// Names the outputs of inputs.
/// @param output    a file; or an existing folder, in which each output is named by its input's stem and `suffix`.
/// @param suffix    with its dot: ".exr".
/// @param variants  illuminants' names; empty for one plain output. `{illuminant}` in `output` is replaced by each; in a
///                  folder without it, `_NAME` follows the stem.
/// @param levels    each a job of its own: `{mip}` in `output` is replaced; in a folder without it, `_mipN` follows the stem
/// where there are several.
/// @error usage: many inputs for one file, many variants for one name, a missing folder, two outputs of one name, an
/// output that is an input (also through links).
Result<std::vector<Job>> plan_outputs(std::span<const std::string> inputs, std::string_view output,
                                      std::string_view suffix, std::span<const std::string> variants = {},
                                      std::span<const int> levels = {});

/// Whether two files can be read and are equal byte for byte.
bool same_bytes(const std::string& a, const std::string& b);

/// Tells files of equal bytes by a number for each content.
class EqualFiles {
public:
    /// Reads of a file only what tells it from those of its size. Nothing for a file that cannot be read, and for one whose
    /// equal has changed since it was numbered.
    std::optional<std::size_t> number(const std::string& path);

private:
    struct Content {
        std::string path, head;
        FileStamp stamp;
    };
    std::vector<Content> contents_;
};

/// One path that an option makes the tool write.
struct NamedOutput {
    std::string option, path;
};
/// Refuses outputs that are inputs or each other, and outputs in missing folders. Empty paths and `-` are skipped.
/// @error usage, naming both.
Status check_outputs(std::span<const std::string> inputs, std::span<const NamedOutput> outputs);

/// The name with every character that is special to a shell or a file system replaced by `_`: D:5003 -> D_5003.
std::string file_name_part(std::string_view name);
/// Replaces each `{illuminant}`.
std::string expand_illuminant(std::string_view path, std::string_view illuminant);
/// File name without folder and last suffix.
std::string stem(std::string_view path);

}  // namespace spectex::app
