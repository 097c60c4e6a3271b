"""Decoded arrays of a film: identity, position, clock, noise and packets, from a receiver with given settings."""

from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.config import from_mapping, merge
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.budget import Reach, reaches
from heliograph.link.film import is_packet
from heliograph.measure.reception import ArrayTally
from heliograph.probe.regions import Region
from heliograph.receive.api import make_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DecodeEvent, DetectEvent, TrackEvent
from heliograph.receive.observe.cutout import Cutout, Noise, measure_noise
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.receive.track.track import Track
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True, slots=True)
class Clock:
    """Clock of the light relative to the camera."""

    # Delay of patterns after frames in patterns, -0.5 to 0.5; 0 in step
    phase_patterns: float
    # Excess duration of a pattern over the settings in ppm, and standard error; None if unknown
    rate_ppm: float | None = None
    rate_error_ppm: float | None = None

    @property
    def in_step(self) -> bool:
        """True if each frame shows a single pattern, for one frame per pattern."""
        return abs(self.phase_patterns) <= 0.1


def clock_of(packets: Sequence[Packet], frames: Sequence[Frame], signal: SignalSettings) -> Clock:
    """Measure the light's clock by the starts of packets."""
    starts: Floats = np.array([packet.start_time_s for packet in packets])
    period_s = float(np.median(np.diff([frame.time_s for frame in frames])))
    delay = (starts[0] - frames[0].time_s) / period_s
    phase = float((delay - round(delay)) * period_s / signal.pattern_period_s)
    numbers = np.round((starts - starts[0]) / signal.packet_s)
    # the soft receiver's start of a packet has a standard error of 0.005 to 0.02 patterns
    spread = float(np.sqrt(((numbers - numbers.mean()) ** 2).sum()))
    error_ppm = 0.02 * signal.pattern_period_s / (spread * signal.packet_s) * 1e6 if spread else np.inf
    if error_ppm > 200.0:  # quartz clocks differ by less
        return Clock(phase)
    return Clock(phase, (float(np.polyfit(numbers, starts, 1)[0]) / signal.packet_s - 1) * 1e6, error_ppm)


@dataclass(frozen=True, slots=True)
class Setup:
    """Settings for the reception of a film."""

    # Signal of the light
    signal: SignalSettings
    # Settings of the receiver
    settings: ReceiveSettings
    # Frames per second by the time stamps
    rate_hz: float

    @property
    def frames_a_pattern(self) -> float:
        """Duration of a pattern in frames by stamps and settings."""
        return self.signal.pattern_period_s * self.rate_hz

    def changed(self, changes: Mapping[str, Any]) -> "Setup":
        """Change some settings, given as a nested mapping with "signal" and "receive"."""
        receive = merge(asdict(self.settings), changes.get("receive", {}))
        # settings of other receivers have no effect, and are an error
        name = receive["receiver"]
        for section in {"plain", "soft", "custom"} - {name if name in ("plain", "soft") else "custom"}:
            receive.pop(section, None)
        if name == "plain":
            receive["calibration"].pop("exposure_s", None)
        signal = merge(asdict(self.signal), changes.get("signal", {}))
        return Setup(from_mapping(SignalSettings, signal), from_mapping(ReceiveSettings, receive), self.rate_hz)


@dataclass
class Trial:
    """Output of a receiver for some frames."""

    # Signal of the settings
    signal: SignalSettings
    # Detected arrays
    detections: list[Detection] = field(default_factory=list)
    # Packets with a decoded codeword
    packets: list[Packet] = field(default_factory=list)
    # Pairs of patterns as the soft receiver decoded them
    cutouts: list[Cutout] = field(default_factory=list)
    # Tracks of each pair, by identity
    tracks: dict[int, list[Track]] = field(default_factory=lambda: defaultdict(list))
    # Bounds of the exposure in T_b from the light, by identity
    exposures: dict[int, tuple[float, float]] = field(default_factory=dict)

    def observe(self, event: object) -> None:
        """Collect the values of an event."""
        if isinstance(event, DetectEvent):
            self.detections.append(event.detection)
        elif isinstance(event, TrackEvent):
            self.tracks[event.identity].append(event.tracked.track)
        elif isinstance(event, DecodeEvent):
            cutouts = [cutout for cutout in event.cutouts if cutout is not None]
            if tracks := self.tracks[event.identity]:
                cutouts = [cutout.motion_compensated(tracks[-1].gain, tracks[-1].led_gains) for cutout in cutouts]
            self.cutouts += cutouts
            if event.exposure_range is not None:
                self.exposures[event.identity] = event.exposure_range


def run_receiver(frames: Sequence[Frame], setup: Setup) -> Trial:
    """Run a receiver on some frames; an error ends the run."""
    trial, watch = Trial(setup.signal), list[Packet]()
    try:
        receiver = make_receiver(setup.signal, setup.settings, trial.observe)
        for frame in frames:
            watch += receiver.push(frame)
        watch += receiver.finish()
    except HeliographError:
        pass
    trial.packets = [packet for packet in watch if is_packet(packet) and packet.has_codeword]
    return trial


SLACK = 0.85  # factor for thresholds below the measured size or contrast


def search_near(size_px: float) -> dict[str, Any]:
    """Return settings of a search near a known size: faster, and with fewer false arrays."""
    smallest = max(SLACK * size_px, 3.0)
    return {"min_side_px": smallest, "max_side_px": max(size_px / SLACK, 2 * smallest, 6.0), "candidates": 2}


