#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <unistd.h>

#include "spectex/compare.h"

namespace spectex {

namespace {

// Compensated sum of Neumaier 1974, doi:10.1002/zamm.19740540106.
class NeumaierSum {
public:
    void add(double x) {
        const double t = sum_ + x;
        rest_ += std::fabs(sum_) >= std::fabs(x) ? (sum_ - t) + x : (x - t) + sum_;
        sum_ = t;
    }
    double value() const { return sum_ + rest_; }

private:
    double sum_ = 0, rest_ = 0;
};

// Unsigned keys in the order of the floats.
std::uint32_t key_of(float v) {
    const auto bits = std::bit_cast<std::uint32_t>(v);
    return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}
float value_of(std::uint32_t key) {
    return std::bit_cast<float>(key & 0x80000000u ? key & 0x7fffffffu : ~key);
}

constexpr std::size_t halves = 65536;
// Nearest ranks of 50%, 95%, 99% and 99.9%, in thousandths.
constexpr std::array<std::uint64_t, 4> quantiles{500, 950, 990, 999};

}  // namespace

struct DifferenceAccumulator::State {
    std::size_t capacity = 0;  ///< floats kept in memory
    std::vector<float> buffer;
    int file = -1;
    std::string folder;
    std::uint64_t spilled = 0;  ///< floats in the file
    /// Counts by the upper half of the keys, so that one pass over the values finds every percentile.
    std::vector<std::uint64_t> upper = std::vector<std::uint64_t>(halves);
    NeumaierSum sum, squares;
    DifferenceStatistics statistics;
    std::int64_t last_row = -1;
    bool any_row = false;

    ~State() {
        if (file >= 0) ::close(file);
    }

    Error failed(const char* what) const {
        return {ErrorKind::output, "temporary file for percentiles in " + folder + ": cannot " + what + ": " +
                                       std::strerror(errno) + "; set TMPDIR to a folder with room"};
    }

    Status open() {
        const char* named = std::getenv("TMPDIR");
        folder = named != nullptr && *named != '\0' ? named : "/tmp";
        std::string path = folder + "/spectex-XXXXXX";
        file = ::mkstemp(path.data());
        if (file < 0) return failed("create");
        ::unlink(path.c_str());
        return {};
    }

    Status spill() {
        if (file < 0)
            if (Status s = open(); !s) return s;
        const char* from = reinterpret_cast<const char*>(buffer.data());
        for (std::size_t left = buffer.size() * sizeof(float); left > 0;) {
            const ssize_t written = ::write(file, from, left);
            if (written < 0 && errno == EINTR) continue;
            if (written < 0) return failed("write");
            from += written;
            left -= static_cast<std::size_t>(written);
        }
        spilled += buffer.size();
        buffer.clear();
        return {};
    }

    /// Calls visit(span) over all values, spilled ones first.
    template <class F>
    Status visit_values(F visit) {
        std::vector<float> chunk(static_cast<std::size_t>(std::min<std::uint64_t>(spilled, std::uint64_t{1} << 18)));
        for (std::uint64_t done = 0; done < spilled;) {
            const std::size_t take = static_cast<std::size_t>(std::min<std::uint64_t>(chunk.size(), spilled - done));
            std::size_t got = 0;
            while (got < take * sizeof(float)) {
                const ssize_t read = ::pread(file, reinterpret_cast<char*>(chunk.data()) + got, take * sizeof(float) - got,
                                             static_cast<off_t>(done * sizeof(float) + got));
                if (read < 0 && errno == EINTR) continue;
                if (read == 0) errno = EIO;
                if (read <= 0) return failed("read");
                got += static_cast<std::size_t>(read);
            }
            visit(std::span<const float>(chunk.data(), take));
            done += take;
        }
        visit(std::span<const float>(buffer));
        return {};
    }
};

DifferenceAccumulator::DifferenceAccumulator(std::size_t memory_bytes) : state_(std::make_unique<State>()) {
    state_->capacity = std::max<std::size_t>(memory_bytes / sizeof(float), 1024);
}
DifferenceAccumulator::~DifferenceAccumulator() = default;
DifferenceAccumulator::DifferenceAccumulator(DifferenceAccumulator&&) noexcept = default;

Status DifferenceAccumulator::add_row(std::int64_t y, std::span<const float> values) {
    State& s = *state_;
    if (s.any_row && y <= s.last_row)
        return Error{ErrorKind::usage, "row " + std::to_string(y) + " of differences came after row " +
                                           std::to_string(s.last_row) + ": rows must ascend"};
    s.any_row = true;
    s.last_row = y;
    DifferenceStatistics& t = s.statistics;
    for (std::size_t x = 0; x < values.size(); ++x) {
        const float v = values[x];
        if (!std::isfinite(v)) {
            ++t.nonfinite;
            continue;
        }
        if (s.buffer.size() == s.capacity)
            if (Status status = s.spill(); !status) return status;
        s.buffer.push_back(v);
        ++s.upper[key_of(v) >> 16];
        s.sum.add(v);
        s.squares.add(static_cast<double>(v) * v);
        if (t.pixels == 0 || v > t.max) {
            t.max = v;
            t.max_at = {static_cast<std::int64_t>(x), y};
        }
        ++t.pixels;
    }
    return {};
}

void DifferenceAccumulator::add_changed_codes(std::uint64_t n) { state_->statistics.changed_codes += n; }

Result<DifferenceStatistics> DifferenceAccumulator::finish() {
    State& s = *state_;
    DifferenceStatistics t = s.statistics;
    if (t.pixels == 0) return t;
    const double count = static_cast<double>(t.pixels);
    t.mean = s.sum.value() / count;
    t.rms = std::sqrt(s.squares.value() / count);

    // The bucket of each percentile, and its rank within the bucket from 0.
    std::array<std::size_t, quantiles.size()> bucket{};
    std::array<std::uint64_t, quantiles.size()> rank{};
    for (std::size_t q = 0; q < quantiles.size(); ++q) {
        // ceil(p N) - 1, without forming p N, which could overflow.
        const std::uint64_t thousands = t.pixels / 1000, rest = t.pixels % 1000;
        rank[q] = thousands * quantiles[q] + (rest * quantiles[q] + 999) / 1000 - 1;
        while (rank[q] >= s.upper[bucket[q]]) rank[q] -= s.upper[bucket[q]++];
    }
    std::array<std::vector<std::uint64_t>, quantiles.size()> lower;
    for (auto& l : lower) l.resize(halves);
    const Status status = s.visit_values([&](std::span<const float> values) {
        for (const float v : values) {
            const std::uint32_t key = key_of(v);
            for (std::size_t q = 0; q < quantiles.size(); ++q)
                if (key >> 16 == bucket[q]) ++lower[q][key & 0xffff];
        }
    });
    if (!status) return status.error();
    std::array<double*, quantiles.size()> to{&t.p50, &t.p95, &t.p99, &t.p999};
    for (std::size_t q = 0; q < quantiles.size(); ++q) {
        std::size_t low = 0;
        while (rank[q] >= lower[q][low]) rank[q] -= lower[q][low++];
        *to[q] = value_of(static_cast<std::uint32_t>(bucket[q] << 16 | low));
    }
    return t;
}

}  // namespace spectex
