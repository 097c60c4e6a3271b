"""What the command says and where: results to standard output, progress and errors to standard error."""

import contextlib
import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""

EVERY_S = 60.0
"""Time between two lines of progress in a log: what is done sooner says nothing."""


def say(text: str) -> None:
    """A line of the result."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def complain(text: str) -> None:
    """A line about what went wrong; one line, whatever the text quotes."""
    sys.stderr.write(f"heliograph: {' '.join(text.splitlines())}\n")


def say_json(value: Any) -> None:
    """One JSON value as the result."""
    say(json.dumps(value))


class Lines:
    """Progress where there is no terminal, in a log: a line now and then, with the time left.

    Parameters
    ----------
    title
        What is counted.
    total
        How much there is of it, if that is known.
    """

    def __init__(self, title: str, total: int | None):
        self._title, self._total = title, total
        self._said = time.monotonic()
        self._first: tuple[float, float] | None = None

    def __call__(self, done: float) -> None:
        """Take the number done, parts included; the first may be of work done before."""
        now = time.monotonic()
        began, before = self._first = self._first or (now, done)
        if now - self._said < EVERY_S:
            return
        self._said = now
        text = f"{self._title}: {done:.1f}".removesuffix(".0")
        if self._total:
            text += f" of {self._total}"
            if done > before:
                left = (now - began) * (self._total - done) / (done - before)
                text += f", about {math.ceil(left / 60)} min left"
        sys.stderr.write(text + "\n")
        sys.stderr.flush()


@contextlib.contextmanager
def progress(title: str, total: int | None) -> Iterator[Callable[[float], None]]:
    """A progress bar on a terminal, a line now and then in a log; call it with the number done, parts included."""
    if not sys.stderr.isatty():
        yield Lines(title, total)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)
