"""Makes the scenes of tests/scenes/gltf with Blender, and compares how Cycles and Photonfarm render them.

    python make_gltf.py export FOLDER                     writes the GLBs
    python make_gltf.py render FOLDER OUT [NAME...]       reads the GLBs back into Blender, and Cycles renders each to OUT/NAME.exr
    python make_gltf.py compare FOLDER OUT BINARY [NAME...]  renders each with Photonfarm, and holds the means against those in OUT

Blender comes from PyPI (requirements-blender.txt, Python 3.11). What is rendered is the GLB as Blender reads it, so that both renderers see the
same file; the world is black, as glTF has none. `compare` fails where the means of a channel differ by more than 3 %.
"""

import json
import math
import pathlib
import struct
import subprocess
import sys
import tempfile
import zlib

import bpy
import mathutils
import meshoptimizer
import numpy

WIDTH, HEIGHT, SAMPLES = 96, 72, 256
BOUNCES = 64
TOLERANCE = 0.03


def reset():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module="io_scene_gltf2")
    # What is exported of animations; Blender begins with frame 1.
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 0, 24
    bpy.context.scene.render.resolution_x = WIDTH
    bpy.context.scene.render.resolution_y = HEIGHT
    bpy.context.scene.render.resolution_percentage = 100


def material(name, color=(0.8, 0.8, 0.8), roughness=0.5, metallic=0.0, **inputs):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic
    for key, value in inputs.items():
        shader.inputs[key].default_value = value
    return made


def give(made, thing=None):
    thing = thing or bpy.context.object
    thing.data.materials.clear()
    thing.data.materials.append(made)
    return thing


def call(thing, text):
    thing.name = thing.data.name = text


def smooth():
    bpy.ops.object.shade_smooth()
    return bpy.context.object


def camera(location=(0, -6.5, 2.5), target=(0, 0, 1), lens=35):
    data = bpy.data.cameras.new("Camera")
    data.lens = lens
    thing = bpy.data.objects.new("Camera", data)
    bpy.context.collection.objects.link(thing)
    thing.location = location
    direction = mathutils.Vector(target) - mathutils.Vector(location)
    thing.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.camera = thing
    return thing


def light(kind, energy, location=(0, 0, 4), rotation=(0, 0, 0), color=(1, 1, 1), **settings):
    data = bpy.data.lights.new(kind.title(), kind)
    data.energy = energy
    data.color = color
    for key, value in settings.items():
        setattr(data, key, value)
    thing = bpy.data.objects.new(kind.title(), data)
    bpy.context.collection.objects.link(thing)
    thing.location = location
    thing.rotation_euler = rotation
    return thing


def room(floor=None):
    """A floor and a back wall."""
    plain = floor or material("Plaster", (0.7, 0.7, 0.7), 1.0, **{"Specular IOR Level": 0.0})
    bpy.ops.mesh.primitive_plane_add(size=12, location=(0, 0, 0))
    give(plain)
    bpy.ops.mesh.primitive_plane_add(size=12, location=(0, 4, 4), rotation=(math.pi / 2, 0, 0))
    give(plain)


def lamp(strength=8.0, location=(0, -1, 4), size=2.0):
    """A square that shines, seen from below by its back."""
    shining = material("Lamp", (0, 0, 0), 1.0, **{"Emission Color": (1, 0.9, 0.8, 1), "Emission Strength": strength})
    bpy.ops.mesh.primitive_plane_add(size=size, location=location)
    give(shining)


