"""Unexpected exceptions of the server: a line of text for the page, and the traceback in the log."""

import logging
import re
from collections.abc import Callable
from typing import TypeVar

from starlette.concurrency import run_in_threadpool

from heliograph.base.errors import HeliographError, brief
from heliograph.media.live.camera import CameraCrashError
from heliograph.web.wording import page_words

T = TypeVar("T")

LOG = logging.getLogger("heliograph.web")


class GoneError(Exception):
    """The page has disconnected."""


class CrashError(Exception):
    """Unexpected exception of a worker thread; the cause is the exception."""


def is_crash(error: BaseException) -> bool:
    """Return True if an error is unexpected and needs a traceback."""
    return isinstance(error, CameraCrashError) or not isinstance(error, HeliographError)


def report(error: BaseException) -> str:
    """Return an error as one line for a page; log the traceback of an unexpected error."""
    cause = error.__cause__ if isinstance(error, CrashError) and error.__cause__ is not None else error
    line = str(cause) if isinstance(cause, HeliographError) else _line_of(cause)
    if is_crash(cause):
        LOG.error("%s", line, exc_info=cause)
    return page_words(line)


def _line_of(error: BaseException) -> str:
    if isinstance(error, MemoryError):
        return "not enough memory for frames of that size: end other receptions, or use a smaller film"
    if isinstance(error, OSError) and error.strerror:
        return f"input or output failed: {brief(error.strerror)}"
    try:
        # pages do not learn folders of the server
        text = re.sub(r"(?<!\w)/(?:[^\s/'\"]+/)+", "", brief(error)) if isinstance(error, Exception) else ""
    except Exception:  # the conversion of an exception to text may fail
        text = ""
    name = type(error).__name__ + (f": {text}" if text else "")
    return f"the server failed by an internal error ({name}); please report it with the traceback in the server's log"


async def in_thread(work: Callable[[], T]) -> T:
    """Run a function in a worker thread, and return the result.

    Unexpected exceptions become a `CrashError`: `KeyboardInterrupt` and `SystemExit` of a worker thread would end the
    event loop.
    """

    def guarded() -> T:
        try:
            return work()
        except (HeliographError, GoneError):
            raise
        except BaseException as error:
            raise CrashError from error

    return await run_in_threadpool(guarded)
