"""Budget of the search in scenes with excessive alternation, and novelty of blocks."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from recorder import Recorder
from scenes import link, statuses
from search_scenes import HEADER, flicker, search_parameters, shown_patterns

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import build
from heliograph.receive.api import make_receiver
from heliograph.receive.detect.alternation import SearchParameters, SearchRegion
from heliograph.receive.detect.budget import WORK_PER_MS, NoveltyFilter, SearchLoad, TokenBucket
from heliograph.receive.detect.detection import headers
from heliograph.receive.detect.detector import Detector
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.events import DropEvent
from heliograph.receive.geometry.pose import UPRIGHT
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.packet import Packet
from heliograph.receive.settings import DetectSettings, ReceiveSettings
from heliograph.signal.settings import SignalSettings

Change = NDArray[np.float32]
FRAME = Frame(0, 0.0, np.zeros((160, 240), np.uint8))
EVEN, EVERYTHING = np.ones((20, 30), np.float32), np.ones((20, 30), bool)


def started(budget: TokenBucket, busy: NDArray[np.bool_] = EVERYTHING) -> bool:
    return bool(budget.start_search(NoveltyFilter(), EVEN, busy, FRAME).any())


def counts(budget: TokenBucket) -> tuple[int, int, int]:
    return budget.load.fitted, budget.load.dropped, budget.load.blocks


def test_each_pattern_refills_the_budget() -> None:
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
    fitted, dropped, blocks = counts(budget)
    budget.charge(budget.capacity)
    assert not started(budget)
    after = 2, 1, blocks + EVERYTHING.size
    assert ((fitted, dropped), counts(budget)) == ((2, 1), after)
    for _ in range(round(1.7 * budget.capacity / pattern)):
        budget.refill()
    assert started(budget)
    assert not started(budget, ~EVERYTHING)
    assert counts(budget) == after


def test_blocks_of_greatest_novelty_are_searched_when_work_is_scarce() -> None:
    budget, busy, baseline, change = TokenBucket(0.5, 1e-3), EVERYTHING.copy(), NoveltyFilter(window=1), EVEN.copy()
    busy[:, 0] = False
    for _ in range(8):
        baseline.novel_blocks(change, (0, 0), False)
    change[:12], change[4:9, 10:15] = 1.5, 3.0
    novel_blocks = busy.copy()
    novel_blocks[12:] = False
    # below 90 % of capacity, blocks without novelty are skipped and not counted
    for one, expected in ((TokenBucket(1000.0, 1e-3), busy), (budget, novel_blocks)):
        assert np.array_equal(one.start_search(deepcopy(baseline), change, busy, FRAME), expected)
    assert budget.load.blocks == 0
    budget.level = 0.4 * budget.capacity
    chosen = budget.start_search(baseline, change, busy, FRAME)
    count = budget.affordable_blocks()
    assert 1 < count == np.count_nonzero(chosen) < np.count_nonzero(novel_blocks)
    assert budget.load.blocks == np.count_nonzero(busy) - count
    # start at the centre of the area
    assert chosen[6, 12]


def test_fewer_blocks_are_affordable_after_expensive_blocks() -> None:
    budget = TokenBucket(0.5, 1e-3)
    before = budget.affordable_blocks()
    for _ in range(20):
        started(budget)
        budget.charge(budget._blocks * 10 * 3000)
        budget.level = 0.9 * budget.capacity
    assert budget.affordable_blocks() < before / 5


def scarce_search(parameters: SearchParameters, with_half_period: bool = False) -> PyramidSearch:
    """Return a search with less than half of the budget left."""
    search = PyramidSearch(parameters, SignalSettings(), with_half_period=with_half_period)
    search.budget.charge(0.6 * search.budget.capacity)
    return search


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "dark"), [("plain", 0), ("plain", 90), ("soft", 0), ("soft", 20)])
def test_an_array_is_found_near_long_flicker(kind: str, dark: int) -> None:
    """The array appears `dark` patterns into a packet and shows data until the next header."""
    settings, rng, found = ReceiveSettings(receiver=kind).with_live_limits(), np.random.default_rng(6), []
    search = scarce_search(build.search_parameters(settings, SignalSettings(), kind == "soft"), kind == "soft")
    patterns = shown_patterns(lambda k: (k - 60 + dark) % 100 < 4, rng)
    for frame, shown in zip(flicker(180, 3, (64, 64)), patterns, strict=False):
        pixels = rng.integers(40, 44, (128, 192)).astype(np.uint8)
        pixels[32:96, :64] = frame.pixels
        if frame.index >= 60:
            pixels[32:64, 128:160] = 40 + (100 * shown).astype(np.uint8)
        found += search.search(replace(frame, pixels=pixels))
    # data may resemble a partial header, but never a clear header
    assert next(one.identity for one in found if one.is_clear and one.fit.pose.x > 100) == 4
    assert search.budget.load.left_out > 0


def test_small_distant_flicker_hides_no_array() -> None:
    """Summing a 1920 x 1080 frame exceeds a search's budget; four squares and an array do not."""
    search = scarce_search(search_parameters(max_side_px=32.0, cpu_share=0.3))
    rng, found = np.random.default_rng(1), list[float]()
    for k, shown in zip(range(100), shown_patterns(lambda k: 82 <= k < 86, rng), strict=False):
        pixels = np.full((1080, 1920), 40, np.uint8)
        for y in (8, 1064):
            for x in (8, 1904):
                pixels[y : y + 8, x : x + 8] = rng.integers(0, 256)
        if k >= 60:
            pixels[540:572, 960:992] = 40 + (100 * shown).astype(np.uint8)
        found += [detection.fit.pose.x for detection in search.search(Frame(k, 1e-3 * k, pixels))]
    assert found == pytest.approx([975.5], abs=0.5)


