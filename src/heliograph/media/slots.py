"""LED patterns on or off by slot, in the files of LED drivers: .bits, .hub75, .shift, .csv and C headers."""

import os
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, shown
from heliograph.base.files import whole_file
from heliograph.media import c_header, slot_table
from heliograph.signal import pwm

RGB = 0b111
"""An LED that is on is white on a panel of three colours: R, G and B. Who wants one colour masks the others out."""

LOWER = 3
"""Place of R2 in a byte of a row scan: R1, G1, B1, R2, G2, B2 are bits 0 to 5."""

Slot = NDArray[np.uint8]
"""(n, n) LEDs of a slot, 1 on and 0 off, row by row as the camera sees them."""


@dataclass(frozen=True)
class Layout:
    """How the LEDs of a slot lie in the bytes of a file."""

    # First 8 bytes of such a file; the last but one is the layout's version
    signature: bytes
    # Bytes of a slot by the LEDs of a side
    size: Callable[[int], int]
    # Bytes of a slot
    pack: Callable[[Slot], bytes]
    # The slot of such bytes and the LEDs of a side; a ValueError where no slot has them
    unpack: Callable[[bytes, int], Slot]


def _plane_size(side: int) -> int:
    return side * side // 8


def _plane(slot: Slot) -> bytes:
    return np.packbits(slot).tobytes()


def _from_plane(data: bytes, side: int) -> Slot:
    return np.unpackbits(np.frombuffer(data, np.uint8)).reshape(side, side)


def _chain(slot: Slot) -> bytes:
    # what is shifted in first ends at the far end of the chain
    return np.packbits(slot.ravel()[::-1]).tobytes()


def _from_chain(data: bytes, side: int) -> Slot:
    return np.unpackbits(np.frombuffer(data, np.uint8))[::-1].reshape(side, side).copy()


def _scan_size(side: int) -> int:
    return side // 2 * (1 + side)


def _scan(slot: Slot) -> bytes:
    half = len(slot) // 2
    out = np.empty((half, 1 + len(slot)), np.uint8)
    out[:, 0] = np.arange(half)
    out[:, 1:] = RGB * slot[:half] | RGB * slot[half:] << LOWER
    return out.tobytes()


