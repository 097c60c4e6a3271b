"""Arrays that are read: which, where, how well; their clock against the camera's, and their noise."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.film import is_packet
from heliograph.measure.reception import ArrayTally
from heliograph.probe.clock import Clock, clock_of
from heliograph.probe.reach import Reach, reaches
from heliograph.probe.reading import Asked, Reading, narrowed, read
from heliograph.probe.regions import Region
from heliograph.receive import Packet
from heliograph.receive.detect.detection import Detection
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise, measure_noise, noise_beside
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE

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
