"""Moving blocks in and out of the kernel's tiles: float32 of shape (tiles, rows, 16), one block a lane.

Numba, as `kernel`; imported with it at the first decoding.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from heliograph.signal.turbo.options import LLR_LIMIT

LANES = 16
_LIMIT = np.float32(LLR_LIMIT)
# values of one block taken in a run, since those share a cache line
_RUN = 16

_compile = njit(cache=True, nogil=True, error_model="numpy")


def zeros(blocks: int, rows: int) -> NDArray[np.float32]:
    """Zeroed tiles for so many blocks."""
    return np.zeros((-(-blocks // LANES), rows, LANES), dtype=np.float32)


@_compile
def agree(app_1: Any, app_2: Any, out: Any) -> None:
    """Whether both half iterations decide alike: bool (tiles, 16)."""
    differ = np.empty(LANES, dtype=np.int32)
    for t in range(app_1.shape[0]):
        differ[:] = 0
        for k in range(app_1.shape[1]):
            x, y = app_1[t, k], app_2[t, k]
            for i in range(LANES):
                differ[i] |= (x[i] < 0) != (y[i] < 0)
        for i in range(LANES):
            out[t, i] = differ[i] == 0


@_compile
def pack(llr: Any, positions: Any, mother: Any) -> None:
    """Clip received LLRs (B, E) and add them into zeroed tiles at their positions in the mother codeword.

    Punctured bits keep 0, repeated ones add up.
    """
    for t in range(mother.shape[0]):
        blocks = llr[t * LANES : (t + 1) * LANES]
        for e in range(positions.size):
            row = mother[t, positions[e]]
            for lane in range(blocks.shape[0]):
                value = blocks[lane, e]
                value = value if value < _LIMIT else _LIMIT
                row[lane] += value if value > -_LIMIT else -_LIMIT


@_compile
def unpack(tiles: Any, lanes: Any, positions: Any, out: Any) -> None:
    """Rows `positions` of the given lanes (tile * 16 + lane) into `out`, float32 (lanes, positions)."""
    for n in range(lanes.size):
        t, lane = lanes[n] // LANES, lanes[n] % LANES
        for e in range(positions.size):
            out[n, e] = tiles[t, positions[e], lane]


@_compile
def collect(app: Any, mother: Any, lanes: Any, blocks: Any, llr: Any, extrinsic: Any, bits: Any) -> None:
    """Results of the given lanes into rows `blocks` of the outputs."""
    for start in range(0, app.shape[1], _RUN):
        end = min(start + _RUN, app.shape[1])
        for n in range(lanes.size):
            t, lane, b = lanes[n] // LANES, lanes[n] % LANES, blocks[n]
            for k in range(start, end):
                value = app[t, k, lane]
                llr[b, k] = value
                extrinsic[b, k] = value - mother[t, 3 * k, lane]
                bits[b, k] = value < 0


@_compile
def move(source: Any, lanes: Any, target: Any) -> None:
    """Bring the given lanes together at the front of fresh tiles."""
    for n in range(lanes.size):
        t, lane = lanes[n] // LANES, lanes[n] % LANES
        to, to_lane = n // LANES, n % LANES
        for row in range(source.shape[1]):
            target[to, row, to_lane] = source[t, row, lane]
