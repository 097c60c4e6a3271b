"""All receivers by name. One algorithm is called in three ways: as a class, as the generator below, as a list of it."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from heliograph.base.config import from_mapping
from heliograph.base.errors import HeliographError, SettingsError, shown
from heliograph.base.frames import Frame
from heliograph.receive.packet import Packet, Receiver
from heliograph.receive.registry import GROUPS, RECEIVERS, ReceiverPart, part_of
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings, check_signal

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
        The name is "plain" or "soft", or is no name; `make` is no function; or there is no such group.
    """
    groups = tuple(reads)
    if unknown := [group for group in groups if group not in GROUPS]:
        raise SettingsError(f"a receiver reads groups of {', '.join(GROUPS)}, not {', '.join(unknown)}")
    RECEIVERS.register_maker(name, make, ReceiverPart(make, settings, groups))


def own_settings(settings: ReceiveSettings) -> Any:
    """A registered receiver's own settings, an object of its settings class; None where it has none.

    Parameters
    ----------
    settings
        Settings of the receiver, which name it and hold its own by name.

    Raises
    ------
    SettingsError
        A key of ``receive.own`` is unknown, or a value out of range; or the settings are no `ReceiveSettings`.
    """
    _check_settings(settings)
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
        There is no receiver of that name, or it cannot read this signal; or the arguments are no settings or observer.
    """
    check_signal(signal)
    settings = ReceiveSettings() if settings is None else settings
    _check_settings(settings)
    if not callable(observe or _ignore):
        raise SettingsError(f"an observer is a function that takes an event, not {shown(observe)}")
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
        Camera frames in the order of time. The receivers of this package copy the pixels, so one array may be filled
        again for each frame, as OpenCV's ``read(image)`` does.
    signal, settings, observe
        The light's signal, the receiver's settings and an observer, as for `make_receiver`.

    Raises
    ------
    HeliographError
        At once: the arguments are no frames, settings or observer, or `make_receiver` refuses them. Later: the frames
        do not follow in time, or the camera's rate does not fit the light's.
    """
    if not isinstance(frames, Iterable):
        raise HeliographError(f"frames are an open film, or any iterable of heliograph.Frame, not {shown(frames)}")
    return _received(frames, make_receiver(signal, settings, observe))


def _received(frames: Iterable[Frame], receiver: Receiver) -> Iterator[Packet]:
    for frame in frames:
        yield from receiver.push(frame)
    yield from receiver.finish()


def _check_settings(settings: object) -> None:
    if not isinstance(settings, ReceiveSettings):
        raise SettingsError(
            f"settings of a receiver are ReceiveSettings, not {shown(settings)}; those of a link are .receive, and "
            f"ReceiveSettings(receiver='soft') chooses another one"
        )


def _ignore(event: Any, /) -> None:
    """Observe nothing."""
