// What the readers of this room share.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <fmt/format.h>

#include "spectex/scene.h"

namespace spectex::scene {

/// A file's text, with its lines.
struct Text {
    std::size_t file = 0;  ///< index into Scene::files
    std::string path, content;
    std::vector<std::size_t> line_ends;

    std::size_t line_of(std::size_t offset) const;
    std::string where(std::size_t offset) const { return fmt::format("line {}", line_of(offset)); }
    Error error(std::size_t offset, std::string_view what) const {
        return {ErrorKind::input, fmt::format("{}: line {}: {}", path, line_of(offset), what)};
    }
};

/// Gathers a scene while its files are read.
class Builder {
public:
    Builder(std::string path, SceneFormat format, const SceneLimits& limits);

    /// Reads a text and keeps count of it. @error input: missing, no regular file, over limits.
    Result<Text> load(const std::string& path);
    /// Guards against cycles: load between enter and leave. @error input, naming both files.
    Status enter(const std::string& path, const Text* from, std::size_t offset);
    void leave() { open_.pop_back(); }

    /// @param base  folder from which a relative path counts.
    Status add(SceneTexture texture, const std::string& base);
    std::size_t add_token(SceneToken token);
    /// The bytes [begin, end) of a text name the file that is loaded next.
    void add_include(const Text& text, std::size_t begin, std::size_t end);
    void add_illuminant(std::string specification, std::string written, const Text& text, std::size_t offset);
    void warn(const Text& text, std::size_t offset, std::string message);

    const SceneLimits& limits() const { return limits_; }
    const Scene& scene() const { return scene_; }
    Scene finish() { return std::move(scene_); }
    int depth() const { return static_cast<int>(open_.size()); }

private:
    Scene scene_;
    SceneLimits limits_;
    std::uint64_t bytes_ = 0;
    std::vector<std::string> open_;
};

std::string folder_of(const std::string& path);
/// Joined and lexically normalised; an absolute `path` stands for itself.
std::string resolve(const std::string& base, const std::string& path);
bool exists(const std::string& path);
std::string lower(std::string_view text);
/// A finite number that is the whole text, in the C locale.
std::optional<double> number_of(std::string_view text);
/// Illuminant of three equal RGB components: the white of the RGB space. Empty for coloured lights.
std::string grey_light(const std::vector<double>& rgb, std::string_view white);

Status read_pbrt(Builder& builder, const std::string& path);
Status read_mitsuba(Builder& builder, const std::string& path);
Status read_materialx(Builder& builder, const std::string& path);
Status read_gltf(Builder& builder, const std::string& path);
Status read_obj(Builder& builder, const std::string& path);

}  // namespace spectex::scene
