"""Acquisition of an array that is switched on.

An array 80 m away from a car at 30 km/h on a road of class B is switched on at a random time, at most 20 patterns
before a header. Each trial has a random road, noise, pixel phase and identity. The array is acquired when the soft
receiver tracks it with the correct identity and packet start, and missed if this fails until the end of the second
header. The simulation renders only windows around the array.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.experiments.links import receive_link
from heliograph.experiments.report import Context
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import random_messages
from heliograph.measure.statistics import Count
from heliograph.receive.api import make_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DetectEvent, Event, TrackEvent
from heliograph.signal.header import IDENTITIES


@dataclass(frozen=True, slots=True)
class AcquisitionTrial:
    """Acquisition trial."""

    seed: int
    # Most patterns between the switch-on and the header, fewer than in a packet
    within: int
    # Changes ``key=value`` of the preset "paper"
    changes: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Acquired:
    """Outcome of a trial."""

    # Headers until the detection, 1 or 2; 0: missed
    headers: int
    # Wrong detections before
    wrong: int


def measure(trials: Sequence[AcquisitionTrial], context: Context) -> list[Acquired]:
    """Run trials."""
    return context.each("acquisition", acquire, trials)


def acquire(trial: AcquisitionTrial) -> Acquired:
    """Simulate and receive until the detection of the array."""
    settings, first_s = _trial_settings(trial)
    detected: list[Detection] = []
    tracked: list[Detection] = []

    def observe(event: Event) -> None:
        if isinstance(event, DetectEvent):
            detected.append(event.detection)
        elif isinstance(event, TrackEvent):
            # a track follows the last detection
            tracked.extend(one for one in detected[-1:] if one.identity == event.identity and one not in tracked)

    signal, identity = settings.signal, settings.transmit.identities[0]
    receiver = make_receiver(signal, settings.receive, observe)
    for _, packets in receive_link(settings, random_messages(settings, trial.seed), trial.seed, receiver):
        for _ in packets:
            pass
        for detection in tracked:
            headers, rest = divmod((detection.start_time_s - first_s) / signal.packet_s + 0.5, 1.0)
            if detection.identity == identity and abs(rest - 0.5) * signal.packet_s < 0.5 * signal.pattern_period_s:
                return Acquired(int(headers) + 1, len(detected) - 1)
    return Acquired(0, len(detected))


def _trial_settings(trial: AcquisitionTrial) -> tuple[LinkSettings, float]:
    """Link of a trial, and the start of the first header in s."""
    rng = np.random.default_rng([trial.seed, 5])
    base = load_settings("paper", None, trial.changes)
    period, patterns = base.signal.pattern_period_s, base.signal.packet_patterns
    on_s = 0.006
    first = on_s + int(rng.integers(0, min(trial.within, patterns - 1) + 1)) * period
    pixel_m = base.channel.distance_m / base.channel.camera.focal_px
    x, y = np.array([1.5, -1.0]) + rng.uniform(-0.5, 0.5, 2) * pixel_m
    changes = (
        f"transmit.identities=[{rng.integers(IDENTITIES)}]",
        f"channel.arrays.0.x_m={x}",
        f"channel.arrays.0.y_m={y}",
        f"channel.arrays.0.start_s={first - patterns * period}",
        f"channel.arrays.0.off_s=[[-1.0, {on_s}]]",
        f"channel.duration_s={first + (patterns + 12) * period}",
    )
    return load_settings("paper", None, ["receive.receiver=soft", *trial.changes, *changes]), first


def outcomes_text(outcomes: Sequence[Acquired]) -> str:
    """Outcomes in a line, with the 95 % interval of the rate of missed arrays."""
    missed, first, second = (sum(outcome.headers == headers for outcome in outcomes) for headers in range(3))
    low, high = Count(len(outcomes), missed).interval()
    return (
        f"{len(outcomes)} trials: by the first header {first}, by the second {second}, missed "
        f"{missed} [{low:.1e}, {high:.1e}]; wrong detections {sum(outcome.wrong for outcome in outcomes)}"
    )
