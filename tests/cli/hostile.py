"""Files that nobody should have made: headers that lie, loops, bombs. Each is a few hundred bytes, and none may cost more than
an ordinary file does."""

import json
import struct
import zlib

INT_MAX, INT_MIN = 2 ** 31 - 1, -2 ** 31


# OpenEXR File Layout: magic, version and flags, attributes, offsets, chunks.

def attribute(name, kind, value, size=None):
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value) if size is None else size) + value


def channel(name, kind=1, x=1, y=1):
    return (name if isinstance(name, bytes) else name.encode()) + b"\0" + struct.pack("<iBBBBii", kind, 0, 0, 0, 0, x, y)


def box(x, y, width, height):
    return struct.pack("<iiii", x, y, x + width - 1, y + height - 1)


def header(channels, window=(0, 0, 4, 4), display=None, compression=0, order=0, aspect=1.0, more=b"", without=()):
    fields = {
        "channels": attribute("channels", "chlist", b"".join(channels) + b"\0"),
        "compression": attribute("compression", "compression", bytes([compression])),
        "dataWindow": attribute("dataWindow", "box2i", window if isinstance(window, bytes) else box(*window)),
        "displayWindow": attribute("displayWindow", "box2i", display or box(0, 0, 4, 4)),
        "lineOrder": attribute("lineOrder", "lineOrder", bytes([order])),
        "pixelAspectRatio": attribute("pixelAspectRatio", "float", struct.pack("<f", aspect)),
        "screenWindowCenter": attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0)),
        "screenWindowWidth": attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
    }
    return b"".join(v for k, v in fields.items() if k not in without) + more + b"\0"


RGB = [channel("B"), channel("G"), channel("R")]


def exr(head, version=2, chunks=b"", offsets=None, rows=4, row_bytes=24):
    """Uncompressed rows of zeros behind the header, unless told otherwise."""
    start = struct.pack("<ii", 20000630, version) + head
    if offsets is None:
        first = len(start) + 8 * rows
        offsets = b"".join(struct.pack("<Q", first + y * (8 + row_bytes)) for y in range(rows))
        chunks = chunks or b"".join(struct.pack("<ii", y, row_bytes) + bytes(row_bytes) for y in range(rows))
    return start + offsets + chunks


def tiled(tile, mode=0, **more):
    return exr(header(RGB, more=attribute("tiles", "tiledesc", struct.pack("<IIB", *tile, mode)), **more), version=2 | 0x200)


def text_attribute(name, value):
    return attribute(name, "string", value.encode())


def bands(names, **more):
    return exr(header(sorted(channel(n) for n in names), **more), row_bytes=8 * len(names))


def part(name, kind, head, chunks):
    return head[:-1] + text_attribute("name", name) + text_attribute("type", kind) + attribute("chunkCount", "int", struct.pack("<i", chunks)) + b"\0"


# PNG, TIFF, JPEG, Radiance and others.

def chunk(kind, data, length=None, damage=0):
    return struct.pack(">I", len(data) if length is None else length) + kind + data + struct.pack(">I", zlib.crc32(kind + data) ^ damage)


def png(width=4, height=4, depth=8, color=2, interlace=0, data=None, before=b"", end=True, method=0, filters=0):
    pixel = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(color, 3) * max(1, depth // 8)
    if data is None:
        data = zlib.compress(b"".join(bytes([filters]) + bytes(width * pixel) for _ in range(height)))
    head = struct.pack(">IIBBBBB", width & 0xffffffff, height & 0xffffffff, depth, color, method, 0, interlace)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + before + chunk(b"IDAT", data) + (chunk(b"IEND", b"") if end else b"")


def tiff(entries, tail=b"", next_directory=0):
    body = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(entries))
    for tag, kind, count, value in sorted(entries):
        body += struct.pack("<HHI", tag, kind, count) + (struct.pack("<H", value) + b"\0\0" if kind == 3 and count == 1 else struct.pack("<I", value))
    return body + struct.pack("<I", next_directory) + tail


def tiff_entries(width=4, height=4, samples=3, bits=8, compression=1, offset=200, size=48, **_):
    return [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, bits), (259, 3, 1, compression), (262, 3, 1, 2), (273, 4, 1, offset),
            (277, 3, 1, samples), (278, 4, 1, min(height, 0xffffffff)), (279, 4, 1, size)]


