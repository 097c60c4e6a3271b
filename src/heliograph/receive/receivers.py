"""All receivers by name. One algorithm is called in three ways: as a class, as the generator below, as a list of it."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.receive.packets import Packet, Receiver
from heliograph.receive.registry import GROUPS, RECEIVERS, ReceiverPart, part_of
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

AnyObserver = Callable[[Any], None]
"""An observer of any receiver's events; see `heliograph.receive.events.Event`."""

MakeReceiver = Callable[[SignalSettings, ReceiveSettings, AnyObserver], Receiver]
"""Makes a receiver before its first frame, from the light's signal, the settings and an observer."""


def register_receiver(name: str, make: MakeReceiver, settings: type | None = None, reads: Iterable[str] = ()) -> None:
    """Register a receiver of one's own.

    It is then chosen by its name wherever ``receive.receiver`` is: on the command line, in sweeps, in plots. Packages
    offer receivers without a call, by an entry point of the group "heliograph.receivers" that names a `ReceiverPart` or
    a function as `make`.

    Parameters
    ----------
    name
        Its name: letters, digits, "-", "_" and ".".
    make
        Takes the light's signal, the receiver's settings and an observer, and returns something with `push` and
        `finish` (see `Receiver`); a class with such a constructor will do.
    settings
        A frozen dataclass of its own settings, made of ``receive.own``; the receiver gets it as
        ``own_settings(receive_settings)``.
    reads
        Groups of ``receive`` that it reads as well: "calibration", "detect", "track", "decode". A setting of another
        group has no effect, and is an error.

    Raises
    ------
    SettingsError
        The name is "plain" or "soft", or is no name; or there is no such group.
    """
    groups = tuple(reads)
    if unknown := [group for group in groups if group not in GROUPS]:
        raise SettingsError(f"a receiver reads groups of {', '.join(GROUPS)}, not {', '.join(unknown)}")
    RECEIVERS.register(name, ReceiverPart(make, settings, groups))


def own_settings(settings: ReceiveSettings) -> Any:
    """A registered receiver's own settings, an object of its settings class; None where it has none.

    Parameters
    ----------
    settings
        Settings of the receiver, which name it and hold its own by name.

    Raises
    ------
    SettingsError
        A key of ``receive.own`` is unknown, or a value out of range.
    """
    kind = part_of(settings.receiver).settings
    return None if kind is None else from_mapping(kind, settings.own)


def make_receiver(
    signal: SignalSettings, settings: ReceiveSettings | None = None, observe: AnyObserver | None = None
) -> Receiver:
    """Make the receiver that the settings name, before its first frame.

    A receiver is for one thread at a time. Receivers in several threads share nothing that they change: each reads what
    it reads alone. Settings, frames and packets may be shared. While a receiver takes a frame, BLAS has one thread in
    the whole process.

    Parameters
    ----------
    signal
        Settings of the light's signal, on which both ends agree.
    settings
        Settings of the receiver; None for "plain" with all defaults.
    observe
        Gets its events, see `heliograph.receive.events`; None observes nothing.

    Raises
    ------
    SettingsError
        There is no receiver of that name, or it cannot read this signal.
    """
    settings = settings or ReceiveSettings()
    found: Receiver = part_of(settings.receiver).make(signal, settings, observe or _ignore)
    return found


def receive_frames(
    frames: Iterable[Frame],
    signal: SignalSettings,
    settings: ReceiveSettings | None = None,
    observe: AnyObserver | None = None,
) -> Iterator[Packet]:
    """Receive a stream of frames: its packets, each as soon as it is complete.

    Parameters
    ----------
    frames
        Camera frames in the order of time.
    signal, settings, observe
        The light's signal, the receiver's settings and an observer, as for `make_receiver`.

    Raises
    ------
    HeliographError
        The frames do not follow in time, or the camera's rate does not fit the light's.
    """
    receiver = make_receiver(signal, settings, observe)
    for frame in frames:
        yield from receiver.push(frame)
    yield from receiver.finish()


def _ignore(event: Any, /) -> None:
    """Observe nothing."""
