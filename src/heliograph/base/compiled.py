"""Hot loops as machine code, kept from one process to the next.

Numba's own cache asks only whether the file of a function has changed. A function or a constant of another file is
compiled into the machine code all the same, so that could be stale. Here it is kept in a folder whose name is a digest
of all that goes into it: the function's module, all modules of the package that this imports, the versions of the
libraries, and the processor.
"""

import contextlib
import gc
import hashlib
import os
import pickle
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import Any, NamedTuple

from numba import njit
from numba.core import config, event
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

from heliograph.base import compile_ahead, compile_time
from heliograph.base.errors import MediaError
from heliograph.base.files import write_whole

KEPT = 8
"""Folders kept of a module, the latest used: several environments and processors may share one place. Each has 0.1 to
2 MB."""

LIBRARIES = ("numba", "llvmlite", "numpy", "scipy")
"""Libraries whose code or values go into the machine code; SciPy gives the table of the normal distribution."""

_NO_MATTER = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")
"""Numba's variables that do not change the machine code; workers have other ones than their parent."""

_NO_STATEMENT = re.compile(r"#.*|\\\n")
"""Comments, and line ends that do not end a statement."""

_IMPORT = re.compile(r"^[ \t]*(?:from\s+([.\w]+)\s+import\s+(\([^)]*\)|.*)|import\s+(.*))", re.MULTILINE)
"""Statements that import: from what, what; or what."""


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function when it is first called, and keep its machine code.

    Parameters
    ----------
    options
        Options of `numba.njit`; the function does not hold Python's lock, so other threads go on. Unless it is said
        otherwise, numbers divided by 0 are infinite, as in NumPy.

    Returns
    -------
    A decorator for a function of a module that can be imported. Where its machine code cannot be kept, because no
    folder can be written or its source is not there, it is compiled in each process anew. A function whose name
    begins with an underscore is for other compiled ones alone: called from Python it raises a TypeError.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        inner = function.__name__.startswith("_")
        dispatcher = njit(nogil=True, **{**_LEAST_WORK, "no_cpython_wrapper": inner, **options})(function)
        dispatcher._cache = _Kept(function)  # what `enable_caching` does with Numba's own
        if inner:
            _close(dispatcher)
        return dispatcher

    return decorate


_LEAST_WORK = {"no_cfunc_wrapper": True, "error_model": "numpy"}
"""What saves a fifth of the time of compiling, with `_close`: no second way into each function, for C, and no error for
each division by 0."""


def _close(dispatcher: Any) -> None:
    """Let no call from Python into a function that has no way in: it would end the process."""

    def refuse(*_: Any, **__: Any) -> None:
        raise TypeError(f"{dispatcher.__name__} is for compiled functions alone; call one that calls it")

    # Python's calls look for machine code among what was inserted, and where there is none ask for it to be compiled
    dispatcher._insert = lambda *_: None
    dispatcher._compile_for_args = refuse


class _Kept:
    """Machine code of one function, a file for each signature; it stands for Numba's `FunctionCache`."""

    def __init__(self, function: Callable[..., Any]):
        self._module, self._name = function.__module__, function.__qualname__
        self._line = function.__code__.co_firstlineno
        # now, as a file may be changed while the process runs on with the old code
        self._digest = None if function.__closure__ else digest(self._module)
        self.cache_path: str | None = None

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The function compiled for a signature, or None where that is not kept."""
        target.refresh()
        path, found = self._path(signature, target), None
        if path is not None and path.exists():
            # whatever a damaged file raises: it is compiled and written again
            with contextlib.suppress(Exception):
                found = CompileResult._rebuild(target, *pickle.loads(path.read_bytes()))
        if found is None:
            compile_time.tell(path is not None)
            if path is not None:
                compile_ahead.begins(self._module, self._name, signature)
        return found

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep what was compiled; a full disk is no reason to stop."""
        path = self._path(signature, result.target_context)
        if path is None or result.library.has_dynamic_globals or result.lifted:
            return
        with contextlib.suppress(OSError, MediaError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, dumps(result._reduce()))

    def _path(self, signature: Any, target: Any) -> Path | None:
        """File of a signature."""
        if self._digest is None:
            return None
        folder = _folder(self._module, self._digest, target.codegen().magic_tuple())
        if folder is None:
            return None
        self.cache_path = str(folder)
        # one file each, instead of Numba's index: workers that compile at a time cannot mix their files up
        key = hashlib.sha256(f"{self._line} {signature}".encode()).hexdigest()[:16]
        return folder / f"{self._name}-{key}.nbc".replace("<", "").replace(">", "")


