"""The whole path, texture to spectra and back, judged by readers and integrals that are not the library's."""

import hashlib
import os
import pathlib
import shutil
import subprocess
import sys
import time

import numpy as np
import OpenImageIO as oiio
import pytest

import oracle
from conftest import BIN, read_image, run_tool, write_image, write_spectral

IMAGES = pathlib.Path(os.environ.get("SPECTEX_TEST_IMAGES", "/usr/lib/python3/dist-packages/skimage/data"))


def picture(name):
    path = IMAGES / name
    if not path.is_file():
        pytest.skip(f"{path} is missing: install python3-skimage, or name a folder of its images in SPECTEX_TEST_IMAGES")
    return path


def spectral_planes(path, prefix="T."):
    """Bands ascending and [height][width][bands], over all parts."""
    found = {}
    source = oiio.ImageInput.open(str(path))
    assert source, oiio.geterror()
    part = 0
    while source.seek_subimage(part, 0):
        pixels = source.read_image(part, 0, 0, 1000000, "float")
        for i, name in enumerate(source.spec().channelnames):
            if name.startswith(prefix):
                found[oracle.parse_band(name)] = pixels[:, :, i]
        part += 1
    source.close()
    bands = sorted(found)
    return np.array(bands), np.stack([found[b] for b in bands], axis=-1)


def attributes(path):
    spec = oiio.ImageInput.open(str(path)).spec()
    return spec, {a.name: a.value for a in spec.extra_attribs}


def digest(path):
    return hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()


# Uplift.


@pytest.mark.parametrize("name", ["coffee.png", "chelsea.png"])
def test_spectra_reproject_to_the_picture(name, run, tmp_path):
    source = picture(name)
    out = tmp_path / "spectra.exr"
    report = run("spxuplift", source, "-o", out, "--store", "spectral", "--bands", 36, "--half", "--check", "--json", "-",
                 check=0).json()
    bands, spectra = spectral_planes(out)
    assert len(bands) == 36 and bands[0] == 380 and bands[-1] == 780
    assert np.allclose(np.diff(bands), 400 / 35, atol=2e-6)  # names keep six decimals
    assert spectra.min() >= 0 and spectra.max() <= 1
    rgb = spectra @ oracle.relight_matrix(bands, "D65").T
    original, _ = read_image(source, "uint8")
    assert np.array_equal(oracle.codes(rgb), original[:, :, :3])
    error = oracle.cie76(oracle.rgb_to_lab(rgb, bands), oracle.rgb_to_lab(oracle.srgb_decode(original[:, :, :3] / 255), bands))
    assert error.max() < 0.05  # the bound promised for half bands
    # The same pixels, metric and white: only the last digits of float arithmetic may differ.
    assert report["roundtrip"]["checked"] == "all"
    assert report["roundtrip"]["changed_codes"] == 0
    assert report["roundtrip"]["max"] == pytest.approx(error.max(), abs=2e-4)
    assert report["roundtrip"]["mean"] == pytest.approx(error.mean(), abs=2e-5)


