"""Writes what `media_figures.py` has measured: tables, sheets of pictures, and which claims hold."""

import io
import math

import numpy as np
from media_cells import TRANSPORTS
from PIL import Image, ImageDraw

# A sheet has at most so many bytes, so many tiles to a row, and tiles of so many pixels beside a margin.
BYTES = 200_000
ACROSS = 4
TILE, MARGIN, LINE = 128, 4, 12
INTRODUCTION = """\
# Photon surfaces, figures repeated

Written by `{command}`. Figures are those of Deng, Jiao, Bitterli and Jarosz, "Photon surfaces for robust, unbiased volumetric density
estimation" (2019), by their numbers there. The scenes are our own, in `tests/scenes/surfaces`: a schoolroom with a large window, a petrol station
at night, a knot that shines, a cloud of smoke.

Each cell renders {size} x {size} pixels with {seeds} seeds, each for {seconds:g} s of processor time on one thread: as many iterations as take so long
in a run beforehand, and variances are brought to the time exactly. Estimators with light paths have as many that the time holds sixteen
iterations, or 16 where that is more. Only the light along the paths named in the table counts ([LAYERS.md](../../LAYERS.md)), and only its time:
that of a run with the layer less that of a run without.

Variance is that of luminance, the mean over pixels. Its standard error (after ±) comes from the seeds, and is too small where variance sits in few
pixels: that of the worst 0.1 % of them has its column, and figure 3 shows it with and without shares. The error is variance, and for
beams, which blur, squared bias as well, against the mean of the estimators without bias, weighted by their variances. The paper counts
variance alone. A claim holds, or does not, where the ratio is two standard errors from 1. Pictures are means of at most four seeds, with a part
enlarged, at one exposure for each light.

Some things are otherwise than in the paper. The planes of two lengths are one setting, so that the planes of earlier work stand alone
only where light is scattered twice. All surfaces are short: they end where lengths end that are drawn at random. Figure 6 has two sizes of the lamp
at one power, and figure 8 is at equal time, not at equal numbers of light paths.

![The scenes in all of their light, by photon beams, with a part enlarged](scenes.png)
"""
COLUMNS = (
    "light",
    "estimator",
    "light paths",
    "iterations",
    "time of an iteration over path tracing's",
    "variance",
    "squared bias",
    "error over path tracing's",
    "error over beams'",
    "worst 0.1 % of pixels",
)
# With fewer seeds the page warns of them.
MANY_SEEDS = 16
# The part of a tile that is shown enlarged, from its upper left corner, as shares of the width: across, down, and its side.
CROPS = {"schoolroom": (0.2, 0.42, 0.25), "station": (0.45, 0.2, 0.25), "knot": (0.35, 0.35, 0.25), "smoke": (0.35, 0.4, 0.25)}


def ratio(a, b):
    """Quotient of two errors, and its standard error (first-order)."""
    quotient = a["error"] / b["error"]
    return quotient, quotient * math.hypot(a["error_error"] / a["error"], b["error_error"] / b["error"])


def told_ratio(a, b):
    if b is None:
        return "not measured"
    if a is b:
        return "1"
    return "{:.3g} ± {:.2g}".format(*ratio(a, b))


def tile(picture, exposure, crop):
    """A picture, and a part of it beneath, as bytes of sRGB."""
    shown = np.clip(picture / exposure, 0, 1)
    encoded = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    image = Image.fromarray((255 * encoded + 0.5).astype(np.uint8))
    left, top, side = (round(share * image.width) for share in crop)
    part = image.crop((left, top, left + side, top + side))
    whole = Image.new("RGB", (TILE, 2 * TILE + MARGIN), "white")
    whole.paste(image.resize((TILE, TILE), Image.NEAREST), (0, 0))
    whole.paste(part.resize((TILE, TILE), Image.NEAREST), (0, TILE + MARGIN))
    return whole


