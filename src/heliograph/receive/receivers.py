"""All receivers by name. One algorithm has three entrances: the class, the generator below, and a list of it."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.base.registry import Registry
from heliograph.receive.packets import Packet, Receiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

AnyObserver = Callable[[Any], None]
"""An observer of any receiver's events; see `heliograph.receive.events.Event`."""

MakeReceiver = Callable[[SignalSettings, ReceiveSettings, AnyObserver], Receiver]
"""Makes a receiver before its first frame, from the light's signal, the settings and an observer."""


class ReceiverPart(NamedTuple):
    """A receiver by name.

    Attributes
    ----------
    make
        Makes it.
    settings
        Class of its own settings, a frozen dataclass; None where it has none.
    """

    make: MakeReceiver
    settings: type | None = None


RECEIVERS: Registry[ReceiverPart] = Registry("receiver", "receive.receiver", "heliograph.receivers")
"""Receivers by the name of the setting ``receive.receiver``."""


def _plain(signal: SignalSettings, settings: ReceiveSettings, observe: AnyObserver) -> Receiver:
    from heliograph.receive.assemblies import plain_receiver  # SciPy and Numba are slow to import

    return plain_receiver(signal, settings, observe)


def _soft(signal: SignalSettings, settings: ReceiveSettings, observe: AnyObserver) -> Receiver:
    from heliograph.receive.assemblies import soft_receiver

    return soft_receiver(signal, settings, observe)


RECEIVERS.built_in("plain", ReceiverPart(_plain))
RECEIVERS.built_in("soft", ReceiverPart(_soft))


def register_receiver(name: str, make: MakeReceiver, settings: type | None = None) -> None:
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

    Raises
    ------
    SettingsError
        The name is "plain" or "soft", or is no name.
    """
    RECEIVERS.register(name, ReceiverPart(make, settings))


def own_settings(settings: ReceiveSettings) -> Any:
    """A registered receiver's own settings, an object of its settings class; None where it has none.

    Raises
    ------
    SettingsError
        A key of ``receive.own`` is unknown, or a value out of range.
    """
    part = _part(settings.receiver)
    if part.settings is not None:
        return from_mapping(part.settings, settings.own)
    if settings.own:
        raise SettingsError(f"the receiver '{settings.receiver}' has no settings of its own, but receive.own is set")
    return None


def make_receiver(
    signal: SignalSettings, settings: ReceiveSettings | None = None, observe: AnyObserver | None = None
) -> Receiver:
    """Make the receiver that the settings name, before its first frame.

    Parameters
    ----------
    signal
        The light's signal.
    settings
        The receiver's; the default is "plain" with all defaults.
    observe
        Gets its events, see `heliograph.receive.events`.

    Raises
    ------
    SettingsError
        There is no receiver of that name, or it cannot read this signal.
    """
    settings = settings or ReceiveSettings()
    own_settings(settings)
    return _part(settings.receiver).make(signal, settings, observe or _ignore)


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
        As for `make_receiver`.

    Raises
    ------
    HeliographError
        The frames do not follow in time, or the camera's rate does not fit the light's.
    """
    receiver = make_receiver(signal, settings, observe)
    for frame in frames:
        yield from receiver.push(frame)
    yield from receiver.finish()


def _part(name: str) -> ReceiverPart:
    found: Any = RECEIVERS[name]
    # an entry point may name the class or function itself
    return found if isinstance(found, ReceiverPart) else ReceiverPart(found)


def _ignore(event: Any, /) -> None:
    """Observe nothing."""