def test_coefficients_are_the_linear_picture(run, tmp_path):
    source = picture("coffee.png")
    out = tmp_path / "coefficients.exr"
    run("spxuplift", source, "-o", out, check=0)
    stored, names = read_image(out)
    assert names == ["R", "G", "B"]
    original, _ = read_image(source, "uint8")
    linear = oracle.srgb_decode(original / 255)
    assert np.array_equal(stored.astype(np.float16), linear.astype(np.float32).astype(np.float16))
    assert np.array_equal(oracle.codes(stored), original)
    assert oracle.cie76(oracle.rgb_to_lab(stored), oracle.rgb_to_lab(linear)).max() < 0.06  # the bound for half coefficients
    # The model in the header is the kept set, to the digits of its table, and integrates to the identity.
    import json
    model = json.loads(attributes(out)[1]["spectex:model"])
    bands, basis = oracle.primaries()
    assert np.array_equal(model["bands"], bands)
    assert np.allclose(oracle.relight_matrix(bands, "D65") @ basis, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("method", ["meng2015"])
def test_coefficients_are_read_back_by_their_own_model(method, run, tmp_path):
    """Some models bear tables of a hundred kilobytes in the header."""
    source, out = tmp_path / "tile.png", tmp_path / "out.exr"
    write_image(source, np.random.default_rng(2).integers(0, 256, (8, 9, 3), dtype=np.uint8))
    stored = run("spxuplift", source, "-o", out, "--method", method, "--float", "--check", "--json", "-", check=0).json()
    read = run("spxdiff", source, out, "--json", "-", check=0).json()
    assert read["pixels"] == 72 and abs(read["changed_codes"] - stored["roundtrip"]["changed_codes"]) <= 1


def test_float_spectra_are_the_primaries(run, tmp_path):
    """With 5 nm bands the spectra are the kept primaries, mixed by linear RGB."""
    source = picture("chelsea.png")
    out = tmp_path / "spectra.exr"
    run("spxuplift", source, "-o", out, "--method", "mallett2019", "--store", "spectral", "--bands", "380:780:5", "--float", check=0)
    bands, spectra = spectral_planes(out)
    nm, basis = oracle.primaries()
    assert np.array_equal(bands, nm)
    linear = oracle.srgb_decode(read_image(source, "uint8")[0] / 255)
    assert np.abs(spectra - linear @ basis.T).max() < 1e-6  # a few float roundings of values up to 1


@pytest.mark.parametrize("tool", [["exrheader"], ["exrinfo", "-v"]])
@pytest.mark.parametrize("layout", ["single", "multipart"])
def test_openexr_tools_read_it(tool, layout, png, run, tmp_path):
    if not shutil.which(tool[0]):
        pytest.skip(f"{tool[0]} is not installed (package openexr)")
    out = tmp_path / "spectra.exr"
    run("spxuplift", png, "-o", out, "--store", "spectral", "--bands", 36, "--half", "--layout", layout, check=0)
    finished = subprocess.run([*tool, str(out)], capture_output=True, text=True, timeout=60)
    assert finished.returncode == 0, finished.stderr
    assert "T.380,000000nm" in finished.stdout and "T.780,000000nm" in finished.stdout
    if tool[0] == "exrheader":
        assert 'spectralLayoutVersion (type string): "1.0"' in finished.stdout
    if shutil.which("exrstdattr") and layout == "single":
        copy = tmp_path / "copy.exr"
        subprocess.run(["exrstdattr", "-owner", "nobody", str(out), str(copy)], check=True, timeout=60)
        assert np.array_equal(read_image(out)[0], read_image(copy)[0])


@pytest.mark.parametrize("compression", ["none", "rle", "zips", "zip", "piz"])
def test_lossless_compressions_hold_the_same(compression, png, run, tmp_path):
    out = tmp_path / "out.exr"
    run("spxuplift", png, "-o", out, "--store", "spectral", "--bands", 12, "--compression", compression, check=0)
    assert attributes(out)[1]["compression"] == compression
    plain = tmp_path / "plain.exr"
    run("spxuplift", png, "-o", plain, "--store", "spectral", "--bands", 12, check=0)
    assert np.array_equal(read_image(out)[0], read_image(plain)[0])


def test_multipart_is_read_part_by_part(png, run, tmp_path):
    out, single = tmp_path / "parts.exr", tmp_path / "single.exr"
    for path, layout in [(out, "multipart"), (single, "single")]:
        run("spxuplift", png, "-o", path, "--store", "spectral", "--bands", 36, "--half", "--layout", layout, check=0)
    source = oiio.ImageInput.open(str(out))
    assert source.seek_subimage(0, 0) and list(source.spec().channelnames) == ["R", "G", "B"]
    preview = source.read_image(0, 0, 0, 4, "float")
    assert source.seek_subimage(1, 0) and all(n.startswith("T.") for n in source.spec().channelnames)
    assert source.spec().nchannels == 36
    assert not source.seek_subimage(2, 0)
    source.close()
    pixels, names = read_image(single)
    assert names[:3] == ["R", "G", "B"]
    assert np.array_equal(preview, pixels[:, :, :3])
    for a, b in zip(spectral_planes(out), spectral_planes(single)):
        assert np.array_equal(a, b)
    relit = [tmp_path / "a.png", tmp_path / "b.png"]
    run("spxrelight", out, "-i", "FL11", "-o", relit[0], check=0)
    run("spxrelight", single, "-i", "FL11", "-o", relit[1], check=0)
    assert relit[0].read_bytes() == relit[1].read_bytes()


def test_preview_is_the_stored_reflectance_under_d65(png, gradient, run, tmp_path):
    out = tmp_path / "spectra.exr"
    run("spxuplift", png, "-o", out, "--store", "spectral", "--bands", 36, "--float", check=0)
    preview = read_image(out)[0][:, :, :3]
    assert np.abs(preview - oracle.srgb_decode(gradient / 255)).max() < 1e-5  # the preview is exact to float arithmetic


# Every code.


@pytest.fixture(scope="module")
def all_codes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("all")
    n = np.arange(1 << 24, dtype=np.uint32).reshape(4096, 4096)
    pixels = np.stack([n & 255, n >> 8 & 255, n >> 16], axis=-1).astype(np.uint8)
    return oracle.write_png(folder / "codes.png", pixels), pixels


@pytest.mark.parametrize("storage", [["--half"], ["--half", "--store", "spectral", "--bands", "36", "--compression", "none"]])
def test_all_codes_come_back(storage, all_codes, run, tmp_path):
    source, pixels = all_codes
    stored, back = tmp_path / "stored.exr", tmp_path / "back.png"
    run("spxuplift", source, "-o", stored, *storage, "--quiet", check=0, timeout=300)
    run("spxrelight", stored, "-i", "D65", "-o", back, "--quiet", check=0, timeout=300)
    stored.unlink()
    assert np.array_equal(read_image(back, "uint8")[0], pixels)


@pytest.mark.parametrize("storage, bound", [(["--half"], 0.06), (["--half", "--store", "spectral", "--bands", "36"], 0.05)])
def test_all_codes_measured(storage, bound, all_codes, run):
    report = run("spxdiff", "--roundtrip", all_codes[0], "--metric", "cie76", *storage, "--json", "-", check=0, timeout=300).json()
    assert report["pixels"] == 1 << 24
    assert report["changed_codes"] == 0 and report["nonfinite"] == 0
    assert 0 < report["max"] <= bound


# Relighting.


@pytest.fixture(scope="module")
def tile(tmp_path_factory):
    """A photograph's corner, small enough for floats in numpy; a random picture where there is none."""
    folder = tmp_path_factory.mktemp("tile")
    path = IMAGES / "coffee.png"
    if path.is_file():
        pixels = read_image(path, "uint8")[0][100:164, 200:320]
    else:
        pixels = np.random.default_rng(1).integers(0, 256, (64, 120, 3), dtype=np.uint8)
    pixels = pixels.copy()
    pixels[0, :4] = [[0, 0, 0], [255, 255, 255], [255, 0, 0], [0, 0, 255]]
    return write_image(folder / "tile.png", pixels), pixels


def model_relit(pixels, light, bands="mallett2019_cie1931_d65_bt709_380-780-5"):
    nm, basis = oracle.primaries(bands)
    return oracle.srgb_decode(pixels / 255) @ (oracle.relight_matrix(nm, light) @ basis).T


@pytest.fixture(scope="module")
def vertices(tmp_path_factory):
    """Spectra at the 9^3 vertices of the lattice, [r][g][b][bands], as a file of that texture holds them."""
    folder = tmp_path_factory.mktemp("vertices")
    r, g, b = np.mgrid[0:9, 0:9, 0:9].astype(np.float32) / 8
    texture = write_image(folder / "vertices.exr", np.stack([r, g, b], axis=3).reshape(27, 27, 3))
    out = folder / "spectra.exr"
    run_tool("spxuplift", texture, "-o", out, "--method", "lattice", "--store", "spectral", "--bands", "380:780:5", "--float", check=0)
    bands, spectra = spectral_planes(out)
    return bands, spectra.reshape(9, 9, 9, -1)


def lattice_relit(pixels, light, vertices):
    """The blend of relit vertices, by the order of the components within the cell (Kuhn's tetrahedra)."""
    bands, spectra = vertices
    relit = spectra @ oracle.relight_matrix(bands, light).T
    scaled = oracle.srgb_decode(pixels / 255) * 8
    cell = np.minimum(np.floor(scaled), 7).astype(int)
    place = scaled - cell
    order = np.argsort(-place, axis=2, kind="stable")
    sorted_place = np.take_along_axis(place, order, axis=2)
    total = (1 - sorted_place[..., :1]) * relit[tuple(cell[..., c] for c in range(3))]
    at = cell.copy()
    for k in range(3):
        np.put_along_axis(at, order[..., k : k + 1], np.take_along_axis(at, order[..., k : k + 1], axis=2) + 1, axis=2)
        weight = sorted_place[..., k] - (sorted_place[..., k + 1] if k < 2 else 0)
        total += weight[..., None] * relit[tuple(at[..., c] for c in range(3))]
    return total


@pytest.mark.parametrize("method", ["mallett2019", "lattice"])
@pytest.mark.parametrize("through", ["texture", "coefficients", "spectral"])
def test_relight_agrees_with_numpy(through, method, tile, run, tmp_path, vertices):
    source, pixels = tile
    # A photograph's sRGB goes to a model on 5 nm, unless --bands says otherwise: by option here, for all three the same.
    grid = ["--bands", "380:780:5"]
    stored = source
    if through != "texture":
        stored = tmp_path / "stored.exr"
        run("spxuplift", source, "-o", stored, "--method", method, "--float", *grid, *(["--store", "spectral"] if through == "spectral" else []), check=0)
    lights = ["A", "FL11", "D50", "E", "HP1"]
    run("spxrelight", stored, "-i", ",".join(lights), "-o", tmp_path / "{illuminant}.exr", "--float",
        *([*grid, "--method", method] if through == "texture" else []), check=0)
    for light in lights:
        relit, names = read_image(tmp_path / f"{light}.exr")
        assert names == ["R", "G", "B"]
        # Float samples and float sums: 1e-6 of the largest value, which is 2 to 3 under lamps as yellow as A and HP1.
        expected = model_relit(pixels, light) if method == "mallett2019" else lattice_relit(pixels, light, vertices)
        assert np.abs(relit - expected).max() < 5e-6


def test_relight_of_half_bands_agrees_with_numpy(tile, run, tmp_path):
    source, _ = tile
    stored = tmp_path / "stored.exr"
    run("spxuplift", source, "-o", stored, "--store", "spectral", "--bands", 36, "--half", check=0)
    bands, spectra = spectral_planes(stored)
    lights = ["A", "FL11", "FL2"]
    run("spxrelight", stored, "-i", ",".join(lights), "-o", tmp_path / "{illuminant}.exr", "--float", check=0)
    for light in lights:
        assert np.abs(read_image(tmp_path / f"{light}.exr")[0] - spectra @ oracle.relight_matrix(bands, light).T).max() < 5e-6  # float sums


@pytest.mark.parametrize("observer", ["cie1964", "cie2006-2", "cie2006-10"])
def test_observers(observer, tile, run, tmp_path):
    source, pixels = tile
    stored, out = tmp_path / "stored.exr", tmp_path / "out.exr"
    run("spxuplift", source, "-o", stored, "--store", "spectral", "--bands", "380:780:5", "--float", "--observer", observer, check=0)
    bands, spectra = spectral_planes(stored)
    cmf = oracle.observer(observer)
    back = spectra @ oracle.relight_matrix(bands, "D65", cmf).T
    assert np.abs(back - oracle.srgb_decode(pixels / 255)).max() < 1e-5  # solved for this observer: exact to float
    run("spxrelight", stored, "-i", "FL11", "-o", out, "--float", check=0)  # the file's own observer
    assert np.abs(read_image(out)[0] - spectra @ oracle.relight_matrix(bands, "FL11", cmf).T).max() < 5e-6
    # Another observer under the new light.
    run("spxrelight", stored, "-i", "FL11", "-o", out, "--float", "--observer", "cie1931", check=0)
    assert np.abs(read_image(out)[0] - spectra @ oracle.relight_matrix(bands, "FL11").T).max() < 5e-6


def test_several_lights_in_one_run(tile, run, tmp_path):
    source, _ = tile
    lights = ["A", "FL11", "D:5003", "P:2856"]
    report = run("spxrelight", source, "-i", ",".join(lights), "-o", tmp_path / "of_{illuminant}.exr", "--float", "--json", "-",
                 check=0).json()
    names = [tmp_path / f"of_{light.replace(':', '_')}.exr" for light in lights]
    assert sorted(tmp_path.iterdir()) == sorted(names)
    assert [o["output"] for o in report["outputs"]] == [str(n) for n in names]
    for light, name in zip(lights, names):
        alone = tmp_path / "alone.exr"
        run("spxrelight", source, "-i", light, "-o", alone, "--float", check=0)
        assert np.array_equal(read_image(alone)[0], read_image(name)[0])
    # P:2856 uses another second radiation constant than illuminant A: near it, not it.
    a, planck = (read_image(names[i])[0] for i in (0, 3))
    assert 0 < np.abs(a - planck).max() < 5e-3


def test_illuminant_from_file(tile, run, tmp_path):
    source, pixels = tile
    lamp = tmp_path / "my lamp.csv"
    power = oracle.illuminant("FL2")
    lamp.write_text("nm,power\n" + "".join(f"{nm},{p:.9g}\n" for nm, p in zip(oracle.NM, power) if 380 <= nm <= 780))
    out = tmp_path / "lit_{illuminant}.exr"
    run("spxrelight", source, "-i", lamp, "-o", out, "--float", "--bands", "380:780:5", "--method", "mallett2019", check=0)
    written = tmp_path / "lit_my_lamp.exr"
    assert np.abs(read_image(written)[0] - model_relit(pixels, "FL2")).max() < 5e-6
    # Of any scale: only relative power counts.
    scaled = tmp_path / "scaled.csv"
    scaled.write_text("".join(f"{nm};{p * 1e-9:.9g}\n" for nm, p in zip(oracle.NM, power) if 380 <= nm <= 780))
    run("spxrelight", source, "-i", scaled, "-o", tmp_path / "s.exr", "--float", "--bands", "380:780:5", "--method", "mallett2019",
        check=0)
    assert np.abs(read_image(tmp_path / "s.exr")[0] - read_image(written)[0]).max() < 1e-6


def test_mixture_lies_between(tile, run, tmp_path):
    source, pixels = tile
    out = tmp_path / "mix.exr"
    run("spxrelight", source, "-i", "0.7*A+0.3*FL11", "-o", out, "--float", "--bands", "380:780:5", "--method", "mallett2019", check=0)
    # Equal luminances are normalised over 360 to 830 nm, the picture over 380 to 780: 5e-5 of A lies outside.
    expected = 0.7 * model_relit(pixels, "A") + 0.3 * model_relit(pixels, "FL11")
    assert np.abs(read_image(out)[0] - expected).max() < 2e-4


@pytest.mark.parametrize("suffix, option, kind", [
    (".png", [], "uint8"), (".png", ["--uint16"], "uint16"), (".tif", ["--uint8"], "uint8"), (".tif", [], "float"), (".tif", ["--uint16"], "uint16"),
    (".exr", [], "half"), (".exr", ["--half"], "half"), (".exr", ["--float"], "float")])
def test_output_types(suffix, option, kind, tile, run, tmp_path):
    source, pixels = tile
    stored, out = tmp_path / "stored.exr", tmp_path / ("out" + suffix)
    run("spxuplift", source, "-o", stored, check=0)
    run("spxrelight", stored, "-i", "D65", "-o", out, *option, check=0)
    spec = oiio.ImageInput.open(str(out)).spec()
    assert str(spec.format) == kind
    got, _ = read_image(out)
    expected = oracle.srgb_decode(pixels / 255)
    if kind.startswith("uint"):
        expected = oracle.srgb_encode(expected)
    # Two roundings of a value up to 1: coefficient to half and output to its type (half: 2^-11 each).
    bound = {"uint8": 0.5 / 255 + 1e-6, "uint16": 4e-4, "half": 6e-4, "float": 3e-4}[kind]
    assert np.abs(got - expected).max() <= bound


@pytest.mark.parametrize("name, decode", [("Linear Rec.709 (sRGB)", lambda v: v), ("sRGB - Texture", oracle.srgb_decode),
                                          ("Gamma 2.2 Rec.709 - Texture", lambda v: np.maximum(v, 0) ** 2.2)])
def test_output_colorspace(name, decode, tile, run, tmp_path):
    source, pixels = tile
    out = tmp_path / "out.exr"
    run("spxrelight", source, "-i", "D65", "-o", out, "--float", "--output-colorspace", name, check=0)
    assert np.abs(decode(read_image(out)[0].astype(float)) - oracle.srgb_decode(pixels / 255)).max() < 1e-5


def test_output_in_acescg_keeps_colours(tile, run, tmp_path):
    """ACEScg's white is D60: what comes out, read back as ACEScg, is the picture."""
    source, pixels = tile
    out, back = tmp_path / "out.exr", tmp_path / "back.png"
    run("spxrelight", source, "-i", "D65", "-o", out, "--float", "--output-colorspace", "ACEScg", check=0)
    assert np.abs(read_image(out)[0] - oracle.srgb_decode(pixels / 255)).max() > 0.01  # other numbers
    run("spxrelight", out, "-i", "D65", "-o", back, "--input-colorspace", "ACEScg", check=0)
    assert np.abs(read_image(back, "uint8")[0].astype(int) - pixels).max() <= 1  # two float matrices, one code at the most


@pytest.mark.parametrize("method", ["vonkries", "bradford", "cat02", "cat16"])
def test_adaptation_keeps_white_white(method, tile, run, tmp_path):
    source, pixels = tile
    lights = ["A", "FL11", "D50"]
    run("spxrelight", source, "-i", ",".join(lights), "-o", tmp_path / "{illuminant}.exr", "--float", "--adapt", method, check=0)
    linear = oracle.srgb_decode(pixels / 255)
    for light in lights:
        relit, _ = read_image(tmp_path / f"{light}.exr")
        assert np.abs(relit[0, 1] - 1).max() < 2e-6  # the white texel: a sum of floats near 1
        assert np.array_equal(relit[0, 0], [0, 0, 0])
        # Colours change less than without adaptation.
        assert np.abs(relit - linear).mean() < np.abs(model_relit(pixels, light) - linear).mean()


def test_adaptation_to_d65_is_none(tile, run, tmp_path):
    source, _ = tile
    outs = [tmp_path / f"{m}.exr" for m in ("none", "bradford")]
    for out in outs:
        run("spxrelight", source, "-i", "D65", "-o", out, "--float", "--adapt", out.stem, check=0)
    assert np.abs(read_image(outs[0])[0] - read_image(outs[1])[0]).max() < 1e-6


def test_bradford_by_its_published_matrix(tile, run, tmp_path):
    source, pixels = tile
    out = tmp_path / "out.exr"
    run("spxrelight", source, "-i", "A", "-o", out, "--float", "--adapt", "bradford", "--bands", "380:780:5", "--method", "mallett2019",
        check=0)
    cone = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])  # Lam 1985; ICC.1 annex E
    nm, basis = oracle.primaries()
    lamp, d65 = oracle.weights(nm, oracle.illuminant("A")), oracle.weights(nm, oracle.illuminant("D65"))
    adapt = np.linalg.inv(cone) @ np.diag((cone @ d65.sum(1)) / (cone @ lamp.sum(1))) @ cone
    m = np.linalg.solve(oracle.bt709_matrix(nm), adapt @ lamp @ basis)
    assert np.abs(read_image(out)[0] - oracle.srgb_decode(pixels / 255) @ m.T).max() < 5e-6


