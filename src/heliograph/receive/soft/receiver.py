"""The receiver "soft": as far as the channel allows."""

from collections import defaultdict
from dataclasses import replace
from functools import partial

from heliograph.base.errors import SettingsError
from heliograph.receive.packets import Observer, ignore
from heliograph.receive.reading import MakeReading
from heliograph.receive.receiver import Receiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.memory import Memory
from heliograph.receive.soft.reading import SoftReading
from heliograph.signal.settings import SignalSettings


class SoftReceiver(Receiver):
    """Detects and follows as the plain receiver does; equalises, cancels and decodes whole packets.

    Parameters
    ----------
    signal
        What the light speaks.
    settings
        The receiver's settings.
    observe
        Gets (stage, data) of each stage.

    Raises
    ------
    SettingsError
        The light does not speak the hierarchical code.
    """

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings | None = None, observe: Observer = ignore):
        if signal.modulation != "haar":
            raise SettingsError(
                f'the soft receiver reads signal.modulation = "haar", not "{signal.modulation}"; '
                f'set receive.receiver = "plain"'
            )
        settings = settings or ReceiveSettings(receiver="soft")
        smallest = min(settings.detect.min_side_px, settings.soft.min_side_px)
        detect = replace(settings.detect, min_side_px=smallest, impaired=True)
        super().__init__(signal, replace(settings, detect=detect), observe)
        # by identity, not by array: one lost and found again goes on with its carousel
        self._memories: dict[int, Memory] = defaultdict(Memory)

    def _reading(self, identity: int) -> MakeReading:
        return partial(SoftReading, self._memories[identity])
