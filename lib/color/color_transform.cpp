#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <mutex>

#include "color/icc.h"
#include "color/spaces.h"

namespace spectex {

ColorTransform::~ColorTransform() = default;

namespace {

namespace OCIO = OCIO_NAMESPACE;

// Small enough that the copies of a block stay in the first-level cache.
constexpr std::size_t block = 512;

/// Decoded values of the 65536 codes v = code / 65535, which hold all 8-bit codes too (255 * 257 = 65535): most pixels of
/// integer files are found here instead of computed.
class CodeTable {
public:
    template <class Decode>
    explicit CodeTable(const Decode& decode) : codes_(65536), values_(65536) {
        for (std::size_t i = 0; i < codes_.size(); ++i) {
            codes_[i] = static_cast<float>(static_cast<double>(i) / 65535);
            values_[i] = decode(static_cast<double>(codes_[i]));
        }
    }
    /// The decoded value, or null when v is no code.
    const double* find(float v) const {
        if (!(v >= 0 && v <= 1)) return nullptr;
        const auto i = static_cast<std::size_t>(v * 65535.0f + 0.5f);
        // -0 compares equal to 0 and would lose its sign.
        return codes_[i] == v && !std::signbit(v) ? &values_[i] : nullptr;
    }

private:
    std::vector<float> codes_;
    std::vector<double> values_;
};

/// Stages: [OCIO or ICC tables or curves] -> matrix -> [curves or OCIO], in double except within OCIO.
class StagedTransform final : public ColorTransform {
public:
    TransferCurve decode, encode;
    bool has_matrix = false;
    Matrix3 matrix;
    std::shared_ptr<const color::IccProfile> icc;
    OCIO::ConstCPUProcessorRcPtr before, after;
    bool ocio_per_channel = true;
    std::string description;

    void set_matrix(const Matrix3& m) {
        matrix = m;
        has_matrix = !(m == Matrix3{});
    }
    bool is_identity() const override {
        return !before && !after && !icc && !has_matrix && decode.is_linear() && encode.is_linear();
    }
    bool is_per_channel() const override {
        return !has_matrix && ocio_per_channel && (!icc || icc->is_curves_and_matrix());
    }
    std::string describe() const override { return description; }

    void apply(std::array<float*, 3> rgb, std::size_t n) const override {
        if (is_identity()) return;
        // A call on a whole strip pays for the table; a caller that makes a table of its own by 256 values does not.
        if (n >= 16384) std::call_once(tables_made_, [this] { make_tables(); });
        for (std::size_t first = 0; first < n; first += block) {
            apply_block(rgb, std::min(block, n - first));
            for (auto& plane : rgb) plane += block;
        }
    }

private:
    void make_tables() const {
        if (icc && icc->is_curves_and_matrix())
            for (std::size_t c = 0; c < (icc->is_grey() ? 1u : 3u); ++c)
                tables_.emplace_back([&](double v) { return icc->decode(c, v); });
        else if (!icc && !decode.is_linear())
            tables_.emplace_back([&](double v) { return decode.decode(v); });
        tables_ready_.store(!tables_.empty(), std::memory_order_release);
    }
    void apply_block(const std::array<float*, 3>& rgb, std::size_t n) const {
        // Kept to put NaN and infinities back where clamps, tables and matrices would lose them.
        float kept[3][block];
        bool finite = true;
        for (std::size_t c = 0; c < 3; ++c) {
            std::memcpy(kept[c], rgb[c], n * sizeof(float));
            for (std::size_t i = 0; i < n; ++i) finite = finite && std::isfinite(kept[c][i]);
        }
        if (before) apply_ocio(before, rgb, n);
        if (icc && !icc->is_curves_and_matrix()) {
            float device[3 * block];
            double xyz[3 * block];
            for (std::size_t i = 0; i < n; ++i)
                for (std::size_t c = 0; c < 3; ++c) device[3 * i + c] = rgb[c][i];
            icc->convert(device, xyz, n);
            for (std::size_t i = 0; i < n; ++i) store(rgb, i, matrix * Vector3{xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]});
        } else if (has_matrix) {
            for (std::size_t i = 0; i < n; ++i)
                store(rgb, i, matrix * Vector3{decoded(0, rgb[0][i]), decoded(1, rgb[1][i]), decoded(2, rgb[2][i])});
        } else if (icc || !decode.is_linear() || !encode.is_linear()) {
            for (std::size_t c = 0; c < 3; ++c)
                for (std::size_t i = 0; i < n; ++i)
                    rgb[c][i] = static_cast<float>(encode.encode(decoded(c, rgb[c][i])));
        }
        if (after) apply_ocio(after, rgb, n);
        if (finite) return;
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t i = 0; i < n; ++i)
                if (!std::isfinite(kept[c][i])) rgb[c][i] = kept[c][i];
    }