def test_normalize_none_keeps_power(tile, run, tmp_path):
    source, _ = tile
    relative, out = tmp_path / "lamp.csv", tmp_path / "out.exr"
    d65 = oracle.illuminant("D65")
    relative.write_text("".join(f"{nm},{p / 4:.12g}\n" for nm, p in zip(oracle.NM, d65)))
    run("spxrelight", source, "-i", relative, "-o", out, "--float", "--normalize", "none", check=0)
    plain = tmp_path / "plain.exr"
    run("spxrelight", source, "-i", "D65", "-o", plain, "--float", check=0)
    # Of D65's luminance over 360-830 nm all but 1e-4 lies in 380-780 nm, over which the picture is integrated.
    assert np.abs(read_image(out)[0] - read_image(plain)[0] / 4).max() < 1e-4
    run("spxrelight", source, "-i", relative, "-o", out, "--float", "--normalize", "luminance", check=0)
    assert np.abs(read_image(out)[0] - read_image(plain)[0]).max() < 1e-5


# Other writers' spectra.


def by_hand(path, names, spectra, attributes=None):
    return write_image(path, spectra.astype(np.float32), names, {"spectralLayoutVersion": "1.0", **(attributes or {})})


def curve(nm):
    nm = np.asarray(nm, dtype=float)
    return np.array([[0.5 + 0.4 * np.sin(nm / 60), np.interp(nm, [400, 700], [0.1, 0.9])],
                     [np.full(nm.shape, 1.0), np.exp(-((nm - 550) / 40) ** 2)]])


