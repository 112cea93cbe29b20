"""What `media_figures.py` measures: cells, each an estimator of some of a scene's light, and the figures and claims that they belong to.

Figures are those of Deng, Jiao, Bitterli and Jarosz, "Photon surfaces for robust, unbiased volumetric density estimation" (2019).
"""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Transport:
    """Light of a scene of tests/scenes/surfaces, along the paths of an expression (docs/LAYERS.md)."""

    scene: str
    paths: str
    defines: dict = field(default_factory=dict)

    @property
    def edges(self):
        """Edges of such a path, camera to light."""
        return len(self.paths.split()) - 1

    @property
    def all_defines(self):
        """Paints are black where no surface scatters, so that no estimator spends time on paths that do not count."""
        paints = {} if "D" in self.paths else {"pale": "0", "warm": "0", "dark": "0"}
        return {**self.defines, **paints, "max_depth": str(self.edges)}


SMALL = {"half_width": "0.17", "half_height": "0.095", "radiance": "8000, 7400, 6400"}
TRANSPORTS = {
    "room": Transport("schoolroom", "L V E"),
    "room, small lamp": Transport("schoolroom", "L V E", SMALL),
    "room, twice": Transport("schoolroom", "L V V E"),
    "room, thrice": Transport("schoolroom", "L V V V E"),
    "room, thrice, forward": Transport("schoolroom", "L V V V E", {"g": "0.9"}),
    "room, by surfaces": Transport("schoolroom", "L D V E"),
    "station": Transport("station", "L V E"),
    "knot": Transport("knot", "L V E"),
    "smoke": Transport("smoke", "L V E"),
}


@dataclass(frozen=True)
class Cell:
    """An estimator of a transport."""

    transport: str
    label: str
    integrator: str
    settings: dict = field(default_factory=dict)

    @property
    def name(self):
        return f"{self.transport}: {self.label}"

    @property
    def biased(self):
        return self.integrator == "pppm"


def path(transport):
    return Cell(transport, "path", "path", {"samples": "1"})


def beams(transport):
    return Cell(transport, "beams", "pppm", {"media": "beams"})


def surfaces(transport, label, kinds, weights="balance"):
    return Cell(transport, label, "surfaces", {"surfaces": kinds, "weights": weights})


def cells():
    """All of them, by name, in the order in which they are measured."""
    three = "planes,cones,cylinders"
    every = [
        path("room"),
        beams("room"),
        surfaces("room", "copies", "light_copies"),
        surfaces("room", "light planes", "light_planes"),
        surfaces("room", "turned planes", "turned_planes"),
        surfaces("room", "spheres", "spheres"),
        surfaces("room", "cones", "cones"),
        surfaces("room", "copies, light planes", "light_copies,light_planes"),
        surfaces("room", "copies, turned planes", "light_copies,turned_planes"),
        surfaces("room", "copies, turned planes, average", "light_copies,turned_planes", "average"),
        surfaces("room", "all", "light_copies,light_planes,light_circles,light_arcs,spheres,cones"),
        beams("room, small lamp"),
        surfaces("room, small lamp", "copies", "light_copies"),
        surfaces("room, small lamp", "turned planes", "turned_planes"),
        surfaces("room, small lamp", "copies, turned planes", "light_copies,turned_planes"),
        path("station"),
        beams("station"),
        surfaces("station", "copies, light planes", "light_copies,light_planes"),
        surfaces("station", "spheres, cones", "spheres,cones"),
        path("knot"),
        surfaces("knot", "copies", "light_copies"),
        path("room, twice"),
        beams("room, twice"),
        surfaces("room, twice", "planes", "planes"),
        surfaces("room, twice", "planes, cones, cylinders", three),
        path("room, thrice"),
        beams("room, thrice"),
        surfaces("room, thrice", "planes", "planes"),
        surfaces("room, thrice", "planes, average", "planes", "average"),
        surfaces("room, thrice", "planes, cones, cylinders", three),
        path("room, thrice, forward"),
        beams("room, thrice, forward"),
        surfaces("room, thrice, forward", "planes", "planes"),
        surfaces("room, thrice, forward", "planes, cones, cylinders", three),
        surfaces("room, thrice, forward", "with toroids, hyperboloids", f"{three},toroids,hyperboloids"),
        path("smoke"),
        beams("smoke"),
        surfaces("smoke", "cones", "cones"),
        path("room, by surfaces"),
        surfaces("room, by surfaces", "spheres, cones", "spheres,cones"),
    ]
    return {cell.name: cell for cell in every}


