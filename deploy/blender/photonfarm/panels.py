"""What an artist sets: in the add-on's preferences where to render, in the render properties how."""

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

INTEGRATORS = [
    ("pppm", "Photon Mapping", "Probabilistic progressive photon mapping: caustics, also those seen in mirrors and through glass"),
    ("pcf", "Photon Cone Focusing", "Photons that count over a range of directions as well"),
    ("vcm", "Vertex Connection and Merging", "Photons and connected paths together: for everything, slower"),
    ("bdpt", "Bidirectional Path Tracing", "Connected paths without photons"),
    ("path", "Path Tracing", "Like Cycles; no caustics of small lamps"),
]


class PhotonfarmPreferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    program: StringProperty(
        name="Program",
        subtype="FILE_PATH",
        default="photonfarm",
        description="The program photonfarm on this computer; not needed where only a farm renders",
    )
    threads: IntProperty(name="Threads", min=0, default=0, description="Threads to render with on this computer; 0 is all of them")
    farm: StringProperty(name="Farm", description="Address of the farm's coordinator, such as https://farm.example:7800")
    token: StringProperty(
        name="Token", subtype="PASSWORD", description="The farm's token with the role submit. It is kept in Blender's preferences"
    )
    authority: StringProperty(
        name="Certificate", subtype="FILE_PATH", description="The farm's certificate, if no public authority vouches for it"
    )

    def draw(self, _):
        for name in ("program", "threads", "farm", "token", "authority"):
            self.layout.prop(self, name)


class PhotonfarmSettings(bpy.types.PropertyGroup):
    where: EnumProperty(
        name="Render On",
        items=[
            ("LOCAL", "This Computer", "By the program of the add-on's preferences"),
            ("FARM", "Farm", "By the farm of the add-on's preferences"),
        ],
    )
    integrator: EnumProperty(name="Integrator", items=INTEGRATORS)
    iterations: IntProperty(name="Iterations", min=1, max=1 << 20, default=64, description="More give less noise and sharper caustics")
    photons: IntProperty(name="Light Paths", min=1, max=1_000_000, default=200_000, description="Paths from the lights in each iteration")
    seed: IntProperty(name="Seed", min=0, description="Another seed gives other noise")
    noise_target: FloatProperty(
        name="Noise Target", min=0.0, soft_max=0.2, precision=4, description="A farm stops at this noise, such as 0.01; 0 is never"
    )
    preview: FloatProperty(name="Refresh", min=1.0, default=3.0, subtype="TIME", description="Seconds between two looks at the picture")
    job: StringProperty(name="Job", description="Number of the job on the farm")


class PHOTONFARM_PT_settings(bpy.types.Panel):
    bl_label = "Photonfarm"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"
    COMPAT_ENGINES = {"PHOTONFARM"}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context):
        layout, settings = self.layout, context.scene.photonfarm
        layout.use_property_split = True
        for name in ("where", "integrator", "iterations", "photons", "seed", "preview"):
            layout.prop(settings, name)
        if settings.where == "FARM":
            layout.prop(settings, "noise_target")


class PHOTONFARM_PT_farm(bpy.types.Panel):
    bl_label = "Farm Jobs"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"

    @classmethod
    def poll(cls, context):
        return context.engine == "PHOTONFARM"

    def draw(self, context):
        layout, settings = self.layout, context.scene.photonfarm
        layout.operator("photonfarm.submit")
        layout.prop(settings, "job")
        row = layout.row(align=True)
        for name in ("fetch", "watch", "cancel"):
            row.operator(f"photonfarm.{name}")


CLASSES = (PhotonfarmPreferences, PhotonfarmSettings, PHOTONFARM_PT_settings, PHOTONFARM_PT_farm)


def _shared_panels():
    """Blender's own panels that hold for any engine which shades as glTF does: those of materials, lights, cameras, size."""
    for panel in bpy.types.Panel.__subclasses__():
        engines = getattr(panel, "COMPAT_ENGINES", ())
        if "BLENDER_EEVEE_NEXT" in engines and not panel.__name__.startswith(("EEVEE_", "RENDER_PT_eevee")):
            yield panel


def register():
    for known in CLASSES:
        bpy.utils.register_class(known)
    bpy.types.Scene.photonfarm = PointerProperty(type=PhotonfarmSettings)
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.add("PHOTONFARM")


def unregister():
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.discard("PHOTONFARM")
    del bpy.types.Scene.photonfarm
    for known in reversed(CLASSES):
        bpy.utils.unregister_class(known)
