"""Channel: timing, windows, ground truth, impaired arrays and rejected settings."""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.channel.background import Footage
from heliograph.channel.camera import film, frame_count
from heliograph.channel.settings import (
    BackgroundSettings,
    CameraSettings,
    ChannelSettings,
    EmitterSettings,
    Placement,
    SensorSettings,
)
from heliograph.channel.truth import Truth

Light = Iterator[NDArray[np.uint8]]
T_B = 1e-3
FINE = SensorSettings(full_well_e=1e7, dark_noise_e=0, bits=12)  # a nearly noiseless sensor


def patterns(seed: int = 0, side: int = 16) -> Light:
    rng = np.random.default_rng(seed)
    return (rng.integers(0, 5, (side, side)).astype(np.uint8) for _ in itertools.count())


def constant(level: int, side: int = 16) -> Light:
    return itertools.repeat(np.full((side, side), level, np.uint8))


def still(**changes: object) -> ChannelSettings:
    return from_mapping(ChannelSettings, {"speed_m_s": 0, "duration_s": 0.003, **changes})


def shoot(settings: ChannelSettings, *lights: Light, seed: int = 7, **more: Any) -> list[tuple[Frame, Truth]]:
    lights = lights or tuple(patterns(k) for k in range(len(settings.arrays)))
    return list(film(settings, lights, np.random.default_rng(seed), pattern_period_s=T_B, **more))


def footage(frames: int = 5, seed: int = 3) -> Footage:
    clip = np.random.default_rng(seed).integers(0, 256, (frames, 90, 160)).astype(np.uint8)
    return Footage(lambda: iter(clip), 25.0)


@pytest.mark.parametrize(("kind", "bits"), [("flat", 8), ("synthetic", 12), ("footage", 8)])
@pytest.mark.slow
def test_window_is_the_frame_bit_for_bit(kind: str, bits: int) -> None:
    second = Placement(x_m=1.1, z_offset_m=7, yaw_deg=20, clock_ppm=80, start_s=0.0103)
    settings = ChannelSettings(
        distance_m=31, duration_s=0.02, shake="road", road_class="D", background=BackgroundSettings(kind=kind),
        arrays=(Placement(roll_deg=3), second), sensor=SensorSettings(bits=bits, dark_noise_e=0 if bits == 12 else 40),
        camera=CameraSettings(fps=250, width=320, height=256, exposure_s=0.9e-3),
    )  # fmt: skip
    more: dict[str, Any] = {"footage": footage()} if kind == "footage" else {}
    whole, part = shoot(settings, **more), shoot(settings, roi_margin_px=5, **more)
    assert len(whole) == len(part) == 5
    for (frame, truth), (window, same) in zip(whole, part, strict=True):
        x, y = window.origin
        height, width = window.pixels.shape
        assert 20 < height < 256
        assert np.array_equal(window.pixels, frame.pixels[y : y + height, x : x + width])
        assert (frame.index, frame.time_s, frame.bits) == (window.index, window.time_s, window.bits)
        assert [a.patterns for a in truth.arrays] == [a.patterns for a in same.arrays]


def test_array_behind_the_camera_is_not_seen_and_a_window_without_arrays_is_a_pixel() -> None:
    settings = ChannelSettings(distance_m=1.0, duration_s=0.2)
    assert not shoot(settings, roi_margin_px=3)[-1][1].arrays[0].visible
    flat = ChannelSettings(distance_m=40, speed_m_s=0, duration_s=0.001, arrays=())
    assert shoot(flat, roi_margin_px=3)[0][0].pixels.shape == (1, 1)


@pytest.mark.parametrize("distance_m", [60.0, 80.0, 150.0])
def test_unresolved_array_has_the_surface_brightness_all_on(distance_m: float) -> None:
    settings = still(distance_m=distance_m, arrays=[{"x_m": 0, "y_m": 0, "brightness": 0.5}])
    settings = replace(settings, sensor=FINE, emitter=EmitterSettings(panel_level=0))
    frame, truth = shoot(settings, constant(4))[0]
    x, y, pitch = truth.arrays[0].x, truth.arrays[0].y, truth.arrays[0].pitch_px
    half = round(3 * pitch)
    patch = frame.pixels[round(y) - half : round(y) + half + 1, round(x) - half : round(x) + half + 1] / 4095
    assert patch.mean() == pytest.approx(0.4, rel=0.02)


