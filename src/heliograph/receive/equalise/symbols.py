"""From layers' bits to symbols and back.

In a pair every symbol is a bit. In the single mode a row of D11 is data times the row's polarity (`signal.polarity`), a
check of three: symbol = polarity x datum. With t = tanh(L / 2) of the symbols' LLRs and m the data's means, the
polarity's LLR is

    L_s = L(column 0) + sum over the row of 2 artanh(t m),

and the message to each symbol or datum is the product of the other two of its check, its own part left out.
"""

from collections.abc import Sequence

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.lmmse import LARGEST_LLR
from heliograph.signal.packet import PacketFormat

CERTAIN = 1e-12
"""Distance of a mean from +-1 below which its LLR is held at 28."""


class SymbolMapper:
    """Passes means and LLRs between the layers' bits and the symbols that the equaliser estimates."""

    def __init__(self, form: PacketFormat):
        self._single = form.single
        self._half = form.settings.side // 2
        self._edges = np.cumsum([layer.symbols for layer in form.layers.values()])[:-1]
        self._seen = np.zeros((form.layers["high"].pairs, self._half, self._half))

    def expected(self, means: Sequence[Floats], variances: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Mean and variance of each symbol. Returns (patterns, n n) each."""
        if not self._single:
            return np.concatenate(means, axis=1), np.concatenate(variances, axis=1)
        data = means[0].reshape(-1, self._half, self._half - 1)
        checks, total = self._polarity(data)
        mean, square = np.zeros_like(self._seen), np.zeros_like(self._seen)
        mean[:, 1:, 0] = np.tanh(0.5 * checks[:, 1:].sum(-1))
        known = np.tanh(0.5 * (total[..., None] - checks))
        mean[:, :, 1:] = known * data
        # a datum's variance may exceed 1 - mean^2, so that an undecoded one is never taken for known
        square[:, :, 1:] = known**2 * (1 - variances[0].reshape(data.shape))
        square[:, :, 0] = mean[:, :, 0] ** 2
        flat = len(mean), self._half**2
        high = mean.reshape(flat), 1 - square.reshape(flat)
        return np.concatenate([high[0], *means[1:]], axis=1), np.concatenate([high[1], *variances[1:]], axis=1)

    def bits(self, llr: Floats, means: Sequence[Floats]) -> list[Floats]:
        """LLRs of each layer's bits. Returns (patterns, bits) a layer."""
        if not self._single:
            return np.split(llr, self._edges, axis=1)
        size = self._half**2
        latest = llr[:, :size].reshape(self._seen.shape)
        # the extrinsic LLR of a known symbol is 0: keep the last one
        self._seen = np.where(latest == 0, self._seen, latest)
        checks, total = self._polarity(means[0].reshape(-1, self._half, self._half - 1))
        data = _llr(np.tanh(0.5 * (total[..., None] - checks)) * np.tanh(0.5 * self._seen[:, :, 1:]))
        return [data.reshape(len(llr), -1), *np.split(llr[:, size:], self._edges[1:] - self._edges[0], axis=1)]

    def _polarity(self, data: Floats) -> tuple[Floats, Floats]:
        """Message of each datum to its row's polarity, and the polarities' LLRs; row 0 has the polarity +1."""
        checks = _llr(np.tanh(0.5 * self._seen[:, :, 1:]) * data)
        total = self._seen[:, :, 0] + checks.sum(-1)
        checks[:, 0], total[:, 0] = 0.0, 2 * LARGEST_LLR
        return checks, total


def _llr(mean: Floats) -> Floats:
    """LLR of a mean."""
    return np.asarray(2 * np.arctanh(np.clip(mean, -1 + CERTAIN, 1 - CERTAIN)))
