"""Receivers tried on the frames of a region with estimated settings, also with the corners of a turned array."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor
from typing import Any

import cv2
import numpy as np

from heliograph.base.config import merge
from heliograph.base.frames import Frame
from heliograph.probe.arrays import SLACK, Asked, Clock, Reading, clock_of, narrowed, read
from heliograph.probe.headers import HeaderSeen
from heliograph.probe.light import LightRate
from heliograph.probe.reach import MOST_SIDE, NEAR_PITCH_PX, layer_information
from heliograph.receive import ReceiveSettings
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.noise import Noise
from heliograph.receive.settings import SMALLEST_SIDE_PX
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings

SIDES = (8, 16, 32, 12, 24, 4, 20, 48, 64)
"""LEDs in a row that are tried where a header is found but no codeword is right, the usual ones first."""

SURE_HEADER = 0.85
"""Correlation with a header from which on a region has one: clutter seldom exceeds 0.8."""

BLURRED, BLURRED_PX = 1.2, 1.2
"""Blur over the pitch, and in px, from which on a lens is out of focus: of the reference lens it is 0.5 px."""


@dataclass(frozen=True, slots=True)
class Found:
    """What reads a region."""

    # The reading in which a codeword is right
    reading: Reading
    # What was changed for it, a nested mapping with "signal" and "receive"; empty where nothing was
    changes: Mapping[str, Any]
    # Whether frames were given the times by which a pattern lasts what the settings say
    retimed: bool
    # The light's clock in the camera's
    clock: Clock


def what_reads(
    frames: Sequence[Frame], asked: Asked, rate: LightRate | None, header: HeaderSeen, noise: Noise, whole: bool
) -> Found | None:
    """Look for settings with which a region is read."""
    # least correlation with a header that is worth a trial
    if header.score < 0.7 or asked.signal.header != "m_sequence":
        return None
    other = rate is not None and abs(rate.frames / asked.frames_a_pattern - 1) > STEP_TOLERANCE
    seen = retimed(frames, rate, asked.signal) if other and rate is not None else frames
    frames_a_pattern = rate.frames if rate is not None else asked.frames_a_pattern
    form = other_packets(header, asked.signal, frames_a_pattern)
    some = one_packet(seen, header, frames_a_pattern, asked.changed({"signal": form}).signal)
    size, full = header.fit.pose.pitch * asked.signal.side, frames[0].full_scale
    pose, sure = header.fit.pose, header.score >= SURE_HEADER
    # least pitch in px of a side that is tried: LEDs nearer to each other are not read, however many there are
    sides = [one for one in SIDES if one != asked.signal.side and size / one > 0.3]
    sides = sides if whole and sure and not is_blurred(pose) else []
    # a frame of each pattern may miss a pair of a header: packets as long as the settings' are first taken for those
    as_long = bool(form) and round(header.period / frames_a_pattern) == asked.signal.packet_patterns
    forms = [{}, form] if as_long else [form]
    kinds = [*forms, *({**form, "side": side} for side in sides)]
    for place, changed in itertools.product(_places(frames, asked.settings), kinds):
        for receiver in receivers_tried(asked.settings, frames_a_pattern):
            changes = {"signal": changed, "receive": needed(asked.settings, receiver, header, size, full)}
            changes = merge(changes, {"receive": {"detect": place}} if place else {})
            tried = asked.changed(merge(changes, {"receive": {"detect": narrowed(size)}}))
            if _hopeless(header, receiver, noise, tried.signal):
                continue
            reading = read(some, tried.signal, tried.settings)
            if reading.read:
                good = [one for one in reading.packets if one.has_codeword]
                return Found(reading, changes, other, clock_of(good, some, tried.signal))
    return None


def is_blurred(pose: Pose) -> bool:
    """Whether a lens is out of focus."""
    return pose.blur > max(BLURRED * pose.pitch, BLURRED_PX)


def _places(frames: Sequence[Frame], asked: ReceiveSettings) -> list[dict[str, Any]]:
    """Where an array is looked for, as settings: where it was asked for; then, if a place was, where the region is."""
    if not (asked.detect.corners or asked.detect.region):
        return [{}]
    rows, columns = frames[0].pixels.shape
    return [{}, {"corners": (), "region": (*frames[0].origin, columns, rows)}]


def retimed(frames: Sequence[Frame], rate: LightRate, signal: SignalSettings) -> list[Frame]:
    """Frames with the times that they have if a pattern lasts what the signal says."""
    every = max(1, min((b.index - a.index for a, b in itertools.pairwise(frames)), default=1))
    in_step = abs(rate.frames - 1) < STEP_TOLERANCE
    step_s = signal.pattern_period_s / (1.0 if in_step else rate.frames)
    first = frames[0].index
    return [
        replace(frame, index=(frame.index - first) // every, time_s=(frame.index - first) / every * step_s)
        for frame in frames
    ]


def _hopeless(header: HeaderSeen, receiver: str, noise: Noise, signal: SignalSettings) -> bool:
    """Whether by size, blur and noise not even the high layer can be read, so that a trial would only take time."""
    pose = header.fit.pose
    pose = replace(pose, pitch=pose.pitch * header.side / signal.side)
    if signal.side > MOST_SIDE or signal.modulation != "haar":
        # the soft receiver's matrices take minutes
        # least pitch in px of an array that is tried without a model of what it holds
        return pose.pitch < 1.0 or (receiver == "soft" and signal.side > MOST_SIDE)
    while pose.pitch > NEAR_PITCH_PX:
        pose = replace(pose, pitch=pose.pitch / 2, blur=pose.blur / 2)
    held = layer_information(receiver, pose, header.fit.gain, noise, signal)
    # least information of the high layer over its rate, as the model of `reach` has it, for a receiver to be tried: 1.3
    # are needed, and the model errs a little on the careful side
    return held["high"] < 0.8 * signal.rate.high


def other_packets(header: HeaderSeen, signal: SignalSettings, frames_a_pattern: float) -> dict[str, int]:
    """Pairs of header and data that headers show, where they are others than the settings'; else nothing."""
    patterns = round(header.period / frames_a_pattern)
    right = header.pairs == signal.header_pairs and patterns in (0, signal.packet_patterns)
    # most pairs of a header that the signal's settings allow
    if right or not 1 <= header.pairs <= 16 or patterns % 2 or patterns <= 2 * header.pairs:
        return {}
    return {"header_pairs": header.pairs, "data_pairs": patterns // 2 - header.pairs}


def one_packet(
    frames: Sequence[Frame], header: HeaderSeen, frames_a_pattern: float, signal: SignalSettings
) -> Sequence[Frame]:
    """Frames of the first packet that is whole, and some about it; all where no header's start is seen."""
    # patterns before and after a packet that are tried with it
    around = round(8 * frames_a_pattern)
    length = round(signal.packet_patterns * frames_a_pattern) + around
    for start in header.starts:
        first = round(start * frames_a_pattern)
        if first + length - around <= len(frames):
            return frames[max(first - around, 0) : first + length]
    return frames


def needed(
    asked: ReceiveSettings, receiver: str, header: HeaderSeen, size_px: float, full_scale: int
) -> dict[str, Any]:
    """Settings of a receiver that a region asks for by its size, contrast and blur, as a nested mapping."""
    out: dict[str, Any] = {} if asked.receiver == receiver else {"receiver": receiver}
    detect = dict[str, float]()
    smallest = asked.detect.min_side_px or SMALLEST_SIDE_PX[receiver]
    if size_px < smallest:
        detect["min_side_px"] = max(floor(2 * SLACK * size_px) / 2, 3.0)
    if size_px > asked.detect.max_side_px:
        detect["max_side_px"] = float(min(ceil(size_px / SLACK / 16) * 16, 4096))
    if header.fit.gain < asked.detect.min_contrast * full_scale:
        detect["min_contrast"] = float(f"{SLACK * header.fit.gain / full_scale:.1g}")
    if detect:
        out["detect"] = detect
    pose = header.fit.pose
    # blur of a header over the first guess of the settings from which on that is to be set: a fit finds twice of it
    # blur over the pitch up to which it hides nothing of a header, whose cells are four LEDs wide or more
    if pose.blur > max(2.5 * asked.calibration.blur_px, 0.5 * pose.pitch):
        out["calibration"] = {"blur_px": min(round(header.fit.pose.blur, 1), 5.0)}
    return out


def receivers_tried(asked: ReceiveSettings, frames_a_pattern: float) -> list[str]:
    """Receivers that are tried: the plain one reads one frame a pattern alone."""
    stepped = abs(frames_a_pattern - 1) < STEP_TOLERANCE and asked.receiver != "soft"
    return ["plain", "soft"] if stepped else ["soft"]


def options(changes: Mapping[str, Any]) -> tuple[str, ...]:
    """Options of the command that make changes, the receiver first."""
    receive = dict(changes.get("receive", {}))
    receiver = receive.pop("receiver", None)
    flat = [*_flat("signal", changes.get("signal", {})), *_flat("receive", receive)]
    given = [f"--receiver {receiver}"] if receiver else []
    return (*given, *filter(None, (_option(key, value) for key, value in flat)))


def _option(key: str, value: Any) -> str:
    """An option that sets a value; nothing for a place that is taken back."""
    if not isinstance(value, tuple):
        return f"--set {key}={value:g}"
    return f"--{key.rpartition('.')[2]} {','.join(f'{n:g}' for n in value)}" if value else ""


def _flat(name: str, tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Dotted keys of a nested mapping, with their values."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{name}.{key}", value)
        else:
            yield f"{name}.{key}", value


CLOSED = 5
"""Pixels across gaps that are closed between LEDs. An array of larger gaps is not found turned."""

LEAST_TURN_DEG, MOST_SKEW = 5.0, 1.1
"""Turn, and ratio of an outline's sides, up to which detectors find an array by themselves: no trial is needed."""

Corners = tuple[float, ...]
"""x and y in px of four corners in turn."""


def outline(frames: Sequence[Frame], centre: tuple[float, float]) -> tuple[Corners, float, float] | None:
    """Find the rectangle that holds what changes about a place."""
    # most pairs of frames of which the change is taken: LEDs then change by a tenth more or less than their mean
    step = max(1, (len(frames) - 1) // 64)
    pairs = [(frames[k].pixels, frames[k + 1].pixels) for k in range(0, len(frames) - 1, step)]
    power = np.mean([(b.astype(np.float32) - a) ** 2 for a, b in pairs], axis=0)
    change = cv2.blur(np.sqrt(power).astype(np.float32), (3, 3))
    bright = float(np.quantile(change, 0.98))
    dark = float(np.median([change[0].mean(), change[-1].mean(), change[:, 0].mean(), change[:, -1].mean()]))
    # change from frame to frame at an array's edge over that within it: blur halves it there
    lit = (change > dark + 0.5 * (bright - dark)).astype(np.uint8)
    lit = cv2.morphologyEx(lit, cv2.MORPH_CLOSE, np.ones((CLOSED, CLOSED), np.uint8))
    shapes, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not shapes:
        return None
    x, y = frames[0].origin
    place = centre[0] - x, centre[1] - y
    shape = max(shapes, key=lambda one: cv2.pointPolygonTest(one, place, True))
    middle, sides, turn = cv2.minAreaRect(shape)
    # a contour runs through the middles of its outermost pixels
    wide, high = sides[0] + 1.0, sides[1] + 1.0
    points = np.add(cv2.boxPoints((middle, (wide, high), turn)), (x, y))
    corners = tuple(round(float(n), 1) for n in points.reshape(-1))
    return corners, (turn + 45) % 90 - 45, max(wide, high) / min(wide, high)


def what_reads_turned(
    frames: Sequence[Frame], asked: Asked, rate: LightRate, centre: tuple[float, float], form: Mapping[str, Any]
) -> Found | None:
    """Read a region by the corners that its light shows."""
    found = outline(frames, centre)
    if found is None or asked.signal.header != "m_sequence":
        return None
    corners, turn, skew = found
    if abs(turn) < LEAST_TURN_DEG and skew < MOST_SKEW:
        return None
    other = abs(rate.frames / asked.frames_a_pattern - 1) > STEP_TOLERANCE
    seen = retimed(frames, rate, asked.signal) if other else frames
    for receiver in receivers_tried(asked.settings, rate.frames):
        changed = {} if receiver == asked.settings.receiver else {"receiver": receiver}
        changes = {"signal": form, "receive": {**changed, "detect": {"corners": corners, "region": ()}}}
        tried = asked.changed(changes)
        reading = read(seen, tried.signal, tried.settings)
        if reading.read:
            good = [one for one in reading.packets if one.has_codeword]
            return Found(reading, changes, other, clock_of(good, seen, tried.signal))
    return None
