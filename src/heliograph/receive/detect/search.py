"""Search for headers of arrays of any size, in the frames of a camera of any rate and phase.

Each level of a pyramid of frames has a detector, for arrays with hardly visible single LEDs. Then sums over cells of a
header hold most of the light, and fits are fast.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from itertools import islice, takewhile
from operator import add

import cv2
import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame, Pixels
from heliograph.receive.detect.alternation import DETECT, Blocks, SearchParameters
from heliograph.receive.detect.budget import NoveltyFilter, SearchLoad, TokenBucket
from heliograph.receive.detect.detection import Detection, is_sending_before
from heliograph.receive.detect.detector import Detector, HalfPeriodDetector
from heliograph.receive.detect.frame_window import FrameWindow, FrameWindowBuffer, crop_to_common, first_present
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.pose import Orientation, Pose
from heliograph.receive.geometry.view import View, halved, reduced_blur
from heliograph.receive.geometry.window import Window, crop, window_around
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings


class HeaderSearch:
    """Search for headers at the phases of a camera, on all levels of a pyramid, in the frames or a region of them."""

    def __init__(
        self, parameters: SearchParameters, signal: SignalSettings, synchronous: bool, region: Window | None = None
    ):
        self._parameters, self._signal, self._synchronous = parameters, signal, synchronous
        self._given = self._region = region
        if region is not None:
            # the ring about an array as large as the region
            margin = math.ceil(DETECT.ring * max(region[2:]) + DETECT.margin_px) + BLOCK_PX
            self._region = region[0] - margin, region[1] - margin, region[2] + 2 * margin, region[3] + 2 * margin
        # phases in patterns, None for each frame, and the searches with one frame per pattern
        self._streams: list[tuple[float | None, PyramidSearch]] = []
        # last frames, oldest first, which hold the header of a new detection
        self.recent: deque[Frame] = deque()
        self._number, self._began_s = 0, 0.0

    @property
    def load(self) -> SearchLoad:
        """Work of all streams, with the skipped candidates and blocks."""
        loads = [search.budget.load for _, search in self._streams]
        return reduce(add, loads) if loads else SearchLoad()

    def start(self, period_s: float) -> None:
        """Prepare for frames of a period, before the first frame: the light's period or less."""
        light_s, max_frames = self._signal.pattern_period_s, 1000
        is_slow = period_s > light_s * (1 + STEP_TOLERANCE)
        if is_slow or period_s * max_frames < light_s:
            needs = "needs at least one frame" if is_slow else f"takes at most {max_frames} frames"
            raise HeliographError(
                f"the soft receiver {needs} per pattern: the film has {1 / period_s:.1f} frames/s, the light "
                f"{1 / light_s:.1f} patterns/s; {'record faster' if is_slow else 'leave out frames'}, give times "
                "in seconds, or pass the camera's true rate with --fps"
            )
        phases: list[float | None] = [None]
        if period_s <= light_s * (1 - STEP_TOLERANCE):
            # fewer frames per pattern need more phases; each has a budget, as a single phase may suit an array
            rate = light_s / period_s
            count = 4 if rate < 2 else math.floor(rate)
            phases = [k / count for k in range(count)]
        with_half_period = phases == [None] and not self._synchronous
        self._streams = [
            (phase, PyramidSearch(self._parameters, self._signal, with_half_period=with_half_period))
            for phase in phases
        ]
        # the light's clock needs two patterns on either side of a header, and two to spare
        self.recent = deque(maxlen=math.ceil((2 * self._signal.header_pairs + 8) * light_s / period_s))

    def set_orientation(self, orientation: Orientation) -> None:
        """Search for arrays of a single orientation from now on, which all arrays share."""
        for _, search in self._streams:
            search.set_orientation(orientation)

    def search(self, frame: Frame, tracked: Sequence[Pose] = ()) -> list[Detection]:
        """Search with the next frame; arrays are not searched for at the poses of tracked arrays."""
        if not self.recent and self._given is not None and not crop(frame, self._given).pixels.size:
            (x, y), (rows, columns) = frame.origin, frame.pixels.shape
            where = f" from {x},{y} on" if frame.origin != (0, 0) else ""
            raise HeliographError(
                f"the region {','.join(map(str, self._given))} that was given lies beyond the frames, which are "
                f"{columns}x{rows}{where}"
            )
        self._began_s = self._began_s if self.recent else frame.time_s
        self.recent.append(frame)
        if self._region is not None:
            self._region = _union(self._region, *(around(pose, self._signal.side) for pose in tracked))
        detections = list[Detection]()
        for phase, search in self._streams:
            thinned = self._number_frame(frame) if phase is None else self._nearest_frame(phase)
            if thinned is not None and self._region is not None:
                # a camera's window may be elsewhere for a while
                thinned = crop(thinned, self._region)
            if thinned is not None and thinned.pixels.size:
                detections += search.search(thinned, [*tracked, *(found.fit.pose for found in detections)])
        return [replace(found, misses_start=self._misses_start(found)) for found in detections]

    def _misses_start(self, detection: Detection) -> bool:
        """Return True if the array was sending before the header, in the first two packets of the film."""
        is_first = detection.start_time_s - self._began_s < 2.5 * self._signal.packet_s
        return is_first and is_sending_before(detection, self.recent, self._signal)

    def _number_frame(self, frame: Frame) -> Frame:
        """Number a frame by the pattern; a dropped frame leaves a gap."""
        if self._synchronous:
            return frame
        last_s = self.recent[-2].time_s if len(self.recent) > 1 else 0.0
        self._number += max(1, round((frame.time_s - last_s) / self._signal.pattern_period_s))
        return replace(frame, index=self._number)

    def _nearest_frame(self, phase: float) -> Frame | None:
        """Return the frame of the last pattern that is nearest to a phase, once the next pattern begins."""

        def place(frame: Frame) -> float:
            return frame.time_s / self._signal.pattern_period_s - phase

        if len(self.recent) < 2 or round(place(self.recent[-1])) == (number := round(place(self.recent[-2]))):
            return None
        of_pattern = takewhile(lambda frame: round(place(frame)) == number, islice(reversed(self.recent), 1, None))
        # of two equally near frames the earlier
        nearest = min(reversed([*of_pattern]), key=lambda frame: abs(place(frame) - number))
        return replace(nearest, index=number)


