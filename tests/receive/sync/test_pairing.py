"""Pairing for synchronous cameras and arbitrary timing: increasing, unique pair numbers despite dropped frames."""

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
from heliograph.receive.geometry.fit import header_amplitudes
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.sync.pairing import (
    AsynchronousPairing,
    DuePair,
    FramePair,
    MeasuredHeader,
    Pairing,
    SynchronousPairing,
)
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

SETTINGS = link("signal.data_pairs=5")
SIGNAL = SETTINGS.signal
POSE = Pose(79.5, 59.5, pitch_at(50.0), 0.0, 0.52)

LEDS = np.ones((16, 16))

# frame rate and light start; only the first is synchronous
RATES = [(1000.0, 2.0e-3), (1000.0, 2.3e-3), (1500.0, 2.2e-3), (2500.0, 2.7e-3)]


@cache
def filmed(fps: float, start_s: float, exposure_s: float | None = None) -> tuple[Frame, ...]:
    """Return 50 ms with three packets; exposure defaults to the full frame period."""
    camera = replace(SETTINGS.channel.camera, fps=fps, exposure_s=exposure_s or 1 / fps)
    arrays = (replace(SETTINGS.channel.arrays[0], start_s=start_s),)
    settings = replace(SETTINGS, channel=replace(SETTINGS.channel, camera=camera, arrays=arrays))
    return tuple(film(settings, 50, roi_margin_px=12))


def pairing_of(start_s: float, exposure_s: float | None = None) -> AsynchronousPairing:
    """Create a pairing as a detection does, a quarter pattern off."""
    return AsynchronousPairing(start_s + 2.5e-4, start_s + 2e-3, POSE, 0, LEDS, SIGNAL, exposure_s)


def due_pairs(pairing: Pairing, frames: Iterable[Frame], single: bool = False) -> Iterator[DuePair]:
    """Yield pairs and measured headers frame by frame, as a receiver does."""
    for frame in frames:
        pairing.push(frame, lambda _: POSE, single)
        while (due := pairing.next_pair(lambda _: POSE, LEDS, single)) is not None:
            yield due


def paired(pairing: Pairing, frames: Iterable[Frame], single: bool = False) -> list[tuple[int, FramePair | None]]:
    due = list(due_pairs(pairing, frames, single))
    pairing.flush()
    while (last := pairing.next_pair(lambda _: POSE, LEDS, single)) is not None:
        due.append(last)
    return [(number, pair) for number, pair in due if not isinstance(pair, MeasuredHeader)]


@examples(20)
@given(rate=st.sampled_from(RATES), dropped=st.sets(st.integers(0, 124), max_size=40))
@pytest.mark.slow
def test_asynchronous_pairs_come_once_in_order_with_their_frames(rate: tuple[float, float], dropped: set[int]) -> None:
    pairing = pairing_of(rate[1])
    got = paired(pairing, [frame for frame in filmed(*rate) if frame.index not in dropped])
    assert [number for number, _ in got] == list(range(len(got)))
    assert not (pairing.lost and got)
    # the phase estimate needs a frame from the first header
    near = 3.5e-4 if dropped & set(range(20)) else 1.5e-4
    for number, pair in got:
        first = rate[1] + 2 * number * 1e-3
        if pair is None:
            continue
        assert pair.pattern.index <= pair.inverted.index
        if pair.combination is None:
            # two camera frames, one pattern apart
            assert not {pair.pattern.index, pair.inverted.index} & dropped
            times_s = pair.pattern.time_s, pair.inverted.time_s
            assert times_s == pytest.approx((first, first + 1e-3), abs=near)
        else:
            assert first - 1e-3 < pair.time_s < first + 2e-3


@pytest.mark.parametrize(("fps", "start_s"), RATES)
def test_complete_films_give_every_pair(fps: float, start_s: float) -> None:
    pairing, in_step = pairing_of(start_s), (fps, start_s) == RATES[0]
    got = paired(pairing, filmed(fps, start_s))
    assert [number for number, _ in got] == list(range(int((50 - 1e3 * start_s) / 2)))
    # an unsynchronised detection sees a weak header, so pairing measures the gain
    assert pairing.first_gain == (None if in_step else pytest.approx(0.8 * 255, rel=0.1))
    for number, pair in got:
        assert isinstance(pair, FramePair)
        assert isinstance(pair.pattern, CombinedFrame) == (not in_step)
        if number % 7 < 2:
            up, down = header_amplitudes((pair.pattern, pair.inverted), POSE, header_levels(0) / 2.0 - 1.0)
            # the difference equals the header's full contrast, as for synchronous cameras
            assert up - down == pytest.approx(0.8 * 255, rel=0.1)
        if pair.combination is not None:
            # half a pattern before the mean light time, relative to the pair or its header
            place = 2 * (number if number % 7 >= 2 else number - number % 7) + pair.combination.sum_time - 0.5
            assert pair.time_s == pytest.approx(start_s + 1e-3 * place, abs=3e-5)
    # a single header gives the start within 0.1 patterns if synchronous, more accurately otherwise
    assert pairing.origin_s == pytest.approx(start_s, abs=1e-4 if in_step else 2e-5)


