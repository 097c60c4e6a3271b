"""Frame window: substitutes for missing frames."""

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.receive.detect.frame_window import copies_before, crop_to_common, fill_missing


@pytest.mark.parametrize(("header", "want"), [
    ([1, 2, 3, 4], [1, 2, 3, 4]),
    # an equal frame, two slots apart
    ([1, 2, None, 4], [1, 2, 1, 4]),
    ([None, 2, 3, 4], [3, 2, 3, 4]), ([1, None, 3, 4], [1, 4, 3, 4]),
    # the nearest frame, preferring the earlier
    ([1, 2, 3, 4, 5, 6, 7, None], [1, 2, 3, 4, 5, 6, 7, 6]),
    ([1, 2, 3, 4, None, 6, 7, 8], [1, 2, 3, 4, 3, 6, 7, 8]),
    ([1, 2, None, 4, None, 6, 7, 8], [1, 2, 1, 4, 7, 6, 7, 8]),
    # amplitude 0 is not missing
    ([0, 0, None, 4], [0, 0, 0, 4]),
    # too many are missing
    *((header, None) for header in ([None, 2], [None, None, 3, 4], [1, None, None, 4])),
    ([1, None, None, 4, 5, None, 7, 8], None),
])  # fmt: skip
def test_a_missing_frame_is_filled_in(header: list[int | None], want: list[int] | None) -> None:
    kept = list(header)
    assert (fill_missing(header), header) == (want, kept)


def frame(index: int, x: int, y: int, rows: int, columns: int) -> Frame:
    """Return a frame encoding sensor coordinates in its pixels."""
    pixels = 16 * (y + np.arange(rows))[:, None] + x + np.arange(columns)
    return Frame(index, index * 1e-3, pixels.astype(np.uint8), 8, (x, y))


def test_frames_are_cropped_to_the_common_part_and_gaps_stay() -> None:
    cut = crop_to_common([None, frame(1, 0, 2, 6, 8), None, frame(3, 3, 0, 5, 9)])
    assert [one and (one.index, one.origin) for one in cut] == [None, (1, (3, 2)), None, (3, (3, 2))]
    assert all(one is None or np.array_equal(one.pixels, frame(0, 3, 2, 3, 5).pixels) for one in cut)


def test_copies_before_a_film_have_earlier_numbers_and_times() -> None:
    first = frame(5, 0, 0, 4, 4)
    copies = copies_before(first, 3)
    assert [(one.index, one.pixels is first.pixels) for one in copies] == [(2, True), (3, True), (4, True)]
    # years apart
    assert np.diff([one.time_s for one in [*copies, first]]).min() > 3e7
    assert copies_before(first, 0) == []
