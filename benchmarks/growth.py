"""What a frame costs as work grows: `python -m benchmarks.growth [size|arrays|side|distance|length|workers ...]`.

One thing grows at a time, from the static link: the frame, the arrays in view, their LEDs, their distance, or the film.
Each case is a process of its own, on one core. Prints a table in Markdown for each receiver: ms of processor time a
frame, codewords right of those sent, and memory beyond that of the film and of a process that has received nothing.
Below it stands the exponent: the slope of ln ms over ln of what grows. First come yardsticks of the same run.

"workers" is another table: seconds that a sweep takes with one and two of them, starting them included.
"""

import argparse
import multiprocessing
import os
import resource
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: algebra in one thread, in the processes of cases too

import cv2
import numpy as np

from benchmarks.near import DATA_PAIRS
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import block_settings, random_messages
from heliograph.receive import make_receiver
from heliograph.sweeps.sweep import sweep

RUNS = 3
PACKETS = 6
"""Packets of a film: an array is acquired in the first, and its LEDs are learnt in the first two."""

MANY_ROUNDS = 100
"""Rounds of a film from which on it is received once: that takes minutes."""

SWEPT_M, SWEPT_WORDS = (40.0, 55.0, 70.0, 85.0), (12, 100)
"""Distances in m and codewords of each in the sweep that workers share."""

APART_M = 0.6
"""Distance of neighbouring arrays, nearly two of their sides."""


@dataclass(frozen=True)
class Case:
    """A film.

    Attributes
    ----------
    size
        What grows, as a number.
    name
        The same in words.
    changes
        Settings that differ from those of the static link.
    packets
        Packets in the film.
    rounds
        Times that its frames come one after the other, as one longer film that is streamed.
    """

    size: float
    name: str
    changes: Sequence[str]
    packets: int = PACKETS
    rounds: int = 1


def sizes() -> list[Case]:
    """Frames of more and more pixels about one array."""
    shapes = ((256, 256), (512, 512), (1024, 512), (1024, 1024), (2048, 1024))
    middle = ("channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0")
    return [
        Case(w * h, f"{w} x {h}", (f"channel.camera.width={w}", f"channel.camera.height={h}", *middle))
        for w, h in shapes
    ]


def arrays() -> list[Case]:
    """More and more arrays side by side; with none the array is dark."""
    cases = []
    for count in (0, 1, 2, 4, 6, 8, 16):
        places = [f"{{x_m={APART_M * (k - (count - 1) / 2):.2f}, y_m=0}}" for k in range(count)]
        identities = ",".join(map(str, range(count)))
        lit = (f"transmit.identities=[{identities}]", f"channel.arrays=[{','.join(places)}]")
        cases.append(Case(count, f"{count}", lit if count else ("channel.arrays.0.brightness=0",)))
    return cases


def sides() -> list[Case]:
    """More and more LEDs in a row."""
    return [
        Case(n, f"{n} x {n}", (f"signal.side={n}", f"signal.data_pairs={pairs}", "channel.distance_m=25"))
        for n, pairs in DATA_PAIRS.items()
    ]


def distances() -> list[Case]:
    """Farther and farther away."""
    return [Case(z, f"{z} m", (f"channel.distance_m={z}",)) for z in (15, 25, 40, 60, 80, 110, 150)]


def lengths() -> list[Case]:
    """Longer and longer films, streamed."""
    return [Case(count, f"{count * PACKETS / 10:g} s", (), PACKETS, count) for count in (1, 5, 25, 125, 1000)]


AXES: Mapping[str, tuple[str, list[Case]]] = {
    "size": ("frame", sizes()),
    "arrays": ("arrays", arrays()),
    "side": ("LEDs", sides()),
    "distance": ("distance", distances()),
    "length": ("film", lengths()),
}


