"""Options shared by several commands, in groups."""

import contextlib
import functools
import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import Field, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from heliograph.base.config import keys_of, merge
from heliograph.base.errors import MediaError, SettingsError, shown
from heliograph.base.files import read_bounded
from heliograph.base.toml_text import parse_assignment, parse_toml
from heliograph.link import truth
from heliograph.link.settings import PRESETS, LinkSettings, load_settings, names_receiver, preset
from heliograph.media import FilmReader
from heliograph.media.live.reader import film_path, is_camera
from heliograph.receive.registry import RECEIVERS
from heliograph.signal.settings import SignalSettings


def option(text: str, metavar: str | None = None, *names: str, default: Any = None, **settings: Any) -> Any:
    """Declare an option with a help text, as the default of a field or a parameter."""
    return field(default=default, metadata={"option": typer.Option(*names, metavar=metavar, help=text, **settings)})


def with_options(function: Callable[..., None]) -> Callable[..., None]:
    """Prepare a function for Typer: apply `option`, and make each field of a dataclass parameter an option."""
    groups, parameters = dict[str, Any](), list[inspect.Parameter]()

    def add(name: str, hint: Any, default: Any, metadata: Mapping[str, Any]) -> None:
        annotation = Annotated[hint, metadata["option"]] if metadata else hint
        parameters.append(
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        )

    hints = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        kind, default = hints[name], parameter.default
        if is_dataclass(kind):
            groups[name], types = kind, get_type_hints(kind, include_extras=True)
            for item in fields(kind):
                add(item.name, types[item.name], getattr(default, item.name, item.default), item.metadata)
        elif isinstance(default, Field):
            add(name, kind, default.default, default.metadata)
        else:
            add(name, kind, default, {})

    @functools.wraps(function)
    def expanded(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{item.name: values.pop(item.name) for item in fields(kind)})
        function(**values)

    expanded.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # Typer reads it of any function
    expanded.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return expanded


def command(function: Callable[..., None]) -> typer.Typer:
    """Make a command of a function; see `with_options`."""
    app = typer.Typer(rich_markup_mode=None, add_completion=False)
    app.command()(with_options(function))
    return app


def complete_preset(start: str) -> list[tuple[str, str]]:
    """Return presets and descriptions for shell completion."""
    return [(name, text) for name, (text, _) in PRESETS.items() if name.startswith(start)]


def complete_receiver(start: str) -> list[str]:
    """Return receivers for shell completion."""
    return [name for name in ("auto", *RECEIVERS.names()) if name.startswith(start)]


def complete_key(start: str) -> list[str]:
    """Return keys of settings for shell completion."""
    return [f"{key}=" for key in keys_of(LinkSettings) if key.startswith(start)]


def vary_option(text: str) -> Any:
    """Declare the option of varied settings."""
    return option(
        f"Key and values: 1,2 or first:last:step, with last included. {text}",
        "KEY=VALUES",
        "--vary",
        autocompletion=complete_key,
    )


FILM_KINDS = (
    "Video, .h5, .mraw, .cine, TIFF stack, .npy, folder of pictures, or their names such as img%04d.png. Or a live "
    "camera, camera:KIND:ADDRESS."
)

