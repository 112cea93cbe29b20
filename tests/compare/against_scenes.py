"""Loads and renders every scene of a folder in every format, and writes a table and a sheet of pictures.

Each scene is rendered by `path` beside the picture that came with it, beside Mitsuba, where Mitsuba reads the same file, and beside
the same scene in another format. Noise is measured from independent renders; where that of `path` stays too large, `vcm` renders the
scene again. Scenes that came with mean and variance of each pixel are judged pixel by pixel. A scene of which a material was replaced
by a simpler one, or of which something was left out, is shown and does not count.
"""

import argparse
import json
import math
import pathlib
import re
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field

import numpy as np

from modernise import modernise, without_unknown
from noise import block_means, luminance, sidak
from renderers import Mitsuba, Photonfarm, processor_seconds, read_picture
from scenes_known import EDITS, SAME, UNLIKE, found
from scenes_sheet import sheet, shrunk

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
# Relative standard error of a mean at which rendering ends, and the one above which the mean by `path` says nothing.
ENOUGH, TOO_MUCH = 0.004, 0.02
# Independent renders before noise is measured, and samples of each.
FIRST, ROUND_SAMPLES = 4, 16
# Pictures that came with a scene: their names are no rule. The first that is there counts, beside the scene or in the folders of its other formats.
STORED = ["scene_v3.exr", "scene.exr", "TungstenRender.exr", "reference-tungsten.exr"]


@dataclass
class Ratio:
    """Our mean over another's, and the standard error of that by what noise is known."""

    value: float = math.nan
    error: float = 0

    def there(self):
        return not math.isnan(self.value)

    def near(self):
        return self.there() and abs(self.value - 1) <= WITHIN

    def __str__(self):
        if not self.there():
            return ""
        return f"{100 * (self.value - 1):+.1f} %" + (f" ({100 * self.error:.1f})" if self.error else "")


@dataclass
class Row:
    """What became of one scene."""

    name: str
    format: str = ""
    problem: str = ""
    warnings: list = field(default_factory=list)
    # The integrator that rendered what is compared.
    by: str = "path"
    stored: Ratio = field(default_factory=Ratio)
    mitsuba: Ratio = field(default_factory=Ratio)
    # To the same scene in another format, and which one that is.
    other: Ratio = field(default_factory=Ratio)
    beside: str = ""
    # Share of pixels beyond the bound, for scenes with a variance, and how large it may be.
    outside: float = math.nan
    most_outside: float = OUTSIDE
    seconds: float = 0
    # Our renders, and a picture to show beside them.
    ours: object = None
    shown: object = None

    def incomplete(self):
        """Whether files that it names are not there, so that no program can load it."""
        return "was not found" in self.problem

    def unlike(self):
        """Why the picture to compare with is not what the file says, if so."""
        return found(self.name, UNLIKE)

    def replaced(self):
        """Whether something is not rendered as it is written."""
        return any(re.search(r"stands in|is rendered as|<?(medium|media)>? (is|are) left out|approximat|does not exist|out of the picture", w) for w in self.warnings)

    def counts(self):
        """Whether the comparison says something about us."""
        compared = self.stored.there() or self.mitsuba.there() or not math.isnan(self.outside)
        return not self.problem and not self.replaced() and not self.unlike() and compared

    def near(self):
        """Whether some mean to compare with is near: stored pictures can be of another program or version."""
        return self.stored.near() or self.mitsuba.near()

    def verdict(self):
        if self.incomplete():
            return "lacks files"
        if self.problem:
            return "does not load"
        if self.replaced():
            return "does not count: something is replaced or left out"
        if self.unlike():
            return "does not count: the picture is of another scene"
        if not self.counts():
            return "nothing to compare with" if not self.other.there() else ""
        kept = math.isnan(self.outside) or self.outside <= self.most_outside
        return "near" if self.near() and kept else "**differs**"


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help="folder of scenes made by others")
    parser.add_argument("--photonfarm", default=ROOT / "target/release/photonfarm", help="the binary")
    parser.add_argument("--out", type=pathlib.Path, help="folder that takes table and sheet")
    parser.add_argument("--only", default="", help="only scenes whose path contains this")
    parser.add_argument("--width", type=int, default=256, help="pictures that are wider are rendered this wide")
    parser.add_argument("--seconds", type=float, default=20, help="processor time for each picture, which ends sooner where its noise is low")
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


