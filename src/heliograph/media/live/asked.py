"""What a camera was asked for, beside what it made of it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from heliograph.base.errors import MediaError, SettingsError

ROUNDED = 1e-4
"""Relative difference of numbers up to which they are the same: a camera may hold them in single precision, or in whole
lines. Chosen."""

Value = str | float | Sequence[int]
"""A setting's value: text, a number, or a region."""


class Asked:
    """Settings of a camera, as asked for and as read back."""

    def __init__(self) -> None:
        self.settings: dict[str, object] = {}
        self.departures: list[str] = []

    @contextmanager
    def setting(self, name: str, value: Value, known: Callable[[], Sequence[str]] | None = None) -> Iterator[None]:
        """Turn a camera's error, raised in the block that sets it, into one that names the setting."""
        try:
            yield
        except MediaError as error:
            values = f"; it knows {', '.join(known())}" if known else ""
            raise SettingsError(f"the camera does not take {name}={_written(value)}: {error}{values}") from None

    def got(self, name: str, asked: Value | None, value: Value) -> None:
        """Keep a value as read back, and note where it is another one than was asked for."""
        self.settings[name] = _written(value)
        if asked is not None and not _same(asked, value):
            self.departures.append(f"{name} is {_written(value)}, asked for {_written(asked)}")


def _same(asked: Value, value: Value) -> bool:
    if asked == value:
        return True
    one, other = _written(asked), _written(value)
    try:
        return abs(float(one) - float(other)) <= ROUNDED * abs(float(one))
    except ValueError:  # no numbers
        return one.lower() == other.lower()


def _written(value: Value) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if isinstance(value, (int, float)) else ",".join(map(str, value))