def measure(case: Case, receiver: str, seed: int) -> tuple[float, int, int, float]:
    """Median ms a frame, codewords right and sent, and memory in MB that receiving takes.

    Parameters
    ----------
    case
        The film.
    receiver
        Name of the receiver.
    seed
        Of messages and noise.
    """
    limit_threads()
    cv2.setNumThreads(1)
    changes = ("channel.distance_m=60", f"receive.receiver={receiver}", *case.changes)
    settings = block_settings(load_settings("static", None, changes), case.packets)
    film = [frame for frame, _ in simulate(settings, random_messages(settings, seed), seed)]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    times, right = list[float](), right_words(settings, film)  # loads the machine code
    for _ in range(RUNS if case.rounds < MANY_ROUNDS else 1):
        start = time.process_time()
        right = right_words(settings, streamed(film, case.rounds, settings.signal.pattern_period_s))
        times.append(time.process_time() - start)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    sent = 4 * case.packets * case.rounds * sum(array.brightness > 0 for array in settings.channel.arrays)
    return 1e3 * statistics.median(times) / len(film) / case.rounds, right, sent, grown / 1e3


def streamed(film: Sequence[Frame], rounds: int, period_s: float) -> Iterator[Frame]:
    """Frames that come again and again, their numbers and times going on."""
    for k in range(rounds):
        past = k * len(film)
        for frame in film:
            yield replace(frame, index=frame.index + past, time_s=frame.time_s + past * period_s)


def right_words(settings: LinkSettings, frames: Iterable[Frame]) -> int:
    """Codewords read in frames, none of which is kept."""
    receiver = make_receiver(settings.signal, settings.receive)
    packets = chain((packet for frame in frames for packet in receiver.push(frame)), receiver.finish())
    return sum(word.status == "ok" for packet in packets for by in packet.layers.values() for word in by)


def workers(seed: int) -> None:
    """Print how long a sweep takes with one worker and with two.

    Parameters
    ----------
    seed
        Of the sweep.
    """
    print("\n| packets of each of four points | one worker, s | two workers, s | ratio |\n|---|---|---|---|")
    for words in SWEPT_WORDS:
        seconds = []
        for count in (1, 2):
            times = []
            for _ in range(RUNS):
                start = time.perf_counter()
                sweep({"channel.distance_m": SWEPT_M}, workers=count, seed=seed, max_codewords=words, min_errors=1000)
                times.append(time.perf_counter() - start)
            seconds.append(statistics.median(times))
        print(f"| {words} | {seconds[0]:.1f} | {seconds[1]:.1f} | {seconds[1] / seconds[0]:.2f} |", flush=True)


def yardsticks() -> dict[str, float]:
    """Median times in ms of reading a frame once and of solving for its symbols once."""
    rng = np.random.default_rng(0)
    one, other = rng.integers(0, 256, (2, 512, 1024), np.uint8)
    out, matrix = np.empty_like(one), rng.normal(size=(256, 256)).astype(np.float32)
    calls: dict[str, Callable[[], object]] = {
        "difference of two frames of 1024 x 512": lambda: cv2.absdiff(one, other, out),
        "blur 5 x 5 of one": lambda: cv2.GaussianBlur(one, (5, 5), 0, out),
        "inverse of 256 x 256": lambda: np.linalg.inv(matrix),
    }
    found = {}
    for name, call in calls.items():
        times = []
        for _ in range(50):
            start = time.process_time()
            call()
            times.append(time.process_time() - start)
        found[name] = 1e3 * statistics.median(times)
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("axes", nargs="*", choices=[[], *AXES, "workers"], default=[])
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    limit_threads()
    cv2.setNumThreads(1)
    print("; ".join(f"{name}: {ms:.3f} ms" for name, ms in yardsticks().items()), flush=True)
    asked = given.axes or [*AXES, "workers"]
    for axis in (one for one in asked if one in AXES):
        title, cases = AXES[axis]
        for receiver in ("plain", "soft"):
            print(f'\n| {title} | "{receiver}", ms a frame | frames/s | codewords right | memory, MB |')
            print("|---|---|---|---|---|")
            points = []
            for case in cases:
                # a process of its own: the most memory of a process never falls
                with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                    ms, right, sent, memory = pool.submit(measure, case, receiver, given.seed).result()
                points.append((case.size, ms))
                print(f"| {case.name} | {ms:.2f} | {1e3 / ms:.0f} | {right}/{sent} | {memory:.0f} |", flush=True)
            x, y = np.log(np.array([point for point in points if point[0] > 0])).T
            print(f"\nexponent {np.polyfit(x, y, 1)[0]:.2f}", flush=True)
    if "workers" in asked:
        workers(given.seed)


if __name__ == "__main__":
    main()
