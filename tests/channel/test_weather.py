"""Weather against the equations: extinction, airlight and halo of fog; glare; rain."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.channel.camera import film
from heliograph.channel.settings import ChannelSettings, WeatherSettings
from heliograph.channel.weather import (
    DIFFRACTED,
    WAVELENGTH_M,
    Windscreen,
    common_area,
    extinction,
    scattered,
    transmission,
)

STILL = {
    "distance_m": 60.0, "speed_m_s": 0, "shake": "none", "duration_s": 1e-3,
    "arrays": [{"x_m": 0, "y_m": 0, "brightness": 0.5}], "sensor": {"full_well_e": 1e7, "dark_noise_e": 0, "bits": 12},
}  # fmt: skip
FOG: dict[str, Any] = {"visibility_m": 100.0, "airlight": 0.4}


def shoot(weather: dict[str, Any], level: int = 4, roi: int | None = None, **changes: Any) -> list[NDArray[Any]]:
    """Return the frames of arrays of a constant level in full scales."""
    settings = from_mapping(ChannelSettings, {**STILL, **changes, "weather": weather})
    lights = [itertools.repeat(np.full((16, 16), level, np.uint8)) for _ in settings.arrays]
    frames = film(settings, lights, np.random.default_rng(2), pattern_period_s=1e-3, roi_margin_px=roi)
    return [frame.pixels / settings.sensor.full_scale for frame, _ in frames]


def array_light(weather: dict[str, Any], **changes: Any) -> NDArray[Any]:
    """Return the light of the LEDs without ambient light."""
    return np.asarray(shoot(weather, 4, **changes)[0] - shoot(weather, 0, **changes)[0])


def test_weather_is_clear_by_default() -> None:
    dry = {"airlight": 3.0, "background_m": 2.0, "droplet_m": 1e-6, "sun_deg": (0.0, 1.0), "wiper_s": 0.1}
    moving: dict[str, Any] = {"speed_m_s": 20.0, "shake": "road", "duration_s": 0.02, "background": {"kind": "street"}}
    for one, other in zip(shoot({}, **moving), shoot(dry, **moving), strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize("visibility_m", [50.0, 1000.0])
def test_light_falls_to_a_twentieth_over_the_optical_range(visibility_m: float) -> None:
    weather = WeatherSettings(visibility_m=visibility_m)
    assert extinction(weather) == pytest.approx(2.996 / visibility_m, rel=1e-4)
    assert transmission(weather, visibility_m) == pytest.approx(0.05)
    assert (extinction(WeatherSettings()), transmission(WeatherSettings(), 1e4)) == (0.0, 1.0)


@pytest.mark.parametrize("distance_m", [40.0, 80.0])
def test_arrays_fade_as_koschmieder_says(distance_m: float) -> None:
    fog, clear = (array_light(weather, distance_m=distance_m) for weather in (FOG, {}))
    share, angle = scattered(WeatherSettings(**FOG), distance_m)
    halo = share * clear.sum() / (2 * math.pi * (angle * 0.035 / 12e-6) ** 2)
    centre = slice(250, 262), slice(506, 518)
    direct = fog[centre].mean() - halo
    assert direct / clear[centre].mean() == pytest.approx(math.exp(-2.9957 / 100 * distance_m), rel=2e-3)


@pytest.mark.parametrize("at", ["background", "panel"])
def test_contrast_to_the_horizon_is_a_twentieth_at_the_optical_range(at: str) -> None:
    black: dict[str, Any] = {"arrays": [], "background": {"level": 0.0}}
    if at == "panel":
        black = {"distance_m": 20.0, "emitter": {"panel_level": 0.0, "panel_margin_m": 1.0}}
    weather = {"visibility_m": 200.0 if at == "background" else 20.0, "airlight": 0.4, "background_m": 200.0}
    assert 1 - shoot(weather, 0, **black)[0][255, 511] / 0.4 == pytest.approx(0.05, abs=2e-3)


@pytest.mark.parametrize(("visibility_m", "distance_m"), [(100.0, 20.0), (50.0, 80.0)])
def test_halo_has_share_and_width_of_random_small_angles(visibility_m: float, distance_m: float) -> None:
    weather, rng = WeatherSettings(visibility_m=visibility_m, droplet_m=2e-5), np.random.default_rng(0)
    depth = extinction(weather) * distance_m
    counts = rng.poisson(DIFFRACTED * depth, 200_000)
    theta = math.sqrt(2) * WAVELENGTH_M / (math.pi * weather.droplet_m)
    turns = theta * rng.standard_normal(counts.sum()) * rng.random(counts.sum())  # seen at a fraction of the way
    seen_at = np.bincount(np.repeat(np.arange(len(counts)), counts), turns, len(counts))
    share, angle = scattered(weather, distance_m)
    lost = math.exp(-(1 - DIFFRACTED) * depth)
    assert share / lost == pytest.approx((counts > 0).mean(), rel=0.01)
    assert angle == pytest.approx(seen_at[counts > 0].std(), rel=0.01)
    assert share + transmission(weather, distance_m) == pytest.approx(lost)


@pytest.mark.parametrize("changes", [
    {}, {"arrays": [{"x_m": 0, "y_m": 0, "brightness": 0.5, "vx_m_s": 5.0, "yaw_deg": 20.0}]},
    {"emitter": {"shape": "cell"}}, {"camera": {"row_time_s": 1e-6}},
])  # fmt: skip
def test_direct_light_and_halo_have_the_light_that_is_not_refracted(changes: dict[str, Any]) -> None:
    changes = {"background": {"level": 0.02}, "distance_m": 30.0, **changes}
    fog, clear = (array_light(weather, **changes) for weather in (FOG, {}))
    depth = 2.9957 / 100 * 30
    # rounding of 12 bits cuts the edge of the halo
    assert fog.sum() / clear.sum() == pytest.approx(math.exp(-(1 - DIFFRACTED) * depth), rel=0.02)
    assert clear[180:330, 440:580].sum() == pytest.approx(clear.sum(), rel=1e-3)
    assert fog[180:330, 440:580].sum() < 0.95 * fog.sum()


@pytest.mark.parametrize("sun_deg", [(0.0, 10.0), (-15.0, 4.0)])
def test_glare_falls_with_the_square_of_the_angle_to_the_sun(sun_deg: tuple[float, float]) -> None:
    image = shoot({"glare": 0.2, "sun_deg": sun_deg}, arrays=[], background={"level": 0.0})[0]
    assert image[255, 511] == pytest.approx(0.2, abs=1e-3)
    right, up = np.radians(sun_deg)
    sun = np.array([np.tan(right), -np.tan(up) / np.cos(right), 1.0])
    pixels = [(100, 20), (511, 500), (1000, 255)]
    angles = [angle_deg(sun, np.array([(x - 511.5) / 2916.7, (y - 255.5) / 2916.7, 1.0])) for x, y in pixels]
    centre = angle_deg(sun, np.array([0.0, 0.0, 1.0]))
    expected = [0.2 * (centre**2 + 1) / (angle**2 + 1) for angle in angles]
    assert [image[y, x] for x, y in pixels] == pytest.approx(expected, abs=1e-3)


def angle_deg(one: NDArray[Any], other: NDArray[Any]) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def test_glare_adds_shot_noise() -> None:
    plain: dict[str, Any] = {"arrays": [], "background": {"level": 0.1}, "sensor": {"dark_noise_e": 0, "bits": 12}}
    noise = []
    for veil in (0.0, 0.3):
        first, second = shoot({"glare": veil}, duration_s=2e-3, **plain)
        noise.append((first - second)[250:260, 400:620].std() / 2**0.5)
    assert noise == pytest.approx(np.sqrt(np.array([0.1, 0.4]) / 15000).tolist(), rel=0.05)


@pytest.mark.parametrize(("rain_mm_h", "db_per_km"), [(1.0, 1.076), (25.0, 9.30)])
def test_rain_dims_as_carbonneau_and_wisely_measured(rain_mm_h: float, db_per_km: float) -> None:
    weather = WeatherSettings(rain_mm_h=rain_mm_h, visibility_m=300.0)
    rain = transmission(weather, 1000.0) / transmission(WeatherSettings(visibility_m=300.0), 1000.0)
    assert -10 * math.log10(rain) == pytest.approx(db_per_km, rel=1e-3)


@pytest.mark.parametrize(("first", "second"), [(3.0, 1.0), (1.0, 3.0), (2.0, 2.5)])
def test_common_area_of_discs_is_the_area_of_a_grid(first: float, second: float) -> None:
    x, y = np.meshgrid(*2 * [np.linspace(-4, 4, 1601)])
    apart = np.array([0.0, 0.7, 1.9, 2.6, 3.9, 9.0])
    areas = [((x**2 + y**2 < first**2) & ((x - a) ** 2 + y**2 < second**2)).sum() * 0.005**2 for a in apart]
    assert common_area(apart, first, second) == pytest.approx(areas, abs=0.02)


def rainy(**weather: float) -> ChannelSettings:
    scene = {"speed_m_s": 20.0, "duration_s": 20.0, "stop_m": 1.0, "weather": {"rain_mm_h": 20.0, **weather}}
    return from_mapping(ChannelSettings, scene)


def test_drops_land_at_the_rate_of_the_rain() -> None:
    settings = rainy(wiper_s=10.0)
    windscreen = Windscreen(settings, 3)
    d = np.linspace(0.005, 12, 4000)
    # the glass behind an area A normal to the travel has the area A / sin(30 degrees)
    normal_m_s = (20 * math.sin(math.radians(30)) + 3.78 * d**0.67 * math.cos(math.radians(30))) / math.sin(
        math.radians(30)
    )
    rate = 8000 * np.exp(-4.1 * 20**-0.21 * d) * normal_m_s
    area = (1024 * 0.2 / 2916.7 + 0.0132) * (512 * 0.2 / 2916.7 + 0.0132)
    drops = np.concatenate([windscreen._draw(k) for k in range(20)])
    assert len(drops) == pytest.approx(rate.sum() * (d[1] - d[0]) * area * 200, rel=0.02)
    mean_mm = (rate * d).sum() / rate.sum()
    assert drops[:, 3].mean() == pytest.approx(2 ** (1 / 3) * 1e-3 * mean_mm, rel=0.02)
    assert np.abs(drops[:, 1]).max() == pytest.approx(0.5 * (1024 * 0.2 / 2916.7 + 0.0132), rel=1e-3)


def test_drops_gather_until_the_next_wipe_and_show_airlight() -> None:
    settings = rainy(wiper_s=0.5, airlight=0.25)
    windscreen, covered, tinted = Windscreen(settings, 3), [], []
    for time_s in np.arange(0, 2, 0.01):
        light, even = np.zeros((512, 1024), np.float32), np.full((512, 1024), 0.25, np.float32)
        windscreen.look_through(light, (0, 0), float(time_s))
        windscreen.look_through(even, (0, 0), float(time_s))
        covered.append(float(light.mean()) / 0.25)
        tinted.append(float(np.abs(even - 0.25).max()))
    steps = np.diff(covered)
    assert max(tinted) < 1e-6
    after = np.flatnonzero(steps < 0) + 1
    assert np.diff(after).tolist() == [50, 50, 50]
    assert max(np.array(covered)[after]) < 0.2 * max(covered)
    # 130 drops of mean area 0.7 mm^2 in half a second on 40 cm^2
    assert 0.005 < max(covered) < 0.1


def test_a_large_drop_hides_a_point_and_a_small_one_dims_it() -> None:
    settings = rainy()
    for radius, least in ((60.0, 0.0), (10.0, 1 - (10 / 23.33) ** 2)):
        windscreen = Windscreen(settings, 3)
        windscreen._land(0.0, 0.0, radius)
        assert windscreen._clear.min() == pytest.approx(least, abs=2e-3)
        assert windscreen._clear[255, 511 + round(radius + 25)] == 1


def test_window_is_the_frame_bit_for_bit() -> None:
    changes = {"speed_m_s": 20.0, "shake": "road", "duration_s": 3e-3, "sensor": {}}
    settings = from_mapping(ChannelSettings, {**STILL, **changes, "weather": {**FOG, "glare": 0.1, "rain_mm_h": 100.0}})
    for window, frame in zip(*(_frames(settings, roi) for roi in (5, None)), strict=True):
        (x, y), (height, width) = window.origin, window.pixels.shape
        assert np.array_equal(window.pixels, frame.pixels[y : y + height, x : x + width])


def _frames(settings: ChannelSettings, roi: int | None) -> list[Any]:
    lights = [itertools.repeat(np.full((16, 16), 3, np.uint8))]
    made = film(settings, lights, np.random.default_rng(2), pattern_period_s=1e-3, roi_margin_px=roi)
    return [frame for frame, _ in made]


@pytest.mark.parametrize(("change", "message"), [
    ({"visibility_m": 5}, "'weather.visibility_m': input should be greater than or equal to 10"),
    ({"visibility_m": math.inf}, "'weather.visibility_m': input should be a finite number"),
    ({"airlight": -1}, "weather.airlight"), ({"background_m": 0}, "weather.background_m"),
    ({"droplet_m": 0}, "weather.droplet_m"), ({"rain_mm_h": -1}, "weather.rain_mm_h"),
    ({"windscreen_m": -1}, "weather.windscreen_m"), ({"wiper_s": 0}, "weather.wiper_s"),
    ({"glare": 5}, "weather.glare"), ({"sun_deg": (0, 100)}, "weather.sun_deg.1"),
    ({"fog": 1}, "unknown setting 'weather.fog'"),
])  # fmt: skip
def test_invalid_weather_is_refused_in_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError) as caught:
        from_mapping(ChannelSettings, {"weather": change})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
