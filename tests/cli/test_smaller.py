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


def mip_mapped(path, pixels):
    """As maketx writes it, by another library: tiles, and each level half of the one before."""
    config = oiio.ImageSpec()
    config.attribute("maketx:filtername", "box")
    config.attribute("maketx:fileformatname", "openexr" if path.suffix == ".exr" else "tiff")
    config.tile_width = config.tile_height = 32
    config.tile_depth = 1
    source = write_image(path.parent / "whole.tif", pixels)
    assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, oiio.ImageBuf(str(source)), str(path), config), oiio.geterror()
    return path


def level_of(path, level):
    source = oiio.ImageInput.open(str(path))
    pixels = source.read_image(0, level, 0, 3, source.spec(0, 0).format)
    source.close()
    return np.asarray(pixels)


@pytest.mark.parametrize("name,kind", [("bricks.tx", np.uint8), ("bricks.exr", np.float32)])
def test_only_the_mip_level_asked_for_is_read(name, kind, run, tmp_path):
    codes = np.random.default_rng(8).integers(0, 256, (70, 150, 3), dtype=np.uint8)
    texture = mip_mapped(tmp_path / name, codes if kind == np.uint8 else (codes / 255).astype(kind))
    spectral = ["--store", "spectral", "--bands", 9, "--input-colorspace", "sRGB"]
    outcome = run("spxuplift", texture, "-o", tmp_path / "level_{mip}.exr", "--mip", "1:3", *spectral, "--explain", "--json", "-", check=0)
    assert [report["mip"] for report in outcome.json()] == [1, 2, 3]
    assert "7 of 8 mip levels, all but level 1: " in outcome.stderr  # 150, 75, 37, 18, 9, 4, 2, 1
    for level, size in ((1, (35, 75)), (2, (17, 37)), (3, (8, 18))):
        pixels = level_of(texture, level)
        assert pixels.shape[:2] == size and pixels.dtype == kind
        plain = write_image(tmp_path / f"plain.{'png' if kind == np.uint8 else 'exr'}", pixels)
        run("spxuplift", plain, "-o", tmp_path / "expected.exr", *spectral, check=0)
        assert np.array_equal(spectral_planes(tmp_path / f"level_{level}.exr")[1], spectral_planes(tmp_path / "expected.exr")[1])
    # What is not asked for is not read: damage in the full size is no matter to a smaller one.
    whole = bytearray(texture.read_bytes())
    whole[6000:9000] = b"\xff" * 3000
    damaged = tmp_path / f"damaged{texture.suffix}"
    damaged.write_bytes(whole)
    run("spxuplift", damaged, "-o", tmp_path / "small.exr", "--mip", 1, *spectral, check=0)
    assert np.array_equal(spectral_planes(tmp_path / "small.exr")[1], spectral_planes(tmp_path / "level_1.exr")[1])
    run("spxuplift", damaged, "-o", tmp_path / "large.exr", *spectral, check=2)
    assert not (tmp_path / "large.exr").exists()


