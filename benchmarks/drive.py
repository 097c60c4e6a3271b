"""Whole frames of the paper's drive, 80 m to 25 m, from memory: `python -m benchmarks.drive FILM [--seconds 6.6]`.

FILM is simulated where it does not exist; the frames of the whole drive take 3.5 GB. Another link is given by
`--preset` and `--set`, another rate at which frames come by `--rate`.

First each receiver reads the drive on one core, everything included but the loading of machine code: medians of three
runs of processor time a frame, beside an inverse of 256 x 256 float32 and a Gaussian blur of the frame in the same run.
Then the frames come at a camera's rate, and packets are decoded beside following or not. A packet's delay is from the
time at which its last frame came to its bytes; a frame waits where the receiver is not done with those before it.

On a machine that others use too, these times say little. So the same is worked out from processor time: what each
frame took to follow, and each packet to hand over and to decode, the least of three runs, as if two cores did nothing
else. `--cores` prints this alone.
"""

import argparse
import gc
import os
import pickle
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from unittest import mock

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: algebra in one thread

import cv2
import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.media import create_film, open_film
from heliograph.receive import Packet, make_receiver
from heliograph.receive.coming import DecodedPacket, Work

RUNS = 3
WAITED_FOR = 1
"""First packets of an array that following waits for: it is then beyond doubt that it is there."""

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
    decode = replace(settings.receive.decode, beside=beside)
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
        "two processes" if settings.receive.decode.beside else "one process",
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


def on_two_cores(frames: Sequence[Frame], settings: LinkSettings, rate_hz: float) -> None:
    """Delays as if following and decoding had a core each, by the processor time of every frame and packet."""
    settings = link(settings, settings.receive.receiver, False)
    read(settings, frames[:WARM_FRAMES])
    follows, decodes = zip(*(processor_times(frames, settings) for _ in range(RUNS)), strict=True)
    follow, decode = np.min(follows, axis=0), np.min(decodes, axis=0)
    done = decoder = 0.0
    waits, delays = list[float](), list[float]()
    for k in range(len(frames)):
        waits.append(max(done - k / rate_hz, 0.0))
        done = max(done, k / rate_hz) + follow[k]
        if decode[k]:
            decoder = max(decoder, done) + decode[k]
            delays.append(decoder - k / rate_hz)
            done = decoder if len(delays) <= WAITED_FOR else done
    wait, delay = np.array(waits) * 1e3, np.array(delays) * 1e3
    settled = wait[(WAITED_FOR + 1) * WARM_FRAMES // 3 :].max(), delay[WAITED_FOR:].max()
    print(
        f"{settings.receive.receiver:6} at {rate_hz:g} frames/s, a core each: {follow.mean() * 1e3:.3f} ms a frame to "
        f"follow, {decode.mean() * 1e3:.3f} to decode; delay in ms of {len(delay)} packets {np.median(delay):.0f} in "
        f"the middle, 90 % {np.quantile(delay, 0.9):.0f}, most {delay.max():.0f}, {settled[1]:.0f} after the first "
        f"{WAITED_FOR}; frames waiting: 99 % {np.quantile(wait, 0.99):.0f}, most {wait.max():.0f}, {settled[0]:.0f} "
        f"after those",
        flush=True,
    )


def processor_times(frames: Sequence[Frame], settings: LinkSettings) -> tuple[list[float], list[float]]:
    """Processor time in s of each frame to follow and to hand packets over, and to decode the packets that it ends."""
    one, clock, decode = make_receiver(settings.signal, settings.receive), time.process_time, Work.__call__
    follows, decodes, took = list[float](), list[float](), list[float]()

    def decoded(work: Work) -> DecodedPacket:
        handed = pickle.dumps(work, 5)
        start = clock()
        result = decode(pickle.loads(handed))
        took.append(clock() - start)
        return result

    gc.collect()
    with mock.patch.object(Work, "__call__", decoded):
        for frame in frames:
            took.clear()
            start = clock()
            list(one.push(frame))
            decodes.append(sum(took))
            follows.append(clock() - start - decodes[-1])
    return follows, decodes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("film", type=Path)
    parser.add_argument("--seconds", type=float, default=6.6)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--set", action="append", default=[], dest="changes", metavar="KEY=VALUE")
    parser.add_argument("--cores", action="store_true")
    parser.add_argument("--rate", type=float, default=1000.0, help="frames a second")
    asked = parser.parse_args()
    limit_threads()
    cv2.setNumThreads(1)
    settings = load_settings(asked.preset, None, asked.changes)
    frames = film(asked.film, settings, asked.seconds)
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
