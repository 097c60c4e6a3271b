"""Time stamps and gray levels: correct values, and memory independent of film length."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.probe.frames import FrameTimes, FrameWatch
from heliograph.probe.levels import Levels, LevelWatch


def frame(number: int, time_s: float, level: int = 0) -> Frame:
    return Frame(number, time_s, np.full((4, 4), level, np.uint8))


def stamped(numbers: Iterable[int], jitter_s: float = 0.0) -> FrameTimes:
    watch, rng = FrameWatch(25.0), np.random.default_rng(1)
    for number in numbers:
        watch.add(frame(number, number / 1000 + jitter_s * rng.standard_normal(), number % 251))
    return watch.times()


def test_rate_follows_from_the_stamps_not_from_the_container() -> None:
    times = stamped(range(300))
    assert times.rate_hz == pytest.approx(1000)
    assert times.claimed_hz == 25
    assert times.jitter_s == pytest.approx(0, abs=1e-9)
    assert (times.count, times.lost, times.repeated, times.every) == (300, 0, 0, 1)
    assert FrameWatch(50.0).times().rate_hz == 50  # no frames


@pytest.mark.parametrize("jitter_s", [5e-6, 5e-5])
def test_jitter_of_stamps_is_measured(jitter_s: float) -> None:
    assert stamped(range(9000), jitter_s).jitter_s == pytest.approx(jitter_s, rel=0.05)


def test_lost_frames_are_counted_by_gaps_in_the_numbers() -> None:
    times = stamped(number for number in range(500) if number not in (10, 11, 12, 400))
    assert (times.lost, times.gaps) == (4, 2)
    assert times.rate_hz == pytest.approx(1000)


def test_recorder_of_every_third_frame_loses_none() -> None:
    times = stamped(number for number in range(0, 900, 3) if number != 300)
    assert (times.every, times.lost, times.gaps) == (3, 1, 1)
    assert times.rate_hz == pytest.approx(1000 / 3)


def test_repeated_frames_are_counted() -> None:
    watch = FrameWatch(1000.0)
    repeated = [watch.add(frame(k, k / 1000, level)) for k, level in enumerate((1, 1, 2, 3, 3, 3))]
    assert repeated == [False, True, False, False, True, True]
    assert watch.times().repeated == 3


def levels(*pictures: NDArray[Any]) -> Levels:
    watch = LevelWatch(8)
    for k, pixels in enumerate(pictures):
        watch.add(Frame(k, k / 1000, pixels.astype(np.uint16), 12))
    return watch.levels()


def test_pixels_at_full_scale_are_counted() -> None:
    picture = np.full((10, 10), 100, np.uint16)
    picture[:3] = 4095
    measured = levels(picture)
    assert measured.at_full_scale == pytest.approx(0.3)
    assert measured.percentiles == {1: 100.0, 50: 100.0, 99: 4095.0}
    assert (measured.brightest, measured.ceiling, measured.full_scale) == (4095, 4095, 4095)


def test_level_of_clipping_shows_a_sensor_with_fewer_bits() -> None:
    rng = np.random.default_rng(2)
    assert levels(*(np.minimum(rng.exponential(400, (64, 64)), 1023) for _ in range(8))).ceiling == 1023
    assert levels(*(rng.normal(400, 20, (64, 64)) for _ in range(8))).ceiling == 4095
    assert levels(*(np.full((16, 16), 9) for _ in range(8))).ceiling == 4095
