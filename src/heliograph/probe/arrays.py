"""Frames read by a receiver with given settings, and the received arrays: identity, place, clock, noise and packets."""

from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.config import from_mapping, merge, to_mapping
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.film import is_packet
from heliograph.measure.reception import ArrayTally
from heliograph.probe.reach import Reach, reaches
from heliograph.probe.regions import Region
from heliograph.receive import Packet, ReceiveSettings, make_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DecodeEvent, DetectEvent, TrackEvent
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise, measure_noise, noise_beside
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.receive.track.track import Track
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True, slots=True)
class Clock:
    """The light's clock in the camera's."""

    # When patterns begin after frames do, in patterns: -0.5 to 0.5, 0 in step
    phase: float
    # By how many millionths a pattern lasts longer than the settings say; None where it is not told
    rate_ppm: float | None
    # Its standard error; None where it is not told
    rate_error_ppm: float | None

    @property
    def in_step(self) -> bool:
        """Whether frames show one pattern each, if a pattern lasts a frame."""
        # phase in patterns from which on frames show two patterns
        return abs(self.phase) <= 0.1


def clock_of(packets: Sequence[Packet], frames: Sequence[Frame], signal: SignalSettings) -> Clock:
    """The light's clock in the camera's, by the starts of packets."""
    starts: Floats = np.array([one.start_time_s for one in packets])
    steps = np.diff([one.time_s for one in frames])
    period_s = float(np.median(steps))
    after = (starts[0] - frames[0].time_s) / period_s
    phase = (after - round(after)) * period_s / signal.pattern_period_s
    numbers = np.round((starts - starts[0]) / signal.packet_s)
    if len(starts) < 2 or numbers[-1] < 1:
        return Clock(float(phase), None, None)
    spread = float(np.sqrt(((numbers - numbers.mean()) ** 2).sum()))
    # standard deviation in patterns of a packet's start by the soft receiver's clock: 0.005 to 0.02
    error = 0.02 * signal.pattern_period_s / (spread * signal.packet_s) * 1e6
    slope = float(np.polyfit(numbers, starts, 1)[0])
    # standard error of a clock's rate above which it is not told: quartz clocks differ by less
    told = error <= 200.0
    return Clock(float(phase), (slope / signal.packet_s - 1) * 1e6 if told else None, error if told else None)


SLACK = 0.85
"""Factor on what a region shows, to ask for less than that: of contrast and size."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What the film is to be read with."""

    # The light's signal, as the receiver takes it
    signal: SignalSettings
    # Settings of the receiver, which they name
    settings: ReceiveSettings
    # Frames per second as they are stamped
    rate_hz: float

    @property
    def frames_a_pattern(self) -> float:
        """Frames that a pattern lasts, if stamps and settings are right."""
        return self.signal.pattern_period_s * self.rate_hz

    def changed(self, changes: Mapping[str, Any]) -> "Asked":
        """The same with some settings changed."""
        receive = merge(to_mapping(self.settings), changes.get("receive", {}))
        # what is another receiver's has no effect, and may not be set
        name = receive["receiver"]
        for room in {"plain", "soft", "own"} - {name if name in ("plain", "soft") else "own"}:
            receive.pop(room, None)
        if name == "plain":
            receive["calibration"].pop("exposure_s", None)
        signal = merge(to_mapping(self.signal), changes.get("signal", {}))
        return Asked(from_mapping(SignalSettings, signal), from_mapping(ReceiveSettings, receive), self.rate_hz)


@dataclass(frozen=True)
class Reading:
    """What a receiver made of frames."""

    # signal, settings: signal and receiver that were asked for
    signal: SignalSettings
    settings: ReceiveSettings
    # What it took for arrays
    detections: tuple[Detection, ...]
    # What is a packet of what it handed out
    packets: tuple[Packet, ...]
    # Pairs from which the soft receiver decoded
    cutouts: tuple[Cutout, ...] = ()
    # Gray levels of the array with all LEDs on, by identity, as pairs of patterns were followed
    gains: Mapping[int, Sequence[float]] = field(default_factory=dict)
    # Why it ended early; empty where it did not
    error: str = ""
    # Exposures in T_b between which the light puts it, by identity
    exposures: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def read(self) -> bool:
        """Whether a codeword is right."""
        return any(packet.has_codeword for packet in self.packets)


