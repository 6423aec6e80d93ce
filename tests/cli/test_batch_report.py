"""spxbatch --report: one page that stands alone, read as text and in a browser."""

import base64
import html.parser
import os
import re

import numpy as np
import pytest

from chromium import Page, find_chromium
from conftest import read_image, run_tool, write_image

HOSTILE = [b"<script>alert(1)<script>.png", b"quo\"te's & more.png", b"new\nline.png", b"inv\xff\xfealid.png", b"\"><img src=x onerror=alert(1)>.png"]
SHOWN = ["<script>alert(1)<script>.png", "quo\"te's & more.png", "new\\nline.png", "inv\\xff\\xfealid.png", "\"><img src=x onerror=alert(1)>.png"]


def noise(seed, width=24, height=16):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A library with all kinds of files, converted, and converted again."""
    folder = tmp_path_factory.mktemp("report")
    src = folder / "src"
    (src / "wood").mkdir(parents=True)
    write_image(src / "tiny.png", noise(1, 8, 8))
    write_image(src / "wood" / "large.png", noise(2, 300, 200))
    write_image(src / "wood" / "oak.png", np.full((16, 16, 3), 90, np.uint8))
    write_image(src / "brick_roughness.png", noise(3))
    (src / "bad.png").write_bytes(b"no picture")
    (src / "note.txt").write_text("not an image")
    for i, name in enumerate(HOSTILE):
        os.rename(write_image(src / "t.png", noise(10 + i)), os.fsencode(src) + b"/" + name)
    first = run_tool("spxbatch", src, folder / "dst", "--report", folder / "first.html", "--json", "-", check=2).json()
    second = run_tool("spxbatch", src, folder / "dst", "--report", folder / "second.html", "--json", "-", check=2).json()
    return folder, first, second


class Reader(html.parser.HTMLParser):
    """The page's table as dictionaries, and every address that the page could ask for."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.addresses, self.heads, self.elements = [], [], [], set()
        self.cell = self.head = None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.elements.add(tag)
        self.addresses += [attributes[a] for a in ("src", "href", "action", "data") if a in attributes]
        assert not any(a.startswith("on") for a in attributes), attributes
        if tag == "tr":
            self.rows.append({"status": attributes.get("data-s"), "cells": [], "values": [], "pictures": []})
        elif tag in ("td", "th") and self.rows:
            self.rows[-1]["cells"].append("")
            self.rows[-1]["values"].append(attributes.get("data-v"))
            self.cell = True
        elif tag == "small" and self.cell:
            self.rows[-1]["cells"][-1] += " | "
        elif tag == "img":
            self.rows[-1]["pictures"].append(base64.b64decode(attributes["src"].split(",")[1], validate=True))

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.cell = None

    def handle_data(self, data):
        if self.cell:
            self.rows[-1]["cells"][-1] += data


def table(path):
    reader = Reader(path.read_text("utf-8"))
    return reader, {r["cells"][0].split(" | ")[0]: r for r in reader.rows if r["status"]}


def test_page_stands_alone_and_tells_all(made):
    folder, first, second = made
    text = (folder / "first.html").read_text("utf-8")
    reader, rows = table(folder / "first.html")
    assert all(a.startswith("data:") for a in reader.addresses) and len(reader.addresses) > 20
    assert not re.search(r"https?:|@import|url\((?!#)", text)
    assert reader.elements.isdisjoint({"iframe", "object", "embed", "base", "form"})
    assert text.count("<script>") == 1
    # Every file, under its name whatever that holds, with the figures of the JSON.
    assert set(SHOWN) <= set(rows) and len(rows) == len(first["files"])
    for f in first["files"]:
        if "roundtrip" in f and os.path.basename(f["input"]) in rows:
            values = rows[os.path.basename(f["input"])]["values"]
            assert [float(v) for v in values[5:8]] == [f["roundtrip"][k] for k in ("mean", "p99", "max")]
    assert rows["bad.png"]["status"] == "failed" and rows["brick_roughness.png"]["status"] == "data"
    assert text.index("bad.png") < text.index("<h2>Errors") < text.index("<h2>Files")
    assert "Not images: 1 file" in text and "roughness" in text
    # Up to date: the manifest's figures and the kept thumbnails, without a texture being read.
    _, again = table(folder / "second.html")
    assert second["report"]["from_cache"] == first["report"]["pictures"] == 8
    assert {k: (r["values"], r["pictures"]) for k, r in again.items()} == {k: (r["values"], r["pictures"]) for k, r in rows.items()}
    assert sum(r["cells"][3] == "up to date" for r in again.values()) == 8


