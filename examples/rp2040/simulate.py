"""Verify the timing in slots.pio: simulate the program cycle by cycle, with a chain of shift registers.

    heliograph transmit patterns.h --packets 10
    python simulate.py patterns.h

The state machine follows the RP2040 datasheet, chapter 3, for the instructions used in slots.pio. An instruction takes
one cycle plus a delay. Side-set pins change in the first cycle, even during a stall. The output register refills
automatically (section 3.5.4.2).
"""

import re
import sys
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

import heliograph

HERE = Path(__file__).parent
SYSTEM_HZ = 125e6
"""System clock set in main.c."""

FIFO = 8
"""Transmit FIFO depth, joined with the receive FIFO."""

PULL_AFTER = 8
"""Bits per output register refill: DMA writes bytes."""


@dataclass(frozen=True)
class Instruction:
    """A program line: `set`, `out`, `jmp` or `nop`, operands, side-set pins and delay in cycles."""

    name: str
    operands: tuple[str, ...]
    side: int
    delay: int


@dataclass
class Program:
    """A PIO program: instructions, labels, wrap, side-set pins and values exported to C."""

    instructions: list[Instruction] = field(default_factory=list)
    labels: dict[str, int] = field(default_factory=dict)
    values: dict[str, int] = field(default_factory=dict)
    wrap_target: int = 0
    wrap: int = -1
    side_pins: int = 0


def assemble(text: str) -> Program:
    """Parse a program and check that all numbers fit the instruction fields."""
    program = Program()
    for line in (line.partition(";")[0].strip() for line in text.splitlines()):
        words = line.split()
        if not words or words[0] == ".program":
            continue
        if words[0] == ".side_set":
            program.side_pins = int(words[1])
        elif words[:2] == [".define", "public"]:
            program.values[words[2]] = int(words[3])
        elif words[0] == ".wrap_target":
            program.wrap_target = len(program.instructions)
        elif words[0] == ".wrap":
            program.wrap = len(program.instructions) - 1
        elif line.endswith(":"):
            program.labels[line[:-1]] = len(program.instructions)
        else:
            program.instructions.append(_instruction(line, program.side_pins))
    if len(program.instructions) > 32:
        raise ValueError("a PIO holds 32 instructions")
    return program


def _instruction(line: str, side_pins: int) -> Instruction:
    match = re.fullmatch(
        r"(set (?=[xy],)|out (?=pins, 1 )|jmp (?=[xy]-- )|nop)\s*(.*?)\s+side\s+(\w+)(?:\s+\[(\d+)\])?", line
    )
    if not match:
        raise ValueError(f"not understood: {line}")
    side, delay = int(match[3], 0), int(match[4] or 0)
    # side-set and delay share 5 bits
    if side >= 1 << side_pins or delay >= 1 << 5 - side_pins:
        raise ValueError(f"side-set or delay too large: {line}")
    operands = tuple(match[2].replace(",", " ").split())
    name = match[1].strip()
    if name == "set" and not 0 <= int(operands[1]) < 32:
        raise ValueError(f"set takes 0 to 31: {line}")
    return Instruction(name, operands, side, delay)


@dataclass
class Pins:
    """Pin levels in a cycle; `stalled` marks a wait for data."""

    cycle: int
    data: int
    clock: int
    latch: int
    stalled: bool


