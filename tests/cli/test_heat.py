"""Pictures of differences, and the differences themselves against numpy."""

import pathlib

import numpy as np
import OpenImageIO as oiio
import pytest

import oracle
from conftest import read_image, write_image

GOLDEN = oracle.ROOT / "tests" / "golden" / "heatmap_magma_legend.png"


def synthetic(width=320, height=200):
    """A ramp with rings: every part of the scale, none of it flat."""
    y, x = np.mgrid[0:height, 0:width]
    return (17 * x / width + 17 * (1 + np.sin(np.hypot(x - 100, y - 90) / 9)) / 2).astype(np.float32)


def write_map(path, values):
    return write_image(path, values.astype(np.float32), ["Y"])


def png(path):
    return read_image(path, "uint8")[0][:, :, :3]


@pytest.fixture
def error_map(tmp_path):
    return write_map(tmp_path / "map.exr", synthetic())


def test_plain_map_has_its_size(error_map, run, tmp_path):
    out = tmp_path / "heat.png"
    report = run("spxheat", error_map, "-o", out, "--range", "0:35", "--json", "-", check=0).json()
    assert png(out).shape == (200, 320, 3)
    assert (report["width"], report["height"], report["range"]) == (320, 200, [0, 35])
    values = synthetic()
    assert report["pixels"] == values.size and report["nonfinite"] == 0
    assert report["mean"] == pytest.approx(values.astype(float).mean(), rel=1e-6)
    assert report["max"] == pytest.approx(values.max(), rel=1e-6)
    assert report["above"] == 0 and report["below"] == 0


def test_colours_follow_values(error_map, run, tmp_path):
    """The same value gives the same colour, and brightness rises with it: magma and viridis are made so."""
    for name in ("magma", "viridis"):
        out = tmp_path / "heat.png"
        run("spxheat", error_map, "-o", out, "--range", "0:35", "--colormap", name, check=0)
        values, colours = synthetic().ravel(), png(out).reshape(-1, 3)
        order = np.argsort(values)
        lightness = oracle.rgb_to_lab(oracle.srgb_decode(colours[order] / 255))[:, 0]
        smooth = lightness[: len(lightness) // 64 * 64].reshape(-1, 64).mean(axis=1)
        assert np.all(np.diff(smooth) > -0.5)  # 8-bit steps of three channels
        assert smooth[-1] - smooth[0] > 50


def test_range_clips_and_counts(error_map, run, tmp_path):
    out = tmp_path / "heat.png"
    report = run("spxheat", error_map, "-o", out, "--range", "5:20", "--json", "-", check=0).json()
    values = synthetic()
    assert report["above"] == int((values > 20).sum()) and report["below"] == int((values < 5).sum())
    colours = png(out)
    assert len(np.unique(colours[values > 20], axis=0)) == 1 and len(np.unique(colours[values < 5], axis=0)) == 1


def test_default_range(error_map, run, tmp_path):
    report = run("spxheat", error_map, "-o", tmp_path / "heat.png", "--json", "-", check=0).json()
    p999 = np.percentile(synthetic(), 99.9)
    low, high = report["range"]
    assert low == 0 and p999 <= high <= 2.5 * p999


def test_legend_stands_beside(error_map, run, tmp_path):
    plain, legend = tmp_path / "plain.png", tmp_path / "legend.png"
    run("spxheat", error_map, "-o", plain, "--range", "0:35", check=0)
    report = run("spxheat", error_map, "-o", legend, "--range", "0:35", "--legend", "--json", "-", check=0).json()
    a, b = png(plain), png(legend)
    assert b.shape[0] == report["height"] and b.shape[1] == report["width"]
    factor = -(-report["height"] // 200)
    assert report["height"] == 200 * factor and report["width"] > 320 * factor
    assert np.array_equal(b[:, :320 * factor], np.repeat(np.repeat(a, factor, axis=0), factor, axis=1))
    bar = b[:, 320 * factor:]
    assert len(np.unique(bar.reshape(-1, 3), axis=0)) > 200  # the scale's colours, and text
    for colour in a.reshape(-1, 3)[::997]:  # every colour of the map is on the scale, within the scale's own steps
        assert np.abs(bar.reshape(-1, 3).astype(int) - colour).max(axis=1).min() <= 4


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (40, 2)])
def test_small_maps_are_enlarged_for_the_legend(shape, run, tmp_path):
    values = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    source, out = write_map(tmp_path / "map.exr", values), tmp_path / "heat.png"
    report = run("spxheat", source, "-o", out, "--legend", "--range", "0:35", "--json", "-", check=0).json()
    picture = png(out)
    assert picture.shape[0] >= 100 and picture.shape[0] % shape[0] == 0
    factor = picture.shape[0] // shape[0]
    assert report["height"] == picture.shape[0]
    for y in range(shape[0]):
        for x in range(shape[1]):
            block = picture[y * factor:(y + 1) * factor, x * factor:(x + 1) * factor]
            assert len(np.unique(block.reshape(-1, 3), axis=0)) == 1


