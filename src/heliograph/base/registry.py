"""Parts by name: those of the package, those a program registers, and those other packages offer by entry points."""

import re
from collections.abc import Mapping
from difflib import get_close_matches
from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

from heliograph.base.errors import SettingsError

T = TypeVar("T")

_REGISTRIES: dict[str, "Registry[Any]"] = {}
_WAITING: dict[str, dict[str, Any]] = {}


class Registry(Generic[T]):
    """Parts of one kind by name.

    Parameters
    ----------
    kind
        What a part is called in messages, such as "receiver".
    group
        Entry-point group by which installed packages offer parts, such as "heliograph.receivers".
    built_in
        Parts of the package: where each is found, as "module:attribute". It is imported when first asked for.
    """

    def __init__(self, kind: str, group: str, built_in: Mapping[str, str]):
        self._kind, self._group, self._built_in = kind, group, dict(built_in)
        self._own: dict[str, T] = _WAITING.pop(group, {})
        _REGISTRIES[group] = self

    def register(self, name: str, part: T) -> None:
        """Add a part of one's own, in place of an earlier one of that name.

        Parameters
        ----------
        name
            Its name: letters, digits, "-", "_" and ".".
        part
            The part.

        Raises
        ------
        SettingsError
            The name is that of a part of the package, or is no name.
        """
        if not re.fullmatch(r"[\w.-]+", name):
            raise SettingsError(f"a {self._kind}'s name has letters, digits, '-', '_' and '.', not {name!r}")
        if name in self._built_in:
            raise SettingsError(f"the {self._kind} '{name}' is one of the package; choose another name")
        self._own[name] = part

    def __getitem__(self, name: str) -> T:
        """Part of a name.

        Raises
        ------
        SettingsError
            There is none, or the package that offers it cannot be loaded; the message names the nearest.
        """
        self.check(name)
        if name in self._own:
            return self._own[name]
        found: T
        if name in self._built_in:
            module, _, attribute = self._built_in[name].partition(":")
            found = getattr(import_module(module), attribute)
            return found
        entry = next(entry for entry in _offered(self._group) if entry.name == name)
        try:
            found = entry.load()
        except Exception as error:  # whatever goes wrong within somebody else's package
            raise SettingsError(f"the {self._kind} '{name}' of {entry.value} cannot be loaded: {error}") from error
        return found

    def check(self, name: str) -> str:
        """Return the name of a part.

        Raises
        ------
        SettingsError
            There is none of that name; the message names the nearest.
        """
        if name not in self.names():
            close = get_close_matches(name, self.names(), 1)
            hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(self.names())}"
            raise SettingsError(f"unknown {self._kind} '{name}'; {hint}")
        return name

    def names(self) -> list[str]:
        """Names of all parts, those of the package first."""
        offered = [entry.name for entry in _offered(self._group)]
        return [*self._built_in, *sorted({*self._own, *offered} - set(self._built_in))]

    def is_built_in(self, name: str) -> bool:
        """Whether a part is one of the package."""
        return name in self._built_in

    @property
    def own(self) -> Mapping[str, T]:
        """Parts that this program registered."""
        return dict(self._own)


def registered() -> dict[str, Mapping[str, Any]]:
    """Parts that this program registered, by entry-point group: what a worker process must be given."""
    return {group: registry.own for group, registry in _REGISTRIES.items() if registry.own}


def register_all(parts: Mapping[str, Mapping[str, Any]]) -> None:
    """Register the parts of another process, as of `registered`; those of a kind not loaded yet wait for it."""
    for group, named in parts.items():
        if group not in _REGISTRIES:
            _WAITING.setdefault(group, {}).update(named)
            continue
        for name, part in named.items():
            _REGISTRIES[group].register(name, part)


@lru_cache  # finding the installed packages takes some milliseconds
def _offered(group: str) -> tuple[Any, ...]:
    return tuple(entry_points(group=group))
