"""Faults of the machine and of its users, for every tool: nothing is lost, nothing half-written stays, inputs are untouched, and
the exit code and the message say what happened."""

import contextlib
import ctypes
import hashlib
import os
import pathlib
import random
import resource
import shutil
import signal
import socket
import subprocess
import threading
import time

import numpy as np
import pytest

import oracle
from conftest import BIN, read_image, run_tool, tools, write_image

# Every tool at its cheapest, writing all that it can into `out`; and the outputs in the order in which they are written.
COMMANDS = {
    "spxuplift": (["in.png", "-o", "out/x.exr"], ["x.exr"]),
    "spxrelight": (["in.png", "-i", "A", "-o", "out/x.png"], ["x.png"]),
    "spxdiff": (["in.png", "other.png", "--map", "out/x.exr"], ["x.exr"]),
    "spxheat": (["in.png", "other.png", "-o", "out/x.png"], ["x.png"]),
    "spxinfo": (["stored.exr", "--at", "1,1", "--plot", "out/x.svg"], ["x.svg"]),
    "spxsolve": (["primaries", "--bands", "380:780:20", "-o", "out/x.csv"], ["x.csv"]),
    "spxbench": (["speed", "--stride", "65536", "--methods", "mallett2019", "--stores", "coefficients-half", "-o", "out"], ["speed.md", "speed.json", "speed.csv"]),
    "spxbatch": (["src", "out/dst"], ["dst/in.exr"]),
}
WRITERS = ["spxuplift", "spxrelight", "spxdiff", "spxheat", "spxinfo", "spxsolve"]
each_tool = pytest.mark.parametrize("tool", sorted(COMMANDS))
each_writer = pytest.mark.parametrize("tool", WRITERS)


def tree(folder):
    """Every file below a folder with its hash."""
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(pathlib.Path(folder).rglob("*"))
            if p.is_file() and not p.is_symlink() and ".spxbatch" not in p.parts}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    pixels = np.random.default_rng(6).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    write_image(folder / "in.png", pixels)
    write_image(folder / "other.png", pixels[::-1])
    run_tool("spxuplift", "in.png", "-o", "stored.exr", cwd=folder, check=0)
    (folder / "src").mkdir()
    shutil.copy(folder / "in.png", folder / "src" / "in.png")
    # Long enough to be stopped anywhere.
    n = np.arange(1 << 19, dtype=np.uint32).reshape(512, 1024) * 37
    oracle.write_png(folder / "long.png", np.stack([n & 255, n >> 8 & 255, n >> 16 & 255], axis=-1).astype(np.uint8))
    return folder


@pytest.fixture
def work(inputs, tmp_path):
    """Links to the inputs, and an empty folder for outputs."""
    for path in inputs.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "out").mkdir()
    before = tree(inputs)
    yield tmp_path
    assert tree(inputs) == before


def earlier(tool, work):
    """A result that was there before, which must survive."""
    for name in COMMANDS[tool][1]:
        if tool != "spxbatch":
            (work / "out" / name).write_bytes(b"an earlier result")
    return tree(work / "out")


def in_child(limits=(), ignore=(), close=(), default=()):
    def prepare():
        for what, value in limits:
            resource.setrlimit(what, (value, value))
        for number in ignore:
            signal.signal(number, signal.SIG_IGN)
        for number in default:
            signal.signal(number, signal.SIG_DFL)
        for fd in close:
            os.close(fd)
    return prepare


def run(tool, work, prepare=None, more=(), **kwargs):
    arguments = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL, **kwargs}
    return subprocess.run([str(BIN / tool), *COMMANDS[tool][0], *more], cwd=work, timeout=60, preexec_fn=prepare, **arguments)


def assert_failed(tool, done, mentions, out=b""):
    text = done.stderr.decode("utf-8")
    # spxinfo tells before it draws.
    assert done.returncode == 2 and (tool == "spxinfo" or done.stdout == out), done
    lines = text.splitlines()
    assert lines and lines[-1].startswith(tool + ": "), done
    assert all(mention in text for mention in mentions), (mentions, text)


@contextlib.contextmanager
def mounted(folder, options):
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip("mounting is not permitted here: " + done.stderr.strip())
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


# Name, what the process is given, and what the message says.
LIMITS = [
    ("no byte may be written", in_child([(resource.RLIMIT_FSIZE, 0)], ignore=[signal.SIGXFSZ]), "File too large"),
    ("writing fails in mid-file", in_child([(resource.RLIMIT_FSIZE, 200)], ignore=[signal.SIGXFSZ]), "File too large"),
    ("the signal of that limit is not ignored", in_child([(resource.RLIMIT_FSIZE, 200)], default=[signal.SIGXFSZ]), "File too large"),
]


