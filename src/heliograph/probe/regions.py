"""Blinking regions of a film: position, size, motion and brightness."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.probe.activity import ALTERNATION_NOISE, Stretch, blinking
from heliograph.probe.levels import overexposed_part
from heliograph.receive.detect.alternation import ALTERNATION
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.window import Window, covered, cut_out

MAX_SIDE_PX = 256  # maximum rows and columns of pixels per region: larger regions are subsampled


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

    @property
    def is_oblong(self) -> bool:
        """True for a part of an array, or an oblique view; the limit is an array turned by 42 degrees."""
        return max(self.width, self.height) > 1.35 * max(min(self.width, self.height), 1.0)

    def is_within(self, other: "Region") -> bool:
        """Return True if the centre is in another region."""
        return abs(self.x - other.x) < 0.5 * other.width and abs(self.y - other.y) < 0.5 * other.height

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
    # groups of adjacent busy blocks, over gaps of up to two blocks
    closed = cv2.morphologyEx(stretch.busy.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels = cv2.connectedComponents(closed, connectivity=8)
    groups = [labels == number for number in range(1, count)]
    strength = np.maximum(stretch.alternation.mean(0) - ALTERNATION_NOISE * stretch.noise, 0.0)
    groups.sort(key=lambda blocks: -float(strength[blocks].sum()))
    regions = list[Region]()
    for blocks in groups[:6]:
        region = _measure(stretch, blocks, ceiling)
        # smaller regions are single pixels: hot pixels, or artefacts of compression
        if region is not None and region.side > 1.5 and not any(map(region.is_within, regions)):
            regions.append(region)
    return regions, len(groups)


def _measure(stretch: Stretch, blocks: NDArray[np.bool_], ceiling: int) -> Region | None:
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
    step = max(1, int(np.ceil(max(width, height) / MAX_SIDE_PX)))
    changes = list[Floats]()
    for k in _spread(count - 3, 4 * width * height // step**2):
        x, y = rough.centre_at(k + 1.5, count)
        window = round(x - 0.5 * (width - 1)), round(y - 0.5 * (height - 1)), width, height
        changes.append(alternation(frames[k : k + 4], window, step))
    power = np.maximum(np.mean(np.square(changes), axis=0) - (20**0.5 / 4 * noise) ** 2, 0.0)
    smooth = cv2.GaussianBlur(power, (0, 0), max(0.7, 0.04 * rough.side / step))
    peak = float(smooth.max())
    rim = np.concatenate([smooth[:2].ravel(), smooth[-2:].ravel(), smooth[:, :2].ravel(), smooth[:, -2:].ravel()])
    threshold = min(max(0.02 * peak, 4 * float(np.median(rim))), 0.25 * peak)
    (dx, dy), size = _uniform_box(np.where(smooth > threshold, power, 0.0))
    # LEDs differ, and a blurred rim has half the amplitude
    core = np.array(changes)[:, smooth > 0.35**2 * peak]
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
    step = max(1, int(np.ceil(region.side / MAX_SIDE_PX)))
    used = _spread(count, int(region.width * region.height / step**2))
    means, levels = np.zeros(len(used)), np.zeros(frames[0].full_scale + 1, np.int64)
    for number, k in enumerate(used):
        pixels = subsample(frames[k], region.box_at(k, count), step)
        means[number] = pixels.mean()
        levels += np.bincount(pixels.astype(np.intp).ravel(), minlength=levels.size)
    half, low = 0.5 * np.array([region.width, region.height]), np.array(frames[0].origin)
    high, corners = np.add(low, (cols, rows)), region.corners
    inside = (corners >= low + 1.5) & (corners <= high - 2.5)  # a region counts as cut 2 px from the border
    ends = np.array([region.centre_at(0, count), region.centre_at(count - 1, count)])
    margin = half + max(16.0, 0.6 * region.side)
    corner = np.maximum(ends.min(0) - margin, low).astype(int)
    size = np.maximum(np.minimum(ends.max(0) + margin, high).astype(int) - corner, 1)
    return replace(
        region, brightness=np.interp(np.arange(count), used, means), saturated=overexposed_part(levels, ceiling),
        at_border=not bool(inside.all()), window=(*corner.tolist(), *size.tolist()),
    )  # fmt: skip


def _spread(count: int, pixels: int) -> list[int]:
    """Return evenly spread frame numbers, fewer for many pixels."""
    limit = max(min(256, 16_000_000 // max(pixels, 1)), 16)
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
