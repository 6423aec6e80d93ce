// ICC profiles of files, by Little CMS.
#pragma once

#include <memory>
#include <optional>
#include <span>

#include "color/curves.h"

namespace spectex::color {

/// A file's profile as a conversion to XYZ.
class IccProfile {
public:
    virtual ~IccProfile() = default;
    /// @error input: not a profile, of a device that has neither three colours nor grey, or with curves or colorants that no
    /// RGB space can have; the message says which.
    static Result<std::unique_ptr<IccProfile>> read(std::span<const std::uint8_t> bytes);

    virtual const std::string& description() const = 0;
    /// Our name of the space, when colorants and curves are those of sRGB, Display P3 or Adobe RGB (1998).
    virtual std::string_view known_name() const = 0;
    virtual bool is_grey() const = 0;
    /// One device value to linear light, for a profile that is curves and a matrix.
    virtual bool is_curves_and_matrix() const = 0;
    virtual double decode(std::size_t channel, double encoded) const = 0;
    /// Linear device RGB to XYZ, or identity for the others.
    virtual const Matrix3& to_xyz() const = 0;
    /// White of the XYZ that to_xyz or convert give.
    virtual const Vector3& white() const = 0;
    /// Device [n][3] to XYZ [n][3], for a profile that is tables. Thread safe.
    virtual void convert(const float* rgb, double* xyz, std::size_t n) const = 0;
};

}  // namespace spectex::color
