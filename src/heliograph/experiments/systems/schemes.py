"""Other systems in the same channel: random bits shown in another way, read by the receiver's own tracking.

Each scheme sends the paper's header and then pairs of pattern and inverse, so that detection and tracking are those of
the plain receiver. Only what the LEDs' luminances mean differs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.channel import ArrayTruth, film
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import window_margin_px
from heliograph.measure.statistics import Clustered, Count
from heliograph.receive import Pose, Receiver
from heliograph.receive.extract import pair_luminances
from heliograph.signal import haar, ook
from heliograph.signal.header import header_levels
from heliograph.signal.packet import PacketFormat, with_inverses
from heliograph.signal.settings import LAYERS, SignalSettings

SIDE = 16

PLACE = (1.5, -1.0)
"""Where the array of the reference link stands, right of and below the axis in m."""

ENOUGH = 200
"""Errors after which no more are counted: their rate is known to about 15 %."""

SILENT = 4
"""Films without a reading after which the array is taken for out of reach."""

Reading = Literal["plain", "inverse", "known"]
"""The luminance at each LED's position; the blur undone; the blur undone with the true pose and blur."""


@dataclass(frozen=True)
class Scheme:
    """How bits are shown.

    Attributes
    ----------
    key
        "ook", one bit an LED; "haar", the hierarchical code; "repeat2" and "repeat4", one bit a square of so many
        LEDs by so many.
    parts
        Where in the bits of a pattern each part lies that is counted by itself.
    """

    key: str
    parts: Mapping[str, slice]

    @property
    def bits(self) -> int:
        """Bits of a pattern."""
        return max(part.stop for part in self.parts.values())

    @property
    def square(self) -> int:
        """LEDs in a row that show the same bit."""
        return int(self.key.removeprefix("repeat")) if self.key.startswith("repeat") else 1

    def encode(self, bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(pairs, bits) to patterns (pairs, n, n) of levels 0 to 4."""
        d = 1 - 2 * bits.astype(np.int8)
        if self.key == "haar":
            return haar.encode(_form().join(d))
        small = d.reshape(-1, SIDE // self.square, SIDE // self.square)
        return ook.encode(np.kron(small, np.ones((1, self.square, self.square), np.int8)))

    def decode(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Luminances x' (n, n) of a pair to soft bits, positive for 0; those of one bit are added."""
        if self.key == "haar":
            return np.concatenate([part[0] for part in _form().split(haar.decode(x)[None]).values()])
        n = SIDE // self.square
        return np.asarray(ook.decode(x).reshape(n, self.square, n, self.square).sum(axis=(1, 3)).ravel())


def _form() -> PacketFormat:
    return PacketFormat(SignalSettings(side=SIDE))


def _schemes() -> Iterator[Scheme]:
    layers = dict(zip(LAYERS, (slice(0, 64), slice(64, 192), slice(192, 256)), strict=True))
    yield Scheme("ook", {"all": slice(0, 256)})
    yield Scheme("haar", layers)
    yield Scheme("repeat2", {"all": slice(0, 64)})
    yield Scheme("repeat4", {"all": slice(0, 16)})


SCHEMES = {scheme.key: scheme for scheme in _schemes()}


@dataclass(slots=True)
class Heard:
    """Bits counted at a distance, by (reading, part) and film; films, and those in which the array was found."""

    counts: dict[tuple[Reading, str], Clustered] = field(default_factory=dict)
    films: int = 0
    found: int = 0

    def add(self, reading: Reading, part: str, trials: int, errors: int) -> None:
        """Count the bits of a film."""
        self.counts.setdefault((reading, part), Clustered(scattered=True)).add(trials, errors)

    def settled(self, target: int) -> bool:
        """Whether every count has its bits, or its errors."""
        if self.films >= SILENT and not self.found:
            return True
        return bool(self.counts) and all(c.trials >= target or c.errors >= ENOUGH for c in self.counts.values())


def listen(scheme: Scheme, readings: Sequence[Reading], distance_m: float, target: int, seed: int) -> Heard:
    """Read films at rest, each at its own place on the pixel grid, until enough bits or errors are counted.

    Parameters
    ----------
    scheme, readings
        What is shown, and how the LEDs are read.
    distance_m
        Distance.
    target
        Bits of each part, less where `ENOUGH` errors come first.
    seed
        Of bits, places and noise.
    """
    heard, number = Heard(), 0
    while not heard.settled(target):
        rng = np.random.default_rng([seed, number, round(1000 * distance_m), *scheme.key.encode()])
        _listen_once(scheme, readings, static_link(distance_m, rng), rng, heard)
        number += 1
    return heard


def static_link(distance_m: float, rng: np.random.Generator, **changes: Any) -> LinkSettings:
    """The reference link at rest for one packet, the array anywhere within a pixel."""
    settings = load_settings("static", {"channel": {"distance_m": distance_m}, **changes})
    pixel_m = distance_m / settings.channel.camera.focal_px
    x, y = np.array(PLACE) + rng.uniform(-0.5, 0.5, 2) * pixel_m
    place = replace(settings.channel.arrays[0], x_m=float(x), y_m=float(y))
    # one frame is not yet whole at the very end
    duration = settings.signal.packet_s + 1e-6
    return replace(settings, channel=replace(settings.channel, arrays=(place,), duration_s=duration))


def _listen_once(
    scheme: Scheme, readings: Sequence[Reading], settings: LinkSettings, rng: np.random.Generator, heard: Heard
) -> None:
    """One film of a packet; the receiver expects a longer one, so that it decodes nothing."""
    pairs, header = settings.signal.data_pairs, settings.signal.header_pairs
    bits = rng.integers(0, 2, (pairs, scheme.bits), dtype=np.uint8)
    truths: list[ArrayTruth] = []
    counts: dict[tuple[Reading, str], Count] = {}

    def observe(stage: str, data: Mapping[str, Any], /) -> None:
        place = data["frames"][0].index // 2 - header if stage == "extract" else -1
        if 0 <= place < pairs:
            _count(scheme, readings, data, truths, settings, bits[place], counts)

    longer = replace(settings.signal, data_pairs=pairs + 1)
    # down to 5 px: the high layer is read from further than the default search reaches
    detect = replace(settings.receive.detect, min_side_px=5.0)
    receiver = Receiver(longer, replace(settings.receive, detect=detect), observe)
    for frame, truth in _shown(scheme, bits, settings, rng):
        truths.append(truth)
        for _ in receiver.push(frame):
            pass
    heard.films += 1
    heard.found += bool(counts)
    for (reading, part), count in counts.items():
        heard.add(reading, part, count.trials, count.errors)


def _shown(
    scheme: Scheme, bits: NDArray[np.uint8], settings: LinkSettings, rng: np.random.Generator
) -> Iterator[tuple[Frame, ArrayTruth]]:
    """Frames of header and data, and the truth of the array in each."""
    head = header_levels(settings.transmit.identities[0], SIDE)[None].repeat(settings.signal.header_pairs, 0)
    patterns = with_inverses(np.concatenate([head, scheme.encode(bits)]))
    period, margin = settings.signal.pattern_period_s, window_margin_px(settings)
    for frame, truth in film(settings.channel, [patterns], rng, pattern_period_s=period, roi_margin_px=margin):
        yield frame, truth.arrays[0]


def _count(
    scheme: Scheme,
    readings: Sequence[Reading],
    data: Mapping[str, Any],
    truths: Sequence[ArrayTruth],
    settings: LinkSettings,
    bits: NDArray[np.uint8],
    counts: dict[tuple[Reading, str], Count],
) -> None:
    pattern, inverted = data["frames"]
    for reading in readings:
        poses = data["poses"]
        if reading == "known":
            poses = tuple(true_pose(truths[frame.index], settings) for frame in (pattern, inverted))
        equaliser: Literal["none", "inverse"] = "none" if reading == "plain" else "inverse"
        gain = settings.channel.emitter.all_on * pattern.full_scale  # a scale: signs do not depend on it
        wrong = (scheme.decode(pair_luminances(pattern, inverted, poses, gain, SIDE, equaliser)) < 0) != bits
        for name, part in scheme.parts.items():
            count = counts.setdefault((reading, name), Count())
            count.add(part.stop - part.start, int(np.count_nonzero(wrong[part])))


def true_pose(truth: ArrayTruth, settings: LinkSettings) -> Pose:
    """The pose of the truth; blur: the lens's and the emitter's disc, whose variance along an axis is r^2 / 4."""
    camera, emitter = settings.channel.camera, settings.channel.emitter
    radius = 0.5 * emitter.diameter_m * camera.focal_px / truth.distance_m
    return Pose(truth.x, truth.y, truth.pitch_px, truth.roll_rad, float(np.hypot(camera.blur_px, radius / 2)))