@pytest.mark.parametrize("legend", [[], ["--legend"]])
def test_zero_map(legend, run, tmp_path):
    source, out = write_map(tmp_path / "map.exr", np.zeros((120, 60))), tmp_path / "heat.png"
    report = run("spxheat", source, "-o", out, *legend, "--json", "-", check=0).json()
    assert report["max"] == 0 and report["range"][1] > 0
    assert len(np.unique(png(out)[:, :60].reshape(-1, 3), axis=0)) == 1


def test_map_without_numbers(run, tmp_path):
    values = np.full((120, 80), np.nan, dtype=np.float32)
    source, out = write_map(tmp_path / "nan.exr", values), tmp_path / "heat.png"
    report = run("spxheat", source, "-o", out, "--legend", "--json", "-", check=0).json()
    assert report["nonfinite"] == 9600 and report["pixels"] == 0
    missing = png(out)[0, 0]
    values[:60] = 3
    values[0, 0] = np.inf
    source = write_map(tmp_path / "half.exr", values)
    report = run("spxheat", source, "-o", out, "--range", "0:35", "--json", "-", check=0).json()
    assert report["nonfinite"] == 4801 and report["mean"] == 3
    picture = png(out)
    assert np.array_equal(picture[100, 10], missing) and not np.array_equal(picture[30, 10], missing)
    assert run("spxheat", source, "-o", tmp_path / "strict.png", "--strict").code == 2
    assert not (tmp_path / "strict.png").exists()


def test_two_images(png_pair, run, tmp_path):
    a, b, first, second = png_pair
    out = tmp_path / "heat.png"
    report = run("spxheat", a, b, "-o", out, "--legend", "--range", "0:35", "--json", "-", check=0).json()
    assert isinstance(report, dict) and report["metric"] == "cie76"
    expected = oracle.cie76(lab(first), lab(second))
    assert report["mean"] == pytest.approx(expected.mean(), abs=1e-3)  # float arithmetic of Lab values up to 100


def test_golden_picture(error_map, run, tmp_path):
    """Text is drawn by the system's fonts: letters may move by a pixel, the map and the scale may not."""
    out = tmp_path / "heat.png"
    run("spxheat", error_map, "-o", out, "--range", "0:35", "--legend", check=0)
    got, golden = png(out).astype(int), png(GOLDEN).astype(int)
    assert got.shape[0] == golden.shape[0] and abs(got.shape[1] - golden.shape[1]) <= 16
    factor = got.shape[0] // 200
    assert np.abs(got[:, :320 * factor] - golden[:, :320 * factor]).max() <= 1
    width = min(got.shape[1], golden.shape[1])
    changed = np.abs(got[:, 320 * factor:width] - golden[:, 320 * factor:width]).max(axis=2) > 48
    assert changed.mean() < 0.08  # letters of another font


# spxdiff.


def lab(pixels):
    return oracle.rgb_to_lab(oracle.srgb_decode(pixels / 255))


@pytest.fixture
def png_pair(tmp_path):
    rng = np.random.default_rng(21)
    first = rng.integers(0, 256, (60, 70, 3), dtype=np.uint8)
    second = np.clip(first.astype(int) + rng.integers(-20, 21, first.shape), 0, 255).astype(np.uint8)
    second[0] = rng.integers(0, 256, (70, 3))
    second[1] = first[1]
    return write_image(tmp_path / "a.png", first), write_image(tmp_path / "b.png", second), first, second


@pytest.mark.parametrize("metric, formula", [("cie76", oracle.cie76), ("ciede2000", oracle.ciede2000)])
def test_differences_agree_with_numpy(metric, formula, png_pair, run, tmp_path):
    a, b, first, second = png_pair
    out = tmp_path / "map.exr"
    report = run("spxdiff", a, b, "--metric", metric, "--map", out, "--json", "-", check=0).json()
    assert isinstance(report, dict)
    expected = formula(lab(first), lab(second))
    got, names = read_image(out)
    assert names == ["Y"]
    # Float arithmetic of Lab values up to 100, and CIEDE2000's hue differences near grey.
    assert np.abs(got[:, :, 0] - expected).max() < 5e-3
    assert np.all(got[1] == 0)
    assert report["mean"] == pytest.approx(expected.mean(), abs=2e-4)
    assert report["max"] == pytest.approx(expected.max(), abs=5e-3)
    for name, q in [("p50", 50), ("p95", 95), ("p99", 99)]:
        low, high = np.percentile(expected, q, method="lower"), np.percentile(expected, q, method="higher")
        assert low - 5e-3 <= report[name] <= high + 5e-3
    x, y = report["max_at"]
    assert expected[y, x] == pytest.approx(expected.max(), abs=5e-3)
    assert report["changed_codes"] == int((first != second).any(axis=2).sum())
    assert report["pixels"] == 4200 and report["metric"] == metric


