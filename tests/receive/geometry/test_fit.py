"""Pose fit: unbiased, efficient, with a consistent covariance; and robust statistics."""

from dataclasses import replace

import fit_oracle as reference
import numpy as np
import pytest
from scenes import ALL_ON, SIDE, Floats, draw, pitch_at
from scipy.special import ndtr

from heliograph.receive.geometry.fit import Fit, RenderCache, correlation, fit_array, robust_std
from heliograph.receive.geometry.kernels import FIT
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import window_around
from heliograph.signal.header import header_levels

GAIN, LEVEL = 200.0, 20.0
HEADER = header_levels(11, SIDE) / 2.0 - 1.0
PATTERNS = {"header": HEADER, "all on": ALL_ON}
POSE = Pose(40.37, 31.81, pitch_at(60), 0.0, 0.55)
BROAD = np.diag([1.0, 1.0, 0.1, 0.1, 0.3]) ** 2


Window = tuple[tuple[int, int], tuple[int, int]]  # corner and shape


def window(pose: Pose) -> Window:
    x, y, cols, rows = window_around(pose, SIDE, 1.5 * pose.pitch + 1.5)
    return (x, y), (rows, cols)


def pixels(pose: Pose, weights: Floats) -> Floats:
    corner, shape = window(pose)
    return GAIN * draw(pose, weights, corner, shape) + LEVEL + 0.3 * np.arange(shape[1])


def start(pose: Pose, rng: np.random.Generator) -> Fit:
    """Draw a prior with errors of 0.3 px and a few percent, consistent with its covariance."""
    return Fit(pose.vector() + rng.normal(0, [0.3, 0.3, 0.03, 0.02, 0.1]), BROAD)


def fit(image: Floats, pose: Pose, weights: Floats, prior: Fit) -> Fit:
    return fit_array(image, window(pose)[0], prior, weights, 8)


def error(found: Fit, pose: Pose) -> Floats:
    return np.asarray(found.vector - pose.vector())


def bound(pose: Pose, weights: Floats, sigma: float, prior: Floats = BROAD, view: Window | None = None) -> Floats:
    """Return Cramer-Rao bounds for the pose: gain and background plane unknown, prior covariance known."""
    corner, shape = view or window(pose)

    def image(v: Floats) -> Floats:
        return GAIN * draw(Pose.from_vector(v), weights, corner, shape)

    steps = 1e-4 * np.eye(5)
    slopes = [(image(pose.vector() + h) - image(pose.vector() - h)) / 2e-4 for h in steps]
    rows, cols = np.mgrid[: shape[0], : shape[1]].astype(float)
    # I = J^T J / sigma^2 + P^-1
    jacobian = np.stack([*slopes, image(pose.vector()), np.ones(shape), rows, cols]).reshape(9, -1)
    information = jacobian @ jacobian.T / sigma**2
    information[:5, :5] += np.linalg.inv(prior)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))[:5]), np.float64)


@pytest.mark.parametrize("kind", PATTERNS)
@pytest.mark.parametrize("distance_m", [25, 50, 80, 110, 150])
def test_a_clean_image_gives_the_pose(distance_m: float, kind: str) -> None:
    rng, pose = np.random.default_rng(3), replace(POSE, pitch=pitch_at(distance_m), roll=0.015)
    found = fit(pixels(pose, PATTERNS[kind]), pose, PATTERNS[kind], start(pose, rng))
    # residual bias: light beyond 4 standard deviations, and the prior
    assert np.abs(error(found, pose))[:2].max() < 1e-3
    assert abs(error(found, pose)[2]) < 5e-3
    assert found.score > 0.9999
    assert found.gain == pytest.approx(GAIN, rel=0.02)


@pytest.mark.parametrize("roll", [-0.5, 0.2, 1.2])
def test_a_rolled_array_is_found(roll: float) -> None:
    pose = Pose(40.37, 31.81, 1.2, roll, 0.6)
    found = fit(pixels(pose, HEADER), pose, HEADER, start(pose, np.random.default_rng(0)))
    assert np.abs(error(found, pose)).max() < 2e-3


