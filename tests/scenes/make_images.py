"""Makes the images and the lattice of the test scenes: `images/sky.exr`, `images/picture.png` and `volumes/smoke.vol`. Needs Python alone."""

import math
import os
import struct
import zlib


def write_exr(path, width, height, pixels):
    """Writes 32-bit RGB scanlines, uncompressed; `pixels[y][x]` is a triple."""

    def attribute(name, kind, data):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data

    channels = b"".join(c + b"\0" + struct.pack("<iBBBBii", 2, 0, 0, 0, 0, 1, 1) for c in (b"B", b"G", b"R")) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = struct.pack("<2i", 20000630, 2)
    header += attribute("channels", "chlist", channels)
    header += attribute("compression", "compression", b"\0")
    header += attribute("dataWindow", "box2i", window)
    header += attribute("displayWindow", "box2i", window)
    header += attribute("lineOrder", "lineOrder", b"\0")
    header += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    header += attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0))
    header += attribute("screenWindowWidth", "float", struct.pack("<f", 1))
    header += b"\0"
    line = 12 * width
    first = len(header) + 8 * height
    with open(path, "wb") as file:
        file.write(header)
        file.write(b"".join(struct.pack("<Q", first + y * (8 + line)) for y in range(height)))
        for y in range(height):
            planes = [pixels[y][x][c] for c in (2, 1, 0) for x in range(width)]
            file.write(struct.pack("<2i", y, line) + struct.pack(f"<{3 * width}f", *planes))


def write_png(path, width, height, pixels):
    """Writes 8-bit RGB; `pixels[y][x]` is a triple of integers."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + bytes(v for pixel in pixels[y] for v in pixel) for y in range(height))
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        file.write(chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)))
        file.write(chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


def write_vol(path, size, value):
    """Writes a lattice of 32-bit floats with one channel; `value(x, y, z)` takes places in the unit cube."""
    places = [[(index + 0.5) / count for index in range(count)] for count in size]
    with open(path, "wb") as file:
        file.write(b"VOL\3" + struct.pack("<5i6f", 1, *size, 1, 0, 0, 0, 1, 1, 1))
        for z in places[2]:
            for y in places[1]:
                file.write(struct.pack(f"<{size[0]}f", *(value(x, y, z) for x in places[0])))


def smoke(x, y, z):
    """A plume that leans and widens as it rises along y, with nothing around it."""
    away = math.hypot(x - 0.3 - 0.4 * y * y, z - 0.5) / (0.12 + 0.25 * y)
    return max(0.0, 1 - away * away) * (0.6 + 0.4 * math.sin(9 * y + 4 * x))


def sky(width, height):
    """A blue gradient over a brown ground, with one wide bright patch."""
    rows = []
    for y in range(height):
        theta = math.pi * (y + 0.5) / height
        row = []
        for x in range(width):
            phi = 2 * math.pi * (x + 0.5) / width
            up = math.cos(theta)
            base = (0.25 + 0.2 * up, 0.35 + 0.3 * up, 0.5 + 0.5 * up) if up > 0 else (0.2, 0.16, 0.12)
            patch = 14 * math.exp(-(((theta - 0.8) / 0.3) ** 2) - ((phi - 2.2) / 0.35) ** 2)
            row.append(tuple(b + patch * c for b, c in zip(base, (1, 0.9, 0.7))))
        rows.append(row)
    return rows


def picture(width, height):
    """Smooth colours with a hard-edged disc, not symmetric in any axis."""
    rows = []
    for y in range(height):
        row = []
        for x in range(width):
            u, v = (x + 0.5) / width, (y + 0.5) / height
            disc = (u - 0.3) ** 2 + (v - 0.6) ** 2 < 0.04
            row.append((220, 60, 40) if disc else (int(40 + 180 * u), int(60 + 150 * v), int(200 - 120 * u * v)))
        rows.append(row)
    return rows


if __name__ == "__main__":
    here = os.path.dirname(os.path.abspath(__file__))
    write_exr(os.path.join(here, "images", "sky.exr"), 32, 16, sky(32, 16))
    write_png(os.path.join(here, "images", "picture.png"), 24, 16, picture(24, 16))
    write_vol(os.path.join(here, "volumes", "smoke.vol"), (10, 18, 9), smoke)
