"""Waits that only a hang ends: no test passes or fails by how busy the machine is."""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

T = TypeVar("T")

HANG_S = 300.0
"""Time in s after which a wait counts as a hang, on any machine under any load."""
HANG_MS = 1000 * HANG_S


def wait_until(condition: Callable[[], T]) -> T:
    """Return the first true value of a condition."""
    end = time.monotonic() + HANG_S
    while not (found := condition()):
        assert time.monotonic() < end, "the condition never came true"
        time.sleep(0.01)
    return found


def run_alone(function: Callable[..., T], *arguments: object) -> T:
    """Run a function in a new process: its memory is traced without that of other tests and their threads."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result(HANG_S)