def jpeg(width, height, components=3):
    frame = struct.pack(">BHHB", 8, height, width, components) + b"".join(bytes([i + 1, 0x11, 0]) for i in range(components))
    return b"\xff\xd8\xff\xdb\0\x43\0" + b"\1" * 64 + b"\xff\xc0" + struct.pack(">H", len(frame) + 2) + frame + b"\xff\xd9"


def model(**changes):
    base = {"format": 1, "method": "mallett2019", "observer": "cie1931", "rgbSpace": "BT.709", "bands": [400, 500, 600]}
    return json.dumps({**base, **changes})


def modelled(text):
    return exr(header(RGB, more=text_attribute("spectex:model", text) + text_attribute("spectex:coefficients", "R,G,B")))


LAUGHS = '<?xml version="1.0"?>\n<!DOCTYPE x [<!ENTITY a0 "ha">' + "".join(
    f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12)) + "]>\n"


# Pictures: name, bytes. Every one of them ends with 2 and a message that names it.
PICTURES = {
    "exr_wide.exr": exr(header(RGB, (0, 0, 2 ** 30, 2 ** 30))),
    "exr_wide_one_row.exr": exr(header(RGB, (0, 0, 2 ** 30, 1))),
    "exr_high.exr": exr(header(RGB, (0, 0, 1, 2 ** 30))),
    "exr_whole_plane.exr": exr(header(RGB, struct.pack("<iiii", INT_MIN, INT_MIN, INT_MAX, INT_MAX))),
    "exr_inverted.exr": exr(header(RGB, struct.pack("<iiii", 5, 5, 0, 0))),
    "exr_far_corner.exr": exr(header(RGB, struct.pack("<iiii", INT_MAX - 3, INT_MAX - 3, INT_MAX, INT_MAX))),
    "exr_no_channels.exr": exr(header([])),
    "exr_many_channels.exr": exr(header([channel(f"c{i:05}") for i in range(5000)]), row_bytes=40000, rows=0, offsets=bytes(32)),
    "exr_many_bands.exr": exr(header([channel(f"T.{i},000000nm") for i in range(10000, 15000)]), rows=0, offsets=bytes(32)),
    "exr_wide_rows.exr": exr(header([channel(f"c{i:04}", 2) for i in range(4000)], (0, 0, 2 ** 20, 4)), rows=0, offsets=bytes(32)),
    "exr_channel_type.exr": exr(header([channel("B", 77), channel("G"), channel("R")])),
    "exr_channel_unended.exr": exr(attribute("channels", "chlist", b"R" * 300)),
    "exr_sampling_zero.exr": exr(header([channel("B", 1, 0, 0), channel("G"), channel("R")])),
    "exr_sampling_negative.exr": exr(header([channel("B", 1, -1, -1), channel("G"), channel("R")])),
    "exr_subsampled.exr": exr(header([channel("B", 1, 2, 2), channel("G"), channel("R")])),
    "exr_attribute_2gb.exr": exr(header(RGB, more=attribute("comments", "string", b"short", INT_MAX))),
    "exr_attribute_negative.exr": exr(header(RGB, more=attribute("comments", "string", b"short", -5))),
    "exr_box_short.exr": exr(header(RGB, b"\0" * 7)),
    "exr_compression.exr": exr(header(RGB, compression=77)),
    "exr_line_order.exr": exr(header(RGB, order=77)),
    "exr_aspect.exr": exr(header(RGB, aspect=float("nan"))),
    "exr_no_window.exr": exr(header(RGB, without=("dataWindow",))),
    "exr_no_list.exr": exr(header(RGB, without=("channels",))),
    "exr_version.exr": exr(header(RGB), version=99),
    "exr_flags.exr": exr(header(RGB), version=2 | 0xffff00),
    "exr_offsets_beyond.exr": exr(header(RGB), offsets=struct.pack("<QQQQ", *[2 ** 62] * 4)),
    "exr_offsets_zero.exr": exr(header(RGB), offsets=bytes(32)),
    "exr_offsets_inside.exr": exr(header(RGB), offsets=struct.pack("<QQQQ", 0, 4, 8, 12)),
    "exr_chunk_negative.exr": exr(header(RGB), chunks=struct.pack("<ii", 0, -1) * 4),
    "exr_chunk_huge.exr": exr(header(RGB), chunks=struct.pack("<ii", 0, INT_MAX) * 4),
    "exr_zip_garbage.exr": exr(header(RGB, compression=3), chunks=struct.pack("<ii", 0, 40) + b"\xff" * 40, rows=1),
    "exr_piz_garbage.exr": exr(header(RGB, compression=4), chunks=struct.pack("<ii", 0, 60) + b"\x7f" * 60, rows=1),
    "exr_tile_huge.exr": tiled((INT_MAX, INT_MAX)),
    "exr_tile_zero.exr": tiled((0, 0)),
    "exr_tile_wraps.exr": tiled((65536, 65536)),
    "exr_tile_mode.exr": tiled((16, 16), 0x77),
    "exr_mip_huge.exr": tiled((1, 1), 1, window=(0, 0, 2 ** 28, 2 ** 28)),
    "exr_no_tiles.exr": exr(header(RGB), version=2 | 0x200),
    "exr_deep.exr": exr(part("d", "deepscanline", header(RGB), 4) , version=2 | 0x800, offsets=bytes(64)),
    "exr_deep_tile.exr": exr(part("d", "deeptile", header(RGB, more=attribute("tiles", "tiledesc", struct.pack("<IIB", 4, 4, 0))), 1),
                             version=2 | 0x800, offsets=bytes(64)),
    "exr_parts_unended.exr": exr(part("a", "scanlineimage", header(RGB), 4), version=2 | 0x1000, offsets=b""),
    "exr_part_chunks.exr": exr(part("a", "scanlineimage", header(RGB), INT_MAX) + b"\0", version=2 | 0x1000, offsets=bytes(64)),
    "exr_part_type.exr": exr(part("a", "hologram", header(RGB), 4) + b"\0", version=2 | 0x1000, offsets=bytes(64)),
    "png_wide.png": png(INT_MAX, 1, data=b"x"),
    "png_beyond.png": png(0xffffffff, 0xffffffff, data=b"x"),
    "png_bomb.png": png(60000, 60000, data=zlib.compress(bytes(1 << 20), 9)),
    "png_no_height.png": png(height=0),
    "png_depth.png": png(depth=3),
    "png_color.png": png(color=5),
    "png_interlace.png": png(interlace=7),
    "png_method.png": png(method=9),
    "png_filter.png": png(filters=200),
    "png_no_palette.png": png(color=3),
    "png_not_zlib.png": png(data=b"not a stream of zlib"),
    "png_short_data.png": png(data=zlib.compress(bytes(20))),
    "png_no_data.png": png(data=b""),
    "png_no_end_of_data.png": png(end=False)[:-12],
    "png_chunk_length.png": png(before=chunk(b"tEXt", b"a\0b", length=INT_MAX)),
    "png_checksum.png": png()[:16] + b"\0\0\0\5" + png()[20:],
    "tif_loop.tif": tiff([], next_directory=8),
    "tif_beyond.tif": b"II*\0" + struct.pack("<I", 0xfffffff0),
    "tif_wide.tif": tiff(tiff_entries(0xffffffff, 0xffffffff), bytes(300)),
    "tif_samples.tif": tiff(tiff_entries(samples=65535), bytes(300)),
    "tif_no_samples.tif": tiff(tiff_entries(samples=0), bytes(300)),
    "tif_compression.tif": tiff(tiff_entries(compression=4242), bytes(300)),
    "tif_strip_beyond.tif": tiff(tiff_entries(offset=0xfffffff0, size=INT_MAX), bytes(300)),
    "tif_count.tif": tiff([(256, 4, 0xffffffff, 4)] + tiff_entries()[1:], bytes(300)),
    "jpg_no_scan.jpg": jpeg(65535, 65535),
    "jpg_components.jpg": jpeg(4, 4, 200),
    "jpg_cut.jpg": jpeg(4, 4)[:90],
    "hdr_wide.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2147483647 +X 2147483647\n",
    "hdr_negative.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y -5 +X -5\n\0",
    "hdr_cut.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 10 +X 10\n\2\2\0\12",
    "bmp_wide.bmp": b"BM" + struct.pack("<IIIIiiHHIIiiII", 60, 0, 54, 40, INT_MAX, INT_MAX, 1, 24, 0, 0, 0, 0, 0, 0),
    "tga_cut.tga": struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, 65535, 65535, 24, 0),
    "gif_cut.gif": b"GIF89a" + struct.pack("<HHBBB", 65535, 65535, 0, 0, 0),
    "pnm_wide.ppm": b"P6\n2147483647 2147483647\n255\n",
    "dpx_cut.dpx": b"SDPX" + b"\xff" * 60,
    "webp_cut.webp": b"RIFF\xff\xff\xff\xffWEBPVP8L",
}

