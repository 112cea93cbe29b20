"""Makes the bunny of the scenes `pyramids` and `cornell-bunny`. Needs Python alone.

The animal is a signed distance field: ellipsoids and rounded cones joined smoothly. Naive surface nets (Gibson 1998) turn its zero set
into a mesh, whose vertices are then moved onto that set and carry its gradient as normals, so that even a mirror looks smooth.
It faces +x, stands on y = 0 and is about 1.2 units high, ears included.
"""

import math
import os
import struct

HERE = os.path.dirname(os.path.abspath(__file__))
SCENES = ("pyramids", "cornell-bunny")
CELL = 0.0235
LOW, HIGH = (-0.66, -0.05, -0.44), (0.78, 1.40, 0.44)


def ellipsoid(p, centre, radii, axes=None):
    """Distance to an ellipsoid, first order at its surface; `axes` are three unit vectors, the world's by default."""
    d = [p[i] - centre[i] for i in range(3)]
    if axes:
        d = [sum(a * b for a, b in zip(d, axis)) for axis in axes]
    k0 = math.sqrt(sum((x / r) ** 2 for x, r in zip(d, radii)))
    k1 = math.sqrt(sum((x / r**2) ** 2 for x, r in zip(d, radii)))
    return k0 * (k0 - 1) / k1 if k1 > 1e-9 else -min(radii)


def limb(p, a, b, ra, rb):
    """Distance to a segment whose radius goes linearly from `ra` to `rb`."""
    ab = [y - x for x, y in zip(a, b)]
    ap = [y - x for x, y in zip(a, p)]
    t = sum(x * y for x, y in zip(ab, ap)) / sum(x * x for x in ab)
    t = min(1.0, max(0.0, t))
    return math.dist(p, [x + t * d for x, d in zip(a, ab)]) - (ra + t * (rb - ra))


def join(a, b, width):
    """Smooth minimum (Quilez): differs from `min` only where the two differ by less than `width`."""
    h = max(width - abs(a - b), 0.0) / width
    return min(a, b) - 0.25 * h * h * width


def carve(a, b, width):
    """`a` without `b`, with a rounded rim."""
    return -join(-a, b, width)


def ear_axes():
    """Frame of the right ear: along it, across it, and out of its hollow."""
    along = unit((-0.34, 1.0, 0.25))
    out = unit(cross(unit((0.45, 0.0, -1.0)), along))
    return along, unit(cross(out, along)), out


def field(p):
    """The animal; symmetric in z, apart from the way it is built from one side."""
    x, y, z = p
    m = (x, y, abs(z))
    along, across, out = EAR
    ear_centre = [0.30 + 0.30 * along[0], 0.78 + 0.30 * along[1], 0.055 + 0.30 * along[2]]
    hollow = [c + 0.042 * o for c, o in zip(ear_centre, out)]
    body = ellipsoid(p, (-0.12, 0.36, 0.0), (0.40, 0.345, 0.30))
    body = join(body, ellipsoid(p, (0.19, 0.43, 0.0), (0.21, 0.27, 0.19)), 0.16)
    body = join(body, ellipsoid(m, (-0.16, 0.25, 0.19), (0.25, 0.235, 0.145)), 0.05)
    body = join(body, ellipsoid(m, (0.06, 0.056, 0.24), (0.23, 0.055, 0.08)), 0.05)
    body = join(body, limb(m, (0.24, 0.34, 0.10), (0.33, 0.075, 0.105), 0.085, 0.058), 0.07)
    body = join(body, ellipsoid(m, (0.40, 0.052, 0.105), (0.11, 0.05, 0.062)), 0.05)
    head = ellipsoid(p, (0.375, 0.735, 0.0), (0.205, 0.175, 0.165))
    head = join(head, ellipsoid(m, (0.45, 0.68, 0.075), (0.12, 0.095, 0.085)), 0.07)
    head = join(head, ellipsoid(p, (0.53, 0.695, 0.0), (0.075, 0.06, 0.05)), 0.06)
    head = carve(head, ellipsoid(m, (0.475, 0.775, 0.142), (0.04, 0.04, 0.03)), 0.03)
    head = join(head, ellipsoid(m, (0.462, 0.772, 0.118), (0.034, 0.034, 0.03)), 0.008)
    ear = ellipsoid(m, ear_centre, (0.29, 0.088, 0.046), (along, across, out))
    ear = carve(ear, ellipsoid(m, hollow, (0.22, 0.055, 0.04), (along, across, out)), 0.03)
    head = join(head, ear, 0.05)
    neck = limb(p, (0.17, 0.5, 0.0), (0.33, 0.68, 0.0), 0.17, 0.13)
    animal = join(join(body, neck, 0.12), head, 0.07)
    return join(animal, ellipsoid(p, (-0.53, 0.29, 0.0), (0.095, 0.10, 0.095)), 0.035)


