#include "color/icc.h"

#include <fmt/format.h>
#include <lcms2.h>

#include <limits>
#include <vector>

#include "color/spaces.h"

namespace spectex::color {
namespace {

struct ContextDeleter {
    void operator()(void* context) const { cmsDeleteContext(static_cast<cmsContext>(context)); }
};
struct ProfileDeleter {
    void operator()(void* profile) const { cmsCloseProfile(profile); }
};
struct TransformDeleter {
    void operator()(void* transform) const { cmsDeleteTransform(transform); }
};
struct CurveDeleter {
    void operator()(cmsToneCurve* curve) const { cmsFreeToneCurve(curve); }
};

class Profile final : public IccProfile {
public:
    Status open(std::span<const std::uint8_t> bytes) {
        const auto wrong = [](std::string why) { return Error{ErrorKind::input, "the ICC profile " + std::move(why)}; };
        if (bytes.size() < 132 || bytes.size() > std::numeric_limits<cmsUInt32Number>::max())
            return wrong(fmt::format("has {} bytes and is no profile", bytes.size()));
        context_.reset(cmsCreateContext(nullptr, nullptr));
        if (!context_) return wrong("cannot be read: out of memory");
        const auto context = static_cast<cmsContext>(context_.get());
        profile_.reset(cmsOpenProfileFromMemTHR(context, bytes.data(), static_cast<cmsUInt32Number>(bytes.size())));
        if (!profile_) return wrong("is damaged");
        read_description();
        const auto named = fmt::format("'{}' ", description_);
        const auto device = cmsGetDeviceClass(profile_.get());
        if (device != cmsSigInputClass && device != cmsSigDisplayClass && device != cmsSigOutputClass &&
            device != cmsSigColorSpaceClass)
            return wrong(named + "describes no device");
        const auto space = cmsGetColorSpace(profile_.get());
        if (space != cmsSigRgbData && space != cmsSigGrayData) return wrong(named + "is neither of RGB nor of grey");
        grey_ = space == cmsSigGrayData;
        if (grey_) {
            if (!take_curves({cmsSigGrayTRCTag, cmsSigGrayTRCTag, cmsSigGrayTRCTag}))
                return wrong(named + "has no usable tone curve");
            // A neutral is a neutral whatever the primaries: R = G = B carries it through.
            const auto rec709 = find_rgb_space("BT.709");
            if (!rec709) return rec709.error();
            white_ = xyz_from_xy(rec709->white_xy[0], rec709->white_xy[1]);
            to_xyz_ = rgb_to_xyz_matrix(*rec709, white_);
            recognize();
            return {};
        }
        // A profile with tables says more by them than by its colorants, so they are preferred, as ICC.1 8.10.2 has it.
        // Little CMS takes A2B0 where the table of the intent is missing.
        tables_ = cmsIsCLUT(profile_.get(), INTENT_RELATIVE_COLORIMETRIC, LCMS_USED_AS_INPUT) != 0 ||
                  cmsIsTag(profile_.get(), cmsSigAToB0Tag) != 0;
        if (!tables_) {
            if (!take_colorants()) return wrong(named + "has no usable colorants");
            if (!take_curves({cmsSigRedTRCTag, cmsSigGreenTRCTag, cmsSigBlueTRCTag}))
                return wrong(named + "has no usable tone curves");
            recognize();
            return {};
        }
        const std::unique_ptr<void, ProfileDeleter> xyz(cmsCreateXYZProfileTHR(context));
        if (xyz)
            transform_.reset(cmsCreateTransformTHR(context, profile_.get(), TYPE_RGB_FLT, xyz.get(), TYPE_XYZ_DBL,
                                                   INTENT_RELATIVE_COLORIMETRIC, cmsFLAGS_NOOPTIMIZE | cmsFLAGS_NOCACHE));
        if (!transform_) return wrong(named + "has tables that cannot be used");
        white_ = {cmsD50_XYZ()->X, cmsD50_XYZ()->Y, cmsD50_XYZ()->Z};
        return {};
    }

    const std::string& description() const override { return description_; }
    std::string_view known_name() const override { return known_; }
    bool is_grey() const override { return grey_; }
    bool is_curves_and_matrix() const override { return !tables_; }
    const Matrix3& to_xyz() const override { return to_xyz_; }
    const Vector3& white() const override { return white_; }

    double decode(std::size_t channel, double encoded) const override {
        const double v = std::fabs(encoded);
        if (!std::isfinite(v)) return encoded;
        const auto& table = entries_[channel];
        if (table.empty())
            return std::copysign(static_cast<double>(cmsEvalToneCurveFloat(curves_[channel].get(), static_cast<float>(v))), encoded);
        // Little CMS rounds the result of a table to 16 bits, a fortieth of an 8-bit code's light in the shadows.
        const double position = std::min(v, 1.0) * static_cast<double>(table.size() - 1);
        const auto i = std::min(static_cast<std::size_t>(position), table.size() - 2);
        const double t = position - static_cast<double>(i);
        return std::copysign(((1 - t) * table[i] + t * table[i + 1]) / 65535, encoded);
    }

