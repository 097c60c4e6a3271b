"""Options that several commands share, and how they become settings."""

import contextlib
import math
import os
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph import __version__
from heliograph.base.errors import MediaError, SettingsError, shown
from heliograph.base.files import read_bounded
from heliograph.base.toml_text import parse_assignment, parse_toml
from heliograph.cli import console

if TYPE_CHECKING:
    from heliograph.link.settings import LinkSettings
    from heliograph.link.simulate import Messages
    from heliograph.signal.fountain.files import SentFile

STDIN, TEXT = "-", "text:"
"""What is given for standard input, and what comes before a text that looks like the name of a file."""

UNDECODED = re.compile("[\ud800-\udfff]")
"""Bytes of a file name that are not UTF-8: the name goes over the air as text."""

Load = Annotated[
    list[Path] | None,
    typer.Option("--load", metavar="FILE", show_default=False,
                 help="Python file that registers parts of your own, such as a receiver; may be repeated."),
]  # fmt: skip


def begun_presets(begun: str) -> list[tuple[str, str]]:
    """Presets with what each is for, for the shell to complete."""
    from heliograph.link.settings import PRESETS

    return [(name, text) for name, (text, _) in PRESETS.items() if name.startswith(begun)]


def begun_receivers(begun: str) -> list[str]:
    """Receivers for the shell to complete."""
    from heliograph.receive.registry import RECEIVERS

    return [name for name in RECEIVERS.names() if name.startswith(begun)]


Preset = Annotated[
    str,
    typer.Option(
        "--preset", help="Preset to start from; 'heliograph presets' lists them.", autocompletion=begun_presets
    ),
]
SettingsFile = Annotated[
    Path | None, typer.Option("--settings", metavar="FILE", help="TOML file laid over the preset.", show_default=False)
]
Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one setting; may be repeated.", show_default=False),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the road, the scene and the noise.")]
Imu = Annotated[
    Path | None,
    typer.Option("--imu", metavar="CSV", help="Recorded motion of a car; sets channel.shake=imu.", show_default=False),
]
BackgroundOption = Annotated[
    Path | None,
    typer.Option(
        "--background",
        metavar="VIDEO",
        help="Recorded footage for the background; sets channel.background.kind=footage.",
        show_default=False,
    ),
]

Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Dask scheduler whose workers compute, in place of --workers.", show_default=False
    ),
]

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Worker processes; one for each core if left out.", show_default=False),
]


@dataclass(frozen=True, slots=True)
class FilmOptions:
    """How a film is read: options of the command, as they were given."""

    fps: float | None
    crop: str | None
    binning: int
    rotate: int
    channel: str

    @property
    def partly(self) -> bool:
        """Whether the frames are others than those of the film."""
        return self.crop is not None or self.binning != 1 or self.rotate != 0

    def keywords(self) -> dict[str, Any]:
        """Return them as `open_film` takes them, black at 0; a MediaError if the crop is not four whole numbers."""
        try:
            crop = tuple(map(int, self.crop.split(","))) if self.crop is not None else None
        except ValueError:
            raise MediaError(f"--crop takes X,Y,WIDTH,HEIGHT in whole pixels, not {shown(self.crop)}") from None
        return {
            "rate_hz": self.fps, "crop": crop, "binning": self.binning, "rotate": self.rotate,
            "channel": self.channel, "expand_range": True,
        }  # fmt: skip


def place_changes(corners: str | None, region: str | None) -> list[str]:
    """Settings that say where an array is, by what was given to --corners and --region."""
    out = []
    for name, given, count, form in (
        ("corners", corners, 8, "X,Y,X,Y,X,Y,X,Y in pixels"),
        ("region", region, 4, "X,Y,WIDTH,HEIGHT in whole pixels"),
    ):
        if given is None:
            continue
        kind = int if name == "region" else float
        try:
            numbers = [kind(one) for one in given.split(",")]
            whole = len(numbers) == count and all(map(math.isfinite, numbers))
        except (ValueError, OverflowError):
            whole = False
        if not whole:
            raise MediaError(f"--{name} takes {form}, not {shown(given)}")
        out.append(f"receive.detect.{name}={numbers}")
    return out


