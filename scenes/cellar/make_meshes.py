"""Makes the bottle of this scene. Needs Python alone. Lengths are in decimetres."""

import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.dirname(HERE))

from meshes import lathe, spline, write_ply


def bottle():
    """One closed body of glass around what is in the bottle, which is open at its neck."""
    foot = [(0.0, 0.14), (0.1, 0.11), (0.2, 0.05), (0.28, 0.0), (0.345, 0.01), (0.375, 0.06)]
    side = [(0.38, 0.4), (0.38, 1.0), (0.38, 1.7), (0.36, 1.95), (0.28, 2.13), (0.18, 2.28), (0.145, 2.42), (0.14, 2.7)]
    lip = [(0.14, 2.8), (0.165, 2.81), (0.168, 2.85), (0.165, 2.89), (0.145, 2.905), (0.115, 2.9), (0.1, 2.88)]
    inside = [(0.1, 2.7), (0.105, 2.42), (0.14, 2.28), (0.24, 2.11), (0.325, 1.93), (0.345, 1.7), (0.345, 1.0), (0.345, 0.4)]
    bottom = [(0.34, 0.14), (0.3, 0.09), (0.2, 0.12), (0.1, 0.18), (0.0, 0.21)]
    return lathe(spline(foot + side + lip + inside + bottom, 3), 64)


if __name__ == "__main__":
    write_ply(os.path.join(HERE, "meshes", "bottle.ply"), *bottle())
