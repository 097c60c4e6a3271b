"""Receive and count a film; exclude false packets; journal of a reception in progress."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from link_packets import perfect
from scenes import link

from heliograph.base.errors import MediaError, SettingsError
from heliograph.link.film import write_film
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages
from heliograph.link.truth import FrameTruth, open_truth, truth_path
from heliograph.measure.journal import Journal, Row, approach, sentence
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import ReceptionCounter, TimedReceiver, receive_and_count, receive_film
from heliograph.media import open_film
from heliograph.receive.events import LostEvent
from heliograph.receive.packet import Packet, Status
from heliograph.receive.receiver import StreamReceiver
from heliograph.transmit import Messages


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Film of three packets, with the truth."""
    path = tmp_path_factory.mktemp("film") / "a.mkv"
    write_film(path, link("channel.duration_s=0.3"), [{}], seed=1)
    return path


@pytest.mark.slow
def test_report_is_available_at_any_time(film: Path) -> None:
    settings, reception = link(), ReceptionCounter(open_truth(truth_path(film)))

    def check_report(_: int) -> None:
        assert reception.report(1.0)["frames"] == reception.frames

    with open_film(film) as source:
        (packet, *_), *_ = receive_and_count(source, settings.signal, settings, reception, progress=check_report)
    assert reception.errors is not None
    high = reception.errors.total()["high"]
    assert (high.codewords, high.codeword_errors, reception.errors.false_codewords) == (3, 0, 0)
    other = ReceptionCounter()
    assert (list(other.add(replace(packet, identity=9, status="no_header"))), other.arrays) == ([], {})


@pytest.mark.slow
def test_a_film_gives_messages_packets_and_arrays_in_one_call(film: Path) -> None:
    by_path, by_name = receive_film(film), receive_film(str(film), link(), receiver="plain")
    assert (by_path.receiver, by_name.receiver) == ("soft", "plain")
    with open_film(film) as source:
        by_film = receive_film(source, receiver="auto")
    for reception in (by_path, by_name, by_film):
        assert [packet.first_frame for packet in reception.packets] == [0, 100, 200]
        assert reception.arrays.keys() == {0}
        assert (reception.arrays[0].layers["high"].ok, reception.messages, reception.incomplete) == (3, [], [])


@pytest.mark.slow
def test_messages_and_missing_bytes_are_given(tmp_path: Path) -> None:
    path, settings = tmp_path / "a.mkv", link("channel.duration_s=0.1")
    write_film(path, settings, [{"high": [b"red for 12 s"], "low": [bytes(500)]}], seed=1)
    reception = receive_film(path)
    assert [(message.layer, message.data) for message in reception.messages] == [("high", b"red for 12 s")]
    ((identity, layer, stream, received, size),) = reception.incomplete
    assert (identity, layer, stream, size) == (0, "low", 0, 500)
    assert 0 < received < 500


