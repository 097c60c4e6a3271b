"""All receivers by name. One algorithm has three entrances: the class, the generator below, and a list of it."""

from collections.abc import Callable, Iterable, Iterator, Mapping

from heliograph.base.frames import Frame
from heliograph.receive.packets import FrameReceiver, Observer, Packet, ignore
from heliograph.receive.receiver import Receiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings


def _soft() -> type[Receiver]:
    from heliograph.receive.soft.receiver import SoftReceiver  # SciPy and Numba are slow to import

    return SoftReceiver


RECEIVERS: Mapping[str, Callable[[], type[Receiver]]] = {"plain": lambda: Receiver, "soft": _soft}
"""Receivers by the name of the setting `receive.receiver`."""


def make_receiver(
    signal: SignalSettings, settings: ReceiveSettings | None = None, observe: Observer = ignore
) -> FrameReceiver:
    """Make the receiver that the settings name, before its first frame."""
    settings = settings or ReceiveSettings()
    return RECEIVERS[settings.receiver]()(signal, settings, observe)


def receive_frames(
    frames: Iterable[Frame],
    signal: SignalSettings,
    settings: ReceiveSettings | None = None,
    observe: Observer = ignore,
) -> Iterator[Packet]:
    """Packets of a stream of frames, each as soon as it is complete.

    Parameters
    ----------
    frames
        Camera frames in the order of time.
    signal, settings, observe
        See `Receiver`.

    Raises
    ------
    HeliographError
        The frames do not follow in time, or not in step with the light.
    """
    receiver = make_receiver(signal, settings, observe)
    for frame in frames:
        yield from receiver.push(frame)
    yield from receiver.finish()
