"""Balls of triangles."""

import math

import mathutils
import numpy


def icosphere(levels):
    """Points of the unit sphere and triangles that face outwards."""
    golden = (1 + math.sqrt(5)) / 2
    points = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    points += [(z, x, y) for x, y, z in points] + [(y, z, x) for x, y, z in points]
    points = [mathutils.Vector(point).normalized() for point in points]
    edge = (points[0] - points[1]).length * 1.01
    near = lambda i, j: (points[i] - points[j]).length < edge
    triangles = []
    for i in range(12):
        for j in range(i + 1, 12):
            for k in range(j + 1, 12):
                if near(i, j) and near(j, k) and near(i, k):
                    out = (points[j] - points[i]).cross(points[k] - points[i]).dot(points[i]) > 0
                    triangles.append((i, j, k) if out else (i, k, j))
    for _ in range(levels):
        halves, finer = {}, []

        def half(i, j):
            key = min(i, j), max(i, j)
            if key not in halves:
                halves[key] = len(points)
                points.append((points[i] + points[j]).normalized())
            return halves[key]

        for i, j, k in triangles:
            a, b, c = half(i, j), half(j, k), half(k, i)
            finer += [(i, a, c), (a, j, b), (c, b, k), (a, b, c)]
        triangles = finer
    return numpy.array(points), numpy.array(triangles)


def grid(columns, rows):
    """Points of the unit sphere about z, their coordinates in an image of all directions, and triangles that face inwards.

    The image is as Cycles has it: its middle lies in the direction x, its upper end in z. Coordinates run down, as those of glTF.
    """
    u, v = (axis.ravel() for axis in numpy.meshgrid(numpy.linspace(0, 1, columns + 1), numpy.linspace(0, 1, rows + 1)))
    around, down = (0.5 - u) * 2 * math.pi, v * math.pi
    points = numpy.stack((numpy.cos(around) * numpy.sin(down), numpy.sin(around) * numpy.sin(down), numpy.cos(down)), axis=1)
    # What is one place has the same bits, so that the surface is closed.
    lines = points.reshape(rows + 1, columns + 1, 3)
    lines[:, -1], lines[0], lines[-1] = lines[:, 0], (0, 0, 1), (0, 0, -1)
    triangles = []
    for row in range(rows):
        for column in range(columns):
            i = row * (columns + 1) + column
            below = i + columns + 1
            # At the poles one of the two has no area.
            if row > 0:
                triangles.append((i, below + 1, i + 1))
            if row < rows - 1:
                triangles.append((i, below, below + 1))
    return points, numpy.stack((u, v), axis=1), numpy.array(triangles)
