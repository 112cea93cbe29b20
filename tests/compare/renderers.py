"""Renders scenes with Photonfarm and with Mitsuba."""

import json
import os
import resource
import subprocess
import tempfile
from dataclasses import dataclass

import mitsuba
import numpy as np

mitsuba.set_variant("scalar_rgb")


def read_channels(path, names):
    """Channels of an OpenEXR file by their names, as (height, width, len(names)) doubles."""
    bitmap = mitsuba.Bitmap(str(path))
    there = [channel.name for channel in bitmap.struct_()]
    pixels = np.array(bitmap, dtype=np.float64)
    return np.stack([pixels[..., there.index(name)] for name in names], axis=-1)


def read_picture(path):
    """Linear RGB of an OpenEXR file, as (height, width, 3) doubles."""
    return read_channels(path, "RGB")


def processor_seconds(who):
    """User and system time so far of this process or of its children that have ended (`resource.RUSAGE_...`)."""
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


@dataclass
class Cost:
    """Seconds that a render took, by the clock and of all its threads' processor time."""

    wall: float
    processor: float


class Mitsuba:
    """Mitsuba's scalar RGB variant, with the scene's own integrator."""

    name = "mitsuba"

    def renders(self, scene, defines, samples, seeds, integrator=None):
        """One picture per seed."""
        loaded = mitsuba.load_file(str(scene), **defines)
        chosen = mitsuba.load_dict(integrator) if integrator else loaded.integrator()
        pictures = [
            np.array(mitsuba.render(loaded, integrator=chosen, spp=samples, seed=seed), dtype=np.float64)[..., :3]
            for seed in seeds
        ]
        return np.stack(pictures)


class Photonfarm:
    """The command line, one process per picture."""

    name = "photonfarm"

    def __init__(self, binary):
        self.binary = str(binary)

    def renders(self, scene, defines, integrator, settings, iterations, seeds, keep=None):
        """One picture per seed; `keep` names a file where the last one stays, with its PNG."""
        pictures = []
        with tempfile.TemporaryDirectory() as folder:
            for seed in seeds:
                out = keep if keep and seed == seeds[-1] else os.path.join(folder, "picture.exr")
                self.run(scene, out, defines, integrator, settings, iterations, seed)
                pictures.append(read_picture(out))
        return np.stack(pictures)

    def measured(self, scene, defines, integrator, settings, iterations, seed, threads):
        """One picture, what it took, and the first and the last radius (None where there is none).

        Wall-clock seconds are those of the render without loading; processor seconds are those of the whole process.
        """
        with tempfile.TemporaryDirectory() as folder:
            out, stats = os.path.join(folder, "picture.exr"), os.path.join(folder, "stats.json")
            before = processor_seconds(resource.RUSAGE_CHILDREN)
            options = ["--threads", str(threads), "--stats", stats]
            self.run(scene, out, defines, integrator, settings, iterations, seed, options)
            processor = processor_seconds(resource.RUSAGE_CHILDREN) - before
            with open(stats) as file:
                told = json.load(file)
            cost = Cost(told["wall_seconds"] - told["load_seconds"], processor)
            return read_picture(out), cost, (told["bandwidth"] or {}).get("sigma")

    def run(self, scene, out, defines, integrator, settings, iterations, seed, options=()):
        """Runs the command and raises what it wrote if it fails."""
        command = [self.binary, "render", str(scene), "-o", out, "--integrator", integrator]
        command += ["--iterations", str(iterations), "--seed", str(seed), *options]
        for name, value in defines.items():
            command += ["-D", f"{name}={value}"]
        for name, value in settings.items():
            command += ["--set", f"{name}={value}"]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{' '.join(command)}\nended with status {done.returncode}\n{done.stdout}")
