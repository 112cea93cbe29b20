"""Noise and time of vertex connection and merging, here and in LuxCore, on the scene water-caustic.

The measure is relMSE x seconds: halving the error or the time halves it. Each renderer's variance is taken about its
own mean, over independent renders, so that a bias of the mean does not count. Renders take turns, so that both meet
the same machine. Prints a table in Markdown.
"""

import argparse
import json
import math
import pathlib
import pickle
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field

import mitsuba
import numpy as np

import noise
from against_references import CHANGES, ROOT, changed_copy
from renderers import Cost, Photonfarm

HERE = pathlib.Path(__file__).resolve().parent
SCENE = "water-caustic/mitsuba/scene.xml"
SIZE = 256
THREADS = 2
# Camera paths per pixel.
SAMPLES = 8
# As many light paths per iteration as camera paths.
LIGHT_PATHS = SIZE * SIZE
# Added to the squared mean, which is about 0.02 for the whole picture, so that black pixels do not decide.
FLOOR = 0.01
# LuxCore's defaults: light paths of one pass of one thread, first radius over that of the bounding sphere, and alpha.
LUXCORE_LIGHT_PATHS, LUXCORE_RADIUS_SCALE, LUXCORE_ALPHA = 16384, 0.003, 0.95
# Photonfarm's default.
ALPHA = 2 / 3
# A pixel this bright shows the lamp, of radiance 541,127: in 8 samples of 6 renders one hit makes it 11,000.
LAMP = 1000
# LuxCore's surfaces have two sides, and without a filter each of its samples counts for the pixel in which it lies.
SAME_AS_LUXCORE = [*CHANGES["two-sided"], (r'<rfilter type="tent"/>', '<rfilter type="box"/>')]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help=f"folder of scenes made by others, with {SCENE}")
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument("--renders", type=int, default=6, help="independent renders of each row, at least 2")
    parser.add_argument("--keep", type=pathlib.Path, help="folder that takes the mean of each row as a PNG")
    options = parser.parse_args()
    if options.renders < 2:
        parser.error("--renders: a variance takes at least 2")
    return options


def describe_shape(shape):
    """What `luxcore.py` needs of a shape: its triangles, and what it reflects, refracts or emits."""
    vertices, bsdf = range(shape.vertex_count()), shape.bsdf()
    parameters = mitsuba.traverse(bsdf)
    described = {
        "positions": vectors(shape.vertex_position(i) for i in vertices),
        "normals": vectors(shape.vertex_normal(i) for i in vertices) if shape.has_vertex_normals() else None,
        "faces": [tuple(int(i) for i in shape.face_indices(face)) for face in range(shape.face_count())],
    }
    if mitsuba.has_flag(bsdf.flags(), mitsuba.BSDFFlags.DeltaTransmission):
        described["eta"] = float(parameters["eta"])
    else:
        described["reflectance"] = rgb(parameters, "reflectance.value")
    if shape.is_emitter():
        described["radiance"] = rgb(mitsuba.traverse(shape.emitter()), "radiance.value")
    return described


def vectors(values):
    """Tuples of floats, as LuxCore takes them."""
    return [tuple(float(x) for x in value) for value in values]


def rgb(parameters, name):
    """A parameter's three values; the name may have a prefix, as in a `twosided` material."""
    (key,) = {key for key in parameters.keys() if key.endswith(name)} - {f"brdf_1.{name}"}
    return [float(x) for x in np.ravel(parameters[key])]


def describe(scene):
    """The scene as `luxcore.py` reads it."""
    loaded = mitsuba.load_file(str(scene), width=SIZE, height=SIZE, optimize=False)
    camera = mitsuba.traverse(loaded.sensors()[0])
    to_world = np.array(camera["to_world"].matrix, dtype=float)
    origin, forward, up = to_world[:3, 3], to_world[:3, 2], to_world[:3, 1]
    view = {"origin": origin, "target": origin + forward, "up": up}
    view = {name: vector.tolist() for name, vector in view.items()} | {"fov": float(camera["x_fov"])}
    return {"size": SIZE, "camera": view, "shapes": [describe_shape(shape) for shape in loaded.shapes()]}


def scene_radius(description):
    """Half the diagonal of the scene's bounding box, to which LuxCore's first radius is relative."""
    positions = np.concatenate([shape["positions"] for shape in description["shapes"]])
    return float(np.linalg.norm(np.ptp(positions, axis=0)) / 2)


def alpha_radius(first, alpha, iteration):
    """Radius of an iteration, from 1 on, where it shrinks as in LuxCore."""
    return first * iteration ** (-(1 - alpha) / 2)


