"""What the tests within Blender share: scenes, renderings by F12 and by the program, and what is expected of them."""

import pathlib
import subprocess
import sys

import bpy
import mathutils

FOLDER = pathlib.Path(sys.argv[1])
URL, TLS_URL, PROGRAM = sys.argv[2:5]
MODULE = "bl_ext.user_default.photonfarm"
WIDTH, HEIGHT = 64, 48


def token(role):
    return (FOLDER / f"{role}.token").read_text().strip()


def install():
    """By the packed extension, as the preferences' "Install from Disk" does it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    result = bpy.ops.extensions.package_install_files(
        filepath=str(FOLDER / "one.zip"), repo="user_default", enable_on_install=True, overwrite=True
    )
    assert result == {"FINISHED"}, result
    bpy.ops.preferences.addon_enable(module="io_scene_gltf2")
    preferences = bpy.context.preferences.addons[MODULE].preferences
    assert preferences.bl_rna.properties["token"].subtype == "PASSWORD"
    preferences.program, preferences.threads, preferences.farm, preferences.token = PROGRAM, 1, URL, token("submit")
    return preferences


def node_material(name, kind, **inputs):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    shader = tree.nodes["Principled BSDF"]
    if kind != "ShaderNodeBsdfPrincipled":
        shader = tree.nodes.new(kind)
        tree.links.new(shader.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    return made


def add_light(kind, energy, location, **settings):
    data = bpy.data.lights.new(kind.title(), kind)
    data.energy = energy
    for key, value in settings.items():
        setattr(data, key, value)
    thing = bpy.data.objects.new(kind.title(), data)
    bpy.context.collection.objects.link(thing)
    thing.location = location
    return thing


def world(color):
    made = bpy.data.worlds.new("World")
    made.use_nodes = True
    made.node_tree.nodes["Background"].inputs["Color"].default_value = (*color, 1.0)
    bpy.context.scene.world = made


def clear():
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    scene = bpy.context.scene
    data = bpy.data.cameras.new("Camera")
    scene.camera = bpy.data.objects.new("Camera", data)
    bpy.context.collection.objects.link(scene.camera)
    scene.camera.location = (0, -6.5, 2.5)
    scene.camera.rotation_euler = (mathutils.Vector((0, 6.5, -1.5))).to_track_quat("-Z", "Y").to_euler()
    scene.render.engine = "PHOTONFARM"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 2 * WIDTH, 2 * HEIGHT, 50
    world((0.0, 0.0, 0.0))
    return scene


def passes_of_render():
    """The pixels of the passes that F12's result holds, the top line first."""
    scene = bpy.context.scene
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"
    path = FOLDER / "result.exr"
    bpy.data.images["Render Result"].save_render(str(path), scene=scene)
    return exr().read(path.read_bytes())


def exr():
    return sys.modules[f"{MODULE}.exr"]


def render():
    assert bpy.ops.render.render() == {"FINISHED"}


def expect_same(found, reference, what):
    """All channels of the reference are there, in some layer, with the same bits."""
    names = {"R": "Combined.R", "G": "Combined.G", "B": "Combined.B", "standard_error": ("Standard Error.X", "Standard Error.V")}
    assert reference["R"].shape == (HEIGHT, WIDTH) and reference["R"].mean() > 0
    for name, channel in reference.items():
        matching = [found[key] for key in found if key.endswith(names[name])]
        assert len(matching) == 1, (what, name, sorted(found))
        assert matching[0].tobytes() == channel.tobytes(), f"{what}: {name} differs"
    print(f"{what}: {len(reference)} channels with the same bits", flush=True)


def expect_error(words, action, *arguments):
    try:
        action(*arguments)
    except RuntimeError as error:
        assert words in str(error), f"{words!r} is not in: {error}"
        print("as it should be:", str(error).strip(), flush=True)
    else:
        raise AssertionError(f"no error about {words!r}")


def by_command(scene, name):
    """What the program makes of the same GLB."""
    exported = sys.modules[f"{MODULE}.export"].export(scene)
    rendering = sys.modules[f"{MODULE}.rendering"]
    glb, picture = FOLDER / f"{name}.glb", FOLDER / f"{name}.exr"
    glb.write_bytes(exported.data)
    arguments = rendering.Wish(exported, scene.photonfarm, "").arguments(glb, picture)
    subprocess.run([PROGRAM, *arguments, "--threads", "1"], check=True, capture_output=True)
    return exr().read(picture.read_bytes()), exported
