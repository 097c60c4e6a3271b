"""One thread for the algebra of receivers and panels.

A BLAS that shares matrices of 256 rows among threads is many times slower, and rounds otherwise than in one.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")


@lru_cache(maxsize=1)  # finding the libraries takes some milliseconds
def _libraries() -> list[Any]:
    blas: list[Any] = ThreadpoolController().select(user_api="blas").lib_controllers
    return blas


class _Holders:
    """Blocks that hold BLAS to one thread. Its number of threads is the process's, so the last to leave restores it."""

    def __init__(self) -> None:
        self._lock, self._count = threading.Lock(), 0
        # libraries and the numbers of threads that they had, of those that had more than one
        self._before: list[tuple[Any, int]] = []

    def enter(self) -> None:
        with self._lock:
            if not self._count:
                self._before = [(one, number) for one in _libraries() if (number := one.num_threads) != 1]
                for library, _ in self._before:
                    _set(library, 1)
            self._count += 1

    def leave(self) -> None:
        with self._lock:
            self._count -= 1
            if not self._count:
                for library, before in self._before:
                    _set(library, before)


def _set(library: Any, threads: int) -> None:
    """Set a library's number of threads. From 3.8 on threadpoolctl heeds one thread alone, until that lets go."""
    let_go = getattr(library, "clear_controlling_thread", None)
    if let_go:
        let_go(force=True)
    library.set_num_threads(threads)
    if let_go:
        let_go(force=True)


_holders = _Holders()


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold BLAS to one thread within a ``with`` block.

    Several threads of a process may be in such blocks at a time: the first to enter limits BLAS, and the last to leave
    gives it back the number of threads it had. A BLAS built with OpenMP keeps a number for each thread; there the first
    thread alone is limited.
    """
    _holders.enter()
    try:
        yield
    finally:
        _holders.leave()


def in_one_thread(items: Iterator[Item]) -> Iterator[Item]:
    """Hold BLAS to one thread while an item is made, not while the caller has it.

    Parameters
    ----------
    items
        What makes them, one by one.

    Yields
    ------
    Item
        The same items.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C came, wherever that was.
    """
    while True:
        # not by the context manager: it would cost each frame a generator of its own
        _holders.enter()
        try:
            item = next(items, _END)
        except SystemError as error:
            if interrupt := _interrupt_of(error):
                raise interrupt from None
            raise
        finally:
            _holders.leave()
        if isinstance(item, _End):
            return
        yield item


def _interrupt_of(error: BaseException | None) -> KeyboardInterrupt | None:
    """The Ctrl-C that an error is due to: amid machine code that calls Python it comes as a SystemError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error


class _End:
    """No item is left."""


_END = _End()
