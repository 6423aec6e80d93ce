#include "spectex/scene.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>

#include <xxhash.h>

#include "scene/internal.h"
#include "spectex/spectral.h"

namespace spectex {
namespace fs = std::filesystem;
namespace scene {

std::size_t Text::line_of(std::size_t offset) const {
    return static_cast<std::size_t>(std::lower_bound(line_ends.begin(), line_ends.end(), offset) - line_ends.begin()) + 1;
}

std::string lower(std::string_view text) {
    std::string out(text);
    for (char& c : out)
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    return out;
}

std::optional<double> number_of(std::string_view text) {
    if (text.starts_with('+')) text.remove_prefix(1);
    double value = 0;
    const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (failed != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return {};
    return value;
}

std::string folder_of(const std::string& path) { return fs::path(path).parent_path().string(); }

std::string resolve(const std::string& base, const std::string& path) {
    const fs::path p(path);
    return (p.is_absolute() ? p : fs::path(base) / p).lexically_normal().string();
}

bool exists(const std::string& path) {
    struct stat s {};
    return ::stat(path.c_str(), &s) == 0 && S_ISREG(s.st_mode);
}

std::string grey_light(const std::vector<double>& rgb, std::string_view white) {
    return rgb.size() == 3 && rgb[0] > 0 && rgb[0] == rgb[1] && rgb[1] == rgb[2] ? std::string(white) : std::string();
}

Builder::Builder(std::string path, SceneFormat format, const SceneLimits& limits) : limits_(limits) {
    scene_.path = std::move(path);
    scene_.format = format;
}

Result<Text> Builder::load(const std::string& path) {
    const auto failed = [&](std::string_view what) { return Error{ErrorKind::input, fmt::format("{}: {}", path, what)}; };
    if (path.find('\0') != std::string::npos) return Error{ErrorKind::input, "a path of the scene contains a zero byte"};
    if (static_cast<int>(scene_.files.size()) >= limits_.max_files)
        return failed(fmt::format("the scene has more than {} files", limits_.max_files));
    // O_NONBLOCK: opening a named pipe must not wait for a writer.
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0) return failed(std::strerror(errno));
    struct stat s {};
    const bool regular = ::fstat(fd, &s) == 0 && S_ISREG(s.st_mode);
    const auto size = static_cast<std::uint64_t>(s.st_size);
    if (!regular || size > limits_.max_file_bytes || size > limits_.max_total_bytes - bytes_) {
        ::close(fd);
        return regular ? failed(fmt::format("has {} bytes: the texts of a scene may have {} each and {} together", size,
                                            limits_.max_file_bytes, limits_.max_total_bytes))
                       : failed("is no regular file");
    }
    Text text;
    text.path = path;
    text.content.resize(size);
    std::size_t done = 0;
    while (done < text.content.size()) {
        const ssize_t n = ::read(fd, text.content.data() + done, text.content.size() - done);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) break;
        done += static_cast<std::size_t>(n);
    }
    ::close(fd);
    if (done != text.content.size()) return failed("cannot be read to its end");
    bytes_ += size;
    for (std::size_t i = 0; i < text.content.size(); ++i)
        if (text.content[i] == '\n') text.line_ends.push_back(i);
    text.file = scene_.files.size();
    scene_.files.push_back(path);
    scene_.hashes.push_back(XXH3_64bits(text.content.data(), text.content.size()));
    return text;
}

Status Builder::enter(const std::string& path, const Text* from, std::size_t offset) {
    std::error_code ignored;
    const std::string canonical = fs::weakly_canonical(path, ignored).string();
    const std::string& key = canonical.empty() ? path : canonical;
    if (std::find(open_.begin(), open_.end(), key) != open_.end())
        return from ? from->error(offset, fmt::format("includes {}, which is being read already", path))
                    : Error{ErrorKind::input, fmt::format("{}: includes itself", path)};
    if (depth() >= limits_.max_depth)
        return from ? from->error(offset, fmt::format("includes are nested deeper than {}", limits_.max_depth))
                    : Error{ErrorKind::input, fmt::format("{}: includes are nested too deep", path)};
    open_.push_back(key);
    return {};
}

Status Builder::add(SceneTexture texture, const std::string& base) {
    if (scene_.textures.size() >= limits_.max_textures)
        return Error{ErrorKind::input, fmt::format("{}: {}: the scene has more than {} textures", texture.file, texture.where,
                                                   limits_.max_textures)};
    if (!texture.embedded) {
        if (texture.resolved.empty()) texture.resolved = resolve(base, texture.written);
        texture.exists = texture.resolved.find('\0') == std::string::npos && exists(texture.resolved);
        if (!texture.exists) scene_.warnings.push_back({texture.file, texture.where, fmt::format("there is no texture {}", texture.resolved)});
    }
    scene_.textures.push_back(std::move(texture));
    return {};
}

std::size_t Builder::add_token(SceneToken token) {
    scene_.tokens.push_back(std::move(token));
    return scene_.tokens.size() - 1;
}

void Builder::add_include(const Text& text, std::size_t begin, std::size_t end) {
    SceneToken token;
    token.kind = SceneToken::Kind::include;
    token.file = text.file;
    token.begin = begin;
    token.end = end;
    token.target = scene_.files.size();  // load() gives the next number
    add_token(std::move(token));
}

void Builder::add_illuminant(std::string specification, std::string written, const Text& text, std::size_t offset) {
    // Scenes repeat their lights by the thousand; one of each is enough.
    for (const SceneIlluminant& known : scene_.illuminants)
        if (known.specification == specification && known.written == written) return;
    if (scene_.illuminants.size() < 10000)
        scene_.illuminants.push_back({std::move(specification), std::move(written), text.path, text.where(offset)});
}

void Builder::warn(const Text& text, std::size_t offset, std::string message) {
    if (scene_.warnings.size() < 100000) scene_.warnings.push_back({text.path, text.where(offset), std::move(message)});
}

}  // namespace scene

