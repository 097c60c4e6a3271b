"""Phase-only correlation, and the marker as reference for poses."""

import cv2
import numpy as np
import pytest
from scipy.special import erf

from heliograph.base.arrays import Floats
from heliograph.channel.scene import lens_matrix
from heliograph.experiments.ranging import (
    MIN_PEAK,
    displacement,
    drive,
    marker,
    marker_poses,
    pilots,
    range_by_correlation,
    shoot,
)
from heliograph.measure.errors import pose_in_space

needs_markers = pytest.mark.skipif(
    not hasattr(getattr(cv2, "aruco", None), "ArucoDetector"), reason="OpenCV before 4.7 has no marker detector"
)


def blurred_block(x: float, y: float, shape: tuple[int, int] = (40, 48)) -> Floats:
    """Draw a block 2 px wide at (x, y) with a blur of 0.8 px, integrated over the pixels by the error function."""

    def along(n: int, centre: float) -> Floats:
        steps = np.linspace(-1, 1, 9)[:, None] + centre
        edges = erf((np.arange(n + 1) - 0.5 - steps) / (0.8 * 2**0.5))
        return np.asarray(0.5 * np.diff(edges, axis=1).mean(0), float)

    return np.outer(along(shape[0], y), along(shape[1], x))


@pytest.mark.parametrize("shift", [(6.3, -0.45), (-9.75, 4.2), (30.4, 0.1)])
def test_correlation_measures_shifts_below_a_pixel(shift: tuple[float, float]) -> None:
    first, second = blurred_block(8.2 + 15 * (shift[0] < 0), 20.6), blurred_block(8.2 + shift[0] + 15 * (shift[0] < 0),
                                                                                20.6 + shift[1])  # fmt: skip
    found, peak = displacement(first, second)
    # aliasing at 0.85 cycles/px is exp(-2 pi^2 0.8^2 (0.85^2 - 0.15^2)), 1e-4 of the light: at most 1e-4 px
    assert found == pytest.approx(shift, abs=1e-3)
    assert peak > 0.999


def test_errors_of_shifts_are_those_of_the_phase_noise() -> None:
    rng, sigma, shift, band = np.random.default_rng(77), 3e-3, np.array([7.35, 2.8]), 0.15
    images = blurred_block(12.4, 18.1), blurred_block(12.4 + shift[0], 18.1 + shift[1])
    errors = []
    for _ in range(60):
        noisy = [image + sigma * rng.standard_normal(image.shape) for image in images]
        errors.append(displacement(noisy[0], noisy[1], band)[0] - shift)
    # two images with noise: var(phase) = n sigma^2 / |F|^2; least squares over n frequencies of the unpadded image
    y, x = np.meshgrid(*map(np.fft.fftfreq, images[0].shape), indexing="ij")
    inside = np.hypot(x, y) < band
    noise = images[0].size * sigma**2 / np.abs(np.fft.fft2(images[0])[inside]) ** 2
    waves = 2 * np.pi * x[inside]
    # each frequency and its negative are one measurement
    expected = np.sqrt(2 * (waves**2 * noise).sum()) / (waves**2).sum()
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(expected, rel=0.35)


def test_noise_has_no_peak() -> None:
    rng = np.random.default_rng(78)
    peaks = [displacement(*rng.standard_normal((2, 40, 48)))[1] for _ in range(20)]
    assert max(peaks) < MIN_PEAK


@pytest.mark.parametrize("seed", [3001, 3002])
def test_pilots_range_within_the_published_error(seed: int) -> None:
    """Published: 0.75 m rms within 100 m."""
    link = drive(95.0, seed)
    frames, plane = shoot(link, seed, pilots(link.signal.side), link.channel.emitter)
    truth, _ = pose_in_space(plane, link.channel.camera)
    assert range_by_correlation(frames, link) == pytest.approx(truth[2], abs=0.75)


@needs_markers
@pytest.mark.parametrize("seed", [3001, 3002, 3003])
def test_marker_pose_at_25_m(seed: int) -> None:
    """Corners are within half a pixel of the image enlarged four times: 1/8 px of a side of 37 px."""
    link = drive(25.0, seed)
    (frame,), plane = shoot(link, seed, *marker(link))
    (place, turn), other = marker_poses(frame, link)
    truth, upright = pose_in_space(plane, link.channel.camera)
    side_px = link.channel.camera.focal_px * 0.32 / truth[2]
    assert place[2] == pytest.approx(truth[2], rel=2 / 8 / side_px)
    lens = lens_matrix(link.channel.camera)
    assert (lens @ place / place[2])[:2] == pytest.approx((lens @ truth / truth[2])[:2], abs=1 / 8)
    # a tilt of 12 degrees shortens the side by 2 %, more than the errors of the corners
    angles = [(rotation * upright.inv()).magnitude() for rotation in (turn, other[1])]
    assert np.degrees(min(angles)) < 12
