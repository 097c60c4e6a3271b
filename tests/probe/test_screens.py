"""Diagnose screen films with a single fault each; a good film has no fault."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from faulty_films import KeptFilm
from scenes import film, link
from screen_films import Phone, phone_frames
from screen_light import shown

from heliograph.base.frames import Frame
from heliograph.link.settings import load_settings
from heliograph.probe import Findings, probe_film
from heliograph.probe.screens import screen_cause
from heliograph.probe.words import in_sentences, lines
from heliograph.web.sending import screen_settings, sending_of

pytestmark = pytest.mark.slow


def filmed(rate_hz: float = 10.0, side: int = 16, seconds: float = 3.5, **changes: float) -> list[Frame]:
    usual = {"width": 320, "height": 240, "side_px": 160.0, "blur_px": 0.8, "seed": 5}
    grabs = shown(sending_of(b"Hello from a laptop", None, side, rate_hz), seconds, cell_px=8)
    pictures = phone_frames(grabs, Phone(**{**usual, **changes}))  # type: ignore[arg-type]
    return [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(pictures)]


@cache
def good() -> list[Frame]:
    """Film 8 s of a screen without a fault; tests use parts."""
    return filmed(seconds=8.0)


def probed(frames: list[Frame], side: int = 16, rate_hz: float = 10.0) -> Findings:
    settings = screen_settings(side, rate_hz)
    return probe_film(KeptFilm(frames, 30.0), settings.signal, settings.receive, reading=False, trials=False)


def kinds(found: Findings) -> list[str]:
    return [cause.kind for causes in (*(region.causes for region in found.regions), found.causes) for cause in causes]


FAULTS: dict[str, tuple[dict[str, float], str]] = {
    "focus": ({"blur_px": 7.0}, "blurred by 1.1 cells"),
    "resolution": ({"side_px": 45.0}, "a cell has 2.3 px"),
    "glare": ({"glare": 0.6}, "on a bright ground"),
    "exposure": ({"gain": 5.0}, "white blots"),
    "motion": ({"shake_px": 20.0}, "move in the picture"),
    "angle": ({"turn_deg": 58.0}, "from a side"),
    "sight": ({"off_px": 120.0}, "the picture's border"),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_film_with_a_fault_has_this_cause_only(kind: str) -> None:
    changes, why = FAULTS[kind]
    found = probed(filmed(10.0, 16, **changes))
    assert kinds(found) == [kind]
    (line,) = in_sentences(found)
    assert line.startswith(f"{kind.capitalize()}: ")
    assert why in line
    assert any(f"{kind}: " in text for text in lines(found))  # the command prints the same
    assert found.advice


def test_other_faults_have_their_causes() -> None:
    """A dark screen has no glare; an array near the border is cut; a film may be shorter than a packet."""
    assert kinds(probed(filmed(gain=0.03))) == ["exposure"]
    cut = [replace(frame, pixels=frame.pixels[50:200, 92:236].copy()) for frame in good()[:104]]
    assert (kinds(probed(cut)), kinds(probed(good()[:45]))) == (["sight"], ["unread", "short"])


def test_rate_above_half_the_frame_rate_is_too_high() -> None:
    (region,) = probed(filmed(20.0)).regions
    assert [cause.kind for cause in region.causes] == ["rate"]
    assert "1.5 frames" in region.causes[0].why


@pytest.mark.parametrize(("shown_side", "side"), [(20, 16), (16, 32)])
def test_other_number_of_cells_is_recognised(shown_side: int, side: int) -> None:
    (region,) = probed(filmed(side=shown_side), side).regions
    (cause,) = (cause for cause in region.causes if cause.kind == "cells")
    assert f"shows {shown_side} x {shown_side} cells" in cause.why


@pytest.mark.parametrize(("side", "rate_hz", "changes"), [
    (16, 15.0, {"glare": 0.3, "seconds": 2.5}), (16, 10.0, {"shake_px": 6.0}), (16, 10.0, {"turn_deg": 40.0}),
    (16, 10.0, {"gain": 1.5, "seconds": 5.0}), (16, 10.0, {"noise": 40.0}), (16, 10.0, {"blur_px": 3.5}),
    (16, 10.0, {"side_px": 105.0}), (32, 10.0, {"width": 480, "height": 360, "side_px": 320.0}),
])  # fmt: skip
def test_film_without_a_fault_has_no_cause_but_unread(side: int, rate_hz: float, changes: dict[str, float]) -> None:
    found = probed(filmed(rate_hz, side, **changes), side, rate_hz)
    assert kinds(found) == ["unread"]
    assert "follow a clock" in found.regions[0].causes[0].why


def test_data_without_a_header_are_not_weak() -> None:
    assert not {"glare", "exposure"} & set(kinds(probed(good()[30:62])))


def test_uneven_patterns_have_no_clock() -> None:
    rng = np.random.default_rng(3)
    numbers = np.cumsum(rng.choice([1, 1, 2, 4], 210))
    uneven = [good()[k] for k in numbers if k < 210]
    found = probed([replace(frame, index=k, time_s=k / 30) for k, frame in enumerate(uneven)])
    assert "no even clock" in found.regions[0].causes[0].why


@pytest.mark.parametrize(("level", "expected"), [
    (240, ["exposure", "sight"]), (6, ["exposure", "sight"]), (90, ["sight"])
])  # fmt: skip
def test_picture_without_patterns_has_its_cause(level: int, expected: list[str]) -> None:
    pixels = np.random.default_rng(level).integers(level - 5, level + 5, (96, 120, 160), np.uint8)
    frames = [Frame(k, k / 30, picture) for k, picture in enumerate(pixels)]
    assert kinds(probed(frames)) == expected
    assert screen_cause(frames, 30.0) is None


def test_decoded_screen_has_no_cause() -> None:
    settings = screen_settings(16, 10.0)
    found = probe_film(KeptFilm(good(), 30.0), settings.signal, settings.receive, trials=False)
    assert (found.read, found.regions, found.causes) == (True, (), ())
    assert "light: not measured, as an array is read" in lines(found)


@pytest.mark.parametrize(
    ("preset", "side", "fps", "changes"),
    [
        ("phone-15", 8, 30.0, {"rate_hz": 15.0}),
        ("phone-240", 8, 240.0,
         {"rate_hz": 60.0, "seconds": 1.6, "readout_s": 0.003, "exposure_s": 0.002, "jitter_s": 0.0002}),
        ("phone-slow", 16, 30.0, {"rate_hz": 2.0, "seconds": 12.0}),
    ],
)  # fmt: skip
def test_screen_in_place_of_an_array_is_named(preset: str, side: int, fps: float, changes: dict[str, float]) -> None:
    settings = load_settings("paper")
    film = KeptFilm(filmed(side=side, fps=fps, **changes), fps)
    found = probe_film(film, settings.signal, settings.receive, reading=False)
    assert kinds(found) == ["screen"]
    assert f"{side} x {side} cells, {changes['rate_hz']:g} patterns a second" in found.causes[0].why
    size = " --set signal.side=8" if side == 8 else ""
    assert found.advice == [f"read it by --preset {preset}{size}, which chooses --receiver screen"]


@pytest.mark.parametrize(("distance_m", "fps"), [(4.0, 4000), (8.0, 1000), (30.0, 2000)])
def test_led_array_is_no_screen_at_any_claimed_rate(distance_m: float, fps: int) -> None:
    changes = f"channel.camera.fps={fps}", f"channel.camera.exposure_s={1 / max(fps, 1000)}"
    frames = film(link(*changes, distance_m=distance_m), 64)
    for claimed_hz in (30.0, 120.0):
        stamped = [replace(frame, time_s=k / claimed_hz) for k, frame in enumerate(frames)]
        assert screen_cause(stamped, claimed_hz) is None