def test_levels_for_every_tool_that_reads_textures(run, png, tmp_path):
    texture = mip_mapped(tmp_path / "bricks.tx", np.random.default_rng(9).integers(0, 256, (64, 96, 3), dtype=np.uint8))
    made = tmp_path / "made"
    made.mkdir()
    run("spxuplift", texture, "-o", made, "--mip", "0:1", check=0)
    assert sorted(p.name for p in made.iterdir()) == ["bricks_mip0.exr", "bricks_mip1.exr"]
    run("spxrelight", texture, "-i", "A,FL11", "-o", tmp_path / "lit_{mip}_{illuminant}.png", "--mip", "2:3", check=0)
    assert read_image(tmp_path / "lit_3_FL11.png")[0].shape == (8, 12, 3)
    lit = write_image(tmp_path / "plain.png", level_of(texture, 2))
    run("spxrelight", lit, "-i", "A", "-o", tmp_path / "expected.png", check=0)
    assert np.array_equal(read_image(tmp_path / "lit_2_A.png", "uint8")[0], read_image(tmp_path / "expected.png", "uint8")[0])
    assert run("spxdiff", texture, texture, "--mip", 3, "--json", "-", check=0).json()["pixels"] == 8 * 12
    assert run("spxdiff", "--roundtrip", texture, "--mip", 2, "--json", "-", check=0).json()["pixels"] == 16 * 24
    out = tmp_path / "out.exr"
    for source, level, why in ((texture, 9, "has no mip level 9: expected 0 to 6"), (png, 1, "has no mip levels, so no level 1"),
                               (made / "bricks_mip0.exr", 1, "coefficients")):
        assert why in run("spxuplift", source, "-o", out, "--mip", level, check=2).stderr
    assert "read as they are" in run("spxrelight", made / "bricks_mip0.exr", "-i", "A", "-o", out, "--mip", 1, check=2).stderr
    for wrong in ("-1", "x", "2:1", "1:", "32", "1:2:3", ""):
        assert "--mip" in run("spxuplift", texture, "-o", out, f"--mip={wrong}", check=64).stderr
    assert "{mip}" in run("spxuplift", texture, "-o", out, "--mip", "0:1", check=64).stderr
    run("spxdiff", texture, texture, "--mip", "0:1", check=64)
    assert not out.exists()


def write_parts(path, parts):
    """Parts of (name, channel names, pixels)."""
    specs = []
    for name, channels, pixels in parts:
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], "half")
        spec.channelnames = channels
        spec.attribute("oiio:subimagename", name)
        specs.append(spec)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), tuple(specs)), output.geterror()
    for i, (_, _, pixels) in enumerate(parts):
        assert i == 0 or output.open(str(path), specs[i], "AppendSubimage"), output.geterror()
        assert output.write_image(np.ascontiguousarray(pixels)), output.geterror()
    assert output.close()
    return path


