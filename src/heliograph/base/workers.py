"""Local worker processes with a single thread each, imported without NumPy; only the parent handles Ctrl-C."""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import resource_tracker

from heliograph.base.registry import register_again, registered

THREAD_LIMITS = {
    f"{name}_THREADS": "1" for name in ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "VECLIB_MAXIMUM", "NUMEXPR_NUM")
}
"""Worker environment. Numba is omitted, as a change to the Numba variable fails once Numba threads run."""


def worker_processes(count: int) -> ProcessPoolExecutor:
    """Return worker processes with all registered parts; submit work within `worker_environment`."""
    return ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), begin_worker, (registered(),))


@contextlib.contextmanager
def worker_environment() -> Iterator[None]:
    """Set the thread limits for new processes, and block Ctrl-C until the workers ignore the signal."""
    before = {name: os.environ[name] for name in THREAD_LIMITS if name in os.environ}
    os.environ.update(THREAD_LIMITS)
    mask = None
    if hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # the first start of the tracker process would unblock Ctrl-C
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name in THREAD_LIMITS:
            os.environ.pop(name, None)
        os.environ.update(before)


def begin_worker(parts: tuple[str, ...] = ()) -> None:
    """Ignore Ctrl-C, exit with the parent process, limit threads, and register the parts from the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    limit_threads()
    register_again(parts)


def limit_threads() -> None:
    """Limit this process to a single thread, through the environment before the NumPy import and through calls."""
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
