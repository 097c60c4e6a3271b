"""Whole frames of the paper's drive, 80 m to 25 m, from memory: `python -m benchmarks.drive FILM [--seconds 6.6]`.

FILM is simulated where it does not exist; the frames of the whole drive take 3.5 GB. Another link is given by
`--preset` and `--set`, another rate at which frames come by `--rate`.

First each receiver reads the drive on one core, everything included but the loading of machine code: medians of three
runs of processor time a frame, beside an inverse of 256 x 256 float32 and a Gaussian blur of the frame in the same run.
Then the frames come at a camera's rate, and packets are decoded beside following or not. A packet's delay is from the
time at which its last frame came to its bytes; a frame waits where the receiver is not done with those before it.

On a machine that others use too, these times say little. So the same is worked out from processor time: what each
frame took to follow, and each packet to hand over, to decode and to learn from, the least of three runs, as if two
cores did nothing else. Following waits where it asks for a result. `--cores` prints this alone.

The film begins with a header. A camera is switched on anywhere within a packet, so `--begin 0,5,40` prints the same of
films that lack so many frames, with the bound of a live camera's search.
"""

import argparse
import gc
import os
import pickle
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: algebra in one thread

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.media import create_film, open_film
from heliograph.receive import Packet, make_receiver
from heliograph.receive import build as assemblies
from heliograph.receive.decode.worker import PendingPacket

RUNS = 3
WARM_FRAMES = 330
"""Frames read before time is taken: three packets, so that all machine code is loaded."""


def film(path: Path, settings: LinkSettings, seconds: float) -> list[Frame]:
    """The drive's frames, those of the first seconds."""
    if not path.exists():
        camera = settings.channel.camera
        with create_film(
            path, width=camera.width, height=camera.height, rate_hz=1 / settings.signal.pattern_period_s
        ) as writer:
            for frame, _ in simulate(settings, default_messages(settings), 3):
                writer.write(frame)
    with open_film(path) as source:
        return [frame for frame in source if frame.time_s < seconds]


def link(settings: LinkSettings, receiver: str, beside: bool) -> LinkSettings:
    decode = replace(settings.receive.decode, in_background=beside)
    return replace(settings, receive=replace(settings.receive, receiver=receiver, decode=decode))


def read(settings: LinkSettings, frames: Sequence[Frame]) -> list[Packet]:
    receiver = make_receiver(settings.signal, settings.receive)
    packets = [packet for frame in frames for packet in receiver.push(frame)]
    return [*packets, *receiver.finish()]


