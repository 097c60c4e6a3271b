"""The receiver "oversampling": two frames for each pattern, and blind selection of the better phase."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.build import plain_receiver
from heliograph.receive.events import Observer
from heliograph.receive.geometry.window import common
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.frame_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True)
class SelectionParameters:
    """Parameters of the selection of a phase."""

    # Patterns before the first selection
    first_patterns: int = 8
    # Weight of the last pattern in the recent change
    rate: float = 0.05
    # Minimum ratio of the changes of both phases for another selection
    min_ratio: float = 1.2


PARAMETERS = SelectionParameters()


class OversamplingReceiver:
    """Receiver "oversampling": read the better of the two frames of each pattern.

    Super-Nyquist sampling, the reference of "Joint interframe separation and gamma correction for asynchronous optical
    camera communication systems based on high-order statistics" (Opt. Express 32(8), 14808, 2024): an unsynchronised
    camera takes two frames in T_b. With an exposure of T_b / 2 at most, the even or the odd frames fall within a
    pattern, and the others show a mixture of two patterns. A mixture changes less from pattern to pattern, so the
    selection takes the phase p with the larger

        E_p = mean over k of the sum over pixels of (r_(2 k + p) - r_(2 k + p - 2))^2.

    The paper refers to such methods without a rule of selection; the rule is ours. It compares whole frames, before any
    array is detected. A frame of T_b / 2 shows two of the four PWM slots, so with ``signal.modulation`` "haar" and
    ``signal.light`` "pwm" frames are summed in pairs, and the phase is off by a quarter of T_b at most.

    The receiver "plain" reads the selected frames. Frame numbers in packets and events count these frames. A drift of
    the phase changes the selection, which may cost a packet.
    """

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: Observer):
        self._receiver = plain_receiver(signal, settings, observe)
        self._period_s = signal.pattern_period_s
        self._is_summed = signal.modulation == "haar" and signal.light == "pwm"
        # the last camera frame, and by phase the last frame and the recent change
        self._before: Frame | None = None
        self._last: list[Frame | None] = [None, None]
        self._change = [0.0, 0.0]
        # frames before the first selection, the selected phase, the last selected frame, and the shift of its time
        self._held, self._phase = list[Frame](), -1
        self._selected: Frame | None = None
        self._index, self._shift_s = 0, 0.0

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes; see `Receiver`."""
        sample = self._sample(frame.copied())
        if sample is None:
            return
        self._measure(sample)
        if self._phase < 0:
            self._held.append(sample)
            if len(self._held) == 2 * PARAMETERS.first_patterns:
                yield from self._start()
        elif sample.index % 2 == self._phase:
            yield from self._select(sample)

    def finish(self) -> Iterator[Packet]:
        """End the film: yield the packets in progress; see `Receiver`."""
        yield from self._start()
        yield from self._receiver.finish()

    def _sample(self, frame: Frame) -> Frame | None:
        """Return the frame, or the sum with the frame before."""
        before, self._before = self._before, frame
        if not self._is_summed:
            return frame
        if before is None or before.index + 1 != frame.index:
            return None
        first, second = common([before, frame])
        # a sum has at most 16 bits
        pixels = (first.pixels.astype(np.uint32) + second.pixels) >> max(frame.bits - 15, 0)
        return replace(first, pixels=pixels.astype(np.uint16), bits=min(frame.bits + 1, 16))

    def _measure(self, sample: Frame) -> None:
        """Update the recent change of a phase."""
        phase = sample.index % 2
        last, self._last[phase] = self._last[phase], sample
        if last is not None:
            now, before = (part.pixels.astype(np.float32) for part in common([sample, last]))
            self._change[phase] += PARAMETERS.rate * (float(((now - before) ** 2).sum()) - self._change[phase])
        if self._phase >= 0 and self._change[1 - self._phase] > PARAMETERS.min_ratio * self._change[self._phase]:
            self._phase = 1 - self._phase

    def _start(self) -> Iterator[Packet]:
        """Select the first phase, and pass the frames so far on."""
        held, self._held = self._held, []
        if len(held) < 2:
            return
        check_rate("oversampling", "two frames per pattern", held, self._period_s, (2, 2))
        self._phase = int(self._change[1] > self._change[0])
        for sample in held:
            if sample.index % 2 == self._phase:
                yield from self._select(sample)

    def _select(self, sample: Frame) -> Iterator[Packet]:
        """Pass a frame on, with the number and the time of a camera that is synchronous with the light."""
        steps = 1
        if self._selected is not None:
            frames = sample.index - self._selected.index
            steps = max(frames // 2, 1)
            # after another selection half a step is a full step
            self._shift_s += (2 * steps - frames) * 0.5 * self._period_s
        self._selected, self._index = sample, self._index + steps
        yield from self._receiver.push(replace(sample, index=self._index, time_s=sample.time_s + self._shift_s))


def check_rate(name: str, needed: str, frames: list[Frame], period_s: float, limits: tuple[float, float]) -> float:
    """Return the frame period in seconds; raise a HeliographError unless the frames per pattern are within limits."""
    step_s = (frames[-1].time_s - frames[0].time_s) / (frames[-1].index - frames[0].index)
    per_pattern, (least, most) = period_s / step_s, limits
    if not least * (1 - STEP_TOLERANCE) < per_pattern < most * (1 + STEP_TOLERANCE):
        raise HeliographError(
            f"the {name} receiver needs {needed}: the film has {1 / step_s:.1f} frames/s, the light "
            f"{1 / period_s:.1f} patterns/s; record at {least / period_s:.1f} frames/s, or use --receiver soft"
        )
    return step_s
