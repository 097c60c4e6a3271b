"""Which LEDs give their light: dead, stuck and hidden ones are told by the headers, where the pattern is known.

In the difference of a header and its inverse what is behind the array cancels and an LED that does not follow the
pattern, whether dark, lit or hidden, is missing. With h the header as +-1 and w the share of its light each LED gives,

    d = g A (h w) + n,

which is the equaliser's problem with h w in place of the data: w comes by linear MMSE around w = 1. A bright background
may have pulled the pose away, and the LEDs of a rim then seem to miss: what an error of the pose explains is left out.
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.soft import kernels
from heliograph.receive.soft.equalise import equalise
from heliograph.receive.soft.glance import Glance, of_squares, to_grid
from heliograph.receive.soft.look import Look, weigh
from heliograph.receive.soft.noise import Noise, measure_noise

Floats = NDArray[np.float64]

SPREAD = 0.3
"""Standard deviation of an LED's share before a header is seen."""

FAILED, SOUND = 0.25, 0.65
"""Estimated shares up to which an LED counts as giving nothing, and from which on as giving all: noise and small
errors of the pose then change nothing of a sound array."""

CHANGED = 0.5
"""Change of an LED's share that makes the pose of a header worth finding again."""

LIT = 4.0
"""Noise inside the array over that beside it, as variances; photons make it 2.4 in the reference link."""

PULLED = np.array([0.2, 0.2, 0.004, 0.02])
"""Standard deviations of errors of a pose in x, y, ln pitch and roll before a bright background."""

MODEL = 0.02
"""Error of the image that errors of the pose leave, as a share of the light."""

FORGET = 0.5
"""Weight of what was seen in earlier packets: hidden LEDs come to light."""


class LedShares:
    """Learns from headers what share of its light each LED gives.

    Parameters
    ----------
    side
        LEDs in a row.

    Attributes
    ----------
    values
        (n, n), 0 to 1.
    """

    def __init__(self, side: int):
        self._side = side
        self._seen: Look | None = None
        self.values: Floats = np.ones((side, side))

    def forget(self) -> None:
        """Trust what was seen less: a packet has gone by."""
        if self._seen is not None:
            self._seen = self._seen.scaled(FORGET)

    def acquit(self) -> None:
        """Take all LEDs for sound again."""
        self._seen, self.values = None, np.ones((self._side, self._side))

    def learn(self, glance: Glance, header: Floats, gain: float) -> tuple[float, bool]:
        """Take a header pair.

        Parameters
        ----------
        glance
            The pair.
        header
            (n, n) of +-1.
        gain
            Gray levels of the array with all LEDs on, as if all gave their light alike.

        Returns
        -------
        gain
            Of the LEDs that give their light.
        changed
            Whether an LED gives its light that did not before, or no longer does: then the pose was found with others
            than there are, and the pair is to be looked at and taken again.
        """
        dark = measure_noise([glance], gain, self._side, self.values).dark
        # with failed LEDs a sum does not tell its noise
        weighted, noise = weigh(glance, Noise(LIT * dark, dark), self._side), LIT * dark + (MODEL * gain) ** 2
        slopes = weighted.root * glance.slopes(header)
        look = weighted.without(slopes, np.diag(noise / (gain * PULLED) ** 2))
        seen = look if self._seen is None else self._seen.plus(look)
        for _ in range(2):
            shares = _estimate(seen, header, gain, noise)
            # the median LED is a sound one
            scale = float(np.clip(np.median(shares), 0.5, 2.0))
            gain *= scale
            if abs(scale - 1) < SPREAD / 10:
                break
        values = np.clip((shares / scale - FAILED) / (SOUND - FAILED), 0, 1)
        changed = bool(np.abs(values - self.values).max() > CHANGED)
        self._seen, self.values = None if changed else seen, values
        return gain, changed


def _estimate(seen: Look, header: Floats, gain: float, noise: float) -> Floats:
    """Share of each LED's light, (n, n), by linear MMSE."""
    signs = of_squares(header)
    mean = kernels.cells(signs)
    # of h w of the variance s^2 the cells have the variance 4 s^2, T T^T being 1/4
    cells = equalise(seen, gain, noise, mean, np.full(mean.size, 4 * SPREAD**2)).mean
    return to_grid(kernels.leds(cells) / signs)
