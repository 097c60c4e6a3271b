"""Sources of page *Watch*: films, live cameras, and simulated drives."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from heliograph.base.config import from_mapping, merge
from heliograph.base.errors import SettingsError
from heliograph.base.files import shown_name
from heliograph.base.toml_text import parse_assignment
from heliograph.link.film import FrameSource, frames_of
from heliograph.link.settings import LinkSettings, load_settings, names_receiver, preset
from heliograph.link.truth import check_truth, open_truth, signal_of, truth_path
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import TruthSource
from heliograph.media import open_film
from heliograph.media.live.reader import LiveReader, is_camera, live_of
from heliograph.probe.screens import with_receiver_for
from heliograph.receive.api import choose_receiver
from heliograph.signal.settings import SignalSettings
from heliograph.web.shared import Shared, named_as

Text = Annotated[str, Field(max_length=200)]


class WatchRequest(BaseModel):
    """Request of a page for a source; no value becomes a path on the disk."""

    model_config = ConfigDict(extra="forbid", strict=True)

    kind: Literal["film", "named", "camera", "drive"]
    film: Text = ""
    number: Annotated[int, Field(ge=0, le=1000)] = 0
    preset: Text | None = None
    seed: Annotated[int, Field(ge=0, lt=1 << 31)] = 0
    street: bool = True
    distance_m: Annotated[float, Field(ge=5, le=300, allow_inf_nan=False)] | None = None
    speed_m_s: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)] | None = None
    receiver: Text | None = None
    rate_hz: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None
    changes: Annotated[list[Text], Field(max_length=40)] = []


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Open source of frames."""

    # Name for the page
    name: str
    frames: FrameSource
    width: int
    height: int
    rate_hz: float
    # Expected number of frames; None if unknown
    frame_count: int | None
    signal: SignalSettings
    settings: LinkSettings
    # None if unknown
    truth: TruthSource | None = None
    # Live camera; None for other sources
    live: LiveReader | None = None
    # Metadata of the film
    metadata: dict[str, str] = field(default_factory=dict)


@contextlib.contextmanager
def opened(request: WatchRequest, shared: Shared) -> Iterator[Source]:
    """Open a source during the block."""
    base = shared.settings if request.preset is None else load_settings(request.preset)
    changes = [parse_assignment(text) for text in request.changes]
    if not all(set(change) <= {"signal", "receive"} for change in changes):
        raise SettingsError("a page changes only settings of signal and receive, such as signal.side=8")
    named = [] if request.receiver is None else [{"receive": {"receiver": request.receiver}}]
    is_auto = shared.is_auto if request.preset is None else not names_receiver(preset(request.preset))
    is_auto = is_auto and not names_receiver(*named, *changes)
    if request.kind == "drive":
        yield _simulate_drive(request, base, [*named, *changes], is_auto=is_auto)
        return
    settings = _with_changes(base, [*named, *changes])
    with contextlib.ExitStack() as stack:
        if request.kind == "film":
            path, name = stack.enter_context(shared.uploads.of(request.film).reading()), "the film"
        elif request.kind == "named":
            path = Path(_select(shared.films, request.number, "film", "reload the page"))
            name = shown_name(path)
        else:
            name = _select(shared.cameras, request.number, "camera", "search for cameras again")
            path = Path(name)
        stack.enter_context(named_as(path, name))
        camera = shared.camera if is_camera(path) else ()
        film = stack.enter_context(open_film(path, rate_hz=request.rate_hz, expand_range=True, camera=camera))
        signal, _ = signal_of(film, base.signal, [change["signal"] for change in changes if "signal" in change])
        truth = None
        if request.kind == "named" and not is_camera(path) and truth_path(path).is_file():
            truth = open_truth(truth_path(path))
            check_truth(film, truth, signal)
        if is_auto:
            settings, _ = with_receiver_for(film, signal, settings)
        live = live_of(film)
        if live is not None:
            settings = replace(settings, receive=settings.receive.with_live_limits())
        yield Source(
            name=name, frames=film, width=film.width, height=film.height, rate_hz=film.rate_hz,
            frame_count=film.frame_count, signal=signal, settings=settings, truth=truth, live=live,
            metadata=film.metadata,
        )  # fmt: skip


def _simulate_drive(
    request: WatchRequest, base: LinkSettings, changes: Sequence[Mapping[str, Any]], *, is_auto: bool
) -> Source:
    """Return a drive that is rendered during the reception."""
    from heliograph.experiments.demo import demo_messages  # imports Matplotlib

    values = {"distance_m": request.distance_m, "speed_m_s": request.speed_m_s}
    channel: dict[str, Any] = {key: value for key, value in values.items() if value is not None}
    if request.street:
        channel["background"] = {"kind": "street" if base.channel.background.level else "street-night"}
    settings = _with_changes(base, [{"channel": channel}, *changes])
    if is_auto:
        name, _ = choose_receiver(settings.signal, settings.channel.camera.fps)
        settings = replace(settings, receive=replace(settings.receive, receiver=name))
    camera, film = settings.channel.camera, LiveFilm(settings, demo_messages(settings), request.seed, None, None)
    return Source(
        name="a simulated drive", frames=film, width=camera.width, height=camera.height,
        rate_hz=camera.fps, frame_count=frames_of(settings), signal=settings.signal,
        settings=settings, truth=film,
    )  # fmt: skip


def _with_changes(settings: LinkSettings, changes: Sequence[Mapping[str, Any]]) -> LinkSettings:
    tree = asdict(settings)
    for change in changes:
        tree = merge(tree, change)
    return from_mapping(LinkSettings, tree)


def _select(names: Sequence[str], number: int, kind: str, remedy: str) -> str:
    if number >= len(names):
        raise SettingsError(f"there is no {kind} {number} here: {remedy}")
    return names[number]
