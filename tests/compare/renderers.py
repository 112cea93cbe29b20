"""Renders scenes with Photonfarm and with Mitsuba."""

import os
import subprocess
import tempfile

import mitsuba
import numpy as np

mitsuba.set_variant("scalar_rgb")


def read_picture(path):
    """Linear RGB of an OpenEXR file, as (height, width, 3) doubles."""
    bitmap = mitsuba.Bitmap(str(path))
    names = [channel.name for channel in bitmap.struct_()]
    pixels = np.array(bitmap, dtype=np.float64)
    return np.stack([pixels[..., names.index(name)] for name in "RGB"], axis=-1)


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
                command = [self.binary, "render", str(scene), "-o", out, "--integrator", integrator]
                command += ["--iterations", str(iterations), "--seed", str(seed)]
                for name, value in defines.items():
                    command += ["-D", f"{name}={value}"]
                for name, value in settings.items():
                    command += ["--set", f"{name}={value}"]
                done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
                if done.returncode != 0:
                    raise RuntimeError(f"{' '.join(command)}\nended with status {done.returncode}\n{done.stdout}")
                pictures.append(read_picture(out))
        return np.stack(pictures)
