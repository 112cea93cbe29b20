"""Samples per second of `path` and `bdpt`, and of Mitsuba's path tracer, on its Cornell box.

A sample is one camera path; in `bdpt` one light path comes with it. Renders take turns. Prints a table in Markdown.
"""

import argparse
import pathlib
import resource
import statistics
import sys
import time

import drjit
import mitsuba

from renderers import Cost, Photonfarm, processor_seconds

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENE = "cbox/cbox.xml"
SIZE = 256
DEPTH = 8
THREADS = 2
# Per pixel.
SAMPLES = 32
# An iteration of each integrator takes `samples` per pixel.
INTEGRATORS = {"path": {"samples": 4}, "bdpt": {"samples": 1, "photons": SIZE * SIZE}}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help=f"folder of scenes made by others, with {SCENE}")
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument("--renders", type=int, default=5, help="renders of each")
    return parser.parse_args()


def mitsuba_cost(scene, seed):
    """What Mitsuba's own path tracer took, without loading."""
    wall, processor = time.monotonic(), processor_seconds(resource.RUSAGE_SELF)
    mitsuba.render(scene, spp=SAMPLES, seed=seed)
    return Cost(time.monotonic() - wall, processor_seconds(resource.RUSAGE_SELF) - processor)


def main():
    options = arguments()
    path = options.folder / SCENE
    if not path.is_file():
        sys.exit(f"error: {path} is missing")
    drjit.set_thread_count(THREADS)
    defines = {"res": SIZE, "max_depth": DEPTH}
    loaded, photonfarm = mitsuba.load_file(str(path), **defines), Photonfarm(options.photonfarm)
    costs = {"mitsuba": []} | {name: [] for name in INTEGRATORS}
    for seed in range(1, 1 + options.renders):
        costs["mitsuba"].append(mitsuba_cost(loaded, seed))
        for name, settings in INTEGRATORS.items():
            iterations = SAMPLES // settings["samples"]
            _, cost, _ = photonfarm.measured(path, defines, name, settings, iterations, seed, THREADS)
            costs[name].append(cost)
    print(
        f"cbox, {SIZE} x {SIZE}, {SAMPLES} samples per pixel, at most {DEPTH} edges, {THREADS} threads; millions of "
        f"samples per second, medians of {options.renders} renders in turn, and of their ratios:\n"
    )
    print("| renderer | by the clock | over Mitsuba's | by processor time | over Mitsuba's |")
    print("| --- | --- | --- | --- | --- |")
    for name, label in {"mitsuba": "Mitsuba `path`", "path": "`path`", "bdpt": "`bdpt`"}.items():
        cells = []
        for kind in ("wall", "processor"):
            seconds, theirs = ([getattr(cost, kind) for cost in costs[which]] for which in (name, "mitsuba"))
            rate = SAMPLES * SIZE * SIZE / 1e6 / statistics.median(seconds)
            ratio = statistics.median(b / a for a, b in zip(seconds, theirs))
            cells += [f"{rate:.2f}", f"{ratio:.2f}"]
        print(f"| {label} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