@pytest.mark.parametrize(
    ("level", "novelty", "fits", "dropped"),
    [(0.96, 1.0, True, 0), (0.94, 1.0, False, 0), (0.94, 1.5, True, 0), (0.72, 1.5, False, 1)],
)
def test_unlikely_candidates_are_fitted_with_spare_work(level: float, novelty: float, fits: bool, dropped: int) -> None:
    budget, baseline = TokenBucket(0.3, 1e-3), NoveltyFilter()
    for _ in range(6):
        baseline.novel_blocks(EVEN, (0, 0), False)
    budget.level = level * budget.capacity
    budget.start_search(baseline, np.float32(novelty) * EVEN, EVERYTHING, FRAME)
    assert budget.try_fit(0.6)
    assert budget.try_fit(-0.59) == fits
    assert budget.load.dropped == dropped


def single_array(duration_s: float, distance_m: float, modulation: str = "haar", **place: float) -> LinkSettings:
    """Return a film of an array in the middle of a camera; only blocks of the array alternate."""
    # the blocks divide the array as in the camera of 1024 x 512 pixels
    camera, arrays = {"width": 128, "height": 128}, [{"x_m": 0.0, "y_m": 0.0, **place}]
    changes = f"signal.modulation={modulation}", "transmit.identities=[29]"
    return link(*changes, distance_m=distance_m, duration_s=duration_s, camera=camera, arrays=arrays)


def packets_of(settings: LinkSettings, kind: str, observe: Recorder, way: int = 1) -> tuple[list[Packet], SearchLoad]:
    """Return packets of a live receiver up to the first decoded, and the search load; a negative way turns frames."""
    live = replace(settings.receive, receiver=kind).with_live_limits()
    receiver, packets = make_receiver(settings.signal, live, observe), list[Packet]()
    for frame, _ in simulate(settings, default_messages(settings), 1):
        packets += receiver.push(replace(frame, pixels=frame.pixels[::way, ::way].astype(np.uint8, "C")))
        if "ok" in statuses(packets):
            break
    return packets, receiver.search.load  # type: ignore[attr-defined]  # receivers with a search


