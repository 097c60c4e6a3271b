"""Pairs out of step of whose squares of 2 x 2 LEDs at most one symbol is open: what is observed lies on lines.

A square's observed symbols are a function of its four symbols. With three of them known they are start + direction u,
u being the open symbol, and the light of the pairs before and after is the same in these pairs' open symbols. So the
equaliser has a quarter of the unknowns for each kind of pair, and knows how the observed symbols of a square belong
together.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.decode.gain_and_noise import GainAndNoise, moments_of
from heliograph.receive.equalise.llr import llr_of
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, equalise
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.timing.out_of_step import OutOfStep


@dataclass(frozen=True, slots=True)
class Lines:
    """Observed symbols of a packet's pairs by the open symbols u."""

    # (pairs, squares) number of the open symbol of each square among its pair's; of a square without one any of its own
    open: NDArray[np.intp]
    # (pairs, symbols) observed symbols where all u of their pair are 0, and the light along their lines that is not
    # theirs
    start: Floats
    # (pairs, symbols) their slopes by the pair's own u
    slope: Floats
    # mean, variance: (pairs, squares) mean and variance of u
    mean: Floats
    variance: Floats
    # leak, leak_variance: (pairs, squares) mean and variance of the light of the pairs around, in units of u
    leak: Floats
    leak_variance: Floats

    @classmethod
    def of(cls, packet: OutOfStep, mean: Floats, variance: Floats) -> "Lines | None":
        """Lines of a packet's pairs; None where any square has more than one open symbol."""
        kinds = variance.reshape(len(variance), 4, -1)
        if ((kinds >= KNOWN_VARIANCE).sum(1) > 1).any():
            return None
        which = kinds.argmax(1)
        open_ = which * kinds.shape[-1] + np.arange(kinds.shape[-1])
        u, spread = (np.take_along_axis(values, open_, 1) for values in (mean, variance))
        start, slope = _line(packet.response, mean, which)
        start += packet.headers
        power = np.maximum(_product(slope, slope), TINY)
        leak, leak_variance = np.zeros_like(u), np.zeros_like(u)
        later, earlier = slice(1, None), slice(-1)
        for there, others, response in ((later, earlier, packet.before), (earlier, later, packet.after)):
            begin, leaks = _line(response[there], mean[others], which[others])
            part = _product(leaks, slope[there]) / power[there]
            # of what is not along the pair's own line the mean is known; its variance is left out
            aside = leaks - np.tile(part, 4) * slope[there]
            start[there] += begin + aside * np.tile(u[others], 4)
            leak[there] += part * u[others]
            leak_variance[there] += part**2 * spread[others]
        return cls(open_, start, slope, u, spread, leak, leak_variance)

    def equalised(self, number: int, pair: PairStatistics, channel: GainAndNoise) -> tuple[Floats, Floats]:
        """Equalise a pair along its lines."""
        along = pair.along(self.start[number], self.slope[number])
        leak, leak_variance = self.leak[number], self.leak_variance[number]
        estimate = equalise(
            along, channel.gain, channel.noise, self.mean[number] + leak, self.variance[number] + leak_variance
        )
        precision, weighted = estimate.extrinsic
        # of u and the leak together; 1 / precision + its variance is that of u
        alone = precision / (1 + precision * leak_variance)
        llr = np.zeros_like(self.start[number])
        llr[self.open[number]] = llr_of(alone, alone * (weighted / np.maximum(precision, TINY) - leak))
        return llr, moments_of(along, estimate)


def _line(response: Floats, mean: Floats, which: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Observed symbols half way between both values of each square's open symbol, and from there to its value +1.

    response (pairs, 16, 4) by the values of a square's symbols, mean (pairs, symbols) of these, which (pairs, squares)
    is open of the four; (pairs, symbols) each.
    """
    bits = np.arange(4)[:, None]
    # bit i of a value's number: 1 where symbol i is -1
    negative = (mean.reshape(len(mean), 4, -1) < 0) & (bits != which[:, None])
    others = (negative << bits).sum(1)
    plus, minus = (
        np.swapaxes(np.take_along_axis(response, value[..., None], 1), 1, 2).reshape(mean.shape)
        for value in (others, others | (1 << which))
    )
    return 0.5 * (plus + minus), 0.5 * (plus - minus)


def _product(one: Floats, other: Floats) -> Floats:
    """Inner products of what is observed of each square, (pairs, squares), of (pairs, symbols)."""
    return np.asarray((one * other).reshape(len(one), 4, -1).sum(1))