    double decoded(std::size_t channel, float value) const {
        if (tables_ready_.load(std::memory_order_acquire)) {
            if (const double* known = tables_[std::min(channel, tables_.size() - 1)].find(value)) return *known;
        }
        return icc ? icc->decode(channel, static_cast<double>(value)) : decode.decode(static_cast<double>(value));
    }
    void store(const std::array<float*, 3>& rgb, std::size_t i, const Vector3& v) const {
        for (std::size_t c = 0; c < 3; ++c) rgb[c][i] = static_cast<float>(encode.encode(v[c]));
    }
    static void apply_ocio(const OCIO::ConstCPUProcessorRcPtr& cpu, const std::array<float*, 3>& rgb, std::size_t n) {
        OCIO::PlanarImageDesc image(rgb[0], rgb[1], rgb[2], nullptr, static_cast<long>(n), 1);
        // It throws on a bad image description alone, which this is not.
        cpu->apply(image);
    }

    mutable std::vector<CodeTable> tables_;
    mutable std::once_flag tables_made_;
    mutable std::atomic<bool> tables_ready_{false};
};

std::string curve_name(const TransferCurve& curve) {
    switch (curve.kind) {
        case CurveKind::linear: return "linear";
        case CurveKind::srgb: return "sRGB curve (IEC 61966-2-1)";
        case CurveKind::power: return fmt::format("gamma {:.6g}", curve.exponent);
        case CurveKind::bt709: return "BT.709 camera curve";
        case CurveKind::romm: return "ROMM curve (ISO 22028-2)";
    }
    return {};
}

/// Linear RGB to linear RGB by way of XYZ; identity to the bit for one space.
Result<Matrix3> between(const Matrix3& from_to_xyz, const Vector3& from_white, const Matrix3& to_to_xyz,
                        const Vector3& to_white) {
    if (from_to_xyz == to_to_xyz && from_white == to_white) return Matrix3{};
    const auto adapt = adaptation_matrix(Adaptation::bradford, from_white, to_white);
    if (!adapt) return adapt.error();
    return to_to_xyz.inverse() * *adapt * from_to_xyz;
}

Result<color::EncodedSpace> linear_space(const RgbSpace& space) {
    auto out = color::encoded_space(space, {}, space.name);
    for (const double v : out.to_xyz.inverse().m)
        if (!std::isfinite(v))
            return Error{ErrorKind::usage, fmt::format("RGB space '{}': its primaries lie on one line", space.name)};
    return out;
}

std::string joined(const std::string& a, const std::string& b) { return a.empty() || b.empty() ? a + b : a + ", then " + b; }

}  // namespace