def median_ms(work: Callable[[], object], runs: int = 40) -> float:
    """Median processor time of a call in ms."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return float(np.median(times)) * 1e3


def right(packets: Sequence[Packet]) -> str:
    counts = Counter(name for p in packets for name, by in p.layers.items() for word in by if word.status == "ok")
    return ", ".join(f"{name} {counts[name]}" for name in ("high", "middle", "low"))


def on_one_core(frames: Sequence[Frame], base: LinkSettings) -> None:
    matrix = np.random.default_rng(0).standard_normal((256, 512)).astype(np.float32)
    gram, image = matrix @ matrix.T, frames[0].pixels
    for receiver in ("soft", "plain"):
        settings, times, yard = link(base, receiver, False), [], []
        read(settings, frames[:WARM_FRAMES])
        packets: list[Packet] = []
        for _ in range(RUNS):
            yard.append((median_ms(lambda: np.linalg.inv(gram)), median_ms(lambda: cv2.GaussianBlur(image, (5, 5), 0))))
            gc.collect()
            start = time.process_time()
            packets = read(settings, frames)
            times.append((time.process_time() - start) / len(frames) * 1e3)
        inverse, blur = np.median(yard, axis=0)
        ms = float(np.median(times))
        print(
            f"{receiver:6} {ms:.3f} ms a frame ({min(times):.3f} to {max(times):.3f}), {ms / inverse:.2f} inverses of "
            f"{inverse:.2f} ms, {ms / blur:.2f} blurs of {blur:.3f} ms; right: {right(packets)}"
        )


def as_they_come(frames: Sequence[Frame], settings: LinkSettings, rate_hz: float) -> None:
    receiver, processes = (
        settings.receive.receiver,
        "two processes" if settings.receive.decode.in_background else "one process",
    )
    read(settings, frames[:WARM_FRAMES])
    one, delays, waits = make_receiver(settings.signal, settings.receive), list[float](), list[float]()
    gc.collect()
    gc.freeze()
    start, first = time.perf_counter() + 0.01, frames[0]
    due = [start + (frame.index - first.index) / rate_hz for frame in frames]
    for frame, at in zip(frames, due, strict=True):
        late = time.perf_counter() - at
        if late < 0:
            time.sleep(-late)
        waits.append(max(late, 0.0))
        for packet in one.push(frame):
            delays.append(time.perf_counter() - due[packet.last_frame - first.index])
    for packet in one.finish():
        delays.append(time.perf_counter() - due[packet.last_frame - first.index])
    wait, delay = np.array(waits) * 1e3, np.array(delays) * 1e3
    print(
        f"{receiver:6} at {rate_hz:g} frames/s, {processes}: delay in ms of {len(delay)} "
        f"packets {np.median(delay):.0f} in the middle, 90 % {np.quantile(delay, 0.9):.0f}, most {delay.max():.0f}; "
        f"frames waiting: 99 % {np.quantile(wait, 0.99):.0f}, most {wait.max():.0f}"
    )


@dataclass
class Step:
    """What one of the two processes did next.

    Attributes
    ----------
    kind
        "frame" where following takes the next one, "follow" what it does with it, "task" what it hands to the process
        that decodes, and "wait" where it asks for the result.
    number
        Of the frame or task.
    seconds
        Processor time.
    """

    kind: str
    number: int
    seconds: float = 0.0


class Stopwatch:
    """Times tracking, and the calls it submits, which run at once; it stands for `worker.ProcessExecutor`."""

    def __init__(self) -> None:
        self.steps, self.last_frames = list[Step](), dict[int, int]()
        self._tasks, self._since = 0, 0.0

    def frame(self, number: int) -> None:
        self.steps.append(Step("frame", number))
        self._since = time.process_time()

    def followed(self) -> None:
        self.steps.append(Step("follow", 0, time.process_time() - self._since))
        self._since = time.process_time()

    def submit(self, call: Callable[..., Any], /, *args: Any) -> "Result":
        handed, number, self._tasks = pickle.dumps((call, args), 5), self._tasks, self._tasks + 1
        self.followed()
        call, args = pickle.loads(handed)
        answer = pickle.dumps(call(*args), 5)
        self.steps.append(Step("task", number, time.process_time() - self._since))
        self._since = time.process_time()
        return Result(self, number, pickle.loads(answer))

    def asked(self, number: int) -> None:
        self.followed()
        self.steps.append(Step("wait", number))

    def read(self, frames: Sequence[Frame], settings: LinkSettings) -> None:
        made = PendingPacket.__init__

        def noted(packet: PendingPacket, seen: Packet, observations: Any, decoded: Result, *others: Any) -> None:
            self.last_frames[decoded.number] = seen.last_frame
            made(packet, seen, observations, decoded, *others)

        gc.collect()
        with (
            mock.patch.object(assemblies, "decode_executor", return_value=self.submit),
            mock.patch.object(PendingPacket, "__init__", noted),
        ):
            one = make_receiver(settings.signal, settings.receive)
            for frame in frames:
                self.frame(frame.index)
                list(one.push(frame))
                self.followed()


class Result(Future[Any]):
    """Tells when it is asked for; as it is never done before, that is only where following cannot do without it."""

    def __init__(self, watch: Stopwatch, number: int, answer: Any) -> None:
        super().__init__()
        self.number, self._watch, self._answer = number, watch, answer

    def done(self) -> bool:
        return False

    def result(self, timeout: float | None = None) -> Any:  # noqa: ARG002 - the base's
        self._watch.asked(self.number)
        return self._answer


@dataclass
class TwoCores:
    """What frames at a camera's rate come to if following and decoding have a core each.

    Attributes
    ----------
    delays_ms
        Of each packet, from its last frame to its bytes.
    waits_ms
        Of each frame, until it is taken.
    follow_ms, decode_ms
        Processor time of a frame, in the mean.
    """

    delays_ms: NDArray[np.float64]
    waits_ms: NDArray[np.float64]
    follow_ms: float
    decode_ms: float


def timed_on_two_cores(frames: Sequence[Frame], settings: LinkSettings, rate_hz: float) -> TwoCores:
    """Delays as if following and decoding had a core each, by the processor time of every step.

    Parameters
    ----------
    frames
        The film's.
    settings
        The link, whose receiver decodes beside following.
    rate_hz
        Rate in Hz at which frames come.
    """
    runs = [Stopwatch() for _ in range(RUNS)]
    for run in runs:
        run.read(frames, settings)
    seconds = np.min([[step.seconds for step in run.steps] for run in runs], axis=0)
    first, now, free, ends = frames[0].index, 0.0, 0.0, dict[int, float]()
    waits, spent = list[float](), Counter[str]()
    for step, took in zip(runs[0].steps, seconds, strict=True):
        spent[step.kind] += took
        if step.kind == "frame":
            waits.append(max(now - (step.number - first) / rate_hz, 0.0))
            now += max((step.number - first) / rate_hz - now, 0.0)
        elif step.kind == "follow":
            now += took
        elif step.kind == "task":
            ends[step.number] = free = max(free, now) + took
        else:
            now = max(now, ends[step.number])
    delays = [ends[task] - (last - first) / rate_hz for task, last in runs[0].last_frames.items()]
    follow, decode = (spent[kind] / len(frames) * 1e3 for kind in ("follow", "task"))
    return TwoCores(np.array(delays) * 1e3, np.array(waits) * 1e3, follow, decode)


def on_two_cores(frames: Sequence[Frame], settings: LinkSettings, rate_hz: float) -> None:
    """Print delays as if following and decoding had a core each."""
    settings = link(settings, settings.receive.receiver, True)
    read(link(settings, settings.receive.receiver, False), frames[:WARM_FRAMES])
    took = timed_on_two_cores(frames, settings, rate_hz)
    delay, wait = took.delays_ms, took.waits_ms
    print(
        f"{settings.receive.receiver:6} at {rate_hz:g} frames/s, a core each: "
        f"{took.follow_ms:.3f} ms a frame to follow, {took.decode_ms:.3f} to "
        f"decode; delay in ms of {len(delay)} packets {np.median(delay):.0f} in the middle, 90 % "
        f"{np.quantile(delay, 0.9):.0f}, most {delay.max():.0f}, the first {np.round(delay[:4]).astype(int).tolist()}; "
        f"frames waiting: 99 % {np.quantile(wait, 0.99):.0f}, most {wait.max():.0f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("film", type=Path)
    parser.add_argument("--seconds", type=float, default=6.6)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--set", action="append", default=[], dest="changes", metavar="KEY=VALUE")
    parser.add_argument("--cores", action="store_true")
    parser.add_argument("--rate", type=float, default=1000.0, help="frames a second")
    parser.add_argument(
        "--begin", default="", metavar="FRAME,...", help="frames left out at first; nothing else is printed"
    )
    asked = parser.parse_args()
    limit_threads()
    cv2.setNumThreads(1)
    settings = load_settings(asked.preset, None, asked.changes)
    frames = film(asked.film, settings, asked.seconds)
    for begin in [int(text) for text in asked.begin.split(",") if text]:
        live = replace(settings, receive=settings.receive.with_live_limits())
        for receiver in ("soft", "plain"):
            print(f"from frame {begin}:", end=" ")
            on_two_cores(frames[begin:], link(live, receiver, False), asked.rate)
    if asked.begin:
        return
    for receiver in ("soft", "plain"):
        on_two_cores(frames, link(settings, receiver, False), asked.rate)
    if asked.cores:
        return
    on_one_core(frames, settings)
    for receiver in ("soft", "plain"):
        for beside in (True, False):
            as_they_come(frames, link(settings, receiver, beside), asked.rate)


if __name__ == "__main__":
    main()
