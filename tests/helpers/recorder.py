"""An observer that keeps what a receiver shows."""

from typing import Any, TypeVar

from heliograph.receive.events import DetectEvent, LostEvent, TrackEvent
from heliograph.receive.track.track import TrackedPair

T = TypeVar("T")


class Recorder:
    """Keeps all events of a receiver in their order.

    Attributes
    ----------
    events
        The events.
    """

    def __init__(self) -> None:
        self.events: list[Any] = []

    def __call__(self, event: Any, /) -> None:
        self.events.append(event)

    def of(self, kind: type[T]) -> list[T]:
        """The events of a kind."""
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def found_s(self) -> list[float]:
        """When the headers began by which arrays were found."""
        return [event.detection.start_time_s for event in self.of(DetectEvent)]

    @property
    def lost_s(self) -> list[float]:
        """Times of the last poses of arrays that were given up."""
        return [event.time_s for event in self.of(LostEvent)]

    @property
    def tracked(self) -> list[TrackedPair]:
        """The array in each pair."""
        return [event.tracked for event in self.of(TrackEvent)]
