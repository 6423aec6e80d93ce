"""Fewer bits and fewer bands within a stated bound, judged by another reader and another integral."""


import numpy as np
import OpenImageIO as oiio
import pytest

import oracle
from conftest import read_image, write_image
from test_path import attributes, digest, picture, spectral_planes


def linear(path):
    return oracle.srgb_decode(read_image(path, "uint8")[0][:, :, :3] / 255)


def lab_under(spectra, bands, light):
    w = oracle.weights(bands, oracle.illuminant(light))
    return oracle.lab(spectra @ w.T, w.sum(axis=1))


@pytest.mark.parametrize("name,kind", [("coffee.png", "--half"), ("chelsea.png", "--float")])
def test_no_pixel_exceeds_the_bound(name, kind, run, tmp_path):
    source, plain, out = picture(name), tmp_path / "plain.exr", tmp_path / "small.exr"
    spectral = ["--store", "spectral", "--bands", 36]
    run("spxuplift", source, "-o", plain, *spectral, "--float", check=0)
    bands, exact = spectral_planes(plain)
    bound = 0.25
    report = run("spxuplift", source, "-o", out, *spectral, kind, "--max-error", bound, "--for", "A,FL11", "--json", "-", check=0).json()
    same_bands, spectra = spectral_planes(out)
    assert np.array_equal(same_bands, bands)
    assert spectra.min() >= 0 and spectra.max() <= 1
    trip = oracle.cie76(oracle.rgb_to_lab(spectra @ oracle.relight_matrix(bands, "D65").T, bands), oracle.rgb_to_lab(linear(source), bands))
    errors = {"round trip": trip, **{light: oracle.cie76(lab_under(spectra, bands, light), lab_under(exact, bands, light)) for light in ("A", "FL11")}}
    for check in report["max_error"]["checks"]:
        error = errors.pop(check["name"])
        assert error.max() <= bound  # the promise, with nothing added
        assert error.max() > 0.9 * bound  # and it is made use of
        assert check["max"] == pytest.approx(error.max(), abs=1e-4)  # the room that the checks in float leave
    assert not errors
    assert sum(report["max_error"]["kept_bits"]) == spectra.shape[0] * spectra.shape[1]
    # On photographs four of ten bits are enough for a quarter of a unit.
    assert report["max_error"]["mean_bits"] < 6
    assert report["file_bytes"] == out.stat().st_size
    if kind == "--half":
        run("spxuplift", source, "-o", plain, *spectral, kind, check=0)
    assert out.stat().st_size < 0.7 * plain.stat().st_size
    assert attributes(out)[1]["spectex:maxError"].startswith("CIE76 bound 0.25 on every pixel, kept bits mean ")


def test_coefficients_within_a_bound(run, tmp_path):
    source, plain, out = picture("coffee.png"), tmp_path / "plain.exr", tmp_path / "small.exr"
    run("spxuplift", source, "-o", plain, check=0)
    report = run("spxuplift", source, "-o", out, "--max-error", 0.5, "--json", "-", check=0).json()
    error = oracle.cie76(oracle.rgb_to_lab(read_image(out)[0][:, :, :3]), oracle.rgb_to_lab(linear(source)))
    assert 0.45 < error.max() <= 0.5
    assert report["max_error"]["checks"][0]["max"] == pytest.approx(error.max(), abs=1e-4)
    assert out.stat().st_size < plain.stat().st_size
    # The same by the path in memory.
    assert run("spxdiff", "--roundtrip", source, "--max-error", 0.5, "--metric", "cie76", "--fail-max", 0.5, "--json", "-",
               check=0).json()["max"] == pytest.approx(error.max(), abs=1e-4)


def test_bounded_files_do_not_depend_on_threads(run, tmp_path):
    source = picture("chelsea.png")
    made = []
    for threads in (1, 2):
        out = tmp_path / f"{threads}.exr"
        run("spxuplift", source, "-o", out, "--store", "spectral", "--bands", 9, "--max-error", 1, "--threads", threads, check=0)
        made.append(digest(out))
    assert made[0] == made[1]


def test_a_bound_that_half_cannot_keep_is_refused(png, run, tmp_path):
    out = tmp_path / "small.exr"
    outcome = run("spxuplift", png, "-o", out, "--max-error", 0.0001, check=2)
    assert "stored as half has a CIE76 of" in outcome.stderr and "or --float" in outcome.stderr
    assert not list(tmp_path.glob("*.exr*"))
    run("spxuplift", png, "-o", out, "--for", "A", check=64)
    run("spxuplift", png, "-o", out, "--max-error", 0, check=64)
    run("spxuplift", png, "-o", out, "--max-error", 1, "--for", "D:99", check=64)
