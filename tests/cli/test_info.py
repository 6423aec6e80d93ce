"""spxinfo."""

import json
import os
import re
import signal
import subprocess
import xml.etree.ElementTree

import numpy as np
import pytest

from conftest import BIN, write_image, write_spectral


def srgb_decode(code):
    """IEC 61966-2-1."""
    v = code / 255
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def test_text(png, run):
    out = run("spxinfo", png, check=0).stdout
    assert "16 x 8 pixels" in out
    assert re.search(r"type +uint8", out)
    assert re.search(r"colour space +\S.*\(.+\)", out)


def test_json_is_pure(png, run):
    outcome = run("spxinfo", png, "--json", "-", check=0)
    info = outcome.json()
    assert (info["width"], info["height"], info["kind"], info["format"]) == (16, 8, "image", "png")
    assert info["channels"] == ["R", "G", "B"]
    assert info["input"] == str(png)
    assert info["colorspace"] and info["colorspace_reason"]
    assert "16 x 8 pixels" in outcome.stderr


def test_json_file_and_no_leftovers(png, tmp_path, run):
    run("spxinfo", png, "--json", tmp_path / "a.json", check=0)
    assert json.loads((tmp_path / "a.json").read_text())["width"] == 16
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.json", "gradient.png"]


def test_pixel(png, gradient, run):
    info = run("spxinfo", png, "--at", "3,2", "--json", "-", check=0).json()
    r, g, b = (int(v) for v in gradient[2, 3])
    assert info["samples"] == {"R": r, "G": g, "B": b}
    assert info["linear_rgb_space"] == "BT.709"
    # Samples pass through float, whose spacing below 1 is 6e-8.
    assert info["linear_rgb"] == pytest.approx([srgb_decode(v) for v in (r, g, b)], abs=1.2e-7)


@pytest.mark.parametrize("kind", [np.uint16, np.float16, np.float32])
def test_sample_types(kind, tmp_path, run):
    values = [0.25, 0.5, 1.5] if kind != np.uint16 else [1, 4096, 65535]
    pixels = np.array([[values]], dtype=kind)
    path = write_image(tmp_path / ("a.tif" if kind == np.uint16 else "a.exr"), pixels)
    info = run("spxinfo", path, "--at", "0,0", "--json", "-", check=0).json()
    assert [info["samples"][c] for c in "RGB"] == values


@pytest.mark.parametrize("at", ["16,0", "0,8", "99999,0"])
def test_outside(png, at, run):
    outcome = run("spxinfo", png, "--at", at, check=64)
    assert outcome.stdout == ""
    assert "0..15" in outcome.stderr and "0..7" in outcome.stderr


@pytest.mark.parametrize("at", ["", "1", "1,", ",1", "-1,0", "1,2,3", "a,b", "1.5,2", "99999999999999999999,0"])
def test_bad_position(png, at, run):
    outcome = run("spxinfo", png, "--at", at, check=64)
    assert "--at" in outcome.stderr and "X,Y" in outcome.stderr


def test_missing_file(tmp_path, run):
    outcome = run("spxinfo", tmp_path / "none.png", check=2)
    assert outcome.stdout == ""
    assert outcome.stderr.count("none.png") == 1 and outcome.stderr.count("\n") == 1


def test_folder(tmp_path, run):
    assert "folder" in run("spxinfo", tmp_path, check=64).stderr


def test_many_inputs(png, gradient, tmp_path, run):
    write_image(tmp_path / "b.png", gradient[:4])
    info = run("spxinfo", tmp_path / "*.png", "--json", "-", check=0).json()
    assert [(i["input"], i["height"]) for i in info] == [(str(tmp_path / "b.png"), 4), (str(png), 8)]


def test_one_bad_among_many(png, tmp_path, run):
    (tmp_path / "bad.png").write_bytes(b"not a picture")
    outcome = run("spxinfo", tmp_path / "bad.png", png, "--json", "-", check=2)
    bad, good = outcome.json()
    assert "error" in bad and good["width"] == 16


def test_wildcard_without_match(tmp_path, run):
    assert "*.tiff" in run("spxinfo", tmp_path / "*.tiff", check=2).stderr


