#include <map>

#include "fuzz.h"
#include "spectex/scene.h"

// A scene of any bytes is read within limits or refused with one sentence; what is read can be written again, and reads the same.
int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static const spectex::fuzz::Folder folder;
    const std::string path = folder.write("scene.mtl", {data, size});
    const auto scene = spectex::read_scene(path);
    if (!scene) {
        SPECTEX_FUZZ_CHECK(scene.error().kind == spectex::ErrorKind::input && scene.error().message.find("scene.mtl") != std::string::npos);
        return 0;
    }
    std::map<std::string, std::string> converted;
    for (const auto& texture : scene->textures) {
        SPECTEX_FUZZ_CHECK(texture.embedded || texture.resolved.starts_with('/'));
        SPECTEX_FUZZ_CHECK(texture.token == spectex::SceneTexture::no_token || texture.token < scene->tokens.size());
        if (texture.use == spectex::SceneUse::reflectance && !texture.embedded && converted.size() < 64) converted[texture.resolved] = path + ".converted.exr";
    }
    for (const auto& token : scene->tokens)
        SPECTEX_FUZZ_CHECK(token.file < scene->files.size() && token.begin <= token.end && (token.file != 0 || token.end <= size));
    (void)spectex::scene_illuminants(*scene);
    const std::string output = path + ".rewritten.mtl";
    const auto written = spectex::rewrite_scene(*scene, output, converted);
    SPECTEX_FUZZ_CHECK(written.ok());
    const auto again = spectex::read_scene(output);
    SPECTEX_FUZZ_CHECK(again.ok() && again->textures.size() == scene->textures.size() && again->illuminants.size() == scene->illuminants.size());
    std::size_t now = 0;
    for (const auto& texture : again->textures) now += texture.resolved == path + ".converted.exr";
    SPECTEX_FUZZ_CHECK(now >= written->changed);
    return 0;
}
