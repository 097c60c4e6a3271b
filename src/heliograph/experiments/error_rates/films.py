"""Films at rest and drives, received and counted packet by packet."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from heliograph.experiments.links import static_link
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, load_imu, simulate
from heliograph.measure.bench import random_messages, window_margin_px
from heliograph.measure.counts import LayerCounts, Layers, pooled
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.measure.statistics import Clustered, Count
from heliograph.receive import Packet, make_receiver
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS


@dataclass(frozen=True, slots=True)
class PacketRecord:
    """A packet received."""

    # True distance in m at its middle
    distance_m: float
    # Bits, codewords and their errors, by layer
    layers: Layers


@dataclass(frozen=True, slots=True)
class FilmCounts:
    """Counts of a film, packet by packet."""

    # Packets received, each with its own counts
    packets: Sequence[PacketRecord]
    # Codewords of packets of which nothing was received, by the lower edge of the distance bin in m and by layer
    missed: Mapping[float, Mapping[str, int]]
    # Packets filmed whole of which nothing was received, each by the middle of its distance bin in m
    lost: Sequence[float] = ()
    # Codewords accepted as right that were not sent
    false_codewords: int = 0


@dataclass(frozen=True, slots=True)
class FilmTask:
    """A film to be received: at rest at a distance, or a drive."""

    # Distance at rest in m; None: a drive from 80 m to 25 m at 30 km/h
    distance_m: float | None
    # "haar", the hierarchical code, or "ook", on-off keying of each LED
    modulation: Literal["haar", "ook"]
    # Of messages, place, motion and noise
    seed: tuple[int, ...]
    # File of the recorded motion of the drive; None: a road
    imu: Path | None = None


def count_film(task: FilmTask) -> FilmCounts:
    """Film, receive, count."""
    rng = np.random.default_rng(task.seed)
    signal = {"modulation": task.modulation}
    if task.distance_m is not None:
        return film_packets(static_link(task.distance_m, rng, signal=signal), rng)
    if task.imu is None:
        return film_packets(load_settings("paper", {"signal": signal}), rng)
    trace = load_imu(task.imu)
    shake = {"shake": "imu", "imu_start_s": float(rng.uniform(0, trace.t_s[-1]))}
    return film_packets(load_settings("paper", {"signal": signal, "channel": shake}), rng, Recordings(imu=trace))


def film_packets(settings: LinkSettings, rng: np.random.Generator, recordings: Recordings | None = None) -> FilmCounts:
    """Counts of each packet of a film by itself: errors within a packet are not independent."""
    seed = int(rng.integers(2**31))
    messages = random_messages(settings, seed)
    counter, receiver = ErrorCounter(settings, messages), make_receiver(settings.signal, settings.receive)
    times: list[float] = []
    distances: list[float] = []
    records: list[PacketRecord] = []
    for frame, truth in simulate(settings, messages, seed, recordings, window_margin_px(settings)):
        array = truth.arrays[0]
        counter.saw(truth.time_s, [array.distance_m], [array.visible])
        times.append(truth.time_s)
        distances.append(array.distance_m)
        for packet in receiver.push(frame):
            if packet.status not in ("no_header", "no_array"):
                middle = packet.start_time_s + settings.signal.packet_s / 2
                record = _counted(counter, packet, float(np.interp(middle, times, distances)))
                records += [record] if record else []
    missed = {start: {n: e.missed for n, e in layers.items() if e.missed} for start, layers in counter.bins().items()}
    missed = {start: layers for start, layers in missed.items() if layers}
    words = PacketFormat(settings.signal).layers["high"].codewords
    lost = [start + BIN_M / 2 for start, layers in missed.items() for _ in range(layers["high"] // words)]
    return FilmCounts(records, missed, lost, counter.false_codewords)


def _counted(counter: ErrorCounter, packet: Packet, distance_m: float) -> PacketRecord | None:
    """The counts that a packet adds; None if it adds none: cut by the film's end, or received before."""
    before = counter.total()
    counter.received(packet)
    after = counter.total()
    # a packet that was missed so far is not any more
    counts = {name: after[name].received - before[name].received for name in LAYERS}
    own = all(one.codewords > 0 and min(asdict(one).values()) >= 0 for one in counts.values())
    return PacketRecord(distance_m, counts) if own and any(one.raw_bits for one in counts.values()) else None


@dataclass(slots=True)
class CountsByDistance:
    """Counts of several packets, by distance and layer."""

    # Counts by layer, by distance in m
    places: dict[float, Layers] = field(default_factory=dict)

    def add(self, place: float, record: PacketRecord) -> None:
        """Count a packet."""
        self.places[place] = pooled([self.places.get(place, {}), record.layers])

    def miss(self, place: float, layer: str, codewords: int) -> None:
        """Count codewords that were not received."""
        self.places[place] = pooled([self.places.get(place, {}), {layer: LayerCounts.of_missed(codewords)}])


def bin_of(distance_m: float) -> float:
    """Middle in m of the distance bin, which is `BIN_M` wide."""
    return float(distance_m // BIN_M * BIN_M + BIN_M / 2)


def lost_packets(films: Sequence[FilmCounts]) -> Count:
    """Packets filmed whole, and those of them of which nothing was received."""
    return Count(sum(len(one.packets) + len(one.lost) for one in films), sum(len(one.lost) for one in films))


def all_layers(layers: Layers) -> Clustered:
    """Raw errors of all layers, by packet."""
    parts = [counts.raw for counts in layers.values()]
    # squares of packets' sums are not kept: at most this by Minkowski, if layers fail in step
    squares = round(sum(np.sqrt(part.squares) for part in parts) ** 2)
    trials, errors = sum(part.trials for part in parts), sum(part.errors for part in parts)
    return Clustered(trials, errors, max(part.clusters for part in parts), squares, scattered=True)
