"""Diagnose screen films with a single fault each; a good film has no fault."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
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


@dataclass(frozen=True)
class Kept:
    """In-memory film."""

    frames: list[Frame]
    rate_hz: float = 30.0
    path: str = "phone.mp4"

    @property
    def frame_count(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        yield from self.frames


def filmed(rate_hz: float = 10.0, side: int = 16, seconds: float = 3.5, **phone: float) -> list[Frame]:
    usual = {"width": 320, "height": 240, "side_px": 160.0, "blur_px": 0.8, "seed": 5}
    grabs = shown(sending_of(b"Hello from a laptop", None, side, rate_hz), seconds, cell_px=8)
    seen = phone_frames(grabs, Phone(**{**usual, **phone}))  # type: ignore[arg-type]
    return [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(seen)]


def probed(frames: list[Frame], side: int = 16, rate_hz: float = 10.0) -> Findings:
    settings = screen_settings(side, rate_hz)
    return probe_film(Kept(frames), settings.signal, settings.receive, reading=False, trials=False)


def kinds(found: Findings) -> list[str]:
    return [*(one.kind for seen in found.regions for one in seen.causes), *(one.kind for one in found.causes)]


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
def test_one_fault_is_told_by_its_name_alone(kind: str) -> None:
    phone, why = FAULTS[kind]
    found = probed(filmed(10.0, 16, **phone))
    assert kinds(found) == [kind]
    (line,) = in_sentences(found)
    assert line.startswith(f"{kind.capitalize()}: ")
    assert why in line
    assert any(f"{kind}: " in one for one in lines(found))  # the command prints the same
    assert found.advice


def test_a_dark_screen_is_no_glare() -> None:
    assert kinds(probed(filmed(gain=0.03))) == ["exposure"]


def test_an_array_that_nearly_reaches_the_border_is_cut() -> None:
    frames = [replace(one, pixels=one.pixels[50:200, 92:236].copy()) for one in filmed()]
    assert kinds(probed(frames)) == ["sight"]


@pytest.mark.parametrize(("rate_hz", "why"), [(20.0, "1.5 frames"), (22.0, "1.4 frames")])
def test_a_rate_that_is_too_high_is_told(rate_hz: float, why: str) -> None:
    (seen,) = probed(filmed(rate_hz)).regions
    assert [one.kind for one in seen.causes] == ["rate"]
    assert why in seen.causes[0].why


@pytest.mark.parametrize(("shown_side", "asked"), [(20, 16), (8, 16), (16, 32)])
def test_another_number_of_cells_is_told(shown_side: int, asked: int) -> None:
    (seen,) = probed(filmed(side=shown_side), asked).regions
    assert "cells" in [one.kind for one in seen.causes]
    assert f"shows {shown_side} x {shown_side} cells" in " ".join(one.why for one in seen.causes)


@pytest.mark.parametrize(
    ("side", "rate_hz", "phone"),
    [
        (16, 10.0, {}),
        (16, 15.0, {}),
        (16, 10.0, {"shake_px": 6.0}),
        (16, 10.0, {"turn_deg": 40.0}),
        (16, 10.0, {"glare": 0.3}),
        (16, 10.0, {"gain": 1.5, "seconds": 5.0}),
        (16, 10.0, {"noise": 40.0}),
        (16, 10.0, {"blur_px": 3.5}),
        (16, 10.0, {"side_px": 105.0}),
        (16, 10.0, {"width": 640, "height": 480, "side_px": 420.0}),
        (32, 10.0, {"width": 640, "height": 480, "side_px": 400.0}),
    ],
)
def test_a_sound_film_is_blamed_for_nothing(side: int, rate_hz: float, phone: dict[str, float]) -> None:
    found = probed(filmed(rate_hz, side, **phone), side, rate_hz)
    assert kinds(found) == ["unread"]
    assert "follow a clock" in found.regions[0].causes[0].why


def test_patterns_without_a_clock_are_told_so() -> None:
    rng = np.random.default_rng(3)
    frames = filmed(seconds=7.0)
    some = np.cumsum(rng.choice([1, 1, 2, 4], len(frames)))
    uneven = [frames[k] for k in some if k < len(frames)]
    found = probed([Frame(k, k / 30, one.pixels) for k, one in enumerate(uneven)])
    assert "no even clock" in found.regions[0].causes[0].why


@pytest.mark.parametrize(("level", "told"), [(240, ["exposure", "sight"]), (6, ["exposure", "sight"]), (90, ["sight"])])
def test_a_picture_without_patterns_is_told_so(level: int, told: list[str]) -> None:
    rng = np.random.default_rng(level)
    frames = [Frame(k, k / 30, rng.integers(level - 5, level + 5, (120, 160), np.uint8)) for k in range(96)]
    assert kinds(probed(frames)) == told


def test_a_film_that_is_too_short_is_told_so() -> None:
    assert kinds(probed(filmed(seconds=1.5))) == ["unread", "short"]


def test_a_screen_that_is_read_is_not_asked_why() -> None:
    settings = screen_settings(16, 10.0)
    found = probe_film(Kept(filmed(seconds=8.0)), settings.signal, settings.receive, trials=False)
    assert found.read
    assert not found.regions
    assert not found.causes
    assert "light: not measured, as an array is read" in lines(found)


SCREENS: dict[str, dict[str, float]] = {
    "phone": {"rate_hz": 10.0},
    "phone-15": {"rate_hz": 15.0},
    "phone-60": {"rate_hz": 30.0, "fps": 60.0, "seconds": 3.0, "readout_s": 0.012, "exposure_s": 0.008},
    "phone-240": {"rate_hz": 60.0, "fps": 240.0, "seconds": 1.6, "readout_s": 0.003, "exposure_s": 0.002,
                  "jitter_s": 0.0002},
    "phone-slow": {"rate_hz": 2.0, "seconds": 12.0},
}  # fmt: skip


@pytest.mark.parametrize(("preset", "side"), list(zip(SCREENS, (16, 8, 16, 8, 16), strict=True)))
def test_a_screen_that_was_to_be_read_as_an_array_is_recognised(preset: str, side: int) -> None:
    settings, seen = load_settings("paper"), SCREENS[preset]
    shown_film = Kept(filmed(side=side, **seen), seen.get("fps", 30.0))
    found = probe_film(shown_film, settings.signal, settings.receive, reading=False)
    assert kinds(found) == ["screen"]
    assert f"{side} x {side} cells, {seen['rate_hz']:g} patterns a second" in found.causes[0].why
    size = " --set signal.side=8" if side == 8 else ""
    assert found.advice == [f"read it by --preset {preset}{size}, which chooses --receiver screen"]


@pytest.mark.parametrize(("distance_m", "fps"), [(4.0, 4000), (8.0, 1000), (8.0, 2000), (30.0, 2000)])
def test_an_array_of_leds_is_no_screen_whatever_rate_its_film_claims(distance_m: float, fps: int) -> None:
    changes = f"channel.camera.fps={fps}", f"channel.camera.exposure_s={1 / max(fps, 1000)}"
    frames = film(link(*changes, distance_m=distance_m), 64)
    for claimed_hz in (30.0, 120.0):
        stamped = [replace(one, time_s=k / claimed_hz) for k, one in enumerate(frames)]
        assert screen_cause(stamped, claimed_hz) is None


def test_noise_is_no_screen() -> None:
    rng = np.random.default_rng(3)
    assert (
        screen_cause([Frame(k, k / 30, rng.integers(90, 110, (120, 160), np.uint8)) for k in range(96)], 30.0) is None
    )
