"""Values handed on from one task to the next, which stay in the process that does the tasks."""

from collections.abc import Callable
from typing import Any, ClassVar, Generic, TypeVar
from uuid import uuid4

T = TypeVar("T")


class Shared(Generic[T]):
    """Hands a value on from task to task, each of which holds this.

    Another process that it is handed to has a content of its own, which stays there from task to task. Each kind of
    value has a class, made by the name alone, that says how many another process keeps.

    Parameters
    ----------
    content
        The value before the first task.
    name
        What tells it from others in another process; None for a new name.
    """

    kept: ClassVar[int]

    def __init__(self, content: T, name: str | None = None) -> None:
        self._content, self._name = content, name or uuid4().hex

    def __reduce__(self) -> tuple[Any, ...]:
        return _of_this_process, (type(self), self._name, self.kept)

    @property
    def content(self) -> T:
        """The value after the last task that was done; what it began with before the first."""
        return self._content

    def keep(self, content: T) -> None:
        """Hand another value on from now on.

        Parameters
        ----------
        content
            The value after a task.
        """
        self._content = content


_HERE: dict[Callable[[str], Shared[Any]], dict[str, Shared[Any]]] = {}
"""What other processes have handed to this one, by kind and name, those asked for last at the end."""


def _of_this_process(kind: Callable[[str], Shared[Any]], name: str, kept: int) -> Shared[Any]:
    """What stands here for one of another process."""
    here = _HERE.setdefault(kind, {})
    here[name] = found = here.pop(name, None) or kind(name)
    while len(here) > kept:
        del here[next(iter(here))]
    return found