Result<std::unique_ptr<ColorTransform>> ColorTransform::to_linear(const ColorSpaceChoice& from, const ImageHeader& header,
                                                                  const RgbSpace& to) {
    const auto target = linear_space(to);
    if (!target) return target.error();
    auto out = std::make_unique<StagedTransform>();
    const auto matrix_from = [&](const Matrix3& to_xyz, const Vector3& white) -> Status {
        const auto matrix = between(to_xyz, white, target->to_xyz, target->white);
        if (!matrix) return Error{matrix.error().kind, fmt::format("{}: {}", header.path, matrix.error().message)};
        out->set_matrix(*matrix);
        return {};
    };
    const auto matrix_text = [&](std::string_view source) {
        return out->has_matrix ? fmt::format("matrix {} -> linear {}", source, to.name) : std::string{};
    };
    Status status;
    if (from.icc) {
        auto profile = color::IccProfile::read(header.color_hints.icc_profile);
        if (!profile) return Error{ErrorKind::input, fmt::format("{}: {}", header.path, profile.error().message)};
        out->icc = std::move(*profile);
        if (out->icc->is_grey()) {
            // Equal R, G, B are neutral in the target too; no matrix is needed.
            out->description = fmt::format("tone curve of the ICC profile '{}'", out->icc->description());
        } else {
            status = matrix_from(out->icc->to_xyz(), out->icc->white());
            out->description = fmt::format("ICC profile '{}' ({}) -> linear {}", out->icc->description(),
                                           out->icc->is_curves_and_matrix() ? "curves and matrix"
                                                                           : "tables, relative colorimetric, Little CMS",
                                           to.name);
        }
    } else if (from.chromaticities) {
        const auto& c = *from.chromaticities;
        RgbSpace custom{from.name, {{{c[0], c[1]}, {c[2], c[3]}, {c[4], c[5]}}}, {c[6], c[7]}, "", "the file"};
        const auto source = linear_space(custom);
        if (!source) return Error{ErrorKind::input, fmt::format("{}: {}", header.path, source.error().message)};
        status = matrix_from(source->to_xyz, source->white);
        out->description = matrix_text(from.name);
    } else {
        const auto found = color::resolve_space(from.name);
        if (!found) return found.error();
        if (found->own && !found->own->data) {
            out->decode = found->own->curve;
            // A grey image is neutral: the curve alone is the whole conversion.
            if (!header.is_grey()) status = matrix_from(found->own->to_xyz, found->own->white);
            out->description =
                joined(out->decode.is_linear() ? "" : curve_name(out->decode), matrix_text(found->own->name));
        } else if (found->user) {
            const auto cpu = color::user_processor(found->user, found->name, true, &out->ocio_per_channel);
            if (!cpu) return cpu.error();
            out->before = *cpu;
            const auto rec709 = find_rgb_space("BT.709");
            if (!rec709) return rec709.error();
            const auto middle = linear_space(*rec709);
            if (!middle) return middle.error();
            status = matrix_from(middle->to_xyz, middle->white);
            out->description = joined(fmt::format("OCIO: {} -> linear Rec.709", found->name), matrix_text("linear Rec.709"));
        }
    }
    if (!status) return status.error();
    if (out->description.empty()) out->description = "none: already linear " + to.name;
    return std::unique_ptr<ColorTransform>(std::move(out));
}

Result<std::unique_ptr<ColorTransform>> ColorTransform::from_linear(const RgbSpace& from, std::string_view to) {
    const auto source = linear_space(from);
    if (!source) return source.error();
    const auto found = color::resolve_space(to);
    if (!found) return found.error();
    auto out = std::make_unique<StagedTransform>();
    if (found->own && !found->own->data) {
        const auto matrix = between(source->to_xyz, source->white, found->own->to_xyz, found->own->white);
        if (!matrix) return matrix.error();
        out->set_matrix(*matrix);
        out->encode = found->own->curve;
        out->description = joined(out->has_matrix ? fmt::format("matrix linear {} -> {}", from.name, found->own->name) : "",
                                  out->encode.is_linear() ? "" : curve_name(out->encode));
    } else if (found->user) {
        const auto cpu = color::user_processor(found->user, found->name, false, &out->ocio_per_channel);
        if (!cpu) return cpu.error();
        out->after = *cpu;
        const auto rec709 = find_rgb_space("BT.709");
        if (!rec709) return rec709.error();
        const auto middle = linear_space(*rec709);
        if (!middle) return middle.error();
        const auto matrix = between(source->to_xyz, source->white, middle->to_xyz, middle->white);
        if (!matrix) return matrix.error();
        out->set_matrix(*matrix);
        out->description = joined(out->has_matrix ? fmt::format("matrix linear {} -> linear Rec.709", from.name) : "",
                                  fmt::format("OCIO: linear Rec.709 -> {}", found->name));
    }
    if (out->description.empty()) out->description = "none: already " + std::string(to);
    return std::unique_ptr<ColorTransform>(std::move(out));
}

}  // namespace spectex