def test_a_wrong_name_is_reported(tmp_path: Path) -> None:
    with pytest.raises(MediaError):
        receive_film(tmp_path / "none.mkv")
    for settings in ("no preset", 3):
        with pytest.raises(SettingsError):
            receive_film(tmp_path / "none.mkv", settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("status", ["no_header", "no_array"])
@pytest.mark.slow
def test_results_without_a_packet_are_not_counted(film: Path, monkeypatch: pytest.MonkeyPatch, status: Status) -> None:
    """A false packet from a known array is excluded too; the sent packet counts as missed."""
    push = StreamReceiver.push
    monkeypatch.setattr(
        StreamReceiver, "push", lambda *a: [replace(p, status=status) if p.first_frame == 100 else p for p in push(*a)]
    )
    settings, reception = link(), ReceptionCounter(open_truth(truth_path(film)))
    with open_film(film) as source:
        found = [packet.first_frame for packet, _ in receive_and_count(source, settings.signal, settings, reception)]
    assert (found, reception.arrays[0].packets) == ([0, 200], 2)
    report = reception.report(1.0)
    assert (report["false_packets"], report["false_codewords"]) == (0, 0)
    assert reception.errors is not None
    high = reception.errors.total()["high"]
    assert (high.codewords, high.missed) == (3, 1)


@dataclass(frozen=True)
class TruthOf:
    """Truth of the frames of an array at 50 m, in time order."""

    settings: LinkSettings

    @property
    def messages(self) -> Sequence[Messages]:
        return default_messages(self.settings)

    def frames(self) -> Iterator[FrameTruth]:
        for index in range(1000):
            yield FrameTruth(index, 1e-3 * index, [50.0], [True])


def without_codewords(packet: Packet) -> Packet:
    failed: dict[str, Any] = {"status": "crc_fail", "block": None}
    words = {name: tuple(replace(word, **failed) for word in by) for name, by in packet.layers.items()}
    return replace(packet, status="crc_fail", layers=words)


def uncertain(number: int) -> Packet:
    """Return a packet with a header but no codeword, from an array that is not in the film."""
    return without_codewords(replace(perfect(link(), number), identity=22))


def test_identity_without_a_decoded_codeword_is_uncertain() -> None:
    settings = link()
    reception = ReceptionCounter(TruthOf(settings))
    for frame in range(300):
        reception.saw(frame)
    for packet in (uncertain(0), without_codewords(perfect(settings, 0)), uncertain(1), perfect(settings, 1)):
        list(reception.add(packet))
    report = reception.report(1.0)
    # the first packet has no codeword either; the second identifies the array
    assert [(array["id"], array["packets"]) for array in report["arrays"]] == [(0, 2)]
    assert [(array["id"], array["packets"]) for array in report["uncertain"]] == [(22, 2)]
    assert report["false_packets"] == 0
    assert reception.errors is not None
    assert reception.errors.uncertain_packets == 2
    list(reception.add(replace(perfect(settings, 2), identity=22)))
    assert [array["id"] for array in reception.report(1.0)["arrays"]] == [0, 22]
    assert reception.report(1.0)["false_packets"] == 1


def test_rows_mark_an_identity_as_uncertain_until_a_codeword_is_decoded() -> None:
    settings, rows = link(), list[Mapping[str, Any]]()
    journal = Journal(settings.receive.calibration, rows.append)
    for packet in (uncertain(0), perfect(settings, 0), without_codewords(perfect(settings, 1))):
        journal.read(packet, [])
    for identity in (22, 0):
        journal.observe(LostEvent(identity, 0.3))
    assert [(row["event"], row["id"], row.get("uncertain", False)) for row in rows] == [
        ("packet", 22, True), ("packet", 0, False), ("packet", 0, False), ("lost", 22, True), ("lost", 0, False)
    ]  # fmt: skip
    assert ["uncertain" in sentence(row) for row in rows] == [True, False, False, True, False]


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
    assert (rows[0]["event"], rows[0]["distance_m"]) == ("found", pytest.approx(30, rel=0.05))
    assert rows[0]["orientation"] == "upright"
    packets = [row for row in rows if row["event"] == "packet" and row["status"] == "ok"]
    assert (len(packets), [row["approach_m_s"] for row in packets[:2]]) == (4, [None, None])
    assert packets[-1]["approach_m_s"] == pytest.approx(8.33, rel=0.3)  # 30 km/h
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
    assert (lost["orientation"], lost["approach_m_s"]) == ("upright", pytest.approx(8.33, rel=0.3))
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


def test_receiver_time_excludes_film_and_counting(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that only the receiver and the caller advance."""
    now = [0.0]
    monkeypatch.setattr("heliograph.measure.reception.time.process_time", lambda: now[0])
    one = perfect(link(), 0)

    class Slow:
        def push(self, _: Any) -> Iterator[Packet]:
            for packet in (without_codewords(one), one):
                now[0] += 0.25
                yield packet
            now[0] += 1.0

        def finish(self) -> list[Packet]:
            now[0] += 0.0625
            return [one]

    counter = ReceptionCounter()
    receiver = TimedReceiver(Slow(), counter)  # type: ignore[arg-type]
    for packets in (receiver.push(None), receiver.finish()):  # type: ignore[arg-type]
        for _ in packets:
            now[0] += 100.0
    assert counter.receiver_s == 1.5625
    assert counter.processing == {"5000": 1, "625": 1}