UNEVEN = [400, 412.5, 450, 500, 510, 560, 610, 620, 655, 700]
C_NM = 299792458e9


@pytest.mark.parametrize("spell", [
    lambda nm: f"T.{nm}nm", lambda nm: f"T.{nm:.1f}nm", lambda nm: f"T.{nm:.6f}nm".replace(".", ",").replace("T,", "T.", 1),
    lambda nm: f"T.{nm:.1f}nm".replace(".", ",").replace("T,", "T.", 1), lambda nm: f"T.{nm:g}e0nm", lambda nm: f"T.{nm / 1000:.7f}um",
    lambda nm: f"T.{nm * 1e-9:.9e}m", lambda nm: f"T.{C_NM / nm / 1e12:.9f}THz", lambda nm: f"T.{C_NM / nm:.9e}Hz"])
def test_spelling_variants(spell, run, tmp_path):
    source = by_hand(tmp_path / "other.exr", [spell(float(nm)) for nm in UNEVEN], curve(UNEVEN))
    out = tmp_path / "out.exr"
    run("spxrelight", source, "-i", "FL11", "-o", out, "--float", check=0)
    expected = curve(UNEVEN) @ oracle.relight_matrix(UNEVEN, "FL11").T
    assert np.abs(read_image(out)[0] - expected).max() < 5e-6  # float sums; names of 9 digits