def smaller(text, suffix, width):
    """The text of a scene file, which ends in `suffix`, with a film of at most `width` pixels across."""
    patterns = {
        ".xml": (r'(<integer name="{0}" value=")(\d+)(")', ("width", "height")),
        ".pbrt": (r'("integer {0}" *\[? *)(\d+)()', ("xresolution", "yresolution")),
    }
    pattern, names = patterns[suffix]
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
    folders = [path.parent, *sorted(p for p in path.parent.parent.iterdir() if p.is_dir() and not p.is_symlink())]
    return next((folder / name for folder in folders for name in STORED if (folder / name).is_file()), None)


def noise_of(stack, keep):
    """Relative standard error of the mean luminance over the pixels `keep` of independent renders.

    It adds up the variances of blocks of pixels, which are many values where whole renders are few.
    """
    lit = (luminance(stack) * keep)[..., None]
    blocks = block_means(lit, 8)
    return float(np.sqrt((blocks.var(0, ddof=1) / len(stack)).sum()) / max(blocks.mean(0).sum(), 1e-30))


def until_quiet(render, seconds, who):
    """Independent renders, one for each seed, until their noise is low or the processor time is spent."""
    begun, pictures = processor_seconds(who), []
    while True:
        wanted = 2 * len(pictures) or FIRST
        pictures += [render(seed) for seed in range(len(pictures) + 1, wanted + 1)]
        stack = np.stack(pictures)
        spent = processor_seconds(who) - begun
        if noise_of(stack, np.isfinite(stack).all((0, -1))) < ENOUGH or 2 * spent > seconds:
            return stack


def ratio_to_picture(stack, other):
    """To a picture whose noise is not known; its brightest fiftieth, where its own fireflies are, is left out.

    So are the pixels about those: a lamp's edge lies as wide as the pixels of a picture are, and ours are larger.
    """
    bright = luminance(other)
    finite = np.isfinite(bright)
    out = np.pad(~finite | (bright > np.quantile(bright[finite], 0.98)), 1)
    height, width = bright.shape
    keep = ~np.any([out[y : y + height, x : x + width] for y in range(3) for x in range(3)], axis=0)
    ours = luminance(stack.mean(0))
    return Ratio(float(ours[keep].mean() / bright[keep].mean()), noise_of(stack, keep))


def ratio_of(stack, others):
    """To other renders."""
    keep = np.isfinite(stack).all((0, -1)) & np.isfinite(others).all((0, -1))
    mean = lambda pictures: float(luminance(pictures.mean(0))[keep].mean())
    return Ratio(mean(stack) / max(mean(others), 1e-30), math.hypot(noise_of(stack, keep), noise_of(others, keep)))


