"""Parts by name: built in, registered by a program, or provided by other packages through entry points."""

import hashlib
import os
import re
import sys
from collections.abc import Mapping
from difflib import get_close_matches
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar, cast

from heliograph.base.errors import SettingsError, shown
from heliograph.base.files import read_bounded

T = TypeVar("T")
_registries: dict[str, "Registry[Any]"] = {}  # by entry-point group
_files: dict[str, bytes] = {}  # file contents by path, for files run by load_parts
_failures: list[str] | None = None  # load errors in a worker process; None in the main process


class Registry(Generic[T]):
    """Named parts of a kind: an entry-point group, registered parts, and built-in parts as "module:attribute"."""

    def __init__(self, kind: str, group: str, built_in: Mapping[str, str]):
        self._kind, self._group, self.built_in = kind, group, dict(built_in)
        self._registered: dict[str, T] = {}
        self.origins: dict[str, str] = {}  # defining module by part name
        _registries[group] = self

    def register(self, name: str, part: T, make: Any) -> None:
        """Add or replace a part and the maker; raise a SettingsError if the name or the maker is invalid."""
        if not callable(make):
            raise SettingsError(f"a {self._kind} is made by a function or a class, not by {shown(make)}")
        if not (isinstance(name, str) and re.fullmatch(r"[\w.-]+", name)):
            raise SettingsError(f"a {self._kind}'s name has letters, digits, '-', '_' and '.', not {shown(name)}")
        if name in self.built_in:
            raise SettingsError(f"the {self._kind} '{name}' is one of the package; choose another name")
        self._registered[name] = part
        self.origins[name] = getattr(make, "__module__", None) or "__main__"

    def __getitem__(self, name: str) -> T:
        """Return a part by name; raise a SettingsError for an unknown name or a failed import."""
        self.check(name)
        if name in self._registered:
            return self._registered[name]
        if name in self.built_in:
            return cast(T, EntryPoint(name, self.built_in[name], self._group).load())
        entry = _entries(self._group)[name]
        try:
            return cast(T, entry.load())
        except Exception as error:  # foreign code may raise any error
            raise SettingsError(f"the {self._kind} '{name}' of {entry.value} cannot be loaded: {error}") from error

    def check(self, name: str) -> str:
        """Return a known name; for an unknown name raise a SettingsError with the nearest match."""
        if name in self.names():
            return name
        if _failures is not None:
            cure = "register it at the top level of a module, or write it into a file and load that by load_parts(FILE)"
            reason = "; ".join(_failures) or cure
            raise SettingsError(f"the {self._kind} '{name}' is not registered in this worker process: {reason}")
        close = get_close_matches(name, self.names(), 1)
        hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(self.names())}; others come by --load"
        raise SettingsError(f"unknown {self._kind} '{name}'; {hint}")

    def names(self) -> list[str]:
        """Return the names of all parts, built-in parts first."""
        return [*self.built_in, *sorted({*self._registered, *_entries(self._group)} - set(self.built_in))]


def load_parts(file: Path | str) -> None:
    """Run a Python file that registers parts.

    Parameters
    ----------
    file
        Path to a Python file, which can import modules from the same folder.

    Raises
    ------
    SettingsError
        The file cannot be read or raises an exception.
    """
    if not isinstance(file, (str, os.PathLike)):
        raise SettingsError(f"load_parts takes the path of a Python file, not {shown(file)}")
    path = Path(file).resolve()
    try:
        source = read_bounded(Path(file), 1 << 24)
    except OSError as error:
        raise SettingsError(f"cannot load {file}: {error.strerror or error}; check the path") from None
    if str(path.parent) not in sys.path:
        sys.path.insert(0, str(path.parent))
    # files with equal names in different folders are different modules
    name = f"loaded_{path.stem}_{hashlib.sha256(os.fsencode(path)).hexdigest()[:8]}"
    module = sys.modules[name] = ModuleType(name)
    module.__file__ = str(path)
    try:
        exec(compile(source, path, "exec"), module.__dict__)
    except Exception as error:  # foreign code may raise any error
        del sys.modules[name]
        raise SettingsError(f"cannot load {file}: {type(error).__name__}: {error}") from error
    _files[str(path)] = source


def registered() -> tuple[str, ...]:
    """Return the files and module names that register parts, for `register_again` in a worker process."""
    modules = {module for registry in _registries.values() for module in registry.origins.values()}
    imported = sorted(module for module in modules if not module.startswith("loaded_"))
    sources = [_find_file(module) if module == "__main__" else module for module in imported]
    return (*_files, *filter(None, sources))


@lru_cache  # a cluster worker receives the sources with each task
def register_again(sources: tuple[str, ...]) -> None:
    """Run files and import modules that register parts, in a worker process."""
    global _failures
    _failures = []
    for source in sources:
        try:
            if not source.endswith(".py"):
                import_module(source)
            elif source not in _files and source != _find_file("__mp_main__"):  # multiprocessing runs the main script
                load_parts(source)
        except Exception as error:  # foreign code may raise any error
            _failures.append(str(error))


def digest() -> str:
    """Return a digest of all external parts, as results depend on the code."""
    about = hashlib.sha256()
    for source in registered():
        file = _find_file(source)
        about.update(_files.get(source) or (Path(file).read_bytes() if file else b""))
    for group, registry in sorted(_registries.items()):
        offered = [(entry.name, entry.value, entry.dist and entry.dist.version) for entry in _entries(group).values()]
        if registry.origins or offered:  # which other registries exist depends on the imported modules
            about.update(repr((group, sorted(registry.origins), offered)).encode())
    return about.hexdigest()[:12]


def _find_file(source: str) -> str | None:
    """Return the file for a source, given as a path or an imported module; None if no file exists."""
    file = source if source.endswith(".py") else getattr(sys.modules.get(source), "__file__", None)
    return str(Path(file).resolve()) if file and Path(file).is_file() else None


@lru_cache  # listing installed packages takes some milliseconds
def _entries(group: str) -> Mapping[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=group)}
