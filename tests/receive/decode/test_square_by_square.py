"""Square-by-square decoding for unsynchronised packets before equalisation."""

from dataclasses import replace

import numpy as np
import pytest
from recorder import Recorder
from scenes import film, link

from heliograph.link.settings import LinkSettings
from heliograph.receive import Pose, receive_frames
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.per_led import decode_per_led
from heliograph.receive.decode.per_quad import decode_per_quad
from heliograph.receive.events import DecodeEvent, EqualiseEvent
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Words
from heliograph.receive.settings import SoftSettings
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat

PACKET = 53
FRAMES = 3 * PACKET + 10


def at_rest(distance_m: float, phase: float) -> LinkSettings:
    """Return settings for an array at rest, `phase` T_b out of step."""
    settings = link("signal.data_pairs=24", "receive.receiver=soft", distance_m=distance_m)
    arrays = (replace(settings.channel.arrays[0], start_s=phase * 1e-3),)
    return replace(settings, channel=replace(settings.channel, arrays=arrays))


def decoded(words: Words | None, layer: str) -> list[bool]:
    assert words is not None
    return [word.status == "ok" for word in words[layer]]


NEAR = [(0.07, 30.0), (0.3, 45.0), (0.5, 30.0), (0.5, 45.0), (0.62, 30.0), (0.9, 45.0)]


@pytest.mark.parametrize(("phase", "distance_m"), [*NEAR, (0.2, 65.0), (0.8, 65.0)])
def test_packets_are_read_without_the_equaliser(phase: float, distance_m: float) -> None:
    settings = at_rest(distance_m, phase)
    frames, recorder, other = film(settings, FRAMES), Recorder(), Recorder()
    packets = list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert [packet.status for packet in packets] == ["ok"] * 3
    assert recorder.of(EqualiseEvent) == []
    equalised = replace(settings.receive, soft=SoftSettings(led_by_led=False))
    alone = list(receive_frames(frames, settings.signal, equalised, other))
    assert len(other.of(EqualiseEvent)) >= 3
    for packet, one in zip(packets, alone, strict=True):
        for name, words in packet.layers.items():
            assert [word.block for word in words] == [word.block for word in one.layers[name]]


@pytest.mark.parametrize("misplaced", [0.0, 3.0])
def test_what_is_read_depends_on_the_pose_and_hardly_on_the_gain(misplaced: float) -> None:
    settings, recorder = at_rest(40.0, 0.4), Recorder()
    list(receive_frames(film(settings, PACKET + 5), settings.signal, settings.receive, recorder))
    (event,) = recorder.of(DecodeEvent)
    error = np.array([misplaced, 0.0, 0.0, 0.0])
    cutouts = [None if one is None else one.moved(error) for one in event.cutouts or ()]
    assert any(one is not None and one.combination is not None for one in cutouts)
    for gain in (140.0, 200.0, 280.0):
        words = decode_per_quad(cutouts, gain, PacketFormat(settings.signal), event.identity, Decoding())
        assert words is not None
        assert all(word.status == ("crc_fail" if misplaced else "ok") for by in words.values() for word in by)


def test_far_layers_are_read_once_the_light_of_those_before_is_known() -> None:
    settings, recorder = link("signal.data_pairs=48", "receive.receiver=soft", distance_m=85.0), Recorder()
    list(receive_frames(film(settings, 105), settings.signal, settings.receive, recorder))
    (event,) = recorder.of(DecodeEvent)
    place = PacketFormat(settings.signal), event.identity, Decoding(algorithm="max-log")
    alone = decode_per_led(event.cutouts or (), *place)
    assert decoded(alone, "high") == [True]
    assert decoded(alone, "middle") == [False, False]
    words = decode_per_quad(event.cutouts or (), 190.0, *place, alone)
    assert decoded(words, "high") == [True]
    assert decoded(words, "middle") == [True, True]
    assert words is not None
    for word, right in zip(words["middle"], event.packet.layers["middle"], strict=True):
        assert word.block == right.block


def test_a_pair_that_is_missing_says_nothing() -> None:
    form = PacketFormat(link("signal.data_pairs=24").signal)
    cutout = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))
    words = decode_per_quad([cutout, *[None] * 23], 100.0, form, 0, Decoding())
    assert words is not None
    assert {word.status for by in words.values() for word in by} == {"crc_fail"}


def test_only_the_hierarchical_code_with_inverses_is_read() -> None:
    form = PacketFormat(link().signal)
    cutout = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))
    pairs = form.settings.data_pairs
    single = PacketFormat(form.settings, Format(mode="single"))
    assert decode_per_quad([cutout] * pairs, 100.0, single, 0, Decoding()) is None
    ook = PacketFormat(link("signal.modulation=ook").signal)
    assert decode_per_quad([cutout] * pairs, 100.0, ook, 0, Decoding()) is None
