// Names to colour spaces: the library's own, known by formula, and those of the user's configuration in $OCIO.
#pragma once

#include <OpenColorIO/OpenColorIO.h>

#include <memory>
#include <optional>

#include "color/curves.h"

namespace spectex::color {

/// A space known by formula: a curve per channel, then a matrix to XYZ relative to its white.
struct EncodedSpace {
    std::string name;
    Matrix3 to_xyz;
    Vector3 white{1, 1, 1};
    TransferCurve curve;
    bool data = false;  ///< numbers without colour: passed on as they are
};

EncodedSpace encoded_space(const RgbSpace& space, const TransferCurve& curve, std::string name);

/// Every space of luts/ocio/spectex.ocio in its order.
const std::vector<EncodedSpace>& own_spaces();

/// What a name stands for: one of our formulas, or a space of the user's configuration.
struct Resolution {
    std::string name;  ///< canonical
    std::optional<EncodedSpace> own;
    OCIO_NAMESPACE::ConstConfigRcPtr user;  ///< set when the space is defined there and by no formula of ours
    std::string note;  ///< how the name was understood, when that is worth telling
};

/// The configuration that $OCIO names, or null when it is unset. Kept, for as long as $OCIO keeps its value.
/// @error input, naming the file.
Result<OCIO_NAMESPACE::ConstConfigRcPtr> user_config();
/// luts/ocio/spectex.ocio.
Result<OCIO_NAMESPACE::ConstConfigRcPtr> own_config();

/// Looks for a name in $OCIO's configuration, then in ours, in spellings without regard for case and punctuation, as
/// `gamma 2.2`, as `linear X` or as the name of an RgbSpace. A space of $OCIO that computes what one of ours does is
/// replaced by ours, which is exact.
/// @error usage with near names; input when $OCIO cannot be read, or when it has the name but nothing to connect it by.
Result<Resolution> resolve_space(std::string_view name);

/// A pair of names, one in the user's configuration and one in ours, that mean the same space.
struct Bridge {
    std::string user, own;
};
/// Where the two configurations meet: the interchange role, else a space whose name leaves no doubt, else scene_linear
/// when a space named as sRGB decodes to it by the curve of sRGB alone (so its primaries are those of sRGB). May throw as
/// OpenColorIO does.
std::optional<Bridge> find_bridge(const OCIO_NAMESPACE::ConstConfigRcPtr& user);

/// A CPU processor between a space of the user's configuration and linear Rec.709. In float, without the optimisations
/// that trade accuracy.
Result<OCIO_NAMESPACE::ConstCPUProcessorRcPtr> user_processor(const OCIO_NAMESPACE::ConstConfigRcPtr& user,
                                                              const std::string& name, bool to_rec709,
                                                              bool* per_channel = nullptr);

}  // namespace spectex::color
