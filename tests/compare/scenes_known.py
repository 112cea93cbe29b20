"""What is known about scenes that others made: where file and picture, or two files of one scene, are not of the same scene."""

import re
from dataclasses import dataclass

# Why a picture cannot tell whether its scene is rendered as the file says, by the end of the file's path.
UNLIKE = {
    "test_texturedprincipled1_path.xml": "Mitsuba 3 swaps the two colours of a checkerboard where a number is looked up",
    "classroom/mitsuba/scene_v0.6.xml": "the picture's sky and sun are Tungsten's, the file's are Mitsuba's `sunsky`",
    "classroom/pbrt/scene-v4.pbrt": "the file lacks the albedos 0.47 and 0.75 of window frames and chairs, which the picture has",
    "cornell-box/pbrt/scene-v4.pbrt": "the file asks for 5 edges a path, the picture has 65",
    "water-caustic/mitsuba/scene.xml": "walls turn their black side to the camera, in the picture all surfaces have two sides",
}

# The sky and the sun of the pbrt file, which are those of the picture.
LIGHTS = (
    r'(?s)<emitter type="sunsky" >.*?</emitter>',
    '<emitter type="envmap"><string name="filename" value="../pbrt/textures/Skydome.pfm"/>'
    '<string name="mapping" value="equalarea"/>'
    '<transform name="toWorld"><matrix value="-1 0 0 0 0 0 1 0 0 -1 0 0 0 0 0 1"/></transform></emitter>'
    '<emitter type="directional"><vector name="direction" x="0.865804" y="-0.416766" z="0.276929"/>'
    '<rgb name="irradiance" value="10, 10, 10"/></emitter>',
)
METALS = (r"0\.471008, 0\.471008, 0\.471008|0\.751534, 0\.751534, 0\.751534", "1, 1, 1")
TWO_SIDED = (r'(?s)<bsdf type="diffuse" id="(\w+)">(.*?)</bsdf>', r'<bsdf type="twosided" id="\1"><bsdf type="diffuse">\2</bsdf></bsdf>')
# `maxdepth` of pbrt counts bounces, which are one less than the edges that Mitsuba counts; the number is 9 in both files.
TEN_EDGES = (r'name="max_depth" value="9"', 'name="max_depth" value="10"')
DEPTH = (r'"integer maxdepth" \[ 4 \]', '"integer maxdepth" [ 64 ]')
SIZE = (r'"integer yresolution" \[ 64 \]  "integer xresolution" \[ 64 \]', '"integer yresolution" [ 256 ] "integer xresolution" [ 256 ]')


@dataclass
class Edit:
    """A scene with a known difference taken away."""

    file: str
    label: str
    substitutions: tuple
    # Whether the picture that came with it shows it so.
    as_stored: bool = True
    # Another format's file that says the same.
    beside: str = ""

    def apply(self, text):
        for pattern, replacement in self.substitutions:
            text, times = re.subn(pattern, replacement, text)
            if not times:
                raise ValueError(f"{self.file} has nothing that matches `{pattern}`")
        return text


EDITS = [
    Edit("classroom/mitsuba/scene_v0.6.xml", "sky and sun of the pbrt file", (LIGHTS,)),
    Edit("classroom/mitsuba/scene_v0.6.xml", "lights and metals of the pbrt file", (LIGHTS, METALS), False, "classroom/pbrt/scene-v4.pbrt"),
    Edit("cornell-box/pbrt/scene-v4.pbrt", "65 edges", (DEPTH, SIZE), True, "cornell-box/mitsuba/scene_v3.xml"),
    Edit("water-caustic/mitsuba/scene.xml", "two-sided", (TWO_SIDED,)),
    Edit("water-caustic/mitsuba/scene.xml", "two-sided, 10 edges", (TWO_SIDED, TEN_EDGES), False, "water-caustic/pbrt/scene-v4.pbrt"),
]

# Files that say the same as they are.
SAME = {
    "veach-bidir/pbrt/scene-v4.pbrt": "veach-bidir/mitsuba/scene.xml",
    "torus/scene-original.xml": "torus/scene.xml",
}


def found(name, known):
    """The value whose key the path ends with."""
    return next((value for key, value in known.items() if name.endswith(key)), None)
