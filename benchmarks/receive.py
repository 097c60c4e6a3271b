"""Speed of the plain receiver on whole frames kept in memory, in processor time, beside filters of the same frame.

`python -m benchmarks.receive [CLIP ...]`: a drive past nothing is searched over each clip of a road too, as a film and
with the bound of a live camera.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, default_messages, load_footage, simulate
from heliograph.receive import Packet, ReceiveSettings
from heliograph.receive.build import plain_receiver, soft_receiver
from heliograph.receive.events import ignore
from heliograph.receive.receiver import StreamReceiver

RUNS = 5
FRAMES = 220
"""Two packets and a bit."""


def static(distance_m: float, background: str = "flat") -> LinkSettings:
    scene = {"distance_m": distance_m, "duration_s": FRAMES * 1e-3, "background": {"kind": background}}
    return load_settings("static", {"channel": scene})


def film(settings: LinkSettings, recordings: Recordings | None = None) -> list[Frame]:
    return [frame for frame, _ in simulate(settings, default_messages(settings), 1, recordings)]


def empty(background: str = "footage", clip: Path | None = None) -> list[Frame]:
    """A drive over a rough road past nothing, before what is drawn or a clip: the array is dark."""
    drive = {"speed_m_s": 8.33, "shake": "road", "road_class": "C", "stop_m": 1.0, "distance_m": 50.0}
    scene = {**drive, "duration_s": FRAMES * 1e-3, "background": {"kind": background}, "arrays": [{"start_s": 1e3}]}
    recordings = None if clip is None else Recordings(footage=load_footage(clip))
    return film(load_settings("static", {"channel": scene}), recordings)


def plain(live: bool = False) -> StreamReceiver:
    """The plain receiver of the reference link; its searches have the bound of a live camera or none."""
    settings = ReceiveSettings().with_live_limits() if live else ReceiveSettings()
    return plain_receiver(load_settings().signal, settings, ignore)


def rate(frames: Sequence[Frame], live: bool) -> tuple[float, list[Packet], int]:
    """Median frames/s over the runs, the packets read and the candidates fitted."""
    rates, packets, fitted = list[float](), list[Packet](), 0
    for _ in range(RUNS):
        receiver, packets = plain(live), []
        start = time.process_time()
        for frame in frames:
            packets += receiver.push(frame)
        rates.append(len(frames) / (time.process_time() - start))
        fitted = receiver.load.fitted
    return float(np.median(rates)), packets, fitted


def flickering(receiver: StreamReceiver) -> tuple[float, float]:
    """Processor time in ms a frame where all of it flickers in squares of 8 px: of 500 frames, and from 2000 on.

    In between hardly anything is searched, until half of what is kept for later has come together again.
    """
    levels = np.random.default_rng(1).integers(0, 256, (100, 64, 128), np.uint8)
    pixels = [np.kron(one, np.ones((8, 8), np.uint8)) for one in levels]
    times = [time.process_time()]
    for k in range(4000):
        list(receiver.push(Frame(k, k * 1e-3, pixels[k % len(pixels)])))
        times.append(time.process_time())
    return (times[500] - times[0]) / 500 * 1e3, (times[-1] - times[2000]) / 2000 * 1e3


def following_rate(frames: Sequence[Frame]) -> float:
    """Frames/s without the search: what following and decoding alone take."""
    signal, settings = load_settings().signal, ReceiveSettings()
    receiver, rates = plain_receiver(signal, settings, ignore), list[float]()
    for frame in frames[:20]:
        list(receiver.push(frame))
    # the array is detected
    receiver.search.search = lambda *_: []  # type: ignore[method-assign]  # a search cannot be switched off
    period = round(frames[-1].index / 100) * 100
    for run in range(RUNS):
        part = [replace(f, index=f.index + run * period, time_s=f.time_s + run * period * 1e-3) for f in frames]
        part = part[20 if not run else len(frames) - period : len(frames)]
        start = time.process_time()
        for frame in part:
            list(receiver.push(frame))
        rates.append(len(part) / (time.process_time() - start))
    return float(np.median(rates))


def plain_ms(work: Callable[[], object]) -> float:
    """Median time of a call in ms."""
    times = []
    for _ in range(200):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return float(np.median(times)) * 1e3


def baselines(frames: Sequence[Frame]) -> tuple[float, float]:
    """Times in ms of a difference and of a filter of whole frames, in buffers kept."""
    a, b, out = frames[0].pixels, frames[1].pixels, np.empty_like(frames[0].pixels)
    return plain_ms(lambda: cv2.absdiff(a, b, out)), plain_ms(lambda: cv2.GaussianBlur(a, (5, 5), 0, out))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", type=Path)
    clips: list[Path] = parser.parse_args().clips
    cv2.setNumThreads(1)
    near = film(static(30.0))
    list(plain().push(near[0]))
    difference, blur = baselines(near)
    height, width = near[0].pixels.shape
    print(f"frames of {width} x {height}, medians of {RUNS} runs, one thread")
    print(f"{'cv2.absdiff':36} {difference:8.3f} ms")
    print(f"{'cv2.GaussianBlur 5x5':36} {blur:8.3f} ms")
    cases = (
        ("following an array at 50 m", film(static(50.0))),
        ("following an array at 30 m", near),
        ("following, drawn scene, 50 m", film(static(50.0, "synthetic"))),
        ("searching, flat", empty("flat")),
        ("searching, drawn scene shaken", empty("synthetic")),
        *((f"searching, {clip.stem}", empty(clip=clip)) for clip in clips),
    )
    bounded = [(f"{name}, live", frames, True) for name, frames in cases if name.startswith("searching")]
    for name, frames, live in (*((*one, False) for one in cases), *bounded):
        per_s, packets, fitted = rate(frames, live)
        ms = 1e3 / per_s
        read = sum(p.status == "ok" for p in packets)
        ratios = f"{ms / difference:6.1f} absdiffs {ms / blur:5.1f} blurs"
        print(f"{name:36} {ms:8.3f} ms {per_s:7.0f} frames/s {ratios}  {read} packets, {fitted} candidates fitted")
    for name, frames in cases[:2]:
        per_s = following_rate(frames)
        print(f"{name + ', no search':36} {1e3 / per_s:8.3f} ms {per_s:7.0f} frames/s")
    for name, make in (("plain", plain_receiver), ("soft", soft_receiver)):
        receiver = make(load_settings().signal, ReceiveSettings().with_live_limits(), ignore)
        first, then = flickering(receiver)
        told = f"{first:.2f} ms a frame of 500, {then:.2f} ms from 2000 on; {receiver.load}"
        print(f"searching what flickers all over, {name}: {told}")


if __name__ == "__main__":
    main()