def name_written(tool):
    return COMMANDS[tool][1][0].split("/")[-1]


@each_writer
def test_write_error(tool, work):
    before = earlier(tool, work)
    for _, prepare, says in LIMITS if tool in ("spxuplift", "spxsolve") else LIMITS[1:2]:
        done = run(tool, work, prepare)
        assert_failed(tool, done, [name_written(tool), *([says] if tool == "spxsolve" else [])])
        assert tree(work / "out") == before and len(os.listdir(work / "out")) == len(before)


def test_write_error_of_a_library_and_of_a_benchmark(work):
    done = run("spxbatch", work, LIMITS[1][1])
    assert done.returncode == 2 and b"spxbatch: " in done.stderr
    assert tree(work / "out") == {}
    assert run("spxbatch", work).returncode == 0 and list(tree(work / "out")) == ["dst/in.exr"]
    before = earlier("spxbench", work)
    done = run("spxbench", work, LIMITS[0][1])
    assert done.returncode == 2 and b"speed" in done.stderr
    assert tree(work / "out") == before


FILE_SYSTEMS = [("full", "size=4k"), ("without inodes", "nr_inodes=1"), ("read-only", "ro,size=64k")]


@pytest.mark.parametrize("name, options", FILE_SYSTEMS, ids=[f[0] for f in FILE_SYSTEMS])
def test_file_system(name, options, work):
    with mounted(work / "out", options):
        if name == "full":
            (work / "out" / "all of it").write_bytes(bytes(4096))
        for tool in COMMANDS if name == "full" else ["spxuplift", "spxsolve", "spxbatch"]:
            done = run(tool, work)
            assert done.returncode == 2, (tool, done)
            text = done.stderr.decode()
            assert text.startswith(tool + ": ") and ("x." in text or "dst" in text or "speed" in text or "in.exr" in text), done
            left = [p for p in (work / "out").rglob("*") if p.is_file() and ".spxbatch" not in p.parts and p.name != "all of it"]
            assert left == [], (tool, left)


def test_read_only_folder_of_another_user(work, inputs, tmp_path):
    if os.geteuid() == 0:
        # Modes do not bind root: the same as somebody else.
        def drop():
            os.setgid(65534)
            os.setuid(65534)
        prepare = drop
        for folder in [work, *work.parents][:3]:
            os.chmod(folder, 0o755)
        for path in [inputs, *inputs.parents][:3]:
            os.chmod(path, 0o755)
        try:
            subprocess.run([str(BIN / "spxinfo"), "--version"], preexec_fn=drop, stdout=subprocess.DEVNULL, check=True)
        except (PermissionError, subprocess.CalledProcessError):
            pytest.skip(f"another user may not run {BIN / 'spxinfo'}: a folder above it is closed")
    else:
        prepare = None
    os.chmod(work / "out", 0o555)
    try:
        for tool in ("spxuplift", "spxrelight", "spxbatch"):
            assert_failed(tool, run(tool, work, prepare), ["ermission denied"])
            assert os.listdir(work / "out") == []
    finally:
        os.chmod(work / "out", 0o755)


