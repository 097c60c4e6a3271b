"""Noise and gain by photon transfer: the variance of what stands still against its gray level.

Of a camera that counts electrons the variance of a pixel is K (m - m_0) + K^2 s^2 + 1/12, m its mean and m_0 the
black level: K gray levels an electron, s electrons of dark noise, and what rounding adds (EMVA 1288). The difference
of two frames has twice that. Blocks in which something moves or blinks have more, so that of blocks of about one gray
level the quiet quarter is looked at; and what moves or blinks differs from frame to frame in patches, noise from
pixel to pixel.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame

BLOCK_PX = 8
"""Pixels of a side of the blocks whose variance is taken: those of the detector's search."""

SAMPLED_PAIRS = 32
"""Pairs of frames that are looked at, spread over the film."""

ENOUGH = 40
"""Least blocks of a group: its quarter is then right to 7 %."""

QUARTER, HALF = 0.8791, 0.9894
"""What a quarter and half of the variances of 64 pixels of white noise lie below, chi-square of 63 over 63."""

ROUNDING = 1 / 12
"""Variance in squared gray levels that rounding adds."""

Untold = Literal["", "one level", "moving", "wiped", "no slope", "few"]
"""Why noise or gain are not told, empty where they are."""


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """Noise of a film by photon transfer.

    Attributes
    ----------
    gain
        K, gray levels an electron; None where it cannot be told.
    gain_error
        Its standard error; None where it cannot be told.
    dark_e
        Noise without light in electrons; None where it cannot be told.
    level
        Median gray level of the quiet blocks; None where there are none.
    deviation
        Standard deviation of a pixel there in gray levels; None where there are none.
    untold
        Why gain and dark noise are not told.
    points
        (groups, 2) gray level and variance of a pixel of each group of quiet blocks, for pictures.
    line
        Variance at gray level 0, and its slope; None where there is none.
    """

    gain: float | None
    gain_error: float | None
    dark_e: float | None
    level: float | None
    deviation: float | None
    untold: Untold
    points: tuple[tuple[float, float], ...] = ()
    line: tuple[float, float] | None = None

    def variance_at(self, level: float) -> float | None:
        """Variance of a pixel in squared gray levels, None where nothing is known.

        Parameters
        ----------
        level
            Its mean gray level.
        """
        if self.line is not None:
            return max(self.line[0] + self.line[1] * level, ROUNDING)
        return None if self.deviation is None else max(self.deviation**2, ROUNDING)


