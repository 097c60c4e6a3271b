"""LED patterns on or off by slot, in the files of LED drivers: .bits, .hub75, .shift, .csv and C headers."""

import os
import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, shown
from heliograph.base.files import whole_file
from heliograph.media.reader import clear_read_errors
from heliograph.signal import pwm

Slot = NDArray[np.uint8]  # (n, n) LEDs of a slot, 1 on and 0 off, row by row as the camera sees them

SIGNATURES = {".bits": b"HGBITS1\n", ".hub75": b"HGHUBS1\n", ".shift": b"HGSHFT1\n"}
"""First 8 bytes of a binary file by suffix; the last digit is the version of the layout."""

SUFFIXES = (*SIGNATURES, ".h")  # suffixes of files for drivers. A C header holds the bytes of ".bits" as an array
HEAD = struct.Struct("<8sHHIQII")  # start of a binary file: signature, the values of `SlotForm`, bytes of a slot, zeros

_MACROS = ("SIDE", "SLOTS_PER_PATTERN", "SLOT_NS", "SLOTS", "BYTES_PER_SLOT")
_C_ARRAY = b"static const uint8_t heliograph_slots[HELIOGRAPH_SLOTS * HELIOGRAPH_BYTES_PER_SLOT] = {\n"

_RGB = 0b111  # R1, G1 and B1 of a row scan; R2, G2 and B2 are the next three bits
_AGAIN = "write it again by 'heliograph transmit'"


@dataclass(frozen=True, slots=True)
class SlotForm:
    """Form of the slots of a file.

    Attributes
    ----------
    side
        LEDs in a row and in a column, 4 to 128 in steps of 4.
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
            The period is too far from a multiple of 1 ns.
        """
        slot_ns = round(slot_s * 1e9)
        # 1e-4 is the tolerance of section 3 of the air interface
        if abs(slot_ns - slot_s * 1e9) > 1e-4 * slot_s * 1e9:
            raise MediaError(f"a slot of {slot_s * 1e9:.7g} ns is no whole number of ns: set signal.pattern_period_s")
        return cls(side, slots_per_pattern, slot_ns, count)


class SlotFile:
    """LED patterns in a file for a driver; made by `open_slots`.

    Iterating gives each slot as (n, n) uint8, 1 for an LED that is on; each iteration starts at the first slot. A
    table of levels has one slot a pattern, with levels of 0 to 4.

    Parameters
    ----------
    path
        The file; the suffix gives the kind.
    form
        Form of the slots.

    Attributes
    ----------
    path
        The file.
    form
        LEDs of a side, slots of a pattern, period of a slot in ns, number of slots.
    """

    def __init__(self, path: Path, form: SlotForm) -> None:
        self.path = path
        self.form = form

    def __iter__(self) -> Iterator[Slot]:
        """Yield the slots in order of time; raise a MediaError after the last good slot of a damaged file."""
        kind, form = self.path.suffix.lower(), self.form
        with clear_read_errors(self.path), self.path.open("rb") as file:
            if kind == ".csv":
                yield from _read_rows(self.path, file, form)
                return
            length, end = _record(kind, form.side)
            file.seek(len(_head(kind, form)))
            for number in range(form.count):
                record = file.read(length)
                if len(record) < length:
                    raise MediaError(f"{self.path} ends after {number} of {form.count} slots; {_AGAIN}")
                try:
                    slot = _unpack(kind, record, form.side)
                except ValueError as error:
                    raise MediaError(f"slot {number} of {self.path} is damaged: {error}; {_AGAIN}") from None
                yield slot
            if file.read(len(end) + 1) != end:
                raise MediaError(f"{self.path} does not end after its {form.count} slots; {_AGAIN}")

    def levels(self) -> Iterator[NDArray[np.uint8]]:
        """Yield the patterns: (n, n) uint8, the slots of each in which an LED is on."""
        slots = iter(self)
        while len(group := list(islice(slots, self.form.slots_per_pattern))) == self.form.slots_per_pattern:
            yield np.sum(group, axis=0, dtype=np.uint8)


