// Reading of the small CSV tables of luts/ that are not spectra.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"

namespace spectex {

/// A regular file of text, of at most `most` bytes. @error input, naming the path.
Result<std::string> read_text(const std::string& path, std::uintmax_t most = std::uintmax_t{64} << 20);

/// Rows of RFC 4180 fields, the header first; empty lines are left out.
/// @error input, naming `label` and the line.
Result<std::vector<std::vector<std::string>>> parse_csv(std::string_view text, std::string_view label);

}  // namespace spectex