# What is wrong in spectra and models: read by spxrelight.
SPECTRA = {
    "model_bands.exr": modelled(model(bands=list(range(100000)))),
    "model_bands_text.exr": modelled(model(bands="many")),
    "model_wavelengths.exr": modelled(model(bands=[500, 400, 300])),
    "model_negative.exr": modelled(model(bands=[-1, 0, 1])),
    "model_observer.exr": modelled(model(observer="../../../etc/passwd")),
    "model_space.exr": modelled(model(rgbSpace={"a": [1] * 10})),
    "model_method.exr": modelled(model(method="../lattice")),
    "model_illuminant.exr": modelled(model(illuminant="/etc/passwd")),
    "model_number.exr": modelled('{"format":1e999}'),
    "model_deep.exr": modelled("[" * 60000),
    "model_utf8.exr": exr(header(RGB, more=attribute("spectex:model", "string", b'{"format":1,"method":"\xff\xfe"}'))),
    "bands_two.exr": bands(["T.400nm", "T.700nm"]),
    "bands_same.exr": bands(["T.400nm", "T.500nm", "T.500,0nm", "T.5e2nm"]),
    "bands_infrared.exr": bands(["T.1000nm", "T.1100nm", "T.1200nm"]),
    "bands_gamma.exr": bands(["T.1e-300nm", "T.1e-200nm", "T.1e-100nm"]),
}

