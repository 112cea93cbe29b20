"""Holds layers of what is seen first against Mitsuba's integrator `aov`, pixel by pixel.

Each side renders every scene with several seeds. Where both means of a pixel have the same expected value, their difference over its
standard error lies beyond 5 for less than one pixel in ten thousand (Student's t, 14 degrees of freedom), and edges, where few rays
decide, are a little worse: one pixel in two hundred may lie there. A value without noise, such as the albedo of a matt wall, must be
the same but for rounding.

Mitsuba's albedo is that of matt surfaces alone, so that albedo is compared where there are no others. Its normals are not turned to the
camera; ours are, ray by ray, so that normals are compared where one surface fills the pixel.
"""

import argparse
import pathlib
import sys
import tempfile

import mitsuba
import numpy as np

from renderers import Photonfarm, read_channels

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENES = ["diffuse-box", "environment"]
MATT = ["diffuse-box"]
SEEDS = 8
SAMPLES = 64
SIZE = 32
# Our layer and its channels, and Mitsuba's name for it.
LAYERS = {
    "albedo": ("RGB", "albedo"),
    "normal": ("XYZ", "sh_normal"),
    "depth": ("Z", "depth"),
    "position": ("XYZ", "position"),
}
MOST_Z = 5
MOST_OUTSIDE = 1 / 200
# Length of a pixel's mean normal from which on one flat surface fills it.
FLAT = 0.999


def ours(photonfarm, scene, seed):
    """The layers of one render, each as (height, width, channels)."""
    options = [option for layer in LAYERS for option in ("--layer", layer)]
    with tempfile.TemporaryDirectory() as folder:
        out = str(pathlib.Path(folder) / "layers.exr")
        photonfarm.run(scene, out, {"res": SIZE}, "path", {"samples": 1}, SAMPLES, seed, options)
        take = lambda layer, letters: read_channels(out, [f"{layer}.{letter}" for letter in letters])
        return {layer: take(layer, letters) for layer, (letters, _) in LAYERS.items()}


def theirs(scene, seed):
    """The same by Mitsuba, with normals turned to the camera."""
    loaded = mitsuba.load_file(str(scene), res=str(SIZE))
    asked = ",".join(f"{layer}:{name}" for layer, (_, name) in LAYERS.items())
    integrator = mitsuba.load_dict({"type": "aov", "aovs": asked})
    pixels = np.array(mitsuba.render(loaded, integrator=integrator, spp=SAMPLES, seed=seed), dtype=np.float64)
    found, first = {}, pixels.shape[-1] - sum(len(letters) for letters, _ in LAYERS.values())
    for layer, (letters, _) in LAYERS.items():
        found[layer] = pixels[..., first : first + len(letters)]
        first += len(letters)
    eye = np.array(loaded.sensors()[0].world_transform().translation()).ravel()
    away = ((found["position"] - eye) * found["normal"]).sum(-1) > 0
    found["normal"][away] *= -1
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument("--gain", type=float, default=1, help="multiplies our layers: a check of this test")
    options = parser.parse_args()
    photonfarm, failed = Photonfarm(options.photonfarm), []
    print(f"{'scene':16} {'layer':10} {'beyond':>8} {'limit':>8} {'mean':>10} {'mean of Mitsuba':>16}")
    for name in SCENES:
        scene = ROOT / f"tests/scenes/{name}.xml"
        first = [ours(photonfarm, scene, seed) for seed in range(1, 1 + SEEDS)]
        second = [theirs(scene, seed) for seed in range(1, 1 + SEEDS)]
        for layer in LAYERS:
            if layer == "albedo" and name not in MATT:
                continue
            a = np.stack([render[layer] for render in first]) * options.gain
            b = np.stack([render[layer] for render in second])
            error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / SEEDS)
            rounding = 1e-4 * np.abs(b).max()
            outside = (np.abs(a.mean(0) - b.mean(0)) > MOST_Z * error + rounding).any(-1)
            if layer == "normal":
                outside = outside[np.linalg.norm(b.mean(0), axis=-1) > FLAT]
            outside = outside.mean()
            good = outside <= MOST_OUTSIDE
            print(
                f"{name:16} {layer:10} {outside:8.2%} {MOST_OUTSIDE:8.2%} {np.abs(a).mean():10.4f} {np.abs(b).mean():16.4f} "
                f"{'' if good else 'DIFFERS'}",
                flush=True,
            )
            if not good:
                failed.append(f"{name} {layer}")
    if failed:
        sys.exit(f"\nerror: noise does not explain the difference in {', '.join(failed)}")
    print("\nNoise explains every difference.")


if __name__ == "__main__":
    main()
