"""What the scripts that make meshes share: curves, bodies of revolution, and files of PLY."""

import math
import struct


def write_ply(path, vertices, faces):
    """Writes a binary PLY; vertices are (x, y, z) or (x, y, z, nx, ny, nz)."""
    fields = ["x", "y", "z", "nx", "ny", "nz"][: len(vertices[0])]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {field}" for field in fields]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode())
        for vertex in vertices:
            file.write(struct.pack(f"<{len(fields)}f", *vertex))
        for face in faces:
            file.write(struct.pack("<B3i", 3, *face))


def spline(points, steps):
    """Centripetal Catmull-Rom curve through (radius, height) points, as (radius, height, normal) samples.

    The normal lies to the right of the direction of travel, so it points outwards where a profile goes up.
    """
    ends = [tuple(2 * a - b for a, b in zip(points[0], points[1]))]
    ends += points + [tuple(2 * a - b for a, b in zip(points[-1], points[-2]))]
    curve = []
    for i in range(len(points) - 1):
        p = ends[i : i + 4]
        t = [0.0]
        for a, b in zip(p, p[1:]):
            t.append(t[-1] + math.dist(a, b) ** 0.5)
        last = i == len(points) - 2
        for k in range(steps + last):
            curve.append(barry_goldman(p, t, t[1] + (t[2] - t[1]) * k / steps))
    samples = []
    for i, (r, y) in enumerate(curve):
        (r0, y0), (r1, y1) = curve[max(i - 1, 0)], curve[min(i + 1, len(curve) - 1)]
        dr, dy = r1 - r0, y1 - y0
        if r < 1e-9:
            dy = 0.0
        length = math.hypot(dr, dy)
        samples.append((max(r, 0.0), y, (dy / length, -dr / length)))
    return samples


def barry_goldman(p, t, x):
    """Point of a Catmull-Rom segment with knots `t` at parameter `x`."""

    def mix(a, b, ta, tb):
        return tuple((tb - x) / (tb - ta) * u + (x - ta) / (tb - ta) * v for u, v in zip(a, b))

    a = [mix(p[i], p[i + 1], t[i], t[i + 1]) for i in range(3)]
    b = [mix(a[i], a[i + 1], t[i], t[i + 2]) for i in range(2)]
    return mix(b[0], b[1], t[1], t[2])


def lathe(profile, segments, closed=False):
    """Turns (radius, height, normal) samples about the y axis."""
    vertices, faces = [], []
    for r, y, (nr, ny) in profile:
        for s in range(segments):
            angle = 2 * math.pi * s / segments
            c, d = math.cos(angle), math.sin(angle)
            vertices.append((r * c, y, r * d, nr * c, ny, nr * d))
    rows = len(profile)
    for i in range(rows if closed else rows - 1):
        for s in range(segments):
            a, b = i * segments + s, i * segments + (s + 1) % segments
            c, d = (a + segments) % len(vertices), (b + segments) % len(vertices)
            if profile[i][0] > 0:
                faces.append((a, c, b))
            if profile[(i + 1) % rows][0] > 0:
                faces.append((b, c, d))
    return vertices, faces
