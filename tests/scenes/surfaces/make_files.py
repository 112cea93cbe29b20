"""Makes the meshes and the lattice of these scenes: `knot.ply` and `smoke.vol`. Needs Python alone."""

import math
import os
import random
import struct
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, "..", "..", "..", "scenes"))

from meshes import write_ply  # noqa: E402


def trefoil(t):
    """A place on the knot, about one unit from the middle."""
    radius = 2 + math.cos(3 * t)
    return (radius * math.cos(2 * t) / 3, radius * math.sin(2 * t) / 3, math.sin(3 * t) / 3)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(a):
    length = math.hypot(*a)
    return tuple(x / length for x in a)


def tube(curve, radius, rings, sides):
    """A closed tube about a closed curve of the parameter 0 to 2 pi; the curve is nowhere straight."""
    vertices, faces = [], []
    for ring in range(rings):
        t, step = 2 * math.pi * ring / rings, 1e-3
        before, here, after = curve(t - step), curve(t), curve(t + step)
        along = unit([b - a for a, b in zip(before, after)])
        bend = [a + b - 2 * c for a, b, c in zip(before, after, here)]
        out = unit([x - y * sum(p * q for p, q in zip(bend, along)) for x, y in zip(bend, along)])
        side = cross(along, out)
        for corner in range(sides):
            c, s = math.cos(2 * math.pi * corner / sides), math.sin(2 * math.pi * corner / sides)
            normal = [c * x + s * y for x, y in zip(out, side)]
            vertices.append((*(p + radius * n for p, n in zip(here, normal)), *normal))
            a, b = ring * sides + corner, ring * sides + (corner + 1) % sides
            c, d = (a + sides) % (rings * sides), (b + sides) % (rings * sides)
            faces += [(a, b, c), (b, d, c)]
    return vertices, faces


def write_vol(path, size, value):
    """Writes a lattice of bytes with one channel; `value(x, y, z)` takes places in the unit cube."""
    places = [(index + 0.5) / size for index in range(size)]
    with open(path, "wb") as file:
        file.write(b"VOL\3" + struct.pack("<5i6f", 3, size, size, size, 1, 0, 0, 0, 1, 1, 1))
        file.write(bytes(round(255 * min(1, max(0, value(x, y, z)))) for z in places for y in places for x in places))


def cloud():
    """A cloud of soft balls, flat below, with nothing at the border of the cube."""
    draw = random.Random(5)
    balls = []
    while len(balls) < 26:
        place = [draw.gauss(0.5, 0.17), 0.27 + abs(draw.gauss(0, 0.2)), draw.gauss(0.5, 0.13)]
        room = min(min(x, 1 - x) for x in place) - 0.03
        if room > 0.08:
            balls.append((place, min(room, draw.uniform(0.1, 0.2))))

    def value(x, y, z):
        total = sum(max(0, 1 - (math.dist(place, (x, y, z)) / radius) ** 2) for place, radius in balls)
        return total * min(1, max(0, (y - 0.17) / 0.08))

    return value


if __name__ == "__main__":
    write_ply(os.path.join(HERE, "knot.ply"), *tube(trefoil, 0.17, 80, 10))
    write_vol(os.path.join(HERE, "smoke.vol"), 24, cloud())
