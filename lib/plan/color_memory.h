// Colours that were met before: what was computed of them is kept, so that textures of few colours cost few.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

namespace spectex::plan {

/// Names a function of a colour: memories of one owner are never those of another.
class ColorMemoryOwner {
public:
    ColorMemoryOwner() : id_(next()) {}
    std::uint64_t id() const { return id_; }

private:
    static std::uint64_t next() {
        static std::atomic<std::uint64_t> last{0};
        return ++last;
    }
    std::uint64_t id_;
};

/// Results of a function of three floats, the last that this thread met, in a table with one place for each hash. A result
/// depends on its colour alone, so that it is the same whether it was remembered or not. A look-up is a hash and a comparison
/// where a spectrum is some hundred operations: it is given up for a while where next to no colour comes again.
class ColorMemory {
public:
    static constexpr std::size_t inputs = 3;
    /// What one memory may take.
    static constexpr std::size_t bytes = std::size_t{4} << 20;
    static constexpr std::size_t most_entries = std::size_t{1} << 15;
    /// Where fewer than one colour of `worth` among `judged` came again, so many calls pass before it is tried again.
    static constexpr std::uint64_t judged = 1 << 15, worth = 20, rest = 256;

    /// Results of n colours.
    /// @param in       three planes; colours [begin, begin + n).
    /// @param compute  (colours [m][3] double, results [m][values] float) for those that are not remembered.
    /// @param out      [n][values].
    template <class Compute>
    static void apply(const ColorMemoryOwner& owner, std::span<const float* const> in, std::size_t begin, std::size_t n, std::size_t values,
                      const Compute& compute, float* out) {
        ColorMemory& memory = of(owner, values);
        // The function may run other tasks of this thread's while it waits for its own, and those come back here.
        if (memory.busy_ || memory.rests()) {
            std::vector<double> colors(inputs * n);
            for (std::size_t p = 0; p < n; ++p)
                for (std::size_t i = 0; i < inputs; ++i) colors[p * inputs + i] = static_cast<double>(in[i][begin + p]);
            compute(std::span<const double>(colors), std::span<float>(out, n * values));
            return;
        }
        memory.busy_ = true;
        // Should the function throw, the places that it left unfilled are nobody's.
        memory.owner_ = 0;
        const Release release{memory};
        memory.look_up(in, begin, n, values, compute, out);
        memory.owner_ = owner.id();
    }

private:
    struct Release {
        ColorMemory& memory;
        ~Release() { memory.busy_ = false; }
    };
    using Key = std::array<std::uint32_t, inputs>;

    /// Plans alternate within a strip: the one that stores, the one that checks, a preview's.
    static ColorMemory& of(const ColorMemoryOwner& owner, std::size_t values) {
        thread_local std::array<ColorMemory, 4> memories;
        thread_local std::size_t oldest = 0;
        for (auto& memory : memories)
            if (memory.owner_ == owner.id()) return memory;
        for (std::size_t tried = 0; tried < memories.size() && memories[oldest].busy_; ++tried) oldest = (oldest + 1) % memories.size();
        ColorMemory& memory = memories[oldest];
        oldest = (oldest + 1) % memories.size();
        if (!memory.busy_) memory.begin(owner.id(), values);
        return memory;
    }

    bool rests() {
        if (resting_ == 0) return false;
        --resting_;
        return true;
    }

    void begin(std::uint64_t owner, std::size_t values) {
        owner_ = owner;
        asked_ = computed_colours_ = resting_ = 0;
        const std::size_t fitting = bytes / (sizeof(Key) + sizeof(float) * std::max<std::size_t>(values, 1));
        shift_ = 64 - std::countr_zero(std::min(std::bit_floor(std::max<std::size_t>(fitting, 2)), most_entries));
        const std::size_t entries = std::size_t{1} << (64 - shift_);
        // No colour has these bits: the colours of plans are finite.
        keys_.assign(entries, Key{0xffffffff, 0xffffffff, 0xffffffff});
        results_.resize(entries * values);
    }

    template <class Compute>
    void look_up(std::span<const float* const> in, std::size_t begin, std::size_t n, std::size_t values, const Compute& compute, float* out) {
        missing_.clear();
        colors_.clear();
        repeats_.clear();
        for (std::size_t p = 0; p < n; ++p) {
            const Key key{std::bit_cast<std::uint32_t>(in[0][begin + p]), std::bit_cast<std::uint32_t>(in[1][begin + p]),
                          std::bit_cast<std::uint32_t>(in[2][begin + p])};
            const std::uint64_t mixed = (key[0] * std::uint64_t{0x9e3779b97f4a7c15} ^ key[1]) * std::uint64_t{0xd6e8feb86659fd93} ^ key[2];
            const auto slot = static_cast<std::size_t>(mixed * std::uint64_t{0xff51afd7ed558ccd} >> shift_);
            if (keys_[slot] == key) {
                // The result of a colour that this very call met first is not there yet.
                if (pending_.size() > slot && pending_[slot] == call_)
                    repeats_.push_back({p, slot});
                else
                    std::copy_n(&results_[slot * values], values, out + p * values);
                continue;
            }
            if (pending_.size() < keys_.size()) pending_.resize(keys_.size(), 0);
            if (pending_[slot] == call_) {
                // The place is promised to another colour of this call: this one is computed and not kept.
                missing_.push_back({p, no_slot});
            } else {
                keys_[slot] = key;
                pending_[slot] = call_;
                missing_.push_back({p, slot});
            }
            for (std::size_t i = 0; i < inputs; ++i) colors_.push_back(static_cast<double>(in[i][begin + p]));
        }
        if (!missing_.empty()) {
            computed_.resize(missing_.size() * values);
            compute(std::span<const double>(colors_), std::span<float>(computed_));
            for (std::size_t m = 0; m < missing_.size(); ++m) {
                std::copy_n(&computed_[m * values], values, out + missing_[m].pixel * values);
                if (missing_[m].slot != no_slot) std::copy_n(&computed_[m * values], values, &results_[missing_[m].slot * values]);
            }
        }
        for (const auto& r : repeats_) std::copy_n(&results_[r.slot * values], values, out + r.pixel * values);
        ++call_;
        asked_ += n;
        computed_colours_ += missing_.size();
        if (asked_ < judged) return;
        if ((asked_ - computed_colours_) * worth < asked_) resting_ = rest;
        asked_ = computed_colours_ = 0;
    }

    static constexpr std::size_t no_slot = static_cast<std::size_t>(-1);
    struct Place {
        std::size_t pixel, slot;
    };
    std::uint64_t owner_ = 0;
    std::uint64_t asked_ = 0, computed_colours_ = 0, resting_ = 0;
    bool busy_ = false;
    int shift_ = 63;
    std::uint32_t call_ = 1;
    std::vector<Key> keys_;
    std::vector<std::uint32_t> pending_;  // the call that last put a key into a place
    std::vector<float> results_, computed_;
    std::vector<double> colors_;
    std::vector<Place> missing_, repeats_;
};

}  // namespace spectex::plan
