"""Console output: results to standard output, progress and errors to standard error."""

import contextlib
import json
import shlex
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import typer

from heliograph.base.errors import HeliographError, printable

INTERRUPTED = 130  # exit status after Ctrl-C
NO_ARRAY = 3  # exit status of a complete reception that found no array


def say(text: str) -> None:
    """Print a line of the result; line breaks in file names are escaped."""
    _print(printable(text))


def say_lines(text: str) -> None:
    """Print lines of the result."""
    for line in text.splitlines():
        say(line)


def say_prose(text: str) -> None:
    """Print a line of the result; a terminal wraps the line with a hanging indent."""
    if sys.stdout.isatty():
        width = max(40, shutil.get_terminal_size().columns - 1)
        say_lines(textwrap.fill(printable(text), width, subsequent_indent=" " * 4, break_on_hyphens=False))
    else:
        say(text)


def say_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a right-aligned table."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    for cells in [head, *rows]:
        say("  ".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True)))


def say_json(value: Any) -> None:
    r"""Print a JSON value in ASCII; bytes of a file name that are not UTF-8 become ``\udce9``."""
    _print(json.dumps(value))


def note(text: str) -> None:
    """Print a hint to standard error if that is a terminal."""
    if sys.stderr.isatty():
        tell(text)


def tell(text: str) -> None:
    """Print a line about an event to standard error."""
    sys.stderr.write(printable(text) + "\n")
    sys.stderr.flush()


def complain(text: str) -> None:
    """Print an error or warning on a single line; shorten quoted arguments and files to 600 characters."""
    line = printable(text)
    if len(line) > 600:  # the problem stands at the beginning, the remedy at the end
        line = f"{line[:300]} ... {line[-300:]}"
    sys.stderr.write(f"heliograph: {line}\n")


def error_text(error: BaseException) -> str:
    """Return the message of an error for the user."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    if isinstance(error, MemoryError):
        return "not enough memory; make the film shorter or the frames smaller"
    if isinstance(error, OSError) and not isinstance(error, HeliographError):
        return f"{error.filename or 'input or output'}: {error.strerror or error}"
    return str(error)


def error_line(error: BaseException) -> str:
    """Return the message of an error without line breaks, for reports."""
    return " ".join(error_text(error).split())


def exit_interrupted(text: str) -> NoReturn:
    """Print the state after Ctrl-C and exit."""
    complain(text)
    sys.exit(INTERRUPTED)


def help_unless_command(context: typer.Context) -> None:
    """Write the help to standard error and exit with status 2 if no command is given; Click before 8.2 exits with 0."""
    if context.invoked_subcommand is None:
        sys.stderr.write(context.get_help() + "\n")
        raise typer.Exit(2)


def argument(path: Path) -> str:
    """Return a file name in the syntax of a shell."""
    text = f"./{path}" if str(path).startswith("-") else str(path)
    if text.isprintable():
        return shlex.quote(text)
    escaped = text.replace("\\", r"\\").replace("'", r"\'")
    return f"$'{printable(escaped)}'"


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


class Progress:
    """Progress of a command."""

    def __init__(self, show: Callable[[float], object] = lambda _: None):
        self.done, self._show = 0.0, show

    def __call__(self, done: float) -> None:
        """Set the number of completed steps, including fractions."""
        self.done = done
        self._show(done)


@contextlib.contextmanager
def progress(title: str, total: int | None, *, is_hidden: bool = False) -> Iterator[Progress]:
    """Show a progress bar if standard error is a terminal."""
    if is_hidden or not sys.stderr.isatty():
        yield Progress()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # results stay on standard output if that is not the terminal
    redirect = sys.stdout.isatty()
    with Bar(*columns, console=Console(stderr=True), transient=True, redirect_stdout=redirect) as bar:
        task = bar.add_task(title, total=total)
        # a film may have more frames than the header states
        yield Progress(lambda done: bar.update(task, completed=done, total=None if total is None else max(total, done)))
