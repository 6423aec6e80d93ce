"""The README's second command and .ci/run are the same lines."""
import os
import re

ROOT = os.path.join(os.path.dirname(__file__), "..", "..")


def text(*parts):
    with open(os.path.join(ROOT, *parts), encoding="utf-8") as file:
        return file.read()


def blocks():
    return re.findall(r"^```(\w*)\n(.*?)^```", text("README.md"), flags=re.S | re.M)


def test_first_two_blocks_are_the_commands():
    (first, build), (second, check) = blocks()[:2]
    assert first == second == "sh"
    assert "spxuplift" in build and "ctest" in check
    assert all(block[0] != "sh" for block in blocks()[2:])


def test_ci_runs_the_second_block_verbatim():
    assert blocks()[1][1] in text(".ci", "run")


def test_pictures_exist():
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text("README.md"))
    assert pictures
    for picture in pictures:
        assert os.path.getsize(os.path.join(ROOT, picture)) > 1000, picture


def test_every_tool_is_named():
    tools = [d for d in os.listdir(os.path.join(ROOT, "apps")) if d.startswith("spx")]
    assert tools
    for tool in tools:
        assert "`" + tool in text("README.md"), tool
