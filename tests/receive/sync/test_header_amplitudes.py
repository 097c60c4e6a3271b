"""Header amplitudes in surrounding frames, against rendered amplitudes."""

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.sync.light_clock import measure_amplitudes

SIDE, POSE = 16, Pose(20.3, 19.6, 1.6, 0.0, 0.55)
SHAPE = 40, 40


def frames_of(light: NDArray[np.float64], header: NDArray[np.float64], amplitudes: list[float]) -> list[Frame]:
    """Render frames with array light and header amplitudes on a uniform background."""
    on, sign = (image_of(levels, POSE, (0, 0), SHAPE) for levels in (light, light * header))
    return [Frame(k, 1e-3 * k, np.round(30 + 90 * on + a * sign).astype(np.uint8)) for k, a in enumerate(amplitudes)]


@pytest.mark.parametrize("dead", [0.0, 0.3])
def test_amplitudes_are_those_that_were_drawn(dead: float) -> None:
    rng = np.random.default_rng(1)
    header = np.where(rng.random((SIDE, SIDE)) < 0.5, -1.0, 1.0)
    gains = np.where(rng.random((SIDE, SIDE)) < dead, 0.0, 1.0)
    drawn = [40.0, -40.0, 10.0, 0.0]
    seen = measure_amplitudes(frames_of(gains, header, drawn), [POSE] * 4, header * gains)
    assert seen.alternation == pytest.approx(drawn, abs=0.5)
    assert np.ptp(seen.brightness) < 2
    assert not seen.clipped


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_where_only_lit_leds_or_only_dark_ones_are_left_nothing_grows_beyond_bounds(sign: float) -> None:
    header = np.full((SIDE, SIDE), sign)
    seen = measure_amplitudes(frames_of(np.ones((SIDE, SIDE)), header, [0.0, 20.0]), [POSE] * 2, header)
    assert np.abs(seen.alternation).max() < 120
    assert np.isfinite(seen.brightness).all()


def test_without_any_led_nothing_is_seen() -> None:
    nothing = np.zeros((SIDE, SIDE))
    seen = measure_amplitudes(frames_of(nothing, nothing, [0.0, 0.0]), [POSE] * 2, nothing)
    assert seen.alternation == pytest.approx([0, 0])


def test_one_frame_at_full_scale_is_told() -> None:
    header = np.where(np.arange(SIDE**2).reshape(SIDE, SIDE) % 2, 1.0, -1.0)
    frames = frames_of(np.ones((SIDE, SIDE)), header, [10.0, 10.0])
    assert not measure_amplitudes(frames, [POSE] * 2, header).clipped
    frames[1].pixels[10:30, 10:30] = 255
    assert measure_amplitudes(frames, [POSE] * 2, header).clipped
