"""spxbatch: libraries of textures, done once, resumed, split and joined."""

import hashlib
import os
import random
import signal
import sqlite3
import subprocess
import time

import numpy as np
import pytest

from conftest import BIN, run_tool, write_image


def noise(seed, width=24, height=16):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def outputs(folder):
    """Relative path to hash of everything but the manifests."""
    return {os.fsencode(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in folder.rglob("*") if p.is_file() and ".spxbatch" not in p.parts}


def batch(*args, check=0, **kwargs):
    return run_tool("spxbatch", *args, "--json", "-", check=check, **kwargs).json()


def counts(report):
    return tuple(report[k] for k in ("converted", "skipped", "data", "failed", "copied"))


@pytest.fixture
def library(tmp_path):
    src = tmp_path / "src"
    (src / "wood" / "deep").mkdir(parents=True)
    write_image(src / "brick_albedo.png", noise(1))
    write_image(src / "brick_roughness.png", noise(2))
    write_image(src / "wood" / "oak.png", noise(3))
    write_image(src / "wood" / "oak.tif", noise(4))
    write_image(src / "wood" / "deep" / "again.png", noise(1))
    write_image(src / "wood" / "deep" / "wide.tif", noise(5).astype(np.uint16) * 257)
    return src


def test_converts_once_and_names_outputs(library, tmp_path):
    dst = tmp_path / "dst"
    (library / "readme.txt").write_text("not an image")
    first = batch(library, dst)
    assert counts(first) == (5, 0, 1, 0, 1)
    assert first["not_images"] == 1
    names = set(outputs(dst))
    assert names == {b"brick_albedo.exr", b"wood/oak.png.exr", b"wood/oak.tif.exr", b"wood/deep/again.exr", b"wood/deep/wide.exr"}
    by_input = {os.path.basename(f["input"]): f for f in first["files"]}
    assert by_input["brick_roughness.png"]["status"] == "data" and by_input["brick_roughness.png"]["output"] is None
    assert "oughness" in by_input["brick_roughness.png"]["reason"]
    # The lattice is exact; what is left is the rounding of half coefficients, which stays below 0.05.
    assert 0 < by_input["brick_albedo.png"]["roundtrip"]["max"] < 0.05
    # The very bytes of spxuplift: one path for both tools.
    run_tool("spxuplift", library / "wood" / "oak.png", "-o", tmp_path / "one.exr", check=0)
    assert (tmp_path / "one.exr").read_bytes() == (dst / "wood" / "oak.png.exr").read_bytes()
    before = {p: p.stat().st_mtime_ns for p in dst.rglob("*.exr")}
    second = batch(library, dst)
    assert counts(second) == (0, 5, 1, 0, 0)
    assert before == {p: p.stat().st_mtime_ns for p in dst.rglob("*.exr")}


def test_redoes_only_what_changes(library, tmp_path):
    dst = tmp_path / "dst"
    batch(library, dst)
    # 8-bit files are stored as halves anyway: only the 16-bit one changes.
    half = batch(library, dst, "--half")
    assert counts(half) == (1, 4, 1, 0, 0)
    assert [f["input"] for f in half["files"] if f["status"] == "converted"] == [str(library / "wood/deep/wide.tif")]
    # No colour of theirs is outside the gamut, so its policy changes nothing.
    assert counts(batch(library, dst, "--half", "--gamut", "desaturate")) == (0, 5, 1, 0, 0)
    assert counts(batch(library, dst, "--half", "--compression", "piz"))[0] == 5
    assert counts(batch(library, dst, "--half", "--compression", "piz", "--treat-as", "*oughness*=color")) == (1, 5, 0, 0, 0)
    # A touched file is hashed and left alone; a changed one is made again; a moved one is copied.
    os.utime(library / "wood" / "oak.png")
    assert counts(batch(library, dst, "--half", "--compression", "piz"))[:2] == (0, 5)
    write_image(library / "wood" / "oak.png", noise(9))
    (library / "wood" / "deep" / "wide.tif").rename(library / "moved.tif")
    moved = batch(library, dst, "--half", "--compression", "piz")
    assert counts(moved) == (2, 3, 1, 0, 1)
    run_tool("spxuplift", library / "moved.tif", "-o", tmp_path / "m.exr", "--half", "--compression", "piz", check=0)
    assert (tmp_path / "m.exr").read_bytes() == (dst / "moved.exr").read_bytes()


def test_verify_finds_and_next_run_mends(library, tmp_path):
    dst = tmp_path / "dst"
    batch(library, dst)
    good = outputs(dst)
    assert batch(library, dst, "--verify")["failed"] == 0
    victim = dst / "brick_albedo.exr"
    stat = victim.stat()
    data = bytearray(victim.read_bytes())
    data[-5] ^= 1
    victim.write_bytes(data)
    # Same size and time: only --verify can see it.
    os.utime(victim, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert counts(batch(library, dst))[0] == 0
    report = batch(library, dst, "--verify", check=2)
    assert report["failed"] == 1
    assert counts(batch(library, dst))[0] == 1
    assert outputs(dst) == good


def test_prune_is_dry_without_yes(library, tmp_path):
    dst = tmp_path / "dst"
    batch(library, dst)
    (library / "wood" / "deep" / "again.png").unlink()
    (library / "wood" / "deep" / "wide.tif").unlink()
    (dst / "wood" / "deep" / "wide.exr").write_bytes(b"the user's own")
    (dst / "note.txt").write_text("nobody's")
    dry = batch(library, dst, "--prune")
    assert not any(o["removed"] for o in dry["outputs"]) and len(dry["outputs"]) == 2
    assert (dst / "wood" / "deep" / "again.exr").exists()
    wet = batch(library, dst, "--prune", "--yes")
    assert [o["output"] for o in wet["outputs"] if o["removed"]] == [str(dst / "wood/deep/again.exr")]
    assert (dst / "wood" / "deep" / "wide.exr").exists() and (dst / "note.txt").exists() and (dst / "brick_albedo.exr").exists()


def test_bad_files_names_and_links(library, tmp_path):
    dst = library / "dst"
    (library / "bad.png").write_bytes(b"no picture")
    (library / "loop").symlink_to(library)
    (library / ".hidden.png").write_bytes(b"temporary")
    for name in (b"-dash.png", b"new\nline.png", "spa ce é.png".encode(), b"not\xffutf8.png"):
        os.rename(write_image(library / "t.png", noise(sum(name))), os.fsencode(library) + b"/" + name)
    report = batch(library, dst, check=2)
    assert counts(report) == (9, 0, 1, 1, 1)
    assert [f["reason"] for f in report["files"] if f["status"] == "failed"][0].count("bad.png") == 1
    assert {b"-dash.exr", b"new\nline.exr", "spa ce é.exr".encode(), b"not\xffutf8.exr"} <= set(outputs(dst))
    assert counts(batch(library, dst, check=2)) == (0, 9, 1, 1, 0)
    assert batch(library, dst, "--include", "wood/*", "--exclude", "*.tif")["excluded"] == len(report["files"]) - 2


def test_dry_run_writes_nothing(library, tmp_path):
    dst = tmp_path / "dst"
    assert counts(batch(library, dst, "--dry-run", "--explain")) == (5, 0, 1, 0, 0)
    assert not dst.exists()
    assert counts(batch(library, dst, "--data", "copy"))[2] == 1
    assert (dst / "brick_roughness.png").read_bytes() == (library / "brick_roughness.png").read_bytes()


def test_usage(library, tmp_path):
    for args in ([library, library], [library / "wood", library], [tmp_path / "none", tmp_path / "dst"],
                 [library, tmp_path / "no" / "parent"], [library, tmp_path / "dst", "--shard", "4/3"],
                 [library, tmp_path / "dst", "--yes"], [library, tmp_path / "dst", "--memory", "lots"]):
        outcome = run_tool("spxbatch", *args, check=64)
        assert outcome.stderr.startswith("spxbatch: ")
    assert not (tmp_path / "dst").exists()


def rows(dst):
    """All that a manifest holds but times."""
    db = sqlite3.connect(dst / ".spxbatch" / "manifest.sqlite")
    names = [c[1] for c in db.execute("PRAGMA table_info(files)") if c[1] not in ("output_mtime_ns", "seconds")]
    return db.execute(f"SELECT {','.join(names)} FROM files ORDER BY path").fetchall()


def test_three_shards_equal_one_run(library, tmp_path):
    for i in range(8):
        write_image(library / f"more{i}.png", noise(100 + i))
    batch(library, tmp_path / "one")
    parts = [batch(library, tmp_path / "three", "--shard", f"{i}/3") for i in (1, 2, 3)]
    assert sum(len(p["files"]) for p in parts) == 14
    assert max(len(p["files"]) for p in parts) < 14
    joined = batch("merge", tmp_path / "three")
    assert joined["shards"] == 3 and joined["merged_files"] == 14
    assert outputs(tmp_path / "one") == outputs(tmp_path / "three")
    assert rows(tmp_path / "one") == rows(tmp_path / "three")
    assert counts(batch(library, tmp_path / "three"))[:2] == (0, 13)
    batch(library, tmp_path / "two", "--shard", "0/2")
    assert batch("merge", tmp_path / "two", check=2)["missing"] == [1]


def test_killed_at_random_moments(library, tmp_path):
    for i in range(12):
        write_image(library / f"big{i}.png", noise(200 + i, 200, 150))
    started = time.monotonic()
    batch(library, tmp_path / "whole")
    usual = time.monotonic() - started
    good = outputs(tmp_path / "whole")
    dice = random.Random(7)
    killed = 0
    # Twenty kills: five times over, four one upon the other, each run taking up what the last has left.
    for chain in range(5):
        dst = tmp_path / f"dst{chain}"
        for _ in range(4):
            process = subprocess.Popen([BIN / "spxbatch", library, dst, "--quiet"], stderr=subprocess.DEVNULL)
            time.sleep(dice.uniform(0.1, 1.0) * usual)
            process.send_signal(signal.SIGKILL)
            killed += process.wait() == -signal.SIGKILL
            # Whatever stands under its own name is whole.
            for name, digest in outputs(dst).items() if dst.exists() else ():
                assert b".tmp" in name or good[name] == digest
        batch(library, dst)
        assert outputs(dst) == good
        assert rows(dst) == rows(tmp_path / "whole")
    # A run on an idle machine may end before its kill; most do not.
    assert killed > 10


def test_runs_exclude_each_other(library, tmp_path):
    import fcntl
    dst = tmp_path / "dst"
    batch(library, dst)
    with open(dst / ".spxbatch" / "lock", "r+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        outcome = run_tool("spxbatch", library, dst, check=2)
        assert "another spxbatch" in outcome.stderr
        run_tool("spxbatch", library, dst, "--shard", "0/2", check=2)
        fcntl.flock(lock, fcntl.LOCK_SH)
        run_tool("spxbatch", library, dst, check=2)
        run_tool("spxbatch", library, dst, "--shard", "0/2", check=0)
    run_tool("spxbatch", library, dst, check=0)


def test_same_bytes_for_any_threads(library, tmp_path):
    write_image(library / "large.png", noise(300, 700, 500))
    batch(library, tmp_path / "a", "--threads", 1)
    batch(library, tmp_path / "b", "--threads", 3, "--jobs", 2, "--memory", "1M")
    assert outputs(tmp_path / "a") == outputs(tmp_path / "b")