def read(frames: Sequence[Frame], signal: SignalSettings, settings: ReceiveSettings) -> Reading:
    """Let a receiver read frames."""
    detections, packets, cutouts, error = list[Detection](), list[Packet](), list[Cutout](), ""
    gains: dict[int, list[float]] = defaultdict(list)
    exposures, tracks = dict[int, tuple[float, float]](), dict[int, Track]()

    def watch(event: Any) -> None:
        if isinstance(event, DetectEvent):
            detections.append(event.detection)
        if isinstance(event, DecodeEvent):
            track = tracks.get(event.identity)
            kept = [one for one in event.cutouts if one is not None]
            cutouts.extend(one.motion_compensated(track.gain, track.led_gains) if track else one for one in kept)
            if event.exposure_range is not None:
                exposures[event.identity] = event.exposure_range
        if isinstance(event, TrackEvent):
            tracks[event.identity] = event.tracked.track
            gains[event.identity].append(event.tracked.track.gain)

    try:
        receiver = make_receiver(signal, settings, watch)
        for frame in frames:
            packets += receiver.push(frame)
        packets += receiver.finish()
    except HeliographError as problem:
        error = str(problem)
    seen = tuple(filter(is_packet, packets))
    return Reading(signal, settings, tuple(detections), seen, tuple(cutouts), gains, error, exposures)


def narrowed(size_px: float) -> dict[str, Any]:
    """Settings of a search about a size that is known: it takes less time, and takes nothing else for the array."""
    smallest = max(SLACK * size_px, 3.0)
    return {"min_side_px": smallest, "max_side_px": max(size_px / SLACK, 2 * smallest, 6.0), "candidates": 2}


MOST_PLACES = 20_000
"""Most packets whose places are kept, the last ones: those of half an hour of the reference link."""

_Place = tuple[int, int, int, float, float]
"""Of a packet that was read: identity, first and last frame, place (x, y) on the sensor in px."""


@dataclass(frozen=True, slots=True)
class ArraySeen:
    """An array that is read.

    Attributes
    ----------
    identity
        Its number, 0 to 29.
    orientation
        How the camera sees it: "upright", "mirrored", "turned 90" and so on.
    packets
        Its packets, read or not.
    first_frame, last_frame
        Numbers of the frame in which its first packet begins, and of that in which its last one ends.
    first_distance_m, last_distance_m
        Its distance in m at its first and its last packet, by the settings' optics.
    x, y
        Its centre on the sensor in px at its last packet.
    pitch_px
        Pixels from LED to LED there.
    blur_px
        Blur of an LED there, as a standard deviation in px.
    contrast
        Light of the array with all LEDs on, over full scale.
    score
        Correlation of its header with the header's image.
    ok, failed
        Codewords read and not read, by layer.
    clock
        The light's clock in the camera's; None where it is not told.
    noise
        Variances of a difference of two frames in squared gray levels; None where they are not told, as of near arrays.
    clipped
        Whether some of its pixels are at full scale: its noise within is then not told, and that beside it stands for
        both.
    reach
        How far layers are expected to be read, by receiver; none where noise is not told.
    exposure
        Exposures between which the light puts the camera's, as parts of the frame period; None where all frames show
        the same part of a pattern, as in step, which does not tell it.
    """

    identity: int
    orientation: str
    packets: int
    first_frame: int
    last_frame: int
    first_distance_m: float
    last_distance_m: float
    x: float
    y: float
    pitch_px: float
    blur_px: float
    contrast: float
    score: float
    ok: dict[str, int]
    failed: dict[str, int]
    clock: Clock | None = None
    noise: Noise | None = None
    clipped: bool = False
    reach: tuple[Reach, ...] = ()
    exposure: tuple[float, float] | None = None


