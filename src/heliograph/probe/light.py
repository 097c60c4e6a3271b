"""Duration of a pattern in frames, measured from the light of a region.

Each pattern is followed by its inverse. The light of an LED in two frames is therefore opposite, equal or independent,
depending on the position of both frames within the pairs. The correlations of frames 1, 2 and 3 apart, each LED without
its mean, are compared with the expected correlations for any duration, phase and exposure. Headers and bright patterns
have the same weight as any other pattern.

A lamp that flashes as a whole shows its period by the autocorrelation of its brightness.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.probe import kernels
from heliograph.probe.regions import Region, subsample
from heliograph.receive.sync.combine import COVARIANCE
from heliograph.signal.pwm import SLOTS

LAGS = (1, 2, 3)  # compared differences of frame numbers
PIECE = 24  # frames of a piece in which the duration may be off by 1 %, an eighth of a pattern at the ends
STEP = 0.02  # relative step of the tried durations

MIN_VARIANCE = 0.01
"""Additional variance of a frame's light, for a lit LED of variance 1; the light of a pair has no variance."""


@dataclass(frozen=True, slots=True)
class LightRate:
    """Duration of a pattern in a region."""

    # Duration in frames: 1 in step
    frames: float
    # Explained part of the correlations' variation, 0 to 1
    explained: float


def light_rate(
    frames: Sequence[Frame], region: Region, noise: float, ceiling: int, slot_order: Sequence[int]
) -> LightRate | None:
    """Measure the duration of a pattern in a region; None if the region shows no patterns."""
    known = correlations(frames, region, noise, ceiling)
    if np.isfinite(known).any(1).sum() < PIECE:
        return None
    order = tuple(slot_order)
    durations, expected = _piece_table(order)
    # up to ten pieces, spread over the stretch
    starts = np.unique(np.linspace(0, max(len(known) - PIECE, 0), 10).round().astype(int))
    scores = np.mean([_explained(known[k : k + PIECE], expected).max(1) for k in starts], axis=0)
    best = _refine(known, durations, scores, order) if scores.max() >= 0.12 else None
    # arrays have 0.65 to 0.95, but tiny, blurred and saturated ones 0.2 to 0.3; water and shadows up to 0.4 for long
    # durations
    threshold = 0.2 if best is not None and abs(best.frames - 1) < 0.02 else 0.5
    return best if best is not None and best.explained >= threshold else None


def _region_pixels(frames: Sequence[Frame], region: Region, numbers: range) -> Floats:
    """Copy a subsample of a region's pixels, (numbers, pixels), at most 4096 pixels of a frame."""
    step = max(1, int(np.ceil((region.width * region.height) ** 0.5 / 64)))
    return np.array([subsample(frames[k], region.box_at(k, len(frames)), step).ravel() for k in numbers])


