"""The channel as a whole: LED patterns in, camera frames and their truth out."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.channel.exposure import Faults, Lighting, PatternFeed
from heliograph.channel.footage import Footage
from heliograph.channel.motion import ImuTrace, Motion, film_duration, motion
from heliograph.channel.settings import ChannelSettings, Placement
from heliograph.channel.transfer import Transfer
from heliograph.channel.truth import NoiseModel, Truth

Patterns = Iterable[NDArray[np.uint8]]

BLOCK = 64
"""Frames whose poses are worked out together."""


def frame_count(settings: ChannelSettings) -> int:
    """Number of frames whose exposure ends within the film."""
    camera = settings.camera
    room = film_duration(settings) - camera.start_s - camera.exposure_s
    return max(0, math.floor(room / camera.frame_period_s + 1e-6) + 1)


def film(
    settings: ChannelSettings,
    lights: Sequence[Patterns],
    rng: np.random.Generator,
    *,
    pattern_period_s: float,
    slot_order: Sequence[int] = (0, 1, 2, 3),
    footage: Footage | None = None,
    imu: ImuTrace | None = None,
    roi_margin_px: int | None = None,
) -> Iterator[tuple[Frame, Truth]]:
    """Film arrays from a moving vehicle.

    Parameters
    ----------
    settings
        The channel.
    lights
        For each array of the settings its patterns in the order of time, (n, n) uint8 levels 0 to 4, possibly
        endless; dark before its start and after its end.
    rng
        Seeds the road, the drawn scene (and which LEDs fail) and the noise, in this order.
    pattern_period_s, slot_order
        T_b and the order of the PWM slots, as in the signal's settings.
    footage, imu
        Recordings for background.kind = "footage" and shake = "imu".
    roi_margin_px
        None: whole frames. Else only a window about all arrays with this margin, cut at the sensor's edges; its
        pixels are the same, noise included.

    Yields
    ------
    frame
        ``time_s`` is the camera's own clock: start_s + index / fps, but for jitter. A frame that was dropped leaves a
        gap in ``index``, and in the truth.
    truth
        What was filmed; of a repeated frame, what it would have shown.

    Raises
    ------
    SettingsError
        A recording is missing, the exposure is longer than T_b, or settings and lights do not fit.
    ValueError
        A pattern is malformed.
    """
    _check(settings, lights, pattern_period_s, slot_order, roi_margin_px)
    if settings.background.kind == "footage" and footage is None:
        raise SettingsError("background.kind = footage needs recorded frames: pass footage, or choose another kind")
    seeds = [int(s) for s in rng.integers(0, 2**63, 3)]
    arrays = [
        _lighting(
            place,
            PatternFeed(patterns, f"array {k}"),
            pattern_period_s,
            tuple(slot_order),
            np.random.default_rng([seeds[1], k]),
        )
        for k, (place, patterns) in enumerate(zip(settings.arrays, lights, strict=True))
    ]
    drive = motion(settings, imu, np.random.default_rng(seeds[0]))
    return _shoot(settings, arrays, drive, footage, seeds[1], seeds[2], roi_margin_px)


def _lighting(
    place: Placement, feed: PatternFeed, period_s: float, order: tuple[int, ...], rng: np.random.Generator
) -> Lighting:
    period_s *= 1 + place.clock_ppm * 1e-6
    return Lighting(feed, place.start_s, period_s, order, Faults.of(place, feed.side, rng))


def _check(
    settings: ChannelSettings, lights: Sequence[Patterns], period_s: float, order: Sequence[int], roi: int | None
) -> None:
    if len(lights) != len(settings.arrays):
        raise SettingsError(f"there is one stream of patterns an array: {len(settings.arrays)}, not {len(lights)}")
    if settings.camera.exposure_s > period_s * (1 + 1e-9):
        raise SettingsError(f"the exposure is at most T_b = {period_s:g} s, not {settings.camera.exposure_s:g} s")
    if sorted(order) != [0, 1, 2, 3]:
        raise SettingsError(f"the slot order is a permutation of 0 to 3, not {list(order)}")
    if roi is not None and roi < 0:
        raise SettingsError(f"roi_margin_px is at least 0, not {roi}")


def _shoot(
    settings: ChannelSettings,
    arrays: list[Lighting],
    drive: Motion,
    footage: Footage | None,
    scene_seed: int,
    noise_seed: int,
    roi: int | None,
) -> Iterator[tuple[Frame, Truth]]:
    # the kernels are imported with the first frame, so that the package costs nothing to import
    from heliograph.channel.background import background
    from heliograph.channel.render import Canvas, Stage, block_views, render, windows
    from heliograph.channel.sensor import read_out

    camera, noise = settings.camera, NoiseModel(settings.sensor)
    stage = Stage(settings, arrays, drive, background(settings, footage, np.random.default_rng(scene_seed)))
    total = frame_count(settings)
    whole = np.empty((camera.height, camera.width), np.float32)
    transfer = Transfer(camera, noise_seed)
    for first in range(0, total, BLOCK):
        block = block_views(stage, np.arange(first, min(first + BLOCK, total)))
        parts = windows(block, camera, roi)
        for k in range(len(block.index)):
            index = int(block.index[k])
            x, y, last_x, last_y = map(int, parts[k])
            light = whole if roi is None else np.empty((last_y - y + 1, last_x - x + 1), np.float32)
            truths = render(stage, block, k, Canvas(light, (x, y)))
            pixels = read_out(light, settings.sensor, noise_seed, index, (x, y))
            frame = Frame(index, camera.start_s + index / camera.fps, pixels, settings.sensor.bits, (x, y))
            delivered = transfer(frame)
            if delivered is not None:
                yield delivered, Truth(index, float(block.times_s[k, 0]), truths, noise)
