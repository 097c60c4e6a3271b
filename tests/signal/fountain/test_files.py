"""File reassembly from fountain symbols: any order and start, losses, invalid symbols, joined receptions."""

import importlib.util
import random
import zlib
from collections.abc import Sequence
from dataclasses import replace

import pytest

from heliograph.base.errors import SettingsError
from heliograph.measure.statistics import Count
from heliograph.signal.block import AnyFileBlock, FileBlock, FileNotice, SymbolBlock, pack, unpack
from heliograph.signal.formats import Format
from heliograph.signal.fountain import cauchy
from heliograph.signal.fountain.codes import CodeName
from heliograph.signal.fountain.files import FileGatherer, FileProgress, SentFile, WholeFile
from heliograph.signal.settings import LAYERS, SignalSettings
from heliograph.transmit import Content, Transmitter

PICTURE = SentFile("crossing.jpg", random.Random(20).randbytes(20_000))
CODES: list[CodeName] = ["cauchy"]
if importlib.util.find_spec("raptorq"):
    CODES.append("raptorq")


def file_blocks(sender: Transmitter, packets: range, *layers: str) -> list[FileBlock]:
    blocks = [sender.blocks(packet)[layer] for packet in packets for layer in layers or LAYERS]
    return [block for listed in blocks for block in listed if isinstance(block, FileBlock)]


def sent(file: SentFile, packets: range, layers: tuple[str, ...] = ("low",), identity: int = 3) -> list[FileBlock]:
    return file_blocks(Transmitter(SignalSettings(), identity, {layer: [file] for layer in layers}), packets)


def gathered(blocks: Sequence[AnyFileBlock], files: FileGatherer | None = None) -> FileProgress | None:
    """Return the last progress, at most until the file is complete."""
    files, last = files or FileGatherer(), None
    for block in blocks:
        last = files.add(block) or last
        if last is not None and last.whole is not None:
            return last
    return last


def whole_of(progress: FileProgress | None) -> WholeFile:
    assert progress is not None
    assert progress.whole is not None
    return progress.whole


