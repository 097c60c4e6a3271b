"""Error counts of received packets by layer and distance."""

import math
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from heliograph.base.arrays import Floats
from heliograph.channel.scene import lens_matrix
from heliograph.channel.settings import CameraSettings
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import transmitters
from heliograph.measure.counts import BUDGET_S, LayerCounts, Layers, no_errors, pooled, ticks
from heliograph.measure.statistics import Count
from heliograph.receive.packet import ERASED, Packet
from heliograph.signal.block import pack
from heliograph.transmit import Messages, Transmitter

BIN_M = 5.0  # Width of a distance bin in m


@dataclass(slots=True)
class _Sent:
    """Packet that an array sent during the film."""

    frames: int = 0
    hidden: int = 0
    # At the frame nearest to the middle of the packet, at a distance of `off_middle` packets
    distance_m: float = 0.0
    off_middle: float = 1.0
    # Centre (x, y) and pitch in px; empty if unknown
    place: Sequence[float] = ()
    # Of the best reception; empty for a missed packet
    counts: Layers = field(default_factory=dict)
    # Correct codewords, and their payload in bits
    right: int = 0
    payload_bits: int = 0
    # End of the exposure that completed the best reception, and the time since the start and the end of the packet
    received_s: float = 0.0
    latency_s: float = 0.0
    delay_s: float = 0.0
    # True if the receiver detected the header
    found: bool = False
    # Relative error of the distance of the best reception, at most 1; NaN for a missed packet
    distance_error: float = math.nan
    # Error of the position of the best reception in px and in sides of the array; NaN if unknown
    position_px: float = math.nan
    position_sides: float = math.nan
    # True if the stated 95 % regions of position and pose in space hold the truth; None without a statement
    covered: tuple[bool, bool] | None = None


