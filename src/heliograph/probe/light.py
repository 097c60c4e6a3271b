"""How many frames a pattern lasts, as the light itself shows it.

Each pattern is followed by its inverse, so what LEDs show in one frame is the opposite of what they show in the next
one, or the same, or has nothing to do with it: by where both lie within pairs. Frames of a region are correlated with
those 1, 2 and 3 frames later, each LED about its mean. What is expected of these correlations, for any number of
frames to a pattern, any phase and exposure, is compared with them. A header or a bright pattern counts no more than
any other.

A lamp that goes on and off as a whole shows its period by the autocorrelation of its brightness.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.probe.regions import Region, thinned
from heliograph.receive.sync.combine import COVARIANCE
from heliograph.signal.pwm import SLOTS

LAGS = (1, 2, 3)
"""Frames by which two are apart that are compared."""

SEGMENT = 24
"""Frames of a piece within which a rate need not be exact: 1 % off shifts its ends by an eighth of a pattern."""

LEAST_RATE, MOST_RATE, RATE_STEP = 0.6, 8.0, 0.02
"""Frames to a pattern that are tried: fewest, most, and the step from one to the next as a fraction.

Below 0.6 a frame shows two patterns at least, in which a pair cancels; above 8 a piece shows fewer than three patterns.
"""

PHASES = 12
"""Phases that are tried within a pair: a sixth of a pattern apart."""

EXPOSURES = (0.3, 0.65, 1.0)
"""Exposures that are tried, as fractions of the frame period."""

EXPLAINED, EXPLAINED_IN_STEP = 0.5, 0.2
"""Part of the correlations' variation that a rate must explain to be told, and that one frame to a pattern must.

Of arrays it is 0.65 to 0.95, but 0.2 to 0.3 of tiny, blurred and saturated ones; of water and shadows up to 0.4, at
slow rates.
"""

LEAST_VARIANCE = 0.01
"""Least variance of a frame's light that is expected, an LED's being 1 when on: of a whole pair's there is none."""

TRIED, ENOUGH = 2, 0.6
"""Good rates that are looked at closely, and what one of them must explain for no other to be."""

MOST_PIXELS = 4096
"""Pixels of a region that are compared: more say no more of its LEDs."""

UNSATURATED, LEAST_CLEAR = 0.99, 0.1
"""Part of the frames in which a pixel is not saturated, to be looked at; and least part of the pixels that are."""


@dataclass(frozen=True, slots=True)
class LightRate:
    """How long a pattern lasts, as a region shows it."""

    # Frames that a pattern lasts: 1 in step
    frames: float
    # Part of the correlations' variation that this explains, 0 to 1
    explained: float
    # Place of the stretch's first frame within a pair of patterns, 0 to 2 patterns
    phase: float
    # Exposure as a fraction of the frame period, one of a few that were tried
    exposure: float


def light_rate(
    frames: Sequence[Frame], region: Region, noise: float, ceiling: int, slot_order: Sequence[int]
) -> LightRate | None:
    """How many frames a pattern lasts in a region."""
    seen = correlations(frames, region, noise, ceiling)
    if np.isfinite(seen).any(1).sum() < SEGMENT:
        return None
    order = tuple(slot_order)
    rates, table = _table(order)
    # most pieces that are looked at, spread over the stretch
    starts = np.unique(np.linspace(0, max(len(seen) - SEGMENT, 0), 10).round().astype(int))
    scores = np.mean([_explained(seen[k : k + SEGMENT], table).max(1) for k in starts], axis=0)
    # least part that a rate must explain within pieces to be looked at closely
    best = _finest(seen, rates, scores, order) if scores.max() >= 0.12 else None
    if best is None:
        return None
    # departure from one frame to a pattern that is none
    least = EXPLAINED_IN_STEP if abs(best.frames - 1) < 0.02 else EXPLAINED
    return best if best.explained >= least else None


