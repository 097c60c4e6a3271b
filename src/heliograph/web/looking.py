"""What light some frames show: its rate and its cells, by the frames alone or by what is read of them."""

from collections.abc import Callable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import chain
from typing import Any

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.probe.screens import cells_of_a_side, patterns_per_s
from heliograph.receive import make_receiver
from heliograph.receive.events import DetectEvent
from heliograph.web.sending import screen_settings

Tell = Callable[[Mapping[str, Any]], None]
"""Tells a page something; what it raises ends the reading."""

Hurry = Callable[[], bool]
"""Whether there is no time to try more."""

SIDES_TRIED = (16, 8, 32, 24, 12, 20, 28)
"""Cells of a side in the order in which they are tried where nobody says. Chosen: by what the page offers first."""

USUAL_HZ = 10.0
"""Patterns a second that are taken where nothing tells: those that page *Transmit* offers first."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a page asks for."""

    # Cells of a side; None where they are to be found
    side: int | None = None
    # Patterns a second; None where they are to be found
    rate_hz: float | None = None

    @property
    def usual(self) -> LinkSettings:
        """The link where nothing is found."""
        return screen_settings(self.side or SIDES_TRIED[0], self.rate_hz or USUAL_HZ)


def unhurried() -> bool:
    """Whether there is no time: there is."""
    return False


def shows_light(frames: list[Frame], asked: Asked) -> bool:
    """Whether it is worth while to look for packets; a display that skips refreshes has no rate, but lines of cells."""
    return asked.rate_hz is not None or patterns_per_s(frames) is not None or cells_of_a_side(frames) is not None


def link_shown(
    frames: list[Frame], asked: Asked, tell: Tell, doubted: AbstractSet[int] = frozenset(), hurry: Hurry = unhurried
) -> LinkSettings:
    """Return the link that some frames show; the usual one where they do not tell."""
    rate = asked.rate_hz or patterns_per_s(frames)
    tell({"event": "light", "rate_hz": rate})
    # a receiver that is told a wrong rate finds the right one, but later
    side = asked.side or _side_of(frames, rate or USUAL_HZ, tell, doubted, hurry)
    if rate or side:
        tell({"event": "light", "rate_hz": rate, "side": side})
    return screen_settings(side or SIDES_TRIED[0], rate or USUAL_HZ)


def _side_of(
    frames: list[Frame], rate_hz: float, tell: Tell, doubted: AbstractSet[int], hurry: Hurry
) -> int | None:  # fmt: skip
    """The size by the lines between cells, else the one whose packets are read; None where there is none."""
    likely = cells_of_a_side(frames)
    if likely is not None and likely not in doubted:
        return likely
    for side in (side for side in SIDES_TRIED if side not in doubted):
        if hurry():
            return None
        tell({"event": "trying", "side": side})
        try:
            found, read = _tried(frames, screen_settings(side, rate_hz), hurry)
        except HeliographError:  # such as too few frames for such a rate: reading says so
            return None
        if read:
            return side
        if not found:  # headers of all sizes look alike
            return None
    return None


def _tried(frames: list[Frame], settings: LinkSettings, hurry: Hurry) -> tuple[bool, bool]:
    """Whether a header is found in some frames, and whether a codeword is read."""
    found = list[DetectEvent]()

    def observe(event: object) -> None:
        if isinstance(event, DetectEvent):
            found.append(event)

    def with_live_limits() -> Iterator[Frame]:
        for frame in frames:
            if hurry():
                return
            yield frame

    receiver = make_receiver(settings.signal, settings.receive, observe)
    packets = chain(chain.from_iterable(map(receiver.push, with_live_limits())), receiver.finish())
    read = any(word.block for packet in packets for words in packet.layers.values() for word in words)
    return bool(found), read
