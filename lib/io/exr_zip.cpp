#include "io/exr_zip.h"


#include <bit>

#include "io/deflate.h"
#include "parallel.h"

namespace spectex::io {
namespace {

static_assert(std::endian::native == std::endian::little, "EXR is little endian, and samples are copied as they lie in memory");

std::size_t line_bytes(std::span<const PackedChannel> channels, std::size_t width) {
    std::size_t bytes = 0;
    for (const PackedChannel& c : channels) bytes += c.sample * width;
    return bytes;
}

/// A row of samples in one piece; `copy` holds it where they lie apart.
const std::byte* gather(const SampleLayout& layout, std::size_t row, std::size_t sample, std::size_t width,
                        std::vector<std::byte>& copy) {
    const std::byte* in = layout.base + row * layout.y_stride;
    if (layout.x_stride == sample) return in;
    copy.resize(std::max(copy.size(), sample * width));
    if (sample == 2)
        for (std::size_t x = 0; x < width; ++x) std::memcpy(copy.data() + 2 * x, in + x * layout.x_stride, 2);
    else
        for (std::size_t x = 0; x < width; ++x) std::memcpy(copy.data() + 4 * x, in + x * layout.x_stride, 4);
    return copy.data();
}

/// Even and odd bytes apart. @param n  pairs.
void split(const std::byte* in, std::size_t n, std::uint8_t* even, std::uint8_t* odd) {
    const auto* p = reinterpret_cast<const std::uint8_t*>(in);
    for (std::size_t i = 0; i < n; ++i) {
        even[i] = p[2 * i];
        odd[i] = p[2 * i + 1];
    }
}

template <class Body>
void for_each(std::size_t n, bool parallel, const Body& body) {
    if (parallel && n > 1)
        parallel_for(std::size_t{0}, n, body);
    else
        for (std::size_t i = 0; i < n; ++i) body(i);
}

struct Segment {
    std::size_t request = 0, begin = 0, end = 0;
    bool last = false;
    std::vector<std::uint8_t> bytes;
};

}  // namespace

void pack_zip_chunks(std::span<const ChunkRequest> requests, std::span<const SampleLayout> layouts, int width_pixels, bool parallel,
                     std::vector<std::vector<std::uint8_t>>& split_bytes, std::vector<std::vector<std::uint8_t>>& payloads) {
    const auto width = static_cast<std::size_t>(width_pixels);
    payloads.resize(requests.size());
    split_bytes.resize(requests.size());
    std::vector<Segment> segments;
    std::vector<std::array<std::size_t, 2>> lines;  // request, row
    for (std::size_t r = 0; r < requests.size(); ++r) {
        const std::size_t size = line_bytes(requests[r].channels, width) * static_cast<std::size_t>(requests[r].rows);
        split_bytes[r].resize(size);  // of the call before, as a rule as large
        for (std::size_t row = 0; row < static_cast<std::size_t>(requests[r].rows); ++row) lines.push_back({r, row});
        for (std::size_t at = 0; at < size; at += deflate_segment)
            segments.push_back({r, at, std::min(at + deflate_segment, size), at + deflate_segment >= size, {}});
    }
    for_each(lines.size(), parallel, [&](std::size_t i) {
        thread_local std::vector<std::byte> copy;
        const auto [r, row] = lines[i];
        const ChunkRequest& request = requests[r];
        auto& out = split_bytes[r];
        std::size_t at = line_bytes(request.channels, width) / 2 * row;
        for (const PackedChannel& c : request.channels) {
            const std::byte* in = gather(layouts[c.index], static_cast<std::size_t>(request.first_row) + row, c.sample, width, copy);
            const std::size_t pairs = c.sample / 2 * width;
            split(in, pairs, out.data() + at, out.data() + out.size() / 2 + at);
            at += pairs;
        }
    });
    std::vector<std::uint32_t> sums(segments.size());
    for_each(segments.size(), parallel, [&](std::size_t i) {
        thread_local std::vector<std::uint8_t> differences;
        Segment& s = segments[i];
        const std::uint8_t* in = split_bytes[s.request].data() + s.begin;
        const std::size_t n = s.end - s.begin;
        differences.resize(std::max(differences.size(), n));
        // A pointer, for a variable of the thread's own is looked up at every use.
        std::uint8_t* out = differences.data();
        out[0] = s.begin == 0 ? in[0] : static_cast<std::uint8_t>(in[0] - in[-1] + 128);
        for (std::size_t k = 1; k < n; ++k) out[k] = static_cast<std::uint8_t>(in[k] - in[k - 1] + 128);
        sums[i] = adler32(out, n);
        deflate_append(out, n, s.last, s.bytes);
    });
    for (auto& payload : payloads) payload.assign(std::begin(zlib_head), std::end(zlib_head));
    std::uint32_t sum = 1;
    for (std::size_t i = 0; i < segments.size(); ++i) {
        const Segment& s = segments[i];
        auto& payload = payloads[s.request];
        payload.insert(payload.end(), s.bytes.begin(), s.bytes.end());
        sum = adler32_join(s.begin == 0 ? 1 : sum, sums[i], s.end - s.begin);
        if (!s.last) continue;
        for (int shift = 24; shift >= 0; shift -= 8) payload.push_back(static_cast<std::uint8_t>(sum >> shift));
        if (payload.size() < split_bytes[s.request].size()) continue;
        // A chunk as large as its samples is taken for the samples themselves.
        const ChunkRequest& request = requests[s.request];
        std::vector<std::byte> copy;
        payload.clear();
        for (std::size_t row = 0; row < static_cast<std::size_t>(request.rows); ++row)
            for (const PackedChannel& c : request.channels) {
                const auto* in = reinterpret_cast<const std::uint8_t*>(
                    gather(layouts[c.index], static_cast<std::size_t>(request.first_row) + row, c.sample, width, copy));
                payload.insert(payload.end(), in, in + c.sample * width);
            }
    }
}

bool unpack_zip_chunk(std::span<const std::uint8_t> payload, std::span<std::byte> samples) {
    thread_local std::vector<std::uint8_t> differences;
    differences.resize(std::max(differences.size(), samples.size()));
    if (!inflate_whole(payload, {differences.data(), samples.size()})) return false;
    // The running sum over the whole chunk in two halves, of its even and of its odd bytes, for the sum of the first is soon
    // known: twice as fast as one after the other.
    const std::uint8_t* first = differences.data();
    const std::size_t evens = (samples.size() + 1) / 2, odds = samples.size() / 2;
    const std::uint8_t* second = first + evens;
    std::uint8_t even = 0x80, odd = 0x80;  // so that the first byte, which no 128 was added to, loses none
    for (std::size_t i = 0; i < evens; ++i) odd = static_cast<std::uint8_t>(odd + first[i] + 0x80);
    auto* out = reinterpret_cast<std::uint8_t*>(samples.data());
    for (std::size_t i = 0; i < odds; ++i) {
        even = static_cast<std::uint8_t>(even + first[i] + 0x80);
        odd = static_cast<std::uint8_t>(odd + second[i] + 0x80);
        out[2 * i] = even;
        out[2 * i + 1] = odd;
    }
    if (evens > odds) out[2 * odds] = static_cast<std::uint8_t>(even + first[odds] + 0x80);
    return true;
}

}  // namespace spectex::io
