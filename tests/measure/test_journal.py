"""Journal of a reception in progress."""

import base64

import pytest

from heliograph.link.settings import load_settings
from heliograph.measure.journal import Journal, Row, approach, message_row, sentence
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.signal.message import Message

CHANGES = (
    "channel.camera.width=160", "channel.camera.height=128", "channel.distance_m=30", "channel.stop_m=20",
    "channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0", "channel.duration_s=0.75", "channel.arrays.0.off_s=[[0.43,1]]",
)  # fmt: skip


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    """Journal of an approach in which the array goes dark after four packets."""
    settings, rows = load_settings("paper", None, CHANGES), list[Row]()
    journal = Journal(settings.receive.calibration, rows.append)
    film = LiveFilm(settings, [{"high": [b"\xff\x00"], "middle": [b"left lane closed"]}], 3, None, None)
    for packet, messages in receive_and_count(film, settings.signal, settings, ReceptionCounter(), journal.observe):
        journal.read(packet, messages)
    return rows


@pytest.mark.slow
def test_rows_have_distance_speed_and_messages_in_order(rows: list[Row]) -> None:
    assert rows[0]["event"] == "found"
    assert rows[0]["distance_m"] == pytest.approx(30, rel=0.05)
    assert rows[0]["orientation"] == "upright"
    packets = [row for row in rows if row["event"] == "packet" and row["status"] == "ok"]
    assert len(packets) == 4
    assert [row["approach_m_s"] for row in packets[:2]] == [None, None]
    # 30 km/h
    assert packets[-1]["approach_m_s"] == pytest.approx(8.33, rel=0.3)
    messages = {row["layer"]: row for row in rows if row["event"] == "message"}
    assert base64.b64decode(messages["high"]["data"]) == b"\xff\x00"
    assert "text" not in messages["high"]
    assert messages["middle"]["text"] == "left lane closed"
    assert "array 0 found 30" in sentence(rows[0])
    assert "px/s in the image, upright" in sentence(rows[0])
    assert "message 0 of the middle layer is whole, 16 bytes" in sentence(messages["middle"])
    assert "nearing at" in sentence(packets[-1])


@pytest.mark.slow
def test_dark_array_is_lost(rows: list[Row]) -> None:
    (lost,) = (row for row in rows if row["event"] == "lost")
    assert lost["distance_m"] < 30
    assert lost["orientation"] == "upright"
    assert lost["approach_m_s"] == pytest.approx(8.33, rel=0.3)
    assert "array 0 lost, last seen" in sentence(lost)
    nearing = sentence({**lost, "approach_m_s": 8.34})
    assert nearing.endswith(f"last seen {lost['distance_m']:.1f} m away, nearing at 30 km/h, upright")
    still = sentence({**lost, "approach_m_s": -0.1})
    assert still.endswith(f"last seen {lost['distance_m']:.1f} m away, at rest, upright")


def test_speed_is_a_slope() -> None:
    assert approach([(0.0, 50.0), (0.1, 49.0)]) is None
    assert approach([(0.0, 50.0), (0.1, 49.0), (0.2, 48.0)]) == pytest.approx(10)
    assert approach([(0.0, 50.0)] * 3) is None
    receding = {"event": "packet", "id": 1, "time_s": 2.0, "layers": {}, "distance_m": 9.0, "orientation": "mirrored"}
    assert "receding at 36 km/h, mirrored" in sentence({**receding, "approach_m_s": -10.0})


def test_message_is_plain_values() -> None:
    row = message_row(Message(4, "low", 7, "grün".encode()))
    assert (row["id"], row["stream"]) == (4, 7)
    assert row["text"] == "grün"
    assert row["bytes"] == 5
