"""A packet's pairs combined of frames out of step: what is observed of them, and what that tells of their symbols."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.timing import partial_exposure
from heliograph.receive.timing.combination import Combination


@dataclass(frozen=True, slots=True)
class ObservedSymbols:
    """What is expected of a packet's observed symbols."""

    # mean, variance: (pairs, symbols) of the light of each pair's own symbols
    mean: Floats
    variance: Floats
    # leak, leak_variance: (pairs, symbols) of the light of the pairs before and after
    leak: Floats
    leak_variance: Floats


@dataclass(frozen=True, slots=True)
class OutOfStep:
    """How a packet's pairs show their symbols, and those of the pairs before and after."""

    # (pairs, 16, 4) observed symbols by the values of a pair's own; see `partial_exposure.response`
    response: Floats
    # before, after: (pairs, 16, 4) the same of the pair before and the one after; 0 where it does not show
    before: Floats
    after: Floats
    # (pairs, symbols) light of the header before the first pair, and of the one after the last
    headers: Floats

    @classmethod
    def of(cls, combinations: Sequence[Combination | None], header: NDArray[np.bool_]) -> "OutOfStep":
        """A packet's pairs."""
        none, last = np.zeros_like(partial_exposure.VALUES), len(combinations) - 1
        response, leaks, headers = [], list[tuple[Floats, Floats]](), np.zeros((last + 1, header.size))
        for k, combination in enumerate(combinations):
            response.append(partial_exposure.VALUES if combination is None else combination.response)
            sides = [none, none]
            for side, place in enumerate((k - 1, k + 1)):
                leak = None if combination is None else combination.leaks[side]
                if leak is None or combination is None:
                    continue
                if 0 <= place <= last:
                    sides[side] = leak
                else:
                    headers[k] += partial_exposure.response_of_levels(combination.slots[2 * side], header)
            leaks.append((sides[0], sides[1]))
        before, after = (np.stack([pair[side] for pair in leaks]) for side in (0, 1))
        return cls(np.stack(response), before, after, headers)

    @property
    def in_step(self) -> bool:
        """Whether all that is observed are the pairs' own symbols."""
        return not self.before.any() and not self.after.any() and bool((self.response == partial_exposure.VALUES).all())

    def expected(self, mean: Floats) -> ObservedSymbols:
        """What is expected of the observed symbols."""
        if self.in_step:
            return ObservedSymbols(mean, 1 - mean**2, self.headers.copy(), np.zeros_like(mean))
        own, spread = partial_exposure.moments(self.response, mean)
        leak, leak_spread = self.headers.copy(), np.zeros_like(mean)
        later, earlier = slice(1, None), slice(-1)
        for there, others, response in ((later, earlier, self.before), (earlier, later, self.after)):
            if response.any():
                part, more = partial_exposure.moments(response[there], mean[others])
                leak[there] += part
                leak_spread[there] += more
        return ObservedSymbols(own, spread, leak, leak_spread)

    def llrs(self, found: Floats, variance: Floats, expected: ObservedSymbols, mean: Floats) -> Floats:
        """Extrinsic LLRs of the symbols by estimates of the observed ones."""
        own, noise = found - expected.leak, variance + expected.leak_variance
        if self.in_step:
            # y = c + n: ln P(c=+1)/P(c=-1) = 2 y / s^2
            return 2 * own / noise
        return partial_exposure.symbol_llrs(self.response, own, noise, mean)

    def posterior_moments(
        self, pairs: NDArray[np.intp], found: Floats, variance: Floats, mean: Floats
    ) -> tuple[Floats, Floats]:
        """Mean of observed symbols and of their squares, the light of other pairs left out; see `partial_exposure`."""
        if self.in_step:
            # <c> = tanh(y / s^2 + arctanh <c>_prior), c^2 = 1
            first = np.tanh(found / variance + np.arctanh(partial_exposure.uncertain(mean)))
            return first, np.ones_like(first)
        return partial_exposure.posterior_moments(self.response[pairs], found, variance, mean)
