"""Holds FLIP of `photonfarm compare` against that of its authors (PyPI's flip-evaluator), pixel by pixel.

    python against_flip.py --photonfarm BINARY
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import flip_evaluator
import mitsuba
import numpy
from PIL import Image

# Largest difference of an error that counts as none; errors lie between 0 and 1.
TOLERANCE = 1e-3

mitsuba.set_variant("scalar_rgb")


def patches(generator, height, width, size):
    """Squares of random colours, which have edges and, where they are small, points."""
    colours = generator.random((height // size + 1, width // size + 1, 3))
    return numpy.kron(colours, numpy.ones((size, size, 1)))[:height, :width].astype(numpy.float32)


def write_exr(path, values):
    mitsuba.Bitmap(values).write(str(path))


def compare(photonfarm, picture, reference, error_map):
    command = [photonfarm, "compare", picture, reference, "--json", "--flip", error_map]
    output = subprocess.run(list(map(str, command)), check=True, stdout=subprocess.PIPE, text=True).stdout
    return json.loads(output), numpy.array(mitsuba.Bitmap(str(error_map)).convert(mitsuba.Bitmap.PixelFormat.RGB))[..., 0]


def judge(name, found, theirs):
    mean, error_map = found
    their_map = theirs[..., 0]
    errors = [abs(mean - their_map.mean(dtype=float)), abs(error_map - their_map).max()]
    verdict = "ok" if max(errors) < TOLERANCE else "WRONG"
    print(f"{name:24} {mean:.6f}  mean off by {errors[0]:.1e}, a pixel by {errors[1]:.1e} at most: {verdict}")
    return verdict == "ok"


def ldr(photonfarm, folder, generator, size):
    height, width = 90, 121
    reference = patches(generator, height, width, size)
    picture = numpy.clip(reference + 0.1 * generator.standard_normal(reference.shape), 0, 1)
    paths = [folder / "picture.png", folder / "reference.png"]
    shown = [numpy.round(255 * values).astype(numpy.uint8) for values in (picture, reference)]
    for path, values in zip(paths, shown):
        Image.fromarray(values).save(path)
    report, error_map = compare(photonfarm, *paths, folder / "map.exr")
    assert report["hdr_flip"] is None
    picture, reference = [values.astype(numpy.float32) / 255 for values in shown]
    theirs = flip_evaluator.evaluate(reference, picture, "LDR", inputsRGB=True, applyMagma=False)[0]
    return judge(f"LDR, patches of {size}", (report["flip"], error_map), theirs)


def hdr(photonfarm, folder, generator, size, power):
    reference = (100 * patches(generator, 151, 200, size) ** power).astype(numpy.float32)
    picture = (reference * numpy.exp(0.3 * generator.standard_normal(reference.shape))).astype(numpy.float32)
    paths = [folder / "picture.exr", folder / "reference.exr"]
    for path, values in zip(paths, (picture, reference)):
        write_exr(path, values)
    report, error_map = compare(photonfarm, *paths, folder / "map.exr")
    theirs = flip_evaluator.evaluate(reference, picture, "HDR", applyMagma=False)[0]
    return judge(f"HDR, patches of {size}", (report["hdr_flip"], error_map), theirs)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photonfarm", required=True, type=Path)
    options = parser.parse_args()
    generator = numpy.random.default_rng(7)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        verdicts = [ldr(options.photonfarm, folder, generator, size) for size in (1, 5, 24)]
        verdicts += [hdr(options.photonfarm, folder, generator, size, power) for size, power in ((1, 2), (8, 6))]
    sys.exit(0 if all(verdicts) else 1)


if __name__ == "__main__":
    main()
