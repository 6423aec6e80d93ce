// One way to compare the names that people type.
#pragma once

#include <string>
#include <string_view>

namespace spectex {

/// Lower case, letters and digits only: "Rec. 2020", "rec2020" and "REC-2020" are one name.
inline std::string folded_name(std::string_view name) {
    std::string out;
    for (const char c : name) {
        if (c >= 'A' && c <= 'Z')
            out += static_cast<char>(c - 'A' + 'a');
        else if ((c >= 'a' && c <= 'z') || (c >= '0' && c <= '9'))
            out += c;
    }
    return out;
}

}  // namespace spectex