class PyramidSearch:
    """Detectors on the levels of a pyramid, the coarsest first, in a stream of one frame per pattern."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings, with_half_period: bool = False):
        # rounding adds to the alternation of reduced frames
        self._min_contrast = 0.9 * DETECT.busy_contrast * parameters.min_contrast
        self._reduced: dict[tuple[object, ...], list[Frame]] = {}
        self.budget = TokenBucket(parameters.cpu_share, signal.pattern_period_s)
        # a header may have 1.2 times the alternation of on-off data, and no more. Data differ for a search from an
        # inverse on, so even and odd frames have separate baselines
        ratios = (1.1, 1.1) if signal.modulation == "ook" else (1.2, 1.4)
        self._baselines = [NoveltyFilter(*ratios) for _ in range(2)]
        self._buffer = FrameWindowBuffer(2 * signal.header_pairs, signal.packet_patterns)
        levels = level_parameters(parameters, signal.side)
        self._levels = [(View(k), Detector(level, signal, self.budget)) for k, level in enumerate(levels)]
        self._finest = self._levels[0][1]
        self._smallest_px = [2**k * level.min_side_px for k, level in enumerate(levels)][1:]
        # larger arrays are not searched for half a pattern out of step, and a header of one pair has no quiet frames
        with_half_period &= signal.header_pairs > 1
        self._half_period = HalfPeriodDetector(self._finest) if with_half_period else None

    def set_orientation(self, orientation: Orientation) -> None:
        """Search for a single orientation from now on; see `HeaderSearch`."""
        for _, detector in self._levels:
            detector.set_orientation(orientation)

    def search(self, frame: Frame, tracked: Sequence[Pose] = ()) -> list[Detection]:
        """Search with the next frame; see `HeaderSearch`."""
        self.budget.refill()
        detections = list[Detection]()
        for slots, with_turned in self._buffer.push(frame):
            detections += self._search(slots, [*tracked, *(found.fit.pose for found in detections)], with_turned)
        if self._half_period is not None:
            detections += self._half_period.search(frame, [*tracked, *(found.fit.pose for found in detections)])
        return detections

    def _search(self, slots: FrameWindow, tracked: Sequence[Pose], with_turned: bool) -> list[Detection]:
        """Search frames on all levels on which they alternate."""
        finest, first = self._finest, first_present(slots)
        means = finest.block_means(slots)
        if means is None:
            return []
        alternating = finest.busy_blocks(means, first, tracked)
        busy = self.budget.start_search(self._baselines[first.index % 2], means, alternating, first)
        if not np.count_nonzero(busy):
            return []
        skipped = alternating & ~busy
        known, detections = list(tracked), list[Detection]()
        coarsest = self._coarsest_level(slots, busy, int(np.count_nonzero(alternating)))
        for k, (view, detector) in reversed(list(enumerate(self._levels[: coarsest + 1]))):
            reduced, poses = self._reduced_window(slots, k), [view.pose_in(pose) for pose in known]
            level_means = (detector.block_means(reduced) if k else means) if reduced else None
            if level_means is None:
                continue
            if k == 0 and not detections:
                level_busy = busy
            else:
                level_busy = detector.busy_blocks(level_means, first_present(reduced), poses)
                if skipped.any():
                    level_busy &= busy if k == 0 else _without_skipped(skipped, busy, slots, reduced, k)
            for found in detector.search(reduced, level_busy, poses, with_turned):
                known.append(view.pose_out(found.fit.pose))
                fit, drift = view.map_fit(found.fit, inverse=True), view.map_motion(found.drift, inverse=True)
                detections.append(replace(found, fit=fit, drift=drift))
        return detections

    def _coarsest_level(self, slots: FrameWindow, busy: Blocks, alternating: int) -> int:
        """Find the coarsest level on which an area as large as an array there may alternate.

        The alternation is reduced instead of the frames, and only about the chosen blocks of those that alternate.
        """
        # half of the columns and half of the rows of an array are visible
        max_level = sum((alternating * BLOCK_PX**2) >= 0.25 * side**2 for side in self._smallest_px)
        if not max_level:
            return 0
        changes = [change.pixels for change, _ in self._finest.regions(slots, busy, 32.0)]
        min_change = self._min_contrast * first_present(slots).full_scale
        for level in range(max_level):
            changes = [np.asarray(cv2.pyrDown(change), np.float32) for change in changes]
            # mean magnitudes of blocks about each pixel
            means = (cv2.blur(np.abs(change), (BLOCK_PX,) * 2, borderType=cv2.BORDER_CONSTANT) for change in changes)
            if all(mean.max() <= min_change for mean in means):
                return level
        return max_level

    def _reduced_window(self, slots: FrameWindow, level: int) -> FrameWindow:
        """Return the frames reduced to a level; none if they are too small for it."""
        if level == 0:
            return slots
        present = [frame for frame in slots if frame is not None]
        self._reduced = {_key(frame): self._reduced.get(_key(frame)) or self._reduce(frame) for frame in present}
        if any(len(frames) <= level for frames in self._reduced.values()):
            return []
        return crop_to_common([None if frame is None else self._reduced[_key(frame)][level] for frame in slots])

    def _reduce(self, frame: Frame) -> list[Frame]:
        """Reduce a frame to each possible level, with a black rim for the ring of a large array."""
        frames, reduced, rim = [frame], frame, math.ceil(2 * DETECT.ring * DETECT.max_side_px)
        for _ in self._levels[1:]:
            # an odd first row or column is left out
            if min(reduced.pixels.shape) < 3:
                break
            reduced = halved(reduced)
            frames.append(_with_rim(reduced, rim))
        return frames


def level_parameters(parameters: SearchParameters, side: int) -> list[SearchParameters]:
    """Return the search parameters of each level, the finest first, in px of the level."""
    smallest, largest = parameters.min_side_px, parameters.max_side_px
    finest = max(min(DETECT.max_side_px, side * DETECT.max_pitch_px), smallest * DETECT.size_ratio)
    levels = [replace(parameters, max_side_px=min(finest, largest))]
    # larger LEDs on a reduced level leave a correlation below 0.5
    reduced = 0.7 * finest
    while largest > finest and (len(levels) == 1 or reduced * 2 ** (len(levels) - 1) < largest):
        k = len(levels)
        sizes = reduced / 2 / DETECT.size_ratio, min(reduced, largest / 2**k)
        blur = reduced_blur(parameters.blur_px, k)
        start = parameters.start and View(k).pose_in(parameters.start)
        levels.append(replace(parameters, min_side_px=min(sizes), max_side_px=max(sizes), blur_px=blur, start=start))
    return levels


def _without_skipped(skipped: Blocks, searched: Blocks, slots: FrameWindow, reduced: FrameWindow, level: int) -> Blocks:
    """Return the blocks of a level, except over skipped blocks with no searched block."""
    frame, level_frame = first_present(slots), first_present(reduced)
    out = np.ones([-(-size // BLOCK_PX) for size in level_frame.pixels.shape], bool)
    for blocks, value in ((skipped, False), (searched, True)):
        # the middles of the blocks, on the sensor and on the level
        middles = (np.argwhere(blocks) + 0.5) * BLOCK_PX + frame.origin[::-1]
        down, across = ((middles / 2**level - level_frame.origin[::-1]) // BLOCK_PX).astype(int).T
        # the common part of all frames may be smaller on a level, by some pixels of a rim
        out[np.clip(down, 0, out.shape[0] - 1), np.clip(across, 0, out.shape[1] - 1)] = value
    return out


def _key(frame: Frame) -> tuple[object, ...]:
    """Return a key to tell apart frames, copies before the film, and crops."""
    return frame.index, frame.time_s, frame.origin, frame.pixels.shape


def _with_rim(frame: Frame, rim: int) -> Frame:
    """Add a black rim to a frame."""
    pixels: Pixels = np.pad(frame.pixels, rim)  # type: ignore[assignment]  # NumPy keeps the dtype
    pixels.setflags(write=False)
    x, y = frame.origin
    return replace(frame, pixels=pixels, origin=(x - rim, y - rim))


def around(pose: Pose, side: int) -> Window:
    """Return the searched surroundings of an array: half a side on each side, for shake between packets."""
    return window_around(pose, side, 0.5 * side * pose.pitch)


def _union(*windows: Window) -> Window:
    """Return the smallest window that holds some windows."""
    left, top = (min(window[k] for window in windows) for k in (0, 1))
    right, low = (max(window[k] + window[k + 2] for window in windows) for k in (0, 1))
    return left, top, right - left, low - top
