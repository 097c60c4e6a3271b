"""The link without films: packets through windows of the channel's frames to a receiver, errors counted.

Everything but the file is that of `heliograph.link.film`: the same channel, receiver and counting. Only the arrays'
surroundings are rendered; their pixels are those of whole frames, noise included.
"""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, cast

import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.film import frames_of, receive_film
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, Recordings, simulate
from heliograph.link.truth import TruthFile
from heliograph.measure.errors import LayerErrors
from heliograph.measure.reception import Reception
from heliograph.measure.statistics import Clustered, Count
from heliograph.media import FilmReader
from heliograph.signal.block import MAX_MESSAGE, MAX_SEGMENTS
from heliograph.signal.formats import AGREED
from heliograph.signal.packet import LayerFormat, PacketFormat
from heliograph.signal.settings import LAYERS

MARGIN_PX = 12
"""Least margin of the window about the arrays: room for the tracker and for the motion within a header."""


@dataclass(slots=True)
class LayerCounts:
    """Counts of a layer; a codeword is wrong where it was not read rightly, missed ones included.

    Attributes
    ----------
    bits, bit_errors
        Information bits after the turbo decoder, of received packets.
    raw_bits, raw_errors
        Coded bits before it, of received packets.
    codewords, codeword_errors, missed
        Codewords sent; those wrong, and of them those of packets not received at all.
    packets
        Packets received.
    bit_squares, raw_squares
        Sums of the squares of their `bit_errors` and `raw_errors`: how much errors come together.
    """

    bits: int = 0
    bit_errors: int = 0
    raw_bits: int = 0
    raw_errors: int = 0
    codewords: int = 0
    codeword_errors: int = 0
    missed: int = 0
    packets: int = 0
    bit_squares: int = 0
    raw_squares: int = 0

    @classmethod
    def of(cls, errors: LayerErrors) -> "LayerCounts":
        """The counts of an `ErrorCounter`."""
        bits, raw, words = errors.bits, errors.raw, errors.codewords
        return cls(
            bits.trials,
            bits.errors,
            raw.trials,
            raw.errors,
            words.trials,
            words.errors,
            errors.missed,
            bits.clusters,
            bits.squares,
            raw.squares,
        )

    @property
    def decoded(self) -> Clustered:
        """Information bits after the turbo decoder, by packet."""
        return Clustered(self.bits, self.bit_errors, self.packets, self.bit_squares)

    @property
    def raw(self) -> Clustered:
        """Coded bits before it, by packet."""
        return Clustered(self.raw_bits, self.raw_errors, self.packets, self.raw_squares, scattered=True)

    @property
    def words(self) -> Count:
        """Codewords sent."""
        return Count(self.codewords, self.codeword_errors)

    def add(self, other: "LayerCounts") -> None:
        """Count another's as well."""
        for one in fields(self):
            setattr(self, one.name, getattr(self, one.name) + getattr(other, one.name))


Layers = dict[str, LayerCounts]


def _no_errors() -> Layers:
    return {name: LayerCounts() for name in LAYERS}


@dataclass(slots=True)
class BlockCounts:
    """What came of a block, or of several.

    Attributes
    ----------
    layers
        Counts by layer.
    bins
        The same by the lower edge in m of the distance bin.
    payload_bits
        Payload of the codewords read, by layer.
    false_codewords
        Codewords taken for right that were not sent.
    false_packets, duplicates
        Packets received that were not sent, and those received again.
    film_s
        Length of the film.
    frames
        Frames rendered.
    """

    layers: Layers = field(default_factory=_no_errors)
    bins: dict[float, Layers] = field(default_factory=dict)
    payload_bits: dict[str, int] = field(default_factory=lambda: dict.fromkeys(LAYERS, 0))
    false_codewords: int = 0
    false_packets: int = 0
    duplicates: int = 0
    film_s: float = 0.0
    frames: int = 0

    @property
    def codewords(self) -> int:
        """Codewords sent, all layers."""
        return sum(layer.codewords for layer in self.layers.values())

    def add(self, other: "BlockCounts") -> None:
        """Count another's as well."""
        _add_layers(self.layers, other.layers)
        for start, layers in other.bins.items():
            _add_layers(self.bins.setdefault(start, _no_errors()), layers)
        for name, bits in other.payload_bits.items():
            self.payload_bits[name] += bits
        self.false_codewords += other.false_codewords
        self.false_packets += other.false_packets
        self.duplicates += other.duplicates
        self.film_s += other.film_s
        self.frames += other.frames

    def to_plain(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**asdict(self), "bins": [[start, _plain(layers)] for start, layers in sorted(self.bins.items())]}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> "BlockCounts":
        """The inverse of `to_plain`."""
        bins = {float(start): _layers(layers) for start, layers in plain["bins"]}
        return cls(**{**plain, "layers": _layers(plain["layers"]), "bins": bins})


def run_block(
    settings: LinkSettings, seed: int, recordings: Recordings | None = None, max_packets: int | None = None
) -> BlockCounts:
    """Send, film, receive and count one block; the result depends on settings and seed alone.

    Parameters
    ----------
    settings
        The link. Where nothing moves, the block is a film of one packet, whatever ``channel.duration_s``, with the
        arrays anywhere within a pixel of their places; else the whole drive.
    seed
        Of messages, road, scene, noise and place.
    recordings
        Real background and motion.
    max_packets
        Cut the film after so many packets.

    Raises
    ------
    HeliographError
        Settings, recordings and receiver do not fit each other.
    """
    settings = dithered(block_settings(settings, max_packets), seed)
    live = _LiveFilm(settings, random_messages(settings, seed), seed, recordings)
    reception = Reception(cast(TruthFile, live))
    packets = receive_film(cast(FilmReader, live), settings.signal, settings, reception)
    deque(packets, maxlen=0)
    return _counts(reception, settings)


