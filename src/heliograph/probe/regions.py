"""Regions of a film in which something blinks: position, size, brightness and rate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.probe.activity import ALTERNATION_NOISE, ROUNDED, Stretch, blinking
from heliograph.probe.levels import overexposed_part
from heliograph.receive.detect.alternation import ALTERNATION
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.window import Window, covered, cut_out

DOTS = 9
"""Least number of blinking spots that are taken for one array: LEDs that lie so far apart that nothing blinks
between."""


@dataclass(frozen=True, slots=True)
class Group:
    """Blocks that belong together."""

    # (blocks down, blocks across), which they are
    blocks: NDArray[np.bool_]
    # Spots they are made of: more than 1 where LEDs lie far apart
    spots: int


def groups_of(busy: NDArray[np.bool_]) -> list[Group]:
    """Busy blocks that touch each other; many spots near each other are one."""
    closed = cv2.morphologyEx(busy.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    if count <= 1:
        return []
    boxes = stats[1:, :4].astype(float)
    sizes = np.sqrt(stats[1:, cv2.CC_STAT_AREA])
    # most spots that are put together: their distances are all compared
    chained = _chained(boxes, sizes) if DOTS <= count - 1 <= 4096 else np.arange(count - 1)
    out = list[Group]()
    for one in np.unique(chained):
        spots = np.flatnonzero(chained == one)
        if 1 < len(spots) < DOTS:
            out += [Group(labels == spot + 1, 1) for spot in spots]
        else:
            out.append(Group(np.isin(labels, spots + 1), len(spots)))
    return out


def _chained(boxes: Floats, sizes: Floats) -> NDArray[np.intp]:
    """Numbers (spots,) of chains of spots of about one size that lie near each other."""
    first, end = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    gaps = np.maximum(np.maximum(first[:, None] - end[None], first[None] - end[:, None]), 0.0).max(-1)
    alike = np.maximum(sizes[:, None], sizes) <= 2 * np.minimum(sizes[:, None], sizes)
    # Largest gap between two such spots, in their sides. An LED takes a quarter of its pitch in the reference link
    near = (gaps <= 4.0 * np.minimum(sizes[:, None], sizes)) & alike
    return np.asarray(connected_components(near, directed=False)[1], np.intp)


MOST_SIDE_PX = 256
"""Most rows and columns of a region that are looked at: of larger ones every second pixel, or every third, and so
on."""

MOST_PIXELS = 16_000_000
"""Most pixels of a region that are looked at over all times: large ones are looked at less often."""

CORE = 0.35
"""Least root mean square of a region's core as a fraction of its largest: LEDs differ, and a blurred rim has half."""

TAIL, RIM, MOST_TAIL = 0.02, 4.0, 0.25
"""Power of a pixel below which it counts for no part of a region: over the largest, and over that of what lies about
it, but no more of the largest than the last."""

ROOM = 1.15
"""Window in which a region is measured, over what its blocks take: its blurred rim must not reach the window's."""

BORDER_PX = 2.0
"""Pixels from the frame's border within which a region is taken to be cut by it."""


