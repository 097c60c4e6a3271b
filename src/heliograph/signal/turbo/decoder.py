"""Drive a kernel: pack blocks into tiles, stop those that are done, keep the others together."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.code import Check
from heliograph.signal.turbo.encoder import TERMINATION
from heliograph.signal.turbo.options import LLR_LIMIT, PER_LLR, DecoderOptions, TurboResult

_CHUNK_BITS = 2**17
"""Information bits decoded at once; their tiles take about 3 MB. Chosen: half and twice the value, here and in the two
bounds below, gave the same speed within 30 %, the noise of the shared machine it was measured on."""

_FEWEST_BLOCKS = 64
"""Blocks decoded at once at least: four tiles."""

_MOST_BLOCKS = 512
"""Blocks decoded at once at most, however short."""

_FEW_BLOCKS = 4
"""Most blocks that `single` decodes; more are decoded side by side by `kernel`. With max-log `single` takes a sixth of
the time of a tile for each block, with log-MAP a quarter. Receivers have one to four codewords."""

Floats32 = NDArray[np.float32]
Indices = NDArray[np.int64]


def decode_blocks(
    llr: Floats32,
    positions: Indices,
    order: Indices,
    options: DecoderOptions,
    *,
    a_priori: Floats32 | None = None,
    check: Check | None = None,
    coded_output: bool = False,
) -> TurboResult:
    """Decode blocks with the Numba kernel; the caller has checked the shapes.

    Parameters
    ----------
    llr : ndarray of float32, shape (B, E)
        Received LLRs, free of NaN.
    positions : ndarray of int64, shape (E,)
        Position of each received bit in the mother codeword.
    order : ndarray of int64, shape (K,)
        Interleaver, ``x_itl = x_nat[order]``.
    options : DecoderOptions
        Algorithm, iterations, scale, stopping rule.
    a_priori : ndarray of float32, shape (B, K), optional
        A-priori LLRs of the information bits.
    check : callable, optional
        The check of ``stop="crc"``.
    coded_output : bool
        Whether to compute the LLRs of the coded bits too.

    Returns
    -------
    TurboResult
        Arrays of leading shape (B,). A block's result does not depend on the other blocks.
    """
    result = _empty_result(len(llr), len(positions), len(order), coded_output)
    chunk = min(max(_CHUNK_BITS // len(order), _FEWEST_BLOCKS), _MOST_BLOCKS)
    for start in range(0, len(llr), chunk):
        part = slice(start, start + chunk)
        run = _Run(llr[part], positions, order, options, None if a_priori is None else a_priori[part])
        run.decode(_rows(result, part), check)
    if result.coded_llr is None:
        return result
    received = np.clip(llr, -LLR_LIMIT, LLR_LIMIT)
    return replace(result, coded_extrinsic=result.coded_llr - received)


def _empty_result(blocks: int, coded_bits: int, k: int, coded_output: bool) -> TurboResult:
    return TurboResult(
        bits=np.empty((blocks, k), dtype=np.uint8),
        llr=np.empty((blocks, k), dtype=np.float32),
        extrinsic=np.empty((blocks, k), dtype=np.float32),
        iterations=np.zeros(blocks, dtype=np.int32),
        stopped=np.zeros(blocks, dtype=np.bool_),
        coded_llr=np.empty((blocks, coded_bits), dtype=np.float32) if coded_output else None,
    )


def _rows(result: TurboResult, part: slice) -> TurboResult:
    """Return views of some of the blocks."""
    return result.mapped(lambda array: array[part])


class _Run:
    """The tiles of one chunk of blocks, and the block in each lane."""

    def __init__(
        self, llr: Floats32, positions: Indices, order: Indices, options: DecoderOptions, a_priori: Floats32 | None
    ) -> None:
        # imported at the first decoding: Numba takes half a second
        from heliograph.signal.turbo import kernel, short, single, tiles

        self.in_short, few = options.metrics == "int16", len(llr) <= _FEW_BLOCKS
        self.kernel, self.tiles = (short if self.in_short else single if few else kernel), tiles
        self.width = short.LANES if self.in_short else 1 if few else tiles.LANES
        # copies, since Numba would compile a second kernel for the read-only originals
        self.order, self.positions, self.options = order.copy(), positions.copy(), options
        self.scale: Any = short.factor_of(options.factor) if self.in_short else np.float32(options.factor)
        self.exact = None if options.algorithm == "max-log" else True
        blocks, k = len(llr), len(order)
        self.blocks = np.arange(blocks)
        self.alive = np.ones(blocks, dtype=np.bool_)
        self.mother = self.tiles.zeros(blocks, 3 * k + TERMINATION, self.width)
        self.tiles.pack(llr, self.positions, self.mother)
        if a_priori is not None:
            self.tiles.pack(a_priori, 3 * np.arange(k), self.mother)
        if self.in_short:  # punctured bits are 0 in it too, and repeated ones were added up
            self.mother = short.quantised(self.mother)
        self.passed = self.tiles.zeros(blocks, k, self.width, self.mother.dtype)
        self.work = self.kernel.working_memory(k)
        self._make_outputs()

    def _make_outputs(self) -> None:
        self.app_2 = np.empty_like(self.passed)
        # only the agreement rule reads the first half iteration
        self.app_1 = np.empty_like(self.passed) if self.options.stop == "agreement" else self.app_2

    def decode(self, result: TurboResult, check: Check | None) -> None:
        """Iterate until every block is done, and fill `result`."""
        most, never = self.options.iterations, self.options.stop == "none"
        step = most if never else 1
        for iteration in range(step, most + 1, step):
            self._iterate(step)
            met = np.zeros_like(self.alive) if never else self._rule_met(check)
            done = self.alive & (met | (iteration == most))
            if done.any():
                self._collect(np.flatnonzero(done), met, iteration, result)
                self._drop(done)
            if not self.alive.any():
                return

    def _iterate(self, count: int) -> None:
        self.kernel.iterate(
            self.mother, self.passed, self.work, self.app_1, self.app_2, self.order, count, self.scale, self.exact
        )

    def _rule_met(self, check: Check | None) -> NDArray[np.bool_]:
        met = np.zeros_like(self.alive)
        lanes = np.flatnonzero(self.alive)
        if check is not None:
            met[lanes] = _checked(check, self._decisions(lanes))
            return met
        lane_agrees = np.empty((len(self.app_1), self.width), dtype=np.bool_)
        self.tiles.agree(self.app_1, self.app_2, lane_agrees)
        met[lanes] = lane_agrees.ravel()[lanes]
        return met

    def _decisions(self, lanes: Indices) -> NDArray[np.uint8]:
        out = np.empty((len(lanes), len(self.order)), dtype=np.float32)
        self.tiles.unpack(self.app_2, lanes, np.arange(len(self.order)), out)
        return (out < 0).astype(np.uint8)

    def _collect(self, lanes: Indices, met: NDArray[np.bool_], iteration: int, result: TurboResult) -> None:
        blocks = self.blocks[lanes]
        result.iterations[blocks] = iteration
        result.stopped[blocks] = met[lanes]
        self.tiles.collect(self.app_2, self.mother, lanes, blocks, result.llr, result.extrinsic, result.bits)
        if self.in_short:
            result.llr[blocks] /= PER_LLR
            result.extrinsic[blocks] /= PER_LLR
        if result.coded_llr is not None:
            result.coded_llr[blocks] = self._coded(lanes)

    def _coded(self, lanes: Indices) -> Floats32:
        posterior = np.empty_like(self.mother)
        self.kernel.mother_posterior(
            self.mother, self.passed.copy(), self.app_2, self.order, self.scale, posterior, self.exact
        )
        out = np.empty((len(lanes), len(self.positions)), dtype=np.float32)
        self.tiles.unpack(posterior, lanes, self.positions, out)
        return out

    def _drop(self, done: NDArray[np.bool_]) -> None:
        """Forget finished blocks; once this saves a whole tile, move the others together."""
        self.alive &= ~done
        lanes = np.flatnonzero(self.alive)
        if len(lanes) == 0 or -(-len(lanes) // self.width) == len(self.mother):
            return
        self.mother, self.passed = self._moved(self.mother, lanes), self._moved(self.passed, lanes)
        self.blocks, self.alive = self.blocks[lanes], np.ones(len(lanes), dtype=np.bool_)
        self._make_outputs()

    def _moved(self, source: NDArray[Any], lanes: Indices) -> NDArray[Any]:
        target: NDArray[Any] = self.tiles.zeros(len(lanes), source.shape[1], self.width, source.dtype)
        self.tiles.move(source, lanes, target)
        return target


def _checked(check: Check, decisions: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the caller's verdicts after a check that there is one bool a block."""
    verdict = np.asarray(check(decisions))
    if verdict.shape != (len(decisions),) or verdict.dtype != np.bool_:
        raise ValueError(
            f"check must return {len(decisions)} bools, one a block, not {verdict.dtype} of shape {verdict.shape}"
        )
    return verdict