class ErrorCounter:
    """Comparison of packets with the truth."""

    def __init__(self, settings: LinkSettings, messages: Sequence[Messages]):
        self._settings = settings
        self._senders = transmitters(settings, messages)
        self._sent: list[dict[int, _Sent]] = [{} for _ in self._senders]
        self.false_packets = 0
        self.uncertain_packets = 0
        self.false_codewords = 0
        self.duplicates = 0
        self.false_detections = 0
        self._visible_s: dict[int, float] = {}
        self._last_s: float | None = None
        self._times_s: list[float] = []
        # time and homographies of the frames of the last packets; decoding takes less than three packets
        frames = math.ceil(5 * settings.signal.packet_s * settings.channel.camera.fps)
        self._recent: deque[tuple[float, NDArray[Any]]] = deque(maxlen=frames)

    def saw(
        self,
        time_s: float,
        distances_m: Sequence[float],
        visible: Sequence[bool],
        places: Sequence[Sequence[float]] = (),
        homographies: NDArray[Any] | None = None,
    ) -> None:
        """Add the truth of a frame, in temporal order."""
        lost, self._last_s = self._lost_before(time_s), time_s
        self._times_s.append(time_s)
        if homographies is not None and len(homographies):
            self._recent.append((time_s, homographies))
        for array, (distance, in_view) in enumerate(zip(distances_m, visible, strict=True)):
            if in_view:
                self._visible_s.setdefault(array, time_s)
            number, fraction = self._packet_at(array, time_s)
            if number < 0:
                continue
            sent = self._sent[array].setdefault(number, _Sent())
            sent.frames += 1
            for missing_s in lost:
                # dropped frames count as well
                before = self._sent[array].get(self._packet_at(array, missing_s)[0])
                if before is not None:
                    before.frames += 1
            sent.hidden += not in_view
            if abs(fraction - 0.5) < sent.off_middle:
                sent.distance_m, sent.off_middle = distance, abs(fraction - 0.5)
                sent.place = places[array] if places else ()

    def found(self, hypotheses: Iterable[tuple[int, float]]) -> None:
        """Add a detection with the identity and start time of each hypothesis; count false detections."""
        found = [place[2] for hypothesis in hypotheses if (place := self._sent_at(*hypothesis)) is not None]
        for sent in found:
            sent.found = True
        self.false_detections += not found

    def received(self, packet: Packet) -> None:
        """Count a received packet."""
        place = self._sent_at(packet.identity, packet.start_time_s)
        if place is None:
            self._count_false(packet)
            return
        array, number, sent = place
        counts, right, payload_bits = self._compare(self._senders[array], number, packet)
        self.duplicates += bool(sent.counts)
        if not sent.counts or right > sent.right:
            sent.counts, sent.right, sent.payload_bits = counts, right, payload_bits
            sent.received_s = self._times_s[-1] + self._settings.channel.camera.exposure_s
            start_s, packet_s = self._settings.channel.arrays[array].start_s, self._packet_s(array)
            sent.latency_s = sent.received_s - start_s - number * packet_s
            sent.delay_s = sent.latency_s - packet_s
            if sent.place:
                x, y, pitch = sent.place
                sent.position_px = math.hypot(packet.pose.x - x, packet.pose.y - y)
                sent.position_sides = sent.position_px / (pitch * self._settings.signal.side)
            sent.distance_error = float(np.minimum(1.0, abs(packet.distance_m / sent.distance_m - 1)))
            sent.covered = self._covered(array, packet)

    def bins(self) -> dict[float, Layers]:
        """Return errors by the lower edge of the distance bin and by layer, near first.

        Complete packets in the film count as missed until received; packets cut by the end of the film are excluded.
        """
        bins: dict[int, list[Layers]] = {}
        for array, number, sent in self._counted():
            formats = self._senders[array].format_of(number).layers.items()
            layers = sent.counts or {name: LayerCounts.of_missed(form.codewords) for name, form in formats}
            bins.setdefault(int(sent.distance_m // BIN_M), []).append(layers)
        return {key * BIN_M: pooled(bins[key]) for key in sorted(bins)}

    def detected(self) -> tuple[int, int]:
        """Return the number of counted packets, and of packets with a detected header or decoded data."""
        found = [bool(sent.counts or sent.found) for _, _, sent in self._counted()]
        return len(found), sum(found)

    def distance_errors(self) -> list[float]:
        """Return the relative distance errors of the received packets; receivers may state no distance."""
        return [sent.distance_error for _, _, sent in self._counted() if not math.isnan(sent.distance_error)]

    def outcomes(self) -> dict[str, Any]:
        """Return the counts of detection, position and time by the names of `BlockCounts`."""
        counted = [sent for _, _, sent in self._counted()]
        arrays = {array for array, _, _ in self._counted()}
        read = [sent for sent in counted if sent.right]
        near = [sent.position_px for sent in counted if sent.position_sides <= 0.5]
        firsts = {array: [s.received_s for s in self._sent[array].values() if s.right] for array in arrays}
        waits_s = [
            min(times) - self._visible_s.get(array, self._times_s[0]) for array, times in firsts.items() if times
        ]
        return {
            "false_codewords": self.false_codewords,
            "false_packets": self.false_packets,
            "uncertain_packets": self.uncertain_packets,
            "false_detections": self.false_detections,
            "duplicates": self.duplicates,
            "timely_bits": sum(sent.payload_bits for sent in read if sent.delay_s <= BUDGET_S),
            "located": len(near),
            "misplaced": sum(sent.position_sides > 0.5 for sent in counted),
            "position_px": math.fsum(near),
            "arrays": len(arrays),
            "acquisition": dict(Counter(map(ticks, waits_s))),
            "latency": dict(Counter(ticks(sent.latency_s) for sent in read)),
        }

    def covered(self) -> list[tuple[bool, bool]]:
        """Return for each located packet if the stated 95 % regions of position and pose hold the truth."""
        return [sent.covered for _, _, sent in self._counted() if sent.covered is not None]

    def report(self) -> list[dict[str, Any]]:
        """Return the bins as plain values for JSON."""
        return [
            {"from_m": start, "to_m": start + BIN_M, **{name: _plain(counts) for name, counts in layers.items()}}
            for start, layers in self.bins().items()
        ]

    def total(self) -> Layers:
        """Return the sum of the bins by layer."""
        return pooled(self.bins().values())

    def _counted(self) -> Iterator[tuple[int, int, _Sent]]:
        """Yield array, packet number and record of the counted packets."""
        for array, packets in enumerate(self._sent):
            for number, sent in packets.items():
                if self._is_complete(array, sent) and (sent.counts or not sent.hidden):
                    yield array, number, sent

    def _sent_at(self, identity: int, start_time_s: float) -> tuple[int, int, _Sent] | None:
        """Return array, number and record of the packet that starts at a camera time, or None."""
        if identity not in self._settings.transmit.identities:
            return None
        array = self._settings.transmit.identities.index(identity)
        number, _ = self._packet_at(array, self._true_time(start_time_s) + 0.5 * self._packet_s(array))
        sent = self._sent[array].get(number)
        return None if sent is None else (array, number, sent)

    def _compare(self, sender: Transmitter, number: int, packet: Packet) -> tuple[Layers, int, int]:
        """Return counts, correct codewords and their payload in bits; count false codewords."""
        layers, right, payload_bits = no_errors(), 0, 0
        for name, words in packet.layers.items():
            code, blocks = sender.format_of(number).layers[name].code, sender.blocks(number)[name]
            if len(words) != len(blocks) or words[0].bits.size != code.k or words[0].raw.size != code.length:
                # wrong packet format
                self.false_codewords += sum(word.status == "ok" for word in words)
                layers[name] = LayerCounts.of_packet(Count(), Count(), Count(len(blocks), len(blocks)))
                continue
            bits, raw, final_raw, sent_words = Count(), Count(), Count(), Count()
            for word, block in zip(words, blocks, strict=True):
                sent = pack(block, code.k)
                wrong = int(np.count_nonzero(word.bits != sent))
                coded = code.encode(sent)
                _compare_raw(raw, word.raw, coded)
                _compare_raw(final_raw, word.final_raw, coded)
                bits.add(code.k, wrong)
                sent_words.add(1, wrong > 0 or word.status != "ok")
                if word.status == "ok" and wrong == 0:
                    right += 1
                    payload_bits += 8 * len(word.block.payload) if word.block else 0
                self.false_codewords += word.status == "ok" and wrong > 0
            layers[name] = LayerCounts.of_packet(bits, raw, sent_words, final_raw)
        return layers, right, payload_bits

    def _covered(self, array: int, packet: Packet) -> tuple[bool, bool] | None:
        """Compare the poses in space with the truth; of several poses, one must be right."""
        times = [time_s for time_s, _ in self._recent]
        poses = packet.spatial_poses if packet.has_codeword and times else ()
        if not poses:
            return None
        # between two frames
        time_s = self._true_time(poses[0].time_s)
        later = min(max(bisect_left(times, time_s), 1), len(times) - 1)
        (before_s, before), (after_s, after) = self._recent[max(later - 1, 0)], self._recent[later]
        part = (time_s - before_s) / (after_s - before_s) if after_s > before_s else 0.0
        plane = before[array] + part * (after[array] - before[array])
        centre, true = pose_in_space(plane, self._settings.channel.camera)
        within = [
            [
                error[:size] @ np.linalg.solve(pose.covariance[:size, :size], error[:size]) < chdtri(size, 0.05)
                for size in (3, 6)
            ]
            for pose in poses
            for turn in [true * Rotation.from_rotvec(pose.rotation_rad).inv()]
            for error in [np.append(centre - pose.translation_m, turn.as_rotvec())]
        ]
        position, both = np.any(within, axis=0).tolist()
        return position, both

    def _count_false(self, packet: Packet) -> None:
        if not packet.has_codeword and packet.identity not in self._settings.transmit.identities:
            self.uncertain_packets += 1
            return
        self.false_packets += 1
        self.false_codewords += sum(word.status == "ok" for words in packet.layers.values() for word in words)

    def _is_complete(self, array: int, sent: _Sent) -> bool:
        """Return True if the film has all patterns of the packet."""
        return sent.frames >= self._packet_s(array) * self._settings.channel.camera.fps - 1

    def _lost_before(self, time_s: float) -> list[float]:
        """Return the times of dropped frames before a time."""
        period = self._settings.channel.camera.frame_period_s
        steps = 1 if self._last_s is None else round((time_s - self._last_s) / period)
        return [time_s - k * period for k in range(1, steps)]

    def _packet_s(self, array: int) -> float:
        return self._settings.signal.packet_s * (1 + self._settings.channel.arrays[array].clock_ppm * 1e-6)

    def _true_time(self, time_s: float) -> float:
        """Return the true time of a camera time."""
        camera = self._settings.channel.camera
        if not camera.gaps:
            # the camera clock counts delivered frames
            tick = round((time_s - camera.start_s) * camera.fps)
            place = min(max(tick, 0), len(self._times_s) - 1)
            return self._times_s[place] + (tick - place) * camera.frame_period_s
        return camera.start_s + (time_s - camera.start_s) * (1 + camera.clock_ppm * 1e-6)

    def _packet_at(self, array: int, time_s: float) -> tuple[int, float]:
        """Return packet number and completed fraction at a time."""
        place = self._settings.channel.arrays[array]
        # 1e-7 s: rounding
        number, fraction = divmod((time_s + 1e-7 - place.start_s) / self._packet_s(array), 1.0)
        return int(number), fraction


def pose_in_space(homography: NDArray[Any], camera: CameraSettings) -> tuple[Floats, Rotation]:
    """Return centre in m and rotation of an array in the axes of the camera."""
    right, down, centre = np.linalg.solve(lens_matrix(camera), homography).T
    return centre, Rotation.from_matrix(np.stack([right, down, np.cross(right, down)], axis=1))


def _compare_raw(count: Count, decided: NDArray[np.uint8], coded: NDArray[np.uint8]) -> None:
    """Count received and wrong coded bits."""
    known = decided != ERASED
    count.add(int(known.sum()), int(np.count_nonzero((decided != coded) & known)))


def _plain(counts: LayerCounts) -> Mapping[str, Any]:
    names = ("bits", "raw_bits", "raw_errors", "codewords", "codeword_errors", "missed")
    return {"errors": counts.bit_errors, **{name: getattr(counts, name) for name in names}}
