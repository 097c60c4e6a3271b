"""Limit BLAS to a single thread: several are slower for small matrices, and rounding depends on the thread count."""

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
    """Limit BLAS to a single thread in a ``with`` block; the last concurrent block restores the thread count."""
    global _blocks
    with _lock:
        if not _blocks:
            _limited[:] = [(library, count) for library in _libraries() if (count := library.num_threads) != 1]
            _set_threads((library, 1) for library, _ in _limited)
        _blocks += 1
    try:
        yield
    except SystemError as error:
        # if machine code calls Python, Ctrl-C arrives as the cause of a SystemError
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
    """Limit BLAS to a single thread while a generator function runs."""

    @wraps(make)
    def iterate(*args: P.args, **kwargs: P.kwargs) -> Iterator[Item]:
        with one_thread():
            yield from make(*args, **kwargs)

    return iterate


@cache  # listing libraries takes some milliseconds
def _libraries() -> list[Any]:
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


def _set_threads(counts: Iterable[tuple[Any, int]]) -> None:
    for library, count in counts:
        # threadpoolctl 3.8 and later accepts calls from a single controlling thread until a release
        release = getattr(library, "clear_controlling_thread", lambda **_: None)
        release(force=True)
        library.set_num_threads(count)
        release(force=True)