def png(name, width, height, pixel):
    """An image of `pixel(x, y)`, RGBA bytes, rows from the top."""
    rows = b"".join(b"\0" + b"".join(bytes(pixel(x, y)) for x in range(width)) for y in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    content = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")
    path = pathlib.Path(tempfile.mkdtemp()) / f"{name}.png"
    path.write_bytes(content)
    return bpy.data.images.load(str(path))


def image_node(made, image, linear=False):
    node = made.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    if linear:
        image.colorspace_settings.name = "Non-Color"
    return node


def diffuse_box():
    """A box open in front, diffuse, in the light of an emissive square that is seen from its back."""
    for name, color, location, rotation in (
        ("Floor", (0.7, 0.7, 0.7), (0, 0, 0), (0, 0, 0)),
        ("Back", (0.7, 0.7, 0.7), (0, 2, 2), (math.pi / 2, 0, 0)),
        ("Left", (0.6, 0.1, 0.1), (-2, 0, 2), (0, math.pi / 2, 0)),
        ("Right", (0.1, 0.5, 0.1), (2, 0, 2), (0, -math.pi / 2, 0)),
        ("Top", (0.7, 0.7, 0.7), (0, 0, 4), (0, 0, 0)),
    ):
        bpy.ops.mesh.primitive_plane_add(size=4, location=location, rotation=rotation)
        give(material(name, color, 1.0, **{"Specular IOR Level": 0.0}))
    bpy.ops.mesh.primitive_cube_add(size=1.2, location=(-0.6, 0.4, 0.6), rotation=(0, 0, 0.5))
    give(bpy.data.materials["Floor"])
    lamp(strength=12.0, location=(0, 0, 3.9), size=1.2)
    camera((0, -7, 2), (0, 0, 2))


def lights():
    """A point, a spot and a sun over a diffuse floor."""
    room()
    bpy.ops.mesh.primitive_cylinder_add(radius=0.5, depth=1.5, location=(0, 0, 0.75))
    give(material("Clay", (0.6, 0.35, 0.2), 1.0, **{"Specular IOR Level": 0.0}))
    light("POINT", 150, (-2, -1, 2), color=(1, 0.6, 0.4), shadow_soft_size=0.0)
    light("SPOT", 800, (2.5, -1, 4), (0.1, 0.4, 0), spot_size=1.0, spot_blend=0.1, shadow_soft_size=0.0)
    light("SUN", 1.5, (0, 0, 5), (0.6, 0.3, 0), angle=0.0)
    camera()


def point_light():
    room()
    light("POINT", 300, (0, -1, 2.5), shadow_soft_size=0.0)
    camera()


def sun_light():
    room()
    light("SUN", 3, (0, 0, 5), (0.6, 0.3, 0), angle=0.0)
    camera()


def spot_light():
    room()
    light("SPOT", 1500, (0, -1, 4), (0.2, 0, 0), spot_size=1.2, spot_blend=0.02, shadow_soft_size=0.0)
    camera()


def dielectrics():
    """Balls of plastic, from smooth to rough."""
    room()
    for i, roughness in enumerate((0.2, 0.5, 1.0)):
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, segments=32, ring_count=16, location=(2.0 * i - 2.0, 0, 0.8))
        smooth()
        give(material(f"Plastic {roughness}", (0.2, 0.4, 0.7), roughness))
    lamp()
    camera()


def metals():
    """Balls of metal, from smooth to rough."""
    room()
    for i, roughness in enumerate((0.0, 0.3, 0.6)):
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, segments=32, ring_count=16, location=(2.0 * i - 2.0, 0, 0.8))
        smooth()
        give(material(f"Metal {roughness}", (0.9, 0.6, 0.3), roughness, 1.0))
    lamp()
    camera()


def glass():
    """Balls of clear, coloured and frosted glass."""
    room()
    for i, (color, roughness) in enumerate((((1, 1, 1), 0.0), ((0.5, 0.9, 0.6), 0.0), ((1, 1, 1), 0.4))):
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, segments=36, ring_count=18, location=(2.0 * i - 2.0, 0, 0.8))
        smooth()
        give(material(f"Glass {i}", color, roughness, **{"Transmission Weight": 1.0, "IOR": 1.5}))
    lamp(size=3.0, strength=4.0)
    camera()


