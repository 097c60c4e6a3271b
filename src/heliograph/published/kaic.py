"""The receiver "kaic": blind separation of the patterns that overlap in the frames of an unsynchronised camera."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.published.oversampling import check_rate
from heliograph.receive.build import plain_receiver
from heliograph.receive.events import Observer
from heliograph.receive.geometry.window import common
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.combine import COVARIANCE, PAIR, slot_light
from heliograph.receive.sync.frame_clock import check_next, check_order
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True)
class SeparationParameters:
    """Parameters of the blind separation."""

    # Patterns per estimate of the phase
    block: int = 50
    # Patterns before and after a pattern whose light is separated
    reach: int = 4
    # Noise variance of a frame, relative to the variance of the light of an LED
    noise: float = 0.01
    # Assumed correlation of a pattern with 1 less the inverse: below 1, so that their sum is measured as well
    correlation: float = 0.95
    # Pixels with the largest variance, for the kurtosis
    pixels: int = 400
    # Step of the phases that an estimate compares, and largest change from block to block, in T_b
    step: float = 0.03125
    max_drift: float = 0.1
    # Maximum power of a pattern for the kurtosis, relative to the upper quartile: excludes headers of "haar"
    max_power: float = 2.0


PARAMETERS = SeparationParameters()

Slots = tuple[tuple[float, ...], ...]  # covariance of the slots of a pair, hashable
SAME_PATTERN = np.kron(np.eye(2), np.ones((SLOTS, SLOTS)))  # 1 for two slots of the same pattern of a pair


class SeparationReceiver:
    """Receiver "kaic": estimate by the kurtosis how patterns overlap in the frames, and separate the patterns.

    "Joint interframe separation and gamma correction for asynchronous optical camera communication systems based on
    high-order statistics" (Opt. Express 32(8), 14808, 2024) estimates the overlapping ratio e and the gamma of each
    frame by the kurtosis, without oversampling. Frame k of a camera with one frame per pattern shows

        r_k = (1 - e) p_k + e p_(k+1).

    Only the abstract is followed; the rest is ours. The light of independent LEDs is sub-Gaussian, and mixtures are
    closer to a Gaussian. The phase of a block of frames is therefore

        e = arg min over e of E[y_e^4] / E[y_e^2]^2

    over pixels and patterns, with the patterns y_e separated at this phase: the linear estimate of least mean square
    error in the frames around, with the slot statistics of the modulation and weights of sum 1. The same comparison
    decides which pattern begins a pair; the covariance of pattern and inverse then counts, too.
    The camera takes any number of frames from 1 per pattern on, exposed for ``receive.calibration.exposure_s`` or the
    frame period. Gray levels of `Frame` are linear in the light, so the receiver estimates no gamma.

    A pattern and the inverse cancel in a frame that shows half of both: with one frame per pattern, a phase near 1/2
    loses the header. PWM slots of "haar" do not mix linearly, which shifts the phase by up to a slot.

    The receiver "plain" reads the separated patterns. Frame numbers in packets and events count patterns.
    """

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: Observer):
        self._receiver = plain_receiver(signal, settings, observe)
        self._period_s, self._exposure_s = signal.pattern_period_s, settings.calibration.exposure_s
        self._slots = slot_covariance(signal)
        self._pairs = self._slots * np.where(SAME_PATTERN, 1, PARAMETERS.correlation)
        # frames for the next patterns, time of the first frame, and exposure in T_b; 0 before the first patterns
        self._frames, self._origin_s, self._exposure = list[Frame](), 0.0, 0.0
        # start of a pair in T_b, 0 to 2 after the first frame; number of its first pattern, and of the next pattern
        self._phase, self._number, self._next = 0.0, 2, 0

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes; see `Receiver`."""
        last = self._frames[-1] if self._frames else None
        check_next(frame, last)
        if last is not None:
            check_order(frame, last, by_index=True)
        self._frames.append(frame.copied())
        if frame.time_s - self._frames[0].time_s >= PARAMETERS.block * self._period_s:
            yield from self._separate(PARAMETERS.reach)

    def finish(self) -> Iterator[Packet]:
        """End the film: yield the packets in progress; see `Receiver`."""
        if len(self._frames) > 1:
            yield from self._separate(0)
        yield from self._receiver.finish()

    def _separate(self, margin: int) -> Iterator[Packet]:
        """Estimate the phase, and pass the patterns on, except a number of patterns before the last frame."""
        frames = self._frames
        is_first = not self._exposure
        if is_first:
            step_s = check_rate("kaic", "at least one frame per pattern", frames, self._period_s, (1, math.inf))
            self._origin_s, self._exposure = frames[0].time_s, min((self._exposure_s or step_s) / self._period_s, 1.0)
        starts = (np.array([frame.time_s for frame in frames]) - self._origin_s) / self._period_s
        if (is_first or starts[-1] - starts[0] > PARAMETERS.block / 2) and (samples := _changing_pixels(frames)).size:
            self._update_phase(starts, samples, is_first)
        starts -= self._phase
        for place, near, weights in separations(starts, self._exposure, self._pairs):
            number = self._number + place
            if number >= self._next and place <= starts[-1] - margin:
                self._next = number + 1
                yield from self._receiver.push(self._pattern(number, [frames[k] for k in near], weights))
        self._frames = [f for f, start in zip(frames, starts, strict=True) if start > starts[-1] - 2 * PARAMETERS.reach]

    def _update_phase(self, starts: Floats, samples: Floats, is_first: bool) -> None:
        """Estimate the phase without the pairs, and then which pattern begins a pair."""
        drift = PARAMETERS.max_drift
        grid = np.arange(0.0, 1.0, PARAMETERS.step) if is_first else np.arange(-drift, drift, PARAMETERS.step)
        phase = estimate_phase(starts, samples, self._exposure, self._slots * SAME_PATTERN, self._phase + grid)
        phase = estimate_phase(starts, samples, self._exposure, self._pairs, np.array([phase, phase + 1]))
        self._number += 0 if is_first else round(phase - self._phase)
        self._phase = phase

    def _pattern(self, number: int, frames: list[Frame], weights: Floats) -> Frame:
        """Separate a pattern as a 16-bit frame of a synchronous camera."""
        parts = common(frames)
        light = np.tensordot(weights / frames[0].full_scale, [part.pixels for part in parts], 1)
        pixels = np.rint(np.clip(light, 0, 1) * 65535).astype(np.uint16)
        return Frame(number, self._origin_s + number * self._period_s, pixels, 16, parts[0].origin)


