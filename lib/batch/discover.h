// Which files a library has, and what their outputs are called.
#pragma once

#include <string>
#include <vector>

#include "spectex/base.h"

namespace spectex::batch {

struct Discovery {
    std::vector<std::string> images;  ///< relative paths, by bytes
    std::vector<Error> errors;        ///< folders that cannot be read
    std::vector<std::string> error_paths;
    std::size_t not_images = 0;
};

/// Walks a folder. Hidden names are left out; a folder that several links reach is visited once, by its real path where it
/// has one below the root, so that loops end.
/// @param barred  a folder that is not entered (DST).
Discovery discover(const std::string& root, const std::string& barred);

/// Relative output names of relative paths, in order: the suffix replaced by .exr; where two of one folder share a stem, or
/// such names would meet, the whole name with .exr after it.
std::vector<std::string> output_names(const std::vector<std::string>& paths);

/// fnmatch on the whole path or on the name alone.
bool matches(const std::string& pattern, const std::string& path);

/// Whether the suffix is one that an image reader claims.
bool has_image_suffix(const std::string& path);

/// A relative path that stays below its root: not empty, no `..`, not absolute.
bool stays_below(const std::string& path);

}  // namespace spectex::batch
