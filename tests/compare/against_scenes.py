"""Loads and renders every scene of a folder in every format, and writes a table and a sheet of pictures.

Each scene is rendered by `path` beside the picture that came with it and beside Mitsuba, where Mitsuba reads the same file. Scenes that
came with mean and variance of each pixel are judged pixel by pixel. A scene of which a material was replaced by a simpler one, or of
which something was left out, is shown and does not count.
"""

import argparse
import json
import math
import pathlib
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field

import mitsuba
import numpy as np

from noise import luminance, sidak
from renderers import Mitsuba, Photonfarm, read_picture

ROOT = pathlib.Path(__file__).resolve().parents[2]
# What is asked: of all scenes so many load, and of those that can be compared the means of so many lie so near.
LOADED, NEAR, WITHIN = 0.9, 0.8, 0.03
# Probability that noise alone fails a scene that is judged pixel by pixel, and the share of pixels that may lie beyond the bound:
# Mitsuba's own tests of the same pictures allow a quarter of a percent, since their variances are estimates too.
RATE, OUTSIDE = 0.01, 0.0025
# Renders of so many samples each. The stored means are as noisy as those of about so many samples: so Mitsuba's own renders differ from them.
RENDERS, SAMPLES, STORED_SAMPLES = 16, 64, 6400
# With --quick, which hides smaller differences: a variance of four values is itself so noisy that more values lie outside.
QUICK_RENDERS, QUICK_OUTSIDE = 4, 0.005
# The smallest variance that counts, as in those tests: some pixels of theirs have none.
LEAST_VARIANCE = 1e-4
# Scenes whose reference is not what the file says, and why.
UNLIKE = {
    "test_texturedprincipled1_path.xml": "Mitsuba 3 swaps the two colours of a checkerboard where a number is looked up",
}
THUMBNAIL = 240
# Pictures that came with a scene, by the scene's folder: their names are no rule. The first that is there counts.
STORED = ["scene_v3.exr", "scene.exr", "TungstenRender.exr", "reference-tungsten.exr"]


@dataclass
class Row:
    """What became of one scene."""

    name: str
    format: str = ""
    problem: str = ""
    warnings: list = field(default_factory=list)
    # Our mean over the other's: of the stored picture, and of Mitsuba's.
    stored: float = math.nan
    mitsuba: float = math.nan
    # Relative standard error of our mean.
    noise: float = 0
    # Share of pixels beyond the bound, for scenes with a variance, and how large it may be.
    outside: float = math.nan
    most_outside: float = OUTSIDE
    seconds: float = 0
    pictures: list = field(default_factory=list)

    def incomplete(self):
        """Whether files that it names are not there, so that no program can load it."""
        return "was not found" in self.problem

    def replaced(self):
        """Whether something is not rendered as it is written, or the reference is not."""
        return pathlib.Path(self.name).name in UNLIKE or any(re.search(r"stands in|is rendered as|left out|approximat|does not exist yet", w) for w in self.warnings)

    def ratios(self):
        return [ratio for ratio in (self.stored, self.mitsuba) if not math.isnan(ratio)]

    def near(self):
        """Whether some mean to compare with is near: stored pictures can be of another program or version."""
        return any(abs(ratio - 1) <= WITHIN for ratio in self.ratios()) or self.outside <= self.most_outside


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help="folder of scenes made by others")
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument("--out", type=pathlib.Path, help="folder that takes table and sheet")
    parser.add_argument("--only", default="", help="only scenes whose path contains this")
    parser.add_argument("--width", type=int, default=320, help="pictures that are wider are rendered this wide")
    parser.add_argument("--samples", type=int, default=256, help="samples of each pixel")
    parser.add_argument("--quick", action="store_true", help="renders only what is judged pixel by pixel; the others are loaded")
    parser.add_argument("--gain", type=float, default=1, help="brightens our pictures: a check of this test")
    return parser.parse_args()


