"""heliograph transmit."""

from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.files import room_for, whole_file
from heliograph.base.frames import Frame
from heliograph.cli import console, options

LED_PX = 16
"""Pixels of a side of an LED in a film of patterns."""


def run_transmit(
    output: Path,
    packets: int,
    identity: int,
    slots: bool,
    preset: str,
    file: Path | None,
    assignments: list[str] | None,
    sent: options.Sent,
    gamma: float = 1.0,
) -> None:
    """Write the patterns of a transmission: levels, or on and off by slot, as drivers take them."""
    from heliograph.link.simulate import transmitters
    from heliograph.media.film import FILM_SUFFIXES
    from heliograph.media.slots import SUFFIXES, SlotForm, file_size, write_slots
    from heliograph.signal import pwm

    options.refuse_to_replace(output, (*sent.inputs, file))
    if gamma != 1 and output.suffix.lower() not in FILM_SUFFIXES:
        raise MediaError(f"--gamma is that of a display, which plays films: leave it out, or write {FILM_SUFFIXES[0]}")
    # one array speaks, however many the preset's scene has
    changes = [*(assignments or ()), "channel.arrays=[{}]", f"transmit.identities=[{identity}]"]
    settings = options.settings_from(preset, file, changes)
    seconds = packets * settings.signal.packet_s
    (sender,) = transmitters(settings, options.read_messages(settings, sent, seconds))
    count = packets * settings.signal.packet_patterns
    patterns: Iterator[NDArray[np.uint8]] = islice(sender.levels(), count)
    period, brightest = settings.signal.pattern_period_s, pwm.SLOTS
    driver = output.suffix.lower() in SUFFIXES
    if slots or driver:
        patterns = (slot for p in patterns for slot in pwm.lit_slots(p, settings.signal.slot_order).astype(np.uint8))
        count, period, brightest = count * pwm.SLOTS, period / pwm.SLOTS, 1
    form = SlotForm.of(settings.signal.side, pwm.SLOTS, period, count) if driver else None
    room_for(output, file_size(output, form) if form else _least_bytes(output, count, settings.signal.side))
    with console.progress("transmitting", count) as advance:
        if form:
            write_slots(output, _counted(patterns, advance), form)
        else:
            _write(output, _counted(patterns, advance), (count, settings.signal.side), (period, brightest, gamma))
    console.say(
        f"{output}: {count} {'slots' if brightest == 1 else 'patterns'} of {period * 1e3:g} ms, {count * period:g} s"
    )


def _least_bytes(output: Path, count: int, side: int) -> int:
    """Least bytes that patterns take: a film's codec makes them smaller, but keeps its marks of each frame."""
    kinds = {".npy": side * side, ".csv": 2 * side * side, ".h5": (LED_PX * side) ** 2, ".hdf5": (LED_PX * side) ** 2}
    # least bytes of a picture in a video file: FFV1 and MJPEG take more for their headers alone
    return count * kinds.get(output.suffix.lower(), 64)


def _write(
    output: Path, patterns: Iterator[NDArray[np.uint8]], size: tuple[int, int], light: tuple[float, int, float]
) -> None:
    from heliograph.media.film import FILM_SUFFIXES
    from heliograph.media.slots import SUFFIXES, write_table

    (period, top, _), kind = light, output.suffix.lower()
    if kind == ".npy":
        with whole_file(output) as partial:
            _write_npy(partial, patterns, size)
    elif kind == ".csv":
        with whole_file(output) as partial:
            write_table(partial, patterns, size[1], period, slots=top == 1)
    elif kind in FILM_SUFFIXES:
        _write_film(output, patterns, size[1], light)
    else:
        known = ", ".join((".npy", ".csv", *SUFFIXES, *FILM_SUFFIXES))
        raise MediaError(f"unknown kind of file {output.name!r}: the name must end in one of {known}")


def _write_npy(path: Path, patterns: Iterator[NDArray[np.uint8]], size: tuple[int, int]) -> None:
    """(patterns, n, n) uint8."""
    count, side = size
    header = {"descr": "|u1", "fortran_order": False, "shape": (count, side, side)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        for pattern in patterns:
            file.write(pattern.tobytes())


def _write_film(path: Path, patterns: Iterator[NDArray[np.uint8]], side: int, light: tuple[float, int, float]) -> None:
    """A film of the array itself, for a screen; gray is the time that an LED is lit, to the power of 1 / gamma."""
    period, top, gamma = light
    grays = np.array([255 * (level / top) ** (1 / gamma) for level in range(top + 1)]).astype(np.uint8)
    from heliograph.media import create_film

    edge, block = side * LED_PX, np.ones((LED_PX, LED_PX), dtype=np.uint8)
    with create_film(path, width=edge, height=edge, rate_hz=1 / period) as film:
        for index, pattern in enumerate(patterns):
            film.write(Frame(index, index * period, np.kron(grays[pattern], block)))


def _counted(patterns: Iterator[NDArray[np.uint8]], advance: Callable[[int], None]) -> Iterator[NDArray[np.uint8]]:
    for number, pattern in enumerate(patterns, 1):
        yield pattern
        advance(number)
