// What both readers of EXR need: an opened file whose declared sizes are within limits.
#pragma once

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputPart.h>
#include <OpenEXR/ImfMultiPartInputFile.h>
#include <OpenEXR/ImfTiledInputPart.h>

#include <memory>

#include "io/internal.h"

namespace spectex::io {

struct ExrPartInfo {
    Geometry geometry;
    std::int64_t pixel_bytes = 0;  ///< over all channels
    int block_rows = 1;            ///< rows that are compressed together, or of a tile
    bool deep = false;
    int mip_levels = 1;            ///< of a part of tiles; of a ripmap, those that are halved both ways
    std::int64_t mip_pixels = 0;   ///< over these levels
};

class ExrInput {
public:
    ExrInput();
    ~ExrInput();
    /// Opens the file and reads all headers. @error input.
    static Result<std::unique_ptr<ExrInput>> open(const std::string& path, int threads);
    int parts() const { return file_->parts(); }
    const Imf::Header& header(int part) const { return file_->header(part); }
    /// Windows and sizes of a part. @error input: over limits, deep data, channels below full resolution.
    Result<ExrPartInfo> describe(int part, const Limits& limits) const;
    /// Makes the part readable; only after describe() found it within limits.
    Imf::InputPart& part(int index);
    /// Fills the slices with rows y .. y + rows - 1 of the data window, counted from its first. ZIP chunks of scan lines are
    /// unpacked by all threads; every other layout, and whatever is damaged, is left to OpenEXR.
    /// @throws what OpenEXR does.
    void read(int part, const Imf::FrameBuffer& frame, int y, int rows);
    /// The tiles of a level other than the first, in place of part(), which must not be asked for the same part as well.
    std::unique_ptr<Imf::TiledInputPart> tiles(int part) { return std::make_unique<Imf::TiledInputPart>(*file_, part); }

private:
    struct ZipPart;
    bool read_zip(int part, ZipPart& zip, const Imf::FrameBuffer& frame, int y, int rows);
    bool parallel_ = false;
    std::vector<std::unique_ptr<ZipPart>> zips_;
    std::string path_;
    std::unique_ptr<Imf::MultiPartInputFile> file_;
    std::vector<std::unique_ptr<Imf::InputPart>> inputs_;
};

/// Adds a header's own attributes; the names that describe the pixels themselves are left out.
void read_exr_attributes(const Imf::Header& header, Attributes& attributes);

/// A slice whose first sample is that of (geometry.x, geometry.y + y).
Imf::Slice exr_slice(Imf::PixelType type, std::byte* base, std::size_t x_stride, std::size_t y_stride,
                     const Geometry& geometry, int y);

/// Rows for one call: a multiple of the block, 64 at least, fewer when the image is smaller.
int rows_per_call(int block_rows, int height);

}  // namespace spectex::io