def _from_scan(data: bytes, side: int) -> Slot:
    rows = np.frombuffer(data, np.uint8).reshape(side // 2, 1 + side)
    if (rows[:, 0] != np.arange(side // 2)).any():
        raise ValueError("its rows do not come in the order of their addresses")
    lit = np.concatenate([rows[:, 1:] & RGB, rows[:, 1:] >> LOWER])
    if not np.isin(lit, (0, RGB)).all():
        raise ValueError("R, G and B of an LED differ")
    return lit // RGB


LAYOUTS = {
    ".bits": Layout(b"HGBITS1\n", _plane_size, _plane, _from_plane),
    ".hub75": Layout(b"HGHUBS1\n", _scan_size, _scan, _from_scan),
    ".shift": Layout(b"HGSHFT1\n", _plane_size, _chain, _from_chain),
}
"""Layouts of binary files by suffix. A C header has the bytes of ".bits"."""


C_HEADER = ".h"
SUFFIXES = (*LAYOUTS, C_HEADER)
"""Suffixes of the files that drivers take."""

READ = (*SUFFIXES, slot_table.SUFFIX)
"""Suffixes of the files that are read: a table of text, too."""

HEAD = struct.Struct("<8sHHIQII")
"""Start of a binary file."""

SIDES = range(4, 65, 4)
"""LEDs of a side, those of ``signal.side``."""

ROUNDING = 1e-4
"""Largest share of a slot's period by which whole ns may change it: the tolerance of section 3 of the air interface."""

BLOCK = 1 << 16
"""Bytes read at a time, or one slot where it is longer."""


@dataclass(frozen=True, slots=True)
class SlotForm:
    """What a file says of its slots.

    Attributes
    ----------
    side
        LEDs in a row and in a column, 4 to 64 in steps of 4.
    slots_per_pattern
        Slots of a pattern, 1 or more.
    slot_ns
        Period of a slot in ns, 1 to 2^32 - 1.
    count
        Slots of the file, 0 or more.
    """

    side: int
    slots_per_pattern: int
    slot_ns: int
    count: int

    @classmethod
    def of(cls, side: int, slots_per_pattern: int, slot_s: float, count: int) -> "SlotForm":
        """Return the form of slots of a period in s.

        Parameters
        ----------
        side
            LEDs in a row and in a column.
        slots_per_pattern
            Slots of a pattern, 1 or more.
        slot_s
            Period of a slot in s, above 0.
        count
            Number of slots, 0 or more.

        Raises
        ------
        MediaError
            The period is too far from a whole number of ns.
        """
        slot_ns = round(slot_s * 1e9)
        if abs(slot_ns - slot_s * 1e9) > ROUNDING * slot_s * 1e9:
            raise MediaError(
                f"a slot of {slot_s * 1e9:.7g} ns is no whole number of ns, in which drivers are told of it: change "
                f"signal.pattern_period_s, {slots_per_pattern} slots"
            )
        return cls(side, slots_per_pattern, slot_ns, count)


def file_size(path: Path, form: SlotForm) -> int:
    """Return the length of a file of slots in bytes."""
    kind = path.suffix.lower()
    size = _layout(kind).size(form.side)
    if kind == C_HEADER:
        return len(c_header.head(_values(form, size))) + form.count * c_header.row_size(size) + len(c_header.END)
    return HEAD.size + form.count * size


def write_slots(path: Path, slots: Iterable[NDArray[np.uint8]], form: SlotForm) -> None:
    """Write a file of slots, whole or not at all."""
    kind = path.suffix.lower()
    layout = _layout(kind)
    size, written = layout.size(form.side), 0
    with whole_file(path) as partial, partial.open("wb") as file:
        text = kind == C_HEADER
        file.write(c_header.head(_values(form, size)).encode() if text else _head(layout, form))
        for slot in slots:
            if slot.shape != (form.side, form.side):
                raise MediaError(f"{path} takes slots of shape ({form.side}, {form.side}), not {slot.shape}")
            data = layout.pack(slot)
            file.write(c_header.row(data).encode() if text else data)
            written += 1
        if written != form.count:
            raise MediaError(f"{path} takes {form.count} slots, not {written}")
        if text:
            file.write(c_header.END.encode())


class SlotFile:
    """LED patterns in a file that a driver takes; made by `open_slots`.

    Iterating gives each slot as (n, n) uint8, 1 for an LED that is on, as often as it is done. A table of levels has
    one slot a pattern, with levels of 0 to 4.

    Parameters
    ----------
    path
        The file, whose suffix tells its kind.
    form
        What it says of its slots.

    Attributes
    ----------
    path
        The file that is read.
    form
        LEDs of a side, slots of a pattern, period of a slot in ns, number of slots.
    """

    def __init__(self, path: Path, form: SlotForm) -> None:
        self.path = path
        self.form = form

    def __iter__(self) -> Iterator[Slot]:
        """Yield the slots in the order of time; a MediaError where the file is cut or damaged, after the whole ones."""
        if self.path.suffix.lower() == slot_table.SUFFIX:
            yield from self._lines()
            return
        layout, count, number = _layout(self.path.suffix.lower()), self.form.count, 0
        try:
            for data in self._slots(layout):
                if number == count:
                    raise _longer(self.path, count)
                yield layout.unpack(data, self.form.side)
                number += 1
            size = self.path.stat().st_size
        except OSError as error:
            raise error if isinstance(error, MediaError) else _unreadable(self.path, error) from None
        except ValueError as error:  # MediaError is none
            raise MediaError(f"slot {number} of {self.path} is damaged: {error}; {_AGAIN}") from None
        if number < count:
            raise MediaError(f"{self.path} ends after {number} of its {count} slots; {_AGAIN}")
        if size > file_size(self.path, self.form):
            raise _longer(self.path, count)

    def levels(self) -> Iterator[NDArray[np.uint8]]:
        """Yield the patterns: (n, n) uint8, the slots of each in which an LED is on."""
        total, held = np.zeros((self.form.side, self.form.side), np.uint8), 0
        for slot in self:
            total, held = total + slot, held + 1
            if held == self.form.slots_per_pattern:
                yield total
                total, held = np.zeros_like(total), 0

    def _lines(self) -> Iterator[Slot]:
        form = self.form
        try:
            yield from slot_table.rows(self.path, form.side, form.slots_per_pattern > 1, form.slot_ns * 1e-9)
        except OSError as error:
            raise error if isinstance(error, MediaError) else _unreadable(self.path, error) from None

    def _slots(self, layout: Layout) -> Iterator[bytes]:
        size = layout.size(self.form.side)
        if self.path.suffix.lower() == C_HEADER:
            yield from c_header.rows(self.path, size)
            return
        with self.path.open("rb") as file:
            file.seek(HEAD.size)
            while block := file.read(max(1, BLOCK // size) * size):
                # the last slot of a file that is cut is left out
                yield from (block[start : start + size] for start in range(0, len(block) // size * size, size))


def open_slots(path: str | os.PathLike[str]) -> SlotFile:
    """Open LED patterns that `heliograph transmit` wrote for a driver: .bits, .hub75, .shift, a C header, or .csv.

    Parameters
    ----------
    path
        The file; its suffix tells its kind.

    Raises
    ------
    MediaError
        There is no such file, it is of another kind or damaged. A file that is cut is told of while iterating, after
        the slots that are whole.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise MediaError(f"the path of slots is text or a pathlib.Path, not {shown(path)}")
    file = Path(path)
    if file.suffix.lower() not in READ:
        raise MediaError(f"slots are in files that end in one of {', '.join(READ)}, not {shown(file.suffix.lower())}")
    try:
        if not file.is_file():
            raise MediaError(f"there is no file {file}: check the name")
        if file.suffix.lower() == slot_table.SUFFIX:
            return SlotFile(file, _read_table(file))
        layout = _layout(file.suffix.lower())
        form, size = _read_c(file) if file.suffix.lower() == C_HEADER else _read_head(file, layout)
    except OSError as error:
        raise error if isinstance(error, MediaError) else _unreadable(file, error) from None
    if form.side not in SIDES or min(form.slots_per_pattern, form.slot_ns) < 1 or size != layout.size(form.side):
        raise MediaError(f"{file} is damaged: no slots are {form.side} LEDs a side in {size} bytes; {_AGAIN}")
    return SlotFile(file, form)


_AGAIN = "write it again by 'heliograph transmit'"


def _layout(suffix: str) -> Layout:
    """The layout of a kind of files; a C header has that of ".bits"."""
    if suffix not in SUFFIXES:
        raise MediaError(f"slots are in files that end in one of {', '.join(SUFFIXES)}, not {shown(suffix)}")
    return LAYOUTS[".bits" if suffix == C_HEADER else suffix]


def _values(form: SlotForm, size: int) -> tuple[int, ...]:
    return form.side, form.slots_per_pattern, form.slot_ns, form.count, size


def _head(layout: Layout, form: SlotForm) -> bytes:
    return HEAD.pack(layout.signature, *_values(form, layout.size(form.side)), 0)


def _read_head(path: Path, layout: Layout) -> tuple[SlotForm, int]:
    with path.open("rb") as file:
        data = file.read(HEAD.size)
    if not data.startswith(layout.signature):
        raise _foreign(path)
    if len(data) < HEAD.size:
        raise MediaError(f"{path} ends within its first {HEAD.size} bytes; {_AGAIN}")
    _, side, per_pattern, slot_ns, count, size, _ = HEAD.unpack(data)
    return SlotForm(side, per_pattern, slot_ns, count), size


def _read_c(path: Path) -> tuple[SlotForm, int]:
    try:
        *values, size = c_header.read_head(path)
    except (ValueError, KeyError):
        raise _foreign(path) from None
    return SlotForm(*values), size


def _read_table(path: Path) -> SlotForm:
    try:
        side, slots, period_s, count = slot_table.read_head(path)
        if side not in SIDES:
            raise ValueError
    except ValueError:
        raise _foreign(path) from None
    return SlotForm.of(side, pwm.SLOTS if slots else 1, period_s, count)


def _longer(path: Path, count: int) -> MediaError:
    return MediaError(f"{path} has more than its {count} slots; {_AGAIN}")


def _foreign(path: Path) -> MediaError:
    return MediaError(f"{path} is no {path.suffix} file of LED patterns; 'heliograph transmit' writes those")


def _unreadable(path: Path, error: OSError) -> MediaError:
    return MediaError(f"cannot read {path}: {error.strerror or error}")
