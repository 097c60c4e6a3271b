"""Header pairs: weights, amplitude, and the signalled format."""

from collections.abc import Sequence

import numpy as np
import pytest
from drawn_packets import drawn_pair
from numpy.typing import NDArray
from scenes import ALL_ON, SIDE, Floats, draw, frame_of, pitch_at

from heliograph.receive.decode.header_format import FormatReader, header_score, header_weights
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.sync.combine import combine_header
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal.formats import AGREED, ALL_MODES, SHORT_PAIRS, words
from heliograph.signal.header import header_levels, signalling_levels

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


GAIN = 0.8 * 255


def reader_of(
    number: int, pairs: Sequence[int], distance_m: float, led_gains: Floats = ALL_ON, known: Floats = ALL_ON
) -> FormatReader:
    """Show header pairs for identity 7 to a reader; the array moves by a third of a pixel per frame."""
    rng, reader = np.random.default_rng(number), FormatReader(7, SIDE, SHORT_PAIRS)
    for pair in pairs:
        levels = signalling_levels(7, number) if pair else header_levels(7)
        x, y = 40 + rng.uniform(-0.5, 0.5, 2)
        first = Pose(x, y, pitch_at(distance_m), 0.01, 0.52)
        poses, lit = (first, first.moved(0.3, -0.2)), (led_gains * levels / 4, led_gains * (4 - levels) / 4)
        reader.add_pair(pair, drawn_pair(poses, lit, rng, GAIN, (80, 80)), poses, known)
    return reader


@pytest.mark.parametrize("distance_m", [40.0, 120.0, 200.0])
def test_formats_are_read(distance_m: float) -> None:
    # at long range, unknown modes could appear from noise
    last = len(words(ALL_MODES) if distance_m < 200 else words()) - 1
    for number in (*range(1, last, 47), last):
        assert reader_of(number, (0, 1), distance_m).decide_format(GAIN) == number


def test_the_gain_decides_without_the_first_pair() -> None:
    reader = reader_of(0o765, (1,), 120.0)
    # with all or no cells dimmed, the gain decides
    assert reader.decide_format(GAIN) == 0o765 != reader.decide_format(0.5 * GAIN)


@pytest.mark.parametrize("pairs", [(), (0,)])
def test_without_a_later_pair_the_agreed_format_is_assumed(pairs: Sequence[int]) -> None:
    assert reader_of(0o765, pairs, 80.0).decide_format(GAIN) == AGREED.number


@pytest.mark.parametrize(
    ("hidden", "are_known", "distance_m"),
    [((slice(0, 4), slice(0, 12)), True, 60.0)]
    + [((slice(0, 16), slice(0, columns)), False, d) for columns in (3, 5, 6, 7) for d in (40.0, 80.0)],
)
def test_hidden_cells_are_not_read_as_dimmed(hidden: tuple[slice, slice], are_known: bool, distance_m: float) -> None:
    """Words differ in four cells at least; occlusion may hide LED columns before LED gains are known."""
    gains = ALL_ON.copy()
    gains[hidden] = 0.0
    # beyond a cell's width no other format is reliable
    for number in (0, 0o765, 0o123) if are_known or hidden[1].stop < 4 else (0,):
        reader = reader_of(number, (0, 1), distance_m, gains, gains if are_known else ALL_ON)
        assert reader.decide_format(GAIN) == number


@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("first", range(32, 48, 4))
def test_foreground_light_signals_no_format(first: int, width: int) -> None:
    """A bright bar moves in front of the array at 2 px per frame."""
    reader, rng = FormatReader(7, SIDE, SHORT_PAIRS), np.random.default_rng(3)
    pose = Pose(40.2, 39.8, pitch_at(80.0), 0.01, 0.52)
    for pair in (0, 1):
        frames = []
        for k, levels in enumerate((header_levels(7), 4 - header_levels(7))):
            light, left = 0.1 + 0.5 * draw(pose, levels / 4, (0, 0), (80, 80)), first + 2 * (2 * pair + k)
            light[:, left : left + width] += 0.4
            frames.append(frame_of(light, k, rng))
        reader.add_pair(pair, FramePair(frames[0], frames[1]), (pose, pose), ALL_ON)
    assert reader.decide_format(0.5 * 255) == AGREED.number
