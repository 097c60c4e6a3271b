"""Diagnose films with a single fault each from frames only."""

from dataclasses import dataclass
from functools import cache

import pytest
from faulty_films import FAULTY, RIGHT, SMALL, KeptFilm, blinking_square, kept, link

from heliograph.base.config import from_mapping
from heliograph.probe import Findings, probe_film
from heliograph.probe.words import array_lines, would_be_lines
from heliograph.receive import ReceiveSettings
from heliograph.signal.settings import SignalSettings

pytestmark = pytest.mark.slow


def probed(film: KeptFilm, **receive: object) -> Findings:
    return probe_film(film, SignalSettings(), from_mapping(ReceiveSettings, receive))


@cache
def faulty(name: str) -> Findings:
    """Diagnose a film with a fault."""
    return probed(FAULTY[name](), detect={"max_side_px": 48.0} if name == "too large" else {})


@dataclass(frozen=True)
class Told:
    """Expected diagnosis: first cause in the only region, True if confirmed by decoding, and advice."""

    kind: str
    proven: bool
    advice: tuple[str, ...]
    why: str = ""


TOLD = {
    "too small": Told("too small", False, ("longer lens",), "3.4 px a side"),
    "too large": Told("too large", True, ("--set receive.detect.max_side_px=80",), "px a side; up to 48 px"),
    "too dim": Told(
        "too dim", True, ("expose longer", "--set receive.detect.min_contrast=0.02"), "2.2 % of full scale"
    ),
    "saturated": Told("saturated", False, ("expose shorter",), "at full scale"),
    "out of focus": Told("out of focus", False, ("focus the lens",), "blurred to 6.0 px"),
    "no header": Told("lamp", False, ("if it is a lamp",), "every 6.0 frames"),
    "half the rate": Told(
        "other rate", True, ("--fps 2000", "signal.pattern_period_s=0.002", "--receiver soft"), "lasts 2.00 frames"
    ),
    "mislabelled": Told("other rate", True, ("--fps 1000", "signal.pattern_period_s=0.033"), "lasts 1.00 frames"),
    "wrong side": Told("other side", True, ("--set signal.side=8",), "with 8 LEDs in a row, not with 16"),
    "moving": Told("moving", False, ("follow it with the camera",), "4.6 px a frame"),
    "cut": Told("cut", False, ("turn the camera",), "the frame's border"),
    "hidden": Told("hidden", False, ("complete array is in view",), "19 px wide and 7 px high"),
    "other packets": Told(
        "other packets", True, ("--set signal.header_pairs=1 --set signal.data_pairs=30",), "1 pairs of header and 30"
    ),
    "out of step": Told("out of step", True, ("--receiver soft",), "0.50 of a pattern"),
    "slow camera": Told("slow camera", False, (), "lasts 0.70 frames"),
}


@pytest.mark.parametrize("name", TOLD)
def test_a_film_with_a_fault_is_told_it(name: str) -> None:
    found, told = faulty(name), TOLD[name]
    assert not found.read
    assert len(found.regions) == 1
    first = found.regions[0].causes[0]
    assert (first.kind, first.proven) == (told.kind, told.proven), found.regions[0].causes
    assert told.why in first.why
    for word in told.advice:
        assert any(word in line for line in found.advice), found.advice


def test_where_nothing_blinks_that_is_said() -> None:
    found = faulty("nothing blinks")
    assert not found.read
    assert not found.regions
    assert found.causes[0].kind == "still"
    assert "switched on" in found.advice[0]


def test_a_camera_slower_than_the_light_is_told_of_the_film() -> None:
    found = faulty("slow camera")
    assert [cause.kind for cause in found.causes] == ["slow camera"]
    assert "film with 1000 frames a second or more" in found.advice
    assert "one frame a pattern" in found.error


