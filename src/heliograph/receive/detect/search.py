"""Search for headers of arrays of any size: a detector for each level of a pyramid of frames.

On its level an array is so small that single LEDs hardly show. Sums over cells of a header then hold most of its light,
and its pixels are soon fitted.

Search for headers in the frames of a camera of any rate and phase.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame, Pixels
from heliograph.receive.detect.alternation import PART_LIT, RING, SIDE_STEP, SearchParameters
from heliograph.receive.detect.budget import Budget, SearchLoad
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.detector import Detector, HalfPeriodDetector
from heliograph.receive.detect.frame_window import FrameWindow, SearchJob, crop_to_common, first_present
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.pose import Orientation, Pose
from heliograph.receive.geometry.view import View, halved, reduced_blur
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings

LEVEL_SIDE_PX = 64.0
"""Largest array in px that is looked for in the camera's own frames: 16 LEDs then have a pitch of 4 px."""

LEVEL_PITCH_PX = 4.0
"""The same as a pitch, for arrays of fewer LEDs: those of 8 x 8 have 32 px."""

REDUCED = 0.7
"""Largest array on a reduced level, as a fraction of that.

Single LEDs at a pitch of 3.9 px left a header's cells a correlation of 0.50, which is the least of a candidate, and at
2.0 px, on the next level, 0.72 (array of 499 px, `python -m benchmarks.near distances 1 0`).
"""

ROUNDED = 0.9
"""Part of the least alternation of a busy block that is asked for before frames are reduced.

A reduced frame is rounded to whole gray levels, which adds 0.3 of them to what alternates; a busy block has 1.9 or more
of the reference link.
"""

AROUND_PX = 32.0
"""Pixels about what alternates that are reduced to see whether it does so on a level: as far as a pixel of it shows."""

LEAST_ALTERNATING_PART = 0.25
"""Least part of a near array that alternates: half of its columns and half of its rows are in sight."""


class PyramidSearch:
    """A detector for each level, the coarsest first; see `HeaderSearch`."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings, budget: Budget | None = None):
        levels = level_parameters(parameters, signal.side)
        self._least = ROUNDED * PART_LIT * parameters.min_contrast
        self._reduced: dict[tuple[object, ...], list[Frame]] = {}
        self._budget, self._earns = budget or Budget(parameters.cpu_share, signal.pattern_period_s), budget is None
        self._levels = [(View(k), Detector(one, signal, self._budget)) for k, one in enumerate(levels)]
        self._smallest_px = [2**k * one.min_side_px for k, one in enumerate(levels)][1:]

    def start(self, period_s: float) -> None:
        """Begin; the frames are taken to come one per pattern, whatever the period; see `HeaderSearch`."""

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""
        for _, detector in self._levels:
            detector.settle(orientation)

    @property
    def load(self) -> SearchLoad:
        """What the searches of all levels did and left out so far."""
        return self._budget.load

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""
        return self._levels[0][1].recent

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; see `HeaderSearch`."""
        if self._earns:
            self._budget.earn()
        found = list[Detection]()
        for due in self._levels[0][1].due(frame):
            found += self._search(due, [*taken, *(one.fit.pose for one in found)])
        return found

    def _search(self, due: SearchJob, taken: Sequence[Pose]) -> list[Detection]:
        """Search frames on all levels."""
        finest = self._levels[0][1]
        change = finest.change(due.slots)
        if change is None:
            return []
        # what alternates on a level alternates in the frames themselves
        alternating = finest.busy(due.slots, change, taken)
        busy, strikes = finest.select_blocks(due.slots, change, alternating)
        if not self._budget.begins(busy, strikes):
            return []
        left = alternating & ~busy
        leaves_out = np.count_nonzero(left)
        known, found = list(taken), list[Detection]()
        shown = self._shown(due.slots, busy)
        for k, (view, detector) in reversed(list(enumerate(self._levels[: shown + 1]))):
            seen, poses = self._slots(due.slots, k), [view.pose_in(pose) for pose in known]
            if not seen:
                continue
            there = detector.change(seen) if k else change
            if there is None:
                continue
            alternates = detector.busy(seen, there, poses)
            if k == 0:
                alternates &= busy
            elif leaves_out:
                alternates &= _but_left(left, busy, due.slots, seen, k)
            for one in detector.search(seen, alternates, poses, due.turned):
                known.append(view.pose_out(one.fit.pose))
                found.append(replace(one, fit=view.fit_out(one.fit), drift=view.motion_out(one.drift)))
        return found

    def _shown(self, slots: FrameWindow, busy: NDArray[np.bool_]) -> int:
        """Coarsest level on which something may alternate that is as large as an array there.

        What alternates is reduced instead of the frames, and only where it is.
        """
        alternating = np.count_nonzero(busy) * BLOCK_PX**2
        most = sum(alternating >= LEAST_ALTERNATING_PART * side**2 for side in self._smallest_px)
        changes = self._levels[0][1].alternating(slots, busy, AROUND_PX) if most else []
        if not changes:
            return 0
        least = self._least * first_present(slots).full_scale
        for level in range(most):
            changes = [np.asarray(cv2.pyrDown(change), np.float32) for change in changes]
            if all(_block_means(change).max() <= least for change in changes):
                return level
        return most

    def _slots(self, slots: FrameWindow, level: int) -> FrameWindow:
        """Frames that are due, as a level has them; none where they are too small for it."""
        if level == 0:
            return slots
        there = [one for one in slots if one is not None]
        self._reduced = {_name(one): self._reduced.get(_name(one)) or self._seen(one) for one in there}
        if any(len(seen) <= level for seen in self._reduced.values()):
            return []
        return crop_to_common([None if one is None else self._reduced[_name(one)][level] for one in slots])

    def _seen(self, frame: Frame) -> list[Frame]:
        """The frame on each level that it has pixels for; on reduced ones with a rim, as a near array may fill it."""
        seen, reduced = [frame], frame
        for _ in self._levels[1:]:
            # an odd first row or column is left out
            if min(reduced.pixels.shape) < 3:
                break
            reduced = halved(reduced)
            seen.append(_rimmed(reduced))
        return seen


