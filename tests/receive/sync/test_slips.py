"""Slip detection: lost frames without a gap in frame numbers."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import slips_oracle as reference
from scenes import ALL_ON, SIDE, draw, frame_of

from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.sync import kernels
from heliograph.receive.sync.slips import SlipWatch
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

POSE, SIGNAL = Pose(30.2, 29.7, 0.61, 0.0, 0.5), SignalSettings(data_pairs=16)

Error = Callable[[int], tuple[float, float]]  # pose error in px by frame number


def before_a_sky(count: int, seed: int) -> list[Frame]:
    """Render packets on a dark panel in front of a bright sky at 95 m."""
    rng, header = np.random.default_rng(seed), header_levels(3, SIDE) / 2.0 - 1.0
    panel = 0.78 * (1 - draw(replace(POSE, pitch=0.61 * 17 / 16), ALL_ON, (0, 0), (60, 60)))
    frames, levels = [], header
    for k in range(count):
        if k % 2 == 0:
            data = rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], (SIDE, SIDE), p=np.array([1, 4, 6, 4, 1]) / 16)
            levels = header if k % SIGNAL.packet_patterns < 2 * SIGNAL.header_pairs else data
        lit = 0.5 + 0.5 * (-1) ** k * levels
        frames.append(replace(frame_of(panel + 0.8 * draw(POSE, lit, (0, 0), (60, 60)), k, rng), time_s=k * 1e-3))
    return frames


def numbers(frames: list[Frame], watch: SlipWatch, error_px: Error = lambda _: (0.0, 0.0)) -> list[int]:
    """Return pattern numbers assigned to frames at poses with an error by frame number."""
    released: list[Frame] = []
    for k, frame in enumerate(frames):
        wrong = POSE.moved(*error_px(k))
        released += watch.push(frame, 0.0, lambda _, pose=wrong: pose, False)  # type: ignore[misc]
    return [round(frame.time_s * 1e3) for frame in [*released, *watch.flush()]]


ERRORS_PX: dict[str, Error] = {
    "alternating": lambda k: (0.5 * np.sin(k / 5), 0.5 * np.cos(k / 7)),
    # as for a fast passing array with unknown velocity
    "wrong for two pairs": lambda k: (1.8 * (-1) ** k, 1.2) if 24 <= k < 28 else (0.0, 0.0),
    # as after an occlusion: the drifted pose jumps back within a pair
    "back at once": lambda k: (1.8, -1.2) if 28 <= k <= 40 else (0.0, 0.0),
}


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("error", ERRORS_PX)
def test_pose_errors_before_a_bright_sky_are_no_slips(error: str, seed: int) -> None:
    assert numbers(before_a_sky(80, seed), SlipWatch(3, SIGNAL), ERRORS_PX[error]) == list(range(80))


@pytest.mark.parametrize("gone", [41, 50, 63])
def test_frame_lost_without_a_gap_is_detected_at_once(gone: int) -> None:
    frames = before_a_sky(120, 1)
    shifted = [*frames[:gone], *(replace(frame, time_s=frame.time_s - 1e-3) for frame in frames[gone + 1 :])]
    # the pair's other frame is dropped too
    assert numbers(shifted, SlipWatch(3, SIGNAL)) == [k for k in range(120) if k // 2 != gone // 2]


def test_late_header_undoes_a_false_slip() -> None:
    watch = SlipWatch(3, SIGNAL)
    watch.lost = 2
    assert numbers(before_a_sky(120, 2), watch)[-40:] == list(range(80, 120))
    assert watch.lost == 0


@pytest.mark.parametrize("width", [1, 3, 5])
def test_kernel_matches_the_oracle(width: int) -> None:
    rng = np.random.default_rng(width)
    # array partly outside the image
    image, pose = rng.uniform(0, 255, (25, 24)), Pose(11.3, 12.9, 1.7, 0.06, 0.5, 0.03, -0.02)
    for rim in (0, 2):
        where = pose.x, pose.y, pose.axes, width, rim, SIDE
        for pixels in (image, image.astype(np.uint8)):
            expected = reference.means_at_leds(pixels.astype(np.float64), *where)
            mean = rng.uniform(100, 150, len(expected))
            light, contrast, power, is_pattern = kernels.light_at_leds(pixels, *where, mean)
            assert light == pytest.approx(expected, rel=1e-9)
            assert contrast == pytest.approx(expected - mean, rel=1e-9)
            assert power == pytest.approx(contrast @ contrast, rel=1e-9)
            assert is_pattern == (np.var(contrast) > 0.25 * np.mean(contrast**2))
