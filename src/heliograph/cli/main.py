"""Entry point of the command `heliograph`."""

import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from heliograph import __version__
from heliograph.base.errors import HeliographError
from heliograph.base.registry import load_parts
from heliograph.cli import console

COMMANDS = {
    "simulate": "Film a drive past the arrays, with the truth.",
    "transmit": "Write the LED patterns of a transmission.",
    "receive": "Find arrays in films or live cameras, and read the messages.",
    "cameras": "List the connected live cameras.",
    "probe": "Diagnose a film: light, regions, arrays, causes, remedies.",
    "convert": "Convert a film to another format.",
    "demo": "Simulate the paper's drive, receive it, and write a report.",
    "serve": "Serve pages to watch a receiver, transmit and receive.",
    "sweep": "Count errors over a grid of settings, without films.",
    "benchmark": "Compare receivers on named scenarios.",
    "budget": "Calculate light, range and flicker of a planned link.",
    "dataset": "Write labelled films for training.",
    "reproduce": "Run the paper's experiments, and compare the claims.",
    "presets": "List the presets, or print all settings of a preset.",
    "measure": "Run a measurement and print the counts.",
}
"""Commands and their help; each is a module of this package."""


class LazyGroup(typer.core.TyperGroup):
    """Group that imports the module of a command when the command is invoked."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
        """Return the name, the command and the remaining arguments."""
        name, _, remaining = super().resolve_command(ctx, args)
        return name, name and load_command(name), remaining


def load_command(name: str) -> Any:
    """Import the module of a command, and return the command."""
    with _ctrl_c_held():
        return typer.main.get_command(getattr(import_module(f"heliograph.cli.{name}"), name))


@contextlib.contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Delay Ctrl-C: machine code that calls Python, such as that of pydantic, may lose the exception."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


app = typer.Typer(cls=LazyGroup, rich_markup_mode=None, pretty_exceptions_enable=False)

for _name, _help in COMMANDS.items():
    app.command(_name, help=_help)(lambda: None)

TyperError: type[Exception] = getattr(typer, "TyperException", typer.BadParameter.__mro__[2])
"""Base class of usage errors; before Typer 0.27, the Click exception below `typer.BadParameter`."""


def print_version(requested: bool) -> None:
    """Print the version and exit."""
    if requested:
        console.say(f"heliograph {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def main(
    context: typer.Context,
    load: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="Python file that registers custom parts, such as a receiver; may be repeated."
        ),
    ] = None,
    version: Annotated[  # noqa: ARG001 - the callback handles the option
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=print_version)
    ] = False,
) -> None:
    """Transmit data by an LED array, and receive it by a high-speed camera on a moving car."""
    for file in load or ():
        load_parts(file)
    console.help_unless_command(context)


def _complain_about_usage(error: Exception) -> None:
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    context = getattr(error, "ctx", None)
    if "No such option: --load" in text and context:
        text = "--load FILE stands before the command"
        context = context.find_root()
    command = f"{context.command_path} --help" if context else "heliograph --help"
    console.complain(f"{' '.join(text.split()).rstrip('.')}; see '{command}'")


def _check_streams() -> None:
    """Make standard output accept any text, and exit if it is closed; discard errors if standard error is closed."""
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - open until the process ends
    if sys.stdout is None:
        console.complain("standard output is closed; redirect it, such as > /dev/null")
        sys.exit(1)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # the encoding may lack characters of file names


def run() -> None:
    """Run the command; an error becomes a line and a non-zero exit status."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices of the receiver are too small for threads
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # SIGTERM ends like Ctrl-C
    _check_streams()
    status = 1
    try:
        status = app(standalone_mode=False, prog_name="heliograph")
    except TyperError as error:
        _complain_about_usage(error)
        status = 2
    except (KeyboardInterrupt, typer.Abort):
        status = console.INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
    except (HeliographError, MemoryError, OSError) as error:
        console.complain(console.error_text(error))
    if status == console.INTERRUPTED:  # also returned by Typer after Ctrl-C
        console.complain("interrupted")
    sys.exit(status)
