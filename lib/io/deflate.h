// zlib streams (RFC 1950) in segments that are compressed independently of each other, so that threads share one stream
// and its bytes depend on neither their number nor the order of their work.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace spectex::io {

/// Input bytes of one segment: what matches across its borders would save is below a percent at this size.
inline constexpr std::size_t deflate_segment = std::size_t{1} << 19;

/// The two bytes ahead of the segments of a stream.
inline constexpr std::uint8_t zlib_head[2] = {0x78, 0x01};

/// Appends one segment of raw deflate data (RFC 1951) that ends on a byte border. @param last  ends the stream.
/// @throws std::runtime_error when the encoder fails, std::bad_alloc.
void deflate_append(const std::uint8_t* in, std::size_t n, bool last, std::vector<std::uint8_t>& out);

/// A whole zlib stream. @return whether it is one, holds just out.size() bytes and has their checksum.
bool inflate_whole(std::span<const std::uint8_t> in, std::span<std::uint8_t> out);

/// Whether this thread's encoder lies where its bytes depend on the data alone.
bool deflate_place_is_chosen();

/// Adler-32 of a segment, and of two neighbours from theirs; `length` is of the second.
std::uint32_t adler32(const std::uint8_t* in, std::size_t n);
std::uint32_t adler32_join(std::uint32_t first, std::uint32_t second, std::size_t length);

}  // namespace spectex::io