def test_bands_in_any_order(run, tmp_path):
    order = np.random.default_rng(3).permutation(len(UNEVEN))
    names = [f"T.{float(UNEVEN[i]):.1f}nm" for i in order]
    source = by_hand(tmp_path / "shuffled.exr", names, curve(UNEVEN)[:, :, order])
    out = tmp_path / "out.exr"
    run("spxrelight", source, "-i", "A", "-o", out, "--float", check=0)
    assert np.abs(read_image(out)[0] - curve(UNEVEN) @ oracle.relight_matrix(UNEVEN, "A").T).max() < 5e-6


def test_numeric_not_lexical_order(run, tmp_path):
    """As text, T.1000nm comes before T.400nm."""
    nm = [400, 500, 600, 700, 1000]
    source = by_hand(tmp_path / "ir.exr", [f"T.{v}nm" for v in nm], curve(nm))
    out = tmp_path / "out.exr"
    run("spxrelight", source, "-i", "A", "-o", out, "--float", check=0)
    assert np.abs(read_image(out)[0] - curve(nm) @ oracle.relight_matrix(nm, "A").T).max() < 5e-6


def test_emissive(run, tmp_path):
    source = by_hand(tmp_path / "light.exr", [f"S0.{v:.1f}nm".replace(".", ",").replace("S0,", "S0.") for v in UNEVEN],
                     curve(UNEVEN), {"emissiveUnits": "W.m^-2.sr^-1.nm^-1"})
    out = tmp_path / "out.exr"
    report = run("spxrelight", source, "-o", out, "--float", "-i", "A", "--json", "-").json()
    assert report["kind"] == "spectral"
    relit, _ = read_image(out)
    xyz = oracle.weights(UNEVEN, np.ones(oracle.NM.size))  # the observer alone, Y = 1 for a radiance of 1
    assert np.abs(relit - curve(UNEVEN) @ np.linalg.solve(oracle.bt709_matrix(UNEVEN), xyz).T).max() < 5e-6


