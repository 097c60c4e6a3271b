"""Search for headers of arrays of any size, in the frames of a camera of any rate and phase.

Each level of a pyramid of frames has a detector, for arrays with hardly visible single LEDs. Then sums over cells of a
header hold most of the light, and fits are fast.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame, Pixels
from heliograph.receive.detect.alternation import COARSE, Blocks, Change, SearchParameters
from heliograph.receive.detect.budget import SearchLoad, TokenBucket
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.detector import Detector, HalfPeriodDetector
from heliograph.receive.detect.frame_window import FrameWindow, crop_to_common, first_present
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.pose import Orientation, Pose
from heliograph.receive.geometry.view import View, halved, reduced_blur
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True, kw_only=True)
class PyramidParameters:
    """Sizes of arrays on the levels of a pyramid, and thresholds for the reduction of frames."""

    # Largest array on the finest level in px a side and in px of pitch: 16 LEDs with a pitch of 4 px have 64 px
    max_side_px: float = 64.0
    max_pitch_px: float = 4.0
    # Largest array on a reduced level as a fraction of the finest level's: larger LEDs leave a correlation below 0.5
    reduced_size: float = 0.7
    # Least alternation on a reduced level over a busy block's: rounding adds to the alternation of reduced frames
    rounding: float = 0.9
    # Margin in px about busy blocks in the reduced alternation
    margin_px: float = 32.0
    # Least alternating part of an array: half of the columns and half of the rows are visible
    min_alternating: float = 0.25


PYRAMID = PyramidParameters()


class PyramidSearch:
    """Detectors on the levels of a pyramid, the coarsest first; see `HeaderSearch`."""

    def __init__(
        self,
        parameters: SearchParameters,
        signal: SignalSettings,
        budget: TokenBucket | None = None,
        pyramid: PyramidParameters = PYRAMID,
        with_half_period: bool = False,
    ):
        levels = level_parameters(parameters, signal.side, pyramid)
        self._pyramid = pyramid
        self._min_contrast = pyramid.rounding * COARSE.busy_contrast * parameters.min_contrast
        self._reduced: dict[tuple[object, ...], list[Frame]] = {}
        self._budget = budget or TokenBucket(parameters.cpu_share, signal.pattern_period_s)
        self._levels = [(View(k), Detector(level, signal, self._budget)) for k, level in enumerate(levels)]
        self._finest = self._levels[0][1]
        # larger arrays are not searched for half a pattern out of step, and a header of one pair has no quiet frames
        with_half_period &= signal.header_pairs > 1
        self._half_period = HalfPeriodDetector(levels[0], signal, self._budget) if with_half_period else None
        self._smallest_px = [2**k * level.min_side_px for k, level in enumerate(levels)][1:]

    def start(self, period_s: float) -> None:
        """Accept any period, as frames come one per pattern; see `HeaderSearch`."""

    def set_orientation(self, orientation: Orientation) -> None:
        """Search for a single orientation from now on; see `HeaderSearch`."""
        for _, detector in self._levels:
            detector.set_orientation(orientation)
        if self._half_period is not None:
            self._half_period.set_orientation(orientation)

    @property
    def load(self) -> SearchLoad:
        """Work of all levels, with the skipped candidates and blocks."""
        return self._budget.load

    @property
    def recent(self) -> Sequence[Frame]:
        """Last frames, oldest first; see `HeaderSearch`."""
        return self._finest.buffer.present

    def push(self, frame: Frame, tracked: Sequence[Pose] = ()) -> list[Detection]:
        """Search with the next frame; see `HeaderSearch`."""
        self._budget.refill()
        detections = list[Detection]()
        for slots, with_turned in self._finest.buffer.push(frame):
            detections += self._search(slots, [*tracked, *(found.fit.pose for found in detections)], with_turned)
        if self._half_period is not None:
            detections += self._half_period.push(frame, [*tracked, *(found.fit.pose for found in detections)])
        return detections

    def _search(self, slots: FrameWindow, tracked: Sequence[Pose], with_turned: bool) -> list[Detection]:
        """Search frames on all levels on which they alternate."""
        finest, first = self._finest, first_present(slots)
        means = finest.block_means(slots)
        if means is None:
            return []
        # alternation on a level is alternation in the frames themselves
        alternating = finest.busy_blocks(means, first, tracked)
        busy, is_novel = finest.selector.select(means, alternating, first)
        if not self._budget.try_start(busy, is_novel):
            return []
        skipped = alternating & ~busy
        known, detections = list(tracked), list[Detection]()
        coarsest = self._coarsest_level(slots, busy, int(np.count_nonzero(busy | skipped)))
        for k, (view, detector) in reversed(list(enumerate(self._levels[: coarsest + 1]))):
            reduced, poses = self._reduced_window(slots, k), [view.pose_in(pose) for pose in known]
            level_means = (detector.block_means(reduced) if k else means) if reduced else None
            if level_means is None:
                continue
            level_busy = detector.busy_blocks(level_means, first_present(reduced), poses)
            if k == 0:
                level_busy &= busy
            elif skipped.any():
                level_busy &= _without_skipped(skipped, busy, slots, reduced, k)
            for found in detector.search(reduced, level_busy, poses, with_turned):
                known.append(view.pose_out(found.fit.pose))
                detections.append(replace(found, fit=view.fit_out(found.fit), drift=view.motion_out(found.drift)))
        return detections

    def _coarsest_level(self, slots: FrameWindow, busy: Blocks, alternating: int) -> int:
        """Find the coarsest level on which an area as large as an array there may alternate.

        The alternation is reduced instead of the frames, and only about the chosen blocks of those that alternate.
        """
        area = alternating * BLOCK_PX**2
        max_level = sum(area >= self._pyramid.min_alternating * side**2 for side in self._smallest_px)
        if not max_level:
            return 0
        changes = [region.change for region in self._finest.regions(slots, busy, self._pyramid.margin_px)]
        min_change = self._min_contrast * first_present(slots).full_scale
        for level in range(max_level):
            changes = [np.asarray(cv2.pyrDown(change), np.float32) for change in changes]
            if all(_max_block_mean(change) <= min_change for change in changes):
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
        frames, reduced, rim = [frame], frame, math.ceil(2 * COARSE.ring * self._pyramid.max_side_px)
        for _ in self._levels[1:]:
            # an odd first row or column is left out
            if min(reduced.pixels.shape) < 3:
                break
            reduced = halved(reduced)
            frames.append(_with_rim(reduced, rim))
        return frames


def level_parameters(
    parameters: SearchParameters, side: int, pyramid: PyramidParameters = PYRAMID
) -> list[SearchParameters]:
    """Return the search parameters of each level, the finest first, in px of the level."""
    smallest, largest = parameters.min_side_px, parameters.max_side_px
    finest = max(min(pyramid.max_side_px, side * pyramid.max_pitch_px), smallest * COARSE.size_ratio)
    levels = [replace(parameters, max_side_px=min(finest, largest))]
    reduced = pyramid.reduced_size * finest
    while largest > finest and (len(levels) == 1 or reduced * 2 ** (len(levels) - 1) < largest):
        k = len(levels)
        sizes = reduced / 2 / COARSE.size_ratio, min(reduced, largest / 2**k)
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


def _max_block_mean(change: Change) -> float:
    """Return the largest mean magnitude of a block about a pixel."""
    return float(cv2.blur(np.abs(change), (BLOCK_PX, BLOCK_PX), borderType=cv2.BORDER_CONSTANT).max())


def _key(frame: Frame) -> tuple[object, ...]:
    """Return a key to tell apart frames, copies before the film, and crops."""
    return frame.index, frame.time_s, frame.origin, frame.pixels.shape


def _with_rim(frame: Frame, rim: int) -> Frame:
    """Add a black rim to a frame."""
    pixels: Pixels = cv2.copyMakeBorder(  # type: ignore[assignment]  # OpenCV keeps the dtype
        frame.pixels, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=0
    )
    x, y = frame.origin
    return replace(frame, pixels=pixels, origin=(x - rim, y - rim))


class PhasedSearch:
    """Searches at several phases of a fast camera, with one frame per pattern each; see `HeaderSearch`."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings):
        self._parameters, self._signal = parameters, signal
        self._streams: list[tuple[_FrameThinner, PyramidSearch]] = []
        self._recent: deque[Frame] = deque()

    @property
    def recent(self) -> Sequence[Frame]:
        """Last frames, oldest first; see `HeaderSearch`."""
        return self._recent

    @property
    def load(self) -> SearchLoad:
        """Work of all streams, with the skipped candidates and blocks."""
        return sum((search.load for _, search in self._streams), SearchLoad())

    def start(self, period_s: float) -> None:
        """Prepare for a camera as fast as the light or faster; see `HeaderSearch`."""
        light_s, max_frames = self._signal.pattern_period_s, 1000
        if period_s > light_s * (1 + STEP_TOLERANCE):
            raise HeliographError(
                f"the soft receiver needs at least one frame a pattern: the film has {1 / period_s:.1f} frames/s, the "
                f"light {1 / light_s:.1f} patterns/s; film faster, give times in seconds, or say by --fps what the "
                "camera did where the film misstates it"
            )
        if period_s * max_frames < light_s:
            raise HeliographError(
                f"the soft receiver takes at most {max_frames} frames a pattern: the film has "
                f"{1 / period_s:.3g} frames/s, the light {1 / light_s:.1f} patterns/s; give times in seconds, say by "
                "--fps what the camera did where the film misstates it, or leave out frames"
            )
        if period_s > light_s * (1 - STEP_TOLERANCE):
            search = PyramidSearch(self._parameters, self._signal, with_half_period=True)
            self._streams = [(_FrameThinner(period_s, None), search)]
        else:
            # fewer frames per pattern need more phases; each has a budget, as a single phase may suit an array
            rate = light_s / period_s
            count = 4 if rate < 2 else math.floor(rate)
            self._streams = [
                (_FrameThinner(light_s, k / count), PyramidSearch(self._parameters, self._signal)) for k in range(count)
            ]
        # the light's clock needs two patterns on either side of a header, and two to spare
        patterns = 2 * self._signal.header_pairs + 8
        self._recent = deque(maxlen=math.ceil(patterns * light_s / period_s))

    def set_orientation(self, orientation: Orientation) -> None:
        """Search for a single orientation from now on; see `HeaderSearch`."""
        for _, search in self._streams:
            search.set_orientation(orientation)

    def push(self, frame: Frame, tracked: Sequence[Pose] = ()) -> list[Detection]:
        """Search with the next frame; see `HeaderSearch`."""
        self._recent.append(frame)
        detections = list[Detection]()
        for thinner, search in self._streams:
            if (thinned := thinner.push(frame)) is not None:
                detections += search.push(thinned, [*tracked, *(found.fit.pose for found in detections)])
        return detections


class _FrameThinner:
    """Numbers one frame per pattern: every frame, or the frames nearest to a phase."""

    def __init__(self, step_s: float, phase: float | None):
        self._step_s, self._phase = step_s, phase
        self._number, self._time_s = 0, 0.0
        self._best: Frame | None = None
        self._distance = 0.0

    def push(self, frame: Frame) -> Frame | None:
        """Add a frame; return the frame of the last pattern once it is known."""
        if self._phase is None:
            # a dropped frame leaves a gap
            self._number += max(1, round((frame.time_s - self._time_s) / self._step_s))
            self._time_s = frame.time_s
            return frame.numbered(self._number)
        place = frame.time_s / self._step_s - self._phase
        number = round(place)
        distance, best = abs(place - number), self._best
        is_next = best is None or best.index != number
        if is_next or distance < self._distance:
            self._best, self._distance = frame.numbered(number), distance
        return best if is_next else None
