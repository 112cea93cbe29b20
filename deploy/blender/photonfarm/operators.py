"""Jobs of a farm that Blender does not wait for: submit, look at, cancel. Their pictures become images for the compositor."""

import pathlib
import threading

import bpy

from . import exr, rendering
from .engine import begin, preferences
from .export import CannotExport, export
from .farm import FarmError

TROUBLE = (CannotExport, FarmError, exr.Unreadable, rendering.RenderFailed, OSError)


def load(scene, job, data):
    """Puts a job's picture, with its layers, into an image of its own, which the compositor can use. Returns the image."""
    name = f"Photonfarm job {job}"
    folder = pathlib.Path(bpy.path.abspath("//") if bpy.data.filepath else bpy.app.tempdir) / "photonfarm"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"job-{job}.exr"
    aside = path.with_suffix(".part")
    aside.write_bytes(exr.layered(exr.read(data)))
    aside.replace(path)
    image = bpy.data.images.get(name)
    if image is None:
        image = bpy.data.images.load(str(path))
        image.name = name
    else:
        image.filepath = str(path)
        image.reload()
    _node(scene, image)
    return image


def _node(scene, image):
    """The image as a node of the compositor, once."""
    scene.use_nodes = True
    tree = scene.node_tree
    if any(node.type == "IMAGE" and node.image == image for node in tree.nodes):
        return
    node = tree.nodes.new("CompositorNodeImage")
    node.image, node.label = image, image.name
    node.location = (-600, 300)


class _Steer(bpy.types.Operator):
    bl_options = {"REGISTER"}

    def execute(self, context):
        try:
            return self.act(context, context.scene, context.scene.photonfarm)
        except TROUBLE as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}


class PHOTONFARM_OT_submit(_Steer):
    """Send the scene, as it is at this frame, to the farm, and go on working"""

    bl_idname = "photonfarm.submit"
    bl_label = "Submit to Farm"

    def act(self, context, scene, settings):
        farm = rendering.connect(preferences(), bpy.app.online_access)
        exported = export(scene, context.view_layer)
        name = bpy.path.display_name_from_filepath(bpy.data.filepath) or "untitled"
        wish = rendering.Wish(exported, settings, f"{name} {scene.frame_current}")
        settings.job = str(rendering.Remote.submitted(farm, wish, settings.preview).job)
        for note in exported.notes:
            self.report({"WARNING"}, f"Left out or changed: {note}")
        self.report({"INFO"}, f"Job {settings.job} was submitted")
        return {"FINISHED"}


class PHOTONFARM_OT_fetch(_Steer):
    """Load the picture of the job as it stands, with its layers, into an image and a node of the compositor"""

    bl_idname = "photonfarm.fetch"
    bl_label = "Fetch Picture"

    def act(self, _, scene, settings):
        job = _job(settings)
        farm = rendering.connect(preferences(), bpy.app.online_access)
        status, data = farm.status(job), farm.picture(job)
        if data is None:
            raise rendering.RenderFailed(f"Job {job} has no picture yet: {status.get('waiting') or status['state']}. Try again later")
        image = load(scene, job, data)
        self.report({"INFO"}, f"{image.name}: {status['iterations_done']} of {status['spec']['iterations']} iterations, {status['state']}")
        return {"FINISHED"}


class PHOTONFARM_OT_cancel(_Steer):
    """End the job on the farm; what was rendered stays there"""

    bl_idname = "photonfarm.cancel"
    bl_label = "Cancel Job"

    def act(self, _, scene, settings):
        status = rendering.connect(preferences(), bpy.app.online_access).cancel(_job(settings))
        self.report({"INFO"}, f"Job {status['id']}: {status['state']}")
        return {"FINISHED"}


class PHOTONFARM_OT_watch(_Steer):
    """Fetch the picture again and again until the job has ended; Esc in the window where it was started ends the watching, not the job"""

    bl_idname = "photonfarm.watch"
    bl_label = "Watch Job"

    def act(self, context, scene, settings):
        self.job = _job(settings)
        self.work = rendering.Remote(rendering.connect(preferences(), bpy.app.online_access), self.job, settings.preview)
        self.news, self.failure, self.stopped = [], None, threading.Event()
        # What a network lets wait must not keep Blender from drawing.
        self.thread = threading.Thread(target=self._poll, daemon=True)
        self.thread.start()
        manager = context.window_manager
        self.timer = manager.event_timer_add(0.5, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _poll(self):
        try:
            while not self.stopped.wait(0.25) and not self.work.ended:
                data = self.work.poll()
                if data is not None:
                    self.news.append(data)
        except TROUBLE as error:
            self.failure = error

    def modal(self, context, event):
        if event.type == "ESC":
            return self._end(context, "INFO", f"Job {self.job} goes on without being watched")
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self.news:
            data, self.news = self.news[-1], []
            try:
                load(context.scene, self.job, data)
            except TROUBLE as error:
                self.failure = error
            for window in context.window_manager.windows:
                for area in window.screen.areas:
                    area.tag_redraw()
        context.workspace.status_text_set(f"Photonfarm: {self.work.message}")
        if self.failure is not None:
            return self._end(context, "ERROR", str(self.failure))
        if not self.thread.is_alive() and not self.news:
            return self._end(context, "INFO", f"Job {self.job} is done")
        return {"PASS_THROUGH"}

    def _end(self, context, kind, text):
        self.stopped.set()
        context.window_manager.event_timer_remove(self.timer)
        context.workspace.status_text_set(None)
        self.report({kind}, text)
        return {"FINISHED"}


def _job(settings):
    if not settings.job.isdigit():
        raise rendering.RenderFailed("There is no job: submit the scene first, or enter the number of one")
    return int(settings.job)


CLASSES = (PHOTONFARM_OT_submit, PHOTONFARM_OT_fetch, PHOTONFARM_OT_watch, PHOTONFARM_OT_cancel)
