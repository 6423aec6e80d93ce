"""Contact sheets, metamerism, and lamps of every format, judged by sums of numpy."""
import json

import numpy as np
import pytest

import oracle
from conftest import read_image, write_image

FLAT = [[200, 60, 40], [40, 120, 200], [128, 128, 128], [250, 240, 20]]


@pytest.fixture
def texture(tmp_path):
    """Four colours in blocks, 40 x 20."""
    pixels = np.repeat(np.repeat(np.array([FLAT], np.uint8), 20, 0), 10, 1)
    path = tmp_path / "four colours.png"
    write_image(path, pixels)
    return path


def test_contact_sheet(texture, run, tmp_path):
    sheet = tmp_path / "sheet.png"
    args = [str(texture), "-i", "A,FL11,D65", "--contact-sheet", str(sheet), "--json", "-", "--quiet"]
    out = json.loads(run("spxrelight", *args, check=0).stdout)
    tiles = {t["illuminant"]: t for t in out["tiles"]}
    assert list(tiles) == ["A", "FL11", "D65"]
    assert tiles["A"]["cct_kelvin"] == pytest.approx(2855.5, abs=0.5)
    assert tiles["FL11"]["cct_kelvin"] == pytest.approx(4000, abs=10)
    assert tiles["D65"]["mean"] == tiles["D65"]["max"] == 0
    # The same differences through files: relit as floats, and compared by another command.
    for light in ("A", "FL11"):
        for name in (light, "D65"):
            run("spxrelight", str(texture), "-i", name, "--float", "-o", str(tmp_path / f"{name}.exr"), "--quiet", check=0)
        files = json.loads(run("spxdiff", str(tmp_path / "D65.exr"), str(tmp_path / f"{light}.exr"), "--json", "-", check=0).stdout)
        # White of the 5 nm and of the 1 nm grid: 1e-3 at the most on differences of tens.
        assert tiles[light]["mean"] == pytest.approx(files["mean"], abs=1e-2)
        assert tiles[light]["max"] == pytest.approx(files["max"], abs=1e-2)
    pixels, _ = read_image(sheet)
    assert pixels.shape[:2] == (out["sheet_height"], out["sheet_width"])
    # The picture is a mean in linear light of flat blocks: their codes themselves are on it, under D65.
    codes = np.rint(pixels[..., :3] * 255).astype(int).reshape(-1, 3)
    for color in FLAT:
        assert (np.abs(codes - color).max(1) <= 1).sum() > 100
    first = sheet.read_bytes()
    run("spxrelight", *args, "--threads", "1", check=0)
    assert sheet.read_bytes() == first


@pytest.mark.parametrize("args, code, words", [
    (["-o", "x.png"], 64, "excludes"), (["--half"], 64, "--half"), (["-i", "nolamp"], 64, "nolamp")])
def test_contact_sheet_refusals(args, code, words, texture, run, tmp_path):
    lights = [] if "-i" in args else ["-i", "A"]
    out = run("spxrelight", str(texture), *lights, "--contact-sheet", "s.png", *args, cwd=tmp_path)
    assert out.code == code and words in out.stderr
    assert not (tmp_path / "s.png").exists()


def test_metamerism(texture, run, tmp_path):
    path = tmp_path / "map.exr"
    args = ["--metamerism", str(texture), "-i", "A,FL11", "--methods", "mallett2019,lattice", "--json", "-"]
    out = json.loads(run("spxdiff", *args, "--map", str(path), check=0).stdout)
    values = read_image(path)[0][..., 0]
    assert values.max() == pytest.approx(out["max"]) and values.mean() == pytest.approx(out["mean"], rel=1e-5)
    # Per light from two relit files, and the larger of both.
    worst = []
    for light in ("A", "FL11"):
        for method in ("mallett2019", "lattice"):
            run("spxrelight", str(texture), "-i", light, "--method", method, "--float", "-o", str(tmp_path / f"{method}.exr"), "--quiet", check=0)
        white = oracle.weights(np.arange(380, 781, 5), oracle.illuminant(light)).sum(1)
        labs = []
        for method in ("mallett2019", "lattice"):
            rgb = read_image(tmp_path / f"{method}.exr")[0][..., :3].astype(float)
            labs.append(oracle.lab(rgb @ oracle.bt709_matrix(np.arange(380, 781, 5)).T, white / white[1]))
        worst.append(oracle.ciede2000(labs[0], labs[1]))
    # Floats in the files and on the way: 1e-3 in Lab at the most.
    assert np.abs(np.maximum(*worst) - values).max() < 2e-3
    assert out["max_methods"] == ["mallett2019", "lattice"]
    assert out["max_illuminant"] == ("A" if worst[0].max() > worst[1].max() else "FL11")
    assert sum(c["pixels"] for c in out["largest"]) <= out["pixels"] == values.size
    # Exact methods agree under the light that they were solved for.
    same = json.loads(run("spxdiff", "--metamerism", str(texture), "-i", "D65", "--json", "-", check=0).stdout)
    assert same["max"] < 1e-2
    assert run("spxdiff", *args, "--fail-max", "0.01").code == 1
    assert run("spxdiff", *args, "--fail-max", "90").code == 0


@pytest.mark.parametrize("args, code, words", [
    ([], 64, "-i"), (["-i", "A", "--methods", "lattice"], 64, "two"), (["-i", "A", "--methods", "lattice,lattice"], 64, "twice"),
    (["-i", "A", "--methods", "lattice,magic"], 64, "magic"), (["-i", "A", "--roundtrip"], 64, "excludes"),
    (["-i", "A", "--method", "lattice"], 64, "--methods")])
def test_metamerism_refusals(args, code, words, texture, run):
    out = run("spxdiff", "--metamerism", str(texture), *args)
    assert out.code == code and words in out.stderr


@pytest.mark.parametrize("shape", [(3, 4000), (4000, 3)])
def test_contact_sheet_of_strips(shape, run, tmp_path):
    """No tile shrinks to a line: 16 pixels are left of the short side, which here has three colours across."""
    colors = np.array([[220, 40, 40], [40, 200, 60], [50, 70, 210]], np.uint8)
    pixels = np.repeat(colors[:, None], 4000, 1)
    write_image(tmp_path / "strip.png", pixels if shape[0] == 3 else pixels.swapaxes(0, 1))
    run("spxrelight", "strip.png", "-i", "D65", "--contact-sheet", "s.png", "--quiet", cwd=tmp_path, check=0)
    sheet = np.rint(read_image(tmp_path / "s.png")[0][..., :3] * 255).astype(int)
    for color in colors.astype(int):
        assert (np.abs(sheet - color).max(-1) <= 1).sum() >= 4 * 1000
