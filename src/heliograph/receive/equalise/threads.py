"""One thread for the equaliser's algebra.

A BLAS that shares matrices of 256 rows among threads is many times slower.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


@lru_cache(maxsize=1)  # finding the libraries takes some milliseconds
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold BLAS to one thread within a ``with`` block."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield
