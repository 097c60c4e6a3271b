"""Search budget in scenes with excessive alternation."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import ReceiveSettings, make_receiver
from heliograph.receive.detect.alternation import SearchParameters, SearchRegion
from heliograph.receive.detect.budget import WORK_PER_MS, NoveltyFilter, SearchLoad, TokenBucket
from heliograph.receive.detect.detector import Candidate, Detector
from heliograph.receive.detect.header_bank import headers
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.events import DetectEvent, DropEvent, Event
from heliograph.receive.geometry.pose import UPRIGHT
from heliograph.receive.settings import DetectSettings
from heliograph.signal.header import all_header_cells
from heliograph.signal.settings import SignalSettings

PARAMETERS = SearchParameters(
    min_side_px=8.0, max_side_px=32.0, min_contrast=0.03, score=0.9, regularity=0.15, candidates=6, blur_px=0.55
)
SOUGHT = headers((UPRIGHT,))


def flicker(count: int, seed: int, shape: tuple[int, int] = (96, 128)) -> list[Frame]:
    """Return frames with independent random gray levels in 8 px squares."""
    levels = np.random.default_rng(seed).integers(0, 256, (count, shape[0] // 8, shape[1] // 8), np.uint8)
    return [Frame(k, 1e-3 * k, np.kron(one, np.ones((8, 8), np.uint8))) for k, one in enumerate(levels)]


FRAME = Frame(0, 0.0, np.zeros((160, 240), np.uint8))
EVERYTHING = np.ones((20, 30), bool)


def started(budget: TokenBucket, busy: NDArray[np.bool_] = EVERYTHING) -> bool:
    return bool(budget.start_search(NoveltyFilter(), np.ones((20, 30), np.float32), busy, FRAME).any())


def test_work_is_earned_by_the_pattern_and_kept_for_later() -> None:
    budget, pattern = TokenBucket(0.5, 1e-3), 0.5 * WORK_PER_MS
    assert started(budget)
    assert budget.try_fit(1.0)
    # a search may use only a fraction of the level
    budget.charge(0.0501 * budget.level)
    assert not budget.try_fit(1.0)
    assert budget.coarse_work <= 0
    assert started(budget)
    assert budget.try_fit(1.0)
    budget.charge(0.5 * budget.capacity)
    assert started(budget)
    assert budget.coarse_work == pytest.approx(0.5 * 0.05 * budget.level)
    fitted, dropped, blocks = budget.load.fitted, budget.load.dropped, budget.load.blocks
    assert (fitted, dropped) == (2, 1)
    budget.charge(budget.capacity)
    assert not started(budget)
    assert (budget.load.fitted, budget.load.dropped, budget.load.blocks) == (2, 1, blocks + EVERYTHING.size)
    for _ in range(round(1.7 * budget.capacity / pattern)):
        budget.refill()
    assert started(budget)
    assert not started(budget, ~EVERYTHING)
    assert (budget.load.fitted, budget.load.dropped, budget.load.blocks) == (2, 1, blocks + EVERYTHING.size)


def test_blocks_of_greatest_novelty_are_searched_when_work_is_scarce() -> None:
    budget, busy, baseline = TokenBucket(0.5, 1e-3), EVERYTHING.copy(), NoveltyFilter(window=1)
    busy[:, 0] = False
    change = np.ones((20, 30), np.float32)
    for _ in range(8):
        baseline.novel_blocks(change, (0, 0), False)
    change[:12] = 1.5
    change[4:9, 10:15] = 3.0
    novel_blocks = busy.copy()
    novel_blocks[12:] = False
    # below 90 % of capacity, blocks without novelty are skipped and not counted
    chosen = budget.start_search(deepcopy(baseline), change, busy, FRAME)
    assert np.array_equal(chosen, busy & novel_blocks)
    assert budget.load.blocks == 0
    budget.level = 0.4 * budget.capacity
    chosen = budget.start_search(baseline, change, busy, FRAME)
    count = budget.affordable_blocks()
    assert 1 < count < np.count_nonzero(busy & novel_blocks)
    assert np.count_nonzero(chosen) == count
    assert budget.load.blocks == np.count_nonzero(busy) - count
    # start at the centre of the area
    assert chosen[6, 12]


def test_the_dearer_blocks_were_the_fewer_are_searched() -> None:
    budget = TokenBucket(0.5, 1e-3)
    before = budget.affordable_blocks()
    for _ in range(20):
        started(budget)
        budget.charge(budget._blocks * 10 * 3000)
        budget.level = 0.9 * budget.capacity
    assert budget.affordable_blocks() < before / 5


@pytest.mark.parametrize(("kind", "dark"), [("plain", 0), ("plain", 90), ("soft", 0), ("soft", 20)])
def test_an_array_beside_what_flickers_for_long_is_found(kind: str, dark: int) -> None:
    """The array appears `dark` patterns into a packet and shows data until the next header."""
    settings = ReceiveSettings(receiver=kind, detect=DetectSettings(cpu_share=0.3))
    receiver, found = make_receiver(SignalSettings(), settings, lambda event: found.append(event)), list[Event]()
    header, rng = np.kron(all_header_cells()[4] > 0, np.ones((8, 8))), np.random.default_rng(6)
    for frame in flicker(720, 3, (64, 64)):
        pixels = rng.integers(40, 44, (128, 192)).astype(np.uint8)
        pixels[32:96, :64] = frame.pixels
        place = (frame.index - 500 + dark) % 100
        if frame.index % 2 == 0:
            shown = header if place < 4 else np.kron(rng.integers(0, 5, (16, 16)) / 4, np.ones((2, 2)))
        else:
            shown = 1 - shown
        if frame.index >= 500:
            pixels[32:64, 128:160] = 40 + (100 * shown).astype(np.uint8)
        list(receiver.push(Frame(frame.index, frame.time_s, pixels)))
    assert receiver.load.left_out > 0  # type: ignore[attr-defined]  # of those that search
    detected = [event.detection for event in found if isinstance(event, DetectEvent)]
    # data may resemble a partial header, but never a clear header
    assert {one.identity for one in detected if one.fit.pose.x > 100 and one.is_clear} == {4}


@pytest.mark.parametrize("start_s", [-0.04, -0.041])
@pytest.mark.parametrize(("modulation", "turned"), [("haar", True), ("ook", False)])
def test_an_array_alone_is_found_with_a_bound_too(modulation: str, turned: bool, start_s: float) -> None:
    """The array appears mid-packet at 25 m; only its blocks alternate."""
    content = {"distance_m": 25.0, "duration_s": 0.26, "arrays": [{"x_m": 0.0, "y_m": 0.0, "start_s": start_s}]}
    link = load_settings("static", {"signal": {"modulation": modulation}, "channel": content})
    receiver, found = (
        make_receiver(link.signal, link.receive.with_live_limits(), lambda e: found.append(e)),
        list[Event](),
    )
    way = -1 if turned else 1
    for k, (frame, _) in enumerate(simulate(link, default_messages(link), 1)):
        pixels = np.ascontiguousarray(frame.pixels[::way, ::way]).astype(np.uint8)
        list(receiver.push(Frame(k, 1e-3 * k, pixels)))
    assert any(isinstance(event, DetectEvent) for event in found)


def test_small_things_that_flicker_far_apart_hide_no_array() -> None:
    """Summing a 1920 x 1080 frame exceeds a search's budget; four squares and an array do not."""
    search = PyramidSearch(replace(PARAMETERS, cpu_share=0.3), SignalSettings())
    search.budget.charge(0.6 * search.budget.capacity)
    header, rng, found = np.kron(all_header_cells()[4] > 0, np.ones((8, 8))), np.random.default_rng(1), list[float]()
    for k in range(400):
        pixels = np.full((1080, 1920), 40, np.uint8)
        for y in (8, 1064):
            for x in (8, 1904):
                pixels[y : y + 8, x : x + 8] = rng.integers(0, 256)
        if k % 2 == 0:
            shown = header if 82 <= k % 100 < 86 else np.kron(rng.integers(0, 5, (16, 16)) / 4, np.ones((2, 2)))
        else:
            shown = 1 - shown
        if k >= 300:
            pixels[540:572, 960:992] = 40 + (100 * shown).astype(np.uint8)
        found += [one.fit.pose.x for one in search.search(Frame(k, 1e-3 * k, pixels))]
    assert found == pytest.approx([975.5], abs=0.5)


