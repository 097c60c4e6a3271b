"""Films at rest and drives, received and counted packet by packet."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from heliograph.experiments.links import receive_link, static_link
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, load_imu
from heliograph.measure.bench import random_messages
from heliograph.measure.counts import LayerCounts, Layers, pooled
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.measure.statistics import Clustered, Count
from heliograph.receive import Packet, make_receiver
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS


@dataclass(frozen=True, slots=True)
class PacketRecord:
    """Received packet."""

    # True distance in m in the middle of the packet
    distance_m: float
    layers: Layers


@dataclass(frozen=True, slots=True)
class FilmCounts:
    """Counts of a film, packet by packet."""

    packets: Sequence[PacketRecord]
    # Counts of missed packets, by the lower edge of the distance bin in m
    missed: Mapping[float, Layers]
    # Middle of the distance bin in m of each missed packet
    lost: Sequence[float] = ()
    # Accepted codewords that were not sent
    false_codewords: int = 0


Modulation = Literal["haar", "ook"]
"""The hierarchical code; on-off keying of each LED."""


@dataclass(frozen=True, slots=True)
class FilmTask:
    """Film at rest, or drive."""

    # Distance at rest in m; None: a drive from 80 m to 25 m at 30 km/h
    distance_m: float | None
    modulation: Modulation
    seed: tuple[int, ...]
    # File of the recorded motion of the drive; None: a road
    imu: Path | None = None


def count_film(task: FilmTask) -> FilmCounts:
    """Simulate, receive and count a film."""
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
    """Count the packets of a film separately, as errors within a packet are dependent."""
    seed = int(rng.integers(2**31))
    messages = random_messages(settings, seed)
    counter, receiver = ErrorCounter(settings, messages), make_receiver(settings.signal, settings.receive)
    times: list[float] = []
    distances: list[float] = []
    records: list[PacketRecord] = []
    for truth, packets in receive_link(settings, messages, seed, receiver, recordings):
        array = truth.arrays[0]
        counter.saw(truth.time_s, [array.distance_m], [array.visible])
        times.append(truth.time_s)
        distances.append(array.distance_m)
        for packet in packets:
            if packet.status not in ("no_header", "no_array"):
                middle = packet.start_time_s + settings.signal.packet_s / 2
                record = _counted(counter, packet, float(np.interp(middle, times, distances)))
                records += [record] if record else []
    missed = {
        start: {name: LayerCounts.of_missed(counts.missed) for name, counts in layers.items()}
        for start, layers in counter.bins().items()
        if any(counts.missed for counts in layers.values())
    }
    words = PacketFormat(settings.signal).layers["high"].codewords
    lost = [start + BIN_M / 2 for start, layers in missed.items() for _ in range(layers["high"].missed // words)]
    return FilmCounts(records, missed, lost, counter.false_codewords)


def _counted(counter: ErrorCounter, packet: Packet, distance_m: float) -> PacketRecord | None:
    """Counts of a packet; None if the packet was cut by the end of the film, or received before."""
    before = counter.total()
    counter.received(packet)
    after = counter.total()
    # a packet counts as missed before the reception
    counts = {name: after[name].received - before[name].received for name in LAYERS}
    complete = all(layer.codewords > 0 and min(asdict(layer).values()) >= 0 for layer in counts.values())
    return PacketRecord(distance_m, counts) if complete and any(c.raw_bits for c in counts.values()) else None


CountsByDistance = dict[float, Layers]
"""Counts of several packets by layer, by distance in m."""


def add_counts(counts: CountsByDistance, distance_m: float, layers: Layers) -> None:
    """Add counts at a distance."""
    counts[distance_m] = pooled([counts.get(distance_m, {}), layers])


def bin_of(distance_m: float) -> float:
    """Middle in m of the distance bin."""
    return float(distance_m // BIN_M * BIN_M + BIN_M / 2)


def lost_packets(films: Sequence[FilmCounts]) -> Count:
    """Filmed and missed packets."""
    lost = sum(len(film.lost) for film in films)
    return Count(sum(len(film.packets) for film in films) + lost, lost)


def all_layers(layers: Layers) -> Clustered:
    """Raw errors of all layers, clustered by packet."""
    parts = [counts.raw for counts in layers.values()]
    # upper bound of the squares of sums over layers, by Minkowski
    squares = round(sum(np.sqrt(part.squares) for part in parts) ** 2)
    trials, errors = sum(part.trials for part in parts), sum(part.errors for part in parts)
    return Clustered(trials, errors, max(part.clusters for part in parts), squares, scattered=True)
