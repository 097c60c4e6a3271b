"""Parts by name: those of the package, those a program registers, and those other packages offer by entry points."""

import hashlib
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, Generic, TypeVar

from heliograph.base.errors import SettingsError, shown
from heliograph.base.files import read_bounded

MOST_SOURCE = 1 << 24
"""Most bytes of a file that registers parts. Chosen; the largest of the package has 16 kB."""

T = TypeVar("T")

_REGISTRIES: dict[str, "Registry[Any]"] = {}
_LOADED: dict[str, "Module"] = {}
_MISSING: dict[tuple[str, str], str] = {}


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
        self._own: dict[str, T] = {}
        self.origins: dict[str, str] = {}
        _REGISTRIES[group] = self

    def register(self, name: str, part: T) -> None:
        """Add a part of one's own, in place of an earlier one of that name.

        Parameters
        ----------
        name
            Its name: letters, digits, "-", "_" and ".".
        part
            What ``registry[name]`` is to return.

        Raises
        ------
        SettingsError
            The name is that of a part of the package, or is no name.
        """
        if not (isinstance(name, str) and re.fullmatch(r"[\w.-]+", name)):
            raise SettingsError(f"a {self._kind}'s name has letters, digits, '-', '_' and '.', not {shown(name)}")
        if name in self._built_in:
            raise SettingsError(f"the {self._kind} '{name}' is one of the package; choose another name")
        self._own[name] = part
        self.origins[name] = _registering()

    def register_maker(self, name: str, make: Any, part: T) -> None:
        """Add a part as `register` does, if what makes it is a function or a class.

        Parameters
        ----------
        name
            Its name, as of `register`.
        make
            What makes the part.
        part
            What ``registry[name]`` is to return.

        Raises
        ------
        SettingsError
            As of `register`; or `make` cannot be called.
        """
        if not callable(make):
            raise SettingsError(f"a {self._kind} is made by a function or a class, not by {shown(make)}")
        self.register(name, part)

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
        """Return the name of a part, if there is one.

        Parameters
        ----------
        name
            Name as the user wrote it.

        Raises
        ------
        SettingsError
            There is none of that name; the message names the nearest.
        """
        if name not in self.names():
            if (self._group, name) in _MISSING:
                raise SettingsError(_MISSING[self._group, name])
            close = get_close_matches(name, self.names(), 1)
            known = f"there are {', '.join(self.names())}; others come by --load"
            hint = f"did you mean '{close[0]}'?" if close else known
            raise SettingsError(f"unknown {self._kind} '{name}'; {hint}")
        return name

    def names(self) -> list[str]:
        """Names of all parts, those of the package first."""
        offered = [entry.name for entry in _offered(self._group)]
        return [*self._built_in, *sorted({*self._own, *offered} - set(self._built_in))]

    def is_built_in(self, name: str) -> bool:
        """Whether a part is one of the package.

        Parameters
        ----------
        name
            Name of the part; False if no part has it.
        """
        return name in self._built_in


@dataclass(frozen=True, slots=True)
class Module:
    """A module that registers parts, as another process can run it again.

    Attributes
    ----------
    name
        Name by which it is imported, or under which ``sys.modules`` holds it once its file was run.
    file
        Its file; None for a module that is imported by its name.
    source
        Text of that file, as the other process may be on another machine.
    """

    name: str
    file: str | None = None
    source: str = ""


@dataclass(frozen=True, slots=True)
class Part:
    """A part that a program registered, as another process can register it again.

    Attributes
    ----------
    group, name
        Entry-point group of its kind, and its name.
    module
        The module that registers it; None where it was registered by hand, in a notebook or an interpreter.
    """

    group: str
    name: str
    module: Module | None


def load_parts(file: Path | str) -> None:
    """Run a Python file that registers parts of one's own.

    Parameters
    ----------
    file
        The file. It can import what lies beside it.

    Raises
    ------
    SettingsError
        The file cannot be read, or ends in an error.
    """
    if not isinstance(file, (str, os.PathLike)):
        raise SettingsError(f"load_parts takes the path of a Python file, not {shown(file)}")
    file = Path(file)
    try:
        source = read_bounded(file, MOST_SOURCE).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"cannot load {file}: {getattr(error, 'strerror', None) or error}") from None
    # files of one name in different folders are different modules
    place = hashlib.sha256(os.fsencode(file.resolve())).hexdigest()[:8]
    _run(Module(f"loaded_{file.stem}_{place}", str(file.resolve()), source))


def registered() -> tuple[Part, ...]:
    """Return the parts that this program registered, for `register_again` in another process."""
    return tuple(
        Part(group, name, _module(module))
        for group, registry in _REGISTRIES.items()
        for name, module in registry.origins.items()
    )


def digest() -> str:
    """Return a digest of the code of all parts that are not the package's: results depend on it."""
    about = hashlib.sha256()
    for part in registered():
        source = "" if part.module is None else part.module.source or _text(part.module.name)
        about.update(repr((part.group, part.name, source)).encode())
    for group in _REGISTRIES:
        for entry in _offered(group):
            about.update(repr((group, entry.name, entry.value, entry.dist and entry.dist.version)).encode())
    return about.hexdigest()[:12]


def _text(module: str) -> str:
    """Source of an imported module; empty where it has none."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file).read_text(encoding="utf-8", errors="replace") if file and Path(file).is_file() else ""


@lru_cache  # a cluster's worker gets them with each task
def register_again(parts: tuple[Part, ...]) -> None:
    """Run the modules that register parts. A part that they do not register is an error once it is asked for.

    Parameters
    ----------
    parts
        As of `registered` in another process.
    """
    failed: dict[Module, str] = {}
    for module in dict.fromkeys(part.module for part in parts if part.module):
        try:
            if module.file is None:
                import_module(module.name)
            elif module.name not in sys.modules:
                _run(module)
        except Exception as error:  # whatever goes wrong within somebody else's module
            failed[module] = str(error)
    for part in parts:
        if part.module is None:
            reason = "write it into a file, and load that by heliograph.load_parts(FILE)"
        else:
            reason = failed.get(part.module, "register it where its module is run, not in a function or under 'if'")
        _MISSING[part.group, part.name] = f"'{part.name}' is not registered in this worker process: {reason}"


def _run(module: Module) -> None:
    """Run a module from its source; it can import what lies beside its file."""
    folder = str(Path(module.file).parent) if module.file else ""
    if folder not in sys.path:
        sys.path.insert(0, folder)
    found = sys.modules[module.name] = ModuleType(module.name)
    found.__file__ = module.file
    _LOADED[module.name] = module
    try:
        exec(compile(module.source, module.file or module.name, "exec"), found.__dict__)
    except Exception as error:  # whatever goes wrong within somebody else's file
        del sys.modules[module.name]
        raise SettingsError(f"cannot load {module.file}: {type(error).__name__}: {error}") from error


def _module(name: str) -> Module | None:
    """Return a module of this program so that another process can run it."""
    if name in _LOADED:
        return _LOADED[name]
    if name != "__main__":
        return Module(name)
    file = getattr(sys.modules[name], "__file__", None)
    return Module("__mp_main__", file, Path(file).read_text(encoding="utf-8")) if file else None


def _registering() -> str:
    """Return the name of the module that is being run."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        name = str(frame.f_globals.get("__name__"))
        if frame.f_code.co_name == "<module>" and not name.startswith("heliograph."):
            return name
        frame = frame.f_back
    return "__main__"


@lru_cache  # finding the installed packages takes some milliseconds
def _offered(group: str) -> tuple[Any, ...]:
    return tuple(entry_points(group=group))