def textures():
    """A picture whose four corners differ, a leaf cut out by alpha, a picture turned and repeated."""
    room()

    def corners(x, y):
        color = ((230, 40, 40), (40, 200, 40), (40, 60, 220), (230, 220, 60))[(x >= 8) + 2 * (y >= 8)]
        return (*color, 255)

    def leaf(x, y):
        inside = (x - 15.5) ** 2 + (y - 15.5) ** 2 < 144
        return (80, 180, 60, 255) if inside else (80, 180, 60, 0)

    for i, location in enumerate(((-2, 0.5, 1.2), (0, 0.5, 1.2), (2, 0.5, 1.2))):
        bpy.ops.mesh.primitive_plane_add(size=1.8, location=location, rotation=(math.pi / 2, 0, 0))
        made = give(material(f"Picture {i}", roughness=1.0, **{"Specular IOR Level": 0.0})).data.materials[0]
        nodes, links = made.node_tree.nodes, made.node_tree.links
        shader = nodes["Principled BSDF"]
        image = image_node(made, png("leaf", 32, 32, leaf) if i == 1 else png("corners", 16, 16, corners))
        links.new(image.outputs["Color"], shader.inputs["Base Color"])
        if i == 1:
            links.new(image.outputs["Alpha"], shader.inputs["Alpha"])
        if i == 2:
            mapping, uv = nodes.new("ShaderNodeMapping"), nodes.new("ShaderNodeUVMap")
            mapping.inputs["Scale"].default_value = (2, 3, 1)
            mapping.inputs["Rotation"].default_value = (0, 0, 0.5)
            mapping.inputs["Location"].default_value = (0.1, 0.2, 0)
            links.new(uv.outputs["UV"], mapping.inputs["Vector"])
            links.new(mapping.outputs["Vector"], image.inputs["Vector"])
    lamp()
    camera()


def normal_map():
    """A plate with a bumpy normal texture, and roughness and metalness from a texture."""
    room()

    def bumps(x, y):
        nx = 0.6 * math.sin(x / 32 * 2 * math.pi * 2)
        ny = 0.6 * math.sin(y / 32 * 2 * math.pi * 2)
        nz = math.sqrt(1 - nx * nx * 0.5 - ny * ny * 0.5)
        return (*(round(127.5 + 127.5 * c) for c in (nx * 0.7, ny * 0.7, nz)), 255)

    def mixed(x, y):
        return (0, 80 if y < 16 else 200, 255 if x < 16 else 0, 255)

    for i in range(2):
        bpy.ops.mesh.primitive_plane_add(size=2.6, location=(-1.5 + 3 * i, 0, 0.8), rotation=(0.7, 0, 0))
        made = give(material(f"Plate {i}", (0.8, 0.7, 0.5), 0.6)).data.materials[0]
        nodes, links = made.node_tree.nodes, made.node_tree.links
        shader = nodes["Principled BSDF"]
        if i == 0:
            shader.inputs["Roughness"].default_value = 1.0
            shader.inputs["Specular IOR Level"].default_value = 0.0
            image = image_node(made, png("bumps", 32, 32, bumps), linear=True)
            bumpy = nodes.new("ShaderNodeNormalMap")
            links.new(image.outputs["Color"], bumpy.inputs["Color"])
            links.new(bumpy.outputs["Normal"], shader.inputs["Normal"])
        else:
            image = image_node(made, png("mixed", 32, 32, mixed), linear=True)
            parts = nodes.new("ShaderNodeSeparateColor")
            links.new(image.outputs["Color"], parts.inputs["Color"])
            links.new(parts.outputs["Green"], shader.inputs["Roughness"])
            links.new(parts.outputs["Blue"], shader.inputs["Metallic"])
    lamp()
    camera()


def instances():
    """One mesh at many nodes, some of them mirrored and unevenly scaled, under empties."""
    room()
    bpy.ops.mesh.primitive_cone_add(vertices=8, radius1=0.4, depth=1.2, location=(-2.5, 0, 0.6))
    first = give(material("Tree", (0.2, 0.5, 0.2), 1.0, **{"Specular IOR Level": 0.0}))
    grove = bpy.data.objects.new("Grove", None)
    bpy.context.collection.objects.link(grove)
    grove.rotation_euler = (0, 0, 0.3)
    for i in range(8):
        tree = bpy.data.objects.new(f"Tree {i}", first.data)
        bpy.context.collection.objects.link(tree)
        tree.parent = grove
        tree.location = (-2 + 0.7 * i, 0.5 * (i % 3), 0.6)
        tree.scale = (-1 if i % 2 else 1, 1, 0.6 + 0.2 * (i % 4))
    lamp()
    camera()