@dataclass(frozen=True, slots=True)
class ArrayReport:
    """Decoded array.

    Attributes
    ----------
    packet
        Latest packet with a decoded codeword: identity, orientation and pose.
    tally
        Number of packets and codewords, frames and distances.
    contrast
        Light of the array with all LEDs on, over full scale.
    score
        Correlation with the header's image.
    clock
        Clock of the light relative to the camera; None if unknown.
    noise
        Variances of the difference of two frames in squared gray levels; None if unknown, as for near arrays.
    clipped
        True if some pixels of the array are at full scale: `noise` then is the noise outside the array.
    reach
        Estimated reach of each layer, by receiver; empty if the noise is unknown.
    exposure
        Bounds of the camera's exposure from the light, as fractions of the frame period; None if all frames show the
        same part of a pattern.
    """

    packet: Packet
    tally: ArrayTally
    contrast: float
    score: float
    clock: Clock | None = None
    noise: Noise | None = None
    clipped: bool = False
    reach: Reach = field(default_factory=dict)
    exposure: tuple[float, float] | None = None


class ArrayWatch:
    """Receiver, and statistics of its packets by array in bounded memory."""

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings | None):
        # Receiver error; empty for no error
        self.error = ""
        # identity, first and last frame, position (x, y) on the sensor in px: half an hour of the reference link
        self.places: deque[tuple[int, int, int, float, float]] = deque(maxlen=20_000)
        self._receiver = make_receiver(signal, settings, self._observe) if settings is not None else None
        self._tallies: dict[int, ArrayTally] = {}
        self._packets: dict[int, Packet] = {}
        self._detections: dict[int, Detection] = {}

    def push(self, frame: Frame) -> None:
        """Pass the next frame to the receiver."""
        if self._receiver is not None:
            self._collect(self._receiver.push(frame))

    def finish(self) -> None:
        """Collect the remaining packets."""
        if self._receiver is not None:
            self._collect(self._receiver.finish())

    def add(self, packet: Packet) -> None:
        """Add a packet."""
        if not is_packet(packet):
            return
        self._tallies.setdefault(packet.identity, ArrayTally(packet.first_frame, packet.distance_m)).add(packet)
        if packet.has_codeword:
            self._packets[packet.identity] = packet
            self.places.append((packet.identity, packet.first_frame, packet.last_frame, packet.pose.x, packet.pose.y))

    def reports(self, full_scale: int) -> dict[int, ArrayReport]:
        """Report the arrays with decoded codewords, by identity."""
        reports = {}
        for identity, packet in sorted(self._packets.items()):
            header = self._detections.get(identity)
            contrast, score = (header.fit.gain / full_scale, header.score) if header else (0.0, 0.0)
            reports[identity] = ArrayReport(packet, self._tallies[identity], contrast, score)
        return reports

    def identity_at(self, region: Region, frames: Sequence[Frame]) -> int | None:
        """Return the identity of the decoded array in a region; None if no decoded array matches."""
        begin, end = frames[0].index, frames[-1].index
        for identity, first, last, x, y in self.places:
            if begin <= last and first <= end:
                late = (0.5 * (first + last) - begin) / max(end - begin, 1) * (len(frames) - 1)
                centre = region.centre_at(late, len(frames))
                if max(abs(x - centre[0]), abs(y - centre[1])) < 0.5 * max(region.width, region.height):
                    return identity
        return None

    def _collect(self, packets: Iterator[Packet]) -> None:
        try:
            for packet in packets:
                self.add(packet)
        except HeliographError as error:
            self._receiver, self.error = None, str(error)

    def _observe(self, event: object) -> None:
        if isinstance(event, DetectEvent):
            for hypothesis in event.detection.hypotheses:
                best = self._detections.setdefault(hypothesis.identity, event.detection)
                self._detections[hypothesis.identity] = max(best, event.detection, key=lambda found: found.score)


def measure_array(array: ArrayReport, frames: Sequence[Frame], setup: Setup) -> ArrayReport:
    """Measure clock, exposure, noise and reach of an array in some frames."""
    signal, full_scale, identity = setup.signal, frames[0].full_scale, array.packet.identity
    if signal.modulation != "haar" or signal.header != "m_sequence":
        return array
    near = search_near(array.packet.pose.pitch * signal.side)
    trial = run_receiver(frames, setup.changed({"receive": {"receiver": "soft", "detect": near}}))
    packets = [packet for packet in trial.packets if packet.identity == identity]
    if not packets:
        return array
    clock, gain, pose = clock_of(packets, frames, signal), array.contrast * full_scale, packets[-1].pose
    if not clock.in_step and trial.tracks[identity]:  # the header shows less of the light
        gain = float(np.median([track.gain for track in trial.tracks[identity]]))
    array = replace(array, contrast=gain / full_scale, clock=clock)
    duration, exposure = setup.frames_a_pattern, trial.exposures.get(identity)
    # for an integer duration all frames show the same parts
    if exposure is not None and abs(duration - round(duration)) >= STEP_TOLERANCE:
        array = replace(array, exposure=(exposure[0] * duration, exposure[1] * duration))
    # reduced frames show less noise
    cutouts = [cut for cut in trial.cutouts if len(cut.poses) == 2 and cut.middle.pitch > 0.75 * pose.pitch]
    if not cutouts or gain <= 0:
        return array
    noise, clipped = measure_noise(cutouts, gain, signal.side), any(_clips(cutout, full_scale) for cutout in cutouts)
    if clipped:  # sums of clipped levels vary by more than the noise
        noise = replace(noise, lit=noise.dark)
    reach = reaches(pose, gain, noise, packets[-1].distance_m, signal, setup.settings.detect.min_side_px)
    return replace(array, noise=noise, clipped=clipped, reach=reach)


def _clips(cutout: Cutout, full_scale: int) -> bool:
    """Return True if a pixel of a pair is at full scale in one of the two frames."""
    return cutout.combination is None and bool((cutout.total + np.abs(cutout.difference) >= 2 * full_scale).any())