def slot_covariance(signal: SignalSettings) -> Floats:
    """Return the covariance of the light of an LED in the slots of a pattern and the inverse, (8, 8)."""
    shown = slot_light(signal.slot_order)[0][PAIR : 2 * PAIR, 1]
    is_linear = signal.modulation == "ook" or signal.light == "steady"
    return np.asarray(shown @ (np.full((SLOTS, SLOTS), 1 / SLOTS**2) if is_linear else COVARIANCE) @ shown.T)


def estimate_phase(starts: Floats, samples: Floats, exposure: float, slots: Floats, phases: Floats) -> float:
    """Estimate the phase in T_b by the least kurtosis of the separated samples.

    `samples` is (frames, pixels); `starts` are the starts of the exposures in T_b.
    """
    kurtosis = []
    for phase in phases:
        light = np.array([weights @ samples[near] for _, near, weights in separations(starts - phase, exposure, slots)])
        light -= light.mean(0)
        power = (light**2).mean(1)
        typical = light[power <= PARAMETERS.max_power * np.quantile(power, 0.75)]
        kurtosis.append((typical**4).mean() / max(((typical**2).mean(0) ** 2).mean(), TINY))
    return float(phases[np.argmin(kurtosis)])


def separations(
    starts: Floats, exposure: float, slots: Floats
) -> Iterator[tuple[int, NDArray[np.intp], NDArray[np.float64]]]:
    """Yield the number, the frames and the weights of each pattern."""
    floors, covariance = np.floor(starts).astype(int), tuple(map(tuple, slots.tolist()))
    for number in np.union1d(floors, floors + 1).tolist():
        near = np.flatnonzero(np.abs(starts - number) < PARAMETERS.reach)
        times = tuple((starts[near] - number).round(2).tolist())
        weights = _weights(times, round(exposure, 2), number % 2, covariance)
        if weights is not None:
            yield number, near, weights


@lru_cache(maxsize=4096)
def _weights(starts: tuple[float, ...], exposure: float, is_inverse: int, slots: Slots) -> Floats | None:
    """Weights of frames for the light of the pattern from 0 to 1; None if the frames show less than half of it."""
    pairs = PARAMETERS.reach // 2 + 1
    edges = np.arange(-pairs * PAIR, pairs * PAIR + 1) / SLOTS - is_inverse
    begins, ends = np.array(starts)[:, None], np.array(starts)[:, None] + exposure
    shown = np.maximum(np.minimum(ends, edges[1:]) - np.maximum(begins, edges[:-1]), 0.0) * SLOTS
    pattern = (edges[:-1] >= 0) & (edges[:-1] < 1)
    if shown[:, pattern].sum() < SLOTS / 2:
        return None
    seen = shown @ np.kron(np.eye(2 * pairs), np.array(slots))
    # w = Q^-1 (c - mu 1), with the sum 1: the background counts once
    brightness = SLOTS * exposure  # of a frame with all LEDs on; of a pattern SLOTS
    matrix = seen @ shown.T / brightness**2 + PARAMETERS.noise / SLOTS**2 * np.eye(len(starts))
    sides = np.stack([seen[:, pattern].sum(1) / (brightness * SLOTS), np.ones(len(starts))], axis=1)
    a, b = np.linalg.solve(matrix, sides).T
    return np.asarray(a + b * (1 - a.sum()) / b.sum())


def _changing_pixels(frames: list[Frame]) -> Floats:
    """Return the pixels of the largest variance, (frames, pixels)."""
    parts = [part.pixels for part in common(frames)]
    total, squares = (np.zeros(parts[0].shape) for _ in range(2))
    for pixels in parts:
        total += pixels
        squares += np.square(pixels, dtype=np.float64)
    largest = np.argsort((squares - total**2 / len(parts)).ravel())[-PARAMETERS.pixels :]
    return np.stack([pixels.ravel()[largest] for pixels in parts]).astype(np.float64)