std::string_view scene_format_name(SceneFormat format) {
    constexpr std::array<std::string_view, 5> names{"pbrt-v4", "Mitsuba 3", "MaterialX", "glTF 2.0", "OBJ"};
    return names[static_cast<std::size_t>(format)];
}

std::string_view scene_use_name(SceneUse use) {
    constexpr std::array<std::string_view, 4> names{"reflectance", "emission", "data", "unused"};
    return names[static_cast<std::size_t>(use)];
}

Result<Scene> read_scene(const std::string& path, const SceneLimits& limits) {
    using Reader = Status (*)(scene::Builder&, const std::string&);
    struct Suffix {
        std::string_view text;
        SceneFormat format;
        Reader read;
    };
    static constexpr std::array<Suffix, 7> suffixes{{{".pbrt", SceneFormat::pbrt, scene::read_pbrt},
                                                     {".xml", SceneFormat::mitsuba, scene::read_mitsuba},
                                                     {".mtlx", SceneFormat::materialx, scene::read_materialx},
                                                     {".gltf", SceneFormat::gltf, scene::read_gltf},
                                                     {".glb", SceneFormat::gltf, scene::read_gltf},
                                                     {".obj", SceneFormat::obj, scene::read_obj},
                                                     {".mtl", SceneFormat::obj, scene::read_obj}}};
    const std::string suffix = scene::lower(fs::path(path).extension().string());
    const auto known = std::find_if(suffixes.begin(), suffixes.end(), [&](const Suffix& s) { return s.text == suffix; });
    if (known == suffixes.end())
        return Error{ErrorKind::usage, fmt::format("{}: \"{}\" is no scene's suffix: expected .pbrt, .xml (Mitsuba 3), .mtlx, .gltf, "
                                                   ".glb, .obj or .mtl", path, suffix)};
    std::error_code failed;
    const std::string absolute = fs::absolute(path, failed).lexically_normal().string();
    scene::Builder builder(path, known->format, limits);
    try {
        if (auto read = known->read(builder, failed ? path : absolute); !read) return read.error();
    } catch (const std::bad_alloc&) {
        return Error{ErrorKind::input, fmt::format("{}: not enough memory for this scene", path)};
    } catch (const std::exception& e) {
        return Error{ErrorKind::input, fmt::format("{}: {}", path, e.what())};
    }
    return builder.finish();
}

std::vector<std::string> scene_illuminants(const Scene& scene) {
    std::vector<std::string> list;
    for (const SceneIlluminant& light : scene.illuminants) {
        if (light.specification.empty() || std::find(list.begin(), list.end(), light.specification) != list.end()) continue;
        if (parse_illuminant(light.specification)) list.push_back(light.specification);
    }
    return list;
}

}  // namespace spectex
