"""Limit the algebra of receivers and panels to one thread: BLAS shares small matrices slowly, and rounds otherwise."""

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
P = ParamSpec("P")

_lock = threading.Lock()
_blocks = 0
_limited: list[tuple[Any, int]] = []


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to one thread in a ``with`` block; the last of simultaneous blocks restores the number of threads."""
    global _blocks
    with _lock:
        if not _blocks:
            _limited[:] = [(library, count) for library in _libraries() if (count := library.num_threads) != 1]
            _set_threads((library, 1) for library, _ in _limited)
        _blocks += 1
    try:
        yield
    except SystemError as error:
        # Ctrl-C in machine code that calls Python comes as the cause of a SystemError
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__cause__
        raise cause or error from None
    finally:
        with _lock:
            _blocks -= 1
            if not _blocks:
                _set_threads(_limited)


def in_one_thread(make: Callable[P, Iterator[Item]]) -> Callable[P, Iterator[Item]]:
    """Limit BLAS to one thread while a generator function runs."""

    @wraps(make)
    def iterate(*args: P.args, **kwargs: P.kwargs) -> Iterator[Item]:
        with one_thread():
            yield from make(*args, **kwargs)

    return iterate


@cache  # searching for the libraries takes some milliseconds
def _libraries() -> list[Any]:
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


def _set_threads(counts: Iterable[tuple[Any, int]]) -> None:
    for library, count in counts:
        # from 3.8 on threadpoolctl obeys only one thread until that releases the control
        release = getattr(library, "clear_controlling_thread", lambda **_: None)
        release(force=True)
        library.set_num_threads(count)
        release(force=True)