def scene_files(folder):
    """Main files: those that describe a camera or a world and that no other file includes."""
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".xml", ".pbrt", ".gltf", ".glb")]
    texts = {path: "" if path.suffix == ".glb" else path.read_text(errors="replace") for path in files}
    # Names are looked for in several folders, so their endings are compared.
    included = set()
    for text in texts.values():
        for name in re.findall(r'<include\s+filename="([^"]+)"|Include\s+"([^"]+)"', text):
            included.add("/" + re.sub(r"^(\.*/)*", "", name[0] or name[1]))
    whole = re.compile(r"<(shape|include)\b|WorldBegin|\"asset\"")
    main = [path for path in files if not any(str(path).endswith(name) for name in included)]
    return [path for path in main if path.suffix == ".glb" or whole.search(texts[path])]


def smaller(path, width):
    """The scene file's text with a film of at most `width` pixels across."""
    text = path.read_text()
    patterns = {
        ".xml": (r'(<integer name="{0}" value=")(\d+)(")', ("width", "height")),
        ".pbrt": (r'("integer {0}" *\[? *)(\d+)()', ("xresolution", "yresolution")),
    }
    pattern, names = patterns[path.suffix]
    text = re.sub(r"\$(resx|resy|width|height|res)\b", lambda m: default_of(text, m.group(1)) or m.group(0), text)
    found = [re.search(pattern.format(name), text) for name in names]
    if not all(found) or int(found[0].group(2)) <= width:
        return text
    scale = width / int(found[0].group(2))
    for name in names:
        text = re.sub(pattern.format(name), lambda m: f"{m[1]}{round(int(m[2]) * scale)}{m[3]}", text)
    return text


def default_of(text, name):
    found = re.search(rf'<default name="{name}" value="(\d+)"', text)
    return found and found.group(1)


def overlay(root, path, text, into):
    """A copy of the folder tree `root` by links, in which `path` has another text; nothing is written where the scenes lie."""
    target = into
    inner = path.relative_to(root).parts
    source = root
    for part in inner[:-1]:
        link_all(source, target, part)
        source, target = source / part, target / part
        target.mkdir()
    link_all(source, target, inner[-1])
    (target / inner[-1]).write_text(text)
    return target / inner[-1]


def link_all(source, target, but):
    for entry in source.iterdir():
        if entry.name != but:
            (target / entry.name).symlink_to(entry)


def check(binary, path):
    """What `photonfarm check` says, as JSON."""
    done = subprocess.run([str(binary), "check", str(path), "--json"], capture_output=True, text=True)
    try:
        return json.loads(done.stdout)
    except json.JSONDecodeError:
        return {"errors": [done.stderr.strip() or f"ended with status {done.returncode}"], "warnings": []}


def stored_picture(path):
    """The picture that came with a scene, if any."""
    beside = [path.parent / name for name in STORED]
    return next((picture for picture in beside if picture.is_file()), None)


def shrunk(picture, height, width):
    """The picture averaged down to about this size; infinite pixels are left out of the average."""
    rows = np.linspace(0, picture.shape[0], height + 1).astype(int)
    columns = np.linspace(0, picture.shape[1], width + 1).astype(int)
    good = np.isfinite(picture).all(-1, keepdims=True)
    sums = np.where(good, picture, 0)
    add = lambda values: np.add.reduceat(np.add.reduceat(values, rows[:-1], 0), columns[:-1], 1)
    return add(sums) / np.maximum(add(good.astype(float)), 1)


def mean_ratio(ours, other):
    """Ratio of the means without the brightest fiftieth of the other's pixels, which few samples do not settle."""
    a, b = luminance(ours), luminance(other)
    keep = b <= np.quantile(b, 0.98)
    return float(a[keep].mean() / b[keep].mean())


