"""Runs that are stopped or run out of room: nothing half-written is left, and earlier results stay."""

import os
import random
import resource
import signal
import subprocess
import time

import numpy as np
import pytest

import oracle
from conftest import BIN, write_image


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    n = np.arange(1 << 24, dtype=np.uint32).reshape(4096, 4096)
    pixels = np.stack([n & 255, n >> 8 & 255, n >> 16], axis=-1).astype(np.uint8)
    return oracle.write_png(tmp_path_factory.mktemp("large") / "large.png", pixels)


def start(source, out):
    # PIZ takes seconds for 36 bands of this size: long enough to be stopped anywhere.
    return subprocess.Popen([str(BIN / "spxuplift"), str(source), "-o", str(out), "--store", "spectral", "--bands", "36", "--half",
                             "--compression", "piz"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def wait_for_temporary(folder, process, known):
    """Until the tool has made its temporary file."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        if set(os.listdir(folder)) - known:
            return
        time.sleep(0.005)
    raise AssertionError(f"no temporary file beside the output: {process.poll()}")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_stopped(number, seed, large, tmp_path):
    out = tmp_path / "out.exr"
    previous = b"an earlier result" if seed == 1 else None
    if previous:
        out.write_bytes(previous)
    known = set(os.listdir(tmp_path))
    process = start(large, out)
    try:
        wait_for_temporary(tmp_path, process, known)
        time.sleep(random.Random(seed).random() * 1.0)
        process.send_signal(number)
        stdout, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert stdout == b""
    # By the signal itself, or by the code that shells give it.
    assert process.returncode in (-number, 128 + number)
    if previous:
        assert out.read_bytes() == previous
    else:
        assert not out.exists()
    left = set(os.listdir(tmp_path)) - known
    if number != signal.SIGKILL:
        assert not left
    else:
        assert all(name != "out.exr" for name in left)  # what nobody can clean up does not bear the output's name


def test_stopped_before_it_began(large, tmp_path):
    """At any moment of the start, the tool ends by the signal or not at all."""
    for delay in (0.0, 0.05, 0.2, 0.4):
        process = start(large, tmp_path / "out.exr")
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        assert process.returncode in (-signal.SIGINT, 128 + signal.SIGINT)
        assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("limit", [0, 1000, 100_000])
@pytest.mark.parametrize("tool, options, suffix", [
    ("spxuplift", ["--store", "spectral", "--bands", "36"], ".exr"), ("spxuplift", ["--compression", "none"], ".exr"),
    ("spxrelight", ["-i", "A"], ".png"), ("spxrelight", ["-i", "A"], ".exr")])
def test_no_room(limit, tool, options, suffix, tmp_path):
    pixels = np.random.default_rng(2).integers(0, 256, (300, 400, 3), dtype=np.uint8)
    source = write_image(tmp_path / "in.png", pixels)
    out = tmp_path / ("out" + suffix)

    def no_larger_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    finished = subprocess.run([str(BIN / tool), str(source), "-o", str(out), *options], stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, timeout=60, preexec_fn=no_larger_files)
    assert finished.returncode == 2, finished
    assert out.name in finished.stderr.decode() and finished.stdout == b""
    assert os.listdir(tmp_path) == ["in.png"]


def test_full_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)], capture_output=True, text=True)
    if mounted.returncode != 0:
        pytest.skip("mounting is not permitted here: " + mounted.stderr.strip())
    try:
        pixels = np.random.default_rng(3).integers(0, 256, (300, 400, 3), dtype=np.uint8)
        source = write_image(tmp_path / "in.png", pixels)
        for name in ("out.exr", "out.png"):
            tool = ["spxuplift"] if name.endswith("exr") else ["spxrelight", "-i", "A"]
            finished = subprocess.run([str(BIN / tool[0]), str(source), "-o", str(folder / name), *tool[1:]], capture_output=True,
                                      text=True, timeout=60)
            assert finished.returncode == 2, finished
            assert name in finished.stderr
            assert os.listdir(folder) == []
    finally:
        subprocess.run(["umount", str(folder)], check=True)