def test_only_the_channels_asked_for_are_read(run, tmp_path):
    """A layer, a part and channels by name, each against a file that holds nothing else."""
    values = np.random.default_rng(4).random((24, 33, 9)).astype(np.float16)
    names = ["A", "B", "G", "R", "albedo.B", "albedo.G", "albedo.R", "mask.Y", "zz"]
    render = write_image(tmp_path / "render.exr", values, names)
    parts = write_parts(tmp_path / "parts.exr", [("beauty", ["R", "G", "B", "A"], values[:, :, [3, 2, 1, 0]]),
                                                 ("albedo", ["R", "G", "B"], values[:, :, [6, 5, 4]]), ("mask", ["Y"], values[:, :, [7]])])
    at = {name: i for i, name in enumerate(names)}
    cases = [(render, ["--layer", "albedo"], ["albedo.R", "albedo.G", "albedo.B"]), (render, ["--layer", "mask"], ["mask.Y"]),
             (render, ["--channels", "albedo.G,zz,R,A"], ["albedo.G", "zz", "R", "A"]), (render, ["--channels", "zz,A"], ["zz", "A"]),
             (render, ["--channels", "R,G,B"], ["R", "G", "B"]), (parts, ["--layer", "albedo"], ["albedo.R", "albedo.G", "albedo.B"]),
             (parts, ["--layer", "mask"], ["mask.Y"]), (parts, ["--channels", "R,G,B"], ["R", "G", "B"])]
    for source, chosen, expected in cases:
        out = tmp_path / "out.exr"
        outcome = run("spxuplift", source, "-o", out, *chosen, "--explain", "--json", "-", check=0)
        # The coefficients of the lattice are linear RGB itself: halves stay as they are.
        color = [expected[0]] * 3 if len(expected) < 3 else expected[:3]
        wanted = values[:, :, [at[name] for name in color + expected[len(expected) - (len(expected) + 1) % 2:]]]
        got, stored = read_image(out)
        assert stored == ["R", "G", "B", "A"][:wanted.shape[2]] and np.array_equal(got, wanted.astype(np.float32))
        total = 9 if source == render else 8
        assert f"{total - len(expected)} of {total} channels (" in outcome.stderr and "not converted" in outcome.stderr
    # A part that is not asked for is not read at all.
    whole = bytearray(parts.read_bytes())
    head = whole.index(b"beauty")
    del head
    broken = bytearray(whole)
    broken[-1500:] = b"\x00" * 1500  # the mask's pixels, which come last
    (tmp_path / "broken.exr").write_bytes(broken)
    run("spxuplift", tmp_path / "broken.exr", "-o", tmp_path / "out.exr", "--layer", "mask", check=2)
    run("spxuplift", tmp_path / "broken.exr", "-o", tmp_path / "out.exr", "--layer", "albedo", check=0)
    # Other formats, by the same names.
    codes = (values[:, :, :6].astype(np.float32) * 255).astype(np.uint8)
    many = write_image(tmp_path / "many.tif", codes, ["R", "G", "B", "A", "four", "five"])
    rgba = write_image(tmp_path / "rgba.png", codes[:, :, :4], ["R", "G", "B", "A"], {"oiio:UnassociatedAlpha": 1})
    stored = oiio.ImageInput.open(str(many)).spec().channelnames
    for source, chosen, columns in ((many, [stored[4], stored[2], stored[5]], [4, 2, 5]), (many, [stored[1]], [1]), (rgba, ["B", "A"], [2, 3])):
        run("spxuplift", source, "-o", tmp_path / "out.exr", "--channels", ",".join(chosen), check=0)
        color = columns if len(columns) == 3 else columns[:1] * 3
        wanted = oracle.srgb_decode(codes[:, :, color] / 255).astype(np.float32).astype(np.float16)
        assert np.array_equal(read_image(tmp_path / "out.exr")[0][:, :, :3], wanted.astype(np.float32))
    # spxdiff and spxrelight choose alike.
    assert run("spxdiff", render, parts, "--layer", "albedo", "--json", "-", check=0).json()["max"] == 0
    run("spxrelight", render, "-i", "A", "-o", tmp_path / "lit.exr", "--layer", "albedo", check=0)
    assert read_image(tmp_path / "lit.exr")[1] == ["R", "G", "B"]
    for wrong, code, why in ((["--layer", "diffuse"], 2, "has no layer 'diffuse'"), (["--channels", "R,G,x"], 2, "has no channel 'x'"),
                             (["--channels", "R", "--layer", "mask"], 64, "--layer excludes --channels"),
                             (["--channels", "R,G,B,A,zz"], 64, "got 5"), (["--channels", "R,,B"], 64, "--channels"), (["--layer", ""], 64, "--layer")):
        assert why in run("spxuplift", render, "-o", tmp_path / "no.exr", *wrong, check=code).stderr
    assert "mask" in run("spxuplift", parts, "-o", tmp_path / "no.exr", "--layer", "diffuse", check=2).stderr


