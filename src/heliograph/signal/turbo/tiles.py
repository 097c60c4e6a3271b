"""Move blocks into and out of the kernels' tiles: arrays of shape (tiles, rows, L), one block a lane.

L is 16 for `kernel`, 1 for `single` and 32 for `short`, whose tiles are int16; the others are float32. Written for
Numba like these, and imported with them at the first decoding. ``B`` is the number of blocks, ``lanes`` a number
tile * L + lane for each block in question.
"""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from heliograph.base.compiled import compiled
from heliograph.signal.turbo.options import LLR_LIMIT

LANES = 16
"""Blocks side by side in a tile: the float32 of a 512-bit register. Of K = 1024 with AVX-512 it decodes 13.7 Mbit/s; 8
lanes 3.4 Mbit/s, 32 lanes 12.7 Mbit/s."""

_LIMIT = np.float32(LLR_LIMIT)
_RUN = 16
"""Values of one block written in a run: 16 float32 fill a cache line of 64 bytes. With 8 and with 32 the speed of
decoding was the same within its noise."""

_compile = compiled(error_model="numpy")


def zeros(blocks: int, rows: int, width: int, dtype: DTypeLike = np.float32) -> NDArray[Any]:
    """Return zeroed tiles.

    Parameters
    ----------
    blocks
        Number of blocks, B.
    rows
        Values of each block: K for information bits, 3 K + 12 for a mother codeword.
    width
        Lanes of a tile, L.
    dtype
        Type of the values, float32 or int16.

    Returns
    -------
    (ceil(B / L), rows, L) array.
    """
    return np.zeros((-(-blocks // width), rows, width), dtype)


@_compile
def agree(app_1: Any, app_2: Any, out: Any) -> None:
    """Find the blocks of which both half iterations decide all bits alike.

    Parameters
    ----------
    app_1, app_2
        (tiles, K, L) float32 a-posteriori LLRs after each half iteration, in the same order.
    out
        (tiles, L) bool, written: True for the lanes of these blocks.
    """
    width = app_1.shape[2]
    differ = np.empty(width, dtype=np.int32)
    for t in range(app_1.shape[0]):
        differ[:] = 0
        for k in range(app_1.shape[1]):
            x, y = app_1[t, k], app_2[t, k]
            for i in range(width):
                differ[i] |= (x[i] < 0) != (y[i] < 0)
        for i in range(width):
            out[t, i] = differ[i] == 0


@_compile
def pack(llr: Any, positions: Any, mother: Any) -> None:
    """Clip received LLRs and add them to tiles at their positions in the mother codeword.

    In zeroed tiles punctured bits keep 0; repeated ones add up.

    Parameters
    ----------
    llr
        (B, E) float32 received LLRs, clipped to +-`LLR_LIMIT` as they are added.
    positions
        (E,) int64 position of each LLR in the mother codeword: the row of its tile.
    mother
        (tiles, rows, L) float32 LLRs of mother codewords, changed.
    """
    width = mother.shape[2]
    for t in range(mother.shape[0]):
        blocks = llr[t * width : (t + 1) * width]
        for e in range(positions.size):
            row = mother[t, positions[e]]
            for lane in range(blocks.shape[0]):
                value = blocks[lane, e]
                value = value if value < _LIMIT else _LIMIT
                row[lane] += value if value > -_LIMIT else -_LIMIT


@_compile
def unpack(tiles: Any, lanes: Any, positions: Any, out: Any) -> None:
    """Read chosen rows of chosen lanes.

    Parameters
    ----------
    tiles
        (tiles, rows, L) float32 values of blocks, such as LLRs.
    lanes
        (n,) int64 lanes to read.
    positions
        (E,) int64 rows to read.
    out
        (n, E) float32, written: the values of each lane.
    """
    width = tiles.shape[2]
    for n in range(lanes.size):
        t, lane = lanes[n] // width, lanes[n] % width
        for e in range(positions.size):
            out[n, e] = tiles[t, positions[e], lane]


@_compile
def collect(app: Any, mother: Any, lanes: Any, blocks: Any, llr: Any, extrinsic: Any, bits: Any) -> None:
    """Write the results of chosen lanes to the rows of their blocks.

    Parameters
    ----------
    app
        (tiles, K, L) float32 a-posteriori LLRs of the information bits.
    mother
        (tiles, 3 K + 12, L) float32 input LLRs.
    lanes
        (n,) int64 lanes to read.
    blocks
        (n,) int64 block in each of these lanes.
    llr
        (B, K) float32, written: a-posteriori LLRs.
    extrinsic
        (B, K) float32, written: the same less the input LLRs.
    bits
        (B, K) uint8, written: decisions, 1 where the LLR is below 0.
    """
    width = app.shape[2]
    for start in range(0, app.shape[1], _RUN):
        end = min(start + _RUN, app.shape[1])
        for n in range(lanes.size):
            t, lane, b = lanes[n] // width, lanes[n] % width, blocks[n]
            for k in range(start, end):
                value = app[t, k, lane]
                llr[b, k] = value
                extrinsic[b, k] = value - mother[t, 3 * k, lane]
                bits[b, k] = value < 0


@_compile
def move(source: Any, lanes: Any, target: Any) -> None:
    """Copy chosen lanes to the front of other tiles.

    Parameters
    ----------
    source
        (tiles, rows, L) float32 values to copy from.
    lanes
        (n,) int64 lanes to copy.
    target
        (ceil(n / L), rows, L) float32, written.
    """
    width = source.shape[2]
    for n in range(lanes.size):
        t, lane = lanes[n] // width, lanes[n] % width
        to, to_lane = n // width, n % width
        for row in range(source.shape[1]):
            target[to, row, to_lane] = source[t, row, lane]
