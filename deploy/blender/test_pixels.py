"""What is carried over from Blender, by pixels: lights, the world, motion."""

import sys

import bpy
import numpy

from test_support import HEIGHT, MODULE, WIDTH, add_light, by_command, clear, node_material, passes_of_render, render, world


def test_world():
    """In an even world of radiance L a matt ball of reflectance a has radiance a L, and all else L."""
    scene = clear()
    bpy.ops.mesh.primitive_uv_sphere_add(radius=2, location=(0, 0, 1), segments=64, ring_count=32)
    bpy.context.object.data.materials.append(node_material("Matt", "ShaderNodeBsdfDiffuse", Color=(0.5, 0.5, 0.5, 1.0)))
    world((0.2, 0.4, 0.8))
    scene.photonfarm.integrator, scene.photonfarm.iterations = "path", 16
    picture, exported = by_command(scene, "world")
    for name, radiance in (("R", 0.2), ("G", 0.4), ("B", 0.8)):
        middle, corner = picture[name][20:28, 28:36].mean(), picture[name][:4, :4].mean()
        assert abs(corner - radiance) < 1e-4, (name, corner)
        assert abs(middle - radiance / 2) < 0.01 * radiance, (name, middle)
    print("world: as it should be", flush=True)


def test_area_light():
    """A lamp of type area sends its power down, as Cycles has it, and nothing up."""
    scene = clear()
    # A floor below and a ceiling above the lamp, both seen from the side.
    for z in (0.0, 4.0):
        bpy.ops.mesh.primitive_plane_add(size=8, location=(0, 0, z))
        bpy.context.object.data.materials.append(node_material("Plane", "ShaderNodeBsdfDiffuse", Color=(0.8, 0.8, 0.8, 1.0)))
    add_light("AREA", 100.0, (0, 0, 2.0), shape="DISK", size=0.5)
    scene.camera.location, scene.camera.rotation_euler = (0, -9, 2), (1.5707963, 0, 0)
    scene.photonfarm.integrator, scene.photonfarm.iterations = "path", 64
    ours, exported = by_command(scene, "area")
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 64, False
    scene.cycles.sample_clamp_indirect, scene.cycles.use_adaptive_sampling = 0.0, False
    render()
    theirs = passes_of_render()
    for part, rows in (("ceiling", slice(0, 12)), ("floor", slice(36, 48))):
        ratio = ours["G"][rows].mean() / next(theirs[name] for name in theirs if name.endswith("Combined.G"))[rows].mean()
        print(f"area lamp, {part}: {ratio:.3f} of Cycles", flush=True)
        # Light that the floor sends up passes through the lamp in Cycles, and not here.
        assert 0.9 < ratio < 1.02 if part == "ceiling" else abs(ratio - 1) < 0.02, (part, ratio)


def test_motion():
    """What moves is blurred where the scene asks for it."""
    scene = clear()
    bpy.ops.mesh.primitive_cube_add(size=1, location=(-1, 0, 1))
    cube = bpy.context.object
    cube.keyframe_insert("location", frame=9)
    cube.location.x = 1
    cube.keyframe_insert("location", frame=11)
    world((1.0, 1.0, 1.0))
    scene.frame_set(10)
    scene.photonfarm.integrator, scene.photonfarm.iterations = "path", 16
    sharp, _ = by_command(scene, "sharp")
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    blurred, exported = by_command(scene, "blurred")
    scene.render.use_motion_blur = False
    assert exported.defines["frame"] == "10", exported.defines
    dark = [(picture["G"] < 0.98).any(axis=0).sum() for picture in (sharp, blurred)]
    assert dark[1] > dark[0] + 5, dark
    middle = [numpy.average(numpy.arange(WIDTH), weights=(1 - picture["G"]).sum(axis=0)) for picture in (sharp, blurred)]
    assert abs(middle[0] - middle[1]) < 1, middle
    print("motion: as it should be", flush=True)


