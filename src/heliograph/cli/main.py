"""Entry point of the command `heliograph`."""

import io
import os
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import HeliographError
from heliograph.base.registry import load_parts
from heliograph.cli import console, film_commands, light_commands, measure, options, study_commands

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)

for _command in (
    light_commands.simulate,
    light_commands.transmit,
    film_commands.receive,
    film_commands.cameras,
    film_commands.probe,
    film_commands.convert,
    light_commands.demo,
    film_commands.serve,
    study_commands.sweep,
    study_commands.budget,
    study_commands.dataset,
    study_commands.reproduce,
    study_commands.presets,
):
    app.command()(_command)
app.add_typer(measure.app, name="measure")

TyperError: type[Exception] = getattr(typer, "TyperException", typer.BadParameter.__mro__[2])
"""Base class of usage errors; before Typer 0.27, the Click exception below `typer.BadParameter`."""

Version = Annotated[
    bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=options.print_version)
]


Load = Annotated[
    list[Path] | None,
    typer.Option(
        "--load", metavar="FILE", help="Python file that registers custom parts, such as a receiver; may be repeated."
    ),
]


@app.callback(invoke_without_command=True)
def main(context: typer.Context, load: Load = None, version: Version = False) -> None:  # noqa: ARG001 - a callback
    """Transmit data by an LED array, and receive it by a high-speed camera on a moving car."""
    for file in load or ():
        load_parts(file)
    options.help_unless_command(context)


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
