"""Limited stores of films and transmissions, and limits of concurrent work."""

import contextlib
import secrets
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from math import inf
from pathlib import Path
from typing import Any, Generic, TypeVar

from heliograph.base.errors import HeliographError, MediaError

T = TypeVar("T")


class BusyError(HeliographError):
    """Too much concurrent work of a kind."""


class MissingError(MediaError):
    """Unknown key or name."""


class Places:
    """Limit of concurrent work of a kind, used by the event loop only."""

    def __init__(self, count: int, name: str):
        self._count, self._name, self.taken = count, name, 0

    @property
    def are_taken(self) -> bool:
        """True if all places are occupied."""
        return self.taken >= self._count

    @contextlib.contextmanager
    def take(self) -> Iterator[None]:
        """Occupy a place during the block; raise a BusyError if all places are occupied."""
        if self.are_taken:
            raise BusyError(f"{self._count} {self._name} run already: end a session, or try again later")
        self.taken += 1
        try:
            yield
        finally:
            self.taken -= 1


class Store(Generic[T]):
    """Values by random key; a new value replaces the least recently used value; thread-safe."""

    def __init__(
        self,
        max_count: int,
        missing: str,
        discard: Callable[[T], Any] = lambda _: None,
        max_size: float = inf,
        size_of: Callable[[T], int] = lambda _: 0,
    ):
        self._max_count, self._missing, self._discard = max_count, missing, discard
        self._max_size, self._size_of = max_size, size_of
        self._values: OrderedDict[str, T] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, value: T) -> str:
        """Add a value and return the key."""
        key = secrets.token_hex(16)
        with self._lock:
            self._values[key] = value
        self.trim()
        return key

    def trim(self) -> None:
        """Discard the least recently used values beyond the limits of number and size; the last value stays."""
        with self._lock:
            keys, sizes = list(self._values), [self._size_of(value) for value in self._values.values()]
        while len(keys) > 1 and (len(keys) > self._max_count or sum(sizes) > self._max_size):
            self.drop(keys.pop(0))
            sizes.pop(0)

    def of(self, key: str) -> T:
        """Return a value; raise a MissingError for an unknown key."""
        with self._lock:
            if key not in self._values:
                raise MissingError(self._missing)
            self._values.move_to_end(key)
            return self._values[key]

    def drop(self, key: str) -> None:
        """Discard a value; ignore unknown keys."""
        with self._lock:
            value = self._values.pop(key, None)
        if value is not None:
            self._discard(value)

    def items(self) -> dict[str, T]:
        """Return all values by key, the least recently used first."""
        return dict(self._values)


class StoredFilm:
    """Film file, deleted after `drop` as soon as no reader remains; thread-safe."""

    def __init__(self, path: Path):
        self.path, self._readers, self._is_dropped = path, 0, False
        self._lock = threading.Lock()

    @property
    def size(self) -> int:
        """Size in bytes; 0 for a missing file."""
        return self.path.stat().st_size if self.path.exists() else 0

    @contextlib.contextmanager
    def reading(self) -> Iterator[Path]:
        """Yield the path; the file stays during the block."""
        self._update(readers=1)
        try:
            yield self.path
        finally:
            self._update(readers=-1)

    def drop(self) -> None:
        """Delete the file, or leave the deletion to the last reader."""
        self._update(is_dropped=True)

    def _update(self, readers: int = 0, is_dropped: bool = False) -> None:
        with self._lock:
            self._readers += readers
            self._is_dropped |= is_dropped
            if self._is_dropped and not self._readers:
                self.path.unlink(missing_ok=True)
