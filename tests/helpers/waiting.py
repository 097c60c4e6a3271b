"""Waits with a limit that only a hang reaches, independent of machine load."""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

T = TypeVar("T")
HANG_S = 300.0  # time limit in s, sufficient for any machine under any load
HANG_MS = 1000 * HANG_S


def wait_until(condition: Callable[[], T]) -> T:
    """Return the first true value of a condition."""
    end = time.monotonic() + HANG_S
    while not (found := condition()):
        assert time.monotonic() < end, "the condition never came true"
        time.sleep(0.01)
    return found


def run_alone(function: Callable[..., T], *arguments: object) -> T:
    """Run a function in a new process, to trace memory apart from other tests."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result(HANG_S)
