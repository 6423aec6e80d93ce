"""Fewer bits and fewer bands within a stated bound, judged by another reader and another integral."""


import numpy as np
import OpenImageIO as oiio
import pytest

import oracle
from conftest import read_image, write_image
from test_path import attributes, digest, picture, spectral_planes


def linear(path):
    return oracle.srgb_decode(read_image(path, "uint8")[0][:, :, :3] / 255)


def part_of(name, folder):
    """The middle of a photograph: these tests integrate every pixel once more."""
    pixels = read_image(picture(name), "uint8")[0]
    return write_image(folder / "part.png", np.ascontiguousarray(pixels[60:220, 120:340, :3]))


def lab_under(spectra, bands, light):
    w = oracle.weights(bands, oracle.illuminant(light))
    return oracle.lab(spectra @ w.T, w.sum(axis=1))


@pytest.mark.parametrize("name,kind", [("coffee.png", "--half"), ("chelsea.png", "--float")])
def test_no_pixel_exceeds_the_bound(name, kind, run, tmp_path):
    source, plain, out = part_of(name, tmp_path), tmp_path / "plain.exr", tmp_path / "small.exr"
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


def test_few_bands_show_the_texture_right(run, tmp_path):
    """Against the same method on 5 nm, each file lit by its own weights into linear BT.709, as a reader does it."""
    source, fine, out = part_of("chelsea.png", tmp_path), tmp_path / "fine.exr", tmp_path / "few.exr"
    lights = ["D65", "A", "FL11"]
    run("spxuplift", source, "-o", fine, "--store", "spectral", "--bands", "380:780:5", "--float", check=0)
    report = run("spxuplift", source, "-o", out, "--store", "spectral", "--bands", "auto", "--for", ",".join(lights), "--max-error", 0.5,
                 "--explain", "--json", "-", check=0)
    assert "chosen for this texture's colours and lights" in report.stderr
    report = report.json()
    fine_bands, expected = spectral_planes(fine)
    bands, spectra = spectral_planes(out)
    assert report["bands_nm"] == bands.tolist()
    assert len(bands) <= 9  # three sums under each of three lights: with so many bands of one's own choice all could be exact
    assert spectra.min() >= 0 and spectra.max() <= 1
    worst = {check["name"]: check["max"] for check in report["max_error"]["checks"]}
    for light in lights:
        white = oracle.weights(fine_bands, oracle.illuminant(light)).sum(axis=1)
        to_xyz = oracle.bt709_matrix(fine_bands)
        a, b = (oracle.lab(s @ oracle.relight_matrix(nm, light).T @ to_xyz.T, white) for s, nm in ((expected, fine_bands), (spectra, bands)))
        error = oracle.cie76(a, b)
        assert error.max() <= 0.5
        assert worst[light] == pytest.approx(error.max(), abs=2e-4)  # checks in float
    trip = oracle.cie76(oracle.rgb_to_lab(spectra @ oracle.relight_matrix(bands, "D65").T), oracle.rgb_to_lab(linear(source)))
    assert trip.max() <= 0.5 * 1.01  # Lab here by the matrix of 1 nm instead of the file's own
    # Even bands of the same number are what the choice must beat.
    even = tmp_path / "even.exr"
    run("spxuplift", source, "-o", even, "--store", "spectral", "--bands", len(bands), "--float", check=0)
    even_bands, even_spectra = spectral_planes(even)
    a, b = (oracle.lab(s @ oracle.relight_matrix(nm, "FL11").T @ to_xyz.T, white) for s, nm in ((expected, fine_bands), (even_spectra, even_bands)))
    assert oracle.cie76(a, b).max() > 1


def test_more_bands_where_a_pixel_that_was_not_sampled_needs_them(run, tmp_path):
    """Bands are chosen by 16384 colours: of more, one may be missed."""
    codes = np.random.default_rng(3).integers(100, 156, (240, 240, 3), dtype=np.uint8)
    store = ["--method", "mallett2019", "--store", "spectral", "--bands", "auto", "--for", "FL11", "--max-error", 0.3, "--float", "--json", "-"]
    found = {}
    for name, odd in (("greys", codes[0, 0]), ("odd", (255, 0, 255))):
        codes[-1, -1] = odd
        write_image(tmp_path / f"{name}.png", codes)
        found[name] = run("spxuplift", tmp_path / f"{name}.png", "-o", tmp_path / f"{name}.exr", *store, check=0).json()
    assert len(found["odd"]["bands_nm"]) > len(found["greys"]["bands_nm"])
    assert max(c["max"] for c in found["odd"]["max_error"]["checks"]) <= 0.3


