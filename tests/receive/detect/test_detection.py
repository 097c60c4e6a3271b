"""Header bank, frame window, and the header's amplitude in a frame pair."""

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.receive.detect.detection import headers
from heliograph.receive.detect.frame_window import FrameWindowBuffer, crop_to_common, fill_missing
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation
from heliograph.signal.header import header_cells

IDENTITIES = range(30)


@pytest.mark.parametrize(
    ("orientations", "other"),
    [((UPRIGHT,), ORIENTATIONS[1:]), (ORIENTATIONS[1:], ()), *(((one,), ()) for one in ORIENTATIONS)],
)
def test_hypotheses_of_a_header_are_all_arrays_with_equal_cells(
    orientations: tuple[Orientation, ...], other: tuple[Orientation, ...]
) -> None:
    bank = headers(orientations, other)
    assert len({cells.tobytes() for cells in bank.cells}) == len(bank.cells) == len(bank.hypotheses)
    every = [(number, orientation) for orientation in (*orientations, *other) for number in IDENTITIES]
    looks = np.array([orientation.turned(header_cells(number)).ravel() for number, orientation in every])
    for cells, meant in zip(bank.cells, bank.hypotheses, strict=True):
        assert set(meant) == {every[k] for k in np.flatnonzero((looks == cells).all(1))}
    meant_by_all = [one for each in bank.hypotheses for one in each]
    assert len(meant_by_all) == len(set(meant_by_all))
    assert other or set(meant_by_all) == set(every)


def test_upright_headers_come_first() -> None:
    upright = headers((UPRIGHT,), ORIENTATIONS[1:])
    assert [meant[0] for meant in upright.hypotheses] == [(number, UPRIGHT) for number in IDENTITIES]
    # some match rotated headers from other identities, sorted by orientation
    others = [meant for meant in upright.hypotheses if len(meant) > 1]
    assert others
    places = [[ORIENTATIONS.index(orientation) for _, orientation in meant] for meant in others]
    assert places == [sorted(place) for place in places]


def test_turned_headers_have_a_smaller_minimum_distance() -> None:
    """A shifted rotated header resembles others."""
    upright, known = headers((UPRIGHT,), ORIENTATIONS[1:]), headers((ORIENTATIONS[3],))
    assert headers(ORIENTATIONS[1:]).min_distance < upright.min_distance == known.min_distance


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


def test_copies_stand_for_the_frames_before_a_film() -> None:
    buffer, header = FrameWindowBuffer(16, 100), range(16)
    windows = [window for k in (*header, *range(16, 22)) for window, _ in buffer.push(frame(5 + k, 0, 0, 4, 4))]
    # every second start is searched, the first with copies of the film's first frame
    starts = [[one and (one.index, one.time_s) for one in window[:3]] for window in windows]
    assert starts[0] == [(3, 0.005), (4, 0.005), (5, 0.005)]
    assert starts[1:] == [[(k, 1e-3 * k) for k in (first, first + 1, first + 2)] for first in (5, 7)]