def arm():
    """A bar bent by two bones, and a cube with a shape key, both in motion."""
    room()
    bpy.ops.mesh.primitive_cube_add(size=1, location=(-1, 0, 1.2))
    bar = give(material("Bar", (0.7, 0.3, 0.2), 1.0, **{"Specular IOR Level": 0.0}))
    call(bar, "Bar")
    bar.scale = (0.3, 0.3, 2.4)
    bpy.ops.object.transform_apply(location=True, scale=True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=6)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.armature_add(location=(-1, 0, 0))
    armature = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    root = armature.data.edit_bones[0]
    root.tail = (0, 0, 1.2)
    tip = armature.data.edit_bones.new("Tip")
    tip.head, tip.tail, tip.parent = (0, 0, 1.2), (0, 0, 2.4), root
    bpy.ops.object.mode_set(mode="OBJECT")
    for name, part in (("Bone", lambda z: z < 1.2), ("Tip", lambda z: z >= 1.2)):
        group = bar.vertex_groups.new(name=name)
        group.add([v.index for v in bar.data.vertices if part(v.co.z)], 1.0, "REPLACE")
    bar.modifiers.new("Armature", "ARMATURE").object = armature
    bar.parent = armature
    bar.matrix_parent_inverse = armature.matrix_world.inverted()
    bone = armature.pose.bones["Tip"]
    bone.rotation_mode = "XYZ"
    for frame, angle in ((0, 0.0), (24, 1.2)):
        bone.rotation_euler = (0, 0, angle)
        bone.keyframe_insert("rotation_euler", frame=frame)
    bpy.ops.mesh.primitive_cube_add(size=1, location=(1.5, 0, 0.5))
    cube = give(material("Box", (0.2, 0.3, 0.7), 1.0, **{"Specular IOR Level": 0.0}))
    call(cube, "Box")
    cube.shape_key_add(name="Basis")
    key = cube.shape_key_add(name="Tall")
    for point in key.data:
        if point.co.z > 0:
            point.co.z += 1.0
    for frame, value in ((0, 0.0), (24, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    bpy.ops.mesh.primitive_ico_sphere_add(radius=0.4, location=(0.3, -1, 0.4))
    ball = give(material("Ball", (0.7, 0.7, 0.2), 1.0, **{"Specular IOR Level": 0.0}))
    call(ball, "Ball")
    for frame, x in ((0, 0.3), (24, 1.8)):
        ball.location.x = x
        ball.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(0)
    lamp()
    camera()


SCENES = {
    "diffuse-box": diffuse_box,
    "lights": lights,
    "point": point_light,
    "sun": sun_light,
    "spot": spot_light,
    "dielectrics": dielectrics,
    "metals": metals,
    "glass": glass,
    "textures": textures,
    "normal-map": normal_map,
    "instances": instances,
    "arm": arm,
}

# The frames at which a scene is rendered, where it is not the first only.
FRAMES = {"arm": (0, 12)}


def export(folder):
    for name, make in SCENES.items():
        reset()
        make()
        path = folder / f"{name}.glb"
        # One animation of all that moves, since Blender plays one of several when it reads them back.
        animation = {"export_animation_mode": "SCENE", "export_anim_scene_split_object": False}
        bpy.ops.export_scene.gltf(filepath=str(path), export_cameras=True, export_lights=True, **animation)
        print(f"{path} {path.stat().st_size} bytes")
    packed(folder)


def packed(folder):
    """One ball as it is, compressed by Draco as Blender exports it, and by meshoptimizer as gltfpack writes it."""
    reset()
    bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=8)
    give(material("Clay", (0.7, 0.5, 0.4)), smooth())
    camera()
    light("POINT", 500)
    plain = folder / "packed.glb"
    for path, draco in ((plain, False), (folder / "packed-draco.glb", True)):
        bpy.ops.export_scene.gltf(
            filepath=str(path), export_cameras=True, export_lights=True, export_draco_mesh_compression_enable=draco
        )
    data = plain.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    document, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    content = b""
    for view in document["bufferViews"]:
        accessor = next(a for a in document["accessors"] if document["bufferViews"][a["bufferView"]] is view)
        begin = view.get("byteOffset", 0)
        plain_bytes = binary[begin : begin + view["byteLength"]]
        if accessor["type"] == "SCALAR":
            indices = numpy.frombuffer(plain_bytes, numpy.uint16).astype(numpy.uint32)
            compressed, stride, mode = meshoptimizer.encode_index_buffer(indices), 2, "TRIANGLES"
        else:
            width = {"VEC2": 2, "VEC3": 3}[accessor["type"]]
            values = numpy.frombuffer(plain_bytes, numpy.float32).reshape(-1, width)
            compressed, stride, mode = meshoptimizer.encode_vertex_buffer(values), 4 * width, "ATTRIBUTES"
        compressed = bytes(compressed)
        extension = {"buffer": 0, "byteOffset": len(content), "byteLength": len(compressed)}
        extension |= {"byteStride": stride, "count": accessor["count"], "mode": mode}
        view["buffer"], view["extensions"] = 1, {"EXT_meshopt_compression": extension}
        content += compressed + bytes(-len(compressed) % 4)
    fallback = {"byteLength": len(binary), "extensions": {"EXT_meshopt_compression": {"fallback": True}}}
    document["buffers"] = [{"byteLength": len(content)}, fallback]
    for field in ("extensionsUsed", "extensionsRequired"):
        document[field] = document.get(field, []) + ["EXT_meshopt_compression"]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(content), 0x004E4942) + content
    (folder / "packed-meshopt.glb").write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)


