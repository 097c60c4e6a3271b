"""Headers half a pattern out of step."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import film, link

from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.receive.detect.budget import TokenBucket
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.detector import Detector, HalfPeriodDetector
from heliograph.signal.settings import SignalSettings

PARAMETERS = SearchParameters(
    min_side_px=4.0, max_side_px=64.0, min_contrast=0.03, score=0.9, regularity=0.15, candidates=6, blur_px=0.55
)


def frames_at(
    phase: float, distance_m: float, identity: int = 5, seed: int = 1, count: int = 12, before: int = 3
) -> list[Frame]:
    """Return frames with the end of a packet, then a header after `before` + `phase` patterns."""
    settings = link(f"transmit.identities=[{identity}]", "signal.data_pairs=16", distance_m=distance_m)
    start_s = (before + phase - 36) * 1e-3
    array = replace(settings.channel.arrays[0], start_s=start_s)
    return film(replace(settings, channel=replace(settings.channel, arrays=(array,))), count, seed)


def detector_with(budget: TokenBucket, min_novelty: float = 1.3) -> HalfPeriodDetector:
    return HalfPeriodDetector(Detector(PARAMETERS, SignalSettings(), budget), min_novelty)


def found(frames: list[Frame]) -> list[Detection]:
    detector = detector_with(TokenBucket(1e6, 1e-3))
    return [one for frame in frames for one in detector.search(frame)]


@pytest.mark.parametrize("phase", [0.46, 0.5, 0.54])
@pytest.mark.parametrize(("distance_m", "identity"), [(30.0, 0), (50.0, 13), (90.0, 29)])
def test_a_header_is_found_half_a_pattern_out_of_step(phase: float, distance_m: float, identity: int) -> None:
    (one,) = found(frames_at(phase, distance_m, identity))
    assert one.identity == identity
    assert one.start_time_s == pytest.approx((3 + phase) * 1e-3, abs=1e-4)
    assert one.fit.pose.pitch == pytest.approx(58.3 / distance_m, rel=0.05)


def test_its_gain_is_that_of_the_array_with_all_leds_on() -> None:
    (one,) = found(frames_at(0.5, 80.0))
    # reference link: 0.8 full scale
    assert one.fit.gain == pytest.approx(0.8 * 255, rel=0.1)


@pytest.mark.parametrize("phase", [0.46, 0.5, 0.54])
@pytest.mark.parametrize(("distance_m", "identity"), [(30.0, 0), (50.0, 13), (100.0, 29)])
def test_it_is_found_with_a_bound_and_its_data_are_mostly_left_out(
    phase: float, distance_m: float, identity: int
) -> None:
    """A header changes more than equally many data patterns, for either first frame."""
    work = list[float]()
    for min_novelty in (1.3, 0.0):
        budget = TokenBucket(1.0, 1e-3)
        # at 90 % of capacity the search skips blocks without novelty
        budget.charge(used := 0.1 * budget.capacity)
        detector, header = detector_with(budget, min_novelty), list[Detection]()
        for k, frame in enumerate(frames_at(phase, distance_m, identity, count=76, before=32)):
            header += detector.search(frame)
            if k == 30:
                # before the header
                work.append(budget.load.work - used)
        if min_novelty:
            due = [one for one in header if one.start_time_s == pytest.approx((32 + phase) * 1e-3, abs=1e-4)]
            assert [one.identity for one in due] == [identity]
    assert work[0] < 0.7 * work[1]


@pytest.mark.parametrize("before", [0, 1, 2])
def test_a_header_seen_first_is_found_with_a_bound(before: int) -> None:
    """Without history every block is novel."""
    budget = TokenBucket(1.0, 1e-3)
    budget.charge(0.1 * budget.capacity)
    detector = detector_with(budget)
    shown = [one for frame in frames_at(0.5, 50.0, count=12, before=before) for one in detector.search(frame)]
    assert [one.identity for one in shown] == [5]


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.5])
def test_data_are_no_header(phase: float) -> None:
    frames = frames_at(phase, 50.0, count=40)[9:]
    assert len(frames) > 28
    assert found(frames) == []


def test_a_header_in_step_is_not_quiet() -> None:
    assert found(frames_at(0.0, 50.0)) == []


def test_frames_of_nothing_hold_no_header() -> None:
    rng = np.random.default_rng(2)
    assert found([Frame(k, k * 1e-3, rng.integers(20, 24, (64, 64), np.uint8)) for k in range(12)]) == []


def test_a_gap_begins_the_search_anew() -> None:
    frames = frames_at(0.5, 50.0)
    late = [frame if k < 5 else replace(frame, index=frame.index + 1) for k, frame in enumerate(frames)]
    assert found(late) == []
