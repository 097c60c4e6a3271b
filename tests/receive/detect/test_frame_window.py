"""Frame window: substitutes for missing frames."""

from collections.abc import Sequence

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.receive.detect.frame_window import copies_before, crop_to_common, fill_missing


@pytest.mark.parametrize(
    ("header", "want"),
    [
        ([1, 2, 3, 4], [1, 2, 3, 4]),
        # an equal frame, two slots apart
        ([1, 2, None, 4], [1, 2, 1, 4]),
        ([None, 2, 3, 4], [3, 2, 3, 4]),
        ([1, None, 3, 4], [1, 4, 3, 4]),
        # the nearest frame, preferring the earlier
        ([1, 2, 3, 4, 5, 6, 7, None], [1, 2, 3, 4, 5, 6, 7, 6]),
        ([1, 2, 3, 4, None, 6, 7, 8], [1, 2, 3, 4, 3, 6, 7, 8]),
        ([1, 2, None, 4, None, 6, 7, 8], [1, 2, 1, 4, 7, 6, 7, 8]),
        # amplitude 0 is not missing
        ([0, 0, None, 4], [0, 0, 0, 4]),
    ],
)
def test_a_missing_frame_is_filled_in(header: list[int | None], want: list[int]) -> None:
    kept = list(header)
    assert fill_missing(header) == want
    assert header == kept


@pytest.mark.parametrize(
    "header", [[None, 2], [None, None, 3, 4], [1, None, None, 4], [1, None, None, 4, 5, None, 7, 8]]
)
def test_with_too_many_missing_there_is_no_header(header: list[int | None]) -> None:
    assert fill_missing(header) is None


def frame(index: int, x: int, y: int, rows: int, columns: int) -> Frame:
    """Return a frame encoding sensor coordinates in its pixels."""
    pixels = 16 * (y + np.arange(rows))[:, None] + x + np.arange(columns)
    return Frame(index, index * 1e-3, pixels.astype(np.uint8), 8, (x, y))


def test_frames_are_cropped_to_the_common_part_and_gaps_stay() -> None:
    slots: Sequence[Frame | None] = [None, frame(1, 0, 2, 6, 8), None, frame(3, 3, 0, 5, 9)]
    cut = crop_to_common(slots)
    assert [one and one.index for one in cut] == [None, 1, None, 3]
    for one in cut:
        if one is not None:
            assert np.array_equal(one.pixels, frame(0, 3, 2, 3, 5).pixels)
            assert one.origin == (3, 2)


def test_copies_before_a_film_have_earlier_numbers_and_times() -> None:
    first = frame(5, 0, 0, 4, 4)
    copies = copies_before(first, 3)
    assert [one.index for one in copies] == [2, 3, 4]
    assert all(one.pixels is first.pixels for one in copies)
    times = [one.time_s for one in [*copies, first]]
    # years apart
    assert np.diff(times).min() > 3e7
    assert copies_before(first, 0) == []