# Lights: read by -i.
LAMPS = {
    "laughs.spdx": LAUGHS + "<IESTM2714><SpectralDistribution>&a11;</SpectralDistribution></IESTM2714>",
    "entity.spdx": '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><IESTM2714>&e;</IESTM2714>',
    "deep.spdx": "<a>" * 20000,
    "bands.sp": "SPECT\nSPECTRAL_BANDS \"2000000000\"\nSPECTRAL_START_NM \"380\"\nSPECTRAL_END_NM \"730\"\nSPECTRAL_NORM \"1\"\n"
                "NUMBER_OF_FIELDS 2000000000\nBEGIN_DATA_FORMAT\nSPEC_380\nEND_DATA_FORMAT\nBEGIN_DATA\n1\nEND_DATA\n",
    "bands_negative.sp": "SPECT\nSPECTRAL_BANDS \"-5\"\nSPECTRAL_START_NM \"730\"\nSPECTRAL_END_NM \"380\"\nSPECTRAL_NORM \"0\"\nBEGIN_DATA\n1\nEND_DATA\n",
    "rows.csv": "".join(f"{400 + i * 1e-6:.6f},1\n" for i in range(100001)),
    "quotes.csv": '"' * 5001,
    "zeros.csv": "\0" * 4000,
    "utf16.csv": "400,1\n500,2\n".encode("utf-16"),
    "overflow.csv": "400,1e308\n500,1e308\n600,1e308\n700,1e309\n",
    "nan.csv": "400,1\n500,nan\n600,1\n",
    "odd.spd": "400 1 500",
    "words.spd": "wave length of four hundred",
}

# Scenes: read by spxbatch --scene. Name, text; those in GOOD_SCENES are read, and reach nothing beyond the folder.
SCENES = {
    "itself.pbrt": 'Include "itself.pbrt"\n',
    "cycle.pbrt": 'Include "cycle_b.pbrt"\n',
    "device.pbrt": 'Include "/dev/zero"\n',
    "open.pbrt": 'Texture "a',
    "laughs.xml": LAUGHS + '<scene version="3.0.0"><string name="filename" value="&a11;"/></scene>',
    "itself.xml": '<scene version="3.0.0"><include filename="itself.xml"/></scene>',
    "deep.xml": "<scene>" * 50000,
    "laughs.mtlx": LAUGHS + '<materialx version="1.38"><image name="&a11;"/></materialx>',
    "cut.mtlx": "<materialx version",
    "buffer.glb": b"glTF" + struct.pack("<III", 2, 20, 0xffffffff) + b"JSON",
    "json.glb": b"glTF" + struct.pack("<III", 2, 28, 8) + b"JSON" + b'{"a":[[ ',
    "deep.gltf": '{"asset":' + "[" * 60000,
    "text.gltf": "no JSON",
}
