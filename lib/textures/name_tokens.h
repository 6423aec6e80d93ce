// The words of a texture's name.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace spectex::textures {

/// Lower-case words of a file's stem or a folder's name: cut at everything but letters and digits, where letters and digits
/// meet, and where camelCase begins a word (`NormalGL` is normal, gl; `AORough` is ao, rough). Numbers are words, with a single
/// letter that follows or precedes them at once (`2k`, `m1`).
std::vector<std::string> name_words(std::string_view name);

/// File name without folders, image suffixes and a UDIM tile (`.1001`, `_u1_v2`, `<UDIM>`).
std::string texture_stem(std::string_view path);

}  // namespace spectex::textures
