"""Baked relights, applied by OpenColorIO and held against the tool's own pictures."""

import numpy as np
import PyOpenColorIO as ocio
import pytest

from conftest import read_image, write_image

# OpenColorIO computes in float: the position in a cell of 9 vertices is off by up to 8 * 2^-24 cells and the values, up to
# 2, by a few 2^-23.
EXACT = 2e-6
LINEAR = "Linear Rec.709 (sRGB)"
OPTIMIZATION = ocio.OPTIMIZATION_DEFAULT


@pytest.fixture(scope="module")
def colors():
    """Random and extreme: corners, edges, greys, vertices and their neighbours, near black, outside [0,1]."""
    rng = np.random.default_rng(7)
    corners = np.array([[r, g, b] for r in (0, 1) for g in (0, 1) for b in (0, 1)])
    greys = np.repeat(np.linspace(0, 1, 33)[:, None], 3, axis=1)
    vertices = rng.integers(0, 9, (64, 3)) / 8
    rows = [corners, greys, vertices, np.nextafter(np.float32(vertices), np.float32(0)), rng.random((3000, 3)),
            rng.random((500, 3)) ** 8, np.eye(3)[rng.integers(0, 3, 64)] * rng.random((64, 1)),
            rng.normal(0.5, 2, (200, 3)), [[1e-38, 0, 1e-30], [-1e-30, 2, 1e30]]]
    return np.concatenate(rows).astype(np.float32)


@pytest.fixture(scope="module")
def image(colors, tmp_path_factory):
    return write_image(tmp_path_factory.mktemp("bake") / "colors.exr", colors[None])


def relit(run, image, tmp_path, light, *options):
    out = tmp_path / "tool.exr"
    run("spxrelight", image, "-i", light, "-o", out, "--float", "--quiet", *options, check=0)
    return read_image(out)[0][0]


def applied(transform, colors, config=None):
    config = config or ocio.Config.CreateRaw()
    processor = config.getProcessor(*transform) if isinstance(transform, tuple) else config.getProcessor(transform)
    # A copy: it works in place.
    pixels = np.array(colors)
    processor.getOptimizedCPUProcessor(OPTIMIZATION).applyRGB(pixels)
    return pixels


def from_file(path):
    return ocio.FileTransform(src=str(path), interpolation=ocio.INTERP_TETRAHEDRAL)


@pytest.mark.parametrize("method, suffix", [("lattice", "cube"), ("lattice", "clf"), ("smits1999", "clf"),
                                            ("mallett2019", "cube"), ("mallett2019", "clf"), ("mallett2019", "spimtx")])
def test_exact_pieces_are_the_tool_itself(run, tmp_path, colors, image, method, suffix):
    run("spxrelight", "-i", "A,FL11", "--method", method, "--bake", tmp_path / f"b_{{illuminant}}.{suffix}", check=0)
    for light in ("A", "FL11"):
        ours = relit(run, image, tmp_path, light, "--method", method)
        # A matrix has no ends; the tool maps colours into [0,1] first.
        taken = np.clip(colors, 0, 1)
        theirs = applied(from_file(tmp_path / f"b_{light}.{suffix}"), taken if suffix == "spimtx" or method == "mallett2019" else colors)
        assert np.abs(ours - theirs).max() <= EXACT


def test_a_cube_says_what_it_cannot_hold(run, tmp_path, colors, image):
    run("spxrelight", "-i", "FL11", "--bake", tmp_path / "b.cube", check=0)
    assert "interpolation=tetrahedral" in (tmp_path / "b.cube").read_text()
    linear = applied(ocio.FileTransform(src=str(tmp_path / "b.cube"), interpolation=ocio.INTERP_LINEAR), colors)
    # The remark is no formality: trilinear interpolation is off by far more than rounding.
    assert np.abs(linear - relit(run, image, tmp_path, "FL11")).max() > 1e-3


def test_options_reach_the_file(run, tmp_path, colors, image):
    options = ["--adapt", "cat16", "--relight-observer", "cie1964", "--normalize", "none"]
    run("spxrelight", "-i", "FL2", *options, "--bake", tmp_path / "b.clf", check=0)
    ours = relit(run, image, tmp_path, "FL2", *options)
    assert np.abs(ours - applied(from_file(tmp_path / "b.clf"), colors)).max() <= EXACT * max(1, np.abs(ours).max())


@pytest.mark.parametrize("file", ["b.clf", "b.cube"])
def test_nonlinear_methods_keep_their_bound(run, tmp_path, colors, image, file):
    out = run("spxrelight", "-i", "A", "--method", "jakob2019", "--max-error", "2", "--bake", tmp_path / file, "--json", "-", check=0).json()
    baked = out["baked"][0]
    assert not baked["exact"] and 0 < baked["mean"] < baked["max"] <= 2 and 8 < baked["grid"] < 65
    text = (tmp_path / file).read_text()
    assert f"max {baked['max']:.3g}" in text
    # An even grid of 65 is too coarse near black: a table of square roots stands first.
    assert ("LUT_1D_SIZE" in text) == (file == "b.cube")
    ours = relit(run, image, tmp_path, "A", "--method", "jakob2019")
    theirs = applied(from_file(tmp_path / file), colors)
    assert np.abs(ours - theirs).max() < 0.05
    # On other colours than those it was measured on, by another formula. Half as much again: the largest of some thousand
    # colours is not the largest of all.
    to_xyz = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]])
    white = to_xyz @ ours[7]

    def lab(rgb):
        t = np.maximum(rgb @ to_xyz.T / white, 0)
        f = np.where(t > 216 / 24389, np.cbrt(t), (24389 / 27 * t + 16) / 116)
        return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)

    assert np.linalg.norm(lab(ours) - lab(theirs), axis=1).max() <= 3
    refused = run("spxrelight", "-i", "A", "--method", "jakob2019", "--max-error", "0.001", "--bake", tmp_path / "no.clf", check=2)
    assert "--max-error" in refused.stderr and not (tmp_path / "no.clf").exists()