@pytest.mark.slow
@pytest.mark.parametrize("code", CODES)
def test_a_picture_of_20_kb_arrives_with_a_fifth_of_its_packets_lost(code: CodeName) -> None:
    """All 40 seeded receptions succeed, with random start and order, over one to three layers."""
    file, failed, extra = replace(PICTURE, code=code), Count(), []
    for seed in range(40):
        rng = random.Random(seed)
        layers = (("low",), ("middle",), ("middle", "low"), ("high", "middle", "low"))[seed % 4]
        start = rng.randrange(3000 if code == "cauchy" else 400)
        blocks = sent(file, range(start, start + 300 // len(layers)), layers)
        blocks = [block for block in blocks if rng.random() >= 0.2]
        rng.shuffle(blocks)
        found = gathered(blocks)
        whole = found is not None and found.whole is not None and found.whole.data == file.data
        failed.add(1, not whole)
        if found is not None:
            extra.append(found.had - found.key.count)
    assert failed.errors == 0, failed.text()
    assert failed.interval()[1] < 0.09
    # Cauchy needs any k symbols; RaptorQ needs an extra symbol with probability 1/256
    assert max(extra) <= (0 if code == "cauchy" else 2)


def test_any_symbols_that_are_as_many_as_the_files_own_are_enough() -> None:
    """100 random choices with k symbols from all 65536 decode; files have 1 to 60 symbols."""
    rng = random.Random(7)
    for _ in range(100):
        data = rng.randbytes(rng.randrange(1, 240))
        encoder = cauchy.CauchyEncoder(data, 4)
        chosen = rng.sample(range(cauchy.NUMBERS), encoder.count)
        assert cauchy.decode({n: encoder.symbol(n) for n in chosen}, encoder.count)[: len(data)] == data


def test_progress_starts_with_the_first_symbol_and_receptions_are_joined() -> None:
    """Two incomplete receptions from two arrays, with repeated symbols."""
    first, second = sent(PICTURE, range(100)), sent(PICTURE, range(5000, 5095), identity=9)
    files = FileGatherer()
    told = [files.add(block) for block in first]
    assert [one.had for one in told if one is not None] == list(range(1, 101))
    assert told[0] is not None
    assert told[0].key.count == -(-(20_000 + 1 + len(PICTURE.name)) // 108)
    assert files.add(first[0]) is None
    assert whole_of(gathered(second, files)) == WholeFile(PICTURE.name, PICTURE.data)
    assert files.add(first[5]) is None
    assert list(files.unfinished()) == []


def test_file_restarts_after_a_wrong_symbol_with_a_valid_crc() -> None:
    blocks = sent(PICTURE, range(400))
    false = replace(blocks[0], payload=bytes(len(blocks[0].payload)))
    files = FileGatherer()
    last = gathered([false, *blocks[1:186]], files)
    assert last is not None
    assert "collected again" in last.reason
    assert whole_of(gathered(blocks[186:], files)).data == PICTURE.data


def test_memory_is_bounded_whatever_comes() -> None:
    rng, files = random.Random(5), FileGatherer()
    for _ in range(2000):
        size = rng.choice([1, 2, 64, 104, 108])
        files.add(FileBlock("low", 0, rng.choice([0, 1, 7]), rng.randrange(1 << 24), rng.randrange(1, 1 << 24), size,
                            rng.randrange(1 << 32), bytes(size)))  # fmt: skip
    assert len(list(files.unfinished())) <= FileGatherer().max_open
    files = FileGatherer()
    for number in range(3000):
        files.add(SymbolBlock("low", 0, number % 256, number, bytes(8)))
    progress = files.add(FileNotice("low", 0, 8 * 4000, 0xFF << 24))
    assert progress is not None
    assert progress.had == 4  # newest 1024 symbols / 256 identifiers


def test_layers_send_different_symbols_and_files_take_turns_with_messages() -> None:
    other = SentFile("b.txt", b"short")
    contents: dict[str, list[Content]] = {"high": [b"brake", PICTURE], "middle": [PICTURE, other], "low": [PICTURE]}
    sender = Transmitter(SignalSettings(), 0, contents)
    high = [sender.blocks(packet)["high"][0] for packet in range(6)]
    assert [isinstance(block, FileBlock) for block in high] == [False, True] * 3
    checks = [block.check for block in file_blocks(sender, range(3), "middle")]
    assert checks == [zlib.crc32(one.packed) for one in (PICTURE, other)] * 3
    numbers = [block.number for block in file_blocks(sender, range(40)) if block.check == checks[0]]
    assert len(numbers) == len(set(numbers)) == 20 + 40 + 40


def test_blocks_of_different_sizes_carry_symbols_of_one_file() -> None:
    """Packets alternate between two rates; the larger block carries several symbols."""
    formats = (Format(), Format(mode="single", low=0.9))
    sender = Transmitter(SignalSettings(), 0, {"low": [PICTURE]}, formats)
    blocks = file_blocks(sender, range(90), "low")
    assert {len(block.payload) // block.size for block in blocks} == {1, 6}
    assert whole_of(gathered(blocks)).data == PICTURE.data


@pytest.mark.parametrize(("file", "settings", "word"), [
    (SentFile("x" * 256, b"1"), SignalSettings(), "at most 255 bytes"),
    (SentFile("a", bytes(200), "raptorq"), SignalSettings(side=4, data_pairs=84), "symbols"),
    (SentFile("a", bytes(4 << 20)), SignalSettings(), "too many"),
])  # fmt: skip
def test_unsendable_content_is_reported(file: SentFile, settings: SignalSettings, word: str) -> None:
    with pytest.raises(SettingsError, match=word):
        Transmitter(settings, 0, {"low": [file]})


SMALL = SignalSettings(side=8, data_pairs=13)


def small(file: SentFile, packets: range, rate: float = 2 / 3) -> list[AnyFileBlock]:
    form = Format(mode="short", high=rate, middle=rate, low=rate)
    sender = Transmitter(SMALL, 3, {layer: [file] for layer in LAYERS}, [form])
    bits = {name: layer.code.k for name, layer in sender.format.layers.items()}
    blocks = [(name, block) for packet in packets for name, by in sender.blocks(packet).items() for block in by]
    made = [unpack(pack(block, bits[name])) for name, block in blocks]
    assert all(isinstance(one, SymbolBlock | FileNotice) for one in made)
    return [one for one in made if isinstance(one, SymbolBlock | FileNotice)]


@pytest.mark.parametrize(("rate", "size"), [(1 / 2, 4), (2 / 3, 8), (3 / 4, 10), (9 / 10, 14)])
def test_small_blocks_complete_a_file_in_any_order_with_losses(rate: float, size: int) -> None:
    file = SentFile("note.txt", random.Random(7).randbytes(500))
    blocks = small(file, range(400 // size), rate)
    random.Random(1).shuffle(blocks)
    found = gathered(blocks[: 4 * len(blocks) // 5])  # 20 % loss
    assert whole_of(found) == WholeFile(file.name, file.data)
    assert {len(block.payload) for block in blocks if isinstance(block, SymbolBlock)} == {size}


def test_every_second_packet_describes_the_file_of_small_blocks() -> None:
    file = SentFile("note.txt", bytes(500))
    for first in range(12):
        blocks = small(file, range(first, first + 2))
        assert sum(isinstance(one, FileNotice) for one in blocks) == 1


def test_symbols_wait_for_the_description_of_their_file() -> None:
    one, two = (SentFile(name, random.Random(seed).randbytes(200)) for name, seed in (("a", 1), ("b", 2)))
    files = FileGatherer()
    mixed = [block for pair in zip(small(one, range(20)), small(two, range(20)), strict=True) for block in pair]
    symbols = [block for block in mixed if isinstance(block, SymbolBlock)]
    assert [files.add(block) for block in symbols] == [None] * len(symbols)
    found = [files.add(block) for block in mixed if isinstance(block, FileNotice)]
    assert [whole_of(progress).data for progress in found if progress is not None] == [one.data, two.data]
