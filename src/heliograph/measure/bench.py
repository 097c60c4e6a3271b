"""The link without files: packets through windows of the channel's frames to a receiver, errors counted.

Channel, receiver and counting are those of films. Only the arrays' surroundings are rendered; their pixels are those of
whole frames, noise included.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from heliograph.link.film import frames_of
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings
from heliograph.measure.counts import BlockCounts, pooled
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import ArrayTally, Reception, receive_film
from heliograph.signal.block import MAX_MESSAGE, MAX_SEGMENTS
from heliograph.signal.formats import AGREED
from heliograph.signal.packet import LayerFormat, PacketFormat
from heliograph.signal.settings import LAYERS


def run_block(
    settings: LinkSettings, seed: int, recordings: Recordings | None = None, max_packets: int | None = None
) -> BlockCounts:
    """Send, film, receive and count one block; the result depends on settings and seed alone."""
    settings = dithered(block_settings(settings, max_packets), seed)
    film = LiveFilm(settings, random_messages(settings, seed), seed, recordings, window_margin_px(settings))
    reception = Reception(film)
    deque(receive_film(film, settings.signal, settings, reception), maxlen=0)
    return _counts(reception, settings)


def block_settings(settings: LinkSettings, max_packets: int | None = None) -> LinkSettings:
    """The settings with the length of film that `run_block` takes."""
    channel, signal = settings.channel, settings.signal
    if max_packets is None and not stands_still(settings):
        return settings
    slowest = 1 + 1e-6 * max([0.0, *(p.clock_ppm for p in channel.arrays)])
    latest = max([channel.camera.start_s, *(p.start_s for p in channel.arrays)])
    return lasting(settings, latest + (max_packets or 1) * signal.packet_s * slowest)


def lasting(settings: LinkSettings, duration_s: float) -> LinkSettings:
    """The settings with another length of film."""
    return replace(settings, channel=replace(settings.channel, duration_s=duration_s))


def dithered(settings: LinkSettings, seed: int) -> LinkSettings:
    """The settings with arrays that do not move placed anywhere within a pixel; a drive stays as it is.

    Errors depend on where LEDs fall between pixels.
    """
    if not stands_still(settings):
        return settings
    return placed_within_pixel(settings, np.random.default_rng([seed, 2]))


def placed_within_pixel(settings: LinkSettings, rng: np.random.Generator) -> LinkSettings:
    """The settings with each array moved by up to half a pixel to any side."""
    channel = settings.channel
    places = []
    for place in channel.arrays:
        pixel_m = (channel.distance_m + place.z_offset_m) / channel.camera.focal_px
        x, y = np.array([place.x_m, place.y_m]) + rng.uniform(-0.5, 0.5, 2) * pixel_m
        places.append(replace(place, x_m=float(x), y_m=float(y)))
    return replace(settings, channel=replace(channel, arrays=tuple(places)))


def stands_still(settings: LinkSettings) -> bool:
    """Whether nothing in the scene moves, so that a film may have any length."""
    channel = settings.channel
    return (
        not channel.moves
        and channel.shake in ("none", "road")  # a car at rest on a road does not shake; a motion of one's own may
        and not any(p.vx_m_s or p.vy_m_s or p.vz_m_s or p.off_s for p in channel.arrays)
    )


def random_messages(settings: LinkSettings, seed: int) -> list[Mapping[str, Sequence[bytes]]]:
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
    """Margin in px about the arrays: half an array's side, so that most of a window is background."""
    channel = settings.channel
    nearest = min(channel.distance_m, channel.stop_m) if channel.moves else channel.distance_m
    side = settings.signal.side * channel.emitter.pitch_m * channel.camera.focal_px / nearest
    # least margin of the window about the arrays: room for the tracker and for the motion within a header
    return max(12, math.ceil(min(side, settings.receive.detect.max_side_px) / 2))


def _counts(reception: Reception, settings: LinkSettings) -> BlockCounts:
    errors = reception.errors
    assert errors is not None  # the truth is known
    bins = errors.bins()
    packets, detected = errors.detected()
    arrays = [reception.arrays[n] for n in settings.transmit.identities if n in reception.arrays]
    return BlockCounts(
        layers=pooled(bins.values()),
        bins=bins,
        payload_bits={name: _payload_bits(arrays, name) for name in LAYERS},
        packets=packets,
        detected=detected,
        false_codewords=errors.false_codewords,
        false_packets=errors.false_packets,
        duplicates=errors.duplicates,
        film_s=reception.frames * settings.channel.camera.frame_period_s,
        frames=reception.frames,
    )


def _payload_bits(arrays: Sequence[ArrayTally], layer: str) -> int:
    return sum(8 * array.layers[layer].bytes for array in arrays)