def test_no_pair_comes_before_the_end_of_the_header() -> None:
    pairing, frames = pairing_of(2.0e-3), filmed(1000.0, 2.0e-3)
    assert (pairing.now_s, pairing.origin_s) == pytest.approx((4.0e-3, 2.25e-3))
    # four header patterns, three more, and a frame for slip detection
    assert [len(list(due_pairs(pairing, [frame]))) for frame in frames[:16]] == [0] * 10 + [3, 0, 1, 1, 0, 1]
    # middle of the last pattern in six pairs
    assert pairing.now_s == pytest.approx(13e-3, abs=1e-4)


def test_header_of_noise_or_before_the_film_is_lost() -> None:
    rng, frames = np.random.default_rng(0), filmed(*RATES[0])
    late = [frame for frame in frames if frame.time_s > RATES[0][1] + 3e-3]
    noise = [replace(f, pixels=rng.integers(0, 255, f.pixels.shape, np.uint8)) for f in frames]
    for unreadable in (late, noise):
        pairing = pairing_of(RATES[0][1])
        assert (paired(pairing, unreadable), pairing.lost) == ([], True)


@pytest.mark.parametrize("single", [False, True])
def test_data_without_inverses_are_not_combined(single: bool) -> None:
    """With exposure 0.7 T_b, pairs are combined although each frame shows a single pattern."""
    frames = filmed(1000.0, 2.0e-3, 0.7e-3)
    got = paired(pairing_of(2.0e-3, 0.7e-3), frames, single)
    assert len(got) == 23
    for number, pair in got:
        assert isinstance(pair, FramePair)
        assert isinstance(pair.pattern, Frame) == (single and number % 7 >= 2)


def test_complete_header_gives_the_gain_and_a_uniform_sum() -> None:
    due = due_pairs(pairing_of(RATES[2][1]), filmed(*RATES[2]))
    measured = [(number, header) for number, header in due if isinstance(header, MeasuredHeader)]
    assert [number for number, _ in measured] == [2, 9, 16]
    for _, header in measured:
        assert header.gain == pytest.approx(0.8 * 255, rel=0.05)
        # 1.5 frames per pattern: four or five frames within four header patterns
        assert len(header.images) in (4, 5)
        assert header.alternation.shape == header.light.shape == (2, len(header.images))
        assert header.pair is not None
        total = header.pair.pattern.pixels + header.pair.inverted.pixels
        middle = total[tuple(slice(size // 2 - 4, size // 2 + 4) for size in total.shape)]
        assert np.std(middle) < 0.05 * np.mean(middle)


@pytest.mark.parametrize(("rate", "numbers"), [(RATES[0], []), (RATES[2], [2, 16])])
def test_synchronous_or_unseen_header_is_not_measured(rate: tuple[float, float], numbers: list[int]) -> None:
    # the second header lasts from 14 to 18 ms
    frames = [frame for frame in filmed(*rate) if not 13e-3 < frame.time_s - rate[1] < 19e-3]
    due = list(due_pairs(pairing_of(rate[1]), frames))
    assert len(due) > 15
    assert [number for number, pair in due if isinstance(pair, MeasuredHeader)] == numbers


SHORT = SignalSettings(data_pairs=3)  # packets with five pairs, two of which are headers


def dark(number: int, start_s: float = 0.0) -> Frame:
    return Frame(number, start_s + number * 1e-3, np.zeros((4, 4), np.uint8))


@examples(80)
@given(
    dropped=st.sets(st.integers(0, 59)),
    before=st.integers(0, 5),
    start_s=st.sampled_from([0.0, 0.0371, 2.0]),
    jitter=st.floats(0, 0.4),
)
@pytest.mark.slow
def test_synchronous_pairs_come_once_in_order(dropped: set[int], before: int, start_s: float, jitter: float) -> None:
    numbers = [k for k in range(-before, 60) if k not in dropped]
    frames = [replace(dark(k + before), time_s=start_s + 1e-3 * (k + jitter * np.sin(k))) for k in numbers]
    got = paired(SynchronousPairing(start_s, start_s + 1.5e-3, 0, SHORT), frames)
    # a pair is complete as soon as its last or a later frame arrives
    assert [number for number, _ in got] == list(range((max(numbers, default=-1) + 1) // 2))
    for number, pair in got:
        shown = pair and (pair.pattern.index, pair.inverted.index, pair.combination)
        whole = not {2 * number, 2 * number + 1} & dropped
        assert shown == ((2 * number + before, 2 * number + 1 + before, None) if whole else None)


def test_data_light_is_early_and_header_light_is_not() -> None:
    got = paired(SynchronousPairing(0.0, 1.5e-3, 0, SHORT), [dark(k) for k in range(20)])
    late = [pair.late_s for _, pair in got if pair is not None]
    # (15 1/2 + 11 3/2 + 5 5/2 + 1 7/2) / 32 slots, each 0.25 ms, minus half a pattern
    data = (15 * 0.5 + 11 * 1.5 + 5 * 2.5 + 3.5) / 32 * 0.25e-3 - 0.5e-3
    assert late == pytest.approx([0, 0, data, data, data] * 2)


def test_synchronous_pairing_times() -> None:
    pairing = SynchronousPairing(0.1, 0.1015, 0, SHORT)
    assert (pairing.origin_s, pairing.now_s) == (0.1, 0.1015)
    paired(pairing, [dark(0, 0.1)])
    assert pairing.now_s == 0.1015
    assert len(paired(pairing, [dark(7, 0.1)])) == 4
    assert pairing.now_s == pytest.approx(0.107)
    assert (pairing.lost, pairing.first_gain) == (False, None)
    pairing.flush()
    assert pairing.next_pair(lambda _: POSE, np.ones((8, 8)), False) is None
