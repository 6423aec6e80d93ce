// Scenes of one format from any bytes: read within limits or refused with one sentence; what is read can be written again, and
// reads the same.
#pragma once

#include <map>
#include <string>

#include "fuzz.h"
#include "spectex/scene.h"

namespace spectex::fuzz {

/// @param writable  whether rewrite_scene takes the format; otherwise it must refuse it as a usage error.
inline void check_scene(const std::string& suffix, bool writable, const std::uint8_t* data, std::size_t size) {
    static const Folder folder;
    const std::string name = "scene." + suffix, path = folder.write(name, {data, size});
    const auto scene = read_scene(path);
    if (!scene) {
        SPECTEX_FUZZ_CHECK(scene.error().kind == ErrorKind::input && scene.error().message.find(name) != std::string::npos);
        return;
    }
    std::map<std::string, std::string> converted;
    for (const auto& texture : scene->textures) {
        SPECTEX_FUZZ_CHECK(texture.embedded || texture.resolved.starts_with('/'));
        SPECTEX_FUZZ_CHECK(texture.token == SceneTexture::no_token || texture.token < scene->tokens.size());
        if (texture.use == SceneUse::reflectance && !texture.embedded && converted.size() < 64)
            converted[texture.resolved] = path + ".converted.exr";
    }
    for (const auto& token : scene->tokens)
        SPECTEX_FUZZ_CHECK(token.file < scene->files.size() && token.begin <= token.end && (token.file != 0 || token.end <= size));
    (void)scene_illuminants(*scene);
    const std::string output = path + ".rewritten." + suffix;
    const auto written = rewrite_scene(*scene, output, converted);
    if (!writable) {
        SPECTEX_FUZZ_CHECK(!written && written.error().kind == ErrorKind::usage);
        return;
    }
    SPECTEX_FUZZ_CHECK(written.ok());
    const auto again = read_scene(output);
    SPECTEX_FUZZ_CHECK(again.ok() && again->textures.size() == scene->textures.size() && again->illuminants.size() == scene->illuminants.size());
    std::size_t now = 0;
    for (const auto& texture : again->textures) now += texture.resolved == path + ".converted.exr";
    SPECTEX_FUZZ_CHECK(now >= written->changed);
}

}  // namespace spectex::fuzz