def start_long(work, tool="spxuplift", more=()):
    out = {"spxuplift": ["-o", "out/x.exr", "--store", "spectral", "--bands", "31", "--compression", "piz"],
           "spxrelight": ["-i", "A", "-o", "out/x.exr", "--compression", "piz", "--float"], "spxheat": ["long.png", "-o", "out/x.png"],
           "spxdiff": ["long.png", "--map", "out/x.exr"]}[tool]
    return subprocess.Popen([str(BIN / tool), "long.png", *out, "--threads", "1", *more], cwd=work, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def start_and_stop(work, tool="spxuplift"):
    """A long run, stopped in its middle: its temporary file is there. A run that was over before it was seen is begun again."""
    for _ in range(20):
        process = start_long(work, tool)
        while process.poll() is None:
            if any(n.startswith(".x.") and f".{process.pid}-" in n for n in os.listdir(work / "out")):
                process.send_signal(signal.SIGSTOP)
                if any(f".{process.pid}-" in n for n in os.listdir(work / "out")):
                    return process
                process.send_signal(signal.SIGCONT)
                break
            time.sleep(0.001)
        assert process.wait(timeout=60) == 0, process.communicate()
        process.communicate()
        for name in COMMANDS[tool][1] + ["x.exr"]:
            (work / "out" / name).unlink(missing_ok=True)
    raise AssertionError("no run was seen at work")


def replaced(path):
    os.replace(shutil.copy(path, str(path) + ".new"), path)


def truncated(path):
    os.truncate(path, 5000)


def overwritten(path):
    data = path.read_bytes()
    with open(path, "r+b") as file:
        file.write(data[:-1] + b"\0")


def removed(path):
    path.unlink()


@pytest.mark.parametrize("tool, change", [("spxuplift", replaced), ("spxuplift", truncated), ("spxuplift", overwritten), ("spxuplift", removed),
                                          ("spxrelight", replaced), ("spxdiff", replaced)])
def test_input_changes_while_it_is_read(tool, change, work, inputs):
    source = work / "long.png"
    source.unlink()
    shutil.copy(inputs / "long.png", source)
    process = start_and_stop(work, tool)
    change(source)
    process.send_signal(signal.SIGCONT)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 2 and stdout == b"" and b"long.png" in stderr, (process.returncode, stderr)
    assert change is truncated or b"changed while it was read" in stderr
    assert os.listdir(work / "out") == []


def test_output_folder_goes_away(work):
    process = start_and_stop(work)
    os.rename(work / "out", work / "elsewhere")
    process.send_signal(signal.SIGCONT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 2 and b"out/x.exr" in stderr
    (work / "out").mkdir()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGXCPU])
def test_signal(number, work):
    tool = ["spxuplift", "spxrelight", "spxdiff", "spxheat"][number % 4]
    (work / "out" / "x.exr").write_bytes(b"an earlier result")
    before = tree(work / "out")
    process = start_long(work, tool)
    time.sleep(random.Random(number).random() * 0.5)
    process.send_signal(number)
    stdout, _ = process.communicate(timeout=60)
    if process.returncode == 0:
        return  # it was done before
    assert process.returncode in (-number, 128 + number) and stdout == b""
    assert tree(work / "out") == before and len(os.listdir(work / "out")) == 1


def test_killed_and_run_again(work):
    """What nobody could clean up is cleaned up by the next run; what another run is writing is left alone."""
    process = start_and_stop(work)
    killed = set(os.listdir(work / "out"))
    process.kill()
    process.communicate()
    assert set(os.listdir(work / "out")) == killed and "x.exr" not in killed
    # A name of the kind that is no leftover: its process lives. And one of another output.
    living, other = f".x.exr.{os.getpid()}-0.tmp.exr", ".y.exr.999999999-0.tmp.exr"
    for name in (living, other):
        (work / "out" / name).write_bytes(b"not yours")
    writing = start_and_stop(work)
    assert run("spxuplift", work).returncode == 0
    left = set(os.listdir(work / "out"))
    assert not killed & left and any(f".{writing.pid}-" in n for n in left)
    writing.send_signal(signal.SIGCONT)
    writing.communicate(timeout=60)
    assert writing.returncode == 0 and set(os.listdir(work / "out")) == {"x.exr", living, other}


def test_two_at_once(work):
    """Of two that write one output, each is whole and one of them stays."""
    first, second = start_long(work), start_long(work)
    assert [p.communicate(timeout=60) and p.returncode for p in (first, second)] == [0, 0]
    assert os.listdir(work / "out") == ["x.exr"] and read_image(work / "out" / "x.exr")[0].shape[:2] == (512, 1024)


SAME = {
    "spxuplift": ["in.exr", "-o", "{}"], "spxrelight": ["in.exr", "-i", "A", "-o", "{}"], "spxdiff": ["in.exr", "in.exr", "--map", "{}"],
    "spxheat": ["in.exr", "in.exr", "-o", "{}"], "spxinfo": ["in.exr", "--json", "{}"], "spxsolve": ["primaries", "-o", "{}", "--certificate", "in.exr"],
}


@pytest.mark.parametrize("tool", sorted(SAME))
def test_source_is_destination(tool, tmp_path):
    write_image(tmp_path / "in.exr", np.full((3, 4, 3), 0.5, np.float32))
    (tmp_path / "soft.exr").symlink_to("in.exr")
    os.link(tmp_path / "in.exr", tmp_path / "hard.exr")
    before = tree(tmp_path)
    for name in ("in.exr", "soft.exr", "hard.exr", "./in.exr") if tool == "spxuplift" else ("soft.exr", "hard.exr"):
        done = run_tool(tool, *[a.format(name) for a in SAME[tool]], cwd=tmp_path)
        assert done.code == 64 and done.stdout == "" and name in done.stderr, done
        assert tree(tmp_path) == before


