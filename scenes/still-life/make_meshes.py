"""Makes the meshes and the table's texture of this scene. Needs Python alone.

Lengths are in decimetres. Meshes of revolution carry normals taken from their profile curve; the cut stone has
flat facets and carries none.
"""

import math
import os
import random
import struct
import sys
import zlib

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.dirname(HERE))

import meshes
from meshes import lathe, spline

WINE_LEVEL = 1.03


def write_ply(name, vertices, faces):
    meshes.write_ply(os.path.join(HERE, "meshes", name), vertices, faces)


def cut(profile, height):
    """Splits a descending profile where it crosses `height`; both parts share the sample there."""
    for i, ((r0, y0, n0), (r1, y1, n1)) in enumerate(zip(profile, profile[1:])):
        if y0 > height >= y1:
            w = (y0 - height) / (y0 - y1)
            normal = tuple(a + w * (b - a) for a, b in zip(n0, n1))
            scale = 1 / math.hypot(*normal)
            at = (r0 + w * (r1 - r0), height, tuple(scale * v for v in normal))
            return profile[: i + 1] + [at], [at] + profile[i + 1 :]
    raise ValueError("the profile does not cross the height")


def wine_glass():
    """One closed body of glass, in two meshes: what touches air, and what touches wine."""
    outside = [(0.0, 0.012), (0.2, 0.008), (0.34, 0.0), (0.372, 0.006), (0.37, 0.022), (0.3, 0.036), (0.14, 0.06)]
    outside += [(0.06, 0.11), (0.038, 0.2), (0.036, 0.3), (0.055, 0.38), (0.13, 0.44), (0.27, 0.53)]
    outside += [(0.395, 0.67), (0.45, 0.85), (0.446, 1.07), (0.405, 1.32), (0.36, 1.52)]
    rim = [(0.357, 1.533), (0.35, 1.534), (0.346, 1.522)]
    inside = [(0.389, 1.32), (0.429, 1.07), (0.432, 0.85), (0.378, 0.69), (0.26, 0.562), (0.12, 0.48), (0.0, 0.455)]
    profile = spline(outside + rim + inside, 3)
    above, below = cut(profile, WINE_LEVEL)
    write_ply("glass.ply", *lathe(above, 80))
    write_ply("glass-wine.ply", *lathe(below, 80))
    return below[0][0]


def wine_surface(radius):
    """The top of the wine: a disc with a small meniscus."""
    rise, width = 0.012, 0.03
    profile = [(0.0, WINE_LEVEL - rise, (0.0, 1.0))]
    profile += [(radius - 3 * width, WINE_LEVEL - rise, (0.0, 1.0))]
    for k in range(7):
        r = radius - 2 * width * (1 - k / 6)
        h = rise * math.exp((r - radius) / width * 2)
        slope = 2 * h / width
        length = math.hypot(slope, 1)
        profile.append((r, WINE_LEVEL - rise + h, (-slope / length, 1 / length)))
    write_ply("wine.ply", *lathe(profile[::-1], 80))


def ring():
    """A bangle lying on the table: nearly flat inside, with rounded edges, and elliptic outside."""
    radius, height, thickness = 0.56, 0.23, 0.06
    profile = []
    for k in range(32):
        angle = 2 * math.pi * k / 32
        c, s = math.cos(angle), math.sin(angle)
        n = 2 if c > 0 else 7
        x, y = math.copysign(abs(c) ** (2 / n), c), math.copysign(abs(s) ** (2 / n), s)
        nx, ny = math.copysign(abs(x) ** (n - 1), x) / thickness, math.copysign(abs(y) ** (n - 1), y) / height
        length = math.hypot(nx, ny)
        profile.append((radius + x * thickness / 2, (1 + y) * height / 2, (nx / length, ny / length)))
    write_ply("ring.ply", *lathe(profile, 112, closed=True))


def stone():
    """A cut stone of eightfold symmetry, lying on a facet of its lower side."""
    top = [(0.56, 0.33, k) for k in range(8)]
    girdle = [(1.0, 0.05, k + 0.5) for k in range(8)]
    belt = [(1.0, -0.03, k + 0.5) for k in range(8)]
    corners = [(r * math.cos(k * math.pi / 4), y, r * math.sin(k * math.pi / 4)) for r, y, k in top + girdle + belt]
    corners += [(0.0, 0.33, 0.0), (0.0, -0.86, 0.0)]
    faces = []
    for k in range(8):
        n = (k + 1) % 8
        faces += [(24, n, k), (k, n, 8 + k), (n, 8 + n, 8 + k)]
        faces += [(8 + k, 8 + n, 16 + k), (8 + n, 16 + n, 16 + k), (16 + k, 16 + n, 25)]
    tilt = math.atan2(0.83, math.cos(math.pi / 8))
    c, s = math.cos(tilt), math.sin(tilt)
    corners = [(x * c + y * s, -x * s + y * c, z) for x, y, z in corners]
    low = min(y for _, y, _ in corners)
    size = 0.3
    write_ply("stone.ply", [(size * x, size * (y - low), size * z) for x, y, z in corners], faces)


def noise(seed):
    """Smooth value noise of two variables, about -1 to 1."""
    generator = random.Random(seed)
    lattice = [[generator.uniform(-1, 1) for _ in range(64)] for _ in range(64)]

    def at(x, y):
        i, j = math.floor(x), math.floor(y)
        u, v = x - i, y - j
        u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
        a, b = lattice[j % 64], lattice[(j + 1) % 64]
        top = a[i % 64] + u * (a[(i + 1) % 64] - a[i % 64])
        bottom = b[i % 64] + u * (b[(i + 1) % 64] - b[i % 64])
        return top + v * (bottom - top)

    return at


def wood(size):
    """Seven planks of oiled wood along u."""
    bend, fine, tone = noise(1), noise(2), noise(6)
    rows = []
    for j in range(size):
        row = bytearray(b"\0")
        plank = 7 * j // size
        across = 7 * j / size - plank
        shade = 1 + 0.09 * tone(plank * 7.3, 1.5)
        seam = min(1.0, min(across, 1 - across) * 24)
        for i in range(size):
            u = i / size + plank * 2.37
            y = across + plank * 9.1
            growth = 3.1 * y + 1.5 * bend(1.4 * u, 0.9 * y) + 0.25 * bend(5 * u + 5, 5 * y)
            band = growth - math.floor(growth)
            band = band**3 * (1 - band**12)
            grain = 0.55 * fine(10 * u, 70 * y) + 0.45 * fine(22 * u, 160 * y)
            level = shade * (0.95 - 0.16 * band + 0.06 * grain) * (0.45 + 0.55 * seam)
            for channel, exponent in ((186, 1.0), (150, 1.2), (116, 1.4)):
                row.append(max(0, min(255, 2 * round(channel * level**exponent / 2))))
        rows.append(bytes(row))
    write_png("wood.png", size, size, b"".join(rows))


def write_png(name, width, height, rows):
    """Writes 8-bit RGB; each row starts with its filter byte."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    with open(os.path.join(HERE, "textures", name), "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)))
        file.write(chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


if __name__ == "__main__":
    for folder in ("meshes", "textures"):
        os.makedirs(os.path.join(HERE, folder), exist_ok=True)
    wine_surface(wine_glass())
    ring()
    stone()
    wood(512)