def test_wildcard_that_is_a_name(gradient, tmp_path, run):
    path = write_image(tmp_path / "[ab].png", gradient)
    write_image(tmp_path / "a.png", gradient)
    assert run("spxinfo", path, "--json", "-", check=0).json()["input"] == str(path)


@pytest.mark.parametrize("name", ["with space.png", "-dash.png", "--threads.png", "λ.png", "new\nline.png", "a'b\"c.png", "%s%n.png",
                                  "{}.png", "=.png"])
def test_odd_names(name, gradient, tmp_path, run):
    write_image(tmp_path / "a.png", gradient)
    os.rename(tmp_path / "a.png", tmp_path / name)
    outcome = run("spxinfo", "--json", "-", "--", name, cwd=tmp_path, check=0)
    assert outcome.json()["input"] == name
    assert "\nline" not in outcome.stderr


def test_name_of_other_encoding(gradient, tmp_path, run):
    name = b"caf\xe9.png"
    write_image(tmp_path / "a.png", gradient)
    os.rename(tmp_path / "a.png", os.path.join(os.fsencode(tmp_path), name))
    outcome = run("spxinfo", "--json", "-", name, cwd=tmp_path, check=0)
    assert outcome.json()["input"] == "caf\ufffd.png"
    assert "caf\\xe9.png" in outcome.stderr


def test_json_onto_input(png, run):
    before = png.read_bytes()
    outcome = run("spxinfo", png, "--json", png, check=64)
    assert "--json" in outcome.stderr and png.read_bytes() == before


def test_json_onto_input_through_links(png, tmp_path, run):
    before = png.read_bytes()
    (tmp_path / "link").symlink_to(png)
    os.link(png, tmp_path / "hard")
    for name in ["link", "hard"]:
        run("spxinfo", png, "--json", tmp_path / name, check=64)
    assert png.read_bytes() == before


def test_json_and_plot_alike(png, tmp_path, run):
    outcome = run("spxinfo", png, "--at", "0,0", "--plot", tmp_path / "x", "--json", tmp_path / "." / "x", check=64)
    assert "--plot" in outcome.stderr and "--json" in outcome.stderr


def test_alpha_and_grey(tmp_path, run):
    rgba = write_image(tmp_path / "rgba.png", np.full((2, 2, 4), 99, np.uint8))
    assert run("spxinfo", rgba, "--json", "-", check=0).json()["alpha"] == "straight"
    grey = write_image(tmp_path / "grey.png", np.full((2, 2), 99, np.uint8))
    info = run("spxinfo", grey, "--at", "1,1", "--json", "-", check=0).json()
    assert info["linear_rgb"] == pytest.approx([srgb_decode(99)] * 3, abs=1.2e-7)


def test_nonfinite_pixel_is_null(tmp_path, run):
    path = write_image(tmp_path / "nan.exr", np.array([[[np.nan, np.inf, 0.5]]], np.float32))
    info = run("spxinfo", path, "--at", "0,0", "--json", "-", check=0).json()
    assert info["samples"] == {"R": None, "G": None, "B": 0.5}


def test_strict_refuses_nonfinite_pixels(tmp_path, run):
    path = write_image(tmp_path / "nan.exr", np.array([[[0.5, np.nan, 0.5], [0.5, 0.5, 0.5]]], np.float32))
    outcome = run("spxinfo", path, "--at", "0,0", "--strict", check=2)
    assert "channel G" in outcome.stderr and "nan" in outcome.stderr and outcome.stdout == ""
    run("spxinfo", path, "--at", "1,0", "--strict", check=0)


def test_unknown_colorspace(png, run):
    assert "sRBG" in run("spxinfo", png, "--input-colorspace", "sRBG", check=64).stderr


BANDS = list(range(380, 781, 20))


@pytest.fixture
def spectral(tmp_path):
    """White, mid grey and a ramp."""
    ramp = np.linspace(0, 1, len(BANDS))
    return write_spectral(tmp_path / "s.exr", [[np.ones(len(BANDS)), np.full(len(BANDS), 0.5), ramp]], BANDS)


def test_spectrum(spectral, run):
    info = run("spxinfo", spectral, "--at", "2,0", "--json", "-", check=0).json()
    assert info["kind"] == "spectral" and info["quantity"] == "reflectance"
    assert info["wavelengths_nm"] == BANDS
    assert info["spectrum"]["wavelengths_nm"] == BANDS
    # Stored as float: the spacing below 1 is 6e-8.
    assert info["spectrum"]["values"] == pytest.approx(np.linspace(0, 1, len(BANDS)), abs=6e-8)


