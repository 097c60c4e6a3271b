"""Acquisition: how surely and how soon an array is found after it is switched on.

Each trial is a drive of the preset "paper" from its start, 80 m, with its own road, noise, place within a pixel and
identity. The camera runs before; the array is switched on at a random moment of its packet. It is acquired once the
receiver follows it with the right identity and the right start of the packet; missed if it does not by the end of the
second header. Only windows about the array are filmed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import random_messages, window_margin_px
from heliograph.measure.statistics import Count
from heliograph.receive import make_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DetectEvent, Event, TrackEvent
from heliograph.signal.header import IDENTITIES

ON_S = 0.006
"""Time in s that is filmed before the light comes on."""

WITHIN = 20
"""Most patterns before a header at which the array is switched on; 100: anywhere in the packet."""

QUICK_TRIALS, FULL_TRIALS = 10, 3000

TEXT = (
    "An array 80 m away, before a car at 30 km/h on a road of class B, is switched on at a random moment, at most "
    f"{WITHIN} patterns before a header. Each trial has its own road, noise, place within a pixel and identity. The "
    "array is acquired once the soft receiver follows it with the right identity and the right start of the packet."
)


@dataclass(frozen=True, slots=True)
class AcquisitionTrial:
    """A trial."""

    # Seed of everything that is random, 0 or more
    seed: int
    # Most patterns before a header at which the array is switched on, 0 or more; cut to one less than a packet has
    within: int
    # Texts ``key=value`` laid over the preset "paper"
    changes: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Acquired:
    """The outcome of a trial."""

    # Headers until the array was found, 1 or 2; 0: it was missed
    headers: int
    # Wrong detections on the way
    wrong: int


def measure(trials: Sequence[AcquisitionTrial], context: Context) -> list[Acquired]:
    """Outcomes of trials, in their order."""
    return context.each("acquisition", acquire, trials)


def acquire(trial: AcquisitionTrial) -> Acquired:
    """Film and receive until the array is found."""
    settings, first_s = _trial_settings(trial)
    detected: list[Detection] = []
    found: list[Detection] = []

    def watch(event: Event) -> None:
        if isinstance(event, DetectEvent):
            detected.append(event.detection)
        elif isinstance(event, TrackEvent):
            # the last one found is the one followed, as soon as its header is seen to be one
            found.extend(one for one in detected[-1:] if one.identity == event.identity and one not in found)

    receiver = make_receiver(settings.signal, settings.receive, watch)
    identity, period = settings.transmit.identities[0], settings.signal.pattern_period_s
    packet_s, messages = settings.signal.packet_s, random_messages(settings, trial.seed)
    for frame, _ in simulate(settings, messages, trial.seed, None, window_margin_px(settings)):
        for _ in receiver.push(frame):
            pass
        for one in found:
            headers, rest = divmod((one.start_time_s - first_s) / packet_s + 0.5, 1.0)
            if one.identity == identity and abs(rest - 0.5) * packet_s < 0.5 * period:
                return Acquired(int(headers) + 1, len(detected) - 1)
    return Acquired(0, len(detected))


def _trial_settings(trial: AcquisitionTrial) -> tuple[LinkSettings, float]:
    """The link of a trial, and the time in s at which its first header begins."""
    rng = np.random.default_rng([trial.seed, 5])
    base = load_settings("paper", None, trial.changes)
    period, patterns = base.signal.pattern_period_s, base.signal.packet_patterns
    lead = int(rng.integers(0, min(trial.within, patterns - 1) + 1))
    first = ON_S + lead * period
    pixel_m = base.channel.distance_m / base.channel.camera.focal_px
    x, y = np.array([1.5, -1.0]) + rng.uniform(-0.5, 0.5, 2) * pixel_m
    own = (
        f"transmit.identities=[{rng.integers(IDENTITIES)}]",
        f"channel.arrays.0.x_m={x}",
        f"channel.arrays.0.y_m={y}",
        f"channel.arrays.0.start_s={first - patterns * period}",
        f"channel.arrays.0.off_s=[[-1.0, {ON_S}]]",
        f"channel.duration_s={first + (patterns + 12) * period}",
    )
    return load_settings("paper", None, ["receive.receiver=soft", *trial.changes, *own]), first


def outcomes_text(outcomes: Sequence[Acquired]) -> str:
    """Outcomes in a line, with the 95 % interval of the rate of missed arrays."""
    by_header = [sum(one.headers == headers for one in outcomes) for headers in range(3)]
    low, high = Count(len(outcomes), by_header[0]).interval()
    return (
        f"{len(outcomes)} trials: by the first header {by_header[1]}, by the second {by_header[2]}, missed "
        f"{by_header[0]} [{low:.1e}, {high:.1e}]; wrong detections {sum(one.wrong for one in outcomes)}"
    )


def run(context: Context) -> ExperimentResult:
    """Switch an array on, again and again."""
    count = QUICK_TRIALS if context.quick else FULL_TRIALS
    outcomes = measure([AcquisitionTrial(context.seed + k, WITHIN) for k in range(count)], context)
    missed, wrong = sum(not one.headers for one in outcomes), sum(one.wrong for one in outcomes)
    names = ("by its first header", "by its second header")
    rows = [[name, str(sum(one.headers == k for one in outcomes))] for k, name in enumerate(names, 1)]
    return ExperimentResult(
        key="acquisition",
        title="Acquisition of an array that is switched on",
        text=TEXT,
        findings=[
            Finding(
                "Asked: an array is found by its next header.",
                f"{outcomes_text(outcomes)}.",
                "differs" if missed else "holds",
            )
        ],
        tables=[Table("Arrays found", ["found", "trials"], [*rows, ["missed", str(missed)]])],
        data={"trials": len(outcomes), "headers": [one.headers for one in outcomes], "wrong_detections": wrong},
    )
