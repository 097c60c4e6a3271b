"""End-to-end messages through films, including truncated films."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import link

from heliograph.base.errors import MediaError, SettingsError
from heliograph.link import film as link_film
from heliograph.link.film import packet_row, read_packets, write_film
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, simulate
from heliograph.link.truth import open_truth, signal_of, truth_path
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.media import open_film
from heliograph.receive.api import make_receiver
from heliograph.signal.message import Message
from heliograph.transmit import Messages

LONG = bytes(np.random.default_rng(5).integers(0, 256, 500, dtype=np.uint8))  # longer than four codewords of 116 bytes
Sent = dict[tuple[int, str, int], bytes]


def through(path: Path, settings: LinkSettings, messages: Sequence[Messages]) -> tuple[Sent, ReceptionCounter]:
    write_film(path, settings, messages, seed=3)
    return read(path, settings)


def read(path: Path, settings: LinkSettings) -> tuple[Sent, ReceptionCounter]:
    """Return the messages decoded from a film by identity, layer and stream, and the reception."""
    reception = ReceptionCounter(open_truth(truth_path(path)))
    with open_film(path) as source:
        signal, _ = signal_of(source, settings.signal)
        packets = list(receive_and_count(source, signal, settings, reception))
    return by_place([message for _, whole in packets for message in whole]), reception


def by_place(messages: list[Message]) -> Sent:
    assert len({(m.identity, m.layer, m.stream) for m in messages}) == len(messages), "each message comes out once"
    return {(m.identity, m.layer, m.stream): m.data for m in messages}


@pytest.mark.slow
def test_messages_come_back_byte_for_byte_in_all_layers(tmp_path: Path) -> None:
    messages: list[Messages] = [{"high": [b"\x00stop\xff"], "middle": [LONG[:300], b"a"], "low": [LONG[:230]]}]
    found, reception = through(tmp_path / "a.mkv", link("channel.duration_s=0.4"), messages)
    middle = {(0, "middle", 0): LONG[:300], (0, "middle", 1): b"a"}
    assert found == {(0, "high", 0): b"\x00stop\xff", **middle, (0, "low", 0): LONG[:230]}
    assert reception.unfinished() == []
    assert reception.errors is not None
    assert [(layer.bit_errors, layer.codeword_errors) for layer in reception.errors.total().values()] == [(0, 0)] * 3
    assert reception.errors.false_codewords == 0
    report = reception.report(2.0)
    assert (report["frames"], report["seconds"], report["frames_per_second"]) == (400, 2.0, 200.0)
    (array,) = report["arrays"]
    assert (array["id"], array["packets"], array["first_frame"], array["last_frame"]) == (0, 4, 0, 399)
    assert array["layers"]["middle"] == {"ok": 8, "failed": 0, "bytes": 2 * 301}
    (row,) = report["errors"]
    assert (row["from_m"], row["to_m"]) == (50, 55)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a film of three packets with a message in "middle", and one in "high" that takes more packets."""
    path = tmp_path_factory.mktemp("film") / "a.mkv"
    write_film(path, link("channel.duration_s=0.3"), [{"high": [LONG], "middle": [b"only this"]}], seed=3)
    return path


@pytest.mark.slow
def test_layers_are_empty_or_unfinished_without_a_whole_message(film: Path) -> None:
    found, reception = read(film, link())
    assert (found, reception.unfinished()) == ({(0, "middle", 0): b"only this"}, [(0, "high", 0, 348, 500)])
    tally = reception.arrays[0].layers
    assert (tally["low"].ok, tally["low"].bytes) == (3, 0)


@pytest.mark.slow
def test_packets_are_read_without_counts_and_become_rows_of_plain_values(film: Path) -> None:
    settings = link()
    with open_film(film) as source:
        packets = list(read_packets(source, settings.signal, make_receiver(settings.signal, settings.receive)))
    assert [(packet.first_frame, packet.status) for packet in packets] == [(0, "ok"), (100, "ok"), (200, "ok")]
    row = packet_row(packets[0])
    assert json.loads(json.dumps(row)) == row
    assert (row["id"], row["status"], row["first_frame"], row["last_frame"]) == (0, "ok", 0, 99)
    assert (row["distance_m"], row["layers"]["high"][0]["sequence"]) == (pytest.approx(50, rel=0.02), 0)


@pytest.mark.slow
def test_truncated_film_gives_all_packets_before_the_end(film: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(film.read_bytes()[: int(film.stat().st_size * 0.99)])
    reception, found = ReceptionCounter(), list[Message]()
    with open_film(cut) as source, pytest.raises(MediaError, match="ends in the middle"):
        found.extend(m for _, whole in receive_and_count(source, link().signal, link(), reception) for m in whole)
    assert 280 < reception.frames < 300
    assert by_place(found) == {(0, "middle", 0): b"only this"}
    assert reception.arrays[0].packets == 3  # a partial packet counts


@pytest.mark.slow
def test_film_may_start_within_a_packet_and_has_a_note_of_the_signal(tmp_path: Path) -> None:
    changes = ("channel.arrays.0.start_s=-0.0371", "channel.duration_s=0.4", "signal.data_pairs=40")
    settings = link(*changes, "signal.rate.low=1/2")
    write_film(tmp_path / "a.mkv", settings, [{"high": [b"odd"], "low": [LONG[:300]]}], seed=3)
    found, reception = read(tmp_path / "a.mkv", link())
    assert found == {(0, "high", 0): b"odd", (0, "low", 0): LONG[:300]}
    assert reception.errors is not None
    assert (reception.errors.false_codewords, reception.errors.total()["high"].bit_errors) == (0, 0)
    assert [list(reception.errors.bins())] == [[50.0]]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["n" * 252 + ".h5", "caf\udce9\n.h5"])