class LuxCore:
    """One process per picture."""

    def __init__(self, description, folder):
        self.scene, self.picture = folder / "scene.pickle", folder / "picture.npy"
        self.scene.write_bytes(pickle.dumps(description))
        self.scene_radius = scene_radius(description)

    def measured(self, seed, light_paths, radius, alpha):
        """One picture, what it took, and the first and the last radius."""
        values = {
            "native.threads.count": THREADS,
            "bidirvm.lightpath.count": light_paths,
            "bidirvm.startradius.scale": radius / self.scene_radius,
            "bidirvm.alpha": alpha,
        }
        command = [sys.executable, "-B", HERE / "luxcore.py", self.scene, self.picture, seed, SAMPLES]
        command = [str(part) for part in command] + [f"{name}={value}" for name, value in values.items()]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{' '.join(command)}\nended with status {done.returncode}\n{done.stdout}{done.stderr}")
        told = json.loads(done.stdout.splitlines()[-1])
        passes = math.ceil(told["samples"] * SIZE * SIZE / (light_paths * THREADS))
        radii = radius, alpha_radius(radius, alpha, passes)
        return np.load(self.picture).astype(np.float64), Cost(told["wall"], told["processor"]), radii


@dataclass
class Row:
    """One renderer with one choice of radii, and its renders."""

    name: str
    light_paths: int
    render: callable
    pictures: list = field(default_factory=list)
    costs: list = field(default_factory=list)
    radii: tuple = ()

    def go(self, seed):
        picture, cost, self.radii = self.render(seed)
        self.pictures.append(picture)
        self.costs.append(cost)

    def summary(self):
        """relMSE by noise alone, its standard error, and mean seconds by the clock and of processor time."""
        value, error = noise.relative_variance(np.stack(self.pictures), FLOOR)
        wall = float(np.mean([cost.wall for cost in self.costs]))
        processor = float(np.mean([cost.processor for cost in self.costs]))
        return value, error, wall, processor

    def mean(self):
        """Mean of pixels and channels but for those in which a camera ray hit the lamp itself, which is rare."""
        mean = np.mean(self.pictures, 0)
        return mean[mean.max(-1) < LAMP].mean()


def make_rows(options, scene, luxcore):
    """Both with the defaults of each, then each with the other's radius and its shrinking."""
    photonfarm = Photonfarm(options.photonfarm)
    ours_defines = {"width": SIZE, "height": SIZE, "max_depth": -1}

    def ours(seed, **settings):
        settings |= {"photons": LIGHT_PATHS, "samples": 1}
        return photonfarm.measured(scene, ours_defines, "vcm", settings, SAMPLES, seed, THREADS)

    theirs = luxcore.scene_radius * LUXCORE_RADIUS_SCALE
    default = Row("Photonfarm", LIGHT_PATHS, ours)
    return [
        default,
        Row(
            "LuxCore",
            LUXCORE_LIGHT_PATHS,
            lambda seed: luxcore.measured(seed, LUXCORE_LIGHT_PATHS, theirs, LUXCORE_ALPHA),
        ),
        Row(
            "Photonfarm, LuxCore's radius",
            LIGHT_PATHS,
            lambda seed: ours(seed, sigma1=theirs, alpha=LUXCORE_ALPHA),
        ),
        Row(
            "LuxCore, Photonfarm's radius and light paths",
            LIGHT_PATHS,
            lambda seed: luxcore.measured(seed, LIGHT_PATHS, default.radii[0], ALPHA),
        ),
    ]


def print_table(rows):
    print(
        "| renderer | light paths | radius, first to last | relMSE (standard error) | s, clock | s, processor "
        "| relMSE x s, clock | relMSE x s, processor | mean |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for row in rows:
        value, error, wall, processor = row.summary()
        first, last = row.radii
        print(
            f"| {row.name} | {row.light_paths:,} | {first:.4f} to {last:.4f} | {value:.4f} ({error:.4f}) | {wall:.1f} "
            f"| {processor:.1f} | {value * wall:.2f} | {value * processor:.2f} | {row.mean():.4f} |"
        )
    print()
    ours, luxcore, ours_narrow, luxcore_wide = (row.summary() for row in rows)
    for what, a, b in [
        ("the defaults of each", ours, luxcore),
        ("LuxCore's radius", ours_narrow, luxcore),
        ("Photonfarm's radius", ours, luxcore_wide),
    ]:
        clock, processor = a[0] * a[2] / (b[0] * b[2]), a[0] * a[3] / (b[0] * b[3])
        print(
            f"- With {what}, Photonfarm's product over LuxCore's: {clock:.2f} by the clock, "
            f"{processor:.2f} by processor time."
        )


def main():
    options = arguments()
    original = options.folder / SCENE
    if not original.is_file():
        sys.exit(f"error: {original} is missing")
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        scene = changed_copy(original, SAME_AS_LUXCORE, scratch / "scene")
        rows = make_rows(options, scene, LuxCore(describe(scene), scratch))
        for seed in range(1, 1 + options.renders):
            for row in rows:
                row.go(seed)
    print(
        f"water-caustic, {SIZE} x {SIZE}, {SAMPLES} camera paths per pixel, {THREADS} threads, "
        f"{options.renders} renders of each row in turn:\n"
    )
    print_table(rows)
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
        for i, row in enumerate(rows):
            picture = mitsuba.Bitmap(np.mean(row.pictures, 0).astype(np.float32))
            mitsuba.util.write_bitmap(str(options.keep / f"{i + 1}.png"), picture)


if __name__ == "__main__":
    main()