def test_inputs_of_equal_bytes_are_converted_once(run, tmp_path):
    """Of one size all: uncompressed, the last one differs in the last pixel."""
    codes = np.random.default_rng(6).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    a = write_image(tmp_path / "a.tif", codes, compression="none")
    b = tmp_path / "b.tif"
    b.write_bytes(a.read_bytes())
    changed = bytearray(a.read_bytes())
    changed[changed.index(codes.tobytes()) + codes.size - 1] ^= 1
    c = tmp_path / "c.tif"
    c.write_bytes(changed)
    out, alone = tmp_path / "out", tmp_path / "alone"
    out.mkdir()
    alone.mkdir()
    outcome = run("spxuplift", a, b, c, "-o", out, "--explain", "--json", "-", check=0)
    first, second, third = outcome.json()
    assert second["copied_from"] == str(out / "a.exr") and "copied_from" not in first and "copied_from" not in third
    assert (second["input"], second["output"]) == (str(b), str(out / "b.exr"))
    assert second["roundtrip"] == first["roundtrip"] and "the bytes of " + str(a) in outcome.stderr
    for name in "abc":
        run("spxuplift", tmp_path / f"{name}.tif", "-o", alone, check=0)
        assert digest(out / f"{name}.exr") == digest(alone / f"{name}.exr")
    assert digest(out / "a.exr") != digest(out / "c.exr")
    lit = run("spxrelight", a, b, "-i", "A,FL11", "-o", out, "--json", "-", check=0).json()
    assert [o["output"] for o in lit[1]["outputs"]] == [str(out / "b_A.exr"), str(out / "b_FL11.exr")]
    assert digest(out / "b_FL11.exr") == digest(out / "a_FL11.exr") != digest(out / "b_A.exr")
    # What failed is nobody's source.
    for name in "ab":
        (tmp_path / f"{name}.tif").write_bytes(a.read_bytes()[:1000])
    broken = run("spxuplift", a, b, c, "-o", out, "--json", "-", check=2).json()
    assert "error" in broken[0] and "error" in broken[1] and "error" not in broken[2]


@pytest.mark.parametrize("options", [["--store", "spectral", "--bands", 9], ["--store", "spectral", "--bands", 9, "--method", "mallett2019"],
                                     ["--method", "jakob2019"], ["--store", "spectral", "--bands", 12, "--max-error", 0.5, "--for", "A"],
                                     ["--store", "spectral", "--bands", 9, "--float", "--method", "jakob2019"]])
def test_greys_are_stored_once_and_copied(options, run, tmp_path):
    """A pixel in colour at the right edge of every row keeps its run from the short way; the greys beside it must not show it."""
    greys = np.random.default_rng(7).integers(0, 256, (48, 256), dtype=np.uint8)
    grey = write_image(tmp_path / "grey.png", greys)
    rgb = write_image(tmp_path / "rgb.png", np.repeat(greys[:, :, None], 3, axis=2))
    mixed_pixels = np.repeat(np.pad(greys, ((0, 0), (0, 1)))[:, :, None], 3, axis=2)
    mixed_pixels[:, -1] = [200, 30, 90]
    mixed = write_image(tmp_path / "mixed.png", mixed_pixels)
    reports = {}
    for source in (grey, rgb, mixed):
        out = source.with_suffix(".exr")
        outcome = run("spxuplift", source, "-o", out, *options, "--check", "--explain", "--json", "-", check=0)
        reports[source.stem] = outcome.json()
        assert ("97% are not uplifted" if source == grey else "each distinct grey is uplifted once") in outcome.stderr
        assert ("pixels without colour" in outcome.stderr) == (source != mixed)
    assert [reports[name]["grey"] for name in ("grey", "rgb", "mixed")] == [greys.size, greys.size, 0]
    short, by_rgb, plain = (read_image(tmp_path / f"{name}.exr") for name in ("grey", "rgb", "mixed"))
    assert short[1] == by_rgb[1] == plain[1]
    assert np.array_equal(short[0], by_rgb[0]) and np.array_equal(short[0], plain[0][:, :-1])
    if "--max-error" in options:
        kept = np.array(reports["grey"]["max_error"]["kept_bits"])
        assert kept.sum() == greys.size
        assert (np.array(reports["mixed"]["max_error"]["kept_bits"]) >= kept).all()


def straight_codes(path):
    """As they are in the file: the library multiplies by alpha unless it is told not to."""
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), config)
    pixels = source.read_image("uint8")
    source.close()
    return np.asarray(pixels)