def message_option(layer: str) -> Any:
    """An option that says what a layer sends."""
    what = f"What is sent with {layer} priority: a file, - for standard input, or a text."
    return typer.Option(f"--{layer}", metavar="FILE|-|TEXT", help=what, show_default=False)


def settings_from(preset: str, file: Path | None, assignments: list[str] | None) -> "LinkSettings":
    """Settings of preset, TOML file and assignments, in this order."""
    from heliograph.link.settings import load_settings

    return load_settings(preset, read_toml(file) if file else None, assignments or ())


def signal_changes(file: Path | None, assignments: list[str]) -> list[dict[str, Any]]:
    """What TOML file and assignments say of the signal, in this order; to be asked for once they are checked."""
    changes = [read_toml(file) if file else {}, *map(parse_assignment, assignments)]
    return [change["signal"] for change in changes if change.get("signal")]


def laid_over(file: Path | None, assignments: list[str] | None) -> Any:
    """TOML file and assignments as one nested mapping, in this order."""
    from heliograph.base.config import merge  # pydantic is slow to import, and no help needs it

    tree: Any = read_toml(file) if file else {}
    for change in map(parse_assignment, assignments or ()):
        tree = merge(tree, change)
    return tree


def varied(texts: list[str] | None) -> dict[str, list[Any]]:
    """Keys that vary with their values, by what was given as key=value,value or key=first:last:step."""
    from heliograph.sweeps.plan import parse_vary

    vary: dict[str, list[Any]] = {}
    for key, values in map(parse_vary, texts or ()):
        if key in vary:
            raise SettingsError(f"'{key}' is varied twice; write its values in one --vary")
        vary[key] = values
    return vary


@dataclass(frozen=True, slots=True)
class Sent:
    """What is sent: options of the command, as they were given."""

    # high, middle, low: what each layer sends, as `message_of` takes it; None for nothing
    high: str | None = None
    middle: str | None = None
    low: str | None = None
    # Files that the layers send which have nothing else
    files: tuple[Path, ...] = ()
    # Code that makes their symbols
    code: str = "cauchy"
    # Junction of which the high and the middle layer tell
    junction: Path | None = None

    @property
    def inputs(self) -> tuple[str | Path | None, ...]:
        """What may be the names of files that are read."""
        return (self.high, self.middle, self.low, *self.files, self.junction)


def read_messages(settings: "LinkSettings", sent: Sent, seconds: float) -> "list[Messages]":
    """What each array sends for some seconds: what is given, a text of our own where nothing is given at all."""
    from heliograph.link.simulate import default_messages
    from heliograph.signal.settings import LAYERS

    high, middle, low = sent.high, sent.middle, sent.low
    given = {layer: what for layer, what in (("high", high), ("middle", middle), ("low", low)) if what is not None}
    files = [file_of(path, sent.code) for path in sent.files]
    road = road_messages(sent, seconds) if sent.junction is not None else {}
    if not given and not files and not road:
        return default_messages(settings)
    if files and len({*given, *road}) == len(LAYERS):
        raise MediaError("--file is sent by layers that have no message: leave out --high, --middle or --low")
    if list(given.values()).count(STDIN) > 1:
        raise MediaError("standard input can be sent in one layer only: give - once")
    content: Messages = {
        layer: road[layer] if layer in road else [message_of(layer, given[layer])] if layer in given else files
        for layer in LAYERS if layer in road or layer in given or files
    }  # fmt: skip
    return [content for _ in settings.transmit.identities]


def road_messages(sent: Sent, seconds: float) -> "Messages":
    """What the lights of a junction show, again and again in the high layer, and its map in the middle one."""
    from heliograph.base.config import from_mapping
    from heliograph.road.codec import mapem, updates
    from heliograph.road.junction import Junction
    from heliograph.signal.message import Updates

    assert sent.junction is not None
    if sent.high is not None or sent.middle is not None:
        raise MediaError("--junction takes the high and the middle layer: leave out --high and --middle")
    tree = read_toml(sent.junction)
    try:
        junction = from_mapping(Junction, tree)
    except SettingsError as error:
        raise SettingsError(f"{sent.junction}: {error}") from None
    return {"high": [Updates(updates(junction, seconds))], "middle": [mapem(junction)]}


