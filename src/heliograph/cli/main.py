"""The command `heliograph`."""

import io
import os
import signal
import sys
from typing import Annotated

import typer

from heliograph.base.errors import HeliographError
from heliograph.base.registry import load_parts
from heliograph.cli import console, film_commands, light_commands, measure, options, study_commands

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

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

NAME = "heliograph"
"""What the command is called, also as ``python -m heliograph``."""

TyperError: type[Exception] = getattr(typer, "TyperException", typer.BadParameter.__mro__[2])
"""What a wrong command line raises: before Typer 0.27, Click's exception at the root of `typer.BadParameter`."""

Version = Annotated[
    bool,
    typer.Option("--version", help="Print the version and end.", is_eager=True, callback=options.say_version),
]


@app.callback(invoke_without_command=True)
def main(context: typer.Context, load: options.Load = None, version: Version = False) -> None:  # noqa: ARG001 - it acts by itself
    """Data sent by an LED array, received by a high-speed camera on a moving car."""
    for file in load or ():
        load_parts(file)
    options.help_unless_command(context)


def _usage(error: Exception) -> None:
    """Say what is wrong with the command line, in one line."""
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    context = getattr(error, "ctx", None)
    if "No such option: --load" in text and context:
        text = "--load FILE stands before the command"
        context = context.find_root()
    command = f"{context.command_path} --help" if context else "heliograph --help"
    console.complain(f"{' '.join(text.split()).rstrip('.')}; see '{command}'")


def _check_streams() -> None:
    """Let standard output take any text; end before any work if it is closed. Errors that nobody hears are left out."""
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - as long as the process
    if sys.stdout is None:
        console.complain("standard output is closed; give it somewhere to go, such as > /dev/null")
        sys.exit(1)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a file name may lie outside the terminal's alphabet


def run() -> None:
    """Entry of the command: every error becomes one line and a non-zero status."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the receiver's matrices are too small to share among threads
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # told to end: as tidy as after Ctrl-C
    _check_streams()
    try:
        status = app(standalone_mode=False, prog_name=NAME)
    except HeliographError as error:
        console.complain(str(error))
        sys.exit(1)
    except TyperError as error:
        _usage(error)
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        console.complain("interrupted")
        sys.exit(console.INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)
    except MemoryError:
        console.complain("not enough memory; make the film shorter or its frames smaller")
        sys.exit(1)
    except OSError as error:
        console.complain(f"{error.filename or 'input or output'}: {error.strerror or error}")
        sys.exit(1)
    if status == console.INTERRUPTED:  # typer's way to hand on Ctrl-C
        console.complain("interrupted")
    sys.exit(status)
