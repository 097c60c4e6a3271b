"""Journal of a reception in progress."""

import base64
from typing import Any

import pytest

from heliograph.link.settings import load_settings
from heliograph.link.simulate import simulate
from heliograph.measure.journal import Journal, Row, approach, message_row, sentence
from heliograph.measure.reception import Reception, receive_film
from heliograph.signal.message import Message

SIZE = ["channel.camera.width=160", "channel.camera.height=128", "channel.distance_m=30", "channel.stop_m=20"]
SIZE += ["channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0"]


class _Film:
    path = "the film"

    def __init__(self, frames: list[Any]):
        self._frames = frames

    def __iter__(self) -> Any:
        return iter(self._frames)


def told(*changes: str, dark_after: int | None = None) -> list[Row]:
    settings = load_settings("paper", None, [*SIZE, "receive.receiver=plain", *changes])
    messages = [{"high": [b"\xff\x00"], "middle": [b"left lane closed"]}]
    frames = [frame for frame, _ in simulate(settings, messages, 3)]
    for frame in frames[dark_after:] if dark_after is not None else []:
        frame.pixels[:] = 0
    rows: list[Row] = []
    journal = Journal(settings.receive.calibration, rows.append)
    for packet, whole in receive_film(_Film(frames), settings.signal, settings, Reception(), journal.observe):
        journal.read(packet, whole)
    return rows


@pytest.mark.slow
def test_rows_come_in_order_with_distance_speed_and_messages() -> None:
    rows = told("channel.duration_s=0.45")
    kinds = [row["event"] for row in rows]
    assert kinds[0] == "found"
    assert kinds.count("packet") == 4
    assert rows[0]["distance_m"] == pytest.approx(30, rel=0.05)
    assert rows[0]["orientation"] == "upright"
    packets = [row for row in rows if row["event"] == "packet"]
    assert [row["approach_m_s"] for row in packets[:2]] == [None, None]
    # 30 km/h
    assert packets[-1]["approach_m_s"] == pytest.approx(8.33, rel=0.3)
    messages = {row["layer"]: row for row in rows if row["event"] == "message"}
    assert base64.b64decode(messages["high"]["data"]) == b"\xff\x00"
    assert "text" not in messages["high"]
    assert messages["middle"]["text"] == "left lane closed"
    words = [sentence(row) for row in rows]
    assert "array 0 found 30" in words[0]
    assert "px/s in the image, upright" in words[0]
    assert any("message 0 of the middle layer is whole, 16 bytes" in one for one in words)
    assert "nearing at" in sentence(packets[-1])


@pytest.mark.slow
def test_an_array_that_goes_dark_is_lost() -> None:
    rows = told("channel.duration_s=0.6", dark_after=250)
    lost = [row for row in rows if row["event"] == "lost"]
    assert len(lost) == 1
    assert lost[0]["distance_m"] < 30
    assert lost[0]["orientation"] == "upright"
    assert lost[0]["approach_m_s"] == pytest.approx(8.33, rel=0.3)
    assert "array 0 lost, last seen" in sentence(lost[0])
    words = sentence({**lost[0], "approach_m_s": 8.34})
    assert words.endswith(f"last seen {lost[0]['distance_m']:.1f} m away, nearing at 30 km/h, upright")
    still = sentence({**lost[0], "approach_m_s": -0.1})
    assert still.endswith(f"last seen {lost[0]['distance_m']:.1f} m away, at rest, upright")


def test_speed_is_a_slope() -> None:
    assert approach([(0.0, 50.0), (0.1, 49.0)]) is None
    assert approach([(0.0, 50.0), (0.1, 49.0), (0.2, 48.0)]) == pytest.approx(10)
    assert approach([(0.0, 50.0)] * 3) is None
    receding = {"event": "packet", "id": 1, "time_s": 2.0, "layers": {}, "distance_m": 9.0, "orientation": "mirrored"}
    assert "receding at 36 km/h, mirrored" in sentence({**receding, "approach_m_s": -10.0})


def test_a_message_is_plain_values() -> None:
    row = message_row(Message(4, "low", 7, "grün".encode()))
    assert row["id"], row["stream"] == (4, 7)
    assert row["text"] == "grün"
    assert row["bytes"] == 5
