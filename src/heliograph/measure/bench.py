"""Link bench in memory: packets through channel and receiver with error counts.

The channel renders only windows around the arrays; the pixels are equal to the pixels of full frames, noise included.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from heliograph.channel.motion import nearest_m
from heliograph.link.film import frames_of
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings
from heliograph.measure.counts import BlockCounts, pooled
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.signal.block import MAX_MESSAGE, MAX_SEGMENTS
from heliograph.signal.formats import AGREED
from heliograph.signal.packet import LayerFormat, PacketFormat
from heliograph.signal.settings import LAYERS


def run_block(
    settings: LinkSettings, seed: int, recordings: Recordings | None = None, max_packets: int | None = None
) -> BlockCounts:
    """Simulate, receive and count a block; a function of settings and seed."""
    settings = dithered(block_settings(settings, max_packets), seed)
    film = LiveFilm(settings, random_messages(settings, seed), seed, recordings, window_margin_px(settings))
    reception = ReceptionCounter(film)
    deque(receive_and_count(film, settings.signal, settings, reception, truth=film.known_channel()), maxlen=0)
    return _counts(reception, settings)


def block_settings(settings: LinkSettings, max_packets: int | None = None) -> LinkSettings:
    """Return the settings with the film length of `run_block`."""
    channel, signal = settings.channel, settings.signal
    if max_packets is None and not is_static(settings):
        return settings
    slowest = 1 + 1e-6 * max([0.0, *(p.clock_ppm for p in channel.arrays)])
    camera, latest = channel.camera, max([channel.camera.start_s, *(p.start_s for p in channel.arrays)])
    # a receiver refuses fewer frames than patterns of a packet: lost frames take a longer film
    packets = max_packets or (math.ceil(1.5 / (1 - camera.dropped)) if camera.dropped else 1)
    end_s = latest + packets * signal.packet_s * slowest
    if max_packets is None:
        # to the end of the last frame that begins in the packet; 1e-6: rounding
        frames = math.ceil((end_s - camera.start_s) / camera.frame_period_s - 1e-6)
        end_s = max(end_s, camera.start_s + frames * camera.frame_period_s)
    return lasting(settings, end_s)


def lasting(settings: LinkSettings, duration_s: float) -> LinkSettings:
    """Return the settings with another film length."""
    return replace(settings, channel=replace(settings.channel, duration_s=duration_s))


def dithered(settings: LinkSettings, seed: int) -> LinkSettings:
    """Return static settings with random array positions within a pixel; moving scenes are unchanged."""
    if not is_static(settings):
        return settings
    return placed_within_pixel(settings, np.random.default_rng([seed, 2]))


def placed_within_pixel(settings: LinkSettings, rng: np.random.Generator) -> LinkSettings:
    """Return the settings with each array shifted by up to half a pixel."""
    channel = settings.channel
    places = []
    for place in channel.arrays:
        pixel_m = (channel.distance_m + place.z_offset_m) / channel.camera.focal_px
        x, y = np.array([place.x_m, place.y_m]) + rng.uniform(-0.5, 0.5, 2) * pixel_m
        places.append(replace(place, x_m=float(x), y_m=float(y)))
    return replace(settings, channel=replace(channel, arrays=tuple(places)))


def is_static(settings: LinkSettings) -> bool:
    """Return True if the scene is static and a film may have any length."""
    channel = settings.channel
    return (
        not channel.moves
        and channel.shake in ("none", "road")  # registered motions may move the camera
        and not any(p.vx_m_s or p.vy_m_s or p.vz_m_s or p.off_s for p in channel.arrays)
    )


def random_messages(settings: LinkSettings, seed: int) -> list[Mapping[str, Sequence[bytes]]]:
    """Return random bytes by array and layer, enough for a film of distinct codewords."""
    camera, named = settings.channel.camera, settings.transmit.formats or (AGREED,)
    film_s = camera.start_s + (frames_of(settings) + 1) * camera.frame_period_s
    packets = math.ceil(film_s / (settings.signal.packet_s * 0.99)) + 1  # a clock may be 1 % fast
    forms = [PacketFormat(settings.signal, form) for form in named]
    sizes = {name: max(_message_bytes(form.layers[name], packets) for form in forms) for name in LAYERS}
    rng = np.random.default_rng([seed, 1])
    return [{name: [rng.bytes(size)] for name, size in sizes.items()} for _ in settings.transmit.identities]


def _message_bytes(layer: LayerFormat, packets: int) -> int:
    """Return the payload bytes of a layer in a number of packets."""
    return min(packets * layer.codewords, MAX_SEGMENTS, MAX_MESSAGE // layer.payload_bytes) * layer.payload_bytes


def window_margin_px(settings: LinkSettings) -> int:
    """Return the window margin around the arrays in px, half the side of an array."""
    channel = settings.channel
    side = settings.signal.side * channel.emitter.pitch_m * channel.camera.focal_px / nearest_m(channel)
    # at least 12 px for the tracker and for motion within a header
    return max(12, math.ceil(min(side, settings.receive.detect.max_side_px) / 2))


def _counts(reception: ReceptionCounter, settings: LinkSettings) -> BlockCounts:
    errors = reception.errors
    assert errors is not None
    bins = errors.bins()
    packets, detected = errors.detected()
    distance_errors, covered = errors.distance_errors(), errors.covered()
    arrays = [reception.arrays[n] for n in settings.transmit.identities if n in reception.arrays]
    return BlockCounts(
        layers=pooled(bins.values()),
        bins=bins,
        payload_bits={name: sum(8 * array.layers[name].bytes for array in arrays) for name in LAYERS},
        packets=packets,
        detected=detected,
        film_s=reception.frames * settings.channel.camera.frame_period_s,
        frames=reception.frames,
        distances=len(distance_errors),
        distance_squares=math.fsum(error**2 for error in distance_errors),
        posed=len(covered),
        covered_positions=sum(position for position, _ in covered),
        covered_poses=sum(pose for _, pose in covered),
        receiver_s=reception.receiver_s,
        processing=dict(reception.processing),
        **errors.outcomes(),
    )
