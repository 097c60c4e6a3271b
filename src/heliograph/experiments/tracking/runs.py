"""Films of a drive with different backgrounds, and all trackers on them."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
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
TRACKERS: Mapping[str, type[Follower]] = {
    "none": NoTracking,
    OURS: InvertedSignals,
    KNOWN: KnownPattern,
    "background": BackgroundMotion,
    "OpenCV MIL": MultipleInstance,
    "OpenCV template": TemplateMatch,
}
"""Trackers by name."""

Pair = tuple[Frame, Frame, ArrayTruth, ArrayTruth]
"""Two successive frames, and the truth of the array in both."""

Error = tuple[float, float, float]
"""Errors of x and y in px, and relative error of the pitch."""

Cut = tuple[float, tuple[Floats, Floats]]
"""Time, and the sum cut out at the first pose and at the tracked pose."""


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
    # (n,) time in s, and true side of the array in px
    times_s: Floats
    side_px: Floats
    # (n,) number of the packet
    packet: NDArray[np.int64]
    # By tracker (n, 3): error of x and y in px, and relative error of the pitch (NaN: not estimated)
    errors: Mapping[str, Floats]
    # Sums for the pictures
    cuts: list[Cut] = field(default_factory=list)


def run_trackers(job: TrackingFilm) -> TrackingRun:
    """Run all trackers on a film."""
    settings, channel = job.settings, job.settings.channel
    recordings = Recordings(
        footage=load_footage(job.clip) if job.clip else None, imu=load_imu(job.imu) if job.imu else None
    )
    pairs = _pairs(simulate(settings, default_messages(settings), job.seed, recordings))
    # the detector needs fewer pairs after a header
    held = deque[Pair](maxlen=17)
    found = _detect(settings, pairs, held)
    if found is None:
        raise HeliographError(f"the array was not found in the film '{job.name}'")
    length_s = channel.duration_s or (channel.distance_m - channel.stop_m) / channel.speed_m_s
    moments = np.linspace(0.02, 0.97, 8) * length_s * channel.camera.fps
    cut_frames = [max(int(k), held[-1][0].index) for k in moments]
    others = [name for name in TRACKERS if name != KNOWN]
    rows, errors, cuts = _follow(settings, found, chain(held, pairs), others, cut_frames)
    # the same drive, scene and noise with the light of the known pattern, rendered around the array
    known_film = film(
        channel,
        [known_light(settings, settings.transmit.identities[0], job.seed)],
        np.random.default_rng(job.seed),
        pattern_period_s=settings.signal.pattern_period_s,
        slot_order=settings.signal.slot_order,
        footage=recordings.footage,
        imu=recordings.imu,
        roi_margin_px=24,  # more than the window of a tracker on the array
    )
    errors |= _follow(settings, found, _pairs(known_film), [KNOWN])[1]
    times, pitch = np.array(rows).T
    packet = np.floor(times / settings.signal.packet_s + 1e-6).astype(np.int64)
    arrays = {name: np.array(errors[name]) for name in TRACKERS}
    return TrackingRun(job.name, times, settings.signal.side * pitch, packet, arrays, cuts)


def _pairs(frames: Iterator[tuple[Frame, Truth]]) -> Iterator[Pair]:
    """Frames 0 and 1, 2 and 3, ..."""
    for (first, true), (second, later) in zip(frames, frames, strict=False):
        yield first, second, true.arrays[0], later.arrays[0]


def _detect(settings: LinkSettings, pairs: Iterable[Pair], held: deque[Pair]) -> Detection | None:
    """Search pairs for the array, and hold the last pairs."""
    parameters = search_parameters(settings.receive, settings.signal, PLAIN_REGULARITY)
    detector = PyramidSearch(parameters, settings.signal)
    for pair in pairs:
        held.append(pair)
        if hits := [hit for frame in pair[:2] for hit in detector.search(frame)]:
            return hits[0]
    return None


def _follow(
    settings: LinkSettings,
    found: Detection,
    pairs: Iterable[Pair],
    names: Sequence[str],
    cut_frames: Sequence[int] = (),
) -> tuple[list[tuple[float, float]], dict[str, list[Error]], list[Cut]]:
    """Start trackers at the last pair of the detected header, and follow the array.

    Returns time and pitch of each pair, errors by tracker, and the sums of the first pairs from `cut_frames`
    on, cut out twice as wide as the array.
    """
    signal, frames, followers = settings.signal, list(cut_frames), dict[str, Follower]()
    poses, rows, cuts = dict[str, Pose](), list[tuple[float, float]](), list[Cut]()
    errors: dict[str, list[Error]] = {name: [] for name in names}
    for pattern, inverted, true, later in pairs:
        since = pattern.time_s - found.start_time_s
        if followers:
            x, y, pitch = (0.5 * (getattr(true, n) + getattr(later, n)) for n in ("x", "y", "pitch_px"))
            rows.append((pattern.time_s, pitch))
            for name, follower in followers.items():
                pose = poses[name] = follower.update(pattern, inverted)
                relative = pose.pitch / pitch - 1 if follower.sized else np.nan
                errors[name].append((pose.x - x, pose.y - y, relative))
        elif since > -1e-9 and not is_in_header(settings, since + 2 * signal.pattern_period_s):
            followers = {name: TRACKERS[name](settings, found, pattern, inverted) for name in names}
        if frames and pattern.index >= frames[0]:
            frames.pop(0)
            if OURS in poses:
                fixed, tracked = (_sum_at(pattern, inverted, p, signal.side) for p in (found.fit.pose, poses[OURS]))
                cuts.append((pattern.time_s, (fixed, tracked)))
    return rows, errors, cuts


def _sum_at(pattern: Frame, inverted: Frame, pose: Pose, side: int) -> Floats:
    half = round(side * pose.pitch)
    window = (round(pose.x) - half, round(pose.y) - half, 2 * half + 1, 2 * half + 1)
    return cut_out(pattern, window) + cut_out(inverted, window)
