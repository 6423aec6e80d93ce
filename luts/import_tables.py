#!/usr/bin/python3
"""Rebuild the tables in this folder from the packages they come from, and the manifest that describes them.

    import_tables.py              rewrite every imported CSV, then MANIFEST.csv
    import_tables.py --manifest   only rehash the files MANIFEST.csv lists

Reads Debian's psychtoolbox-3-common, colord-data and python3-skimage; needs numpy and scipy. The output depends on
nothing else, so a second run changes no byte. Rows of MANIFEST.csv that this script does not write (solved models,
colour configurations, transcribed tables) keep their text and get a fresh hash. Exit 2: a data file lacks its row.
"""
import argparse
import csv
import hashlib
import io
import pathlib
import re
import sys

LUTS = pathlib.Path(__file__).resolve().parent
PSYCHTOOLBOX = pathlib.Path("/usr/share/psychtoolbox-3/PsychColorimetricData/PsychColorimetricMatFiles")
COLORD = pathlib.Path("/usr/share/colord")
CIEDE2000 = pathlib.Path("/usr/lib/python3/dist-packages/skimage/color/tests/ciede2000_test_data.txt")
COLUMNS = ["path", "sha256", "unit", "start_nm", "end_nm", "step_nm", "columns", "source", "licence", "notes"]
DATA_SUFFIXES = {".csv", ".clf", ".ctf", ".cube", ".ocio", ".spi1d", ".spi3d", ".json", ".bin", ".exr", ".xml"}

PTB = "Debian psychtoolbox-3-common 3.0.18.12, "
EXPAT = "Expat"
RELATIVE = "relative spectral power"
REFLECTANCE = "reflectance factor, dimensionless"

# S0, S1, S2 outside 380-780 nm, which psychtoolbox does not carry: CIE 15:2004, 10 nm, the 5 nm rows between them are
# means of their neighbours as everywhere in this table.
DAYLIGHT_WINGS = {
    300: (0.04, 0.02, 0.0), 310: (6.0, 4.5, 2.0), 320: (29.6, 22.4, 4.0), 330: (55.3, 42.0, 8.5),
    340: (57.3, 40.6, 7.8), 350: (61.8, 41.6, 6.7), 360: (61.5, 38.0, 5.3), 370: (68.8, 42.4, 6.1),
    790: (66.0, -10.6, 7.0), 800: (61.0, -9.7, 6.4), 810: (53.3, -8.3, 5.5), 820: (58.9, -9.3, 6.1),
    830: (61.9, -9.8, 6.5)}

# CIE illuminant B, 380-780 nm at 5 nm. colord-data carries 89.65 at 515 nm and nothing above 770.
ILLUMINANT_B = [
    22.40, 26.85, 31.30, 36.18, 41.30, 46.62, 52.10, 57.70, 63.20, 68.37, 73.10, 77.31, 80.80, 83.44, 85.40, 86.88,
    88.30, 90.08, 92.00, 93.75, 95.20, 96.23, 96.50, 95.71, 94.20, 92.37, 90.70, 89.95, 89.50, 90.43, 92.20, 94.46,
    96.90, 99.16, 101.00, 102.20, 102.80, 102.92, 102.60, 101.90, 101.00, 100.07, 99.20, 98.44, 98.00, 98.08, 98.50,
    99.06, 99.70, 100.36, 101.00, 101.56, 102.20, 103.05, 103.90, 104.59, 105.00, 105.08, 104.90, 104.55, 103.90,
    102.84, 101.60, 100.38, 99.10, 97.70, 96.20, 94.60, 92.90, 91.10, 89.40, 88.00, 86.90, 85.90, 85.20, 84.80, 84.70,
    84.90, 85.40, 86.10, 87.00]

