"""Live cameras switched on anywhere: `python -m benchmarks.switched_on [--films 48] [--seed 1]`.

Each film is 0.6 s of the paper's drive. Where on the way it begins, at which pattern of a packet, how far out of step,
which identity the array has and how it is yawed and rolled are drawn by the seed. Told are the delay of packets, from
the time at which their last frame came to their bytes, and for how long frames wait: by processor time, as if following
and decoding had a core each (see `benchmarks.drive`), with the bound of a live camera's search.
"""

import argparse
import math
import os
from dataclasses import replace

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: algebra in one thread

import cv2
import numpy as np

from benchmarks import drive
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate

RATE_HZ = 1000.0

SECONDS = 0.6

MOST_YAW_DEG, MOST_ROLL_DEG = 20.0, 5.0

LONGEST_MS = 100.0
"""Delay that is asked for."""


def draw(rng: np.random.Generator, near_m: float, far_m: float) -> LinkSettings:
    """Draw a link.

    Parameters
    ----------
    rng
        Source of randomness.
    near_m, far_m
        Distances in m between which the first frame's is drawn, evenly by its logarithm.
    """
    signal = load_settings("paper").signal
    place = {
        "yaw_deg": float(rng.uniform(-1, 1) * MOST_YAW_DEG),
        "roll_deg": float(rng.uniform(-1, 1) * MOST_ROLL_DEG),
        "start_s": -float(rng.uniform(0, signal.packet_s)),
    }
    distance_m = math.exp(rng.uniform(math.log(near_m), math.log(far_m)))
    channel = {"distance_m": distance_m, "duration_s": SECONDS, "arrays": [place]}
    return load_settings("paper", {"channel": channel, "transmit": {"identities": [int(rng.integers(30))]}})


def tell(name: str, distances_m: list[float], took: list[drive.TwoCores]) -> None:
    """Print what the films took.

    Parameters
    ----------
    name
        Of the receiver.
    distances_m
        Distance of each film's first frame in m.
    took
        What each film took.
    """
    delays = np.concatenate([one.delays_ms for one in took])
    if not delays.size:
        print(f"{name}: no packet in {len(took)} films", flush=True)
        return
    waits = np.array([one.waits_ms.max() for one in took])
    late = [
        f"{k} ({distance:.0f} m: {np.round(one.delays_ms).astype(int).tolist()})"
        for k, (distance, one) in enumerate(zip(distances_m, took, strict=True))
        if (one.delays_ms > LONGEST_MS).any()
    ]
    middle, most = np.quantile(delays, [0.5, 0.9])
    print(
        f"{name}: {len(took)} films, {len(delays)} packets, {sum(not len(one.delays_ms) for one in took)} films "
        f"without any; delay in ms {middle:.0f} in the middle, 90 % {most:.0f}, most {delays.max():.0f}; "
        f"{np.count_nonzero(delays > LONGEST_MS)} packets above {LONGEST_MS:.0f} ms, in films {late}; frames waiting, "
        f"most of a film in ms: {np.median(waits):.0f} in the middle, 90 % {np.quantile(waits, 0.9):.0f}, most "
        f"{waits.max():.0f}",
        flush=True,
    )


def main() -> None:
    """Time films that are drawn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, default=48)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--near", type=float, default=30.0, help="least distance in m")
    parser.add_argument("--far", type=float, default=80.0, help="largest distance in m")
    parser.add_argument("--receivers", default="soft,plain")
    given = parser.parse_args()
    limit_threads()
    cv2.setNumThreads(1)
    names = given.receivers.split(",")
    distances, took = list[float](), {name: list[drive.TwoCores]() for name in names}
    for k in range(given.films):
        sent = draw(np.random.default_rng((given.seed, k)), given.near, given.far)
        live = replace(sent, receive=sent.receive.with_live_limits())
        frames = [frame for frame, _ in simulate(sent, default_messages(sent), given.seed)]
        distances.append(sent.channel.distance_m)
        for name in names:
            if k == 0:
                # machine code is loaded
                drive.read(drive.link(live, name, False), frames)
            took[name].append(drive.timed_on_two_cores(frames, drive.link(live, name, True), RATE_HZ))
    for name in names:
        tell(name, distances, took[name])


if __name__ == "__main__":
    main()