def test_a_configuration_relights_without_a_plug_in(run, tmp_path, colors, image):
    path = tmp_path / "show.ocio"
    run("spxrelight", "-i", "A,D:5003", "--bake", path, check=0)
    config = ocio.Config.CreateFromFile(str(path))
    config.validate()
    for light, name in (("A", "Relit A"), ("D:5003", "Relit D_5003")):
        ours = relit(run, image, tmp_path, light)
        look = ocio.LookTransform(src=LINEAR, dst=LINEAR, looks=name)
        assert np.abs(applied(look, colors, config) - ours).max() <= EXACT
        # By way of the reference space: two matrices in float, which cost colours of 1e30 all their small components.
        inside = (colors >= 0).all(axis=1) & (colors <= 1).all(axis=1)
        assert np.abs(applied((LINEAR, name), colors[inside], config) - ours[inside]).max() <= 2 * EXACT
        assert name in list(config.getViews("sRGB"))
    before = path.read_bytes()
    run("spxrelight", "-i", "A", "--bake", path, check=0)
    assert path.read_bytes() == before
    refused = run("spxrelight", "-i", "A", "--method", "mallett2019", "--bake", path, check=64)
    assert "Relit A" in refused.stderr and path.read_bytes() == before


EXISTING = """# a show's own configuration
ocio_profile_version: 2

search_path: luts
roles:
  aces_interchange: ap0
  default: plain
{looks}
colorspaces:
  # the first of two
  - !<ColorSpace>
    name: plain
    isdata: true

  - !<ColorSpace>
    name: ap0
    description: kept word for word
displays:
  screen:
    - !<View> {{name: as it is, colorspace: plain}}
"""


@pytest.mark.parametrize("looks", ["", "looks:\n  - !<Look> {name: warm, process_space: ap0}\n", "looks: []\n"])
def test_an_existing_configuration_keeps_all_it_holds(run, tmp_path, colors, image, looks):
    path = tmp_path / "own.ocio"
    (tmp_path / "luts").mkdir()
    text = EXISTING.format(looks=looks)
    path.write_text(text)
    run("spxrelight", "-i", "FL11", "--bake", path, check=0)
    config = ocio.Config.CreateFromFile(str(path))
    config.validate()
    assert {"plain", "ap0", "Relit FL11"} <= set(config.getColorSpaceNames())
    assert ("warm" in list(config.getLookNames())) == ("warm" in looks)
    assert list(config.getViews("screen")) == ["as it is"]
    if looks != "looks: []\n":  # which is written anew in another layout
        kept = path.read_text().splitlines()
        assert [line for line in text.splitlines() if line not in kept] == ["search_path: luts"]
    # ACES2065-1 to linear Rec.709 and back, by Bradford; float matrices with terms up to 2.5 cost a few 1e-7 each.
    inside = np.clip(colors, 0, 1)
    shared = ocio.Config.CreateFromFile(str(run_config(run, tmp_path)))
    ap0 = applied((LINEAR, "ACES2065-1"), inside, shared)
    lit = applied(ocio.LookTransform(src="ap0", dst="ap0", looks="Relit FL11"), ap0, config)
    ours = relit(run, image, tmp_path, "FL11")
    assert np.abs(applied(("ACES2065-1", LINEAR), lit, shared) - ours).max() <= 1e-5


def run_config(run, tmp_path):
    """The library's own configuration, with something in it."""
    path = tmp_path / "shared.ocio"
    run("spxrelight", "-i", "E", "--bake", path, check=0)
    return path


@pytest.mark.parametrize("content", ["", "not a configuration", "ocio_profile_version: 2\ncolorspaces:\n  - !<ColorSpace> {name: a}\n"])
def test_what_cannot_be_added_to_stays(run, tmp_path, content):
    path = tmp_path / "own.ocio"
    path.write_text(content)
    run("spxrelight", "-i", "A", "--bake", path, check=2)
    assert path.read_text() == content and sorted(p.name for p in tmp_path.iterdir()) == ["own.ocio"]


def test_usage(run, tmp_path):
    for arguments in (["--bake", tmp_path / "a.clf"], ["-i", "A", "--bake", tmp_path / "a.txt"],
                      ["-i", "A,D50", "--bake", tmp_path / "a.clf"], ["-i", "A", "--bake", tmp_path / "none" / "a.clf"],
                      ["-i", "A", "--bake", tmp_path / "a.spimtx"],
                      ["-i", "A", "--bake", tmp_path / "a.clf", "-o", tmp_path / "a.exr"]):
        run("spxrelight", *arguments, check=64)
    assert not list(tmp_path.iterdir())
