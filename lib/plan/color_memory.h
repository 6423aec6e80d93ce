// Colours that were met before: what was computed of them is kept, so that textures of few colours cost few.
#pragma once

#include <time.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <vector>

namespace spectex::plan {

/// What it costs to compute a colour, and to remember it, in nanoseconds a colour of this machine.
struct BreakEven {
    double compute = 0;  ///< the function itself
    double plain = 0;    ///< handing a colour to it
    double missed = 0;   ///< looking up one that is not remembered, and keeping its result
    double found = 0;    ///< looking up one that is

    /// Of all colours, those that must come again for remembering to take no longer than computing: with a share s of them,
    /// s found + (1 - s)(missed + compute) = plain + compute. 1 where it never pays.
    double share() const {
        const double saved = compute + missed - found;
        return saved > 0 ? std::clamp((missed - plain) / saved, 0.0, 1.0) : 1;
    }
    /// How long to compute before remembering is tried again, in trials, so that trying in vain adds a fiftieth.
    double rest() const { return std::clamp(50 * (missed - plain) / std::max(plain + compute, 1e-3), 1.0, 1e3); }
};

/// Names a function of a colour: memories of one owner are never those of another.
class ColorMemoryOwner {
public:
    /// @param share  of colours that must come again for the memory to be used; 1 and it never is.
    /// @param rest   where fewer come again, how long it is left alone, in trials.
    explicit ColorMemoryOwner(double share = 0, double rest = 8) : id_(next()), share_(share), rest_(rest) {}
    explicit ColorMemoryOwner(const BreakEven& b) : ColorMemoryOwner(b.share(), b.rest()) {}
    std::uint64_t id() const { return id_; }
    double share() const { return share_; }
    double rest() const { return rest_; }

private:
    static std::uint64_t next() {
        static std::atomic<std::uint64_t> last{0};
        return ++last;
    }
    std::uint64_t id_;
    double share_, rest_;
};

/// Results of a function of three floats, the last that this thread met, in a table with one place for each hash. A result
/// depends on its colour alone, so that it is the same whether it was remembered or not. It is given up for a while where
/// fewer colours come again than pay for the look-ups.
class ColorMemory {
public:
    static constexpr std::size_t inputs = 3;
    /// What one memory may take.
    static constexpr std::size_t bytes = std::size_t{4} << 20;
    static constexpr std::size_t most_entries = std::size_t{1} << 15;
    /// Colours of a trial: where fewer of them came again than the owner's share, the memory rests.
    static constexpr std::uint64_t judged = 1 << 15;
    /// For measurements of one way or the other.
    enum class Use { as_it_pays, always, never };
    static inline std::atomic<Use> use{Use::as_it_pays};

    /// Results of n colours.
    /// @param in       three planes; colours [begin, begin + n).
    /// @param compute  (colours [m][3] double, results [m][values] float) for those that are not remembered.
    /// @param out      [n][values].
    template <class Compute>
    static void apply(const ColorMemoryOwner& owner, std::span<const float* const> in, std::size_t begin, std::size_t n, std::size_t values,
                      const Compute& compute, float* out) {
        const Use how = use.load(std::memory_order_relaxed);
        if (how == Use::never || (how == Use::as_it_pays && owner.share() >= 1)) return pass(in, begin, n, values, compute, out);
        ColorMemory& memory = of(owner, values);
        // The function may run other tasks of this thread's while it waits for its own, and those come back here.
        if (memory.busy_ || (how == Use::as_it_pays && memory.rests(n))) return pass(in, begin, n, values, compute, out);
        memory.busy_ = true;
        // Should the function throw, the places that it left unfilled are nobody's.
        memory.owner_ = 0;
        const Release release{memory};
        memory.look_up(in, begin, n, values, compute, out, owner);
        memory.owner_ = owner.id();
    }

