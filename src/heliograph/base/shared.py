"""Values handed on from task to task, which stay in the process that does the tasks."""

from collections.abc import Callable
from typing import Any, ClassVar, Generic, TypeVar
from uuid import uuid4

T = TypeVar("T")


class Shared(Generic[T]):
    """Value that each task hands on to the next; a subclass, made by name, sets how many another process keeps.

    Pickling sends the name only: another process keeps a separate content from task to task.
    """

    kept: ClassVar[int]

    def __init__(self, content: T, name: str | None = None) -> None:
        self.content, self._name = content, name or uuid4().hex

    def __reduce__(self) -> tuple[Any, ...]:
        return _of_this_process, (type(self), self._name, self.kept)

    def keep(self, content: T) -> None:
        """Hand on another value from now on."""
        self.content = content


_HERE: dict[Callable[[str], Shared[Any]], dict[str, Shared[Any]]] = {}
"""Values of other processes by kind and name, the latest used at the end."""


def _of_this_process(kind: Callable[[str], Shared[Any]], name: str, kept: int) -> Shared[Any]:
    """Return the value of this process that stands for a value of another process."""
    here = _HERE.setdefault(kind, {})
    here[name] = value = here.pop(name, None) or kind(name)
    while len(here) > kept:
        del here[next(iter(here))]
    return value
