"""An array among many flickering lamps: detection, false candidates and search budget."""

from dataclasses import replace

import numpy as np
import pytest
from lamp_scenes import lamp_film
from search_scenes import search_parameters

from heliograph.base.frames import Frame
from heliograph.receive import make_receiver
from heliograph.receive.detect.alternation import SearchRegion, coarse_search
from heliograph.receive.detect.budget import WORK_PER_MS, TokenBucket
from heliograph.receive.detect.detection import headers
from heliograph.receive.detect.detector import Detector, HalfPeriodDetector
from heliograph.receive.events import DetectEvent, Event
from heliograph.receive.geometry.pose import UPRIGHT
from heliograph.signal.header import all_header_cells
from heliograph.signal.settings import SignalSettings

PARAMETERS = search_parameters()


@pytest.mark.slow
def test_array_among_lamps_is_found_within_the_search_budget() -> None:
    (link, frames), events = lamp_film(125, 3, 0.12, (256, 256)), list[Event]()
    receiver = make_receiver(link.signal, replace(link.receive, receiver="soft"), events.append)
    for frame in frames:
        list(receiver.push(frame))
    detected = [event.detection.identity for event in events if isinstance(event, DetectEvent)]
    assert link.transmit.identities[0] in detected
    assert len(detected) <= 3
    # the last search may overdraw by one block and one fit
    bound = TokenBucket(2.0, 1e-3).capacity + len(frames) * 2.0 * WORK_PER_MS + 5e6
    assert receiver.search.load.work < bound  # type: ignore[attr-defined]  # of those that search


@pytest.mark.slow
def test_search_is_reproducible() -> None:
    """The budget counts work, not time."""
    (link, frames), loads = lamp_film(30, 1, 0.03, (128, 96)), []
    for _ in range(2):
        receiver = make_receiver(link.signal, link.receive)
        for frame in frames:
            list(receiver.push(frame))
        loads.append(receiver.search.load)  # type: ignore[attr-defined]  # of those that search
    assert loads[0] == loads[1]
    assert loads[0].work > 0


def test_lamps_below_half_an_array_are_not_correlated() -> None:
    change = np.zeros((96, 128), np.float32)
    for y in (20, 48, 76):
        for x in (24, 64, 104):
            change[y : y + 4, x : x + 4] = 120.0
    busy, frame = np.ones((12, 16), bool), Frame(0, 0.0, np.zeros((96, 128), np.uint8))
    region, sought = SearchRegion(change, busy, frame), headers((UPRIGHT,)).cells
    assert coarse_search(region, PARAMETERS, sought, np.array([12.0, 16.0, 24.0]))[3] == 0
    # one real header among the lamps
    change[32:64, 40:72] = 60 * np.kron(all_header_cells()[4], np.ones((8, 8)))
    rows, *_ = coarse_search(region, PARAMETERS, sought, np.array([32.0]))
    assert rows[0, 4] == 4


@pytest.mark.parametrize(("within", "count"), [(0.5, 1), (0.0, 0)], ids=["an array", "lamps"])
def test_half_a_pattern_late_the_array_is_lit_within_the_header(within: float, count: int) -> None:
    """Lamps lit before and after, but dark between, are no array."""
    header, found = np.kron(all_header_cells()[4], np.ones((8, 8))), 0
    detector = HalfPeriodDetector(Detector(PARAMETERS, SignalSettings(), TokenBucket(1e6, 1e-3)))
    for k, light in enumerate([0.5 + 0.5 * header, *[np.full_like(header, within)] * 3, 0.5 - 0.5 * header]):
        pixels = np.full((96, 128), 20, np.uint8)
        # half a header contrast, plus half uniform data
        shown = light if k in (1, 2, 3) else 0.5 * light + 0.25
        pixels[32:64, 48:80] = 20 + np.rint(160 * shown)
        found += len(detector.search(Frame(k, 1e-3 * k, pixels)))
    assert found == count
