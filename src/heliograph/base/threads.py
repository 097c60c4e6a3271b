"""Limit BLAS to a single thread: several are slower for small matrices, and rounding depends on the thread count."""

import threading
from collections.abc import Callable, Iterator
from contextlib import ContextDecorator
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
P = ParamSpec("P")


class one_thread(ContextDecorator):  # noqa: N801 - used like a function, as those of contextlib
    """Limit BLAS to a single thread in a ``with`` block; the last concurrent block restores the thread count."""

    _lock, _blocks, _limited = threading.Lock(), 0, list[tuple[Any, int]]()

    def __enter__(self) -> None:
        with one_thread._lock:
            if not one_thread._blocks:
                one_thread._limited = [(lib, count) for lib in _libraries() if (count := lib.num_threads) != 1]
                for library, _ in one_thread._limited:
                    _set_threads(library, 1)
            one_thread._blocks += 1

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        with one_thread._lock:
            one_thread._blocks -= 1
            if not one_thread._blocks:
                for library, count in one_thread._limited:
                    _set_threads(library, count)
        # if machine code calls Python, Ctrl-C arrives as the cause of a SystemError
        cause: BaseException | None = error if isinstance(error, SystemError) else None
        while cause is not None and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__cause__
        if cause is not None:
            raise cause from None


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


def _set_threads(library: Any, count: int) -> None:
    # threadpoolctl 3.8 and later accepts calls from a single controlling thread until a release
    release = getattr(library, "clear_controlling_thread", lambda **_: None)
    release(force=True)
    library.set_num_threads(count)
    release(force=True)
