"""Time that compiling takes, and the words that tell it on a terminal.

Numba is not imported here, so that the command can ask the clock at no cost; `compiled` tells when Numba compiles.
"""

import sys
import time
from dataclasses import dataclass


@dataclass
class _Compiling:
    """What this process knows of its compiling."""

    depth: int = 0
    """Functions that are being compiled; one may wait for another that it calls."""
    began_s: float = 0.0
    """When the outermost of them began, by the machine's clock."""
    spent_s: float = 0.0
    """Seconds of those that are finished."""
    told: bool = False
    """Whether the words were said."""


_now = _Compiling()


def clock() -> float:
    """Time in s that stands still while this process compiles: estimates of the time left go by it."""
    now = _now.began_s if _now.depth else time.monotonic()
    return now - _now.spent_s


def begin() -> None:
    """Stop the clock: a function is being compiled. Numba's own lock is held."""
    if not _now.depth:
        _now.began_s = time.monotonic()
    _now.depth += 1


def end() -> None:
    """Let the clock go on where no other function is being compiled."""
    _now.depth -= 1
    if not _now.depth:
        _now.spent_s += time.monotonic() - _now.began_s


def tell(kept: bool) -> None:
    """Say once on a terminal that compiling takes a while; of several workers the first speaks for all.

    Parameters
    ----------
    kept
        Whether the machine code is kept for the next process.
    """
    if _now.told:
        return
    _now.told = True
    import multiprocessing  # only now: the command asks this module's clock before it does anything

    helper = multiprocessing.parent_process() and not multiprocessing.current_process().name.endswith("-1")
    if helper or sys.stderr is None or not sys.stderr.isatty():
        return
    often = "once" if kept else "each time, as no folder can be written to keep it: set NUMBA_CACHE_DIR to one"
    sys.stderr.write(f"compiling for this computer, about 20 s ({often})\n")
    sys.stderr.flush()
