"""Static scenes as sums of LED images, against frame-by-frame rendering."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.config import from_mapping
from heliograph.channel.background import Scenery
from heliograph.channel.exposure import Faults, Lighting, PatternFeed
from heliograph.channel.motion import motion
from heliograph.channel.parts import BACKGROUNDS
from heliograph.channel.render import Canvas, StillLight, render
from heliograph.channel.settings import ChannelSettings
from heliograph.channel.views import FilmScene, frame_block, windows

FAULTS = {"x_m": 0, "y_m": 0, "dead": 0.05, "stuck": 0.05, "spread": 0.2, "clock_ppm": 200.0, "yaw_deg": 12.0}
HIDDEN = {"x_m": 0.1, "y_m": 0, "hidden": (0.0, 0.0, 0.4, 0.5), "off_s": ((0.0012, 0.0025),), "roll_deg": 3.0}


def patterns(seed: int) -> Iterator[NDArray[np.uint8]]:
    rng = np.random.default_rng(seed)
    return (rng.integers(0, 5, (16, 16)).astype(np.uint8) for _ in itertools.count())


def scene_of(**changes: Any) -> FilmScene:
    settings = from_mapping(ChannelSettings, {"speed_m_s": 0, "shake": "none", "duration_s": 0.01, **changes})
    lightings = []
    for k, place in enumerate(settings.arrays):
        faults, period_s = Faults.of(place, 16, np.random.default_rng(k)), 1e-3 * (1 + place.clock_ppm * 1e-6)
        feed = PatternFeed(patterns(k), f"array {k}")
        lightings.append(Lighting(feed, place.start_s, period_s, (0, 1, 2, 3), faults))
    drive = motion(settings, None, np.random.default_rng(0))
    paint = BACKGROUNDS[settings.background.kind](Scenery(settings, None, np.random.default_rng(1)))
    return FilmScene(settings, lightings, drive, paint)


@pytest.mark.parametrize(("changes", "roi"), [
    ({"distance_m": 80.0}, None),
    ({"distance_m": 20.0, "arrays": [FAULTS, {**HIDDEN, "x_m": 0.9}], "camera": {"start_s": 3e-4}}, 4),
    ({"distance_m": 4.0, "arrays": [{"x_m": 0, "y_m": 0, "yaw_deg": 30.0, "pitch_deg": 20.0}]}, None),
    ({"distance_m": 45.0, "arrays": [HIDDEN], "camera": {"psf": "halo"}, "background": {"kind": "synthetic"}}, 4),
    ({"distance_m": 50.0, "arrays": [FAULTS, {**HIDDEN, "x_m": 1.9}], "weather": {"visibility_m": 100.0}}, None),
])  # fmt: skip
def test_sums_are_the_light_rendered_frame_by_frame(changes: dict[str, Any], roi: int | None) -> None:
    scene = scene_of(**changes)
    block = frame_block(scene, np.arange(4))
    parts, still = windows(block, scene.settings.camera, roi), StillLight(scene)
    assert still.take(block, parts)
    x, y, last_x, last_y = map(int, parts[0])
    for k in range(4):
        made, exact = (Canvas(np.empty((last_y - y + 1, last_x - x + 1), np.float32), (x, y)) for _ in range(2))
        truths, expected = still.render(block, k, made), render(scene, block, k, exact)
        assert [one.patterns for one in truths] == [one.patterns for one in expected]
        assert np.abs(made.light - exact.light).max() < 5e-6 * max(1.0, float(exact.light.max()))
        assert np.ptp(exact.light) > 0.05


@pytest.mark.parametrize("changes", [
    {"speed_m_s": 10.0, "distance_m": 60.0}, {"arrays": [{"vx_m_s": 1.0}]}, {"camera": {"row_time_s": 1e-6}},
    {"arrays": [{"x_m": 0, "y_m": 0}, {"x_m": 0.05, "y_m": 0, "z_offset_m": 3.0}]},  # overlapping arrays
])  # fmt: skip
def test_scenes_without_a_common_sum_are_rendered_frame_by_frame(changes: dict[str, Any]) -> None:
    scene = scene_of(**changes)
    block = frame_block(scene, np.arange(4))
    assert not StillLight(scene).take(block, windows(block, scene.settings.camera, 4))


def test_scene_that_starts_to_move_is_searched_again() -> None:
    scene = scene_of(distance_m=60.0, speed_profile=[(0.0, 0.0), (0.05, 0.0), (0.1, 20.0)], duration_s=0.2)
    still, camera = StillLight(scene), scene.settings.camera
    blocks = [frame_block(scene, np.arange(k, k + 10)) for k in (0, 40, 60)]
    assert [still.take(block, windows(block, camera, 4)) for block in blocks] == [True, True, False]
