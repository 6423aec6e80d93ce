// Relighting as text that OpenColorIO reads: matrices, tables, and configurations that name them.
#pragma once

#include <string>
#include <vector>

#include "spectex/base.h"
#include "spectex/methods.h"
#include "spectex/spectral.h"

namespace spectex::color {

/// What is said of a baked transform, one line each.
using Remarks = std::vector<std::string>;

/// Twelve numbers, no comments: the format has none.
std::string spimtx_text(const Matrix3& m);
/// Entries of the table of square roots that may stand in a cube: up to 1 / 4095 its root is a straight line.
inline constexpr int shaper_entries = 4096;
/// Iridas cube, or DaVinci Resolve's with a one-dimensional table first. It cannot say that its interpolation is tetrahedral; the
/// remarks must.
/// @param table     three values per vertex, the same evenly spaced knots on every axis.
/// @param of_roots  the table is one of the square roots of the colours, which the file takes first.
std::string cube_text(const LatticeTable& table, bool of_roots, const Remarks& remarks);
/// Common LUT Format 3 (SMPTE ST 2136-1), floats, tetrahedral. @param name  the transform's name and, escaped, its id.
std::string clf_text(const Matrix3& m, const std::string& name, const RgbSpace& space, const Remarks& remarks);
/// @param of_roots  the table is one of the square roots of the colours, which the file takes first.
std::string clf_text(const LatticeTable& table, bool of_roots, const std::string& name, const RgbSpace& space, const Remarks& remarks);

/// One illuminant of a configuration.
struct Relight {
    std::string illuminant;  ///< as it may stand in a name of OpenColorIO: without comma, colon, quotes
    std::string file;        ///< CLF beside the configuration
    std::string clf;         ///< its text
    std::string description;
};
/// A configuration with a look and a colour space `Relit NAME` for every entry; views of them where it is one of ours.
/// @param existing  text of a configuration, every entry of which is kept; empty: the library's own is begun with.
/// @param folder    in which the configuration and the tables lie.
/// @param space     linear RGB that the tables take and give.
/// @param label     of messages.
/// @error input, when `existing` cannot be read or connected to; usage, when it has another look or space of such a name.
Result<std::string> config_text(const std::string& existing, const std::string& label, const RgbSpace& space,
                                const std::vector<Relight>& relights);

}  // namespace spectex::color
