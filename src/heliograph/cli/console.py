"""What the command says and where: results to standard output, progress and errors to standard error."""

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from typing import Any

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


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


def _quiet(done: float, /) -> None:
    """Show no progress."""


@contextlib.contextmanager
def progress(title: str, total: int | None) -> Iterator[Callable[[float], None]]:
    """A progress bar on a terminal, nothing in a pipe; call it with the number done, parts included."""
    if not sys.stderr.isatty():
        yield _quiet
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)
