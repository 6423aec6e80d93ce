// PNG (ISO/IEC 15948) under OpenImageIO, which still reads and writes every chunk but IDAT: rows of 8 and 16 bits, not
// interlaced, no palette. Streams in bounded memory; checksums of chunks and of the stream are checked.
#pragma once

#include <OpenImageIO/imageio.h>

#include "io/internal.h"

namespace spectex::io {

/// A reader of what `header` describes, or null where the file is of a kind that is left to OpenImageIO.
std::unique_ptr<ImageReader> open_png(const ImageHeader& header, const FileFacts& facts);

/// A writer of an image of `spec`, whose metadata it takes, or null where it is of a kind that is left to OpenImageIO.
/// @param file  taken over when a writer is returned.
Result<std::unique_ptr<ImageWriter>> create_png(OutputFile& file, const OIIO::ImageSpec& spec, PixelType type, int threads);

}  // namespace spectex::io
