"""A film of a 64 x 64 panel in three colours, 560 x 560 px: `python -m benchmarks.panels [--frames 100] [--seed 0]`.

The panel is drawn by `tests/helpers/panel_films.py`, which has no code of what is measured: perspective, motion of a
pixel or two a frame, LEDs that differ by 5 %, light fall-off, colours that leak by a tenth, noise of two gray levels.
It is found by two frames, followed, and read with and without undoing the blur; each LED is judged by its mean over the
film. Times are of processor time, beside a Gaussian blur of 5 x 5 of a frame in three colours.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np

import heliograph
from heliograph.measure.statistics import Clustered

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from panel_films import PanelFilm, keystone, moving

LEDS = 64

CASES = [(430.0, 1.5, 0.0), (430.0, 2.0, 0.0), (430.0, 2.5, 0.0), (430.0, 2.5, 0.1),
         (300.0, 1.5, 0.0), (300.0, 2.0, 0.0), (300.0, 2.5, 0.0)]  # fmt: skip
"""Side of the panel in px, blur in px, and the part of the light in a halo four times as wide."""

COLUMNS = ("pitch, px", "blur, px", "blur of an LED, pitches", "corners off, px: median, most", "bits wrong",
           "blur undone: bits wrong", "locate, ms", "follow, ms", "sample, ms", "blur undone, ms",
           "yardstick, ms")  # fmt: skip


def timed(call: Callable[..., Any], *given: Any) -> tuple[Any, float]:
    """What a call gives, and its processor time in ms."""
    began = time.process_time()
    found = call(*given)
    return found, 1e3 * (time.process_time() - began)


def measure(side: float, blur: float, halo: float, count: int, seed: int) -> None:
    """Print a row of the table."""
    way = moving(keystone((265.0, 270.0), side, 1.0, 0.06, 0.15), (0.2, 0.1))
    film = PanelFilm(way, blur=blur, halo=halo, seed=seed)
    frames, hand = list(film.film(count)), ""
    start, locating = timed(lambda: heliograph.locate(frames[:2], rows=LEDS, columns=LEDS))
    if np.abs(start.corners - film.corners(0)).max() > 1:  # two frames do not tell
        start, locating = timed(lambda: heliograph.locate(frames[0], film.corners(0) + 1.0, rows=LEDS, columns=LEDS))
        hand = ", by hand"
    following, places = heliograph.follow(frames, start, LEDS, LEDS), list[heliograph.Place]()
    spent: list[list[float]] = [[], [], [], []]
    for _ in frames:
        place, ms = timed(next, following)
        places.append(place)
        spent[0].append(ms)
    wrong = []
    for k, unblur in ((1, False), (2, True)):
        values = []
        for frame, place in zip(frames, places, strict=True):
            seen, ms = timed(heliograph.sample, frame, place, LEDS, LEDS, unblur, film.leak)
            spent[k].append(ms)
            values.append(seen.astype(np.float32))
        wrong.append(counted(values, film))
    spent[3] = [timed(cv2.GaussianBlur, frame, (5, 5), 0)[1] for frame in frames]
    off = [float(np.abs(place.corners - film.corners(k)).max()) for k, place in enumerate(places)]
    of_led = np.hypot(blur, film.emitter * side / LEDS / 4) * LEDS / side
    halo_text = f", halo of {halo:.0%}" if halo else ""
    follow, *sampling = (median(one) for one in spent)
    cells = [f"{side / LEDS:.1f}", f"{blur:g}{halo_text}", f"{of_led:.2f}", f"{median(off):.3f}, {max(off):.3f}"]
    cells += [*wrong, f"{locating:.0f}{hand}", f"{follow:.0f}", *(f"{ms:.3g}" for ms in sampling)]
    print_row(cells)


def counted(values: list[Any], film: PanelFilm) -> str:
    """Bits wrong, their rate and its interval; errors of a frame are taken together."""
    seen, errors = np.array(values), Clustered(scattered=True)
    found = seen > seen.mean(axis=0)
    for number, bits in enumerate(found):
        errors.add(bits.size, int((bits != film.bits(number)).sum()))
    low, high = errors.interval()
    said = f"{errors.text()} ({low:.1e} to {high:.1e})" if errors.errors else errors.text()
    return f"{errors.errors}/{errors.trials}: {said}"


def print_row(cells: Iterable[str]) -> None:
    print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100, help="frames of each film")
    parser.add_argument("--seed", type=int, default=0, help="of scenery, bits and noise")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    print_row(COLUMNS)
    print_row("-" * 3 for _ in COLUMNS)
    for side, blur, halo in CASES:
        measure(side, blur, halo, chosen.frames, chosen.seed)


if __name__ == "__main__":
    main()
