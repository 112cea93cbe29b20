"""Reads the pictures of Photonfarm, and writes them anew with names of layers that Blender's compositor knows.

They are scan lines of 32-bit floats, packed by zip in blocks of 16 lines, as the OpenEXR file layout describes. Blender's own
reader shows red, green and blue alone of such a file.
"""

import struct
import zlib

import numpy

MAGIC = b"\x76\x2f\x31\x01"
# Version 2, of scan lines in one part; names of more than 31 bytes are allowed by a flag.
VERSION, LONG_NAMES = 2, 0x400
FLOAT, ZIP, LINES = 2, 3, 16


class Unreadable(Exception):
    """The bytes are no picture of Photonfarm."""


def _text(data, at):
    end = data.index(0, at)
    return data[at:end].decode(), end + 1


def _header(data):
    """Attributes by name, as type and bytes, and where the header ends."""
    if data[:4] != MAGIC or struct.unpack_from("<I", data, 4)[0] & ~LONG_NAMES != VERSION:
        raise Unreadable("it is no OpenEXR file of scan lines")
    attributes, at = {}, 8
    while data[at]:
        name, at = _text(data, at)
        kind, at = _text(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        attributes[name] = kind, data[at + 4 : at + 4 + size]
        at += 4 + size
    return attributes, at + 1


def _channels(packed):
    names, at = [], 0
    while packed[at]:
        name, at = _text(packed, at)
        if struct.unpack_from("<i", packed, at)[0] != FLOAT:
            raise Unreadable(f"its channel {name} does not hold 32-bit floats")
        names.append(name)
        at += 16
    return names


def _unpack(block, size):
    if len(block) == size:
        return block
    steps = numpy.frombuffer(zlib.decompress(block), dtype=numpy.uint8).astype(numpy.int64)
    steps[1:] -= 128
    halves = numpy.cumsum(steps).astype(numpy.uint8)
    mixed = numpy.empty(size, dtype=numpy.uint8)
    mixed[0::2] = halves[: (size + 1) // 2]
    mixed[1::2] = halves[(size + 1) // 2 :]
    return mixed.tobytes()


def _pack(raw):
    mixed = numpy.frombuffer(raw, dtype=numpy.uint8)
    halves = numpy.concatenate([mixed[0::2], mixed[1::2]]).astype(numpy.int64)
    halves[1:] = halves[1:] - halves[:-1] + 128
    packed = zlib.compress(halves.astype(numpy.uint8).tobytes(), 4)
    return packed if len(packed) < len(raw) else raw


def read(data):
    """The channels of a picture by name, each an array of height x width with the top line first."""
    try:
        attributes, at = _header(data)
        if attributes["compression"][1] != bytes([ZIP]):
            raise Unreadable("it is not packed by zip")
        left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"][1])
        width, height = right - left + 1, bottom - top + 1
        names = _channels(attributes["channels"][1])
        lines = numpy.empty((height, len(names), width), dtype=numpy.float32)
        for offset in struct.unpack_from(f"<{-(-height // LINES)}Q", data, at):
            line, size = struct.unpack_from("<2i", data, offset)
            line -= top
            count = min(LINES, height - line)
            raw = _unpack(data[offset + 8 : offset + 8 + size], 4 * count * len(names) * width)
            lines[line : line + count] = numpy.frombuffer(raw, dtype="<f4").reshape(count, len(names), width)
    except (KeyError, IndexError, ValueError, struct.error, zlib.error) as error:
        raise Unreadable(f"it is damaged ({error})") from error
    return {name: lines[:, i] for i, name in enumerate(names)}


def passes(channels):
    """Passes as Blender names them, each an array of height x width x channels, with the letters of these."""
    height, width = channels["R"].shape
    combined = numpy.ones((height, width, 4), dtype=numpy.float32)
    for i, letter in enumerate("RGB"):
        combined[:, :, i] = channels[letter]
    found = {"Combined": (combined, "RGBA")}
    others = {}
    for name in channels:
        if name not in ("R", "G", "B", "A"):
            group, dot, letter = name.rpartition(".")
            others.setdefault(group if dot else name, []).append((letter if dot else "X", name))
    for group, members in others.items():
        letters = [letter for letter, _ in members]
        order = next((o for o in ("RGBA", "RGB", "XYZ", "XYZW", "X") if sorted(o) == sorted(letters)), None)
        if order:
            named = dict(members)
            layer = numpy.stack([channels[named[letter]] for letter in order], axis=2)
            found[group.replace("_", " ").title()] = layer, order
    return found


def layered(channels):
    """The bytes of a file of the same pixels, whose layers Blender's image node shows one by one."""
    named = {}
    for name, (layer, letters) in passes(channels).items():
        for i, letter in enumerate(letters):
            named[f"Photonfarm.{name}.{letter}"] = layer[:, :, i]
    names = sorted(named)
    height, width = named[names[0]].shape
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listed = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for name in names) + b"\0"
    attributes = [
        ("channels", "chlist", listed),
        ("compression", "compression", bytes([ZIP])),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]
    flags = LONG_NAMES if any(len(name) > 31 for name in names) else 0
    head = MAGIC + struct.pack("<I", VERSION | flags)
    for name, kind, value in attributes:
        head += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    blocks = []
    for line in range(0, height, LINES):
        rows = numpy.stack([named[name][line : line + LINES] for name in names], axis=1)
        packed = _pack(rows.astype("<f4").tobytes())
        blocks.append(struct.pack("<2i", line, len(packed)) + packed)
    at = len(head) + 8 * len(blocks)
    offsets = []
    for block in blocks:
        offsets.append(at)
        at += len(block)
    return head + struct.pack(f"<{len(offsets)}Q", *offsets) + b"".join(blocks)
