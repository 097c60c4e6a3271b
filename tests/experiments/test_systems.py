"""Other systems: patterns, counts, ranges."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from heliograph.base.threads import one_thread
from heliograph.experiments import systems
from heliograph.experiments.links import static_link
from heliograph.experiments.report import Context
from heliograph.experiments.systems import CURVES, SCHEMES, BitCounts, count_bits, error_free_m, range_m
from heliograph.link.settings import LinkSettings
from heliograph.measure.statistics import Clustered, Count


def test_bits_of_a_pattern_come_back() -> None:
    for scheme in SCHEMES.values():
        bits = np.random.default_rng(0).integers(0, 2, (3, scheme.bits), dtype=np.uint8)
        patterns = scheme.encode(bits)
        assert patterns.shape == (3, 16, 16)
        assert patterns.dtype == np.uint8
        for pattern, sent in zip(patterns, bits, strict=True):
            assert np.array_equal(scheme.decode(pattern.astype(float) - 2) < 0, sent)
    assert {key: s.bits for key, s in SCHEMES.items()} == {"ook": 256, "haar": 256, "repeat2": 64, "repeat4": 16}
    square = SCHEMES["repeat4"].encode(np.eye(16, dtype=np.uint8)[:1])[0]
    assert not square[:4, :4].any()
    assert (square[4:] == 4).all()


@pytest.fixture
def short_films(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Shorten films to 16 data pairs, which leaves the result per pair unchanged, and use a single thread.

    On a loaded machine, multithreaded BLAS is ten times slower for small matrices.
    """

    def short(distance_m: float, rng: np.random.Generator) -> LinkSettings:
        settings = static_link(distance_m, rng)
        return replace(settings, signal=replace(settings.signal, data_pairs=16))

    monkeypatch.setattr(systems, "static_link", short)
    with one_thread():
        yield


@pytest.mark.slow
def test_bits_are_counted_and_the_inverse_helps(short_films: None) -> None:
    counted = count_bits(2000, 3, ("ook", 55.0))
    plain, inverse, known = (counted.counts[method, "all"] for method in ("plain", "inverse", "known"))
    assert counted.films == counted.found == 4
    assert plain.trials == inverse.trials == known.trials == 4 * 16 * 256
    assert 0.02 < plain.rate < 0.12
    assert inverse.rate < 1e-3
    assert known.rate < 1e-3


def test_repetition_reaches_further_but_not_everywhere(short_films: None) -> None:
    counted = count_bits(8000, 0, ("repeat2", 65.0)).counts["plain", "all"]
    assert counted.trials >= 2000
    assert counted.errors < 5
    beyond = count_bits(2000, 0, ("repeat2", 400.0))
    assert (beyond.found, beyond.counts) == (0, {})


def test_counting_ends_after_200_errors_of_each_method() -> None:
    counted = BitCounts({("plain", "all"): Clustered(1000, 200)}, films=4)
    assert counted.is_settled(10**6)
    counted.counts["inverse", "all"] = Clustered(1000, 0)
    assert not counted.is_settled(10**6)
    assert not BitCounts({("plain", "all"): Clustered(1000, 200)}, films=3).is_settled(10**6)


def test_ranges_and_field_trials_follow_the_counts() -> None:
    points = [(30.0, Count(10**5, 0)), (40.0, Count(10**5, 0)), (50.0, Count(10**5, 50)), (60.0, Count(10**5, 5000))]
    free = error_free_m(points)
    assert free is not None
    assert (free[0], free[1].trials) == (40.0, 2 * 10**5)
    assert range_m(points, 5e-4) == pytest.approx(50)
    assert range_m(points, 5e-3) == pytest.approx(55)
    assert range_m(points, 0.4) is None
    assert error_free_m(points[2:]) is None
    points = [(40.0, Count(1000, 3)), (50.0, Count(1000, 30))]
    assert systems.field_trial("without the inverse", 40.0, points, "why").verdict == "differs"
    # the limit is outside the measured range
    assert systems.field_trial("without the inverse", 40.0, [(40.0, Count(1000, 0))]).verdict == "differs"


@pytest.mark.slow
def test_result(short_films: None) -> None:
    places = {"ook": (40, 50, 60), "haar": (60,), "repeat2": (100,), "repeat4": (150,)}
    result = systems.run(Context(), 500, places)
    assert (len(result.pictures), result.findings[0].verdict) == (1, "holds")
    rows = {row["system"]: row for row in result.data["systems"]}
    assert (rows["on-off keying"]["error_free_m"], rows["hierarchical, high"]["bits_per_pattern"]) == (40.0, 64)
    assert len(result.tables[0].rows) == len(CURVES)
