"""Blinking regions: position, size, rate, and rejection of other regions."""

from collections.abc import Callable, Iterable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from light_oracle import expected_correlation
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.probe import kernels
from heliograph.probe.activity import Stretches, stretch_of
from heliograph.probe.arrays import Clock, clock_of
from heliograph.probe.frames import FrameTimes, FrameWatch
from heliograph.probe.levels import Levels, LevelWatch
from heliograph.probe.light import MIN_VARIANCE, lamp_period, pair_covariance
from heliograph.probe.noise import NoiseEstimate, NoiseWatch
from heliograph.probe.regions import Region, regions_of
from heliograph.signal.settings import SignalSettings

Picture = NDArray[np.float64]


def frames(draw: Callable[[int, Picture], None], count: int = 128) -> list[Frame]:
    """Draw into a uniform noisy scene."""
    rng, out = np.random.default_rng(7), list[Frame]()
    for k in range(count):
        picture = np.full((96, 128), 40.0)
        draw(k, picture)
        noisy = np.clip(np.rint(picture + rng.normal(0, 1.5, picture.shape)), 0, 255)
        out.append(Frame(k, k / 1000, noisy.astype(np.uint8)))
    return out


CELLS = np.random.default_rng(8).integers(0, 2, (64, 4, 4)).astype(float)