@pytest.mark.parametrize("kind", PATTERNS)
@pytest.mark.parametrize("distance_m", [25, 50, 80, 150])
def test_errors_are_near_the_bound_and_match_the_covariance(distance_m: float, kind: str) -> None:
    weights, sigma, rng, pitch = PATTERNS[kind], 2.5, np.random.default_rng(int(distance_m)), pitch_at(distance_m)
    errors, normed = [], []
    for _ in range(50):
        pose = Pose(40 + rng.random(), 31 + rng.random(), pitch, 0.0, 0.55)
        clean = pixels(pose, weights)
        found = fit(clean + rng.normal(0, sigma, clean.shape), pose, weights, start(pose, rng))
        errors.append(e := error(found, pose))
        normed.append(e[:2] @ np.linalg.solve(found.covariance[:2, :2], e[:2]))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms[:3] < 2 * bound(Pose(40.5, 31.5, pitch, 0.0, 0.55), weights, sigma)[:3]).all()
    # chi-square with two degrees of freedom
    assert 1.0 < np.mean(normed) < 4.0


@pytest.mark.parametrize("distance_m", [25, 40, 60, 80])
@pytest.mark.parametrize("scene", ["wall", "lamp"])
def test_bright_clutter_around_the_panel_does_not_pull(distance_m: float, scene: str) -> None:
    rng, pose = np.random.default_rng(5), replace(POSE, pitch=pitch_at(distance_m))
    (x0, y0), shape = window(pose)
    y, x = np.mgrid[: shape[0], : shape[1]] + np.array([[[y0 - pose.y]], [[x0 - pose.x]]])
    visible = np.ones(shape) if scene == "wall" else np.hypot(x - 10.5 * pose.pitch, y) < 3 * pose.pitch
    # the dark panel, one pitch beyond the outer LEDs, hides the clutter
    panel = np.prod([ndtr((9 * pose.pitch - np.abs(t)) / 0.6) for t in (x, y)], axis=0)
    light = GAIN * draw(pose, ALL_ON, (x0, y0), shape) + 5 + 2 * GAIN * visible * (1 - panel)
    prior = Fit(np.add(pose.vector(), [0.2, -0.15, 0.01, 0.0, 0.05]), np.diag([0.5, 0.5, 0.05, 0.02, 0.5]) ** 2, GAIN)
    found = fit_array(light + rng.normal(0, 2.5, shape), (x0, y0), prior, ALL_ON, 5, panel=True)
    assert np.abs(error(found, pose))[:2].max() < 0.1


def test_a_header_shows_the_tilt() -> None:
    rng = np.random.default_rng(2)
    pose = Pose(40.3, 30.8, pitch_at(50.0), 0.05, 0.55, -0.06, 0.04)
    prior = Fit(np.append(start(pose, rng).vector, [0.0, 0.0]), np.diag([1.0, 1.0, 0.1, 0.1, 0.3, 0.1, 0.1]) ** 2)
    found = fit(pixels(pose, HEADER), pose, HEADER, prior)
    assert found.vector == pytest.approx(pose.full_vector(), abs=2e-3)
    # a prior without tilt fixes the tilt
    held = fit(pixels(pose, HEADER), pose, HEADER, Fit(pose.full_vector() + 0.01, BROAD))
    assert held.vector[5:] == pytest.approx(pose.full_vector()[5:] + 0.01)
    assert len(held.covariance) == 5


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("distance_m", [30, 80])
def test_an_unexpected_gain_does_not_end_the_fit_early(distance_m: float, factor: float) -> None:
    rng, pose, errors = np.random.default_rng(7), replace(POSE, pitch=pitch_at(distance_m)), []
    spread = np.array([0.1, 0.1, 2e-3, 2e-3, 0.05])
    for _ in range(20):
        prior = Fit(pose.vector() + rng.normal(0, 0.5 * spread), np.diag(spread**2), factor * GAIN)
        light = pixels(pose, ALL_ON) + rng.normal(0, 2.5, window(pose)[1])
        errors.append(error(fit_array(light, window(pose)[0], prior, ALL_ON, 3, panel=True), pose)[:2])
    assert np.sqrt(np.mean(np.square(errors))) < 0.01


@pytest.mark.parametrize("panel", [False, True])
def test_the_first_step_with_a_known_gain_is_accurate(panel: bool) -> None:
    """For a slightly wrong pose, image brightness follows only from the expected gain."""
    prior = Fit(np.add(POSE.vector(), [0.2, -0.15, 0.005, 0.0, 0.02]), np.diag([0.5, 0.5, 0.02, 0.02, 0.1]) ** 2, GAIN)
    found = fit_array(pixels(POSE, ALL_ON), window(POSE)[0], prior, ALL_ON, 1, panel=panel)
    # remaining error is second-order in the step
    assert np.abs(error(found, POSE))[:2].max() < 0.1 * 0.2
    assert found.gain == pytest.approx(GAIN, rel=0.02)


