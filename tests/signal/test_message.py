"""Message segmentation and reassembly in any order."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.signal.block import MAX_MESSAGE, MAX_SEGMENTS, Block
from heliograph.signal.message import Carousel, Message, Reassembler, segments
from heliograph.signal.settings import LAYERS

messages = st.builds(
    Message, st.integers(0, 29), st.sampled_from(LAYERS), st.integers(0, 255), st.binary(min_size=1, max_size=60)
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
    assert (len(found), set(found)) == (len(sent), set(sent))


@examples(40)
@given(messages, st.integers(1, 20))
def test_segments(message: Message, room: int) -> None:
    blocks = segments(message, room)
    assert (len(blocks), b"".join(block.payload for block in blocks)) == (-(-len(message.data) // room), message.data)
    assert [block.sequence for block in blocks] == list(range(len(blocks)))
    assert all(len(block.payload) == room for block in blocks[:-1])
    (told,) = {(b.identity, b.layer, b.stream, b.length) for b in blocks}
    assert told == (message.identity, message.layer, message.stream, len(message.data))


@examples(40)
@given(messages, st.integers(1, 20), st.data())
def test_a_missing_segment_keeps_the_message_open(message: Message, room: int, data: st.DataObject) -> None:
    blocks = segments(message, room)
    missing = data.draw(st.integers(0, len(blocks) - 1))
    rest, reassembler = blocks[:missing] + blocks[missing + 1 :], Reassembler()
    assert received(rest * 3, reassembler) == []
    had = len(message.data) - len(blocks[missing].payload)
    key = (message.identity, message.layer, message.stream, had, len(message.data))
    assert (reassembler.unfinished(), received([blocks[missing]], reassembler)) == ([key] if rest else [], [message])
    assert reassembler.unfinished() == []


@pytest.mark.parametrize("text", [b"green after that", b"green light now", b"red until 13:30"])
def test_a_number_that_has_come_round(text: bytes) -> None:
    """After 256 messages a number repeats, with a different or equal message."""
    old, new = Message(0, "high", 4, b"red until 12:00"), Message(0, "high", 4, text)
    reassembler = Reassembler()
    assert (received(segments(old, 4) * 2, reassembler), received(segments(new, 4) * 3, reassembler)) == ([old], [new])
    assert received(segments(old, 4) * 3, reassembler) == [old]


def test_segments_that_contradict_or_exceed_a_message_are_no_harm() -> None:
    old, new = segments(Message(0, "low", 0, b"aabbcc"), 2), segments(Message(0, "low", 0, b"xxyyzz"), 2)
    assert received([old[0], old[1], new[0], new[1], new[2]]) == [Message(0, "low", 0, b"xxyyzz")]
    message = Message(0, "low", 0, b"abcd")
    assert received([Block("low", 0, 0, 7, 4, b""), *segments(message, 2)]) == [message]


def test_idle_blocks_carry_nothing() -> None:
    idle = segments(Message(0, "low", 0, b""), 10)
    assert idle == [Block("low", 0, 0, 0, 0, b"")]
    reassembler = Reassembler()
    assert (received(idle * 3, reassembler), reassembler.unfinished()) == ([], [])
    assert Carousel(0, "low", [], 2).block(12345) == Block("low", 0, 0, 0, 0, b"")


@pytest.mark.slow
def test_longest_messages() -> None:
    assert len(segments(Message(0, "high", 0, bytes(3 * MAX_SEGMENTS)), 3)) == MAX_SEGMENTS
    with pytest.raises(ValueError, match="at most 196608 bytes, not 196609"):
        segments(Message(0, "high", 0, bytes(3 * MAX_SEGMENTS + 1)), 3)
    assert len(segments(Message(0, "high", 0, bytes(MAX_MESSAGE)), 700)) == 23968
    with pytest.raises(ValueError, match="at most 16777215 bytes, not 16777216"):
        segments(Message(0, "high", 0, bytes(MAX_MESSAGE + 1)), 700)


def test_carousel_goes_round_all_of_at_most_256_messages() -> None:
    carousel = Carousel(9, "middle", [b"abcde", b"", b"xyz"], 2)
    first = [carousel.block(i) for i in range(6)]
    assert [b.payload for b in first] == [b"ab", b"cd", b"e", b"", b"xy", b"z"]
    assert [(b.stream, b.sequence) for b in first] == [(0, 0), (0, 1), (0, 2), (1, 0), (2, 0), (2, 1)]
    assert [carousel.block(i) for i in range(600, 606)] == first
    assert {(b.identity, b.layer) for b in first} == {(9, "middle")}
    assert Carousel(0, "low", [b"a"] * 256, 2).block(255).stream == 255
    with pytest.raises(ValueError, match="at most 256 messages, not 257"):
        Carousel(0, "low", [b"a"] * 257, 2)


def test_cuts_of_different_size_do_not_mix() -> None:
    message, reassembler = Message(0, "low", 3, bytes(range(50))), Reassembler()
    # segments with different sizes must not be combined
    halves = [segments(message, 10)[:3], segments(message, 20)[:2]]
    for room, blocks in zip((10, 20), halves, strict=True):
        assert [reassembler.add(block, room) for block in blocks] == [None] * len(blocks)
    assert reassembler.add(segments(message, 20)[2], 20) == message
    # already delivered: completing the other segmentation gives no duplicate
    assert [reassembler.add(block, 10) for block in segments(message, 10)] == [None] * 5
    other = Message(0, "low", 3, bytes(50))  # a reused number with new content is delivered
    assert [reassembler.add(block, 10) for block in segments(other, 10)][-1] == other
