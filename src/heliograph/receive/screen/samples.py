"""The light of an array's cells in some frames, and how much of it a clock leaves unexplained."""

from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.screen.budget import SearchBudget
from heliograph.receive.screen.clock import Clock, pairs_between

BINS = 8
"""Groups of cells by row of pixels that are taken at one time. Chosen: an eighth of a frame's readout is 4 ms at
most."""

CLOCK_SAMPLES, PRODUCT_SAMPLES = 5000, 0.008
"""Work of judging a clock, and of a product in it, in `budget.SAMPLES_PER_S`."""

PAIR_LOADING = 1e-3
"""Loading of the least squares, by the power of a frame: a pair that hardly any frame shows must not be made of
noise."""


@dataclass(frozen=True)
class Samples:
    """Light of an array's cells in some frames."""

    # (frames,) starts of the exposures of row 0, by the camera's clock
    times_s: Floats
    # (frames, n, n) row of pixels of each cell
    rows: Floats
    # (frames, n, n) light in any unit, linear
    light: Floats
    # (frames,) inverse variance of the light, in any unit
    weights: Floats

    def between(self, start_s: float, end_s: float) -> "Samples":
        """Return those of frames between two times."""
        kept = (self.times_s >= start_s) & (self.times_s <= end_s)
        return Samples(self.times_s[kept], self.rows[kept], self.light[kept], self.weights[kept])

    def evened(self, gains: Floats) -> "Samples":
        """Return the same without the camera's gain."""
        whole = np.maximum(gains if gains.ndim == 1 else gains.mean((1, 2)), TINY)
        # what is divided by a small gain is noisy
        weights = self.weights * np.clip(whole / np.median(whole), 0, 1) ** 2
        shape = (len(gains), 1, 1) if gains.ndim == 1 else gains.shape
        return replace(self, light=self.light / np.maximum(gains.reshape(shape), TINY), weights=weights + TINY)


class Bins:
    """Samples by groups of rows of pixels, for the search of a clock."""

    def __init__(self, samples: Samples, budget: SearchBudget | None = None):
        self._budget = budget or SearchBudget()
        n = samples.light.shape[-1]
        y = samples.rows.mean(0).ravel()
        order = np.argsort(y, kind="stable")
        groups = np.array_split(order, min(BINS, n))
        flat, rows = (one.reshape(len(samples.times_s), -1) for one in (samples.light, samples.rows))
        self.times_s = samples.times_s
        self.rows = np.stack([rows[:, g].mean(1) for g in groups])  # (bins, frames)
        self._share = samples.weights[:, None] / samples.weights.sum()
        self._root = np.sqrt(self._share * len(samples.weights))
        seen = [self._root * (flat[:, g] - (self._share * flat[:, g]).sum(0)) for g in groups]
        self.gram = np.stack([one @ one.T for one in seen])  # (bins, frames, frames)
        self.power = float(np.trace(self.gram, axis1=1, axis2=2).sum())

    def unexplained(self, clock: Clock) -> float:
        """Return the variance that a clock's pairs leave, as a part of all."""
        frames = len(self.times_s)
        pairs = pairs_between(
            clock, float(self.times_s[0]), float(self.times_s[-1]), clock.row_s * float(self.rows.max())
        )
        # a frame more is needed than there are unknowns
        if len(pairs) + 1 >= frames - 1:
            return 1.0
        self._budget.spend(
            CLOCK_SAMPLES + PRODUCT_SAMPLES * len(self.rows) * frames * len(pairs) * (frames + len(pairs))
        )
        m = clock.design(self.times_s + clock.row_s * self.rows, pairs)
        m = self._root * (m - (self._share * m).sum(1, keepdims=True))
        gram = m.transpose(0, 2, 1) @ m
        loading = PAIR_LOADING * 2 * frames / len(pairs) * np.eye(len(pairs))
        b = m.transpose(0, 2, 1) @ self.gram @ m
        got = float(np.trace(np.linalg.solve(gram + loading, b), axis1=1, axis2=2).sum())
        left = max(self.power - got, 0.0) / max(self.power, TINY)
        return left * (frames - 1) / (frames - 1 - len(pairs))