def sheet(path, tiles):
    """One PNG of tiles, each a picture with two lines of text, with fewer colours the more bytes it would have."""
    rows = math.ceil(len(tiles) / ACROSS)
    width, height = TILE + MARGIN, 2 * TILE + 2 * MARGIN + 2 * LINE
    whole = Image.new("RGB", (width * min(ACROSS, len(tiles)), height * rows), "white")
    draw = ImageDraw.Draw(whole)
    for index, (first, second, image) in enumerate(tiles):
        x, y = index % ACROSS * width, index // ACROSS * height
        draw.text((x + 1, y), first, "black", font_size=10)
        draw.text((x + 1, y + LINE - 1), second, "black", font_size=10)
        whole.paste(image, (x, y + 2 * LINE))
    for colours in (256, 128, 64, 48, 32, 24, 16, 8):
        packed = io.BytesIO()
        whole.quantize(colours, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(packed, "PNG", optimize=True)
        if packed.tell() < BYTES:
            break
    path.write_bytes(packed.getvalue())


def exposure_of(picture):
    """What is shown as white."""
    return max(float(np.percentile(picture, 97)), 1e-9)


def cell_tiles(entries):
    """Tiles of (cell, numbers, arrays); each light has the exposure of the one with the least error."""
    exposures = {}
    for cell, told, arrays in entries:
        best = exposures.get(cell.transport)
        if best is None or told["error"] < best[0]:
            exposures[cell.transport] = (told["error"], exposure_of(arrays["mean"]))
    for cell, _, arrays in entries:
        crop = CROPS[TRANSPORTS[cell.transport].scene]
        yield cell.transport, cell.label, tile(arrays["shown"], exposures[cell.transport][1], crop)


def figure_lines(number, figure, every, found, missing):
    """The section of a figure."""
    yield f"## {figure.title} (figure {number})\n"
    there = [found[cell.name] for cell in figure.cells(every) if cell.name in found]
    if there:
        yield f"![{figure.title}](figure-{number}.png)\n"
    yield "| " + " | ".join(COLUMNS) + " |"
    yield "| " + " | ".join("---" for _ in COLUMNS) + " |"
    for cell, told, _ in there:
        others = [found.get(f"{cell.transport}: {label}") for label in ("path", "beams")]
        path, beams = (other and other[1] for other in others)
        dear = f"{told['cost'] / path['cost']:.2g}" if path else "not measured"
        bias = f"{told['bias']:.2e}" if "bias" in told else "0"
        variance = f"{told['variance']:.2e} ± {told['variance_error']:.0e}"
        row = [f"{cell.transport}, `{TRANSPORTS[cell.transport].paths}`", cell.label, told["photons"] or "", told["iterations"], dear]
        row += [variance, bias, told_ratio(told, path), told_ratio(told, beams), f"{100 * told['worst_share']:.1f} %"]
        yield "| " + " | ".join(map(str, row)) + " |"
    for cell in figure.cells(every):
        if cell.name in missing:
            yield f"| {cell.transport} | {cell.label} | | | | not measured: {missing[cell.name]} | | | | |"
    yield ""


def claim_lines(claims, found):
    """The table of the paper's claims."""
    yield "| where | claim | error of the first over that of the second | here |"
    yield "| --- | --- | --- | --- |"
    for where, text, first, second in claims:
        if first not in found or second not in found:
            yield f"| {where} | {text} | {first} / {second} | not measured |"
            continue
        quotient, error = ratio(found[first][1], found[second][1])
        verdict = "undecided" if abs(quotient - 1) < 2 * error else "holds" if quotient < 1 else "does not hold"
        yield f"| {where} | {text} | {first} / {second}: {quotient:.3g} ± {error:.2g} | {verdict} |"
    yield ""


def write_report(options, figures, every, found, missing, claims, agreement, whole):
    """Writes README.md and the sheets of the figures."""
    options.out.mkdir(parents=True, exist_ok=True)
    for number, figure in figures.items():
        there = [found[cell.name] for cell in figure.cells(every) if cell.name in found]
        if there:
            sheet(options.out / f"figure-{number}.png", list(cell_tiles(there)))
    scenes = [(scene, "all light", tile(picture, exposure_of(picture), CROPS[scene])) for scene, picture in whole.items()]
    sheet(options.out / "scenes.png", scenes)
    pairs, limit = agreement
    beyond = [f"{name} ({z:.1f})" for name, z in pairs if z > limit]
    command = f"tests/compare/media --seeds {options.seeds} --seconds {options.seconds:g}"
    command += f" --only {options.only}" if options.only else ""
    lines = [INTRODUCTION.format(command=command, size=options.resolution, seeds=options.seeds, seconds=options.seconds)]
    lines += ["## What holds\n", *claim_lines(claims, found)]
    said = f"these differ by more than the limit of |z| {limit:.1f}: {', '.join(beyond)}." if beyond else f"none differs by more than the limit, |z| {limit:.1f}."
    lines.append(f"Estimators without bias were compared with the first of their light in {len(pairs)} pairs, in 16 blocks of the picture: {said}\n")
    if options.seeds < MANY_SEEDS:
        lines.append("These are few seeds: noise that is skewed passes that limit, too, and errors of variances are rough.\n")
    for number, figure in figures.items():
        lines += figure_lines(number, figure, every, found, missing)
    (options.out / "README.md").write_text("\n".join(lines).rstrip() + "\n")
