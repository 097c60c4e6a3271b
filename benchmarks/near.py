"""Near arrays, and turned ones, read at random places.

`python -m benchmarks.near distances|acquired|turned|drives|speed [COUNT] [SEED]`. Receivers have their
default settings. Identity, place and noise are drawn; films have whole frames.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import block_settings, lasting, random_messages
from heliograph.measure.statistics import clopper_pearson
from heliograph.receive import Packet, make_receiver
from heliograph.receive.events import DetectEvent
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation
from heliograph.signal.settings import LAYERS

PX_M = 58.3 * 16
"""Side in px of 16 LEDs, times their distance in m."""

DATA_PAIRS = {8: 96, 16: 48, 32: 12}
"""Pairs of a packet, by LEDs in a row: 4 codewords a packet at 16, and as many or more else."""

DISTANCES_M = (1.87, 3, 4, 5, 6, 8, 10, 12, 14, 18, 25, 40)
"""From an array of 500 px on; on either side of each change of the level."""


class Counts:
    """Codewords and packets of films: read, lost, and wrong."""

    def __init__(self) -> None:
        self.films = self.found = self.foreign = self.false = 0
        self.lost = {name: [0, 0] for name in LAYERS}

    def add(self, settings: LinkSettings, packets: Sequence[Packet], seed: int, sent: int, seen: Orientation) -> None:
        """Count a film of one array."""
        identity, per = settings.transmit.identities[0], _codewords(settings)
        content = random_messages(settings, seed)[0]
        own = [p for p in packets if p.identity == identity and p.orientation == seen]
        self.films += 1
        self.found += bool(own)
        self.foreign += len(packets) - len(own)
        for name in LAYERS:
            words = [word for p in own for word in p.layers[name] if word.block is not None]
            self.false += sum(word.block.payload not in content[name][0] for word in words if word.block is not None)
            self.lost[name][0] += max(sent * per[name] - len(words), 0)
            self.lost[name][1] += sent * per[name]

    def __str__(self) -> str:
        lost = ", ".join(f"{a}/{b}" for a, b in self.lost.values())
        low, high = clopper_pearson(*(sum(of) for of in zip(*self.lost.values(), strict=True)))
        return (
            f"found {self.found}/{self.films}, lost {lost} ({low:.1e} to {high:.1e}), foreign packets {self.foreign}, "
            f"false codewords {self.false}"
        )


def link(receiver: str, side: int, distance_m: float, rng: np.random.Generator, *changes: str) -> LinkSettings:
    """A link at rest with an array of a random identity, at a random place of the frame at which all of it is seen."""
    half = 0.5 * side / 16 * PX_M / distance_m + 8
    x, y = rng.uniform(-1, 1, 2) * (max(512 - half, 0), max(256 - half, 0)) / 2917 * distance_m
    return load_settings(
        "static",
        None,
        [
            f"receive.receiver={receiver}", f"signal.side={side}", f"signal.data_pairs={DATA_PAIRS[side]}",
            f"channel.distance_m={distance_m}", f"transmit.identities=[{rng.integers(30)}]",
            f"channel.arrays.0.x_m={x:.6f}", f"channel.arrays.0.y_m={y:.6f}", *changes,
        ],
    )  # fmt: skip


def film(settings: LinkSettings, seed: int, packets: int | None = 2) -> list[Frame]:
    """Whole frames of so many packets; None: of the whole drive."""
    settings = settings if packets is None else block_settings(settings, packets)
    return [frame for frame, _ in simulate(settings, random_messages(settings, seed), seed)]


def receive(settings: LinkSettings, frames: Sequence[Frame]) -> list[Packet]:
    """All packets of a film."""
    receiver = make_receiver(settings.signal, settings.receive)
    return [p for frame in frames for p in receiver.push(frame)] + list(receiver.finish())


def distances(count: int, seed: int) -> None:
    """At rest, by distance and LEDs in a row."""
    for receiver in ("plain", "soft"):
        for side in (8, 16, 32):
            for distance_m in DISTANCES_M:
                if side / 16 * PX_M / distance_m > 500 or (side == 8 and distance_m > 30):
                    continue
                rng, counts = np.random.default_rng([seed, side, int(100 * distance_m)]), Counts()
                for _ in range(count if side < 32 else -(-count // 4)):
                    one = int(rng.integers(1 << 30))
                    settings = block_settings(link(receiver, side, distance_m, rng), 2)
                    counts.add(settings, receive(settings, film(settings, one)), one, 2, UPRIGHT)
                print(f"{receiver}, {side} x {side}, {distance_m:g} m: {counts}", flush=True)


def acquired(count: int, seed: int) -> None:
    """Whether arrays of 16 x 16 LEDs are found by their first header, and as whom, at any size from 500 px to 60 px."""
    for receiver in ("plain", "soft"):
        rng = np.random.default_rng(seed)
        right = wrong = 0
        missed = []
        for _ in range(count):
            one, distance_m = int(rng.integers(1 << 30)), PX_M / float(np.exp(rng.uniform(np.log(60), np.log(500))))
            settings = block_settings(link(receiver, 16, distance_m, rng), 1)
            seen: list[Any] = []
            hearing = make_receiver(settings.signal, settings.receive, seen.append)
            for frame in film(lasting(settings, 0.016), one, None):
                list(hearing.push(frame))
            found = [event.detection.identity for event in seen if isinstance(event, DetectEvent)]
            right += found == [settings.transmit.identities[0]]
            wrong += any(number != settings.transmit.identities[0] for number in found)
            missed += [] if found else [round(PX_M / distance_m)]
        low, high = clopper_pearson(count - right, count)
        print(f"{receiver}: right {right}/{count} (else {low:.1e} to {high:.1e}), wrong {wrong}, missed at px {missed}")


def turned(count: int, seed: int) -> None:
    """All orientations, at random distances."""
    for receiver, farthest in (("plain", 40.0), ("soft", 80.0)):
        for number, orientation in enumerate(ORIENTATIONS):
            rng, counts = np.random.default_rng([seed, number]), Counts()
            for _ in range(count):
                one, distance_m = int(rng.integers(1 << 30)), float(np.exp(rng.uniform(np.log(3), np.log(farthest))))
                settings = block_settings(link(receiver, 16, distance_m, rng), 2)
                frames = [replace(f, pixels=orientation.turned(f.pixels)) for f in film(settings, one)]
                counts.add(settings, receive(settings, frames), one, 2, orientation)
            print(f"{receiver}, {orientation}: {counts}", flush=True)


def drives(count: int, seed: int) -> None:
    """From 30 m to 3 m at 30 km/h, with shake of a road of class B; the array a little off the camera's axis."""
    for receiver in ("plain", "soft"):
        rng, counts = np.random.default_rng(seed), Counts()
        for _ in range(count):
            one, (x, y) = int(rng.integers(1 << 30)), rng.uniform(-0.15, 0.15, 2)
            changes = [f"channel.arrays.0.x_m={x:.4f}", f"channel.arrays.0.y_m={y:.4f}"]
            changes += [f"transmit.identities=[{rng.integers(30)}]", f"receive.receiver={receiver}"]
            settings = load_settings("paper", None, ["channel.distance_m=30", "channel.stop_m=3", *changes])
            frames = film(settings, one, None)
            sent = int(len(frames) / 1000 / settings.signal.packet_s)
            counts.add(settings, receive(settings, frames), one, sent, UPRIGHT)
        print(f"{receiver}, 30 m to 3 m at 30 km/h: {counts}", flush=True)


def speed(count: int, seed: int) -> None:
    """Computing time of a second of whole frames, acquisition included, medians of runs."""
    rng = np.random.default_rng(seed)
    for receiver in ("plain", "soft"):
        for distance_m in (80.0, 25.0, PX_M / 200, 3.0, 1.87):
            settings = block_settings(link(receiver, 16, distance_m, rng), 10)
            frames, rates = film(settings, seed, 10), []
            for turn in range(count + 1):
                begin = time.process_time()
                receive(settings, frames)
                if turn:  # the first compiles
                    rates.append(len(frames) / (time.process_time() - begin))
            print(
                f"{receiver}, {PX_M / distance_m:.0f} px: {np.median(rates):.0f} frames/s of processor time", flush=True
            )


def _codewords(settings: LinkSettings) -> dict[str, int]:
    from heliograph.signal.packet import PacketFormat

    return {name: layer.codewords for name, layer in PacketFormat(settings.signal).layers.items()}


if __name__ == "__main__":
    what, *numbers = sys.argv[1:]
    count, seed = (int(n) for n in [*numbers, *("8", "0")[len(numbers) :]])
    {"distances": distances, "acquired": acquired, "turned": turned, "drives": drives, "speed": speed}[what](
        count, seed
    )
