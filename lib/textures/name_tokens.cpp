#include "textures/name_tokens.h"

#include <algorithm>
#include <array>

namespace spectex::textures {
namespace {

// Not those of <cctype>: names mean the same in every locale.
bool is_upper(char c) { return c >= 'A' && c <= 'Z'; }
bool is_lower(char c) { return c >= 'a' && c <= 'z'; }
bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_letter(char c) { return is_upper(c) || is_lower(c) || (static_cast<unsigned char>(c) & 0x80) != 0; }
char lowered(char c) { return is_upper(c) ? static_cast<char>(c - 'A' + 'a') : c; }

}  // namespace

std::vector<std::string> name_words(std::string_view name) {
    std::vector<std::string> words;
    std::string word;
    const auto finish = [&] {
        if (!word.empty()) words.push_back(std::move(word));
        word.clear();
    };
    for (std::size_t i = 0; i < name.size(); ++i) {
        const char c = name[i];
        if (!is_letter(c) && !is_digit(c)) {
            finish();
            continue;
        }
        if (!word.empty()) {
            const char before = name[i - 1];
            // A single letter belongs to the number before it or after it: 2k, turn100R, m1.
            const bool lone = is_digit(c) ? word.size() == 1 && is_letter(before)
                                          : is_digit(before) && (i + 1 >= name.size() || !is_letter(name[i + 1]));
            const bool kind_changes = is_digit(c) != is_digit(before) && !lone;
            const bool word_begins = is_upper(c) && (is_lower(before) || (is_upper(before) && i + 1 < name.size() && is_lower(name[i + 1])));
            if (kind_changes || word_begins) finish();
        }
        word.push_back(lowered(c));
    }
    finish();
    return words;
}

std::string texture_stem(std::string_view path) {
    if (const auto slash = path.rfind('/'); slash != std::string_view::npos) path.remove_prefix(slash + 1);
    static constexpr std::array<std::string_view, 24> suffixes{"png", "jpg",  "jpeg", "jpe", "tga", "tif", "tiff", "bmp",
                                                               "exr", "hdr",  "rgbe", "pic", "dds", "rgb", "rgba", "sgi",
                                                               "bw",  "webp", "tx",   "psd", "ppm", "dpx", "jp2",  "gif"};
    for (bool again = true; again;) {
        again = false;
        const auto dot = path.rfind('.');
        if (dot == std::string_view::npos || dot == 0) break;
        std::string suffix(path.substr(dot + 1));
        std::transform(suffix.begin(), suffix.end(), suffix.begin(), lowered);
        const bool udim = (suffix.size() == 4 && suffix[0] == '1' && std::all_of(suffix.begin(), suffix.end(), is_digit)) ||
                          suffix == "<udim>" || suffix == "<uvtile>";
        if (udim || std::find(suffixes.begin(), suffixes.end(), suffix) != suffixes.end()) {
            path = path.substr(0, dot);
            again = true;
        }
    }
    return std::string(path);
}

}  // namespace spectex::textures