def test_without_an_array_the_score_is_low_and_the_prior_holds() -> None:
    rng, pose = np.random.default_rng(0), Pose(40.0, 31.0, 1.2, 0.0, 0.55)
    noise = rng.normal(LEVEL, 2.5, window(pose)[1])
    assert abs(fit(noise, pose, HEADER, start(pose, rng)).score) < 0.5
    found = fit(noise, pose, ALL_ON, Fit(pose.vector(), 1e-6 * np.eye(5), GAIN))
    assert np.abs(error(found, pose)).max() < 5e-3
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(np.full(5, 1e-3), rel=0.2)


@pytest.mark.slow
def test_all_but_one_percent_of_near_arrays_are_found_within_the_covariance() -> None:
    """Above 2 px pitch the fit may lock onto neighbouring LEDs: 22 of 4600 draws; below 2 px, 2 exceed the bound."""
    outside = list[float]()
    for seed in range(600, 900):
        rng, weights = np.random.default_rng(seed), ALL_ON if seed % 2 == 0 else HEADER
        # x, y, pitch, roll, blur, stretch and shear
        low, high = (39, 30, 0.5, -3, 0.4, -0.1, -0.1), (41, 32, 2.5, 3, 1.0, 0.1, 0.1)
        pose = Pose(*rng.uniform(low, high).tolist())
        # below a fifth of a pitch, so that few LEDs match a neighbour
        spread = np.array([0.07 * pose.pitch, 0.07 * pose.pitch, 0.007, 0.007, 0.1, 0.007, 0.007])
        prior = Fit(pose.full_vector() + rng.normal(0, spread), np.diag(spread**2))
        clean = pixels(pose, weights)
        found = fit(clean + rng.normal(0, 2.5, clean.shape), pose, weights, prior)
        off = found.vector - pose.full_vector()
        assert found.score > 0.9
        # seven degrees of freedom: P(chi-square > 30) = 1e-4
        if off @ np.linalg.solve(found.covariance, off) >= 30:
            outside.append(pose.pitch)
    assert len(outside) <= 3
    assert all(pitch > 2 for pitch in outside)


def test_the_covariance_is_correct_with_few_and_many_pixels() -> None:
    """Nine parameters from 49 pixels leave 40 degrees of freedom."""
    rng, pose, sigma, ratios = np.random.default_rng(9), Pose(40.1, 30.9, pitch_at(150), 0.0, 0.55), 2.5, []
    prior = Fit(pose.vector(), np.diag([1.0, 1.0, 1e-4, 1e-4, 1e-4]) ** 2)
    for corner, shape in (((37, 28), (7, 7)), ((25, 16), (30, 31))):
        clean = GAIN * draw(pose, HEADER, corner, shape) + LEVEL
        found = [fit_array(clean + rng.normal(0, sigma, shape), corner, prior, HEADER, 2) for _ in range(200)]
        stated = np.mean([1 / one.covariance[0, 0] for one in found])
        ratios.append(stated * bound(pose, HEADER, sigma, prior.covariance, (corner, shape))[0] ** 2)
    assert ratios[0] == pytest.approx(ratios[1], rel=0.1)
    # small loss through robust weights and rounding
    assert ratios[1] == pytest.approx(1, abs=0.25)


def test_undefined_pixels_give_no_pose() -> None:
    prior = Fit(np.array([20.0, 20.0, 0.2, 0.0, -0.5]), np.diag([1.0, 1.0, 0.01, 0.01, 0.1]))
    with pytest.raises(np.linalg.LinAlgError, match="no solution"):
        fit_array(np.full((40, 40), np.nan), (0, 0), prior, np.ones((16, 16)), 3)


