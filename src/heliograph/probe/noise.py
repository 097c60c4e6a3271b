"""Noise and gain of a camera by photon transfer: variance of static pixels against gray level.

A camera that counts electrons has the pixel variance K (m - m_0) + K^2 s^2 + 1/12 with the mean m, the black level m_0,
the gain K in gray levels per electron, the dark noise s in electrons and the variance of rounding (EMVA 1288). The
difference of two frames has twice this variance. Motion and blinking light increase the variance, so the estimate uses
the quiet quarter of the blocks of a gray level. Motion and blinking differ from frame to frame in patches, noise from
pixel to pixel.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame

BLOCK_PX = 8  # side of the blocks in px
ROUNDING = 1 / 12  # variance of rounding in squared gray levels

Obstacle = Literal["", "one level", "moving", "wiped", "no slope", "few"]
"""Reason for a missing gain; empty if the gain is known."""


# Minimum blocks of a group: the quarter of the variances then has a standard error of 7 %
MIN_BLOCKS = 40


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Noise of a film by photon transfer.

    Attributes
    ----------
    untold
        Reason for unknown gain and dark noise; empty if they are known.
    level
        Median gray level of the quiet blocks; None if the film has none.
    deviation
        Standard deviation of a pixel in quiet blocks in gray levels; None if the film has none.
    points
        (groups, 2) gray level and variance of a pixel of each group of quiet blocks, for figures.
    gain_dn_per_e
        K in gray levels per electron; None if unknown.
    gain_error
        Standard error of the gain; None if unknown.
    dark_e
        Dark noise in electrons; None if unknown.
    """

    untold: Obstacle
    level: float | None = None
    deviation: float | None = None
    points: tuple[tuple[float, float], ...] = ()
    gain_dn_per_e: float | None = None
    gain_error: float | None = None
    dark_e: float | None = None

    def variance_at(self, level: float) -> float | None:
        """Return the variance of a pixel in squared gray levels; None if unknown.

        Parameters
        ----------
        level
            Mean gray level of the pixel.
        """
        if self.gain_dn_per_e is not None and self.dark_e is not None:
            return self.gain_dn_per_e * level + (self.gain_dn_per_e * self.dark_e) ** 2 + ROUNDING
        return None if self.deviation is None else max(self.deviation**2, ROUNDING)


