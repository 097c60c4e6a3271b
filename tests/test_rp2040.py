"""RP2040 example: simulate the PIO program cycle by cycle, and check the C syntax.

The C is checked against the declarations below, not the Pico SDK, and was not run on hardware.
"""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from waiting import HANG_S

from heliograph.media.slots import SlotForm, write_slots

EXAMPLE = Path(__file__).parents[1] / "examples" / "rp2040"
CYCLES = 3125  # PIO cycles in 250 us at 125 MHz / 10


@pytest.fixture(scope="module")
def simulate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("rp2040_simulate", EXAMPLE / "simulate.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # required by dataclasses
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def program(simulate: ModuleType) -> Any:
    return simulate.assemble((EXAMPLE / "slots.pio").read_text())


def slots(count: int, seed: int = 0) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.random.default_rng(seed).integers(0, 2, (count, 16, 16), np.uint8)


def sent(light: np.ndarray[Any, np.dtype[np.uint8]]) -> list[int]:
    return [*np.packbits(light.reshape(len(light), -1)).tobytes()]


def test_the_program_fills_its_time_by_its_own_counts(simulate: ModuleType, program: Any) -> None:
    set_y, set_x, out, again, jmp_y, latch = (1 + one.delay for one in program.instructions)
    assert set_y + 8 * (set_x + 32 * (out + again) + jmp_y) + latch == program.values["CYCLES"] == CYCLES
    assert simulate.SYSTEM_HZ / 10 * 250e-6 == CYCLES
    assert len(program.instructions) <= 32


@pytest.mark.slow
@pytest.mark.parametrize("light", [slots(6), np.zeros((3, 16, 16), np.uint8), np.ones((3, 16, 16), np.uint8)])
def test_bits_come_in_order_and_slots_in_time(simulate: ModuleType, program: Any, light: Any) -> None:
    """The chain begins at the lower right LED, as wired in the README; the latch comes once per slot, evenly spaced."""
    shown = simulate.shown_by(simulate.run(program, sent(light)))
    assert np.array_equal([led[::-1] for led in shown.slots], light.reshape(len(light), -1))
    assert set(np.diff(shown.began)) == {CYCLES}
    if light.any() and not light.all():
        assert shown.steady == (6, 6)  # 0.48 us; the 74HC595 needs at most 0.1 us


@pytest.mark.slow
@pytest.mark.parametrize(("dma_cycles", "with_live_limits"), [(1, True), (90, True), (110, False)])
def test_slow_dma_shifts_no_bits(simulate: ModuleType, program: Any, dma_cycles: int, with_live_limits: bool) -> None:
    """A slot has 32 bytes and 3125 cycles, 97 per byte; slower DMA delays slots."""
    light = slots(12)
    shown = simulate.shown_by(simulate.run(program, sent(light), dma_cycles))
    assert np.array_equal([led[::-1] for led in shown.slots], light.reshape(len(light), -1))
    assert (set(np.diff(shown.began)) == {CYCLES}) == with_live_limits


@pytest.mark.slow
def test_an_end_of_data_shows_no_half_slot(simulate: ModuleType, program: Any) -> None:
    shown = simulate.shown_by(simulate.run(program, sent(slots(3))[:-5]))
    assert len(shown.slots) == 2
    assert shown.stalls == CYCLES, "the machine waits where bits are missing, and main.c turns the array off"


@pytest.mark.parametrize(
    "line", ["out pins, 2 side 0", "set y, 32 side 0", "nop side 4", "nop side 0 [8]", "mov x, y side 0", "nop"]
)
def test_unsupported_instructions_are_refused(simulate: ModuleType, line: str) -> None:
    with pytest.raises(ValueError, match=re.escape(line)):
        simulate.assemble(f".side_set 2\n{line}\n")


@pytest.mark.slow
def test_simulation_runs_as_in_the_readme(tmp_path: Path) -> None:
    light = slots(8)
    for slot_ns in (250_000, 250_100):
        write_slots(tmp_path / "patterns.h", light, SlotForm(16, 4, slot_ns, len(light)))
        command = [sys.executable, str(EXAMPLE / "simulate.py"), "patterns.h"]
        ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=HANG_S, check=False)
        assert (ran.returncode == 0) == (slot_ns == 250_000), ran.stderr
        assert "8 slots of" in ran.stdout
        assert "jitter 0 us" in ran.stdout
    wrong = subprocess.run([*command[:-1], "none.h"], capture_output=True, text=True, timeout=HANG_S, check=False)
    assert (wrong.returncode, wrong.stderr) == (1, "there is no file none.h: check the name\n")