def test_thresholds(png_pair, run):
    a, b, first, second = png_pair
    for name in ("mean", "p99", "max"):
        assert run("spxdiff", a, b, f"--fail-{name}", 1000).code == 0
        failed = run("spxdiff", a, b, f"--fail-{name}", 0.001)
        assert failed.code == 1 and name in failed.stderr
    assert run("spxdiff", a, a, "--fail-max", 0, "--fail-mean", 0, "--fail-p99", 0).code == 0


def test_alpha_is_not_compared(run, tmp_path):
    rng = np.random.default_rng(22)
    pixels = rng.integers(0, 256, (10, 11, 4), dtype=np.uint8)
    a = oracle.write_png(tmp_path / "a.png", pixels)
    pixels = pixels.copy()
    pixels[:, :, 3] = rng.integers(0, 256, (10, 11))
    b = oracle.write_png(tmp_path / "b.png", pixels)
    report = run("spxdiff", a, b, "--json", "-", check=0).json()
    assert report["max"] == 0 and report["changed_codes"] == 0


def test_files_of_every_kind_compare(png_pair, run, tmp_path):
    """A texture against its spectra and its coefficients: each as D65 shows it."""
    a, _, first, _ = png_pair
    for name, options in [("s.exr", ["--store", "spectral", "--bands", "36", "--half"]), ("c.exr", [])]:
        run("spxuplift", a, "-o", tmp_path / name, *options, check=0)
        report = run("spxdiff", a, tmp_path / name, "--metric", "cie76", "--json", "-", check=0).json()
        assert report["changed_codes"] == 0 and report["max"] <= 0.06  # the bound for half storage


def test_figure1(tmp_path, run):
    arguments = ["figure1", "--methods", "mallett2019,smits1999", "--bits", "4", "--spp", "16"]
    one, two = tmp_path / "one.png", tmp_path / "two.png"
    figures = run("spxheat", *arguments, "-o", one, "--threads", "1", "--width", "1200", "--json", "-", check=0).json()
    run("spxheat", *arguments, "-o", two, "--threads", "2", "--width", "1200", check=0)
    assert one.read_bytes() == two.read_bytes()
    pixels, _ = read_image(one, "uint8")
    assert pixels.shape[1] == 1200 == figures["width"] and pixels.shape[0] == figures["height"] > 1000
    assert [m["method"] for m in figures["methods"]] == ["mallett2019", "smits1999"]
    exact, classic = figures["methods"]
    for part in (exact["noise"], classic["noise"], classic["distortion"]):
        assert 0.5 < part["mean"] < part["p99"] <= part["max"]
    assert exact["distortion"]["max"] < 1e-5
    assert figures["texels"] == 4096 and figures["range"] == [0, 35]
    other = run("spxheat", *arguments, "-o", two, "--seed", "2", "--width", "1200", "--json", "-", check=0).json()
    assert other["methods"][0]["noise"] != exact["noise"] and other["methods"][1]["distortion"] == classic["distortion"]
    wide = run("spxheat", *arguments, "-o", two, "--width", "3600", "--json", "-", check=0).json()
    assert wide["height"] == pytest.approx(3 * figures["height"], abs=6)


def test_figure1_refuses(tmp_path, run):
    out = tmp_path / "f.png"
    for arguments, mention in [(["--bits", "5"], "--bits"), (["--spp", "0"], "--spp"), (["--methods", "nosuch"], "nosuch"),
                               (["--legend"], "--legend"), (["--metric", "itp"], "--metric"), (["--width", "10"], "--width"),
                               (["--width", "600", "--methods", ",".join(["lattice"] * 6)], "too narrow")]:
        outcome = run("spxheat", "figure1", "-o", out, *arguments, check=64)
        assert mention in outcome.stderr and not out.exists()
    outcome = run("spxheat", "figure1", "-o", tmp_path / "f.exr", "--bits", "2", "--methods", "lattice", check=64)
    assert "8 bits" in outcome.stderr
    outcome = run("spxheat", "map.exr", "-o", out, "--spp", "3", check=64)
    assert "figure1" in outcome.stderr