def light_of_levels(**changes: Any) -> list[float]:
    """Return the sum of gray levels for each level of an array at the centre."""
    settings = replace(still(arrays=[{"x_m": 0, "y_m": 0}]), sensor=FINE, **changes)
    return [float(shoot(settings, constant(level))[0][0].pixels.astype(float).sum()) for level in range(5)]


def test_levels_are_fractions_of_the_exposure_and_short_exposures_read_the_slots_they_see() -> None:
    light = light_of_levels()
    assert np.diff(light) == pytest.approx(np.full(4, (light[4] - light[0]) / 4), rel=1e-3)
    # an exposure of T_b / 4 from 0.5 ms covers slot 2: dark at level 2, lit at level 3
    light = light_of_levels(camera=CameraSettings(exposure_s=0.25e-3, start_s=0.5e-3))
    assert light == pytest.approx([light[0]] * 3 + [light[4]] * 2, rel=1e-4)
    assert light[4] > light[0] * 1.001


def test_dark_before_the_start_and_after_the_end() -> None:
    settings = still(duration_s=0.006, arrays=[{"x_m": 0, "y_m": 0, "start_s": 0.0015}])
    truths = [truth for _, truth in shoot(settings, itertools.islice(patterns(), 3))]
    assert [t.arrays[0].patterns for t in truths] == [(), (0,), (0, 1), (1, 2), (2,), ()]


def test_clocks_drift_apart() -> None:
    small: dict[str, Any] = {"width": 32, "height": 16}
    settings = still(duration_s=0.3, camera=small, arrays=[{"clock_ppm": 5000.0}])
    truths = [truth for _, truth in shoot(settings)]
    assert truths[299].arrays[0].patterns == (297, 298) or truths[299].arrays[0].patterns == (297,)
    filmed = shoot(replace(settings, camera=CameraSettings(**small, clock_ppm=5000.0)))
    assert all(t.arrays[0].patterns == (t.index,) for _, t in filmed)
    assert filmed[200][0].time_s == pytest.approx(0.2)
    assert filmed[200][1].time_s == pytest.approx(0.201)


def test_truth_is_where_the_light_is() -> None:
    placement = Placement(x_m=0.7, y_m=-0.4, roll_deg=10, yaw_deg=15)
    emitter = EmitterSettings(half_angle_deg=89.9)
    scene = ChannelSettings(distance_m=30, duration_s=0.05, shake="road", arrays=(placement,))
    dark = replace(scene, sensor=FINE, emitter=emitter, background=BackgroundSettings(level=0.02))
    for frame, truth in shoot(dark, constant(4), roi_margin_px=6)[::10]:
        array, light = truth.arrays[0], frame.pixels - 82.0
        rows, columns = np.indices(light.shape)
        centre = [(light * places).sum() / light.sum() for places in (columns, rows)]  # the near side is brighter
        assert np.add(frame.origin, centre) == pytest.approx([array.x, array.y], abs=0.03)
        corner = array.homography @ np.array([0.1, 0.0, 1.0])
        right = corner[:2] / corner[2] - (array.x, array.y)
        assert np.arctan2(right[1], right[0]) == pytest.approx(array.roll_rad, abs=1e-3)
        assert array.visible
        pitch_px = 0.02 * 0.035 / 12e-6 / array.distance_m * np.cos(np.radians(15)) ** 0.5
        assert array.pitch_px == pytest.approx(pitch_px, rel=2e-2)


def test_an_array_that_comes_too_near_for_its_speed_is_refused() -> None:
    # without lateral motion the settings cannot bound the image: array size and shake are unknown
    camera = CameraSettings(width=32, height=32, focal_m=0.5)
    settings = still(distance_m=2, arrays=(Placement(x_m=0, y_m=0, vz_m_s=-1000),), camera=camera)
    with pytest.raises(SettingsError, match=r"array 0 moves .* px in the exposure at 0 s, at most 1000: .*vz_m_s"):
        shoot(settings)


