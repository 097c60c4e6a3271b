"""Memory of ended receptions, returned to the system."""

import contextlib
import ctypes
import gc


def release_memory() -> None:
    """Return freed memory to the system.

    The C library of Linux (glibc) keeps freed memory in an arena for each thread. Frames of a reception leave gaps that
    only `malloc_trim` gives back; without it the server grows with each thread that has received.
    """
    gc.collect()
    with contextlib.suppress(
        AttributeError, OSError, TypeError
    ):  # other C libraries, and systems, return it themselves
        ctypes.CDLL(None).malloc_trim(ctypes.c_size_t(0))
