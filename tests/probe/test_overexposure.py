"""Detect overexposure from pixels at the highest level in a region, for any such level."""

from dataclasses import replace
from functools import cache
from itertools import product

import cv2
import numpy as np
import pytest
from faulty_films import FAULTY, KeptFilm
from numpy.typing import NDArray
from screen_films import Phone, phone_frames
from screen_light import shown

from heliograph.base.frames import Frame
from heliograph.probe import probe_film
from heliograph.probe.levels import overexposed_part
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings
from heliograph.web.sending import screen_settings, sending_of

SIDE, CELL = 16, 6
NOISES = [(0.0, False), (2.0, False), (2.0, True)]


@cache
def light(blur: float, levels: int = 5) -> NDArray[np.float64]:
    """Draw LED frames with random levels from 0 to 1; five levels have Haar data probabilities."""
    rng = np.random.default_rng(0)
    shape = (24, SIDE, SIDE)
    values = rng.binomial(4, 0.5, shape) / 4 if levels == 5 else rng.integers(0, levels, shape) / (levels - 1)
    frames = values.repeat(CELL, axis=1).repeat(CELL, axis=2)
    return np.stack([cv2.GaussianBlur(frame, (0, 0), blur) for frame in frames])


def part(gray: NDArray[np.float64], noise: float, full_scale: int = 255, jpeg: bool = False) -> float:
    rng = np.random.default_rng(100)
    pixels = np.clip(np.rint(gray + rng.normal(0, noise, gray.shape)), 0, full_scale).astype(np.int64)
    if jpeg:
        quality = [cv2.IMWRITE_JPEG_QUALITY, 70]
        coded = [cv2.imencode(".jpg", frame.astype(np.uint8), quality)[1] for frame in pixels]
        pixels = np.stack([np.asarray(cv2.imdecode(frame, cv2.IMREAD_GRAYSCALE), np.int64) for frame in coded])
    return overexposed_part(np.bincount(pixels.ravel(), minlength=full_scale + 1), full_scale)


@pytest.mark.parametrize(("noise", "jpeg"), NOISES)
def test_levels_clipped_at_any_white_are_overexposed(noise: float, jpeg: bool) -> None:
    for white in (255, 245, 235, 220, 180):
        assert part(white * np.minimum(4.0 * light(0.8), 1.0), noise, jpeg=jpeg) > 0.5, white


def test_tone_curves_and_shifted_bits_are_overexposed() -> None:
    bright = 4.0 * light(0.8)
    assert part(235 * np.tanh(1.5 * bright) ** (1 / 2.2), 2.0) > 0.5
    assert part(16 * np.rint(4095 * np.minimum(bright, 1.0)), 0.0, 65535) > 0.5


@pytest.mark.parametrize(("noise", "jpeg"), NOISES)
def test_good_dim_and_weak_light_is_not_overexposed(noise: float, jpeg: bool) -> None:
    ranges = (0, 235), (0, 250), (10, 60), (120, 150), (200, 240)
    for levels, (dark, white), gamma in product((4, 5), ranges, (1.0, 2.2)):
        gray = dark + (white - dark) * light(0.6, levels) ** (1 / gamma)
        assert part(gray, noise, jpeg=jpeg) < 0.25, (levels, dark, white, gamma)


@pytest.mark.slow
def test_phone_film_with_highlights_below_full_scale_is_overexposed() -> None:
    """White is 235 of 255, with noise added after clipping."""
    phone = Phone(width=320, height=240, side_px=160.0, blur_px=0.8, noise=0.0, seed=5, gain=5.0)
    grabs, rng = shown(sending_of(b"Hello from a laptop", None, 16, 10.0), 3.5, cell_px=8), np.random.default_rng(5)
    frames = [
        Frame(k, time_s, np.clip(np.rint(gray * (235 / 255) + rng.normal(0, 1.5, gray.shape)), 0, 255).astype(np.uint8))
        for k, (time_s, gray) in enumerate(phone_frames(grabs, phone))
    ]
    settings = screen_settings(16, 10.0)
    found = probe_film(KeptFilm(frames, 30.0), settings.signal, settings.receive, reading=False, trials=False)
    assert {cause.kind for region in found.regions for cause in region.causes} == {"exposure"}
    assert "lower the brightness of the screen" in found.advice[0]


@pytest.mark.slow
def test_array_with_highlights_below_full_scale_is_saturated() -> None:
    film, rng = FAULTY["saturated"](), np.random.default_rng(200)

    def lower(frame: Frame) -> Frame:
        gray = frame.pixels * (200 / 255) + rng.normal(0, 1.5, frame.pixels.shape)
        return replace(frame, pixels=np.clip(np.rint(gray), 0, 255).astype(np.uint8))

    film = KeptFilm([lower(frame) for frame in film], film.rate_hz)
    first = probe_film(film, SignalSettings(), ReceiveSettings(), reading=False, trials=False).regions[0].causes[0]
    assert first.kind == "saturated"
    assert "expose shorter" in first.advice[0]