def open_slots(path: str | os.PathLike[str]) -> SlotFile:
    """Open LED patterns of `heliograph transmit` for a driver: .bits, .hub75, .shift, a C header, or .csv.

    Parameters
    ----------
    path
        The file; the suffix gives the kind.

    Raises
    ------
    MediaError
        The file is missing, of another kind or damaged. Iterating reports a truncated file after the last good slot.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise MediaError(f"the path of slots is text or a pathlib.Path, not {shown(path)}")
    file = Path(path)
    kind = _checked_kind(file, (*SUFFIXES, ".csv"))
    with clear_read_errors(file):
        if not file.is_file():
            raise MediaError(f"there is no file {file}: check the name")
        try:
            if kind == ".csv":
                return SlotFile(file, _read_table_form(file))
            with file.open("rb") as opened:
                head = opened.read(1 << 12)
            *values, size = _read_head(kind, head)
        except (ValueError, KeyError, struct.error):
            raise MediaError(f"{file} is no {kind} file of LED patterns; see 'heliograph transmit'") from None
    form = SlotForm(*values)
    if not _is_side(form.side) or min(form.slots_per_pattern, form.slot_ns) < 1 or size != _slot_bytes(kind, form.side):
        raise MediaError(f"{file} is damaged: no slots are {form.side} LEDs a side in {size} bytes; {_AGAIN}")
    if not head.startswith(_head(kind, form)):
        raise MediaError(f"{file} has a changed or damaged header; {_AGAIN}")
    return SlotFile(file, form)


def write_slots(path: Path, slots: Iterable[NDArray[np.uint8]], form: SlotForm) -> None:
    """Write a file of slots completely or not at all."""
    kind, written = _checked_kind(path, SUFFIXES), 0
    with whole_file(path) as partial, partial.open("wb") as file:
        file.write(_head(kind, form))
        for slot in slots:
            if slot.shape != (form.side, form.side):
                raise MediaError(f"{path} takes slots of shape ({form.side}, {form.side}), not {slot.shape}")
            file.write(_pack(kind, slot))
            written += 1
        if written != form.count:
            raise MediaError(f"{path} takes {form.count} slots, not {written}")
        file.write(_record(kind, form.side)[1])


def file_size(path: Path, form: SlotForm) -> int:
    """Return the length of a file of slots in bytes."""
    kind = _checked_kind(path, SUFFIXES)
    length, end = _record(kind, form.side)
    return len(_head(kind, form)) + form.count * length + len(end)


def _checked_kind(path: Path, suffixes: tuple[str, ...]) -> str:
    kind = path.suffix.lower()
    if kind not in suffixes:
        raise MediaError(f"slots are in files that end in one of {', '.join(suffixes)}, not {shown(kind)}")
    return kind


def _is_side(side: int) -> bool:
    return side in range(4, 129, 4)


def _slot_bytes(kind: str, side: int) -> int:
    return side // 2 * (1 + side) if kind == ".hub75" else side * side // 8


def _record(kind: str, side: int) -> tuple[int, bytes]:
    """Return the length of a slot in the file, and the bytes behind all slots."""
    size = _slot_bytes(kind, side)
    return (len(_c_row(bytes(size))), b"};\n\n#endif\n") if kind == ".h" else (size, b"")


def _c_row(data: bytes) -> bytes:
    return b"  " + b"".join(b"0x%02x," % byte for byte in data) + b"\n"


def _pack(kind: str, slot: Slot) -> bytes:
    if kind == ".hub75":  # a row scan: the address of the row, then a byte for each column of both halves
        half = len(slot) // 2
        lit = _RGB * slot[:half] | _RGB * slot[half:] << 3
        return np.insert(lit, 0, np.arange(half), axis=1).tobytes()
    # the first bit in a chain of registers ends at the far end
    data = np.packbits(slot.ravel()[::-1] if kind == ".shift" else slot).tobytes()
    return _c_row(data) if kind == ".h" else data


def _unpack(kind: str, data: bytes, side: int) -> Slot:
    if kind == ".h":
        if not re.fullmatch(rb"  (?:0x[0-9a-f]{2},)+\n", data):
            raise ValueError("its line is cut")
        data = bytes.fromhex(data.decode().replace("0x", "").replace(",", ""))
    held = np.frombuffer(data, np.uint8)
    if kind == ".hub75":
        rows = held.reshape(side // 2, 1 + side)
        if (rows[:, 0] != np.arange(side // 2)).any():
            raise ValueError("its rows do not come in the order of addresses")
        lit = np.concatenate([rows[:, 1:] & _RGB, rows[:, 1:] >> 3])
        if not np.isin(lit, (0, _RGB)).all():
            raise ValueError("R, G and B of an LED differ")
        return lit // _RGB
    slot = np.unpackbits(held)
    return (slot[::-1].copy() if kind == ".shift" else slot).reshape(side, side)


def _head(kind: str, form: SlotForm) -> bytes:
    values = (form.side, form.slots_per_pattern, form.slot_ns, form.count, _slot_bytes(kind, form.side))
    if kind != ".h":
        return HEAD.pack(SIGNATURES[kind], *values, 0)
    macros = "".join(f"#define HELIOGRAPH_{name} {value}u\n" for name, value in zip(_MACROS, values, strict=True))
    text = (
        "/* LED patterns, written by heliograph transmit: LEDs on (1) or off (0) in each slot, slot after slot,\n"
        "   row by row from the upper left, most significant bit first. A slot lasts HELIOGRAPH_SLOT_NS. */\n"
        f"#ifndef HELIOGRAPH_SLOTS_H\n#define HELIOGRAPH_SLOTS_H\n\n#include <stdint.h>\n\n{macros}\n"
    )
    return text.encode() + _C_ARRAY


def _read_head(kind: str, head: bytes) -> tuple[int, ...]:
    """Return the values of `SlotForm`, and the bytes of a slot."""
    if kind == ".h":
        values = dict(re.findall(rb"#define HELIOGRAPH_([A-Z_]+) (\d{1,19})u\s", head))
        return tuple(int(values[name.encode()]) for name in _MACROS)
    signature, *numbers, _ = HEAD.unpack(head[: HEAD.size])
    if signature != SIGNATURES[kind]:
        raise ValueError
    return tuple(numbers)


def write_table(path: Path, patterns: Iterable[NDArray[np.uint8]], side: int, period_s: float, slots: bool) -> None:
    """Write a table in text: a line for each slot, or for each pattern where the values are levels."""
    with path.open("w", encoding="ascii") as file:
        file.write(_column_names(side, slots) + "\n")
        for index, pattern in enumerate(patterns):
            file.write(f"{index * period_s:.9g}," + ",".join(map(str, pattern.ravel().tolist())) + "\n")


def _column_names(side: int, slots: bool) -> str:
    time = "slot_s" if slots else "time_s"
    return ",".join((time, *(f"led_{u}_{v}" for u in range(side) for v in range(side))))


def _lines(file: BinaryIO) -> Iterator[str]:
    """Yield lines of at most 256 KiB; the first line of 128 x 128 LEDs takes 168 kB."""
    return (line.decode("ascii", "replace").replace("\r\n", "\n") for line in iter(lambda: file.readline(1 << 18), b""))


def _read_table_form(path: Path) -> SlotForm:
    with path.open("rb") as file:
        lines = _lines(file)
        names = next(lines, "")
        side, slots = round(names.count(",") ** 0.5), names.startswith("slot_s")
        start_s, next_s = (float(line.partition(",")[0]) for line in islice(lines, 2))
        if not _is_side(side) or names != _column_names(side, slots) + "\n" or not 0 == start_s < next_s < np.inf:
            raise ValueError
        return SlotForm.of(side, pwm.SLOTS if slots else 1, next_s, 2 + sum(1 for _ in lines))


def _read_rows(path: Path, file: BinaryIO, form: SlotForm) -> Iterator[Slot]:
    """Yield the LEDs of each line of a table."""
    highest = 1 if form.slots_per_pattern > 1 else pwm.SLOTS
    for count, line in enumerate(islice(_lines(file), 1, None)):
        time_s, _, values = line.partition(",")
        try:
            leds = np.array(values.split(","), np.int64)
            late = abs(float(time_s) / (form.slot_ns * 1e-9) - count)
        except ValueError:
            leds, late = np.empty(0, np.int64), np.inf
        if not line.endswith("\n") or leds.size != form.side**2 or not 0 <= leds.min() <= leds.max() <= highest:
            raise MediaError(f"line {count + 2} of {path} is cut or damaged; {_AGAIN}")
        if not late <= 0.01 + 1e-8 * count:  # times have nine digits
            raise MediaError(f"line {count + 2} of {path} is late or early; {_AGAIN}")
        yield leds.reshape(form.side, form.side).astype(np.uint8)
