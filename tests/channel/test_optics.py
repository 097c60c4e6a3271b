"""Pixel irradiance against brute force: finely sampled disc, each sample blurred by the exact erf."""

from typing import Any

import numpy as np
import pytest
from scipy.special import erf

from heliograph.base.arrays import Floats
from heliograph.channel.optics import cover, normal_table
from heliograph.channel.render import Canvas, add_array
from heliograph.channel.scene import CameraPose, homography, project, square
from heliograph.channel.settings import ChannelSettings, EmitterSettings, Placement

REST = CameraPose(*[np.zeros(1)] * 6)


def view(settings: ChannelSettings, placement: Placement) -> tuple[Floats, Floats]:
    one, eye = homography(REST, np.zeros(1), placement, settings.distance_m, settings.camera)
    return one[0], eye[0]


def shares(edges: Floats, centre: Floats, sigma: float) -> Floats:
    """Integrate Gaussians over pixels, (points, pixels)."""
    return np.diff(0.5 * (1 + erf((edges - centre[:, None]) / (sigma * np.sqrt(2)))), axis=1)


def brute_force(settings: ChannelSettings, one: Floats, eye: Floats, level: Floats, canvas: Canvas) -> Floats:
    """Reference for `add_array` at rest: each emitter as 0.79 over^2 points."""
    over = 70
    emitter, camera = settings.emitter, settings.camera
    grid = (np.arange(over) + 0.5) / over * 2 - 1
    disc = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    disc = disc[(disc**2).sum(1) <= 1] * emitter.diameter_m / 2
    (x0, y0), (h, w), n = canvas.corner, canvas.light.shape, len(level)
    out = np.zeros((h, w))
    for u, v in zip(*np.nonzero(level), strict=True):
        led = (np.array([v, u]) - (n - 1) / 2) * emitter.pitch_m
        image, _ = project(one, disc + led)
        _, depth = project(one, led[None])
        way = eye - np.array([*led, 0])
        lobe = (-way[2] / np.linalg.norm(way)) ** emitter.lobe_order
        flux = level[u, v] * lobe * (camera.focal_px * emitter.pitch_m / depth[0]) ** 2 / len(disc)
        across = shares(np.arange(w + 1) - 0.5 + x0, image[:, 0], camera.blur_px)
        down = shares(np.arange(h + 1) - 0.5 + y0, image[:, 1], camera.blur_px)
        out += flux * down.T @ across
    return out


def blank(one: Floats, half_m: float, rim: int = 6) -> Canvas:
    corners, _ = project(one, square(half_m))
    low, high = np.floor(corners.min(0)).astype(int) - rim, np.ceil(corners.max(0)).astype(int) + rim
    width, height = high - low + 1
    return Canvas(np.zeros((height, width), np.float32), (int(low[0]), int(low[1])))


def at_rest(level: Floats) -> tuple[Floats, Floats, Floats]:
    return level, np.zeros_like(level), np.zeros_like(level)


NEAREST = pytest.param(5, 5e-3, 25.0, marks=pytest.mark.slow)


@pytest.mark.parametrize(("distance_m", "share_of_peak", "tilt_deg"), [
    NEAREST, (10, 2e-3, 0.0), (25, 6e-4, 25.0), (50, 3e-4, 0.0), (80, 1e-4, 25.0),
])  # fmt: skip
def test_leds_equal_brute_force(distance_m: float, share_of_peak: float, tilt_deg: float) -> None:
    settings = ChannelSettings(distance_m=distance_m, speed_m_s=0)
    turn: dict[str, Any] = {"yaw_deg": tilt_deg, "roll_deg": tilt_deg / 2, "pitch_deg": -tilt_deg}
    one, eye = view(settings, Placement(x_m=0.21, y_m=-0.13, **turn))
    level = np.zeros((16, 16))
    level[3, 4], level[3, 5], level[15, 0] = 1.0, 0.25, 0.5
    canvas = blank(one, 0.16)
    add_array(settings, one, np.zeros((3, 3)), eye, at_rest(level), canvas)
    exact = brute_force(settings, one, eye, level, canvas)
    upright = 4e-4 if tilt_deg else 0.0  # `_add_led` ignores lower correlations
    assert np.abs(canvas.light - exact).max() < (share_of_peak + upright) * exact.max()
    assert canvas.light.sum() == pytest.approx(exact.sum(), rel=2e-6)