# What a check compares with path tracing: of each kind of light that where all kinds of surfaces have their share.
COMPARED = (
    "room: all",
    "room: copies, turned planes",
    "station: spheres, cones",
    "knot: copies",
    "room, twice: planes, cones, cylinders",
    "room, thrice: planes, cones, cylinders",
    "smoke: cones",
    "room, by surfaces: spheres, cones",
)


@dataclass(frozen=True)
class Figure:
    """A figure of the paper: which transports it shows, and of these some cells or all."""

    title: str
    transports: tuple
    labels: tuple = ()

    def cells(self, every):
        chosen = [cell for cell in every.values() if cell.transport in self.transports]
        return [cell for cell in chosen if not self.labels or cell.label in self.labels]


FIGURES = {
    3: Figure(
        "Shares by the balance heuristic against a straight average",
        ("room, thrice", "room"),
        ("planes", "planes, average", "copies, turned planes", "copies, turned planes, average"),
    ),
    4: Figure(
        "Single techniques of light that is scattered once",
        ("room", "knot"),
        ("path", "copies", "light planes", "turned planes"),
    ),
    5: Figure("Estimators of light that is scattered once, alone and combined", ("room",)),
    6: Figure(
        "The size of the lamp",
        ("room", "room, small lamp"),
        ("beams", "copies", "turned planes", "copies, turned planes"),
    ),
    7: Figure(
        "Light that is scattered once, twice and three times, to all sides and forward",
        ("station", "room, twice", "room, thrice", "room, thrice, forward"),
    ),
    8: Figure("A medium that varies", ("smoke",)),
    9: Figure("Light that surfaces scatter into the medium", ("room, by surfaces",)),
}

# What the paper says, where it says so, and two cells by name: the first has less error than the second at equal time.
CLAIMS = [
    ("figure 3", "Generalised planes: shares by the balance heuristic have less variance than an average", "room, thrice: planes", "room, thrice: planes, average"),
    ("figure 3", "Continuous planes of a lamp: the same", "room: copies, turned planes", "room: copies, turned planes, average"),
    ("figure 5", "Copies and planes of the lamp have less error than beams in a room with a large window", "room: copies, light planes", "room: beams"),
    ("figure 5", "and than path tracing", "room: copies, light planes", "room: path"),
    ("figure 5", "Spheres alone have more variance than when combined", "room: all", "room: spheres"),
    ("figure 5", "Cones alone likewise", "room: all", "room: cones"),
    ("figure 5", "The cost of all surfaces does not always pay: fewer do better", "room: copies, light planes", "room: all"),
    ("section 9", "(u, t) and (v, t) planes do slightly better than turned ones", "room: copies, light planes", "room: copies, turned planes"),
    ("figure 6", "A large lamp: copies do better than turned planes", "room: copies", "room: turned planes"),
    ("figure 6", "A small lamp: turned planes do better than copies", "room, small lamp: turned planes", "room, small lamp: copies"),
    ("figure 7", "Small lamps: beams do better than planes of the lamps", "station: beams", "station: copies, light planes"),
    ("figure 7", "and so do cones and spheres", "station: spheres, cones", "station: copies, light planes"),
    ("figure 7", "Scattered twice: planes, cones and cylinders have less variance than planes alone", "room, twice: planes, cones, cylinders", "room, twice: planes"),
    ("figure 7", "and less error than beams", "room, twice: planes, cones, cylinders", "room, twice: beams"),
    ("figure 7", "Three times: three kinds of planes have less error than beams", "room, thrice: planes", "room, thrice: beams"),
    ("figure 7", "Cones and cylinders help little where scattering is even: planes alone do better", "room, thrice: planes", "room, thrice: planes, cones, cylinders"),
    ("figure 7", "They help where it is forward", "room, thrice, forward: planes, cones, cylinders", "room, thrice, forward: planes"),
    ("figure 9", "From surfaces, path tracing has less variance than spheres and cones", "room, by surfaces: path", "room, by surfaces: spheres, cones"),
]  # fmt: skip