MACBETH = ["dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green", "orange", "purplish blue",
           "moderate red", "purple", "yellow green", "orange yellow", "blue", "green", "red", "yellow", "magenta",
           "cyan", "white 9.5", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black 2"]

# Kinds are read off the package's labels; what a label does not say is "unspecified". "led-model" and "model" are
# computed spectra, not measured lamps.
KINDS = [
    (1, 3, "led-model"), (4, 6, "fluorescent"), (7, 7, "metal-halide"), (8, 8, "mercury"), (9, 10, "sodium"),
    (11, 12, "incandescent"), (13, 21, "led-model"), (22, 23, "led"), (24, 27, "led-model"), (28, 28, "model"),
    (29, 29, "daylight"), (30, 31, "model"), (32, 43, "fluorescent"), (44, 45, "sodium"), (46, 61, "fluorescent"),
    (62, 63, "mercury"), (64, 65, "metal-halide"), (66, 66, "sodium"), (67, 72, "led-model"), (73, 76, "model"),
    (77, 80, "led-model"), (81, 85, "led"), (86, 87, "led-model"), (88, 123, "led"), (124, 131, "planckian"),
    (132, 137, "daylight"), (138, 237, "led"), (238, 238, "sodium"), (239, 252, "led"), (253, 277, "unspecified"),
    (278, 292, "fluorescent"), (293, 293, "sodium"), (294, 296, "metal-halide"), (297, 297, "incandescent"),
    (298, 298, "led"), (299, 299, "unspecified"), (300, 300, "halogen"), (301, 302, "led"), (303, 305, "metal-halide"),
    (306, 306, "halogen"), (307, 307, "fluorescent"), (308, 314, "led"), (315, 315, "fluorescent"), (316, 322, "led"),
    (323, 323, "incandescent"), (324, 325, "halogen"), (326, 327, "fluorescent"), (328, 330, "led"),
    (331, 332, "fluorescent"), (333, 333, "halogen"), (334, 347, "fluorescent"), (348, 348, "incandescent"),
    (349, 349, "halogen"), (350, 351, "incandescent"), (352, 352, "metal-halide"), (353, 353, "sodium"),
    (354, 355, "metal-halide"), (356, 357, "model"), (358, 368, "fluorescent"), (369, 369, "incandescent"),
    (370, 370, "sodium"), (371, 372, "metal-halide"), (373, 373, "incandescent"), (374, 375, "sodium"),
    (376, 377, "mercury"), (378, 392, "led"), (393, 393, "plasma"), (394, 396, "halogen"), (397, 400, "led"),
    (401, 401, "led-model")]

HIGH_PRESSURE = {1: "standard high pressure sodium", 2: "colour-enhanced high pressure sodium",
                 3: "high pressure metal halide", 4: "high pressure metal halide", 5: "high pressure metal halide"}


def number(x):
    """Shortest decimal that reads back as the same double, without a trailing '.0'."""
    text = repr(float(x))
    return text[:-2] if text.endswith(".0") else text


def csv_text(rows):
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


class Import:
    def __init__(self):
        self.manifest = {}

    def write(self, path, rows, unit, source, licence, notes="", grid=("", "", "")):
        rows = list(rows)
        target = (LUTS / path).resolve()
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(csv_text(rows), encoding="utf-8", newline="")
        self.manifest[path] = dict(zip(COLUMNS, [path, "", unit, *map(str, grid), str(len(rows[0])), source, licence,
                                                 notes]))

    def spectra(self, path, start, step, names, table, unit, source, licence, notes=""):
        """table: [wavelength][sample]; the grid in the file name comes from the data, so that they cannot disagree."""
        end = start + step * (len(table) - 1)
        rows = [["wavelength_nm", *names]]
        rows += [[start + step * i, *map(number, row)] for i, row in enumerate(table)]
        assert len(set(names)) == len(names) and all(len(r) == len(rows[0]) for r in rows)
        self.write(path.format(grid=f"{start}-{end}-{step}"), rows, unit, source, licence, notes, (start, end, step))


def psychtoolbox(name):
    import scipy.io
    return scipy.io.loadmat(PSYCHTOOLBOX / (name + ".mat"))


def colord(name):
    """The numeric rows of one colord CGATS file, as lists of words."""
    body = (COLORD / name).read_text().split("BEGIN_DATA\n")[1].split("END_DATA")[0]
    return [line.split() for line in body.strip().split("\n")]


def plain(label):
    return re.sub(r"\s+", " ", str(label)).strip()


def lamp_label(label):
    """A label that needs no quoting in a shell and holds none of , + * : that mixtures and lists of lamps use."""
    text = plain(label).replace("Duv=+", "Duv p").replace("Duv= +", "Duv p").replace("Duv= -", "Duv m")
    text = text.replace("Duv= -", "Duv m").replace("Duv=-", "Duv m").replace("RGB+A", "RGBA")
    text = re.sub(r"(\d),(\d{3})", r"\1\2", text)
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.")


def import_observers(out):
    for name, key, source in (
            ("cie1931_2deg", "xyz1931", "CIE 1931 2 degree observer; " + PTB + "T_xyz1931.mat"),
            ("cie1964_10deg", "xyz1964", "CIE 1964 10 degree observer; " + PTB + "T_xyz1964.mat"),
            ("cie2006_2deg", "xyzCIEPhys2", "CIE 170-2:2015 2 degree XYZ; " + PTB + "T_xyzCIEPhys2.mat (CVRL)"),
            ("cie2006_10deg", "xyzCIEPhys10", "CIE 170-2:2015 10 degree XYZ; " + PTB + "T_xyzCIEPhys10.mat (CVRL)")):
        data = psychtoolbox("T_" + key)
        start, step, _ = (int(v) for v in data["S_" + key][0])
        out.spectra(f"cie/{name}_{{grid}}.csv", start, step, ["x_bar", "y_bar", "z_bar"], data["T_" + key].T,
                    "dimensionless", source, EXPAT)


def import_daylight(out):
    middle = psychtoolbox("B_cieday")["B_cieday"]
    known = dict(DAYLIGHT_WINGS)
    known.update({380 + 5 * i: tuple(map(float, row)) for i, row in enumerate(middle)})
    table = []
    for nm in range(300, 831, 5):
        row = known.get(nm) or [(a + b) / 2 for a, b in zip(known[nm - 5], known[nm + 5])]
        table.append([round(v, 3) for v in row])
    reference = list(zip(*[[float(v) for v in row] for row in colord("ref/CIE-1986-daylight-SPD.cmf")]))
    assert all(abs(a - b) < 1e-9 for r, s in zip(table, reference) for a, b in zip(r, s)) and len(reference) == 107
    out.spectra("cie/daylight_components_{grid}.csv", 300, 5, ["s0", "s1", "s2"], table, RELATIVE,
                "CIE 15:2004; 380-780 nm " + PTB + "B_cieday.mat; wings transcribed and checked against colord-data",
                EXPAT, "5 nm rows are means of the published 10 nm rows")


def import_illuminants(out):
    c = psychtoolbox("spd_CIEC")["spd_CIEC"][:, 0]
    assert len(ILLUMINANT_B) == 81
    out.spectra("illuminants/cie_tables_{grid}.csv", 380, 5, ["B", "C"], list(zip(ILLUMINANT_B, c)), RELATIVE,
                "B: CIE 15:2004, transcribed from colour-science; C: " + PTB + "spd_CIEC.mat",
                "BSD-3-Clause (B); Expat (C)", "B at 515 nm: 89.95 as tabulated; colord-data has 89.65, which is smoother and meets the published "
                "chromaticity closer (3e-6 against 1.5e-5)")
    for name, key in (("D65", "spd_D65"), ("A", "spd_CIEA")):
        out.spectra(f"../tests/unit/data/illuminant_{name}_{{grid}}.csv", 380, 5, [name], psychtoolbox(key)[key],
                    RELATIVE, PTB + key + ".mat", EXPAT, "test reference only; rounded to two decimals by the package")


def correlated_temperature(x, y, locus):
    """Nearest Planckian temperature in CIE 1960 uv, or None where |Duv| > 0.05 and the term has no meaning."""
    import numpy as np
    u, v = 4 * x / (12 * y - 2 * x + 3), 6 * y / (12 * y - 2 * x + 3)
    d2 = (locus[1] - u) ** 2 + (locus[2] - v) ** 2
    i = int(np.argmin(d2))
    return int(round(locus[0][i])) if d2[i] <= 0.05 ** 2 and 0 < i < len(d2) - 1 else None


def import_lamps(out):
    import numpy as np
    data = psychtoolbox("spd_houser")
    table = data["spd_houser"]
    original = [plain(label[0]) for label in data["labels_houser"][0]]
    labels = [lamp_label(text) for text in original]
    houser = ("Houser, Wei, David, Krames and Shen 2013, doi:10.1364/OE.21.010393; " + PTB + "spd_houser.mat")
    out.spectra("illuminants/lamps_{grid}.csv", 380, 5, labels, table, RELATIVE + ", peak 1", houser, EXPAT,
                "lamps 171 and 174 are identical; FL3.1-FL3.8, FL3.12-FL3.15 and HP2-HP5 are copies of limited "
                "precision (chromaticity off by up to 0.0018)")

    nm = np.arange(380, 781, 5)
    cmf = psychtoolbox("T_xyz1931")["T_xyz1931"][:, 20:421:5]
    kelvin = np.exp(np.linspace(np.log(1000), np.log(50000), 40001))
    # second radiation constant of ITS-90, 1.4388e-2 m K
    planck = nm ** -5.0 / np.expm1(1.4388e7 / np.outer(kelvin, nm))
    xyz = planck @ cmf.T
    x, y, z = xyz.T
    locus = (kelvin, 4 * x / (x + 15 * y + 3 * z), 6 * y / (x + 15 * y + 3 * z))
    kinds = {i: kind for first, last, kind in KINDS for i in range(first, last + 1)}
    rows = [["index", "label", "kind", "cct_kelvin", "description"]]
    for i, label in enumerate(labels, 1):
        x, y, z = cmf @ table[:, i - 1]
        cct = correlated_temperature(x / (x + y + z), y / (x + y + z), locus)
        rows.append([i, label, kinds[i], "" if cct is None else cct, original[i - 1]])
    out.write("illuminants/lamps.csv", rows, "index; kelvin", houser, EXPAT,
              "kind read off the label; cct_kelvin computed here (CIE 1931, nearest in CIE 1960 uv, empty beyond "
              "Duv 0.05); description is the package's label")

    found = {}
    for i, text in enumerate(original, 1):
        if m := re.fullmatch(r"NIST \d+: CIE F(\d+)\*?", text):
            found[f"F{m[1]}"] = found[f"FL{m[1]}"] = (i, f"CIE fluorescent lamp F{m[1]}")
        elif m := re.fullmatch(r"(?:nCRI|MCRI)-\d+: FL?3\.(\d+)", text):
            found[f"FL3.{m[1]}"] = found[f"F3.{m[1]}"] = (i, f"CIE fluorescent lamp FL3.{m[1]}")
        elif m := re.fullmatch(r"(?:nCRI|MCRI)-\d+: HP(\d)", text):
            found[f"HP{m[1]}"] = (i, f"CIE {HIGH_PRESSURE[int(m[1])]} lamp HP{m[1]}")
    assert len(found) == 12 * 2 + 15 * 2 + 5
    order = sorted(found, key=lambda n: (re.match(r"\D+", n)[0], [int(v) for v in re.findall(r"\d+", n)]))
    out.write("illuminants/names.csv", [["name", "lamp", "description"]] + [[n, *found[n]] for n in order], "index",
              houser, EXPAT, "lamp is the 1-based column of lamps_380-780-5.csv")


def import_reflectances(out):
    def labels(data, key):
        result = []
        for item in data[key][0]:
            value = item["label"]
            while getattr(value, "dtype", None) == object:
                value = value.ravel()[0]
            result.append(plain(value.ravel()[0] if hasattr(value, "ravel") else value))
        return result

    def cut(table, start, step, first, last):
        return table[(first - start) // step:(last - start) // step + 1]

    def bounds(table):
        return f"{int((table < 0).sum())} values below 0, {int((table > 1).sum())} above 1"

    def numbered(names):
        return [f"{i:03d} {name}" for i, name in enumerate(names, 1)]

    data = psychtoolbox("sur_vrhel")
    table = data["sur_vrhel"]
    out.spectra("reflectances/vrhel_{grid}.csv", 390, 2, numbered(labels(data, "labels_vrhel")), table, REFLECTANCE,
                "Vrhel, Gershon and Iwan 1994; " + PTB + "sur_vrhel.mat", EXPAT, bounds(table))
    data = psychtoolbox("sur_koivisto")
    table = data["sur_koivisto"] / 4096.0
    out.spectra("reflectances/koivisto_{grid}.csv", 400, 5, numbered(labels(data, "labels_koivisto")), table,
                REFLECTANCE, "Natural colours, University of Eastern Finland; " + PTB + "sur_koivisto.mat", EXPAT,
                f"stored 0-4096, divided by 4096; {int((table == 0).sum())} zeros and {int((table == 1).sum())} ones "
                f"are the sensor's limits; noisy below 420 nm; " + bounds(table))
    data = psychtoolbox("sur_krinov")
    table = data["sur_krinov"]
    out.spectra("reflectances/krinov_{grid}.csv", 400, 10, labels(data, "labels_krinov"), table, REFLECTANCE,
                "Krinov 1947; " + PTB + "sur_krinov.mat", EXPAT,
                "the numbers in the labels are Krinov's own; kept as the package has them, though 095 at 620 nm (0.161 among "
                "0.065 and 0.056) and 200 at 570 nm look mistyped and 250 jumps by 0.2 at 620 nm; " + bounds(table))
    table = cut(psychtoolbox("sur_nickerson")["sur_nickerson"], 380, 5, 400, 700)
    out.spectra("reflectances/nickerson_{grid}.csv", 400, 5, [f"{i:03d}" for i in range(1, table.shape[1] + 1)], table,
                REFLECTANCE, "Nickerson, Munsell papers; " + PTB + "sur_nickerson.mat", EXPAT,
                "zeros outside 400-700 nm in the package are no data and are cut; no labels; 5 nm rows are the package's "
                "interpolation of 10 nm measurements; " + bounds(table))
    table = cut(psychtoolbox("sur_macbeth")["sur_macbeth"], 380, 5, 390, 730)
    out.spectra("reflectances/macbeth_{grid}.csv", 390, 5, [f"{i:02d} {n}" for i, n in enumerate(MACBETH, 1)], table,
                REFLECTANCE, "Macbeth ColorChecker; " + PTB + "sur_macbeth.mat", EXPAT,
                "the package calls it not accurate; zeros at 380 and from 735 nm on are cut, and 385 nm, which is "
                "interpolated towards the zeros; patch names are the chart's; " + bounds(table))
    import numpy as np
    rows = colord("ref/CIE-TCS.sp")
    table = cut(np.array([[float(v) for v in row[1:]] for row in rows]).T, 360, 5, 380, 780)
    out.spectra("reflectances/cie_tcs_{grid}.csv", 380, 5, [row[0] for row in rows], table, REFLECTANCE,
                "CIE 13.3-1995 TCS01-TCS14, JIS Z 8726 TCS15; Debian colord-data 1.4.6, ref/CIE-TCS.sp",
                "published CIE numbers (facts); the package they were read from is GPL-2+", bounds(table))


def import_ciede2000(out):
    rows = [["pair", "l1", "a1", "b1", "l2", "a2", "b2", "delta_e"]]
    lines = [re.split(r"\s+", line.strip()) for line in CIEDE2000.read_text().split("\n")
             if line.strip() and not line.startswith("#")]
    for f in lines:
        # pair 1 L a b a' C' h' hbar' G T SL SC SH RT dE 2 L a b a' C' h'
        second = f.index("2", 15)
        rows.append([f[0], *map(number, f[2:5] + f[second + 1:second + 4] + [f[15]])])
    assert len(rows) == 35
    out.write("../tests/unit/data/ciede2000_sharma2005.csv", rows, "CIELAB",
              "Sharma, Wu and Dalal 2005, doi:10.1002/col.20070, Table 1; Debian python3-skimage 0.19.3",
              "BSD-3-Clause", "test reference only")


def read_manifest():
    path = LUTS / "MANIFEST.csv"
    if not path.exists():
        return {}
    with path.open(encoding="utf-8", newline="") as f:
        return {row["path"]: row for row in csv.DictReader(f)}


def data_files():
    return sorted(p.relative_to(LUTS).as_posix() for p in LUTS.rglob("*")
                  if p.suffix in DATA_SUFFIXES and p.name != "MANIFEST.csv")


def write_manifest(rows):
    missing = [p for p in data_files() if p not in rows]
    for path, row in sorted(rows.items()):
        row["sha256"] = hashlib.sha256((LUTS / path).read_bytes()).hexdigest()
    text = csv_text([COLUMNS] + [[rows[p][c] for c in COLUMNS] for p in sorted(rows)])
    (LUTS / "MANIFEST.csv").write_text(text, encoding="utf-8", newline="")
    for path in missing:
        print(f"import_tables: luts/{path} has no row in luts/MANIFEST.csv: add one (path, unit, grid, source, "
              "licence) and run --manifest", file=sys.stderr)
    return 2 if missing else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--manifest", action="store_true", help="only rehash the files listed in MANIFEST.csv")
    arguments = parser.parse_args()
    rows = read_manifest()
    if not arguments.manifest:
        out = Import()
        for step in (import_observers, import_daylight, import_illuminants, import_lamps, import_reflectances,
                     import_ciede2000):
            step(out)
        rows = {path: row for path, row in rows.items() if (LUTS / path).exists()}
        rows.update(out.manifest)
    return write_manifest(rows)


if __name__ == "__main__":
    sys.exit(main())
