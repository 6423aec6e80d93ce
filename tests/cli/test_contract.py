"""What scripts rely on, for every tool alike."""

import os
import pty
import re
import shutil
import subprocess

import pytest

from conftest import BIN, run_tool, tools

COMMON = ["--help", "--version", "--threads", "--quiet", "--explain", "--json", "--strict"]


def test_there_are_tools():
    assert tools(), f"no spx* binaries in {BIN}: set SPECTEX_BIN"


each_tool = pytest.mark.parametrize("tool", tools())


@each_tool
def test_help(tool, run):
    outcome = run(tool, "--help", check=0)
    assert outcome.stderr == ""
    for option in COMMON:
        assert option in outcome.stdout
    for line in ["Usage: " + tool, "Examples:", "Exit codes:", "a stated threshold was exceeded", "an input or output failed"]:
        assert line in outcome.stdout
    for code in ["0", "1", "2", "64"]:
        assert any(line.split()[:1] == [code] for line in outcome.stdout.splitlines())
    too_wide = [line for line in outcome.stdout.splitlines() if len(line) > 100]
    assert not too_wide
    assert run(tool, "-h", check=0).stdout == outcome.stdout


@each_tool
def test_help_wins_over_errors(tool, run):
    assert run(tool, "--no-such-option", "--help", check=0).stdout.startswith("Usage: ")


@each_tool
def test_every_option_has_help_text(tool, run):
    lines = run(tool, "--help", check=0).stdout.splitlines()
    for here, below in zip(lines, lines[1:] + [""]):
        if here.startswith("  -"):
            text = here[26:].strip() if len(here) > 26 and here[24:26] == "  " else below[26:].strip()
            assert text, here


@each_tool
def test_version(tool, run):
    outcome = run(tool, "--version", check=0)
    assert outcome.stdout.split()[0] == tool
    assert outcome.stdout.split()[1].count(".") == 2
    assert outcome.stdout.count("\n") == 1


def assert_usage_error(tool, outcome, *mentions):
    assert outcome.code == 64, outcome
    assert outcome.stdout == "", outcome
    lines = outcome.stderr.splitlines()
    assert len(lines) == 1, outcome
    assert lines[0].startswith(tool + ": ")
    for mention in mentions:
        assert mention in lines[0], outcome


# The parser is one for all tools, and starting one costs a third of a second of loading libraries.
one_tool = pytest.mark.parametrize("tool", ["spxinfo"])


@each_tool
def test_unknown_option(tool, run):
    assert_usage_error(tool, run(tool, "--thread", "2"), "--thread", "did you mean --threads?")
    assert_usage_error(tool, run(tool, "--qiet"), "--qiet", "did you mean --quiet?")
    assert_usage_error(tool, run(tool, "--jsom=x"), "--jsom", "did you mean --json?")
    assert_usage_error(tool, run(tool, "--zzzzzzzzzzzz"), "--zzzzzzzzzzzz")


@each_tool
def test_nothing_given(tool, run):
    assert_usage_error(tool, run(tool))


@one_tool
@pytest.mark.parametrize("value", ["-1", "x", "", "1025", "1.5", "0x10", "1e2", " 1", "99999999999999999999"])
def test_threads(tool, value, run):
    assert_usage_error(tool, run(tool, "--threads", value), "--threads", "0..1024", f"'{value}'")
    assert_usage_error(tool, run(tool, f"--threads={value}"), "--threads", "0..1024", f"'{value}'")


@each_tool
def test_missing_value(tool, run):
    assert_usage_error(tool, run(tool, "--threads"), "--threads", "expected N")
    assert_usage_error(tool, run(tool, "--json", "--quiet"), "--json", "FILE", "--quiet")


@each_tool
def test_flag_with_value(tool, run):
    assert_usage_error(tool, run(tool, "--quiet=yes"), "--quiet", "no value")


@each_tool
def test_repeated_option(tool, run):
    assert_usage_error(tool, run(tool, "--threads", "1", "--threads", "2"), "--threads", "2 times")
    assert_usage_error(tool, run(tool, "--quiet", "--quiet"), "--quiet", "2 times")


