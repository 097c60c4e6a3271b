"""Other systems: their patterns, their counts and their ranges."""

import numpy as np
import pytest

from heliograph.experiments.result import Context
from heliograph.experiments.systems import experiment as figure
from heliograph.experiments.systems.schemes import ENOUGH, SCHEMES, SIDE, Heard, listen
from heliograph.measure.statistics import Count


@pytest.mark.parametrize("key", SCHEMES)
def test_bits_come_back(key: str) -> None:
    scheme = SCHEMES[key]
    bits = np.random.default_rng(0).integers(0, 2, (3, scheme.bits), dtype=np.uint8)
    patterns = scheme.encode(bits)
    assert patterns.shape == (3, SIDE, SIDE)
    assert patterns.dtype == np.uint8
    for pattern, sent in zip(patterns, bits, strict=True):
        assert np.array_equal(scheme.decode(pattern.astype(float) - 2) < 0, sent)


def test_bits_of_a_pattern() -> None:
    assert {key: s.bits for key, s in SCHEMES.items()} == {"ook": 256, "haar": 256, "repeat2": 64, "repeat4": 16}
    square = SCHEMES["repeat4"].encode(np.eye(16, dtype=np.uint8)[:1])[0]
    assert not square[:4, :4].any()
    assert (square[4:] == 4).all()


def test_listening_counts_bits_and_the_inverse_helps() -> None:
    heard = listen(SCHEMES["ook"], ("plain", "inverse", "known"), 55.0, 2000, 3)
    plain, inverse, known = (heard.counts[reading, "all"] for reading in ("plain", "inverse", "known"))
    assert heard.films == heard.found == 1
    assert plain.trials == inverse.trials == known.trials == 48 * 256
    assert 0.02 < plain.rate < 0.12
    assert inverse.rate < 1e-3
    assert known.rate < 1e-3


def test_repetition_reaches_further() -> None:
    assert listen(SCHEMES["repeat2"], ("plain",), 65.0, 2000, 0).counts["plain", "all"].errors < 5


def test_an_array_out_of_reach_ends() -> None:
    heard = listen(SCHEMES["ook"], ("plain",), 400.0, 2000, 0)
    assert heard.found == 0
    assert not heard.counts


def test_counting_ends_with_errors_enough() -> None:
    heard = Heard()
    heard.add("plain", "all", 1000, ENOUGH)
    assert heard.settled(10**6)
    heard.add("inverse", "all", 1000, 0)
    assert not heard.settled(10**6)


def test_ranges() -> None:
    points = [(30.0, Count(10**5, 0)), (40.0, Count(10**5, 0)), (50.0, Count(10**5, 50)), (60.0, Count(10**5, 5000))]
    free = figure.error_free_m(points)
    assert free is not None
    assert (free[0], free[1].trials) == (40.0, 2 * 10**5)
    assert figure.range_m(points, 5e-4) == pytest.approx(50)
    assert figure.range_m(points, 5e-3) == pytest.approx(55)
    assert figure.range_m(points, 0.4) is None
    assert figure.error_free_m(points[2:]) is None


def test_chapter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figure, "QUICK_BITS", 500)
    monkeypatch.setattr(
        figure, "QUICK_M", {"ook": (40, 50, 60, 65), "haar": (60,), "repeat2": (100,), "repeat4": (150,)}
    )
    chapter = figure.run(Context())
    assert chapter.key == "systems"
    assert len(chapter.pictures) == 1
    assert chapter.findings[0].verdict == "holds"
    rows = {row["system"]: row for row in chapter.data["systems"]}
    assert rows["on-off keying"]["error_free_m"] == 40.0
    assert rows["hierarchical, high"]["bits_per_pattern"] == 64
    assert len(chapter.tables[0].rows) == len(figure.LINES)


def test_a_claim_that_does_not_hold_differs() -> None:
    points = [(40.0, Count(1000, 3)), (50.0, Count(1000, 30))]
    assert figure._trial("without the inverse", 40.0, points, "why").verdict == "differs"
    # nothing tells where it ends
    assert figure._trial("without the inverse", 40.0, [(40.0, Count(1000, 0))]).verdict == "differs"
