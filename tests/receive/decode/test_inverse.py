"""Channel inverse against the explicit matrix and against sampling at LED positions."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from render_oracle import blur_matrix
from scenes import SIDE, draw, film, levels, link, pitch_at

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Pose, ReceiveSettings, receive_frames
from heliograph.receive.decode.per_led import luminances, pair_luminances, unblurred
from heliograph.receive.events import ExtractEvent
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.settings import Equaliser, PlainSettings

Floats = NDArray[np.float64]

GAIN = 200.0
SIZE = 44


def shown(pose: Pose, x: Floats, index: int = 0) -> CombinedFrame:
    """Render a noiseless frame without quantisation."""
    light = 30.0 + GAIN * draw(pose, x, (0, 0), (SIZE, SIZE))
    return CombinedFrame(index, index * 1e-3, light.astype(np.float32), (0, 0), 255)


def pair(poses: tuple[Pose, Pose], x: Floats) -> tuple[CombinedFrame, CombinedFrame]:
    return shown(poses[0], x), shown(poses[1], 1 - x, 1)


@pytest.mark.parametrize("roll", [0.0, 0.05])
def test_luminances_come_back_at_60_m_without_noise(roll: float) -> None:
    pose = Pose(21.2, 20.7, pitch_at(60), roll, 0.52)
    x = np.random.default_rng(1).integers(0, 5, (SIDE, SIDE)) / 4
    found = unblurred(pair((pose, pose), x), (pose, pose), GAIN, SIDE, loading=1e-10)
    assert np.allclose(found, 4 * x - 2, atol=1e-4)


def test_the_solution_is_that_of_the_normal_equations() -> None:
    pose = Pose(21.2, 20.7, pitch_at(70), 0.02, 0.52)
    rng = np.random.default_rng(2)
    first, second = (Frame(k, 0.0, rng.integers(0, 255, (SIZE, SIZE)).astype(np.uint8)) for k in range(2))
    found = unblurred((first, second), (pose, pose), GAIN, SIDE, loading=1e-3)
    # receiver window: 2.5 px beyond the array
    half = 8 * pose.pitch * (np.cos(0.02) + np.sin(0.02)) + 2.5
    x0, y0 = int(np.floor(pose.x - half)), int(np.floor(pose.y - half))
    w, h = int(np.ceil(pose.x + half)) - x0 + 1, int(np.ceil(pose.y + half)) - y0 + 1
    a = blur_matrix(pose, SIDE, (x0, y0), (h, w))
    change = (first.pixels.astype(float) - second.pixels)[y0 : y0 + h, x0 : x0 + w].ravel() / GAIN
    expected = np.linalg.solve(a.T @ a + 1e-3 * np.eye(SIDE * SIDE), a.T @ change)
    assert np.allclose(found.ravel(), 2 * expected, atol=1e-5)


def test_motion_between_the_frames_is_undone() -> None:
    poses = Pose(21.2, 20.7, pitch_at(50), 0.0, 0.52), Pose(21.25, 21.0, pitch_at(50), 0.0, 0.52)
    x = np.random.default_rng(3).integers(0, 5, (SIDE, SIDE)) / 4
    found = unblurred(pair(poses, x), poses, GAIN, SIDE, loading=1e-8)
    assert np.allclose(found, 4 * x - 2, atol=0.05)


def test_gray_levels_without_gain_do_not_break_it() -> None:
    pose = Pose(21.2, 20.7, pitch_at(50), 0.0, 0.52)
    dark = Frame(0, 0.0, np.zeros((SIZE, SIZE), np.uint8))
    assert not unblurred((dark, dark), (pose, pose), 0.0, SIDE).any()


def test_by_default_leds_are_read_at_their_positions() -> None:
    assert ReceiveSettings().plain.equaliser == "none"
    pose = Pose(21.2, 20.7, pitch_at(50), 0.0, 0.52)
    frames = pair((pose, pose), np.random.default_rng(4).integers(0, 5, (SIDE, SIDE)) / 4)
    plain = 2 * (luminances(frames[0], pose, SIDE) - luminances(frames[1], pose, SIDE)) / GAIN
    assert np.array_equal(pair_luminances(frames, (pose, pose), GAIN, SIDE), plain)
    assert np.array_equal(pair_luminances(frames, (pose, pose), GAIN, SIDE, "none"), plain)
    inverse = unblurred(frames, (pose, pose), GAIN, SIDE)
    assert np.array_equal(pair_luminances(frames, (pose, pose), GAIN, SIDE, "inverse"), inverse)


def test_an_unknown_equaliser_is_refused() -> None:
    with pytest.raises(SettingsError, match="equaliser"):
        from_mapping(ReceiveSettings, {"plain": {"equaliser": "zero-forcing"}})


def wrong_leds(settings: LinkSettings, equaliser: Equaliser, sent: list[NDArray[np.bool_]]) -> float:
    """Return the receiver's LED error rate."""
    errors: list[float] = []

    def observe(event: Any) -> None:
        if isinstance(event, ExtractEvent):
            assert event.luminances is not None
            errors.append(float(np.mean((event.luminances > 0) != sent[event.frames[0].index])))

    receive = replace(settings.receive, plain=PlainSettings(equaliser=equaliser))
    list(receive_frames(film(settings, len(sent)), settings.signal, receive, observe))
    assert len(errors) > 20
    return float(np.mean(errors))


@pytest.mark.parametrize("distance_m", [50.0, 57.0])
@pytest.mark.slow
def test_the_inverse_beats_reading_at_the_positions(distance_m: float) -> None:
    """Full link: estimated pose and blur, sensor noise."""
    settings = link("signal.modulation=ook", distance_m=distance_m)
    sent = [pattern > 2 for pattern, _ in zip(levels(settings), range(60), strict=False)]
    equalisers: tuple[Equaliser, ...] = ("none", "inverse")
    wrong = {equaliser: wrong_leds(settings, equaliser, sent) for equaliser in equalisers}
    assert wrong["none"] > 5e-3
    assert wrong["inverse"] < wrong["none"] / 20