class ArrayWatch:
    """Keeps what a receiver hands out of a film, array by array, however long the film is."""

    def __init__(self) -> None:
        self._tallies: dict[int, ArrayTally] = {}
        self._last: dict[int, Packet] = {}
        self._headers: dict[int, Detection] = {}
        self._places: deque[_Place] = deque(maxlen=MOST_PLACES)

    def found(self, detection: Detection) -> None:
        """Take what the receiver takes for an array."""
        for one in detection.hypotheses:
            best = self._headers.get(one.identity)
            if best is None or detection.score > best.score:
                self._headers[one.identity] = detection

    def add(self, packet: Packet) -> None:
        """Take a packet."""
        if not is_packet(packet):
            return
        new = ArrayTally(packet.first_frame, packet.distance_m)
        self._tallies.setdefault(packet.identity, new).add(packet)
        if packet.has_codeword:
            self._last[packet.identity] = packet
            self._places.append((packet.identity, packet.first_frame, packet.last_frame, packet.pose.x, packet.pose.y))

    def arrays(self, full_scale: int) -> list[ArraySeen]:
        """Arrays of which codewords were right, by their identity."""
        return [self._array(identity, full_scale) for identity in sorted(self._last)]

    def at(self, region: Region, frames: Sequence[Frame]) -> int | None:
        """Identity of the array that a region is; None where it is none that was read."""
        begin, end = frames[0].index, frames[-1].index
        reach = 0.5 * max(region.width, region.height)
        for identity, first, last, x, y in self._places:
            if last < begin or first > end:
                continue
            late = (0.5 * (first + last) - begin) / max(end - begin, 1) * (len(frames) - 1)
            there = region.centre_at(late, len(frames))
            if abs(x - there[0]) < reach and abs(y - there[1]) < reach:
                return identity
        return None

    def _array(self, identity: int, full_scale: int) -> ArraySeen:
        tally, last, header = self._tallies[identity], self._last[identity], self._headers.get(identity)
        return ArraySeen(
            identity=identity,
            orientation=str(last.orientation),
            packets=tally.packets,
            first_frame=tally.first_frame,
            last_frame=tally.last_frame,
            first_distance_m=tally.first_distance_m,
            last_distance_m=tally.last_distance_m,
            x=last.pose.x,
            y=last.pose.y,
            pitch_px=last.pose.pitch,
            blur_px=last.pose.blur,
            contrast=header.fit.gain / full_scale if header else 0.0,
            score=header.score if header else 0.0,
            ok={name: layer.ok for name, layer in tally.layers.items()},
            failed={name: layer.failed for name, layer in tally.layers.items()},
        )


def looked_into(array: ArraySeen, frames: Sequence[Frame], asked: Asked) -> ArraySeen:
    """An array with its clock, its noise and what follows, by some frames in which it is read."""
    if asked.signal.modulation != "haar" or asked.signal.header != "m_sequence":
        return array
    size = array.pitch_px * asked.signal.side
    changes: dict[str, Any] = {"receiver": "soft", "detect": narrowed(size)}
    soft = asked.changed({"receive": changes})
    reading = read(frames, soft.signal, soft.settings)
    own = [one for one in reading.packets if one.identity == array.identity and one.has_codeword]
    if not own:
        return array
    clock, gain = clock_of(own, frames, soft.signal), array.contrast * frames[0].full_scale
    if not clock.in_step and array.identity in reading.gains:
        # its header shows less of its light
        gain = float(np.median(reading.gains[array.identity]))
    cutouts, side = _cutouts(reading, own[-1]) if gain > 0 else [], soft.signal.side
    clipped = any(_clips(cutout, frames[0].full_scale) for cutout in cutouts)
    noise = None
    if clipped:
        # sums of levels that are cut off are uneven, by more than any noise
        noise = Noise(beside := noise_beside(cutouts, side), beside)
    elif cutouts:
        noise = measure_noise(cutouts, gain, side)
    seen = replace(
        array, contrast=gain / frames[0].full_scale, clock=clock, noise=noise, clipped=clipped,
        exposure=_exposure(reading, array, asked),
    )  # fmt: skip
    if noise is None:
        return seen
    reach = reaches(
        own[-1].pose, gain, noise, own[-1].distance_m, soft.signal,
        asked.settings.detect.min_side_px,
    )  # fmt: skip
    return replace(seen, reach=reach)


def _exposure(reading: Reading, array: ArraySeen, asked: Asked) -> tuple[float, float] | None:
    """Exposure in frame periods; None where frames begin at the same places of patterns over and over."""
    count = asked.frames_a_pattern
    if array.identity not in reading.exposures or abs(count - round(count)) < STEP_TOLERANCE:
        return None
    low, high = reading.exposures[array.identity]
    return low * count, high * count


def _cutouts(reading: Reading, packet: Packet) -> list[Cutout]:
    """Pairs of an array that show its noise: in reduced frames other things are left, and of noise a part."""
    return [one for one in reading.cutouts if len(one.poses) == 2 and one.middle.pitch > 0.75 * packet.pose.pitch]


def _clips(cutout: Cutout, full_scale: int) -> bool:
    """Whether a pixel of a pair is at full scale in one of its frames, whichever is brighter."""
    return cutout.combination is None and bool((cutout.total + np.abs(cutout.difference) >= 2 * full_scale).any())
