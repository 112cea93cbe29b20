"""Holds Cryptomatte layers against what Mitsuba's rays hit, and reads them as a compositor does.

The file is read by the OpenEXR library, the ids of names are hashed by the package mmh3, and the matte of an object is the sum of the
coverage of its id over the ranks. Mitsuba says which shape the rays through a grid of points in each pixel hit first: the share of these that
hit the object is the same matte. Both are means over some hundred points spread evenly over the pixel, so that they differ along
edges alone, by the length of an edge over the spacing of points.

A window of the picture (`--crop`) is to lie at its place in the display window, with the pixels of the whole picture.
"""

import argparse
import json
import pathlib
import struct
import sys
import tempfile

import mitsuba
import mmh3
import numpy as np
import OpenEXR

from renderers import Photonfarm

ROOT = pathlib.Path(__file__).resolve().parents[2]
SIZE = 24
# Points of the grid along a side of a pixel.
GRID = 12
WINDOW = (5, 3, 12, 16)
# Of one pixel, and of the mean over all.
MOST_APART = 0.1
MOST_APART_ON_AVERAGE = 0.004
# Shapes by id, with the id of their material.
SHAPES = {"floor": "grey", "größer": "red", "box": "red", "rod": "grey"}
SCENE = f"""<scene version="3.0.0">
    <integrator type="path"/>
    <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="1, 2, 5" target="0, 0.4, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/>
            <rfilter type="box"/></film></sensor>
    <bsdf type="diffuse" id="grey"/>
    <bsdf type="twosided" id="red"><bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.1, 0.1"/></bsdf></bsdf>
    <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="1.6"/></transform>
        <ref id="grey"/></shape>
    <shape type="sphere" id="größer"><point name="center" x="-0.5" y="0.6" z="0"/><float name="radius" value="0.6"/><ref id="red"/></shape>
    <shape type="cube" id="box"><transform name="to_world"><scale value="0.4"/><rotate y="1" angle="30"/>
        <translate x="0.7" y="0.4" z="0.4"/></transform><ref id="red"/></shape>
    <shape type="cylinder" id="rod"><point name="p0" x="-1.5" y="0.2" z="1"/><point name="p1" x="1.5" y="1.4" z="0.8"/>
        <float name="radius" value="0.03"/><ref id="grey"/></shape>
    <emitter type="constant"/>
</scene>"""


def matte_id(name):
    """The id of a name, and it as a number of the file."""
    bits = mmh3.hash(name.encode(), 0, signed=False)
    if bits >> 23 & 0xFF in (0, 0xFF):
        bits ^= 1 << 23
    return f"{bits:08x}", struct.unpack("<f", struct.pack("<I", bits))[0]


def read(path):
    """Header and channels of a file."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = dict(file.header())
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    return header, channels


def mattes(header, channels, layer):
    """The matte of each name of a layer, by what the header says of it."""
    key = f"cryptomatte/{matte_id(layer)[0][:7]}"
    assert header[f"{key}/name"] == layer, header
    assert header[f"{key}/hash"] == "MurmurHash3_32"
    assert header[f"{key}/conversion"] == "uint32_to_float32"
    found = {}
    ranks = [(number, letters) for number in range(3) for letters in ("RG", "BA")]
    for name, text in json.loads(header[f"{key}/manifest"]).items():
        assert text == matte_id(name)[0], (name, text)
        number = np.float32(matte_id(name)[1])
        pairs = [[channels[f"{layer}{rank:02}.{letter}"] for letter in letters] for rank, letters in ranks]
        assert all(ids.dtype == np.float32 for ids, _ in pairs)
        found[name] = sum(np.where(ids == number, coverage, 0) for ids, coverage in pairs)
    return found


def hit(path):
    """The share of each shape's hits in each pixel."""
    scene = mitsuba.load_file(str(path))
    sensor = scene.sensors()[0]
    found = {shape.id(): np.zeros((SIZE, SIZE)) for shape in scene.shapes()}
    steps = (np.arange(SIZE * GRID) + 0.5) / (SIZE * GRID)
    for row, y in enumerate(steps):
        for column, x in enumerate(steps):
            ray, _ = sensor.sample_ray(0, 0.5, mitsuba.Point2f(x, y), mitsuba.Point2f(0.5))
            surface = scene.ray_intersect(ray)
            if surface.is_valid():
                found[surface.shape.id()][row // GRID, column // GRID] += 1 / GRID**2
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument("--shift", type=int, default=0, help="shifts our mattes by so many pixels: a check of this test")
    options = parser.parse_args()
    photonfarm, layers = Photonfarm(options.photonfarm), ["cryptomatte:object", "cryptomatte:material", "alpha", "samples"]
    asked = [option for layer in layers for option in ("--layer", layer)]
    with tempfile.TemporaryDirectory() as folder:
        scene, out = pathlib.Path(folder) / "scene.xml", pathlib.Path(folder) / "mattes.exr"
        scene.write_text(SCENE)
        photonfarm.run(scene, str(out), {}, "path", {"samples": 1}, GRID**2, 1, asked)
        header, channels = read(out)
        x, y, width, height = WINDOW
        photonfarm.run(scene, str(out), {}, "path", {"samples": 1}, GRID**2, 1, asked + ["--crop", f"{x},{y},{width}x{height}"])
        part_header, part = read(out)
        truth = hit(scene)
    objects, materials = mattes(header, channels, "CryptoObject"), mattes(header, channels, "CryptoMaterial")
    assert set(objects) == set(SHAPES) and set(materials) == set(SHAPES.values()), (objects.keys(), materials.keys())
    of_material = lambda material: sum(truth[shape] for shape, made_of in SHAPES.items() if made_of == material)
    pairs = [(name, matte, truth[name]) for name, matte in objects.items()]
    pairs += [(name, matte, of_material(name)) for name, matte in materials.items()]
    failed = []
    print(f"{'matte':10} {'mean':>8} {'Mitsuba':>8} {'apart at most':>14} {'on average':>11}")
    for name, matte, expected in pairs:
        apart = np.abs(np.roll(matte, options.shift, 1) - expected)
        good = apart.max() <= MOST_APART and apart.mean() <= MOST_APART_ON_AVERAGE
        print(
            f"{name:10} {matte.mean():8.4f} {expected.mean():8.4f} {apart.max():14.4f} {apart.mean():11.5f} "
            f"{'' if good else 'DIFFERS'}"
        )
        if not good:
            failed.append(name)
    covered = sum(objects.values())
    assert (covered <= channels["A"] + 1e-6).all() and (covered >= channels["A"] - MOST_APART).all()
    assert (channels["samples.Y"] == GRID**2).all()
    window, display = part_header["dataWindow"], part_header["displayWindow"]
    assert [tuple(corner) for corner in window] == [(x, y), (x + width - 1, y + height - 1)], window
    assert [tuple(corner) for corner in display] == [(0, 0), (SIZE - 1, SIZE - 1)], display
    for name, pixels in channels.items():
        inside = pixels[y : y + height, x : x + width]
        assert (part[name].view(np.uint32) == inside.view(np.uint32)).all(), f"{name} of the window differs"
    if failed:
        sys.exit(f"\nerror: points do not explain the difference of {', '.join(failed)}")
    print("\nMattes are what is seen.")


if __name__ == "__main__":
    main()
