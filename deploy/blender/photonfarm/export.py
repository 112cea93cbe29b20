"""Writes the open scene, as it is at the current frame, to a GLB: by Blender's own exporter, and what that leaves out by hand."""

import math
import pathlib
import tempfile

import bpy
import mathutils
import numpy

from .glb import Glb
from .shapes import icosphere
from .world import TO_GLTF, add_world

# Shaders that Blender's exporter does not know.
SHADERS = {"BSDF_GLASS", "BSDF_REFRACTION", "BSDF_GLOSSY", "BSDF_METALLIC", "BSDF_DIFFUSE"}
DISC_SIDES = 48


class CannotExport(Exception):
    """There is nothing that could be rendered; the text says what to do."""


class Exported:
    """A scene that was written."""

    def __init__(self, data, defines, notes):
        # The GLB, the values of its definitions, and what of the scene is not in it.
        self.data, self.defines, self.notes = data, defines, notes


def export(scene, view_layer=None):
    """The scene as a GLB. To be called in Blender's main thread."""
    if scene.camera is None:
        raise CannotExport("The scene has no camera: add one, or choose one in the scene's properties")
    # An animation that is rendered moves the renderer's copy of the scene alone.
    scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    notes, defines = [], {"width": str(_size(scene)[0])}
    options = {
        "export_format": "GLB",
        "use_active_scene": True,
        "use_renderable": True,
        "export_cameras": True,
        "export_lights": True,
        "export_apply": True,
        "export_extras": False,
        "export_yup": True,
        "export_animations": False,
        "export_current_frame": True,
        "export_skins": False,
        "export_morph": False,
        "export_gpu_instances": False,
    }
    blurred = scene.render.use_motion_blur and scene.render.motion_blur_shutter > 0
    if blurred:
        options |= {"export_animations": True, "export_animation_mode": "SCENE", "export_current_frame": False}
        fps = scene.render.fps / scene.render.fps_base
        defines |= {"fps": f"{fps:g}", "shutter": f"{scene.render.motion_blur_shutter:g}"}
        notes.append("motion blur: what moves as a whole is blurred; meshes that change their form are sharp")
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "scene.glb"
        with _frames_about_the_current_one(scene, blurred) as frame:
            # F12 may render another scene than the one that the window shows.
            with bpy.context.temp_override(scene=scene, view_layer=view_layer or bpy.context.view_layer):
                bpy.ops.export_scene.gltf(filepath=str(path), **options)
        glb = Glb(path.read_bytes())
    if blurred:
        defines["frame"] = f"{frame:g}"
    depsgraph = (view_layer or bpy.context.view_layer).depsgraph
    depsgraph.update()
    _choose_camera(glb, scene, notes)
    _shaders(glb, notes)
    _lights(glb, depsgraph, notes)
    add_world(glb, scene, depsgraph, notes)
    _left_out(depsgraph, notes)
    return Exported(glb.bytes(), defines, notes)


def _size(scene):
    """The picture's pixels across and down."""
    share = scene.render.resolution_percentage / 100
    return max(1, int(scene.render.resolution_x * share)), max(1, int(scene.render.resolution_y * share))


class _frames_about_the_current_one:
    """While it holds, the scene's range is that of the blur: the exporter writes each frame of the range. Its value is the
    current frame counted from the first that is written."""

    def __init__(self, scene, needed):
        self.scene, self.needed = scene, needed
        self.range = scene.frame_start, scene.frame_end

    def __enter__(self):
        if not self.needed:
            return None
        reach = math.ceil(self.scene.render.motion_blur_shutter / 2) + 1
        now = self.scene.frame_current
        self.scene.frame_start, self.scene.frame_end = max(0, now - reach), now + reach
        # The exporter writes a frame at the time that it has in Blender.
        return now

    def __exit__(self, *_):
        if self.needed:
            self.scene.frame_start, self.scene.frame_end = self.range


def _choose_camera(glb, scene, notes):
    """The scene's camera comes first: Photonfarm looks through the first one. It gets the aspect of the picture."""
    document = glb.document
    nodes = document.get("nodes", [])
    with_camera = [node for node in nodes if "camera" in node]
    chosen = next((node for node in with_camera if node.get("name") == scene.camera.name), None)
    if chosen is None and len(with_camera) == 1:
        chosen = with_camera[0]
    if chosen is None:
        raise CannotExport(f"The camera {scene.camera.name!r} was not exported: is it hidden from renders?")
    for node in with_camera:
        if node is not chosen:
            del node["camera"]
    width, height = _size(scene)
    kind = document["cameras"][chosen["camera"]]
    if "perspective" in kind:
        kind["perspective"]["aspectRatio"] = width / height
    camera = scene.camera.data
    if camera.dof.use_dof:
        notes.append("depth of field: everything is in focus")
    if camera.shift_x or camera.shift_y:
        notes.append("the camera's shift: it looks straight ahead")
    if camera.type == "PANO":
        notes.append("panoramic camera: it is rendered in perspective")
    if scene.render.use_border:
        notes.append("render region: the whole picture is rendered")


def _shaders(glb, notes):
    """Materials whose surface is one of Cycles' simple shaders."""
    for entry in glb.document.get("materials", []):
        material = bpy.data.materials.get(entry.get("name", ""))
        shader = _surface(material)
        if shader is None or shader.type == "BSDF_PRINCIPLED":
            continue
        if shader.type not in SHADERS:
            if shader.type != "EMISSION":
                notes.append(f"material {material.name!r}: its shader {shader.name!r} is not known; use a Principled BSDF")
            continue
        if any(socket.is_linked for socket in shader.inputs if socket.name in ("Color", "Base Color", "Roughness", "IOR")):
            notes.append(f"material {material.name!r}: textures of its {shader.name!r} are left out; use a Principled BSDF")
        _set_shader(glb, entry, shader)


