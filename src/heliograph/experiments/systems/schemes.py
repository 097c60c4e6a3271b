"""Other systems in the same channel: random bits in other patterns, read by the tracking of the plain receiver.

Each scheme sends the header of the paper and then pairs of pattern and inverse, so that the plain receiver does
detection and tracking. Only the meaning of the luminances differs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.channel import ArrayTruth, film
from heliograph.experiments.links import static_link, true_pose
from heliograph.link.settings import LinkSettings
from heliograph.measure.bench import window_margin_px
from heliograph.measure.statistics import Clustered, Count
from heliograph.receive import make_receiver
from heliograph.receive.decode.per_led import pair_luminances
from heliograph.receive.events import Event, ExtractEvent
from heliograph.signal import haar, ook
from heliograph.signal.header import header_levels
from heliograph.signal.packet import PacketFormat, with_inverses
from heliograph.signal.settings import SignalSettings

SIDE = 16

ENOUGH = 200
"""Errors at which counting ends: the rate is known to about 15 %."""

ReadMethod = Literal["plain", "inverse", "known"]
"""Luminance at each LED position; the blur inverted; the blur inverted with the true pose and blur."""


@dataclass(frozen=True)
class Scheme:
    """Mapping of bits to patterns."""

    # "ook": a bit per LED; "haar": the hierarchical code; "repeat2", "repeat4": a bit per square of 2 x 2 or 4 x 4 LEDs
    key: str
    # Parts of the bits of a pattern that are counted separately
    parts: Mapping[str, slice]

    @property
    def bits(self) -> int:
        """Bits of a pattern."""
        return max(part.stop for part in self.parts.values())

    @property
    def square(self) -> int:
        """LEDs in a row with the same bit."""
        return int(self.key.removeprefix("repeat")) if self.key.startswith("repeat") else 1

    def encode(self, bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Patterns (pairs, 16, 16) of levels 0 to 4 for (pairs, bits) bits."""
        d = 1 - 2 * bits.astype(np.int8)
        if self.key == "haar":
            return haar.encode(_packet_format().join(d))
        small = d.reshape(-1, SIDE // self.square, SIDE // self.square)
        return ook.encode(np.kron(small, np.ones((1, self.square, self.square), np.int8)))

    def decode(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Soft bits (bits,), positive for 0, of (16, 16) luminances x' = gain (level - 2)."""
        if self.key == "haar":
            return np.concatenate([part[0] for part in _packet_format().split(haar.decode(x)[None]).values()])
        n = SIDE // self.square
        return np.asarray(ook.decode(x).reshape(n, self.square, n, self.square).sum(axis=(1, 3)).ravel())


def _packet_format() -> PacketFormat:
    return PacketFormat(SignalSettings(side=SIDE))


SCHEMES = {
    "ook": Scheme("ook", {"all": slice(0, 256)}),
    "haar": Scheme("haar", {"high": slice(0, 64), "middle": slice(64, 192), "low": slice(192, 256)}),
    "repeat2": Scheme("repeat2", {"all": slice(0, 64)}),
    "repeat4": Scheme("repeat4", {"all": slice(0, 16)}),
}


@dataclass(slots=True)
class BitCounts:
    """Bits of a scheme counted at a distance."""

    # Bits and errors by method and part, clustered by film
    counts: dict[tuple[ReadMethod, str], Clustered] = field(default_factory=dict)
    films: int = 0
    # Films with a detected array
    found: int = 0

    def add(self, method: ReadMethod, part: str, trials: int, errors: int) -> None:
        """Count the bits of a film."""
        self.counts.setdefault((method, part), Clustered(scattered=True)).add(trials, errors)

    def settled(self, target: int) -> bool:
        """True if every count has enough bits or errors, or four films show the array to be out of reach."""
        if self.films >= 4 and not self.found:
            return True
        return bool(self.counts) and all(c.trials >= target or c.errors >= ENOUGH for c in self.counts.values())


def count_bits(scheme: Scheme, methods: Sequence[ReadMethod], distance_m: float, target: int, seed: int) -> BitCounts:
    """Read films at rest, each with another pixel phase of the array, up to enough bits or errors."""
    counted, number = BitCounts(), 0
    while not counted.settled(target):
        rng = np.random.default_rng([seed, number, round(1000 * distance_m), *scheme.key.encode()])
        _count_film(scheme, methods, static_link(distance_m, rng), rng, counted)
        number += 1
    return counted


def _count_film(
    scheme: Scheme, methods: Sequence[ReadMethod], settings: LinkSettings, rng: np.random.Generator, counted: BitCounts
) -> None:
    """Count a film of a packet; the receiver expects a longer packet, so that it decodes nothing."""
    pairs, header = settings.signal.data_pairs, settings.signal.header_pairs
    bits = rng.integers(0, 2, (pairs, scheme.bits), dtype=np.uint8)
    truths: list[ArrayTruth] = []
    counts: dict[tuple[ReadMethod, str], Count] = {}

    def observe(event: Event) -> None:
        if isinstance(event, ExtractEvent) and 0 <= (number := event.frames[0].index // 2 - header) < pairs:
            _count_pair(scheme, methods, event, truths, settings, bits[number], counts)

    longer = replace(settings.signal, data_pairs=pairs + 1)
    # the high layer is readable beyond the reach of the default search
    detect = replace(settings.receive.detect, min_side_px=5.0)
    receiver = make_receiver(longer, replace(settings.receive, detect=detect), observe)
    for frame, truth in _film_bits(scheme, bits, settings, rng):
        truths.append(truth)
        for _ in receiver.push(frame):
            pass
    counted.films += 1
    counted.found += bool(counts)
    for (method, part), count in counts.items():
        counted.add(method, part, count.trials, count.errors)


def _film_bits(
    scheme: Scheme, bits: NDArray[np.uint8], settings: LinkSettings, rng: np.random.Generator
) -> Iterator[tuple[Frame, ArrayTruth]]:
    """Frames of header and data with the truth of the array."""
    head = header_levels(settings.transmit.identities[0], SIDE)[None].repeat(settings.signal.header_pairs, 0)
    patterns = with_inverses(np.concatenate([head, scheme.encode(bits)]))
    period, margin = settings.signal.pattern_period_s, window_margin_px(settings)
    for frame, truth in film(settings.channel, [patterns], rng, pattern_period_s=period, roi_margin_px=margin):
        yield frame, truth.arrays[0]


def _count_pair(
    scheme: Scheme,
    methods: Sequence[ReadMethod],
    event: ExtractEvent,
    truths: Sequence[ArrayTruth],
    settings: LinkSettings,
    bits: NDArray[np.uint8],
    counts: dict[tuple[ReadMethod, str], Count],
) -> None:
    pattern, inverted = event.frames
    # signs do not depend on the gain
    gain = settings.channel.emitter.all_on * settings.channel.sensor.full_scale
    for method in methods:
        poses = event.poses[0], event.poses[1]
        if method == "known":
            poses = true_pose(truths[pattern.index], settings), true_pose(truths[inverted.index], settings)
        equaliser: Literal["none", "inverse"] = "none" if method == "plain" else "inverse"
        luminances = pair_luminances(event.frames, poses, gain, SIDE, equaliser)
        wrong = (scheme.decode(luminances) < 0) != bits
        for name, part in scheme.parts.items():
            count = counts.setdefault((method, name), Count())
            count.add(part.stop - part.start, int(np.count_nonzero(wrong[part])))