def test_thumbnails_are_what_the_tools_show(made, tmp_path):
    folder, _, _ = made
    _, rows = table(folder / "first.html")

    def decoded(png):
        (tmp_path / "t.png").write_bytes(png)
        return read_image(tmp_path / "t.png", "uint8")[0].astype(int)

    source, relit, errors = map(decoded, rows["tiny.png"]["pictures"])
    assert np.array_equal(source, read_image(folder / "src" / "tiny.png", "uint8")[0])
    run_tool("spxrelight", folder / "dst" / "tiny.exr", "-i", "A", "-o", tmp_path / "lit.png", check=0)
    # Float sums against the relight's own rounding: one code where a value lies between two.
    assert np.abs(relit - read_image(tmp_path / "lit.png", "uint8")[0]).max() <= 1
    assert errors.shape == source.shape and errors.max() > 0
    # A flat grey stays flat, and a large texture shrinks to its mean, which 50 x 50 pixels each make grey.
    assert len(np.unique(decoded(rows["wood/oak.png"]["pictures"][0]).reshape(-1, 3), axis=0)) == 1
    large = decoded(rows["wood/large.png"]["pictures"][0])
    assert large.shape == (64, 96, 3)
    # The mean in linear light of uniform codes, which an average of codes (127) would miss.
    codes = np.arange(256) / 255
    mean = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4).mean()
    assert abs(large.mean() - 255 * (1.055 * mean ** (1 / 2.4) - 0.055)) < 4


def test_usage_and_faults(made, tmp_path):
    folder, _, _ = made
    src, dst = folder / "src", tmp_path / "dst"
    for args in (["--report", tmp_path / "r.txt"], ["--report", tmp_path / "no" / "r.html"], ["--report-light", "A"],
                 ["--report", tmp_path / "r.html", "--report-light", "D:99"], ["--verify", "--report", tmp_path / "r.html"]):
        run_tool("spxbatch", src, dst, *args, check=64)
    assert not dst.exists() and not (tmp_path / "r.html").exists()
    dry = run_tool("spxbatch", src, dst, "--dry-run", "--report", tmp_path / "r.html", "--json", "-", check=2).json()
    assert not dst.exists() and dry["report"]["pictures"] == 0 and "Dry run" in (tmp_path / "r.html").read_text("utf-8")
    # An unwritable page fails the run's code, not the conversion.
    (tmp_path / "r.html").unlink()
    (tmp_path / "r.html").symlink_to("/dev/full")
    outcome = run_tool("spxbatch", src, dst, "--include", "tiny.png", "--report", tmp_path / "r.html", check=2)
    assert "r.html" in outcome.stderr and (dst / "tiny.exr").exists()


@pytest.mark.skipif(not find_chromium(), reason="chromium is not installed: the page is not looked at in a browser")
def test_in_a_browser(made, tmp_path):
    folder, first, _ = made
    with Page((folder / "first.html").as_uri(), tmp_path) as page:
        names = "Array.from(document.querySelectorAll('#files tbody tr'), r => r.cells[0].firstChild.textContent)"
        figures = "Array.from(document.querySelectorAll('#files tbody tr'), r => r.cells[7].dataset.v ?? null)"
        sorts = "Array.from(document.querySelectorAll('#files th[aria-sort]'), h => h.dataset.t + ' ' + h.ariaSort)"
        press = "document.querySelector('#files th[data-t=\"{}\"] button').click()"
        assert page.evaluate(sorts) == ["Texture ascending"]
        before = page.evaluate(names)
        page.evaluate(press.format("ΔE max"))
        values = page.evaluate(figures)
        known = [float(v) for v in values if v is not None]
        # By number, not by text ("0.0101" before "3e-05"), the largest first, what has none last.
        assert known == sorted(known, reverse=True) and len(known) == 8 and values[8:] == [None, None]
        assert page.evaluate(names) != before and page.evaluate(sorts) == ["ΔE max descending"]
        page.evaluate(press.format("ΔE max"))
        values = page.evaluate(figures)
        assert [float(v) for v in values[:8]] == sorted(known) and values[8:] == [None, None]
        page.evaluate(press.format("Size"))
        assert page.evaluate(names)[0].startswith("wood/")
        page.evaluate(press.format("Texture"))
        assert page.evaluate(names) == sorted(before, key=str.lower)
        # By keyboard alone.
        page.evaluate("document.querySelector('#files th[data-t=\"Status\"] button').focus()")
        for kind in ("keyDown", "keyUp"):
            page.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", text="\r", windowsVirtualKeyCode=13)
        assert page.evaluate(sorts) == ["Status ascending"]
        shown = "Array.from(document.querySelectorAll('#files tbody tr')).filter(r => r.offsetHeight > 0).length"
        page.evaluate("s = document.getElementById('status'); s.value = 'failed'; s.dispatchEvent(new Event('change'))")
        assert page.evaluate(shown) == 1 and page.evaluate("document.getElementById('shown').value") == "1 of 10 files"
        page.evaluate("s.value = ''; s.dispatchEvent(new Event('change'))")
        page.evaluate("s = document.getElementById('search'); s.value = 'wood OAK'; s.dispatchEvent(new Event('input'))")
        assert page.evaluate(shown) == 1
        page.evaluate("s.value = ''; s.dispatchEvent(new Event('input'))")
        # Nothing is wider than the screen, on a desk or a phone, and pictures come as they are scrolled to.
        for width, mobile in ((1200, False), (390, True)):
            page.size(width, 800, mobile=mobile)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        loaded = "Promise.all(Array.from(document.images, i => { i.loading = 'eager'; return i.decode(); })).then(() => document.images.length)"
        assert page.evaluate(loaded) == 24
        assert page.pdf().startswith(b"%PDF")
        assert page.evaluate("document.title").startswith("spxbatch: ")
        assert page.messages == []
        assert [r for r in page.requests if not r.startswith(("data:", "file:"))] == []
