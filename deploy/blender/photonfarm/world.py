"""The world: what shines from all sides. glTF has none, so that it becomes a dome about all there is."""

import math

import mathutils
import numpy

from .shapes import grid, icosphere

# From Blender's axes (z up) to those of glTF (y up).
TO_GLTF = mathutils.Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))
# Radii of the scene at which an image lies: nearer, it would shift more from place to place; farther, fewer light paths that start there would meet the scene.
DISTANCE = 10.0
# Pixels across of the largest image that is carried.
WIDEST = 2048
NOT_CARRIED = "the world: one colour or one image with a strength is carried, and no sky; it is black"


def add_world(glb, scene, depsgraph, notes):
    """Adds the dome, if the world shines."""
    background = _background(scene.world, notes)
    if background is None:
        return
    color, strength, image, turn = background
    if strength <= 0 or not any(channel > 0 for channel in color):
        return
    middle, radius = _sphere(scene, depsgraph)
    if image is None:
        points, triangles = icosphere(4)
        # It shines inwards.
        part = points * radius * 1.05, triangles[:, ::-1], glb.emission("World", [channel * strength for channel in color])
    else:
        points, coordinates, triangles = grid(128, 64)
        points = points @ numpy.array(turn) @ numpy.array(TO_GLTF.to_3x3()).T * radius * DISTANCE
        texture = glb.add_texture("World", _radiance(image))
        part = points, triangles, glb.emission("World", [strength] * 3, texture), coordinates
        notes.append("the world's image: it lies on a ball about the scene, so that reflections of it shift a little from place to place")
    points, *rest = part
    # Whatever the camera's clipping says, it sees the world.
    for camera in glb.document["cameras"]:
        kind = camera.get("perspective") or camera["orthographic"]
        kind["zfar"] = max(kind.get("zfar", 0.0), 2.2 * radius * (1.0 if image is None else DISTANCE))
    glb.add_mesh("World", [(points + numpy.array(TO_GLTF @ middle), *rest)])


def _background(world, notes):
    """The colour, the strength, the image and its turn; none where it is black."""
    if world is None:
        return None
    if not world.use_nodes:
        return tuple(world.color), 1.0, None, None
    output = next((node for node in world.node_tree.nodes if node.type == "OUTPUT_WORLD" and node.is_active_output), None)
    links = output.inputs["Surface"].links if output else ()
    if not links:
        return None
    background = links[0].from_node
    if background.type != "BACKGROUND" or background.inputs["Strength"].is_linked:
        notes.append(NOT_CARRIED)
        return None
    strength = background.inputs["Strength"].default_value
    links = background.inputs["Color"].links
    if not links:
        return tuple(background.inputs["Color"].default_value[:3]), strength, None, None
    texture = links[0].from_node
    turn = _turn(texture) if texture.type == "TEX_ENVIRONMENT" and texture.projection == "EQUIRECTANGULAR" else None
    if turn is None or texture.image is None or not texture.image.has_data and not texture.image.pixels:
        notes.append(NOT_CARRIED)
        return None
    return (1.0, 1.0, 1.0), strength, texture.image, turn


def _turn(texture):
    """From a direction of the world to where its image is looked up; none where that is more than a turn."""
    links = texture.inputs["Vector"].links
    if not links:
        return mathutils.Matrix.Identity(3)
    turn = mathutils.Matrix.Identity(3)
    if links[0].from_node.type == "MAPPING":
        mapping = links[0].from_node
        if mapping.vector_type not in ("POINT", "VECTOR") or any(mapping.inputs[name].is_linked for name in ("Rotation", "Scale")):
            return None
        if any(abs(scale - 1) > 1e-6 for scale in mapping.inputs["Scale"].default_value):
            return None
        if mapping.vector_type == "POINT" and (mapping.inputs["Location"].is_linked or any(mapping.inputs["Location"].default_value)):
            return None
        turn = mathutils.Euler(mapping.inputs["Rotation"].default_value).to_matrix()
        links = mapping.inputs["Vector"].links
    return turn if links and links[0].from_node.type == "TEX_COORD" and links[0].from_socket.name == "Generated" else None


def _radiance(image):
    """An image as a file of Radiance (RGBE), in linear colours."""
    width, height = image.size
    pixels = numpy.empty(width * height * 4, dtype=numpy.float32)
    image.pixels.foreach_get(pixels)
    # Blender's first line is the lowest.
    pixels = pixels.reshape(height, width, 4)[::-1, :, :3].astype(float)
    if not image.is_float and image.colorspace_settings.name == "sRGB":
        pixels = numpy.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4)
    step = -(-width // WIDEST)
    if step > 1:
        rows, columns = height // step * step, width // step * step
        pixels = pixels[:rows, :columns].reshape(rows // step, step, columns // step, step, 3).mean(axis=(1, 3))
    pixels = numpy.clip(numpy.nan_to_num(pixels, posinf=1e30), 0, 1e30)
    brightest = pixels.max(axis=2)
    _, exponent = numpy.frexp(brightest)
    mantissas = numpy.floor(numpy.ldexp(pixels, (8 - exponent)[..., None]))
    packed = numpy.zeros((*brightest.shape, 4), dtype=numpy.uint8)
    packed[..., :3], packed[..., 3] = mantissas, exponent + 128
    packed[brightest < 1e-30] = 0
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {packed.shape[0]} +X {packed.shape[1]}\n"
    return head.encode() + packed.tobytes()


def _sphere(scene, depsgraph):
    """A sphere about everything that is rendered, lights and the camera included."""
    points = [scene.camera.matrix_world.translation.copy()]
    for instance in depsgraph.object_instances:
        thing = instance.object
        corners = [mathutils.Vector(corner) for corner in thing.bound_box] if thing.type != "LIGHT" else []
        points += [instance.matrix_world @ corner for corner in corners or [mathutils.Vector()]]
    low = mathutils.Vector([min(point[i] for point in points) for i in range(3)])
    high = mathutils.Vector([max(point[i] for point in points) for i in range(3)])
    middle = (low + high) / 2
    return middle, max(max((point - middle).length for point in points), 1e-3)
