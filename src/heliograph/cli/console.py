"""What the command says and where: results to standard output, progress and errors to standard error."""

import contextlib
import json
import shlex
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from heliograph.base.errors import printable

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""

NO_ARRAY = 3
"""Exit status where all was read to its end, and no array was found."""

LONGEST = 600
"""Most characters of a message: some quote what was typed, or a file, which may be of any length."""

BACKSLASH, QUOTE = "\\", "'"


def say(text: str) -> None:
    """Write a line of the result; a file name with a line break in it stays on that line."""
    _write_line(printable(text))


def say_lines(text: str) -> None:
    """Write a text of several lines as the result."""
    for line in text.splitlines():
        say(line)


def say_prose(text: str) -> None:
    """A line of text as a result; on a terminal it is broken between words, and the lines that follow are set in."""
    if sys.stdout.isatty():
        # least characters of a line of prose on a terminal
        width = max(40, shutil.get_terminal_size().columns - 1)
        say_lines(textwrap.fill(printable(text), width, subsequent_indent=" " * 4, break_on_hyphens=False))
    else:
        say(text)


def say_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table of texts, flush right, as a result."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    for cells in [head, *rows]:
        say("  ".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True)))


def note(text: str) -> None:
    """A line of advice beside the result, for who looks on: nothing is said where errors do not go to a terminal."""
    if sys.stderr.isatty():
        tell(text)


def complain(text: str) -> None:
    """A line about what went wrong; one line, and no longer than can be read, whatever the text quotes."""
    line = printable(text)
    if len(line) > LONGEST:
        half = LONGEST // 2
        line = f"{line[:half]} ... {line[-half:]}"  # what is wrong stands in front, the cure at the end
    sys.stderr.write(f"heliograph: {line}\n")


def tell(text: str) -> None:
    """A line of what happens while it happens, as it was asked for."""
    sys.stderr.write(printable(text) + "\n")
    sys.stderr.flush()


def say_json(value: Any) -> None:
    r"""Write one JSON value as the result, in ASCII: bytes of a file name that are not UTF-8 become ``\udce9``."""
    _write_line(json.dumps(value))


def argument(path: Path) -> str:
    """Return a file name as a shell takes it, for a command that is shown."""
    text = f"./{path}" if str(path).startswith("-") else str(path)
    if text.isprintable():
        return shlex.quote(text)
    return f"$'{printable(text.replace(BACKSLASH, 2 * BACKSLASH).replace(QUOTE, BACKSLASH + QUOTE))}'"


def _write_line(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


@contextlib.contextmanager
def progress(title: str, total: int | None) -> Iterator[Callable[[float], None]]:
    """A progress bar on a terminal, and nothing in a pipe; call it with the number done, parts included."""
    if not sys.stderr.isatty():
        yield lambda _done: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # results that are said meanwhile stay on standard output, where that leads elsewhere
    aside = sys.stdout.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=aside) as bar:
        task = bar.add_task(title, total=total)
        # a film may hold more frames than it claims
        yield lambda done: bar.update(task, completed=done, total=None if total is None else max(total, done))