def test_flat_spectra_are_grey(spectral, run):
    white = run("spxinfo", spectral, "--at", "0,0", "--json", "-", check=0).json()
    grey = run("spxinfo", spectral, "--at", "1,0", "--json", "-", check=0).json()
    # r = 1 is (1,1,1) on the very grid, so only double rounding of some hundred terms is left.
    assert white["linear_rgb"] == pytest.approx([1, 1, 1], abs=1e-12)
    assert grey["linear_rgb"] == pytest.approx([0.5, 0.5, 0.5], abs=1e-12)


def test_emissive(tmp_path, run):
    path = write_spectral(tmp_path / "e.exr", [[np.ones(len(BANDS))]], BANDS, "S0", {"emissiveUnits": "W.m^-2.sr^-1"})
    info = run("spxinfo", path, "--at", "0,0", "--json", "-", check=0).json()
    assert info["quantity"] == "radiance"
    x, y, z = info["xyz"]
    # Equal energy: x = y = 1/3. Beyond 20 nm hats over 380..780 nm, the half hats at both ends hold under 1e-3 of it.
    assert (x / (x + y + z), y / (x + y + z)) == pytest.approx((1 / 3, 1 / 3), abs=1e-3)


def test_coefficients(png, gradient, tmp_path, run):
    run("spxuplift", png, "-o", tmp_path / "c.exr", "--store", "coefficients", "--method", "mallett2019", "--float", check=0)
    info = run("spxinfo", tmp_path / "c.exr", "--at", "3,2", "--json", "-", check=0).json()
    assert info["kind"] == "coefficients" and info["method"] == "mallett2019"
    values = info["spectrum"]["values"]
    assert len(values) == len(info["wavelengths_nm"]) and 0 <= min(values) and max(values) <= 1
    # Float coefficients: a relative error of 6e-8 in each of three values below 1.
    assert info["linear_rgb"] == pytest.approx([srgb_decode(int(v)) for v in gradient[2, 3]], abs=2e-7)


def test_plot(spectral, tmp_path, run):
    svg = tmp_path / "p.svg"
    info = run("spxinfo", spectral, "--at", "2,0", "--plot", svg, "--json", "-", check=0).json()
    assert info["output"] == str(svg)
    root = xml.etree.ElementTree.parse(svg).getroot()
    assert root.tag.endswith("svg")
    first = svg.read_bytes()
    run("spxinfo", spectral, "--at", "2,0", "--plot", svg, check=0)
    assert svg.read_bytes() == first
    assert sorted(p.name for p in tmp_path.iterdir()) == ["p.svg", "s.exr"]


def test_plot_without_position(spectral, tmp_path, run):
    assert "--at" in run("spxinfo", spectral, "--plot", tmp_path / "p.svg", check=64).stderr


def test_plot_of_image(png, tmp_path, run):
    run("spxinfo", png, "--at", "0,0", "--plot", tmp_path / "p.svg", check=2)
    assert not (tmp_path / "p.svg").exists()


def test_plot_in_missing_folder(spectral, tmp_path, run):
    assert "missing" in run("spxinfo", spectral, "--at", "0,0", "--plot", tmp_path / "no" / "p.svg", check=64).stderr


def test_stdout_to_full_device(png):
    with open("/dev/full", "wb") as full:
        finished = subprocess.run([str(BIN / "spxinfo"), str(png), "--json", "-"], stdout=full, stderr=subprocess.PIPE, timeout=60)
    assert finished.returncode == 2
    assert b"standard output" in finished.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_is_seen_by_the_shell(number, tmp_path):
    """The reader waits on a pipe with a name, so that the signal meets the tool at work."""
    os.mkfifo(tmp_path / "pipe.png")
    process = subprocess.Popen([str(BIN / "spxinfo"), str(tmp_path / "pipe.png")], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        process.wait(0.5)
        pytest.skip("the reader refuses pipes, so there is no moment to interrupt")
    except subprocess.TimeoutExpired:
        process.send_signal(number)
        assert process.wait(10) == -number
    finally:
        process.kill()
        process.communicate()
