#include "io/deflate.h"

#include <isa-l/crc.h>
#include <isa-l/igzip_lib.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <limits>
#include <new>
#include <stdexcept>

namespace spectex::io {
namespace {

// Level 1 compresses at 2.5 times the speed of any other encoder of this format, to 5% more bytes; 2 and 3 gain 1%.
constexpr int level = 1;

/// ISA-L (2.30, igzip_icf_body_h1_gr_bt.asm) enters position 2 of a stream into its table of 8192 buckets under a hash of the
/// stream's own address (bits 16 to 47) instead of the data there: about one thread in 500 finds other matches in the same
/// data. So every stream lies where that hash is the same.
constexpr std::uint32_t bucket_mask = 8191, chosen_bucket = 0x1555;
constexpr std::size_t window = std::size_t{1} << 16;

std::uint32_t bucket_of(const void* place) {
    // CRC-32C of four bytes, as the instruction of SSE 4.2 has it.
    auto v = static_cast<std::uint32_t>(reinterpret_cast<std::uintptr_t>(place) / window);
    for (int bit = 0; bit < 32; ++bit) v = v >> 1 ^ (0x82F63B78U & (0U - (v & 1U)));
    return v & bucket_mask;
}

/// Memory for one stream, in such a place; in any, where the process may not reserve addresses to choose from.
class StreamPlace {
public:
    StreamPlace() {
        const auto page = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
        size_ = (sizeof(isal_zstream) + page - 1) / page * page;
        // Of 65536 windows in line, and aligned, eight are right; most often a quarter of those has one already.
        for (const std::size_t reserve : {std::size_t{1} << 30, std::size_t{1} << 33, size_}) {
            void* const reserved = ::mmap(nullptr, reserve, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
            if (reserved == MAP_FAILED) continue;
            auto* const begin = static_cast<std::byte*>(reserved);
            auto* const end = begin + reserve;
            auto* at = begin + (window - reinterpret_cast<std::uintptr_t>(begin) % window) % window;
            while (at + size_ <= end && bucket_of(at) != chosen_bucket) at += window;
            if (at + size_ > end) at = begin;
            if ((bucket_of(at) == chosen_bucket || reserve == size_) && ::mprotect(at, size_, PROT_READ | PROT_WRITE) == 0) {
                if (at > begin) ::munmap(begin, static_cast<std::size_t>(at - begin));
                if (at + size_ < end) ::munmap(at + size_, static_cast<std::size_t>(end - at) - size_);
                stream_ = reinterpret_cast<isal_zstream*>(at);
                return;
            }
            ::munmap(reserved, reserve);
        }
        throw std::bad_alloc();
    }
    StreamPlace(const StreamPlace&) = delete;
    StreamPlace& operator=(const StreamPlace&) = delete;
    ~StreamPlace() { ::munmap(stream_, size_); }
    isal_zstream& stream() { return *stream_; }

private:
    std::size_t size_ = 0;
    isal_zstream* stream_ = nullptr;
};

StreamPlace& stream_place() {
    thread_local StreamPlace place;
    return place;
}

}  // namespace

bool deflate_place_is_chosen() { return bucket_of(&stream_place().stream()) == chosen_bucket; }

void deflate_append(const std::uint8_t* in, std::size_t n, bool last, std::vector<std::uint8_t>& out) {
    if (n > std::numeric_limits<std::uint32_t>::max() / 2) throw std::length_error("a segment is too large");
    thread_local std::vector<std::uint8_t> work(ISAL_DEF_LVL1_LARGE);
    isal_zstream& stream = stream_place().stream();
    isal_deflate_init(&stream);
    stream.level = level;
    stream.level_buf = work.data();
    stream.level_buf_size = static_cast<std::uint32_t>(work.size());
    stream.gzip_flag = IGZIP_DEFLATE;
    stream.flush = last ? NO_FLUSH : FULL_FLUSH;
    stream.end_of_stream = last ? 1 : 0;
    // The interface takes a pointer to bytes that it only reads.
    stream.next_in = const_cast<std::uint8_t*>(in);
    stream.avail_in = static_cast<std::uint32_t>(n);
    // What is grown is cleared first: only what was written is appended.
    thread_local std::vector<std::uint8_t> buffer;
    buffer.resize(std::max(buffer.size(), n + n / 8 + 1024));
    std::uint8_t* const begin = buffer.data();
    do {
        stream.next_out = begin;
        stream.avail_out = static_cast<std::uint32_t>(buffer.size());
        if (isal_deflate(&stream) != COMP_OK) throw std::runtime_error("the deflate encoder failed");
        out.insert(out.end(), begin, stream.next_out);
    } while (stream.avail_out == 0 || stream.avail_in > 0);
}

bool inflate_whole(std::span<const std::uint8_t> in, std::span<std::uint8_t> out) {
    constexpr std::size_t most = std::numeric_limits<std::uint32_t>::max();
    if (in.size() > most || out.size() > most) return false;
    thread_local inflate_state state;
    isal_inflate_init(&state);
    state.crc_flag = ISAL_ZLIB;
    // The interface takes a pointer to bytes that it only reads.
    state.next_in = const_cast<std::uint8_t*>(in.data());
    state.avail_in = static_cast<std::uint32_t>(in.size());
    state.next_out = out.data();
    state.avail_out = static_cast<std::uint32_t>(out.size());
    return isal_inflate_stateless(&state) == ISAL_DECOMP_OK && state.avail_out == 0;
}

std::uint32_t adler32(const std::uint8_t* in, std::size_t n) { return isal_adler32(1, in, n); }

std::uint32_t adler32_join(std::uint32_t first, std::uint32_t second, std::size_t length) {
    // RFC 1950 section 8.2: a is 1 + sum of bytes, b the sum of all a.
    constexpr std::uint64_t base = 65521;
    const std::uint64_t a1 = first & 0xffff, b1 = first >> 16, a2 = second & 0xffff, b2 = second >> 16;
    const std::uint64_t a = (a1 + a2 + base - 1) % base;
    const std::uint64_t b = (b1 + b2 + (length % base) * ((a1 + base - 1) % base)) % base;
    return static_cast<std::uint32_t>(b << 16 | a);
}

}  // namespace spectex::io