@pytest.mark.parametrize(("kind", "distance_m", "most_ms"), [
    ("plain", 25.0, 22.0), ("plain", 60.0, 10.0), ("soft", 25.0, 60.0), ("soft", 60.0, 15.0),
])  # fmt: skip
def test_data_before_the_first_header_cost_little(kind: str, distance_m: float, most_ms: float) -> None:
    """Data have low novelty: the search skips nearly all blocks until the first header, with no drop event."""
    recorder = Recorder()
    _, load = packets_of(single_array(0.088, distance_m, start_s=-0.0105), kind, recorder)
    assert load.work / WORK_PER_MS < most_ms
    assert not recorder.of(DropEvent)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "modulation", "way", "distance_m", "angles_deg", "start_s"), [
    ("soft", "haar", 1, 29.4, (-39.0, -7.0), -0.0457),
    ("soft", "haar", 1, 17.1, (24.0, -6.0), -0.03353),
    ("soft", "haar", 1, 23.754, (-25.47, -6.21), -0.0292),
    ("plain", "haar", 1, 14.8, (14.0, 0.0), -0.00362),
    *(("plain", "haar", -1, 25.0, (0.0, 0.0), start_s) for start_s in (-0.04, -0.041)),
    *(("plain", "ook", 1, *place) for place in ((15.2, (0, 0), -0.027), (25, (0, 0), -0.04), (25, (0, 0), -0.041))),
])  # fmt: skip
def test_a_single_near_array_is_found_within_the_budget(
    kind: str, modulation: str, way: int, distance_m: float, angles_deg: tuple[float, float], start_s: float
) -> None:
    """Each block holds few LEDs: data can be novel by chance, and the last search over a header may see no novelty."""
    place = {"yaw_deg": angles_deg[0], "roll_deg": angles_deg[1], "start_s": start_s}
    packets, _ = packets_of(single_array(0.32, distance_m, modulation, **place), kind, Recorder(), way)
    assert "ok" in statuses(packets)


def test_only_novelty_of_searched_blocks_counts() -> None:
    budget, baseline, change, busy = TokenBucket(0.3, 1e-3), NoveltyFilter(), EVEN.copy(), ~EVERYTHING
    busy[:, 12:] = True
    for _ in range(6):
        assert not budget.start_search(baseline, change, busy, FRAME).all()
    for novel, is_searched in ((slice(4), False), (slice(12, None), True)):
        change[:, novel] = 3
        assert np.array_equal(budget.start_search(baseline, change, busy, FRAME), busy & is_searched)
        assert budget.try_fit(0.5) == is_searched


@pytest.mark.parametrize("cpu_share", [0.01, 0.3, 1000.0])
def test_a_live_camera_starts_with_nine_tenths_of_the_budget(cpu_share: float) -> None:
    budget = TokenBucket(cpu_share, 1e-3)
    assert budget.is_high == (cpu_share > 1)
    budget.charge(0.39 * budget.capacity)
    assert not budget.is_low
    budget.charge(0.06 * budget.capacity)
    assert budget.is_low == (cpu_share < 1)