SDK = """
#include <stdbool.h>
#include <stdint.h>
#include <stddef.h>
typedef unsigned int uint;
typedef struct { volatile uint32_t txf[4], fdebug; } pio_hw_t;
typedef pio_hw_t *PIO;
extern pio_hw_t *const pio0;
typedef struct { uint32_t clkdiv, execctrl, shiftctrl, pinctrl; } pio_sm_config;
typedef struct pio_program { const uint16_t *instructions; uint8_t length; int8_t origin; } pio_program_t;
enum pio_fifo_join { PIO_FIFO_JOIN_NONE, PIO_FIFO_JOIN_TX, PIO_FIFO_JOIN_RX };
#define PIO_FDEBUG_TXSTALL_LSB 24
int pio_add_program(PIO, const pio_program_t *); int pio_claim_unused_sm(PIO, bool required);
uint pio_get_dreq(PIO, uint sm, bool is_tx); void pio_gpio_init(PIO, uint pin);
void pio_sm_init(PIO, uint sm, uint initial_pc, const pio_sm_config *); bool pio_sm_is_tx_fifo_full(PIO, uint sm);
void pio_sm_set_consecutive_pindirs(PIO, uint sm, uint pin_base, uint pin_count, bool is_out);
void pio_sm_set_enabled(PIO, uint sm, bool enabled);
void sm_config_set_clkdiv_int_frac(pio_sm_config *, uint16_t div_int, uint8_t div_frac);
void sm_config_set_fifo_join(pio_sm_config *, enum pio_fifo_join);
void sm_config_set_out_pins(pio_sm_config *, uint base, uint count);
void sm_config_set_out_shift(pio_sm_config *, bool shift_right, bool autopull, uint pull_threshold);
void sm_config_set_sideset_pins(pio_sm_config *, uint base);
typedef struct { uint32_t ctrl; } dma_channel_config;
typedef struct { struct { volatile uint32_t al3_read_addr_trig; } ch[12]; } dma_hw_t;
extern dma_hw_t *const dma_hw;
enum dma_channel_transfer_size { DMA_SIZE_8, DMA_SIZE_16, DMA_SIZE_32 };
int dma_claim_unused_channel(bool required);
dma_channel_config dma_channel_get_default_config(uint channel);
void channel_config_set_transfer_data_size(dma_channel_config *, enum dma_channel_transfer_size);
void channel_config_set_read_increment(dma_channel_config *, bool);
void channel_config_set_write_increment(dma_channel_config *, bool);
void channel_config_set_dreq(dma_channel_config *, uint dreq);
void channel_config_set_high_priority(dma_channel_config *, bool);
void channel_config_set_chain_to(dma_channel_config *, uint);
void dma_channel_configure(uint, const dma_channel_config *, volatile void *to, const volatile void *from, uint count,
                           bool trigger);
void dma_channel_start(uint channel);
#define GPIO_OUT true
void gpio_init(uint); void gpio_put(uint, bool); void gpio_set_dir(uint, bool);
bool set_sys_clock_khz(uint32_t, bool required); void sleep_us(uint64_t); void tight_loop_contents(void);
"""
"""Pico SDK 2 declarations for main.c."""


def syntax(folder: Path, slot_ns: int = 250_000, side: int = 16) -> "subprocess.CompletedProcess[str]":
    """Check the syntax of main.c against SDK headers and the pioasm output for slots.pio."""
    if not shutil.which("gcc"):
        pytest.skip("there is no gcc to check the C by")
    for name in ("hardware/clocks.h", "hardware/dma.h", "hardware/gpio.h", "hardware/pio.h", "pico/stdlib.h"):
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text('#include "sdk.h"\n')
    (folder / "sdk.h").write_text(f"#pragma once\n{SDK}")
    cycles = re.search(r"define public CYCLES (\d+)", (EXAMPLE / "slots.pio").read_text())
    assert cycles
    (folder / "slots.pio.h").write_text(
        f"#define slots_CYCLES {cycles[1]}\nextern const struct pio_program slots_program;\n"
        "pio_sm_config slots_program_get_default_config(uint offset);\n"
    )
    write_slots(folder / "patterns.h", np.zeros((4, side, side), np.uint8), SlotForm(side, 4, slot_ns, 4))
    strict = ("-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror")
    command = ["gcc", "-fsyntax-only", *strict, "-I", str(folder), str(EXAMPLE / "main.c")]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("slot_ns", [250_000, 25_000, 100_000, 1_000_000])
def test_the_program_is_c(tmp_path: Path, slot_ns: int) -> None:
    done = syntax(tmp_path, slot_ns)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("slot_ns", "side", "says"), [(250_001, 16, "no multiple of 25 us"), (250_000, 8, "counts 256 bits")]
)
def test_patterns_that_do_not_fit_are_compiler_errors(tmp_path: Path, slot_ns: int, side: int, says: str) -> None:
    done = syntax(tmp_path, slot_ns, side)
    assert done.returncode != 0
    assert says in done.stderr
