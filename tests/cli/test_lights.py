"""Contact sheets, metamerism, and lamps of every format, judged by sums of numpy."""
import json

import numpy as np
import pytest

import oracle
from conftest import read_image, write_image, write_spectral

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


LIGHTS = ("A", "D50", "FL2", "FL11", "HP1")
# One of each kind of model; tests/stress takes all of them without files.
METHODS = ("mallett2019", "lattice", "smits1999", "jakob2019", "macadam1935", "burns2020", "meng2015", "otsu2018", "peters2019:fourier-srgb")


def integrated(spectra, nm, light, cmf=None):
    """XYZ of spectra [n][bands] in long double, a perfect diffuser's white, and linear BT.709 to XYZ."""
    real = np.longdouble
    cmf = (oracle.observer() if cmf is None else cmf).astype(real)
    power = np.asarray(light, real)
    fine = np.array([np.interp(oracle.NM, nm, r, left=0, right=0) for r in spectra]).astype(real)
    inside = ((oracle.NM >= nm[0]) & (oracle.NM <= nm[-1])).astype(real)
    scale = 1 / (power * cmf[1] * inside).sum()
    white = (cmf * power * inside).sum(1) * scale
    d65 = (cmf * oracle.illuminant("D65").astype(real) * inside).sum(1)
    return fine @ (cmf * power).T * scale, white, oracle.rgb_to_xyz((d65 / d65[1]).astype(float))


def worst_cie76(rgb, spectra, nm, light, cmf=None):
    xyz, white, to_xyz = integrated(spectra, nm, light, cmf)
    return oracle.cie76(oracle.lab(xyz, white), oracle.lab(rgb.astype(np.longdouble) @ to_xyz.T, white)).max()


def spectra_of(path):
    pixels, names = read_image(path)
    bands = sorted((oracle.parse_band(name), i) for i, name in enumerate(names) if name.startswith("T."))
    return np.array([nm for nm, _ in bands]), pixels[0][:, [i for _, i in bands]].astype(float)


@pytest.fixture(scope="module")
def few_colors(tmp_path_factory):
    rng = np.random.default_rng(4)
    corners = [[r, g, b] for r in (0, 1) for g in (0, 1) for b in (0, 1)]
    rows = np.concatenate([corners, [[v] * 3 for v in (1e-4, 0.02, 0.18, 0.99)], rng.random((16, 3)), rng.random((6, 3)) ** 6])
    return write_image(tmp_path_factory.mktemp("colors") / "colors.exr", rows.astype(np.float32)[None])


@pytest.mark.parametrize("method", METHODS)
def test_float_files_agree_with_independent_sums(method, few_colors, run, tmp_path):
    """Colours, coefficients and spectra of one method, under the same lights: 1e-3, of which floats alone take a few 1e-4."""
    common = ["--method", method, "--float", "--quiet"]
    run("spxuplift", few_colors, "-o", tmp_path / "spectra.exr", "--store", "spectral", "--bands", "380:780:5", *common, check=0)
    run("spxuplift", few_colors, "-o", tmp_path / "kept.exr", *common, check=0)
    nm, spectra = spectra_of(tmp_path / "spectra.exr")
    inputs = [(few_colors, common), (tmp_path / "kept.exr", common[2:])]
    if method in ("mallett2019", "jakob2019"):
        inputs.append((tmp_path / "spectra.exr", common[2:]))
    for path, options in inputs:
        run("spxrelight", path, "-i", ",".join(LIGHTS), "-o", tmp_path / "lit_{illuminant}.exr", *options, check=0)
        for light in LIGHTS:
            rgb = read_image(tmp_path / f"lit_{light}.exr")[0][0][:, :3]
            assert worst_cie76(rgb, spectra, nm, oracle.illuminant(light)) <= 1e-3, (path, light)


def test_what_integers_cannot_hold_is_counted(run, tmp_path, few_colors):
    run("spxrelight", few_colors, "-i", "P:2856,D:20000", "-o", tmp_path / "{illuminant}.exr", "--float", "--quiet", check=0)
    out = run("spxrelight", few_colors, "-i", "P:2856,D:20000", "-o", tmp_path / "{illuminant}.png", "--uint8", "--json", "-", check=0)
    for report in out.json()["outputs"]:
        name = report["output"].rsplit("/", 1)[-1][:-4]
        exact = read_image(tmp_path / f"{name}.exr")[0][..., :3].astype(float)
        # A sample counts that rounding to the nearest code does not bring into range.
        encoded = np.where(exact <= 0.0031308, 12.92 * exact, 1.055 * np.maximum(exact, 0) ** (1 / 2.4) - 0.055) * 255
        assert report["clipped"] == ((encoded < -0.5) | (encoded > 255.5)).sum() > 0
        codes = np.rint(read_image(tmp_path / f"{name}.png")[0][..., :3] * 255).astype(int)
        assert np.abs(codes - np.clip(encoded, 0, 255)).max() < 0.5 + 1e-3
    assert out.stderr.count("clipped") == 2


def test_the_list_is_searched_by_name_kind_and_title(run):
    with open(oracle.LUTS / "illuminants" / "lamps.csv", encoding="utf-8") as file:
        rows = [line.split(",") for line in file.read().splitlines()[1:]]
    found = run("spxrelight", "--list-illuminants", "LED", "--json", "-", check=0).json()["illuminants"]
    lamps = {int(e["name"][5:]) for e in found if e["name"].startswith("lamp:")}
    assert lamps == {int(r[0]) for r in rows if "led" in (r[1] + " " + r[2]).lower()} and len(lamps) > 100
    everything = run("spxrelight", "--list-illuminants", "", "--json", "-", check=0).json()["illuminants"]
    assert sum(e["name"].startswith("lamp:") for e in everything) == len(rows) == 401
    assert {"A", "D65", "E", "FL11", "FL3.15", "HP5", "F1"} <= {e["name"] for e in everything}


