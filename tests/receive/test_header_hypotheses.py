"""Competing hypotheses for the header of an array: the first valid codeword selects one."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation
from heliograph.receive.receiver import HeaderHypotheses

FRAME = Frame(0, 0.0, np.zeros((4, 4), np.uint8))


@dataclass
class Scripted:
    """Scripted receiver: returns a named packet every few frames and at the end."""

    name: str
    orientation: Orientation
    has_codeword: bool = False
    done: bool = False
    proves_at: int = 99
    every: int = 1
    frames: list[Frame] = field(default_factory=list)

    def push(self, frame: Frame) -> Iterator[Any]:
        self.frames.append(frame)
        self.has_codeword |= len(self.frames) >= self.proves_at
        if len(self.frames) % self.every == 0:
            yield f"{self.name}{len(self.frames)}"

    def flush(self) -> Iterator[Any]:
        yield f"{self.name} at the end"


def array_of(*receivers: Scripted, settled: bool = False) -> HeaderHypotheses:
    return HeaderHypotheses([cast(ArrayReceiver, receiver) for receiver in receivers], settled)


def pushed(array: HeaderHypotheses, count: int = 1) -> list[Any]:
    return [packet for k in range(count) for packet in array.push(replace(FRAME, index=k))]


CASES: dict[str, tuple[list[Scripted], int, list[str], list[int]]] = {
    "others follow after the first packet of the first": (
        [Scripted("a", UPRIGHT, every=3), Scripted("b", ORIENTATIONS[2], every=3, proves_at=6)],
        *(7, ["a3", "b6"], [6, 7]),
    ),
    "others get no frame if the first packet is right": (
        [Scripted("a", UPRIGHT, every=3, proves_at=3), Scripted("b", ORIENTATIONS[2])],
        *(6, ["a3", "a6"], [6, 0]),
    ),
    "the first gives the packets until a codeword is right": (
        [Scripted("a", UPRIGHT), Scripted("b", ORIENTATIONS[2])],
        *(2, ["a1", "a2"], [2, 2]),
    ),
    "a right codeword selects and stops less plausible ones": (
        [Scripted("a", UPRIGHT), Scripted("b", ORIENTATIONS[1], proves_at=2), Scripted("c", ORIENTATIONS[2])],
        *(3, ["a1", "b2", "b3"], [2, 3, 1]),
    ),
    "the more plausible of two right ones is selected": (
        [Scripted("a", ORIENTATIONS[1], proves_at=1), Scripted("b", ORIENTATIONS[2], proves_at=1)],
        *(1, ["a1"], [1, 0]),
    ),
    "ended ones get no frame": (
        [Scripted("a", UPRIGHT), Scripted("b", ORIENTATIONS[1], done=True), Scripted("c", ORIENTATIONS[2])],
        *(2, ["a1", "a2"], [2, 1, 2]),
    ),
}
"""Receivers, number of frames, packets, and number of frames that each receiver gets."""


@pytest.mark.parametrize("case", CASES)
def test_first_right_codeword_selects_a_hypothesis(case: str) -> None:
    receivers, count, expected, frames = CASES[case]
    assert pushed(array_of(*receivers), count) == expected
    # each frame once and in order
    assert [[frame.index for frame in receiver.frames] for receiver in receivers] == [list(range(n)) for n in frames]


def test_others_read_the_missed_frames_at_the_end_of_the_film() -> None:
    a, b = Scripted("a", UPRIGHT, every=9), Scripted("b", ORIENTATIONS[2], every=9, proves_at=2)
    array = array_of(a, b)
    assert [*pushed(array, 2), *cast(Any, array.flush())] == ["b at the end"]
    assert (len(a.frames), len(b.frames)) == (2, 2)


def test_settled_hypothesis_reads_the_missed_frames() -> None:
    a, b = Scripted("a", UPRIGHT, every=9), Scripted("b", ORIENTATIONS[2], every=4)
    array = array_of(a, b)
    pushed(array, 3)
    assert array.settle(ORIENTATIONS[2])
    assert pushed(array, 2) == ["b4"]
    assert (len(a.frames), len(b.frames)) == (3, 5)


@pytest.mark.parametrize(("orientation", "settled", "proven", "credible"), [
    (UPRIGHT, False, False, True), (ORIENTATIONS[3], False, False, False),
    (ORIENTATIONS[3], True, False, True), (ORIENTATIONS[3], False, True, True),
])  # fmt: skip
def test_turned_arrays_need_a_codeword(orientation: Orientation, settled: bool, proven: bool, credible: bool) -> None:
    array = array_of(Scripted("a", orientation, has_codeword=proven), settled=settled)
    assert array.is_credible == credible
    # implausible packets are dropped silently
    assert pushed(array) == (["a1"] if credible else [])


def test_settling_drops_other_orientations() -> None:
    receivers = [Scripted(name, way) for name, way in zip("abcd", (*ORIENTATIONS[:3], ORIENTATIONS[1]), strict=True)]
    array = array_of(*receivers)
    assert array.settle(ORIENTATIONS[1])
    assert array.is_credible
    assert pushed(array) == ["b1"]
    assert [len(receiver.frames) for receiver in receivers] == [0, 1, 0, 1]


def test_settling_on_another_orientation_changes_nothing() -> None:
    array = array_of(Scripted("a", ORIENTATIONS[1]), Scripted("b", ORIENTATIONS[2]))
    settled = array.settle(ORIENTATIONS[5])
    assert (settled, array.is_credible, array.leading.orientation) == (False, False, ORIENTATIONS[1])


def test_end_of_the_first_ends_all() -> None:
    a, b = Scripted("a", UPRIGHT), Scripted("b", ORIENTATIONS[1])
    array = array_of(a, b)
    assert not array.done
    a.done = True
    assert array.done