def level_parameters(parameters: SearchParameters, side: int) -> list[SearchParameters]:
    """What is looked for on each level, the finest first, each with sizes in px of its own."""
    smallest, largest = parameters.min_side_px, parameters.max_side_px
    most = max(min(LEVEL_SIDE_PX, side * LEVEL_PITCH_PX), smallest * SIDE_STEP)
    levels = [replace(parameters, max_side_px=min(most, largest))]
    reduced = REDUCED * most
    while largest > most and (len(levels) == 1 or reduced * 2 ** (len(levels) - 1) < largest):
        k = len(levels)
        sizes = reduced / 2 / SIDE_STEP, min(reduced, largest / 2**k)
        blur = reduced_blur(parameters.blur_px, k)
        start = parameters.start and View(k).pose_in(parameters.start)
        levels.append(replace(parameters, min_side_px=min(sizes), max_side_px=max(sizes), blur_px=blur, start=start))
    return levels


def _but_left(
    left: NDArray[np.bool_], searched: NDArray[np.bool_], slots: FrameWindow, seen: FrameWindow, level: int
) -> NDArray[np.bool_]:
    """Blocks of a level but those that hold blocks left out and none that is searched, (blocks down, blocks across)."""
    frame, reduced = first_present(slots), first_present(seen)
    out = np.ones([-(-size // BLOCK_PX) for size in reduced.pixels.shape], bool)
    for blocks, kept in ((left, False), (searched, True)):
        # the middles of the blocks, on the sensor and on the level
        middles = (np.argwhere(blocks) + 0.5) * BLOCK_PX + frame.origin[::-1]
        down, across = ((middles / 2**level - reduced.origin[::-1]) // BLOCK_PX).astype(int).T
        # what all frames show may be less on a level, by some pixels of a rim
        out[np.clip(down, 0, out.shape[0] - 1), np.clip(across, 0, out.shape[1] - 1)] = kept
    return out


def _block_means(change: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean size of what alternates in a block about each pixel, (rows, columns)."""
    means = cv2.blur(np.abs(change), (BLOCK_PX, BLOCK_PX), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(means, np.float32)


def _name(frame: Frame) -> tuple[object, ...]:
    """What tells frames apart, those that stand for frames before the film, and those cut to what others show."""
    return frame.index, frame.time_s, frame.origin, frame.pixels.shape


def _rimmed(frame: Frame) -> Frame:
    """A frame with black about it: a candidate's ring must be there, and must not alternate."""
    rim = ceil(2 * RING * LEVEL_SIDE_PX)
    pixels: Pixels = cv2.copyMakeBorder(  # type: ignore[assignment]
        frame.pixels, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=0
    )
    x, y = frame.origin
    return replace(frame, pixels=pixels, origin=(x - rim, y - rim))


PATTERNS_KEPT = 4
"""Patterns around a header whose frames are kept too.

The light's clock asks for two on either side, and two to spare.
"""

SLOW_PHASES = 4
"""Phases tried for a camera of fewer than two frames per pattern: one of them is within 1/8 pattern of any header's."""


@dataclass(frozen=True, slots=True)
class PhaseLimits:
    """Limits of a search by phases."""

    # Most frames a pattern: all frames of a header are kept, and each phase has a search of its own
    max_frames: int = 1000


LIMITS = PhaseLimits()


class PhasedSearch:
    """Thins frames out to streams of one frame per pattern at several phases, each with a detector of its own."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings):
        self._parameters, self._signal = parameters, signal
        # shared by the two detectors of a camera of the light's rate
        self._budget = Budget(parameters.cpu_share, signal.pattern_period_s)
        self._streams: list[_Stream] = []
        self._kept: deque[Frame] = deque()

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""
        return self._kept

    @property
    def load(self) -> SearchLoad:
        """What the searches of all streams did and left out so far."""
        streams = [detector.load for stream in self._streams if len(self._streams) > 1 for detector in stream.detectors]
        return sum(streams, self._budget.load)

    def start(self, period_s: float) -> None:
        """Begin to search frames of a camera as fast as the light or faster; see `HeaderSearch`."""
        light_s = self._signal.pattern_period_s
        if period_s > light_s * (1 + STEP_TOLERANCE):
            raise HeliographError(
                f"the soft receiver needs at least one frame a pattern: the film has {1 / period_s:.1f} frames/s, the "
                f"light {1 / light_s:.1f} patterns/s; film faster, give times in seconds, or say by --fps what the "
                "camera did where the film misstates it"
            )
        if period_s * LIMITS.max_frames < light_s:
            raise HeliographError(
                f"the soft receiver takes at most {LIMITS.max_frames} frames a pattern: the film has "
                f"{1 / period_s:.3g} frames/s, the light {1 / light_s:.1f} patterns/s; give times in seconds, say by "
                "--fps what the camera did where the film misstates it, or leave out frames"
            )
        alike = period_s > light_s * (1 - STEP_TOLERANCE)
        if alike:
            detectors: list[_FrameDetector] = [PyramidSearch(self._parameters, self._signal, self._budget)]
            if self._signal.header_pairs > 1:
                # of the finest level alone: larger arrays are not looked for half a pattern out of step
                finest = level_parameters(self._parameters, self._signal.side)[0]
                detectors.append(HalfPeriodDetector(finest, self._signal, self._budget))
            self._streams = [_EveryFrame(detectors, period_s)]
        else:
            phases = _phases(light_s / period_s)
            # each with a budget of its own: one of them alone may be in step with an array
            searches = [PyramidSearch(self._parameters, self._signal) for _ in range(phases)]
            self._streams = [_Nearest(one, light_s, k / phases) for k, one in enumerate(searches)]
        patterns = 2 * self._signal.header_pairs + 2 * PATTERNS_KEPT
        self._kept = deque(maxlen=math.ceil(patterns * light_s / period_s))

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""
        for stream in self._streams:
            for detector in stream.detectors:
                detector.settle(orientation)

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; see `HeaderSearch`."""
        self._kept.append(frame)
        self._budget.earn()
        known, found = list(taken), list[Detection]()
        for stream in self._streams:
            shown = stream.push(frame)
            if shown is None:
                continue
            for detector in stream.detectors:
                there = detector.push(shown, known)
                known += [one.fit.pose for one in there]
                found += there
        return found


class _FrameDetector(Protocol):
    """Looks for headers in a stream of one frame per pattern."""

    @property
    def load(self) -> SearchLoad:
        """What the searches did and left out so far."""

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; return the arrays whose header lies in the last ones."""


class _Stream(Protocol):
    """Thins frames out for detectors."""

    @property
    def detectors(self) -> Sequence[_FrameDetector]:
        """The detectors, all of which get the same frames."""

    def push(self, frame: Frame) -> Frame | None:
        """Take a frame; return the one that a pattern is known to be seen in, with the pattern's number."""


class _EveryFrame:
    """All frames of a camera of the light's rate."""

    def __init__(self, detectors: Sequence[_FrameDetector], period_s: float):
        self.detectors, self._period_s = detectors, period_s
        self._number, self._time_s = 0, 0.0

    def push(self, frame: Frame) -> Frame:
        """Number the frame; one that was dropped leaves a gap."""
        self._number += max(1, round((frame.time_s - self._time_s) / self._period_s))
        self._time_s = frame.time_s
        return frame.numbered(self._number)


class _Nearest:
    """One frame per pattern: those that begin nearest to even times."""

    def __init__(self, detector: _FrameDetector, step_s: float, phase: float):
        self.detectors, self._step_s, self._phase = (detector,), step_s, phase
        self._best: Frame | None = None
        self._off = 0.0

    def push(self, frame: Frame) -> Frame | None:
        """Take a frame; return the last pattern's once it is known which one is nearest."""
        place = frame.time_s / self._step_s - self._phase
        number = round(place)
        off, kept = abs(place - number), self._best
        another = kept is None or kept.index != number
        if another or off < self._off:
            self._best, self._off = frame.numbered(number), off
        return kept if another else None


def _phases(rate: float) -> int:
    """Streams for a camera of `rate` frames per pattern: the fewer frames to choose from, the more phases are tried."""
    return SLOW_PHASES if rate < 2 else max(2, math.floor(rate))
