"""The README's pictures, made anew by the README's commands."""
import os
import subprocess

import numpy
import OpenImageIO as oiio
import pytest

HERE = os.path.dirname(__file__)
BIN = os.environ["SPECTEX_BIN"]
IMAGES = os.environ.get("SPECTEX_TEST_IMAGES", "/usr/lib/python3/dist-packages/skimage/data")
PHOTO = os.path.join(IMAGES, "coffee.png")

pytestmark = pytest.mark.skipif(not os.path.exists(PHOTO), reason="no coffee.png: python3-skimage is not there")


def pixels(path):
    image = oiio.ImageBuf(str(path))
    assert not image.has_error, image.geterror()
    return image.get_pixels(oiio.UINT8).astype(int)


def run(tool, *arguments):
    subprocess.run([os.path.join(BIN, tool), *map(str, arguments)], check=True)


def differing(a, b, codes):
    assert a.shape == b.shape
    return numpy.mean(numpy.abs(a - b).max(axis=2) > codes)


def test_relit_photograph(tmp_path):
    run("spxuplift", PHOTO, "-o", tmp_path / "bands.exr", "--store", "spectral", "--bands", "36", "--half")
    run("spxrelight", tmp_path / "bands.exr", "-i", "A,FL11", "-o", tmp_path / "coffee_{illuminant}.png")
    for name in ("coffee_A.png", "coffee_FL11.png"):
        # Another compiler or libm may move a value across the middle between two codes, no further.
        assert differing(pixels(tmp_path / name), pixels(os.path.join(HERE, name)), 1) == 0, name


def test_error_map(tmp_path):
    run("spxdiff", "--roundtrip", PHOTO, "--store", "spectral", "--bands", "36", "--half", "--metric", "cie76", "--map",
        tmp_path / "map.exr")
    run("spxheat", tmp_path / "map.exr", "-o", tmp_path / "heat.png", "--legend")
    made, kept = pixels(tmp_path / "heat.png"), pixels(os.path.join(HERE, "coffee_heatmap.png"))
    # The map itself is exact to a code; the letters depend on the font's version.
    width = 600
    assert differing(made[:, :width], kept[:, :width], 2) < 1e-3
    assert abs(made.shape[1] - kept.shape[1]) <= 16
