"""A street drawn at random, as a background of any size."""

import itertools

import numpy as np

from heliograph.base.arrays import Gray

_ROUND_LAMPS = 0.5
"""Probability of a drawn lamp to be round. Chosen by eye."""

_LIT_WINDOWS = 0.3
"""Probability of a drawn window to be lit. Chosen by eye, as are the sizes and gray levels of the whole drawing."""


def draw_scene(size: tuple[int, int], rng: np.random.Generator) -> Gray:
    """Draw a street at dusk: sky, road, buildings with windows, round and rectangular lamps.

    Numbers, sizes and gray levels of all of them are chosen by eye; a change would change every film with this
    background.
    """
    import cv2

    height, width = size
    horizon = height // 2
    sky = np.linspace(110, 60, horizon)
    road = np.linspace(30, 50, height - horizon)
    scene = np.repeat(np.concatenate([sky, road])[:, None], width, 1).astype(np.uint8)
    for left in itertools.accumulate(rng.integers(width // 24, width // 8, 64)):
        _draw_building(scene, int(left) - width // 8, horizon, rng)
    for _ in range(rng.integers(12, 24)):
        x, y = int(rng.integers(width)), int(rng.integers(height // 6, height * 5 // 6))
        w, h, shade = int(rng.integers(2, 20)), int(rng.integers(2, 16)), int(rng.integers(160, 256))
        if rng.random() < _ROUND_LAMPS:
            cv2.circle(scene, (x, y), max(w // 2, 1), shade, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(scene, (x, y), (x + w, y + h), shade, -1)
    return np.asarray(cv2.GaussianBlur(scene, (0, 0), 0.6), np.uint8)


def _draw_building(scene: Gray, left: int, horizon: int, rng: np.random.Generator) -> None:
    import cv2

    width, tall = int(rng.integers(30, 120)), int(rng.integers(horizon // 4, horizon))
    shade = int(rng.integers(20, 90))
    cv2.rectangle(scene, (left, horizon - tall), (left + width, horizon), shade, -1)
    for x, y in itertools.product(range(left + 5, left + width - 6, 12), range(horizon - tall + 6, horizon - 8, 16)):
        lit = int(rng.integers(120, 220)) if rng.random() < _LIT_WINDOWS else shade + 15
        cv2.rectangle(scene, (x, y), (x + 5, y + 8), lit, -1)
