"""spxbench."""

import json

import numpy as np
import pytest


def table(text):
    """Rows of a Markdown table as lists of cells, the header first."""
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    assert text.splitlines()[1].startswith("|---")
    return rows


def test_speed_over_codes(tmp_path, run):
    out = run("spxbench", "speed", "--methods", "mallett2019,smits1999", "--stores", "coefficients-float,spectral-half", "--stride", "4093",
              "--bands", "380:780:20", "-o", tmp_path / "made", check=0).stdout
    rows = table(out)
    assert [r[0] for r in rows[1:]] == ["`mallett2019`"] * 2 + ["`smits1999`"] * 2
    assert (tmp_path / "made" / "speed.md").read_text() == out
    figures = json.loads((tmp_path / "made" / "speed.json").read_text())
    assert figures["what"] == "speed"
    exact, classic = figures["rows"][0], figures["rows"][2]
    assert exact["pixels"] == -(-2**24 // 4093)
    assert exact["changed_codes"] == 0 and exact["max"] < 1e-6
    assert classic["changed_codes"] > 0.9 * classic["pixels"] and classic["mean"] > 1
    assert all(r["store_seconds"] > 0 and r["reproject_seconds"] > 0 for r in figures["rows"])
    assert figures["rows"][1]["channels"] == 21


def test_kernels_as_ratios_to_a_copy(tmp_path, run):
    figures = run("spxbench", "kernels", "--runs", "1", "--json", "-", "-o", tmp_path / "made", check=0).json()
    rows = {r["kernel"]: r for r in figures["rows"]}
    assert figures["rows"][0]["ratio"] == 1 and "memory copy" in figures["rows"][0]["kernel"]
    assert {r["target"] for r in rows.values() if "target" in r} == {0.5, 0.8, 0.15, 0.25, 0.05}
    # Checked before they are timed: exact where nothing is rounded, a float's rounding elsewhere.
    assert rows["relight by a matrix"]["error"] == 0 < rows["CIEDE2000 ΔE00"]["error"] < 1e-4
    assert all(r["megapixels_per_second"] > 0 for r in rows.values())
    assert "| relight by the lattice |" in (tmp_path / "made" / "kernels.md").read_text()


def test_scaling_of_the_smallest(run):
    made = run("spxbench", "scaling", "--max-megapixels", "1", "--runs", "1", "--json", "-", check=0)
    rows = {r["key"]: r for r in made.json()["rows"]}
    assert {"pixels, to half coefficients 1 Mpixel", "pixels, to 36 half bands 1 Mpixel", "bands 8", "bands 81", "threads 1"} <= set(rows)
    assert "bands 4: lattice: vertex" in made.stderr  # four bands cannot hold every colour
    assert all(0 <= r["system_seconds"] <= r["processor_seconds"] and r["seconds"] > 0 for r in rows.values())
    # More bands cost more, but less than in proportion: reading and decoding are paid once.
    assert rows["bands 8"]["processor_seconds"] < rows["bands 81"]["processor_seconds"] < 81 / 8 * rows["bands 8"]["processor_seconds"]


def test_accuracy_of_tables_of_ones_own(tmp_path, run):
    nm = np.arange(380, 781, 10)
    bumps = np.stack([0.2 + 0.5 * np.exp(-(((nm - c) / 60) ** 2)) for c in (450, 550, 650)], axis=1)
    mine = tmp_path / "my pigments.csv"
    mine.write_text("wavelength_nm,blue,green,red\n" + "".join(f"{w},{','.join(map(str, r))}\n" for w, r in zip(nm, bumps)))
    figures = run("spxbench", "accuracy", "--methods", "mallett2019,jakob2019", "--sets", "macbeth", "--unseen", mine, "--json", "-",
                  check=0).json()
    assert figures["lamps"] > 400
    for method in figures["methods"]:
        assert [s["set"] for s in method["sets"]] == ["macbeth", "my pigments"]
        assert [s["left_out"] for s in method["sets"]] == [True, False]
        assert method["sets"][1]["samples"] == 3
        assert method["mean"] == pytest.approx(method["sets"][0]["mean"])
        assert 0.1 < method["sets"][1]["mean"] < method["sets"][1]["p95"] < 20


def test_smoothness_is_the_same_again(run):
    a, b, other = (run("spxbench", "smoothness", "--methods", "mallett2019,jakob2019", "--lines", "20", "--seed", seed, "--json", "-",
                       check=0).json() for seed in ("1", "1", "2"))
    assert a["methods"] == b["methods"] != other["methods"]
    linear, sigmoid = a["methods"]
    assert linear["max"] < 0.01 < sigmoid["max"]


def picture(path, size=48):
    y, x = np.mgrid[0:size, 0:size]
    codes = np.stack([x * 5, y * 5, (x + y) * 2], axis=-1).astype(np.uint8)
    path.write_bytes(b"P6 %d %d 255\n" % (size, size) + codes.tobytes())
    return path


def test_grid_of_time_and_error(tmp_path, run):
    ours = picture(tmp_path / "ours.ppm")
    common = ["--methods", "mallett2019,smits1999", "--stores", "coefficients-float,spectral-half:16", "--corpus", ours, "--runs", "1"]
    out = run("spxbench", "grid", *common, "-o", tmp_path / "made", check=0).stdout
    assert [r[0] for r in table(out)[1:]] == ["`mallett2019`"] * 2 + ["`smits1999`"] * 2
    figures = json.loads((tmp_path / "made" / "grid.json").read_text())
    exact, stored, classic = figures["rows"][0], figures["rows"][1], figures["rows"][2]
    assert exact["pixels"] == 48 * 48 and exact["channels"] == 3 and stored["channels"] == 16
    # Float coefficients keep what the method gives; sixteen bands cannot show three lights as its 81 do.
    assert exact["relight_mean"] < 1e-5 < 1e-2 < stored["relight_mean"]
    assert exact["max"] < 1e-3 and stored["changed_codes"] == 0 and classic["mean"] > 0.5
    assert all(r["file_seconds_per_megapixel"] > 0 and r["bytes_per_texel"] > 1 and r["reference_error"] <= 1e-5 for r in figures["rows"])
    # What rounding costs is seen in the rounded samples.
    rounded = run("spxbench", "grid", "--methods", "mallett2019", "--stores", "spectral-half:36,spectral-half:36:max-error=1", "--corpus", ours,
                  "--runs", "1", "--json", "-", check=0).json()
    plain, coarse = rounded["rows"]
    assert 5 * plain["relight_mean"] < coarse["relight_mean"] < 1 and coarse["bytes_per_texel"] < plain["bytes_per_texel"]
    # Nothing on the front is beaten by another row.
    rows = {r["key"]: (r["file_seconds_per_megapixel"], max(r["relight_mean"], 1e-6)) for r in figures["rows"]}
    assert figures["front"]
    for key in figures["front"]:
        assert not any(o[0] <= rows[key][0] and o[1] < rows[key][1] for o in rows.values()), key
    assert sorted(p.name for p in (tmp_path / "made").iterdir()) == ["grid.csv", "grid.json", "grid.md", "grid.png", "grid.svg"]
    svg = (tmp_path / "made" / "grid.svg").read_text()
    assert svg.count(">16 half bands<") == 2 and "smits1999" in svg
    again = run("spxbench", "grid", *common, "--baseline", tmp_path / "made" / "grid.json", check=0).stdout
    assert "times the baseline" in again and table(again)[1][-1] == "1.00"
    for arguments, mention in [(["--stores", "octal-half"], "octal-half"), (["--stores", "spectral-half:36:max-error=0"], "max-error"),
                               (["--kernels", "gpu"], "gpu")]:
        assert mention in run("spxbench", "grid", "--corpus", ours, *arguments, check=64).stderr
    (tmp_path / "none.json").write_text("[]")
    assert "none.json" in run("spxbench", "grid", *common, "--baseline", tmp_path / "none.json", check=2).stderr


def test_memory_of_colours(tmp_path, run):
    """Dear methods gain by few repeats, cheap ones lose by any; what a plan decides by itself is what the timings say."""
    out = run("spxbench", "memory", "--methods", "burns2020,otsu2018,mallett2019", "--runs", 2, "--json", tmp_path / "memory.json", check=0).stdout
    rows = {(r["method"], r["work"]): r for r in json.loads((tmp_path / "memory.json").read_text())["rows"]}
    assert len(rows) == 6 and len(table(out)) == 7 and not any(method == "mallett2019" for method, _ in rows)
    assert all([point["share"] for point in r["points"]] == [0, 0.05, 0.1, 0.25, 0.5, 0.9] for r in rows.values())
    decided = {key: float(r["decision"].split("wherever ")[1].split("%")[0]) / 100 if "wherever" in r["decision"] else 1 for key, r in rows.items()}
    for work in ("36 bands", "relit under A"):  # hundreds of nanoseconds against some ten
        row = rows["burns2020", work]
        assert decided["burns2020", work] < 0.5 and row["break_even"] < 0.6 and row["points"][-1]["remembered_ns"] < 0.6 * row["points"][-1]["computed_ns"]
    # A sum of three products takes less than any look-up.
    assert decided["otsu2018", "coefficients"] == rows["otsu2018", "coefficients"]["break_even"] == 1
    run("spxbench", "memory", "--methods", "mallett2019", check=64)


def test_refuses(tmp_path, run):
    for arguments, mention in [(["speedy"], "speedy"), (["speed", "--methods", "nosuch"], "nosuch"), (["speed", "--stores", "octal"], "octal"),
                               (["accuracy", "--sets", "nowhere"], "nowhere"), (["speed", "--stride", "0"], "--stride"),
                               (["-o", ""], "folder"), ([], "grid")]:
        outcome = run("spxbench", *arguments, check=64)
        assert mention in outcome.stderr and outcome.stdout == ""
    bad = tmp_path / "bad.csv"
    bad.write_text("wavelength_nm,a\n400,0.5\n500,many\n")
    outcome = run("spxbench", "accuracy", "--methods", "mallett2019", "--unseen", bad, check=2)
    assert "bad.csv" in outcome.stderr and "row 2" in outcome.stderr
    outcome = run("spxbench", "smoothness", "--methods", "mallett2019", "--lines", "0", "-o", tmp_path / "none" / "deeper", check=2)
    assert "deeper" in outcome.stderr


def test_stability(tmp_path, run):
    csv = tmp_path / "stability.csv"
    out = run("spxbench", "stability", "--groups", "sums", "--colors", "1000", "--stride", "65536", "--bands", "380:780:20", "--csv", csv, "--json",
              tmp_path / "stability.json", check=0).stdout
    figures = json.loads((tmp_path / "stability.json").read_text())
    assert figures["what"] == "stability" and figures["failures"] == 0
    rows = table(out)
    assert len(rows) - 1 == len(figures["rows"]) == len(csv.read_text().splitlines()) - 1
    assert all(r[-1] == "yes" for r in rows[1:])
    for row in figures["rows"]:
        assert row["group"] == "sums" and row["kept"] and row["broken"] == 0 and row["cases"] > 0 and row["reason"]
        assert row["worst"] <= row["bound"]
    run("spxbench", "stability", "--groups", "solvers", "--methods", "burns2020", "--stride", "65536", "--bands", "380:780:20", "--json",
        tmp_path / "solvers.json", check=0)
    solver, = json.loads((tmp_path / "solvers.json").read_text())["solvers"]
    assert solver["method"] == "burns2020" and solver["unreached"] == 0 and solver["counts"]["1 to 8 Newton steps"] > 0
    assert sum(solver["counts"].values()) == solver["colors"] > 0
    run("spxbench", "stability", "--groups", "sums,colors", check=64)
    run("spxbench", "stability", "--methods", "none", check=64)


def test_colours_without_a_spectrum_are_counted(tmp_path, run):
    path = picture(tmp_path / "codes.ppm")
    made = [run("spxuplift", path, "-o", tmp_path / "made.exr", "--method", "jakob2019", "--bands", "380:780:20", "--store", "spectral", "--rgb-space", space,
                "--input-colorspace", f"Linear {space}", "--check", "--json", "-", check=0) for space in ("Rec.709", "Rec.2020")]
    inside, wide = (m.json() for m in made)
    # Half bands cost 0.02.
    assert inside["unreached"] == 0 and inside["roundtrip"]["max"] < 0.1
    assert 0 < wide["unreached"] < 48 * 48
    x, y = wide["first_unreached"]
    assert 0 <= x < 48 and 0 <= y < 48
    assert f"{wide['unreached']} pixels have no spectrum of this method, the first at {x},{y}" in made[1].stderr
    # Off by what the colour solid lacks, and not into white or black.
    assert 0.1 < wide["roundtrip"]["max"] < 60
    # The same where the texture is relit without being stored.
    lit = run("spxrelight", path, "-i", "A", "-o", tmp_path / "lit.exr", "--method", "jakob2019", "--bands", "380:780:20", "--rgb-space", "Rec.2020",
              "--input-colorspace", "Linear Rec.2020", "--json", "-", check=0)
    assert lit.json()["unreached"] == wide["unreached"] and lit.json()["first_unreached"] == [x, y]
    assert "have no spectrum of this method" in lit.stderr
