"""Speed of the channel: frames and windows a second on one core, beside plain copies and filters of the same frame.

python benchmarks/channel.py
"""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.channel import ChannelSettings, Footage, Placement, film
from heliograph.channel.settings import BackgroundSettings

RUNS = 5
FRAMES = 150


def clip() -> Footage:
    """A textured clip in memory, 1280 x 720 at 25 frames/s."""
    rng = np.random.default_rng(0)
    images = [cv2.GaussianBlur(rng.integers(0, 256, (720, 1280)).astype(np.uint8), (0, 0), 3) for _ in range(12)]
    return Footage(lambda: iter(images), 25.0)  # type: ignore[arg-type]  # OpenCV's arrays are not typed


def patterns() -> Iterator[NDArray[np.uint8]]:
    rng = np.random.default_rng(1)
    few = [rng.binomial(4, 0.5, (16, 16)).astype(np.uint8) for _ in range(16)]
    return itertools.cycle(few)


def film_ms(settings: ChannelSettings, roi_margin_px: int | None) -> float:
    """Median time of a frame in ms, the first ten frames left out."""
    recording = clip() if settings.background.kind == "footage" else None
    medians = []
    for _ in range(RUNS):
        lights = [patterns() for _ in settings.arrays]
        frames = film(
            settings,
            lights,
            np.random.default_rng(2),
            pattern_period_s=1e-3,
            footage=recording,
            roi_margin_px=roi_margin_px,
        )
        stamps = [time.perf_counter() for _ in itertools.islice(frames, FRAMES)]
        medians.append(float(np.mean(np.diff(stamps[10:]))) * 1e3)
    return float(np.median(medians))


def plain_ms(work: Callable[[], object]) -> float:
    """Median time of a call in ms."""
    times = []
    for _ in range(200):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times)) * 1e3


def cases() -> Iterator[tuple[str, ChannelSettings, int | None]]:
    base = ChannelSettings(shake="road", distance_m=31.0)
    yield "frame, footage, array at 30 m", replace(base, background=BackgroundSettings(kind="footage")), None
    yield "frame, drawn scene, array at 30 m", replace(base, background=BackgroundSettings(kind="synthetic")), None
    yield "frame, flat, array at 30 m", base, None
    for distance_m in (80.0, 50.0, 30.0, 26.0):
        yield f"window, flat, array at {distance_m:g} m", replace(base, distance_m=distance_m, duration_s=0.2), 8
    yield (
        "window, footage, array at 30 m",
        replace(base, background=BackgroundSettings(kind="footage"), duration_s=0.2),
        8,
    )
    two = (Placement(), Placement(x_m=-1.5))
    yield "frame, flat, two arrays at 30 m", replace(base, arrays=two), None


def main() -> None:
    cv2.setNumThreads(1)
    frame = np.random.default_rng(0).integers(0, 256, (512, 1024)).astype(np.uint8)
    other = np.empty_like(frame)
    copy = plain_ms(lambda: np.copyto(other, frame))
    blur = plain_ms(lambda: cv2.GaussianBlur(frame, (5, 5), 0))
    print(f"{'np.copyto of a frame':36} {copy:8.3f} ms")
    print(f"{'cv2.GaussianBlur 5x5 of a frame':36} {blur:8.3f} ms")
    for name, settings, roi in cases():
        ms = film_ms(settings, roi)
        print(f"{name:36} {ms:8.3f} ms {1e3 / ms:8.0f} frames/s  {ms / copy:7.1f} copies {ms / blur:6.2f} blurs")


if __name__ == "__main__":
    main()
