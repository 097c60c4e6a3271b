"""Limit the algebra of receivers and panels to one thread.

A BLAS that shares matrices of 256 rows among threads is many times slower, and rounds in another way.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")


class _Limit:
    """Limit of BLAS to one thread while any block needs it. The last block restores the number of the process."""

    def __init__(self) -> None:
        self._lock, self._count = threading.Lock(), 0
        self._before: list[tuple[Any, int]] = []

    def enter(self) -> None:
        with self._lock:
            if not self._count:
                self._before = [(library, n) for library in _libraries() if (n := library.num_threads) != 1]
                for library, _ in self._before:
                    _set_threads(library, 1)
            self._count += 1

    def leave(self) -> None:
        with self._lock:
            self._count -= 1
            if not self._count:
                for library, before in self._before:
                    _set_threads(library, before)


@lru_cache(maxsize=1)  # searching for the libraries takes some milliseconds
def _libraries() -> list[Any]:
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


def _set_threads(library: Any, threads: int) -> None:
    # from 3.8 on threadpoolctl obeys one thread only, until that releases the control
    release = getattr(library, "clear_controlling_thread", lambda **_: None)
    release(force=True)
    library.set_num_threads(threads)
    release(force=True)


_limit = _Limit()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to one thread in a ``with`` block; threads may be in such blocks at the same time.

    A BLAS built with OpenMP keeps a number for each thread, so that only the first thread is limited.
    """
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()


_END = object()


def in_one_thread(items: Iterator[Item]) -> Iterator[Item]:
    """Limit BLAS to one thread while an item is made, and raise a KeyboardInterrupt for Ctrl-C in machine code."""
    while True:
        # the context manager would cost each frame a generator
        _limit.enter()
        try:
            item: Any = next(items, _END)
        except SystemError as error:
            # Ctrl-C in machine code that calls Python comes as the cause of a SystemError
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, KeyboardInterrupt):
                cause = cause.__cause__
            if cause is not None:
                raise cause from None
            raise
        finally:
            _limit.leave()
        if item is _END:
            return
        yield item