@pytest.mark.parametrize("method", ["lattice", "mallett2019", "peters2019:fourier-srgb"])
def test_coefficients_in_eight_bits(method, run, tmp_path):
    """The codes of an 8-bit sRGB texture are the coefficients of methods that keep linear RGB: nothing is lost."""
    rng = np.random.default_rng(12)
    codes = rng.integers(0, 256, (31, 47, 4), dtype=np.uint8)
    codes[0, :, :3] = np.arange(47)[:, None] * [5, 3, 1]
    source = write_image(tmp_path / "in.png", codes, ["R", "G", "B", "A"], {"oiio:UnassociatedAlpha": 1})
    out, exr = tmp_path / "out.png", tmp_path / "out.exr"
    outcome = run("spxuplift", source, "-o", out, "--uint8", "--method", method, "--check", "--explain", "--json", "-", check=0)
    report = outcome.json()
    assert report["type"] == "uint8" and report["channels"] == ["R", "G", "B", "A"] and "3 in place of 6" in outcome.stderr
    run("spxuplift", source, "-o", exr, "--float", "--method", method, check=0)
    stored = straight_codes(out)
    assert np.array_equal(stored[:, :, 3], codes[:, :, 3])
    exact = method != "peters2019:fourier-srgb"
    if exact:
        assert np.array_equal(stored[:, :, :3], codes[:, :, :3]) and report["roundtrip"]["changed_codes"] == 0
    else:
        kept = read_image(exr)[0][:, :, :3]
        assert np.abs(stored[:, :, :3] - oracle.srgb_encode(kept.astype(float)) * 255).max() <= 0.5 + 1e-5
    # Every reader takes it for what it is: the same light as from floats, up to half a code.
    facts = run("spxinfo", out, "--at", "3,5", "--json", "-", check=0).json()
    assert facts["kind"] == "coefficients" and facts["format"] == "png" and facts["method"] == method
    if exact:
        assert facts["samples"]["G"] == pytest.approx(oracle.srgb_decode(codes[5, 3, 1] / 255), abs=1e-12)
    for name, texture in (("codes", out), ("floats", exr)):
        run("spxrelight", texture, "-i", "FL11", "--float", "-o", tmp_path / f"{name}.exr", check=0)
    lit, expected = (read_image(tmp_path / f"{name}.exr")[0] for name in ("codes", "floats"))
    assert np.abs(lit - expected)[:, :, :3].max() < (1e-6 if exact else 0.02)
    assert np.abs(lit - expected)[:, :, 3].max() < 1e-6
    difference = run("spxdiff", source, out, "--json", "-", check=0).json()
    trip = run("spxdiff", "--roundtrip", source, "--uint8", "--method", method, "--json", "-", check=0).json()
    assert difference["max"] < (1e-3 if exact else 3) and abs(trip["max"] - difference["max"]) < 0.01


def test_eight_bits_where_they_do_not_fit(run, png, tmp_path):
    out = tmp_path / "out.png"
    for options, why in ((["--method", "jakob2019"], "within [0,1]"), (["--store", "spectral"], "not spectra"), (["--max-error", 1], "do not have"),
                         (["--layout", "multipart"], "one part"), (["--half"], "excludes")):
        assert why in run("spxuplift", png, "-o", out, "--uint8", *options, check=64).stderr
    assert ".png" in run("spxuplift", png, "-o", tmp_path / "out.exr", "--uint8", check=64).stderr
    assert ".exr" in run("spxuplift", png, "-o", out, check=64).stderr
    run("spxbatch", tmp_path, tmp_path / "made", "--uint8", check=64)
    # Between two codes the nearer one: a linear texture is rounded by the curve.
    linear = np.random.default_rng(1).random((20, 30, 3)).astype(np.float32)
    run("spxuplift", write_image(tmp_path / "linear.exr", linear), "-o", out, "--uint8", check=0)
    stored = read_image(out, "uint8")[0].astype(int)
    exact = oracle.srgb_encode(linear.astype(float)) * 255
    assert np.abs(stored - exact).max() <= 0.5 + 1e-9
    many = write_image(tmp_path / "many.exr", np.zeros((4, 4, 5), np.float16), ["R", "G", "B", "A", "Z"])
    assert "alpha alone" in run("spxuplift", many, "-o", out, "--uint8", check=2).stderr
    run("spxuplift", many, "-o", out, "--uint8", "--channels", "R,G,B,A", check=0)