def test_grids_of_other_writers(run, tmp_path):
    for nm in [np.arange(400, 701, 10), np.arange(380, 781, 1), np.linspace(395, 705, 7), np.array([450.0, 550, 650])]:
        spectra = curve(nm)
        source = write_spectral(tmp_path / f"grid{len(nm)}.exr", spectra, nm)
        out = tmp_path / "out.exr"
        run("spxrelight", source, "-i", "FL11", "-o", out, "--float", check=0)
        bands = [oracle.parse_band(f"T.{v:.6f}nm") for v in nm]
        assert np.abs(read_image(out)[0] - spectra @ oracle.relight_matrix(bands, "FL11").T).max() < 1e-5


# What is not colour.


def test_extra_float_channel_passes_untouched(run, tmp_path):
    rng = np.random.default_rng(5)
    pixels = rng.random((9, 13, 5)).astype(np.float32)
    pixels[:, :, 3] = rng.random((9, 13))
    pixels[:, :, 4] = 42
    pixels[2, 3, 4] = 1234567.0
    pixels[4, 4, 4] = -np.inf
    source = write_image(tmp_path / "in.exr", pixels, ["R", "G", "B", "A", "depth.id"])
    for options in [[], ["--store", "spectral", "--bands", "12"], ["--layout", "multipart"],
                    ["--layout", "multipart", "--store", "spectral", "--bands", "12"]]:
        stored, relit = tmp_path / "stored.exr", tmp_path / "relit.exr"
        run("spxuplift", source, "-o", stored, *options, "--float", check=0)
        run("spxrelight", stored, "-i", "A", "-o", relit, "--float", check=0)
        for path in (stored, relit):
            part = oiio.ImageBuf(str(path))
            names = list(part.spec().channelnames)
            values = part.get_pixels("float")
            for index, name in [(3, "A"), (4, "depth.id")]:
                at = [i for i, n in enumerate(names) if n == name or n.endswith("." + name)]
                assert at, (path, options, names)
                assert np.array_equal(values[:, :, at[0]], pixels[:, :, index]), (path, options, name)
    direct = tmp_path / "direct.exr"
    run("spxrelight", source, "-i", "A", "-o", direct, "--float", check=0)
    values, names = read_image(direct)
    assert np.array_equal(values[:, :, names.index("depth.id")], pixels[:, :, 4])


@pytest.mark.parametrize("options", [[], ["--store", "spectral", "--bands", "36"], ["--layout", "multipart"], None])
def test_straight_alpha_and_the_colours_under_it(options, run, tmp_path):
    rng = np.random.default_rng(6)
    pixels = rng.integers(0, 256, (17, 31, 4), dtype=np.uint8)
    pixels[:4, :, 3] = 0  # fully transparent, coloured all the same
    pixels[4, :, 3] = 1
    source = oracle.write_png(tmp_path / "in.png", pixels)
    stored, back = tmp_path / "stored.exr", tmp_path / "back.png"
    if options is None:
        stored = source
    else:
        run("spxuplift", source, "-o", stored, *options, check=0)
    run("spxrelight", stored, "-i", "D65", "-o", back, check=0)
    reader = oiio.ImageInput.open(str(back), configured())
    got = reader.read_image("uint8")
    reader.close()
    assert np.array_equal(got, pixels)


def configured():
    """Straight alpha as it is in the file, not multiplied in on the way."""
    spec = oiio.ImageSpec()
    spec.attribute("oiio:UnassociatedAlpha", 1)
    return spec


