"""Limit BLAS to a single thread: several are slower for small matrices, and rounding depends on the thread count."""

import threading
from collections.abc import Callable, Iterator
from contextlib import ContextDecorator
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
P = ParamSpec("P")


class _OneThread(ContextDecorator):
    """Limit BLAS to a single thread in a ``with`` block; the last concurrent block restores the thread count."""

    def __init__(self) -> None:
        self._lock, self._blocks, self._limited = threading.Lock(), 0, list[tuple[Any, int]]()

    def __enter__(self) -> None:
        with self._lock:
            if not self._blocks:
                self._limited = [(library, count) for library in _libraries() if (count := library.num_threads) != 1]
                for library, _ in self._limited:
                    _set_threads(library, 1)
            self._blocks += 1

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        with self._lock:
            self._blocks -= 1
            if not self._blocks:
                for library, count in self._limited:
                    _set_threads(library, count)
        # if machine code calls Python, Ctrl-C arrives as the cause of a SystemError
        cause: BaseException | None = error if isinstance(error, SystemError) else None
        while cause is not None and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__cause__
        if cause is not None:
            raise cause from None


_ONE_THREAD = _OneThread()


def one_thread() -> _OneThread:
    """Return the context manager and decorator that limits BLAS to a single thread."""
    return _ONE_THREAD


def in_one_thread(make: Callable[P, Iterator[Item]]) -> Callable[P, Iterator[Item]]:
    """Limit BLAS to a single thread while a generator function runs."""

    @wraps(make)
    def iterate(*args: P.args, **kwargs: P.kwargs) -> Iterator[Item]:
        with _ONE_THREAD:
            yield from make(*args, **kwargs)

    return iterate


@cache  # listing libraries takes some milliseconds
def _libraries() -> list[Any]:
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


def _set_threads(library: Any, count: int) -> None:
    # threadpoolctl 3.8 and later accepts calls from a single controlling thread until a release
    release = getattr(library, "clear_controlling_thread", lambda **_: None)
    release(force=True)
    library.set_num_threads(count)
    release(force=True)
