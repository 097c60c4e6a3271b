"""Counts and their exact intervals, against SciPy."""

import math

import pytest
from scipy.stats import beta, binomtest

from heliograph.link.statistics import Count, clopper_pearson


@pytest.mark.parametrize(("errors", "trials"), [(1, 10), (5, 10), (9, 10), (1, 10**6), (37, 12345), (999, 1000)])
@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_two_sided_intervals_agree_with_scipy(errors: int, trials: int, confidence: float) -> None:
    known = binomtest(errors, trials).proportion_ci(confidence, "exact")
    assert clopper_pearson(errors, trials, confidence) == pytest.approx((known.low, known.high), rel=1e-9)
    tail = (1 - confidence) / 2
    quantiles = beta.ppf(tail, errors, trials - errors + 1), beta.ppf(1 - tail, errors + 1, trials - errors)
    assert clopper_pearson(errors, trials, confidence) == pytest.approx(quantiles, rel=1e-9)


@pytest.mark.parametrize("trials", [1, 10, 1000, 10**7])
def test_without_errors_the_whole_risk_lies_above(trials: int) -> None:
    low, high = clopper_pearson(0, trials)
    assert low == 0
    assert high == pytest.approx(1 - 0.05 ** (1 / trials), rel=1e-9)
    assert high == pytest.approx(binomtest(0, trials, alternative="less").proportion_ci(0.95, "exact").high)
    low, high = clopper_pearson(trials, trials)
    assert high == 1
    assert low == pytest.approx(0.05 ** (1 / trials), rel=1e-9)


@pytest.mark.parametrize("trials", [100, 5120, 10**6])
def test_the_bound_without_errors_is_three_by_n(trials: int) -> None:
    assert Count(trials, 0).interval()[1] == pytest.approx(3 / trials, rel=0.02)
    assert Count(trials, 0).text() == f"< {3 / trials:.1e}"
    assert Count(trials, 0).interval()[1] <= 3 / trials


def test_the_interval_covers_as_often_as_it_says() -> None:
    rate, trials = 0.1, 40
    chance = sum(
        math.comb(trials, k) * rate**k * (1 - rate) ** (trials - k)
        for k in range(trials + 1)
        if clopper_pearson(k, trials)[0] <= rate <= clopper_pearson(k, trials)[1]
    )
    assert chance >= 0.95


def test_a_count_adds_up_and_shows_its_rate() -> None:
    count = Count()
    assert math.isnan(count.rate)
    assert count.text() == "no data"
    assert count.interval() == (0, 1)
    count.add(1000, 1)
    count.add(1000, 2)
    assert (count.trials, count.errors, count.rate) == (2000, 3, 0.0015)
    assert count.text() == "1.5e-03"


@pytest.mark.parametrize(("errors", "trials"), [(-1, 5), (6, 5), (1, 0)])
def test_impossible_counts_are_refused(errors: int, trials: int) -> None:
    with pytest.raises(ValueError, match=f"0 to {trials}"):
        clopper_pearson(errors, trials)
