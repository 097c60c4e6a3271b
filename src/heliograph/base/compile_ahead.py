"""The second core compiles too: loops that the first use needs later, from the last to the first.

When a loop of the list `first_use.txt` has to be compiled, a helper process is started that compiles the others of the
list from its end. What it has finished is found in the folder where machine code is kept. The helper ends with the
process that started it.
"""

import contextlib
import multiprocessing
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

SWITCH = "HELIOGRAPH_COMPILE_AHEAD"
"""Environment variable that is 0 where no helper is to be started."""

LIST = Path(__file__).with_name("first_use.txt")
"""Loops of a first use in its order, parts of it after empty lines; made by ``scripts/make_first_use.py``."""


class Loop(NamedTuple):
    """A compiled function of the list.

    Attributes
    ----------
    module, name
        The function's module, and its name there.
    signature
        Types of its arguments, as Numba writes them.
    """

    module: str
    name: str
    signature: str


@cache
def loops() -> tuple[tuple[Loop, ...], ...]:
    """Return the loops of the list, in parts and in the order of use; none where the list is not there."""
    try:
        text = LIST.read_text(encoding="utf-8")
    except OSError:
        return ()
    return tuple(tuple(Loop(*line.split(" ", 2)) for line in part.splitlines()) for part in text.strip().split("\n\n"))


_helpers: list[subprocess.Popen[bytes]] = []
"""The helper of this process, once it was started."""


def start_once(module: str, name: str) -> None:
    """Start the helper where a loop that has to be compiled is on the list and there is no helper yet.

    Parameters
    ----------
    module, name
        The function's module, and its name there.
    """
    if not _helpers and any(loop[:2] == (module, name) for part in loops() for loop in part) and _may_help():
        with contextlib.suppress(OSError):
            _helpers.append(_helper())


def _may_help() -> bool:
    """Whether another process may work beside this one."""
    # an application that is frozen is no Python, and workers have a core each already
    alone = bool(sys.executable) and not getattr(sys, "frozen", False) and multiprocessing.parent_process() is None
    return alone and _cores() > 1 and os.environ.get(SWITCH) != "0"


def _helper() -> "subprocess.Popen[bytes]":
    """Start the helper; its standard input ends with this process."""
    return subprocess.Popen(
        [sys.executable, "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, SWITCH: "0"},
    )


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_all() -> Iterator[Loop]:
    """Compile the loops of the list that are not kept yet, part by part, each from its end.

    Yields
    ------
    Loop
        Each that is there now; what cannot be compiled is left out, for the list may be an older one.
    """
    for part in loops():
        for loop in reversed(part):
            with contextlib.suppress(Exception):
                function = getattr(import_module(loop.module), loop.name)
                function.compile(types_of(loop.signature))
                yield loop


def types_of(signature: str) -> tuple[Any, ...]:
    """Return the types of a signature.

    Parameters
    ----------
    signature
        Types of the arguments as Numba writes them, a tuple.
    """
    from numba.core.sigutils import normalize_signature

    return tuple(normalize_signature(signature)[0])  # type: ignore[no-untyped-call]  # Numba has no types


def _end_with_parent() -> None:
    sys.stdin.buffer.read()  # until it is closed
    os._exit(0)


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for _ in compile_all():
        pass