def gradient(p):
    """Unit gradient by central differences."""
    h = 1e-4
    steps = []
    for i in range(3):
        a, b = list(p), list(p)
        a[i] += h
        b[i] -= h
        steps.append(field(a) - field(b))
    return unit(steps)


def unit(v):
    length = math.sqrt(sum(x * x for x in v))
    return tuple(x / length for x in v)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def surface_net():
    """Vertices and triangles of the zero set: a vertex per cell that it crosses, a quadrilateral per crossed edge."""
    n = [math.ceil((b - a) / CELL) + 1 for a, b in zip(LOW, HIGH)]
    at = lambda g: tuple(low + CELL * i for low, i in zip(LOW, g))
    grid = [(i, j, k) for i in range(n[0]) for j in range(n[1]) for k in range(n[2])]
    value = {g: field(at(g)) for g in grid}
    corners = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    edges = [(a, b) for a in corners for b in corners if a < b and sum(abs(x - y) for x, y in zip(a, b)) == 1]
    vertices, index = [], {}
    for g in grid:
        if any(g[i] + 1 == n[i] for i in range(3)):
            continue
        corner = {c: value[tuple(x + y for x, y in zip(g, c))] for c in corners}
        crossings = []
        for a, b in edges:
            if (corner[a] < 0) != (corner[b] < 0):
                t = corner[a] / (corner[a] - corner[b])
                crossings.append([x + t * (y - x) for x, y in zip(a, b)])
        if crossings:
            index[g] = len(vertices)
            mean = [sum(c[i] for c in crossings) / len(crossings) for i in range(3)]
            vertices.append(at([x + y for x, y in zip(g, mean)]))
    faces = []
    for g in grid:
        for axis in range(3):
            end = tuple(x + (i == axis) for i, x in enumerate(g))
            if end not in value or (value[g] < 0) == (value[end] < 0):
                continue
            u, v = [(0, 1, 0), (0, 0, 1), (1, 0, 0)][axis], [(0, 0, 1), (1, 0, 0), (0, 1, 0)][axis]
            cells = [(0, 0, 0), u, tuple(x + y for x, y in zip(u, v)), v]
            quad = [index[tuple(x - y for x, y in zip(g, c))] for c in cells]
            if value[g] >= 0:
                quad.reverse()
            faces += [(quad[0], quad[1], quad[2]), (quad[0], quad[2], quad[3])]
    return vertices, faces


def settle(p):
    """Moves a vertex onto the zero set and gives it its normal."""
    for _ in range(4):
        g, d = gradient(p), field(p)
        p = tuple(x - d * y for x, y in zip(p, g))
    return p + gradient(p)


def write_ply(path, vertices, faces):
    """Writes a binary PLY of vertices (x, y, z, nx, ny, nz)."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {field}" for field in ("x", "y", "z", "nx", "ny", "nz")]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode())
        for vertex in vertices:
            file.write(struct.pack("<6f", *vertex))
        for face in faces:
            file.write(struct.pack("<B3i", 3, *face))


EAR = ear_axes()

if __name__ == "__main__":
    vertices, faces = surface_net()
    vertices = [settle(v) for v in vertices]
    low = min(v[1] for v in vertices)
    vertices = [(v[0], v[1] - low) + v[2:] for v in vertices]
    for scene in SCENES:
        folder = os.path.join(HERE, scene, "meshes")
        os.makedirs(folder, exist_ok=True)
        write_ply(os.path.join(folder, "bunny.ply"), vertices, faces)
