"""Channel simulation: LED patterns to camera frames and truth."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.channel.background import Footage, Scenery
from heliograph.channel.exposure import Faults, Lighting, PatternFeed
from heliograph.channel.motion import ImuTrace, film_duration, motion
from heliograph.channel.parts import BACKGROUNDS
from heliograph.channel.render import Canvas, StillLight, render, surroundings_gain
from heliograph.channel.sensor import read_out
from heliograph.channel.settings import EXPOSURE_SLACK, MAX_JITTER, CameraSettings, ChannelSettings
from heliograph.channel.truth import NoiseModel, Truth
from heliograph.channel.views import FilmScene, frame_block, windows
from heliograph.channel.weather import Windscreen, glare


def frame_count(settings: ChannelSettings) -> int:
    """Return the number of complete exposures in the film, dropped frames included."""
    camera = settings.camera
    room = film_duration(settings) - camera.start_s - camera.exposure_s
    return max(0, math.floor(room / camera.frame_period_s + 1e-6) + 1)  # 1e-6: rounding


def film(
    settings: ChannelSettings,
    lights: Sequence[Iterable[NDArray[np.uint8]]],
    rng: np.random.Generator,
    *,
    pattern_period_s: float,
    slot_order: Sequence[int] = (0, 1, 2, 3),
    steady: bool = False,
    footage: Footage | None = None,
    imu: ImuTrace | None = None,
    roi_margin_px: int | None = None,
) -> Iterator[tuple[Frame, Truth]]:
    """Simulate a film of arrays, given as patterns of (n, n) uint8 levels 0 to 4, from a moving vehicle."""
    if len(lights) != len(settings.arrays):
        raise SettingsError(f"expected a pattern stream per array: {len(settings.arrays)}, not {len(lights)}")
    camera = settings.camera
    if camera.exposure_s > pattern_period_s * (1 + EXPOSURE_SLACK):
        raise SettingsError(f"the exposure is at most T_b = {pattern_period_s:g} s, not {camera.exposure_s:g} s")
    if roi_margin_px is not None and roi_margin_px < 0:
        raise SettingsError(f"roi_margin_px is at least 0, not {roi_margin_px}")
    seeds = [int(s) for s in rng.integers(0, 2**63, 3)]
    arrays = []
    for k, (place, patterns) in enumerate(zip(settings.arrays, lights, strict=True)):
        feed = PatternFeed(patterns, f"array {k}")
        period_s = pattern_period_s * (1 + place.clock_ppm * 1e-6)
        faults = Faults.of(place, feed.side, np.random.default_rng([seeds[1], k]))
        arrays.append(Lighting(feed, place.start_s, period_s, tuple(slot_order), faults, steady))
    drive = motion(settings, imu, np.random.default_rng(seeds[0]))
    paint = BACKGROUNDS[settings.background.kind](Scenery(settings, footage, np.random.default_rng(seeds[1])))
    return _shoot(FilmScene(settings, arrays, drive, paint, seeds[2]), roi_margin_px)


def _shoot(scene: FilmScene, roi: int | None) -> Iterator[tuple[Frame, Truth]]:
    settings, camera, noise = scene.settings, scene.settings.camera, NoiseModel(scene.settings.sensor)
    total = frame_count(settings)
    full = np.empty((camera.height, camera.width), np.float32)
    transfer, still = Transfer(camera, scene.seed), StillLight(scene)
    weather, faults = settings.weather, tuple(lighting.faults for lighting in scene.lightings)
    windscreen = Windscreen(settings, scene.seed) if weather.rain_mm_h and weather.windscreen_m else None
    veil = glare(settings) if weather.glare else None
    for first in range(0, total, 64):  # poses are computed in blocks
        block = frame_block(scene, np.arange(first, min(first + 64, total)))
        parts = windows(block, camera, roi)
        static = still.take(block, parts)
        for k in range(len(block.index)):
            index = int(block.index[k])
            x, y, last_x, last_y = map(int, parts[k])
            light = full if roi is None else np.empty((last_y - y + 1, last_x - x + 1), np.float32)
            canvas = Canvas(light, (x, y))
            truths = still.render(block, k, canvas) if static else render(scene, block, k, canvas)
            time_s = float(block.times_s[k, 1])
            if windscreen is not None:
                windscreen.look_through(light, (x, y), time_s)
            if veil is not None:
                light += veil[y : last_y + 1, x : last_x + 1]
            if camera.gain_swing or camera.white_balance_swing:
                light *= np.float32(camera.gain(time_s) * surroundings_gain(settings, time_s))
            pixels = read_out(light, settings.sensor, scene.seed, index, (x, y))
            pixels.setflags(write=False)  # receivers copy writable pixels
            stamp_s = camera.start_s + index / camera.fps + float(block.late_s[k])
            delivered = transfer(Frame(index, stamp_s, pixels, settings.sensor.bits, (x, y)))
            if delivered is not None:
                yield delivered, Truth(delivered.index, float(block.times_s[k, 0]), truths, noise, faults)


class Transfer:
    """Frame transfer; faults depend on the seed and the frame number only.

    With ``gaps`` off, delivered frames have consecutive numbers and times.
    """

    def __init__(self, camera: CameraSettings, seed: int):
        self._camera, self._seed = camera, seed
        self._last: Frame | None = None
        self._lost = 0

    def __call__(self, frame: Frame) -> Frame | None:
        """Return the delivered frame; None for a dropped frame."""
        camera = self._camera
        if not (camera.dropped or camera.repeated or camera.jitter_s):
            return frame
        rng = np.random.default_rng([self._seed, frame.index])
        draw, late = rng.random(), rng.normal(0.0, camera.jitter_s)
        if draw < camera.dropped:
            self._lost += not camera.gaps
            return None
        limit = MAX_JITTER / camera.fps
        time_s = frame.time_s - self._lost / camera.fps + float(np.clip(late, -limit, limit))
        source = self._last if self._last is not None and draw < camera.dropped + camera.repeated else frame
        self._last = replace(source, index=frame.index - self._lost, time_s=time_s)
        return self._last
