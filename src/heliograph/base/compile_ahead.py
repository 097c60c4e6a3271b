"""Other cores compile too: loops that the first use needs later, from the last to the first.

When a loop of the list `first_use.txt` has to be compiled, helper processes are started that share out the others of
the list and compile them from its end. What they have finished is found in the folder where machine code is kept. The
process that started them tells them what it compiles itself, and they end with it.
"""

import contextlib
import hashlib
import multiprocessing
import os
import subprocess
import sys
import threading
from collections.abc import Container, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

SWITCH = "HELIOGRAPH_COMPILE_AHEAD"
"""Environment variable that is 0 where no helper is to be started."""

HELPERS = 3
"""Helpers at most: each loads Numba, 0.2 GB, and what all of them need of it is compiled by each."""

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
"""The helpers of this process, once they were started."""


def begins(module: str, name: str, signature: Any) -> None:
    """Tell the helpers that this process compiles a loop now; start them where there are none yet and it is listed.

    Parameters
    ----------
    module, name
        The function's module, and its name there.
    signature
        Types of its arguments.
    """
    if not _helpers and any(loop[:2] == (module, name) for part in loops() for loop in part) and _may_help():
        count = min(_cores() - 1, HELPERS)
        with contextlib.suppress(OSError):
            _helpers.extend(_helper(number, count) for number in range(count))
    for helper in _helpers:
        # it may have ended, or its pipe be closed
        with contextlib.suppress(OSError, ValueError):
            if helper.stdin is not None:
                helper.stdin.write(_key(module, name, signature) + b"\n")


def _key(module: str, name: str, signature: Any) -> bytes:
    """What tells a loop from others in a few bytes."""
    return hashlib.sha256(f"{module} {name} {signature}".encode()).hexdigest()[:16].encode()


def _may_help() -> bool:
    """Whether another process may work beside this one."""
    # an application that is frozen is no Python, and workers have a core each already
    alone = bool(sys.executable) and not getattr(sys, "frozen", False) and multiprocessing.parent_process() is None
    return alone and _cores() > 1 and os.environ.get(SWITCH) != "0"


def _helper(number: int, count: int) -> "subprocess.Popen[bytes]":
    """Start one of so many helpers; its standard input ends with this process."""
    return subprocess.Popen(
        [sys.executable, "-m", __name__, str(number), str(count)],
        bufsize=0,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, SWITCH: "0"},
    )


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_all(begun: Container[bytes] = (), number: int = 0, count: int = 1) -> Iterator[Loop]:
    """Compile the loops of the list that are not kept yet, part by part, each from its end.

    Parameters
    ----------
    begun
        Those that another process has begun; it may grow meanwhile.
    number, count
        Which of so many helpers this is, from 0.

    Yields
    ------
    Loop
        Each that is there now; what cannot be compiled is left out, for the list may be an older one.
    """
    for loop in [loop for part in loops() for loop in reversed(part)][number::count]:
        with contextlib.suppress(Exception):
            function, types = getattr(import_module(loop.module), loop.name), types_of(loop.signature)
            if _key(loop.module, loop.name, types) not in begun:
                function.compile(types)
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


def _listen(begun: set[bytes]) -> None:
    """Hear what the parent compiles, and end with it."""
    for line in sys.stdin.buffer:
        begun.add(line.strip())
    os._exit(0)


if __name__ == "__main__":
    heard = set[bytes]()
    threading.Thread(target=_listen, args=(heard,), daemon=True).start()
    for _ in compile_all(heard, *map(int, sys.argv[1:])):
        pass
    # an orderly end would wait for the thread that reads, and fail
    os._exit(0)
