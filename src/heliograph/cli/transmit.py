"""Files of LED patterns."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.files import room_for, whole_file
from heliograph.base.frames import Frame
from heliograph.cli import console, options
from heliograph.cli.messages import read_messages
from heliograph.cli.options import option
from heliograph.link.simulate import transmitters
from heliograph.media import create_film
from heliograph.media.film import FILM_SUFFIXES
from heliograph.media.slots import SUFFIXES, SlotForm, file_size, write_slots, write_table
from heliograph.signal import pwm


@dataclass(frozen=True, slots=True)
class Patterns:
    """Successive patterns of an array: levels 0 to `max_level`, or slots with `max_level` 1."""

    # (n, n) uint8 each
    levels: Iterator[NDArray[np.uint8]]
    count: int
    side: int
    period_s: float
    max_level: int


@options.command
def transmit(
    output: Annotated[
        Path,
        typer.Argument(
            help="Patterns to write: .npy, .csv, a film (.mkv, .mp4, ...); for drivers, by slot: .bits (bit planes), "
            ".h (C header), .hub75 (row scan), .shift (shift registers)."
        ),
    ],
    *,
    packets: int = option("Packets to write.", default=10, min=1),
    identity: int = option("Identity of the array.", default=0, min=0, max=29),
    slots: bool = option("Write on and off by PWM slot instead of levels.", None, "--slots", default=False),
    gamma: float = option(
        "Gamma of the display for a film, usually 2.2; 1 writes linear levels.", default=1.0, min=1, max=4
    ),
    settings: options.SettingsOptions,
    sent: options.SentOptions,
) -> None:
    """Write the LED patterns of a transmission."""
    options.refuse_to_replace(output, (*sent.inputs, settings.settings_file))
    suffix = output.suffix.lower()
    if gamma != 1 and suffix not in FILM_SUFFIXES:
        raise MediaError(f"--gamma applies to films for displays: leave it out, or write {FILM_SUFFIXES[0]}")
    # a single array, for any number of arrays in the scene of the preset
    single = ("channel.arrays=[{}]", f"transmit.identities=[{identity}]")
    link = settings.changed(overrides=single).load()
    signal, by_slot = link.signal, slots or suffix in SUFFIXES
    (sender,) = transmitters(link, read_messages(link, sent, packets * signal.packet_s))
    count, period_s, max_level = packets * signal.packet_patterns, signal.pattern_period_s, pwm.SLOTS
    levels: Iterator[NDArray[np.uint8]] = islice(sender.levels(), count)
    if by_slot:
        levels = (slot for level in levels for slot in pwm.lit_slots(level, signal.slot_order).astype(np.uint8))
        count, period_s, max_level = count * pwm.SLOTS, period_s / pwm.SLOTS, 1
    if suffix in FILM_SUFFIXES:
        console.say("Caution: on a display this film flashes, which can trigger seizures in photosensitive epilepsy.")
    with console.progress("transmitting", count) as advance:
        _write(output, Patterns(_counted(levels, advance), count, signal.side, period_s, max_level), gamma)
    console.say(
        f"{output}: {count} {'slots' if by_slot else 'patterns'} of {period_s * 1e3:g} ms, {count * period_s:g} s"
    )


def _write(output: Path, patterns: Patterns, gamma: float) -> None:
    """Write an array, a table, a file for drivers, or a film."""
    suffix, leds, pixels = output.suffix.lower(), patterns.side**2, (16 * patterns.side) ** 2
    if suffix in SUFFIXES:
        form = SlotForm.of(patterns.side, pwm.SLOTS, patterns.period_s, patterns.count)
        room_for(output, file_size(output, form))
        write_slots(output, patterns.levels, form)
        return
    # lower bounds of the size; a frame of a compressed film has a header of at least 64 bytes
    sizes = {".npy": leds, ".csv": 2 * leds, ".h5": pixels, ".hdf5": pixels}
    room_for(output, patterns.count * sizes.get(suffix, 64))
    if suffix == ".npy":
        header = {"descr": "|u1", "fortran_order": False, "shape": (patterns.count, patterns.side, patterns.side)}
        with whole_file(output) as partial, partial.open("wb") as file:
            np.lib.format.write_array_header_1_0(file, header)
            for level in patterns.levels:
                file.write(level.tobytes())
    elif suffix == ".csv":
        with whole_file(output) as partial:
            write_table(partial, patterns.levels, patterns.side, patterns.period_s, slots=patterns.max_level == 1)
    elif suffix in FILM_SUFFIXES:
        _write_film(output, patterns, gamma)
    else:
        known = ", ".join((".npy", ".csv", *SUFFIXES, *FILM_SUFFIXES))
        raise MediaError(f"unknown kind of file {output.name!r}: the name must end in one of {known}")


def _write_film(path: Path, patterns: Patterns, gamma: float) -> None:
    """Write a film of the array for a display, with 16 x 16 pixels an LED."""
    duty_cycles = np.arange(patterns.max_level + 1) / patterns.max_level
    grays = (255 * duty_cycles ** (1 / gamma)).astype(np.uint8)
    edge, led = 16 * patterns.side, np.ones((16, 16), dtype=np.uint8)
    with create_film(path, width=edge, height=edge, rate_hz=1 / patterns.period_s) as film:
        for index, level in enumerate(patterns.levels):
            film.write(Frame(index, index * patterns.period_s, np.kron(grays[level], led)))


def _counted(patterns: Iterator[NDArray[np.uint8]], advance: Callable[[float], None]) -> Iterator[NDArray[np.uint8]]:
    for number, pattern in enumerate(patterns, 1):
        yield pattern
        advance(number)
