"""spxbatch --scene: a scene decides what is converted, and is written with the new paths."""

import numpy as np
import pytest

from conftest import run_tool, write_image

SCENE = """LightSource "infinite" "spectrum L" "stdillum-F11"
LightSource "distant" "blackbody L" [ 3200 ]
Texture "a" "spectrum" "imagemap" "string filename" "tex/wood_mask.png"
Texture "r" "float" "imagemap" "string filename" "tex/rough.png"
Texture "gone" "spectrum" "imagemap" "string filename" "tex/gone.png"
Material "coateddiffuse" "texture reflectance" "a" "texture roughness" "r" "string normalmap" "tex/n.png"
Material "diffuse" "texture reflectance" "gone"
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "scene" / "tex").mkdir(parents=True)
    for i, name in enumerate(("wood_mask", "rough", "n", "unused_albedo")):
        write_image(tmp_path / "scene" / "tex" / f"{name}.png", np.random.default_rng(i).integers(0, 256, (8, 12, 3), dtype=np.uint8))
    (tmp_path / "scene" / "s.pbrt").write_text(SCENE)
    return tmp_path / "scene"


def test_converts_only_the_reflectances_of_a_scene(scene, tmp_path):
    out = scene / "spectral.pbrt"
    run = run_tool("spxbatch", scene, tmp_path / "dst", "--scene", scene / "s.pbrt", "--rewrite-scene", out, "--json", "-", check=0)
    report = run.json()
    assert (report["converted"], report["excluded"], report["failed"]) == (1, 3, 0)
    # The scene knows better than the name.
    assert report["files"][0]["input"].endswith("wood_mask.png") and report["files"][0]["use"] == "color"
    assert report["scene"]["illuminants"] == ["F11", "P:3200"]
    assert {(t["written"], t["use"]) for t in report["scene"]["textures"]} == {
        ("tex/wood_mask.png", "reflectance"), ("tex/rough.png", "data"), ("tex/gone.png", "reflectance"), ("tex/n.png", "data")}
    assert "gone.png" in run.stderr and "line 5" in run.stderr
    assert out.read_text() == SCENE.replace("tex/wood_mask.png", "../dst/tex/wood_mask.exr")
    assert (scene / "s.pbrt").read_text() == SCENE
    assert (tmp_path / "dst" / "tex" / "wood_mask.exr").exists()
    again = run_tool("spxbatch", scene, tmp_path / "dst", "--scene", scene / "s.pbrt", "--json", "-", check=0).json()
    assert (again["converted"], again["skipped"]) == (0, 1)


def test_a_rule_stands_above_the_scene(scene, tmp_path):
    report = run_tool("spxbatch", scene, tmp_path / "dst", "--scene", scene / "s.pbrt", "--treat-as", "*_mask*=mask", "--json", "-",
                      check=0).json()
    assert (report["converted"], report["data"]) == (0, 1)


@pytest.mark.parametrize("scene_file, text, output, code, says", [
    ("s.gltf", '{"asset":{}}', "o.gltf", 64, "no EXR"),
    ("s.xml", "<scene/>", "o.xml", 64, "multipart"),
    ("s.usd", "", "o.usd", 64, "suffix"),
    ("bad.pbrt", 'Texture "a', "o.pbrt", 2, "line 1"),
    ("s.pbrt", SCENE, "s.pbrt", 64, "own files"),
])
def test_refuses_what_it_cannot_write(scene, tmp_path, scene_file, text, output, code, says):
    (scene / scene_file).write_text(text)
    run = run_tool("spxbatch", scene, tmp_path / "dst", "--scene", scene / scene_file, "--rewrite-scene", scene / output)
    assert run.code == code, run.stderr
    assert says in run.stderr
    assert (scene / scene_file).read_text() == text
    assert not (tmp_path / "dst").exists()  # known before any work is done


def test_needs_a_scene_to_rewrite(scene, tmp_path):
    run = run_tool("spxbatch", scene, tmp_path / "dst", "--rewrite-scene", tmp_path / "o.pbrt")
    assert run.code == 64 and "--scene" in run.stderr