def render(folder, out, names):
    for name in names or SCENES:
        for frame in FRAMES.get(name, (0,)):
            reset()
            bpy.ops.import_scene.gltf(filepath=str(folder / f"{name}.glb"))
            scene = bpy.context.scene
            scene.camera = next(thing for thing in scene.objects if thing.type == "CAMERA")
            for thing in scene.objects:
                if thing.type == "LIGHT":
                    thing.data.use_shadow = True
                    if thing.data.type == "SUN":
                        thing.data.angle = 0.0
                    else:
                        thing.data.shadow_soft_size = 0.0
            scene.frame_set(frame)
            scene.render.engine = "CYCLES"
            scene.cycles.device = "CPU"
            scene.cycles.samples = SAMPLES
            scene.cycles.use_denoising = False
            scene.cycles.use_adaptive_sampling = False
            # Nothing is clamped, blurred or cut short, so that the means are those of the light.
            scene.cycles.sample_clamp_indirect = 0.0
            scene.cycles.sample_clamp_direct = 0.0
            scene.cycles.blur_glossy = 0.0
            scene.cycles.caustics_reflective = True
            scene.cycles.caustics_refractive = True
            scene.cycles.pixel_filter_type = "BOX"
            scene.cycles.filter_width = 1.0
            for bounces in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
                setattr(scene.cycles, f"{bounces}_bounces", BOUNCES)
            scene.world = bpy.data.worlds.new("Black")
            scene.world.use_nodes = True
            scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
            scene.view_settings.view_transform = "Raw"
            scene.render.image_settings.file_format = "OPEN_EXR"
            scene.render.image_settings.color_depth = "32"
            scene.render.image_settings.exr_codec = "ZIP"
            path = picture(out, name, frame)
            scene.render.filepath = str(path)
            bpy.ops.render.render(write_still=True)
            print(f"{path.name} mean {mean(path)}", flush=True)


def picture(out, name, frame):
    return out / (f"{name}-{frame}.exr" if frame else f"{name}.exr")


def mean(path):
    """Of each channel over the picture."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = numpy.array(image.pixels[:]).reshape(-1, 4)
    return pixels[:, :3].mean(axis=0)


def compare(folder, out, binary, names):
    """Prints Photonfarm's means over those of Cycles; whether all are near 1."""
    near = True
    for name in names or SCENES:
        for frame in FRAMES.get(name, (0,)):
            ours = picture(out, f"photonfarm-{name}", frame)
            subprocess.run(
                [binary, "render", str(folder / f"{name}.glb"), "--output", str(ours), "--integrator", "path", "--iterations", "16"]
                + ["--set", "samples=16", "--set", f"max_depth={BOUNCES}", "-D", f"width={WIDTH}", "-D", f"frame={frame}"],
                check=True,
                stdout=subprocess.DEVNULL,
            )
            ratio = mean(ours) / mean(picture(out, name, frame))
            within = abs(ratio - 1).max() <= TOLERANCE
            near &= bool(within)
            print(f"{name:14} {frame:3} {ratio.round(3)} {'' if within else 'DIFFERS'}", flush=True)
    return near


def main():
    command, folder, *rest = sys.argv[1:]
    folder = pathlib.Path(folder)
    if command == "export":
        return export(folder)
    out = pathlib.Path(rest[0])
    out.mkdir(parents=True, exist_ok=True)
    if command == "render":
        render(folder, out, rest[1:])
    elif not compare(folder, out, rest[1], rest[2:]):
        sys.exit("means differ by more than 3 %")


if __name__ == "__main__":
    main()