def test_straight_alpha_of_16_bits(run, tmp_path):
    rng = np.random.default_rng(7)
    pixels = rng.integers(0, 65536, (8, 9, 4)).astype(np.uint16)
    pixels[0, :, 3] = 0
    spec = oiio.ImageSpec(9, 8, 4, "uint16")
    spec.attribute("oiio:UnassociatedAlpha", 1)
    source = tmp_path / "in.png"
    writer = oiio.ImageOutput.create(str(source))
    assert writer.open(str(source), spec) and writer.write_image(pixels) and writer.close()
    stored, back = tmp_path / "stored.exr", tmp_path / "back.png"
    run("spxuplift", source, "-o", stored, check=0)
    run("spxrelight", stored, "-i", "D65", "-o", back, "--uint16", check=0)
    reader = oiio.ImageInput.open(str(back), configured())
    got = reader.read_image("uint16").astype(int)
    assert np.array_equal(got[:, :, 3], pixels[:, :, 3])
    assert np.abs(got - pixels).max() <= 1  # float coefficients: within the last of 65536 codes


def test_placement_and_metadata_are_kept(run, tmp_path):
    rng = np.random.default_rng(8)
    spec = oiio.ImageSpec(12, 10, 3, "half")
    spec.x, spec.y, spec.full_x, spec.full_y, spec.full_width, spec.full_height = 5, -3, 0, 0, 40, 30
    spec.attribute("Orientation", 6)
    spec.attribute("PixelAspectRatio", 2.0)
    spec.attribute("DateTime", "2001:02:03 04:05:06")
    spec.attribute("Copyright", "nobody")
    source = tmp_path / "in.exr"
    writer = oiio.ImageOutput.create(str(source))
    assert writer.open(str(source), spec) and writer.write_image(rng.random((10, 12, 3)).astype(np.float16)) and writer.close()
    written = []
    for name, options in [("coefficients", []), ("spectral", ["--store", "spectral", "--bands", "8"]), ("parts", ["--layout", "multipart"])]:
        stored, relit = tmp_path / f"{name}.exr", tmp_path / f"{name}_relit.exr"
        run("spxuplift", source, "-o", stored, *options, check=0)
        run("spxrelight", stored, "-i", "A", "-o", relit, check=0)
        written += [stored, relit]
    direct = tmp_path / "direct.exr"
    run("spxrelight", source, "-i", "A", "-o", direct, check=0)
    for path in [*written, direct]:
        got, found = attributes(path)
        assert (got.x, got.y, got.width, got.height) == (5, -3, 12, 10), path
        assert (got.full_x, got.full_y, got.full_width, got.full_height) == (0, 0, 40, 30), path
        assert found.get("Orientation") == 6, path
        assert found.get("PixelAspectRatio") == 2.0, path
        assert found.get("DateTime") == "2001:02:03 04:05:06", path
        assert found.get("Copyright") == "nobody", path


def test_no_time_of_day_and_the_same_bytes(png, tile, run, tmp_path):
    jobs = [("spxuplift", ".exr", []), ("spxuplift", ".exr", ["--store", "spectral", "--bands", "36", "--half"]),
            ("spxuplift", ".exr", ["--store", "spectral", "--bands", "36", "--layout", "multipart", "--compression", "piz"]),
            ("spxrelight", ".exr", ["-i", "A"]), ("spxrelight", ".png", ["-i", "FL11"]), ("spxrelight", ".tif", ["-i", "FL11"]),
            ("spxdiff", "map", [])]
    first = {}
    for threads in [1, 2]:
        time.sleep(1.1)  # a time of day would now differ by a second
        for i, (tool, suffix, options) in enumerate(jobs):
            out = tmp_path / f"out{i}{suffix if suffix.startswith('.') else '.exr'}"
            if tool == "spxdiff":
                lit = tmp_path / "out4.png"
                run(tool, tile[0], lit, "--map", out, "--threads", threads, check=0)
            else:
                run(tool, tile[0], "-o", out, *options, "--threads", threads, check=0)
            assert first.setdefault(i, digest(out)) == digest(out), jobs[i]
            found = attributes(out)[1]
            assert "capDate" not in found and "DateTime" not in found, found


# Every kind of picture.


@pytest.mark.parametrize("name", ["coffee.png", "chelsea.png", "rocket.jpg", "hubble_deep_field.jpg", "palette_color.png",
                                  "green_palette.png", "chessboard_GRAY_U16.tif", "foo3x5x4indexed.png",
                                  "brick.png", "moon.png", "checker_bilevel.png", "bw_text.png", "color.png", "logo.png", "retina.jpg"])
def test_pictures_come_back(name, run, tmp_path):
    source = picture(name)
    probe = oiio.ImageInput.open(str(source), configured())
    wide = str(probe.spec().format) == "uint16"
    stored, back = tmp_path / "stored.exr", tmp_path / "back.png"
    # By option, for some carry other profiles: then codes come back only in spaces that have names.
    run("spxuplift", source, "-o", stored, "--input-colorspace", "sRGB - Texture", check=0)
    run("spxrelight", stored, "-i", "D65", "-o", back, *(["--uint16"] if wide else []), check=0)
    original = probe.read_image("uint16" if wide else "uint8").astype(int)
    got = oiio.ImageInput.open(str(back), configured()).read_image("uint16" if wide else "uint8").astype(int)
    if original.shape[2] <= 2:  # grey: three equal channels, then alpha
        original = np.concatenate([np.repeat(original[:, :, :1], 3, axis=2), original[:, :, 1:]], axis=2)
    assert got.shape == original.shape
    # 16-bit textures are stored as float, whose linear values keep each code to within one.
    assert np.abs(got - original).max() <= (1 if wide else 0)


