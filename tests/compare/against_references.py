"""Renders scenes made by others, unchanged, and compares them with the pictures that came with them.

Where no picture came with a scene, one method is compared with another.

References are averaged down to our size. A glossy or tiny light leaves a few pixels that no sampling settles, and
edges are filtered differently at another size, so the comparison is of blocks of 4 x 4 pixels, and by medians and
trimmed means: the brightest blocks of the reference (2 %) and all that touch an infinite pixel are left out.
"""

import argparse
import pathlib
import re
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass

import numpy as np

from noise import block_means, luminance
from renderers import Mitsuba, Photonfarm, read_picture

ROOT = pathlib.Path(__file__).resolve().parents[2]
BLOCK = 4
TRIM = 0.02
SEEDS = 3


@dataclass
class Case:
    """One scene rendered by one integrator, and what it must agree with."""

    scene: str
    integrator: str
    iterations: int
    settings: dict
    defines: dict
    # A picture beside the scene (.exr), or another integrator for the scene.
    reference: str
    # Between which bounds the median ratio and the ratio of trimmed means must lie.
    low: float
    high: float
    # Share of blocks that may differ by more than a tenth and three standard errors of ours.
    share: float
    # What is changed in a copy of the scene: "two-sided" or "wide-lamp", or nothing.
    changed: str = ""


# Changes of a scene: a pattern and what takes its place.
CHANGES = {
    # Diffuse surfaces get a second side.
    "two-sided": [
        (
            r'<bsdf type="diffuse" id="(\w+)">(.*?)</bsdf>',
            r'<bsdf type="twosided" id="\1"><bsdf type="diffuse">\2</bsdf></bsdf>',
        )
    ],
    # The lamp of water-caustic, 0.005 x 0.004, becomes 0.8 x 0.8 with about the same power, so that path tracing finds it.
    "wide-lamp": [
        (r'"-0\.0025 (.*?) -0\.002 (.*?)"', r'"-0.4 \1 -0.4 \2"'),
        (r'"541127, 381972, 127324"', r'"17, 12, 4"'),
    ],
}


def cases():
    """The comparisons.

    The two pictures of veach-mis end at two and at three edges. Mitsuba itself is 1.2 % above the picture of
    veach-bidir. The picture of water-caustic comes from a renderer whose diffuse surfaces have two sides; in Mitsuba,
    and here, three of its walls turn their black side to the camera, so a copy of the scene with `twosided` walls is
    compared. It stops at nine edges, and so do we. With a wide lamp path tracing converges, so that photons are held
    against it without a limit of path length.
    """
    mis, bidir, water, torus = "veach-mis/mitsuba", "veach-bidir/mitsuba", "water-caustic/mitsuba", "torus"
    wide, square, table = {"resx": 160, "resy": 90}, {"resx": 128, "resy": 128}, {"width": 128, "height": 96}
    tank = {"width": 128, "height": 128}
    stored, paths = "reference-tungsten.exr", {"samples": 16}
    photons = {"photons": 100_000}
    # Cones are read over a position and an angle at once, so their bias falls more slowly: narrower first bandwidths.
    cones = {"photons": 200_000, "sigma1": 0.015, "theta1": 12}
    return [
        Case(mis, "path", 4, paths, wide | {"max_depth": 2}, stored, 0.99, 1.02, 0.08),
        Case(mis, "path", 4, paths, wide, "scene.exr", 0.99, 1.02, 0.08),
        Case(mis, "pppm", 8, photons, wide, "scene.exr", 0.97, 1.04, 0.15),
        Case(mis, "pcf", 8, photons, wide, "scene.exr", 0.97, 1.04, 0.15),
        Case(bidir, "path", 8, paths, square, stored, 0.98, 1.03, 0.05),
        Case(bidir, "pppm", 8, photons, square, stored, 0.97, 1.04, 0.10),
        Case(bidir, "pcf", 8, photons, square, stored, 0.97, 1.04, 0.10),
        Case(water, "pppm", 8, photons, tank, stored, 0.97, 1.03, 0.02, "two-sided"),
        Case(water, "pppm", 8, photons, tank | {"max_depth": -1}, "path", 0.98, 1.02, 0.05, "wide-lamp"),
        Case(water, "pcf", 4, cones, tank, stored, 0.93, 1.02, 0.17, "two-sided"),
        Case(water, "pcf", 4, cones, tank, "pppm", 0.90, 1.02, 0.13),
        Case(torus, "pppm", 8, photons, table, "path", 0.97, 1.03, 0.10),
        Case(torus, "pcf", 8, photons, table, "pppm", 0.97, 1.03, 0.10),
    ]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help="folder of scenes made by others")
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument(
        "--only",
        default="",
        help="only comparisons whose scene, integrator and reference, set one after the other, contain this",
    )
    parser.add_argument(
        "--quick", action="store_true", help="leaves out what holds one of our own methods against another"
    )
    parser.add_argument("--keep", type=pathlib.Path, help="folder that takes our pictures")
    parser.add_argument("--gain", type=float, default=1, help="brightens our pictures: a check of this test")
    parser.add_argument(
        "--candidate",
        choices=["photonfarm", "mitsuba"],
        default="photonfarm",
        help="`mitsuba` renders the `path` comparisons with Mitsuba: a check of this test",
    )
    return parser.parse_args()


def blocks_of(values, size):
    """Means of blocks of one value per pixel."""
    return block_means(values[None, ..., None], size)[0, ..., 0]


