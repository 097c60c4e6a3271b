"""Some frames read by a receiver, with any settings: what it made of them."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from heliograph.base.config import from_mapping, merge, to_mapping
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.film import is_packet
from heliograph.receive import Packet, ReceiveSettings, make_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DecodeEvent, DetectEvent, TrackEvent
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.track.track import Track
from heliograph.signal.settings import SignalSettings

SLACK = 0.85
"""Factor on what a region shows, to ask for less than that: of contrast and size."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What the film is to be read with.

    Attributes
    ----------
    signal
        The light's signal, as the receiver takes it.
    settings
        Settings of the receiver, which they name.
    rate_hz
        Frames per second as they are stamped.
    """

    signal: SignalSettings
    settings: ReceiveSettings
    rate_hz: float

    @property
    def frames_a_pattern(self) -> float:
        """Frames that a pattern lasts, if stamps and settings are right."""
        return self.signal.pattern_period_s * self.rate_hz

    def changed(self, changes: Mapping[str, Any]) -> "Asked":
        """The same with some settings changed.

        Parameters
        ----------
        changes
            Nested mapping with "signal" and "receive", as of the link's settings.
        """
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
    """What a receiver made of frames.

    Attributes
    ----------
    signal, settings
        Signal and receiver that were asked for.
    detections
        What it took for arrays.
    packets
        What is a packet of what it handed out.
    cutouts
        Pairs from which the soft receiver decoded.
    gains
        Gray levels of the array with all LEDs on, by identity, as pairs of patterns were followed.
    error
        Why it ended early; empty where it did not.
    exposures
        Exposures in T_b between which the light puts it, by identity.
    """

    signal: SignalSettings
    settings: ReceiveSettings
    detections: tuple[Detection, ...]
    packets: tuple[Packet, ...]
    cutouts: tuple[Cutout, ...] = ()
    gains: Mapping[int, Sequence[float]] = field(default_factory=dict)
    error: str = ""
    exposures: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def read(self) -> bool:
        """Whether a codeword is right."""
        return any(packet.has_codeword for packet in self.packets)


def read(frames: Sequence[Frame], signal: SignalSettings, settings: ReceiveSettings) -> Reading:
    """Let a receiver read frames.

    Parameters
    ----------
    frames
        Frames or windows of them, in the order of time.
    signal
        The light's signal, as the receiver is to take it.
    settings
        Settings of the receiver, which they name.
    """
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
    """Settings of a search about a size that is known: it takes less time, and takes nothing else for the array.

    Parameters
    ----------
    size_px
        Side of the array in px.
    """
    smallest = max(SLACK * size_px, 3.0)
    return {"min_side_px": smallest, "max_side_px": max(size_px / SLACK, 2 * smallest, 6.0), "candidates": 2}
