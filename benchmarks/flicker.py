"""An array that comes into sight beside what flickers: `python -m benchmarks.flicker [--films 24] [--seed 1]`.

With `--lamps 1000` films of 1 s show an array among so many lamps, still and shaken, at 25, 50 and 80 m, and are read
with the bound of a film. Printed are frames/s of processor time, the time of the first codeword, and the detections of
another identity.

In each film squares of 8 px change at random, within a larger square of 16 to 160 px. An array at rest comes into sight
0 to 3 s later, anywhere in a packet, and shows eight whole ones. It is 20 to 60 m away, where "plain" reads all layers.
Sizes, places and times are drawn at random by the seed. Frames are searched with the bound of a live camera. Counted
are the packets that are not read whole and the films that have one, the processor time of a frame, and for how long
frames of a camera would wait at most.
"""

import argparse
import math
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: algebra in one thread

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.measure.statistics import Count
from heliograph.receive import make_receiver
from heliograph.receive.events import DetectEvent, Event

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from lamp_scenes import LampScene

PACKETS = 8
SQUARE_PX = 8


@dataclass(frozen=True)
class Scene:
    """A film.

    Attributes
    ----------
    dark
        The link while the array is dark.
    lit
        The link from the time on at which it comes into sight.
    size
        Squares in a row of what flickers.
    place
        Its first row and column, in squares.
    seed
        Of the noise and of what flickers.
    turned
        Whether the camera sees all of it upside down.
    """

    dark: LinkSettings
    lit: LinkSettings
    size: int
    place: tuple[int, int]
    seed: int
    turned: bool = False

    def frames(self) -> Iterator[Frame]:
        """Frames of the film."""
        rng, period_s = np.random.default_rng(self.seed), self.lit.signal.pattern_period_s
        films = [simulate(one, default_messages(one), self.seed) for one in (self.dark, self.lit)]
        for k, (frame, _) in enumerate(chain(*films)):
            pixels = frame.pixels.astype(np.uint8)
            self._flicker(pixels, rng)
            yield Frame(k, k * period_s, np.ascontiguousarray(pixels[::-1, ::-1]) if self.turned else pixels)

    def _flicker(self, pixels: NDArray[np.uint8], rng: np.random.Generator) -> None:
        squares = rng.integers(0, 256, (self.size, self.size), np.uint8)
        rows, columns = (slice(SQUARE_PX * at, SQUARE_PX * (at + self.size)) for at in self.place)
        pixels[rows, columns] = np.kron(squares, np.ones((SQUARE_PX, SQUARE_PX), np.uint8))


