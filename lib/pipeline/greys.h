// Textures without colour have few colours: what is computed of each grey once serves wherever it comes again.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

namespace spectex::pipeline {

/// The distinct greys of a run of pixels. Whatever is a function of a pixel's colour alone is computed for these and spread, and
/// comes out the same to the bit.
class DistinctGreys {
public:
    /// A look-up and a copy cost some tenth of a spectrum; where more than one in so many differs, little is gained.
    static constexpr std::size_t worth = 4;

    /// @return whether all n colours have three equal components, and at most one in `worth` differs from those before it.
    bool find(std::array<const float*, 3> rgb, std::size_t n) {
        values_.clear();
        counts_.clear();
        found_ = false;
        // Told by the first pixels where there is colour.
        const std::size_t bytes = n * sizeof(float);
        if (n < worth || std::memcmp(rgb[0], rgb[1], bytes) != 0 || std::memcmp(rgb[0], rgb[2], bytes) != 0) return false;
        const std::size_t most = n / worth;
        const auto bits = static_cast<int>(std::bit_width(2 * most));
        slots_.assign(std::size_t{1} << bits, 0);
        places_.resize(std::max(places_.size(), n));
        for (std::size_t p = 0; p < n; ++p) {
            const auto key = std::bit_cast<std::uint32_t>(rgb[0][p]);
            std::size_t slot = (key * std::uint64_t{0x9e3779b97f4a7c15}) >> (64 - bits);
            // A slot holds the place of a value, counted from 1; it is never full: at least half of the slots are free.
            while (slots_[slot] != 0 && std::bit_cast<std::uint32_t>(values_[slots_[slot] - 1]) != key) slot = (slot + 1) & (slots_.size() - 1);
            if (slots_[slot] == 0) {
                if (values_.size() == most) return false;
                values_.push_back(rgb[0][p]);
                counts_.push_back(0);
                slots_[slot] = static_cast<std::uint32_t>(values_.size());
            }
            const std::uint32_t place = slots_[slot] - 1;
            places_[p] = place;
            ++counts_[place];
        }
        found_ = true;
        return true;
    }

    void clear() { found_ = false; }
    bool found() const { return found_; }
    std::size_t size() const { return values_.size(); }
    /// Three planes of size(), all the same one.
    std::array<const float*, 3> rgb() const { return {values_.data(), values_.data(), values_.data()}; }
    /// How many pixels have each of them.
    const std::vector<std::uint32_t>& counts() const { return counts_; }
    /// Index of the first pixel that has the grey of this place.
    std::size_t first_of(std::size_t place) const {
        return static_cast<std::size_t>(std::find(places_.begin(), places_.end(), static_cast<std::uint32_t>(place)) - places_.begin());
    }
    /// @param of_greys  [size()]. @param out  [n] of the run.
    template <class T>
    void spread(const T* of_greys, std::size_t n, T* out) const {
        for (std::size_t p = 0; p < n; ++p) out[p] = of_greys[places_[p]];
    }

private:
    std::vector<float> values_;
    std::vector<std::uint32_t> counts_, places_, slots_;
    bool found_ = false;
};

}  // namespace spectex::pipeline
