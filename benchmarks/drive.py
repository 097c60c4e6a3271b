"""Receiver speed on the paper's drive, 80 m to 25 m: `python -m benchmarks.drive FILM [--seconds 6.6]`.

The benchmark simulates FILM if the file does not exist. Full-size frames for the complete drive need 3.5 GB of
memory. --preset and --set select another link, --rate another frame rate.

The first part measures processor time per frame on one core, compilation excluded: the median over three runs for
each receiver, with two yardsticks from the same run (inverse of 256 x 256 float32, Gaussian blur of the frame). The
second part delivers frames at camera rate and decodes packets in the same or a second process. It reports packet
delay, from the last frame to the decoded bytes, and the waiting time for frames while the receiver is busy.
"""

import argparse
import gc
import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before importing NumPy: single-threaded BLAS

import cv2
import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.media import create_film, open_film
from heliograph.receive.api import make_receiver
from heliograph.receive.packet import Packet

RUNS = 3
WARM_FRAMES = 330
"""Warm-up frames, three packets, to load compiled code."""


def film(path: Path, settings: LinkSettings, seconds: float) -> list[Frame]:
    """Return frames from the first seconds of the drive."""
    if not path.exists():
        camera = settings.channel.camera
        with create_film(
            path, width=camera.width, height=camera.height, rate_hz=1 / settings.signal.pattern_period_s
        ) as writer:
            for frame, _ in simulate(settings, default_messages(settings), 3):
                writer.write(frame)
    with open_film(path) as source:
        return [frame for frame in source if frame.time_s < seconds]


def link(settings: LinkSettings, receiver: str, in_background: bool) -> LinkSettings:
    decode = replace(settings.receive.decode, in_background=in_background)
    return replace(settings, receive=replace(settings.receive, receiver=receiver, decode=decode))


def read(settings: LinkSettings, frames: Sequence[Frame]) -> list[Packet]:
    receiver = make_receiver(settings.signal, settings.receive)
    packets = [packet for frame in frames for packet in receiver.push(frame)]
    return [*packets, *receiver.finish()]


def median_ms(work: Callable[[], object], runs: int = 40) -> float:
    """Return the median processor time per call in ms."""
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("film", type=Path)
    parser.add_argument("--seconds", type=float, default=6.6)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--set", action="append", default=[], dest="changes", metavar="KEY=VALUE")
    parser.add_argument("--rate", type=float, default=1000.0, help="frames a second")
    given = parser.parse_args()
    limit_threads()
    cv2.setNumThreads(1)
    settings = load_settings(given.preset, None, given.changes)
    frames = film(given.film, settings, given.seconds)
    on_one_core(frames, settings)
    for receiver in ("soft", "plain"):
        for in_background in (True, False):
            as_they_come(frames, link(settings, receiver, in_background), given.rate)


if __name__ == "__main__":
    main()
