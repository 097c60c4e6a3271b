"""What is watched: an uploaded film, one that was named where the server began, a live camera, a simulated drive."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from heliograph.base.config import from_mapping, merge, to_mapping
from heliograph.base.errors import SettingsError
from heliograph.base.files import shown_name
from heliograph.base.toml_text import parse_assignment
from heliograph.link.film import FrameSource, frames_of
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.truth import check_truth, open_truth, signal_of, truth_path
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import TruthSource
from heliograph.media import open_film
from heliograph.media.live.reader import LiveReader, is_camera, live_of
from heliograph.signal.settings import SignalSettings
from heliograph.web.shared import Shared, named_as

OPEN = ("signal", "receive")
"""Parts of the settings that a page may change: what the light says, and how it is read."""

Text = Annotated[str, Field(max_length=200)]


class Asked(BaseModel):
    """What a page asks to watch; nothing of it becomes a path of the disk."""

    model_config = ConfigDict(extra="forbid", strict=True)

    kind: Literal["film", "named", "camera", "drive"]
    film: Text = ""
    number: Annotated[int, Field(ge=0, le=1000)] = 0
    preset: Text | None = None
    seed: Annotated[int, Field(ge=0, lt=1 << 31)] = 0
    street: bool = True
    distance_m: Annotated[float, Field(ge=5, le=300, allow_inf_nan=False)] | None = None
    speed_m_s: Annotated[float, Field(ge=0, le=70, allow_inf_nan=False)] | None = None
    receiver: Text | None = None
    rate_hz: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None
    changes: Annotated[list[Text], Field(max_length=40)] = []


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Something that is watched, opened."""

    # What a page calls it
    name: str
    # Its frames in the order of time
    frames: FrameSource
    # width, height, bits, rate_hz: form of its frames
    width: int
    height: int
    bits: int
    rate_hz: float
    # Frames to expect; None where that is not known
    frame_count: int | None
    # signal, settings: the light's signal, and the link with the receiver
    signal: SignalSettings
    settings: LinkSettings
    # What was sent; None where it is not known
    truth: TruthSource | None = None
    # The camera behind it; None of anything else
    live: LiveReader | None = None
    # Text that is kept with it
    metadata: dict[str, str]


@contextlib.contextmanager
def opened(asked: Asked, shared: Shared) -> Iterator[Source]:
    """Open what a page asks for, for as long as the block lasts."""
    if asked.kind == "drive":
        yield _drive(asked, shared)
        return
    with contextlib.ExitStack() as stack:
        if asked.kind == "film":
            path, name = stack.enter_context(shared.uploads.reading(asked.film)), "the film"
        elif asked.kind == "named":
            path = Path(_numbered(shared.films, asked.number, "film"))
            name = shown_name(path)
        else:
            name = _numbered(shared.cameras, asked.number, "camera")
            path = Path(name)
        stack.enter_context(named_as(path, name))
        yield stack.enter_context(_film(asked, shared, path, name))


@contextlib.contextmanager
def _film(asked: Asked, shared: Shared, path: Path, name: str) -> Iterator[Source]:
    base = _base(asked, shared)
    settings, changes = _settings(asked, base)
    camera = shared.camera if is_camera(path) else ()
    with open_film(path, rate_hz=asked.rate_hz, expand_range=True, camera=camera) as film:
        signal, _ = signal_of(film, base.signal, changes)
        known = None
        beside = truth_path(path)
        if asked.kind == "named" and not is_camera(path) and beside.is_file():
            known = open_truth(beside)
            check_truth(film, known, signal)
        live = live_of(film)
        if live is not None:
            settings = replace(settings, receive=settings.receive.with_live_limits())
        yield Source(
            name=name, frames=film, width=film.width, height=film.height, bits=film.bits, rate_hz=film.rate_hz,
            frame_count=film.frame_count, signal=signal, settings=settings, truth=known, live=live,
            metadata=film.metadata,
        )  # fmt: skip


def _drive(asked: Asked, shared: Shared) -> Source:
    """A drive rendered as it is watched, with its truth."""
    from heliograph.experiments.demo.drive import demo_messages  # it draws reports too, which is slow to import

    base = _base(asked, shared)
    kind = "street" if base.channel.background.level else "street-night"
    channel = [f"channel.background.kind='{kind}'"] if asked.street else []
    given = {"distance_m": asked.distance_m, "speed_m_s": asked.speed_m_s}
    channel += [f"channel.{key}={value}" for key, value in given.items() if value is not None]
    settings, _ = _settings(asked, _changed(base, map(parse_assignment, channel)))
    camera, film = settings.channel.camera, LiveFilm(settings, demo_messages(settings), asked.seed, None, None)
    return Source(
        name="a simulated drive", frames=film, width=camera.width, height=camera.height,
        bits=settings.channel.sensor.bits, rate_hz=camera.fps, frame_count=frames_of(settings), signal=settings.signal,
        settings=settings, truth=film, metadata={},
    )  # fmt: skip


def _base(asked: Asked, shared: Shared) -> LinkSettings:
    """Settings before what the page changes one by one."""
    return shared.settings if asked.preset is None else load_settings(asked.preset)


def _settings(asked: Asked, base: LinkSettings) -> tuple[LinkSettings, list[dict[str, object]]]:
    """Settings with what the page changes, and the changes of the signal alone."""
    changes = [parse_assignment(text) for text in asked.changes]
    if not all(set(change) <= set(OPEN) for change in changes):
        raise SettingsError(f"a page changes settings of {' and '.join(OPEN)}, such as signal.side=8, no others")
    receiver = [] if asked.receiver is None else [{"receive": {"receiver": asked.receiver}}]
    return _changed(base, [*receiver, *changes]), [one["signal"] for one in changes if "signal" in one]


def _changed(settings: LinkSettings, changes: Iterable[Mapping[str, Any]]) -> LinkSettings:
    tree = to_mapping(settings)
    for change in changes:
        tree = merge(tree, change)
    return from_mapping(LinkSettings, tree)


def _numbered(names: tuple[str, ...] | list[str], number: int, what: str) -> str:
    if number >= len(names):
        raise SettingsError(
            f"there is no {what} {number} here: {'look for cameras' if what == 'camera' else 'load the page'} again"
        )
    return names[number]
