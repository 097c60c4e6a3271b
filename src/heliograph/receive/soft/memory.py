"""Several looks: codewords of a carousel that could not be decoded are kept, and added to when they come again."""

from collections import defaultdict, deque

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.turbo import TurboCode

Floats = NDArray[np.float64]

Kind = tuple[str, TurboCode]
"""Layer and code: only codewords of one kind can be the same."""

KEPT = 32
"""Codewords kept of each kind."""

LIKENESS = 5.5
"""Standard deviations of agreement from which two codewords are taken for the same: 2e-8 by chance."""

FAITHFUL = 0.6
"""Share of the agreement to be expected that a look shows at least with what is its codeword."""


class Memory:
    """LLRs of the codewords of one array that were seen but not decoded."""

    def __init__(self) -> None:
        self._kept: dict[Kind, deque[Floats]] = defaultdict(lambda: deque(maxlen=KEPT))

    def recall(self, kind: Kind, llr: Floats) -> Floats:
        """Sum of the LLRs (E,) of earlier looks at the codeword that a look with `llr` shows; zeros without any."""
        kept = self._kept[kind]
        agreements = [agreement(llr, other) for other in kept]
        best = int(np.argmax(agreements)) if agreements else -1
        if best < 0 or agreements[best] < LIKENESS:
            return np.zeros_like(llr)
        return kept[best]

    def keep(self, kind: Kind, llr: Floats, recalled: Floats) -> None:
        """Keep what is known of a codeword that this look alone did not give, in place of what was recalled."""
        kept = self._kept[kind]
        rest = [other for other in kept if other is not recalled]
        kept.clear()
        kept.extend([*rest, llr + recalled])


def agreement(a: Floats, b: Floats) -> float:
    """How far two looks (E,) agree beyond chance, in standard deviations of looks at different codewords."""
    # sum of E[bit | a] E[bit | b]; for bits that have nothing to do with each other of mean 0
    product = np.tanh(a / 2) * np.tanh(b / 2)
    return float(product.sum() / np.sqrt(max(float((product**2).sum()), 1e-12)))


def faithful(llr: Floats, signs: Floats) -> bool:
    """Whether a look (E,) alone speaks for a codeword's bits, 1 for 0 and -1 for 1, as far as it speaks at all.

    A codeword decoded with the help of earlier looks might be theirs alone, of which this one differs in some bits.
    """
    soft = np.tanh(llr / 2)
    # E[soft * sign] = soft^2 where the LLRs are right
    expected = float((soft**2).sum())
    spread = float(np.sqrt((soft**2 * (1 - soft**2)).sum()))
    return bool(soft @ signs >= FAITHFUL * expected - 3 * spread)
