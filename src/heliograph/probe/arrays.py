"""Decoded arrays of a film: identity, position, clock, noise and packets, from a receiver with given settings."""

from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
    """Clock of the light relative to the camera."""

    # Delay of patterns after frames in patterns, -0.5 to 0.5; 0 in step
    phase: float
    # Excess duration of a pattern over the settings in ppm, and standard error; None if unknown
    rate_ppm: float | None
    rate_error_ppm: float | None

    @property
    def in_step(self) -> bool:
        """True if each frame shows a single pattern, for one frame per pattern."""
        return abs(self.phase) <= 0.1


def clock_of(packets: Sequence[Packet], frames: Sequence[Frame], signal: SignalSettings) -> Clock:
    """Measure the light's clock by the starts of packets."""
    starts: Floats = np.array([packet.start_time_s for packet in packets])
    period_s = float(np.median(np.diff([frame.time_s for frame in frames])))
    delay = (starts[0] - frames[0].time_s) / period_s
    phase = float((delay - round(delay)) * period_s / signal.pattern_period_s)
    numbers = np.round((starts - starts[0]) / signal.packet_s)
    if len(starts) < 2 or numbers[-1] < 1:
        return Clock(phase, None, None)
    # the soft receiver's start of a packet has a standard error of 0.005 to 0.02 patterns
    spread = float(np.sqrt(((numbers - numbers.mean()) ** 2).sum()))
    error_ppm = 0.02 * signal.pattern_period_s / (spread * signal.packet_s) * 1e6
    if error_ppm > 200.0:  # quartz clocks differ by less
        return Clock(phase, None, None)
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
        receive = merge(to_mapping(self.settings), changes.get("receive", {}))
        # settings of other receivers have no effect, and are an error
        name = receive["receiver"]
        for section in {"plain", "soft", "custom"} - {name if name in ("plain", "soft") else "custom"}:
            receive.pop(section, None)
        if name == "plain":
            receive["calibration"].pop("exposure_s", None)
        signal = merge(to_mapping(self.signal), changes.get("signal", {}))
        return Setup(from_mapping(SignalSettings, signal), from_mapping(ReceiveSettings, receive), self.rate_hz)


@dataclass(frozen=True)
class Trial:
    """Output of a receiver for some frames."""

    # Signal of the settings
    signal: SignalSettings
    # Detected arrays
    detections: tuple[Detection, ...]
    # Packets
    packets: tuple[Packet, ...]
    # Pairs of patterns as the soft receiver decoded them
    cutouts: tuple[Cutout, ...]
    # Gray levels of the array with all LEDs on for each pair, by identity
    gains: Mapping[int, Sequence[float]]
    # Bounds of the exposure in T_b from the light, by identity
    exposures: Mapping[int, tuple[float, float]]

    @property
    def decoded(self) -> list[Packet]:
        """Packets with a decoded codeword."""
        return [packet for packet in self.packets if packet.has_codeword]


def run_receiver(frames: Sequence[Frame], setup: Setup) -> Trial:
    """Run a receiver on some frames; an error ends the run."""
    detections, packets, cutouts = list[Detection](), list[Packet](), list[Cutout]()
    gains: dict[int, list[float]] = defaultdict(list)
    exposures, tracks = dict[int, tuple[float, float]](), dict[int, Track]()

    def observe(event: Any) -> None:
        if isinstance(event, DetectEvent):
            detections.append(event.detection)
        if isinstance(event, DecodeEvent):
            track = tracks.get(event.identity)
            seen = [cutout for cutout in event.cutouts if cutout is not None]
            cutouts.extend(cut.motion_compensated(track.gain, track.led_gains) if track else cut for cut in seen)
            if event.exposure_range is not None:
                exposures[event.identity] = event.exposure_range
        if isinstance(event, TrackEvent):
            tracks[event.identity] = event.tracked.track
            gains[event.identity].append(event.tracked.track.gain)

    try:
        receiver = make_receiver(setup.signal, setup.settings, observe)
        for frame in frames:
            packets += receiver.push(frame)
        packets += receiver.finish()
    except HeliographError:
        pass
    return Trial(
        setup.signal, tuple(detections), tuple(filter(is_packet, packets)), tuple(cutouts), gains, exposures
    )  # fmt: skip


SLACK = 0.85
"""Factor for thresholds below the measured size or contrast."""


def search_near(size_px: float) -> dict[str, Any]:
    """Return settings of a search near a known size: faster, and with fewer false arrays."""
    smallest = max(SLACK * size_px, 3.0)
    return {"min_side_px": smallest, "max_side_px": max(size_px / SLACK, 2 * smallest, 6.0), "candidates": 2}


