"""Observer that records receiver events."""

from typing import Any, TypeVar

from heliograph.receive.events import DetectEvent, LostEvent, TrackEvent
from heliograph.receive.track.track import TrackedPair

T = TypeVar("T")


class Recorder:
    """Record all receiver events in order."""

    def __init__(self) -> None:
        self.events: list[Any] = []

    def __call__(self, event: Any, /) -> None:
        self.events.append(event)

    def of(self, kind: type[T]) -> list[T]:
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def found_s(self) -> list[float]:
        return [event.detection.start_time_s for event in self.of(DetectEvent)]

    @property
    def lost_s(self) -> list[float]:
        return [event.time_s for event in self.of(LostEvent)]

    @property
    def tracked(self) -> list[TrackedPair]:
        return [event.tracked for event in self.of(TrackEvent)]
