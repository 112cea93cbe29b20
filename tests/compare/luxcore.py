"""Renders one picture with LuxCore's vertex connection and merging, in a process of its own.

LuxCore and Mitsuba cannot be loaded into one process, so the meshes arrive in a file:

    luxcore.py SCENE.pickle PICTURE.npy SEED SAMPLES [PROPERTY=VALUE]...

SAMPLES is per pixel. PICTURE is linear RGB, (height, width, 3). Prints one JSON object: what the render took, without
loading, building the ray tracing hierarchy and reading the picture.
"""

import json
import os
import pickle
import resource
import sys
import time

import numpy as np
import pyluxcore

# Seconds between questions whether LuxCore is done.
POLL = 0.05
# Edges of a camera path and of a light path: roulette ends nearly all before, so this is no limit that shows.
DEPTH = 32


def properties(values):
    """LuxCore's properties from names and values; a tuple holds the parts of a vector."""
    result = pyluxcore.Properties()
    for name, value in values.items():
        parts = value if isinstance(value, (list, tuple)) else [value]
        result.SetFromString(f"{name} = {' '.join(str(part) for part in parts)}\n")
    return result


def material(name, shape):
    """Diffuse surfaces have two sides in LuxCore; a lamp shines from its front."""
    base = f"scene.materials.{name}"
    if "eta" in shape:
        values = {"type": "glass", "kr": (1, 1, 1), "kt": (1, 1, 1), "interiorior": shape["eta"], "exteriorior": 1}
    else:
        values = {"type": "matte", "kd": shape["reflectance"]}
    if "radiance" in shape:
        values["emission"] = shape["radiance"]
    return {f"{base}.{key}": value for key, value in values.items()}


def build(description):
    """The scene, from what `against_luxcore.py` writes."""
    scene = pyluxcore.Scene()
    camera = description["camera"]
    values = {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": camera["origin"],
        "scene.camera.lookat.target": camera["target"],
        "scene.camera.up": camera["up"],
        "scene.camera.fieldofview": camera["fov"],
    }
    scene.Parse(properties(values))
    for i, shape in enumerate(description["shapes"]):
        scene.Parse(properties(material(f"material{i}", shape)))
        scene.DefineMesh(f"mesh{i}", shape["positions"], shape["faces"], shape["normals"], None, None, None)
        scene.Parse(properties({f"scene.objects.{i}.shape": f"mesh{i}", f"scene.objects.{i}.material": f"material{i}"}))
    return scene


def configuration(description, seed, samples):
    """LuxCore's settings, without a filter and without a tone curve; the command line may change any."""
    return {
        "renderengine.type": "BIDIRVMCPU",
        "renderengine.seed": seed,
        "sampler.type": "RANDOM",
        # One pixel a time: in larger buckets a short render leaves stripes of the picture without samples.
        "sampler.random.bucketsize": 1,
        "sampler.random.adaptive.strength": 0,
        "path.maxdepth": DEPTH,
        "light.maxdepth": DEPTH,
        "batch.haltspp": samples,
        "film.width": description["size"],
        "film.height": description["size"],
        "film.filter.type": "NONE",
        "film.imagepipelines.0.0.type": "NOP",
        "film.outputs.0.type": "RGB_IMAGEPIPELINE",
        "film.outputs.0.filename": "unused.exr",
    }


def processor_seconds():
    """User and system time of all threads so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main():
    scene_file, picture_file, seed, samples, *changes = sys.argv[1:]
    with open(scene_file, "rb") as file:
        description = pickle.load(file)
    pyluxcore.Init(lambda message: None)
    values = configuration(description, seed, samples) | dict(change.split("=") for change in changes)
    session = pyluxcore.RenderSession(pyluxcore.RenderConfig(properties(values), build(description)))
    session.Start()
    wall, processor = time.monotonic(), processor_seconds()
    # LuxCore notices that it has enough samples only when it is asked for its statistics.
    while not session.HasDone():
        time.sleep(POLL)
        session.UpdateStats()
    wall, processor = time.monotonic() - wall, processor_seconds() - processor
    passes = session.GetStats().Get("stats.renderengine.pass").GetInt()
    session.Stop()
    size = description["size"]
    pixels = np.zeros(size * size * 3, np.float32)
    session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB_IMAGEPIPELINE, pixels, 0, True)
    np.save(picture_file, pixels.reshape(size, size, 3)[::-1])
    print(json.dumps({"wall": wall, "processor": processor, "samples": passes}), flush=True)
    # LuxCore's destructors crash now and then when the interpreter ends.
    os._exit(0)


if __name__ == "__main__":
    main()
