"""Blinking regions of a film: position, size, motion and brightness."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.probe.activity import ALTERNATION_NOISE, Stretch, blinking
from heliograph.probe.levels import overexposed_part
from heliograph.receive.detect.alternation import ALTERNATION
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.window import Window, covered, cut_out

Blocks = NDArray[np.bool_]
"""Set of blocks, (blocks down, blocks across)."""


@dataclass(frozen=True, slots=True)
class RegionTuning:
    """Thresholds and limits of regions."""

    # Minimum spots of an array with LEDs far apart
    min_spots: int = 9
    # Maximum gap between such spots in sides of a spot: LEDs of the reference link cover a quarter of the pitch
    max_gap: float = 4.0
    # Maximum rows and columns of pixels per region: larger regions are subsampled
    max_side_px: int = 256
    # Maximum pixels per region over all frames: fewer frames of large regions are used
    max_pixels: int = 16_000_000
    # Minimum amplitude of the core over the maximum: LEDs differ, and a blurred rim has half
    core: float = 0.35
    # Minimum power of a pixel: over the maximum, over the surroundings, and the upper limit of the latter
    tail: float = 0.02
    rim: float = 4.0
    max_tail: float = 0.25
    # Distance in px from the frame's border at which a region counts as cut
    border_px: float = 2.0


TUNING = RegionTuning()


@dataclass(frozen=True)
class Region:
    """Blinking region of a film.

    Attributes
    ----------
    x, y
        Centre on the sensor in px, at half time.
    width, height
        Size in px.
    speed
        Motion along x and y in px per frame.
    contrast
        Amplitude of the light at its maximum over time, over full scale.
    blinks
        Ratio of blinking to change, see `blinking`.
    saturated
        Overexposed fraction of the pixels, see `overexposed_part`.
    at_border
        True if the region touches the frame's border.
    window
        Part of the sensor with the region and its surroundings in all frames.
    brightness
        (frames,) mean gray level in each frame of the stretch.
    """

    x: float
    y: float
    width: float
    height: float
    speed: tuple[float, float]
    contrast: float
    blinks: float
    saturated: float
    at_border: bool
    window: Window
    brightness: Floats

    @property
    def side(self) -> float:
        """Side in px of a square with the same area."""
        return float(np.sqrt(self.width * self.height))

    @property
    def corners(self) -> Floats:
        """(4, 2) corners of the bounding box in px, clockwise from the upper left."""
        ends = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
        return np.array([self.x, self.y]) + ends * np.array([self.width, self.height])

    @property
    def speed_px(self) -> float:
        """Magnitude of the motion in px per frame."""
        return float(np.hypot(*self.speed))

    def centre_at(self, frame: float, frames: int) -> tuple[float, float]:
        """Return the centre on the sensor in px at another time.

        Parameters
        ----------
        frame
            Number of the frame within the stretch.
        frames
            Number of frames of the stretch.
        """
        late = frame - 0.5 * (frames - 1)
        return self.x + self.speed[0] * late, self.y + self.speed[1] * late

    def box_at(self, frame: float, frames: int, scale: float = 1.0) -> Window:
        """Return the bounding box at a time as corner (x, y) on the sensor, columns and rows.

        Parameters
        ----------
        frame
            Number of the frame within the stretch.
        frames
            Number of frames of the stretch.
        scale
            Size of the box over the size of the region, above 0.
        """
        x, y = self.centre_at(frame, frames)
        width, height = (max(round(scale * size), 1) for size in (self.width, self.height))
        return round(x - 0.5 * (width - 1)), round(y - 0.5 * (height - 1)), width, height


def regions_of(stretch: Stretch, ceiling: int) -> tuple[list[Region], int]:
    """Measure up to six blinking regions, the strongest first; return them and the number of all regions."""
    groups = group_blocks(stretch.busy)
    strength = np.maximum(stretch.alternation.mean(0) - ALTERNATION_NOISE * stretch.noise, 0.0)
    groups.sort(key=lambda blocks: -float(strength[blocks].sum()))
    regions = list[Region]()
    for blocks in groups[:6]:
        region = _measure(stretch, blocks, ceiling)
        # smaller regions are single pixels: hot pixels, or artefacts of compression
        if region is not None and region.side > 1.5 and not any(_is_within(region, other) for other in regions):
            regions.append(region)
    return regions, len(groups)


def _is_within(region: Region, other: Region) -> bool:
    return abs(region.x - other.x) < 0.5 * other.width and abs(region.y - other.y) < 0.5 * other.height


def group_blocks(busy: Blocks) -> list[Blocks]:
    """Group adjacent busy blocks, and chains of many similar spots."""
    closed = cv2.morphologyEx(busy.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    if count <= 1:
        return []
    chains = np.arange(count - 1)
    if TUNING.min_spots <= count - 1 <= 4096:  # the distances of all pairs are computed
        chains = _chain(stats[1:, :4].astype(float), np.sqrt(stats[1:, cv2.CC_STAT_AREA]))
    groups = list[Blocks]()
    for chain in np.unique(chains):
        spots = np.flatnonzero(chains == chain) + 1
        groups += [labels == spot for spot in spots] if len(spots) < TUNING.min_spots else [np.isin(labels, spots)]
    return groups


def _chain(boxes: Floats, sizes: Floats) -> NDArray[np.intp]:
    """Return the chain number (spots,) of spots of similar size near each other."""
    first, end = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    gaps = np.maximum(np.maximum(first[:, None] - end[None], first[None] - end[:, None]), 0.0).max(-1)
    smaller, larger = np.minimum(sizes[:, None], sizes), np.maximum(sizes[:, None], sizes)
    linked = (gaps <= TUNING.max_gap * smaller) & (larger <= 2 * smaller)
    return np.asarray(connected_components(linked, directed=False)[1], np.intp)


def _measure(stretch: Stretch, blocks: Blocks, ceiling: int) -> Region | None:
    """Measure a group of blocks: first motion by blocks, then size by pixels."""
    frames, power = stretch.frames, stretch.alternation**2 - (ALTERNATION_NOISE * stretch.noise) ** 2
    near = cv2.dilate(blocks.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    power = np.maximum(power, 0.0) * near
    if not power.any():
        return None
    total = power.sum((1, 2))
    rows, cols = np.indices(near.shape)
    # parts of the stretch with little power do not show the position
    lively = total > 0.15 * total.max()
    moments = np.stack([(power * cols).sum((1, 2)), (power * rows).sum((1, 2))], axis=1)[lively]
    places = (moments / total[lively, None] + 0.5) * BLOCK_PX - 0.5 + np.array(frames[0].origin, float)
    times = 0.5 * (np.array(stretch.bounds[:-1]) + stretch.bounds[1:] - len(frames))[lively]
    (x, y), speed = places[0], np.zeros(2)
    if len(times) > 1:
        (x, y), speed = np.linalg.lstsq(np.stack([np.ones_like(times), times], axis=1), places, rcond=None)[0]
    extent = float((np.ptp(np.argwhere(blocks), axis=0).max() + 1) * BLOCK_PX)
    side = extent - min(float(np.hypot(*speed)) * len(frames), extent - BLOCK_PX)
    blinks = blinking(stretch.alternation.mean(0)[near], stretch.change.mean(0)[near], stretch.noise[near])
    rough = Region(
        float(x), float(y), side, side, (float(speed[0]), float(speed[1])), 0.0, blinks, 0.0, False, (0, 0, 1, 1),
        np.zeros(len(frames)),
    )  # fmt: skip
    return _expose(_resize(rough, frames, float(stretch.noise[near].mean())), frames, ceiling)


def _resize(rough: Region, frames: Sequence[Frame], noise: float) -> Region:
    """Measure position, size and contrast of a region by the alternation of pixels."""
    count = len(frames)
    # the blurred rim must not reach the border of the window
    width, height = rough.box_at(0, count, 1.15 + 3 * BLOCK_PX / rough.side)[2:]
    step = max(1, int(np.ceil(max(width, height) / TUNING.max_side_px)))
    changes = list[Floats]()
    for k in _spread(count - 3, 4 * width * height // step**2):
        x, y = rough.centre_at(k + 1.5, count)
        window = round(x - 0.5 * (width - 1)), round(y - 0.5 * (height - 1)), width, height
        changes.append(alternation(frames[k : k + 4], window, step))
    power = np.maximum(np.mean(np.square(changes), axis=0) - (20**0.5 / 4 * noise) ** 2, 0.0)
    smooth = cv2.GaussianBlur(power, (0, 0), max(0.7, 0.04 * rough.side / step))
    peak = float(smooth.max())
    rim = np.concatenate([smooth[:2].ravel(), smooth[-2:].ravel(), smooth[:, :2].ravel(), smooth[:, -2:].ravel()])
    threshold = min(max(TUNING.tail * peak, TUNING.rim * float(np.median(rim))), TUNING.max_tail * peak)
    (dx, dy), size = _uniform_box(np.where(smooth > threshold, power, 0.0))
    core = np.array(changes)[:, smooth > TUNING.core**2 * smooth.max()]
    # position in the window, which is centred on the region except for rounding
    x, y = (rough.x, rough.y) if step > 1 else (rough.x + dx - 0.5 * (width - 1), rough.y + dy - 0.5 * (height - 1))
    if step == 1 and rough.speed_px * count < 1:
        x, y = window[0] + dx, window[1] + dy
    # headers show the full contrast for 4 % of the time
    contrast = float(np.quantile(np.abs(core).mean(1), 0.98)) / frames[0].full_scale
    return replace(rough, x=x, y=y, width=size[0] * step, height=size[1] * step, contrast=contrast)


def _expose(region: Region, frames: Sequence[Frame], ceiling: int) -> Region:
    """Measure brightness, overexposure and window of a region."""
    count, (rows, cols) = len(frames), frames[0].pixels.shape
    step = max(1, int(np.ceil(region.side / TUNING.max_side_px)))
    used = _spread(count, int(region.width * region.height / step**2))
    means, levels = np.zeros(len(used)), np.zeros(frames[0].full_scale + 1, np.int64)
    for number, k in enumerate(used):
        pixels = subsample(frames[k], region.box_at(k, count), step)
        means[number] = pixels.mean()
        levels += np.bincount(pixels.astype(np.intp).ravel(), minlength=levels.size)
    half = 0.5 * np.array([region.width, region.height])
    low = np.array(frames[0].origin)
    high = low + np.array([cols, rows])
    centre = np.array([region.x, region.y])
    inside = (centre - half >= low - 0.5 + TUNING.border_px) & (centre + half <= high - 0.5 - TUNING.border_px)
    ends = np.array([region.centre_at(0, count), region.centre_at(count - 1, count)])
    margin = half + max(16.0, 0.6 * region.side)
    x0, y0 = np.maximum(ends.min(0) - margin, low).astype(int).tolist()
    x1, y1 = np.minimum(ends.max(0) + margin, high).astype(int).tolist()
    return replace(
        region, brightness=np.interp(np.arange(count), used, means), saturated=overexposed_part(levels, ceiling),
        at_border=not bool(inside.all()), window=(x0, y0, max(x1 - x0, 1), max(y1 - y0, 1)),
    )  # fmt: skip


def _spread(count: int, pixels: int) -> list[int]:
    """Return evenly spread frame numbers, fewer for many pixels."""
    limit = max(min(256, TUNING.max_pixels // max(pixels, 1)), 16)
    return [*map(int, np.unique(np.linspace(0, max(count, 1) - 1, min(limit, max(count, 1))).round()))]


def subsample(frame: Frame, window: Window, step: int) -> Floats:
    """Copy every n-th pixel of a window; beyond the frame the border repeats."""
    if step == 1:
        return cut_out(frame, window)
    x, y, width, height = window
    rows = np.clip(np.arange(y, y + height, step) - frame.origin[1], 0, frame.pixels.shape[0] - 1)
    columns = np.clip(np.arange(x, x + width, step) - frame.origin[0], 0, frame.pixels.shape[1] - 1)
    return frame.pixels[np.ix_(rows, columns)].astype(np.float64)


def alternation(frames: Sequence[Frame], window: Window, step: int = 1) -> Floats:
    """Compute the alternation of four frames in a window in gray levels, 0 beyond the frame."""
    weighted = (weight * subsample(frame, window, step) for weight, frame in zip(ALTERNATION, frames, strict=True))
    change = np.asarray(sum(weighted))
    inside = covered(frames, window[:2], (window[3], window[2]))
    return change if inside is None else change * inside[0][::step] * inside[1][::step, None]


def _uniform_box(power: Floats) -> tuple[list[float], list[float]]:
    """Return centre (x, y) and size of the uniform box with the moments of a power map."""
    centres, sizes, total = list[float](), list[float](), max(float(power.sum()), TINY)
    for axis in (0, 1):
        along, places = power.sum(axis), np.arange(power.shape[1 - axis])
        centres.append(float(along @ places / total))
        # a box of side s has the variance s^2 / 12
        variance = float(along @ (places - centres[-1]) ** 2 / total)
        sizes.append(max((12 * variance) ** 0.5, 1.0))
    return centres, sizes