Film = Annotated[Path, typer.Argument(metavar="FILM", parser=film_path, help=FILM_KINDS)]
Json = Annotated[bool, typer.Option("--json", help="Print only a JSON object.")]
JsonList = Annotated[bool, typer.Option("--json", help="Print only a JSON list.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the road, the scene and the noise.")]
Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a setting; may be repeated.", autocompletion=complete_key),
]
Imu = Annotated[Path | None, typer.Option(metavar="CSV", help="Recorded car motion; sets channel.shake=imu.")]
WorkersOption = Annotated[int | None, typer.Option(min=1, help="Worker processes; default: number of cores.")]
Receiver = Annotated[
    str | None,
    typer.Option(
        help="Receiver: plain, soft, screen (for a phone's film of a screen), a published or custom receiver, or auto, "
        "which chooses by the frame rate; default: receiver of the preset, or auto.",
        autocompletion=complete_receiver,
    ),
]
CameraOption = Annotated[
    list[str] | None,
    typer.Option(
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

    preset: str = option(
        "Preset to start from, see 'heliograph presets'.", default="paper", autocompletion=complete_preset
    )
    settings_file: Path | None = option("TOML file that changes settings of the preset.", "FILE", "--settings")
    assignments: Assignments = None

    def load(self) -> LinkSettings:
        """Return the settings."""
        return load_settings(self.preset, self._tree(), self.assignments or ())

    def signal_of(self, film: FilmReader) -> tuple[SignalSettings, str]:
        """Return the signal of a film, and the differences from the film's note; `load` validates the settings."""
        changes = [change["signal"] for change in self._changes() if change.get("signal")]
        return truth.signal_of(film, load_settings(self.preset).signal, changes)

    def is_auto(self, receiver: str | None) -> bool:
        """Return True if the film decides: by option "auto", or without an option and a setting of a receiver."""
        return receiver == "auto" or (receiver is None and not names_receiver(preset(self.preset), *self._changes()))

    def overlay(self) -> Any:
        """Return file and assignments as a nested mapping."""
        return functools.reduce(merge, self._changes())

    def changed(self, defaults: Iterable[str] = (), overrides: Iterable[str] = ()) -> "SettingsOptions":
        """Return the options with assignments of lower and higher priority."""
        return SettingsOptions(self.preset, self.settings_file, [*defaults, *(self.assignments or ()), *overrides])

    def _changes(self) -> list[dict[str, Any]]:
        return [self._tree(), *map(parse_assignment, self.assignments or ())]

    def _tree(self) -> dict[str, Any]:
        return read_toml(self.settings_file) if self.settings_file else {}


STATIC = SettingsOptions("static")
"""Default of commands that vary the distance, as a drive of the preset "paper" has no fixed distance."""


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Random numbers and recordings of a simulation."""

    seed: Seed = 0
    background: Path | None = option(
        "Recorded footage for the background; sets channel.background.kind=footage.", "VIDEO"
    )
    imu: Imu = None


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """Processes or machines for the computation."""

    workers: WorkersOption = None
    scheduler: str | None = option("Dask scheduler whose workers compute, in place of --workers.", "ADDRESS")


@dataclass(frozen=True, slots=True)
class FilmOptions:
    """Reading of a film."""

    fps: float | None = option(
        "Frames per second of the camera, if the film states another rate, as in slow motion, or has no clock: a "
        "folder of pictures, TIFF, .npy.",
        "RATE",
    )
    crop: str | None = option(
        "Region of the frames to read, in pixels; x and y count from 0 at the upper left.", "X,Y,WIDTH,HEIGHT"
    )
    binning: int = option("Average squares of SIDE pixels, 1 to 16; 2 for a Bayer mosaic.", "SIDE", "--bin", default=1)
    rotate: int = option("Rotate the region clockwise: 0, 90, 180 or 270 degrees.", "DEGREES", default=0)
    channel: str = option("Gray level of a colour: luma, red, green or blue.", default="luma")

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
    corners: str | None = option(
        "Position of an array that detection misses: the four corners of the LED area in turn, in pixels of the frames "
        "after cropping and binning. Sets receive.detect.corners.",
        "X,Y,X,Y,X,Y,X,Y",
    )
    region: str | None = option(
        "Region of the frames to search for arrays, however faint; tracking continues outside. Sets "
        "receive.detect.region.",
        "X,Y,WIDTH,HEIGHT",
    )

    def assignments(self) -> list[str]:
        """Return assignments of settings."""
        changes = [] if self.receiver in (None, "auto") else [f"receive.receiver='{self.receiver}'"]
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
    duration: float | None = option("Duration of a live recording in seconds.", "S")

    def keywords(self, film: Path) -> dict[str, Any]:
        """Return the arguments of `open_film`; raise a MediaError for a recording."""
        values = {name: getattr(self, name, None) for name in ("camera", "duration", "record")}
        names = [f"--{name}" for name, value in values.items() if value not in (None, [])]
        if names and not is_camera(film):
            are = "is" if len(names) == 1 else "are"
            raise MediaError(f"{' and '.join(names)} {are} for a live camera, such as camera:aravis, not {film}")
        return {"camera": [*(self.camera or ()), *([] if self.duration is None else [f"duration_s={self.duration}"])]}


@dataclass(frozen=True, slots=True)
class RecordOptions(LiveOptions):
    """Settings of live cameras, and recording of failures."""

    record: Path | None = option(
        "HDF5 film of the last seconds of a live camera with a lost array or an unread packet, or without any packet.",
        "FILE",
    )
    record_s: float = option("Seconds that --record keeps.", "S", default=10.0, min=0.1, max=3600)


@dataclass(frozen=True, slots=True)
class AddressOptions:
    """Address of a server."""

    host: str = option("Address of the server; 0.0.0.0 admits other machines with a token.", default="127.0.0.1")
    port: int = option("Port of the server; 0 for a free port.", default=8000, min=0, max=65535)
    certificate: Path | None = option(
        "Certificate for HTTPS, required by browsers of other machines for camera access.", "PEM"
    )
    key: Path | None = option("Key of the certificate.", "PEM")


@dataclass(frozen=True, slots=True)
class EventOptions:
    """Output of events."""

    follow: bool = option(
        "Print a JSON line for each array found or lost, each packet and message.", None, "--follow", default=False
    )
    send: list[str] | None = option(
        "Send the lines of --follow: udp://HOST:PORT, or ws://127.0.0.1:PORT for WebSocket clients; may be repeated.",
        "ADDRESS",
    )
    verbose: bool = option("Describe these events on standard error.", None, "--verbose", "-v", default=False)


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """Results of a reception."""

    output: Path | None = option("Folder for the messages and the packet log.", "DIR")
    files: Path | None = option(
        "Folder for received files; incomplete files continue with the next film. Default: the folder 'files' in the "
        "folder of --output.",
        "DIR",
    )
    replay: Path | None = option("Page for replay in a browser without a server, a file .html.", "FILE")
    rerun: Path | None = option(
        "Recording of the reception for the viewer Rerun, a file .rrd; needs the extra 'rerun'.", "FILE"
    )


@dataclass(frozen=True, slots=True)
class ReceiveOptions:
    """Options of `receive`."""

    film: FilmOptions
    settings: SettingsOptions
    results: OutputOptions = OutputOptions()
    live: RecordOptions = RecordOptions()
    events: EventOptions = EventOptions()
    as_json: bool = False
    # True to choose the receiver by the film
    is_auto: bool = False

    @property
    def is_quiet(self) -> bool:
        """True if standard output is JSON only."""
        return self.as_json or self.events.follow

    @property
    def files_folder(self) -> Path | None:
        """Folder of received files."""
        output = self.results.output
        return self.results.files or (None if output is None else output / "files")

    def for_film(self, film: Path, folder: Path) -> "ReceiveOptions":
        """Return the options for one of many films; paths are relative to a folder."""
        file, output, files = (
            None if path is None else folder / path
            for path in (self.settings.settings_file, self.results.output, self.results.files)
        )
        results = OutputOptions(None if output is None else output / film.name, files)
        return replace(self, settings=replace(self.settings, settings_file=file), results=results)


@dataclass(frozen=True, slots=True)
class SentOptions:
    """Messages and files to send; see `messages.message_of` for `high`, `middle` and `low`."""

    high: str | None = option("Message of high priority: a file, - for standard input, or a text.", "FILE|-|TEXT")
    middle: str | None = option("Message of middle priority: a file, - for standard input, or a text.", "FILE|-|TEXT")
    low: str | None = option("Message of low priority: a file, - for standard input, or a text.", "FILE|-|TEXT")
    file: list[Path] | None = option(
        "File for layers that have no message, sent as fountain-coded symbols: any sufficient number restores the "
        "file; may be repeated.",
        "PATH",
    )
    file_code: str = option("Code of --file: cauchy, for every receiver, or raptorq, for megabytes.", default="cauchy")
    junction: Path | None = option(
        "Junction: the high layer sends traffic lights as SPATEM, the middle layer lanes as MAPEM.", "TOML"
    )

    @property
    def inputs(self) -> tuple[str | Path | None, ...]:
        """Possible names of input files."""
        return (self.high, self.middle, self.low, *(self.file or ()), self.junction)


def read_toml(file: Path) -> dict[str, Any]:
    """Return the settings of a TOML file; raise a SettingsError for an unreadable or invalid file."""
    try:
        # all settings with comments have 12 kB; some editors write a byte order mark
        return parse_toml(read_bounded(file, 1 << 20).decode("utf-8-sig"))
    except OSError as error:
        raise SettingsError(f"cannot read the settings {file}: {error.strerror}; check the path") from None
    except UnicodeDecodeError:
        raise SettingsError(f"the settings {file} are no text; write TOML in UTF-8") from None
    except SettingsError as error:
        raise SettingsError(f"{file}: {error}") from None


def refuse_to_replace(output: Path, inputs: Iterable[Path | str | None]) -> None:
    """Raise a MediaError if an output file is also an input file."""
    is_same = False
    for path in (name for name in inputs if name):
        with contextlib.suppress(OSError, ValueError):  # missing files, and texts
            is_same |= output.samefile(path)
    if is_same:
        raise MediaError(f"{output} is read and would be written: give the output another name")
