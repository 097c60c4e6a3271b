"""Fast lateral motion and camera shake: the image moves by pixels per frame."""

import numpy as np
import pytest
from recorder import Recorder
from scenes import SIDE, draw, frame_of, received, statuses

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import Pose
from heliograph.receive.sync.light_clock import measure_amplitudes
from heliograph.signal.header import header_levels


def passing(receiver: str, distance_m: float, speed_m_s: float, yaw_deg: float) -> LinkSettings:
    """Return settings for three packets during a pass across the sensor centre."""
    half_m = 0.5 * speed_m_s * 0.161
    array = {"x_m": -half_m, "y_m": 0.2, "vx_m_s": speed_m_s, "yaw_deg": yaw_deg}
    received_by = {"receive": {"receiver": receiver}, "signal": {"data_pairs": 24}}
    channel = {"distance_m": distance_m, "duration_s": 0.161, "arrays": [array]}
    return load_settings("crossing", {**received_by, "channel": channel})


@pytest.mark.parametrize(
    ("receiver", "distance_m", "speed_m_s", "yaw_deg"),
    [("soft", 30.0, 16.0, 22.0), ("soft", 18.0, 12.0, -20.0), ("soft", 38.0, 8.0, 5.0), ("plain", 18.0, 12.0, -20.0)],
)
@pytest.mark.slow
def test_passing_array_is_read(receiver: str, distance_m: float, speed_m_s: float, yaw_deg: float) -> None:
    """At 1.5 px per frame, motion resembled a phase shift, blur or stretch."""
    settings, recorder = passing(receiver, distance_m, speed_m_s, yaw_deg), Recorder()
    frames = [frame for frame, _ in simulate(settings, default_messages(settings), 3, None, 40)]
    assert statuses(received(frames, settings, recorder)) == ["ok"] * 3
    assert len(recorder.found_s) == 1


def test_moving_background_does_not_mislead_the_clock() -> None:
    """An approaching bright edge lowered the apparent array brightness relative to its surroundings."""
    rng, header = np.random.default_rng(2), header_levels(5, SIDE) / 2.0 - 1.0
    frames, poses = [], []
    for k in range(8):
        pose = Pose(40.0, 40.0, 2.0, 0.0, 0.55)
        levels = 0.5 * np.ones((SIDE, SIDE)) + (0.5 * (-1) ** k * header if 2 <= k < 6 else 0.0)
        # background wall with an approaching edge
        behind = 0.1 + 0.6 * (np.arange(80) < 8 + 2 * k)
        panel = draw(pose, np.ones((SIDE, SIDE)), (0, 0), (80, 80))
        frames.append(frame_of((1 - panel) * behind + 0.3 * draw(pose, levels, (0, 0), (80, 80)), k, rng))
        poses.append(pose)
    view = measure_amplitudes(frames, poses, header)
    assert np.ptp(view.brightness) < 0.06 * 0.3 * 255
    assert np.abs(view.alternation[[2, 4]] - 0.15 * 255).max() < 4
