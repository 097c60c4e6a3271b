"""Speed of writing and reading films: python benchmarks/media.py [--ffv1] [--frames 150] [--runs 3].

Noisy 1024x512 frames of 8 bits (noise of 1.5 gray levels rms over a real picture where the recordings are at hand).
Medians of the runs; each run also writes and reads a plain raw file, and the ratio is taken to that same run.
"""

import argparse
import functools
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from heliograph.base.frames import Frame, Pixels
from heliograph.media import create_film, open_film, video_write
from heliograph.media.record import FilmSpec
from heliograph.media.writer import ThreadedSink

WIDTH, HEIGHT, DIFFERENT = 1024, 512, 24
PICTURE = (
    Path(os.environ.get("HELIOGRAPH_DATA", Path(__file__).parents[2] / "shared" / "data")) / "driving/day-shade.mp4"
)
FILMS: dict[str, tuple[str, dict[str, Any]]] = {
    "FFV1 .mkv": (".mkv", {}),
    "FFV1 .nut": (".nut", {}),
    "FFV1 .nut 12 bits": (".nut", {"bits": 12}),
    "H.264 lossless .mp4": (".mp4", {"lossless": True}),
    "H.264 crf 12 .mp4": (".mp4", {}),
    "H.264 crf 18 .mp4": (".mp4", {"crf": 18.0}),
    "MJPEG .avi": (".avi", {}),
    "HDF5 .h5": (".h5", {}),
}
FFV1_CHOICES = [
    {"coder": coder, "context": context, "slices": slices, "slicecrc": crc}
    for coder, context, slices, crc in [
        ("0", "0", "4", "1"), ("0", "0", "6", "1"), ("0", "0", "9", "1"), ("0", "0", "16", "1"),
        ("0", "1", "6", "1"), ("1", "0", "6", "1"), ("1", "1", "6", "1"),
    ]
]  # fmt: skip


def noisy_frames(bits: int) -> list[Pixels]:
    """Return frames of uint8 or uint16; their noise grows with the scale."""
    rng, scale = np.random.default_rng(1), 1 << (bits - 8)
    if PICTURE.exists():
        with open_film(PICTURE) as film:
            picture = next(iter(film)).pixels[100 : 100 + HEIGHT, :WIDTH].astype(float)
    else:
        picture = np.add.outer(np.linspace(30, 120, HEIGHT), 40 * np.sin(np.linspace(0, 40, WIDTH)))
    noisy = [picture + rng.normal(0, 1.5, picture.shape) for _ in range(DIFFERENT)]
    levels = [np.clip(np.rint(p * scale), 0, 256 * scale - 1) for p in noisy]
    return [p.astype(np.uint8) for p in levels] if bits == 8 else [p.astype(np.uint16) for p in levels]


def film_frames(count: int, bits: int) -> Iterator[Frame]:
    pictures = noisy_frames(bits)
    return (Frame(n, n / 1000, pictures[n % DIFFERENT], bits) for n in range(count))


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def time_film(path: Path, count: int, options: dict[str, Any]) -> tuple[float, float, float]:
    """Return frames/s written, frames/s read and bytes a frame; finishing (fsync) counts as writing."""
    frames = list(film_frames(count, options.get("bits", 8)))

    def write() -> None:
        with create_film(path, width=WIDTH, height=HEIGHT, rate_hz=1000, **options) as film:
            for frame in frames:
                film.write(frame)

    def read() -> None:
        with open_film(path) as film:
            assert sum(1 for _ in film) == count

    return count / seconds(write), count / seconds(read), path.stat().st_size / count


def time_raw(path: Path, count: int) -> tuple[float, float, float]:
    frames = list(film_frames(count, 8))

    def write() -> None:
        with path.open("wb") as file:
            for frame in frames:
                file.write(frame.pixels.data)
            os.fsync(file.fileno())

    def read() -> None:
        with path.open("rb") as file:
            while np.fromfile(file, np.uint8, WIDTH * HEIGHT).size:
                pass

    return count / seconds(write), count / seconds(read), path.stat().st_size / count


def report(films: dict[str, tuple[str, dict[str, Any]]], count: int, runs: int, folder: Path) -> None:
    print(f"{'film':28s} {'write/s':>8s} {'read/s':>8s} {'kB/frame':>9s} {'of raw':>7s}  speed to raw (write, read)")
    raw_runs = [time_raw(folder / "film.raw", count) for _ in range(runs)]
    print_row("raw file", raw_runs, raw_runs)
    for name, (suffix, options) in films.items():
        raw_runs, timed = [], []
        for _ in range(runs):
            raw_runs.append(time_raw(folder / "film.raw", count))
            timed.append(time_film(folder / f"film{suffix}", count, options))
        print_row(name, timed, raw_runs)


def print_row(name: str, timed: list[tuple[float, float, float]], raw: list[tuple[float, float, float]]) -> None:
    write, read, size = (statistics.median(run[k] for run in timed) for k in range(3))
    ratios = [statistics.median(t[k] / r[k] for t, r in zip(timed, raw, strict=True)) for k in range(2)]
    share = size / (WIDTH * HEIGHT)
    print(
        f"{name:28s} {write:8.0f} {read:8.0f} {size / 1e3:9.1f} {share:7.0%}  {ratios[0]:.3f} {ratios[1]:.3f}",
        flush=True,
    )


def report_ffv1(count: int, runs: int, folder: Path) -> None:
    for choice in FFV1_CHOICES:
        timed = []
        coded = ("gray", {"level": "3", **choice})
        for _ in range(runs):
            with mock.patch.object(video_write, "_coding", lambda *_, coded=coded: coded):
                timed.append(time_film(folder / "film.mkv", count, {}))
        print_row(" ".join(f"{k}={v}" for k, v in choice.items()).replace("context", "ctx"), timed, timed)


def report_overlap(count: int, folder: Path) -> None:
    """Print how much the encoder's thread saves beside a renderer that needs 4 ms of one core a frame."""
    spec = FilmSpec(width=WIDTH, height=HEIGHT, rate_hz=1000)
    frames = list(film_frames(count, 8))

    def run(background: bool) -> None:
        path = folder / f"overlap{background}.nut"
        direct = video_write.VideoSink(path, path, spec, "ffv1")
        sink = ThreadedSink(direct) if background else direct
        for frame in frames:
            busy_until = time.perf_counter() + 0.004
            while time.perf_counter() < busy_until:
                np.sqrt(frame.pixels[:64], dtype=np.float32)
            sink.put(frame)
        sink.close()

    for background in (False, True):
        rate = count / seconds(functools.partial(run, background))
        print(f"rendering 4 ms a frame, FFV1 {'behind' if background else 'between'} it: {rate:.0f} frames/s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--ffv1", action="store_true", help="compare FFV1's options as well")
    choice = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        report(FILMS, choice.frames, choice.runs, Path(name))
        report_overlap(choice.frames, Path(name))
        if choice.ffv1:
            report_ffv1(choice.frames, choice.runs, Path(name))


if __name__ == "__main__":
    main()