@pytest.mark.slow
def test_interrupted_searches_of_several_regions_continue_on_the_sensor() -> None:
    """Three noisy regions share a small budget; the window origins shift between searches."""
    rng, budget, found, spent = np.random.default_rng(0), TokenBucket(1e-3, 1e-3), set[int](), list[float]()
    detector = Detector(search_parameters(max_side_px=32.0), SignalSettings(), budget)
    changes = rng.normal(0, 30, (3, 136, 136)).astype(np.float32)
    # a header at the last position in search order
    changes[:, 96:128, 96:128] += 90 * (2 * HEADER - 1).astype(np.float32)
    for k in range(60):
        shift, before, regions = 8 * (k % 2), budget.load.blocks, list[SearchRegion]()
        for n, change in enumerate(changes):
            part = CombinedFrame(0, 0.0, change[:, shift:].copy(), (400 * n + shift, 8 * n), 255)
            regions.append((part, np.ones((17, 17 - shift // 8), bool)))
        # budget for a few blocks per region
        budget.charge(2 * (budget.coarse_work - 3e5))
        most = budget.coarse_work
        candidates, _ = detector.find_candidates(regions, headers((UPRIGHT,)))
        assert k or budget.load.blocks - before > 300
        # each region may overdraw by a block
        spent.append(2 * (most - budget.coarse_work) / most)
        for one in candidates:
            if one.hypotheses[0][0] == 4:
                number = round(one.start.x / 400)
                found.add(number)
                # a block's remaining positions may precede the best position
                assert (one.start.x - 400 * number, one.start.y - 8 * number) == pytest.approx((111.5, 111.5), abs=8)
    assert max(spent) < 1.3
    assert found == {0, 1, 2}


@pytest.mark.slow
def test_a_busy_scene_stays_within_the_budget_and_drop_events_report_skipped_work() -> None:
    recorder, cpu_share = Recorder(), 0.01
    settings = ReceiveSettings(receiver="soft", detect=DetectSettings(cpu_share=cpu_share))
    receiver = make_receiver(SignalSettings(), settings, recorder)
    for frame in flicker(120, 2):
        list(receiver.push(frame))
    load: SearchLoad = receiver.search.load  # type: ignore[attr-defined]  # receivers with a search
    # initial level, refill, and overdraft by the last search: one block and one fit
    assert load.work < TokenBucket(cpu_share, 1e-3).capacity + 120 * cpu_share * WORK_PER_MS + 3e6
    assert load.blocks > 1000
    drops = recorder.of(DropEvent)
    assert drops
    assert all(0 < event.time_s < 0.12 and event.load.left_out > 0 for event in drops)
    assert sum((event.load for event in drops), SearchLoad()).left_out == load.left_out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "place"), [("plain", "region=[40, 20, 80, 80]"), ("soft", "corners=[60, 40, 92, 40, 92, 72, 60, 72]")]
)
def test_a_given_place_has_no_budget(kind: str, place: str) -> None:
    """A given region counts as busy: noise would exhaust any budget before an array appears."""
    settings = load_settings("static", None, [f"receive.receiver={kind}", f"receive.detect.{place}"])
    receiver, rng = make_receiver(SignalSettings(), settings.receive.with_live_limits()), np.random.default_rng(5)
    for k in range(12):
        list(receiver.push(Frame(k, 1e-3 * k, rng.integers(20, 60, (128, 160), np.uint8))))
    assert receiver.search.load.left_out == 0  # type: ignore[attr-defined]  # receivers with a search


def test_only_a_live_camera_has_a_small_share_by_default() -> None:
    assert ReceiveSettings().detect.cpu_share is None
    assert ReceiveSettings().with_live_limits().detect.cpu_share == 0.3
    assert ReceiveSettings(detect=DetectSettings(cpu_share=2.0)).with_live_limits().detect.cpu_share == 2.0


HAAR, OOK, STRONG, WARMUP_SEARCHES = (1.2, 1.4), (1.1, 1.1), NoveltyFilter.STRONG, 3
LEAST, MOST = HAAR
SQUARE = np.ones((8, 8), np.float32)


def novelty_of(baseline: NoveltyFilter, change: Change, is_scarce: bool = True, x: int = 0) -> str:
    """Update the baseline with a search; return the novelty of all blocks: "", "novel" or "strong"."""
    novel, novelty = baseline.novel_blocks(change, (x, 0), is_scarce)
    strong = novelty > STRONG
    assert (novel.all(), strong.all()) == (novel.any(), strong.any())
    return ("strong" if strong.all() else "novel") if novel.all() else ""


def warmed_up(parameters: tuple[float, float] = HAAR, searches: int = 8) -> NoveltyFilter:
    baseline = NoveltyFilter(*parameters)
    for k in range(searches):
        assert bool(novelty_of(baseline, SQUARE)) == (k < WARMUP_SEARCHES)
    return baseline


def test_a_header_is_novel_over_data_and_even_flicker_is_not() -> None:
    baseline, change = warmed_up(), SQUARE.copy()
    change[:3, :3] = 2.5
    header, _ = baseline.novel_blocks(change, (0, 0), True)
    assert header[:2, :2].all()
    assert not header[6:].any()
    # persistent change becomes baseline
    for _ in range(20):
        novel, _ = baseline.novel_blocks(change, (0, 0), True)
    assert not novel.any()
    # scarce budget raises the threshold
    assert novelty_of(baseline, np.float32(1.01 * MOST) * change)
    baseline.novel_blocks(change, (0, 0), True)
    assert not novelty_of(baseline, np.float32(1.1 * LEAST) * change)
    assert novelty_of(baseline, np.float32(1.1 * LEAST) * change, is_scarce=False)


@pytest.mark.parametrize(("parameters", "searches", "quiet", "factors", "updates"), [
    # a novel block stays novel in the next search, which may catch a header missed by the first
    (HAAR, 8, 0, (1, 0.5 * (LEAST + MOST), 1, 1), ["", "novel", "", ""]),
    (HAAR, 8, 0, (1, 1.1 * STRONG, 1, 1), ["", "strong", "strong", ""]),
    (OOK, 8, 0, (1, 0.5 * (OOK[0] + STRONG), 1, 1), ["", "novel", "novel", ""]),
    (OOK, 8, 0, (1, 1.1 * STRONG, 1, 1), ["", "strong", "strong", ""]),
    # a new array is novel in two searches, because the second may contain the header
    (HAAR, 8, 0, (10, 10, 10), ["strong", "strong", ""]),
    # as for a new or quiet area
    (HAAR, 0, 20, (1, 1, 1), ["strong", "strong", ""]), (HAAR, 20, 20, (1, 1, 1), ["strong", "strong", ""]),
    (HAAR, 20, 1, (1, 1, 1), ["", "", ""]),
])  # fmt: skip
def test_new_blocks_stay_novel_twice(
    parameters: tuple[float, float], searches: int, quiet: int, factors: Sequence[float], updates: list[str]
) -> None:
    baseline = warmed_up(parameters, searches)
    for _ in range(quiet):
        baseline.record_quiet()
    is_scarce = [False, False, len(factors) == 4, len(factors) == 4]
    shown = zip(factors, is_scarce, strict=False)
    assert [novelty_of(baseline, np.float32(one) * SQUARE, scarce) for one, scarce in shown] == updates


def test_all_blocks_of_a_new_place_are_novel() -> None:
    baseline = warmed_up()
    assert [bool(novelty_of(baseline, SQUARE, x=8)) for _ in range(4)] == [True, True, True, False]
    assert novelty_of(baseline, SQUARE[:5], x=8)


@pytest.mark.parametrize("levels", [(0, 0.25, 0.5, 0.75, 1), (0, 1)], ids=["haar", "ook"])
@pytest.mark.parametrize("first", [0, 1], ids=["pattern", "inverse"])
@pytest.mark.parametrize("phase", [0.0, 0.2])
def test_headers_are_novel_over_data_for_either_first_frame(levels: Sequence[float], first: int, phase: float) -> None:
    baseline, rng = NoveltyFilter(*(HAAR if len(levels) > 2 else OOK)), np.random.default_rng(2)
    header = rng.integers(0, 2, (6, 6, 16)).astype(float)
    packets = [[header, header, *rng.choice(levels, (48, *header.shape))] for _ in range(12)]
    patterns = [shown for pattern in chain.from_iterable(packets) for shown in (pattern, 1 - pattern)]
    frames = [(1 - phase) * one + phase * two for one, two in pairwise(patterns)]
    novel = dict[int, bool]()
    for k in range(first, len(frames) - 3, 2):
        a, b, c, d = frames[k : k + 4]
        # mean absolute change per block
        change = np.abs(a - 3 * b + 3 * c - d).mean(axis=2).astype(np.float32)
        novel[k] = bool(baseline.novel_blocks(change, (0, 0), True)[0][1:-1, 1:-1].all())
    headers_at = [k for k in novel if k > 200 and k % 100 == first]
    assert len(headers_at) > 8
    # headers starting with an inverse need two searches
    assert all(novel[k] or (first == 1 and novel[k - 2]) for k in headers_at)
