"""Message segmentation and reassembly in any order."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.signal.block import MAX_MESSAGE, MAX_SEGMENTS, Block
from heliograph.signal.message import Carousel, Message, Reassembler, segments

messages = st.builds(
    Message,
    identity=st.integers(0, 29),
    layer=st.sampled_from(["high", "middle", "low"]),
    stream=st.integers(0, 255),
    data=st.binary(min_size=1, max_size=60),
)


def received(blocks: list[Block], reassembler: Reassembler | None = None) -> list[Message]:
    reassembler = reassembler or Reassembler()
    found = [reassembler.add(block) for block in blocks]
    return [message for message in found if message is not None]


@examples(40)
@given(st.lists(messages, max_size=6, unique_by=lambda m: (m.identity, m.layer, m.stream)), st.integers(1, 20),
       st.randoms(use_true_random=False))  # fmt: skip
def test_any_order_with_repeats(sent: list[Message], room: int, random: Random) -> None:
    """Interleaved messages from several arrays, layers and streams each appear exactly once."""
    blocks = [block for message in sent for block in segments(message, room)]
    blocks += random.choices(blocks, k=len(blocks)) if blocks else []
    random.shuffle(blocks)
    found = received(blocks)
    assert len(found) == len(sent)
    assert set(found) == set(sent)


@examples(40)
@given(messages, st.integers(1, 20))
def test_segments(message: Message, room: int) -> None:
    blocks = segments(message, room)
    assert len(blocks) == -(-len(message.data) // room)
    assert b"".join(block.payload for block in blocks) == message.data
    assert [block.sequence for block in blocks] == list(range(len(blocks)))
    assert all(len(block.payload) == room for block in blocks[:-1])
    assert {(b.identity, b.layer, b.stream, b.length) for b in blocks} == {
        (message.identity, message.layer, message.stream, len(message.data))
    }


@examples(40)
@given(messages, st.integers(1, 20), st.data())
def test_a_missing_segment_keeps_the_message_open(message: Message, room: int, data: st.DataObject) -> None:
    blocks = segments(message, room)
    missing = data.draw(st.integers(0, len(blocks) - 1))
    rest = blocks[:missing] + blocks[missing + 1 :]
    reassembler = Reassembler()
    assert received(rest * 3, reassembler) == []
    had = len(message.data) - len(blocks[missing].payload)
    key = (message.identity, message.layer, message.stream, had, len(message.data))
    assert reassembler.unfinished() == ([key] if rest else [])
    assert received([blocks[missing]], reassembler) == [message]
    assert reassembler.unfinished() == []


@pytest.mark.parametrize("text", [b"green after that", b"green light now", b"red until 13:30"])
def test_a_number_that_has_come_round(text: bytes) -> None:
    """After 256 messages a number repeats, with a different or equal message."""
    old, new = Message(0, "high", 4, b"red until 12:00"), Message(0, "high", 4, text)
    reassembler = Reassembler()
    assert received(segments(old, 4) * 2, reassembler) == [old]
    assert received(segments(new, 4) * 3, reassembler) == [new]
    assert received(segments(old, 4) * 3, reassembler) == [old]


def test_a_segment_that_contradicts_starts_the_message_anew() -> None:
    old, new = segments(Message(0, "low", 0, b"aabbcc"), 2), segments(Message(0, "low", 0, b"xxyyzz"), 2)
    assert received([old[0], old[1], new[0], new[1], new[2]]) == [Message(0, "low", 0, b"xxyyzz")]


def test_idle_blocks_carry_nothing() -> None:
    idle = segments(Message(0, "low", 0, b""), 10)
    assert idle == [Block("low", 0, 0, 0, 0, b"")]
    reassembler = Reassembler()
    assert received(idle * 3, reassembler) == []
    assert reassembler.unfinished() == []


def test_a_segment_beyond_the_end_is_no_harm() -> None:
    message = Message(0, "low", 0, b"abcd")
    assert received([Block("low", 0, 0, 7, 4, b""), *segments(message, 2)]) == [message]


@pytest.mark.slow
def test_longest_messages() -> None:
    assert len(segments(Message(0, "high", 0, bytes(3 * MAX_SEGMENTS)), 3)) == MAX_SEGMENTS
    with pytest.raises(ValueError, match="at most 196608 bytes, not 196609"):
        segments(Message(0, "high", 0, bytes(3 * MAX_SEGMENTS + 1)), 3)
    assert len(segments(Message(0, "high", 0, bytes(MAX_MESSAGE)), 700)) == 23968
    with pytest.raises(ValueError, match="at most 16777215 bytes, not 16777216"):
        segments(Message(0, "high", 0, bytes(MAX_MESSAGE + 1)), 700)


def test_carousel_goes_round_all_messages() -> None:
    carousel = Carousel(9, "middle", [b"abcde", b"", b"xyz"], 2)
    first = [carousel.block(i) for i in range(6)]
    assert [(b.stream, b.sequence, b.payload) for b in first] == [
        (0, 0, b"ab"),
        (0, 1, b"cd"),
        (0, 2, b"e"),
        (1, 0, b""),
        (2, 0, b"xy"),
        (2, 1, b"z"),
    ]
    assert [carousel.block(i) for i in range(600, 606)] == first
    assert {(b.identity, b.layer) for b in first} == {(9, "middle")}


def test_carousel_without_messages_is_idle() -> None:
    assert Carousel(0, "low", [], 2).block(12345) == Block("low", 0, 0, 0, 0, b"")


def test_carousel_has_256_numbers() -> None:
    assert Carousel(0, "low", [b"a"] * 256, 2).block(255).stream == 255
    with pytest.raises(ValueError, match="at most 256 messages, not 257"):
        Carousel(0, "low", [b"a"] * 257, 2)


def test_cuts_of_different_size_do_not_mix() -> None:
    message = Message(0, "low", 3, bytes(range(50)))
    reassembler = Reassembler()
    # segments with different sizes must not be combined
    halves = [segments(message, 10)[:3], segments(message, 20)[:2]]
    for room, blocks in zip((10, 20), halves, strict=True):
        assert [reassembler.add(block, room) for block in blocks] == [None] * len(blocks)
    assert reassembler.add(segments(message, 20)[2], 20) == message
    # already delivered: completing the other segmentation gives no duplicate
    assert [reassembler.add(block, 10) for block in segments(message, 10)] == [None] * 5
    # a reused number with new content is delivered
    other = Message(0, "low", 3, bytes(50))
    assert [reassembler.add(block, 10) for block in segments(other, 10)][-1] == other