def correlations(frames: Sequence[Frame], region: Region, noise: float, ceiling: int) -> Floats:
    """How alike a region's frames are, each pixel about its mean."""
    count = len(frames)
    step = max(1, int(np.ceil((region.width * region.height / MOST_PIXELS) ** 0.5)))
    pixels = np.array([thinned(one, region.box_at(k, count), step).ravel() for k, one in enumerate(frames)])
    clear = (pixels < ceiling).mean(0) > UNSATURATED
    if clear.mean() > LEAST_CLEAR:
        pixels = pixels[:, clear]
    every = max(1, min(b.index - a.index for a, b in itertools.pairwise(frames)))
    numbers = np.array([(frame.index - frames[0].index) // every for frame in frames])
    out = np.full((min(int(numbers[-1]) + 1, 4 * count), len(LAGS)), np.nan)
    # all of the array goes up and down with PWM, which hides what LEDs show
    mean = np.median(pixels, axis=0)
    shape = np.linalg.qr(np.stack([np.ones_like(mean), mean], axis=1))[0]
    rest = pixels - mean
    rest -= rest @ shape @ shape.T
    freedom = rest.shape[1] - shape.shape[1]
    power = (rest**2).sum(1) - noise**2 * freedom
    # least power of what LEDs show about their mean over that of noise, for a frame to be correlated with others
    power[power <= 0.5 * noise**2 * freedom] = np.nan
    places = {int(number): k for k, number in enumerate(numbers)}
    for number, k in places.items():
        for column, lag in enumerate(LAGS):
            other = places.get(number + lag)
            if other is not None and number < len(out):
                out[number, column] = rest[k] @ rest[other] / np.sqrt(power[k] * power[other])
    return np.clip(out, -1.5, 1.5)


def pattern_part(frames: Sequence[Frame], region: Region, noise: float) -> float:
    """How much of what a region's pixels do they do apart from each other."""
    count = len(frames)
    step = max(1, int(np.ceil((region.width * region.height / MOST_PIXELS) ** 0.5)))
    # frames that are compared to tell a lamp from a pattern
    some = range(0, count, max(1, count // 64))
    pixels = np.array([thinned(frames[k], region.box_at(k, count), step).ravel() for k in some])
    rest = pixels - pixels.mean(0)
    # the strongest image that goes up and down as one
    values = np.linalg.svd(rest, compute_uv=False) ** 2
    total = max(float(values.sum()) - noise**2 * rest.size, TINY)
    return float(np.clip((values[1:].sum() - noise**2 * (rest.size - sum(rest.shape))) / total, 0.0, 1.0))


def lamp_period(brightness: Floats) -> float | None:
    """Frames from one flash of a lamp to the next, by the autocorrelation of its brightness."""
    x = brightness - np.convolve(np.pad(brightness, 16, mode="edge"), np.full(33, 1 / 33), mode="valid")
    power = float(x @ x)
    if len(x) < 8 or power < TINY:
        return None
    auto = np.correlate(x, x, mode="full")[len(x) - 1 :] / power
    auto[1:] *= len(x) / np.arange(len(x) - 1, 0, -1)
    auto = auto[: len(x) // 2]
    peaks = [k for k in range(2, len(auto) - 1) if auto[k] >= auto[k - 1] and auto[k] >= auto[k + 1]]
    # least autocorrelation of a lamp's brightness at its period
    strong = [k for k in peaks if auto[k] >= 0.4]
    if not strong:
        return None
    # part of the highest peak that the first one must have: half a frame off the period a short flash loses a quarter
    k = next(k for k in strong if auto[k] >= 0.7 * max(auto[j] for j in strong))
    left, middle, right = auto[k - 1 : k + 2]
    bend = left - 2 * middle + right
    return float(k + (0.5 * (left - right) / bend if bend < 0 else 0.0))


def pair_covariance(slot_order: Sequence[int]) -> Floats:
    """Covariance (8, 8) of the light of an LED in the slots of a random pattern and its inverse."""
    rank = np.argsort(np.asarray(slot_order))
    shown = np.zeros((2 * SLOTS, SLOTS))
    shown[np.arange(SLOTS), rank] = 1.0
    # slot j of the inverse is lit where slot 3 - j of the pattern is not
    shown[SLOTS + np.arange(SLOTS), SLOTS - 1 - rank] = -1.0
    return np.asarray(shown @ COVARIANCE @ shown.T)


def expected_correlation(
    rate: float, phase: float, exposure: float, number: int, lag: int, slot_order: Sequence[int]
) -> float:
    """How alike a frame and a later one are on average; `kernels.expected_correlations` is the same, faster."""
    covariance = pair_covariance(slot_order)
    starts = [4 * ((number + later) / rate + phase) for later in (0, lag)]
    length = 4 * exposure / rate
    slots = np.arange(8 * np.floor(starts[0] / 8), 8 * np.ceil((starts[1] + length) / 8))
    one, other = (
        np.clip(np.minimum(start + length, slots + 1) - np.maximum(start, slots), 0, None).reshape(-1, 8) / length
        for start in starts
    )
    own, its, both = (np.einsum("pi,ij,pj", a, covariance, b) for a, b in ((one, one), (other, other), (one, other)))
    return float(both / np.sqrt((own + LEAST_VARIANCE) * (its + LEAST_VARIANCE)))


@lru_cache(maxsize=2)
def _table(slot_order: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Rates that are tried, and correlations that are expected of a piece, (rates, others, frames and lags)."""
    count = int(np.ceil(np.log(MOST_RATE / LEAST_RATE) / RATE_STEP)) + 1
    rates = np.geomspace(LEAST_RATE, MOST_RATE, count)
    return rates, _expected(rates, 2 * np.arange(PHASES) / PHASES, SEGMENT, slot_order)


def _expected(rates: Floats, phases: Floats, frames: int, slot_order: Sequence[int]) -> Floats:
    """Correlations that are expected, (rates, phases and exposures, frames and lags)."""
    from heliograph.probe import kernels  # Numba is slow to import

    out = np.empty((len(rates), len(phases), len(EXPOSURES), frames, len(LAGS)))
    numbers, covariance = np.arange(frames, dtype=float), pair_covariance(slot_order)
    kernels.expected_correlations(
        rates, phases, np.array(EXPOSURES), numbers, np.array(LAGS), covariance, LEAST_VARIANCE, out
    )
    return out.reshape(len(rates), -1, frames * len(LAGS))


def _explained(seen: Floats, expected: Floats) -> Floats:
    """Part of the variation of correlations (frames, lags) that each hypothesis explains, (rates, others)."""
    flat, size = seen.ravel(), expected.shape[-1]
    d, known = np.zeros(size), np.zeros(size)
    d[: flat.size] = np.nan_to_num(flat)
    known[: flat.size] = np.isfinite(flat)
    if known.sum() < size / 3:
        return np.zeros(expected.shape[:2])
    # what all frames have in common, such as LEDs that are cut off at full scale, adds the same to all
    count = known.sum()
    mean = float(d.sum()) / count
    both = np.maximum(expected @ d - mean * (expected @ known), 0.0)
    own = (expected**2) @ known - (expected @ known) ** 2 / count
    return np.asarray(both**2 / np.maximum(own, TINY) / max(float(d @ d) - mean**2 * count, TINY))


def _finest(seen: Floats, rates: Floats, scores: Floats, slot_order: tuple[int, ...]) -> LightRate | None:
    """The best rate over all frames, near one of the best of pieces."""
    best: LightRate | None = None
    tried: list[float] = []
    for k in np.argsort(-scores):
        if len(tried) >= TRIED or scores[k] < 0.5 * scores.max() or (best and best.explained >= ENOUGH):
            break
        if any(abs(np.log(rates[k] / one)) < 2.5 * RATE_STEP for one in tried):
            continue
        tried.append(float(rates[k]))
        # rates that are tried about a good one over the whole stretch: two thousandths apart, a quarter of a pattern in
        # 250 from the nearest
        fine = rates[k] * np.exp(np.linspace(-1.5 * RATE_STEP, 1.5 * RATE_STEP, 31))
        phases = 2 * np.arange(PHASES) / PHASES
        found = _explained(seen, _expected(fine, phases, len(seen), slot_order))
        i, j = np.unravel_index(int(np.argmax(found)), found.shape)
        one = LightRate(
            float(fine[i]), float(found[i, j]), float(phases[j // len(EXPOSURES)]), EXPOSURES[j % len(EXPOSURES)]
        )
        if best is None or one.explained > best.explained:
            best = one
    return best
