"""A picture that is being made: by a program on this computer, or by a farm. Either is asked now and then what is new."""

import os
import pathlib
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import time

from .farm import Farm, FarmError, Unreachable

PROGRESS = re.compile(r"(\d+)\s*/\s*(\d+) iterations")
# How long a farm may be away while a job is followed [s].
ABSENCE = 600.0
FILE = "scene.glb"


class RenderFailed(Exception):
    """There is no picture, or no whole one; the text says what to do."""


class Wish:
    """What is to be rendered, and how."""

    def __init__(self, exported, settings, name):
        self.exported, self.name = exported, name
        self.integrator, self.photons = settings.integrator, settings.photons
        self.iterations, self.seed, self.noise = settings.iterations, settings.seed, settings.noise_target

    def spec(self, bundle):
        """The job as a farm takes it."""
        integrator = {"type": self.integrator}
        if self.integrator != "path":
            integrator["photons"] = self.photons
        spec = {
            "scene": bundle,
            "main": FILE,
            "name": self.name,
            "defines": self.exported.defines,
            "integrator": integrator,
            "iterations": self.iterations,
            "seed": self.seed,
        }
        if self.noise > 0:
            spec["schedule"] = {"noise_target": self.noise}
        return spec

    def arguments(self, scene, picture):
        """The same for the command line."""
        arguments = ["render", str(scene), "--output", str(picture), "--integrator", self.integrator]
        arguments += ["--iterations", str(self.iterations), "--seed", str(self.seed)]
        if self.integrator != "path":
            arguments += ["--set", f"photons={self.photons}"]
        for name, value in sorted(self.exported.defines.items()):
            arguments += ["-D", f"{name}={value}"]
        return arguments


class Local:
    """The program `photonfarm` at work on this computer."""

    def __init__(self, wish, program, threads, preview):
        found = shutil.which(program) or (program if os.access(program, os.X_OK) else None)
        if not found:
            raise RenderFailed(f"There is no program {program!r}. Choose photonfarm in the add-on's preferences, or render on a farm")
        self.done, self.total, self.message, self.warnings = 0, wish.iterations, "", []
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="photonfarm-"))
        self.path, self.seen, self.ended = self.folder / "picture.exr", None, False
        scene = self.folder / FILE
        scene.write_bytes(wish.exported.data)
        arguments = wish.arguments(scene, self.path) + ["--preview", str(max(1, round(preview)))]
        if threads:
            arguments += ["--threads", str(threads)]
        self.process = subprocess.Popen(
            [found, *arguments], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace"
        )
        self.said = []
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        # A bar may be drawn anew after a carriage return.
        for line in self.process.stderr:
            for part in line.replace("\r", "\n").splitlines():
                if found := PROGRESS.search(part):
                    self.done, self.message = int(found[1]), part.strip()
                elif part.startswith("warning:"):
                    self.warnings.append(part.removeprefix("warning:").strip())
                elif part.strip():
                    self.said.append(part.strip())

    def poll(self):
        """A new picture as bytes, if there is one. Sets `ended` with the last one."""
        ended = self.process.poll() is not None
        if ended:
            self.reader.join(timeout=5)
            if self.process.returncode != 0:
                raise RenderFailed(f"photonfarm ended without a picture: {' '.join(self.said[-3:]) or self.process.returncode}")
            self.done = self.total
        self.ended = ended
        try:
            when = self.path.stat().st_mtime_ns
            if when == self.seen:
                return None
            data = self.path.read_bytes()
        except FileNotFoundError:
            return None
        self.seen = when
        return data

    def cancel(self):
        """Stops the program."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)
            try:
                self.process.wait(timeout=5)
            except subprocess.TimeoutExpired:
                self.process.kill()

    def close(self):
        """Stops what goes on, and removes what was written."""
        self.cancel()
        self.reader.join(timeout=5)
        self.process.stderr.close()
        shutil.rmtree(self.folder, ignore_errors=True)


class Remote:
    """A job of a farm."""

    def __init__(self, farm, job, preview):
        self.farm, self.job, self.preview = farm, job, max(1.0, preview)
        self.done, self.total, self.message, self.warnings = 0, 1, "", []
        self.seen, self.looked, self.fetched, self.heard, self.ended = 0, 0.0, 0.0, time.monotonic(), False

    @classmethod
    def submitted(cls, farm, wish, preview):
        """Sends a scene and follows its job."""
        bundle = farm.send({FILE: wish.exported.data})
        return cls(farm, farm.submit(wish.spec(bundle))["id"], preview)

    def poll(self):
        """A new picture as bytes, if there is one. Sets `ended` with the last one."""
        now = time.monotonic()
        if now - self.looked < min(1.0, self.preview):
            return None
        self.looked = now
        try:
            status = self.farm.status(self.job)
            self.heard = now
            self._note(status)
            ended = status["state"] in ("done", "failed", "cancelled")
            new = status["iterations_done"] > self.seen and (ended or now - self.fetched >= self.preview)
            data = self.farm.picture(self.job) if new or (ended and self.seen == 0) else None
        except Unreachable as error:
            if now - self.heard > ABSENCE:
                raise RenderFailed(f"{error}. Job {self.job} goes on there: fetch its picture later") from error
            self.message = "the farm does not answer now; trying again"
            return None
        if data is not None:
            self.seen, self.fetched = status["iterations_done"], now
        self.ended = ended
        if status["state"] == "failed":
            raise RenderFailed(f"Job {self.job} failed: {status.get('failure') or 'iterations were given up'}")
        if status["state"] == "cancelled":
            raise RenderFailed(f"Job {self.job} was cancelled on the farm")
        return data

    def _note(self, status):
        self.done, self.total = status["iterations_done"], status["spec"]["iterations"]
        self.warnings = status.get("warnings") or []
        waiting = status.get("waiting")
        self.message = f"job {self.job}: {self.done} of {self.total} iterations" + (f"; {waiting}" if waiting else "")

    def cancel(self):
        """Ends the job."""
        try:
            self.farm.cancel(self.job)
        except FarmError:
            pass

    def close(self):
        """The job keeps its picture on the farm."""


def connect(preferences, online):
    """The farm of the add-on's preferences."""
    if not preferences.farm.strip():
        raise RenderFailed("No farm is set: enter its address in the add-on's preferences")
    farm = Farm(preferences.farm, preferences.token, preferences.authority)
    if not (farm.local or online):
        raise RenderFailed("Blender is offline: allow online access in Preferences > System > Network")
    return farm
