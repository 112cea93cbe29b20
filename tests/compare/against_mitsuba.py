"""Tests whether noise explains the difference between `photonfarm render --integrator path` and Mitsuba.

Without FOLDER: the project's own scenes. With it: also the scenes of that folder that are listed below.
"""

import argparse
import pathlib
import sys
import time

import noise
from renderers import Mitsuba, Photonfarm

ROOT = pathlib.Path(__file__).resolve().parents[2]
SIZE = 60
# Mitsuba normalises by the filter weights that fell into the picture, so the outermost pixels mean something else.
BORDER = 2
SAMPLES = 64

# Mitsuba 3 reads no animations, and most BSDFs of the room of lobes are no more.
UNLIKE_MITSUBA = ("motion.xml", "lobes.xml")
# Where not Mitsuba's `path` renders.
INTEGRATORS = {"media.xml": {"integrator": "volpath"}}
OWN_FILES = [path for path in sorted((ROOT / "tests/scenes").glob("*.xml")) if path.name not in UNLIKE_MITSUBA]
OWN = [(path.relative_to(ROOT), {"res": SIZE + 2 * BORDER, **INTEGRATORS.get(path.name, {})}) for path in OWN_FILES]
OWN += [(pathlib.Path("scenes/still-life/scene.xml"), {"width": 100, "height": 68, "integrator": "path"})]
OTHERS = [
    ("cbox/cbox.xml", {"res": SIZE + 2 * BORDER}),
    ("cbox/cbox-rgb.xml", {"res": SIZE + 2 * BORDER}),
    ("veach-mis/mitsuba/scene.xml", {"resx": 100, "resy": 60}),
    ("veach-bidir/mitsuba/scene.xml", {"resx": SIZE + 2 * BORDER, "resy": SIZE + 2 * BORDER}),
    ("torus/scene.xml", {"width": 84, "height": 64}),
]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=pathlib.Path, help="folder of scenes made by others")
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument("--seeds", type=int, default=8, help="independent renders on each side")
    parser.add_argument("--only", default="", help="only scenes whose path contains this")
    parser.add_argument(
        "--candidate",
        choices=["photonfarm", "mitsuba"],
        default="photonfarm",
        help="`mitsuba` compares Mitsuba with itself: a check of this test",
    )
    parser.add_argument("--gain", type=float, default=1, help="brightens the candidate: a check of this test")
    return parser.parse_args()


def scenes(folder):
    """The scenes to compare; a listed scene that is missing is an error."""
    chosen = [(str(name), ROOT / name, defines) for name, defines in OWN]
    if folder:
        chosen += [(name, folder / name, defines) for name, defines in OTHERS]
    for _, path, _ in chosen:
        if not path.is_file():
            sys.exit(f"error: {path} is missing")
    return chosen


def candidate(options, path, defines):
    """Renders with seeds that the other side does not use."""
    seeds = range(1001, 1001 + options.seeds)
    if options.candidate == "mitsuba":
        return Mitsuba().renders(path, defines, SAMPLES, seeds)
    settings = {"samples": 4, "sampling": "independent"}  # as Mitsuba's `independent` sampler
    return Photonfarm(options.photonfarm).renders(path, defines, "path", settings, SAMPLES // 4, seeds)


def print_head(options):
    print(
        f"{options.candidate} against Mitsuba, {options.seeds} renders of {SAMPLES} samples on each side.\n"
        f"Noise alone puts {noise.PIXEL_SHARE:.2%} of the pixels beyond |z| = {noise.PIXEL_Z:g}.\n"
    )
    print(
        f"{'scene':32} {'mean ratio R, G, B (standard error)':42} {'median (s.e.)':14} {'|z|>3':>6} {'limit':>6} "
        f"{'worst pixel':>15} {'block z':>7} {'limit':>5} {'s':>5}"
    )


def print_row(name, verdict, seconds):
    ratios = " ".join(f"{r:.4f}({e:.4f})" for r, e in zip(verdict.ratio, verdict.ratio_error))
    median = f"{verdict.median:.4f}({verdict.median_error:.4f})"
    x, y, z = verdict.worst
    print(
        f"{name:32} {ratios:42} {median:14} {verdict.share:6.2%} {verdict.share_limit:6.2%} "
        f"{f'({x}, {y}) {z:+.1f}':>15} {verdict.block:7.2f} {verdict.block_limit:5.2f} {seconds:5.1f} "
        f"{', '.join(verdict.faults)}",
        flush=True,
    )


def main():
    options = arguments()
    inner = slice(BORDER, -BORDER)
    chosen = [scene for scene in scenes(options.folder) if options.only in scene[0]]
    if not chosen:
        sys.exit(f"error: no scene's path contains {options.only!r}")
    print_head(options)
    failed = []
    for name, path, defines in chosen:
        start = time.monotonic()
        ours = candidate(options, path, defines)[:, inner, inner] * options.gain
        theirs = Mitsuba().renders(path, defines, SAMPLES, range(1, 1 + options.seeds))[:, inner, inner]
        verdict = noise.compare(ours, theirs)
        print_row(name, verdict, time.monotonic() - start)
        if verdict.faults:
            failed.append(name)
    if failed:
        sys.exit(f"\nerror: noise does not explain the difference in {', '.join(failed)}")
    print("\nNoise explains every difference.")


if __name__ == "__main__":
    main()