@each_tool
def test_json_in_missing_folder(tool, tmp_path, run):
    rest = {"spxdiff": ["x", "y"], "spxheat": ["x", "-o", "y.png"], "spxinfo": ["x"], "spxuplift": ["x", "-o", "y.exr"],
            "spxrelight": ["x", "-i", "A", "-o", "y.png"], "spxsolve": ["primaries", "-o", "y.csv"]}
    if tool in rest:
        outcome = run(tool, "--json", tmp_path / "none" / "a.json", *rest[tool], cwd=tmp_path)
        assert_usage_error(tool, outcome, "--json", "folder", "missing")


@one_tool
@pytest.mark.parametrize("argument", [b"", b"x" * 100000, b"\xff\xfe\x80", b"--\xff", b"-\xff", b"-", b"--", b"---", b"--=",
                                      b"--=x", b"-=", b"[", b"[]", b"[a,b]", b"{}", b"%s%n%%", b"--%s%n", b"\n\t\x1b[31m",
                                      b"--threads=[1]", b"--json=", b"*", b"[z-a]*", b"--at", b"++", b"/", b"."])
def test_odd_arguments_never_crash(tool, argument, run, tmp_path):
    for arguments in ([argument], ["--", argument]):
        outcome = run_tool(tool, *arguments, cwd=tmp_path)
        assert outcome.code in (2, 64), outcome
        assert outcome.stdout == "", outcome
        assert outcome.stderr.startswith(tool + ": "), outcome
        outcome.stderr_bytes.decode("utf-8")
        assert not any(ord(c) < 32 and c != "\n" for c in outcome.stderr), outcome
        assert max(map(len, outcome.stderr.splitlines())) < 110000


@each_tool
def test_help_into_closed_pipe(tool):
    """`tool --help | true` ends by SIGPIPE at the most, without a message."""
    reader, writer = os.pipe()
    os.close(reader)
    finished = subprocess.run([str(BIN / tool), "--help"], stdout=writer, stderr=subprocess.PIPE, timeout=60)
    os.close(writer)
    assert finished.returncode == -13
    assert finished.stderr == b""


@each_tool
def test_help_to_full_device(tool):
    with open("/dev/full", "wb") as full:
        finished = subprocess.run([str(BIN / tool), "--help"], stdout=full, stderr=subprocess.PIPE, timeout=60)
    assert finished.returncode == 2


@each_tool
def test_locale_changes_nothing(tool, run):
    plain = run(tool, "--help", check=0, env={"LC_ALL": "C"})
    other = run(tool, "--help", check=0, env={"LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8"})
    assert plain.stdout == other.stdout


@each_tool
def test_no_escape_sequences_on_a_terminal_for_errors(tool):
    parent, child = pty.openpty()
    subprocess.run([str(BIN / tool), "--threads", "x"], stdout=child, stderr=child, timeout=60)
    os.close(child)
    text = b""
    try:
        while chunk := os.read(parent, 4096):
            text += chunk
    except OSError:
        pass  # Linux says EIO once the other side is closed
    os.close(parent)
    assert b"--threads" in text and b"\x1b" not in text


@pytest.mark.skipif(os.environ.get("SPECTEX_HARDENED") != "1", reason="only Release builds are hardened")
@pytest.mark.skipif(shutil.which("readelf") is None, reason="readelf is missing")
def test_hardened():
    """What the linker and the compiler were asked for is in the files."""
    imported = {}
    for path in [*(BIN / tool for tool in tools()), os.environ["SPECTEX_LIBRARY"]]:
        text = subprocess.run(["readelf", "-hlWd", "--dyn-syms", str(path)], capture_output=True, text=True, check=True).stdout
        stack = [line for line in text.splitlines() if "GNU_STACK" in line]
        assert len(stack) == 1 and " RW " in stack[0] and "RWE" not in stack[0], path
        assert "GNU_RELRO" in text and "NOW" in text and "TEXTREL" not in text, path
        assert "Type:" in text and "DYN" in text, path
        if str(path) != os.environ["SPECTEX_LIBRARY"]:
            assert re.search(r"FLAGS_1.*PIE", text), f"{path}: not position-independent"
        imported[str(path)] = text
        assert "__stack_chk_fail" in text, f"{path}: no stack protector"
    library = imported[os.environ["SPECTEX_LIBRARY"]]
    assert re.search(r"__\w+_chk\b", library.replace("__stack_chk_fail", "")), "no fortified calls"
    assert "glibcxx_assert_fail" in library, "containers are not checked in the rooms that read files"
