"""Speed of the soft receiver following one array, beside an inverse of the equaliser's size in the same run.

python -m benchmarks.soft
"""

import os
import time
from collections.abc import Callable, Sequence

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: one core, and no threads that wait for each other

import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.measure.bench import window_margin_px
from heliograph.receive import Packet, make_receiver

RUNS = 5
FRAMES = 400
"""Four packets."""

DISTANCES = (30, 50, 80, 110, 150)


SINGLE = 'transmit.formats=[{mode="single", high="9/10", middle="3/4", low="1/2"}]'


def film(distance_m: float, *changes: str) -> tuple[LinkSettings, list[Frame]]:
    """Windows about an array at rest, as a camera that follows it would send them."""
    own = (f"channel.distance_m={distance_m}", f"channel.duration_s={FRAMES * 1e-3}", "receive.receiver=soft")
    settings = load_settings("static", None, [*own, *changes])
    margin = window_margin_px(settings)
    frames = [frame for frame, _ in simulate(settings, default_messages(settings), 1, None, margin)]
    return settings, frames


def rate(settings: LinkSettings, frames: Sequence[Frame]) -> tuple[float, list[Packet]]:
    """Median frames/s over the runs by the time of this process, and the packets read."""
    rates, packets = list[float](), list[Packet]()
    for _ in range(RUNS):
        receiver, packets = make_receiver(settings.signal, settings.receive), []
        start = time.process_time()
        for frame in frames:
            packets += receiver.push(frame)
        packets += receiver.finish()
        rates.append(len(frames) / (time.process_time() - start))
    return float(np.median(rates)), packets


def median_ms(work: Callable[[], object]) -> float:
    """Median time of a call in ms."""
    times = []
    for _ in range(100):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return float(np.median(times)) * 1e3


def inverse_ms() -> float:
    """Median time in ms of the inverse of a 256 x 256 matrix in single precision: how fast the core is now."""
    a = np.random.default_rng(0).standard_normal((256, 512)).astype(np.float32)
    matrix = a @ a.T
    return median_ms(lambda: np.linalg.inv(matrix))


def read(packets: Sequence[Packet]) -> str:
    """Codewords read of those received, by layer."""
    words = {name: [w for p in packets for w in p.layers[name]] for name in ("high", "middle", "low")}
    return ", ".join(f"{name} {sum(w.status == 'ok' for w in by)}/{len(by)}" for name, by in words.items())


def main() -> None:
    limit_threads()
    films = {f"array at {z} m": film(z) for z in DISTANCES}
    films["without inverses, 80 m"] = film(80, SINGLE)
    for one in list(films.values())[-2:]:
        rate(*one)  # compiles
    inverse = inverse_ms()
    print(f"following one array, medians of {RUNS} runs, one core; asked are 500 frames/s")
    print(f"{'inverse, 256 x 256 float32':30} {inverse:8.3f} ms")
    for name, (settings, frames) in films.items():
        per_s, packets = rate(settings, frames)
        ms = 1e3 / per_s
        print(f"{name:30} {ms:8.3f} ms {per_s:7.0f} frames/s {ms / inverse:6.2f} inverses a frame   {read(packets)}")


if __name__ == "__main__":
    main()
