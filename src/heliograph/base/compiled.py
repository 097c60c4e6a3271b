"""Compile hot loops to machine code, which Numba caches on disk.

Numba's cache compares only the file of a function, although functions and constants of other files are compiled into
the same machine code. The cache folder is therefore named by a digest of all sources of the package.
"""

import contextlib
import gc
import hashlib
import multiprocessing
import os
import shutil
import sys
import tempfile
import uuid
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import config, event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator
from numba.misc.appdirs import AppDirs

KEPT_FOLDERS = 8
"""Cache folders that remain when a new one is made, as several environments may share the place."""

_PACKAGE = Path(__file__).parents[1]


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function as `numba.njit` does, and cache the machine code; a division by 0 gives infinity."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(nogil=True, **{"error_model": "numpy", "no_cfunc_wrapper": True, **options})(function)
        if cache_folder() and Path(function.__code__.co_filename).exists():
            dispatcher._cache = _Cache(function)
        return dispatcher

    return decorate


@cache
def cache_folder() -> Path | None:
    """Return the cache folder of these sources, newly made if missing; None if it cannot be written."""
    digest = hashlib.sha256(f"{sys.version} {numba.__version__} {np.__version__}".encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0" + path.read_bytes())
    place = Path(vars(config)["CACHE_DIR"] or AppDirs(appname="heliograph", appauthor=False).user_cache_dir)
    folder = place / f"heliograph-{digest.hexdigest()[:16]}"
    is_new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        os.utime(folder)
    except OSError:
        return None
    if is_new:
        with contextlib.suppress(OSError):  # another process may remove a folder
            for old in sorted(place.glob("heliograph-*"), key=os.path.getmtime)[:-KEPT_FOLDERS]:
                shutil.rmtree(old, ignore_errors=True)
    return folder


class _Locator(InTreeCacheLocator):
    def get_cache_path(self) -> str:
        return os.path.join(str(cache_folder()), self.get_suitable_cache_subpath(self._py_file))


class _Files(CompileResultCacheImpl):
    _locator_classes: list[type[object]] = [_Locator]  # noqa: RUF012 - Numba's own attribute, not annotated there


class _Cache(FunctionCache):
    """Numba's cache; a damaged or unwritable file only costs the time of compiling."""

    _impl_class = _Files

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        # Numba numbers the files of a function, so two processes could write machine code under the same name
        self._cache_file._data_name = self._name_file  # type: ignore[method-assign]  # the index has no setting for it

    def _name_file(self, _: int) -> str:
        return f"{self._impl.filename_base}.{uuid.uuid4().hex}.nbc"

    def load_overload(self, signature: Any, target: Any) -> Any:
        try:
            return super().load_overload(signature, target)
        except Exception:  # unpickling a damaged file may raise any error
            self.flush()
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        with contextlib.suppress(OSError):
            super().save_overload(signature, result)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            super().flush()


class _Compilation(event.Listener):
    """Announce the first compilation on a terminal, and suspend garbage collection while Numba compiles."""

    announced = False

    def __init__(self) -> None:
        self._collecting: list[bool] = []

    def on_start(self, started: Any) -> None:
        # Numba keeps most of the million objects that it makes: searching them takes a sixth of the time
        self._collecting.append(gc.isenabled())
        gc.disable()
        # of several worker processes only the first one announces it
        worker = multiprocessing.parent_process() and not multiprocessing.current_process().name.endswith("-1")
        own = started.data["dispatcher"].py_func.__module__.startswith("heliograph.")
        if own and not (self.announced or worker) and sys.stderr is not None and sys.stderr.isatty():
            self.announced = True
            often = "first use only" if cache_folder() else "at each start: set NUMBA_CACHE_DIR to a writable folder"
            print(f"compiling for this computer, about 30 s ({often})", file=sys.stderr, flush=True)

    def on_end(self, _: Any) -> None:
        if self._collecting.pop():
            gc.enable()


event.register("numba:compile", _Compilation())
