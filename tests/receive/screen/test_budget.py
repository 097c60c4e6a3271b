"""Screen search budget: bounded cost without a screen, no loss with a screen."""

from collections.abc import Sequence

import numpy as np
import pytest

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.link.settings import load_settings
from heliograph.receive import make_receiver
from heliograph.receive.events import Event, UnseenEvent
from heliograph.receive.screen.cells import PARAMETERS, SAMPLES_PER_S, CellFitter, Place, SearchBudget
from heliograph.receive.screen.locate import ArraySearch, Candidate

LIMITS = SearchBudget()


def flickering(seconds: float, seed: int = 1) -> list[Frame]:
    """Return a hand-held film with uniformly blinking squares in noise."""
    rng, out = np.random.default_rng(seed), list[Frame]()
    squares = [(rng.integers(5, 180), rng.integers(5, 60), rng.integers(40, 90), rng.uniform(1, 6)) for _ in range(3)]
    for k in range(int(seconds * 30)):
        light = np.full((160, 280), 60.0)
        for x, y, side, rate_hz in squares:
            x += round(3 * np.sin(k / 7))
            light[y : y + side, x : x + side] = 60 + 150 * (np.sin(2 * np.pi * rate_hz * k / 30) > 0)
        pixels = np.clip(light + rng.normal(0, 3, light.shape), 0, 255).astype(np.uint8)
        out.append(Frame(k, k / 30, pixels))
    return out


@pytest.mark.slow
def test_a_film_without_a_screen_costs_a_part_of_its_length(monkeypatch: pytest.MonkeyPatch) -> None:
    spent_s, seen, seconds = [0.0], list[Event](), 10.0
    spend = SearchBudget.spend

    def counted(budget: SearchBudget, samples: float) -> None:
        spent_s[0] += samples / SAMPLES_PER_S
        spend(budget, samples)

    monkeypatch.setattr(SearchBudget, "spend", counted)
    settings = load_settings("phone")
    receiver = make_receiver(settings.signal, settings.receive, seen.append)
    packets = [packet for frame in flickering(seconds) for packet in receiver.push(frame)] + list(receiver.finish())
    assert packets == []
    assert LIMITS.first_s < spent_s[0] < LIMITS.first_s + LIMITS.share * seconds + 2 * LIMITS.debt_s
    assert [event.searched_s for event in seen if isinstance(event, UnseenEvent)] == pytest.approx([5.0], abs=0.1)


def test_work_is_earned_by_the_films_time_and_no_more_is_kept_than_at_first() -> None:
    budget = SearchBudget(share=0.5, first_s=1.0, debt_s=0.5)
    budget.spend(1.2 * SAMPLES_PER_S)
    assert not budget.is_left
    assert not budget.is_overdrawn
    budget.earn(1.0)
    assert budget.is_left
    budget.earn(1000.0)
    budget.spend(1.6 * SAMPLES_PER_S)
    assert budget.is_overdrawn


def test_a_search_that_broke_off_goes_on_with_the_next_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    budget, counts = SearchBudget(), list[int]()
    search = ArraySearch(8, 2.2, budget)
    fitter = CellFitter(8, 1.0, np.linspace(0, 1, 256, dtype=np.float32), budget)
    place = Place.of(np.array([[20, 20], [100, 20], [100, 100], [20, 100]], float), 8)

    def placed(_corners: Floats) -> Candidate:
        budget.spend(2 * LIMITS.first_s * SAMPLES_PER_S)
        return np.inf, place, fitter

    def changing(frames: Sequence[object]) -> object:
        counts.append(len(frames))
        return None

    monkeypatch.setattr(search, "_fit_candidate", placed)
    monkeypatch.setattr("heliograph.receive.screen.locate.mean_change", changing)
    monkeypatch.setattr("heliograph.receive.screen.locate.find_quadrilaterals", lambda *_: [None])
    rng = np.random.default_rng(1)
    for k in range(90):
        search.push(Frame(k, k / 30, rng.integers(0, 255, (48, 64), dtype=np.uint8)))
        if k % 6 == 5:
            budget.fill()
    assert set(counts[-6:]) == set(PARAMETERS.windows)
