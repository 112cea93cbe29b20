"""Tells a difference between two pictures from their noise.

Each side is a stack of independent renders of one scene, so that its noise is measured and not assumed. All
statistics are two-sided. Pictures are float arrays (renders, height, width, 3).
"""

import math
from dataclasses import dataclass

import numpy as np

# |z| beyond which one pixel counts as unexplained; noise alone puts this share of the pixels there.
PIXEL_Z = 3.0
PIXEL_SHARE = math.erfc(PIXEL_Z / math.sqrt(2))
# Probability that noise alone fails a picture through its worst block.
FAMILY_RATE = 1e-3
BLOCK = 8
# Relative difference that rounding may cause where neither side has noise.
ROUNDING = 1e-4


def luminance(pictures):
    """Rec. 709 luminance of the last axis."""
    return pictures @ np.array([0.212671, 0.715160, 0.072169])


def z_scores(a, b):
    """Welch's t of the means over the first axis, turned into a standard normal score.

    The conversion is Wallace's (1959), good to a few thousandths for the degrees of freedom here.
    """
    va, vb = a.var(0, ddof=1) / len(a), b.var(0, ddof=1) / len(b)
    difference = a.mean(0) - b.mean(0)
    floor = (ROUNDING * np.maximum(abs(a.mean(0)), abs(b.mean(0))) + 1e-9) ** 2
    variance = va + vb
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = variance**2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    freedom = np.where(np.isfinite(freedom), freedom, len(a) + len(b) - 2)
    t = difference / np.sqrt(variance + floor)
    scale = (8 * freedom + 1) / (8 * freedom + 3)
    return np.sign(t) * scale * np.sqrt(freedom * np.log1p(t**2 / freedom))


def block_means(pictures, size):
    """Means of square blocks; what does not fill a block at the right and lower border is left out."""
    n, height, width = pictures.shape[:3]
    rows, columns = height // size, width // size
    cut = pictures[:, : rows * size, : columns * size]
    return cut.reshape(n, rows, size, columns, size, -1).mean((2, 4))


def sidak(rate, tests):
    """|z| that the largest of `tests` independent scores passes with probability `rate`."""
    single = -math.expm1(math.log1p(-rate) / tests)
    low, high = 0.0, 40.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if math.erfc(middle / math.sqrt(2)) > single else (low, middle)
    return high


def mean_ratio(a, b):
    """Ratio of the whole-picture means of each channel, and its standard error (first-order)."""
    a, b = a.mean((1, 2)), b.mean((1, 2))
    ratio = a.mean(0) / b.mean(0)
    relative = (a.var(0, ddof=1) / len(a)) / a.mean(0) ** 2 + (b.var(0, ddof=1) / len(b)) / b.mean(0) ** 2
    return ratio, ratio * np.sqrt(relative)


def median_ratio(a, b, size):
    """Median over blocks of the ratio of luminance, and its standard error: fireflies do not move it."""
    a, b = (block_means(luminance(side)[..., None], size).mean(0).ravel() for side in (a, b))
    ratios = a[b > 0] / b[b > 0]
    median = float(np.median(ratios))
    spread = 1.4826 * float(np.median(abs(ratios - median)))
    return median, 1.2533 * spread / math.sqrt(len(ratios))


def relative_variance(pictures, floor):
    """relMSE by noise alone: the mean over pixels and channels of variance over (squared mean + `floor`).

    Returns it for one render, and its standard error, which takes the first axis for independent renders. A pixel
    cannot count for more than the number of renders, which is what one that is lit in a single render comes to: noise
    that strong is understated.
    """
    mean = pictures.mean(0)
    single = ((pictures - mean) ** 2 / (mean**2 + floor)).mean((1, 2, 3)) * len(pictures) / (len(pictures) - 1)
    return float(single.mean()), float(single.std(ddof=1) / math.sqrt(len(single)))


@dataclass
class Verdict:
    """What the comparison of two stacks of renders found."""

    ratio: np.ndarray
    ratio_error: np.ndarray
    median: float
    median_error: float
    share: float
    share_limit: float
    worst: tuple
    block: float
    block_limit: float
    faults: list


def compare(a, b, ratio_tolerance=1e-3):
    """Compares stack `a` with stack `b`; `faults` in the result lists what noise cannot explain.

    Bounds: the ratio of means within `ratio_tolerance` plus 4 standard errors of one in each channel; the median ratio
    of blocks of 4 x 4 pixels within 0.3 % plus 4 standard errors of one; the share of pixels with |z| > 3 below twice
    what noise gives (0.27 %) plus five standard deviations of that count; the worst block of 8 x 8 pixels, in three
    channels, within the Sidak-corrected limit of a false-alarm rate of 0.1 %.
    """
    for name, stack in (("first", a), ("second", b)):
        if not np.isfinite(stack).all():
            raise ValueError(f"the {name} side has pixels that are not finite")
    ratio, ratio_error = mean_ratio(a, b)
    median, median_error = median_ratio(a, b, 4)
    z = z_scores(luminance(a), luminance(b))
    share = float((abs(z) > PIXEL_Z).mean())
    share_limit = 2 * PIXEL_SHARE + 5 * math.sqrt(PIXEL_SHARE / z.size)
    y, x = np.unravel_index(abs(z).argmax(), z.shape)
    blocks = z_scores(block_means(a, BLOCK), block_means(b, BLOCK))
    block, block_limit = float(abs(blocks).max()), sidak(FAMILY_RATE, blocks.size)
    faults = []
    if (abs(ratio - 1) > ratio_tolerance + 4 * ratio_error).any():
        faults.append("means differ")
    if abs(median - 1) > 3e-3 + 4 * median_error:
        faults.append("medians differ")
    if share > share_limit:
        faults.append("too many pixels differ")
    if block > block_limit:
        faults.append("a block differs")
    worst = (int(x), int(y), float(z[y, x]))
    return Verdict(ratio, ratio_error, median, median_error, share, share_limit, worst, block, block_limit, faults)