@pytest.mark.parametrize(
    ("level", "before", "fits", "counts"),
    [
        (0.96, "header", True, False),
        (0.94, "header", False, False),
        (0.94, "record_quiet", True, False),
        (0.72, "record_quiet", False, True),
    ],
    ids=["ample", "nothing strikes", "strikes", "scarce"],
)
def test_what_is_little_like_a_header_is_fitted_by_what_is_left(
    level: float, before: str, fits: bool, counts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alternation rises sharply after quiet frames, but not if the film begins with a header."""
    find, found = Detector.find_candidates, list[int]()

    def unlike(*arguments: Any) -> tuple[list[Candidate], bool]:
        candidates, has_compared = find(*arguments)
        return [one._replace(score=0.59 * one.score) for one in candidates], has_compared

    for is_like in (True, False):
        if not is_like:
            monkeypatch.setattr(Detector, "find_candidates", unlike)
        budget = TokenBucket(0.3, 1e-3)
        search = PyramidSearch(replace(PARAMETERS, cpu_share=0.3), SignalSettings(), budget)
        budget.level = level * budget.capacity
        first = 4 if before == "record_quiet" else 0
        for k in range(first + 8):
            pixels = np.full((96, 128), 40, np.uint8)
            if first <= k < first + 4:
                sign = 1 - 2 * (k % 2)
                pixels[32:64, 48:80] = 100 + 60 * sign * np.kron(all_header_cells()[4], np.ones((8, 8)))
            found += [one.identity for one in search.search(Frame(k, 1e-3 * k, pixels))]
        assert (budget.load.fitted > 0) == (is_like or fits)
        assert (budget.load.dropped > 0) == counts or is_like
    assert found == ([4, 4] if fits else [4])


@pytest.mark.parametrize(
    ("kind", "distance_m", "most_ms"),
    [("plain", 25.0, 22.0), ("plain", 60.0, 10.0), ("soft", 25.0, 60.0), ("soft", 60.0, 15.0)],
)
def test_a_camera_switched_on_amid_a_packet_does_not_wait_for_its_data(
    kind: str, distance_m: float, most_ms: float
) -> None:
    """Data have low novelty: the search skips nearly all blocks until the first header, with no drop event."""
    link, events = alone(0.088, distance_m=distance_m, start_s=-0.0105), list[Event]()
    receiver = make_receiver(link.signal, replace(link.receive, receiver=kind).with_live_limits(), events.append)
    for frame, _ in simulate(link, default_messages(link), 1):
        list(receiver.push(frame))
    assert receiver.load.work / WORK_PER_MS < most_ms  # type: ignore[attr-defined]  # of those that search
    assert not any(isinstance(event, DropEvent) for event in events)


def alone(duration_s: float, modulation: str = "haar", **place: float) -> LinkSettings:
    here = {"x_m": 0.0, "y_m": 0.0, **{name: one for name, one in place.items() if name != "distance_m"}}
    channel = {"distance_m": place["distance_m"], "duration_s": duration_s, "arrays": [here]}
    sent = {"signal": {"modulation": modulation}, "transmit": {"identities": [29]}}
    return load_settings("static", {"channel": channel, **sent})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "modulation", "distance_m", "yaw_deg", "roll_deg", "start_s"),
    [
        ("soft", "haar", 29.4, -39.0, -7.0, -0.0457),
        ("soft", "haar", 17.1, 24.0, -6.0, -0.03353),
        ("soft", "haar", 23.754, -25.47, -6.21, -0.0292),
        ("plain", "haar", 14.8, 14.0, 0.0, -0.00362),
        ("plain", "haar", 30.4, 1.0, 9.0, -0.01442),
        ("plain", "ook", 15.2, 0.0, 0.0, -0.027),
        ("plain", "ook", 18.8, 10.0, 0.0, -0.042),
    ],
)
def test_near_arrays_alone_are_found_with_a_bound_too(
    kind: str, modulation: str, distance_m: float, yaw_deg: float, roll_deg: float, start_s: float
) -> None:
    """Each block holds few LEDs: data can be novel by chance, and the last search over a header may see no novelty."""
    place = {"distance_m": distance_m, "yaw_deg": yaw_deg, "roll_deg": roll_deg, "start_s": start_s}
    link, read = alone(0.32, modulation, **place), 0
    receiver = make_receiver(link.signal, replace(link.receive, receiver=kind).with_live_limits())
    for frame, _ in simulate(link, default_messages(link), 1):
        read += sum(packet.status == "ok" for packet in receiver.push(frame))
    assert read > 0


def test_where_hardly_anything_is_used_up_all_is_searched() -> None:
    budget, baseline = TokenBucket(1000.0, 1e-3), NoveltyFilter()
    for _ in range(10):
        assert budget.start_search(baseline, np.ones((20, 30), np.float32), EVERYTHING, FRAME).all()


def test_what_strikes_is_asked_of_what_is_searched_alone() -> None:
    budget, baseline, change = TokenBucket(0.3, 1e-3), NoveltyFilter(), np.ones((20, 30), np.float32)
    busy = np.zeros(change.shape, bool)
    busy[:, 12:] = True
    for _ in range(6):
        assert not budget.start_search(baseline, change, busy, FRAME).all()
    change[:, :4] = 3
    assert not budget.start_search(baseline, change, busy, FRAME).any()
    assert not budget.try_fit(0.5)
    change[:, 12:] = 3
    assert np.array_equal(budget.start_search(baseline, change, busy, FRAME), busy)
    assert budget.try_fit(0.5)


@pytest.mark.parametrize("cpu_share", [0.01, 0.3, 1000.0])
def test_a_tenth_is_not_there_at_first_for_a_live_camera(cpu_share: float) -> None:
    """With more than a live camera's share, the budget starts full."""
    budget = TokenBucket(cpu_share, 1e-3)
    assert budget.is_high == (cpu_share > 1)
    budget.charge(0.39 * budget.capacity)
    assert not budget.is_low
    budget.charge(0.06 * budget.capacity)
    assert budget.is_low == (cpu_share < 1)


def test_a_search_that_breaks_off_is_gone_on_with() -> None:
    """Frame origins shift between searches; the resume position refers to the sensor."""
    change = np.random.default_rng(0).normal(0, 30, (136, 136)).astype(np.float32)
    # last position in search order
    change[96:128, 96:128] += 90 * np.kron(all_header_cells()[4], np.ones((8, 8), np.float32))
    budget, left, rows = TokenBucket(1e-3, 1e-3), list[int](), list[Candidate]()
    search = Detector(PARAMETERS, SignalSettings(), budget)
    while not rows and len(left) < 100:
        shift, before = 8 * (len(left) % 2), budget.load.blocks
        frame = Frame(0, 0.0, np.zeros((136, 136 - shift), np.uint8), origin=(shift, 0))
        # budget for a few blocks
        budget.charge(2 * (budget.coarse_work - 1e5))
        part = SearchRegion(change[:, shift:].copy(), np.ones((17, 17 - shift // 8), bool), frame)
        rows, _ = search.find_candidates([part], SOUGHT)
        left.append(budget.load.blocks - before)
    assert len(left) > 3
    assert left[0] > 100
    assert rows[0].hypotheses[0][0] == 4
    # a block's remaining positions may precede the best position
    assert (rows[0].start.x, rows[0].start.y) == pytest.approx((111.5, 111.5), abs=8)


def test_parts_that_break_off_are_all_gone_on_with() -> None:
    """Three noisy regions share a small budget: each is searched to the end."""
    rng, budget = np.random.default_rng(0), TokenBucket(1e-3, 1e-3)
    search, found = Detector(PARAMETERS, SignalSettings(), budget), list[set[int]]([set(), set(), set()])
    header = 90 * np.kron(all_header_cells()[4], np.ones((8, 8), np.float32))
    parts, spent = [], list[float]()
    for k in range(3):
        change = rng.normal(0, 30, (136, 136)).astype(np.float32)
        change[96:128, 96:128] += header
        frame = Frame(0, 0.0, np.zeros((136, 136), np.uint8), origin=(400 * k, 8 * k))
        parts.append(SearchRegion(change, np.ones((17, 17), bool), frame))
    for _ in range(60):
        # budget for a few blocks per region
        budget.charge(2 * (budget.coarse_work - 3e5))
        most = budget.coarse_work
        for one in search.find_candidates(parts, SOUGHT)[0]:
            found[one.region.first.origin[0] // 400].add(one.hypotheses[0][0])
        # each region may overdraw by a block
        spent.append(2 * (most - budget.coarse_work) / most)
    assert max(spent) < 1.3
    assert all(4 in one for one in found)


def test_a_busy_scene_costs_what_it_may() -> None:
    frames = flicker(400, 1)
    search = PyramidSearch(replace(PARAMETERS, cpu_share=0.01), SignalSettings())
    for frame in frames:
        search.search(frame)
    # initial level, refill, and overdraft by the last search: one block and one fit
    assert search.budget.load.work < search.budget.capacity + len(frames) * 0.01 * WORK_PER_MS + 3e6
    assert search.budget.load.blocks > 1000


@pytest.mark.parametrize("kind", ["plain", "soft"])
def test_what_is_left_out_is_told(kind: str) -> None:
    events = list[Event]()
    settings = ReceiveSettings(receiver=kind, detect=DetectSettings(cpu_share=0.01))
    receiver = make_receiver(SignalSettings(), settings, events.append)
    for frame in flicker(120, 2):
        list(receiver.push(frame))
    drops = [event for event in events if isinstance(event, DropEvent)]
    assert drops
    assert all(0 < event.time_s < 0.12 and event.load.left_out > 0 for event in drops)
    total = sum((event.load for event in drops), SearchLoad())
    assert total.left_out == receiver.load.left_out  # type: ignore[attr-defined]  # of those that search


def test_an_array_costs_less_than_it_may() -> None:
    """With default settings, a single array in a quiet scene causes no drops."""
    events = list[Event]()
    receiver = make_receiver(SignalSettings(), ReceiveSettings(receiver="soft").with_live_limits(), events.append)
    cells = np.kron(all_header_cells()[3], np.ones((8, 8)))
    rng = np.random.default_rng(4)
    for k in range(60):
        pixels = rng.integers(20, 24, (128, 160)).astype(np.uint8)
        pixels[40:72, 60:92] += (100 * (cells * (-1) ** k > 0)).astype(np.uint8)
        list(receiver.push(Frame(k, 1e-3 * k, pixels)))
    assert not any(isinstance(event, DropEvent) for event in events)
    bound = 0.1 * TokenBucket(0.3, 1e-3).capacity
    assert receiver.load.work < bound  # type: ignore[attr-defined]  # of those that search


@pytest.mark.parametrize("kind", ["plain", "soft"])
@pytest.mark.parametrize("place", ["region=[40, 20, 80, 80]", "corners=[60, 40, 92, 40, 92, 72, 60, 72]"])
def test_where_somebody_says_where_an_array_is_there_is_no_bound(kind: str, place: str) -> None:
    """A given region counts as busy: noise would exhaust any budget before an array appears."""
    settings = load_settings(
        "static", None, [f"receive.receiver={kind}", f"receive.detect.{place}"]
    ).receive.with_live_limits()
    search, rng = make_receiver(SignalSettings(), settings), np.random.default_rng(5)
    for k in range(12):
        list(search.push(Frame(k, 1e-3 * k, rng.integers(20, 60, (128, 160), np.uint8))))
    assert search.load.left_out == 0  # type: ignore[attr-defined]  # of those that search


def test_a_film_can_wait_and_a_live_camera_cannot() -> None:
    assert ReceiveSettings().detect.cpu_share is None
    assert ReceiveSettings().with_live_limits().detect.cpu_share == 0.3
    assert ReceiveSettings(detect=DetectSettings(cpu_share=2.0)).with_live_limits().detect.cpu_share == 2.0
