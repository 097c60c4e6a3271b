"""Map bits of layers to symbols and back.

In a pair every symbol is a bit. In the single mode a row of D11 is data times the row's polarity (`signal.polarity`), a
check of three: symbol = polarity x datum. With t = tanh(L / 2) of the symbols' LLRs and m the data's means, the
LLR of the polarity is

    L_s = L(column 0) + sum over the row of 2 artanh(t m),

and the message to each symbol or datum is the product of the other two members of the check.
"""

from collections.abc import Sequence

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.lmmse import LARGEST_LLR
from heliograph.signal.packet import PacketFormat


class SymbolMapper:
    """Maps means and LLRs between bits of layers and symbols of the equaliser."""

    def __init__(self, form: PacketFormat):
        self._single = form.single
        self._half = form.settings.side // 2
        self._edges = np.cumsum([layer.symbols for layer in form.layers.values()])[:-1]
        self._llr = np.zeros((form.layers["high"].pairs, self._half, self._half))

    def expected(self, means: Sequence[Floats], variances: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Compute mean and variance of each symbol, (patterns, n n)."""
        if not self._single:
            return np.concatenate(means, axis=1), np.concatenate(variances, axis=1)
        data = means[0].reshape(-1, self._half, self._half - 1)
        checks, total = self._decode_polarities(data)
        mean, square = np.zeros_like(self._llr), np.zeros_like(self._llr)
        mean[:, 1:, 0] = np.tanh(0.5 * checks[:, 1:].sum(-1))
        known = np.tanh(0.5 * (total[..., None] - checks))
        mean[:, :, 1:] = known * data
        # a variance above 1 - mean^2 marks an undecoded datum as unknown
        square[:, :, 1:] = known**2 * (1 - variances[0].reshape(data.shape))
        square[:, :, 0] = mean[:, :, 0] ** 2
        flat = len(mean), self._half**2
        high = mean.reshape(flat), 1 - square.reshape(flat)
        return np.concatenate([high[0], *means[1:]], axis=1), np.concatenate([high[1], *variances[1:]], axis=1)

    def bits(self, llr: Floats, means: Sequence[Floats]) -> list[Floats]:
        """Compute LLRs of the bits of each layer, (patterns, bits)."""
        if not self._single:
            return np.split(llr, self._edges, axis=1)
        size = self._half**2
        latest = llr[:, :size].reshape(self._llr.shape)
        # the extrinsic LLR of a known symbol is 0: keep the last one
        self._llr = np.where(latest == 0, self._llr, latest)
        checks, total = self._decode_polarities(means[0].reshape(-1, self._half, self._half - 1))
        data = _llr_of(np.tanh(0.5 * (total[..., None] - checks)) * np.tanh(0.5 * self._llr[:, :, 1:]))
        return [data.reshape(len(llr), -1), *np.split(llr[:, size:], self._edges[1:] - self._edges[0], axis=1)]

    def _decode_polarities(self, data: Floats) -> tuple[Floats, Floats]:
        """Compute messages of data to the polarities of rows, and the LLRs of these; row 0 has the polarity +1."""
        checks = _llr_of(np.tanh(0.5 * self._llr[:, :, 1:]) * data)
        total = self._llr[:, :, 0] + checks.sum(-1)
        checks[:, 0], total[:, 0] = 0.0, 2 * LARGEST_LLR
        return checks, total


def _llr_of(mean: Floats) -> Floats:
    """Compute the LLR of a mean, at most 28."""
    return np.asarray(2 * np.arctanh(np.clip(mean, -1 + 1e-12, 1 - 1e-12)))
