"""Receivers by name, with three entry points: a class with `push`, a generator, and a list of the generator."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from heliograph.base.config import from_mapping
from heliograph.base.errors import HeliographError, SettingsError, shown
from heliograph.base.frames import Frame
from heliograph.receive.packet import Packet, Receiver
from heliograph.receive.registry import GROUPS, RECEIVERS, ReceiverPart, is_bound, part_of
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings, check_signal

AnyObserver = Callable[[Any], None]  # an observer of any receiver's events; see `heliograph.receive.events.Event`

MakeReceiver = Callable[[SignalSettings, ReceiveSettings, AnyObserver], Receiver]
"""Makes a receiver from the light's signal, the settings and an observer."""


def register_receiver(name: str, make: MakeReceiver, settings: type | None = None, reads: Iterable[str] = ()) -> None:
    """Register a receiver.

    The setting ``receive.receiver`` then selects the receiver by name: on the command line, in sweeps, in plots. A
    package can also offer a receiver by an entry point of the group "heliograph.receivers", a `ReceiverPart` or a
    function like `make`.

    Parameters
    ----------
    name
        Name of the receiver: letters, digits, "-", "_" and ".".
    make
        Function of the light's signal, the receiver's settings and an observer that returns a `Receiver`; a class with
        such a constructor is fine.
    settings
        Frozen dataclass of settings, made from ``receive.custom``; the receiver gets them by
        ``own_settings(receive_settings)``.
    reads
        Other groups of ``receive`` that the receiver reads: "calibration", "detect", "track", "decode". A setting of
        another group is an error.

    Raises
    ------
    SettingsError
        The name is invalid or taken by the package, `make` is no function, or a group is unknown.
    """
    groups = tuple(reads)
    if unknown := [group for group in groups if group not in GROUPS]:
        raise SettingsError(f"a receiver reads groups of {', '.join(GROUPS)}, not {', '.join(unknown)}")
    RECEIVERS.register(name, ReceiverPart(make, settings, groups), make)


def list_receivers() -> list[str]:
    """Return the names of all receivers, those of the package first."""
    return RECEIVERS.names()


def choose_receiver(signal: SignalSettings, rate_hz: float) -> tuple[str, str]:
    """Choose a receiver for a film.

    Parameters
    ----------
    signal
        Settings of the light's signal.
    rate_hz
        Frames per second of the film.

    Returns
    -------
    Name of the receiver, and the reason.
    """
    for key, value, wanted in (("modulation", signal.modulation, "haar"), ("header", signal.header, "m_sequence")):
        if value != wanted:
            return "plain", f'the only receiver for signal.{key} = "{value}"'
    rates = f"{rate_hz:.5g} frames/s, {1 / signal.pattern_period_s:.5g} patterns/s"
    if rate_hz * signal.pattern_period_s >= 1 - STEP_TOLERANCE:
        return "soft", rates
    # phones film up to 240 frames/s; "plain" reports a rate that no receiver for arrays can read
    return ("screen" if rate_hz <= 300 else "plain"), rates


def own_settings(settings: ReceiveSettings) -> Any:
    """Settings of a registered receiver, an object of the registered class; None without a class.

    Parameters
    ----------
    settings
        Settings with the receiver's name, and the settings in ``custom``.

    Raises
    ------
    SettingsError
        A key of ``receive.custom`` is unknown, or a value out of range; or the settings are no `ReceiveSettings`.
    """
    _check_settings(settings)
    kind = part_of(settings.receiver).settings
    return None if kind is None else from_mapping(kind, settings.custom)


def make_receiver(
    signal: SignalSettings,
    settings: ReceiveSettings | None = None,
    observe: AnyObserver | None = None,
    truth: object = None,
) -> Receiver:
    """Make the receiver that the settings name.

    Use a receiver in a single thread at a time. Receivers in several threads share no mutable state; settings, frames
    and packets may be shared. While a receiver processes a frame, BLAS has a single thread in the process.

    Parameters
    ----------
    signal
        Settings of the light's signal, equal at both ends.
    settings
        Settings of the receiver; None for "plain" with all defaults.
    observe
        Observer of the events, see `heliograph.receive.events`; None for no observer.
    truth
        True channel of a simulation, for the receivers "genie-zero-forcing" and "genie-mmse" alone: no other receiver
        gets it.

    Raises
    ------
    SettingsError
        The receiver is unknown, or cannot read this signal; an argument is no settings or observer; or the truth is
        missing.
    """
    check_signal(signal)
    settings = ReceiveSettings() if settings is None else settings
    _check_settings(settings)
    observe = (lambda _: None) if observe is None else observe
    if not callable(observe):
        raise SettingsError(f"an observer is a function that takes an event, not {shown(observe)}")
    name = settings.receiver
    if not is_bound(name):
        return part_of(name).make(signal, settings, observe)
    if truth is None:
        raise SettingsError(
            f"the receiver {name} needs the true channel of a simulation, which a film lacks: compare it by "
            f"'heliograph benchmark --receiver {name}', or choose another receiver"
        )
    return part_of(name).make(signal, settings, observe, truth)


def receive_frames(
    frames: Iterable[Frame],
    signal: SignalSettings,
    settings: ReceiveSettings | None = None,
    observe: AnyObserver | None = None,
) -> Iterator[Packet]:
    """Receive a stream of frames: yield each packet as soon as it is complete.

    Parameters
    ----------
    frames
        Camera frames in the order of time. The receivers of this package copy pixels that are not read-only, so the
        caller may fill the same array again for each frame, as OpenCV's ``read(image)`` does.
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