@dataclass(frozen=True, slots=True)
class ArrayReport:
    """Decoded array.

    Attributes
    ----------
    identity
        Identity, 0 to 29.
    orientation
        Orientation in the image: "upright", "mirrored", "turned 90" and so on.
    packets
        Number of packets, decoded or not.
    first_frame, last_frame
        First frame of the first packet, and last frame of the last packet.
    first_distance_m, last_distance_m
        Distance in m at the first and at the last packet, by the optics in the settings.
    x, y
        Centre on the sensor in px at the last packet.
    pitch_px
        Pitch of the LEDs in px at the last packet.
    blur_px
        Standard deviation of an LED's blur in px at the last packet.
    contrast
        Light of the array with all LEDs on, over full scale.
    score
        Correlation with the header's image.
    ok, failed
        Number of decoded and of failed codewords, by layer.
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


MOST_PLACES = 20_000
"""Number of stored packet positions: half an hour of the reference link."""


class ArrayWatch:
    """Statistics of a receiver's packets by array, in bounded memory."""

    def __init__(self) -> None:
        self._tallies: dict[int, ArrayTally] = {}
        self._last: dict[int, Packet] = {}
        self._headers: dict[int, Detection] = {}
        # identity, first and last frame, position (x, y) on the sensor in px
        self._places: deque[tuple[int, int, int, float, float]] = deque(maxlen=MOST_PLACES)

    def found(self, detection: Detection) -> None:
        """Add a detection."""
        for hypothesis in detection.hypotheses:
            best = self._headers.setdefault(hypothesis.identity, detection)
            if detection.score > best.score:
                self._headers[hypothesis.identity] = detection

    def add(self, packet: Packet) -> None:
        """Add a packet."""
        if not is_packet(packet):
            return
        tally = self._tallies.setdefault(packet.identity, ArrayTally(packet.first_frame, packet.distance_m))
        tally.add(packet)
        if packet.has_codeword:
            self._last[packet.identity] = packet
            self._places.append((packet.identity, packet.first_frame, packet.last_frame, packet.pose.x, packet.pose.y))

    def arrays(self, full_scale: int) -> list[ArrayReport]:
        """Report the arrays with decoded codewords, by identity."""
        return [self._report(identity, full_scale) for identity in sorted(self._last)]

    def at(self, region: Region, frames: Sequence[Frame]) -> int | None:
        """Return the identity of the decoded array in a region; None if no decoded array matches."""
        begin, end = frames[0].index, frames[-1].index
        radius = 0.5 * max(region.width, region.height)
        for identity, first, last, x, y in self._places:
            if last < begin or first > end:
                continue
            late = (0.5 * (first + last) - begin) / max(end - begin, 1) * (len(frames) - 1)
            centre = region.centre_at(late, len(frames))
            if abs(x - centre[0]) < radius and abs(y - centre[1]) < radius:
                return identity
        return None

    def _report(self, identity: int, full_scale: int) -> ArrayReport:
        tally, last, header = self._tallies[identity], self._last[identity], self._headers.get(identity)
        return ArrayReport(
            identity, str(last.orientation), tally.packets, tally.first_frame, tally.last_frame,
            tally.first_distance_m, tally.last_distance_m, last.pose.x, last.pose.y, last.pose.pitch, last.pose.blur,
            contrast=header.fit.gain / full_scale if header else 0.0, score=header.score if header else 0.0,
            ok={name: layer.ok for name, layer in tally.layers.items()},
            failed={name: layer.failed for name, layer in tally.layers.items()},
        )  # fmt: skip


def measure_array(array: ArrayReport, frames: Sequence[Frame], setup: Setup) -> ArrayReport:
    """Measure clock, exposure, noise and reach of an array in some frames."""
    if setup.signal.modulation != "haar" or setup.signal.header != "m_sequence":
        return array
    signal, full_scale, identity = setup.signal, frames[0].full_scale, array.identity
    near = search_near(array.pitch_px * signal.side)
    trial = run_receiver(frames, setup.changed({"receive": {"receiver": "soft", "detect": near}}))
    packets = [packet for packet in trial.decoded if packet.identity == identity]
    if not packets:
        return array
    clock, gain, pose = clock_of(packets, frames, signal), array.contrast * full_scale, packets[-1].pose
    if not clock.in_step and identity in trial.gains:  # the header shows less of the light
        gain = float(np.median(trial.gains[identity]))
    # reduced frames show less noise
    cutouts = [cut for cut in trial.cutouts if len(cut.poses) == 2 and cut.middle.pitch > 0.75 * pose.pitch]
    cutouts = cutouts if gain > 0 else []
    clipped = any(_clips(cutout, full_scale) for cutout in cutouts)
    noise: Noise | None = None
    if clipped:  # sums of clipped levels vary by more than the noise
        noise = Noise(beside := noise_beside(cutouts, signal.side), beside)
    elif cutouts:
        noise = measure_noise(cutouts, gain, signal.side)
    smallest, reach = setup.settings.detect.min_side_px, tuple[Reach, ...]()
    if noise is not None:
        reach = reaches(pose, gain, noise, packets[-1].distance_m, signal, smallest)
    duration, exposure = setup.frames_a_pattern, trial.exposures.get(identity)
    if exposure is not None:  # for an integer duration all frames show the same parts
        is_whole = abs(duration - round(duration)) < STEP_TOLERANCE
        exposure = None if is_whole else (exposure[0] * duration, exposure[1] * duration)
    return replace(
        array, contrast=gain / full_scale, clock=clock, noise=noise, clipped=clipped, reach=reach, exposure=exposure
    )


def _clips(cutout: Cutout, full_scale: int) -> bool:
    """Return True if a pixel of a pair is at full scale in one of the two frames."""
    return cutout.combination is None and bool((cutout.total + np.abs(cutout.difference) >= 2 * full_scale).any())