    void convert(const float* rgb, double* xyz, std::size_t n) const override {
        cmsDoTransform(transform_.get(), rgb, xyz, static_cast<cmsUInt32Number>(n));
    }

private:
    void read_description() {
        char text[256] = {};
        cmsGetProfileInfoASCII(profile_.get(), cmsInfoDescription, "en", "US", text, sizeof text);
        // What a file calls itself goes to terminals and reports: printable characters only.
        for (const char* c = text; c < text + sizeof text && *c != '\0'; ++c)
            if (*c >= ' ' && *c < 127) description_ += *c;
        if (description_.empty()) description_ = "unnamed";
    }

    bool take_curves(const std::array<cmsTagSignature, 3>& tags) {
        for (std::size_t c = 0; c < 3; ++c) {
            const auto* curve = static_cast<const cmsToneCurve*>(cmsReadTag(profile_.get(), tags[c]));
            if (curve == nullptr) return false;
            curves_[c].reset(cmsDupToneCurve(curve));
            if (!curves_[c]) return false;
            if (cmsGetToneCurveParametricType(curve) == 0) {
                const auto count = cmsGetToneCurveEstimatedTableEntries(curve);
                const auto* values = cmsGetToneCurveEstimatedTable(curve);
                if (count < 2 || values == nullptr) return false;
                entries_[c].assign(values, values + count);
            }
            // A decoding that falls, or that does not span about 0 to 1, is damage rather than an encoding.
            double before = -1e-3;
            for (int i = 0; i <= 256; ++i) {
                const double value = decode(c, i / 256.0);
                if (!(value >= before - 1e-6) || !(value <= 1.01)) return false;
                before = value;
            }
            if (before < 0.5 || decode(c, 0) > 0.1) return false;
        }
        return true;
    }

    bool take_colorants() {
        const cmsTagSignature tags[] = {cmsSigRedColorantTag, cmsSigGreenColorantTag, cmsSigBlueColorantTag};
        white_ = {0, 0, 0};
        for (std::size_t j = 0; j < 3; ++j) {
            const auto* xyz = static_cast<const cmsCIEXYZ*>(cmsReadTag(profile_.get(), tags[j]));
            if (xyz == nullptr) return false;
            const double column[] = {xyz->X, xyz->Y, xyz->Z};
            for (std::size_t i = 0; i < 3; ++i) {
                if (!std::isfinite(column[i]) || std::fabs(column[i]) > 4) return false;
                to_xyz_(i, j) = column[i];
                white_[i] += column[i];
            }
        }
        // The colorants' own sum is taken as the white, so that equal R, G, B stay neutral in spite of the profile's 16-bit
        // rounding, and in spite of writers that left the colorants unadapted.
        const double luminance = white_[1];
        if (!(luminance > 0.5) || !(luminance < 2)) return false;
        for (auto& v : to_xyz_.m) v /= luminance;
        for (auto& v : white_) v /= luminance;
        const auto inverse = to_xyz_.inverse();
        for (const double v : inverse.m)
            if (!std::isfinite(v) || std::fabs(v) > 1e3) return false;
        return white_[0] > 0.5 && white_[0] < 2 && white_[2] > 0.2 && white_[2] < 3;
    }

    /// Profiles of the common spaces come rounded to 16 bits and with tabulated curves; the space itself is meant.
    void recognize() {
        const Vector3 d50{cmsD50_XYZ()->X, cmsD50_XYZ()->Y, cmsD50_XYZ()->Z};
        for (const auto& space : own_spaces()) {
            const bool srgb = space.name == srgb_name();
            if (!srgb && space.name != "sRGB Encoded P3-D65 - Texture" && space.name != "Adobe RGB (1998)") continue;
            if (grey_ && !srgb) continue;
            bool same = true;
            if (!grey_) {
                const auto adapt = adaptation_matrix(Adaptation::bradford, space.white, d50);
                if (!adapt) continue;
                const auto colorants = *adapt * space.to_xyz;
                // Published sRGB profiles differ among themselves by 3e-4; Adobe RGB and Display P3 are 0.1 away.
                for (std::size_t i = 0; i < 9; ++i) same = same && std::fabs(colorants.m[i] - to_xyz_.m[i]) < 1e-3;
            }
            for (std::size_t c = 0; c < 3 && same; ++c)
                for (int i = 0; i <= 255; ++i)
                    // Tables of 1024 entries are within 1e-4, the shortest in use (26) within 7e-4; a gamma of 2.2 is 7e-3 from
                    // sRGB.
                    if (!(std::fabs(decode(c, i / 255.0) - space.curve.decode(i / 255.0)) < 1e-3)) same = false;
            if (same) {
                known_ = space.name;
                return;
            }
        }
    }

    std::unique_ptr<void, ContextDeleter> context_;
    std::unique_ptr<void, ProfileDeleter> profile_;
    std::unique_ptr<void, TransformDeleter> transform_;
    std::array<std::unique_ptr<cmsToneCurve, CurveDeleter>, 3> curves_;
    std::array<std::vector<double>, 3> entries_;
    std::string description_, known_;
    Matrix3 to_xyz_;
    Vector3 white_{1, 1, 1};
    bool grey_ = false, tables_ = false;
};

}  // namespace

Result<std::unique_ptr<IccProfile>> IccProfile::read(std::span<const std::uint8_t> bytes) {
    auto profile = std::make_unique<Profile>();
    if (const auto status = profile->open(bytes); !status) return status.error();
    return std::unique_ptr<IccProfile>(std::move(profile));
}

}  // namespace spectex::color
