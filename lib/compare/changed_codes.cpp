#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "spectex/compare.h"

namespace spectex {

namespace {

// 8-bit sRGB codes by search among the 255 linear values at which the code changes, each the least float that is not below
// decode((k - 1/2) / 255) (IEC 61966-2-1): encoding with exact rounding, at the cost of a table look-up.
class CodeTable {
public:
    CodeTable() {
        threshold_[0] = -std::numeric_limits<float>::infinity();
        for (int k = 1; k < 256; ++k) {
            const long double c = (k - 0.5L) / 255;
            const long double linear = c <= 0.04045L ? c / 12.92L : std::pow((c + 0.055L) / 1.055L, 2.4L);
            float t = static_cast<float>(linear);
            if (t < linear) t = std::nextafter(t, 2.0f);
            threshold_[static_cast<std::size_t>(k)] = t;
        }
        threshold_[256] = std::numeric_limits<float>::quiet_NaN();  // which nothing reaches, not even infinity
        first_bucket_ = bucket_of(threshold_[1]);
        std::size_t code = 0;
        for (std::size_t i = 0; i < buckets; ++i) {
            const float start = std::bit_cast<float>((first_bucket_ + static_cast<std::uint32_t>(i)) << shift);
            while (threshold_[code + 1] <= start) ++code;
            code_[i] = static_cast<std::uint8_t>(code);
        }
        lowest_ = std::bit_cast<float>(first_bucket_ << shift);
        highest_ = std::bit_cast<float>(((first_bucket_ + static_cast<std::uint32_t>(buckets)) << shift) - 1);
    }

    /// Without a branch: which way one would go is as random as the pixels. NaN gives any code.
    unsigned operator()(float v) const {
        const float inside = std::min(highest_, std::max(lowest_, v));  // in this order NaN becomes the lowest
        const unsigned code = code_[(std::bit_cast<std::uint32_t>(inside) >> shift) - first_bucket_];
        return code + static_cast<unsigned>(v >= threshold_[code + 1]);
    }

private:
    // Buckets split each octave into 256, finer than the codes, so that the search after the look-up takes a step at most.
    static constexpr int shift = 15;
    // From threshold 1, 1.5e-4 > 2^-13, to 1.
    static constexpr std::size_t buckets = 13 * 256;
    static std::uint32_t bucket_of(float v) { return std::bit_cast<std::uint32_t>(v) >> shift; }

    std::array<float, 257> threshold_{};
    std::uint32_t first_bucket_ = 0;
    float lowest_ = 0, highest_ = 0;  // of all buckets
    std::array<std::uint8_t, buckets> code_{};
};

}  // namespace

std::uint64_t count_changed_codes(std::array<const float*, 3> a, std::array<const float*, 3> b, std::size_t n) {
    static const CodeTable code;
    std::uint64_t changed = 0;
    for (std::size_t i = 0; i < n; ++i) {
        unsigned differs = 0;  // in whole numbers, so that no comparison becomes a branch
        for (std::size_t k = 0; k < 3; ++k) {
            const float p = a[k][i], q = b[k][i];
            differs |= static_cast<unsigned>(std::isnan(p)) | static_cast<unsigned>(std::isnan(q)) |
                       static_cast<unsigned>(code(p) != code(q));
        }
        changed += differs;
    }
    return changed;
}

}  // namespace spectex
