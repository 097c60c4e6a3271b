"""Changes between frames by blocks, and the stretch of a film with the most blinking light.

The alternation of four frames responds to blinking light, as in the detector. Its ratio to the change from frame to
frame separates blinking from motion, which continues evenly. The finest detail separates noise from both, because a
lens hardly transmits it and because noise depends only on the gray level.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import alternation_means
from heliograph.receive.detect.kernels import BLOCK_PX

MOST_FRAMES = 256
"""Maximum frames of a stretch: two and a half packets of the reference link, so that one packet is complete."""

LEAST_FRAMES = 8  # minimum frames of a stretch, for large frames: fewer show no rate

ALTERNATION_NOISE = 1.118 * 0.798
"""Mean magnitude of the alternation of white noise with unit variance: sqrt(20) / 4 times sqrt(2 / pi)."""

CHANGE_NOISE = 1.414 * 0.798  # mean magnitude of the change from frame to frame of white noise with unit variance
QUIET = 0.25  # part of the blocks assumed quiet


@dataclass(frozen=True, slots=True)
class Stretch:
    """Successive frames of a film, and the changes by blocks."""

    # Complete frames in order of time
    frames: Sequence[Frame]
    # First frame of each part, and the end, (parts + 1,)
    bounds: tuple[int, ...]
    # (parts, blocks down, blocks across) mean magnitudes of the alternation in gray levels
    alternation: Floats
    # (parts, blocks down, blocks across) mean magnitudes of the change from frame to frame in gray levels
    change: Floats
    # (blocks down, blocks across) standard deviation of a pixel's noise in gray levels
    noise: Floats

    @property
    def excess(self) -> Floats:
        """Alternation over the alternation of noise, (parts, blocks down, blocks across)."""
        return np.asarray(self.alternation / (ALTERNATION_NOISE * self.noise))

    @property
    def busy(self) -> "np.ndarray[tuple[int, int], np.dtype[np.bool_]]":
        """Blocks with blinking or motion, (blocks down, blocks across)."""
        excess = self.excess
        mean = excess.mean(0)
        quiet = max(1.0, float(np.quantile(mean, QUIET)))
        # over 250 frames the noise of a block scatters by 2 %; over a part of the stretch by more
        return np.asarray((mean > 1.35 * quiet) | (excess.max(0) > 2.5 * quiet), bool)

    @property
    def score(self) -> float:
        """Sum of the excess of all busy blocks."""
        return float(np.minimum(self.excess.mean(0), 50.0)[self.busy].sum())


class Stretches:
    """Search for the stretch with the most blinking light, one stretch at a time."""

    def __init__(self, every: int = 1):
        self._every = every
        self._number = 0
        self._frames: list[Frame] = []
        self._best: Stretch | None = None

    def add(self, frame: Frame) -> None:
        """Add the next frame."""
        last = self._frames[-1] if self._frames else frame
        if last.pixels.shape != frame.pixels.shape or last.origin != frame.origin:
            self._end()
        self._frames.append(frame)
        if len(self._frames) >= _length(frame):
            self._end()

    def best(self) -> Stretch | None:
        """Return the stretch with the most blinking light; None if the film has fewer than four frames."""
        self._end()
        return self._best

    def _end(self) -> None:
        """Compare the finished stretch with the best one."""
        frames, self._frames = self._frames, []
        self._number += 1
        is_short = len(frames) < 4 or (self._best is not None and len(frames) < 0.25 * _length(frames[0]))
        if is_short or (self._number - 1) % self._every or min(frames[0].pixels.shape) < 1:
            return
        stretch = stretch_of(frames)
        if self._best is None or stretch.score * len(frames) > self._best.score * len(self._best.frames):
            self._best = stretch


def _length(frame: Frame) -> int:
    """Return the frames of a stretch: 192 MB for each of two, or 380 frames of 1024 x 512 pixels of 8 bits."""
    return max(LEAST_FRAMES, min(MOST_FRAMES, (192 << 20) // max(frame.pixels.nbytes, 1)))


def stretch_of(frames: Sequence[Frame]) -> Stretch:
    """Measure the changes of successive frames, in up to eight parts that show motion."""
    bounds = np.linspace(0, len(frames), max(1, min(8, len(frames) // 8)) + 1).round().astype(int)
    alternation, change = list[Floats](), list[Floats]()
    for first, end in itertools.pairwise(bounds):
        starts = range(max(0, int(first) - 3), int(end) - 3)
        for means, size in ((alternation, 4), (change, 2)):
            means.append(np.mean([alternation_means(frames[k : k + size]) for k in starts], axis=0, dtype=np.float64))
    shape = alternation[0].shape
    # every eighth pair: noise hardly changes within a stretch
    pairs = range(0, len(frames) - 1, 8)
    detail = np.mean([finest_detail(frames[k], frames[k + 1], shape) for k in pairs], axis=0)
    middle = frames[len(frames) // 2].pixels.astype(np.float32)
    gray = np.asarray(cv2.resize(middle, shape[::-1], interpolation=cv2.INTER_AREA), np.float64)
    noise = block_noise(detail, gray)
    return Stretch(frames, tuple(map(int, bounds)), np.array(alternation), np.array(change), noise)


def block_noise(detail: Floats, gray: Floats) -> Floats:
    """Estimate the noise of blocks by the finest detail, limited to the usual noise at this gray level."""
    groups = np.array_split(np.argsort(gray, axis=None), min(16, gray.size))
    levels = np.array([np.median(gray.ravel()[group]) for group in groups])
    variances = np.array([np.quantile(detail.ravel()[group], QUIET) ** 2 for group in groups])
    # shot noise: the variance rises linearly; the median slope (Theil-Sen) ignores a few blinking groups
    i, j = np.triu_indices(len(groups), 1)
    distance = levels[j] - levels[i]
    clear = distance > 1.0
    slopes = (variances[j] - variances[i])[clear] / distance[clear]
    slope = max(float(np.median(slopes)), 0.0) if slopes.size > QUIET * distance.size else 0.0
    usual = np.sqrt(np.maximum(float(np.median(variances - slope * levels)) + slope * gray, 0.0))
    return np.asarray(np.maximum(np.minimum(detail, usual), 0.29))  # rounding alone: sqrt(1 / 12)


def finest_detail(first: Frame, second: Frame, shape: tuple[int, ...]) -> Floats:
    """Measure the noise of blocks by the diagonal detail of the difference of two frames."""
    rows, cols = (size // 2 * 2 for size in first.pixels.shape)
    if not rows or not cols:
        return np.zeros(shape)
    d = cv2.subtract(second.pixels[:rows, :cols], first.pixels[:rows, :cols], dtype=cv2.CV_32F)
    # 2 x 2 pixels of white noise with the deviation s in each frame have the deviation sqrt(2) s
    detail = np.abs(0.5 * (d[::2, ::2] - d[::2, 1::2] - d[1::2, ::2] + d[1::2, 1::2])) / CHANGE_NOISE
    half = BLOCK_PX // 2
    size = [(0, half * blocks - pixels) for blocks, pixels in zip(shape, detail.shape, strict=True)]
    return np.asarray(np.pad(detail, size, mode="edge").reshape(shape[0], half, shape[1], half).mean((1, 3)))


def blinking(alternation: Floats, change: Floats, noise: Floats) -> float:
    """Return the RMS ratio of alternation to change, noise removed: near 1 for blinking, small for motion."""
    blinks = np.maximum(alternation**2 - (ALTERNATION_NOISE * noise) ** 2, 0.0).sum()
    changes = np.maximum(change**2 - (CHANGE_NOISE * noise) ** 2, 0.0).sum()
    return float(np.sqrt(blinks / max(changes, TINY))) if changes > 0 else 0.0
