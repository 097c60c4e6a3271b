"""Minutes of frames: `python -m benchmarks.soak [--minutes 10] [--seed 0] [--receiver plain] [--compare 1]`.

One receiver gets drives of ten seconds, one after another without a gap in time. Each is drawn by the seed: from 95 m
on at 10 to 30 km/h, on roads of class A to C, before a flat or drawn background, past two arrays that are switched on
and off, with posts before them, and with 1 % of the frames lost. A line a drive says what the process holds in memory
and how long a frame took. A fresh receiver reads each drive too, with `--compare 4` every fourth one. Counted are
codewords that it reads and the lasting one does not, and codewords that were never sent. In the last packet of each
drive, which is left out, both arrays are off: the next drive begins elsewhere.
"""

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.poles import MARGIN_PX, Post
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import random_messages
from heliograph.receive import Packet, Receiver, make_receiver
from heliograph.signal.settings import LAYERS

DRIVE_S = 10.0
"""Length of a drive in seconds: a whole number of packets."""

LAST_S = 0.1
"""Length of a drive's last packet in seconds."""

IDENTITIES = (3, 17)
"""Numbers of the two arrays."""

Word = tuple[int, int, str, int]
"""Array, number of the packet in its drive, layer, and number of the codeword."""


@dataclass(frozen=True)
class Drive:
    """Ten seconds of frames.

    Attributes
    ----------
    settings
        The link.
    posts
        Posts that pass.
    messages
        What each array sends.
    seed
        Of the film.
    """

    settings: LinkSettings
    posts: tuple[Post, ...]
    messages: list[Mapping[str, Sequence[bytes]]]
    seed: int

    def frames(self) -> Iterator[Frame]:
        """Its frames, from time 0 on."""
        rng = np.random.default_rng(self.seed)
        for frame, truth in simulate(self.settings, self.messages, self.seed, None, MARGIN_PX):
            for post in self.posts:
                frame = post.before(frame, truth, rng)
            yield frame

    @property
    def packets(self) -> int:
        """Packets that are counted."""
        return round(DRIVE_S / self.settings.signal.packet_s) - 1

    def words(self, packets: list[Packet], start_s: float) -> tuple[set[Word], int]:
        """Codewords that were right, and how many were taken for right and never sent.

        Parameters
        ----------
        packets
            What a receiver gave of this drive.
        start_s
            Time of its first frame.
        """
        found, wrong, packet_s = set[Word](), 0, self.settings.signal.packet_s
        for packet in packets:
            number = round((packet.start_time_s - start_s) / packet_s)
            if not 0 <= number < self.packets:
                continue
            for layer in LAYERS:
                for k, word in enumerate(packet.layers[layer]):
                    if word.status != "ok" or word.block is None:
                        continue
                    if packet.identity in IDENTITIES:
                        sent = self.messages[IDENTITIES.index(packet.identity)][layer]
                        if any(word.block.payload in one for one in sent):
                            found.add((packet.identity, number, layer, k))
                            continue
                    wrong += 1
        return found, wrong


def draw(rng: np.random.Generator, receiver: str) -> Drive:
    """Draw a drive.

    Parameters
    ----------
    rng
        Source of randomness.
    receiver
        Name of the receiver.
    """
    speed_m_s, posts = rng.uniform(10, 30) / 3.6, []
    for start_s in rng.uniform(0.5, DRIVE_S - 1, int(rng.integers(1, 4))):
        end_s = start_s + rng.uniform(0.1, 0.6)
        posts.append(Post(start_s, end_s, rng.uniform(1, 3), rng.uniform(5, 150), int(rng.choice([-1, 1]))))
    arrays = []
    for x_m in (rng.uniform(-3, -0.7), rng.uniform(0.7, 3)):
        off_s = [*np.sort(rng.uniform(0, DRIVE_S - LAST_S, 4)).reshape(2, 2).tolist(), [DRIVE_S - LAST_S, DRIVE_S]]
        arrays.append({"x_m": x_m, "y_m": rng.uniform(-1, 0), "off_s": off_s})
    channel = {
        "distance_m": 95.0,
        "stop_m": 10.0,
        "speed_m_s": speed_m_s,
        "duration_s": DRIVE_S,
        "road_class": str(rng.choice(["A", "B", "C"])),
        "background": {"kind": str(rng.choice(["flat", "synthetic"]))},
        "camera": {"dropped": 0.01},
        "arrays": arrays,
    }
    content = {"transmit": {"identities": list(IDENTITIES)}, "receive": {"receiver": receiver}, "channel": channel}
    settings, seed = load_settings("paper", content), int(rng.integers(2**31))
    return Drive(settings, tuple(posts), random_messages(settings, seed), seed)


def main() -> None:
    """Feed one receiver for minutes, and compare it with fresh ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--receiver", default="plain")
    parser.add_argument("--compare", type=int, default=1)
    given = parser.parse_args()
    lasting: Receiver | None = None
    read, missed, more, wrong, index, frames = 0, 0, 0, 0, 0, 0
    for number in range(max(1, round(given.minutes * 60 / DRIVE_S))):
        drive, start_s = draw(np.random.default_rng((given.seed, number)), given.receiver), number * DRIVE_S
        lasting = lasting or make_receiver(drive.settings.signal, drive.settings.receive)
        compared = number % given.compare == 0
        fresh = make_receiver(drive.settings.signal, drive.settings.receive)
        packets: list[Packet] = []
        alone: list[Packet] = []
        took_s, count, first = 0.0, 0, index
        for frame in drive.frames():
            index, count = first + frame.index, count + 1
            begin = time.process_time()
            packets += lasting.push(replace(frame, index=index, time_s=start_s + frame.time_s))
            took_s += time.process_time() - begin
            if compared:
                alone += fresh.push(frame)
        index += 1
        alone += fresh.finish()
        found, false = drive.words(packets, start_s)
        once, _ = drive.words(alone, 0.0)
        lost, gained = len(once - found), len(found - once) if compared else 0
        read, missed, more, wrong = read + len(found), missed + lost, more + gained, wrong + false
        frames += count
        print(
            f"{start_s + DRIVE_S:4.0f} s: {_resident_mb():.0f} MB, {1e3 * took_s / count:.2f} ms a frame, "
            f"right {len(found)}, with a fresh receiver alone {lost if compared else '-'}, never sent {false}",
            flush=True,
        )
    print(
        f"{frames} frames: right {read}, with fresh receivers alone {missed}, "
        f"with this alone {more}, never sent {wrong}"
    )


def _resident_mb() -> float:
    """Memory of the process in 1e6 bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


if __name__ == "__main__":
    main()
