"""Receiver "auto": chooses a receiver by the first frames of a film."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from heliograph.base.frames import Frame
from heliograph.receive.events import ChooseEvent, Observer
from heliograph.receive.packet import Packet, Receiver
from heliograph.receive.registry import part_of
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.frame_clock import (
    FIRST_FRAMES,
    STEP_TOLERANCE,
    check_next,
    check_order,
    frame_period,
    owned,
)
from heliograph.signal.settings import SignalSettings

PHONE_RATE_HZ = 300.0
"""Frame rate up to which a camera slower than the light is taken for a phone that films a screen."""


def choose_receiver(signal: SignalSettings, period_s: float | None) -> tuple[str, str]:
    """Choose a receiver by the signal and the frame period, None if unknown; return the name and the reason."""
    for key, value, wanted in (("modulation", signal.modulation, "haar"), ("header", signal.header, "m_sequence")):
        if value != wanted:
            return "plain", f'only "plain" reads signal.{key} = "{value}"'
    if period_s is None:
        return "soft", "the film has too few frames for a frame rate"
    rates = f"{1 / period_s:.5g} frames/s, {1 / signal.pattern_period_s:.5g} patterns/s"
    if period_s <= (1 + STEP_TOLERANCE) * signal.pattern_period_s:
        return "soft", rates
    # "plain" reports a frame rate that no receiver for arrays can read
    return ("screen" if period_s * PHONE_RATE_HZ >= 1 else "plain"), rates


class AutoReceiver:
    """Receiver that makes another receiver after a few frames; see `packet.Receiver`."""

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: Observer):
        self._signal, self._settings, self._observe = signal, settings, observe
        self._held: list[Frame] = []
        self._chosen: Receiver | None = None

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes; see `Receiver`."""
        if self._chosen is not None:
            yield from self._chosen.push(frame)
            return
        last = self._held[-1] if self._held else None
        check_next(frame, last)
        if last is not None:
            check_order(frame, last)
        # the caller may fill the array again
        self._held.append(owned(frame))
        if len(self._held) == FIRST_FRAMES:
            yield from self._start()

    def finish(self) -> Iterator[Packet]:
        """End the film; see `Receiver`."""
        if self._chosen is None:
            yield from self._start()
        if self._chosen is not None:
            yield from self._chosen.finish()

    def _start(self) -> Iterator[Packet]:
        """Choose a receiver and hand over the held frames."""
        gaps = np.diff([frame.time_s for frame in self._held])
        name, reason = choose_receiver(self._signal, frame_period(gaps) if gaps.size else None)
        self._observe(ChooseEvent(name, reason))
        self._chosen = part_of(name).make(self._signal, replace(self._settings, receiver=name), self._observe)
        held, self._held = self._held, []
        for frame in held:
            yield from self._chosen.push(frame)
