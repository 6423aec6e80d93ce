// Sample types in OpenImageIO's words.
#pragma once

#include <OpenImageIO/typedesc.h>

#include "spectex/io.h"

namespace spectex::io {

inline OIIO::TypeDesc oiio_type(PixelType type) {
    switch (type) {
        case PixelType::uint8: return OIIO::TypeUInt8;
        case PixelType::uint16: return OIIO::TypeUInt16;
        case PixelType::half: return OIIO::TypeHalf;
        case PixelType::float32: break;
    }
    return OIIO::TypeFloat;
}

}  // namespace spectex::io
