// ZIP chunks of scan line EXR (OpenEXR File Layout), packed and compressed by many threads.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "io/exr_stream.h"

namespace spectex::io {

inline constexpr int zip_rows = 16;  ///< of one chunk

/// A channel in the order of the file, and where its samples are.
struct PackedChannel {
    std::size_t sample = 2;  ///< bytes
    std::size_t index = 0;   ///< among the layouts
};

/// One chunk: rows of the channels of one part.
struct ChunkRequest {
    std::span<const PackedChannel> channels;
    int first_row = 0, rows = 0;  ///< row 0 is the layouts' first
};

/// Payloads of chunks as the file holds them: compressed, or as they are where that would not make them smaller.
/// @param scratch   memory that calls pass on.
/// @param payloads  [requests].  @throws std::bad_alloc, std::runtime_error.
void pack_zip_chunks(std::span<const ChunkRequest> requests, std::span<const SampleLayout> layouts, int width, bool parallel,
                     std::vector<std::vector<std::uint8_t>>& scratch, std::vector<std::vector<std::uint8_t>>& payloads);

/// The samples of a chunk as they lie in the file without compression: by row, by channel.
/// @param payload  as a file holds it, compressed. @return false where it is no zlib stream of just that many samples.
bool unpack_zip_chunk(std::span<const std::uint8_t> payload, std::span<std::byte> samples);

}  // namespace spectex::io
