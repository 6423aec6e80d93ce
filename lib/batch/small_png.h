// Pictures of a few thousand pixels as text within a page.
#pragma once

#include <string>
#include <vector>

#include "spectex/heatmap.h"

namespace spectex::batch {

/// A PNG of at most `colors` colours (2 to 256): the picture's own where it has no more, else by median cut (Heckbert 1982)
/// and nearest in RGB, which a thumbnail of a photograph survives at a third of the bytes.
/// @throws std::runtime_error when the encoder fails.
std::vector<std::uint8_t> small_png(const Picture& picture, int colors);

/// RFC 4648, section 4, with padding.
std::string base64(const std::vector<std::uint8_t>& bytes);

}  // namespace spectex::batch