def test_bands_for_other_methods_and_a_bound(run, tmp_path):
    source, out = tmp_path / "patches.png", tmp_path / "few.exr"
    write_image(source, np.random.default_rng(5).integers(0, 256, (4, 6, 3), dtype=np.uint8))
    report = run("spxuplift", source, "-o", out, "--method", "mallett2019", "--store", "spectral", "--bands", "auto", "--for", "A", "--float",
                 "--json", "-", check=0).json()
    assert max(check["max"] for check in report["max_error"]["checks"]) <= 0.5
    assert len(report["bands_nm"]) == report["channels"].__len__() - 3 < 41


def test_store_follows_the_readers(png, run, tmp_path):
    out = tmp_path / "out.exr"
    for readers, store, parts in (("pbrt", "coefficients", 1), ("spectex,pbrt", "coefficients", 1), ("pbrt,mitsuba", "spectral", 2),
                                  ("spectral-exr,spectex", "spectral", 1)):
        outcome = run("spxuplift", png, "-o", out, "--store", "auto", "--for-reader", readers, "--bands", 9, "--explain", "--json", "-", check=0)
        assert outcome.json()["store"] == store and "store chosen" in outcome.stderr
        source = oiio.ImageInput.open(str(out))
        assert [source.seek_subimage(i, 0) for i in range(2)] == [True, parts == 2]
        assert any(name.startswith("T.") for name in source.spec().channelnames) == (store == "spectral") or parts == 2
        source.close()
    for wrong in (["--store", "auto", "--for-reader", "mitsuba,spectral-exr"], ["--store", "auto", "--for-reader", "blender"],
                  ["--for-reader", "pbrt"], ["--store", "auto", "--for-reader", "mitsuba", "--layout", "single"]):
        run("spxuplift", png, "-o", tmp_path / "no.exr", *wrong, check=64)


def test_constant_textures_become_a_pixel_on_request(run, tmp_path):
    source, out = tmp_path / "flat.png", tmp_path / "out.exr"
    pixels = np.tile(np.array([200, 30, 90, 255], np.uint8), (37, 53, 1))
    write_image(source, pixels, ["R", "G", "B", "A"])
    run("spxuplift", source, "-o", out, check=0)
    whole = read_image(out)[0]
    assert whole.shape == (37, 53, 4)
    outcome = run("spxuplift", source, "-o", out, "--constant-to-pixel", "--explain", "--json", "-", check=0)
    assert "1960 of 1961 pixels" in outcome.stderr and outcome.json()["constant"] is True
    assert np.array_equal(read_image(out)[0], whole[:1, :1])
    for channel in range(4):  # one code in the last pixel, alpha as well, and it is no longer constant
        pixels[-1, -1] = [200, 30, 90, 255]
        pixels[-1, -1, channel] -= 1
        write_image(source, pixels, ["R", "G", "B", "A"])
        assert run("spxuplift", source, "-o", out, "--constant-to-pixel", "--json", "-", check=0).json()["constant"] is False
        assert read_image(out)[0].shape == (37, 53, 4)


def test_transparent_texels_are_skipped_on_request(run, gradient, tmp_path):
    source, plain, out = tmp_path / "cut.png", tmp_path / "plain.exr", tmp_path / "out.exr"
    alpha = np.where(np.arange(16) % 3 == 0, 0, 255).astype(np.uint8) * np.ones((8, 1), np.uint8)
    alpha[0, 0] = 1  # hardly there is there
    write_image(source, np.dstack([gradient, alpha]), ["R", "G", "B", "A"])
    spectral = ["--store", "spectral", "--bands", 9]
    run("spxuplift", source, "-o", plain, *spectral, check=0)
    outcome = run("spxuplift", source, "-o", out, *spectral, "--skip-transparent", "--explain", "--json", "-", check=0)
    assert outcome.json()["transparent"] == (alpha == 0).sum() and "alpha is 0" in outcome.stderr
    before, after = spectral_planes(plain)[1], spectral_planes(out)[1]
    assert np.array_equal(after[alpha != 0], before[alpha != 0])
    assert (after[alpha == 0] == 0).all() and (before[alpha == 0] != 0).any()