@pytest.mark.parametrize(("vx_m_s", "level"), [(2.0, 2), (12.0, 4)])
@pytest.mark.slow
def test_long_exposure_is_the_mean_of_short_ones(vx_m_s: float, level: int) -> None:
    parts = 20  # (6): integral over the open shutter, along the motion (0.2 and 1.2 px) and over PWM slots
    small = CameraSettings(width=128, height=96)
    unsaturated = Placement(x_m=0, y_m=0, vx_m_s=vx_m_s, vy_m_s=1, brightness=0.3)
    as_panel = BackgroundSettings(level=0.02)  # the panel is drawn at mid-exposure pose
    scene = still(distance_m=30, duration_s=1.5e-3)
    base = replace(scene, arrays=(unsaturated,), camera=small, sensor=FINE, background=as_panel)
    whole = shoot(base, constant(level))[0][0].pixels
    mean = np.zeros(whole.shape)
    for k in range(parts):
        camera = replace(small, exposure_s=1e-3 / parts, start_s=k * 1e-3 / parts)
        mean += shoot(replace(base, camera=camera), constant(level))[0][0].pixels / parts
    assert np.abs(whole - mean).max() < 0.001 * 4095
    assert whole.max() > 800


def test_default_drive_is_the_reference_link() -> None:
    assert frame_count(ChannelSettings()) == 6600
    frames = film(ChannelSettings(), [patterns()], np.random.default_rng(0), pattern_period_s=T_B, roi_margin_px=2)
    first: Truth = next(frames)[1]
    assert first.arrays[0].distance_m == pytest.approx(80, abs=0.01)
    assert first.arrays[0].patterns == (0,)
    assert first.arrays[0].pitch_px == pytest.approx(0.729, abs=1e-3)
    assert first.noise.sigma(0.4) == pytest.approx(0.006, rel=0.05)


def test_near_panel_hides_a_far_array() -> None:
    two = [{"x_m": 0, "y_m": 0, "z_offset_m": 20}, {"x_m": 0, "y_m": 0}]
    settings = replace(still(arrays=two, distance_m=20), sensor=FINE)
    hidden = shoot(settings, constant(4), constant(0))[0][0].pixels
    alone = shoot(settings, constant(0), constant(0))[0][0].pixels
    assert np.abs(hidden.astype(int) - alone).max() <= 16
    assert hidden[255, 511] / 4095 == pytest.approx(settings.emitter.panel_level, abs=1e-3)


NEAR = {
    "distance_m": 10, "speed_m_s": 0, "shake": "none", "camera": {"width": 160, "height": 160},
    "sensor": {"full_well_e": 1e7, "dark_noise_e": 0},
}  # fmt: skip
"""LED pitch 5.8 px, so that LED images do not overlap."""


def shoot_near(level: int, frames: int = 1, **place: Any) -> list[NDArray[np.float64]]:
    scene = {**NEAR, "duration_s": 1e-3 * frames, "arrays": [{"x_m": 0, "y_m": 0, "brightness": 0.1, **place}]}
    settings = from_mapping(ChannelSettings, scene)
    return [frame.pixels.astype(float) for frame, _ in shoot(settings, constant(level), seed=3)]


def at_leds(image: NDArray[np.float64]) -> NDArray[np.float64]:
    at = np.round(79.5 + (np.arange(16) - 7.5) * 35 / 12 * 20 / 10).astype(int)
    return np.asarray(image[np.ix_(at, at)])


def leds(level: int, **place: Any) -> NDArray[np.bool_]:
    """Return the mask of lit LEDs."""
    return np.asarray(at_leds(shoot_near(level, **place)[0]) > 20)


def test_dead_leds_stay_dark_and_stuck_ones_lit() -> None:
    lit, dark = (leds(level, dead=0.05, stuck=0.025) for level in (4, 0))
    assert ((~lit).sum(), dark.sum()) == (round(0.05 * 256), round(0.025 * 256))
    assert not (dark & ~lit).any()


def test_leds_differ_by_their_spread() -> None:
    even, first, second = (shoot_near(4, 2, spread=spread)[k] for spread, k in ((0.0, 0), (0.2, 0), (0.2, 1)))
    gains = [at_leds(frame) / at_leds(even) for frame in (first, second)]
    assert (gains[0].std(), gains[0].mean()) == (pytest.approx(0.2, rel=0.15), pytest.approx(1, abs=0.04))
    assert np.abs(gains[1] - gains[0]).max() < 0.05


def test_dark_while_it_is_off() -> None:
    frames = shoot_near(4, 5, off_s=[(0.001, 0.0025), (0.0042, 0.0044)], stuck=0.1)
    light = np.array([frame.sum() - shoot_near(0)[0].sum() for frame in frames])
    assert light / light[0] == pytest.approx([1.0, 0.0, 0.5, 1.0, 0.8], abs=0.01)


