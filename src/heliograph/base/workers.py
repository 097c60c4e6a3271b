"""Worker processes of this machine: one core each, and Ctrl-C only for the parent; imports are light before NumPy's."""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

from heliograph.base.registry import register_again, registered

THREAD_LIMITS = {
    f"{name}_THREADS": "1" for name in ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "VECLIB_MAXIMUM", "NUMEXPR_NUM")
}
"""Environment of a worker. Numba is not in it: once its threads run, it fails if its variable changes."""


def worker_processes(count: int) -> ProcessPoolExecutor:
    """Return worker processes that know the registered parts; submit work within `worker_environment`."""
    return ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), begin_worker, (registered(),))


@contextlib.contextmanager
def worker_environment() -> Iterator[None]:
    """Start processes within this block: they inherit the thread limits, and Ctrl-C waits until they ignore it."""
    before = {name: os.environ[name] for name in THREAD_LIMITS if name in os.environ}
    os.environ.update(THREAD_LIMITS)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name in THREAD_LIMITS:
            os.environ.pop(name, None)
        os.environ.update(before)


def begin_worker(parts: tuple[str, ...] = ()) -> None:
    """Ignore Ctrl-C, end with the parent process, limit threads, and register the parts of the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    limit_threads()
    register_again(parts)


def limit_threads() -> None:
    """Limit this process to one thread: by the environment before NumPy is imported, and by calls."""
    if "numpy" not in sys.modules:
        os.environ.update(THREAD_LIMITS)
    import cv2
    import numba

    cv2.setNumThreads(1)
    numba.set_num_threads(1)


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