def beside_cycles(scene, name, iterations, samples):
    """The green channel of our picture and of Cycles', and what the export has said."""
    scene.photonfarm.integrator, scene.photonfarm.iterations = "path", iterations
    ours, exported = by_command(scene, name)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", samples, False
    scene.cycles.sample_clamp_indirect, scene.cycles.use_adaptive_sampling = 0.0, False
    render()
    theirs = passes_of_render()
    return ours["G"], next(theirs[key] for key in theirs if key.endswith("Combined.G")), exported.notes


def test_point_light():
    """A point light with a radius has its power and a soft shadow, as in Cycles."""
    scene = clear()
    bpy.ops.mesh.primitive_plane_add(size=12)
    bpy.context.object.data.materials.append(node_material("Floor", "ShaderNodeBsdfDiffuse", Color=(0.8, 0.8, 0.8, 1.0)))
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 1.2))
    add_light("POINT", 500.0, (0, 0, 4.0), shadow_soft_size=0.7)
    scene.camera.location, scene.camera.rotation_euler = (0, -9, 1.5), (1.4, 0, 0)
    ours, theirs, notes = beside_cycles(scene, "point", 64, 64)
    assert not any("size of lights" in note for note in notes), notes
    floor = slice(34, 48)
    parts = {"floor": (floor, slice(0, WIDTH)), "shadow": (slice(33, 38), slice(28, 36))}
    for part, (rows, columns) in parts.items():
        ratio = ours[rows, columns].mean() / theirs[rows, columns].mean()
        print(f"point light, {part}: {ratio:.3f} of Cycles", flush=True)
        assert abs(ratio - 1) < (0.02 if part == "floor" else 0.1), (part, ratio)


def world_image(turn):
    """A world whose image is brighter to one side and above, turned about z."""
    across, down = numpy.meshgrid(numpy.linspace(0, 2 * numpy.pi, 64, endpoint=False), numpy.linspace(1, -1, 32))
    pixels = numpy.ones((32, 64, 4), dtype=numpy.float32)
    pixels[..., 0] = 1 + 0.9 * numpy.sin(across)
    pixels[..., 1] = 20 * numpy.exp(4 * (numpy.cos(across - 1) - 1)) * (1 + down) + 0.1
    pixels[..., 2] = 1 + 0.9 * down
    image = bpy.data.images.new("Sky", 64, 32, float_buffer=True, is_data=False)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(pixels[::-1].ravel())
    image.pack()
    tree = bpy.context.scene.world.node_tree
    sky, mapping, place = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Mapping", "TexCoord"))
    sky.image = image
    mapping.inputs["Rotation"].default_value = (0, 0, turn)
    tree.links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], sky.inputs["Vector"])
    tree.links.new(sky.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = 0.5


def test_world_image():
    """An image about the scene is seen and lights as in Cycles: very much so from afar, and nearly from where the add-on puts it."""
    module = sys.modules[f"{MODULE}.world"]
    usual = module.DISTANCE
    for turn, distance, most in ((0.0, 1000.0, 0.03), (2.0, 1000.0, 0.03), (2.0, usual, 0.15)):
        scene = clear()
        bpy.ops.mesh.primitive_uv_sphere_add(radius=1.5, location=(0, 0, 1), segments=64, ring_count=32)
        bpy.ops.object.shade_smooth()
        bpy.context.object.data.materials.append(node_material("Matt", "ShaderNodeBsdfDiffuse", Color=(0.8, 0.8, 0.8, 1.0)))
        world_image(turn)
        module.DISTANCE = distance
        ours, theirs, notes = beside_cycles(scene, f"sky-{turn}", 64, 64)
        module.DISTANCE = usual
        assert any("the world's image" in note for note in notes), notes
        corners = {"left": (slice(0, 12), slice(0, 12)), "right": (slice(0, 12), slice(52, 64)), "ball": (slice(18, 30), slice(24, 40))}
        for part, (rows, columns) in corners.items():
            ratio = ours[rows, columns].mean() / theirs[rows, columns].mean()
            print(f"world's image turned by {turn}, {distance:g} radii away, {part}: {ratio:.3f} of Cycles", flush=True)
            assert abs(ratio - 1) < most, (turn, distance, part, ratio)