def test_a_part_is_hidden_by_something_of_its_own_light() -> None:
    image = shoot_near(4, hidden=(0.0, 0.5, 0.25, 1.0), hidden_level=0.3)[0]
    part = np.zeros((16, 16), bool)
    part[8:, :4] = True
    seen = at_leds(image)
    assert seen[part] == pytest.approx(0.3 * 255, abs=1)
    assert not np.isclose(seen[~part], 0.3 * 255, atol=1).any()


def test_car_at_100_m_s_passes_the_reference_drive() -> None:
    settings = ChannelSettings(speed_m_s=100.0, camera=CameraSettings(width=64, height=64))
    assert frame_count(settings) == 550
    *_, (_, truth) = shoot(settings, constant(0), roi_margin_px=2)
    assert truth.arrays[0].distance_m == pytest.approx(80 - 100 * 0.5495, abs=0.01)


@pytest.mark.parametrize(("speed", "rate"), [(0, -10), (25, 15)])
def test_an_array_drives_away(speed: float, rate: float) -> None:
    scene = {**NEAR, "speed_m_s": 10, "distance_m": 30, "duration_s": 0.01, "arrays": [{"vz_m_s": speed}]}
    *_, (_, truth) = shoot(from_mapping(ChannelSettings, scene), constant(0))
    assert truth.arrays[0].distance_m == pytest.approx(30 + rate * 0.0095, abs=1e-6)


@pytest.mark.parametrize(("change", "message"), [
    ({"camera": {"exposure_s": 2e-3}}, "exposure_s is at most 1 / fps = 0.001 s, not 0.002 s"),
    ({"camera": {"row_time_s": 1e-3}}, "row_time_s times height is at most 1 / fps"),
    ({"camera": {"exposure": 1}}, "did you mean 'camera.exposure_s'"),
    ({"camera": {"dropped": 1.0}}, "camera.dropped"), ({"camera": {"repeated": -0.1}}, "camera.repeated"),
    ({"camera": {"jitter_s": -1e-6}}, "camera.jitter_s"),
    ({"camera": {"dropped": 0.6, "repeated": 0.5}}, "below 1 together"),
    ({"distance_m": 20}, "stop_m is below distance_m"), ({"speed_m_s": 101}, "speed_m_s': input should be less"),
    ({"speed_profile": [[1, 2], [0, 3]]}, "times of speed_profile rise"),
    ({"speed_profile": [[1, -2]]}, "speeds are at least 0, not -2"),
    ({"emitter": {"diameter_m": 0.03}}, "diameter_m is at most pitch_m"),
    ({"emitter": {"shape": "disc", "response_s": 0.01}}, "apply to a screen"),
    ({"emitter": {"colour": (0, 0, 0)}}, "a colour has red, green or blue above 0"),
    ({"sensor": {"bits": 16}}, "less than or equal to 12"), ({"shake": "waves"}, "shake"),
    ({"arrays": [{"dead": 0.6, "stuck": 0.5}]}, "at most 1 together"),
    ({"arrays": [{"hidden": (0.5, 0, 0.5, 1)}]}, "left < right"), ({"arrays": [{"hidden": (0.5, 0)}]}, "hidden"),
    ({"arrays": [{"off_s": [(0.2, 0.1)]}]}, "from < to"),
])  # fmt: skip
def test_invalid_settings_are_refused_in_one_line(change: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError) as caught:
        from_mapping(ChannelSettings, change)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("change", "arguments", "message"), [
    ({}, {"lights": [patterns(), patterns()]}, r"a pattern stream per array: 1, not 2"),
    ({}, {"pattern_period_s": 5e-4}, r"exposure is at most T_b = 0.0005 s"),
    ({"background": {"kind": "footage"}}, {}, r"pass footage"), ({"shake": "imu"}, {}, r"pass imu"),
    ({}, {"roi_margin_px": -1}, r"at least 0, not -1"), ({}, {"lights": [iter(())]}, r"has no patterns"),
    ({}, {"lights": [constant(5)]}, r"levels of array 0 are 0 to 4, not 5"),
    ({}, {"lights": [iter([np.zeros((4, 8), np.uint8)])]}, r"\(n, n\) uint8"),
    ({"duration_s": None, "speed_profile": ((0, 1), (1, 0))}, {}, r"does not drive 55 m"),
])  # fmt: skip
def test_settings_that_do_not_fit_the_inputs_are_refused(change: Any, arguments: Any, message: str) -> None:
    given = {"lights": [patterns()], "rng": np.random.default_rng(0), "pattern_period_s": T_B, **arguments}
    with pytest.raises(ValueError, match=message):
        film(still(**change), **given)
