"""What changes from frame to frame, block by block, in a stretch of a film; and the stretch in which most blinks.

A film is gone through stretch by stretch, and the frames of one are kept: where most blinks. What alternates in four
frames shows light that blinks, as in the detector; beside the change from frame to frame it tells blinking from
motion, as a motion goes on evenly. Noise is told from both by its finest detail, which a lens hardly lets through,
and by being the same wherever the gray level is.
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
"""Most frames in a stretch: two packets and a half of the reference link, so that one is whole whatever the phase."""

LEAST_FRAMES = 8
"""Least frames in a stretch, of however large frames: the fewest that show a rate."""

ROUNDED = 0.29
"""Standard deviation in gray levels that rounding leaves: less noise than that is not told from it."""

ALTERNATION_NOISE = 1.118 * 0.798
"""Mean magnitude of what alternates in four frames of white noise of the deviation 1: sqrt(20) / 4, sqrt(2 / pi)."""

CHANGE_NOISE = 1.414 * 0.798
"""The same of the change from frame to frame."""

QUIET = 0.25
"""Part of the blocks that is taken to be quiet."""


@dataclass(frozen=True)
class Stretch:
    """Frames of a film that follow each other, and what changes in them."""

    # The frames, whole ones, in the order of time
    frames: Sequence[Frame]
    # Numbers of the frames with which the parts begin, and of the end, (parts + 1,)
    bounds: tuple[int, ...]
    # (parts, blocks down, blocks across) mean magnitude of what alternates, in gray levels
    alternation: Floats
    # (parts, blocks down, blocks across) mean magnitude of the change from frame to frame, in gray levels
    change: Floats
    # (blocks down, blocks across) standard deviation of a pixel's noise in gray levels
    noise: Floats

    @property
    def excess(self) -> Floats:
        """(parts, blocks down, blocks across) alternation over that of noise, 1 where there is noise alone."""
        return np.asarray(self.alternation / (ALTERNATION_NOISE * self.noise))

    @property
    def busy(self) -> "np.ndarray[tuple[int, int], np.dtype[np.bool_]]":
        """(blocks down, blocks across), where something blinks or moves."""
        excess = self.excess
        whole = excess.mean(0)
        quiet = max(1.0, float(np.quantile(whole, QUIET)))
        # Alternation of a busy block over that of noise, and over that of the quiet quarter of all blocks. Over 250
        # frames noise alone scatters by 2 % from block to block
        # the same of a part of a stretch, in which noise scatters more, and through which something may pass
        return np.asarray((whole > 1.35 * quiet) | (excess.max(0) > 2.5 * quiet), bool)

    @property
    def score(self) -> float:
        """How much blinks in it: the excess of busy blocks, each by the deviations of its noise."""
        return float(np.minimum(self.excess.mean(0), 50.0)[self.busy].sum())


class Stretches:
    """Goes through a film, and keeps the stretch in which most blinks."""

    def __init__(self, every: int = 1):
        self._every = every
        self._number = 0
        self._frames: list[Frame] = []
        self._length = 0
        self._best: Stretch | None = None

    def add(self, frame: Frame) -> None:
        """Take the next frame."""
        if not self._frames:
            # Most bytes of frames in a stretch: 380 frames of 1024 x 512 pixels of 8 bits. Two stretches are held at a
            # time
            room = (192 << 20) // max(frame.pixels.nbytes, 1)
            self._length = max(LEAST_FRAMES, min(MOST_FRAMES, room))
        elif not _alike(self._frames[-1], frame):
            self._end()
        self._frames.append(frame)
        if len(self._frames) >= self._length:
            self._end()

    def best(self) -> Stretch | None:
        """The stretch in which most blinks; None where there are too few frames of any."""
        self._end()
        return self._best

    def _end(self) -> None:
        """Look at the frames gathered, and begin anew."""
        frames, self._frames = self._frames, []
        number, self._number = self._number, self._number + 1
        if len(frames) < 4 or number % self._every or min(frames[0].pixels.shape) < 1:
            return
        # part of a stretch's length below which the last one of a film says too little
        if self._best is not None and len(frames) < 0.25 * self._length:
            return
        stretch = stretch_of(frames)
        if self._best is None or stretch.score * len(frames) > self._best.score * len(self._best.frames):
            self._best = stretch


def stretch_of(frames: Sequence[Frame]) -> Stretch:
    """What changes in frames that follow each other."""
    # parts of a stretch: where something is in each tells how it moves
    count = max(1, min(8, len(frames) // 8))
    bounds = np.linspace(0, len(frames), count + 1).round().astype(int)
    parts, changes = list[Floats](), list[Floats]()
    for first, end in itertools.pairwise(bounds):
        # the frames of a part and those before it that it takes four with
        starts = range(max(0, int(first) - 3), int(end) - 3)
        parts.append(np.mean([alternation_means(frames[k : k + 4]) for k in starts], axis=0, dtype=np.float64))
        changes.append(np.mean([alternation_means(frames[k : k + 2]) for k in starts], axis=0, dtype=np.float64))
    # the finest detail costs more than both, and noise is as even as the light
    # every so many frames the finest detail is looked at: noise hardly changes within a stretch
    compared = range(0, len(frames) - 1, 8)
    detail = np.mean([finest_detail(frames[k], frames[k + 1], parts[0].shape) for k in compared], axis=0)
    gray = cv2.resize(
        frames[len(frames) // 2].pixels.astype(np.float32), parts[0].shape[::-1], interpolation=cv2.INTER_AREA
    )
    noise = noise_of(detail, np.asarray(gray, np.float64))
    return Stretch(frames, tuple(map(int, bounds)), np.array(parts), np.array(changes), noise)


def noise_of(detail: Floats, gray: Floats) -> Floats:
    """Noise of blocks: by their finest detail, but no more than blocks of their gray level usually have."""
    order = np.argsort(gray, axis=None)
    # groups of blocks by their gray level, in which the quiet quarter tells the noise of that level
    groups = [one for one in np.array_split(order, 16) if one.size]
    levels = np.array([float(np.median(gray.ravel()[one])) for one in groups])
    variances = np.array([float(np.quantile(detail.ravel()[one], QUIET)) ** 2 for one in groups])
    # photons: variance rises evenly with the level; the median slope heeds no few groups that blink (Theil and Sen)
    i, j = np.triu_indices(len(groups), 1)
    apart = levels[j] - levels[i]
    # gray levels by which two groups must differ to tell how noise rises with the level
    clear = apart > 1.0
    slopes = (variances[j] - variances[i])[clear] / apart[clear]
    slope = max(float(np.median(slopes)), 0.0) if slopes.size > QUIET * apart.size else 0.0
    base = float(np.median(variances - slope * levels))
    usual = np.sqrt(np.maximum(base + slope * gray, 0.0))
    return np.asarray(np.maximum(np.minimum(detail, usual), ROUNDED))


def finest_detail(one: Frame, other: Frame, shape: tuple[int, ...]) -> Floats:
    """Noise by what two frames differ in from pixel to pixel along both diagonals."""
    rows, cols = (size // 2 * 2 for size in one.pixels.shape)
    if not rows or not cols:
        return np.zeros(shape)
    d = cv2.subtract(other.pixels[:rows, :cols], one.pixels[:rows, :cols], dtype=cv2.CV_32F)
    # of 2 x 2 pixels of white noise of the deviation s in each frame this has the deviation sqrt(2) s
    detail = np.abs(0.5 * (d[::2, ::2] - d[::2, 1::2] - d[1::2, ::2] + d[1::2, 1::2])) / CHANGE_NOISE
    half = BLOCK_PX // 2
    down, across = -detail.shape[0] % half, -detail.shape[1] % half
    padded = np.pad(detail, ((0, down), (0, across)), mode="edge")
    means = padded.reshape(padded.shape[0] // half, half, padded.shape[1] // half, half).mean((1, 3))
    out = np.full(shape, float(means.mean()))
    out[: means.shape[0], : means.shape[1]] = means[: shape[0], : shape[1]]
    return out


def blinking(alternation: Floats, change: Floats, noise: Floats) -> float:
    """Return the ratio of alternation to change, as root mean squares: near 1 for blinking, small for motion."""
    blinks = np.maximum(alternation**2 - (ALTERNATION_NOISE * noise) ** 2, 0.0).sum()
    changes = np.maximum(change**2 - (CHANGE_NOISE * noise) ** 2, 0.0).sum()
    return float(np.sqrt(blinks / max(changes, TINY))) if changes > 0 else 0.0


def _alike(one: Frame, other: Frame) -> bool:
    """Whether two frames have the same pixels of a sensor."""
    return one.pixels.shape == other.pixels.shape and one.origin == other.origin
