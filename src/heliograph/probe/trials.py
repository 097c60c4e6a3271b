"""Trials of receivers with estimated settings on the frames of a region, also with the corners of a turned array."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor
from typing import Any

import cv2
import numpy as np

from heliograph.base.config import merge
from heliograph.base.frames import Frame
from heliograph.link.budget import REACH_MAX_PITCH_PX, REACH_MAX_SIDE, high_information
from heliograph.probe.arrays import SLACK, Clock, Setup, Trial, clock_of, run_receiver, search_near
from heliograph.probe.headers import HeaderMatch
from heliograph.probe.light import LightRate
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Noise
from heliograph.receive.settings import SMALLEST_SIDE_PX, ReceiveSettings
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings

SURE_HEADER = 0.85  # minimum correlation with a certain header: clutter seldom exceeds 0.8
MIN_TURN_DEG = 5.0  # minimum turn in degrees of arrays that need corners


@dataclass(frozen=True, slots=True)
class Remedy:
    """Settings with which a region is decoded."""

    # Trial with decoded codewords
    trial: Trial
    # Changed settings as a nested mapping with "signal" and "receive"; empty if none were changed
    changes: Mapping[str, Any]
    # True if the time stamps were changed to the duration of a pattern in the settings
    retimed: bool
    # Clock of the light relative to the camera
    clock: Clock


def find_remedy(
    frames: Sequence[Frame], setup: Setup, rate: LightRate | None, header: HeaderMatch, noise: Noise, is_square: bool
) -> Remedy | None:
    """Try settings for the header of a region; other numbers of LEDs only for a complete, square region."""
    if header.score < 0.7 or setup.signal.header != "m_sequence":
        return None
    duration = rate.frames if rate is not None else setup.frames_a_pattern
    form = other_packets(header, setup.signal, duration)
    pose, size = header.fit.pose, header.fit.pose.pitch * setup.signal.side
    sides = list[int]()
    if is_square and header.score >= SURE_HEADER and not is_blurred(pose):
        # the most usual first
        sides = [n for n in (8, 16, 32, 12, 24, 4, 20, 48, 64) if n != setup.signal.side and size / n > 0.3]
    # a frame of each pattern may miss a pair of a header: if the period is right, the form may be right too
    as_long = bool(form) and round(header.period / duration) == setup.signal.packet_patterns
    forms = [*([{}] if as_long else []), form, *({**form, "side": side} for side in sides)]
    settings, (rows, columns) = setup.settings, frames[0].pixels.shape
    places: list[dict[str, Any]] = [{}]
    if settings.detect.corners or settings.detect.region:  # the array may be elsewhere
        places.append({"detect": {"corners": (), "region": (*frames[0].origin, columns, rows)}})
    trials = _Trials(frames, setup, rate)
    packet = _first_packet(frames, header, duration, setup.changed({"signal": form}).signal)

    def candidates() -> Iterator[Mapping[str, Any]]:
        for signal, place, receiver in itertools.product(forms, places, trials.receivers):
            if not _is_hopeless(header, receiver, noise, setup.changed({"signal": signal}).signal):
                receive = _needed(settings, receiver, header, size, frames[0].full_scale)
                yield {"signal": signal, "receive": merge(receive, place)}

    return trials.find(candidates(), packet, {"receive": {"detect": search_near(size)}})


def find_turned_remedy(
    frames: Sequence[Frame], setup: Setup, rate: LightRate, centre: tuple[float, float], form: Mapping[str, Any]
) -> Remedy | None:
    """Try the corners of a region's outline."""
    found = outline(frames, centre)
    if found is None or setup.signal.header != "m_sequence":
        return None
    corners, turn, skew = found
    if abs(turn) < MIN_TURN_DEG and skew < 1.1:
        return None
    trials = _Trials(frames, setup, rate)
    place = {"detect": {"corners": corners, "region": ()}}
    receivers = [{**_other_receiver(setup.settings, receiver), **place} for receiver in trials.receivers]
    return trials.find({"signal": form, "receive": receive} for receive in receivers)


class _Trials:
    """Receivers on the frames of a region, with time stamps corrected to the duration of a pattern."""

    def __init__(self, frames: Sequence[Frame], setup: Setup, rate: LightRate | None):
        self._setup, self._frames = setup, frames
        duration = rate.frames if rate is not None else setup.frames_a_pattern
        # plain needs a frame per pattern
        is_stepped = abs(duration - 1) < STEP_TOLERANCE and setup.settings.receiver != "soft"
        self.receivers = ["plain", "soft"] if is_stepped else ["soft"]
        self._retimed = rate is not None and abs(rate.frames / setup.frames_a_pattern - 1) > STEP_TOLERANCE
        if self._retimed:
            every = max(1, min((b.index - a.index for a, b in itertools.pairwise(frames)), default=1))
            step_s = setup.signal.pattern_period_s / (1.0 if abs(duration - 1) < STEP_TOLERANCE else duration)
            stamped = zip(frames, [(frame.index - frames[0].index) / every for frame in frames], strict=True)
            self._frames = [replace(frame, index=int(number), time_s=number * step_s) for frame, number in stamped]

    def find(
        self, candidates: Iterable[Mapping[str, Any]], part: slice = slice(None), limits: Mapping[str, Any] = {}
    ) -> Remedy | None:
        """Return the first changes of the settings that decode a part of the frames, with a limited search."""
        for changes in candidates:
            frames, setup = self._frames[part], self._setup.changed(merge(changes, limits))
            trial = run_receiver(frames, setup)
            if trial.packets:
                return Remedy(trial, changes, self._retimed, clock_of(trial.packets, frames, setup.signal))
        return None