def file_of(path: Path, code: str) -> "SentFile":
    """A file to be sent by its symbols, under its own name."""
    from heliograph.signal.block import MAX_MESSAGE
    from heliograph.signal.fountain.codes import CODES
    from heliograph.signal.fountain.files import SentFile

    known = {name: name for name in CODES}
    if code not in known:
        raise MediaError(f"--file-code is one of {', '.join(known)}, not {shown(code)}")
    try:
        return SentFile(
            UNDECODED.sub("_", path.name), read_bounded(path, MAX_MESSAGE, "send less, or cut it up"), known[code]
        )
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from None


def message_of(layer: str, given: str) -> bytes:
    """The bytes to send by what was given: "-", "text:" and a text, the name of a file, or a text as it is."""
    from heliograph.signal.block import MAX_MESSAGE

    path, source = Path(given), given
    if given == STDIN:
        data, source = sys.stdin.buffer.read(MAX_MESSAGE + 1), "standard input"
        if len(data) > MAX_MESSAGE:
            raise MediaError(f"standard input has more than {MAX_MESSAGE} bytes: send less, or cut it up")
    elif not given or given.startswith(TEXT) or not (_names_a_file(given) or _is_there(path)):
        data, source = os.fsencode(given.removeprefix(TEXT)), f"the text of --{layer}"
        if len(data) > MAX_MESSAGE:
            raise MediaError(f"{source} has more than {MAX_MESSAGE} bytes: send less, or cut it up")
    else:
        try:
            data = read_bounded(path, MAX_MESSAGE, "send less, or cut it up")
        except OSError as error:
            hint = f"; to send these words write --{layer} {TEXT}..." if not _is_there(path) else ""
            raise MediaError(f"cannot read {path}: {error.strerror}{hint}") from None
    if not data:
        raise MediaError(f"{source} is empty: there is nothing to send")
    return data


def _names_a_file(given: str) -> bool:
    """Whether something that is no file here looks like the name of one: a folder or a suffix, and no blank."""
    return bool(re.fullmatch(r"\S*[/\\]\S*|\S+\.[A-Za-z][A-Za-z0-9]{0,4}", given))


def _is_there(path: Path) -> bool:
    with contextlib.suppress(OSError, ValueError):  # a text may be too long for a name, or hold a zero
        return path.exists()
    return False


def read_toml(file: Path) -> dict[str, Any]:
    """Settings of a TOML file; a SettingsError where it cannot be read or is wrong."""
    try:
        # some editors begin UTF-8 with a mark of the order of bytes
        # most bytes of a file of settings: all that there are, with their meanings, take 12 kB
        return parse_toml(read_bounded(file, (1 << 20)).decode("utf-8-sig"))
    except OSError as error:
        raise SettingsError(f"cannot read the settings {file}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SettingsError(f"the settings {file} are no text; write TOML in UTF-8") from None
    except SettingsError as error:
        raise SettingsError(f"{file}: {error}") from None


def say_version(wanted: bool) -> None:
    """Print the version and end, where that is asked for."""
    if wanted:
        console.say(f"heliograph {__version__}")
        raise typer.Exit


def refuse_to_replace(output: Path, inputs: Iterable[Path | str | None]) -> None:
    """Check that a file to be written is none of those that are read."""
    for path in (one for one in inputs if one):
        same = False
        with contextlib.suppress(OSError, ValueError):  # one of them is not there, or is a text
            same = output.samefile(path)
        if same:
            raise MediaError(f"{output} is read and would be written: give the output another name")


def help_unless_command(context: typer.Context) -> None:
    """Write the help to standard error and end with status 2 where no command was given.

    Click has this of its own, but called it a success until 8.2.
    """
    if context.invoked_subcommand is None:
        sys.stderr.write(context.get_help() + "\n")
        raise typer.Exit(2)
