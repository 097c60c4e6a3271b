"""Display cells and the row timing of a rolling shutter."""

import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.config import from_mapping
from heliograph.base.frames import Frame
from heliograph.channel.camera import film
from heliograph.channel.settings import ChannelSettings
from heliograph.channel.truth import Truth

SIDE, PERIOD_S = 4, 0.1
SENSOR: dict[str, Any] = {"full_well_e": 1e7, "dark_noise_e": 0}
STILL = {
    "distance_m": 1.0, "speed_m_s": 0, "shake": "none", "arrays": [{"x_m": 0, "y_m": 0}], "sensor": SENSOR,
    "background": {"level": 0.0},
}  # fmt: skip
CAMERA = {"fps": 30, "exposure_s": 0.01, "width": 80, "height": 80, "focal_m": 0.005, "pixel_m": 1e-5, "blur_px": 0.3}
SCREEN = {"pitch_m": 0.02, "shape": "cell", "all_on": 0.8, "panel_level": 0.0}


def shoot(patterns: Iterable[int], frames: int, camera: Any, emitter: Any, **more: Any) -> list[Floats]:
    """Render films in which all cells show the same level sequence; full scale is 1."""
    scene = {"camera": {**CAMERA, **camera}, "emitter": {**SCREEN, **emitter}, "duration_s": frames / 30, **more}
    return [frame.pixels / 255 for frame, _ in film_of(scene, patterns)]


def film_of(changes: dict[str, Any], patterns: Iterable[int] = itertools.repeat(2)) -> list[tuple[Frame, Truth]]:
    settings = from_mapping(ChannelSettings, {**STILL, "camera": CAMERA, "emitter": SCREEN, **changes})
    lights = (np.full((SIDE, SIDE), level, np.uint8) for level in patterns)
    return list(film(settings, [lights], np.random.default_rng(3), pattern_period_s=PERIOD_S, steady=True))


def middle(image: NDArray[np.float64]) -> float:
    return float(image[38:42, 30:50].mean())


def test_a_level_is_a_luminance_and_gray_levels_are_those_of_the_gamma() -> None:
    for level in range(5):
        (image,) = shoot(itertools.repeat(level), 1, {}, {})
        assert image[25:55, 25:55] == pytest.approx(0.8 * level / 4, abs=0.004)
        assert image[:15].max() < 0.004
    (image,) = shoot(itertools.repeat(1), 1, {}, {}, sensor=SENSOR | {"gamma": 2.2})
    assert middle(image) == pytest.approx(0.2 ** (1 / 2.2), abs=0.005)


def test_a_slow_display_nears_a_level() -> None:
    tau = 0.02  # level 4 until 0.1 s, then 0: an exposure starting at 0.1 s averages exp(-t / tau)
    images = shoot([4, 4, 0, 0, 0], 9, {"start_s": 0.2 - 4 / 30 + 1e-9}, {"response_s": tau})
    assert middle(images[4]) == pytest.approx(0.8 * tau / 0.01 * (1 - np.exp(-0.01 / tau)), abs=0.004)


def test_a_switched_backlight_shows_as_bands() -> None:
    rolled = {"row_time_s": 2e-4, "exposure_s": 1e-3}
    (image,) = shoot(itertools.repeat(4), 1, rolled, {"backlight_hz": 250.0, "backlight_duty": 0.5})
    rows = image[25:55, 30:50].mean(1)
    assert rows.min() < 0.05  # 4 ms span 20 rows; the mean is unchanged
    assert np.ptp(rows) > 0.9
    whole = shoot(itertools.repeat(4), 1, {"exposure_s": 0.012}, {"backlight_hz": 250.0, "backlight_duty": 0.5})[0]
    assert middle(whole) == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize("shape", ["cell", "disc"])
def test_a_row_sees_a_pattern_at_its_own_time(shape: str) -> None:
    rolled = {"row_time_s": 4e-4, "exposure_s": 1e-3, "start_s": 0.1 - 0.4 * 0.04}
    (image,) = shoot([4, 0, 0, 0, 0], 1 + 3, rolled, {"shape": shape})[:1]
    rows = image[20:60, 20:60].mean(1)
    assert (rows[21:] < 0.01).all()  # row 40 starts exposure at 0.1 s, when level 4 has ended
    assert rows[:18].max() > 0.1


def test_the_display_takes_a_pattern_row_by_row() -> None:
    (image,) = shoot([0, 4, 4, 4], 4, {"exposure_s": 1e-3, "start_s": 0.1 + 0.025}, {"scan_s": 0.04})[:1]
    # cell rows update after 0, 10, 20 and 30 ms
    levels = [float(image[y - 2 : y + 3, 30:50].mean()) for y in (25, 35, 45, 55)]
    assert levels == pytest.approx([0.8, 0.8, 0.8, 0.0], abs=0.02)


def test_automatic_exposure_swings() -> None:
    images = shoot(itertools.repeat(2), 30, {"gain_swing": 0.2, "gain_period_s": 1.0}, {})
    light = np.array([middle(image) for image in images])
    assert (light.max(), light.min()) == (pytest.approx(0.48, abs=0.01), pytest.approx(0.32, abs=0.01))


def test_white_balance_changes_light_by_its_colour_and_hardly_white() -> None:
    camera = {"white_balance_swing": 0.3, "white_balance_period_s": 1.0, "gain_swing": 0.1, "gain_period_s": 0.5}
    exposure = 1 + 0.1 * np.sin(4 * np.pi * (np.arange(30) / 30 + 0.005))
    # red gain follows the swing, blue the opposite swing, green stays constant
    swing = 0.3 * np.sin(2 * np.pi * (np.arange(30) / 30 + 0.005))
    for colour, gain in (((1, 0, 0), 1 + swing), ((0, 2, 0), 1 + 0 * swing), ((0, 0, 0.5), 1 - swing)):
        background = {"level": 0.3, "colour": (0, 1, 0)}
        images = shoot(itertools.repeat(2), 30, camera, {"colour": colour}, background=background)
        assert [middle(image) for image in images] == pytest.approx(0.4 * gain * exposure, abs=0.004)
        assert [float(image[:10].mean()) for image in images] == pytest.approx(0.3 * exposure, abs=0.004)
    camera = {"white_balance_swing": 0.2, "white_balance_period_s": 1.0}
    sensor = SENSOR | {"gamma": 2.2}
    light = np.array([middle(one) ** 2.2 for one in shoot(itertools.repeat(2), 30, camera, {}, sensor=sensor)])
    assert 0.02 < np.ptp(light) / 0.4 < 0.08  # luma weights: 0.21 red, 0.07 blue


def test_time_stamps_reveal_a_variable_frame_rate() -> None:
    shot = film_of({"duration_s": 1.0, "camera": {**CAMERA, "uneven_s": 0.004}})
    assert 0.002 < np.array([frame.time_s - frame.index / 30 for frame, _ in shot]).std() < 0.006
    assert [truth.time_s for _, truth in shot] == pytest.approx([frame.time_s for frame, _ in shot])


def test_a_hand_sways() -> None:
    shot = film_of({"shake": "hand", "hand_deg": 0.5, "duration_s": 3.0})
    x = np.array([truth.arrays[0].x for _, truth in shot])
    assert 1.5 < x.std() < 9  # 500 px focal length times 0.5 degrees