@dataclass(frozen=True)
class Region:
    """A region of a film in which something blinks.

    Attributes
    ----------
    x, y
        Its centre on the sensor in px, in the middle of the stretch.
    width, height
        Its size in px.
    speed
        Motion along x and y in px a frame.
    contrast
        Gray levels by which its light goes up and down where it does so most, over full scale.
    power
        The same of an average frame.
    blinks
        How much of what changes blinks rather than moves, see `blinking`.
    evenness
        How much all of it goes up and down as one: 1 for a lamp, about 0 for a pattern and its inverse.
    saturated
        Fraction of its pixels that are overexposed, see `overexposed_part`.
    at_border
        Whether it touches the frame's border.
    spots
        Blinking spots it is made of: more than 1 where LEDs lie far apart.
    window
        The part of the sensor that holds it and its surroundings, in all frames.
    brightness
        (frames,) mean gray level of its pixels in each frame of the stretch.
    """

    x: float
    y: float
    width: float
    height: float
    speed: tuple[float, float]
    contrast: float
    power: float
    blinks: float
    evenness: float
    saturated: float
    at_border: bool
    spots: int
    window: Window
    brightness: Floats

    @property
    def side(self) -> float:
        """Side in px of a square as large."""
        return float(np.sqrt(self.width * self.height))

    @property
    def corners(self) -> Floats:
        """(4, 2) corners of its box in px, clockwise from the upper left one."""
        ends = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
        return np.asarray(np.array([self.x, self.y]) + ends * np.array([self.width, self.height]), np.float64)

    @property
    def speed_px(self) -> float:
        """Motion in px a frame, whatever its direction."""
        return float(np.hypot(*self.speed))

    def centre_at(self, frame: float, frames: int) -> tuple[float, float]:
        """Its centre on the sensor in px at another time.

        Parameters
        ----------
        frame
            Number of the frame within the stretch.
        frames
            Frames of the stretch.
        """
        later = frame - 0.5 * (frames - 1)
        return self.x + self.speed[0] * later, self.y + self.speed[1] * later

    def box_at(self, frame: float, frames: int, scale: float = 1.0) -> Window:
        """Pixels of it, or of its surroundings, at a time.

        Parameters
        ----------
        frame
            Number of the frame within the stretch.
        frames
            Frames of the stretch.
        scale
            Size of what is wanted over that of the region, above 0.

        Returns
        -------
        Corner (x, y) on the sensor, columns and rows.
        """
        x, y = self.centre_at(frame, frames)
        width, height = (max(round(scale * size), 1) for size in (self.width, self.height))
        return round(x - 0.5 * (width - 1)), round(y - 0.5 * (height - 1)), width, height


def regions_of(stretch: Stretch, ceiling: int) -> tuple[list[Region], int]:
    """Regions of a stretch in which something blinks, the strongest first."""
    groups = groups_of(stretch.busy)
    strength = np.maximum(stretch.alternation.mean(0) - ALTERNATION_NOISE * stretch.noise, 0.0)
    groups.sort(key=lambda group: -float(strength[group.blocks].sum()))
    found = list[Region]()
    # most regions that are looked into, those that blink most: each takes up to a second
    for group in groups[:6]:
        one = _region(stretch, group, ceiling)
        # side in px up to which a region is a pixel that blinks: a hot one, or what compression leaves
        if one is not None and one.side > 1.5 and not any(_within(one, other) for other in found):
            found.append(one)
    return found, len(groups)


def _within(one: Region, other: Region) -> bool:
    """Whether a region lies within a stronger one: what is left over of it."""
    return abs(one.x - other.x) < 0.5 * other.width and abs(one.y - other.y) < 0.5 * other.height