def blocks(picture):
    """Luminance of blocks; infinite where a block touches an infinite pixel."""
    return blocks_of(luminance(picture), BLOCK)


def shrink(picture, height, width):
    """Averages whole squares of pixels down to the size of our pictures."""
    factor = picture.shape[0] // height
    if (height * factor, width * factor) != picture.shape[:2]:
        raise ValueError(f"{picture.shape[:2]} is no multiple of {(height, width)}")
    return block_means(picture[None], factor)[0]


def changed_copy(scene, changes, copy):
    """The scene in a copy of its folder, made once; `changes` are patterns and what takes their place."""
    if not copy.exists():
        shutil.copytree(scene.parent, copy, ignore=shutil.ignore_patterns("*.exr"))
        text = scene.read_text()
        for pattern, replacement in changes:
            text, count = re.subn(pattern, replacement, text, flags=re.DOTALL)
            if count == 0:
                raise ValueError(f"{scene} has nothing of the form {pattern}")
        (copy / scene.name).unlink()
        (copy / scene.name).write_text(text)
    return copy / scene.name


@dataclass
class Finding:
    median: float
    mean: float
    mean_error: float
    share: float


def examine(renders, reference, reference_error):
    """Compares independent renders, by blocks, with a reference of the same size and its standard error."""
    ours = np.stack([blocks(render) for render in renders])
    wanted = blocks(reference)
    usable = np.isfinite(wanted) & (wanted > 1e-3 * np.median(wanted[np.isfinite(wanted)]))
    usable &= wanted <= np.quantile(wanted[usable], 1 - TRIM)
    ours, wanted, reference_error = ours[:, usable], wanted[usable], reference_error[usable]
    mean = ours.mean(0)
    means = ours.mean(1) / wanted.mean()
    error = np.hypot(ours.std(0, ddof=1) / np.sqrt(len(ours)), reference_error)
    share = float((abs(mean - wanted) > 0.1 * wanted + 3 * error).mean())
    return Finding(
        float(np.median(mean / wanted)), float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means))), share
    )


class Suite:
    def __init__(self, options):
        self.options = options
        self.done = {}
        self.scratch = tempfile.TemporaryDirectory()

    def render(self, case, integrator, iterations, settings):
        """Independent renders, made once."""
        key = (case.scene, case.changed, integrator, tuple(case.defines.items()))
        if key not in self.done:
            scene = self.options.folder / case.scene / "scene.xml"
            if not scene.is_file():
                sys.exit(f"error: {scene} is missing")
            if case.changed:
                scene = changed_copy(scene, CHANGES[case.changed], pathlib.Path(self.scratch.name) / case.changed)
            seeds = range(1, 1 + SEEDS)
            if self.options.candidate == "mitsuba":
                samples = iterations * settings["samples"]
                self.done[key] = Mitsuba().renders(scene, case.defines, samples, seeds)
            else:
                name = "-".join(filter(None, [case.scene.split("/")[0], case.changed, integrator]))
                keep = self.options.keep and str(self.options.keep / f"{name}.exr")
                self.done[key] = Photonfarm(self.options.photonfarm).renders(
                    scene, case.defines, integrator, settings, iterations, seeds, keep
                )
        return self.done[key]

    def run(self, case):
        """What one comparison found."""
        renders = self.render(case, case.integrator, case.iterations, case.settings) * self.options.gain
        return examine(renders, *self.reference(case, *renders.shape[1:3]))

    def reference(self, case, height, width):
        """The reference at our size, and the standard error of its blocks."""
        if case.reference.endswith(".exr"):
            picture = shrink(read_picture(self.options.folder / case.scene / case.reference), height, width)
            return picture, np.zeros_like(blocks(picture))
        settings = {"samples": 16} if case.reference == "path" else {"photons": 100_000}
        renders = self.render(case, case.reference, 8, settings)
        error = np.stack([blocks(render) for render in renders]).std(0, ddof=1) / np.sqrt(len(renders))
        return renders.mean(0), error


def main():
    options = arguments()
    suite, failed = Suite(options), []
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    print(
        f"{'scene':24} {'integrator':10} {'against':26} {'median':>7} {'mean (standard error)':>22} {'bounds':>14} "
        f"{'differ':>7} {'limit':>6} {'s':>6}"
    )
    for case in cases():
        name = f"{case.scene} {case.integrator} {case.reference}"
        if options.only not in name or (options.candidate == "mitsuba" and case.integrator != "path"):
            continue
        if options.quick and not case.reference.endswith(".exr"):
            continue
        start = time.monotonic()
        found = suite.run(case)
        good = case.low <= found.median <= case.high and found.share <= case.share
        good &= case.low - 3 * found.mean_error <= found.mean <= case.high + 3 * found.mean_error
        print(
            f"{case.scene:24} {case.integrator:10} {case.reference:26} {found.median:7.4f} "
            f"{f'{found.mean:.4f} ({found.mean_error:.4f})':>22} {f'{case.low:.2f} to {case.high:.2f}':>14} "
            f"{found.share:7.2%} {case.share:6.1%} {time.monotonic() - start:6.1f} {'' if good else 'DIFFERS'}",
            flush=True,
        )
        if not good:
            failed.append(name)
    if failed:
        sys.exit(f"\nerror: beyond bounds: {', '.join(failed)}")
    print("\nAll within bounds.")


if __name__ == "__main__":
    main()
