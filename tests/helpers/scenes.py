"""Receiver test films: an array rendered from the equations, and small simulated films."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from heliograph.base.frames import Frame
from heliograph.base.threads import one_thread
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate, transmitters
from heliograph.measure.bench import run_block
from heliograph.receive.api import AnyObserver, receive_frames
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.packet import Codeword, Packet
from heliograph.signal.pwm import lit_slots

Floats = NDArray[np.float64]
SIDE = 16
ALL_ON = np.ones((SIDE, SIDE))


def pitch_at(distance_m: float) -> float:
    return 0.035 * 0.02 / (distance_m * 12e-6)


def draw(pose: Pose, weights: Floats, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Render an array by integrating each LED's Gaussian over each pixel."""
    points = pose.leds(len(weights)).reshape(-1, 2)

    def pixel_light(first: int, count: int, centres: Floats) -> Floats:
        edges = first - 0.5 + np.arange(count + 1)
        return np.diff(0.5 * erf((edges - centres[:, None]) / (np.sqrt(2) * pose.blur)), axis=1)

    spans = []  # only 6e-16 of an LED's light lies beyond 8 standard deviations
    for first, count, centres in zip(corner, (shape[1], shape[0]), points.T, strict=True):
        low, high = np.floor([centres.min() - 8 * pose.blur, centres.max() + 8 * pose.blur + 1]).astype(int) - first
        spans.append(slice(*np.clip([low, high + 1], 0, count)))
    across = pixel_light(corner[0] + spans[0].start, spans[0].stop - spans[0].start, points[:, 0])
    down = pixel_light(corner[1] + spans[1].start, spans[1].stop - spans[1].start, points[:, 1])
    out = np.zeros(shape)
    with one_thread():  # on a loaded machine, multithreaded BLAS is ten times slower for small matrices
        out[spans[1], spans[0]] = pose.pitch**2 * (down * weights.reshape(-1, 1)).T @ across
    return out


def link(*changes: str, **channel: Any) -> LinkSettings:
    """Return the still reference link, with the array centred in a small camera image."""
    small = {"distance_m": 50.0, "camera": {"width": 160, "height": 120}, "arrays": [{"x_m": 0.0, "y_m": 0.0}]}
    return load_settings("static", {"channel": small | channel}, changes)


def film(settings: LinkSettings, frames: int, seed: int = 1, roi_margin_px: int | None = None) -> list[Frame]:
    """Simulate the first frames of a film, one per millisecond."""
    channel = replace(settings.channel, duration_s=frames * 1e-3)
    timed = simulate(replace(settings, channel=channel), default_messages(settings), seed, None, roi_margin_px)
    return [frame for frame, _ in timed]


def received(frames: Iterable[Frame], settings: LinkSettings, observe: AnyObserver | None = None) -> list[Packet]:
    return list(receive_frames(frames, settings.signal, settings.receive, observe))


def statuses(packets: Iterable[Packet]) -> list[str]:
    return [packet.status for packet in packets]


def words_of(packet: Packet) -> list[Codeword]:
    """Return the codewords of a packet: high, middle and low layer."""
    return [word for words in packet.layers.values() for word in words]


def comparable(packets: Iterable[Packet]) -> list[Packet]:
    """Return the packets with codewords as plain values, to compare them by `==`."""

    def values(word: Codeword) -> Any:
        return word.status, word.block, word.iterations, word.margin, word.bits.tobytes(), word.raw.tobytes()

    return [replace(p, layers={name: tuple(map(values, by)) for name, by in p.layers.items()}) for p in packets]


def codewords(settings: LinkSettings, seed: int = 1, max_packets: int | None = None) -> list[tuple[int, int]]:
    """Simulate a link; return the numbers of sent and lost codewords by layer. No codeword may be false."""
    counts = run_block(settings, seed, max_packets=max_packets)
    assert counts.false_codewords == counts.false_packets == 0
    return [(layer.codewords, layer.codeword_errors) for layer in counts.layers.values()]


def at_rest(t: Floats) -> Floats:
    """Return the path of an array at rest; see `drawn_film`."""
    return np.full((len(t), 2), (47.3, 48.8))


def levels(settings: LinkSettings) -> Iterator[NDArray[np.uint8]]:
    return transmitters(settings, default_messages(settings))[0].levels()


def drawn_film(
    settings: LinkSettings, frames: int, path: Callable[[Floats], Floats], *, hidden: Sequence[range] = (),
    exposed_slots: int = 4, distance_m: float = 50.0,
) -> list[Frame]:  # fmt: skip
    """Film an array with its centre on a path: time in s (n,) -> (x, y), shape (n, 2).

    Frames are contiguous. An exposure covers some of the four slots in a 1 ms pattern and averages an image per
    slot. Gain 0.8, background 0.1, no panel, reference noise.
    """
    rng, out = np.random.default_rng(0), []
    slots = (lit for pattern in levels(settings) for lit in lit_slots(pattern, settings.signal.slot_order))
    for index in range(frames):
        light, first = np.full((96, 96), 0.1), index * exposed_slots
        moments = path((first + np.arange(exposed_slots) + 0.5) / 4 * 1e-3)
        lights = list(islice(slots, exposed_slots))
        if (moments == moments[0]).all():
            moments, lights = moments[:1], [np.sum(lights, axis=0)]
        for (x, y), lit in zip(moments, lights, strict=True):
            if not any(index in gap for gap in hidden):
                pose = Pose(float(x), float(y), pitch_at(distance_m), 0.0, 0.52)
                light += 0.8 / exposed_slots * draw(pose, lit.astype(float), (0, 0), light.shape)
        out.append(replace(frame_of(light, index, rng), time_s=first / 4 * 1e-3))
    return out


def frame_of(light: Floats, index: int, rng: np.random.Generator, origin: tuple[int, int] = (0, 0)) -> Frame:
    """Return a frame for light in fractions of full scale, with the reference link's noise."""
    electrons = 15000 * light + rng.normal(0, np.sqrt(40.0**2 + 15000 * np.maximum(light, 0)))
    pixels = np.clip(np.round(electrons * 255 / 15000), 0, 255).astype(np.uint8)
    return Frame(index, index * 1e-3, pixels, 8, origin)