@pytest.mark.parametrize("name, space", [("rocket.jpg", "Adobe RGB (1998)"), ("coffee.png", "sRGB - Texture"),
                                         ("multipage_rgb.tif", "Linear Rec.709 (sRGB)"), ("color.png", "ICC profile: Color LCD")])
def test_spaces_are_found(name, space, run, tmp_path):
    report = run("spxuplift", picture(name), "-o", tmp_path / "out.exr", "--check", "--json", "-", check=0).json()
    assert report["colorspace"] == space and report["colorspace_reason"]
    assert report["nonfinite"] == 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 1000), (1000, 1), (17, 33), (3, 70000)])
def test_sizes(shape, run, tmp_path):
    pixels = np.random.default_rng(9).integers(0, 256, (*shape, 3), dtype=np.uint8)
    source = oracle.write_png(tmp_path / "in.png", pixels)
    stored, back = tmp_path / "stored.exr", tmp_path / "back.png"
    run("spxuplift", source, "-o", stored, "--store", "spectral", "--bands", "7", check=0)
    run("spxrelight", stored, "-i", "D65", "-o", back, check=0)
    assert np.array_equal(read_image(back, "uint8")[0], pixels)


@pytest.mark.parametrize("suffix, kind", [
    (".tif", np.uint8), (".tif", np.uint16), (".tif", np.float32), (".exr", np.float16), (".exr", np.float32), (".png", np.uint16),
    (".tga", np.uint8), (".bmp", np.uint8), (".hdr", np.float32)])
def test_sample_types(suffix, kind, run, tmp_path):
    rng = np.random.default_rng(10)
    integer = np.issubdtype(kind, np.integer)
    pixels = rng.integers(0, np.iinfo(kind).max + 1, (20, 30, 3)).astype(kind) if integer else rng.random((20, 30, 3)).astype(kind)
    source, stored = tmp_path / ("in" + suffix), tmp_path / "stored.exr"
    write_image(source, pixels)
    run("spxuplift", source, "-o", stored, "--float", "--input-colorspace", "sRGB - Texture" if integer else "Linear Rec.709 (sRGB)", check=0)
    values = read_image(source)[0].astype(float)
    linear = oracle.srgb_decode(values) if integer else values
    assert np.abs(read_image(stored)[0] - linear).max() < 1e-6  # float rounding of values up to 1


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_tiled_tiff(channels, run, tmp_path):
    pixels = np.random.default_rng(11).integers(0, 256, (150, 200, channels), dtype=np.uint8)
    if channels in (2, 4):
        pixels[:, :, -1] = 255
    spec = oiio.ImageSpec(200, 150, channels, "uint8")
    if channels == 2:
        spec.channelnames, spec.alpha_channel = ["Y", "A"], 1
    spec.tile_width, spec.tile_height = 64, 32
    source = tmp_path / "tiled.tif"
    writer = oiio.ImageOutput.create(str(source))
    assert writer.open(str(source), spec) and writer.write_image(pixels) and writer.close()
    stored, back = tmp_path / "stored.exr", tmp_path / "back.png"
    run("spxuplift", source, "-o", stored, check=0)
    run("spxrelight", stored, "-i", "D65", "-o", back, check=0)
    got = oiio.ImageInput.open(str(back), configured()).read_image("uint8")
    colour = pixels[:, :, :1] if channels <= 2 else pixels[:, :, :3]
    assert np.array_equal(got[:, :, :3], np.broadcast_to(colour, (150, 200, 3)))


def test_many_inputs_into_a_folder(run, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    rng = np.random.default_rng(12)
    for i in range(3):
        write_image(tmp_path / f"in{i}.png", rng.integers(0, 256, (5, 5, 3), dtype=np.uint8))
    report = run("spxuplift", tmp_path / "in*.png", "-o", folder, "--json", "-", check=0).json()
    assert [pathlib.Path(r["input"]).name for r in report] == ["in0.png", "in1.png", "in2.png"]
    assert sorted(p.name for p in folder.iterdir()) == ["in0.exr", "in1.exr", "in2.exr"]
    assert [r["output"] for r in report] == [str(folder / f"in{i}.exr") for i in range(3)]


def test_memory_is_bounded(run, tmp_path):
    """36 half bands of 8192 x 8192 are 4.8 GB: the peak must be of strips, not of the picture."""
    y, x = np.mgrid[0:128, 0:128].astype(np.uint8)
    blocks = np.stack([x * 2, y * 2, x + y], axis=-1)
    pixels = np.repeat(np.repeat(blocks, 64, axis=0), 64, axis=1)
    source = oracle.write_png(tmp_path / "large.png", pixels)
    del pixels
    out = tmp_path / "large.exr"
    command = [str(BIN / "spxuplift"), str(source), "-o", str(out), "--store", "spectral", "--bands", "36", "--half",
               "--compression", "rle", "--quiet"]
    # A child's peak counts the memory of the process it was forked from: a small one stands between.
    starter = "import os, sys; _, s, u = os.wait4(os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ), 0); " \
              "print(os.waitstatus_to_exitcode(s), u.ru_maxrss)"
    finished = subprocess.run([sys.executable, "-c", starter, *command], capture_output=True, text=True, timeout=300)
    code, peak_kilobytes = map(int, finished.stdout.split())
    assert code == 0, finished.stderr
    assert peak_kilobytes < 400 * 1024
    spec = oiio.ImageInput.open(str(out)).spec()
    assert (spec.width, spec.height, spec.nchannels) == (8192, 8192, 39)
