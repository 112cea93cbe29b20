"""What `test` does within Blender."""

import os
import sys
import threading
import time
import traceback

import bpy

import test_pixels
from test_support import (
    FOLDER,
    MODULE,
    PROGRAM,
    TLS_URL,
    URL,
    add_light,
    by_command,
    clear,
    exr,
    expect_error,
    expect_same,
    install,
    node_material,
    passes_of_render,
    render,
    token,
    world,
)

def glass_ball():
    """A ball of glass on a floor, below a lamp."""
    scene = clear()
    bpy.ops.mesh.primitive_plane_add(size=12)
    bpy.context.object.data.materials.append(node_material("Floor", "ShaderNodeBsdfDiffuse", Color=(0.7, 0.6, 0.5, 1.0)))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1, location=(0, 0, 1.2), segments=64, ring_count=32)
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(node_material("Glass", "ShaderNodeBsdfGlass", IOR=1.45, Roughness=0.0))
    add_light("POINT", 800.0, (1.0, -1.0, 5.0), shadow_soft_size=0.0)
    scene.photonfarm.integrator, scene.photonfarm.iterations, scene.photonfarm.photons = "pppm", 4, 20000
    scene.photonfarm.preview = 1.0
    return scene


def test_render(scene):
    """F12, here and on the farm: the pixels are those of the program's picture."""
    reference, _ = by_command(scene, "ball")
    for where in ("LOCAL", "FARM"):
        scene.photonfarm.where = where
        render()
        expect_same(passes_of_render(), reference, f"F12, {where}")
    return reference


def test_job(scene, reference):
    """A job that nobody waits for, and its image in the compositor."""
    assert bpy.ops.photonfarm.submit() == {"FINISHED"}
    job = scene.photonfarm.job
    farm = sys.modules[f"{MODULE}.farm"].Farm(URL, token("submit"))
    while farm.status(job)["state"] != "done":
        time.sleep(0.2)
    for _ in range(2):
        assert bpy.ops.photonfarm.fetch() == {"FINISHED"}
    image = bpy.data.images[f"Photonfarm job {job}"]
    nodes = [node for node in scene.node_tree.nodes if node.type == "IMAGE" and node.image == image]
    assert len(nodes) == 1 and image.type == "MULTILAYER"
    assert {"Combined", "Standard Error"} <= {output.name for output in nodes[0].outputs}, [o.name for o in nodes[0].outputs]
    through_compositor(scene, nodes[0], reference)
    assert bpy.ops.photonfarm.cancel() == {"FINISHED"}


def through_compositor(scene, node, reference):
    """What the compositor gets of the node, written to files."""
    tree = scene.node_tree
    out = tree.nodes.new("CompositorNodeOutputFile")
    out.base_path = str(FOLDER / "composed")
    out.format.file_format, out.format.color_depth, out.format.exr_codec = "OPEN_EXR_MULTILAYER", "32", "ZIP"
    out.layer_slots.clear()
    for name in ("Combined", "Standard Error"):
        out.layer_slots.new(name)
        tree.links.new(node.outputs[name], out.inputs[name])
    scene.render.use_compositing = True
    scene.photonfarm.where, scene.photonfarm.iterations = "LOCAL", 1
    render()
    (written,) = FOLDER.glob("composed*.exr")
    expect_same(exr().read(written.read_bytes()), reference, "compositor")
    scene.use_nodes, scene.photonfarm.iterations = False, 4


def test_errors(scene, preferences):
    """What goes wrong is said, with what to do."""
    scene.photonfarm.where = "FARM"
    preferences.token = "phf_" + "0" * 64
    expect_error("does not know the token", bpy.ops.photonfarm.submit)
    expect_error("does not know the token", bpy.ops.render.render)
    preferences.token = token("read")
    expect_error("role submit", bpy.ops.photonfarm.submit)
    preferences.token, preferences.farm = token("submit"), "http://127.0.0.1:9"
    expect_error("No farm answers", bpy.ops.photonfarm.submit)
    preferences.farm = "farm"
    expect_error("is no address", bpy.ops.photonfarm.submit)
    preferences.farm = URL
    scene.photonfarm.job = "4711"
    expect_error("4711", bpy.ops.photonfarm.fetch)
    scene.photonfarm.where, preferences.program = "LOCAL", "/no/such/program"
    expect_error("There is no program", bpy.ops.render.render)
    preferences.program, camera, scene.camera = PROGRAM, scene.camera, None
    expect_error("no camera", bpy.ops.photonfarm.submit)
    scene.camera = camera


def test_cancel(scene):
    """A job ends when somebody ends it."""
    scene.photonfarm.iterations = 100_000
    assert bpy.ops.photonfarm.submit() == {"FINISHED"}
    assert bpy.ops.photonfarm.cancel() == {"FINISHED"}
    farm = sys.modules[f"{MODULE}.farm"].Farm(URL, token("submit"))
    assert farm.status(scene.photonfarm.job)["state"] == "cancelled"
    scene.photonfarm.iterations = 4


def test_sharpening(scene):
    """The picture is shown more than once while it is rendered."""
    engine, shown = sys.modules[f"{MODULE}.engine"], []
    show = engine.show
    engine.show = lambda *arguments: (shown.append(1), show(*arguments))
    for where in ("LOCAL", "FARM"):
        scene.photonfarm.where, scene.photonfarm.iterations, scene.photonfarm.photons = where, 16, 200_000
        shown.clear()
        render()
        assert len(shown) >= 2, (where, len(shown))
        print(f"sharpening, {where}: shown {len(shown)} times", flush=True)
    engine.show, scene.photonfarm.iterations, scene.photonfarm.photons = show, 4, 20_000