def _set_shader(glb, entry, shader):
    def value(name, otherwise):
        socket = shader.inputs.get(name)
        return socket.default_value if socket is not None else otherwise

    color = value("Color", None) or value("Base Color", (0.8, 0.8, 0.8, 1.0))
    metallic = shader.type in ("BSDF_GLOSSY", "BSDF_METALLIC")
    roughness = 1.0 if shader.type == "BSDF_DIFFUSE" else value("Roughness", 0.0)
    entry["pbrMetallicRoughness"] = {
        "baseColorFactor": [*color[:3], 1.0],
        "metallicFactor": 1.0 if metallic else 0.0,
        "roughnessFactor": roughness,
    }
    extensions = entry.setdefault("extensions", {})
    if shader.type in ("BSDF_GLASS", "BSDF_REFRACTION"):
        extensions["KHR_materials_transmission"] = {"transmissionFactor": 1.0}
        extensions["KHR_materials_ior"] = {"ior": value("IOR", 1.5)}
    elif shader.type == "BSDF_DIFFUSE":
        extensions["KHR_materials_specular"] = {"specularFactor": 0.0}
    for extension in extensions:
        glb.uses(extension)


def _surface(material):
    """The shader that is linked to a material's surface, if it has nodes."""
    if material is None or not material.use_nodes:
        return None
    output = material.node_tree.get_output_node("ALL") or material.node_tree.get_output_node("CYCLES")
    links = output.inputs["Surface"].links if output else ()
    return links[0].from_node if links else None


def _lights(glb, depsgraph, notes):
    """Lights with a size, which glTF has not: surfaces that shine. Spots and suns lose their size."""
    sizes, balls = set(), set()
    for instance in depsgraph.object_instances:
        thing = instance.object
        if thing.type != "LIGHT" or thing.hide_render:
            continue
        light = thing.data
        if light.type == "AREA":
            _area_light(glb, thing.name, light, instance.matrix_world.copy())
        elif light.type == "POINT" and light.shadow_soft_size > 0:
            balls.add(light.name)
            _ball(glb, thing.name, light, instance.matrix_world.translation)
        elif (light.angle if light.type == "SUN" else light.shadow_soft_size) > 0:
            sizes.add(thing.name)
    glb.remove_lights(balls)
    if sizes:
        notes.append(f"the size of lights: {', '.join(sorted(sizes))} cast sharp shadows; lights of type Area and Point keep theirs")


def _left_out(depsgraph, notes):
    """What neither Blender's exporter nor this one writes."""
    for kind, what in (("VOLUME", "volumes"), ("CURVES", "hair"), ("POINTCLOUD", "points")):
        names = {instance.object.name for instance in depsgraph.object_instances if instance.object.type == kind}
        if names:
            notes.append(f"{what}: {', '.join(sorted(names))} are left out")
    for material in bpy.data.materials:
        output = material.node_tree.get_output_node("ALL") if material.users and material.use_nodes else None
        if output and output.inputs["Volume"].is_linked:
            notes.append(f"material {material.name!r}: its volume is empty space")


def _ball(glb, name, light, middle):
    """A point light with a radius: a ball that shines, with the power of the light."""
    points, triangles = icosphere(2)
    points = points * light.shadow_soft_size
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    area = numpy.linalg.norm(numpy.cross(b - a, c - a), axis=1).sum() / 2
    radiance = [light.energy * channel / (math.pi * area) for channel in light.color]
    # Both kinds of axes are right-handed, so that triangles keep their fronts.
    points = (points + numpy.array(middle)) @ numpy.array(TO_GLTF.to_3x3()).T
    glb.add_mesh(name, [(points, triangles, glb.emission(name, radiance))])


def _area_light(glb, name, light, place):
    width = light.size
    height = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
    round_one = light.shape in ("DISK", "ELLIPSE")
    corners = DISC_SIDES if round_one else 4
    angles = [(i + 0.5) * 2 * math.pi / corners for i in range(corners)]
    # A polygon of the area that the disc has.
    reach = math.sqrt(math.pi / (corners / 2 * math.sin(2 * math.pi / corners))) / 2 if round_one else math.sqrt(0.5)
    rim = [(width * reach * math.cos(a), height * reach * math.sin(a)) for a in angles]
    scale = place.to_scale()
    area = width * height * abs(scale.x * scale.y) * (math.pi / 4 if round_one else 1)
    if area <= 0:
        return
    radiance = [light.energy * channel / (math.pi * area) for channel in light.color]
    # It shines along -z. A black sheet just behind takes what it would send there.
    shining = numpy.array([TO_GLTF @ place @ mathutils.Vector((x, y, 0)) for x, y in rim])
    behind = place.copy()
    behind.translation += place.to_3x3().normalized() @ mathutils.Vector((0, 0, 2e-3 * max(width, height)))
    sheet = numpy.array([TO_GLTF @ behind @ mathutils.Vector((x, y, 0)) for x, y in rim])
    fan = [(0, i + 1, i) for i in range(1, corners - 1)]
    parts = [(shining, fan, glb.emission(name, radiance)), (sheet, fan, glb.emission(f"{name} (back)", (0, 0, 0)))]
    for part in parts:
        glb.add_mesh(name, [part])
