// Small scenes of every format: which textures they use as colour, under which lights, and what a rewriting changes.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>

#include "spectex/scene.h"

namespace spectex {
namespace {
namespace fs = std::filesystem;

class SceneTest : public ::testing::Test {
protected:
    void SetUp() override {
        std::string pattern = (fs::temp_directory_path() / "spectex_scene_XXXXXX").string();
        ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
        folder_ = fs::canonical(pattern);
    }
    void TearDown() override { fs::remove_all(folder_); }

    std::string write(const std::string& name, const std::string& text) {
        fs::create_directories((folder_ / name).parent_path());
        std::ofstream(folder_ / name, std::ios::binary) << text;
        return (folder_ / name).string();
    }
    std::string path(const std::string& name) const { return (folder_ / name).string(); }
    static std::string content(const std::string& file) {
        std::ifstream in(file, std::ios::binary);
        return {std::istreambuf_iterator<char>(in), {}};
    }
    /// Uses of the texture of that name below the folder.
    std::set<SceneUse> uses(const Scene& scene, const std::string& name) const {
        std::set<SceneUse> found;
        for (const SceneTexture& t : scene.textures)
            if (t.resolved == path(name)) found.insert(t.use);
        return found;
    }
    static const SceneTexture* texture(const Scene& scene, const std::string& resolved) {
        for (const SceneTexture& t : scene.textures)
            if (t.resolved == resolved) return &t;
        return nullptr;
    }