def correlations(frames: Sequence[Frame], region: Region, noise: float, ceiling: int) -> Floats:
    """Correlate a region's frames, (frames, lags), NaN for missing and dark frames."""
    count = len(frames)
    pixels = _region_pixels(frames, region, range(count))
    clear = (pixels < ceiling).mean(0) > 0.99
    if clear.mean() > 0.1:
        pixels = pixels[:, clear]
    every = max(1, min(b.index - a.index for a, b in itertools.pairwise(frames)))
    numbers = [(frame.index - frames[0].index) // every for frame in frames]
    out = np.full((min(numbers[-1] + 1, 4 * count), len(LAGS)), np.nan)
    # PWM dims all LEDs together: remove the part proportional to the mean image
    mean = np.median(pixels, axis=0)
    shape = np.linalg.qr(np.stack([np.ones_like(mean), mean], axis=1))[0]
    rest = pixels - mean
    rest -= rest @ shape @ shape.T
    freedom = rest.shape[1] - shape.shape[1]
    power = (rest**2).sum(1) - noise**2 * freedom
    power[power <= 0.5 * noise**2 * freedom] = np.nan  # noise dominates
    places = {number: k for k, number in enumerate(numbers)}
    for number, k in places.items():
        for column, lag in enumerate(LAGS):
            other = places.get(number + lag)
            if other is not None and number < len(out):
                out[number, column] = rest[k] @ rest[other] / np.sqrt(power[k] * power[other])
    return np.clip(out, -1.5, 1.5)


def pattern_part(frames: Sequence[Frame], region: Region, noise: float) -> float:
    """Return the part of the power outside the strongest image: 0 for a lamp."""
    pixels = _region_pixels(frames, region, range(0, len(frames), max(1, len(frames) // 64)))
    rest = pixels - pixels.mean(0)
    values = np.linalg.svd(rest, compute_uv=False) ** 2
    total = max(float(values.sum()) - noise**2 * rest.size, TINY)
    return float(np.clip((values[1:].sum() - noise**2 * (rest.size - sum(rest.shape))) / total, 0.0, 1.0))


def lamp_period(brightness: Floats) -> float | None:
    """Measure the period of a lamp in frames by the autocorrelation of its brightness; None if no period is clear."""
    x = brightness - np.convolve(np.pad(brightness, 16, mode="edge"), np.full(33, 1 / 33), mode="valid")
    power = float(x @ x)
    if len(x) < 8 or power < TINY:
        return None
    auto = np.correlate(x, x, mode="full")[len(x) - 1 :] / power
    auto[1:] *= len(x) / np.arange(len(x) - 1, 0, -1)
    auto = auto[: len(x) // 2]
    peaks = [k for k in range(2, len(auto) - 1) if auto[k] >= max(auto[k - 1], auto[k + 1], 0.4)]
    if not peaks:
        return None
    # the first high peak; half a frame off the period a short flash loses a quarter
    k = next(k for k in peaks if auto[k] >= 0.7 * max(auto[j] for j in peaks))
    left, middle, right = auto[k - 1 : k + 2]
    bend = left - 2 * middle + right
    return float(k + (0.5 * (left - right) / bend if bend < 0 else 0.0))


def pair_covariance(slot_order: Sequence[int]) -> Floats:
    """Covariance (8, 8) of an LED's light in the slots of a random pattern and the inverse."""
    rank = np.argsort(np.asarray(slot_order))
    shown = np.zeros((2 * SLOTS, SLOTS))
    shown[np.arange(SLOTS), rank] = 1.0
    # slot j of the inverse is lit if slot 3 - j of the pattern is dark
    shown[SLOTS + np.arange(SLOTS), SLOTS - 1 - rank] = -1.0
    return np.asarray(shown @ COVARIANCE @ shown.T)


@lru_cache(maxsize=2)
def _piece_table(slot_order: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Durations, and the expected correlations of a piece for each."""
    # a pattern shorter than 0.6 frames and the inverse cancel in a frame, and a piece shows three patterns of 8 frames
    durations = np.geomspace(0.6, 8.0, int(np.ceil(np.log(8.0 / 0.6) / STEP)) + 1)
    return durations, _expected(durations, PIECE, slot_order)


def _expected(durations: Floats, frames: int, slot_order: Sequence[int]) -> Floats:
    """Compute expected correlations, (durations, phases and exposures, frames and lags)."""
    # phases within a pair, and exposures as fractions of the frame period
    phases, exposures = np.arange(12) / 6, np.array([0.3, 0.65, 1.0])
    out = np.empty((len(durations), len(phases), len(exposures), frames, len(LAGS)))
    kernels.expected_correlations(
        durations, phases, exposures, np.arange(float(frames)), np.array(LAGS), pair_covariance(slot_order),
        MIN_VARIANCE, out,
    )  # fmt: skip
    return out.reshape(len(durations), -1, frames * len(LAGS))


def _explained(known: Floats, expected: Floats) -> Floats:
    """Part of the variation of correlations (frames, lags) that each hypothesis explains, (durations, others)."""
    flat, size = known.ravel(), expected.shape[-1]
    d, weight = np.zeros(size), np.zeros(size)
    d[: flat.size] = np.nan_to_num(flat)
    weight[: flat.size] = np.isfinite(flat)
    count = weight.sum()
    if count < size / 3:
        return np.zeros(expected.shape[:2])
    # a constant in all frames, such as saturated LEDs, adds the same to all correlations
    mean = float(d.sum()) / count
    product = np.maximum(expected @ d - mean * (expected @ weight), 0.0)
    power = (expected**2) @ weight - (expected @ weight) ** 2 / count
    return np.asarray(product**2 / np.maximum(power, TINY) / max(float(d @ d) - mean**2 * count, TINY))


def _refine(known: Floats, durations: Floats, scores: Floats, slot_order: tuple[int, ...]) -> LightRate | None:
    """Refine the best durations of the pieces over all frames."""
    best: LightRate | None = None
    tried = list[float]()
    for k in np.argsort(-scores):
        is_done = len(tried) >= 2 or (best is not None and best.explained >= 0.6)
        if is_done or scores[k] < 0.5 * scores.max():
            break
        if any(abs(np.log(durations[k] / other)) < 2.5 * STEP for other in tried):
            continue
        tried.append(float(durations[k]))
        # steps of 0.002: at most a quarter of a pattern off after 250 patterns
        fine = durations[k] * np.exp(np.linspace(-1.5 * STEP, 1.5 * STEP, 31))
        explained = _explained(known, _expected(fine, len(known), slot_order)).max(1)
        i = int(np.argmax(explained))
        if best is None or explained[i] > best.explained:
            best = LightRate(float(fine[i]), float(explained[i]))
    return best