def draw(rng: np.random.Generator, any_phase: bool, turned: bool, modulation: str) -> Scene:
    """Draw a film whose array, in the middle, is clear of what flickers.

    Parameters
    ----------
    rng
        Source of randomness.
    any_phase
        Whether the array may begin amid a frame.
    turned
        Whether the camera sees it upside down.
    modulation
        That of the data.
    """
    signal = load_settings("static").signal
    gone = rng.uniform(0, signal.packet_patterns)
    gone_s = (gone if any_phase else int(gone)) * signal.pattern_period_s
    distance_m, lead_s = rng.uniform(20, 60), rng.uniform(1e-3, 3)
    # it ends with the last whole packet, as a part of another one may be read too
    starts = {"dark": (lead_s, 1e3), "lit": (PACKETS * signal.packet_s + -gone_s % signal.packet_s, -gone_s)}
    links = {
        name: load_settings(
            "static",
            {
                "signal": {"modulation": modulation},
                "channel": {
                    "distance_m": distance_m,
                    "duration_s": duration_s,
                    "arrays": [{"x_m": 0.0, "y_m": 0.0, "start_s": start_s}],
                },
            },
        )
        for name, (duration_s, start_s) in starts.items()
    }
    camera, size = links["lit"].channel.camera, int(rng.integers(2, 21))
    rows, columns = camera.height // SQUARE_PX, camera.width // SQUARE_PX
    # half of the frame, left or right, less what an array at 20 m takes
    free = columns // 2 - 8 - size
    column = int(rng.integers(0, free)) + int(rng.integers(0, 2)) * (columns // 2 + 8)
    place = int(rng.integers(0, rows - size)), column
    return Scene(links["dark"], links["lit"], size, place, int(rng.integers(2**31)), turned)


def receive(scene: Scene, receiver: str) -> tuple[int, float, float]:
    """Packets read whole, processor time of a frame, and most that a frame waits, in ms.

    Parameters
    ----------
    scene
        The film.
    receiver
        Name of the receiver.
    """
    settings = replace(scene.lit.receive, receiver=receiver).with_live_limits()
    made, spent = make_receiver(scene.lit.signal, settings), 0.0
    late, waits, whole, count = 0.0, 0.0, 0, 0
    for frame in scene.frames():
        start = time.process_time()
        packets = list(made.push(frame))
        took = time.process_time() - start
        spent, count = spent + took, count + 1
        late = max(0.0, late + took - scene.lit.signal.pattern_period_s)
        waits, whole = max(waits, late), whole + sum(one.status == "ok" for one in packets)
    whole += sum(one.status == "ok" for one in made.finish())
    return whole, spent / count * 1e3, waits * 1e3


def read_lamps(count: int, seed: int, names: Sequence[str]) -> None:
    """Read films of an array among lamps."""
    print("| lamps | m | camera | receiver | frames/s | first codeword, s | other detections |")
    print("|---|---|---|---|---|---|---|")
    for shaking in (False, True):
        for distance_m in (25.0, 50.0, 80.0):
            scene = LampScene(lamps=count, seed=seed, distance_m=distance_m, shaking=shaking)
            link, frames = scene.link(), list(scene.frames())
            for name in names:
                events, first_s, spent_s = list[Event](), math.nan, 0.0
                made = make_receiver(link.signal, replace(link.receive, receiver=name), events.append)
                for frame in frames:
                    start = time.process_time()
                    packets = list(made.push(frame))
                    spent_s += time.process_time() - start
                    if math.isnan(first_s) and any(one.status in ("ok", "partial") for one in packets):
                        first_s = frame.time_s
                found = [event.detection.identity for event in events if isinstance(event, DetectEvent)]
                others = sum(one not in link.transmit.identities for one in found)
                camera = "shaking" if shaking else "still"
                rate = len(frames) / spent_s
                print(
                    f"| {count} | {distance_m:g} | {camera} | {name} | {rate:.0f} | {first_s:.3f} | {others} |",
                    flush=True,
                )


def main() -> None:
    """Count what is read beside what flickers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--receivers", default="plain,soft")
    parser.add_argument("--any-phase", action="store_true", help="out of step too, which plain does not read")
    parser.add_argument("--turned", action="store_true", help="seen upside down")
    parser.add_argument("--modulation", default="haar", help="haar or ook")
    parser.add_argument("--lamps", type=int, help="films of an array among so many lamps")
    given = parser.parse_args()
    limit_threads()
    cv2.setNumThreads(1)
    if given.lamps is not None:
        read_lamps(given.lamps, given.seed, given.receivers.split(","))
        return
    kind = given.any_phase, given.turned, given.modulation
    scenes = [draw(np.random.default_rng((given.seed, k)), *kind) for k in range(given.films)]
    for name in given.receivers.split(","):
        receive(scenes[0], name)  # compiles
        found = [receive(scene, name) for scene in scenes]
        lost = Count()
        for whole, *_ in found:
            lost.add(1, int(whole < PACKETS))
        low, high = lost.interval()
        ms, waits = np.array([one[1] for one in found]), np.array([one[2] for one in found])
        print(
            f"{name}: films that lose a packet {lost.errors}/{lost.trials} ({low:.1e} to {high:.1e}), packets lost "
            f"{[max(PACKETS - one[0], 0) for one in found]} of {PACKETS} each; {np.median(ms):.2f} ms a frame (most "
            f"{ms.max():.2f}); frames wait for {np.median(waits):.0f} ms at most in the middle film, "
            f"{waits.max():.0f} in the worst",
            flush=True,
        )


if __name__ == "__main__":
    main()