def test_stop(scene):
    """What Esc does to the program on this computer: it ends, and nothing is left."""
    scene.photonfarm.where, scene.photonfarm.iterations = "LOCAL", 100_000
    engine, export = sys.modules[f"{MODULE}.engine"], sys.modules[f"{MODULE}.export"].export
    work = engine.begin(export(scene), scene.photonfarm, "stopped")
    while work.poll() is None:
        time.sleep(0.1)
    work.cancel()
    work.close()
    assert work.process.returncode is not None and not work.folder.exists()
    scene.photonfarm.iterations = 4
    print("stop: as it should be", flush=True)


class Escaped:
    """The engine, while somebody has pressed Esc as soon as something was shown."""

    def __init__(self, engine, shown):
        self.engine, self.shown = engine, shown

    def __getattr__(self, name):
        return getattr(self.engine, name)

    def test_break(self):
        return bool(self.shown)


def test_escape(scene):
    """Esc during F12: what was rendered until then stays, the job of a farm is cancelled, and the program on this computer has ended."""
    engine = sys.modules[f"{MODULE}.engine"]
    kind, begin, works = engine.PhotonfarmEngine, engine.begin, []
    follow = kind._follow
    scene.photonfarm.iterations = 100_000
    engine.begin = lambda *arguments: works.append(begin(*arguments)) or works[-1]
    for where in ("LOCAL", "FARM"):
        shown, show = [], engine.show
        engine.show = lambda *arguments: (show(*arguments), shown.append(1))
        kind._follow = lambda self, *arguments: follow(Escaped(self, shown), *arguments)
        scene.photonfarm.where = where
        try:
            render()
        finally:
            engine.show, kind._follow = show, follow
        picture = passes_of_render()
        assert len(shown) == 1 and any(channel.mean() > 0 for name, channel in picture.items() if name.endswith("Combined.G"))
    local, remote = works
    assert local.process.returncode is not None and not local.folder.exists()
    assert remote.farm.status(remote.job)["state"] == "cancelled"
    engine.begin, scene.photonfarm.iterations = begin, 4
    print("escape: as it should be", flush=True)


def test_tls(scene, preferences):
    """A farm that made its certificate itself: without the certificate nothing is sent there, with it the pixels are the same."""
    reference, _ = by_command(scene, "encrypted")
    scene.photonfarm.where, preferences.farm = "FARM", TLS_URL
    expect_error("CERTIFICATE_VERIFY_FAILED", bpy.ops.photonfarm.submit)
    preferences.authority = str(FOLDER / "no.pem")
    expect_error("cannot be read", bpy.ops.photonfarm.submit)
    preferences.authority = str(FOLDER / "farm.pem")
    render()
    expect_same(passes_of_render(), reference, "F12, encrypted farm")
    preferences.farm, preferences.authority = URL, ""


def test_animation():
    """Render Animation: each frame is the scene at that frame."""
    scene = clear()
    bpy.ops.mesh.primitive_cube_add(size=1, location=(-1, 0, 1))
    cube = bpy.context.object
    cube.keyframe_insert("location", frame=1)
    cube.location.x = 1
    cube.keyframe_insert("location", frame=2)
    world((0.5, 0.5, 0.5))
    scene.photonfarm.where, scene.photonfarm.integrator, scene.photonfarm.iterations = "LOCAL", "path", 2
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.filepath = str(FOLDER / "frame")
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}
    references = []
    for frame in (1, 2):
        scene.frame_set(frame)
        references.append(by_command(scene, f"animated-{frame}")[0])
        expect_same(exr().read((FOLDER / f"frame{frame:04}.exr").read_bytes()), references[-1], f"frame {frame}")
    assert (references[0]["G"] != references[1]["G"]).any()


class Timers:
    """What Blender runs in its main thread, when the test says so."""

    def __init__(self):
        self.due = []

    def register(self, work):
        self.due.append(work)

    def is_registered(self, work):
        return work in self.due

    def unregister(self, work):
        self.due.remove(work)


def test_threads():
    """F12 of a window renders in a thread of its own: what it has exported is exported by the main thread."""
    in_main_thread = sys.modules[f"{MODULE}.engine"].in_main_thread
    results = []

    def render_thread(work, broken, timers):
        try:
            results.append(in_main_thread(work, broken, timers))
        except ValueError as error:
            results.append(str(error))

    def fail():
        raise ValueError("it cannot be exported")

    def is_main():
        return threading.current_thread() is threading.main_thread()

    for work, broken, pumped in ((is_main, False, True), (fail, False, True), (is_main, True, False)):
        timers = Timers()
        thread = threading.Thread(target=render_thread, args=(work, lambda: broken, timers))
        thread.start()
        if pumped:
            while not timers.due:
                time.sleep(0.01)
            timers.due.pop()()
        thread.join(timeout=10)
        assert not thread.is_alive() and not timers.due
    assert results == [True, "it cannot be exported", None], results
    print("threads: as it should be", flush=True)


def main():
    preferences = install()
    test_threads()
    scene = glass_ball()
    reference = test_render(scene)
    test_job(scene, reference)
    test_errors(scene, preferences)
    test_cancel(scene)
    test_sharpening(scene)
    test_stop(scene)
    test_escape(scene)
    test_tls(scene, preferences)
    test_animation()
    for test in (
        test_pixels.test_world,
        test_pixels.test_motion,
        test_pixels.test_area_light,
        test_pixels.test_point_light,
        test_pixels.test_world_image,
    ):
        test()
    bpy.ops.preferences.addon_disable(module=MODULE)
    print("all is well", flush=True)


try:
    main()
except BaseException:
    traceback.print_exc()
    status = 1
else:
    status = 0
# Blender as a module does not always end by itself.
sys.stdout.flush()
sys.stderr.flush()
os._exit(status)
