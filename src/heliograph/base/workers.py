"""Worker processes of this machine: a core each, and Ctrl-C left to the process that began them.

Nothing heavy is imported here: a worker imports this module first, and sets its thread limits before NumPy is there.
"""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from heliograph.base.registry import register_again, registered

_LIBRARIES = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "VECLIB_MAXIMUM", "NUMEXPR_NUM")
"""Not Numba: once its threads run, it fails where its variable of the environment has changed."""

THREAD_LIMITS = {f"{name}_THREADS": "1" for name in _LIBRARIES}
"""Environment of a worker: a core each, and no threads of libraries beside it."""


def worker_processes(count: int) -> ProcessPoolExecutor:
    """Worker processes that know the parts registered in this one; they begin when work is submitted.

    Submit within `worker_environment`, so that they begin as they should.

    Parameters
    ----------
    count
        How many, 1 or more.
    """
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, mp_context=context, initializer=begin_worker, initargs=(registered(),))


@contextlib.contextmanager
def worker_environment() -> Iterator[None]:
    """What a process started within inherits: thread limits, and that Ctrl-C waits until it can leave it alone."""
    before = {name: os.environ.get(name) for name in THREAD_LIMITS}
    os.environ.update(THREAD_LIMITS)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def begin_worker(parts: tuple[str, ...] = ()) -> None:
    """Begin a worker process: leave Ctrl-C to the parent, end with it however it ends, and know its own parts.

    Parameters
    ----------
    parts
        Files and modules that register parts, as of `heliograph.base.registry.registered`.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    limit_threads()
    register_again(parts)


def limit_threads() -> None:
    """One thread for this process: by its environment where NumPy is not imported yet, by calls for the rest."""
    if "numpy" not in sys.modules:
        os.environ.update(THREAD_LIMITS)
    import cv2
    import numba

    cv2.setNumThreads(1)
    numba.set_num_threads(1)


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)
