"""A film received and counted: at any time, and only what is a packet."""

from dataclasses import replace
from pathlib import Path

import pytest
from link_packets import small

from heliograph.link.film import write_film
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import open_film
from heliograph.receive.packets import Status
from heliograph.receive.receiver import StreamReceiver


@pytest.mark.slow
def test_a_report_may_be_asked_for_at_any_time(tmp_path: Path) -> None:
    settings = small("channel.duration_s=0.2")
    write_film(tmp_path / "a.mkv", settings, [{}], seed=1)
    reception = Reception(open_truth(truth_path(tmp_path / "a.mkv")))
    with open_film(tmp_path / "a.mkv") as source:
        for _ in receive_film(source, settings.signal, settings, reception, progress=lambda _: asked(reception)):
            pass
    assert reception.errors is not None
    high = reception.errors.total()["high"]
    assert (high.codewords, high.codeword_errors, reception.errors.false_codewords) == (2, 0, 0)


def asked(reception: Reception) -> None:
    assert reception.report(1.0)["frames"] == reception.frames


def test_packets_of_nobody_are_not_counted(tmp_path: Path) -> None:
    settings = small("channel.duration_s=0.1")
    write_film(tmp_path / "a.mkv", settings, [{}], seed=1)
    with open_film(tmp_path / "a.mkv") as source:
        ((packet, _),) = receive_film(source, settings.signal, settings, Reception())
    reception = Reception()
    assert list(reception.add(replace(packet, identity=9, status="no_header"))) == []
    assert reception.arrays == {}


@pytest.mark.parametrize("status", ["no_header", "no_array"])
@pytest.mark.slow
def test_what_is_no_packet_is_neither_handed_on_nor_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, status: Status
) -> None:
    """Also that of an array seen before; it was sent, so it is missed."""
    settings = small("channel.duration_s=0.3")
    write_film(tmp_path / "a.mkv", settings, [{}], seed=1)
    push = StreamReceiver.push
    monkeypatch.setattr(
        StreamReceiver,
        "push",
        lambda *a: [replace(p, status=status) if p.first_frame == 100 else p for p in push(*a)],
    )
    reception = Reception(open_truth(truth_path(tmp_path / "a.mkv")))
    with open_film(tmp_path / "a.mkv") as source:
        found = [packet.first_frame for packet, _ in receive_film(source, settings.signal, settings, reception)]
    assert found == [0, 200]
    assert reception.arrays[0].packets == 2
    report = reception.report(1.0)
    assert (report["false_packets"], report["false_codewords"]) == (0, 0)
    assert reception.errors is not None
    high = reception.errors.total()["high"]
    assert (high.codewords, high.missed) == (3, 1)
