"""Wrong files and wrong requests: the exit code, a message that helps, and nothing left behind."""

import contextlib
import hashlib
import os
import pathlib
import re
import shutil
import sqlite3
import subprocess

import numpy as np
import OpenImageIO as oiio
import pytest

import hostile
import oracle
from conftest import BIN, read_image, run_tool, write_image


def tree(folder):
    """Every file below a folder with its hash; links by what they name."""
    found = {}
    for path in sorted(pathlib.Path(os.fsdecode(folder)).rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = "-> " + os.readlink(path)
        elif path.is_dir():
            found[name] = "folder"
        else:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """One folder of good and bad files, copied for each case."""
    folder = tmp_path_factory.mktemp("corpus")
    rng = np.random.default_rng(31)
    noise = rng.integers(0, 256, (200, 150, 3), dtype=np.uint8)
    write_image(folder / "ok.png", noise)
    write_image(folder / "small.png", noise[:20, :10])
    write_image(folder / "ok.jpg", noise)
    write_image(folder / "ok.tif", noise)
    floats = rng.random((200, 150, 3)).astype(np.float32)
    write_image(folder / "ok.exr", floats)
    run_tool("spxuplift", folder / "ok.png", "-o", folder / "coefficients.exr", check=0)
    run_tool("spxuplift", folder / "ok.png", "-o", folder / "spectra.exr", "--store", "spectral", "--bands", "12", check=0)
    for name in ("ok.png", "ok.jpg", "ok.exr", "ok.tif", "coefficients.exr", "spectra.exr"):
        data = (folder / name).read_bytes()
        stem, suffix = name.split(".")
        for percent in (0, 2, 30, 60, 90):
            (folder / f"{stem}_cut{percent}.{suffix}").write_bytes(data[:len(data) * percent // 100])
    (folder / "text.png").write_text("This is no picture.\n")
    (folder / "text.exr").write_text("This is no picture.\n")
    odd = np.full((6, 7, 3), 0.5, np.float32)
    odd[2, 3, 0], odd[4, 5, 1], odd[0, 6, 2] = np.nan, np.inf, -np.inf
    odd[1, 1, 0], odd[1, 2, 2] = -0.5, 3
    write_image(folder / "odd.exr", odd)
    write_image(folder / "alpha.exr", odd[:, :, :1], ["A"])
    write_image(folder / "z.exr", odd[:, :, :1], ["Z"])
    write_image(folder / "map.exr", np.abs(np.nan_to_num(odd[:, :, :1])), ["Y"])
    bands = np.full((3, 4, 4), 0.5, np.float32)
    write_image(folder / "twice.exr", bands, ["T.400nm", "T.500nm", "T.500,0nm", "T.600nm"])
    write_image(folder / "two_bands.exr", bands[:, :, :2], ["T.400nm", "T.500nm"])
    write_image(folder / "infrared.exr", bands, ["T.900nm", "T.1000nm", "T.1100nm", "T.1200nm"])
    for name, model in [("broken", "{"), ("empty_object", "{}"), ("list", "[1,2]"), ("method", '{"format":1,"method":"none"}'),
                        ("huge", '{"format":1,"method":"mallett2019","bands":' + "[" * 5000)]:
        write_image(folder / f"model_{name}.exr", np.full_like(odd, 0.5), None, {"spectex:model": model, "spectex:coefficients": "R,G,B"})
    model = {a.name: a.value for a in oiio.ImageInput.open(str(folder / "coefficients.exr")).spec().extra_attribs}["spectex:model"]
    write_image(folder / "model_channels.exr", np.full_like(odd, 0.5), None, {"spectex:model": model, "spectex:coefficients": "R,G,Q"})
    spec = oiio.ImageSpec(4, 4, 3, "float")
    spec.deep = True
    deep = oiio.ImageOutput.create(str(folder / "deep.exr"))
    spec.channelnames = ["R", "G", "B"]
    assert deep.open(str(folder / "deep.exr"), spec)
    data = oiio.DeepData()
    data.init(16, 3, ["float"] * 3, ["R", "G", "B"])
    assert deep.write_deep_image(data) and deep.close()
    # A PNG that says it has no columns.
    png = bytearray((folder / "ok.png").read_bytes())
    png[16:20] = b"\0\0\0\0"
    (folder / "no_width.png").write_bytes(png)
    exr = bytearray((folder / "ok.exr").read_bytes())
    at = exr.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    exr[at + 8:at + 12] = (-5).to_bytes(4, "little", signed=True)  # right of the data window lies left of its left
    (folder / "inverted.exr").write_bytes(exr)
    exr[at + 8:at + 12] = (2 ** 31 - 2).to_bytes(4, "little")
    (folder / "enormous.exr").write_bytes(exr)
    lamps = {"words": "nm,power\n400,1\n500,bright\n600,1\n", "repeated": "400,1\n500,1\n500,2\n", "descending": "500,1\n400,1\n",
             "negative": "400,1\n500,-1\n", "columns": "400,1,2\n500,1,2\n", "one_row": "500,1\n", "dark": "400,0\n700,0\n",
             "nowhere": "900,1\n1000,1\n", "empty": "", "infinite": "400,1\n500,inf\n600,1\n", "zero": "0,1\n500,1\n"}
    for name, text in lamps.items():
        (folder / f"lamp_{name}.csv").write_text(text)
    (folder / "link.png").symlink_to("ok.png")
    os.link(folder / "ok.tif", folder / "hard.tif")
    os.link(folder / "ok.exr", folder / "hard.exr")
    (folder / "dangling.png").symlink_to("nowhere.png")
    (folder / "folder.png").mkdir()
    return folder


def copy_of(corpus, folder):
    shutil.copytree(corpus, folder, symlinks=True)
    for name in ("tif", "exr"):
        os.unlink(folder / f"hard.{name}")
        os.link(folder / f"ok.{name}", folder / f"hard.{name}")
    return folder


@pytest.fixture
def work(corpus, tmp_path):
    return copy_of(corpus, tmp_path / "work")


@pytest.fixture(scope="module")
def untouched(corpus, tmp_path_factory):
    """One copy for all cases that must change nothing, and what it holds."""
    folder = copy_of(corpus, tmp_path_factory.mktemp("untouched") / "work")
    return folder, tree(folder)


UP, RE = "spxuplift", "spxrelight"
S = ["--store", "spectral"]

# tool, arguments, exit code, what the message must hold
CASES = [
    # Files that are not there, or not what they seem.
    (UP, ["none.png", "-o", "x.exr"], 2, ["none.png", "No such file"]),
    (UP, ["dangling.png", "-o", "x.exr"], 2, ["dangling.png"]),
    (UP, ["none*.png", "-o", "x.exr"], 2, ["none*.png", "no file matches"]),
    (UP, ["folder.png", "-o", "x.exr"], 64, ["folder.png", "is a folder"]),
    (UP, [".", "-o", "x.exr"], 64, ["'.'", "is a folder"]),
    (UP, ["", "-o", "x.exr"], 64, ["empty"]),
    (UP, ["text.png", "-o", "x.exr"], 2, ["text.png"]),
    (UP, ["text.exr", "-o", "x.exr"], 2, ["text.exr"]),
    (UP, ["deep.exr", "-o", "x.exr"], 2, ["deep.exr", "deep"]),
    (UP, ["no_width.png", "-o", "x.exr"], 2, ["no_width.png"]),
    (UP, ["inverted.exr", "-o", "x.exr"], 2, ["inverted.exr"]),
    (UP, ["enormous.exr", "-o", "x.exr"], 2, ["enormous.exr"]),
    *[(UP, [f"ok_cut{p}.{s}", "-o", "x.exr", *S], 2, [f"ok_cut{p}.{s}"]) for s in ("png", "jpg", "exr", "tif") for p in (0, 2, 30, 60)],
    *[(RE, [f"{n}_cut{p}.exr", "-i", "A", "-o", "x.png"], 2, [f"{n}_cut{p}.exr"]) for n in ("coefficients", "spectra") for p in (2, 60)],
    ("spxdiff", ["ok.png", "ok_cut60.png"], 2, ["ok_cut60.png"]),
    ("spxdiff", ["--roundtrip", "ok_cut60.exr"], 2, ["ok_cut60.exr"]),
    ("spxheat", ["ok_cut60.png", "ok.png", "-o", "x.png"], 2, ["ok_cut60.png"]),
    # Pictures without the colours, spectra or models that are needed.
    (UP, ["alpha.exr", "-o", "x.exr"], 2, ["alpha.exr", "A", "expected R, G, B"]),
    (UP, ["z.exr", "-o", "x.exr"], 2, ["z.exr", "Z", "expected R, G, B"]),
    (UP, ["coefficients.exr", "-o", "x.exr"], 2, ["coefficients.exr", "coefficients already", "expected an RGB texture"]),
    (UP, ["spectra.exr", "-o", "x.exr"], 2, ["spectra.exr", "spectra already"]),
    (RE, ["twice.exr", "-i", "A", "-o", "x.exr"], 2, ["twice.exr", "T.500nm", "T.500,0nm", "same wavelength"]),
    (RE, ["two_bands.exr", "-i", "A", "-o", "x.exr"], 2, ["two_bands.exr"]),
    (RE, ["infrared.exr", "-i", "A", "-o", "x.exr"], 2, ["infrared.exr"]),
    *[(RE, [f"model_{n}.exr", "-i", "A", "-o", "x.exr"], 2, [f"model_{n}.exr", "spectex:model"])
      for n in ("broken", "empty_object", "list", "method", "huge")],
    (RE, ["model_channels.exr", "-i", "A", "-o", "x.exr"], 2, ["model_channels.exr", "'Q'"]),
    ("spxheat", ["ok.png", "-o", "x.png"], 2, ["ok.png", "one channel"]),
    ("spxdiff", ["ok.png", "small.png"], 2, ["ok.png", "small.png", "150 x 200", "10 x 20"]),
    ("spxheat", ["ok.png", "small.png", "-o", "x.png"], 2, ["150 x 200", "10 x 20"]),
    # Pixels.
    (UP, ["odd.exr", "-o", "x.exr", "--strict"], 2, ["odd.exr", "3 pixels", "6,0"]),
    (RE, ["odd.exr", "-i", "A", "-o", "x.exr", "--strict"], 2, ["odd.exr", "3 pixels"]),
    ("spxdiff", ["odd.exr", "odd.exr", "--strict", "--map", "x.exr"], 2, ["odd.exr", "3 pixels"]),
    (UP, ["odd.exr", "-o", "x.exr", "--gamut", "error"], 2, ["odd.exr", "pixel 1,1", "-0.5"]),
    (RE, ["odd.exr", "-i", "A", "-o", "x.exr", "--gamut", "error"], 2, ["odd.exr", "pixel 1,1"]),
    # Outputs that must not be written, or cannot be.
    (UP, ["ok.exr", "-o", "ok.exr"], 64, ["ok.exr", "input"]),
    (UP, ["ok.exr", "-o", "hard.exr"], 64, ["hard.exr", "input"]),
    (UP, ["ok.exr", "-o", "./folder.png/../ok.exr"], 64, ["input"]),
    (RE, ["link.png", "-i", "A", "-o", "ok.png"], 64, ["ok.png", "input"]),
    (RE, ["ok.png", "-i", "A", "-o", "link.png"], 64, ["link.png", "input"]),
    (RE, ["ok.tif", "-i", "A", "-o", "hard.tif"], 64, ["hard.tif", "input"]),
    ("spxdiff", ["ok.png", "ok.exr", "--map", "ok.exr"], 64, ["ok.exr", "input"]),
    ("spxheat", ["ok.png", "ok.tif", "-o", "ok.tif"], 64, ["ok.tif", "input"]),
    (UP, ["ok.exr", "-o", "x.exr", "--json", "ok.exr"], 64, ["--json", "ok.exr", "input"]),
    (UP, ["ok.png", "-o", "none/x.exr"], 64, ["folder 'none' is missing"]),
    (UP, ["ok.png", "-o", "text.png/x.exr"], 64, ["text.png", "missing"]),
    (UP, ["ok.png", "-o", "none/"], 64, ["none", "missing"]),
    (UP, ["ok.png", "-o", ""], 64, ["-o"]),
    (UP, ["ok.png"], 64, ["-o", "OUT"]),
    (UP, ["ok.png", "-o", "x.png"], 64, ["x.png", ".exr"]),
    (UP, ["ok.png", "-o", "x"], 64, ["x", ".exr"]),
    (RE, ["ok.png", "-i", "A", "-o", "x.abc"], 64, ["x.abc", "suffix"]),
    (RE, ["ok.png", "-i", "A", "-o", "x.png", "--float"], 64, ["x.png", "float", "uint16"]),
    (RE, ["ok.png", "-i", "A", "-o", "x.jpg", "--uint16"], 64, ["x.jpg", "uint16"]),
    ("spxheat", ["map.exr", "-o", "x.exr"], 64, ["x.exr", "8 bits"]),
    (UP, ["ok.png", "small.png", "-o", "x.exr"], 64, ["x.exr", "folder"]),
    (RE, ["ok.png", "-i", "A,FL2", "-o", "x.png"], 64, ["{illuminant}", "x.png"]),
    (RE, ["ok.png", "-i", "A,A", "-o", "{illuminant}.png"], 64, ["A.png"]),
    (UP, ["ok.png", "-o", "x.exr", "--json", "none/x.json"], 64, ["--json", "none", "missing"]),
    (UP, ["ok.png", "-o", "/proc/x.exr"], 2, ["/proc/x.exr"]),
    # Requests.
    (RE, ["ok.png", "-i", "D:99", "-o", "x.png"], 64, ["D:99", "4000", "25000"]),
    (RE, ["ok.png", "-i", "D:", "-o", "x.png"], 64, ["D:"]),
    (RE, ["ok.png", "-i", "P:-5", "-o", "x.png"], 64, ["P:-5"]),
    (RE, ["ok.png", "-i", "FL99", "-o", "x.png"], 64, ["FL99", "FL9"]),
    (RE, ["ok.png", "-i", "A,,FL2", "-o", "x_{illuminant}.png"], 64, ["-i"]),
    (RE, ["ok.png", "-i", "-1*A+2*FL2", "-o", "x.png"], 64, ["-1*A"]),
    (RE, ["ok.png", "-o", "x.png"], 64, ["no illuminant", "-i"]),
    (RE, ["ok.png", "-i", "none.csv", "-o", "x.png"], 2, ["none.csv"]),
    *[(RE, ["ok.png", "-i", f"lamp_{n}.csv", "-o", "x.png"], 2, [f"lamp_{n}.csv", m]) for n, m in [
        ("words", "line 3"), ("repeated", "line 3"), ("descending", "line 2"), ("negative", "line 2"), ("columns", "line 1"),
        ("infinite", "line 2"), ("zero", "line 1"), ("one_row", "at least two"), ("dark", "zero"), ("nowhere", "visible"), ("empty", "rows")]],
    (UP, ["ok.png", "-o", "x.exr", "--rgb-space", "sRGB2"], 64, ["--rgb-space", "sRGB2", "BT.709"]),
    (UP, ["ok.png", "-o", "x.exr", "--observer", "1932"], 64, ["--observer", "1932", "cie1931"]),
    (UP, ["ok.png", "-o", "x.exr", "--method", "magic"], 64, ["--method", "magic", "mallett2019"]),
    (UP, ["ok.png", "-o", "x.exr", "--illuminant", "sun"], 64, ["--illuminant", "sun"]),
    (UP, ["ok.png", "-o", "x.exr", "--gamut", "stretch"], 64, ["--gamut", "clip"]),
    (UP, ["ok.png", "-o", "x.exr", "--store", "all"], 64, ["--store", "spectral"]),
    (UP, ["ok.png", "-o", "x.exr", "--layout", "three"], 64, ["--layout", "multipart"]),
    (UP, ["ok.png", "-o", "x.exr", "--half", "--float"], 64, ["--float", "half"]),
    (UP, ["ok.png", "-o", "x.exr", "--input-colorspace", "sRGBB"], 64, ["sRGBB", "sRGB - Texture"]),
    (RE, ["ok.png", "-i", "A", "-o", "x.png", "--output-colorspace", "nope"], 64, ["nope", "Raw"]),
    *[(UP, ["ok.png", "-o", "x.exr", "--compression", c], 64, [c, "zip", "piz"]) for c in ("B44", "b44a", "DWAA", "dwab", "pxr24", "lzma")],
    (UP, ["ok.png", "-o", "x.exr", "--compression", ""], 64, ["--compression"]),
    *[(UP, ["ok.png", "-o", "x.exr", *S, "--bands", b], 64, ["--bands", f"'{b}'" if b.count(":") != 2 else ""])
      for b in ("", "1:2", "2", "0", "-5", "402", "x", "380:780:7", "780:380:5", "380:780:0", "380:780:-5", "nan:780:5", "380:inf:5",
                "380:780:5:1", "1e9:2e9:1", "36.5")],
    (UP, ["ok.png", "-o", "x.exr", "--rgb-space", "Rec.2020"], 2, ["Rec.2020", "vertex", "violate"]),
    (UP, ["ok.png", "-o", "x.exr", "--rgb-space", "Rec.2020", "--method", "mallett2019"], 2, ["Rec.2020", "violate", "0.2106"]),
    (UP, ["ok.png", "-o", "x.exr", "--rgb-space", "ACEScg"], 2, ["ACEScg", "violate"]),
    ("spxdiff", ["ok.png"], 64, ["two"]),
    ("spxdiff", ["ok.png", "ok.jpg", "ok.tif"], 64, ["two"]),
    ("spxdiff", ["ok.png", "ok.jpg", "--metric", "cie2000"], 64, ["--metric", "ciede2000"]),
    ("spxdiff", ["ok.png", "ok.jpg", "--fail-max", "-1"], 64, ["--fail-max", "-1"]),
    ("spxheat", ["map.exr", "-o", "x.png", "--range", "3:2"], 64, ["--range", "3:2"]),
    ("spxheat", ["map.exr", "-o", "x.png", "--colormap", "pink"], 64, ["--colormap", "magma"]),
]


@pytest.mark.parametrize("tool, arguments, code, fragments", CASES, ids=[f"{i}-{c[0]}-{' '.join(c[1])[:60]}" for i, c in enumerate(CASES)])
def test_answer(tool, arguments, code, fragments, untouched):
    work, before = untouched
    outcome = run_tool(tool, *arguments, cwd=work)
    assert outcome.code == code, outcome
    assert outcome.stdout == "", outcome
    message = outcome.stderr.splitlines()
    assert message and message[-1].startswith(tool + ": "), outcome
    for fragment in fragments:
        assert fragment in outcome.stderr, (fragment, outcome)
    assert tree(work) == before, outcome


def measured(tool, *arguments, cwd):
    """Exit code, what was said, and the largest memory in MB."""
    with open(cwd / "said", "w+b") as said:
        process = subprocess.Popen([str(BIN / tool), *map(str, arguments)], cwd=cwd, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
        _, status, usage = os.wait4(process.pid, 0)
        said.seek(0)
        text = said.read().decode("utf-8", "replace")
    os.unlink(cwd / "said")
    return os.waitstatus_to_exitcode(status), text, usage.ru_maxrss / 1024


# A texture of 4 x 4 takes 80 MB, most of it linked libraries. Four in work at once, and a decoder's own tables, stay below.
MOST_MEMORY = 400


def lay_out(files, folder):
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    write_image(folder / "fine.png", np.full((4, 4, 3), 90, np.uint8))
    return folder


@pytest.mark.parametrize("tool", ["spxuplift", "spxrelight", "spxbatch", "spxinfo", "spxdiff"])
def test_hostile_pictures(tool, tmp_path):
    """All at once: each has its own message, none costs memory, and the good one among them is made."""
    folder = lay_out({**hostile.PICTURES, **hostile.SPECTRA} if tool == "spxrelight" else hostile.PICTURES, tmp_path / "in")
    (tmp_path / "out").mkdir()
    before = tree(folder)
    names = [n for n in before if n != "fine.png"]
    inputs = [f"in/{n}" for n in [*names, "fine.png"]]
    arguments = {"spxuplift": [*inputs, "-o", "out"], "spxrelight": [*inputs, "-i", "A", "-o", "out"], "spxinfo": inputs,
                 "spxdiff": ["--roundtrip", *inputs], "spxbatch": ["in", "out"]}[tool]
    code, text, memory = measured(tool, *arguments, cwd=tmp_path)
    assert code == 2, text
    assert tree(folder) == before
    lines = [line for line in text.splitlines() if line.startswith(tool + ": ")]
    # A header alone may be fine; its pixels are not.
    silent = [n for n in names if not any(n in line for line in lines)]
    assert not silent or tool == "spxinfo", silent
    assert len(silent) < 30
    # Neither a library's internals nor a forged line.
    assert not any(word in text for word in ("std::", "vector::", "basic_string", "unexpected")), text
    if tool in ("spxuplift", "spxrelight", "spxbatch"):
        assert [p.name for p in (tmp_path / "out").iterdir() if p.name != ".spxbatch"] == ["fine.exr" if tool != "spxrelight" else "fine_A.exr"]
    assert memory < MOST_MEMORY


def test_hostile_lights(tmp_path):
    folder = lay_out(hostile.LAMPS, tmp_path / "in")
    before = tree(folder)
    for name in hostile.LAMPS:
        code, text, memory = measured("spxrelight", "fine.png", "-i", name, "-o", "x.png", cwd=folder)
        assert code == 2 and name in text and memory < MOST_MEMORY, (name, code, text)
        assert "root:" not in text and "unexpected" not in text
    assert tree(folder) == before


def test_hostile_scenes(tmp_path):
    folder = lay_out({**hostile.SCENES, "cycle_b.pbrt": 'Include "cycle.pbrt"\n'}, tmp_path / "in")
    before = tree(folder)
    for name in hostile.SCENES:
        code, text, memory = measured("spxbatch", ".", "../dst", "--scene", name, "--dry-run", cwd=folder)
        assert (code == 2 or name.startswith("laughs")) and memory < MOST_MEMORY, (name, code, text)
        assert name in text or code == 0
    assert tree(folder) == before and not (tmp_path / "dst").exists()


def test_scenes_reach_nothing_outside(tmp_path):
    """Textures of a scene that lie elsewhere are named, and neither converted nor written; a rewritten scene stays beside its name."""
    scene, secret = tmp_path / "scene", tmp_path / "secret"
    for folder in (scene, secret):
        folder.mkdir()
        write_image(folder / "a.png", np.full((4, 4, 3), 90, np.uint8))
    lines = [f'Texture "{i}" "spectrum" "imagemap" "string filename" "{path}"\nMaterial "diffuse" "texture reflectance" "{i}"'
             for i, path in enumerate(["a.png", "../secret/a.png", str(secret / "a.png"), "link.png", "/etc/passwd", "../../../../etc/passwd"])]
    (scene / "link.png").symlink_to(secret / "a.png")
    (scene / "up.pbrt").write_text('Texture "u" "spectrum" "imagemap" "string filename" "a.png"\nMaterial "diffuse" "texture reflectance" "u"\n')
    (scene / "s.pbrt").write_text("\n".join(lines) + '\nInclude "./sub/../up.pbrt"\n')
    (scene / "sub").mkdir()
    before = {str(f): tree(f) for f in (scene, secret)}
    (tmp_path / "out").mkdir()
    outcome = run_tool("spxbatch", scene, tmp_path / "dst", "--scene", scene / "s.pbrt", "--rewrite-scene", tmp_path / "out" / "s.pbrt", check=0)
    assert "lies outside" in outcome.stderr
    assert {str(f): tree(f) for f in (scene, secret)} == before
    assert sorted(n for n in tree(tmp_path / "dst") if ".spxbatch" not in n) == ["a.exr"]
    assert sorted(os.listdir(tmp_path / "out")) == ["s.pbrt", "s.up.pbrt"]


def hostile_manifest(path, statements, rows=()):
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE TABLE files (path BLOB PRIMARY KEY, size INT, mtime_ns INT, content TEXT, status TEXT, use TEXT, use_reason TEXT, "
            "use_by_option INT, classifier TEXT, input_type INT, width INT, height INT, settings TEXT, gamut INT, out_of_gamut INT, "
            "nonfinite INT, output BLOB, output_size INT, output_mtime_ns INT, output_hash TEXT, measured_pixels INT, changed_codes INT, "
            "mean REAL, p99 REAL, max REAL, seconds REAL) WITHOUT ROWID; CREATE TABLE orphans (output BLOB PRIMARY KEY, hash BLOB) "
            "WITHOUT ROWID; PRAGMA user_version = 1;" + statements)


VIEW = ("DROP TABLE files; CREATE VIEW files AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT " +
        ", ".join(f"n AS {name}" for name in "path size mtime_ns content status use use_reason use_by_option classifier input_type width height "
                  "settings gamut out_of_gamut nonfinite output output_size output_mtime_ns output_hash measured_pixels changed_codes mean p99 "
                  "max seconds".split()) + " FROM c;")
MANIFESTS = {
    "endless": (VIEW, 2),
    "trigger": ("CREATE TRIGGER t AFTER INSERT ON files BEGIN DELETE FROM files; END;", 0),
    "outside": ("INSERT INTO files (path, output, output_hash, status, content) VALUES ('gone.png', '../keep.txt', '{hash}', 'converted', '00');"
                "INSERT INTO orphans VALUES ('../keep.txt', '{hash}'), ('{keep}', '{hash}');", 0),
    "types": ("INSERT INTO files (path, size, use, input_type, width, mean) VALUES (x'00ff', 'text', 'no such use', 99999, -5, 'NaN');", 0),
    "columns": ("DROP TABLE files; CREATE TABLE files (path);", 2),
}


@pytest.mark.parametrize("name", sorted(MANIFESTS))
def test_hostile_manifests(name, tmp_path):
    statements, expected = MANIFESTS[name]
    (tmp_path / "dst" / ".spxbatch").mkdir(parents=True)
    (tmp_path / "src").mkdir()
    write_image(tmp_path / "src" / "a.png", np.full((4, 4, 3), 90, np.uint8))
    keep = tmp_path / "keep.txt"
    keep.write_text("not to be removed")
    hostile_manifest(tmp_path / "dst" / ".spxbatch" / "manifest.sqlite",
                     statements.format(keep=keep, hash="00000000000000000000000000000000") if "{" in statements else statements)
    for arguments in (["src", "dst"], ["src", "dst", "--prune", "--yes"], ["src", "dst", "--verify"])[:3 if name == "outside" else 1]:
        outcome = run_tool("spxbatch", *arguments, cwd=tmp_path, timeout=30)
        assert outcome.code == expected or (outcome.code == 2 and name == "outside" and "--verify" in arguments), outcome
        assert "unexpected" not in outcome.stderr
        assert keep.read_text() == "not to be removed"
    if expected == 0:
        assert (tmp_path / "dst" / "a.exr").exists()


def test_manifest_that_is_a_link(tmp_path):
    (tmp_path / "dst" / ".spxbatch").mkdir(parents=True)
    (tmp_path / "src").mkdir()
    write_image(tmp_path / "src" / "a.png", np.full((4, 4, 3), 90, np.uint8))
    for name, target in (("lock", "elsewhere.lock"), ("manifest.sqlite", "elsewhere.sqlite")):
        (tmp_path / "dst" / ".spxbatch" / name).symlink_to(tmp_path / target)
        outcome = run_tool("spxbatch", "src", "dst", cwd=tmp_path)
        assert outcome.code == 2 and name in outcome.stderr, outcome
        assert not (tmp_path / target).exists()
        (tmp_path / "dst" / ".spxbatch" / name).unlink()


CONFIGURATIONS = {
    "empty": "", "text": "no configuration", "version": "ocio_profile_version: 99\n", "binary": "\0\1\2",
    "deep": "ocio_profile_version: 2\nroles: " + "{a: " * 3000 + "}" * 3000,
    "laughs": "a: &a [x,x,x,x,x,x,x,x,x,x]\n" + "".join(f"{c}: &{c} [{','.join('*' + p for _ in range(10))}]\n" for p, c in zip("abcdefgh", "bcdefghi")) +
              "ocio_profile_version: 2\nroles: *i\n",
}


@pytest.mark.parametrize("name", sorted(CONFIGURATIONS))
def test_hostile_configurations(name, tmp_path):
    (tmp_path / "c.ocio").write_text(CONFIGURATIONS[name])
    write_image(tmp_path / "a.png", np.full((4, 4, 3), 90, np.uint8))
    before = tree(tmp_path)
    code, text, memory = measured("spxrelight", "-i", "A", "--bake", "c.ocio", cwd=tmp_path)
    assert code == 2 and "c.ocio" in text and memory < MOST_MEMORY, (code, text[:500])
    assert tree(tmp_path) == before
    if name not in ("deep", "version"):
        return
    outcome = run_tool("spxrelight", "a.png", "-i", "A", "-o", "x.png", "--output-colorspace", "no such space", cwd=tmp_path,
                       env={"OCIO": str(tmp_path / "c.ocio")})
    assert outcome.code in (2, 64) and "unexpected" not in outcome.stderr, outcome
    assert tree(tmp_path) == before


def test_pixels_without_a_number(tmp_path):
    """A million of them are counted and marked; statistics are of what is left, and never NaN."""
    pixels = np.full((1000, 1000, 3), np.nan, np.float32)
    write_image(tmp_path / "nan.exr", pixels)
    pixels[10:20, 30:40] = 0.25
    write_image(tmp_path / "some.exr", pixels)
    for tool, arguments in [(UP, ["nan.exr", "-o", "x.exr"]), (RE, ["nan.exr", "-i", "A", "-o", "x.exr"])]:
        report = run_tool(tool, *arguments, "--json", "-", cwd=tmp_path, check=0).json()
        assert report["nonfinite"] == 1000000 and report["first_nonfinite"] == [0, 0]
        assert np.isfinite(read_image(tmp_path / "x.exr")[0]).all()
    for name, left in (("nan.exr", 0), ("some.exr", 100)):
        report = run_tool("spxdiff", name, name, "--map", "map.exr", "--json", "-", cwd=tmp_path, check=0).json()  # .json() refuses NaN
        assert report["nonfinite"] == 1000000 - left and report["pixels"] == left
        mask = np.isnan(read_image(tmp_path / "map.exr")[0])
        assert mask.sum() == 1000000 - left and (left == 0 or not mask[10:20, 30:40].any())
    report = run_tool("spxheat", "map.exr", "-o", "x.png", "--json", "-", cwd=tmp_path, check=0).json()
    assert run_tool(UP, "nan.exr", "-o", "y.exr", "--strict", cwd=tmp_path).code == 2


def test_tiles_and_levels_are_read(tmp_path):
    """Of a tiled file with smaller levels, the first is the picture."""
    pixels = np.random.default_rng(2).random((40, 50, 3)).astype(np.float32)
    write_image(tmp_path / "plain.exr", pixels)
    spec = oiio.ImageSpec(50, 40, 3, "float")
    spec.tile_width = spec.tile_height = 16
    output = oiio.ImageOutput.create(str(tmp_path / "mip.exr"))
    spec.attribute("openexr:levelmode", 1)
    assert output.open(str(tmp_path / "mip.exr"), spec) and output.write_image(pixels) and output.close()
    for name in ("plain", "mip"):
        run_tool(UP, f"{name}.exr", "-o", f"{name}_up.exr", cwd=tmp_path, check=0)
    assert np.array_equal(read_image(tmp_path / "plain_up.exr")[0], read_image(tmp_path / "mip_up.exr")[0])


def test_no_text_is_a_format():
    """Messages are made by {fmt}, whose formats the compiler checks: no printf, and no format that is known at run time only."""
    pattern = re.compile(r"\b\w*printf\s*\(|syslog\s*\(|fmt::runtime|fmt::v(format|print)|\bsystem\s*\(|\bpopen\s*\(")
    for folder in ("lib", "apps"):
        for path in (oracle.ROOT / folder).rglob("*"):
            if path.suffix in (".cpp", ".h"):
                assert not pattern.search(path.read_text()), path


def test_there_are_enough():
    """Sixty bad inputs at the least, all of them different."""
    files = len(hostile.PICTURES) + len(hostile.SPECTRA) + len(hostile.LAMPS) + len(hostile.SCENES) + len(MANIFESTS) + len(CONFIGURATIONS)
    assert len(CASES) >= 40 and files >= 60


def test_counts_of_odd_pixels(work):
    for tool, more in [(UP, ["-o", "x.exr"]), (RE, ["-i", "A", "-o", "x.exr"]), ("spxdiff", ["--roundtrip"])]:
        outcome = run_tool(tool, "odd.exr", *more, "--json", "-", cwd=work, check=0)
        report = outcome.json()
        if tool == "spxdiff":
            assert report["pixels"] + report["nonfinite"] == 42
            continue
        assert report["nonfinite"] == 3 and report["first_nonfinite"] == [6, 0]
        assert report["out_of_gamut"] == 2
        assert "odd.exr" in outcome.stderr
    run_tool(UP, "odd.exr", "-o", "y.exr", cwd=work, check=0)
    pixels, _ = read_image(work / "y.exr")
    assert np.array_equal(pixels[2, 3], [0, 0.5, 0.5])  # NaN
    assert np.array_equal(pixels[4, 5], [0.5, 1, 0.5])  # +inf
    assert np.array_equal(pixels[0, 6], [0.5, 0.5, 0])  # -inf
    assert np.array_equal(pixels[1, 1], [0, 0.5, 0.5])  # negative
    assert np.array_equal(pixels[1, 2], [0.5, 0.5, 1])  # above 1
    run_tool(UP, "odd.exr", "-o", "y.exr", "--gamut", "desaturate", cwd=work, check=0)
    pixels, _ = read_image(work / "y.exr")
    assert np.isfinite(pixels).all() and pixels.min() >= 0 and pixels.max() <= 1


def test_one_bad_file_among_good_ones(work):
    """The others are made, the bad one is named, the code is the worst."""
    (work / "out").mkdir()
    outcome = run_tool(UP, "ok.png", "text.png", "small.png", "-o", "out", "--json", "-", cwd=work)
    assert outcome.code == 2 and "text.png" in outcome.stderr
    assert sorted(os.listdir(work / "out")) == ["ok.exr", "small.exr"]
    report = outcome.json()
    assert [r["input"] for r in report] == ["ok.png", "text.png", "small.png"]
    assert "error" in report[1] and "error" not in report[0]


@pytest.mark.parametrize("name", ["two words.png", "line\nbreak.png", "Grün λ.png", "-dash.png", "%s%n.png", "a{illuminant}.png", "[x].png",
                                  b"latin\xfc.png"])
def test_names_of_any_kind(name, work):
    odd = os.fsencode(name)
    os.rename(work / "small.png", os.path.join(os.fsencode(work), odd))
    out = odd.replace(b".png", b".exr")
    outcome = run_tool(UP, "-o", b"./" + out, "--json", "-", "--", odd, cwd=work, check=0)
    assert os.path.exists(os.path.join(os.fsencode(work), out))
    outcome.json()
    if b"{" not in odd:
        run_tool(RE, "-i", "A", "-o", b"./lit_" + odd, "--", b"./" + out, cwd=work, check=0)
        assert os.path.exists(os.path.join(os.fsencode(work), b"lit_" + odd))
    missing = run_tool(UP, "-o", "x.exr", "--", b"no_" + odd, cwd=work)
    assert missing.code == 2
    assert missing.stderr.count("\n") == 1  # a name cannot forge a second message


def test_json_alone_on_standard_output(work):
    outcome = run_tool(UP, "ok.png", "-o", "x.exr", "--json", "-", "--explain", cwd=work, check=0)
    assert outcome.json()["output"] == "x.exr"
    outcome = run_tool("spxdiff", "ok.png", "ok.jpg", "--json", "-", "--fail-max", "0.001", cwd=work, check=1)
    assert outcome.json()["max"] > 0.001
    run_tool("spxdiff", "ok.png", "ok.png", "--json", "report.json", cwd=work, check=0)
    assert oracle.load(work / "report.json")["max"] == 0


def test_existing_output_survives_a_failure(work):
    (work / "x.exr").write_bytes(b"an earlier result")
    assert run_tool(UP, "ok_cut60.png", "-o", "x.exr", cwd=work).code == 2
    assert run_tool(UP, "odd.exr", "-o", "x.exr", "--strict", cwd=work).code == 2
    assert (work / "x.exr").read_bytes() == b"an earlier result"


def test_output_through_a_link(work):
    """A link is written through: it stays one, and its target is the result."""
    (work / "target.exr").write_bytes(b"old")
    (work / "x.exr").symlink_to("target.exr")
    run_tool(UP, "ok.png", "-o", "x.exr", cwd=work, check=0)
    assert (work / "x.exr").is_symlink()
    assert read_image(work / "target.exr")[0].shape == (200, 150, 3)
