"""Arrays told apart: each identity filmed, and what the receiver's detector takes it for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.channel import ImuTrace
from heliograph.channel.settings import ChannelSettings
from heliograph.experiments.candidates import same
from heliograph.experiments.clutter import Film, shoot
from heliograph.experiments.lamps import Backdrop
from heliograph.link.settings import load_settings
from heliograph.link.statistics import Count
from heliograph.receive.detect import Detection, Detector
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.header import IDENTITIES
from heliograph.signal.settings import SignalSettings

SMALLEST_PX = 5.0
"""Least side looked for: an array 150 m away has 6.2 px, less than the receiver's default of 8."""


@dataclass(frozen=True, slots=True)
class Confusion:
    """Films by identity shown (row) and found (column, the last: missed), (30, 31) counts."""

    counts: NDArray[np.int64]

    @property
    def right(self) -> Count:
        """Found as what they are, among all; the rest is missed or wrong."""
        return Count(int(self.counts.sum()), int(np.trace(self.counts)))

    @property
    def wrong(self) -> Count:
        """Taken for another, among those found."""
        found = int(self.counts[:, :-1].sum())
        return Count(found, found - int(np.trace(self.counts)))

    @property
    def missed(self) -> Count:
        """Not found, among all."""
        return Count(int(self.counts.sum()), int(self.counts[:, -1].sum()))


def confusion(
    distances: Sequence[float],
    scenes: Mapping[str, Backdrop],
    repeats: int,
    imu: ImuTrace | None,
    seed: int,
    done: Callable[[float], None],
    identities: Sequence[int] = range(IDENTITIES),
) -> dict[float, Confusion]:
    """Film every identity at every distance, the car at rest with its shake, before each scene in turn."""
    result, backs = {}, list(scenes.values())
    for place, distance in enumerate(distances):
        counts = np.zeros((IDENTITIES, IDENTITIES + 1), dtype=np.int64)
        for shown in identities:
            for repeat in range(repeats):
                rng = np.random.default_rng([seed, round(10 * distance), shown, repeat])
                stretch = backs[(shown + repeat) % len(backs)](rng)
                film = shoot(stretch, rng, imu, distance, "m_sequence", shown, small_camera())
                counts[shown, taken_for(film)] += 1
            done((place + (shown + 1) / IDENTITIES) / len(distances))
        result[distance] = Confusion(counts)
    return result


def small_camera() -> ChannelSettings:
    """The reference link at rest, with a part of its sensor about the array."""
    return load_settings("paper", {"channel": {"speed_m_s": 0.0, "camera": {"width": 256, "height": 192}}}).channel


def taken_for(film: Film) -> int:
    """Identity that the detector gives the film's array; 30 where it misses it."""
    assert film.truth is not None
    found = [one for one in detections(film, SMALLEST_PX) if same(one.fit.pose, film.truth)]
    return max(found, key=lambda one: one.score).identity if found else IDENTITIES


def detections(film: Film, smallest_px: float | None = None) -> list[Detection]:
    """What the receiver's detector, as it is set, finds in a film."""
    settings = ReceiveSettings()
    if smallest_px:
        settings = replace(settings, detect=replace(settings.detect, min_side_px=smallest_px))
    detector = Detector(settings, SignalSettings())
    return [one for frame in film.frames for one in detector.push(frame)]
