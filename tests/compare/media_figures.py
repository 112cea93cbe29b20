"""Repeats the figures on photon surfaces of `media_cells.py` and writes docs/results/media: tables, pictures and whether the claims hold.

Each cell has equal time: as many iterations as take `--seconds` of processor time on one thread, for each of `--seeds` seeds. What is
measured is kept in `--work`, a file for each cell, and is not measured again for the same program, scene and options.
"""

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from media_cells import CLAIMS, COMPARED, FIGURES, TRANSPORTS, cells
from media_report import write_report
from noise import block_means, luminance, sidak, z_scores

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "tests/scenes/surfaces"
# Into so many iterations the time of a cell with light paths is cut.
ITERATIONS = 16
# Fewest light paths of an iteration.
LIGHT_PATHS = 16
# Pictures of so many seeds are averaged on the sheets.
SHOWN = 4
# Blocks to a side in which cells without bias are compared, and how often noise alone makes one differ.
BLOCKS = 4
FALSE_ALARMS = 1e-4
# How the program says that it does not know a word of a list.
UNKNOWN = "expected a list of one or more of"
# Of a check: pixels across and down, light paths, iterations, seeds, and how often noise alone fails it. It finds most factors of two.
CHECK_SIZE, CHECK_PHOTONS, CHECK_ITERATIONS, CHECK_SEEDS = 16, 64, 12, 5
CHECK_FALSE_ALARMS = 3e-2


class NotThere(Exception):
    """The program does not have what a cell asks for."""


@dataclass(frozen=True)
class Cost:
    """Processor seconds: of an iteration with its layer, the share of these that the layer takes, and of what is no iteration."""

    both: float
    share: float
    start: float

    @property
    def iteration(self):
        return self.share * self.both


class Program:
    """The command line, one process and one thread per picture."""

    def __init__(self, binary, resolution):
        self.binary, self.resolution = str(binary), resolution
        with open(binary, "rb") as file:
            self.digest = hashlib.file_digest(file, "sha256").hexdigest()

    def render(self, cell, settings, iterations, seed, whole=False):
        """Light along the cell's paths, and the processor seconds of the process. With `whole` that of all paths, in about half the time."""
        transport = TRANSPORTS[cell.transport]
        paths = None if whole else transport.paths
        return self.run(transport.scene, transport.all_defines, cell.integrator, settings, iterations, seed, paths)

    def run(self, scene, defines, integrator, settings, iterations, seed, paths=None):
        """A picture, of the light along some paths or along all, and the processor seconds of the process."""
        with tempfile.TemporaryDirectory() as folder:
            out = os.path.join(folder, "picture.exr")
            command = [self.binary, "render", str(SCENES / f"{scene}.xml"), "-o", out, "--threads", "1"]
            command += ["--integrator", integrator, "--iterations", str(iterations), "--seed", str(seed)]
            command += ["--layer", f"part={paths}"] if paths else []
            for name, value in {**defines, "res": self.resolution}.items():
                command += ["-D", f"{name}={value}"]
            for name, value in settings.items():
                command += ["--set", f"{name}={value}"]
            with open(os.path.join(folder, "log"), "w+") as log:
                process = subprocess.Popen(command, stdout=log, stderr=log)
                try:
                    _, status, used = os.wait4(process.pid, 0)
                except BaseException:
                    process.kill()
                    raise
                process.returncode = os.waitstatus_to_exitcode(status)
                log.seek(0)
                said = log.read().strip()
            if process.returncode and UNKNOWN in said:
                raise NotThere(f"the program does not know all of `{settings['surfaces']}`")
            if process.returncode:
                raise RuntimeError(f"{' '.join(command)}\nended with status {process.returncode}\n{said}")
            channels = OpenEXR.File(out, separate_channels=True).channels()
            group = "part." if paths else ""
            picture = np.stack([channels[group + letter].pixels for letter in "RGB"], axis=-1)
            return picture.astype(np.float64), used.ru_utime + used.ru_stime

    def cost(self, cell, settings, seconds):
        """What iterations cost, from runs of about `seconds` with the light that counts and without."""
        iterations, one = 1, self.render(cell, settings, 1, 0)[1]
        took = one
        while took - one < seconds and iterations < 1 << 16:
            iterations *= 4
            took = self.render(cell, settings, iterations, 0)[1]
        both = max((took - one) / (iterations - 1), 1e-6)
        without = self.render(cell, settings, iterations, 0, whole=True)[1]
        # The bounds are for runs so short that the difference is noise.
        share = min(max((took - without) / iterations / both, 0.2), 0.8)
        return Cost(both, share, max(one - both, 0.0))

    def calibrated(self, cell, seconds):
        """Settings with a number of light paths, iterations that take `seconds`, and what they cost."""
        settings = dict(cell.settings)
        if cell.integrator == "path":
            cost = self.cost(cell, settings, 0.5 * seconds)
        else:
            # The cost is that of the camera paths and, in proportion, that of the light paths.
            base = self.cost(cell, {**settings, "photons": 1}, 0.1 * seconds).iteration
            for many in (16, 64, 256, 1024, 4096):
                more = self.cost(cell, {**settings, "photons": many}, 0.1 * seconds).iteration - base
                if more > base:
                    break
            photons = (seconds / ITERATIONS - base) * many / max(more, 1e-2 * base)
            settings["photons"] = int(min(max(photons, LIGHT_PATHS), 1_000_000))
            cost = self.cost(cell, settings, 0.5 * seconds)
        return settings, max(1, round(seconds / cost.iteration)), cost