@pytest.mark.parametrize("name", RIGHT)
def test_a_right_film_is_read(name: str) -> None:
    found = probed(RIGHT[name]())
    (array,) = found.arrays
    assert found.read
    assert array.identity == 0
    assert array.orientation == ("mirrored" if name == "mirrored" else "upright")
    assert array.last_distance_m == pytest.approx(50, abs=0.2)
    assert array.pitch_px == pytest.approx(1.1667, rel=2e-3)
    assert array.blur_px == pytest.approx(0.51, abs=0.03)
    assert array.contrast == pytest.approx(0.8, abs=0.01)
    assert array.failed == {"high": 0, "middle": 0, "low": 0}
    assert array.clock is not None
    assert array.clock.phase == pytest.approx(0, abs=0.03)
    assert array.exposure is None  # synchronous frames all show the same part of a pattern
    assert found.regions[0].array == array
    assert found.rate is not None
    assert found.rate.frames == pytest.approx(1, abs=3e-3)
    lost = [cause for cause in found.causes if cause.kind == "lost frames"]
    assert bool(lost) == (name == "frames lost")
    if lost:
        assert found.times.lost == 8
        assert "8 of 130 frames" in lost[0].why


def test_a_lamp_of_another_rate_is_told_by_its_period() -> None:
    found = probed(blinking_square(5))
    assert found.regions[0].lamp_frames == pytest.approx(10, abs=0.05)
    assert "every 10.0 frames (99.88 times a second" in found.regions[0].causes[0].why


def test_orders_of_another_receiver_are_kept() -> None:
    """The soft receiver reads an asynchronous film; probe keeps the requested receiver."""
    found = probed(FAULTY["out of step"](), receiver="soft")
    (array,) = found.arrays
    assert array.clock is not None
    assert abs(array.clock.phase) == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("place", [
    {"region": (0, 0, 40, 40)}, {"corners": (10.0, 10.0, 30.0, 10.0, 30.0, 30.0, 10.0, 30.0)},
])  # fmt: skip
def test_a_place_beside_the_array_is_told_and_so_is_where_it_is(place: dict[str, tuple[float, ...]]) -> None:
    film, (name,) = RIGHT["right"](), place
    found = probed(film, detect=place)
    assert not found.read
    (cause,) = found.regions[0].causes
    assert (cause.kind, cause.proven) == ("elsewhere", True)
    assert f"--{name} {','.join(f'{n:g}' for n in place[name])}" in cause.why
    assert f"leave out --{name}, or say where it is: --region " in cause.advice[0]
    region = [int(n) for n in cause.advice[0].rpartition(" ")[2].split(",")]
    assert probed(film, detect={"region": region}).read


def test_what_a_region_would_be_as_an_array_is_told() -> None:
    """Pixels, blur, clock and predicted range of each layer."""
    (seen,) = faulty("out of step").regions
    assert seen.would_be is not None
    assert seen.would_be.pitch_px == pytest.approx(1.1667, rel=0.01)
    assert seen.would_be.blur_px == pytest.approx(0.51, abs=0.05)
    assert seen.would_be.clock is not None
    assert abs(seen.would_be.clock.phase) == pytest.approx(0.5, abs=0.03)
    assert {one.receiver: one.distance_m["high"] > 80 for one in seen.would_be.reach} == {"plain": True, "soft": True}
    (line, clock, *_) = would_be_lines(seen)
    assert "1.16 px from LED to LED" in line
    assert "0.50 of a pattern" in clock


@pytest.mark.parametrize("exposure", [0.3, 0.6])
def test_the_exposure_is_told_by_the_light_of_a_camera_out_of_step(exposure: float) -> None:
    camera = {**SMALL["camera"], "fps": 1300.0, "exposure_s": exposure / 1300}
    (array,) = probed(kept(link(camera=camera, duration_s=0.2)), receiver="soft").arrays
    assert array.exposure is not None
    assert array.exposure[0] <= exposure <= array.exposure[1]
    assert array.exposure[1] - array.exposure[0] < 0.15
    assert any("exposure by the light: 0." in line for line in array_lines(array))


def test_a_short_exposure_out_of_step_is_read_by_soft() -> None:
    camera = {**SMALL["camera"], "fps": 1300.0, "exposure_s": 0.5 / 1300}
    (seen,) = probed(kept(link(camera=camera))).regions
    assert (seen.causes[0].kind, seen.causes[0].proven) == ("out of step", True)
