"""Header bank, frame window, and the header's amplitude in a frame pair."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, Floats, draw, pitch_at

from heliograph.base.frames import Frame
from heliograph.receive.detect.detection import headers
from heliograph.receive.detect.frame_window import copies_before, crop_to_common, fill_missing
from heliograph.receive.detect.header_format import header_score, header_weights
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation, Pose
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.sync.combine import combine_header
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal.formats import words
from heliograph.signal.header import header_cells, header_levels

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


SIGNS = header_levels(7) / 2.0 - 1.0
FORM = 0o765
DIMMED = np.kron(words()[FORM].reshape(4, 4), np.ones((4, 4))) > 0


def test_dimmed_cells_have_half_of_their_contrast() -> None:
    assert np.array_equal(header_weights(7, 0, SIDE, None), SIGNS)
    assert np.array_equal(header_weights(7, FORM, SIDE, None), np.where(DIMMED, 0.5 * SIGNS, SIGNS))


def test_combined_frames_show_dimmed_cells_by_contrast_and_light() -> None:
    shown = np.array([0.4, -0.4, 0.7, 0.1])
    combination = combine_header(np.arange(4.0), 1.0, shown, (0.6 * shown, np.array([0.5, 0.5, 0.7, 0.5])))
    assert combination is not None
    contrast, light = combination.dimmed
    assert contrast == pytest.approx(0.6)
    assert light > 0.1
    # light adds to lit cells and reduces dark cells
    weights = np.where(DIMMED, 0.6 * SIGNS + light, SIGNS)
    assert header_weights(7, FORM, SIDE, combination) == pytest.approx(weights)


@pytest.mark.parametrize("part", [1.0, 0.5, 0.0, -1.0])
def test_the_score_is_the_amplitude_over_the_arrays_light(part: float) -> None:
    pose = Pose(30.2, 29.7, pitch_at(60.0), 0.01, 0.55)

    def light(levels: Floats) -> NDArray[np.float32]:
        return (20 + 100 * draw(pose, levels, (0, 0), (60, 60))).astype(np.float32)

    up, down = (
        CombinedFrame(k, k * 1e-3, light(1 + sign * part * SIGNS), (0, 0), 255) for k, sign in enumerate((1, -1))
    )
    assert header_score(FramePair(up, down), pose, SIGNS, 200.0) == pytest.approx(part, abs=0.01)


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
