"""Transmitter: endless, on time, decodable from any packet on."""

from itertools import islice, pairwise

import numpy as np
import pytest

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.signal.block import Block
from heliograph.signal.formats import Format
from heliograph.signal.header import header_levels
from heliograph.signal.message import Message, Reassembler, Updates
from heliograph.signal.settings import LAYERS, RateSettings, SignalSettings
from heliograph.transmit import Content, TransmitSettings, Transmitter

SMALL = SignalSettings(side=8, header_pairs=2, data_pairs=21, pattern_period_s=2e-3)
MESSAGES = {"high": [b"stop line in 40 m", b"red, 12 s left"], "low": [bytes(range(256))]}


def segments(sender: Transmitter, packet: int, layer: str) -> list[Block]:
    return [block for block in sender.blocks(packet)[layer] if isinstance(block, Block)]


def test_patterns_are_on_time_with_part_and_inverse() -> None:
    shown, lit = list(islice(Transmitter(SMALL, 0, MESSAGES).patterns(), 3 * 46 + 5)), header_levels(0, 8)
    assert [p.index for p in shown] == list(range(len(shown)))
    # multiplied, not accumulated, so a long transmission does not drift
    assert [p.time_s for p in shown] == [i * 2e-3 for i in range(len(shown))]
    for p in shown:
        assert (p.levels.shape, p.part) == ((8, 8), "header" if p.index % 46 < 4 else "data")
        assert p.levels.dtype == np.uint8
        assert p.inverted == bool(p.index % 2)
        if p.part == "header":
            assert np.array_equal(p.levels, 4 - lit if p.inverted else lit)
    for first, second in pairwise(shown):
        if second.inverted:
            assert np.all(first.levels + second.levels == 4)


def test_packets_levels_patterns_and_single_packets_agree() -> None:
    sender = Transmitter(SMALL, 3, MESSAGES)
    packets = list(islice(sender.packets(), 12))
    levels = np.concatenate(packets)
    assert np.array_equal(levels, list(islice(sender.levels(), len(levels))))
    assert np.array_equal(levels, [p.levels for p in islice(sender.patterns(), len(levels))])
    for number in (11, 0, 5):
        assert np.array_equal(sender.format.patterns(3, sender.blocks(number)), packets[number])


def test_blocks_bring_the_messages_from_any_packet_on() -> None:
    settings = SignalSettings(side=8, data_pairs=21, rate=RateSettings(high=0.5, middle=0.5, low=0.5))
    sender = Transmitter(settings, 3, MESSAGES)
    for start in (0, 1, 1000):
        reassembler = Reassembler()
        blocks = [b for p in range(start, start + 80) for layer in LAYERS for b in segments(sender, p, layer)]
        found = {m for m in map(reassembler.add, blocks) if m is not None}
        sent = {Message(3, layer, i, data) for layer in MESSAGES for i, data in enumerate(MESSAGES[layer])}
        assert found == sent


def test_every_size_of_block_brings_the_messages() -> None:
    """Segment numbers count sent segments of the same size, so each segment is sent eventually."""
    sender = Transmitter(SMALL, 3, MESSAGES, (Format(low=0.9), Format(), Format(low=0.9), Format(low=0.5)))
    by_size: dict[int, list[int]] = {}
    for packet in range(40):
        room = sender.format_of(packet).layers["low"].payload_bytes
        by_size.setdefault(room, []).extend(b.sequence for b in segments(sender, packet, "low"))
    assert len(by_size) == 3
    for room, found in by_size.items():
        count = -(-256 // room)
        assert found == [i % count for i in range(len(found))]


@pytest.mark.parametrize(("settings", "identity", "messages", "message"), [
    (SMALL, 0, {"top": [b""]}, "layers are high, middle, low, not top"),
    (SMALL, 30, {}, "identity is a whole number, 0 to 29, not 30"),
    (SignalSettings(side=8, data_pairs=20), 0, {"high": [bytes(65537)]}, "at most 65536 bytes, not 65537"),
    (SignalSettings(side=4, data_pairs=10), 0, {}, r"raise signal\.data_pairs"),
    (SMALL, 3, {"high": [Updates(())]}, "in order"),
    (SMALL, 3, {"high": [Updates(((1.0, b"b"), (0.0, b"a")))]}, "in order"),
    (SMALL, 3, {"high": [Updates(((0.0, "text"),))]}, "in order"),  # type: ignore[arg-type]
])  # fmt: skip
def test_invalid_arguments_are_refused(
    settings: SignalSettings, identity: int, messages: dict[str, list[Content]], message: str
) -> None:
    with pytest.raises(SettingsError, match=message):
        Transmitter(settings, identity, messages)


def test_settings() -> None:
    assert TransmitSettings().identities == (0,)
    assert from_mapping(TransmitSettings, {"identities": [0, 29]}).identities == (0, 29)
    for wrong in (-1, 30):
        with pytest.raises(SettingsError, match="identities"):
            from_mapping(TransmitSettings, {"identities": [wrong]})


def test_a_message_that_changes_has_a_stream_number_for_each_content() -> None:
    """A packet carries the newest content at packet start; other messages keep their stream numbers."""
    times = [(0.1 * k, k.to_bytes(2, "big")) for k in range(700)]
    sender = Transmitter(SMALL, 3, {"high": [b"42", Updates(tuple(times))]})
    room, reassembler = sender.format.layers["high"].payload_bytes, Reassembler()
    assert room == 2  # each content fits a block, sent in every second packet
    newest = {}
    for packet in range(700):
        for block in segments(sender, packet, "high"):
            message = reassembler.add(block, room)
            if message is not None and message.stream:
                newest[packet] = message
    for packet, message in newest.items():
        number = int((packet * SMALL.packet_s + 1e-7) / 0.1)
        assert (message.stream, message.data) == (1 + number % 255, times[number][1])
    assert len(newest) == len({m.data for m in newest.values()}) > 300  # more contents than stream numbers
