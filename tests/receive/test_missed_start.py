"""A packet starting before the first detected header is reported once."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from scenes import film, link

from heliograph.base.frames import Frame
from heliograph.measure.journal import Journal, Row, sentence
from heliograph.measure.reception import ReceptionCounter, receive_and_count


@cache
def frames(start_s: float) -> list[Frame]:
    place, camera = {"x_m": 0.0, "y_m": 0.0, "start_s": start_s}, {"width": 64, "height": 64}
    return film(link("signal.data_pairs=24", arrays=[place], camera=camera), 140, seed=4)


class Film(tuple[Frame, ...]):
    path = "the film"


def received(film: Sequence[Frame], receiver: str) -> tuple[list[Row], ReceptionCounter]:
    settings = link("signal.data_pairs=24", f"receive.receiver={receiver}")
    rows, reception = list[Row](), ReceptionCounter()
    journal = Journal(settings.receive.calibration, rows.append)
    for packet, messages in receive_and_count(Film(film), settings.signal, settings, reception, journal.observe):
        journal.read(packet, messages)
    return rows, reception


def torn(film: Sequence[Frame]) -> list[Frame]:
    """The second frame repeats rows from the first, so that the first header is undetectable."""
    pixels = film[1].pixels.copy()
    pixels[:32] = film[0].pixels[:32]
    return [film[0], replace(film[1], pixels=pixels), *film[2:]]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.parametrize(("start_s", "begun", "header_s"), [(-0.0201, list, 0.0319), (0.0, torn, 0.052)])
@pytest.mark.slow
def test_packet_before_a_header_is_reported_once(start_s: float, begun: Any, header_s: float, receiver: str) -> None:
    rows, reception = received(begun(frames(start_s)), receiver)
    report = {"id": 0, "time_s": pytest.approx(header_s, abs=0.001)}
    missed = [row for row in rows if row["event"] == "missed_start"]
    assert missed == [{"event": "missed_start", **report}]
    kinds = [row["event"] for row in rows]
    assert kinds.index("missed_start") == kinds.index("packet") - 1
    words = f"array 0: a packet began before the first header found, at {header_s:.3f} s; that packet is lost"
    assert sentence(missed[0]) == words
    assert reception.report(1.0)["missed_starts"] == [report]


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.parametrize(("start_s", "first"), [(0.0, 1402), (0.0503, 0)])
def test_array_that_switches_on_misses_no_start(start_s: float, first: int, receiver: str) -> None:
    later = [replace(f, index=f.index + first, time_s=f.time_s + first / 1000) for f in frames(start_s)]
    rows, reception = received(later, receiver)
    assert "missed_start" not in {row["event"] for row in rows}
    assert len(reception.arrays) == 1
    assert reception.report(1.0)["missed_starts"] == []
