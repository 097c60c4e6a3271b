"""Pairing for arbitrary camera timing: increasing, unique pair numbers despite dropped frames."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from scenes import film, link, pitch_at

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.geometry.fit import header_amplitudes
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.sync.pairing import (
    AsynchronousPairing,
    DuePair,
    FramePair,
    MeasuredHeader,
)
from heliograph.signal.header import header_levels

SETTINGS = link("signal.data_pairs=5")
SIGNAL = SETTINGS.signal
POSE = Pose(79.5, 59.5, pitch_at(50.0), 0.0, 0.52)

RATES = [(1000.0, 2.0e-3), (1000.0, 2.3e-3), (1500.0, 2.2e-3), (2500.0, 2.7e-3)]
"""Frame rate and light start; only the first entry is synchronous."""


@cache
def filmed(fps: float, start_s: float, exposure_s: float | None = None) -> tuple[Frame, ...]:
    """Return 50 ms with three packets; exposure defaults to the full frame period."""
    channel = SETTINGS.channel
    camera = replace(channel.camera, fps=fps, exposure_s=exposure_s or 1 / fps)
    arrays = (replace(channel.arrays[0], start_s=start_s),)
    return tuple(film(replace(SETTINGS, channel=replace(channel, camera=camera, arrays=arrays)), 50, roi_margin_px=12))


def pairing_of(start_s: float, exposure_s: float | None = None) -> AsynchronousPairing:
    """Create a pairing as a detection does, a quarter pattern off."""
    return AsynchronousPairing(start_s + 2.5e-4, start_s + 2e-3, POSE, 0, np.ones((16, 16)), SIGNAL, exposure_s)


def taken(pairing: AsynchronousPairing, frames: Iterable[Frame], single: bool = False) -> Iterator[DuePair]:
    """Yield pairs and measured headers frame by frame, as a receiver does."""
    for frame in frames:
        pairing.push(frame, lambda _: POSE, single)
        while (due := pairing.next_pair(lambda _: POSE, np.ones((16, 16)), single)) is not None:
            yield due


def paired(
    pairing: AsynchronousPairing, frames: list[Frame], single: bool = False
) -> list[tuple[int, FramePair | None]]:
    due = list(taken(pairing, frames, single))
    pairing.flush()
    while (last := pairing.next_pair(lambda _: POSE, np.ones((16, 16)), single)) is not None:
        due.append(last)
    return [(number, pair) for number, pair in due if not isinstance(pair, MeasuredHeader)]


@examples(40)
@given(rate=st.sampled_from(RATES), dropped=st.sets(st.integers(0, 124), max_size=40))
@pytest.mark.slow
def test_each_pair_comes_once_in_order_with_frames_of_its_time(rate: tuple[float, float], dropped: set[int]) -> None:
    fps, start_s = rate
    pairing = pairing_of(start_s)
    frames = [frame for frame in filmed(fps, start_s) if frame.index not in dropped]
    got = paired(pairing, frames)
    assert [number for number, _ in got] == list(range(len(got)))
    if pairing.lost:
        assert not got
        return
    # the phase estimate needs a frame from the first header
    near = 3.5e-4 if dropped & set(range(20)) else 1.5e-4
    for number, pair in got:
        first = start_s + 2 * number * 1e-3
        if pair is None:
            continue
        assert pair.pattern.index <= pair.inverted.index
        if pair.combination is None:
            # two camera frames, one pattern apart
            assert not {pair.pattern.index, pair.inverted.index} & dropped
            assert pair.pattern.time_s == pytest.approx(first, abs=near)
            assert pair.inverted.time_s == pytest.approx(first + 1e-3, abs=near)
        else:
            assert first - 1e-3 < pair.time_s < first + 2e-3


@pytest.mark.parametrize(("fps", "start_s"), RATES)
def test_whole_films_give_every_pair(fps: float, start_s: float) -> None:
    pairing = pairing_of(start_s)
    got = paired(pairing, list(filmed(fps, start_s)))
    assert not pairing.lost
    assert [number for number, _ in got] == list(range(int((50 - 1e3 * start_s) / 2)))
    pairs = [pair for _, pair in got]
    assert all(pair is not None for pair in pairs)
    in_step = (fps, start_s) == RATES[0]
    assert {isinstance(pair.pattern, CombinedFrame) for pair in pairs if isinstance(pair, FramePair)} == {not in_step}
    # an unsynchronised detection sees a weak header, so pairing measures the gain
    assert (pairing.first_gain is None) == in_step
    assert pairing.first_gain is None or pairing.first_gain == pytest.approx(0.8 * 255, rel=0.1)
    signs = header_levels(0) / 2.0 - 1.0
    for number, pair in got:
        assert isinstance(pair, FramePair)
        if number % 7 < 2:
            up, down = header_amplitudes((pair.pattern, pair.inverted), POSE, signs)
            # the difference equals the header's full contrast, as for synchronous cameras
            assert up - down == pytest.approx(0.8 * 255, rel=0.1)
        if pair.combination is not None:
            # half a pattern before the mean light time, relative to the pair or its header
            place = 2 * (number if number % 7 >= 2 else number - number % 7) + pair.combination.sum_time - 0.5
            assert pair.time_s == pytest.approx(start_s + 1e-3 * place, abs=3e-5)
    # a single header gives the start within 0.1 patterns if synchronous, more accurately otherwise
    assert pairing.origin_s == pytest.approx(start_s, abs=1e-4 if in_step else 2e-5)


def test_before_the_header_is_over_no_pair_is_read() -> None:
    pairing, frames = pairing_of(2.0e-3), filmed(1000.0, 2.0e-3)
    assert (pairing.now_s, pairing.origin_s) == pytest.approx((4.0e-3, 2.25e-3))
    counts = [sum(not isinstance(pair, MeasuredHeader) for _, pair in taken(pairing, [frame])) for frame in frames[:16]]
    # four header patterns, three more, and a frame for slip detection
    assert counts == [0] * 10 + [3, 0, 1, 1, 0, 1]
    # middle of the last pattern in six pairs
    assert pairing.now_s == pytest.approx(13e-3, abs=1e-4)


def test_a_header_from_before_the_film_is_lost() -> None:
    start_s = 2.0e-3
    pairing = pairing_of(start_s)
    late = [frame for frame in filmed(1000.0, start_s) if frame.time_s > start_s + 3e-3]
    assert paired(pairing, late) == []
    assert pairing.lost


def test_what_is_no_header_is_lost() -> None:
    rng, start_s = np.random.default_rng(0), 2.0e-3
    noise = [
        replace(frame, pixels=rng.integers(0, 255, frame.pixels.shape).astype(np.uint8))
        for frame in filmed(1000.0, start_s)
    ]
    pairing = pairing_of(start_s)
    assert paired(pairing, noise) == []
    assert pairing.lost


@pytest.mark.parametrize("single", [False, True])
def test_data_without_inverses_are_read_frame_by_frame(single: bool) -> None:
    """With exposure 0.7 T_b, pairs are combined although each frame shows a single pattern."""
    frames = list(filmed(1000.0, 2.0e-3, 0.7e-3))
    got = paired(pairing_of(2.0e-3, 0.7e-3), frames, single)
    assert len(got) == 23
    for number, pair in got:
        assert isinstance(pair, FramePair)
        assert isinstance(pair.pattern, Frame) == (single and number % 7 >= 2)


def test_a_whole_header_gives_the_gain_and_an_even_sum() -> None:
    fps, start_s = RATES[2]
    measured = [due for due in taken(pairing_of(start_s), filmed(fps, start_s)) if isinstance(due[1], MeasuredHeader)]
    assert [number for number, _ in measured] == [2, 9, 16]
    for _, header in measured:
        assert isinstance(header, MeasuredHeader)
        assert header.gain == pytest.approx(0.8 * 255, rel=0.05)
        assert header.pair is not None
        # 1.5 frames per pattern: four or five frames within four header patterns
        assert len(header.images) in (4, 5)
        assert header.alternation.shape == header.light.shape == (2, len(header.images))
        total = header.pair.pattern.pixels + header.pair.inverted.pixels
        middle = tuple(slice(size // 2 - 4, size // 2 + 4) for size in total.shape)
        assert np.std(total[middle]) < 0.05 * np.mean(total[middle])


def test_a_header_in_step_gives_no_more() -> None:
    fps, start_s = RATES[0]
    due = list(taken(pairing_of(start_s), filmed(fps, start_s)))
    assert len(due) > 15
    assert not any(isinstance(pair, MeasuredHeader) for _, pair in due)
