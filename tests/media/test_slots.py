"""LED driver registers show the written slots; truncated or foreign files raise a one-line error."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from heliograph.base.errors import MediaError
from heliograph.media import open_slots
from heliograph.media.slots import HEAD, SUFFIXES, SlotForm, file_size, write_slots, write_table

Slots = NDArray[np.uint8]
KINDS = pytest.mark.parametrize("kind", SUFFIXES)


def drawn(side: int, count: int) -> Slots:
    return np.random.default_rng(count).integers(0, 2, (count, side, side), np.uint8)


def wrote(path: Path, slots: Slots, slot_ns: int = 250_000) -> SlotForm:
    form = SlotForm(slots.shape[1], 4, slot_ns, len(slots))
    write_slots(path, slots, form)
    return form


@KINDS
@given(side=st.integers(1, 16).map(lambda n: 4 * n), count=st.integers(0, 9), slot_ns=st.integers(1, 2**32 - 1))
@examples(15)
def test_written_slots_are_read(
    kind: str, side: int, count: int, slot_ns: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path, slots = tmp_path_factory.mktemp("slots") / f"a{kind}", drawn(side, count)
    form = wrote(path, slots, slot_ns)
    read = open_slots(str(path))
    assert read.form == form
    for _ in range(2):
        assert np.array_equal(np.array(list(read)).reshape(slots.shape), slots)
    assert path.stat().st_size == file_size(path, form)


def body(path: Path) -> bytes:
    return path.read_bytes()[HEAD.size :]


def bits(data: bytes) -> list[int]:
    return [byte >> place & 1 for byte in data for place in range(7, -1, -1)]


def test_a_chain_of_registers_shows_the_slots(tmp_path: Path) -> None:
    """Simulate shift registers bit by bit, latched after each slot."""
    slots, path = drawn(12, 5), tmp_path / "a.shift"
    form = wrote(path, slots)
    size = HEAD.unpack(path.read_bytes()[: HEAD.size])[5]
    shown, chain = [], [0] * 144
    for start in range(0, form.count * size, size):
        for bit in bits(body(path)[start : start + size]):
            chain = [bit, *chain[:-1]]  # the first output of the first register receives the bit
        shown.append(list(chain))
    assert np.array_equal(np.reshape(shown, slots.shape), slots)


def test_a_row_scan_shows_the_slots(tmp_path: Path) -> None:
    """A byte holds a column, leftmost first; each address latches two rows, half a panel apart."""
    slots, path = drawn(16, 5), tmp_path / "a.hub75"
    wrote(path, slots)
    data = np.frombuffer(body(path), np.uint8).reshape(5, 8, 1 + 16)
    assert (data[..., 0] == np.arange(8)).all()
    columns = data[..., 1:]
    assert (columns >> 6 == 0).all()
    for colour in range(3):
        assert (columns >> colour & 1 == slots[:, :8]).all()
        assert (columns >> 3 + colour & 1 == slots[:, 8:]).all()


def test_bit_planes_are_rows_from_the_upper_left(tmp_path: Path) -> None:
    slots, path = drawn(8, 3), tmp_path / "a.bits"
    wrote(path, slots)
    assert bits(body(path)) == slots.ravel().tolist()
    head = (b"HGBITS1\n", 8, 4, 250_000, 3, 8, 0)
    assert HEAD.unpack(path.read_bytes()[: HEAD.size]) == head


def test_a_c_header_has_the_bytes_of_the_bit_planes(tmp_path: Path) -> None:
    slots = drawn(16, 3)
    for name in ("a.bits", "a.h"):
        wrote(tmp_path / name, slots)
    text = (tmp_path / "a.h").read_text()
    assert "#define HELIOGRAPH_SLOT_NS 250000u\n" in text
    numbers = text.partition("{")[2].partition("}")[0].replace(",", " ").split()
    assert bytes(int(one, 16) for one in numbers) == body(tmp_path / "a.bits")


@KINDS
@given(where=st.floats(0, 1, exclude_max=True))
@examples(25)
def test_truncated_file_gives_its_complete_slots(
    kind: str, where: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path, slots = tmp_path_factory.mktemp("cut") / f"a{kind}", drawn(8, 6)
    wrote(path, slots)
    whole, read = path.read_bytes(), list[Slots]()
    path.write_bytes(whole[: int(where * len(whole))])
    with pytest.raises(MediaError, match="heliograph transmit"):
        read.extend(open_slots(path))
    assert np.array_equal(np.array(read).reshape(-1, 8, 8), slots[: len(read)])


@KINDS
@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n" + bytes(99), b"#include <math.h>\n" * 99, b"\xff" * 99])
def test_a_foreign_file_is_one_line(kind: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"a{kind}"
    path.write_bytes(content)
    with pytest.raises(MediaError, match=rf"a{kind} is no {kind} file of LED patterns"):
        open_slots(path)


@KINDS
def test_a_file_with_more_than_its_slots_is_refused(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{kind}"
    wrote(path, drawn(8, 6))
    whole = path.read_bytes()
    fewer = [whole.replace(b"SLOTS 6u", b"SLOTS 5u")] if kind == ".h" else [whole * 2]
    for longer in [*fewer, whole + b"\n"]:
        path.write_bytes(longer)
        with pytest.raises(MediaError, match=r"does not end after its|damaged"):
            list(open_slots(path))


def test_rows_of_another_order_are_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.hub75"
    wrote(path, drawn(8, 3))
    path.write_bytes(path.read_bytes()[:-9] + bytes([7]) + path.read_bytes()[-8:])
    with pytest.raises(MediaError, match=r"slot 2 of .* is damaged: its rows do not come in the order"):
        list(open_slots(path))


@KINDS
@pytest.mark.parametrize("count", [2, 4])
def test_wrong_number_of_slots_leaves_no_file(kind: str, count: int, tmp_path: Path) -> None:
    with pytest.raises(MediaError, match=f"takes 3 slots, not {count}"):
        write_slots(tmp_path / f"a{kind}", drawn(8, count), SlotForm(8, 4, 250_000, 3))
    assert not list(tmp_path.iterdir())


def test_a_period_is_rounded_to_ns_and_no_further() -> None:
    assert SlotForm.of(16, 4, 1 / 12_000, 9).slot_ns == 83_333
    with pytest.raises(MediaError, match=r"250.25 ns is no whole number of ns"):
        SlotForm.of(16, 4, 250.25e-9, 9)


@pytest.mark.parametrize(("what", "says"), [
    (None, "text or a pathlib.Path, not NoneType"), ("none.bits", "there is no file"), (".", "end in one of"),
    ("a.mkv", "end in one of .bits, .hub75, .shift, .h, .csv, not '.mkv'"),
])  # fmt: skip
def test_other_files_than_slots_are_one_line(what: str, says: str) -> None:
    with pytest.raises(MediaError, match=says):
        open_slots(what)


@given(side=st.integers(1, 8).map(lambda n: 4 * n), count=st.integers(2, 9), slots=st.booleans())
@examples(20)
def test_a_table_of_text_is_read_as_it_was_written(
    side: int, count: int, slots: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path, most = tmp_path_factory.mktemp("table") / "a.csv", 1 if slots else 4
    sent = np.random.default_rng(count).integers(0, most + 1, (count, side, side), np.uint8)
    write_table(path, sent, side, 2.5e-4, slots)
    read = open_slots(path)
    assert read.form == SlotForm(side, 4 if slots else 1, 250_000, count)
    assert np.array_equal(list(read), sent)
    levels = sent[: count // 4 * 4].reshape(-1, 4, side, side).sum(1) if slots else sent
    assert np.array_equal(np.array(list(read.levels())).reshape(levels.shape), levels)


ROW = "0," + "1," * 15 + "1\n"
TABLE = "slot_s," + ",".join(f"led_{u}_{v}" for u in range(4) for v in range(4)) + "\n" + ROW


@pytest.mark.parametrize(("text", "says"), [
    ("", "is no .csv file of LED patterns"), ("t,a\n0,1\n1,2\n", "is no .csv file of LED patterns"),
    (TABLE, "is no .csv file of LED patterns"),  # a single line has no period
    (TABLE + "0.001," + "1," * 9, "line 3 of .*a.csv is cut or damaged"),
    (TABLE + "0.001," + "1," * 15 + "2\n", "line 3 of .*a.csv is cut or damaged"),
    (TABLE + ("0.001," + "1," * 15 + "1\n") * 2, "line 4 of .*a.csv is late or early"),
])  # fmt: skip
def test_a_foreign_or_damaged_table_is_one_line(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(MediaError, match=says):
        list(open_slots(tmp_path / "a.csv"))
