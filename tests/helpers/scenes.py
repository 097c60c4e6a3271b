"""What the receiver's tests film: an array drawn from the equations, and small films of the simulated link."""

from collections.abc import Callable, Iterator, Mapping, Sequence
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
from heliograph.receive import Pose
from heliograph.signal.pwm import lit_slots

Floats = NDArray[np.float64]

SIDE = 16
ALL_ON = np.ones((SIDE, SIDE))


def pitch_at(distance_m: float) -> float:
    """Pitch in px of the reference link."""
    return 0.035 * 0.02 / (distance_m * 12e-6)


def draw(pose: Pose, weights: Floats, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Image of an array by brute force: every LED's Gaussian integrated over every pixel."""
    points = pose.leds(len(weights)).reshape(-1, 2)

    def pixel_light(first: int, count: int, centres: Floats) -> Floats:
        edges = first - 0.5 + np.arange(count + 1)
        return np.diff(0.5 * erf((edges - centres[:, None]) / (np.sqrt(2) * pose.blur)), axis=1)

    # beyond 8 standard deviations lie 6e-16 of an LED's light
    spans = []
    for first, count, centres in zip(corner, (shape[1], shape[0]), points.T, strict=True):
        low, high = np.floor([centres.min() - 8 * pose.blur, centres.max() + 8 * pose.blur + 1]).astype(int) - first
        spans.append(slice(*np.clip([low, high + 1], 0, count)))
    across = pixel_light(corner[0] + spans[0].start, spans[0].stop - spans[0].start, points[:, 0])
    down = pixel_light(corner[1] + spans[1].start, spans[1].stop - spans[1].start, points[:, 1])
    out = np.zeros(shape)
    with one_thread():  # beside other work, threads take ten times as long for matrices so small
        out[spans[1], spans[0]] = pose.pitch**2 * (down * weights.reshape(-1, 1)).T @ across
    return out


def link(*changes: str, **channel: Any) -> LinkSettings:
    """The reference link at rest with an array in the middle of a small camera."""
    base: Mapping[str, Any] = {
        "distance_m": 50.0,
        "camera": {"width": 160, "height": 120},
        "arrays": [{"x_m": 0.0, "y_m": 0.0}],
        **channel,
    }
    return load_settings("static", {"channel": base}, changes)


def film(settings: LinkSettings, frames: int, seed: int = 1, roi_margin_px: int | None = None) -> list[Frame]:
    """The first frames of a simulated film, as many as there are milliseconds."""
    channel = replace(settings.channel, duration_s=frames * 1e-3)
    timed = simulate(replace(settings, channel=channel), default_messages(settings), seed, None, roi_margin_px)
    return [frame for frame, _ in timed]


def levels(settings: LinkSettings) -> Iterator[NDArray[np.uint8]]:
    """Patterns of the first array."""
    return transmitters(settings, default_messages(settings))[0].levels()


def drawn_film(
    settings: LinkSettings,
    frames: int,
    path: Callable[[Floats], Floats],
    *,
    hidden: Sequence[range] = (),
    exposed_slots: int = 4,
    distance_m: float = 50.0,
    size: int = 96,
    seed: int = 0,
) -> list[Frame]:
    """A film of an array whose centre goes along a path: time in s (n,) -> (x, y) of shape (n, 2).

    Frame follows frame, and each is exposed for so many of the four slots of a pattern, which takes 1 ms. An exposure
    is the mean of moments, one a slot. Gain 0.8, background 0.1, no panel, reference noise.
    """
    rng, out = np.random.default_rng(seed), []
    slots = (lit for pattern in levels(settings) for lit in lit_slots(pattern, settings.signal.slot_order))
    for index in range(frames):
        light, first = np.full((size, size), 0.1), index * exposed_slots
        moments = path((first + np.arange(exposed_slots) + 0.5) / 4 * 1e-3)
        for (x, y), lit in zip(moments, islice(slots, exposed_slots), strict=True):
            if not any(index in gap for gap in hidden):
                pose = Pose(float(x), float(y), pitch_at(distance_m), 0.0, 0.52)
                light += 0.8 / exposed_slots * draw(pose, lit.astype(float), (0, 0), light.shape)
        out.append(replace(frame_of(light, index, rng), time_s=first / 4 * 1e-3))
    return out


def frame_of(light: Floats, index: int, rng: np.random.Generator, origin: tuple[int, int] = (0, 0)) -> Frame:
    """A frame of light, given as fractions of full scale, with the reference link's noise."""
    electrons = 15000 * light + rng.normal(0, np.sqrt(40.0**2 + 15000 * np.maximum(light, 0)))
    pixels = np.clip(np.round(electrons * 255 / 15000), 0, 255).astype(np.uint8)
    return Frame(index, index * 1e-3, pixels, 8, origin)
