"""Decoding of 2 x 2 LED squares for unsynchronised packets, before the equaliser."""

import itertools

import numpy as np
import pytest
from recorder import Recorder
from scenes import film, link, received, statuses

from heliograph.link.settings import LinkSettings
from heliograph.receive import Pose
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.per_led import decode_per_led
from heliograph.receive.decode.per_quad import decode_per_quad
from heliograph.receive.events import DecodeEvent, EqualiseEvent
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Words
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat

PACKET = 53  # frames per packet, with one for the phase


def unsynchronised(distance_m: float, phase: float) -> LinkSettings:
    """Return settings for an array at rest, `phase` T_b out of step."""
    start_s = f"channel.arrays.0.start_s={phase * 1e-3}"
    return link("signal.data_pairs=24", "receive.receiver=soft", start_s, distance_m=distance_m)


def statuses_of(words: Words | None) -> list[str]:
    return [word.status for by in (words or {}).values() for word in by]


@pytest.mark.parametrize(("phase", "distance_m"), [(0.07, 30.0), (0.5, 45.0), (0.9, 45.0), (0.2, 65.0)])
@pytest.mark.slow
def test_unsynchronised_packets_are_decoded_without_the_equaliser(phase: float, distance_m: float) -> None:
    settings, recorder = unsynchronised(distance_m, phase), Recorder()
    packets = received(film(settings, 2 * PACKET + 3, roi_margin_px=20), settings, recorder)
    assert statuses(packets) == ["ok"] * 2
    assert recorder.of(EqualiseEvent) == []


@pytest.mark.slow
def test_decoding_depends_on_the_pose_and_hardly_on_the_gain() -> None:
    settings, recorder = unsynchronised(40.0, 0.4), Recorder()
    received(film(settings, PACKET + 5, roi_margin_px=20), settings, recorder)
    (event,) = recorder.of(DecodeEvent)
    assert any(cutout is not None and cutout.combination is not None for cutout in event.cutouts or ())
    for misplaced_px, gain in itertools.product((0.0, 3.0), (140.0, 280.0)):
        cutouts = [cutout and cutout.moved(np.array([misplaced_px, 0.0, 0.0, 0.0])) for cutout in event.cutouts or ()]
        words = decode_per_quad(cutouts, gain, PacketFormat(settings.signal), event.identity, Decoding())
        assert set(statuses_of(words)) == {"crc_fail" if misplaced_px else "ok"}


def test_far_layers_are_decoded_once_the_light_of_the_others_is_known() -> None:
    settings, recorder = link("signal.data_pairs=48", "receive.receiver=soft", distance_m=85.0), Recorder()
    received(film(settings, 105, roi_margin_px=20), settings, recorder)
    (event,) = recorder.of(DecodeEvent)
    place = PacketFormat(settings.signal), event.identity, Decoding(algorithm="max-log")
    alone = decode_per_led(event.cutouts or (), *place)
    assert statuses_of(alone)[:3] == ["ok", "crc_fail", "crc_fail"]
    words = decode_per_quad(event.cutouts or (), 190.0, *place, alone)
    assert words is not None
    assert statuses_of(words)[:3] == ["ok"] * 3
    assert [w.block for w in words["middle"]] == [w.block for w in event.packet.layers["middle"]]


CUTOUT = Cutout(np.zeros((9, 9)), np.zeros((9, 9)), (0, 0), (Pose(4.0, 4.0, 1.0, 0.0, 0.5),))


def test_missing_pairs_are_erased() -> None:
    form = PacketFormat(link("signal.data_pairs=24").signal)
    words = decode_per_quad([CUTOUT, *[None] * 23], 100.0, form, 0, Decoding())
    assert set(statuses_of(words)) == {"crc_fail"}


@pytest.mark.parametrize(
    "form", [PacketFormat(link().signal, Format(mode="single")), PacketFormat(link("signal.modulation=ook").signal)]
)
def test_only_the_hierarchical_code_with_inverses_is_decoded(form: PacketFormat) -> None:
    assert decode_per_quad([CUTOUT] * form.settings.data_pairs, 100.0, form, 0, Decoding()) is None
