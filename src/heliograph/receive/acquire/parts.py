"""The parts of frames that are searched: what surrounds the blocks in which something alternates."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.acquire.coarse import BLOCK_PX, RING

PART_BLOCKS = 3000
"""Blocks of 8 x 8 pixels that it takes as long to combine and to sum up as a part takes beside its pixels: 250 us."""


class SearchedPart(NamedTuple):
    """A part of frames that is searched."""

    # (rows, columns) gray levels of what alternates
    change: NDArray[np.float32]
    # (blocks down, blocks across), whether an array may have its centre there
    busy: NDArray[np.bool_]
    # The first of the frames, for place and full scale
    first: Frame


def searched_parts(
    frames: Sequence[Frame],
    busy: NDArray[np.bool_],
    largest_px: float,
    change_of: Callable[[Sequence[Frame]], NDArray[np.float32]],
) -> list[SearchedPart]:
    """The parts of frames that candidates in busy blocks are seen in, from a block's first pixel on.

    Blocks that are far from each other have parts of their own, where these are smaller together than one for all.
    """
    # an array and its ring about a centre in a busy block, and two blocks for where its fit moves it and tilts it
    reach = int(np.ceil((0.5 + RING) * largest_px / BLOCK_PX)) + 2
    groups, spans = [busy], [_spans_of(busy, reach)]
    if _blocks(*spans[0]) > PART_BLOCKS and len(apart := _apart(busy, 2 * reach)) > 1:
        spans_apart = [_spans_of(group, reach) for group in apart]
        if sum(PART_BLOCKS + _blocks(*one) for one in spans_apart) < PART_BLOCKS + _blocks(*spans[0]):
            groups, spans = apart, spans_apart
    parts = []
    for group, (down, across) in zip(groups, spans, strict=True):
        rows, columns = (slice(span.start * BLOCK_PX, span.stop * BLOCK_PX) for span in (down, across))
        place = frames[0].origin[0] + columns.start, frames[0].origin[1] + rows.start
        cut = [replace(frame, pixels=frame.pixels[rows, columns], origin=place) for frame in frames]
        parts.append(SearchedPart(change_of(cut), group[down, across], cut[0]))
    return parts


def _apart(busy: NDArray[np.bool_], gap: int) -> list[NDArray[np.bool_]]:
    """Busy blocks by groups that have at least so many calm columns between them, or rows."""
    groups = []
    for columns in _runs(np.any(busy, axis=0), gap):
        for rows in _runs(np.any(busy[:, columns], axis=1), gap):
            groups.append(np.zeros_like(busy))
            groups[-1][rows, columns] = busy[rows, columns]
    return groups


def _runs(busy: NDArray[np.bool_], gap: int) -> list[slice]:
    """Places from the first to the last that is busy, cut where at least so many in a row are calm."""
    places = np.flatnonzero(busy)
    cuts = np.flatnonzero(places[1:] - places[:-1] > gap)
    firsts, lasts = [0, *(cuts + 1).tolist()], [*cuts.tolist(), -1]
    return [slice(int(places[k]), int(places[j]) + 1) for k, j in zip(firsts, lasts, strict=True)]


def _spans_of(busy: NDArray[np.bool_], reach: int) -> tuple[slice, slice]:
    """Rows and columns of the blocks that are busy, and so many around."""
    down, across = (slice(*_span(np.any(busy, axis=axis), reach)) for axis in (1, 0))
    return down, across


def _blocks(down: slice, across: slice) -> int:
    """How many blocks rows and columns hold."""
    return int((down.stop - down.start) * (across.stop - across.start))


def _span(busy: NDArray[np.bool_], reach: int) -> tuple[int, int]:
    """First and end of the busy places, and of those around."""
    places = np.flatnonzero(busy)
    return max(int(places[0]) - reach, 0), min(int(places[-1]) + 1 + reach, busy.size)
