#include "color/spaces.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <mutex>
#include <sstream>

#include "spectral/names.h"
#include "spectral/numeric.h"

namespace spectex {

std::string_view linear_rec709_name() { return "Linear Rec.709 (sRGB)"; }
std::string_view srgb_name() { return "sRGB - Texture"; }

namespace {

struct LinearName {
    const char* name;
    const char* rgb;
};
constexpr LinearName linear_names[] = {
    {"ACES2065-1", "ACES2065-1"},       {"ACEScg", "ACEScg"},
    {"Linear Rec.709 (sRGB)", "BT.709"}, {"Linear P3-D65", "Display P3"},
    {"Linear Rec.2020", "Rec.2020"},    {"Linear AdobeRGB", "Adobe RGB"},
    {"Linear ProPhoto", "ProPhoto"},    {"Linear PAL-SECAM", "PAL/SECAM"},
};

}  // namespace

std::string_view linear_space_name(const RgbSpace& space) {
    for (const auto& row : linear_names)
        if (const auto known = find_rgb_space(row.rgb);
            known && known->primaries_xy == space.primaries_xy && known->white_xy == space.white_xy)
            return row.name;
    return {};
}

namespace color {

namespace OCIO = OCIO_NAMESPACE;

EncodedSpace encoded_space(const RgbSpace& space, const TransferCurve& curve, std::string name) {
    EncodedSpace out;
    out.name = std::move(name);
    out.white = xyz_from_xy(space.white_xy[0], space.white_xy[1]);
    out.to_xyz = rgb_to_xyz_matrix(space, out.white);
    out.curve = curve;
    return out;
}

const std::vector<EncodedSpace>& own_spaces() {
    static const std::vector<EncodedSpace> spaces = [] {
        std::vector<EncodedSpace> out;
        EncodedSpace xyz;
        xyz.name = "CIE XYZ-D65 - Scene-referred";
        xyz.white = xyz_from_xy(0.3127, 0.3290);
        out.push_back(xyz);
        const auto add = [&out](const char* name, const char* rgb, CurveKind kind, double exponent = 1) {
            if (const auto space = find_rgb_space(rgb)) out.push_back(encoded_space(*space, {kind, exponent}, name));
        };
        for (const auto& row : linear_names) add(row.name, row.rgb, CurveKind::linear);
        add("sRGB - Texture", "BT.709", CurveKind::srgb);
        add("sRGB Encoded P3-D65 - Texture", "Display P3", CurveKind::srgb);
        add("Adobe RGB (1998)", "Adobe RGB", CurveKind::power, 563.0 / 256);
        add("ProPhoto RGB", "ProPhoto", CurveKind::romm);
        add("Camera Rec.709", "BT.709", CurveKind::bt709);
        add("Camera Rec.2020", "Rec.2020", CurveKind::bt709);
        add("Gamma 1.8 Rec.709 - Texture", "BT.709", CurveKind::power, 1.8);
        add("Gamma 2.2 Rec.709 - Texture", "BT.709", CurveKind::power, 2.2);
        add("Gamma 2.4 Rec.709 - Texture", "BT.709", CurveKind::power, 2.4);
        EncodedSpace raw;
        raw.name = "Raw";
        raw.data = true;
        out.push_back(raw);
        return out;
    }();
    return spaces;
}

Result<OCIO::ConstConfigRcPtr> user_config() {
    static std::mutex mutex;
    static std::string kept_path;
    static OCIO::ConstConfigRcPtr kept;
    const char* path = std::getenv("OCIO");
    if (path == nullptr || *path == '\0') return OCIO::ConstConfigRcPtr{};
    const std::lock_guard lock(mutex);
    if (kept && kept_path == path) return kept;
    try {
        auto config = OCIO::Config::CreateFromFile(path);
        config->validate();
        kept = config;
        kept_path = path;
        return config;
    } catch (const std::exception& e) {
        return Error{ErrorKind::input, fmt::format("OCIO configuration '{}', which the environment variable OCIO names, cannot "
                                                   "be used: {}",
                                                   path, e.what())};
    }
}

Result<OCIO::ConstConfigRcPtr> own_config() {
    static const Result<OCIO::ConstConfigRcPtr> config = []() -> Result<OCIO::ConstConfigRcPtr> {
        const auto text = lut_text("ocio/spectex.ocio");
        if (!text) return text.error();
        try {
            std::istringstream in(*text);
            return OCIO::Config::CreateFromStream(in);
        } catch (const std::exception& e) {
            return Error{ErrorKind::input, fmt::format("{}: ocio/spectex.ocio cannot be used: {}",
                                                       lut_origin("ocio/spectex.ocio"), e.what())};
        }
    }();
    return config;
}

namespace {

constexpr auto accurate = OCIO::OPTIMIZATION_LOSSLESS;

void apply_to_pixels(const OCIO::ConstCPUProcessorRcPtr& cpu, std::vector<float>& pixels) {
    OCIO::PackedImageDesc image(pixels.data(), static_cast<long>(pixels.size() / 3), 1, 3);
    cpu->apply(image);
}

/// Colours on which two conversions are told apart: greys, and saturated ones that show crosstalk.
std::vector<float> probe_colors() {
    std::vector<float> probe;
    for (int i = 0; i <= 64; ++i) {
        const float v = static_cast<float>(i) / 64;
        probe.insert(probe.end(), {v, v, v, v, 0.25f, 0, 0, v, 0.25f, 0.25f, 0, v});
    }
    return probe;
}

/// Largest difference over the probe colours between a processor's answer and decoding by one of our spaces to linear
/// Rec.709.
double disagreement(const std::vector<float>& probe, const std::vector<float>& answer, const EncodedSpace& space,
                    const Matrix3& to_rec709) {
    double worst = 0;
    for (std::size_t i = 0; i < probe.size(); i += 3) {
        const Vector3 ours = to_rec709 * Vector3{space.curve.decode(probe[i]), space.curve.decode(probe[i + 1]),
                                                 space.curve.decode(probe[i + 2])};
        for (std::size_t c = 0; c < 3; ++c) {
            const double difference = std::fabs(ours[c] - static_cast<double>(answer[i + c]));
            if (!(difference <= worst)) worst = difference;
        }
    }
    return worst;
}

// OCIO 2.1's sRGB is off by 7.6e-7 and its float matrices by a few 1e-7; the nearest two different curves of ours, gamma
// 2.2 and 563/256, are 1.3e-4 apart.
constexpr double same_space = 1e-5;

}  // namespace

std::optional<Bridge> find_bridge(const OCIO::ConstConfigRcPtr& user) {
    if (user->hasRole(OCIO::ROLE_INTERCHANGE_SCENE)) return Bridge{OCIO::ROLE_INTERCHANGE_SCENE, "ACES2065-1"};
    for (const auto& [name, own] : {std::pair{"ACES2065-1", "ACES2065-1"}, {"ACES - ACES2065-1", "ACES2065-1"},
                                    {"lin_ap0", "ACES2065-1"}, {"ACEScg", "ACEScg"}, {"ACES - ACEScg", "ACEScg"},
                                    {"lin_ap1", "ACEScg"}, {"Linear Rec.709 (sRGB)", "Linear Rec.709 (sRGB)"},
                                    {"lin_rec709", "Linear Rec.709 (sRGB)"}, {"lin_srgb", "Linear Rec.709 (sRGB)"},
                                    {"Utility - Linear - sRGB", "Linear Rec.709 (sRGB)"}})
        if (user->getColorSpace(name)) return Bridge{name, own};
    if (!user->hasRole(OCIO::ROLE_SCENE_LINEAR)) return std::nullopt;
    for (const char* name : {"sRGB - Texture", "sRGB", "srgb_tx", "srgb_texture", "Utility - sRGB - Texture"}) {
        if (!user->getColorSpace(name)) continue;
        const auto cpu = user->getProcessor(name, OCIO::ROLE_SCENE_LINEAR)->getOptimizedCPUProcessor(accurate);
        const auto probe = probe_colors();
        auto answer = probe;
        apply_to_pixels(cpu, answer);
        EncodedSpace srgb;
        srgb.curve.kind = CurveKind::srgb;
        // Version 1 configurations tabulate the curve: 1e-3 tells sRGB from gamma 2.2 (7e-3 apart) and from other primaries.
        if (disagreement(probe, answer, srgb, Matrix3{}) < 1e-3)
            return Bridge{OCIO::ROLE_SCENE_LINEAR, "Linear Rec.709 (sRGB)"};
    }
    return std::nullopt;
}

namespace {

const EncodedSpace* own_space_named(std::string_view name) {
    for (const auto& space : own_spaces())
        if (space.name == name) return &space;
    return nullptr;
}

/// The formula among ours that a space of the user's configuration computes, if any.
const EncodedSpace* recognized(const OCIO::ConstCPUProcessorRcPtr& cpu) {
    const auto probe = probe_colors();
    auto answer = probe;
    apply_to_pixels(cpu, answer);
    const auto* rec709 = own_space_named(linear_rec709_name());
    if (rec709 == nullptr) return nullptr;
    for (const auto& space : own_spaces()) {
        if (space.data) continue;
        const auto adapt = adaptation_matrix(Adaptation::bradford, space.white, rec709->white);
        if (adapt && disagreement(probe, answer, space, rec709->to_xyz.inverse() * *adapt * space.to_xyz) < same_space)
            return &space;
    }
    return nullptr;
}

std::size_t edit_distance(const std::string& a, const std::string& b) {
    std::vector<std::size_t> row(b.size() + 1);
    for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
    for (std::size_t i = 1; i <= a.size(); ++i) {
        std::size_t diagonal = row[0];
        row[0] = i;
        for (std::size_t j = 1; j <= b.size(); ++j) {
            const std::size_t changed = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
            diagonal = row[j];
            row[j] = std::min({changed, row[j] + 1, row[j - 1] + 1});
        }
    }
    return row[b.size()];
}

std::string near_names(std::string_view name, const std::vector<OCIO::ConstConfigRcPtr>& configs) {
    struct Candidate {
        double distance;
        std::string name;
    };
    std::vector<Candidate> candidates;
    // A hostile option must not make the quadratic comparison expensive.
    const auto wanted = folded_name(name.substr(0, 200));
    for (const auto& config : configs) {
        if (!config) continue;
        for (int i = 0; i < config->getNumColorSpaces(); ++i) {
            const char* canonical = config->getColorSpaceNameByIndex(i);
            const auto space = config->getColorSpace(canonical);
            if (!space) continue;
            double best = 1e9;
            const auto consider = [&](const char* spelling) {
                const auto folded = folded_name(spelling);
                if (folded.empty()) return;
                double d = static_cast<double>(edit_distance(wanted, folded)) /
                           static_cast<double>(std::max(wanted.size(), folded.size()));
                if (wanted.size() >= 3 && (folded.find(wanted) != std::string::npos)) d = std::min(d, 0.3);
                best = std::min(best, d);
            };
            consider(canonical);
            for (std::size_t a = 0; a < space->getNumAliases(); ++a) consider(space->getAlias(a));
            if (std::none_of(candidates.begin(), candidates.end(), [&](const auto& c) { return c.name == canonical; }))
                candidates.push_back({best, canonical});
        }
    }
    std::stable_sort(candidates.begin(), candidates.end(), [](const auto& a, const auto& b) { return a.distance < b.distance; });
    std::string out;
    const std::size_t most = !candidates.empty() && candidates.front().distance <= 0.5 ? 5 : 30;
    for (std::size_t i = 0; i < std::min(most, candidates.size()); ++i)
        out += (i == 0 ? "'" : ", '") + candidates[i].name + "'";
    return out;
}

std::optional<Resolution> resolve_own(std::string_view name, const OCIO::ConstConfigRcPtr& config) {
    const auto from_name = [](const char* canonical) -> std::optional<Resolution> {
        if (const auto* space = own_space_named(canonical)) return Resolution{space->name, *space, {}, {}};
        return std::nullopt;
    };
    if (const auto space = config->getColorSpace(std::string(name).c_str())) return from_name(space->getName());
    const auto folded = folded_name(name);
    if (folded.empty()) return std::nullopt;
    for (int i = 0; i < config->getNumColorSpaces(); ++i) {
        const auto space = config->getColorSpace(config->getColorSpaceNameByIndex(i));
        if (folded == folded_name(space->getName())) return from_name(space->getName());
        for (std::size_t a = 0; a < space->getNumAliases(); ++a)
            if (folded == folded_name(space->getAlias(a))) return from_name(space->getName());
    }
    // Pure gammas as files declare them: "Gamma2.2", "GammaCorrected2.2" (OIIO), "gamma 1.96".
    for (const std::string_view prefix : {"gammacorrected", "gamma"})
        if (folded.starts_with(prefix)) {
            const auto digits = name.find_first_of("+-0123456789.");
            const auto gamma = digits == std::string_view::npos ? std::nullopt : parse_number(name.substr(digits));
            const auto rec709 = find_rgb_space("BT.709");
            if (gamma && *gamma >= 0.1 && *gamma <= 10 && rec709) {
                if (*gamma == 1) return from_name("Linear Rec.709 (sRGB)");
                for (const auto& space : own_spaces())
                    if (space.curve == TransferCurve{CurveKind::power, *gamma} && space.name.starts_with("Gamma"))
                        return Resolution{space.name, space, {}, {}};
                auto title = fmt::format("Gamma {:g}", *gamma);
                auto space = encoded_space(*rec709, {CurveKind::power, *gamma}, title);
                return Resolution{title, space, {}, "a pure gamma with the primaries of Rec.709"};
            }
        }
    for (const std::string_view prefix : {"linear", "lin", ""})
        if (folded.starts_with(prefix))
            if (const auto space = find_rgb_space(folded.substr(prefix.size())))
                if (const auto linear = linear_space_name(*space); !linear.empty()) {
                    auto found = from_name(std::string(linear).c_str());
                    if (found && prefix.empty()) found->note = "the name of RGB primaries, taken as linear";
                    return found;
                }
    return std::nullopt;
}

}  // namespace

Result<OCIO::ConstCPUProcessorRcPtr> user_processor(const OCIO::ConstConfigRcPtr& user, const std::string& name,
                                                    bool to_rec709, bool* per_channel) {
    const auto own = own_config();
    if (!own) return own.error();
    try {
        const auto bridge = find_bridge(user);
        if (!bridge)
            return Error{ErrorKind::input,
                         fmt::format("the OCIO configuration has neither the role aces_interchange nor a space known as ACES2065-1, "
                                     "ACEScg or linear Rec.709: '{}' cannot be converted",
                                     name)};
        const std::string rec709(linear_rec709_name());
        const auto processor =
            to_rec709 ? OCIO::Config::GetProcessorFromConfigs(user, name.c_str(), bridge->user.c_str(), *own, rec709.c_str(),
                                                              bridge->own.c_str())
                      : OCIO::Config::GetProcessorFromConfigs(*own, rec709.c_str(), bridge->own.c_str(), user, name.c_str(),
                                                              bridge->user.c_str());
        const auto cpu = processor->getOptimizedCPUProcessor(OCIO::BIT_DEPTH_F32, OCIO::BIT_DEPTH_F32, accurate);
        if (per_channel != nullptr) *per_channel = !cpu->hasChannelCrosstalk();
        return cpu;
    } catch (const std::exception& e) {
        return Error{ErrorKind::input, fmt::format("OCIO cannot convert '{}' {} linear Rec.709: {}", name,
                                                   to_rec709 ? "to" : "from", e.what())};
    }
}

Result<Resolution> resolve_space(std::string_view name) {
    const auto user = user_config();
    if (!user) return user.error();
    const auto own = own_config();
    if (!own) return own.error();
    try {
        const auto ours = resolve_own(name, *own);
        if (*user)
            if (const auto space = (*user)->getColorSpace(std::string(name).c_str())) {
                Resolution found{space->getName(), {}, *user, {}};
                if (space->isData()) {
                    EncodedSpace raw;
                    raw.name = found.name;
                    raw.data = true;
                    return Resolution{found.name, raw, {}, "data of $OCIO"};
                }
                const auto cpu = user_processor(*user, found.name, true);
                if (!cpu) {
                    if (!ours) return cpu.error();
                    auto fallback = *ours;
                    fallback.note = "the library's own, since $OCIO cannot connect its space of that name";
                    return fallback;
                }
                if (const auto* known = recognized(*cpu)) {
                    found.own = *known;
                    found.user = nullptr;
                    if (known->name != found.name) found.note = fmt::format("computes {}", known->name);
                }
                return found;
            }
        if (ours) return *ours;
        return Error{ErrorKind::usage, fmt::format("colour space '{}' is not known; near names: {}", name,
                                                   near_names(name, {*user, *own}))};
    } catch (const std::exception& e) {
        return Error{ErrorKind::input, fmt::format("colour space '{}': {}", name, e.what())};
    }
}

}  // namespace color
}  // namespace spectex
