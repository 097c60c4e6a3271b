"""Probe a complete film frame by frame; an early end keeps the results."""

import json
import re
import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty_films import KeptFilm, film, kept, link

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.probe import Findings, probe_film
from heliograph.probe.activity import MOST_FRAMES
from heliograph.probe.arrays import ArrayWatch
from heliograph.probe.page import write_page
from heliograph.probe.words import as_mapping, in_short, lines
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

pytestmark = pytest.mark.slow


def probed(source: Any, **options: Any) -> Findings:
    return probe_film(source, SignalSettings(), ReceiveSettings(), **options)


@pytest.fixture(scope="module")
def right() -> KeptFilm:
    return kept(link())


@pytest.fixture(scope="module")
def found(right: KeptFilm) -> Findings:
    return probed(right)


@dataclass
class Broken(KeptFilm):
    """Film that raises an error after some frames."""

    error: BaseException = field(default_factory=lambda: MediaError("the film ends in the middle"))
    count: int = 0

    def __iter__(self) -> Iterator[Frame]:
        yield from self.frames[: self.count]
        raise self.error


@dataclass
class Repeated(KeptFilm):
    """Film that repeats a packet up to any length, with frames made on request."""

    length: int = 0
    alive: list[int] = field(default_factory=list)

    @property
    def frame_count(self) -> int:
        return self.length

    def __iter__(self) -> Iterator[Frame]:
        made: list[Any] = []
        for number in range(self.length):
            frame = self.frames[number % len(self.frames)]
            pixels = frame.pixels.copy()
            made.append(weakref.ref(pixels))
            yield replace(frame, index=number, time_s=number / 1000, pixels=pixels)
            if number % 75 == 74:
                self.alive.append(sum(pixels() is not None for pixels in made))


def test_broken_film_keeps_the_results_so_far(right: KeptFilm) -> None:
    film = Broken(right.frames, count=120)
    findings = probed(film)
    assert findings.broken == "the film ends in the middle"
    assert findings.read
    assert findings.times.count == 120


def test_ctrl_c_during_the_analysis_keeps_the_rest(right: KeptFilm, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("heliograph.probe.film.light_rate", interrupt)
    findings = probed(right)
    assert findings.broken == "interrupted"
    assert findings.read
    assert "codewords read: high" in "\n".join(lines(findings))


def test_film_without_frames_is_an_error(right: KeptFilm) -> None:
    for source, says in ((Broken(right.frames), "ends in the middle"), (KeptFilm([]), "holds no frames")):
        with pytest.raises(MediaError, match=says):
            probed(source)


def test_memory_does_not_grow_with_the_film() -> None:
    source = Repeated(film(link(duration_s=0.2, camera={"width": 48, "height": 48})), length=1000)
    findings = probed(source)
    assert (findings.arrays[0].tally.packets, findings.times.count) == (10, 1000)
    # two stretches, and the receiver's frames of a packet
    assert max(source.alive) < 2 * MOST_FRAMES + 150


def test_number_of_stored_packets_is_bounded(found: Findings) -> None:
    watch, packet = ArrayWatch(SignalSettings(), None), found.arrays[0].packet
    limit = watch.places.maxlen or 0
    for number in range(limit + 100):
        watch.add(replace(packet, first_frame=100 * number, last_frame=100 * number + 99))
    assert (watch.reports(255)[packet.identity].tally.packets, len(watch.places)) == (limit + 100, limit)


def test_array_is_found_by_its_region_without_a_receiver(right: KeptFilm, tmp_path: Path) -> None:
    findings = probed(right, reading=False)
    (region, *_) = findings.regions
    assert (findings.read, region.causes[0].proven) == (False, True)
    assert region.remedy is not None
    write_page(tmp_path / "probe.html", findings)
    page = (tmp_path / "probe.html").read_text()
    for text in ("No array was read", "Region 1: search", "What to change", "--crop "):
        assert text in page
    assert any("--crop " in line for line in in_short(findings))
    assert probed(right, most=40, trials=False).times.count == 40


@pytest.mark.parametrize(("pixels", "kinds"), [
    ([np.full((16, 16), 9, np.uint8)], {"short", "dark"}), ([np.zeros((16, 16), np.uint8)] * 150, {"still", "dark"}),
    ([np.full((16, 16), 255, np.uint8)] * 150, {"still", "overexposed"}),
    ([*np.random.default_rng(1).integers(60, 64, (150, 3, 5)).astype(np.uint8)], {"still"}),
], ids=["one frame", "black", "white", "tiny"])  # fmt: skip
def test_films_without_light_have_causes(pixels: list[Any], kinds: set[str]) -> None:
    findings = probed(KeptFilm([Frame(k, k / 1000, picture) for k, picture in enumerate(pixels)]))
    assert not findings.read
    assert {cause.kind for cause in findings.causes} == kinds
    assert "no array found" in list(lines(findings))


def test_findings_are_plain_values(found: Findings) -> None:
    row = json.loads(json.dumps(as_mapping(found)))
    (array,) = row["arrays"]
    assert (row["array_read"], row["light"]["camera_hz"]) == (True, pytest.approx(1000, rel=5e-3))
    assert (array["codewords"]["high"], array["orientation"]) == ({"ok": 1, "failed": 0}, "upright")
    assert row["regions"][0]["causes"][0]["kind"] == "array"


def test_background_noise_replaces_the_noise_of_saturated_leds(found: Findings) -> None:
    near = probed(kept(link(distance_m=25.0)))
    assert near.arrays[0].clipped
    assert not found.arrays[0].clipped
    # both films give the same predicted range
    for receiver, distances_m in found.arrays[0].reach.items():
        assert near.arrays[0].reach[receiver] == pytest.approx(distances_m, rel=0.1)
    assert as_mapping(near)["arrays"][0]["noise"]["lit"] is None
    assert any("noise of a pixel: unknown within, as some are at full scale" in line for line in lines(near))


def test_page_shows_the_film_and_its_arrays_in_one_file(found: Findings, tmp_path: Path) -> None:
    write_page(tmp_path / "probe.html", found)
    page = (tmp_path / "probe.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == 3
    # table of contents links stay within the page
    assert not re.findall(r"""(?:src|href)=["']?(?!["']?data:|#part-)""", page)
    for text in ("Read with the settings as they are: array 0 (upright)", "130 frames of 160x120 px", "stamps",
                 "array 0: upright, 1 packet", "codewords read: high 1 of 1", "plain expected to read"):  # fmt: skip
        assert text in page
    assert [file.name for file in tmp_path.iterdir()] == ["probe.html"]
    with pytest.raises(MediaError):
        write_page(tmp_path / "no" / "probe.html", found)