def blink(k: int, picture: Picture, x: int, y: int, cell: int, light: float = 60.0) -> None:
    """Draw 4 x 4 cells with patterns and inverses, two of each as in a header."""
    pattern = CELLS[k // 4 % 64]
    cells = pattern if k % 2 == 0 else 1 - pattern
    picture[y : y + 4 * cell, x : x + 4 * cell] += light * np.kron(cells, np.ones((cell, cell)))


def regions(film: list[Frame]) -> list[Region]:
    return regions_of(stretch_of(film), 255)[0]


def test_place_size_and_contrast_of_regions_are_measured() -> None:
    def draw(k: int, picture: Picture) -> None:
        blink(k, picture, 20, 30, 5)
        blink(k + 7, picture, 90, 60, 3, 30.0)

    large, small = regions(frames(draw))
    assert (large.x, large.y, large.width, large.height) == pytest.approx((29.5, 39.5, 20, 20), abs=1)
    assert (small.x, small.y, small.width, small.height) == pytest.approx((95.5, 65.5, 12, 12), abs=1)
    # includes the half-bright rim
    assert large.contrast == pytest.approx(0.85 * 60 / 255, rel=0.1)
    assert (large.at_border, large.saturated) == (False, 0)
    assert large.speed_px < 0.02


def test_motion_is_measured_in_pixels_per_frame_and_the_border_is_marked() -> None:
    (moving,) = regions(frames(lambda k, picture: blink(k, picture, 10 + k // 2, 70 - k // 4, 4)))
    assert moving.speed == pytest.approx((0.5, -0.25), abs=0.03)
    (cut,) = regions(frames(lambda k, picture: blink(k, picture, 0, 40, 5)))
    assert cut.at_border


def test_noise_makes_no_region_and_a_drifting_shadow_does_not_blink() -> None:
    def draw(k: int, picture: Picture) -> None:
        x = np.arange(picture.shape[1])
        picture += 60 / (1 + np.exp(-(x - 20 - 0.7 * k) / 3))

    assert regions_of(stretch_of(frames(lambda _, __: None)), 255) == ([], 0)
    assert all(region.blinks < 0.45 for region in regions(frames(draw)))
    assert regions(frames(lambda k, picture: blink(k, picture, 20, 30, 5)))[0].blinks > 0.6


def test_stretch_with_the_most_blinking_light_is_kept() -> None:
    watch = Stretches()
    for frame in frames(lambda k, picture: blink(k, picture, 20, 30, 5) if 600 <= k < 700 else None, 1100):
        watch.add(frame)
    best: Any = watch.best()
    assert (best.frames[0].index, len(best.frames)) == (512, 256)


ORDER = SignalSettings().slot_order


def test_kernel_agrees_with_the_reference() -> None:
    rates, phases, exposures = np.array([0.7, 1.0, 1.37, 4.2]), np.array([0.0, 0.3, 1.6]), np.array([0.3, 1.0])
    numbers, lags = np.arange(5.0), np.array([1, 2, 3])
    out = np.empty((4, 3, 2, 5, 3))
    covariance = pair_covariance(ORDER)
    kernels.expected_correlations(rates, phases, exposures, numbers, lags, covariance, MIN_VARIANCE, out)
    for place in np.ndindex(out.shape):
        r, p, x, t, k = place
        expected = expected_correlation(float(rates[r]), float(phases[p]), float(exposures[x]), t, int(lags[k]), ORDER)
        assert out[place] == pytest.approx(expected, abs=1e-9), place


def test_pattern_and_inverse_are_opposite_and_other_pairs_independent() -> None:
    # the variance floor keeps the correlation above -1
    assert expected_correlation(1.0, 0.0, 1.0, 0, 1, ORDER) < -0.8
    others = [expected_correlation(1.0, 0.0, 1.0, t, lag, ORDER) for t, lag in ((1, 1), (0, 2))]
    assert others == pytest.approx([0, 0], abs=1e-9)
    # two frames of a pattern cover different halves of the slots
    assert expected_correlation(2.0, 0.0, 1.0, 0, 1, ORDER) > 0.2


@pytest.mark.parametrize("period", [4.0, 7.5, 20.0])
def test_period_of_a_lamp_is_measured(period: float) -> None:
    brightness = 100 + 20 * np.sign(np.sin(2 * np.pi * (np.arange(240) + 0.3) / period))
    assert lamp_period(brightness) == pytest.approx(period, rel=0.02)
    for aperiodic in (np.random.default_rng(1).normal(100, 5, 240), np.full(240, 7.0)):
        assert lamp_period(aperiodic) is None


def clock(phase: float, ppm: float, packets: int) -> Clock:
    signal = SignalSettings()
    starts = (phase * signal.pattern_period_s + np.arange(packets) * signal.packet_s * (1 + ppm * 1e-6)).tolist()
    frames = [Frame(k, k * 1e-3, np.zeros((1, 1), np.uint8)) for k in range(20)]
    rows: Any = [SimpleNamespace(start_time_s=start) for start in starts]
    return clock_of(rows, frames, signal)


@pytest.mark.parametrize("phase", [0.0, 0.3, -0.45])
def test_phase_of_the_clock_is_the_delay_of_patterns_after_frames(phase: float) -> None:
    measured = clock(phase, 0.0, 1)
    assert measured.phase_patterns == pytest.approx(phase, abs=1e-9)
    assert (measured.rate_ppm, measured.in_step) == (None, abs(phase) < 0.1)


def test_rate_of_the_clock_needs_distant_packets() -> None:
    assert clock(0.1, 80.0, 2).rate_ppm is None
    measured = clock(0.1, 80.0, 20)
    assert measured.rate_ppm == pytest.approx(80, abs=0.1)
    assert measured.rate_error_ppm is not None
    assert measured.rate_error_ppm < 20


def frame(number: int, time_s: float, level: int = 0) -> Frame:
    return Frame(number, time_s, np.full((4, 4), level, np.uint8))


def stamped(numbers: Iterable[int], jitter_s: float = 0.0) -> FrameTimes:
    watch, rng = FrameWatch(25.0), np.random.default_rng(1)
    for number in numbers:
        watch.add(frame(number, number / 1000 + jitter_s * rng.standard_normal(), number % 251))
    return watch.times()


def test_rate_follows_from_the_stamps_not_from_the_container() -> None:
    times = stamped(range(300))
    assert (times.rate_hz, times.claimed_hz) == pytest.approx((1000, 25))
    assert times.jitter_s == pytest.approx(0, abs=1e-9)
    assert (times.count, times.lost, times.repeated, times.every) == (300, 0, 0, 1)
    assert FrameWatch(50.0).times().rate_hz == 50  # no frames


@pytest.mark.parametrize("jitter_s", [5e-6, 5e-5])
def test_jitter_of_stamps_is_measured(jitter_s: float) -> None:
    assert stamped(range(9000), jitter_s).jitter_s == pytest.approx(jitter_s, rel=0.05)


def test_lost_frames_are_counted_by_gaps_in_the_numbers() -> None:
    for numbers, expected in (
        (set(range(500)) - {10, 11, 12, 400}, (1, 4, 2, 1000)), (set(range(0, 900, 3)) - {300}, (3, 1, 1, 1000 / 3))
    ):  # fmt: skip
        times = stamped(sorted(numbers))
        assert (times.every, times.lost, times.gaps, times.rate_hz) == pytest.approx(expected)


def test_repeated_frames_are_counted() -> None:
    watch = FrameWatch(1000.0)
    repeated = [watch.add(frame(k, k / 1000, level)) for k, level in enumerate((1, 1, 2, 3, 3, 3))]
    assert (repeated, watch.times().repeated) == ([False, True, False, False, True, True], 3)


def levels(*pictures: NDArray[Any]) -> Levels:
    watch = LevelWatch(8)
    for k, pixels in enumerate(pictures):
        watch.add(Frame(k, k / 1000, pixels.astype(np.uint16), 12))
    return watch.levels()


def test_pixels_at_full_scale_are_counted() -> None:
    picture = np.full((10, 10), 100, np.uint16)
    picture[:3] = 4095
    measured = levels(picture)
    assert measured.at_full_scale == pytest.approx(0.3)
    assert measured.percentiles == {1: 100.0, 50: 100.0, 99: 4095.0}
    assert (measured.brightest, measured.ceiling, measured.full_scale) == (4095, 4095, 4095)


def test_level_of_clipping_shows_a_sensor_with_fewer_bits() -> None:
    rng = np.random.default_rng(2)
    assert levels(*(np.minimum(rng.exponential(400, (64, 64)), 1023) for _ in range(8))).ceiling == 1023
    assert levels(*(rng.normal(400, 20, (64, 64)) for _ in range(8))).ceiling == 4095
    assert levels(*(np.full((16, 16), 9) for _ in range(8))).ceiling == 4095


SLOPE = np.tile(np.linspace(20, 200, 160), (120, 1))
"""Gray levels of a still scene."""


def estimate(
    scene: Callable[[int], Picture],
    gain: float = 0.05,
    dark_e: float = 30.0,
    after: Callable[[Picture], Picture] = np.rint,
) -> NoiseEstimate:
    """Estimate film noise for an electron-counting sensor with `gain` gray levels per electron."""
    rng, watch = np.random.default_rng(3), NoiseWatch(32)
    for k in range(33):
        electrons = rng.poisson(scene(k) / gain) + rng.normal(0, dark_e, scene(k).shape)
        watch.add(Frame(k, k / 1000, np.clip(after(gain * electrons), 0, 255).astype(np.uint8)), repeated=False)
    return watch.noise(255)


@pytest.mark.parametrize(("gain", "dark_e"), [(0.02, 60.0), (0.2, 10.0)])
def test_gain_and_dark_noise_of_the_sensor_are_estimated(gain: float, dark_e: float) -> None:
    noise: Any = estimate(lambda _: SLOPE, gain, dark_e)
    assert noise.gain_dn_per_e == pytest.approx(gain, rel=0.05)
    assert abs(noise.gain_dn_per_e - gain) < 4 * noise.gain_error + 0.02 * gain
    assert noise.dark_e == pytest.approx(dark_e, rel=0.2)
    # at level 100 both terms add up
    assert noise.variance_at(100) == pytest.approx(100 * gain + (gain * dark_e) ** 2 + 1 / 12, rel=0.05)


def blinking(leds: NDArray[np.int64], k: int) -> Picture:
    picture = SLOPE.copy()
    picture[30:94, 20:84] = 20 + 200 * np.kron(leds[k], np.ones((8, 8)))
    return picture


def partly_wiped(levels: Picture) -> Picture:
    """Remove the noise in a fifth of the picture and of the gray levels."""
    picture = levels.copy()
    picture[:, 128:] = np.rint(SLOPE[:, 128:])
    return picture


def test_blinking_light_and_wiped_parts_do_not_change_the_gain() -> None:
    leds = np.random.default_rng(4).integers(0, 2, (33, 8, 8))
    assert estimate(partial(blinking, leds)).gain_dn_per_e == pytest.approx(0.05, rel=0.06)
    assert estimate(lambda _: SLOPE, after=partly_wiped).gain_dn_per_e == pytest.approx(0.05, rel=0.06)


def test_single_gray_level_gives_noise_but_no_gain() -> None:
    noise = estimate(lambda _: np.full((120, 160), 100.0))
    assert (noise.gain_dn_per_e, noise.untold) == (None, "one level")
    assert noise.deviation == pytest.approx((100 * 0.05 + (0.05 * 30) ** 2) ** 0.5, rel=0.03)


def test_unsuitable_films_name_the_obstacle() -> None:
    assert estimate(lambda _: SLOPE, after=lambda _: np.rint(SLOPE)).untold == "wiped"
    coarse = [np.kron(np.random.default_rng(k).uniform(20, 200, (15, 20)), np.ones((8, 8))) for k in range(33)]
    assert estimate(lambda k: np.asarray(np.roll(coarse[k], k % 7, 1))).untold in ("moving", "few")
    assert estimate(lambda k: np.full((120, 160), 0.0 if k % 2 else 300.0)).untold == "few"
    assert NoiseWatch(None).noise(255).untold == "few"
