"""Estimate of the pattern rate and the number of cells of a screen from frames or trial receptions."""

import contextlib
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from itertools import takewhile
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.probe.screens import SIDES, cells_of_a_side, patterns_per_s
from heliograph.web.camera_frames import Frames
from heliograph.web.sending import MAX_RATE_HZ, MIN_RATE_HZ, screen_settings

Tell = Callable[[Mapping[str, Any]], None]  # sends a row to a page; an exception ends the reception

# sides in the order of trials; page *Transmit* offers 16 first
TRIAL_SIDES = (16, 8, 32, 24, 12, 20, 28, 64, 48, 96, 128)
# default pattern rate, as in page *Transmit*, and rates of trials: without inverses, no rate is measured
DEFAULT_RATE_HZ, TRIAL_RATES_HZ = 10.0, (10.0, 15.0, 30.0, 20.0)


class LinkRequest(BaseModel):
    """Properties of the screen in the request of a page; None for unknown values."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    # Cells of a side
    side: Annotated[int, Field(ge=SIDES[0], le=SIDES[-1], multiple_of=4)] | None = None
    # Patterns per second
    rate_hz: Annotated[float, Field(ge=MIN_RATE_HZ, le=MAX_RATE_HZ)] | None = None

    @property
    def default_link(self) -> LinkSettings:
        """Default settings."""
        return screen_settings(self.side or TRIAL_SIDES[0], self.rate_hz or DEFAULT_RATE_HZ)


def shows_light(frames: list[Frame], request: LinkRequest) -> bool:
    """Return True if frames may show a screen; displays that skip refreshes have cells, but no measurable rate."""
    return request.rate_hz is not None or patterns_per_s(frames) is not None or cells_of_a_side(frames) is not None


def estimate_link(
    frames: list[Frame],
    request: LinkRequest,
    tell: Tell,
    rejected_sides: Collection[int] = (),
    is_late: Callable[[], bool] = lambda: False,
) -> LinkSettings:
    """Estimate the settings of a link; `is_late` ends the trials."""
    rate_hz = request.rate_hz or patterns_per_s(frames)
    side = request.side or cells_of_a_side(frames)
    if rate_hz is None and side is not None and side not in rejected_sides:
        rate_hz = next((hz for hz in TRIAL_RATES_HZ if _try(frames, _settings_at(side, hz), is_late)[1]), None)
    tell({"event": "light", "rate_hz": rate_hz})
    # a receiver with a wrong rate finds the right rate, but later
    trial_rate_hz = rate_hz or DEFAULT_RATE_HZ
    if request.side is None and (side is None or side in rejected_sides):
        side = None
        for trial_side in TRIAL_SIDES:
            if trial_side in rejected_sides:
                continue
            if is_late():
                break
            tell({"event": "trying", "side": trial_side})
            is_detected, is_decoded = _try(frames, screen_settings(trial_side, trial_rate_hz), is_late)
            if is_decoded:
                side = trial_side
            if is_decoded or not is_detected:  # headers of all sizes look alike
                break
    if rate_hz or side:
        tell({"event": "light", "rate_hz": rate_hz, "side": side})
    return screen_settings(side or TRIAL_SIDES[0], trial_rate_hz)


def _settings_at(side: int, rate_hz: float) -> LinkSettings:
    """Return settings of a receiver that searches no other rate."""
    settings = screen_settings(side, rate_hz)
    screen = replace(settings.receive.screen, find_rate=False)
    return replace(settings, receive=replace(settings.receive, screen=screen))


def _try(frames: list[Frame], settings: LinkSettings, is_late: Callable[[], bool]) -> tuple[bool, bool]:
    """Return True for a detected header, and for a decoded codeword."""
    reception, film = ReceptionCounter(), Frames("the film", takewhile(lambda _: not is_late(), frames))
    with contextlib.suppress(HeliographError):  # such as too few frames; the reception reports the error
        deque(receive_and_count(film, settings.signal, settings, reception), maxlen=0)
    return bool(reception.detections), bool(reception.confirmed)
