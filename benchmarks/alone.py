"""Arrays alone, in view as a live camera is switched on: `python -m benchmarks.alone [--films 48] [--seed 1]`.

Each is at rest at a random distance, yawed and rolled, anywhere in a packet and out of step with the camera, as drawn
by the seed. Its own data alternate until its first header comes, and use up what searches may cost. The films are read
with the bound of a live camera's search and without it. Counted are packets of which a codeword is read: films that
have one, and those that have fewer with the bound.
"""

import argparse
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: algebra in one thread

import cv2
import numpy as np

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import Packet, Receiver, make_receiver
from heliograph.receive.geometry.pose import UPRIGHT, Orientation

PACKETS = 5
"""Packets that a film lasts for: four of them are whole."""

UPSIDE_DOWN = Orientation(turns=2)

MOST_YAW_DEG, MOST_ROLL_DEG = 40.0, 10.0


def draw(rng: np.random.Generator, near_m: float, far_m: float, modulation: str) -> LinkSettings:
    """Draw a link.

    Parameters
    ----------
    rng
        Source of randomness.
    near_m, far_m
        Distances in m between which the array's is drawn, evenly by its logarithm.
    modulation
        That of the data.
    """
    signal = load_settings("static").signal
    place = {
        "x_m": 0.0,
        "y_m": 0.0,
        "yaw_deg": float(rng.uniform(-1, 1) * MOST_YAW_DEG),
        "roll_deg": float(rng.uniform(-1, 1) * MOST_ROLL_DEG),
        "start_s": -float(rng.uniform(0, signal.packet_s)),
    }
    distance_m = math.exp(rng.uniform(math.log(near_m), math.log(far_m)))
    channel = {"distance_m": distance_m, "duration_s": PACKETS * signal.packet_s, "arrays": [place]}
    sent = {"signal": {"modulation": modulation}, "transmit": {"identities": [int(rng.integers(30))]}}
    return load_settings("static", {"channel": channel, **sent})


def read(link: LinkSettings, receiver: str, frames: Sequence[Frame]) -> tuple[int, int]:
    """Packets of which a codeword is read, with the bound of a live camera and without it.

    Parameters
    ----------
    link
        The link.
    receiver
        Name of the receiver.
    frames
        Its film.
    """
    settings = replace(link.receive, receiver=receiver)
    bounded, unbounded = (
        sum(_read(packet, link) for packet in _packets(make_receiver(link.signal, one), frames))
        for one in (settings.with_live_limits(), settings)
    )
    return bounded, unbounded


def _packets(receiver: Receiver, frames: Sequence[Frame]) -> Iterator[Packet]:
    for frame in frames:
        yield from receiver.push(frame)
    yield from receiver.finish()


def _read(packet: Packet, link: LinkSettings) -> bool:
    own = packet.identity == link.transmit.identities[0]
    return own and any(word.status == "ok" for words in packet.layers.values() for word in words)


def main() -> None:
    """Count what is read with the bound and without it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, default=48)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--near", type=float, default=12.0, help="least distance in m")
    parser.add_argument("--far", type=float, default=32.0, help="largest distance in m")
    parser.add_argument("--receivers", help="plain, soft; of ook only plain reads")
    parser.add_argument("--turned", action="store_true", help="seen upside down")
    parser.add_argument("--modulation", default="haar", help="haar or ook")
    given = parser.parse_args()
    limit_threads()
    cv2.setNumThreads(1)
    names = given.receivers or ("plain" if given.modulation == "ook" else "plain,soft")
    counts: dict[str, list[tuple[int, int]]] = {name: [] for name in names.split(",")}
    for k in range(given.films):
        link = draw(np.random.default_rng((given.seed, k)), given.near, given.far, given.modulation)
        turn = UPSIDE_DOWN if given.turned else UPRIGHT
        film = simulate(link, default_messages(link), given.seed)
        frames = [replace(frame, pixels=turn.turned(frame.pixels)) for frame, _ in film]
        for name, found in counts.items():
            found.append(read(link, name, frames))
    for name, found in counts.items():
        bounded, unbounded = (sum(one[k] > 0 for one in found) for k in (0, 1))
        missed = [k for k, one in enumerate(found) if one[0] == 0 < one[1]]
        fewer = {k: one for k, one in enumerate(found) if 0 < one[0] < one[1]}
        print(
            f"{name}: of {len(found)} arrays {bounded} are read with the bound and {unbounded} without it; only "
            f"without it: {missed}; fewer packets with it, and how many with it and without: {fewer}",
            flush=True,
        )


if __name__ == "__main__":
    main()
