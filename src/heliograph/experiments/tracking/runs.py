"""Films of one drive before different backgrounds, and all trackers run on them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.channel import ArrayTruth, film
from heliograph.experiments.tracking.trackers import (
    BackgroundMotion,
    Follower,
    InvertedSignals,
    KnownPattern,
    MultipleInstance,
    NoTracking,
    TemplateMatch,
    in_header,
    known_light,
)
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings, default_messages, load_footage, load_imu, simulate
from heliograph.receive import Pose
from heliograph.receive.build import PLAIN_REGULARITY, search_parameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.geometry.window import cut_out

KNOWN = "known pattern"
TRACKERS: Mapping[str, Callable[[LinkSettings], Follower]] = {
    "none": lambda _: NoTracking(),
    "inverted signals": InvertedSignals,
    KNOWN: KnownPattern,
    "background": lambda _: BackgroundMotion(),
    "OpenCV MIL": lambda _: MultipleInstance(),
    "OpenCV template": lambda _: TemplateMatch(),
}
"""Trackers by name."""

Pair = tuple[Frame, Frame, ArrayTruth, ArrayTruth]
"""A pattern and the one after it, and the array's truth in both."""


@dataclass(frozen=True, kw_only=True)
class TrackingFilm:
    """A film to run the trackers on."""

    # Name of the film in tables
    name: str
    # Settings of the link that is filmed
    settings: LinkSettings
    # Seed of road, scene and noise, 0 or more
    seed: int
    # clip, imu: files of recorded footage and motion; None: as the settings draw them
    clip: Path | None = None
    imu: Path | None = None


@dataclass(frozen=True)
class TrackingRun:
    """Errors of the trackers in a film, by pair of frames."""

    # Name of the film in tables
    name: str
    # times_s, distance_m, side_px: (n,) time of the pair since the film's start in s; true distance in m and side of
    # the array in px
    times_s: Floats
    distance_m: Floats
    side_px: Floats
    # (n,) number of the packet the pair belongs to
    packet: NDArray[np.int64]
    # By tracker (n, 3): x and y, found minus true, in px, and pitch found over true, less 1 (NaN: not given)
    errors: Mapping[str, Floats]
    # Moments for the pictures: time, and the sum cut out at the first pose and at the tracked one
    cuts: list[tuple[float, tuple[Floats, Floats]]] = field(default_factory=list)


def run_trackers(job: TrackingFilm) -> TrackingRun:
    """Run all trackers on a film."""
    recordings = Recordings(
        footage=load_footage(job.clip) if job.clip else None, imu=load_imu(job.imu) if job.imu else None
    )
    group = _TrackerGroup(job.settings, [name for name in TRACKERS if name != KNOWN])
    frames = simulate(job.settings, default_messages(job.settings), job.seed, recordings)
    moments = _moments(job.settings)
    for pair in _pairs(frames):
        group.push(pair)
        if moments and group.found and pair[0].index >= moments[0]:
            moments.pop(0)
            group.cut(pair)
    if group.found is None:
        raise HeliographError(f"the array was not found in the film '{job.name}'")
    known = _TrackerGroup(job.settings, [KNOWN], group.found)
    for pair in _pairs(_known_film(job, recordings)):
        known.push(pair)
    return _result(job, group, known)


def _moments(settings: LinkSettings) -> list[int]:
    channel = settings.channel
    length = channel.duration_s or (channel.distance_m - channel.stop_m) / channel.speed_m_s
    return [int(k) for k in np.linspace(0.02, 0.97, 8) * length * channel.camera.fps]


def _known_film(job: TrackingFilm, recordings: Recordings) -> Iterator[tuple[Frame, Any]]:
    """The same drive, scene and noise with the light of the known pattern."""
    settings, signal = job.settings, job.settings.signal
    # pixels rendered around the array for the known pattern: its window needs no more while it is not lost, and they
    # are the pixels of whole frames
    return film(
        settings.channel,
        [known_light(settings, settings.transmit.identities[0], job.seed)],
        np.random.default_rng(job.seed),
        pattern_period_s=signal.pattern_period_s,
        slot_order=signal.slot_order,
        footage=recordings.footage,
        imu=recordings.imu,
        roi_margin_px=24,
    )


def _pairs(frames: Iterator[tuple[Frame, Any]]) -> Iterator[Pair]:
    """Frames 0 and 1, 2 and 3, ...: each pattern with the one after it."""
    for (first, true), (second, later) in zip(frames, frames, strict=False):
        yield first, second, true.arrays[0], later.arrays[0]


class _TrackerGroup:
    """Trackers that get one film: the detector first, then all of them from the end of the header on."""

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
        self.first: Pose | None = None
        self.poses: dict[str, Pose] = {}

    def push(self, pair: Pair) -> None:
        """Take a pair; those held back until the array is found are followed then."""
        # pairs kept until the array is found: more than its header and what the detector waits for
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
            # all begin at the last pair of the header
            self._started = not in_header(self._settings, since + 2 * self._settings.signal.pattern_period_s)
            if self._started:
                self._begin(found, pattern, inverted)
            return
        self.rows.append((pattern.time_s, _mean(true, later, "distance_m"), _mean(true, later, "pitch_px")))
        for name, follower in self._followers.items():
            pose = follower.update(pattern, inverted)
            self.poses[name] = pose
            self.errors[name].append(_error(pose, true, later, follower.sized))

    def _begin(self, found: Detection, pattern: Frame, inverted: Frame) -> None:
        self.first = found.fit.pose
        for follower in self._followers.values():
            follower.start(found, pattern, inverted)

    def cut(self, pair: Pair) -> None:
        """Keep the sum at the first pose and at that of the inverted signals, twice the array's side across."""
        if self.first is None or "inverted signals" not in self.poses:
            return
        fixed, tracked = (
            _cut(pair, pose, self._settings.signal.side) for pose in (self.first, self.poses["inverted signals"])
        )
        self.cuts.append((pair[0].time_s, (fixed, tracked)))


def _mean(true: ArrayTruth, later: ArrayTruth, name: str) -> float:
    return 0.5 * (getattr(true, name) + getattr(later, name))


def _error(pose: Pose, true: ArrayTruth, later: ArrayTruth, sized: bool) -> tuple[float, float, float]:
    x, y, pitch = (_mean(true, later, name) for name in ("x", "y", "pitch_px"))
    return pose.x - x, pose.y - y, pose.pitch / pitch - 1 if sized else np.nan


def _cut(pair: Pair, pose: Pose, side: int) -> Floats:
    half = round(side * pose.pitch)
    place = (round(pose.x) - half, round(pose.y) - half, 2 * half + 1, 2 * half + 1)
    return cut_out(pair[0], place) + cut_out(pair[1], place)


def _result(job: TrackingFilm, group: _TrackerGroup, known: _TrackerGroup) -> TrackingRun:
    times, distance, pitch = np.array(group.rows).T
    errors = {name: np.array((group.errors | known.errors)[name]) for name in TRACKERS}
    packet = np.floor(times / job.settings.signal.packet_s + 1e-6).astype(np.int64)
    return TrackingRun(job.name, times, distance, job.settings.signal.side * pitch, packet, errors, group.cuts)