def run(program: Program, data: Iterable[int], dma_cycles: int = 1) -> Iterator[Pins]:
    """Yield pins for each PIO cycle, until the data end for a slot's duration.

    DMA needs `dma_cycles` PIO cycles per byte and starts with a full FIFO, as in main.c.
    """
    waiting = iter(data)
    fifo = deque(islice(waiting, FIFO))
    register, shifted = 0, 32  # the output register starts empty
    scratch = {"x": 0, "y": 0}
    place, out, left, stalls, cycle = 0, 0, 0, 0, 0
    while stalls < program.values["CYCLES"]:
        if len(fifo) < FIFO and cycle % dma_cycles == 0 and (byte := next(waiting, None)) is not None:
            fifo.append(byte)
        instruction = program.instructions[place]
        executes, stalled = left == 0, False
        if executes and instruction.name == "out":
            if shifted >= PULL_AFTER:
                stalled = True
            else:
                out, register, shifted = register >> 31, register << 1 & 0xFFFFFFFF, shifted + 1
        if shifted >= PULL_AFTER and fifo:
            # a byte write fills all four bytes in the word
            register, shifted = fifo.popleft() * 0x01010101, 0
        stalls = stalls + 1 if stalled else 0
        yield Pins(cycle, out, instruction.side & 1, instruction.side >> 1, stalled)
        cycle += 1
        if stalled:
            continue
        if executes:
            left = instruction.delay + 1
            following = program.wrap_target if place == program.wrap else place + 1
            if instruction.name == "set":
                scratch[instruction.operands[0]] = int(instruction.operands[1])
            elif instruction.name == "jmp":
                counter = instruction.operands[0].removesuffix("--")
                if scratch[counter]:
                    following = program.labels[instruction.operands[1]]
                scratch[counter] = scratch[counter] - 1 & 0xFFFFFFFF
        left -= 1
        if left == 0:
            place = following


@dataclass
class Shown:
    """Register chain output: slots, start cycle of each slot, and cycles stalled for data."""

    slots: list[np.ndarray]
    began: list[int]
    stalls: int
    steady: tuple[int, int]
    """Minimum data setup and hold times around the shift clock edge, in cycles."""


def shown_by(pins: Iterable[Pins], leds: int = 256) -> Shown:
    """Shift bits in at the rising shift clock and show them at the rising storage clock, as 74HC595 do."""
    chain = deque([0] * leds, maxlen=leds)
    slots, began, stalls, changed, rose, steady = [], [], 0, -1, -1, [1 << 30, 1 << 30]
    before = Pins(-1, 0, 0, 0, False)
    for now in pins:
        if now.data != before.data:
            changed = now.cycle
            steady[1] = min(steady[1], changed - rose) if rose >= 0 else steady[1]
        if now.clock and not before.clock:
            chain.appendleft(now.data)  # the first output holds the newest bit
            rose = now.cycle
            steady[0] = min(steady[0], rose - changed)
        if now.latch and not before.latch:
            slots.append(np.array(chain, np.uint8))
            began.append(now.cycle)
        stalls += now.stalled
        before = now
    return Shown(slots, began, stalls, (steady[0], steady[1]))


def main() -> None:
    """Simulate the first slots in a C header; report order and timing."""
    try:
        light = heliograph.open_slots(sys.argv[1] if len(sys.argv) > 1 else "patterns.h")
        slots = list(islice(light, 400))
    except heliograph.HeliographError as error:
        sys.exit(str(error))
    if len(slots) < 3 or light.form.side != 16:
        sys.exit("slots.pio takes slots of 16 x 16 LEDs, and their time is seen from three on: write a packet")
    program = assemble((HERE / "slots.pio").read_text())
    shown = shown_by(run(program, [byte for slot in slots for byte in np.packbits(slot).tobytes()]))
    # the chain begins at the lower right LED
    right = all(np.array_equal(led[::-1], slot.ravel()) for led, slot in zip(shown.slots, slots, strict=True))
    wanted_us = light.form.slot_ns / 1000
    divider = max(1, round(SYSTEM_HZ * wanted_us / 1e6 / program.values["CYCLES"]))
    cycle_us = divider / SYSTEM_HZ * 1e6
    shortest, longest = min(np.diff(shown.began)) * cycle_us, max(np.diff(shown.began)) * cycle_us
    setup, hold = (cycles * cycle_us for cycles in shown.steady)
    print(f"{len(slots)} slots of {wanted_us:g} us: bits {'in order' if right else 'WRONG'}")
    print(f"slot period {shortest:g} us, off by {shortest - wanted_us:+g} us, in cycles of {cycle_us:g} us")
    print(f"jitter {longest - shortest:g} us")
    print(f"data steady {setup:g} us before the shift clock rises and {hold:g} us after")
    if not right or shortest != longest or abs(shortest - wanted_us) >= cycle_us:
        sys.exit("the timing is wrong")


if __name__ == "__main__":
    main()
