"""Posts that pass before an array: `python -m benchmarks.poles [--passages 300] [--seed 1] [--receivers plain,soft]`.

With `--brief` the array is 50 m away, and a post hides it, or parts of it, during up to a quarter of the pairs of one
packet. Counted are the codewords of that packet. With `--live` searches have the bound of a live camera.

Else:

Each passage is a film of its own. Distance (40 to 95 m), speed (0 to 50 km/h), road (A to C), background, place of the
array, and the post's time (0.1 to 1 s from the first touch to the last, even in its logarithm), width (1 to 3 arrays),
gray level, side and start are drawn at random by the seed. Counted are codewords right, codewords that "plain" reads
and "soft" does not, and passages whose first packet in clear sight is read whole: the first one that begins after the
post is gone.
"""

import argparse
import contextlib
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console
from rich.progress import track

from heliograph.base.frames import Frame
from heliograph.channel import Truth
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.measure.statistics import Count
from heliograph.receive import make_receiver
from heliograph.receive.packet import Packet
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS

MARGIN_PX = 40
"""Surroundings of the array that are rendered, in px."""

Word = tuple[int, str, int]
"""Number of a packet, layer, and number of a codeword in it."""


@dataclass(frozen=True)
class Post:
    """A post with upright edges that passes before an array.

    Attributes
    ----------
    start_s, end_s
        When it first touches the array, and when it has left it, in seconds.
    width
        Its width in sides of the array.
    level
        Its gray level, 0 to 255.
    side
        1 if it comes from the left, -1 from the right.
    """

    start_s: float
    end_s: float
    width: float
    level: float
    side: int

    def before(self, frame: Frame, truth: Truth, rng: np.random.Generator) -> Frame:
        """Put it before the array in a frame.

        Parameters
        ----------
        frame
            The frame without it.
        truth
            Where the array is in the frame.
        rng
            Draws its noise.
        """
        array, leds = truth.arrays[0], 16
        length = leds * array.pitch_px
        travelled = (frame.time_s - self.start_s) / (self.end_s - self.start_s) * (1 + self.width) * length
        centre = array.x + self.side * (travelled - 0.5 * length - 0.5 * self.width * length)
        columns = np.arange(frame.pixels.shape[1]) + frame.origin[0]
        # the part of each column of pixels that it covers
        reach = 0.5 * self.width * length + 0.5
        hides = np.clip(reach - np.abs(columns - centre), 0, 1)
        if not hides.any():
            return frame
        post = rng.normal(self.level, 1.5, frame.pixels.shape)
        mixed = frame.pixels + hides * (post - frame.pixels)
        return replace(frame, pixels=np.clip(np.round(mixed), 0, 255).astype(frame.pixels.dtype))


@dataclass(frozen=True)
class Passage:
    """A film in which a post passes.

    Attributes
    ----------
    settings
        The link.
    post
        The post.
    seed
        Of the film.
    """

    settings: LinkSettings
    post: Post
    seed: int

    @property
    def clear(self) -> int:
        """Number of the first packet in clear sight after the post."""
        return math.ceil(self.post.end_s / self.settings.signal.packet_s)

    def frames(self) -> Iterator[Frame]:
        """Frames of the film."""
        rng = np.random.default_rng(self.seed)
        for frame, truth in simulate(self.settings, default_messages(self.settings), self.seed, None, MARGIN_PX):
            yield self.post.before(frame, truth, rng)


def draw(rng: np.random.Generator, spans_s: tuple[float, float] = (0.1, 1.0)) -> Passage:
    """Draw a passage.

    Parameters
    ----------
    rng
        Source of randomness.
    spans_s
        Shortest and longest time of a post in seconds.
    """
    start_s, span_s = rng.uniform(0.11, 0.21), math.exp(rng.uniform(*np.log(spans_s)))
    post = Post(start_s, start_s + span_s, rng.uniform(1, 3), rng.uniform(5, 150), int(rng.choice([-1, 1])))
    channel = {
        "distance_m": rng.uniform(40, 95),
        "speed_m_s": rng.uniform(0, 50 / 3.6),
        "road_class": str(rng.choice(["A", "B", "C"])),
        "background": {"kind": str(rng.choice(["flat", "synthetic"]))},
        "arrays": [{"x_m": rng.uniform(-2, 2), "y_m": rng.uniform(-1, 0)}],
        "stop_m": 10.0,
        "duration_s": 0.1 * math.ceil(post.end_s / 0.1) + 0.112,
    }
    return Passage(load_settings("paper", {"channel": channel}), post, int(rng.integers(2**31)))