@pytest.mark.parametrize("gain", [0.0, GAIN])
@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("panel", [False, True])
def test_the_fit_equals_the_reference(panel: bool, tilted: bool, gain: float) -> None:
    rng, weights, free = np.random.default_rng(0), ALL_ON if panel else HEADER, 7 if tilted else 5
    pose = Pose(20.0, 22.0, float(rng.uniform(0.6, 1.4)), float(rng.uniform(-0.2, 0.2)), 0.6)
    corner, shape = window(pose)
    image = GAIN * draw(pose, weights, corner, shape) + LEVEL + rng.normal(0, 2, shape)
    image[3:6, 4:9] += 60  # foreground clutter
    spread = np.diag([*np.diag(BROAD), 0.05**2, 0.05**2][:free])
    prior = (pose.full_vector() + rng.normal(0, [0.3, 0.3, 0.03, 0.02, 0.1, 0, 0]))[:free]
    margins = list(FIT.panel_margins) if panel else []
    vector, matrix, linear = reference.fit(image, corner, weights, margins, prior, np.linalg.inv(spread), gain, 4)
    got = fit_array(image, corner, Fit(prior, spread, gain), weights, 4, panel)
    # the kernel truncates light beyond 4 standard deviations
    assert got.vector == pytest.approx(vector, abs=2e-3)
    assert got.gain == pytest.approx(linear[0], rel=2e-3)
    assert got.covariance == pytest.approx(np.linalg.inv(matrix)[:free, :free], rel=0.05, abs=1e-7)


def test_cached_images_serve_nearby_poses() -> None:
    """The pose stays accurate while a cached image serves an array drifting by 0.05 px per pair."""
    rng, drawn, spread = np.random.default_rng(9), RenderCache(), np.diag([0.01, 0.01, 4e-4, 4e-4, 0.01]) ** 2
    first, off, redrawn = Pose(30.2, 28.7, 1.6, 0.015, 0.55), [], 0
    for k in range(24):
        pose = replace(first, x=first.x + 0.05 * k, y=first.y + 0.03 * k, pitch=first.pitch * (1 + 2e-4 * k))
        x, y, cols, rows = drawn.window(pose, SIDE, 4.0)
        anchor = drawn.anchor.copy()
        prior = Fit(pose.vector() + np.append(rng.normal(0, 0.005, 2), np.zeros(3)), spread, GAIN)
        light = GAIN * draw(pose, ALL_ON, (x, y), (rows, cols)) + LEVEL + rng.normal(0, 1.5, (rows, cols))
        near, exact = (fit_array(light, (x, y), prior, ALL_ON, 3, panel=True, drawn=one) for one in (drawn, None))
        redrawn += not np.array_equal(anchor[:5], drawn.anchor[:5])
        off.append(near.vector - exact.vector)
        assert near.gain == pytest.approx(exact.gain, rel=5e-3)
        assert near.score == pytest.approx(exact.score, abs=1e-3)
    assert 8 <= redrawn <= 18
    away = np.abs(off).max(0)
    assert away[:2].max() < 4e-3
    assert away[2:4].max() < 2e-4
    assert away[4] < 0.02


def test_images_of_other_leds_or_positions_are_rendered_again() -> None:
    drawn, pose, dim = RenderCache(), Pose(30.2, 28.7, 1.6, 0.015, 0.55), ALL_ON.copy()
    dim[:, :3] = 0.0
    ((x, y), shape), prior = window(pose), Fit(pose.vector(), 1e-4 * np.eye(5), GAIN)
    for weights, corner in ((ALL_ON, (x, y)), (dim, (x, y)), (dim, (x + 3, y)), (ALL_ON, (x, y))):
        light = GAIN * draw(pose, weights, corner, shape) + LEVEL
        got, exact = (fit_array(light, corner, prior, weights, 2, drawn=one) for one in (drawn, None))
        assert got.vector == pytest.approx(exact.vector, abs=1e-9)


@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (256,), (5, 6)])
def test_robust_deviation_is_that_of_the_median_and_keeps_the_values(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(2).normal(size=shape)
    before = values.copy()
    # Phi^-1(3/4) = 0.67449; outliers count by their order only
    assert robust_std(values) == pytest.approx(np.median(np.abs(values)) / 0.67449, rel=1e-4)
    assert np.array_equal(values, before)


def test_correlation_ignores_gain_and_offset() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 9, 7))
    found = [correlation(a, one) for one in (b, 3 * a + 5, -a, np.full((9, 7), 4.0))]
    assert found == pytest.approx([np.corrcoef(a.ravel(), b.ravel())[0, 1], 1, -1, 0])
