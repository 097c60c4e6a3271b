"""Compile hot loops to machine code, which Numba caches in a folder named by a digest of all package sources.

Numba checks only the source of the cached function, although the code contains functions and constants of other files.
"""

import contextlib
import gc
import hashlib
import multiprocessing
import os
import shutil
import sys
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

KEPT_FOLDERS = 8  # recently used cache folders to keep, as several environments may share the location


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function with `numba.njit` and cache the machine code; division by 0 gives infinity."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(nogil=True, **{"error_model": "numpy", "no_cfunc_wrapper": True, **options})(function)
        with contextlib.suppress(RuntimeError):  # no sources, or no writable folder
            dispatcher._cache = _Cache(function)
        return dispatcher

    return decorate


@cache
def cache_folder() -> Path:
    """Return the cache folder for the current sources; a new folder replaces the oldest."""
    package, digest = Path(__file__).parents[1], hashlib.sha256(sys.version.encode())
    digest.update(f"{numba.__version__} {np.__version__}".encode())
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    place = Path(vars(config)["CACHE_DIR"] or AppDirs(appname="heliograph", appauthor=False).user_cache_dir)
    folder = place / f"heliograph-{digest.hexdigest()[:16]}"
    with contextlib.suppress(OSError):  # not writable, or changed by another process
        if not folder.exists():
            folder.mkdir(parents=True)
            for old in sorted(place.glob("heliograph-*"), key=os.path.getmtime)[:-KEPT_FOLDERS]:
                shutil.rmtree(old, ignore_errors=True)
        os.utime(folder)
    return folder


class _Locator(InTreeCacheLocator):
    def get_cache_path(self) -> str:
        return str(cache_folder() / self.get_suitable_cache_subpath(self._py_file))


class _Files(CompileResultCacheImpl):
    _locator_classes: list[type[object]] = [_Locator]  # noqa: RUF012 - Numba declares the attribute with no annotation


class _Cache(FunctionCache):
    """Numba cache; after a read or write failure, the function is compiled again."""

    _impl_class = _Files

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        # Numba numbers the cache files, so two processes could write different machine code to the same file
        self._cache_file._data_name = lambda _: f"{self._impl.filename_base}.{uuid.uuid4().hex}.nbc"  # type: ignore[method-assign]  # no setting

    def load_overload(self, signature: Any, target: Any) -> Any:
        try:
            return super().load_overload(signature, target)
        except Exception:  # unpickling a damaged file may raise any error
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        with contextlib.suppress(OSError):
            super().save_overload(signature, result)


class _Compilation(event.Listener):
    """Announce the first compilation on a terminal, and suspend garbage collection during compilation."""

    def __init__(self) -> None:
        self._announced, self._collecting = False, list[bool]()

    def on_start(self, started: Any) -> None:
        # Numba keeps most objects alive; garbage collection would take a sixth of the compile time
        self._collecting.append(gc.isenabled())
        gc.disable()
        dispatcher, process = started.data["dispatcher"], multiprocessing.current_process()
        is_first = multiprocessing.parent_process() is None or process.name.endswith("-1")
        is_own = dispatcher.py_func.__module__.startswith("heliograph.")
        if is_own and is_first and not self._announced and sys.stderr is not None and sys.stderr.isatty():
            self._announced = True
            uncached = "at each start: set NUMBA_CACHE_DIR to a writable folder"
            often = "first use only" if dispatcher.stats.cache_path else uncached
            print(f"compiling for this computer, up to a minute ({often})", file=sys.stderr, flush=True)

    def on_end(self, _: Any) -> None:
        if self._collecting.pop():
            gc.enable()


event.register("numba:compile", _Compilation())
