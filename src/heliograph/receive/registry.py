"""Receivers by name."""

from collections.abc import Callable
from typing import Any, NamedTuple

from heliograph.base.registry import Registry

GROUPS = ("calibration", "detect", "track", "decode")
"""Groups of settings that are not one receiver's alone."""


class ReceiverPart(NamedTuple):
    """A receiver by name.

    Attributes
    ----------
    make
        Makes it of the light's signal, the receiver's settings and an observer.
    settings
        Class of its own settings, a frozen dataclass; None where it has none.
    reads
        Groups of ``receive`` that it reads as well as ``receive.own``, of `GROUPS`.
    """

    make: Callable[..., Any]
    settings: type | None = None
    reads: tuple[str, ...] = ()


RECEIVERS: Registry[Any] = Registry(
    "receiver",
    "heliograph.receivers",
    {
        "plain": "heliograph.receive.build:plain_receiver",
        "soft": "heliograph.receive.build:soft_receiver",
        "screen": "heliograph.receive.screen.receiver:screen_receiver",
    },
)
"""Receivers by the name of the setting ``receive.receiver``; a `ReceiverPart`, or what makes one."""


def part_of(name: str) -> ReceiverPart:
    """Receiver of a name.

    Parameters
    ----------
    name
        Name of the receiver, such as "soft", as in the setting ``receive.receiver``.

    Raises
    ------
    SettingsError
        There is none of that name.
    """
    found = RECEIVERS[name]
    return found if isinstance(found, ReceiverPart) else ReceiverPart(found)
