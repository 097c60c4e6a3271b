"""Counts and exact intervals, compared with SciPy."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binomtest, chi2, poisson

from heliograph.measure.statistics import Clustered, Count, clopper_pearson, poisson_interval, quantile, range_m


@pytest.mark.parametrize(("errors", "trials"), [(1, 10), (5, 10), (9, 10), (1, 10**6), (37, 12345), (999, 1000)])
@pytest.mark.parametrize("confidence", [0.9, 0.99])
def test_two_sided_intervals_agree_with_scipy(errors: int, trials: int, confidence: float) -> None:
    with np.errstate(divide="ignore"):  # SciPy < 1.11 divides by zero in its test
        known = binomtest(errors, trials).proportion_ci(confidence, "exact")
    assert clopper_pearson(errors, trials, confidence) == pytest.approx((known.low, known.high), rel=1e-9)


@pytest.mark.parametrize("trials", [1, 10, 1000, 10**7])
def test_interval_without_errors_is_one_sided(trials: int) -> None:
    low, high = clopper_pearson(0, trials)
    assert low == 0
    assert high == pytest.approx(1 - 0.05 ** (1 / trials), rel=1e-9)
    assert high == pytest.approx(binomtest(0, trials, alternative="less").proportion_ci(0.95, "exact").high)
    low, high = clopper_pearson(trials, trials)
    assert high == 1
    assert low == pytest.approx(0.05 ** (1 / trials), rel=1e-9)


@pytest.mark.parametrize("trials", [100, 5120, 10**6])
def test_bound_without_errors_is_three_over_n(trials: int) -> None:
    assert Count(trials, 0).interval()[1] == pytest.approx(3 / trials, rel=0.02)
    assert Count(trials, 0).text() == f"< {3 / trials:.1e}"
    assert Count(trials, 0).interval()[1] <= 3 / trials


def test_coverage_is_at_least_the_confidence() -> None:
    rate, trials = 0.1, 40
    chance = sum(
        math.comb(trials, k) * rate**k * (1 - rate) ** (trials - k)
        for k in range(trials + 1)
        if clopper_pearson(k, trials)[0] <= rate <= clopper_pearson(k, trials)[1]
    )
    assert chance >= 0.95


def test_count_adds_up_and_shows_its_rate() -> None:
    count = Count()
    assert math.isnan(count.rate)
    assert (count.text(), count.interval()) == ("no data", (0, 1))
    count.add(1000, 1)
    count.add(1000, 2)
    assert (count.trials, count.errors, count.rate, count.text()) == (2000, 3, 0.0015, "1.5e-03")


@pytest.mark.parametrize(("errors", "trials"), [(-1, 5), (6, 5), (1, 0)])
def test_impossible_counts_are_errors(errors: int, trials: int) -> None:
    with pytest.raises(ValueError, match=f"0 to {trials}"):
        clopper_pearson(errors, trials)


def clustered(errors: NDArray[np.int64], size: int, scattered: bool = False) -> Clustered:
    trials, squares = size * len(errors), int((errors**2).sum())
    return Clustered(trials, int(errors.sum()), len(errors), squares, scattered)


@pytest.mark.parametrize("packets", [10, 100, 1000])
@pytest.mark.parametrize("bad", [0.01, 0.1, 1.0])
def test_interval_of_clustered_bit_errors_covers_the_rate(packets: int, bad: float) -> None:
    """Bad packets have 5 % to 20 % bit errors, others none; the binomial interval is far too narrow."""
    rng = np.random.default_rng([packets, round(100 * bad)])
    size, runs, true = 512, 600, bad * 0.125
    hits = np.zeros(2)
    for _ in range(runs):
        share = np.where(rng.random(packets) < bad, rng.uniform(0.05, 0.2, packets), 0.0)
        count = clustered(rng.binomial(size, share), size)
        intervals = count.interval(), Count(count.trials, count.errors).interval()
        hits += [low <= true <= high for low, high in intervals]
    assert hits[0] >= 0.93 * runs
    assert hits[1] <= 0.6 * runs


def test_independent_bits_keep_the_binomial_interval() -> None:
    count = clustered(np.random.default_rng(1).binomial(1000, 0.02, 200), 1000)
    low, high = count.interval()
    plain = Count(count.trials, count.errors).interval()
    assert count.design_effect < 1.3
    assert 1 <= (high - low) / (plain[1] - plain[0]) < 1.15


def test_packets_that_fail_completely_and_single_packets_count_as_trials() -> None:
    count = clustered(np.array([256] * 10 + [0] * 90), 256)
    assert count.design_effect == pytest.approx(256)
    assert count.interval() == pytest.approx(clopper_pearson(10, 100))
    assert clustered(np.array([30]), 1000).interval() == pytest.approx(clopper_pearson(0.03, 1))
    assert clustered(np.array([0]), 1000).interval() == pytest.approx(clopper_pearson(0, 1))


def test_packets_without_errors_are_the_trials_unless_errors_scatter() -> None:
    none = np.zeros(100, np.int64)
    together, scattered = clustered(none, 512), clustered(none, 512, scattered=True)
    assert together.text() == "< 3.0e-02"
    assert together.interval() == pytest.approx(clopper_pearson(0, 100))
    assert scattered.text() == "< 5.9e-05"
    assert scattered.interval() == pytest.approx(clopper_pearson(0, 51200))
    assert (Clustered().interval(), Clustered().text()) == ((0, 1), "no data")


def test_clusters_add_up() -> None:
    errors = np.array([0, 3, 40, 0, 7])
    whole, first, rest = Clustered(), *(clustered(errors[part], 100) for part in (slice(2), slice(2, None)))
    for wrong in errors:
        whole.add(100, int(wrong))
    first.include(rest)
    assert (first, whole.clusters, whole.squares) == (whole, 5, 9 + 1600 + 49)
    whole.add(0, 0)
    assert whole.clusters == 5
    assert whole.design_effect == pytest.approx(np.var(errors, ddof=1) / (100 * 0.1 * 0.9))


@pytest.mark.parametrize("events", [0, 1, 3, 40])
def test_interval_of_a_number_of_events_agrees_with_chi_square_and_covers(events: int) -> None:
    low, high = poisson_interval(events)
    tail = 0.025 if events else 0.05
    assert low == (pytest.approx(chi2.ppf(tail, 2 * events) / 2) if events else 0)
    assert high == pytest.approx(chi2.ppf(1 - tail, 2 * events + 2) / 2)
    numbers = range(200)
    covered = [poisson_interval(k)[0] <= events + 0.7 <= poisson_interval(k)[1] for k in numbers]
    assert poisson.pmf(numbers, events + 0.7) @ covered >= 0.95


def test_quantiles_are_the_smallest_values_that_reach_the_share() -> None:
    histogram = {"100": 1, "9": 18, "30": 1}
    assert [quantile(histogram, share) for share in (0.5, 0.9, 0.95, 0.96)] == [9, 9, 30, 100]
    values = np.random.default_rng(5).integers(0, 40, 101)
    counted = {str(value): int((values == value).sum()) for value in values}
    assert quantile(counted, 0.5) == np.median(values)
    # of 40 arrays 20 are known
    assert [quantile(histogram, share, 40) for share in (0.25, 0.5, 0.51)] == [9, 100, math.inf]


def test_range_is_interpolated_in_the_logarithm_and_bounded_by_the_points() -> None:
    points = [(25.0, 0.0), (60.0, 1e-3), (80.0, 1e-1), (150.0, 1e-3)]
    assert range_m(points, 1e-2) == pytest.approx(70)
    assert range_m(points, 0.2) == math.inf
    assert range_m(points[2:], 1e-2) == 0
    assert math.isnan(range_m([(25.0, 0.0), (40.0, math.nan), (60.0, 0.5)], 1e-2))
    assert range_m([], 1e-2) == math.inf
