"""Accuracy of panel location and colour unmixing: `python -m benchmarks.panel_places`.

The scenes in `benchmarks/panel_scenes.py` are independent of the measured code. Family 0 served for tuning; family 1
differs in clutter, noise and motion. A place is correct if every LED error is below 0.4 pitches. "Another count"
searches a wrong number of rows or columns from corners given by hand, so every place found is wrong.
"""

import argparse
from collections import Counter

import cv2
import numpy as np
from numpy.typing import NDArray

import heliograph
from benchmarks.panel_scenes import Scene, draw_scene

RIGHT_PITCHES = 0.4
ACCEPTED = 0.75
HAND_PITCHES = (0.25, 0.2)
"""Standard deviations in pitches: independent error per hand-marked corner, and common error."""

WAYS = ("one frame", "six frames", "by hand, one frame", "by hand, another count")
RESULTS = ("right, accepted", "right, rejected", "wrong, accepted", "wrong, rejected", "not found")


def outcomes(seed: int, family: int) -> dict[str, str]:
    """Return results for one scene by method."""
    scene = draw_scene(seed, family)
    rng = np.random.default_rng(seed)
    each, shared = HAND_PITCHES
    hand = scene.corners[0] + scene.pitch * (rng.normal(0, each, (4, 2)) + rng.normal(0, shared, 2))
    more_rows, more_columns = [(1, 0), (-1, 0), (0, 1), (0, -1)][seed % 4]
    found = {}
    for way in WAYS:
        frames = scene.frames if "six" in way else scene.frames[:1]
        more = (more_rows, more_columns) if "count" in way else (0, 0)
        count = scene.rows + more[0], scene.columns + more[1]
        found[way] = outcome(scene, frames, hand if "hand" in way else None, count)
    return found


def outcome(
    scene: Scene, frames: list[NDArray[np.uint8]], hand: NDArray[np.float64] | None, count: tuple[int, int]
) -> str:
    """Return the result of one call."""
    try:
        place = heliograph.locate(frames, hand, rows=count[0], columns=count[1])
    except heliograph.HeliographError:
        return RESULTS[-1]
    is_right = count == (scene.rows, scene.columns) and scene.error_pitches(place.corners) < RIGHT_PITCHES
    return f"{'right' if is_right else 'wrong'}, {'accepted' if place.score >= ACCEPTED else 'rejected'}"


def measure_colours(seeds: int) -> None:
    """Print bit errors for a threshold and for `unmix_colours` under random crosstalk."""
    print("\n| lit | crosstalk up to | bits | wrong by a threshold | wrong by unmix_colours |")
    print("| --- | --- | --- | --- | --- |")
    for lit in (0.05, 0.1, 0.3, 0.5, 0.8):
        for leak in (0.1, 0.3, 0.5):
            trials = before = after = 0
            for seed in range(seeds):
                rng = np.random.default_rng([seed, int(100 * lit), int(100 * leak)])
                bits = rng.random((1024, 3)) < lit
                matrix = (np.eye(3) + rng.uniform(0, leak, (3, 3)) * (1 - np.eye(3))) * rng.uniform(60, 140, 3)
                values = bits @ matrix.T + rng.uniform(5, 40) + rng.normal(0, 8, bits.shape)
                trials += bits.size
                middle = (values.min(axis=0) + values.max(axis=0)) / 2
                before += int(((values > middle) != bits).sum())
                after += int((heliograph.unmix_colours(values).bits != bits).sum())
            print(f"| {lit:.0%} | {leak:.0%} | {trials} | {before} | {after} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100, help="scenes")
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--family", type=int, default=1, choices=(0, 1), help="clutter, noise and motion")
    parser.add_argument("--colours", type=int, default=0, help="matrices of crosstalk of each kind")
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    counts: dict[str, Counter[str]] = {way: Counter() for way in WAYS}
    for seed in range(chosen.first, chosen.first + chosen.scenes):
        for way, result in outcomes(seed, chosen.family).items():
            counts[way][result] += 1
    print(f"| given | {' | '.join(RESULTS)} |\n| {' | '.join(['---'] * (len(RESULTS) + 1))} |")
    for way, count in counts.items():
        print(f"| {way} | {' | '.join(str(count[result]) for result in RESULTS)} |")
    if chosen.colours:
        measure_colours(chosen.colours)


if __name__ == "__main__":
    main()
