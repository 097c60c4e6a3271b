"""Options shared by several commands, in groups."""

import contextlib
import functools
import inspect
import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from heliograph import __version__
from heliograph.base.errors import MediaError, SettingsError, shown
from heliograph.base.files import read_bounded
from heliograph.base.toml_text import parse_assignment, parse_toml
from heliograph.cli import console

if TYPE_CHECKING:
    from heliograph.link.settings import LinkSettings


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Replace parameters of a command that are dataclasses: each field becomes an option."""
    hints, groups, parameters = get_type_hints(command, include_extras=True), dict[str, Any](), []
    for name, parameter in inspect.signature(command).parameters.items():
        kind = hints[name]
        if not (isinstance(kind, type) and is_dataclass(kind)):
            parameters.append(parameter.replace(kind=parameter.KEYWORD_ONLY, annotation=kind))
            continue
        groups[name] = kind
        defaults = kind() if parameter.default is parameter.empty else parameter.default
        parameters += [
            inspect.Parameter(option, parameter.KEYWORD_ONLY, default=getattr(defaults, option), annotation=field_hint)
            for option, field_hint in get_type_hints(kind, include_extras=True).items()
        ]

    @functools.wraps(command)
    def expanded(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{option: values.pop(option) for option in get_type_hints(kind)})
        command(**values)

    expanded.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    expanded.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return expanded


def complete_preset(start: str) -> list[tuple[str, str]]:
    """Return presets and descriptions for shell completion."""
    from heliograph.link.settings import PRESETS

    return [(name, text) for name, (text, _) in PRESETS.items() if name.startswith(start)]


def complete_receiver(start: str) -> list[str]:
    """Return receivers for shell completion."""
    from heliograph.receive.registry import RECEIVERS

    return [name for name in RECEIVERS.names() if name.startswith(start)]


def parse_film(text: str) -> Path:
    """Return the path of a film, or the name of a live camera."""
    from heliograph.media.live.reader import film_path

    return film_path(text)


def message_option(layer: str) -> Any:
    """Return the option of the message of a layer."""
    text = f"Message of {layer} priority: a file, - for standard input, or a text."
    return typer.Option(f"--{layer}", metavar="FILE|-|TEXT", help=text)


def vary_option(text: str) -> Any:
    """Return the option of varied settings."""
    return typer.Option("--vary", metavar="KEY=VALUES", help=f"Key and values: 1,2 or first:last:step. {text}")


FILM_KINDS = (
    "Video, .h5, .mraw, .cine, TIFF stack, .npy, folder of pictures, or their names such as img%04d.png. Or a live "
    "camera, camera:KIND:ADDRESS."
)

Film = Annotated[Path, typer.Argument(metavar="FILM", parser=parse_film, help=FILM_KINDS)]
Json = Annotated[bool, typer.Option("--json", help="Print only a JSON object.")]
JsonList = Annotated[bool, typer.Option("--json", help="Print only a JSON list.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the road, the scene and the noise.")]
Assignments = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a setting; may be repeated.")
]
Imu = Annotated[Path | None, typer.Option("--imu", metavar="CSV", help="Recorded car motion; sets channel.shake=imu.")]
WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, help="Worker processes; default: number of cores.")
]
Receiver = Annotated[
    str | None,
    typer.Option(
        help="Receiver: plain, soft, screen (for a phone's film of a screen) or a custom receiver; default: receiver "
        "of the preset.",
        autocompletion=complete_receiver,
    ),
]
CameraOption = Annotated[
    list[str] | None,
    typer.Option(
        "--camera",
        metavar="KEY=VALUE",
        help="Set a live camera: exposure_us, gain, rate_hz, region=X,Y,WIDTH,HEIGHT, pixel_format, trigger, producer, "
        "queue_s, reconnect, or a feature by the camera's own name, such as BlackLevel; may be repeated.",
    ),
]
Codec = Annotated[
    str | None, typer.Option(help="Codec of the film: ffv1, h264, h265 or mjpeg; default: by the suffix.")
]


@dataclass(frozen=True, slots=True)
class SettingsOptions:
    """Selection of settings: `assignments` override the file, and the file overrides the preset."""

    preset: Annotated[
        str,
        typer.Option(
            "--preset", help="Preset to start from, see 'heliograph presets'.", autocompletion=complete_preset
        ),
    ] = "paper"
    settings_file: Annotated[
        Path | None, typer.Option("--settings", metavar="FILE", help="TOML file that changes settings of the preset.")
    ] = None
    assignments: Assignments = None

    def load(self) -> "LinkSettings":
        """Return the settings."""
        from heliograph.link.settings import load_settings

        return load_settings(self.preset, self._tree(), self.assignments or ())

    def load_preset(self) -> "LinkSettings":
        """Return the settings of the preset."""
        from heliograph.link.settings import load_settings

        return load_settings(self.preset)

    def signal_changes(self) -> list[dict[str, Any]]:
        """Return changes of the signal in order, after validation by `load`."""
        changes = [self._tree(), *map(parse_assignment, self.assignments or ())]
        return [change["signal"] for change in changes if change.get("signal")]

    def overlay(self) -> Any:
        """Return file and assignments as a nested mapping."""
        from heliograph.base.config import merge

        tree: Any = self._tree()
        for change in map(parse_assignment, self.assignments or ()):
            tree = merge(tree, change)
        return tree

    def changed(self, defaults: Iterable[str] = (), overrides: Iterable[str] = ()) -> "SettingsOptions":
        """Return the options with assignments of lower and higher priority."""
        return SettingsOptions(self.preset, self.settings_file, [*defaults, *(self.assignments or ()), *overrides])

    def _tree(self) -> dict[str, Any]:
        return read_toml(self.settings_file) if self.settings_file else {}


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Random numbers and recordings of a simulation."""

    seed: Seed = 0
    background: Annotated[
        Path | None,
        typer.Option(
            "--background",
            metavar="VIDEO",
            help="Recorded footage for the background; sets channel.background.kind=footage.",
        ),
    ] = None
    imu: Imu = None


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """Processes or machines for the computation."""

    workers: WorkersOption = None
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler whose workers compute, in place of --workers."),
    ] = None