class NoiseWatch:
    """Block statistics of some 32 pairs of frames, spread over a film."""

    def __init__(self, frames: int | None):
        self._every = max(1, (frames or 512) // 32)
        self._last: Frame | None = None
        self._count = 0
        self._blocks: list[Floats] = []

    def add(self, frame: Frame, repeated: bool) -> None:
        """Add the next frame."""
        last, self._last = self._last, frame
        self._count += 1
        if last is None or self._count % self._every or repeated:
            return
        if last.pixels.shape == frame.pixels.shape and min(frame.pixels.shape) >= BLOCK_PX:
            if len(self._blocks) >= 64:  # the film is longer than announced
                self._blocks, self._every = self._blocks[::2], 2 * self._every
            self._blocks.append(block_statistics(last, frame))

    def noise(self, ceiling: int) -> NoiseEstimate:
        """Estimate the noise from the frames so far."""
        return photon_transfer(np.concatenate(self._blocks), ceiling) if self._blocks else NoiseEstimate("few")


def block_statistics(first: Frame, second: Frame) -> Floats:
    """Compute mean, variance, lowest and highest level, and variance of the finest detail of blocks, (blocks, 5)."""
    rows, cols = (size // BLOCK_PX for size in first.pixels.shape)
    # large frames: skip rows of blocks, about 8192 blocks are enough
    used = np.arange(0, rows, -(-rows * cols // 8192))
    lines = (used[:, None] * BLOCK_PX + np.arange(BLOCK_PX)).ravel()
    a, b = (frame.pixels[lines, : cols * BLOCK_PX].astype(np.float32) for frame in (first, second))
    d, size, pixels = b - a, (cols, len(used)), BLOCK_PX**2
    # 2 x 2 pixels minus mean and slopes along rows and columns
    fine = 0.5 * (d[::2, ::2] - d[::2, 1::2] - d[1::2, ::2] + d[1::2, 1::2])
    mean, squares, shift, detail = (
        cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in ((a + b) / 2, d * d, d, fine * fine / 2)
    )
    variance = (squares - shift**2) * pixels / (pixels - 1) / 2
    shape = len(used), BLOCK_PX, cols, BLOCK_PX
    lowest, highest = np.minimum(a, b).reshape(shape).min((1, 3)), np.maximum(a, b).reshape(shape).max((1, 3))
    columns = [part.ravel() for part in (mean, variance, lowest, highest, detail)]
    return np.stack(columns, axis=1).astype(np.float64)


def photon_transfer(blocks: Floats, ceiling: int) -> NoiseEstimate:
    """Estimate gain and dark noise from the blocks of many pairs of frames."""
    exposed = blocks[(blocks[:, 2] > 0) & (blocks[:, 3] < ceiling)]
    if len(exposed) < 2 * MIN_BLOCKS:
        return NoiseEstimate("few")
    # less than half the variance of rounding: compression removed the noise
    if np.mean(exposed[:, 1] < ROUNDING / 2) > 0.25:
        level, variance = np.median(exposed[:, :2], axis=0)
        return NoiseEstimate("wiped", float(level), float(np.sqrt(max(variance, 0.0))))
    # white noise has twice the variance of the finest detail in 5 % of the blocks
    fine = exposed[exposed[:, 1] <= 2 * exposed[:, 4]]
    points, errors = _static_groups(fine, 0.01 * ceiling)
    if not len(points):
        return NoiseEstimate("moving")
    level, variance = np.median(points, axis=0)
    estimate = NoiseEstimate("", float(level), float(variance) ** 0.5, tuple((float(x), float(y)) for x, y in points))
    if len(points) < 2 or float(np.ptp(points[:, 0])) < 0.02 * ceiling:
        return replace(estimate, untold="one level")
    (slope, base), covariance = np.polyfit(points[:, 0], points[:, 1], 1, w=1 / errors, cov="unscaled")
    chi_square = float((((points @ (-slope, 1) - base) / errors) ** 2).sum()) / max(len(points) - 2, 1)
    error = float(covariance[0, 0] * max(chi_square, 1.0)) ** 0.5
    if not (slope > 4 * error and base > 0):
        return replace(estimate, untold="no slope")
    dark_e = float(max(base - ROUNDING, 0.0) ** 0.5 / slope)
    return replace(estimate, gain_dn_per_e=float(slope), gain_error=error, dark_e=dark_e)


def _static_groups(blocks: Floats, max_range: float) -> tuple[Floats, Floats]:
    """Group blocks by gray level; return level and variance (groups, 2) of static groups, and standard errors."""
    blocks = blocks[np.argsort(blocks[:, 0], kind="stable")]
    points, errors, first = list[tuple[float, float]](), list[float](), 0
    while first < len(blocks):
        end = int(np.searchsorted(blocks[:, 0], blocks[first, 0] + max_range, "right"))
        end = min(first + max(len(blocks) // 16, MIN_BLOCKS), end)
        group, first = blocks[first:end], end
        quarter, median = np.quantile(group[:, 1], [0.25, 0.5])
        # of 64 pixels of white noise: chi-square with 63 degrees of freedom over 63
        variance = float(quarter / 0.8791)
        is_moving = median / 0.9894 > 1.35 * max(variance, 1e-9)
        # a wiped-out group would weigh as if it were exact
        if len(group) >= MIN_BLOCKS and not is_moving and variance >= ROUNDING / 2:
            points.append((float(np.median(group[group[:, 1] <= median, 0])), variance))
            # the quarter of n variances with the spread 0.18 has the error 1.36 * 0.18 / sqrt(n)
            errors.append(variance * 0.25 / len(group) ** 0.5)
    return np.array(points).reshape(-1, 2), np.array(errors)