    /// The same, and nothing remembered.
    template <class Compute>
    static void pass(std::span<const float* const> in, std::size_t begin, std::size_t n, std::size_t values, const Compute& compute, float* out) {
        std::vector<double> colors(inputs * n);
        for (std::size_t p = 0; p < n; ++p)
            for (std::size_t i = 0; i < inputs; ++i) colors[p * inputs + i] = static_cast<double>(in[i][begin + p]);
        compute(std::span<const double>(colors), std::span<float>(out, n * values));
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

    bool rests(std::size_t n) {
        if (resting_ == 0) return false;
        resting_ -= std::min<std::uint64_t>(resting_, n);
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
    void look_up(std::span<const float* const> in, std::size_t begin, std::size_t n, std::size_t values, const Compute& compute, float* out,
                 const ColorMemoryOwner& owner) {
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
        if (static_cast<double>(asked_ - computed_colours_) < owner.share() * static_cast<double>(asked_))
            resting_ = static_cast<std::uint64_t>(owner.rest() * static_cast<double>(asked_));
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

/// Measures, in a fraction of a millisecond (or the time of 16 colours), what remembering the results of a function is worth.
/// @param values   results per colour. @param compute  as ColorMemory::apply takes it.
template <class Compute>
BreakEven measure_break_even(std::size_t values, const Compute& compute) {
    constexpr std::size_t n = 256, few = 16, sets = 4;
    constexpr double enough = 1e5;
    // Colours without order, none twice: steps of a Weyl sequence for each component.
    std::vector<float> colors(ColorMemory::inputs * n * sets);
    for (std::size_t i = 0; i < colors.size(); ++i)
        colors[i] = static_cast<float>(static_cast<std::uint32_t>((i + 1) * 2654435769u) >> 8) * 0x1p-24f;
    const auto set = [&](std::size_t s) {
        const float* at = colors.data() + s * ColorMemory::inputs * n;
        return std::array<const float*, ColorMemory::inputs>{at, at + n, at + 2 * n};
    };
    // Of this thread's processor time, which others on the machine do not lengthen.
    const auto nanoseconds = [](const auto& run) {
        const auto now = [] {
            timespec t{};
            ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
            return 1e9 * static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec);
        };
        const double begin = now();
        run();
        return now() - begin;
    };
    std::vector<float> results(n * values);
    const auto nothing = [](std::span<const double>, std::span<float> out) { std::fill(out.begin(), out.end(), 0.5f); };
    BreakEven b;
    const ColorMemoryOwner owner;
    const auto in = set(0);
    ColorMemory::apply(owner, in, 0, n, values, nothing, results.data());
    b.plain = b.missed = b.found = std::numeric_limits<double>::infinity();
    for (std::size_t s = 1; s < sets; ++s) {
        const auto fresh = set(s);
        b.plain = std::min(b.plain, nanoseconds([&] { ColorMemory::pass(fresh, 0, n, values, nothing, results.data()); }) / n);
        b.missed = std::min(b.missed, nanoseconds([&] { ColorMemory::apply(owner, fresh, 0, n, values, nothing, results.data()); }) / n);
        b.found = std::min(b.found, nanoseconds([&] { ColorMemory::apply(owner, fresh, 0, n, values, nothing, results.data()); }) / n);
    }
    // The first colours of a function may load its tables.
    double spent = nanoseconds([&] { ColorMemory::pass(in, 0, few, values, compute, results.data()); });
    spent += few * (b.compute = nanoseconds([&] { ColorMemory::pass(in, 0, few, values, compute, results.data()); }) / few);
    for (std::size_t s = 1; s < sets && spent < enough; ++s) {
        const auto fresh = set(s);
        const double took = nanoseconds([&] { ColorMemory::pass(fresh, 0, n, values, compute, results.data()); });
        spent += took;
        b.compute = s == 1 ? took / n : std::min(b.compute, took / n);
    }
    b.compute = std::max(b.compute - b.plain, 0.0);
    return b;
}

}  // namespace spectex::plan
