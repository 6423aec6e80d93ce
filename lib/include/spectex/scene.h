// Scenes of renderers: which textures they use as reflectance colour, and under which lights.
//
// Reads pbrt-v4 (.pbrt), Mitsuba 3 (.xml), MaterialX (.mtlx), glTF 2.0 (.gltf, .glb) and Wavefront OBJ with MTL (.obj, .mtl).
// Only text and headers are read, never geometry or pixels; files are hostile: sizes, depths and counts are checked against
// SceneLimits, include cycles are refused. A texture that does not exist is reported and is no error. Paths resolve as each
// format defines: pbrt from the folder of the first file; Mitsuba from the folders named by <path> and the scene's own;
// MaterialX from the file that names it, with the fileprefix in force; glTF as percent-encoded URIs from the .gltf; MTL from
// the .mtl, which is found beside the .obj.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "spectex/base.h"

namespace spectex {

enum class SceneFormat { pbrt, mitsuba, materialx, gltf, obj };
SPECTEX_API std::string_view scene_format_name(SceneFormat format);

/// How a scene uses a texture; where it is used in several ways each use is an entry of its own.
enum class SceneUse {
    reflectance,  ///< colour of a surface: to be uplifted
    emission,     ///< radiance of a light or a surface
    data,         ///< scalars, normals, weights, or a colour texture marked as raw
    unused,       ///< defined, but nothing that is read here refers to it
};
SPECTEX_API std::string_view scene_use_name(SceneUse use);

struct SceneTexture {
    std::string written;    ///< path as the scene has it, after variables, prefixes and percent-decoding
    std::string resolved;   ///< absolute path; empty when embedded
    SceneUse use = SceneUse::unused;
    std::string parameter;  ///< what refers to it: "diffuse.reflectance", "map_Kd", "baseColorTexture", ...
    std::string file;       ///< that names it
    std::string where;      ///< "line 12", or a JSON pointer
    bool exists = false;
    bool embedded = false;  ///< data URI or buffer view: nothing to convert on disk
    bool raw = false;       ///< marked as linear or raw by the scene
    std::size_t token = no_token;  ///< index into Scene::tokens
    static constexpr std::size_t no_token = static_cast<std::size_t>(-1);
};

struct SceneIlluminant {
    std::string specification;  ///< as parse_illuminant takes it; empty when it cannot be said so
    std::string written;        ///< as the scene has it
    std::string file, where;
};

struct SceneWarning {
    std::string file, where, message;
};

/// A run of bytes in a file of the scene that stands for a texture's path, an included file's, or a colour space.
struct SceneToken {
    enum class Kind { texture, include, colorspace };
    Kind kind = Kind::texture;
    std::size_t file = 0;             ///< index into Scene::files
    std::size_t begin = 0, end = 0;   ///< without quotes; begin == end: where a colour space is to be inserted
    std::size_t target = 0;           ///< include: index into Scene::files; colorspace: the texture's token
    std::string prefix;               ///< put before the path by the format: MaterialX's fileprefix
};

struct Scene {
    std::string path;
    SceneFormat format = SceneFormat::pbrt;
    std::vector<std::string> files;  ///< every text that was read, the scene itself first, absolute
    std::vector<std::uint64_t> hashes;  ///< XXH3 of each, by which rewrite_scene knows that nothing changed
    std::vector<SceneTexture> textures;
    std::vector<SceneIlluminant> illuminants;
    std::vector<SceneWarning> warnings;
    std::vector<SceneToken> tokens;  ///< for rewrite_scene
};

struct SceneLimits {
    std::uint64_t max_file_bytes = std::uint64_t{1} << 30;   ///< of one text
    std::uint64_t max_total_bytes = std::uint64_t{1} << 32;  ///< of all texts of a scene
    int max_files = 10000;
    int max_depth = 64;                                      ///< of includes, and of elements within elements
    std::size_t max_textures = 1000000;
};

/// Reads a scene by the suffix of its name.
/// @error usage: a suffix that is none of these; input: missing, malformed (with the line), a cycle of includes, over limits.
SPECTEX_API Result<Scene> read_scene(const std::string& path, const SceneLimits& limits = {});

/// Illuminants of a scene as one list for `--for`: specifications that parse, each once, in order.
SPECTEX_API std::vector<std::string> scene_illuminants(const Scene& scene);

struct SceneRewrite {
    std::vector<std::string> written;  ///< files, the scene first
    std::size_t changed = 0;           ///< tokens that now name a converted file
    std::vector<std::string> notes;    ///< sentences for the user
};

/// Whether renderers of a format read our EXRs, and with which layout; one sentence for --explain.
struct SceneOutput {
    bool readable = false;
    bool needs_multipart = false;
    std::string sentence;
};
SPECTEX_API SceneOutput scene_output(SceneFormat format);

/// Writes the scene with the paths of converted textures; all other bytes stay. A token changes only where every use of its
/// texture is a reflectance. Files that the scene includes are written beside `output`, as STEM.NAME, where they change.
/// @param converted  resolved path of a texture to the path of its conversion; written relative to the output's folder
///                   where the scene's own path was relative. Other relative paths stay: `notes` says so where the output
///                   lies in another folder than the scene.
/// @error usage: the format cannot take EXRs, or `output` is one of the scene's files or of the converted ones;
///        input: a text changed since read_scene; output.
SPECTEX_API Result<SceneRewrite> rewrite_scene(const Scene& scene, const std::string& output,
                                               const std::map<std::string, std::string>& converted);

}  // namespace spectex
