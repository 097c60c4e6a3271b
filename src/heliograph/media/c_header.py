"""C headers of LED patterns: the bytes of ".bits" as an array, and their timing as macros."""

import re
from collections.abc import Iterator
from pathlib import Path

from heliograph.base.errors import MediaError

MOST_LINE = 1 << 14
"""Most characters of a line: those of a slot of 64 x 64 LEDs take 2.6 kB."""

MOST_LINES = 64
"""Most lines before the array: there are 15."""

NAMES = ("SIDE", "SLOTS_PER_PATTERN", "SLOT_NS", "SLOTS", "BYTES_PER_SLOT")
"""Macros of a header, after "HELIOGRAPH_"."""

_MACRO = re.compile(r"#define HELIOGRAPH_([A-Z_]+) (\d{1,19})u\s")
_ROW = re.compile(r"  (?:0x[0-9a-f]{2},)+\n")
_ARRAY = "static const uint8_t heliograph_slots[HELIOGRAPH_SLOTS * HELIOGRAPH_BYTES_PER_SLOT] = {\n"
END = "};\n\n#endif\n"
"""All that stands after the bytes."""


def head(values: tuple[int, ...]) -> str:
    """Return all that stands before the bytes."""
    macros = "".join(f"#define HELIOGRAPH_{name} {value}u\n" for name, value in zip(NAMES, values, strict=True))
    return (
        "/* LED patterns, written by heliograph transmit: LEDs on (1) or off (0) in each slot, slot after slot,\n"
        "   row by row from the upper left, most significant bit first. A slot lasts HELIOGRAPH_SLOT_NS. */\n"
        "#ifndef HELIOGRAPH_SLOTS_H\n#define HELIOGRAPH_SLOTS_H\n\n#include <stdint.h>\n\n" + macros + "\n" + _ARRAY
    )


def row(data: bytes) -> str:
    """Return a slot's bytes as a line of the array."""
    return "  " + "".join(f"0x{byte:02x}," for byte in data) + "\n"


def row_size(size: int) -> int:
    """Return the characters of a line of the array."""
    return len("  \n") + len("0x00,") * size


def read_head(path: Path) -> tuple[int, ...]:
    """Return the values of the macros `NAMES`, in their order."""
    found: dict[str, int] = {}
    with path.open(encoding="ascii") as file:
        for _ in range(MOST_LINES):
            line = file.readline(MOST_LINE)
            if match := _MACRO.match(line):
                found[match[1]] = int(match[2])
            if line == _ARRAY:
                return tuple(found[name] for name in NAMES)
    raise ValueError


def rows(path: Path, size: int) -> Iterator[bytes]:
    """Yield the bytes of each slot up to the end of the array."""
    with path.open(encoding="ascii") as file:
        while file.readline(MOST_LINE) != _ARRAY:
            pass
        number = 0
        while _ROW.fullmatch(line := file.readline(MOST_LINE)) and len(line) == row_size(size):
            yield bytes.fromhex(line.replace("0x", "").replace(",", ""))
            number += 1
        if line + file.read(len(END)) != END:
            raise MediaError(f"{path} is cut or damaged after {number} slots; write it again by 'heliograph transmit'")
