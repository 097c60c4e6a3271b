"""Timestamps and gray levels: correct values, and memory independent of film length."""

from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.probe.frames import FrameTimes, FrameWatch
from heliograph.probe.levels import Levels, LevelWatch


def frame(number: int, time_s: float, level: int = 0) -> Frame:
    return Frame(number, time_s, np.full((4, 4), level, np.uint8))


def stamped(
    numbers: Iterable[int], jitter_s: float = 0.0, rate_hz: float = 1000.0, claimed_hz: float = 25.0
) -> FrameTimes:
    watch, rng = FrameWatch(claimed_hz), np.random.default_rng(1)
    for number in numbers:
        watch.add(frame(number, number / rate_hz + jitter_s * rng.standard_normal(), number % 251))
    return watch.times()


def test_the_rate_is_that_of_the_stamps_not_what_the_film_claims() -> None:
    times = stamped(range(300))
    assert times.rate_hz == pytest.approx(1000)
    assert times.claimed_hz == 25
    assert times.jitter_s == pytest.approx(0, abs=1e-9)
    assert (times.count, times.lost, times.repeated, times.every) == (300, 0, 0, 1)


@pytest.mark.parametrize("jitter_s", [5e-6, 5e-5])
def test_jitter_of_stamps_is_told(jitter_s: float) -> None:
    assert stamped(range(20_000), jitter_s).jitter_s == pytest.approx(jitter_s, rel=0.05)


def test_lost_frames_are_counted_by_gaps_in_their_numbers() -> None:
    times = stamped(number for number in range(500) if number not in (10, 11, 12, 400))
    assert (times.lost, times.gaps) == (4, 2)
    assert times.rate_hz == pytest.approx(1000)


def test_a_camera_that_keeps_every_third_frame_has_lost_none() -> None:
    times = stamped(number for number in range(0, 900, 3) if number != 300)
    assert (times.every, times.lost, times.gaps) == (3, 1, 1)
    assert times.rate_hz == pytest.approx(1000 / 3)


def test_frames_that_show_the_very_same_are_counted() -> None:
    watch = FrameWatch(1000.0)
    told = [watch.add(frame(k, k / 1000, level)) for k, level in enumerate((1, 1, 2, 3, 3, 3))]
    assert told == [False, True, False, False, True, True]
    assert watch.times().repeated == 3


def test_a_film_without_frames_has_the_rate_that_it_claims() -> None:
    assert FrameWatch(50.0).times().rate_hz == 50


def levels(pictures: Iterator[np.ndarray[tuple[int, int], np.dtype[np.uint16]]], bits: int = 12) -> Levels:
    watch = LevelWatch(8)
    for k, pixels in enumerate(pictures):
        watch.add(Frame(k, k / 1000, pixels, bits))
    return watch.levels()


def test_what_is_at_full_scale_is_told() -> None:
    picture = np.full((10, 10), 100, np.uint16)
    picture[:3] = 4095
    told = levels(iter([picture]))
    assert told.at_full_scale == pytest.approx(0.3)
    assert told.percentiles == {1: 100.0, 50: 100.0, 99: 4095.0}
    assert (told.brightest, told.ceiling, told.full_scale) == (4095, 4095, 4095)


def test_a_sensor_of_fewer_bits_than_its_film_is_told_by_where_light_is_cut_off() -> None:
    rng = np.random.default_rng(2)
    cut = (np.minimum(rng.exponential(400, (64, 64)), 1023).astype(np.uint16) for _ in range(8))
    assert levels(cut).ceiling == 1023
    free = (rng.normal(400, 20, (64, 64)).astype(np.uint16) for _ in range(8))
    assert levels(free).ceiling == 4095


def test_an_even_picture_is_not_cut_off() -> None:
    assert levels(np.full((16, 16), 9, np.uint16) for _ in range(8)).ceiling == 4095
