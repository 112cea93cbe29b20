#!/usr/bin/env python3
"""Writes core/src/light/daylight/hosek_wilkie.bin: the RGB data of the sky and sun models by Hosek and Wilkie (2012, 2013).

Needs the PyPI packages mitsuba (3.9.1 was used), which ships the authors' data under their licence (hosek_wilkie.license beside the
table), and numpy. The file holds little-endian f32 numbers, one table after the other, the last index fastest:

    sky parameters   10 turbidities, 2 albedos, 6 control points, 3 channels, 9 parameters
    sky radiances    10 turbidities, 2 albedos, 6 control points, 3 channels
    sun irradiances  10 turbidities, 45 segments of elevation, 3 channels, 4 coefficients of a cubic

The sun's disc is given as a polynomial in the cosine of the angle at its surface (limb darkening). Over the disc, which is small, the mean
of that cosine to the power j is 2 / (j + 2); so the irradiance, the mean times the solid angle, has one polynomial less.

    python3 core/tools/daylight_table.py
"""
import pathlib
import struct

import mitsuba as mi
import numpy as np

DATA = pathlib.Path(mi.__file__).parent / "data" / "sunsky"
TARGET = pathlib.Path(__file__).parent.parent / "src" / "light" / "daylight"
# Half the angle that the sun is seen under [radians].
SUN_HALF_ANGLE = np.radians(0.5 * 0.5358)
# What Mitsuba turns the spectral sun into the unit of the tristimulus sky by.
SUN_TO_RGB = 467.069280386


def tensors(path: pathlib.Path) -> dict[str, np.ndarray]:
    """The tables of one of Mitsuba's tensor files."""
    data = path.read_bytes()
    assert data[:12] == b"tensor_file\0"
    (count,) = struct.unpack_from("<I", data, 14)
    at, tables = 18, {}
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, at)
        name = data[at + 2 : at + 2 + length].decode()
        at += 2 + length
        dimensions, kind, offset = struct.unpack_from("<HBQ", data, at)
        shape = struct.unpack_from(f"<{dimensions}Q", data, at + 11)
        at += 11 + 8 * dimensions
        element = {0x0A: "<f4", 0x0B: "<f8"}[kind]
        tables[name] = np.frombuffer(data, element, int(np.prod(shape)), offset).reshape(shape)
    return tables


def main() -> None:
    tables = tensors(DATA / "sunsky_datasets.bin")
    limb = tables["sun_rad_rgb"]
    mean_over_disc = 2.0 / (np.arange(limb.shape[-1]) + 2.0)
    solid_angle = 2.0 * np.pi * (1.0 - np.cos(SUN_HALF_ANGLE))
    sun = (limb * mean_over_disc).sum(axis=-1) * (solid_angle * SUN_TO_RGB)
    parts = [tables["sky_params_rgb"], tables["sky_rad_rgb"], sun]
    (TARGET / "hosek_wilkie.bin").write_bytes(b"".join(part.astype("<f4").tobytes() for part in parts))
    licence = (DATA / "LICENSE").read_text().rstrip() + "\n"
    (TARGET / "hosek_wilkie.license").write_text(licence)


if __name__ == "__main__":
    main()