@cache
def digest(module: str) -> str | None:
    """Digest of what goes into a module's machine code, but for the processor.

    Parameters
    ----------
    module
        The module's dotted name.

    Returns
    -------
    Hexadecimal digits, or None where a source or a version is not there to be read.
    """
    known, versions = sources(module), _versions()
    if known is None or versions is None:
        return None
    parts = [*versions, *(one for item in sorted(known.items()) for one in item)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


@cache  # reading them takes some milliseconds
def _versions() -> tuple[str, ...] | None:
    """Python, libraries and Numba's switches; None for an installation without its metadata."""
    try:
        libraries = [f"{name} {version(name)}" for name in LIBRARIES]
    except PackageNotFoundError:
        return None
    switches = sorted(f"{key}={value}" for key, value in os.environ.items() if key.startswith("NUMBA_"))
    return sys.version, *libraries, *(one for one in switches if not one.startswith(_NO_MATTER))


def sources(module: str) -> dict[str, str] | None:
    """Sources of a module and of all modules of its package that it imports, themselves or through others.

    Parameters
    ----------
    module
        The module's dotted name.

    Returns
    -------
    Texts by the modules' names, or None where one is not there to be read.
    """
    package, found, todo = module.partition(".")[0], dict[str, str](), [module]
    while todo:
        name = todo.pop()
        if name in found or name.partition(".")[0] != package:
            continue
        source = _source(name)
        if source is None and name != module:  # a name within a module, no module
            continue
        if source is None or source.text is None:
            return None
        found[name] = source.text
        todo += source.imports
    return found


class _Source(NamedTuple):
    text: str | None
    """None where the module is there without its source."""
    imports: tuple[str, ...]
    """Dotted names of all that it imports, be it modules or names within them."""


@cache  # modules share what they import
def _source(name: str) -> _Source | None:
    """A module's source; None where there is no such module."""
    try:
        spec = find_spec(name)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    try:
        text: str | None = spec.loader.get_source(name)  # type: ignore[union-attr]  # loaders without it are caught below
    except (AttributeError, ImportError, OSError):
        return _Source(None, ())
    return _Source(text, tuple(_imported(text or "", spec.parent or "")))


def _imported(text: str, parent: str) -> Iterator[str]:
    """Dotted names of all that a source imports; a syntax tree would give the same in ten times the time."""
    for base, names, modules in _IMPORT.findall(_NO_STATEMENT.sub(" ", text)):
        if base:
            with contextlib.suppress(ImportError):  # a sentence of a docstring
                base = resolve_name(base, parent)
                yield from (base, *(f"{base}.{name}" for name in re.findall(r"\w+", names)))
        else:
            yield from re.findall(r"[\w.]+", modules)


@cache
def _folder(module: str, made_of: str, machine: tuple[str, ...]) -> Path | None:
    """Where a module's machine code is kept for a processor; None where no folder can be written."""
    name = hashlib.sha256("\0".join([made_of, *machine]).encode()).hexdigest()[:16]
    for place in _places(module):
        folder = place / f"{module}-{name}"
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()  # whether it can be written
            os.utime(folder)
            _clear(place, module)
            return folder
    return None


def _places(module: str) -> list[Path]:
    """Folders to keep machine code in, best first; where NUMBA_CACHE_DIR is set, that one alone."""
    given = vars(config).get("CACHE_DIR")
    if given:
        return [Path(given)]
    file = Path(getattr(sys.modules.get(module), "__file__", None) or "")
    beside = [file.parent / "__pycache__"] if file.is_file() else []
    return [*beside, Path(AppDirs(appname="heliograph", appauthor=False).user_cache_dir)]


def _clear(place: Path, module: str) -> None:
    """Remove the module's folders but for the latest used."""
    used = {folder: folder.stat().st_mtime for folder in place.glob(f"{module}-*")}
    for folder in sorted(used, key=lambda one: used[one])[:-KEPT]:
        shutil.rmtree(folder, ignore_errors=True)  # a process that uses it makes it again


class _Watch(event.Listener):
    """Stops the clock of `compile_time` while Numba compiles, and the collection of garbage.

    Numba keeps most of the million objects that it makes: to look through them takes a twelfth of the time.
    """

    def __init__(self) -> None:
        self._depth, self._collects = 0, False

    def on_start(self, _: Any) -> None:
        compile_time.begin()
        if not self._depth:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, _: Any) -> None:
        compile_time.end()
        self._depth -= 1
        if not self._depth and self._collects:
            gc.enable()


event.register("numba:compile", _Watch())
