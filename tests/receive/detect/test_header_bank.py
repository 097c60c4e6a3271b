"""Header bank: unique hypotheses, most plausible first."""

import numpy as np
import pytest

from heliograph.receive.detect.header_bank import ALL_ON, headers
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation
from heliograph.signal.header import header_cells

NUMBERS = range(30)


@pytest.mark.parametrize(("orientations", "other"), [((UPRIGHT,), ORIENTATIONS[1:]), (ORIENTATIONS[1:], ())])
def test_a_header_means_what_looks_like_it(
    orientations: tuple[Orientation, ...], other: tuple[Orientation, ...]
) -> None:
    looked_for = headers(orientations, other)
    assert len({cells.tobytes() for cells in looked_for.cells}) == len(looked_for.cells) == len(looked_for.hypotheses)
    every = [(number, orientation) for orientation in (*orientations, *other) for number in NUMBERS]
    looks = np.array([orientation.turned(header_cells(number)).ravel() for number, orientation in every])
    for cells, meant in zip(looked_for.cells, looked_for.hypotheses, strict=True):
        # the hypotheses are exactly the identities and orientations with equal cells
        assert set(meant) == {every[k] for k in np.flatnonzero((looks == cells).all(1))}


def test_upright_headers_are_looked_for_alone_and_stand_first() -> None:
    upright = headers((UPRIGHT,), ORIENTATIONS[1:])
    assert [meant[0] for meant in upright.hypotheses] == [(number, UPRIGHT) for number in NUMBERS]
    # some match rotated headers from other identities, sorted by orientation
    others = [meant for meant in upright.hypotheses if len(meant) > 1]
    assert others
    places = [[ORIENTATIONS.index(orientation) for _, orientation in meant] for meant in others]
    assert places == [sorted(place) for place in places]


def test_known_orientations_alone_leave_each_header_one_meaning() -> None:
    for orientation in ORIENTATIONS:
        assert [*headers((orientation,)).hypotheses] == [((number, orientation),) for number in NUMBERS]


def test_all_orientations_are_looked_for_each_identity_once_a_way() -> None:
    turned = headers(ORIENTATIONS[1:])
    meant = [one for each in turned.hypotheses for one in each]
    assert len(meant) == len(set(meant)) == 7 * 30
    # a shifted rotated header resembles others, so the minimum distance decreases
    assert (
        turned.min_distance
        < headers((UPRIGHT,), ORIENTATIONS[1:]).min_distance
        == headers((ORIENTATIONS[3],)).min_distance
    )


def test_a_blinking_square_is_lit_all_over_and_upright() -> None:
    assert ALL_ON.cells.tolist() == [[1.0] * 16]
    assert ALL_ON.hypotheses == (((0, UPRIGHT),),)