def test_source_folder_is_destination(work, inputs):
    (work / "alias").symlink_to("src")
    for source, destination in (("src", "alias"), ("src", inputs), ("alias", "src/../src")):
        done = run_tool("spxbatch", source, destination, cwd=work)
        assert done.code == 64, done


@each_tool
def test_standard_output_is_closed(tool, work):
    """No file that is opened takes its number: reports never end up in a picture."""
    done = run(tool, work, in_child(close=[0, 1, 2]), ["--quiet"] if tool not in ("spxinfo", "spxbench") else [],
               stdout=None, stderr=None)
    names = sorted(tree(work / "out"), reverse=True)
    # What only writes files has nothing to say; what prints could not.
    assert done.returncode == (2 if tool in ("spxdiff", "spxinfo", "spxbench") else 0)
    assert names == COMMANDS[tool][1]
    if tool in ("spxuplift", "spxdiff"):
        read_image(work / "out" / "x.exr")


@pytest.mark.parametrize("tool", ["spxuplift", "spxinfo", "spxbatch"])
def test_standard_output_is_full(tool, work):
    with open("/dev/full", "wb") as full:
        done = run(tool, work, more=["--json", "-"], stdout=full)
    assert done.returncode == 2 and b"standard output" in done.stderr, done


def test_standard_output_is_a_broken_pipe(work):
    for tool in ("spxuplift", "spxinfo"):
        reader, writer = os.pipe()
        os.close(reader)
        done = run(tool, work, more=["--json", "-"], stdout=writer)
        os.close(writer)
        assert done.returncode == -signal.SIGPIPE, done
        assert not any(n.startswith(".") for n in os.listdir(work / "out"))


@pytest.fixture
def odd_files(work):
    os.mkfifo(work / "pipe.png")
    listener = socket.socket(socket.AF_UNIX)
    here = os.getcwd()
    os.chdir(work)  # the path of a socket is short
    listener.bind("socket.png")
    os.chdir(here)
    (work / "loop.png").symlink_to("loop.png")
    (work / "zero.png").symlink_to("/dev/zero")
    yield ["pipe.png", "socket.png", "loop.png", "zero.png", "src"]
    listener.close()


def test_inputs_that_are_no_files(odd_files, work):
    """None is waited for, none is read to an end that it does not have."""
    for name in odd_files:
        for tool, arguments in [("spxuplift", [name, "-o", "out/x.exr"]), ("spxrelight", ["in.png", "-i", f"./{name}", "-o", "out/x.png"]),
                                ("spxinfo", [name])][:3 if name == "pipe.png" else 1]:
            done = run_tool(tool, *arguments, cwd=work, timeout=20)
            assert done.code == (64 if name == "src" else 2) and name in done.stderr, done
    assert os.listdir(work / "out") == []


def test_scenes_tables_and_configurations_that_are_no_files(work):
    for suffix in ("pbrt", "csv", "ocio", "json"):
        os.mkfifo(work / f"pipe.{suffix}")
    for tool, arguments in [("spxbatch", ["src", "out/dst", "--scene", "pipe.pbrt"]), ("spxrelight", ["in.png", "-i", "pipe.csv", "-o", "out/x.png"]),
                            ("spxrelight", ["-i", "A", "--bake", "pipe.ocio"]), ("spxbench", ["speed", "--stride", "65536", "--baseline", "pipe.json", "-o", "out"]),
                            ("spxbench", ["accuracy", "--methods", "mallett2019", "--unseen", "pipe.csv", "-o", "out"])]:
        done = run_tool(tool, *arguments, cwd=work, timeout=20)
        assert done.code in (2, 64) and "pipe." in done.stderr or "--baseline" in arguments, done


def test_outputs_that_are_no_files(odd_files, work):
    os.mkfifo(work / "pipe.exr")
    (work / "null.exr").symlink_to("/dev/null")
    (work / "loop.exr").symlink_to("loop.exr")
    for name, code in (("pipe.exr", 2), ("null.exr", 2), ("loop.exr", 2), ("out/" + "n" * 300 + ".exr", 2)):
        done = run_tool("spxuplift", "in.png", "-o", name, cwd=work, timeout=20)
        assert done.code in (code, 64) and name in done.stderr, done
    assert os.path.exists("/dev/null") and os.listdir(work / "out") == []


NAMES = ["two words", "line\nbreak", "Grün λ 色", "-dash", "--help", "%s%n%d", "'quotes\"", "$(touch x)", "a;b&c", "\\back", "#hash", b"latin\xfc"]


