"""Array background in single frames, estimated from headers."""

import numpy as np
import pytest
from scenes import pitch_at
from single_frames import GAIN, PANEL, framed, headers

from heliograph.receive import Pose
from heliograph.receive.equalise.single_mode import background_images, fit_background, surroundings

SOUND = np.ones((16, 16))


def test_the_panels_width_is_found_by_the_header() -> None:
    """The panel extends 9 pitches from the centre; an error of half a pitch would bias the pitch by 5 %."""
    half, _, variance = fit_background(headers(), GAIN, SOUND)
    assert half == pytest.approx(PANEL, abs=0.15)
    # half the noise variance of a sum is 1.6 outside the array
    assert variance < 6


def test_the_background_is_what_a_dark_array_shows() -> None:
    half, coefficients, _ = fit_background(headers(), GAIN, SOUND)
    pose = Pose(40.4, 40.3, pitch_at(80.0), 0.01, 0.53)
    dark = framed(pose, np.zeros((16, 16)), 50, np.random.default_rng(5))
    corner, image = surroundings(dark, pose, 16)
    rows, cols = image.shape
    images = background_images(pose, corner, (rows, cols), half)
    left = image - np.tensordot(coefficients, images[:, 0], 1)
    # background 114 gray levels, panel 5
    assert np.abs(left).mean() < 4
    assert np.abs(image).mean() > 40


def test_slopes_of_the_background_are_those_of_its_square() -> None:
    """The plane is fixed; the square follows the pose."""
    pose, half = Pose(20.3, 19.6, 1.1, 0.05, 0.6), 9.0
    images = background_images(pose, (0, 0), (40, 41), half)
    assert not images[1:, 1:].any()
    assert images[1, 0].min() == images[1, 0].max() == 1
    for k, step in enumerate(1e-4 * np.eye(5)[:4]):
        plus, minus = (
            background_images(Pose.from_vector(pose.vector() + sign * step), (0, 0), (40, 41), half)[0, 0]
            for sign in (1, -1)
        )
        slope = (plus - minus) / 2e-4
        assert np.abs(images[0, 1 + k] - slope).max() < 0.02 * np.abs(slope).max()
