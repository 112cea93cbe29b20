#!/usr/bin/env python3
"""Writes core/src/material/conductors.rs: the named conductors as linear Rec. 709 triples.

Needs the PyPI packages mitsuba (3.9.1 was used) and numpy. Mitsuba ships the measured spectra; each is integrated
against the CIE 1931 colour-matching functions over 360 to 830 nm, divided by the integral of y-bar, turned from XYZ to
linear Rec. 709, and negative components are set to zero. The result must agree with what Mitsuba's own RGB mode uses.

    python3 core/tools/conductor_table.py && cargo fmt -p photonfarm-core
"""
import pathlib
import re

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)

FOLDER = pathlib.Path(mi.__file__).parent / "data" / "ior"
TARGET = pathlib.Path(__file__).parent.parent / "src" / "material" / "conductors.rs"


def to_rgb(path: pathlib.Path) -> np.ndarray:
    table = np.loadtxt(path)
    wavelengths = np.linspace(360.0, 830.0, 471)
    values = np.interp(wavelengths, table[:, 0], table[:, 1], left=0.0, right=0.0)
    matching = np.array([np.array(mi.cie1931_xyz(w)).ravel() for w in wavelengths])
    xyz = (values[:, None] * matching).sum(axis=0) / matching[:, 1].sum()
    return np.maximum(np.array(mi.xyz_to_srgb(mi.Color3f(*xyz))).ravel(), 0.0)


def reference(material: str) -> dict[str, np.ndarray]:
    parameters = mi.traverse(mi.load_dict({"type": "conductor", "material": material}))
    return {key: np.broadcast_to(np.array(parameters[f"{key}.value"]).ravel(), 3) for key in ("eta", "k")}


def main() -> None:
    names = sorted({re.sub(r"\.(eta|k)\.spd$", "", path.name) for path in FOLDER.glob("*.spd")})
    worst = 0.0
    rows = ['    ("none", [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]),']
    for name in names:
        expected = reference(name)
        row = []
        for key in ("eta", "k"):
            ours = to_rgb(FOLDER / f"{name}.{key}.spd")
            difference = np.abs(ours - expected[key]).max()
            worst = max(worst, difference)
            if difference > 2e-3 * max(1.0, expected[key].max()):
                raise SystemExit(f"{name}.{key}: {ours} but Mitsuba has {expected[key]}")
            row.append("[" + ", ".join(f"{value:.6g}" if "." in f"{value:.6g}" else f"{value:.1f}"
                                       for value in expected[key].astype(float)) + "]")
        rows.append(f'    ("{name}", {row[0]}, {row[1]}),')
    TARGET.write_text(
        "//! Written by `core/tools/conductor_table.py`; do not edit.\n\n"
        "/// Name, real part and imaginary part of the index, in linear Rec. 709.\n"
        "pub(super) const CONDUCTORS: &[(&str, [f32; 3], [f32; 3])] = &[\n" + "\n".join(rows) + "\n];\n"
    )
    print(f"{len(rows)} conductors; largest difference between the two integrations {worst:.2g}")


if __name__ == "__main__":
    main()