def block_settings(settings: LinkSettings, max_packets: int | None = None) -> LinkSettings:
    """The settings with the length of film that `run_block` takes."""
    channel, signal = settings.channel, settings.signal
    packets = max_packets or 1
    slowest = 1 + 1e-6 * max([0.0, *(p.clock_ppm for p in channel.arrays)])
    latest = max([channel.camera.start_s, *(p.start_s for p in channel.arrays)])
    if stands_still(settings):
        return _lasting(settings, latest + packets * signal.packet_s * slowest)
    if max_packets is None:
        return settings
    return _lasting(settings, latest + max_packets * signal.packet_s * slowest)


def dithered(settings: LinkSettings, seed: int) -> LinkSettings:
    """Where nothing moves, the arrays anywhere within a pixel: errors depend on where LEDs fall between pixels."""
    if not stands_still(settings):
        return settings
    channel, rng = settings.channel, np.random.default_rng([seed, 2])
    places = []
    for place in channel.arrays:
        pixel_m = (channel.distance_m + place.z_offset_m) / channel.camera.focal_px
        x, y = np.array([place.x_m, place.y_m]) + rng.uniform(-0.5, 0.5, 2) * pixel_m
        places.append(replace(place, x_m=float(x), y_m=float(y)))
    return replace(settings, channel=replace(channel, arrays=tuple(places)))


def stands_still(settings: LinkSettings) -> bool:
    """Whether the scene stays as it is, so that a film may be of any length."""
    channel = settings.channel
    return (
        not channel.moves
        and channel.shake != "imu"
        and not any(p.vx_m_s or p.vy_m_s or p.vz_m_s or p.off_s for p in channel.arrays)
    )


def random_messages(settings: LinkSettings, seed: int) -> list[Messages]:
    """Random bytes by array and layer, enough that no codeword of the film is sent twice."""
    camera, named = settings.channel.camera, settings.transmit.formats or (AGREED,)
    film_s = camera.start_s + (frames_of(settings) + 1) * camera.frame_period_s
    packets = math.ceil(film_s / (settings.signal.packet_s * 0.99)) + 1  # a clock may be 1 % fast
    forms = [PacketFormat(settings.signal, one) for one in named]
    sizes = {name: max(_enough(form.layers[name], packets) for form in forms) for name in LAYERS}
    rng = np.random.default_rng([seed, 1])
    return [{name: [rng.bytes(size)] for name, size in sizes.items()} for _ in settings.transmit.identities]


def _enough(layer: LayerFormat, packets: int) -> int:
    """Bytes that fill a layer's codewords of so many packets."""
    return min(packets * layer.codewords, MAX_SEGMENTS, MAX_MESSAGE // layer.payload_bytes) * layer.payload_bytes


def window_margin_px(settings: LinkSettings) -> int:
    """Margin about the arrays: half an array's side, that what stands still is the larger part of a window."""
    channel = settings.channel
    nearest = min(channel.distance_m, channel.stop_m) if channel.moves else channel.distance_m
    side = settings.signal.side * channel.emitter.pitch_m * channel.camera.focal_px / nearest
    return max(MARGIN_PX, math.ceil(min(side, settings.receive.detect.max_side_px) / 2))


class _LiveFilm:
    """Frames as they are rendered, in place of a `FilmReader`; and their truth, in place of a `TruthFile`."""

    path = "the film"

    def __init__(self, settings: LinkSettings, messages: Sequence[Messages], seed: int, recordings: Recordings | None):
        self.settings, self.messages = settings, messages
        self._frames = simulate(settings, messages, seed, recordings, window_margin_px(settings))
        self._rows: deque[dict[str, Any]] = deque()

    def __iter__(self) -> Iterator[Frame]:
        """Frames, the truth of each known before."""
        for frame, truth in self._frames:
            # distances as a truth file has them
            distances = np.array([a.distance_m for a in truth.arrays], np.float32)
            arrays = {"distance_m": distances, "visible": np.array([a.visible for a in truth.arrays])}
            self._rows.append({"index": truth.index, "time_s": truth.time_s, "arrays": arrays})
            yield frame

    def rows(self) -> Iterator[dict[str, Any]]:
        """Rows in the order of time; there is one for each frame that was seen."""
        while True:
            yield self._rows.popleft()


def _counts(reception: Reception, settings: LinkSettings) -> BlockCounts:
    assert reception.errors is not None  # the truth is known
    bins = {start: {n: LayerCounts.of(e) for n, e in by.items()} for start, by in reception.errors.bins().items()}
    total = BlockCounts(
        bins=bins,
        false_codewords=reception.errors.false_codewords,
        false_packets=reception.errors.false_packets,
        duplicates=reception.errors.duplicates,
        film_s=reception.frames * settings.channel.camera.frame_period_s,
        frames=reception.frames,
    )
    for layers in bins.values():
        _add_layers(total.layers, layers)
    for identity in settings.transmit.identities:
        for name, tally in reception.arrays[identity].layers.items() if identity in reception.arrays else ():
            total.payload_bits[name] += 8 * tally.bytes
    return total


def _lasting(settings: LinkSettings, duration_s: float) -> LinkSettings:
    return replace(settings, channel=replace(settings.channel, duration_s=duration_s))


def _add_layers(total: Layers, more: Layers) -> None:
    for name, counts in more.items():
        total[name].add(counts)


def _plain(layers: Layers) -> dict[str, Any]:
    return {name: asdict(counts) for name, counts in layers.items()}


def _layers(plain: Mapping[str, Any]) -> Layers:
    return {name: LayerCounts(**counts) for name, counts in plain.items()}
