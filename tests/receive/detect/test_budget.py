"""What searches may cost where more alternates than there is time for."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import ReceiveSettings, make_receiver
from heliograph.receive.detect.alternation import SearchParameters, SearchRegion
from heliograph.receive.detect.budget import BUDGET, BudgetedSearch, BudgetParameters, SearchLoad, TokenBucket
from heliograph.receive.detect.detector import Detector
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


def first_part(cpu_share: float) -> float:
    """Part of what is kept that is there at first."""
    return 1 - BUDGET.initial_deficit_ms / (1e3 * BUDGET.live_capacity_s * cpu_share)


def flicker(count: int, seed: int, shape: tuple[int, int] = (96, 128)) -> list[Frame]:
    """Frames of which each square of 8 px has another gray level every time."""
    levels = np.random.default_rng(seed).integers(0, 256, (count, shape[0] // 8, shape[1] // 8), np.uint8)
    return [Frame(k, 1e-3 * k, np.kron(one, np.ones((8, 8), np.uint8))) for k, one in enumerate(levels)]


def test_work_is_earned_by_the_pattern_and_kept_for_later() -> None:
    budget, everything, pattern = TokenBucket(0.5, 1e-3), np.ones((2, 3), bool), 0.5 * BUDGET.work_per_ms
    most = 1e3 * BUDGET.live_capacity_s * pattern
    assert budget.try_start(everything)
    assert budget.try_fit(1.0)
    # one search takes a part of what is not kept for new arrays
    surplus = BUDGET.surplus_share * (first_part(0.5) - BUDGET.high_level)
    spent = 1.01 * max(surplus, BUDGET.search_share * first_part(0.5)) * most
    budget.charge(spent)
    assert not budget.try_fit(1.0)
    assert budget.coarse_work <= 0
    assert budget.try_start(everything)
    assert budget.try_fit(1.0)
    budget.charge(BUDGET.low_level * most)
    assert budget.try_start(everything)
    assert budget.coarse_work == pytest.approx(
        0.5 * BUDGET.search_share * ((first_part(0.5) - BUDGET.low_level) * most - spent)
    )
    budget.charge(most)
    assert not budget.try_start(everything)
    assert (budget.load.fitted, budget.load.dropped, budget.load.blocks) == (2, 1, 6)
    for _ in range(round(1.2 * most / pattern)):
        budget.refill()
    assert budget.try_start(everything)
    assert not budget.try_start(np.zeros((2, 3), bool))
    assert (budget.load.fitted, budget.load.dropped, budget.load.blocks) == (2, 1, 6)


def test_blocks_of_greatest_novelty_are_searched_when_work_is_scarce() -> None:
    budget, busy = TokenBucket(0.5, 1e-3), np.ones((20, 30), bool)
    busy[:, 0] = False
    novelty, waits = np.full(busy.shape, 1.5, np.float32), np.full(busy.shape, 2.0, np.float32)
    novelty[4:9, 10:15] = 3.0
    most = 1e3 * BUDGET.live_capacity_s * 0.5 * BUDGET.work_per_ms
    novel_blocks = novelty > 1.2
    novel_blocks[12:] = False
    # a tenth is used up: what does not surge is left out, and not counted
    assert np.array_equal(budget.choose_blocks(busy, novel_blocks, novelty, waits), busy & novel_blocks)
    assert budget.load.blocks == 0
    budget.charge((first_part(0.5) - 0.4) * most)
    count = budget.affordable_blocks()
    assert 1 < count < np.count_nonzero(busy & novel_blocks)
    chosen = budget.choose_blocks(busy, novel_blocks, novelty, waits)
    assert np.count_nonzero(chosen) == count
    assert budget.load.blocks == np.count_nonzero(busy) - count
    # the middle of the area first
    assert chosen[6, 12]
    # those searched lately are left out, and those of before are not
    waits[:8] = 0.5 * BUDGET.research_packets
    assert budget.is_low
    chosen = budget.choose_blocks(busy, novel_blocks, novelty, waits)
    assert not chosen[:8].any()
    assert chosen[8, 12]


def test_the_dearer_blocks_were_the_fewer_are_searched() -> None:
    budget, few = TokenBucket(0.5, 1e-3), np.ones((2, 3), bool)
    before = budget.affordable_blocks()
    for _ in range(20):
        budget.try_start(few)
        budget.charge(few.size * 10 * BUDGET.block_work)
        budget.refill()
    assert budget.affordable_blocks() < before / 5


@pytest.mark.parametrize("dark", [0, 20, 90], ids=["at its header", "early in a packet", "late in a packet"])
@pytest.mark.parametrize("kind", ["plain", "soft"])
def test_an_array_beside_what_flickers_for_long_is_found(kind: str, dark: int) -> None:
    """It comes into sight after the patterns of a packet that were dark, and shows data until its next header."""
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
    # light of data may be taken for a part of a header, but not beyond doubt
    assert {one.identity for one in detected if one.fit.pose.x > 100 and one.is_clear} == {4}


@pytest.mark.parametrize("start_s", [-0.04, -0.041])
@pytest.mark.parametrize(("modulation", "turned"), [("haar", True), ("ook", False)])
def test_an_array_alone_is_found_with_a_bound_too(modulation: str, turned: bool, start_s: float) -> None:
    """It comes into sight amid a packet, 25 m away, and all blocks that alternate are its own."""
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
    """A frame of 1920 x 1080 px costs more to sum up than a search may take; four squares and an array cost little."""
    search = PyramidSearch(replace(PARAMETERS, cpu_share=0.3), SignalSettings())
    search._budget.charge(0.6 * search._budget.capacity)
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
        found += [one.fit.pose.x for one in search.push(Frame(k, 1e-3 * k, pixels))]
    assert found == pytest.approx([975.5], abs=0.5)


@pytest.mark.parametrize("made", [PyramidSearch, Detector])
@pytest.mark.parametrize(
    ("left", "before", "fits", "counts"),
    [
        (BUDGET.live_full_level + 0.01, "header", True, False),
        (BUDGET.live_full_level - 0.01, "header", False, False),
        (BUDGET.live_full_level - 0.01, "record_quiet", True, False),
        (BUDGET.high_level - 0.01, "record_quiet", False, True),
    ],
    ids=["ample", "nothing strikes", "strikes", "scarce"],
)
def test_what_is_little_like_a_header_is_fitted_by_what_is_left(
    made: type[PyramidSearch] | type[Detector],
    left: float,
    before: str,
    fits: bool,
    counts: bool,
) -> None:
    """Much more alternates than usual where it was calm before; not where the film begins with a header."""
    found = list[int]()
    for least in (BUDGET.min_score, 1.1):
        budget = TokenBucket(0.3, 1e-3, BudgetParameters(min_score=least))
        search = made(replace(PARAMETERS, cpu_share=0.3), SignalSettings(), budget)
        budget.charge((first_part(0.3) - left) * budget.capacity)
        first = 4 if before == "record_quiet" else 0
        for k in range(first + 8):
            pixels = np.full((96, 128), 40, np.uint8)
            if first <= k < first + 4:
                sign = 1 - 2 * (k % 2)
                pixels[32:64, 48:80] = 100 + 60 * sign * np.kron(all_header_cells()[4], np.ones((8, 8)))
            found += [one.identity for one in search.push(Frame(k, 1e-3 * k, pixels))]
        assert (budget.load.fitted > 0) == (least < 1 or fits)
        assert (budget.load.dropped > 0) == counts or least < 1
    assert found == ([4, 4] if fits else [4])


@pytest.mark.parametrize(
    ("kind", "distance_m", "most_ms"),
    [("plain", 25.0, 22.0), ("plain", 60.0, 10.0), ("soft", 25.0, 60.0), ("soft", 60.0, 15.0)],
)
def test_a_camera_switched_on_amid_a_packet_does_not_wait_for_its_data(
    kind: str, distance_m: float, most_ms: float
) -> None:
    """Data surge little: nearly all is left out until the first header comes, and nothing is told of that."""
    link, events = alone(0.088, distance_m=distance_m, start_s=-0.0105), list[Event]()
    receiver = make_receiver(link.signal, replace(link.receive, receiver=kind).with_live_limits(), events.append)
    for frame, _ in simulate(link, default_messages(link), 1):
        list(receiver.push(frame))
    assert receiver.load.work / BUDGET.work_per_ms < most_ms  # type: ignore[attr-defined]  # of those that search
    assert not any(isinstance(event, DropEvent) for event in events)


def alone(duration_s: float, modulation: str = "haar", **place: float) -> LinkSettings:
    """A link of an array at rest, in view all the time."""
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
    """Each block shows few of their LEDs, so that data surge by chance; a header may not do so in its last search."""
    place = {"distance_m": distance_m, "yaw_deg": yaw_deg, "roll_deg": roll_deg, "start_s": start_s}
    link, read = alone(0.32, modulation, **place), 0
    receiver = make_receiver(link.signal, replace(link.receive, receiver=kind).with_live_limits())
    for frame, _ in simulate(link, default_messages(link), 1):
        read += sum(packet.status == "ok" for packet in receiver.push(frame))
    assert read > 0


def test_where_hardly_anything_is_used_up_all_is_searched() -> None:
    search = Detector(replace(PARAMETERS, cpu_share=1000.0), SignalSettings())
    change, frame = np.ones((12, 16), np.float32), Frame(0, 0.0, np.zeros((96, 128), np.uint8))
    busy = np.ones(change.shape, bool)
    for _ in range(10):
        assert search.selector.select(change, busy, frame)[0].all()


def test_what_strikes_is_asked_of_what_is_searched_alone() -> None:
    search = Detector(replace(PARAMETERS, cpu_share=0.3), SignalSettings())
    change, frame = np.ones((12, 16), np.float32), Frame(0, 0.0, np.zeros((96, 128), np.uint8))
    busy = np.zeros(change.shape, bool)
    busy[:, 12:] = True
    for _ in range(6):
        assert not search.selector.select(change, busy, frame)[0].all()
    change[:, :4] = 3
    searched, strikes = search.selector.select(change, busy, frame)
    assert not searched.any()
    assert not strikes
    change[:, 12:] = 3
    searched, strikes = search.selector.select(change, busy, frame)
    assert np.array_equal(searched, busy)
    assert strikes


@pytest.mark.parametrize("cpu_share", [0.01, 0.3, 1000.0])
def test_a_tenth_at_most_is_not_there_at_first(cpu_share: float) -> None:
    """With more than a live camera's part all is searched from the beginning, or nearly."""
    is_film = cpu_share >= BUDGET.min_film_share
    budget, kept_s = TokenBucket(cpu_share, 1e-3), BUDGET.film_capacity_s if is_film else BUDGET.live_capacity_s
    most = 1e3 * kept_s * cpu_share * BUDGET.work_per_ms
    assert budget.is_full == ((1 - BUDGET.live_full_level) * most > BUDGET.initial_deficit_ms * BUDGET.work_per_ms)
    budget.charge(0.1499 * most)
    assert budget.is_high
    budget.charge(0.1 * most)
    assert budget.is_high == (cpu_share > 1)