def is_blurred(pose: Pose) -> bool:
    """Return True if the lens is out of focus; the reference lens blurs by 0.5 px."""
    return pose.blur > 1.2 * max(pose.pitch, 1.0)


def _is_hopeless(header: HeaderMatch, receiver: str, noise: Noise, signal: SignalSettings) -> bool:
    """Return True if size, blur and noise leave too little information even for the high layer."""
    pose = header.fit.pose
    pose = replace(pose, pitch=pose.pitch * header.side / signal.side)
    if signal.side > REACH_MAX_SIDE or signal.modulation != "haar":
        return pose.pitch < 1.0 or (receiver == "soft" and signal.side > REACH_MAX_SIDE)
    while pose.pitch > REACH_MAX_PITCH_PX:
        pose = replace(pose, pitch=pose.pitch / 2, blur=pose.blur / 2)
    # decoding needs 1.3 times the rate, but the model is cautious
    return high_information(receiver, pose, header.fit.gain, noise, signal.side) < 0.8 * signal.rate.high


def other_packets(header: HeaderMatch, signal: SignalSettings, duration: float) -> dict[str, int]:
    """Return the pairs of header and data by the header times if they differ from the settings, or {}."""
    patterns = round(header.period / duration)
    is_same = header.pairs == signal.header_pairs and patterns in (0, signal.packet_patterns)
    if is_same or not 1 <= header.pairs <= 16 or patterns % 2 or patterns <= 2 * header.pairs:
        return {}
    return {"header_pairs": header.pairs, "data_pairs": patterns // 2 - header.pairs}


def _first_packet(frames: Sequence[Frame], header: HeaderMatch, duration: float, signal: SignalSettings) -> slice:
    """Return the frames of the first complete packet and of 8 patterns on both sides; all if no start is known."""
    margin, length = round(8 * duration), round(signal.packet_patterns * duration)
    firsts = (round(start * duration) for start in header.starts)
    parts = (slice(max(k - margin, 0), k + length + margin) for k in firsts if k + length <= len(frames))
    return next(parts, slice(None))


def _other_receiver(settings: ReceiveSettings, receiver: str) -> dict[str, Any]:
    return {} if settings.receiver == receiver else {"receiver": receiver}


def _needed(
    settings: ReceiveSettings, receiver: str, header: HeaderMatch, size_px: float, full_scale: int
) -> dict[str, Any]:
    """Return settings for the size, contrast and blur of a header, as a nested mapping."""
    detect: dict[str, float] = {}
    if size_px < (settings.detect.min_side_px or SMALLEST_SIDE_PX[receiver]):
        detect["min_side_px"] = max(floor(2 * SLACK * size_px) / 2, 3.0)
    if size_px > settings.detect.max_side_px:
        detect["max_side_px"] = float(min(ceil(size_px / SLACK / 16) * 16, 4096))
    if header.fit.gain < settings.detect.min_contrast * full_scale:
        detect["min_contrast"] = float(f"{SLACK * header.fit.gain / full_scale:.1g}")
    # a fit reaches twice the initial blur; half a pitch of blur does not affect a header's cells of four LEDs
    pose = header.fit.pose
    is_wide = pose.blur > max(2.5 * settings.calibration.blur_px, 0.5 * pose.pitch)
    calibration = {"calibration": {"blur_px": min(round(pose.blur, 1), 5.0)}} if is_wide else {}
    return {**_other_receiver(settings, receiver), **({"detect": detect} if detect else {}), **calibration}


def options(changes: Mapping[str, Any], name: str = "") -> tuple[str, ...]:
    """Return the command's options for changed settings, the receiver first."""
    out: list[str] = []
    for key, value in changes.items():
        if isinstance(value, Mapping):
            out += options(value, f"{name}{key}.")
        elif key == "receiver":
            out.append(f"--receiver {value}")
        elif not isinstance(value, tuple):
            out.append(f"--set {name}{key}={value:g}")
        elif value:  # an empty place has no option
            out.append(f"--{key} {','.join(f'{n:g}' for n in value)}")
    return tuple(sorted(out, key=lambda option: not option.startswith("--receiver ")))


def outline(
    frames: Sequence[Frame], centre: tuple[float, float]
) -> tuple[tuple[float, ...], float, float] | None:  # fmt: skip
    """Find the rectangle of changing pixels near a point: eight coordinates, turn in degrees and ratio of sides."""
    # 64 pairs of frames: the mean change of an LED has an error of a tenth
    step = max(1, (len(frames) - 1) // 64)
    pairs = [(frames[k].pixels, frames[k + 1].pixels) for k in range(0, len(frames) - 1, step)]
    power = np.mean([(b.astype(np.float32) - a) ** 2 for a, b in pairs], axis=0)
    change = cv2.blur(np.sqrt(power).astype(np.float32), (3, 3))
    bright = float(np.quantile(change, 0.98))
    dark = float(np.median([change[0].mean(), change[-1].mean(), change[:, 0].mean(), change[:, -1].mean()]))
    # blur halves the change at the edge of an array; gaps of 5 px between LEDs are closed
    lit = (change > dark + 0.5 * (bright - dark)).astype(np.uint8)
    lit = cv2.morphologyEx(lit, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    contours, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    x, y = frames[0].origin
    contour = max(contours, key=lambda shape: cv2.pointPolygonTest(shape, (centre[0] - x, centre[1] - y), True))
    middle, sides, turn = cv2.minAreaRect(contour)
    # a contour passes through the centres of pixels
    wide, high = sides[0] + 1.0, sides[1] + 1.0
    points = np.add(cv2.boxPoints((middle, (wide, high), turn)), (x, y))
    corners = tuple(round(float(n), 1) for n in points.reshape(-1))
    return corners, (turn + 45) % 90 - 45, max(wide, high) / min(wide, high)