def judge_by_variance(options, path, row):
    """Holds our picture against stored mean and variance of each pixel."""
    name = path.stem.rsplit("_", 1)[0]
    reference, variance = (path.parent / "refs" / f"{name}_ref_rgb{end}.exr" for end in ("", "_var"))
    if not (reference.is_file() and variance.is_file()):
        return False
    if options.quick and row.replaced():
        return True
    renders, row.most_outside = (QUICK_RENDERS, QUICK_OUTSIDE) if options.quick else (RENDERS, OUTSIDE)
    expected, variance = read_picture(reference), np.maximum(read_picture(variance), LEAST_VARIANCE)
    settings = {"samples": 16, "sampling": "independent"}
    stack = Photonfarm(options.photonfarm).renders(path, {}, "path", settings, SAMPLES // 16, range(1, renders + 1)) * options.gain
    ours = stack.mean(0)
    row.pictures = [ours, expected]
    if ours.shape != expected.shape:
        row.problem = f"the picture has {ours.shape[1]} x {ours.shape[0]} pixels, the stored one {expected.shape[1]} x {expected.shape[0]}"
        return True
    # Bright paths that few samples find are missing from either estimate of the variance: the larger one counts.
    variance = np.maximum(variance, stack.var(0, ddof=1) * SAMPLES)
    z = (ours - expected) / np.sqrt(variance * (1 / (renders * SAMPLES) + 1 / STORED_SAMPLES))
    row.outside = float((abs(z) > sidak(RATE, z[..., 0].size)).mean())
    row.stored = mean_ratio(ours, expected)
    return True


def compare(options, path, row):
    """Renders a scene beside what there is to compare it with."""
    if judge_by_variance(options, path, row) or options.quick:
        return
    with tempfile.TemporaryDirectory() as folder:
        root = options.folder.resolve()
        if path.suffix in (".xml", ".pbrt"):
            path_here = overlay(root, path.resolve(), smaller(path, options.width), pathlib.Path(folder))
        else:
            path_here = path
        settings = {"samples": 16}
        ours = Photonfarm(options.photonfarm).renders(path_here, {}, "path", settings, options.samples // 16, [1])[0] * options.gain
        row.pictures = [ours]
        stored = stored_picture(path)
        if stored:
            other = shrunk(read_picture(stored), *ours.shape[:2])
            row.stored = mean_ratio(ours, other)
            row.pictures.append(other)
        if path.suffix == ".xml":
            try:
                other = Mitsuba().renders(path_here, {}, options.samples, [1])[0]
                row.mitsuba = mean_ratio(ours, other)
                row.pictures.append(other)
            except Exception as error:  # Mitsuba reads few of the old scenes; that is no fault of ours.
                print(f"    Mitsuba does not render it: {str(error).strip().splitlines()[-1][:120]}")


def percent(value):
    return "" if math.isnan(value) else f"{100 * (value - 1):+.1f} %"


def table(rows, verdicts):
    """The page."""
    lines = [
        "# Scenes made by others",
        "",
        "Written by `tests/compare/scenes FOLDER`. Our mean by `path` beside that of the picture that came with the scene, and beside",
        "Mitsuba 3.9.1 rendering the same file; the brightest fiftieth of the pixels is left out of means. *Outside*: pixels that differ",
        "from a stored mean by more than its stored variance explains. A scene of which something is replaced or left out is shown in",
        "brackets and does not count.",
        "",
        *verdicts,
        "",
        "| scene | format | beside the stored picture | beside Mitsuba | outside | warnings |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        outside = "" if math.isnan(row.outside) else f"{row.outside:.2%}"
        name = f"({row.name})" if row.replaced() else row.name
        unlike = UNLIKE.get(pathlib.Path(row.name).name)
        said = row.problem or unlike or "; ".join(re.sub(r"^[^ ]*: ", "", warning) for warning in row.warnings[:3])
        if len(row.warnings) > 3 and not row.problem:
            said += f"; and {len(row.warnings) - 3} more"
        said = said.replace("|", "\\|").replace("\n", " ")
        lines.append(f"| {name} | {row.format} | {percent(row.stored)} | {percent(row.mitsuba)} | {outside} | {said} |")
    return "\n".join(lines) + "\n"


def sheet(rows, path):
    """All pictures in rows: ours, and those that it is compared with."""
    strips = []
    for row in rows:
        cells = []
        for picture in row.pictures[:3]:
            height = max(1, round(THUMBNAIL * picture.shape[0] / picture.shape[1]))
            if picture.shape[1] >= THUMBNAIL:
                cell = shrunk(picture, height, THUMBNAIL)
            else:
                rows_at = np.arange(height) * picture.shape[0] // height
                cell = picture[rows_at][:, np.arange(THUMBNAIL) * picture.shape[1] // THUMBNAIL]
            cells.append(cell)
        if cells:
            # One exposure for all pictures of a scene.
            scale = 0.5 / max(np.quantile(luminance(cells[0]), 0.8), 1e-6)
            cells = [np.clip(cell * scale, 0, 1) ** (1 / 2.2) for cell in cells]
            cells += [np.zeros_like(cells[0])] * (3 - len(cells))
            tall = max(cell.shape[0] for cell in cells)
            cells = [np.pad(cell, ((0, tall - cell.shape[0]), (0, 4), (0, 0))) for cell in cells]
            strips.append(np.pad(np.concatenate(cells, 1), ((0, 4), (0, 0), (0, 0))))
    columns = [strips[i::3] for i in range(3)]
    columns = [np.concatenate(column) for column in columns if column]
    tall = max(column.shape[0] for column in columns)
    picture = np.concatenate([np.pad(column, ((0, tall - column.shape[0]), (0, 8), (0, 0))) for column in columns], 1)
    mitsuba.Bitmap((picture * 255 + 0.5).astype(np.uint8)).write(str(path))


def verdict(rows):
    """What the rows say, and whether it is what is asked."""
    complete = [row for row in rows if not row.incomplete()]
    loaded = [row for row in complete if not row.problem]
    counted = [row for row in loaded if not row.replaced() and (row.ratios() or not math.isnan(row.outside))]
    near = [row for row in counted if row.near()]
    judged = [row for row in counted if not math.isnan(row.outside)]
    kept = [row for row in judged if row.outside <= row.most_outside]
    lines = [
        f"* {len(loaded)} of {len(complete)} scenes load (asked: {LOADED:.0%}); {len(rows) - len(complete)} more lack files that they name.",
        f"* The mean of {len(near)} of {len(counted)} that count lies within {WITHIN:.0%} of one to compare with (asked: {NEAR:.0%}).",
        f"* {len(kept)} of {len(judged)} that are judged pixel by pixel have few enough of the pixels outside (asked: {OUTSIDE:.2%}, and {QUICK_OUTSIDE:.2%} with --quick).",
    ]
    well = len(loaded) >= LOADED * len(complete) and len(near) >= NEAR * len(counted) and len(kept) == len(judged)
    return lines, well


def main():
    options = arguments()
    rows = []
    for path in scene_files(options.folder):
        name = str(path.relative_to(options.folder))
        if options.only not in name:
            continue
        start = time.monotonic()
        told = check(options.photonfarm, path)
        row = Row(name, told.get("format", ""), "; ".join(told.get("errors", [])), told["warnings"])
        if not row.problem:
            compare(options, path, row)
        row.seconds = time.monotonic() - start
        rows.append(row)
        print(f"{name:75} {percent(row.stored):>8} {percent(row.mitsuba):>8} {row.outside:7.2%} {row.seconds:4.0f} s {row.problem[:200]}", flush=True)
    if not rows:
        sys.exit(f"error: no scene in {options.folder}")
    lines, well = verdict(rows)
    print("\n".join(lines))
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "scenes.md").write_text(table(rows, lines))
        sheet(rows, options.out / "scenes.png")
    if not well:
        sys.exit("FAILED: the scenes are not as asked")


if __name__ == "__main__":
    main()
