"""Samples per second of `path` and `bdpt`, and of Mitsuba's path tracers, on its Cornell box and on its tests of media.

A sample is one camera path; in `bdpt` one light path comes with it. Renders take turns. Prints tables in Markdown.
"""

import argparse
import pathlib
import resource
import statistics
import sys
import time
from dataclasses import dataclass, field

import drjit
import mitsuba

from renderers import Cost, Photonfarm, processor_seconds

ROOT = pathlib.Path(__file__).resolve().parents[2]
THREADS = 2
MEDIA = "mitsuba-tests/tests/scenes/participating_media"


@dataclass
class Case:
    """What both render: `samples` per pixel, of which an iteration of each of our integrators takes as many as its settings say."""

    label: str
    scene: str
    defines: dict
    samples: int
    # Of Mitsuba.
    integrator: str
    ours: dict = field(default_factory=lambda: {"path": {"samples": 4}})


CASES = [
    Case(
        "cbox, 256 x 256, at most 8 edges",
        "cbox/cbox.xml",
        {"res": 256, "max_depth": 8},
        32,
        "path",
        {"path": {"samples": 4}, "bdpt": {"samples": 1, "photons": 256 * 256}},
    ),
    Case("a homogeneous medium", f"{MEDIA}/test_homo_area_light_volpath.xml", {}, 64, "volpath"),
    Case("a lattice", f"{MEDIA}/test_hetero_sigmat_volpath.xml", {"integrator": "volpathmis"}, 64, "volpathmis"),
]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help="folder of scenes made by others")
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument("--renders", type=int, default=5, help="renders of each")
    parser.add_argument("--only", default="", help="only cases whose scene's path contains this")
    return parser.parse_args()


def mitsuba_cost(scene, samples, seed):
    """What Mitsuba took, without loading."""
    wall, processor = time.monotonic(), processor_seconds(resource.RUSAGE_SELF)
    mitsuba.render(scene, spp=samples, seed=seed)
    return Cost(time.monotonic() - wall, processor_seconds(resource.RUSAGE_SELF) - processor)


def compare(options, case):
    path = options.folder / case.scene
    if not path.is_file():
        sys.exit(f"error: {path} is missing")
    loaded, photonfarm = mitsuba.load_file(str(path), **case.defines), Photonfarm(options.photonfarm)
    width, height = loaded.sensors()[0].film().size()
    costs = {"mitsuba": []} | {name: [] for name in case.ours}
    for seed in range(1, 1 + options.renders):
        costs["mitsuba"].append(mitsuba_cost(loaded, case.samples, seed))
        for name, settings in case.ours.items():
            iterations = case.samples // settings["samples"]
            _, cost, _ = photonfarm.measured(path, case.defines, name, settings, iterations, seed, THREADS)
            costs[name].append(cost)
    print(
        f"{case.label}, {case.samples} samples per pixel, {THREADS} threads; millions of samples per second, medians of "
        f"{options.renders} renders in turn, and of their ratios:\n"
    )
    print("| renderer | by the clock | over Mitsuba's | by processor time | over Mitsuba's |")
    print("| --- | --- | --- | --- | --- |")
    for name in costs:
        cells = []
        for kind in ("wall", "processor"):
            seconds, theirs = ([getattr(cost, kind) for cost in costs[which]] for which in (name, "mitsuba"))
            rate = case.samples * width * height / 1e6 / statistics.median(seconds)
            ratio = statistics.median(b / a for a, b in zip(seconds, theirs))
            cells += [f"{rate:.2f}", f"{ratio:.2f}"]
        label = f"Mitsuba `{case.integrator}`" if name == "mitsuba" else f"`{name}`"
        print(f"| {label} | {' | '.join(cells)} |")
    print()


def main():
    options = arguments()
    drjit.set_thread_count(THREADS)
    for case in CASES:
        if options.only in case.scene:
            compare(options, case)


if __name__ == "__main__":
    main()