class NoiseWatch:
    """Takes some pairs of a film's frames, and keeps gray level and variance of their blocks."""

    def __init__(self, frames: int | None):
        self._every = max(1, (frames or 16 * SAMPLED_PAIRS) // SAMPLED_PAIRS)
        self._last: Frame | None = None
        self._seen = 0
        self._kept: list[Floats] = []

    def add(self, frame: Frame, copied: bool) -> None:
        """Take the next frame."""
        last, self._last = self._last, frame
        self._seen += 1
        if last is None or self._seen % self._every or copied:
            return
        if last.pixels.shape == frame.pixels.shape and min(frame.pixels.shape) >= BLOCK_PX:
            if len(self._kept) >= 2 * SAMPLED_PAIRS:
                # longer than it claimed: every second pair goes
                self._kept, self._every = self._kept[::2], 2 * self._every
            self._kept.append(block_noise(last, frame))

    def noise(self, ceiling: int) -> NoiseFound:
        """Noise by the frames so far."""
        if not self._kept:
            return NoiseFound(None, None, None, None, None, "few")
        return photon_transfer(np.concatenate(self._kept), ceiling)


def block_noise(one: Frame, other: Frame) -> Floats:
    """Mean, variance and extremes of the blocks of two frames."""
    rows, cols = (size // BLOCK_PX for size in one.pixels.shape)
    # of large frames whole rows of blocks are left out
    # blocks of a pair that are looked at: those of a frame of 1024 x 512
    some = np.arange(0, rows, -(-rows * cols // 8192))
    kept = (some[:, None] * BLOCK_PX + np.arange(BLOCK_PX)).ravel()
    rows = len(some)
    a, b = (frame.pixels[kept, : cols * BLOCK_PX].astype(np.float32) for frame in (one, other))
    d, size = b - a, (cols, rows)
    mean = cv2.resize(a + b, size, interpolation=cv2.INTER_AREA) / 2
    squares = cv2.resize(d * d, size, interpolation=cv2.INTER_AREA)
    shift = cv2.resize(d, size, interpolation=cv2.INTER_AREA)
    pixels = BLOCK_PX**2
    variance = (squares - shift**2) * pixels / (pixels - 1) / 2
    blocks = np.maximum(a, b).reshape(rows, BLOCK_PX, cols, BLOCK_PX)
    most = blocks.max((1, 3))
    least = np.minimum(a, b).reshape(rows, BLOCK_PX, cols, BLOCK_PX).min((1, 3))
    # what four pixels have apart from means, slopes along rows and slopes along columns
    fine = 0.5 * (d[::2, ::2] - d[::2, 1::2] - d[1::2, ::2] + d[1::2, 1::2])
    detail = cv2.resize(fine * fine, size, interpolation=cv2.INTER_AREA) / 2
    out = np.stack([one.ravel() for one in (mean, variance, least, most, detail)], axis=1)
    return np.asarray(out, np.float64)


def photon_transfer(blocks: Floats, ceiling: int) -> NoiseFound:
    """Gain and dark noise by the blocks of many pairs of frames."""
    whole = blocks[(blocks[:, 2] > 0) & (blocks[:, 3] < ceiling)]
    if len(whole) < 2 * ENOUGH:
        return NoiseFound(None, None, None, None, None, "few")
    # part of the blocks of which the variance is below that of rounding, from which on compression has wiped noise out
    if np.mean(whole[:, 1] < ROUNDING / 2) > 0.25:
        return NoiseFound(None, None, None, *_middle(whole), "wiped")
    # largest span of gray levels within a group, as a fraction of full scale: a quarter of its noise is not that of
    # another level
    # variance of a block over that of its finest detail from which on it is no noise: of white noise one in twenty has
    # it
    points, errors = _groups(whole[whole[:, 1] <= 2.0 * whole[:, 4]], 0.01 * ceiling)
    if len(points) < 1:
        return NoiseFound(None, None, None, None, None, "moving")
    level, deviation = float(np.median(points[:, 0])), float(np.median(points[:, 1])) ** 0.5
    kept = tuple((float(x), float(y)) for x, y in points)
    span = float(np.ptp(points[:, 0]))
    # least span of gray levels of the groups as a fraction of full scale, 5 gray levels of 8 bits, to tell a slope
    if len(points) < 2 or span < 0.02 * ceiling:
        return NoiseFound(None, None, None, level, deviation, "one level", kept)
    base, slope, slope_error = _line(points, errors)
    # standard errors by which a slope must differ from 0
    if not (slope > 4.0 * slope_error and base > 0):
        return NoiseFound(None, None, None, level, deviation, "no slope", kept)
    dark_e = max(base - ROUNDING, 0.0) ** 0.5 / slope
    return NoiseFound(slope, slope_error, dark_e, level, deviation, "", kept, (base, slope))


def _middle(blocks: Floats) -> tuple[float, float]:
    """Median gray level and standard deviation of blocks."""
    return float(np.median(blocks[:, 0])), float(np.sqrt(max(np.median(blocks[:, 1]), 0.0)))


def _groups(blocks: Floats, narrow: float) -> tuple[Floats, Floats]:
    """Gray level and variance (groups, 2) of groups that stand still, and the variances' standard errors (groups,)."""
    order = blocks[np.argsort(blocks[:, 0], kind="stable")]
    points, errors = list[tuple[float, float]](), list[float]()
    level, first = order[:, 0], 0
    while first < len(order):
        # groups of blocks by their gray level, of equally many blocks at most
        end = min(first + max(len(order) // 16, ENOUGH), int(np.searchsorted(level, level[first] + narrow, "right")))
        group, first = order[first:end], end
        if len(group) < ENOUGH:
            continue
        # Part of a group's blocks that is taken to be quiet. The whole group is where nothing moves
        quarter, half = np.quantile(group[:, 1], [0.25, 0.5])
        # ratio of half to quarter, over that of white noise, from which on a group is taken to move: it then says
        # nothing
        if half / max(quarter, 1e-9) * QUARTER / HALF > 1.35:
            continue
        variance = quarter / QUARTER
        if variance < ROUNDING / 2:  # wiped out at this level: it would weigh as if it were known exactly
            continue
        quiet = group[group[:, 1] <= half]
        points.append((float(np.median(quiet[:, 0])), float(variance)))
        # of a quarter of n variances with the spread 0.18, 1.36 * 0.18 / sqrt(n)
        errors.append(float(variance) * 0.25 / len(group) ** 0.5)
    return np.array(points).reshape(-1, 2), np.array(errors)


def _line(points: Floats, errors: Floats) -> tuple[float, float, float]:
    """Value at 0, slope and its standard error of a line through points, by their errors or their scatter."""
    x, y = points.T
    weight = 1 / errors**2
    design = np.stack([np.ones_like(x), x], axis=1)
    normal = design.T @ (weight[:, None] * design)
    base, slope = np.linalg.solve(normal, design.T @ (weight * y))
    rest = float((weight * (y - base - slope * x) ** 2).sum()) / max(len(x) - 2, 1)
    error = float(np.linalg.inv(normal)[1, 1] * max(rest, 1.0)) ** 0.5
    return float(base), float(slope), error
