"""Time by stage of the receiver: what passes until a stage's event counts for it."""

import time

from heliograph.receive.events import (
    DecodeEvent,
    DetectEvent,
    EqualiseEvent,
    ExtractEvent,
    LostEvent,
    TrackEvent,
)

STAGES: dict[type, str] = {
    DetectEvent: "find",
    TrackEvent: "follow",
    ExtractEvent: "take pairs",
    EqualiseEvent: "equalise",
    DecodeEvent: "decode",
    LostEvent: "follow",
}
"""Stages by the event that ends them."""

SEARCH = "search"
"""What a frame takes without an event after it: mostly the search for arrays."""


class Stages:
    """Counts the seconds of each stage, from one mark to the next."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def mark(self, stage: str) -> None:
        """Count the time since the last mark for a stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now

    def event(self, event: object) -> None:
        """Count the time since the last mark for the stage that an event ends."""
        self.mark(STAGES.get(type(event), SEARCH))
