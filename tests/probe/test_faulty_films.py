"""Diagnose films with a single fault each from frames only."""

from functools import cache
from typing import Any

import pytest
from faulty_films import CAMERA, FAULTY, KeptFilm, kept, link, mirrored

from heliograph.base.config import from_mapping
from heliograph.probe import Findings, probe_film
from heliograph.probe.words import array_lines, would_be_lines
from heliograph.receive.api import receive_frames
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

pytestmark = pytest.mark.slow

Place = tuple[float, ...]


def probed(film: KeptFilm, reading: bool = True, **receive: object) -> Findings:
    return probe_film(film, SignalSettings(), from_mapping(ReceiveSettings, receive), reading=reading)


@cache
def faulty(name: str) -> Findings:
    """Diagnose a film with a fault, which the receiver does not read."""
    return probed(FAULTY[name](), False, detect={"max_side_px": 48.0} if name == "too large" else {})


# film: first cause of the only region, True if confirmed by decoding, part of the reason, advice
DIAGNOSES: dict[str, tuple[str, bool, str, tuple[str, ...]]] = {
    "too small": ("too small", False, "3.4 px a side", ("longer lens",)),
    "too large": ("too large", True, "px a side; up to 48 px", ("--set receive.detect.max_side_px=80",)),
    "too dim": ("too dim", True, "2.2 % of full scale", ("expose longer", "--set receive.detect.min_contrast=0.02")),
    "saturated": ("saturated", False, "at full scale", ("expose shorter",)),
    "out of focus": ("out of focus", False, "blurred to 6.0 px", ("focus the lens",)),
    "no header": ("lamp", False, "every 6.0 frames", ("if it is a lamp",)),
    "half the rate": ("other rate", True, "lasts 2.00 frames",
                      ("--fps 2000", "signal.pattern_period_s=0.002", "--receiver soft")),
    "mislabelled": ("other rate", True, "lasts 1.00 frames", ("--fps 1000", "signal.pattern_period_s=0.033")),
    "wrong side": ("other side", True, "with 8 LEDs in a row, not with 16", ("--set signal.side=8",)),
    "moving": ("moving", False, "4.6 px a frame", ("follow it with the camera",)),
    "cut": ("cut", False, "the frame's border", ("turn the camera",)),
    "hidden": ("hidden", False, "19 px wide and 7 px high", ("complete array is in view",)),
    "other packets": ("other packets", True, "1 pairs of header and 30",
                      ("--set signal.header_pairs=1 --set signal.data_pairs=30",)),
    "out of step": ("out of step", True, "0.50 of a pattern", ("--receiver soft",)),
    "slow camera": ("slow camera", False, "lasts 0.70 frames", ()),
}  # fmt: skip


@pytest.mark.parametrize("name", DIAGNOSES)
def test_film_with_a_fault_has_its_cause_and_remedies(name: str) -> None:
    found, (kind, proven, why, advice) = faulty(name), DIAGNOSES[name]
    (region,) = found.regions
    assert (region.causes[0].kind, region.causes[0].proven) == (kind, proven), region.causes
    assert why in region.causes[0].why
    for words in advice:
        assert any(words in line for line in found.advice), found.advice


def test_film_without_blinking_light_is_still() -> None:
    found = probed(FAULTY["nothing blinks"]())
    assert (found.read, found.regions, found.causes[0].kind) == (False, (), "still")
    assert "switched on" in found.advice[0]


def test_camera_slower_than_the_light_is_a_cause_of_the_film() -> None:
    found = probe_film(FAULTY["slow camera"](), SignalSettings(), ReceiveSettings(), trials=False)
    assert [cause.kind for cause in found.causes] == ["slow camera"]
    assert "film with 1000 frames a second or more" in found.advice
    assert "one frame per pattern" in found.error


def test_decodable_film_is_measured() -> None:
    found = probed(kept(link(camera={**CAMERA, "dropped": 0.05}), mirrored))
    (array,) = found.arrays
    clock: Any = array.clock
    rate: Any = found.rate
    assert found.read
    assert (array.packet.identity, str(array.packet.orientation)) == (0, "mirrored")
    assert array.tally.last_distance_m == pytest.approx(50, abs=0.2)
    assert array.packet.pose.pitch == pytest.approx(1.1667, rel=2e-3)
    assert array.packet.pose.blur == pytest.approx(0.51, abs=0.03)
    assert array.contrast == pytest.approx(0.8, abs=0.01)
    assert [layer.failed for layer in array.tally.layers.values()] == [0, 0, 0]
    assert clock.phase_patterns == pytest.approx(0, abs=0.03)
    assert array.exposure is None  # synchronous frames all show the same part of a pattern
    assert (found.regions[0].array, rate.frames) == (array, pytest.approx(1, abs=3e-3))
    (lost,) = found.causes
    assert (lost.kind, found.times.lost) == ("lost frames", 8)
    assert "8 of 130 frames" in lost.why


def test_requested_receiver_is_kept() -> None:
    """The soft receiver reads a film out of step; its clock and exposure are measured."""
    camera = {**CAMERA, "fps": 1300.0, "exposure_s": 0.3 / 1300}
    (array,) = probed(kept(link(camera=camera, duration_s=0.2)), receiver="soft").arrays
    assert array.exposure is not None
    assert array.exposure[0] <= 0.3 <= array.exposure[1]
    assert array.exposure[1] - array.exposure[0] < 0.15
    assert any("exposure by the light: 0." in line for line in array_lines(array))


@pytest.mark.parametrize("place", [
    {"region": (0, 0, 24, 24)}, {"corners": (10.0, 10.0, 26.0, 10.0, 26.0, 26.0, 10.0, 26.0)},
])  # fmt: skip
def test_array_outside_the_given_place_is_found_elsewhere(place: dict[str, Place]) -> None:
    film, (name,) = kept(link()), place
    found = probed(film, False, detect=place)
    (cause,) = found.regions[0].causes
    assert (cause.kind, cause.proven) == ("elsewhere", True)
    assert f"--{name} {','.join(f'{n:g}' for n in place[name])}" in cause.why
    assert f"leave out --{name}, or say where it is: --region " in cause.advice[0]
    region = [int(n) for n in cause.advice[0].rpartition(" ")[2].split(",")]
    settings = from_mapping(ReceiveSettings, {"detect": {"region": region}})
    assert any(packet.has_codeword for packet in receive_frames(film.frames, SignalSettings(), settings))


def test_undecoded_region_is_described_as_an_array() -> None:
    """Pixels, blur, clock and predicted range of each layer."""
    (region,) = faulty("out of step").regions
    array: Any = region.would_be
    assert (array.pose.pitch, array.pose.blur) == (pytest.approx(1.1667, rel=0.01), pytest.approx(0.51, abs=0.05))
    assert abs(array.clock.phase_patterns) == pytest.approx(0.5, abs=0.03)
    reached = {receiver: distances_m["high"] > 80 for receiver, distances_m in array.reach.items()}
    assert reached == {"plain": True, "soft": True}
    (line, clock, *_) = would_be_lines(region)
    assert "1.16 px from LED to LED" in line
    assert "0.50 of a pattern" in clock


def test_short_exposure_out_of_step_is_decoded_by_soft() -> None:
    camera = {**CAMERA, "fps": 1300.0, "exposure_s": 0.5 / 1300}
    (region,) = probed(kept(link(camera=camera)), False).regions
    assert (region.causes[0].kind, region.causes[0].proven) == ("out of step", True)
    assert "lasts 1.30 frames" in region.causes[0].why
