"""Detect overexposure from pixels at the highest level in a region, for any such level."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from faulty_films import FAULTY, KeptFilm
from numpy.typing import NDArray
from screen_films import Phone, phone_frames, write_phone_film
from screen_light import shown

from heliograph.base.frames import Frame
from heliograph.media import open_film
from heliograph.probe import Findings, probe_film
from heliograph.probe.levels import overexposed_part
from heliograph.receive import ReceiveSettings
from heliograph.signal.settings import SignalSettings
from heliograph.web.sending import screen_settings, sending_of

SEEDS = range(2)
SIDE, CELL = 16, 6


def light(seed: int, blur: float, levels: int = 5) -> NDArray[np.float64]:
    """Draw LED frames with random levels from 0 to 1; five levels have Haar data probabilities."""
    rng = np.random.default_rng(seed)
    shape = (24, SIDE, SIDE)
    values = rng.binomial(4, 0.5, shape) / 4 if levels == 5 else rng.integers(0, levels, shape) / (levels - 1)
    frames = values.repeat(CELL, axis=1).repeat(CELL, axis=2)
    return np.stack([cv2.GaussianBlur(one, (0, 0), blur) for one in frames])


def part(gray: NDArray[np.float64], seed: int, noise: float, full_scale: int = 255, jpeg: bool = False) -> float:
    rng = np.random.default_rng(seed + 100)
    seen = np.clip(np.rint(gray + rng.normal(0, noise, gray.shape)), 0, full_scale).astype(np.int64)
    if jpeg:
        quality = [cv2.IMWRITE_JPEG_QUALITY, 70]
        coded = [cv2.imencode(".jpg", one.astype(np.uint8), quality)[1] for one in seen]
        seen = np.stack([np.asarray(cv2.imdecode(one, cv2.IMREAD_GRAYSCALE), np.int64) for one in coded])
    return overexposed_part(np.bincount(seen.ravel(), minlength=full_scale + 1), full_scale)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("white", [255, 245, 235, 220, 180])
@pytest.mark.parametrize(("noise", "jpeg"), [(0.0, False), (2.0, False), (2.0, True)])
def test_levels_clipped_at_any_white_are_overexposed(seed: int, white: int, noise: float, jpeg: bool) -> None:
    clipped = white * np.minimum(4.0 * light(seed, 0.8), 1.0)
    assert part(clipped, seed, noise, jpeg=jpeg) > 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_highlights_in_the_knee_of_a_tone_curve_are_overexposed(seed: int) -> None:
    bright = 4.0 * light(seed, 0.8)
    assert part(235 * np.tanh(1.5 * bright) ** (1 / 2.2), seed, 2.0) > 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_levels_of_12_bits_at_the_top_of_16_are_overexposed(seed: int) -> None:
    clipped = 16 * np.rint(4095 * np.minimum(4.0 * light(seed, 0.8), 1.0))
    assert part(clipped, seed, 0.0, 65535) > 0.5


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("levels", [4, 5])
@pytest.mark.parametrize(("dark", "white"), [(0, 235), (0, 250), (10, 60), (120, 150), (200, 240)])
@pytest.mark.parametrize(("noise", "jpeg"), [(0.0, False), (2.0, False), (2.0, True)])
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_well_exposed_dim_and_weak_light_is_not_overexposed(
    seed: int, levels: int, dark: int, white: int, noise: float, jpeg: bool, gamma: float
) -> None:
    gray = dark + (white - dark) * light(seed, 0.6, levels) ** (1 / gamma)
    assert part(gray, seed, noise, jpeg=jpeg) < 0.25


def darkened(
    frames: Iterator[tuple[float, NDArray[np.uint8]]], white: int, seed: int
) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Yield frames with reduced white level, with noise added after clipping."""
    rng = np.random.default_rng(seed)
    for time_s, gray in frames:
        seen = gray * (white / 255) + rng.normal(0, 1.5, gray.shape)
        yield time_s, np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def probed_screen(path: Path, seed: int, white: int, **phone: float) -> Findings:
    usual = {"width": 320, "height": 240, "side_px": 160.0, "blur_px": 0.8, "noise": 0.0, "seed": seed}
    made = Phone(**{**usual, **phone})  # type: ignore[arg-type]
    grabs = shown(sending_of(b"Hello from a laptop", None, 16, 10.0), 3.5, cell_px=8)
    write_phone_film(path, darkened(phone_frames(grabs, made), white, seed), made)
    settings = screen_settings(16, 10.0)
    with open_film(path, expand_range=True) as film:
        return probe_film(film, settings.signal, settings.receive, reading=False, trials=False)


def kinds(found: Findings) -> set[str]:
    return {one.kind for seen in found.regions for one in seen.causes}


@pytest.mark.slow
def test_a_phones_film_whose_highlights_end_below_full_scale_is_told_its_exposure_alone(tmp_path: Path) -> None:
    found = probed_screen(tmp_path / "phone.mp4", 5, 235, gain=5.0)
    assert kinds(found) == {"exposure"}
    assert "lower the brightness of the screen" in found.advice[0]


@pytest.mark.slow
@pytest.mark.parametrize(("white", "phone"), [(235, {}), (90, {}), (255, {"glare": 0.5})])
def test_a_phones_film_in_good_or_weak_light_is_not_overexposed(
    white: int, phone: dict[str, float], tmp_path: Path
) -> None:
    found = probed_screen(tmp_path / "phone.mp4", 7, white, **phone)
    assert all("white blots" not in one.why for seen in found.regions for one in seen.causes)


@pytest.mark.slow
def test_an_array_whose_highlights_end_below_full_scale_is_saturated() -> None:
    film, rng = FAULTY["saturated"](), np.random.default_rng(200)

    def seen(frame: Frame) -> Frame:
        gray = frame.pixels * (200 / 255) + rng.normal(0, 1.5, frame.pixels.shape)
        return replace(frame, pixels=np.clip(np.rint(gray), 0, 255).astype(np.uint8))

    lower = KeptFilm([seen(frame) for frame in film], film.rate_hz)
    found = probe_film(lower, SignalSettings(), ReceiveSettings())
    first = found.regions[0].causes[0]
    assert first.kind == "saturated"
    assert "expose shorter" in first.advice[0]
