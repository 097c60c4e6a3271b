"""What reading a film costs by its kind, alone and in a reception: python -m benchmarks.reading.

Films of one array at rest 60 m away, 1024 x 512, 8 bits or where it is said more, one after the other in each run.
A cold film's pages are given back to the system first, where that takes such advice.
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: one core, and no threads that wait for each other

import cv2
import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.media import create_film, open_film
from heliograph.receive import make_receiver

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from made_recordings import write_cine, write_mraw

RATE_HZ = 1000.0

Cost = tuple[float, float]
"""Time of this process and of the clock on the wall, both in ms a frame."""


def written(folder: Path, frames: list[Frame]) -> dict[str, Path]:
    """The film in each kind."""
    kinds: dict[str, tuple[str, dict[str, Any]]] = {
        "HDF5 .h5": ("a.h5", {}),
        "FFV1 .mkv": ("a.mkv", {}),
        "H.264 lossless .mp4": ("a.mp4", {"lossless": True}),
        "H.264 crf 12 .mp4": ("b.mp4", {}),
    }
    rows, columns = frames[0].pixels.shape
    for name, options in kinds.values():
        with create_film(folder / name, width=columns, height=rows, rate_hz=RATE_HZ, **options) as film:
            for frame in frames:
                film.write(frame)
    paths = {kind: folder / name for kind, (name, _) in kinds.items()}
    levels = [frame.pixels for frame in frames]
    np.save(folder / "a.npy", np.stack(levels))
    assert cv2.imwritemulti(str(folder / "a.tif"), levels, [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    assert cv2.imwritemulti(str(folder / "b.tif"), levels)
    stack = np.stack(levels)
    write_mraw(folder / "a.mraw", stack, 8, 8)
    write_mraw(folder / "b.mraw", stack.astype(np.uint16) << 4, 12, 12)
    write_cine(folder / "a.cine", levels, 8, 8)
    write_cine(folder / "b.cine", [one.astype(np.uint16) << 2 for one in levels], 10, 10)
    for suffix in ("png", "jpg"):
        (folder / suffix).mkdir()
        for number, picture in enumerate(levels):
            assert cv2.imwrite(str(folder / suffix / f"{number:04d}.{suffix}"), picture)
    return paths | {
        "Photron .mraw, 8 bits": folder / "a.mraw", "Photron .mraw, 12 bits packed": folder / "b.mraw",
        "Phantom .cine, 8 bits": folder / "a.cine", "Phantom .cine, 10 bits packed": folder / "b.cine",
        ".npy": folder / "a.npy", "TIFF, not packed": folder / "a.tif", "TIFF, packed by LZW": folder / "b.tif",
        "folder of PNG": folder / "png", "folder of JPEG": folder / "jpg",
    }  # fmt: skip


def forget(path: Path) -> None:
    """Give a film's pages back to the system."""
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        handle = os.open(file, os.O_RDONLY)
        os.fsync(handle)
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
        os.close(handle)


def cost(work: Callable[[Path], int], path: Path) -> Cost:
    """What a film's frames cost each."""
    start, wall = time.process_time(), time.perf_counter()
    count = work(path)
    return 1e3 * (time.process_time() - start) / count, 1e3 * (time.perf_counter() - wall) / count


def read(path: Path) -> int:
    """Read a film, and nothing else."""
    with open_film(path, rate_hz=RATE_HZ) as film:
        return sum(1 for _ in film)


def read_cold(path: Path) -> int:
    """Read a film that is no longer in memory."""
    forget(path)
    return read(path)


def receiving(settings: LinkSettings) -> Callable[[Path], int]:
    """What receives a film."""

    def receive(path: Path) -> int:
        receiver = make_receiver(settings.signal, settings.receive)
        count, packets = 0, 0
        with open_film(path, rate_hz=RATE_HZ) as film:
            for frame in film:
                packets += len(list(receiver.push(frame)))
                count += 1
        packets += len(list(receiver.finish()))
        assert packets
        return count

    return receive


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--runs", type=int, default=3)
    choice = parser.parse_args()
    changes = ["channel.distance_m=60", f"channel.duration_s={choice.frames / RATE_HZ}", "receive.receiver=plain"]
    settings = load_settings("static", None, changes)
    frames = [frame for frame, _ in simulate(settings, default_messages(settings), 1)]
    works = {"warm": read, "cold": read_cold, "received": receiving(settings)}
    taken: dict[tuple[str, str], list[Cost]] = {}
    limit_threads()
    with tempfile.TemporaryDirectory() as name:
        paths = written(Path(name), frames)
        works["received"](paths["HDF5 .h5"])  # compiles
        for _ in range(choice.runs):
            for kind, path in paths.items():
                for what, work in works.items():
                    taken.setdefault((kind, what), []).append(cost(work, path))
        heads = "".join(f" {what + ' cpu':>14s} {'wall':>7s}" for what in works)
        print(f"{'ms a frame':30s}{heads}")
        for kind in paths:
            medians = [statistics.median(one[k] for one in taken[kind, what]) for what in works for k in (0, 1)]
            cells = "".join(f" {cpu:14.2f} {wall:7.2f}" for cpu, wall in zip(medians[::2], medians[1::2], strict=True))
            print(f"{kind:30s}{cells}", flush=True)


if __name__ == "__main__":
    main()
