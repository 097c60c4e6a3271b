"""Plain receiver kernel against the NumPy reference."""

import numpy as np
import per_led_oracle as reference
import pytest

from heliograph.receive import Pose
from heliograph.receive.decode import kernels


def test_cubic_samples() -> None:
    rng = np.random.default_rng(0)
    image, points = rng.normal(size=(9, 12)), rng.uniform(-2.5, 13, (200, 2))
    got = np.empty(200)
    kernels.sample_cubic(image, points, got)
    assert got == pytest.approx(reference.sample_cubic(image, points), abs=1e-12)


def test_cubic_samples_of_a_parabola_are_exact() -> None:
    y, x = np.mgrid[:12, :14].astype(float)
    points = np.random.default_rng(0).uniform(2, 9, (50, 2))
    got = np.empty(50)
    kernels.sample_cubic(2 + x - 0.3 * y + 0.2 * x * y + 0.1 * x * x - 0.05 * y * y, points, got)
    px, py = points.T
    assert got == pytest.approx(2 + px - 0.3 * py + 0.2 * px * py + 0.1 * px * px - 0.05 * py * py)


def test_cubic_samples_at_leds() -> None:
    image, pose = np.random.default_rng(0).normal(size=(19, 22)), Pose(9.3, 10.8, 1.3, 0.05, 0.5, 0.02, -0.03)
    got = np.empty((16, 16))
    kernels.cubic_at_leds(image, pose.x, pose.y, pose.axes, got)
    assert got.ravel() == pytest.approx(reference.sample_cubic(image, pose.leds(16).reshape(-1, 2)), abs=1e-12)