def test_names(work):
    """One run for all names of a tool; spxbatch meets them as a folder's own."""
    folder = os.fsencode(work / "names")
    os.mkdir(folder)
    names = [os.fsencode(n) for n in NAMES]
    for name in names:
        shutil.copy(work / "in.png", os.path.join(folder, name + b".png"))
    done = run_tool("spxuplift", "-o", "../out", "--json", "-", "--", *[n + b".png" for n in names], cwd=folder, check=0)
    assert len(done.json()) == len(names)
    assert sorted(os.listdir(os.fsencode(work / "out"))) == sorted(n + b".exr" for n in names)
    for tool, arguments in [("spxinfo", ["--json", "-", "--", *[b"../out/" + n + b".exr" for n in names]]), ("spxbatch", [folder, work / "dst", "--json", "-"]),
                            ("spxdiff", ["--json", "-", "--", names[4] + b".png", names[1] + b".png"]),
                            ("spxheat", ["-o", b"../heat \n.png", "--", names[4] + b".png", names[3] + b".png"]),
                            ("spxrelight", ["-i", "A", "-o", b"../--lit \n.png", "--", names[4] + b".png"]), ("spxsolve", ["primaries", "--bands", "380:780:20", "-o", b"-\n.csv"])]:
        done = run_tool(tool, *arguments, cwd=folder, check=0)
        if "--json" in arguments:
            done.json()
    assert sorted(n for n in os.listdir(os.fsencode(work / "dst")) if n != b".spxbatch") == sorted(n + b".exr" for n in names)
    missing = run_tool("spxuplift", "-o", "../out", "--", *[b"no " + n for n in names], cwd=folder)
    # A name cannot forge a message of its own.
    assert missing.code == 2 and missing.stderr.count("\n") == len(names)
    assert all(line.startswith("spxuplift: ") for line in missing.stderr.splitlines())


@pytest.fixture(scope="module")
def decimal_commas(tmp_path_factory):
    """A locale that writes 1,5, made here where the machine has none."""
    folder = tmp_path_factory.mktemp("locales")
    made = subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(folder / "de_DE.UTF-8")], capture_output=True, text=True)
    if not (folder / "de_DE.UTF-8").exists():
        pytest.skip("localedef: " + made.stderr.strip()[:200])
    return {"LOCPATH": str(folder), "LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8"}


@pytest.mark.parametrize("tool", ["spxuplift", "spxrelight", "spxinfo", "spxsolve", "spxdiff"])
def test_decimal_commas(tool, work, decimal_commas):
    outcomes = []
    for environment in ({"LC_ALL": "C"}, decimal_commas):
        done = run(tool, work, more=["--json", "-"], env={**os.environ, **environment})
        assert done.returncode == 0, done
        outcomes.append((done.stdout, tree(work / "out")))
        shutil.rmtree(work / "out")
        (work / "out").mkdir()
    assert outcomes[0] == outcomes[1]


def test_few_descriptors(work):
    for limit in (8, 12):
        done = run("spxuplift", work, in_child([(resource.RLIMIT_NOFILE, limit)]))
        assert done.returncode in (0, 2, 127), done  # 127: not even its libraries can be loaded
        assert done.returncode == 0 or os.listdir(work / "out") == []
        shutil.rmtree(work / "out")
        (work / "out").mkdir()


def test_strange_environment(work):
    empty = {"PATH": "/nowhere", "HOME": "/nowhere", "TMPDIR": "/nowhere", "TZ": ":/nowhere", "OCIO": ""}
    done = run("spxuplift", work, env=empty)
    assert done.returncode == 0, done
    done = run("spxrelight", work, env={**os.environ, "OCIO": "/nowhere.ocio"}, more=["--output-colorspace", "Display P3 (no such)"])
    assert done.returncode in (2, 64) and os.listdir(work / "out") == ["x.exr"], done


def test_working_folder_is_gone(work):
    gone = work / "gone"
    gone.mkdir()
    script = 'cd gone && rmdir "$PWD" && exec "$0" ../in.png -o x.exr'
    done = subprocess.run(["sh", "-c", script, str(BIN / "spxuplift")], cwd=work, capture_output=True, timeout=60)
    assert done.returncode in (2, 64) and done.stderr.startswith(b"spxuplift: "), done


def test_tables_are_large_enough():
    """Twelve kinds of fault, at the least, for every tool."""
    assert set(COMMANDS) == set(tools())
    faults = len(LIMITS) + len(FILE_SYSTEMS) + len([n for n in globals() if n.startswith("test_")]) - 1
    assert faults >= 12