@pytest.mark.parametrize(("distance_m", "roll_rad"), [(60.0, 0.02), (100.0, 0.0)])
def test_equals_the_blur_matrix_of_the_reference_link(distance_m: float, roll_rad: float) -> None:
    # formula from bound.py: Gaussians with variance blur^2 + radius^2 / 4, integrated over pixels, times pitch^2
    settings = ChannelSettings(distance_m=distance_m, emitter=EmitterSettings(half_angle_deg=89.999))
    one, eye = view(settings, Placement(x_m=0, y_m=0, roll_deg=-np.degrees(roll_rad)))
    level = np.random.default_rng(0).random((16, 16))
    canvas = blank(one, 0.16)
    add_array(settings, one, np.zeros((3, 3)), eye, at_rest(level), canvas)
    pitch = 0.035 * 0.02 / (distance_m * 12e-6)
    dy, dx = (g.ravel() for g in np.meshgrid(*[(np.arange(16) - 7.5) * pitch] * 2, indexing="ij"))
    x = 511.5 + dy * np.sin(roll_rad) + dx * np.cos(roll_rad) - canvas.corner[0]
    y = 255.5 + dy * np.cos(roll_rad) - dx * np.sin(roll_rad) - canvas.corner[1]
    sigma = np.hypot(0.5, 0.005 / 0.02 * pitch / 4)
    height, width = canvas.light.shape
    down, across = shares(np.arange(height + 1) - 0.5, y, sigma), shares(np.arange(width + 1) - 0.5, x, sigma)
    exact = np.einsum("l,li,lj->ij", level.ravel(), down, across) * pitch**2
    assert np.abs(canvas.light - exact).max() < 2e-6


@pytest.mark.parametrize("late_s", [-3e-4, 0.0])
def test_smear_equals_many_short_exposures(late_s: float) -> None:
    settings = ChannelSettings(distance_m=25, speed_m_s=0)
    one, eye = view(settings, Placement())
    drift = settings.camera.focal_px * np.array([[0, 0, 0.25 * 25], [0, 0, -0.1 * 25], [0, 0, 0]]) / 2917 * 1e3
    level, length = np.ones((16, 16)), 7e-4
    canvas, exact = blank(one, 0.18), blank(one, 0.18)
    add_array(settings, one, drift, eye, (level, level * late_s, level * length**2 / 12), canvas)
    for t in late_s + length * ((np.arange(20) + 0.5) / 20 - 0.5):
        add_array(settings, one + t * drift, np.zeros((3, 3)), eye, at_rest(level / 20), exact)
    assert np.abs(canvas.light - exact.light).max() < 5e-4 * exact.light.max()


def test_lobe_halves_at_the_half_angle() -> None:
    settings, lights = ChannelSettings(distance_m=50), []
    for angle in (0.0, 22.6):
        one, eye = view(settings, Placement(x_m=0, y_m=0, yaw_deg=angle))
        canvas = blank(one, 0.16)
        add_array(settings, one, np.zeros((3, 3)), eye, at_rest(np.ones((16, 16))), canvas)
        lights.append(float(canvas.light.sum()))
    assert lights[1] / lights[0] == pytest.approx(0.5, rel=2e-3)


def test_panel_is_a_blurred_square() -> None:
    one, _ = view(ChannelSettings(distance_m=30), Placement(x_m=0.01, y_m=0.02))
    canvas = blank(one, 0.2, rim=12)
    canvas.light.fill(0.5)
    sigma, scale = 0.58, one[0, 0] / one[2, 2]
    inverse = np.asarray(np.linalg.inv(one), float)
    inverse[:2] *= scale / sigma
    half = float(0.18 * scale / sigma)
    cover(canvas.light, canvas.corner, inverse, (half, half), (-9, -9, 9999, 9999), 0.02, normal_table())
    rows, columns = np.indices(canvas.light.shape)
    x = (columns + canvas.corner[0] - one[0, 2] / one[2, 2]) / sigma / np.sqrt(2)
    y = (rows + canvas.corner[1] - one[1, 2] / one[2, 2]) / sigma / np.sqrt(2)
    h = half / np.sqrt(2)
    share = (erf(h - x) - erf(-h - x)) * (erf(h - y) - erf(-h - y)) / 4
    assert np.abs(canvas.light - (0.5 + share * (0.02 - 0.5))).max() < 1e-6
