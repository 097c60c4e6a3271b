"""Unknown rates: displays with skipped refreshes, and slow patterns."""

import numpy as np
import pytest
from screen_films import Grabs, Phone, phone_frames
from screen_light import shown

import heliograph
from heliograph.base.frames import Frame
from heliograph.link.settings import load_settings
from heliograph.receive.screen.cells import PARAMETERS, CellFitter, Place, SearchBudget
from heliograph.receive.screen.locate import ArraySearch
from heliograph.web.sending import sending_of


def filmed(display_hz: float, lasts: int, skipped: float, seconds: float, seed: int = 1) -> list[Frame]:
    """Film a display at 30 frames/s; each pattern lasts `lasts` refreshes and a fraction of refreshes is skipped."""
    rng = np.random.default_rng(seed)
    grabs = shown(sending_of(rng.bytes(3000), "a.bin", 16, display_hz / lasts), seconds, cell_px=8)
    refreshes = np.flatnonzero(rng.random(int(seconds * display_hz)) >= skipped)
    patterns, first = np.unique(refreshes // lasts, return_index=True)
    times_s = grabs.times_s[0] + refreshes[first] / display_hz
    phone = Phone(width=240, height=240, side_px=200, blur_px=0.8, seed=seed)
    seen = phone_frames(Grabs(times_s, grabs.pictures[patterns]), phone)
    return [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(seen)]


@pytest.mark.slow
@pytest.mark.parametrize(("display_hz", "lasts", "skipped"), [(72, 5, 0.2), (77, 7, 0.0)])
def test_any_rate_is_found_also_where_refreshes_are_skipped(display_hz: float, lasts: int, skipped: float) -> None:
    settings = load_settings("phone")
    film = filmed(display_hz, lasts, skipped, 2.3 * 30 * lasts / display_hz)
    packets = list(heliograph.receive_frames(film, settings.signal, settings.receive))
    assert [packet.status for packet in packets][:2] == ["ok", "ok"]


def test_what_is_doubtful_is_no_array_before_many_frames_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between two slow patterns only noise changes, which resembles a poor array."""
    budget = SearchBudget()
    fitter = CellFitter(8, 1.0, np.linspace(0, 1, 256, dtype=np.float32), budget)
    place = Place.of(np.array([[20, 20], [100, 20], [100, 100], [20, 100]], float), 8)
    search = ArraySearch(8, 2.2, budget)
    monkeypatch.setattr(search, "_fit_candidate", lambda *_: (0.5, place, fitter))
    rng = np.random.default_rng(1)
    taken = []
    for k in range(PARAMETERS.kept_frames):
        cells = rng.integers(20, 230, (8, 8)).astype(np.uint8).repeat(10, 0).repeat(10, 1)
        pixels = np.pad(cells, 20, constant_values=10)
        taken.append(search.push(Frame(k, k / 30, pixels)) is not None)
    assert PARAMETERS.max_doubtful <= taken.index(True) + 1 <= PARAMETERS.kept_frames
