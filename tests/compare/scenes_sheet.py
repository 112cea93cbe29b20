"""The sheet of pictures of docs/results/scenes: ours, what it is compared with, and how they differ."""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from noise import luminance

WIDTH, HEIGHT = 152, 152
LABEL, GAP, COLUMNS = 14, 6, 3
# The file is kept below a size that a reader of the page waits for.
COLOURS = 256


def shrunk(picture, height, width):
    """The picture averaged down to about this size; infinite pixels are left out of the average."""
    rows = np.linspace(0, picture.shape[0], height + 1).astype(int)
    columns = np.linspace(0, picture.shape[1], width + 1).astype(int)
    good = np.isfinite(picture).all(-1, keepdims=True)
    sums = np.where(good, picture, 0)
    add = lambda values: np.add.reduceat(np.add.reduceat(values, rows[:-1], 0), columns[:-1], 1)
    return add(sums) / np.maximum(add(good.astype(float)), 1)


def thumbnail(picture):
    """The picture as large as a cell of the sheet allows; small ones keep their pixels as squares."""
    scale = min(WIDTH / picture.shape[1], HEIGHT / picture.shape[0])
    height, width = (max(1, round(side * scale)) for side in picture.shape[:2])
    if scale <= 1:
        return shrunk(picture, height, width)
    return picture[np.arange(height) * picture.shape[0] // height][:, np.arange(width) * picture.shape[1] // width]


def difference(ours, other):
    """White where both are as bright; red where ours is brighter, blue where it is darker, in full at twice and half."""
    least = 0.01 * max(float(luminance(other).mean()), 1e-9)
    stops = np.clip(np.log2((luminance(ours) + least) / (luminance(other) + least)), -1, 1)[..., None]
    return np.where(stops > 0, 1 - stops * np.array([0, 1, 1]), 1 + stops * np.array([1, 1, 0]))


def strip(label, ours, other, size):
    """A row of the sheet as an image."""
    ours = thumbnail(ours)
    cells = [ours]
    if other is not None:
        other = shrunk(thumbnail(other), *ours.shape[:2])
        cells = [ours, other]
    # One exposure for both.
    scale = 0.5 / max(np.quantile(luminance(cells[-1]), 0.8), 1e-6)
    shown = [np.clip(cell * scale, 0, 1) ** (1 / 2.2) for cell in cells]
    if other is not None:
        shown.append(difference(ours, other))
    image = Image.new("RGB", (3 * (WIDTH + 2), ours.shape[0] + LABEL), "black")
    ImageDraw.Draw(image).text((0, 0), label, fill="white", font=ImageFont.load_default(size))
    for i, cell in enumerate(shown):
        image.paste(Image.fromarray((cell * 255 + 0.5).astype(np.uint8)), (i * (WIDTH + 2), LABEL))
    return image


def sheet(rows, path):
    """Writes the sheet; `rows` are label, ours, and what it is compared with or None."""
    strips = [strip(*row, 10) for row in rows]
    # Each goes to the column that is shortest so far.
    columns = [[] for _ in range(COLUMNS)]
    heights = [0] * COLUMNS
    for image in strips:
        at = heights.index(min(heights))
        columns[at].append((image, heights[at]))
        heights[at] += image.height + GAP
    whole = Image.new("RGB", (COLUMNS * (3 * (WIDTH + 2) + GAP), max(heights)), "black")
    for at, column in enumerate(columns):
        for image, top in column:
            whole.paste(image, (at * (3 * (WIDTH + 2) + GAP), top))
    whole.quantize(COLOURS).save(path, optimize=True)