    fs::path folder_;
};
using Uses = std::set<SceneUse>;
using enum SceneUse;

constexpr const char* pbrt_scene = R"(# "Texture" in a comment "string filename" "no.png"
LookAt 0 0 5  0 0 0  0 1 0
Camera "perspective" "float fov" [ 45 ]
WorldBegin
LightSource "infinite" "spectrum L" "stdillum-D65"
LightSource "distant" "blackbody L" [ 3200 ]
LightSource "infinite" "string filename" "sky.exr"
AttributeBegin
  AreaLightSource "diffuse" "rgb L" [ 10 10 10 ]
  AreaLightSource "diffuse" "rgb L" [ 10 5 1 ]
AttributeEnd
Texture "wood" "spectrum" "imagemap" "string filename" [ "tex/wood \"oak\".png" ]
Texture "scaled" "spectrum" "scale" "texture tex" "wood" "float scale" 0.5
Texture "rough" "float" "imagemap" "string filename" "tex/rough.png" "string encoding" "linear"
Texture "dots" "spectrum" "checkerboard" "texture tex1" "a" "texture tex2" "b"
Texture "a" "spectrum" "imagemap" "string filename" "tex/a.png"
Texture "b" "spectrum" "imagemap" "string filename" "tex/b.png"
Texture "mixed" "spectrum" "mix" "texture tex1" "a" "rgb tex2" [1 0 0] "texture amount" "share"
Texture "share" "float" "imagemap" "string filename" "tex/share.png"
Texture "weight" "float" "imagemap" "string filename" "tex/weight.png"
Texture "idle" "spectrum" "imagemap" "string filename" "tex/idle.png"
Texture "both" "spectrum" "imagemap" "string filename" "tex/both.png"
Material "coateddiffuse" "texture reflectance" "scaled" "texture roughness" "rough" "string normalmap" "tex/nrm.png"
MakeNamedMaterial "m" "string type" "diffuse" "texture reflectance" [ "dots" ]
MakeNamedMaterial "n" "string type" [ "conductor" ] "texture eta" "both" "bool remaproughness" false
MakeNamedMaterial "o" "string type" "diffusetransmission" "texture transmittance" "mixed" "texture reflectance" "both"
Include "parts/more.pbrt"
Shape "trianglemesh" "integer indices" [ 0 1 2 ] "point3 P" [ 0 0 0 1 0 0 0 1 0 ] "texture alpha" "weight"
)";

TEST_F(SceneTest, PbrtFollowsTexturesToTheirMaterials) {
    const auto scene_path = write("scene.pbrt", pbrt_scene);
    // Paths of an include count from the first file's folder.
    write("parts/more.pbrt", "Texture \"inc\" \"spectrum\" \"imagemap\" \"string filename\" \"tex/inc.png\"\n"
                             "Material \"diffuse\" \"texture reflectance\" \"inc\"\n");
    write("tex/inc.png", "");
    const auto scene = read_scene(scene_path);
    ASSERT_TRUE(scene) << scene.error().message;
    EXPECT_EQ(uses(*scene, "tex/wood \"oak\".png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "tex/rough.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "tex/nrm.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "tex/a.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "tex/b.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "tex/weight.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "tex/share.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "tex/idle.png"), Uses{unused});
    EXPECT_EQ(uses(*scene, "tex/both.png"), (Uses{reflectance, data}));
    EXPECT_EQ(uses(*scene, "tex/inc.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "sky.exr"), Uses{emission});
    EXPECT_EQ(uses(*scene, "no.png"), Uses{});
    EXPECT_TRUE(texture(*scene, path("tex/inc.png"))->exists);
    EXPECT_FALSE(texture(*scene, path("tex/a.png"))->exists);
    EXPECT_EQ(texture(*scene, path("tex/a.png"))->where, "line 16");
    EXPECT_FALSE(scene->warnings.empty());
    EXPECT_EQ(scene_illuminants(*scene), (std::vector<std::string>{"D65", "P:3200"}));
    EXPECT_EQ(scene->files.size(), 2u);
}

TEST_F(SceneTest, PbrtRewritesOnlyThePathsOfReflectances) {
    const auto scene_path = write("scene.pbrt", pbrt_scene);
    const std::string more = "Texture \"inc\" \"spectrum\" \"imagemap\" \"string filename\" \"tex/inc.png\" # end\r\n"
                             "Material \"diffuse\" \"texture reflectance\" \"inc\"";
    write("parts/more.pbrt", more);
    const auto scene = read_scene(scene_path);
    ASSERT_TRUE(scene);
    const auto done = rewrite_scene(*scene, path("out.pbrt"), {{path("tex/a.png"), path("spectral/a \"1\".exr")},
                                                               {path("tex/inc.png"), path("spectral/inc.exr")},
                                                               {path("tex/both.png"), path("spectral/both.exr")}});
    ASSERT_TRUE(done) << done.error().message;
    std::string expected = pbrt_scene;
    const auto replace = [](std::string& text, const std::string& from, const std::string& to) { text.replace(text.find(from), from.size(), to); };
    replace(expected, "tex/a.png", "spectral/a \\\"1\\\".exr");
    replace(expected, "parts/more.pbrt", "out.more.pbrt");
    EXPECT_EQ(content(path("out.pbrt")), expected);
    std::string expected_more = more;
    replace(expected_more, "tex/inc.png", "spectral/inc.exr");
    EXPECT_EQ(content(path("out.more.pbrt")), expected_more);
    EXPECT_EQ(content(scene_path), pbrt_scene);
    EXPECT_EQ(done->changed, 2u);
    EXPECT_EQ(done->written, (std::vector<std::string>{path("out.pbrt"), path("out.more.pbrt")}));
    ASSERT_EQ(done->notes.size(), 1u);  // of both.png, which is data as well

    const auto again = read_scene(path("out.pbrt"));
    ASSERT_TRUE(again);
    EXPECT_EQ(uses(*again, "spectral/a \"1\".exr"), Uses{reflectance});
    EXPECT_EQ(uses(*again, "spectral/inc.exr"), Uses{reflectance});
    EXPECT_EQ(uses(*again, "tex/both.png"), (Uses{reflectance, data}));
}

TEST_F(SceneTest, RefusesToWriteOverItsSourcesAndStaleScenes) {
    const auto scene_path = write("scene.pbrt", pbrt_scene);
    write("parts/more.pbrt", "");
    const auto scene = read_scene(scene_path);
    ASSERT_TRUE(scene);
    const auto over = rewrite_scene(*scene, scene_path, {});
    ASSERT_FALSE(over);
    EXPECT_EQ(over.error().kind, ErrorKind::usage);
    fs::create_symlink(scene_path, path("link.pbrt"));
    EXPECT_FALSE(rewrite_scene(*scene, path("link.pbrt"), {}));
    write("scene.pbrt", std::string(pbrt_scene) + "# more\n");
    const auto stale = rewrite_scene(*scene, path("out.pbrt"), {});
    ASSERT_FALSE(stale);
    EXPECT_EQ(stale.error().kind, ErrorKind::input);
    EXPECT_FALSE(fs::exists(path("out.pbrt")));
}

TEST_F(SceneTest, RefusesCyclesDepthAndSizes) {
    write("a.pbrt", "Include \"b.pbrt\"\n");
    write("b.pbrt", "\nInclude \"./a.pbrt\"\n");
    const auto cycle = read_scene(path("a.pbrt"));
    ASSERT_FALSE(cycle);
    EXPECT_NE(cycle.error().message.find("line 2"), std::string::npos) << cycle.error().message;
    const auto numbered = [](char c, int i) { return std::string(1, c).append(std::to_string(i)).append(".pbrt"); };
    const auto including = [&](char c, int i) { return std::string("Include \"").append(numbered(c, i)).append("\"\n"); };
    for (int i = 0; i < 70; ++i) write(numbered('d', i), including('d', i + 1));
    EXPECT_FALSE(read_scene(path("d0.pbrt")));
    // Doubling includes: 2^20 readings of small files, without a cycle.
    for (int i = 0; i < 20; ++i) write(numbered('e', i), including('e', i + 1) + including('e', i + 1));
    write("e20.pbrt", "");
    const auto many = read_scene(path("e0.pbrt"));
    ASSERT_FALSE(many);
    EXPECT_NE(many.error().message.find("10000 files"), std::string::npos) << many.error().message;
    SceneLimits small;
    small.max_file_bytes = 10;
    EXPECT_FALSE(read_scene(path("a.pbrt"), small));
    std::string deep;
    for (int i = 0; i < 100000; ++i) deep += "<a>";
    EXPECT_FALSE(read_scene(write("deep.xml", deep)));
    EXPECT_FALSE(read_scene(write("deep.gltf", std::string(1000000, '['))));
    EXPECT_FALSE(read_scene(write("open.pbrt", "Texture \"a\" \"spectrum\" \"imagemap\" \"string filename\" \"x")));
    EXPECT_EQ(read_scene(path("scene.usd")).error().kind, ErrorKind::usage);
    EXPECT_EQ(read_scene(path("missing.pbrt")).error().kind, ErrorKind::input);
    EXPECT_NE(read_scene(path("missing.pbrt")).error().message.find("missing.pbrt"), std::string::npos);
}

constexpr const char* mitsuba_scene = R"(<?xml version="1.0" encoding="utf-8"?>
<scene version="3.0.0">
  <default name="dir" value="maps"/>
  <path value="search"/>
  <texture type="bitmap" id="t_shared"><string name="filename" value="shared.png"/></texture>
  <texture type="bitmap" id="idle"><string name="filename" value="idle.png"/></texture>
  <bsdf type="twosided" id="m1"><bsdf type="principled">
    <texture type="bitmap" name="base_color"><string name="filename" value='maps/a &amp; b.png'/></texture>
    <texture type="bitmap" name="roughness"><string name="filename" value="$dir/r.png"/><boolean name="raw" value="true"/></texture>
    <ref id="t_shared" name="spec_tint"/>
  </bsdf></bsdf>
  <bsdf type="normalmap">
    <texture type="bitmap" name="normalmap"><string name="filename" value="n.png"/><boolean name="raw" value="true"/></texture>
    <bsdf type="diffuse"><ref name="reflectance" id="t_shared"/></bsdf>
  </bsdf>
  <bsdf type="mask"><texture type="bitmap" name="opacity"><string name="filename" value="mask.png"/></texture>
    <bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
      <texture type="bitmap" name="color0"><string name="filename" value="c0.png"/></texture></texture></bsdf></bsdf>
  <bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="found.png"/></texture></bsdf>
  <emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>
  <emitter type="point"><spectrum name="intensity" type="blackbody"><float name="temperature" value="4000"/></spectrum></emitter>
  <shape type="sphere"><emitter type="area"><spectrum name="radiance" type="d65"/></emitter></shape>
  <shape type="sphere"><emitter type="area"><spectrum name="radiance" value="400:1, 700:2"/></emitter></shape>
  <include filename="inc.xml"/>
</scene>
)";

TEST_F(SceneTest, MitsubaFollowsNamesReferencesAndPaths) {
    const auto scene_path = write("scene.xml", mitsuba_scene);
    write("inc.xml", "<scene version='3.0.0'><bsdf type='roughconductor'><texture type='bitmap' name='specular_reflectance'>"
                     "<string name='filename' value='inc.png'/></texture></bsdf></scene>");
    write("search/found.png", "");
    const auto scene = read_scene(scene_path);
    ASSERT_TRUE(scene) << scene.error().message;
    EXPECT_EQ(uses(*scene, "maps/a & b.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "maps/r.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "n.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "mask.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "c0.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "shared.png"), (Uses{reflectance, data}));
    EXPECT_EQ(uses(*scene, "idle.png"), Uses{unused});
    EXPECT_EQ(uses(*scene, "search/found.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "inc.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "sky.exr"), Uses{emission});
    EXPECT_EQ(scene_illuminants(*scene), (std::vector<std::string>{"P:4000", "D65"}));

    const auto done = rewrite_scene(*scene, path("out.xml"), {{path("maps/a & b.png"), path("x/a<b>&\"c.exr")}, {path("inc.png"), path("x/inc.exr")}});
    ASSERT_TRUE(done) << done.error().message;
    const auto again = read_scene(path("out.xml"));
    ASSERT_TRUE(again) << again.error().message;
    EXPECT_EQ(uses(*again, "x/a<b>&\"c.exr"), Uses{reflectance});
    EXPECT_EQ(uses(*again, "x/inc.exr"), Uses{reflectance});
    EXPECT_EQ(uses(*again, "maps/r.png"), Uses{data});
    std::string expected = mitsuba_scene;
    expected.replace(expected.find("maps/a &amp; b.png"), 18, "x/a&lt;b>&amp;&quot;c.exr");
    expected.replace(expected.find("inc.xml"), 7, "out.inc.xml");
    EXPECT_EQ(content(path("out.xml")), expected);
}

constexpr const char* materialx_scene = R"(<?xml version="1.0"?>
<materialx version="1.38" colorspace="lin_rec709" fileprefix="maps/">
  <nodegraph name="NG">
    <image name="col" type="color3"><input name="file" type="filename" value="c.png" colorspace="srgb_texture"/></image>
    <image name="tint" type="color3"><input name="file" type="filename" value="t.png"/></image>
    <image name="rough" type="float"><input name="file" type="filename" value="r.png"/></image>
    <tiledimage name="nrm" type="vector3"><input name="file" type="filename" value="n.png"/></tiledimage>
    <image name="idle" type="color3"><input name="file" type="filename" value="idle.png"/></image>
    <mix name="mixed" type="color3"><input name="fg" type="color3" nodename="col"/><input name="bg" type="color3" nodename="tint"/>
      <input name="mix" type="float" nodename="one"/></mix>
    <image name="packed" type="color3"><input name="file" type="filename" value="p.png"/></image>
    <extract name="one" type="float"><input name="in" type="color3" nodename="packed"/></extract>
    <normalmap name="bent" type="vector3"><input name="in" type="vector3" nodename="nrm"/></normalmap>
    <output name="base" type="color3" nodename="mixed"/>
    <output name="r" type="float" nodename="rough"/>
    <output name="n" type="vector3" nodename="bent"/>
  </nodegraph>
  <image name="glow" type="color3"><input name="file" type="filename" value="g.png" colorspace="srgb_texture"/></image>
  <standard_surface name="S" type="surfaceshader">
    <input name="base_color" type="color3" nodegraph="NG" output="base"/>
    <input name="specular_roughness" type="float" nodegraph="NG" output="r"/>
    <input name="normal" type="vector3" nodegraph="NG" output="n"/>
    <input name="emission_color" type="color3" nodename="glow"/>
  </standard_surface>
</materialx>
)";

TEST_F(SceneTest, MaterialXFollowsGraphsAndMarksLinearColour) {
    const auto scene = read_scene(write("scene.mtlx", materialx_scene));
    ASSERT_TRUE(scene) << scene.error().message;
    EXPECT_EQ(uses(*scene, "maps/c.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "maps/t.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "maps/r.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "maps/n.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "maps/p.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "maps/g.png"), Uses{emission});
    EXPECT_EQ(uses(*scene, "maps/idle.png"), Uses{unused});
    const auto done = rewrite_scene(*scene, path("out.mtlx"), {{path("maps/c.png"), path("maps/c.exr")}, {path("maps/t.png"), path("t.exr")}});
    ASSERT_TRUE(done) << done.error().message;
    std::string expected = materialx_scene;
    const std::string from = "value=\"c.png\" colorspace=\"srgb_texture\"", tint = "value=\"t.png\"";
    expected.replace(expected.find(from), from.size(), "value=\"c.exr\" colorspace=\"lin_rec709\"");
    expected.replace(expected.find(tint), tint.size(), "value=\"../t.exr\" colorspace=\"lin_rec709\"");
    EXPECT_EQ(content(path("out.mtlx")), expected);
}

constexpr const char* gltf_scene = R"({"asset":{"version":"2.0"},
"images":[{"uri":"base%20color.png"},{"uri":"mr.png"},{"uri":"data:image/png;base64,AAAA"},{"bufferView":0,"mimeType":"image/png"},{"uri":"sheen.png"},{"uri":"idle.png"},{"uri":"e.png"}],
"textures":[{"source":0},{"source":1},{"source":2},{"source":3},{"source":4},{"source":99},{"source":6}],
"materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0},"metallicRoughnessTexture":{"index":1}},"normalTexture":{"index":2},"emissiveTexture":{"index":6},
 "extensions":{"KHR_materials_sheen":{"sheenColorTexture":{"index":4}},"KHR_materials_pbrSpecularGlossiness":{"diffuseTexture":{"index":3}}}},
 {"pbrMetallicRoughness":{"baseColorTexture":{"index":-1}}},{"pbrMetallicRoughness":7},8,{"occlusionTexture":{"index":5}}]})";

TEST_F(SceneTest, GltfReadsBothContainersAndRefusesToBeRewritten) {
    const std::string json = gltf_scene;
    std::string binary = "glTF";
    const auto u32 = [](std::size_t v) {
        std::string s;
        for (int i = 0; i < 4; ++i) s.push_back(static_cast<char>(v >> (8 * i) & 255));
        return s;
    };
    std::string padded = json;
    while (padded.size() % 4) padded.push_back(' ');
    binary += u32(2) + u32(20 + padded.size()) + u32(padded.size()) + "JSON" + padded;
    for (const auto& file : {write("s.gltf", json), write("s.glb", binary)}) {
        const auto scene = read_scene(file);
        ASSERT_TRUE(scene) << scene.error().message;
        EXPECT_EQ(uses(*scene, "base color.png"), Uses{reflectance});
        EXPECT_EQ(uses(*scene, "mr.png"), Uses{data});
        EXPECT_EQ(uses(*scene, "sheen.png"), Uses{reflectance});
        EXPECT_EQ(uses(*scene, "e.png"), Uses{emission});
        EXPECT_EQ(uses(*scene, "idle.png"), Uses{unused});
        EXPECT_EQ(texture(*scene, path("mr.png"))->where, "/images/1/uri");
        EXPECT_EQ(std::count_if(scene->textures.begin(), scene->textures.end(), [](const SceneTexture& t) { return t.embedded; }), 2);
        EXPECT_EQ(rewrite_scene(*scene, path("out.gltf"), {}).error().kind, ErrorKind::usage);
    }
    EXPECT_FALSE(read_scene(write("cut.glb", binary.substr(0, 100))));
    EXPECT_FALSE(read_scene(write("old.glb", "glTF" + u32(1) + u32(20) + u32(0) + "JSON")));
    EXPECT_FALSE(read_scene(write("none.gltf", "[]")));
}

TEST_F(SceneTest, MtlSkipsOptionsAndKeepsNamesWithSpaces) {
    const std::string mtl = "newmtl a\r\nKd 1 1 1\r\nmap_Kd -s 2 2 1 -o 0.5 -clamp on my wood.png\r\n"
                            "map_bump -bm 0.3 bump 1.png\r\n\tnorm n.png\nmap_Pr r.png\nmap_d -imfchan a d.png\n"
                            "map_Ks tex\\s.png\nmap_Ke glow.png\n# map_Kd no.png\nmap_Kd\nmap_Kd -s 1 1 1 2";
    const std::string obj = "# cube\nmtllib my lib.mtl\nv 0 0 0\nusemtl a\nmtllib my lib.mtl missing.mtl\n";
    write("sub/my lib.mtl", mtl);
    write("sub/tex/s.png", "");
    const auto scene = read_scene(write("sub/cube.obj", obj));
    ASSERT_TRUE(scene) << scene.error().message;
    EXPECT_EQ(uses(*scene, "sub/my wood.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "sub/bump 1.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "sub/n.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "sub/r.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "sub/d.png"), Uses{data});
    EXPECT_EQ(uses(*scene, "sub/tex/s.png"), Uses{reflectance});
    EXPECT_EQ(uses(*scene, "sub/glow.png"), Uses{emission});
    EXPECT_EQ(uses(*scene, "sub/2"), Uses{reflectance});
    EXPECT_EQ(scene->textures.size(), 8u);
    const auto done = rewrite_scene(*scene, path("sub/out.obj"), {{path("sub/my wood.png"), path("sub/x/wood.exr")}});
    ASSERT_TRUE(done) << done.error().message;
    std::string expected = mtl;
    expected.replace(expected.find("my wood.png"), 11, "x/wood.exr");
    EXPECT_EQ(content(path("sub/out.my lib.mtl")), expected);
    std::string expected_obj = obj;
    expected_obj.replace(expected_obj.find("my lib.mtl"), 10, "out.my lib.mtl");
    EXPECT_EQ(content(path("sub/out.obj")), expected_obj);
}

}  // namespace
}  // namespace spectex