def draw_brief(rng: np.random.Generator) -> Passage:
    """Draw a passage at 50 m whose post passes within the data of packet 1, during at most a quarter of its pairs.

    Parameters
    ----------
    rng
        Source of randomness.
    """
    passage = draw(rng)
    signal = passage.settings.signal
    span_s = rng.uniform(0.05, 0.25) * 2 * signal.data_pairs * signal.pattern_period_s
    first_s = signal.packet_s + 2 * signal.header_pairs * signal.pattern_period_s
    start_s = rng.uniform(first_s, 2 * signal.packet_s - span_s)
    channel = replace(passage.settings.channel, distance_m=50.0, duration_s=2 * signal.packet_s + 0.012)
    post = replace(passage.post, start_s=start_s, end_s=start_s + span_s)
    return replace(passage, settings=replace(passage.settings, channel=channel), post=post)


def receive(passage: Passage, frames: Sequence[Frame], receiver: str, live: bool = False) -> list[Packet]:
    """Packets that a receiver gives.

    Parameters
    ----------
    passage
        The passage, of whose settings signal and receiver are used.
    frames
        Frames of its film.
    receiver
        Name of the receiver.
    live
        Whether its searches have the bound of a live camera.
    """
    settings = replace(passage.settings.receive, receiver=receiver)
    made = make_receiver(passage.settings.signal, settings.with_live_limits() if live else settings)
    return [packet for frame in frames for packet in made.push(frame)] + list(made.finish())


def right(passage: Passage, packets: Sequence[Packet]) -> set[Word]:
    """Codewords that were right.

    Parameters
    ----------
    passage
        The passage.
    packets
        What a receiver gave.
    """
    packet_s = passage.settings.signal.packet_s
    return {
        (round(packet.start_time_s / packet_s), layer, k)
        for packet in packets
        for layer in LAYERS
        for k, word in enumerate(packet.layers[layer])
        if word.status == "ok"
    }


def whole(passage: Passage, packets: Sequence[Packet]) -> bool:
    """Whether the first packet in clear sight was read whole.

    Parameters
    ----------
    passage
        The passage.
    packets
        What a receiver gave.
    """
    packet_s = passage.settings.signal.packet_s
    return any(round(one.start_time_s / packet_s) == passage.clear and one.status == "ok" for one in packets)


def main() -> None:
    """Count what posts leave."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--passages", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--receivers", default="plain,soft")
    parser.add_argument("--brief", action="store_true", help="posts of up to a quarter of a packet, at 50 m")
    parser.add_argument("--live", action="store_true", help="searches with the bound of a live camera")
    given = parser.parse_args()
    names = given.receivers.split(",")
    if given.brief:
        count_brief(given.passages, given.seed, names, given.live)
        return
    words = {name: Counter[str]() for name in names}
    clear, lost = {name: Count() for name in names}, Count()
    # interrupted, it prints what it has counted
    with contextlib.suppress(KeyboardInterrupt):
        for k in track(range(given.passages), "passages", console=Console(stderr=True), transient=True):
            passage = draw(np.random.default_rng((given.seed, k)))
            frames = list(passage.frames())
            packets = {name: receive(passage, frames, name, given.live) for name in names}
            found = {name: right(passage, packets[name]) for name in names}
            for name, one in found.items():
                words[name].update(layer for _, layer, _ in one)
                clear[name].add(1, not whole(passage, packets[name]))
            if {"plain", "soft"} <= found.keys():
                lost.add(len(found["plain"]), len(found["plain"] - found["soft"]))
    for name in names:
        print(f"{name}: right {dict(words[name])}; first packet in clear sight not whole {_text(clear[name])}")
    if lost.trials:
        print(f"right with plain but not with soft {_text(lost)}")


def count_brief(passages: int, seed: int, names: Sequence[str], live: bool) -> None:
    """Count codewords lost of packets that a post hides during up to a quarter of their pairs.

    Parameters
    ----------
    passages, seed
        How many, and of which seed.
    names
        Names of the receivers.
    live
        Whether searches have the bound of a live camera.
    """
    lost = {(name, layer): Count() for name in names for layer in LAYERS}
    for k in range(passages):
        passage = draw_brief(np.random.default_rng((seed, k)))
        frames = list(passage.frames())
        for name in names:
            packets = receive(passage, frames, name, live)
            found = Counter(layer for number, layer, _ in right(passage, packets) if number == 1)
            for layer in LAYERS:
                sent = PacketFormat(passage.settings.signal).layers[layer].codewords
                lost[name, layer].add(sent, sent - found[layer])
    for name in names:
        print(f"{name}: lost " + ", ".join(f"{layer} {_text(lost[name, layer])}" for layer in LAYERS))


def _text(count: Count) -> str:
    """Errors of trials, and the interval of their rate."""
    low, high = count.interval()
    return f"{count.errors}/{count.trials} ({low:.1e} to {high:.1e})"


if __name__ == "__main__":
    main()