def test_film_of_any_name_has_a_truth_file(tmp_path: Path, name: str) -> None:
    settings = link("channel.camera.width=64", "channel.camera.height=64", "channel.duration_s=0.01")
    write_film(tmp_path / name, settings, [{"high": [b"x"]}], seed=1)
    assert (len(list(tmp_path.iterdir())), open_truth(truth_path(tmp_path / name)).settings) == (2, settings)


@pytest.mark.slow
def test_two_arrays_send_different_messages(tmp_path: Path) -> None:
    settings = load_settings("two-arrays", None, [
        "channel.distance_m=40", "channel.speed_m_s=0", "channel.shake=none", "channel.duration_s=0.3",
        "channel.camera.width=256", "channel.camera.height=96",
        "channel.arrays.0.x_m=0.8", "channel.arrays.0.y_m=0", "channel.arrays.1.x_m=-0.8", "channel.arrays.1.y_m=0",
    ])  # fmt: skip
    found, reception = through(tmp_path / "a.mkv", settings, [{"high": [b"left"]}, {"high": [b"right"]}])
    assert found == {(0, "high", 0): b"left", (7, "high", 0): b"right"}
    assert [array["id"] for array in reception.report(1.0)["arrays"]] == [0, 7]


def test_the_same_seed_gives_the_same_film(tmp_path: Path) -> None:
    settings = link("channel.duration_s=0.02")
    films = [[frame.pixels for frame, _ in simulate(settings, [{}], seed)] for seed in (4, 4, 5)]
    assert np.array_equal(films[0], films[1])
    assert not np.array_equal(films[0], films[2])


def interrupted_after(monkeypatch: pytest.MonkeyPatch, frames: int, error: BaseException) -> None:
    def some(*arguments: Any) -> Iterator[Any]:
        for count, pair in enumerate(simulate(*arguments)):
            if count == frames:
                raise error
            yield pair

    monkeypatch.setattr(link_film, "simulate", some)


def test_ctrl_c_keeps_the_film_and_its_truth_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interrupted_after(monkeypatch, 120, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        write_film(tmp_path / "a.mkv", link(), [{"high": [b"so far"]}], seed=1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mkv", "a.mkv.truth.npz"]
    assert len(list(open_truth(tmp_path / "a.mkv.truth.npz").rows())) == 120
    found, reception = read(tmp_path / "a.mkv", link())
    assert (found, reception.frames) == ({(0, "high", 0): b"so far"}, 120)


@pytest.mark.parametrize("frames", [0, 20])
def test_failure_leaves_existing_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    (tmp_path / "a.mkv").write_bytes(b"old film")
    (tmp_path / "a.mkv.truth.npz").write_bytes(b"old truth")
    interrupted_after(monkeypatch, frames, SettingsError("broken") if frames else KeyboardInterrupt())
    with pytest.raises(SettingsError if frames else KeyboardInterrupt):
        write_film(tmp_path / "a.mkv", link(), [{}], seed=1)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {
        "a.mkv": b"old film", "a.mkv.truth.npz": b"old truth"
    }  # fmt: skip


def test_a_truth_that_cannot_be_written_takes_the_film_with_it(tmp_path: Path) -> None:
    (tmp_path / "a.mkv.truth.npz").mkdir()
    with pytest.raises(MediaError, match=r"truth\.npz is a folder: move it away"):
        write_film(tmp_path / "a.mkv", link("channel.duration_s=0.01"), [{}], seed=1)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mkv.truth.npz"]


def test_drives_without_a_frame_or_a_packet_are_reported(tmp_path: Path) -> None:
    with pytest.raises(MediaError, match=r"no frames.*channel\.duration_s"):
        write_film(tmp_path / "a.mkv", link("channel.duration_s=1e-5"), [{}], seed=1)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(MediaError, match="has 99 frames; a packet takes 100"):
        through(tmp_path / "a.mkv", link("channel.duration_s=0.099"), [{}])


@pytest.mark.parametrize("data", [b"x" * 8_000_000, b"x" * 20_000_000])
def test_a_message_too_long_is_refused(data: bytes) -> None:
    with pytest.raises(SettingsError, match=r"array 0, high layer: .* at most"):
        simulate(link(), [{"high": [data]}], 0)


@pytest.mark.parametrize("change", ["channel.background.kind=footage", "channel.shake=imu"])
def test_missing_recordings_are_reported(change: str) -> None:
    with pytest.raises(SettingsError, match="needs"):
        next(simulate(link(change), [{}], 0, Recordings()))