def judge_by_variance(options, path, row):
    """Holds our picture against stored mean and variance of each pixel."""
    name = path.stem.rsplit("_", 1)[0]
    reference, variance = (path.parent / "refs" / f"{name}_ref_rgb{end}.exr" for end in ("", "_var"))
    if not (reference.is_file() and variance.is_file()):
        return False
    if options.quick and (row.replaced() or row.unlike()):
        return True
    renders, row.most_outside = (QUICK_RENDERS, QUICK_OUTSIDE) if options.quick else (RENDERS, OUTSIDE)
    expected, variance = read_picture(reference), np.maximum(read_picture(variance), LEAST_VARIANCE)
    settings = {"samples": 16, "sampling": "independent"}
    row.ours = Photonfarm(options.photonfarm).renders(path, {}, "path", settings, SAMPLES // 16, range(1, renders + 1)) * options.gain
    row.shown = expected
    ours = row.ours.mean(0)
    if ours.shape != expected.shape:
        row.problem = f"the picture has {ours.shape[1]} x {ours.shape[0]} pixels, the stored one {expected.shape[1]} x {expected.shape[0]}"
        return True
    # Bright paths that few samples find are missing from either estimate of the variance: the larger one counts.
    variance = np.maximum(variance, row.ours.var(0, ddof=1) * SAMPLES)
    z = (ours - expected) / np.sqrt(variance * (1 / (renders * SAMPLES) + 1 / STORED_SAMPLES))
    row.outside = float((abs(z) > sidak(RATE, z[..., 0].size)).mean())
    row.stored = ratio_to_picture(row.ours, expected)
    return True


def compare(options, path, row, edit=None):
    """Renders a scene beside what there is to compare it with."""
    if not edit and judge_by_variance(options, path, row) or options.quick:
        return
    with tempfile.TemporaryDirectory() as folder:
        root = options.folder.resolve()
        here = path
        if path.suffix in (".xml", ".pbrt"):
            text = edit.apply(path.read_text()) if edit else path.read_text()
            here = overlay(root, path.resolve(), smaller(text, path.suffix, options.width), pathlib.Path(folder))
        ours = Photonfarm(options.photonfarm)
        render = lambda by, settings: until_quiet(
            lambda seed: ours.renders(here, {}, by, settings, 1, [seed])[0], options.seconds, resource.RUSAGE_CHILDREN
        )
        row.ours = render("path", {"samples": ROUND_SAMPLES})
        if noise_of(row.ours, np.isfinite(row.ours).all((0, -1))) > TOO_MUCH:
            row.by, row.ours = "vcm", render("vcm", {"samples": 1})
        row.ours = row.ours * options.gain
        stored = stored_picture(path)
        if stored and (not edit or edit.as_stored):
            row.shown = shrunk(read_picture(stored), *row.ours.shape[1:3])
            row.stored = ratio_to_picture(row.ours, row.shown)
        if path.suffix == ".xml" and row.by == "path":
            others = by_mitsuba(options, here)
            if others is not None:
                row.mitsuba = ratio_of(row.ours, others)
                row.shown = others.mean(0) if row.shown is None else row.shown


def by_mitsuba(options, path):
    """Mitsuba's renders of the file, which is rewritten where it is of an old version; nothing where Mitsuba cannot."""
    text = path.read_text()
    # The skies of old versions are other ones there.
    if re.search(r'type="(sky|sun|sunsky)"', text) and re.search(r'version="0', text):
        return None
    changed = False
    while True:
        try:
            return until_quiet(lambda seed: Mitsuba().renders(path, {}, ROUND_SAMPLES, [seed])[0], options.seconds, resource.RUSAGE_SELF)
        except Exception as error:  # Mitsuba reads few of the old scenes; that is no fault of ours.
            if not changed:
                modernise(path)
                changed = True
            elif not without_unknown(path, str(error)):
                print(f"    Mitsuba does not render it: {str(error).strip().splitlines()[-1][:120]}")
                return None


def formats(rows):
    """Compares scenes that lie here in two formats."""
    by_name = {row.name: row for row in rows if row.ours is not None}
    for row in list(by_name.values()):
        other = next((by_name[name] for name in by_name if row.beside and name.endswith(row.beside)), None)
        if other and other.ours.shape[1:] == row.ours.shape[1:]:
            row.other = ratio_of(row.ours, other.ours)
            row.shown = other.ours.mean(0) if row.shown is None else row.shown


def table(rows, verdicts):
    """The page."""
    lines = [
        "# Scenes made by others",
        "",
        "Written by `tests/compare/scenes FOLDER`. Our mean by `path` beside that of the picture that came with the scene, beside",
        "Mitsuba 3.9.1 rendering the same file (old versions without what Mitsuba 3 has no more and the picture does not show), and beside",
        "ours of the same scene in another format; in parentheses the standard error by noise, in percent. Means beside a stored picture are",
        "without the brightest fiftieth of its pixels, whose noise is not known. Where the noise of `path` is above 2 %, `vcm` renders.",
        "*Outside*: pixels that differ from a stored mean by more than its stored variance explains. Names in brackets do not count; names with",
        "something behind them are scenes with a known difference from the picture or the other format taken away (docs/COMPARISON.md says why).",
        "",
        *verdicts,
        "",
        "![The pictures](scenes.png)",
        "",
        "Ours, what it is compared with, and the difference: red where ours is brighter, blue where it is darker, in full at a factor of 2.",
        "",
        "| scene | format | beside the stored picture | beside Mitsuba | beside another format | by | outside | verdict | |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        outside = "" if math.isnan(row.outside) else f"{row.outside:.2%}"
        name = row.name if row.counts() else f"({row.name})"
        said = row.problem or row.unlike() or "; ".join(re.sub(r"^[^ ]*: ", "", warning) for warning in row.warnings[:3])
        if len(row.warnings) > 3 and not row.problem and not row.unlike():
            said += f"; and {len(row.warnings) - 3} more"
        said = said.replace("|", "\\|").replace("\n", " ")
        by = row.by if row.ours is not None else ""
        lines.append(f"| {name} | {row.format} | {row.stored} | {row.mitsuba} | {row.other} | {by} | {outside} | {row.verdict()} | {said} |")
    return "\n".join(lines) + "\n"


def label(row):
    """What the sheet says above the pictures of a scene."""
    short = row.name.replace("mitsuba-tests/tests/scenes/", "").replace("mitsuba-05/scenes/", "")
    ratio = next((str(ratio) for ratio in (row.stored, row.mitsuba, row.other) if ratio.there()), "")
    return f"{short[:64]}  {ratio}" + ("  vcm" if row.by != "path" else "")


def verdict(rows):
    """What the rows say, and whether it is what is asked."""
    files = [row for row in rows if not row.name.endswith(")")]
    complete = [row for row in files if not row.incomplete()]
    loaded = [row for row in complete if not row.problem]
    counted = [row for row in rows if row.counts()]
    near = [row for row in counted if row.near()]
    by_path = [row for row in near if row.by == "path"]
    judged = [row for row in counted if not math.isnan(row.outside)]
    kept = [row for row in judged if row.outside <= row.most_outside]
    two = [row for row in rows if row.other.there()]
    same = [row for row in two if abs(row.other.value - 1) <= max(3 * row.other.error, 0.005)]
    lines = [
        f"* {len(loaded)} of {len(complete)} scenes load (asked: {LOADED:.0%}); {len(files) - len(complete)} more lack files that they name.",
        f"* {len(near)} of {len(counted)} that count are within {WITHIN:.0%} of a mean to compare with (asked: {NEAR:.0%}), {len(by_path)} of them by `path`.",
        f"* {len(kept)} of {len(judged)} that are judged pixel by pixel have few enough of the pixels outside (asked: {OUTSIDE:.2%}, and {QUICK_OUTSIDE:.2%} with --quick).",
        f"* {len(same)} of {len(two)} scenes that are here in two formats have one mean within three standard errors or half a percent.",
    ]
    well = len(loaded) >= LOADED * len(complete) and len(near) >= NEAR * len(counted) and len(kept) == len(judged)
    return lines, well


def main():
    options = arguments()
    rows = []
    begun = time.monotonic()
    for path in scene_files(options.folder):
        name = str(path.relative_to(options.folder))
        if options.only not in name:
            continue
        told = check(options.photonfarm, path)
        edits = [edit for edit in EDITS if name.endswith(edit.file)]
        for edit in [None, *([] if options.quick else edits)]:
            start = time.monotonic()
            row = Row(f"{name} ({edit.label})" if edit else name, told.get("format", ""), "; ".join(told.get("errors", [])), told["warnings"])
            row.beside = edit.beside if edit else found(name, SAME) or ""
            if not row.problem:
                compare(options, path, row, edit)
            row.seconds = time.monotonic() - start
            rows.append(row)
            print(f"{row.name:75} {row.stored!s:>14} {row.mitsuba!s:>14} {row.by} {row.outside:7.2%} {row.seconds:4.0f} s {row.problem[:200]}", flush=True)
    if not rows:
        sys.exit(f"error: no scene in {options.folder}")
    formats(rows)
    lines, well = verdict(rows)
    lines.append(f"* It took {(time.monotonic() - begun) / 60:.0f} minutes.")
    print("\n".join(lines))
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "scenes.md").write_text(table(rows, lines))
        shown = [(label(row), row.ours.mean(0), row.shown) for row in rows if row.ours is not None]
        sheet(shown, options.out / "scenes.png")
    if not well:
        sys.exit("FAILED: the scenes are not as asked")


if __name__ == "__main__":
    main()