def test_a_file_of_both_is_lit_by_its_reflectances(run, tmp_path):
    nm = np.arange(400, 701, 20)
    rng = np.random.default_rng(8)
    names = [f"T.{v},0nm" for v in nm] + [f"S0.{v},0nm" for v in nm]
    pixels = rng.random((2, 3, 2 * len(nm))).astype(np.float32)
    write_image(tmp_path / "both.exr", pixels, names, {"spectralLayoutVersion": "1.0", "emissiveUnits": "W.m^-2.sr^-1"})
    out = run("spxrelight", tmp_path / "both.exr", "-i", "FL11", "-o", tmp_path / "lit.exr", "--float", "--explain", check=0)
    assert "emissive bands" in out.stdout + out.stderr
    expected = pixels[..., :len(nm)].astype(float) @ oracle.relight_matrix(nm, "FL11").T
    assert np.abs(read_image(tmp_path / "lit.exr")[0][..., :3] - expected).max() < 5e-6


def test_few_bands_keep_their_bound_and_say_so(run, tmp_path, few_colors):
    common = ["--method", "meng2015:matched", "-i", "FL11", "--float"]
    exact = run("spxrelight", few_colors, *common, "-o", tmp_path / "all.exr", "--explain", check=0)
    few = run("spxrelight", few_colors, *common, "-o", tmp_path / "few.exr", "--max-error", "0.5", "--explain", check=0)
    said = lambda out, key: [line.split(None, 1)[1] for line in (out.stdout + out.stderr).splitlines() if line.split()[:1] == [key]]
    assert said(exact, "bound")[0].startswith("exact") and not said(exact, "nodes")
    nodes, bound = said(few, "nodes")[0].split(" nm")[0].split(", "), float(said(few, "bound")[0].split()[1].rstrip(":"))
    assert 8 <= len(nodes) <= 40 and 0 < bound <= 0.5
    labs = []
    for name in ("all", "few"):
        white = oracle.weights(np.arange(380, 781, 5), oracle.illuminant("FL11")).sum(1)
        rgb = read_image(tmp_path / f"{name}.exr")[0][..., :3].astype(float)
        labs.append(oracle.lab(rgb @ oracle.bt709_matrix(np.arange(380, 781, 5)).T, white))
    assert 0 < oracle.cie76(*labs).max() <= bound


def measured():
    """Reflectances at 400 to 700 nm by 1 nm of every set that reaches so far."""
    fine, out = np.arange(400, 701), []
    for name in ("cie_tcs_380-780-5", "koivisto_400-700-5", "macbeth_390-730-5", "nickerson_400-700-5", "vrhel_390-730-2"):
        nm, columns = oracle.table(oracle.LUTS / "reflectances" / f"{name}.csv")
        out += [np.interp(fine, nm, r) for r in columns.values()]
    return fine, np.array(out)


def test_a_band_is_more_than_its_centre(run, tmp_path):
    """Samples of measured reflectances at 10 and 20 nm under lamps with lines: integrated over each band's kernel, and as who takes the
    lamp's value at the band's centre has them; both against sums at 1 nm."""
    fine, truth = measured()
    lights = ("FL2", "FL11", "lamp:1", "lamp:8")  # lamp:1: three LEDs; lamp:8: mercury
    power = {}
    nm, lamps = oracle.table(oracle.LUTS / "illuminants" / "lamps_380-780-5.csv")
    for light in lights:
        power[light] = np.interp(oracle.NM, nm, list(lamps.values())[int(light[5:]) - 1], left=0, right=0) if light[0] == "l" else oracle.illuminant(light)
    at = fine - oracle.NM[0]
    for step in (10, 20):
        bands = np.arange(400, 701, step)
        samples = np.clip(truth[:, bands - 400], 0, 1).astype(np.float32)
        write_spectral(tmp_path / f"s{step}.exr", samples[None], bands)
        run("spxrelight", tmp_path / f"s{step}.exr", "-i", ",".join(lights), "-o", tmp_path / "{illuminant}.exr", "--float", "--quiet", check=0)
        for light in lights:
            w = oracle.observer()[:, at] * power[light][at]
            exact = oracle.lab(truth @ w.T, w.sum(1))
            rgb = read_image(tmp_path / f"{light.replace(':', '_')}.exr")[0][0][:, :3].astype(float)
            ours = oracle.ciede2000(exact, oracle.lab(rgb @ oracle.bt709_matrix(bands).T, oracle.weights(bands, power[light]).sum(1)))
            point = w[:, bands - 400]
            naive = oracle.ciede2000(exact, oracle.lab(samples @ point.T, point.sum(1)))
            print(f"| {light} | {step} nm | {naive.mean():.2f} | {naive.max():.2f} | {ours.mean():.3f} | {ours.max():.2f} |")
            if light == "lamp:1":
                # No lines: what is left on both sides is what the reflectance does between its samples.
                assert ours.mean() < 1.25 * naive.mean()
            else:
                # At 20 nm what the reflectance does in between is the larger part of ours.
                assert ours.mean() < (0.15 if step == 10 else 0.5) * naive.mean()