def renders(program, cell, settings, iterations, seeds, jobs):
    """What `Program.render` gives for seeds from 1 on, in their order, by so many processes at once."""
    pool = ThreadPoolExecutor(jobs)
    try:
        yield from pool.map(lambda seed: program.render(cell, settings, iterations, seed), range(1, seeds + 1))
    finally:
        pool.shutdown(cancel_futures=True)


def measure(program, cell, seeds, seconds, jobs):
    """What `seeds` pictures of a cell say, as arrays; variances are brought to exactly `seconds`."""
    settings, iterations, cost = program.calibrated(cell, seconds)
    mean, squares, shown, singles, blocks, took = 0, 0, 0, [], [], []
    for seed, (picture, used) in enumerate(renders(program, cell, settings, iterations, seeds, jobs), 1):
        took.append(used - cost.start)
        shown = picture if seed == 1 else shown + (picture - shown) / seed if seed <= SHOWN else shown
        light = luminance(picture)
        # Welford's update, with the squared deviations of each seed for the error of their mean.
        before = mean
        mean = mean + (light - mean) / seed
        squares = squares + (light - before) * (light - mean)
        singles.append(light.astype(np.float32))
        blocks.append(block_means(light[None, ..., None], len(light) // BLOCKS)[0])
    iteration = cost.share * np.mean(took) / iterations
    equal = float(iterations * iteration / seconds)
    variance = squares / (seeds - 1) * equal
    each = ((np.stack(singles) - mean) ** 2).mean((1, 2)) * equal * seeds / (seeds - 1)
    worst = np.sort(variance.ravel())[::-1]
    told = {
        "photons": settings.get("photons", 0),
        "iterations": iterations,
        "cost": float(iteration),
        "seeds": seeds,
        "variance": float(variance.mean()),
        "variance_error": float(each.std(ddof=1) / np.sqrt(seeds)),
        "worst_share": float(worst[: max(1, round(1e-3 * worst.size))].sum() / max(worst.sum(), 1e-300)),
        "equal": equal,
    }
    return told, {"mean": mean, "shown": shown, "blocks": np.stack(blocks)}


def fingerprint(program, cell, seeds, seconds):
    """What a kept measurement was of."""
    transport = TRANSPORTS[cell.transport]
    parts = [program.resolution, seeds, seconds, cell.integrator, sorted(cell.settings.items()), transport.paths]
    parts += [sorted(transport.all_defines.items()), program.digest]
    files = [SCENES / f"{transport.scene}.xml", *sorted(SCENES.glob("*.ply")), *sorted(SCENES.glob("*.vol"))]
    return hashlib.sha256(json.dumps(parts).encode() + b"".join(file.read_bytes() for file in files)).hexdigest()


def kept_or_measured(program, cell, work, options):
    """A cell's numbers and arrays, from `work` where they are there."""
    stem = hashlib.sha256(cell.name.encode()).hexdigest()[:16]
    numbers, arrays = work / f"{stem}.json", work / f"{stem}.npz"
    mark = fingerprint(program, cell, options.seeds, options.seconds)
    if numbers.exists():
        told = json.loads(numbers.read_text())
        if told["of"] == mark:
            return told, dict(np.load(arrays))
    told, there = measure(program, cell, options.seeds, options.seconds, options.jobs)
    told |= {"of": mark, "name": cell.name}
    np.savez_compressed(arrays, **there)
    # Written last, in one step: what has numbers is whole.
    partial = numbers.with_suffix(".partial")
    partial.write_text(json.dumps(told, indent=1))
    partial.replace(numbers)
    return told, there


def add_errors(found):
    """Adds to the numbers of each cell its error: variance, and squared bias where there is one, against the mean of the cells without."""
    for transport in {cell.transport for cell, _, _ in found.values()}:
        group = [entry for entry in found.values() if entry[0].transport == transport]
        truth = [entry for entry in group if not entry[0].biased and entry[1]["variance"] > 0]
        weights = [told["seeds"] * told["equal"] / told["variance"] for _, told, _ in truth]
        for cell, told, there in group:
            told["error"], told["error_error"] = told["variance"], told["variance_error"]
            if cell.biased and truth:
                reference = sum(w * arrays["mean"] for w, (_, _, arrays) in zip(weights, truth)) / sum(weights)
                own = told["variance"] / told["equal"] / told["seeds"]
                bias = ((there["mean"] - reference) ** 2).mean() - own - 1 / sum(weights)
                told["bias"] = float(max(bias, 0.0))
                told["error"] += told["bias"]
                # The bias is known to about the noise that was taken from it.
                told["error_error"] = float(np.hypot(told["variance_error"], own + 1 / sum(weights)))


def disagreements(found):
    """Cells without bias whose blocks differ from those of their transport's first such cell by more than noise explains."""
    pairs = []
    for name, (cell, _, there) in found.items():
        others = [entry for entry in found.values() if entry[0].transport == cell.transport and not entry[0].biased]
        if not cell.biased and others[0][0] is not cell:
            pairs.append((name, np.abs(z_scores(there["blocks"], others[0][2]["blocks"])).max()))
    limit = sidak(FALSE_ALARMS, BLOCKS**2 * max(len(pairs), 1))
    return pairs, limit


def check(program, chosen):
    """Renders every cell small, and compares those of `COMPARED` with path tracing by their means; returns what is wrong."""

    def pictures(cell, compared):
        # An iteration of path tracing takes a fraction of the others' time.
        by_path = cell.integrator == "path"
        settings = cell.settings if by_path else {**cell.settings, "photons": CHECK_PHOTONS}
        iterations = CHECK_ITERATIONS * (12 if by_path else 1) if compared else 1
        seeds = range(CHECK_SEEDS if compared else 1)
        try:
            return np.stack([program.render(cell, settings, iterations, seed)[0] for seed in seeds])
        except (NotThere, RuntimeError) as error:
            return error

    baselines = {f"{cell.transport}: path" for cell in chosen if cell.name in COMPARED}
    compared = [cell.name in COMPARED or cell.name in baselines for cell in chosen]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        stacks = dict(zip((cell.name for cell in chosen), pool.map(pictures, chosen, compared)))
    wrong = [f"{name}: {stack}" for name, stack in stacks.items() if isinstance(stack, Exception)]
    ran = {name: stack for name, stack in stacks.items() if not isinstance(stack, Exception)}
    wrong += [f"{name}: black, or not finite" for name, stack in ran.items() if not np.isfinite(stack).all() or not stack.any()]
    limit, largest = sidak(CHECK_FALSE_ALARMS, len(COMPARED)), 0.0
    for cell in chosen:
        other = f"{cell.transport}: path"
        if cell.name in COMPARED and cell.name in ran and other in ran:
            a, b = (luminance(ran[name]).mean((1, 2)) for name in (cell.name, other))
            z = float(abs(z_scores(a, b)))
            largest = max(largest, z)
            if z > limit:
                wrong.append(f"{cell.name}: {a.mean():.4g}, and by path tracing {b.mean():.4g}; |z| {z:.1f} is above {limit:.1f}")
    print(f"{len(ran)} of {len(chosen)} cells ran; largest |z| {largest:.2f}, limit {limit:.2f}")
    return wrong


def whole_scenes(program, work, iterations):
    """All light of each scene, by photon beams, from `work` where it is there."""
    pictures = {}
    for scene in sorted({transport.scene for transport in TRANSPORTS.values()}):
        file = work / f"{scene}-{program.resolution}-{iterations}-{program.digest[:16]}.npy"
        if not file.exists():
            settings = {"media": "beams", "photons": 4_000}
            np.save(file, program.run(scene, {}, "pppm", settings, iterations, 0)[0])
        pictures[scene] = np.load(file)
    return pictures


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photonfarm", type=Path, default=ROOT / "target/release/photonfarm", help="the program, or its folder")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=2.0, help="processor time of each seed")
    parser.add_argument("--jobs", type=int, default=1, help="processes at once, of one thread each")
    parser.add_argument("--resolution", type=int, default=128, help="pixels across and down, a multiple of four")
    parser.add_argument("--only", help="figures, by their numbers, as 3,5")
    parser.add_argument("--work", type=Path, default=ROOT / "target/media-figures", help="folder that keeps what is measured")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/results/media")
    parser.add_argument("--check", action="store_true", help="small and quick: every cell runs, and some agree with path tracing")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended; the same command goes on"))
    if options.seeds < 2 or options.jobs < 1 or options.seconds <= 0 or options.resolution < 8 or options.resolution % 4:
        parser.error("there have to be 2 seeds, a job, some seconds, and a resolution of 8, 12, 16, ... pixels")
    binary = options.photonfarm / "photonfarm" if options.photonfarm.is_dir() else options.photonfarm
    try:
        figures = {int(number): FIGURES[int(number)] for number in options.only.split(",")} if options.only else FIGURES
    except (ValueError, KeyError):
        parser.error(f"--only takes some of {','.join(map(str, FIGURES))}")
    every = cells()
    wanted = {cell.name for figure in figures.values() for cell in figure.cells(every)}
    chosen = [cell for cell in every.values() if cell.name in wanted]
    if options.check:
        wrong = check(Program(binary.resolve(), CHECK_SIZE), chosen)
        return "\n".join(wrong) or None

    program = Program(binary.resolve(), options.resolution)
    options.work.mkdir(parents=True, exist_ok=True)
    found, missing = {}, {}
    for number, cell in enumerate(chosen, 1):
        try:
            found[cell.name] = (cell, *kept_or_measured(program, cell, options.work, options))
            told = found[cell.name][1]
            said = f"variance {told['variance']:.3e} +- {told['variance_error']:.1e}, {told['iterations']} iterations of {told['cost']:.3f} s"
        except NotThere as error:
            missing[cell.name] = said = str(error)
        print(f"{number}/{len(chosen)} {cell.name}: {said}", flush=True)
    add_errors(found)
    pairs, limit = disagreements(found)
    whole = whole_scenes(program, options.work, max(4, round(16 * options.seconds)))
    write_report(options, figures, every, found, missing, CLAIMS, (pairs, limit), whole)
    return None


if __name__ == "__main__":
    sys.exit(main())