def _region(stretch: Stretch, group: Group, ceiling: int) -> Region | None:
    """Look into a group of blocks."""
    frames, power = stretch.frames, stretch.alternation**2 - (ALTERNATION_NOISE * stretch.noise) ** 2
    near = cv2.dilate(group.blocks.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    power = np.maximum(power, 0.0) * near
    total = power.sum((1, 2))
    if not total.any():
        return None
    corner = np.array(frames[0].origin, float)
    places = np.array([_centroid(one) if one.any() else (np.nan, np.nan) for one in power])
    places = (places + 0.5) * BLOCK_PX - 0.5 + corner
    times = 0.5 * (np.array(stretch.bounds[:-1]) + stretch.bounds[1:] - 1)
    centre, speed = _motion(times, places, total, 0.5 * (len(frames) - 1))
    blocks = np.argwhere(group.blocks)
    extent = float((np.ptp(blocks, axis=0).max() + 1) * BLOCK_PX)
    rough = extent - min(float(np.hypot(*speed)) * len(frames), extent - BLOCK_PX)
    begun = Region(
        *centre, rough, rough, speed, 0.0, 0.0,
        blinking(stretch.alternation.mean(0)[near], stretch.change.mean(0)[near], stretch.noise[near]),
        0.0, 0.0, False, group.spots, (0, 0, 1, 1), np.zeros(len(frames)),
    )  # fmt: skip
    return _measured(begun, frames, float(stretch.noise[near].mean()), ceiling)


def _centroid(power: Floats) -> tuple[float, float]:
    rows, cols = np.indices(power.shape)
    total = power.sum()
    return float((power * cols).sum() / total), float((power * rows).sum() / total)


def _motion(
    times: Floats, places: Floats, power: Floats, middle: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Place (x, y) at a time and motion in px a frame of a line through places (parts, 2), by their power (parts,)."""
    # part of a stretch's strongest part from which on a part tells where a region is
    lively = power > 0.15 * power.max()
    t, p = times[lively] - middle, places[lively]
    if len(t) < 2:
        x, y = p[0]
        return (float(x), float(y)), (0.0, 0.0)
    design = np.stack([np.ones_like(t), t], axis=1)
    (x, y), (vx, vy) = np.linalg.lstsq(design, p, rcond=None)[0]
    return (float(x), float(y)), (float(vx), float(vy))


def _measured(begun: Region, frames: Sequence[Frame], noise: float, ceiling: int) -> Region:
    """Size, contrast and the rest of a region, by its pixels."""
    count = len(frames)
    width, height = begun.box_at(0, count, ROOM + 3 * BLOCK_PX / begun.side)[2:]
    step = max(1, int(np.ceil(max(width, height) / MOST_SIDE_PX)))
    starts = _spread(count - 3, 4 * width * height // step**2)
    changes = list[Floats]()
    for k in starts:
        x, y = begun.centre_at(k + 1.5, count)
        window = round(x - 0.5 * (width - 1)), round(y - 0.5 * (height - 1)), width, height
        changes.append(_alternation(frames[k : k + 4], window, step))
    power = np.maximum(np.mean(np.square(changes), axis=0) - (20**0.5 / 4 * max(noise, ROUNDED)) ** 2, 0.0)
    smooth = cv2.GaussianBlur(power, (0, 0), max(0.7, 0.04 * begun.side / step))
    rim = np.concatenate([smooth[:2].ravel(), smooth[-2:].ravel(), smooth[:, :2].ravel(), smooth[:, -2:].ravel()])
    tail = min(max(TAIL * float(smooth.max()), RIM * float(np.median(rim))), MOST_TAIL * float(smooth.max()))
    (dx, dy), size = _box(np.where(smooth > tail, power, 0.0))
    core = np.array(changes)[:, smooth > CORE**2 * smooth.max()]
    shown = np.abs(core).mean(1)
    even = np.abs(core.mean(1)) / np.maximum(shown, TINY)
    full = frames[0].full_scale
    # the box's centre in the window, whose own centre is the region's but for rounding
    x, y = (begun.x, begun.y) if step > 1 else (begun.x + dx - 0.5 * (width - 1), begun.y + dy - 0.5 * (height - 1))
    if step == 1 and begun.speed_px * count < 1:
        x, y = window[0] + dx, window[1] + dy
    # part of the times that have less contrast than is told: headers, which show all of it, take 4 % of the time
    measured = replace(
        begun,
        x=x,
        y=y,
        width=size[0] * step,
        height=size[1] * step,
        contrast=float(np.quantile(shown, 0.98)) / full,
        power=float(np.sqrt(power[smooth > CORE**2 * smooth.max()].mean())) / full,
        evenness=float(np.median(even[shown >= np.median(shown)])),
    )
    return _placed(measured, frames, ceiling)


def _placed(region: Region, frames: Sequence[Frame], ceiling: int) -> Region:
    """What the place and size of a region tell."""
    count, (left, top), (rows, cols) = len(frames), frames[0].origin, frames[0].pixels.shape
    step = max(1, int(np.ceil(region.side / MOST_SIDE_PX)))
    brightness, levels = np.zeros(count), np.zeros(frames[0].full_scale + 1, np.int64)
    counted = set(_spread(count, int(region.width * region.height / step**2)))
    for k, frame in enumerate(frames):
        box = thinned(frame, region.box_at(k, count), step) if k in counted else None
        brightness[k] = np.nan if box is None else box.mean()
        levels += 0 if box is None else np.bincount(box.astype(np.intp).ravel(), minlength=levels.size)
    known = np.flatnonzero(np.isfinite(brightness))
    brightness = np.interp(np.arange(count), known, brightness[known])
    ends = [region.centre_at(k, count) for k in (0, count - 1)]
    half = 0.5 * region.width, 0.5 * region.height
    middle = region.centre_at(0.5 * (count - 1), count)
    at_border = (
        middle[0] - half[0] < left - 0.5 + BORDER_PX or middle[0] + half[0] > left + cols - 0.5 - BORDER_PX
        or middle[1] - half[1] < top - 0.5 + BORDER_PX or middle[1] + half[1] > top + rows - 0.5 - BORDER_PX
    )  # fmt: skip
    margin = max(16.0, 0.6 * region.side)
    x0, y0 = (int(max(min(end[k] for end in ends) - half[k] - margin, (left, top)[k])) for k in (0, 1))
    x1, y1 = (
        int(min(max(end[k] for end in ends) + half[k] + margin, ((left + cols), (top + rows))[k])) for k in (0, 1)
    )
    window = x0, y0, max(x1 - x0, 1), max(y1 - y0, 1)
    saturated = overexposed_part(levels, ceiling)
    return replace(region, brightness=brightness, saturated=saturated, at_border=bool(at_border), window=window)


def _spread(count: int, pixels: int) -> list[int]:
    """Times that are looked at: all, or evenly spread ones where there are many or they have many pixels."""
    # most times at which a region's pixels are looked at
    most = max(min(256, MOST_PIXELS // max(pixels, 1)), 16)
    return [*map(int, np.unique(np.linspace(0, max(count, 1) - 1, min(most, max(count, 1))).round()))]


def thinned(frame: Frame, window: Window, step: int) -> Floats:
    """Every so many pixels of a window; what lies beyond the frame repeats its border."""
    if step == 1:
        return cut_out(frame, window)
    x, y, width, height = window
    rows = np.clip(np.arange(y, y + height, step) - frame.origin[1], 0, frame.pixels.shape[0] - 1)
    columns = np.clip(np.arange(x, x + width, step) - frame.origin[0], 0, frame.pixels.shape[1] - 1)
    return frame.pixels[np.ix_(rows, columns)].astype(np.float64)


def _alternation(frames: Sequence[Frame], window: Window, step: int) -> Floats:
    """What alternates in four frames, within a window, in gray levels."""
    four = zip(ALTERNATION, frames, strict=True)
    change = np.asarray(sum(weight * thinned(one, window, step) for weight, one in four))
    # beyond the frame nothing is seen
    inside = covered(frames, window[:2], (window[3], window[2]))
    return change if inside is None else change * inside[0][::step] * inside[1][::step, None]


def _box(power: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    """Centre (x, y) and size of the even box that has the power's moments."""
    total = max(float(power.sum()), TINY)
    out = []
    for axis in (0, 1):
        along, places = power.sum(axis), np.arange(power.shape[1 - axis])
        centre = float(along @ places / total)
        variance = float(along @ (places - centre) ** 2 / total)
        # a box of the side s has the variance s^2 / 12
        out.append((centre, max((12 * variance) ** 0.5, 1.0)))
    return (out[0][0], out[1][0]), (out[0][1], out[1][1])
