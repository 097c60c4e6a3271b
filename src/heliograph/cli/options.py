"""Options that several commands share, and how they become settings."""

import contextlib
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

MOST_SETTINGS = 1 << 20
"""Most bytes of a file of settings: all that there are, with their meanings, take 12 kB."""

Load = Annotated[
    list[Path] | None,
    typer.Option("--load", metavar="FILE", show_default=False,
                 help="Python file that registers parts of your own, such as a receiver; may be repeated."),
]  # fmt: skip


def begun_presets(begun: str) -> list[tuple[str, str]]:
    """Presets with what each is for, for the shell to complete.

    Parameters
    ----------
    begun
        First letters of the name, any number.
    """
    from heliograph.link.settings import PRESETS

    return [(name, text) for name, (text, _) in PRESETS.items() if name.startswith(begun)]


def begun_receivers(begun: str) -> list[str]:
    """Receivers for the shell to complete.

    Parameters
    ----------
    begun
        First letters of the name, any number.
    """
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
        """Return them as `open_film` takes them; a MediaError where the crop is no four whole numbers."""
        try:
            crop = tuple(map(int, self.crop.split(","))) if self.crop is not None else None
        except ValueError:
            raise MediaError(f"--crop takes X,Y,WIDTH,HEIGHT in whole pixels, not {shown(self.crop)}") from None
        return {
            "rate_hz": self.fps, "crop": crop, "binning": self.binning, "rotate": self.rotate, "channel": self.channel
        }  # fmt: skip


def message_option(layer: str) -> Any:
    """An option that names a file to send in a layer."""
    return typer.Option(f"--{layer}", metavar="FILE", help=f"File to send with {layer} priority.", show_default=False)


def settings_from(preset: str, file: Path | None, assignments: list[str] | None) -> "LinkSettings":
    """Settings of preset, TOML file and assignments, in this order."""
    from heliograph.link.settings import load_settings

    return load_settings(preset, read_toml(file) if file else None, assignments or ())


def signal_changes(file: Path | None, assignments: list[str]) -> list[dict[str, Any]]:
    """What TOML file and assignments say of the signal, in this order; to be asked for once they are checked."""
    changes = [read_toml(file) if file else {}, *map(parse_assignment, assignments)]
    return [change["signal"] for change in changes if change.get("signal")]


def read_messages(
    settings: "LinkSettings", high: Path | None, middle: Path | None, low: Path | None
) -> "list[Messages]":
    """What each array sends: the files given, a text of our own where none is given at all."""
    from heliograph.link.simulate import default_messages

    files = {"high": high, "middle": middle, "low": low}
    if not any(files.values()):
        return default_messages(settings)
    content: Messages = {layer: [read_bytes(path)] for layer, path in files.items() if path}
    return [content for _ in settings.transmit.identities]


def read_bytes(path: Path) -> bytes:
    """A message's file; a MediaError where it cannot be read, is longer than any message or is empty."""
    from heliograph.signal.block import MAX_MESSAGE

    try:
        data = read_bounded(path, MAX_MESSAGE, "send less, or cut it up")
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from None
    if not data:
        raise MediaError(f"{path} is empty: there is nothing to send")
    return data


def read_toml(file: Path) -> dict[str, Any]:
    """Settings of a TOML file; a SettingsError where it cannot be read or is wrong."""
    try:
        # some editors begin UTF-8 with a mark of the order of bytes
        return parse_toml(read_bounded(file, MOST_SETTINGS).decode("utf-8-sig"))
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


def refuse_to_replace(output: Path, inputs: Iterable[Path | None]) -> None:
    """Check that a file to be written is none of those that are read.

    Raises
    ------
    MediaError
        It is one of them: it would be lost.
    """
    for path in filter(None, inputs):
        same = False
        with contextlib.suppress(OSError):  # one of them is not there
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