def test_a_search_that_breaks_off_is_gone_on_with() -> None:
    """The frames shift between the searches: the place kept is one on the sensor."""
    change = np.random.default_rng(0).normal(0, 30, (136, 136)).astype(np.float32)
    # what is searched last
    change[96:128, 96:128] += 90 * np.kron(all_header_cells()[4], np.ones((8, 8), np.float32))
    budget, left, rows = TokenBucket(1e-3, 1e-3), list[int](), np.empty((0, 5))
    search = BudgetedSearch(PARAMETERS, SOUGHT, budget)
    while not rows.size and len(left) < 100:
        shift, before = 8 * (len(left) % 2), budget.load.blocks
        frame = Frame(0, 0.0, np.zeros((136, 136 - shift), np.uint8), origin=(shift, 0))
        # enough for some blocks
        budget.charge(2 * (budget.coarse_work - 1e5))
        part = SearchRegion(change[:, shift:].copy(), np.ones((17, 17 - shift // 8), bool), frame)
        [rows] = search.search([part])
        left.append(budget.load.blocks - before)
    assert len(left) > 3
    assert left[0] > 100
    assert rows[0, 4] == 4
    # a block's part of the places may be searched before the best one
    assert rows[0, 1:3] + (shift, 0) == pytest.approx([112, 112], abs=8)


def test_parts_that_break_off_are_all_gone_on_with() -> None:
    """Three of noise, and little to spend: the last blocks of each are searched too, and no part takes all."""
    rng, budget = np.random.default_rng(0), TokenBucket(1e-3, 1e-3)
    search, found = BudgetedSearch(PARAMETERS, SOUGHT, budget), list[set[float]]([set(), set(), set()])
    header = 90 * np.kron(all_header_cells()[4], np.ones((8, 8), np.float32))
    parts, spent = [], list[float]()
    for k in range(3):
        change = rng.normal(0, 30, (136, 136)).astype(np.float32)
        change[96:128, 96:128] += header
        frame = Frame(0, 0.0, np.zeros((136, 136), np.uint8), origin=(400 * k, 8 * k))
        parts.append(SearchRegion(change, np.ones((17, 17), bool), frame))
    for _ in range(60):
        # enough for some blocks of each
        budget.charge(2 * (budget.coarse_work - 3e5))
        most = budget.coarse_work
        for k, rows in enumerate(search.search(parts)):
            found[k] |= set(rows[:, 4].tolist()) if rows.size else set()
        # a block of each part may be overdrawn
        spent.append(2 * (most - budget.coarse_work) / most)
    assert max(spent) < 1.3
    assert all(4 in one for one in found)


def test_a_busy_scene_costs_what_it_may() -> None:
    frames = flicker(400, 1)
    search = PyramidSearch(replace(PARAMETERS, cpu_share=0.01), SignalSettings())
    for frame in frames:
        search.push(frame)
    # what was there, what came, and what the last search may overdraw: a block of places, and a fit begun
    assert search.load.work < (1e3 * BUDGET.live_capacity_s + len(frames)) * 0.01 * BUDGET.work_per_ms + 3e6
    assert search.load.blocks > 1000


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
    """The default leaves nothing out where hardly anything else alternates."""
    events = list[Event]()
    receiver = make_receiver(SignalSettings(), ReceiveSettings(receiver="soft").with_live_limits(), events.append)
    cells = np.kron(all_header_cells()[3], np.ones((8, 8)))
    rng = np.random.default_rng(4)
    for k in range(60):
        pixels = rng.integers(20, 24, (128, 160)).astype(np.uint8)
        pixels[40:72, 60:92] += (100 * (cells * (-1) ** k > 0)).astype(np.uint8)
        list(receiver.push(Frame(k, 1e-3 * k, pixels)))
    assert not any(isinstance(event, DropEvent) for event in events)
    bound = 0.1 * BUDGET.live_capacity_s * 0.3e3 * BUDGET.work_per_ms
    assert receiver.load.work < bound  # type: ignore[attr-defined]  # of those that search


@pytest.mark.parametrize("kind", ["plain", "soft"])
@pytest.mark.parametrize("place", ["region=[40, 20, 80, 80]", "corners=[60, 40, 92, 40, 92, 72, 60, 72]"])
def test_where_somebody_says_where_an_array_is_there_is_no_bound(kind: str, place: str) -> None:
    """All of such a place counts as busy, and a search of noise would use up any bound before an array comes."""
    settings = load_settings(
        "static", None, [f"receive.receiver={kind}", f"receive.detect.{place}"]
    ).receive.with_live_limits()
    search, rng = make_receiver(SignalSettings(), settings), np.random.default_rng(5)
    for k in range(300):
        list(search.push(Frame(k, 1e-3 * k, rng.integers(20, 60, (128, 160), np.uint8))))
    assert search.load.left_out == 0  # type: ignore[attr-defined]  # of those that search


def test_a_film_can_wait_and_a_live_camera_cannot() -> None:
    assert ReceiveSettings().detect.cpu_share is None
    assert ReceiveSettings().with_live_limits().detect.cpu_share == 0.3
    assert ReceiveSettings(detect=DetectSettings(cpu_share=2.0)).with_live_limits().detect.cpu_share == 2.0
