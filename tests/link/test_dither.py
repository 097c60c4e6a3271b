"""Subpixel dither of still arrays at any distance."""

import numpy as np
import pytest
from scenes import link

from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import default_messages, simulate
from heliograph.measure.bench import dithered


def places(settings: LinkSettings) -> np.ndarray:
    """Return (arrays, 2) image centres in px."""
    _, truth = next(simulate(settings, default_messages(settings), 0))
    return np.array([(array.x, array.y) for array in truth.arrays])


@pytest.mark.slow
def test_images_move_by_half_a_pixel_at_most() -> None:
    """The two arrays are nearer and farther than the scene distance."""
    settings = link(
        "channel.distance_m=50",
        "channel.arrays=[{x_m=-0.4, y_m=0.0, z_offset_m=-20.0}, {x_m=0.4, y_m=0.1, z_offset_m=30.0}]",
        "transmit.identities=[0, 7]",
        "channel.duration_s=0.001",
    )
    at = places(settings)
    moves = np.array([places(dithered(settings, seed)) - at for seed in range(60)])
    assert np.abs(moves).max() < 0.501
    # both arrays cover almost the full pixel in both directions
    assert moves.min(0) == pytest.approx(-0.5, abs=0.06)
    assert moves.max(0) == pytest.approx(0.5, abs=0.06)
    # their positions are uncorrelated
    assert abs(np.corrcoef(moves[:, 0, 0], moves[:, 1, 0])[0, 1]) < 0.4
