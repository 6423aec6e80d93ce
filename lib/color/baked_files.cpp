#include "color/baked_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <sstream>

#include "color/spaces.h"
#include "spectex/color.h"

namespace spectex::color {

namespace OCIO = OCIO_NAMESPACE;

namespace {

std::string xml_escaped(std::string_view text) {
    std::string out;
    for (const char c : text) switch (c) {
        case '&': out += "&amp;"; break;
        case '<': out += "&lt;"; break;
        case '>': out += "&gt;"; break;
        case '"': out += "&quot;"; break;
        default: out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
        }
    return out;
}

std::string clf_document(const std::string& name, const RgbSpace& space, const Remarks& remarks, const std::string& node) {
    std::string out = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n";
    out += fmt::format("<ProcessList compCLFversion=\"3\" id=\"spectex {0}\" name=\"{0}\">\n", xml_escaped(name));
    for (const auto& remark : remarks) out += fmt::format("    <Description>{}</Description>\n", xml_escaped(remark));
    out += fmt::format("    <InputDescriptor>linear {0}</InputDescriptor>\n    <OutputDescriptor>linear {0}</OutputDescriptor>\n",
                       xml_escaped(space.name));
    return out + node + "</ProcessList>\n";
}

/// The shortest text that reads back as the same float, which is what OpenColorIO keeps.
void append_row(std::string& out, const double* v, std::size_t n) {
    for (std::size_t i = 0; i < n; ++i) fmt::format_to(std::back_inserter(out), "{}{}", i ? " " : "", static_cast<float>(v[i]));
    out += '\n';
}

/// A scalar in double quotes, as YAML and JSON share.
std::string quoted(std::string_view text) {
    std::string out = "\"";
    for (const char c : text) {
        if (c == '"' || c == '\\') out += '\\';
        out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
    }
    return out + '"';
}

std::string matrix_node(const Matrix3& m) {
    std::string numbers;
    for (std::size_t i = 0; i < 3; ++i) numbers += fmt::format("{}, {}, {}, 0, ", m(i, 0), m(i, 1), m(i, 2));
    return fmt::format("!<MatrixTransform> {{matrix: [{}0, 0, 0, 1]}}", numbers);
}

const EncodedSpace* own_space(std::string_view name) {
    for (const auto& space : own_spaces())
        if (space.name == name) return &space;
    return nullptr;
}

/// A space of a configuration in which the tables' RGB is reached by a matrix, or is there already.
struct Entrance {
    std::string name;
    std::optional<Matrix3> to_model;
};

Result<Entrance> entrance(const OCIO::ConstConfigRcPtr& config, const std::string& label, const RgbSpace& space) {
    const std::string linear(linear_space_name(space));
    if (const auto found = linear.empty() ? nullptr : config->getColorSpace(linear.c_str())) return Entrance{found->getName(), {}};
    const auto bridge = find_bridge(config);
    const auto* from = bridge ? own_space(bridge->own) : nullptr;
    if (from == nullptr)
        return Error{ErrorKind::input, fmt::format("{}: has neither the role aces_interchange nor a space known as ACES2065-1, ACEScg "
                                                   "or linear Rec.709: expected one, to connect the relit colours by",
                                                   label)};
    const auto to = encoded_space(space, {}, linear);
    const auto adapt = adaptation_matrix(Adaptation::bradford, from->white, to.white);
    if (!adapt) return adapt.error();
    const auto connected = config->getColorSpace(bridge->user.c_str());
    Entrance result{connected ? connected->getName() : bridge->user, {}};
    if (from->name != linear) result.to_model = to.to_xyz.inverse() * *adapt * from->to_xyz;
    return result;
}

/// A space that is the scene's reference itself: it has no transform.
std::string reference_space(const OCIO::ConstConfigRcPtr& config) {
    for (int i = 0; i < config->getNumColorSpaces(); ++i) {
        const auto space = config->getColorSpace(config->getColorSpaceNameByIndex(i));
        if (space && !space->isData() && space->getReferenceSpaceType() == OCIO::REFERENCE_SPACE_SCENE &&
            !space->getTransform(OCIO::COLORSPACE_DIR_TO_REFERENCE) && !space->getTransform(OCIO::COLORSPACE_DIR_FROM_REFERENCE))
            return space->getName();
    }
    return {};
}

/// Children of a group, one per line.
std::string children(const std::vector<std::string>& nodes, const std::string& indent) {
    std::string out = "!<GroupTransform>\n" + indent + "children:\n";
    for (const auto& node : nodes) out += indent + "  - " + node + "\n";
    return out;
}

/// Where a line begins that is `wanted` (or only starts so).
std::size_t line_of(const std::string& text, const std::string& wanted, bool whole) {
    for (std::size_t at = 0; at < text.size();) {
        const auto end = std::min(text.find('\n', at), text.size());
        std::string_view line(text.data() + at, end - at);
        if (whole)
            while (!line.empty() && (line.back() == ' ' || line.back() == '\r')) line.remove_suffix(1);
        if (whole ? line == wanted : line.starts_with(wanted)) return at;
        at = end + 1;
    }
    return std::string::npos;
}

/// Lets a configuration look for files beside itself too. False where the text is laid out in another way.
bool search_beside(std::string& text, const OCIO::ConstConfigRcPtr& config) {
    for (int i = 0; i < config->getNumSearchPaths(); ++i)
        if (std::string_view(config->getSearchPath(i)) == ".") return true;
    const auto at = line_of(text, "search_path:", false);
    if (at == std::string::npos) {
        const auto version = line_of(text, "ocio_profile_version:", false);
        if (version == std::string::npos) return false;
        text.insert(text.find('\n', version) + 1, "search_path: .\n");
        return true;
    }
    const auto end = std::min(text.find('\n', at), text.size());
    std::string value = text.substr(at + 12, end - at - 12);
    value.erase(0, std::min(value.find_first_not_of(' '), value.size()));
    while (!value.empty() && (value.back() == ' ' || value.back() == '\r')) value.pop_back();
    if (value == "\"\"" || value == "''") value = ".";
    else if (value.empty() || value.find_first_of("\"'[#") != std::string::npos) return false;
    else value += ":.";
    text.replace(at, end - at, "search_path: " + value);
    return true;
}

/// Puts items at the head of a top-level block list, before its first item and with its indentation; a list that is not
/// there is begun before `before`. False where the text is laid out in another way.
bool insert_items(std::string& text, const std::string& key, const std::string& before, const std::string& items) {
    const auto indented = [&](std::size_t by) {
        std::string out;
        std::istringstream lines(items);
        for (std::string line; std::getline(lines, line);) out += (line.empty() ? "" : std::string(by, ' ') + line) + "\n";
        return out;
    };
    const auto at = line_of(text, key + ":", true);
    if (at == std::string::npos) {
        if (line_of(text, key + ":", false) != std::string::npos || before.empty()) return false;
        const auto place = line_of(text, before + ":", false);
        if (place == std::string::npos) return false;
        text.insert(place, key + ":\n" + indented(2) + "\n");
        return true;
    }
    const auto begin = std::min(text.find('\n', at), text.size() - 1) + 1;
    auto item = text.find_first_not_of(" \r\n", begin);
    while (item != std::string::npos && text[item] == '#') {
        item = text.find('\n', item);
        if (item != std::string::npos) item = text.find_first_not_of(" \r\n", item);
    }
    if (item == std::string::npos || text[item] != '-') return false;
    const auto line = text.rfind('\n', item) + 1;
    text.insert(begin, indented(item - line) + "\n");
    return true;
}

OCIO::ConstConfigRcPtr config_of(const std::string& text) {
    std::istringstream in(text);
    auto config = OCIO::Config::CreateFromStream(in);
    config->validate();
    return config;
}

/// In OpenColorIO's own layout, files beside it included.
std::string serialized(const OCIO::ConstConfigRcPtr& config) {
    const auto copy = config->createEditableCopy();
    copy->addSearchPath(".");
    std::ostringstream out;
    copy->serialize(out);
    return out.str();
}

/// The first thing of `old` that is not in `now`, or nothing.
std::string lost(const OCIO::ConstConfigRcPtr& old, const OCIO::ConstConfigRcPtr& now) {
    for (int i = 0; i < old->getNumColorSpaces(); ++i)
        if (!now->getColorSpace(old->getColorSpaceNameByIndex(i))) return old->getColorSpaceNameByIndex(i);
    for (int i = 0; i < old->getNumLooks(); ++i)
        if (!now->getLook(old->getLookNameByIndex(i))) return old->getLookNameByIndex(i);
    for (int i = 0; i < old->getNumRoles(); ++i)
        if (!now->hasRole(old->getRoleName(i))) return old->getRoleName(i);
    for (int d = 0; d < old->getNumDisplays(); ++d) {
        const char* display = old->getDisplay(d);
        if (now->getNumViews(display) < old->getNumViews(display)) return display;
    }
    return {};
}

// A line of luts/ocio/spectex.ocio: configurations that hold it are ours, and get views.
constexpr std::string_view own_view = "    - !<View> {name: Raw, colorspace: Raw}\n";

}  // namespace

std::string spimtx_text(const Matrix3& m) {
    std::string out;
    for (std::size_t i = 0; i < 3; ++i) out += fmt::format("{} {} {} 0\n", m(i, 0), m(i, 1), m(i, 2));
    return out;
}

std::string cube_text(const LatticeTable& table, bool of_roots, const Remarks& remarks) {
    std::string out;
    for (const auto& remark : remarks) out += "# " + remark + "\n";
    const std::size_t n = table.knots[0].size();
    if (of_roots) {
        out += fmt::format("\nLUT_1D_SIZE {}\nLUT_1D_INPUT_RANGE 0 1\nLUT_3D_SIZE {}\nLUT_3D_INPUT_RANGE 0 1\n", shaper_entries, n);
        for (int i = 0; i < shaper_entries; ++i) {
            const double root = std::sqrt(static_cast<double>(i) / (shaper_entries - 1)), row[] = {root, root, root};
            append_row(out, row, 3);
        }
    } else {
        out += fmt::format("\nLUT_3D_SIZE {}\nDOMAIN_MIN 0 0 0\nDOMAIN_MAX 1 1 1\n", n);
    }
    // Red is the fastest here, the slowest in the table.
    for (std::size_t b = 0; b < n; ++b)
        for (std::size_t g = 0; g < n; ++g)
            for (std::size_t r = 0; r < n; ++r) append_row(out, &table.vertices[3 * ((r * n + g) * n + b)], 3);
    return out;
}

std::string clf_text(const Matrix3& m, const std::string& name, const RgbSpace& space, const Remarks& remarks) {
    std::string node = "    <Matrix inBitDepth=\"32f\" outBitDepth=\"32f\">\n        <Array dim=\"3 3\">\n";
    for (std::size_t i = 0; i < 3; ++i) node += fmt::format("{} {} {}\n", m(i, 0), m(i, 1), m(i, 2));
    return clf_document(name, space, remarks, node + "        </Array>\n    </Matrix>\n");
}

std::string clf_text(const LatticeTable& table, bool of_roots, const std::string& name, const RgbSpace& space, const Remarks& remarks) {
    const std::size_t n = table.knots[0].size();
    std::string node;
    if (of_roots)
        node += "    <Exponent inBitDepth=\"32f\" outBitDepth=\"32f\" style=\"basicFwd\">\n"
                "        <ExponentParams exponent=\"0.5\"/>\n    </Exponent>\n";
    node += "    <LUT3D inBitDepth=\"32f\" outBitDepth=\"32f\" interpolation=\"tetrahedral\">\n";
    node += fmt::format("        <Array dim=\"{0} {0} {0} 3\">\n", n);
    for (std::size_t v = 0; v < n * n * n; ++v) append_row(node, &table.vertices[3 * v], 3);
    return clf_document(name, space, remarks, node + "        </Array>\n    </LUT3D>\n");
}

Result<std::string> config_text(const std::string& existing, const std::string& label, const RgbSpace& space,
                                const std::vector<Relight>& relights) {
    std::string text = existing;
    if (text.empty()) {
        const auto own = lut_text("ocio/spectex.ocio");
        if (!own) return own.error();
        text = *own;
        // Its first line says how the library's copy is made, which does not hold for this one.
        if (text.starts_with('#')) text.erase(0, text.find('\n') + 1);
        text.insert(0, "# Relighting without a plug-in: looks and colour spaces `Relit NAME`.\n");
    }
    try {
        const auto old = config_of(text);
        const auto way = entrance(old, label, space);
        if (!way) return way.error();
        const auto reference = reference_space(old);
        const bool first_version = old->getMajorVersion() < 2;
        std::string looks, spaces, views;
        for (const auto& relight : relights) {
            const std::string name = "Relit " + relight.illuminant;
            std::vector<std::string> chain;
            if (way->to_model) chain.push_back(matrix_node(*way->to_model));
            chain.push_back(fmt::format("!<FileTransform> {{src: {}, interpolation: tetrahedral}}", quoted(relight.file)));
            if (way->to_model) chain.push_back(matrix_node(way->to_model->inverse()));
            const auto description = quoted(relight.description);
            std::string look = fmt::format("- !<Look>\n  name: {}\n  process_space: {}\n  description: {}\n  transform: {}",
                                           quoted(name), quoted(way->name), description, children(chain, "    "));
            // What was written before, for the same request, stays as it is; anything else of that name is not ours to change.
            if (const auto known = old->getLook(name.c_str())) {
                if (std::string_view(known->getDescription()) != relight.description ||
                    std::string_view(known->getProcessSpace()) != way->name)
                    return Error{ErrorKind::usage, fmt::format("{}: has a look '{}' of another request already: expected another file, "
                                                               "or that look removed first",
                                                               label, name)};
                continue;
            }
            if (old->getColorSpace(name.c_str()))
                return Error{ErrorKind::usage, fmt::format("{}: has a colour space '{}' already: expected another file, or that space "
                                                           "removed first",
                                                           label, name)};
            looks += look;
            if (text.find(own_view) != std::string::npos)
                views += fmt::format("    - !<View> {{name: {}, colorspace: sRGB - Texture, looks: {}}}\n", quoted(name), quoted(name));
            if (reference.empty()) continue;
            chain.insert(chain.begin(), fmt::format("!<ColorSpaceTransform> {{src: {}, dst: {}}}", quoted(reference), quoted(way->name)));
            spaces += fmt::format("- !<ColorSpace>\n  name: {}\n  family: Relit\n  equalitygroup: \"\"\n  bitdepth: 32f\n"
                                  "  description: {}\n  isdata: false\n{}  allocation: uniform\n  {}: {}\n",
                                  quoted(name), description, first_version ? "" : "  encoding: scene-linear\n",
                                  first_version ? "from_reference" : "from_scene_reference", children(chain, "    "));
        }
        if (looks.empty()) return text;
        const auto extended = [&](std::string base) -> std::optional<std::string> {
            if (!insert_items(base, "looks", "colorspaces", looks)) return std::nullopt;
            if (!spaces.empty() && !insert_items(base, "colorspaces", "", spaces)) return std::nullopt;
            if (const auto at = base.find(own_view); at != std::string::npos) base.insert(at + own_view.size(), views);
            return base;
        };
        // Into the text as it is, so that comments and layout stay; else into OpenColorIO's own way of writing it.
        auto result = [&]() -> std::optional<std::string> {
            auto base = text;
            return search_beside(base, old) ? extended(base) : std::nullopt;
        }();
        if (!result) result = extended(serialized(old));
        if (!result) return Error{ErrorKind::input, fmt::format("{}: is laid out in a way that cannot be added to", label)};
        const auto now = config_of(*result);
        if (const auto missing = lost(old, now); !missing.empty())
            return Error{ErrorKind::input, fmt::format("{}: '{}' would be lost: nothing was written", label, missing)};
        for (const auto& relight : relights)
            if (!now->getLook(("Relit " + relight.illuminant).c_str()))
                return Error{ErrorKind::input, fmt::format("{}: a look for {} could not be added", label, relight.illuminant)};
        return *std::move(result);
    } catch (const std::exception& e) {
        return Error{ErrorKind::input, fmt::format("{}: cannot be used as an OCIO configuration: {}", label, e.what())};
    }
}

}  // namespace spectex::color
