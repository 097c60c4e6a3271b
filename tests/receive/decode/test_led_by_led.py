"""LED-by-LED decoding before equalisation."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from recorder import Recorder
from scenes import drawn_film, link

from heliograph.link.settings import LinkSettings
from heliograph.receive import Packet, Pose, receive_frames
from heliograph.receive.decode import soft_packet as taken_pairs
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.per_led import decode_per_led
from heliograph.receive.decode.turbo_equaliser import decode_iteratively
from heliograph.receive.equalise.led_gains import DecodedPair, LedGains
from heliograph.receive.events import DecodeEvent, EqualiseEvent
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.settings import SoftSettings
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat

Floats = NDArray[np.float64]


def resting(t: Floats) -> Floats:
    return np.stack([np.full_like(t, 40.3), np.full_like(t, 48.8)], -1)


def received(distance_m: float, soft: SoftSettings, frames: int = 318) -> tuple[LinkSettings, list[Packet], Recorder]:
    """Return soft receiver packets for an array at rest, with reader events."""
    settings, recorder = link("signal.data_pairs=24", "receive.receiver=soft"), Recorder()
    film = drawn_film(settings, frames, resting, distance_m=distance_m)
    receive = replace(settings.receive, soft=soft)
    return settings, list(receive_frames(film, settings.signal, receive, recorder)), recorder


def equalised_packets(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Record the number of known codewords per equalised packet."""
    seen = list[int]()

    def noted(*args: Any) -> Any:
        known = args[-2]
        seen.append(0 if known is None else sum(word.status == "ok" for words in known.values() for word in words))
        return decode_iteratively(*args)

    monkeypatch.setattr(taken_pairs, "decode_iteratively", noted)
    return seen


def test_near_packets_are_not_equalised_once_the_array_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = equalised_packets(monkeypatch)
    _, packets, recorder = received(40.0, SoftSettings())
    assert [packet.status for packet in packets] == ["ok"] * 6
    # known codewords give LED brightness
    assert set(seen) == {4}
    assert recorder.of(EqualiseEvent) == []
    _, alone, other = received(40.0, SoftSettings(led_by_led=False))
    assert len(other.of(EqualiseEvent)) >= len(packets)
    for packet, equalised in zip(packets, alone, strict=True):
        for name, words in packet.layers.items():
            assert [word.block for word in words] == [word.block for word in equalised.layers[name]]


def test_leds_are_learnt_from_packets_that_are_not_equalised(monkeypatch: pytest.MonkeyPatch) -> None:
    learnt, learn = list[int](), LedGains.learn_data

    def noted(self: LedGains, pairs: Sequence[DecodedPair], gain: float, noise: float) -> LedGains:
        learnt.append(len(pairs))
        return learn(self, pairs, gain, noise)

    monkeypatch.setattr(LedGains, "learn_data", noted)
    _, packets, recorder = received(25.0, SoftSettings(), 212)
    assert [packet.status for packet in packets] == ["ok"] * 4
    assert recorder.of(EqualiseEvent) == []
    # a single packet is insufficient at this distance
    assert learnt[:3] == [8] * 3


def test_without_feedback_everything_is_equalised() -> None:
    _, packets, recorder = received(40.0, SoftSettings(feedback="none"), 159)
    assert len(recorder.of(EqualiseEvent)) >= len(packets) == 3


def test_only_pairs_in_step_are_read() -> None:
    form = PacketFormat(link().signal)
    cutout = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))
    pairs = form.settings.data_pairs
    single = PacketFormat(form.settings, Format(mode="single"))
    assert decode_per_led([None] * pairs, form, 0, Decoding()) is None
    assert decode_per_led([cutout] * pairs, single, 0, Decoding()) is None
    words = decode_per_led([cutout] * pairs, form, 0, Decoding())
    assert words is not None
    assert {word.status for by in words.values() for word in by} == {"crc_fail"}


@pytest.mark.parametrize("misplaced", [0.0, 3.0])
def test_what_is_read_depends_on_the_pose(misplaced: float) -> None:
    settings, _, recorder = received(40.0, SoftSettings(), 53)
    (event,) = recorder.of(DecodeEvent)
    error = np.array([misplaced, 0.0, 0.0, 0.0])
    cutouts = [None if one is None else one.moved(error) for one in event.cutouts or ()]
    words = decode_per_led(cutouts, PacketFormat(settings.signal), event.identity, Decoding())
    assert words is not None
    assert all(word.status == ("crc_fail" if misplaced else "ok") for by in words.values() for word in by)
