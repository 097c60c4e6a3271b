"""Expectation propagation: what being +-1 says of cells that the equaliser takes as Gaussian.

To the others the light of a cell that is not decoded is noise. Linear MMSE takes it as Gaussian, but a cell is -1 or
+1, and where a look tells something of it, it is less uncertain than that. In the place of what is known of cell i
stands a Gaussian, its site, of precision L_i and mean G_i / L_i. What the equaliser says of the cell without its site
is the cavity; the site is chosen so that the two together have the mean and the variance of the cavity together with
-1 and +1, each as probable as the turbo decoder says (Minka 2001; for equalisers Santos et al. 2017).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.soft.equalise import KNOWN, Estimate

Floats = NDArray[np.float64]

STEP = 0.7
"""Share of its way that a site goes in a round; all of it, sites of neighbours may swing."""

LEAST = 1e-6
"""Precision below which a site would take away what the cavity says; it stays as it was."""


@dataclass(slots=True)
class Sites:
    """The Gaussians in the places of a packet's cells, (patterns, cells) each.

    Attributes
    ----------
    precision, weighted
        L and G.
    cavity, cavity_weighted
        The same of the cavities; 0 where the looks have not been equalised.
    """

    precision: Floats
    weighted: Floats
    cavity: Floats
    cavity_weighted: Floats

    @classmethod
    def begun(cls, shape: tuple[int, int]) -> "Sites":
        """Sites of cells of which nothing is known."""
        return cls(np.ones(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape))

    def forget(self) -> None:
        """Begin again: the looks are others, or the guesses that led here are not to be used."""
        self.cavity[:], self.cavity_weighted[:] = 0.0, 0.0

    def priors(self, mean: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Mean and variance of the sites, (patterns, cells), by those of the cells that the turbo decoder gives.

        Decoded cells are their own.
        """
        # P(+1) / P(-1) = exp(L), L = 2 artanh(mean) + 2 G_cavity
        llr = 2 * np.arctanh(np.clip(mean, KNOWN - 1, 1 - KNOWN)) + 2 * self.cavity_weighted
        both = np.tanh(0.5 * llr)
        spread = np.maximum(1 - both**2, 2 * KNOWN)
        # L_i = 1 / variance - L_cavity, G_i = mean / variance - G_cavity
        precision, weighted = 1 / spread - self.cavity, both / spread - self.cavity_weighted
        step = np.where(self.cavity == 0, 1.0, np.where(precision > LEAST, STEP, 0.0))
        self.precision += step * (precision - self.precision)
        self.weighted += step * (weighted - self.weighted)
        known = variance < KNOWN
        return np.where(known, mean, self.weighted / self.precision), np.where(known, variance, 1 / self.precision)

    def take(self, number: int, estimate: Estimate) -> Floats:
        """Keep the cavities of a look equalised with its sites; what it tells of its cells, LLRs (cells,)."""
        first = not self.cavity[number].any()
        self.cavity[number], self.cavity_weighted[number] = estimate.added
        # L = ln N(1) / N(-1) = 2 G; at first the neighbours that weigh most are drawn from +-1, which is nearer
        return estimate.llr if first else 2 * self.cavity_weighted[number]
