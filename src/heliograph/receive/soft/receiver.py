"""The receiver "soft": as far as the channel allows."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.receive.packets import Observer, Packet, ignore
from heliograph.receive.reading import Reading
from heliograph.receive.receiver import Receiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.array import TimedArray
from heliograph.receive.soft.camera import CameraClock
from heliograph.receive.soft.memory import Memory
from heliograph.receive.soft.reading import SoftReading
from heliograph.receive.soft.search import Search
from heliograph.signal.settings import SignalSettings


class SoftReceiver(Receiver):
    """Detects and follows as the plain receiver does; equalises, cancels and decodes whole packets.

    It takes what `Receiver` takes.

    Raises
    ------
    SettingsError
        The light does not speak the hierarchical code, or its headers have no M-sequence.
    """

    array = TimedArray

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings | None = None, observe: Observer = ignore):
        if signal.modulation != "haar":
            raise SettingsError(
                f'the soft receiver reads signal.modulation = "haar", not "{signal.modulation}"; '
                f'set receive.receiver = "plain"'
            )
        if signal.header != "m_sequence":
            raise SettingsError(
                f'the soft receiver reads signal.header = "m_sequence", not "{signal.header}"; '
                f'set receive.receiver = "plain"'
            )
        settings = settings or ReceiveSettings(receiver="soft")
        soft = settings.soft
        detect = replace(settings.detect, min_side_px=soft.min_side_px, regularity=soft.regularity, impaired=True)
        super().__init__(signal, replace(settings, detect=detect), observe)
        self._camera = CameraClock()
        self._search = Search(self._setup.settings, signal)
        self._detector = self._search
        # by identity, not by array: one lost and found again goes on with its carousel
        self._memories: dict[int, Memory] = defaultdict(Memory)

    def _reading(self, identity: int) -> Reading:
        return SoftReading(identity, self._setup, self._memories[identity])

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes.

        Raises
        ------
        HeliographError
            The frame comes before the last one, or the camera is slower than the light.
        """
        yield from self._timed(self._camera.push(frame))

    def finish(self) -> Iterator[Packet]:
        """End of the film: yield the packets in progress of which enough was seen."""
        yield from self._timed(self._camera.flush())
        yield from super().finish()

    def _timed(self, frames: Iterator[Frame]) -> Iterator[Packet]:
        """Take frames whose times are known."""
        for frame in frames:
            if not self._search.started:
                self._search.start(self._camera.period_s)
            yield from super().push(frame)

    def _check(self, frame: Frame) -> None:
        """Any frame that the camera's clock has passed will do."""