@dataclass(frozen=True, slots=True)
class FilmOptions:
    """Reading of a film."""

    fps: Annotated[
        float | None,
        typer.Option(
            "--fps",
            metavar="RATE",
            help="Frames per second of the camera, if the film states another rate, as in slow motion, or has no "
            "clock: a folder of pictures, TIFF, .npy.",
        ),
    ] = None
    crop: Annotated[
        str | None,
        typer.Option(
            "--crop",
            metavar="X,Y,WIDTH,HEIGHT",
            help="Region of the frames to read, in pixels; x and y count from 0 at the upper left.",
        ),
    ] = None
    binning: Annotated[
        int,
        typer.Option("--bin", metavar="SIDE", help="Average squares of SIDE pixels, 1 to 16; 2 for a Bayer mosaic."),
    ] = 1
    rotate: Annotated[
        int,
        typer.Option("--rotate", metavar="DEGREES", help="Rotate the region clockwise: 0, 90, 180 or 270 degrees."),
    ] = 0
    channel: Annotated[str, typer.Option("--channel", help="Gray level of a colour: luma, red, green or blue.")] = (
        "luma"
    )

    @property
    def is_partial(self) -> bool:
        """True for a part or rotation of the frames."""
        return self.crop is not None or self.binning != 1 or self.rotate != 0

    def keywords(self) -> dict[str, Any]:
        """Return the arguments of `open_film`; raise a MediaError for an invalid crop."""
        try:
            crop = tuple(map(int, self.crop.split(","))) if self.crop is not None else None
        except ValueError:
            raise MediaError(f"--crop takes X,Y,WIDTH,HEIGHT in whole pixels, not {shown(self.crop)}") from None
        return {
            "rate_hz": self.fps, "crop": crop, "binning": self.binning, "rotate": self.rotate,
            "channel": self.channel, "expand_range": True,
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class DetectOptions:
    """Receiver, and positions of arrays."""

    receiver: Receiver = None
    corners: Annotated[
        str | None,
        typer.Option(
            "--corners",
            metavar="X,Y,X,Y,X,Y,X,Y",
            help="Position of an array that detection misses: the four corners of the LED area in turn, in pixels of "
            "the frames after cropping and binning. Sets receive.detect.corners.",
        ),
    ] = None
    region: Annotated[
        str | None,
        typer.Option(
            "--region",
            metavar="X,Y,WIDTH,HEIGHT",
            help="Region of the frames to search for arrays, however faint; tracking continues outside. Sets "
            "receive.detect.region.",
        ),
    ] = None

    def assignments(self) -> list[str]:
        """Return assignments of settings."""
        changes = [] if self.receiver is None else [f"receive.receiver='{self.receiver}'"]
        changes += _numbers("corners", self.corners, 8, float, "X,Y,X,Y,X,Y,X,Y in pixels")
        return changes + _numbers("region", self.region, 4, int, "X,Y,WIDTH,HEIGHT in whole pixels")


def _numbers(name: str, text: str | None, count: int, kind: type, form: str) -> list[str]:
    """Return the assignment of the numbers of an option."""
    if text is None:
        return []
    with contextlib.suppress(ValueError, OverflowError):
        numbers = [kind(part) for part in text.split(",")]
        if len(numbers) == count and all(map(math.isfinite, numbers)):
            return [f"receive.detect.{name}={numbers}"]
    raise MediaError(f"--{name} takes {form}, not {shown(text)}")


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Settings of live cameras."""

    camera: CameraOption = None
    duration: Annotated[float | None, typer.Option(metavar="S", help="Duration of a live recording in seconds.")] = None

    def keywords(self, film: Path) -> dict[str, Any]:
        """Return the arguments of `open_film`; raise a MediaError for a recording."""
        from heliograph.media.live.reader import is_camera

        values = {name: getattr(self, name, None) for name in ("camera", "duration", "record")}
        names = [f"--{name}" for name, value in values.items() if value not in (None, [])]
        if names and not is_camera(film):
            are = "is" if len(names) == 1 else "are"
            raise MediaError(f"{' and '.join(names)} {are} for a live camera, such as camera:aravis, not {film}")
        return {"camera": [*(self.camera or ()), *([] if self.duration is None else [f"duration_s={self.duration}"])]}


@dataclass(frozen=True, slots=True)
class RecordOptions(LiveOptions):
    """Settings of live cameras, and recording of failures."""

    record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="HDF5 film of the last seconds of a live camera with a lost array or an unread packet, or without any "
            "packet.",
        ),
    ] = None
    record_s: Annotated[
        float, typer.Option("--record-s", metavar="S", min=0.1, max=3600, help="Seconds that --record keeps.")
    ] = 10.0


@dataclass(frozen=True, slots=True)
class AddressOptions:
    """Address of a server."""

    host: Annotated[
        str, typer.Option("--host", help="Address of the server; 0.0.0.0 admits other machines with a token.")
    ] = "127.0.0.1"
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Port of the server; 0 for a free port.")] = 8000
    certificate: Annotated[
        Path | None,
        typer.Option(
            "--certificate",
            metavar="PEM",
            help="Certificate for HTTPS, required by browsers of other machines for camera access.",
        ),
    ] = None
    key: Annotated[Path | None, typer.Option("--key", metavar="PEM", help="Key of the certificate.")] = None


@dataclass(frozen=True, slots=True)
class EventOptions:
    """Output of events."""

    follow: Annotated[
        bool, typer.Option("--follow", help="Print a JSON line for each array found or lost, each packet and message.")
    ] = False
    send: Annotated[
        list[str] | None,
        typer.Option(
            "--send",
            metavar="ADDRESS",
            help="Send the lines of --follow: udp://HOST:PORT, or ws://127.0.0.1:PORT for WebSocket clients; may be "
            "repeated.",
        ),
    ] = None
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Describe these events on standard error.")] = False


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """Results of a reception."""

    output: Annotated[
        Path | None, typer.Option("--output", metavar="DIR", help="Folder for the messages and the packet log.")
    ] = None
    files: Annotated[
        Path | None,
        typer.Option(
            "--files",
            metavar="DIR",
            help="Folder for received files; incomplete files continue with the next film. Default: the folder 'files' "
            "in the folder of --output.",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class ReceiveOptions:
    """Options of `receive`."""

    film: FilmOptions
    settings: SettingsOptions
    results: OutputOptions = OutputOptions()
    truth: Path | None = None
    live: RecordOptions = RecordOptions()
    events: EventOptions = EventOptions()
    as_json: bool = False

    @property
    def is_quiet(self) -> bool:
        """True if standard output is JSON only."""
        return self.as_json or self.events.follow

    def relative_to(self, folder: Path) -> "ReceiveOptions":
        """Return the options with paths relative to a folder."""
        file, output, files = (
            None if path is None else folder / path
            for path in (self.settings.settings_file, self.results.output, self.results.files)
        )
        return replace(self, settings=replace(self.settings, settings_file=file), results=OutputOptions(output, files))


@dataclass(frozen=True, slots=True)
class SentOptions:
    """Messages and files to send; see `messages.message_of` for `high`, `middle` and `low`."""

    high: Annotated[str | None, message_option("high")] = None
    middle: Annotated[str | None, message_option("middle")] = None
    low: Annotated[str | None, message_option("low")] = None
    file: Annotated[
        list[Path] | None,
        typer.Option(
            "--file",
            metavar="PATH",
            help="File for layers that have no message, sent as fountain-coded symbols: any sufficient number "
            "restores the file; may be repeated.",
        ),
    ] = None
    file_code: Annotated[
        str,
        typer.Option("--file-code", help="Code of --file: cauchy, for every receiver, or raptorq, for megabytes."),
    ] = "cauchy"
    junction: Annotated[
        Path | None,
        typer.Option(
            "--junction",
            metavar="TOML",
            help="Junction: the high layer sends traffic lights as SPATEM, the middle layer lanes as MAPEM.",
        ),
    ] = None

    @property
    def inputs(self) -> tuple[str | Path | None, ...]:
        """Possible names of input files."""
        return (self.high, self.middle, self.low, *(self.file or ()), self.junction)


def parse_vary_options(texts: list[str] | None) -> dict[str, list[Any]]:
    """Return the values of varied settings by key."""
    from heliograph.sweeps.plan import parse_vary

    vary: dict[str, list[Any]] = {}
    for key, values in map(parse_vary, texts or ()):
        if key in vary:
            raise SettingsError(f"'{key}' is varied twice; write its values in one --vary")
        vary[key] = values
    return vary


def read_toml(file: Path) -> dict[str, Any]:
    """Return the settings of a TOML file; raise a SettingsError for an unreadable or invalid file."""
    try:
        # all settings with comments have 12 kB; some editors write a byte order mark
        return parse_toml(read_bounded(file, 1 << 20).decode("utf-8-sig"))
    except OSError as error:
        raise SettingsError(f"cannot read the settings {file}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SettingsError(f"the settings {file} are no text; write TOML in UTF-8") from None
    except SettingsError as error:
        raise SettingsError(f"{file}: {error}") from None


def print_version(requested: bool) -> None:
    """Print the version and exit."""
    if requested:
        console.say(f"heliograph {__version__}")
        raise typer.Exit


def refuse_to_replace(output: Path, inputs: Iterable[Path | str | None]) -> None:
    """Raise a MediaError if an output file is also an input file."""
    is_same = False
    for path in (name for name in inputs if name):
        with contextlib.suppress(OSError, ValueError):  # missing files, and texts
            is_same |= output.samefile(path)
    if is_same:
        raise MediaError(f"{output} is read and would be written: give the output another name")


def help_unless_command(context: typer.Context) -> None:
    """Write the help to standard error and exit with status 2 if no command is given; Click before 8.2 exits with 0."""
    if context.invoked_subcommand is None:
        sys.stderr.write(context.get_help() + "\n")
        raise typer.Exit(2)
