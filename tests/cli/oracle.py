"""Integrals and colour differences that share no code with the library: what the tests hold its figures against.

Tables are read from luts/ as text; the observers, and lamps at 5 nm interpolated linearly, are all that is shared. A band is
a hat function between its neighbours; integrals are sums over whole nanometres within the stored range. Vectors are columns.
"""

import csv
import json
import pathlib
import struct
import zlib

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
LUTS = ROOT / "luts"

# Chromaticities of Rec. ITU-R BT.709-6, table 1.
BT709 = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])


def table(path):
    """First column and a dictionary of the others."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    values = np.array([[float(v) for v in row] for row in rows[1:]])
    return values[:, 0], dict(zip(rows[0][1:], values[:, 1:].T))


NM = np.arange(360, 831)


def observer(name="cie1931"):
    """[3][471] colour matching functions at 360 to 830 nm."""
    files = {"cie1931": "cie1931_2deg_360-830-1", "cie1964": "cie1964_10deg_360-830-1",
             "cie2006-2": "cie2006_2deg_390-830-1", "cie2006-10": "cie2006_10deg_390-830-1"}
    nm, columns = table(LUTS / "cie" / (files[name] + ".csv"))
    return np.array([np.interp(NM, nm, columns[c], left=0, right=0) for c in ("x_bar", "y_bar", "z_bar")])


def illuminant(name):
    """Relative power at 360 to 830 nm."""
    if name == "A":  # CIE 15:2018, eq. 3.1
        return 100 * (560 / NM) ** 5 * np.expm1(1.435e7 / (2848 * 560)) / np.expm1(1.435e7 / (2848 * NM))
    if name == "E":
        return np.full(NM.size, 100.0)
    # M1 and M2 to three decimals, those that reproduce the CIE's tables (at 380 nm: 24.4875 and 49.9755).
    factors = {"D50": (-1.039, 0.363), "D65": (-0.295, -0.689)}
    if name in factors:
        nm, s = table(LUTS / "cie" / "daylight_components_300-830-5.csv")
        m1, m2 = factors[name]
        return np.interp(NM, nm, s["s0"] + m1 * s["s1"] + m2 * s["s2"])
    with open(LUTS / "illuminants" / "names.csv", newline="", encoding="utf-8") as file:
        index = {row[0]: int(row[1]) for row in list(csv.reader(file))[1:]}
    nm, columns = table(LUTS / "illuminants" / "lamps_380-780-5.csv")
    return np.interp(NM, nm, list(columns.values())[index[name] - 1], left=0, right=0)


def hats(bands):
    """[bands][471] hat functions, zero outside the stored range."""
    bands = np.asarray(bands, dtype=float)
    return np.array([np.interp(NM, bands, row, left=0, right=0) for row in np.eye(len(bands))])


def weights(bands, light, cmf=None):
    """[3][bands] with XYZ = W r and Y = 1 for r = 1 in the stored range."""
    cmf = observer() if cmf is None else cmf
    w = (cmf * light) @ hats(bands).T
    return w / w[1].sum()


def rgb_to_xyz(white_xyz, primaries=BT709):
    p = np.array([[x / y, 1, (1 - x - y) / y] for x, y in primaries]).T
    return p * np.linalg.solve(p, white_xyz)


def bt709_matrix(bands, cmf=None):
    return rgb_to_xyz(weights(bands, illuminant("D65"), cmf).sum(axis=1))


def relight_matrix(bands, light, cmf=None):
    """[3][bands]: linear BT.709 of a reflectance under a light, no adaptation, Y = 1 for white."""
    return np.linalg.solve(bt709_matrix(bands, cmf), weights(bands, illuminant(light), cmf))


def srgb_decode(code):
    code = np.asarray(code, dtype=float)
    return np.where(code <= 0.04045, code / 12.92, ((np.maximum(code, 0) + 0.055) / 1.055) ** 2.4)


def srgb_encode(linear):
    linear = np.clip(np.asarray(linear, dtype=float), 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def codes(linear):
    return np.floor(srgb_encode(linear) * 255 + 0.5).astype(np.uint8)


def lab(xyz, white):
    t = np.asarray(xyz) / white
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def rgb_to_lab(rgb, bands=np.arange(380, 781)):
    m = bt709_matrix(bands)
    return lab(np.asarray(rgb, dtype=float) @ m.T, m.sum(axis=1))


def cie76(a, b):
    return np.linalg.norm(a - b, axis=-1)


def ciede2000(a, b):
    """Sharma, Wu and Dalal 2005, eq. 2 to 22."""
    (l1, a1, b1), (l2, a2, b2) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    g = 0.5 * (1 - np.sqrt(mean ** 7 / (mean ** 7 + 25.0 ** 7)))
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = np.degrees(np.arctan2(b1, a1)) % 360, np.degrees(np.arctan2(b2, a2)) % 360
    dh = h2 - h1
    dh = np.where(dh > 180, dh - 360, np.where(dh < -180, dh + 360, dh))
    grey = c1 * c2 == 0
    dh = np.where(grey, 0, dh)
    dl, dc, big_h = l2 - l1, c2 - c1, 2 * np.sqrt(c1 * c2) * np.sin(np.radians(dh / 2))
    ml, mc = (l1 + l2) / 2, (c1 + c2) / 2
    far = np.abs(h1 - h2) > 180
    mh = np.where(grey, h1 + h2, np.where(~far, (h1 + h2) / 2, np.where(h1 + h2 < 360, (h1 + h2 + 360) / 2, (h1 + h2 - 360) / 2)))
    cos = lambda degrees: np.cos(np.radians(degrees))
    t = 1 - 0.17 * cos(mh - 30) + 0.24 * cos(2 * mh) + 0.32 * cos(3 * mh + 6) - 0.20 * cos(4 * mh - 63)
    sl = 1 + 0.015 * (ml - 50) ** 2 / np.sqrt(20 + (ml - 50) ** 2)
    sc, sh = 1 + 0.045 * mc, 1 + 0.015 * mc * t
    rt = -np.sin(np.radians(60 * np.exp(-((mh - 275) / 25) ** 2))) * 2 * np.sqrt(mc ** 7 / (mc ** 7 + 25.0 ** 7))
    c, h = dc / sc, big_h / sh
    return np.sqrt((dl / sl) ** 2 + c ** 2 + h ** 2 + rt * c * h)


def primaries(name="mallett2019_cie1931_d65_bt709_380-780-5"):
    """Bands and [bands][3] of a kept set."""
    nm, columns = table(LUTS / "models" / (name + ".csv"))
    return nm, np.array(list(columns.values())[:3]).T


def parse_band(name):
    """Wavelength of T.400,000000nm as this suite's own files spell it."""
    return float(name.split(".", 1)[1].removesuffix("nm").replace(",", "."))


def write_png(path, pixels, level=1, chunks=()):
    """8-bit RGB or RGBA, filter none: for files that must be made fast or with chunks of the test's choosing."""
    height, width, channels = pixels.shape
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = np.zeros((height, 1 + width * channels), np.uint8)
    rows[:, 1:] = pixels.reshape(height, -1)
    body = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, {1: 0, 3: 2, 4: 6}[channels], 0, 0, 0))
    for kind, data in chunks:
        body += chunk(kind, data)
    body += chunk(b"IDAT", zlib.compress(rows.tobytes(), level)) + chunk(b"IEND", b"")
    pathlib.Path(path).write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return pathlib.Path(path)


def load(path):
    return json.loads(pathlib.Path(path).read_text(encoding="utf-8"))
