"""Header amplitudes in frames, and light clock estimation from headers."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.sync.light_clock import LightClock, measure_amplitudes
from heliograph.signal.formats import words
from heliograph.signal.header import header_cells
from heliograph.signal.settings import SignalSettings

SIGNAL, IDENTITY, FINE, SLOTS = SignalSettings(), 29, 2000, np.array([15, 11, 5, 1]) / 16


class Amplitudes(NamedTuple):
    """Amplitudes as `measure_amplitudes` returns them."""

    times_s: Floats
    alternation: Floats
    brightness: Floats
    trust: float = 1.0


def header_view(start: float, exposure: float, period: float, seed: int = 0, form: int = 0) -> Amplitudes:
    """Integrate header amplitudes numerically: frames `period` patterns apart, header `start` patterns late.

    The second pair signals a format: dimmed cells have levels 3 and 1.
    """
    times: Floats = np.arange(-2, 6 + 1e-9, period)
    steps = np.arange(-6 * FINE, 10 * FINE) / FINE
    pattern, slot = np.floor(steps), np.floor(4 * (steps % 1)).astype(int)
    cells, dimmed = header_cells(IDENTITY).ravel().astype(float), words()[form] > 0
    wave = np.random.default_rng(seed).normal(0, 0.03, 16)[(pattern + 6).astype(int)]
    bright = SLOTS[slot]
    for k in range(4):
        sign, here = -1 if k % 2 else 1, pattern == k
        levels = np.where(dimmed & (k >= 2), 2 + sign * cells, 2 + 2 * sign * cells)
        lit = (levels > np.arange(4)[:, None]).astype(float)
        wave[here], bright[here] = (2 * lit @ cells / 16)[slot[here]], lit.mean(1)[slot[here]]
    first, last = (np.searchsorted(steps, times - start + offset) for offset in (0, exposure))
    waves, lights = (np.concatenate([[0], np.cumsum(light)]) for light in (wave, bright))
    alternation, brightness = ((total[last] - total[first]) / (last - first) for total in (waves, lights))
    return Amplitudes(1e-3 * times, 100 * alternation, 200 * brightness + 31)


def measured(view: Amplitudes, period: float = 1.0, exposure_s: float | None = None) -> LightClock:
    clock = LightClock(0.0, period * 1e-3, SIGNAL, IDENTITY, exposure_s)
    assert clock.measure(view, 0)
    return clock


def distinct_formats() -> list[int]:
    """Return formats dimming most lit cells, most dark cells, all cells, and equally many lit and dark cells."""
    cells, dimmed = header_cells(IDENTITY).ravel(), words().astype(int)
    lit, count = dimmed @ cells, dimmed.sum(1)
    return [int(np.argmax(lit)), int(np.argmin(lit)), int(np.argmax(count)), int(np.argmax((lit == 0) & (count == 8)))]


@pytest.mark.parametrize("form", [0, *distinct_formats()])
@pytest.mark.parametrize("exposure", [1.0, 2 / 3, 0.37, 0.25])
@pytest.mark.parametrize("start", [0.12, 0.3, -0.37])
def test_header_gives_start_and_exposure_despite_dimmed_cells(start: float, exposure: float, form: int) -> None:
    clock = measured(header_view(start, exposure, exposure, form=form), exposure)
    assert clock.start_s == pytest.approx(start * 1e-3, abs=2e-5)
    assert clock.exposure == pytest.approx(exposure, abs=0.04)
    assert clock.gain == pytest.approx(200, rel=0.05 if form else 0.04)
    assert clock.explained > 0.95


@pytest.mark.parametrize("period", [0.37, 2 / 3])
@pytest.mark.slow
def test_later_header_gives_starts_finer_than_the_grid(period: float) -> None:
    late, found = np.linspace(-0.02, 0.02, 17), []
    for start in late:
        clock = measured(header_view(0.0, period, period), period)
        view = header_view(float(start), period, period)
        # the same header 100 patterns later
        clock.measure(view._replace(times_s=view.times_s + 0.1), 100)
        found.append((clock.start_s - 0.1) * 1e3)
    # the filter corrects a constant fraction, independent of the start
    slope, zero = np.polyfit(late, found, 1)
    assert slope == pytest.approx(1, abs=0.05)
    assert np.array(found) == pytest.approx(slope * late + zero, abs=1e-3)


# at 25 m some LEDs saturate; clipped brightness, without trust, shifted the clock by 0.3 T_b
@pytest.mark.parametrize(("wrong", "factor", "trust"), [(-0.1, 1, 0.1), (-0.4, 3, 0.0)])
def test_brightness_with_less_trust_counts_less(wrong: float, factor: float, trust: float) -> None:
    view = header_view(0.3, 1.0, 1.0)._replace(brightness=factor * header_view(wrong, 1.0, 1.0).brightness)
    full, less = (0.3 - measured(view._replace(trust=one)).start_s * 1e3 for one in (1.0, trust))
    assert full > 0.1 or trust
    assert abs(less) < (0.5 * abs(full) if trust else 0.01)


@pytest.mark.parametrize(("exposure", "period"), [(0.9, 1.0), (0.5, 1.0), (0.3, 2 / 3)])
@pytest.mark.parametrize("start", [0.3, -0.37, 0.12])
def test_header_with_known_exposure_gives_the_start(start: float, exposure: float, period: float) -> None:
    clock = measured(header_view(start, exposure, period), period, exposure_s=exposure * 1e-3)
    assert clock.start_s == pytest.approx(start * 1e-3, abs=5e-5)
    assert clock.exposure == pytest.approx(exposure)


def test_longest_of_equivalent_exposures_is_chosen() -> None:
    # the central 60 % of a pattern and the full pattern give equal header amplitudes
    assert measured(header_view(-0.2, 0.6, 1.0)).exposure == pytest.approx(1, abs=0.05)


def test_noise_is_not_explained() -> None:
    clock, noise = LightClock(0.0, 1e-3, SIGNAL, IDENTITY), np.random.default_rng(3).normal(0, 50, (2, 9))
    clock.measure(Amplitudes(np.linspace(-2e-3, 6e-3, 9), *noise), 0)
    assert clock.explained < 0.7


def test_rate_is_estimated_from_successive_headers() -> None:
    clock, rate = LightClock(0.0, 0.66e-3, SIGNAL, IDENTITY), -400e-6
    for packet in range(12):
        # align the header with the frame grid
        frames_s, late_s = (part * 0.66e-3 for part in divmod(packet * 0.1 * (1 + rate) / 0.66e-3, 1))
        view = header_view(late_s * 1e3, 0.66, 0.66, packet)
        clock.measure(view._replace(times_s=view.times_s + frames_s), 100 * packet)
    assert clock.rate == pytest.approx(rate, abs=2e-5)
    assert clock.time_s(1150) == pytest.approx(1.15 * (1 + rate), abs=3e-5)
    assert clock.pattern_at(clock.time_s(1234.5)) == pytest.approx(1234.5)


def normed_error(start: float, period: float, seed: int, part: float | None, trust: float, again: bool) -> float:
    """Return the normalised start error for a noisy header; the exposure is a known part of the frame period."""
    clock = LightClock(0.0, period * 1e-3, SIGNAL, IDENTITY, None if part is None else part * period * 1e-3)
    view = header_view(start, (part or 1.0) * period, period, seed)._replace(trust=trust)
    noise = np.random.default_rng([seed, 3]).normal(0, 4, len(view.times_s))
    for repeat in range(1 + again):
        assert clock.measure(view._replace(alternation=view.alternation + noise), 0, again=bool(repeat))
    return (clock.time_s(0) * 1e3 - start) / clock.deviation


@pytest.mark.parametrize(
    ("period", "trust", "again"), [(1.0, 1.0, False), (1.0, 0.0, True), (0.5, 1.0, True), (0.5, 0.0, False)]
)
@pytest.mark.slow
def test_start_errors_match_the_stated_deviation(period: float, trust: float, again: bool) -> None:
    errors = [normed_error(0.3, period, seed, None, trust, again) for seed in range(40)]
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.5


@examples(80)
@given(
    start=st.floats(-0.9, 0.9),
    period=st.floats(0.25, 1.0),
    part=st.none() | st.floats(0.3, 1.0),
    seed=st.integers(0, 99),
)
@pytest.mark.slow
def test_any_start_is_within_five_deviations(start: float, period: float, part: float | None, seed: int) -> None:
    assert abs(normed_error(start, period, seed, part, 1.0, False)) < 5


def test_unseen_header_leaves_the_clock_unchanged() -> None:
    clock = measured(header_view(0.2, 1.0, 1.0))
    before = clock.time_s(50), clock.gain, clock.exposure
    noise = np.random.default_rng(0).normal(0, 3, (2, 9))
    assert not clock.measure(Amplitudes(1e-3 * (50 + np.arange(-2.0, 7.0)), *noise), 50)
    assert (clock.time_s(50), clock.gain, clock.exposure) == pytest.approx(before)


def unseen(pattern: int) -> Amplitudes:
    return Amplitudes(1e-3 * (pattern + np.arange(-2.0, 7.0)), np.full(9, 1e-3), np.zeros(9))


def test_known_rate_wanders_as_quartz_does() -> None:
    """The rate random walk is 6.3e-8 per square root of a pattern, which limits rate accuracy to 3.5e-6."""
    clock, view = LightClock(0.0, 1e-3, SIGNAL, IDENTITY), header_view(0.2, 1.0, 1.0)
    for packet in range(60):
        assert clock.measure(view._replace(times_s=view.times_s + 0.1 * packet), 100 * packet)
    assert clock.deviation < 0.01
    assert not any(clock.measure(unseen(pattern), pattern) for pattern in (16_000, 36_000))
    # rate deviation over 30000 patterns, and random walk from the first 10000 over the last 20000
    walk = 6.3e-8 * 10_000**0.5 * 20_000
    assert clock.deviation == pytest.approx(np.hypot(3.5e-6 * 30_000, walk), rel=0.1)


def test_start_uncertainty_grows_without_headers() -> None:
    """The initial rate deviation, 250 ppm, accumulates to one pattern after 4000 patterns."""
    clock = measured(header_view(0.2, 1.0, 1.0))
    assert not clock.measure(unseen(4000), 4000)
    assert clock.deviation == pytest.approx(1.0, rel=0.05)


SIDE, POSE = 16, Pose(20.3, 19.6, 1.6, 0.0, 0.55)
ON, CHEQUERED = np.ones((SIDE, SIDE)), np.where(np.arange(SIDE**2).reshape(SIDE, SIDE) % 2, 1.0, -1.0)


def seen(light: Floats, header: Floats, amplitudes: Sequence[float], full_scale: bool = False) -> Amplitudes:
    """Measure frames with array light and header amplitudes on a uniform background."""
    on, sign = (image_of(levels, POSE, (0, 0), (40, 40)) for levels in (light, light * header))
    images = [np.round(30 + 90 * on + a * sign).astype(np.uint8) for a in amplitudes]
    if full_scale:
        images[-1][10:30, 10:30] = 255
    frames = [Frame(k, 1e-3 * k, image) for k, image in enumerate(images)]
    return Amplitudes(*measure_amplitudes(frames, [POSE] * len(frames), header * light))


@pytest.mark.parametrize("dead", [0.0, 0.3])
def test_amplitudes_match_the_rendered_ones(dead: float) -> None:
    rng, drawn = np.random.default_rng(1), [40.0, -40.0, 10.0, 0.0]
    header = np.where(rng.random((SIDE, SIDE)) < 0.5, -1.0, 1.0)
    view = seen(np.where(rng.random((SIDE, SIDE)) < dead, 0.0, 1.0), header, drawn)
    assert view.alternation == pytest.approx(drawn, abs=0.5)
    assert np.ptp(view.brightness) < 2
    assert view.trust > 0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_amplitudes_stay_bounded_with_only_lit_or_dark_leds(sign: float) -> None:
    view = seen(ON, sign * ON, [0.0, 20.0])
    assert np.abs(view.alternation).max() < 120
    assert np.isfinite(view.brightness).all()


def test_amplitudes_without_leds_are_zero() -> None:
    assert seen(0 * ON, 0 * ON, [0.0, 0.0]).alternation == pytest.approx([0, 0])


def test_frame_at_full_scale_marks_clipping() -> None:
    assert [seen(ON, CHEQUERED, [10.0, 10.0], full).trust > 0 for full in (False, True)] == [True, False]
