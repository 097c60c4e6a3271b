"""Header velocity from single frames."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import SIDE, draw, frame_of, pitch_at

from heliograph.receive import Pose
from heliograph.receive.detect.candidate import estimate_drift
from heliograph.signal.header import header_levels


def seen(distance_m: float, drift: tuple[float, float], late: float, seed: int) -> tuple[float, float]:
    """Estimate the drift in px per pattern for a header `late` patterns late, with full exposure."""
    rng, header = np.random.default_rng(seed), header_levels(seed, SIDE) / 2.0 - 1.0
    x, y = (float(v) for v in rng.uniform(58, 62, 2))
    pose, frames = Pose(x, y, pitch_at(distance_m), float(rng.normal(0, 0.02)), 0.51), []
    for k in range(4):
        # late frames mix with the next pattern
        amount = (1 - 2 * late) * (-1) ** k
        image = draw(
            pose.moved((k - 0.5) * drift[0], (k - 0.5) * drift[1]), 0.5 + 0.5 * amount * header, (0, 0), (120, 120)
        )
        frames.append(replace(frame_of(0.1 + 0.7 * image, k, rng), time_s=k * 1e-3))
    vx, vy = estimate_drift(frames, pose, 0.5e-3, header, 1e-3)
    return vx * 1e-3, vy * 1e-3


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("distance_m", "within"), [(18.0, 0.05), (30.0, 0.05), (60.0, 0.06), (95.0, 0.1)])
def test_any_motion_is_found(distance_m: float, within: float, seed: int) -> None:
    rng = np.random.default_rng([seed, round(distance_m)])
    speed, angle = rng.uniform(0, 2 if distance_m < 50 else 0.9), rng.uniform(0, 2 * np.pi)
    drift = float(speed * np.cos(angle)), float(speed * np.sin(angle))
    assert seen(distance_m, drift, float(rng.uniform(0, 0.3)), seed) == pytest.approx(drift, abs=within)
