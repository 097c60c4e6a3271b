"""Films of one drive with different backgrounds, and all trackers on them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.channel import ArrayTruth, Truth, film
from heliograph.experiments.tracking.trackers import (
    BackgroundMotion,
    Follower,
    InvertedSignals,
    KnownPattern,
    MultipleInstance,
    NoTracking,
    TemplateMatch,
    is_in_header,
    known_light,
)
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings, default_messages, load_footage, load_imu, simulate
from heliograph.receive import Pose
from heliograph.receive.build import PLAIN_REGULARITY, search_parameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.geometry.window import cut_out

KNOWN, OURS = "known pattern", "inverted signals"
TRACKERS: Mapping[str, Callable[[LinkSettings], Follower]] = {
    "none": lambda _: NoTracking(),
    OURS: InvertedSignals,
    KNOWN: KnownPattern,
    "background": lambda _: BackgroundMotion(),
    "OpenCV MIL": lambda _: MultipleInstance(),
    "OpenCV template": lambda _: TemplateMatch(),
}
"""Trackers by name."""

Pair = tuple[Frame, Frame, ArrayTruth, ArrayTruth]
"""Two successive frames, and the truth of the array in both."""


@dataclass(frozen=True, kw_only=True)
class TrackingFilm:
    """Film for the trackers."""

    name: str
    settings: LinkSettings
    seed: int
    # Recorded footage and motion; None: as in the settings
    clip: Path | None = None
    imu: Path | None = None


@dataclass(frozen=True)
class TrackingRun:
    """Errors of the trackers in a film, by pair of frames."""

    name: str
    # (n,) time in s, true distance in m and true side of the array in px
    times_s: Floats
    distance_m: Floats
    side_px: Floats
    # (n,) number of the packet
    packet: NDArray[np.int64]
    # By tracker (n, 3): error of x and y in px, and relative error of the pitch (NaN: not estimated)
    errors: Mapping[str, Floats]
    # For the pictures: time, and the sum cut out at the first pose and at the tracked pose
    cuts: list[tuple[float, tuple[Floats, Floats]]] = field(default_factory=list)


def run_trackers(job: TrackingFilm) -> TrackingRun:
    """Run all trackers on a film."""
    recordings = Recordings(
        footage=load_footage(job.clip) if job.clip else None, imu=load_imu(job.imu) if job.imu else None
    )
    group = _TrackerGroup(job.settings, [name for name in TRACKERS if name != KNOWN])
    channel = job.settings.channel
    length_s = channel.duration_s or (channel.distance_m - channel.stop_m) / channel.speed_m_s
    moments = [int(k) for k in np.linspace(0.02, 0.97, 8) * length_s * channel.camera.fps]
    for pair in _pairs(simulate(job.settings, default_messages(job.settings), job.seed, recordings)):
        group.push(pair)
        if moments and group.found and pair[0].index >= moments[0]:
            moments.pop(0)
            group.cut(pair)
    if group.found is None:
        raise HeliographError(f"the array was not found in the film '{job.name}'")
    known = _TrackerGroup(job.settings, [KNOWN], group.found)
    for pair in _pairs(_known_film(job, recordings)):
        known.push(pair)
    times, distance, pitch = np.array(group.rows).T
    errors = {name: np.array((group.errors | known.errors)[name]) for name in TRACKERS}
    packet = np.floor(times / job.settings.signal.packet_s + 1e-6).astype(np.int64)
    return TrackingRun(job.name, times, distance, job.settings.signal.side * pitch, packet, errors, group.cuts)


def _known_film(job: TrackingFilm, recordings: Recordings) -> Iterator[tuple[Frame, Truth]]:
    """The same drive, scene and noise with the light of the known pattern, rendered around the array."""
    settings, signal = job.settings, job.settings.signal
    return film(
        settings.channel,
        [known_light(settings, settings.transmit.identities[0], job.seed)],
        np.random.default_rng(job.seed),
        pattern_period_s=signal.pattern_period_s,
        slot_order=signal.slot_order,
        footage=recordings.footage,
        imu=recordings.imu,
        # more than the window of a tracker on its array
        roi_margin_px=24,
    )


def _pairs(frames: Iterator[tuple[Frame, Truth]]) -> Iterator[Pair]:
    """Frames 0 and 1, 2 and 3, ..."""
    for (first, true), (second, later) in zip(frames, frames, strict=False):
        yield first, second, true.arrays[0], later.arrays[0]


class _TrackerGroup:
    """Trackers of one film, started together at the end of the first detected header."""

    def __init__(self, settings: LinkSettings, names: list[str], found: Detection | None = None):
        self._settings, self.found = settings, found
        self._detector = PyramidSearch(
            search_parameters(settings.receive, settings.signal, PLAIN_REGULARITY), settings.signal
        )
        self._followers = {name: TRACKERS[name](settings) for name in names}
        self._held: list[Pair] = []
        self._started = False
        self.rows: list[tuple[float, float, float]] = []
        self.errors: dict[str, list[tuple[float, float, float]]] = {name: [] for name in names}
        self.cuts: list[tuple[float, tuple[Floats, Floats]]] = []
        self._poses: dict[str, Pose] = {}

    def push(self, pair: Pair) -> None:
        """Process a pair, or hold it until the array is detected."""
        # the detector needs fewer pairs after a header
        self._held = [*self._held[-16:], pair]
        if self.found is None:
            hits = [hit for frame in pair[:2] for hit in self._detector.search(frame)]
            self.found = hits[0] if hits else None
        if self.found is None:
            return
        held, self._held = self._held, []
        for one in held:
            self._follow(self.found, one)

    def _follow(self, found: Detection, pair: Pair) -> None:
        pattern, inverted, true, later = pair
        since = pattern.time_s - found.start_time_s
        if since < -1e-9:
            return
        if not self._started:
            # trackers begin at the last pair of the header
            self._started = not is_in_header(self._settings, since + 2 * self._settings.signal.pattern_period_s)
            if self._started:
                for follower in self._followers.values():
                    follower.start(found, pattern, inverted)
            return
        x, y, pitch, distance = (
            0.5 * (getattr(true, name) + getattr(later, name)) for name in ("x", "y", "pitch_px", "distance_m")
        )
        self.rows.append((pattern.time_s, distance, pitch))
        for name, follower in self._followers.items():
            pose = self._poses[name] = follower.update(pattern, inverted)
            relative = pose.pitch / pitch - 1 if follower.sized else np.nan
            self.errors[name].append((pose.x - x, pose.y - y, relative))

    def cut(self, pair: Pair) -> None:
        """Cut the sum out at the first and at the tracked pose, twice as wide as the array."""
        if self.found is None or OURS not in self._poses:
            return
        fixed, tracked = (self._cut(pair, pose) for pose in (self.found.fit.pose, self._poses[OURS]))
        self.cuts.append((pair[0].time_s, (fixed, tracked)))

    def _cut(self, pair: Pair, pose: Pose) -> Floats:
        half = round(self._settings.signal.side * pose.pitch)
        window = (round(pose.x) - half, round(pose.y) - half, 2 * half + 1, 2 * half + 1)
        return cut_out(pair[0], window) + cut_out(pair[1], window)
