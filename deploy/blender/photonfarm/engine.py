"""Photonfarm among Blender's render engines: F12 shows the picture as it sharpens, Esc ends it."""

import threading
import time

import bpy

from . import exr, rendering
from .export import CannotExport, export
from .farm import FarmError

STEP = 0.1


def in_main_thread(work, broken, timers=bpy.app.timers):
    """Blender's data change in its main thread alone, and F12 renders in another: lets the main thread do the work, and waits."""
    if threading.current_thread() is threading.main_thread():
        return work()
    result, done = {}, threading.Event()

    def run():
        try:
            result["value"] = work()
        except BaseException as error:  # It is raised again where it is waited for.
            result["error"] = error
        done.set()

    timers.register(run)
    while not done.wait(STEP):
        if broken():
            # The work may have begun: it is waited for as well.
            if timers.is_registered(run):
                timers.unregister(run)
                return None
    if "error" in result:
        raise result["error"]
    return result["value"]


def preferences():
    """Those of the add-on."""
    return bpy.context.preferences.addons[__package__].preferences


def begin(exported, settings, name):
    """Starts a rendering where the scene's settings say."""
    wish, wanted = rendering.Wish(exported, settings, name), preferences()
    if settings.where == "FARM":
        farm = rendering.connect(wanted, bpy.app.online_access)
        return rendering.Remote.submitted(farm, wish, settings.preview)
    return rendering.Local(wish, bpy.path.abspath(wanted.program), wanted.threads, settings.preview)


class PhotonfarmEngine(bpy.types.RenderEngine):
    bl_idname = "PHOTONFARM"
    bl_label = "Photonfarm"
    bl_use_preview = False
    bl_use_postprocess = True
    bl_use_shading_nodes_custom = False
    bl_use_eevee_viewport = True

    def update_render_passes(self, scene=None, renderlayer=None):
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        self.register_pass(scene, renderlayer, "Standard Error", 1, "X", "VALUE")

    def render(self, depsgraph):
        scene = depsgraph.scene.original
        view_layer = scene.view_layers[depsgraph.view_layer.name]
        if view_layer != scene.view_layers[0]:
            self.report({"WARNING"}, f"View layer {view_layer.name!r} is left out: Photonfarm renders all objects as one")
            return
        try:
            self._render(scene, view_layer)
        except (CannotExport, FarmError, exr.Unreadable, rendering.RenderFailed, OSError) as error:
            self.report({"ERROR"}, f"Photonfarm: {error}")

    def _render(self, scene, view_layer):
        self.update_stats("", "Photonfarm: exporting the scene")
        frame = scene.frame_current
        exported = in_main_thread(lambda: export(scene, view_layer), self.test_break)
        if exported is None:
            return
        for note in exported.notes:
            self.report({"INFO"}, f"Photonfarm leaves out or changes {note}")
        self.update_stats("", "Photonfarm: sending the scene")
        work = begin(exported, scene.photonfarm, f"{bpy.path.display_name_from_filepath(bpy.data.filepath) or 'untitled'} {frame}")
        try:
            self._follow(work, scene)
        finally:
            work.close()

    def _follow(self, work, scene):
        share = scene.render.resolution_percentage / 100
        width, height = max(1, int(scene.render.resolution_x * share)), max(1, int(scene.render.resolution_y * share))
        self.add_pass("Standard Error", 1, "X")
        result = self.begin_result(0, 0, width, height)
        try:
            while True:
                data = work.poll()
                if data is not None:
                    show(result, exr.passes(exr.read(data)), (width, height))
                    self.update_result(result)
                if work.ended:
                    break
                if self.test_break():
                    work.cancel()
                    self.report({"INFO"}, "Photonfarm: cancelled")
                    break
                self.update_progress(work.done / max(1, work.total))
                self.update_stats("", f"Photonfarm: {work.message}")
                time.sleep(STEP)
        finally:
            self.end_result(result)
        for warning in work.warnings:
            self.report({"WARNING"}, f"Photonfarm: {warning}")


def show(result, passes, size):
    """Puts the pixels of a picture into the passes of a result: Blender's first line is the lowest."""
    for held in result.layers[0].passes:
        if held.name not in passes:
            continue
        layer, _ = passes[held.name]
        if layer.shape[1::-1] != size:
            raise rendering.RenderFailed(f"The picture has {layer.shape[1]} x {layer.shape[0]} pixels, and the scene asks for {size[0]} x {size[1]}")
        pixels = layer[::-1].reshape(-1, layer.shape[2])
        try:
            held.rect.foreach_set(pixels.ravel())
        except TypeError:
            # Older versions of Blender take a list for each pixel, slowly.
            held.rect = pixels.tolist()
