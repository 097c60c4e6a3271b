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
from faulty_films import FAULTY, KeptFilm, film, kept, link

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.probe import Findings, probe_film
from heliograph.probe.activity import MOST_FRAMES
from heliograph.probe.arrays import MOST_PLACES, ArrayWatch
from heliograph.probe.page import write_page
from heliograph.probe.words import as_mapping, in_short, lines
from heliograph.receive import Packet, ReceiveSettings, receive_frames
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
class Breaking(KeptFilm):
    """Film that raises an error after some frames."""

    error: BaseException = field(default_factory=lambda: MediaError("the film ends in the middle"))
    whole: int = 0

    def __iter__(self) -> Iterator[Frame]:
        yield from self.frames[: self.whole]
        raise self.error


@dataclass
class Repeating(KeptFilm):
    """Film that repeats a packet up to any length, with frames made on request."""

    length: int = 0
    alive: list[int] = field(default_factory=list)

    @property
    def frame_count(self) -> int:
        return self.length

    def __iter__(self) -> Iterator[Frame]:
        given: list[Any] = []
        for number in range(self.length):
            frame = self.frames[number % len(self.frames)]
            pixels = frame.pixels.copy()
            given.append(weakref.ref(pixels))
            yield replace(frame, index=number, time_s=number / 1000, pixels=pixels)
            if number % 75 == 74:
                self.alive.append(sum(one() is not None for one in given))


@pytest.mark.parametrize("error", [MediaError("the film ends in the middle"), KeyboardInterrupt()])
def test_what_breaks_off_keeps_what_was_found(right: KeptFilm, error: BaseException) -> None:
    told = probed(Breaking(right.frames, error=error, whole=120))
    assert told.broken is error
    assert told.read
    assert told.times.count == 120


def test_ctrl_c_while_regions_are_looked_into_keeps_the_rest(right: KeptFilm, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("heliograph.probe.film.light_rate", interrupted)
    told = probed(right)
    assert isinstance(told.broken, KeyboardInterrupt)
    assert told.read
    assert "codewords read: high" in "\n".join(lines(told))


def test_a_film_that_breaks_at_once_or_is_empty_is_an_error(right: KeptFilm) -> None:
    with pytest.raises(MediaError, match="ends in the middle"):
        probed(Breaking(right.frames, whole=0))
    with pytest.raises(MediaError, match="holds no frames"):
        probed(KeptFilm([]))


def test_of_a_long_film_no_more_frames_are_kept_than_of_a_short_one() -> None:
    source = Repeating(film(link(duration_s=0.2, camera={"width": 48, "height": 48})), length=1500)
    told = probed(source)
    assert told.arrays[0].packets == 15
    assert told.times.count == 1500
    # two stretches, and the receiver's frames of a packet
    assert max(source.alive) < 2 * MOST_FRAMES + 150


def test_of_a_long_film_no_more_packets_are_kept() -> None:
    watch, packet = ArrayWatch(), probed_packet()
    for number in range(MOST_PLACES + 100):
        watch.add(replace(packet, first_frame=100 * number, last_frame=100 * number + 99))
    (array,) = watch.arrays(255)
    assert array.packets == MOST_PLACES + 100
    assert len(watch._places) == MOST_PLACES


def probed_packet() -> Packet:
    return next(iter(receive_frames(film(link(duration_s=0.11)), SignalSettings())))


def test_so_many_frames_and_no_more(right: KeptFilm) -> None:
    assert probed(right, most=40).times.count == 40


def test_without_a_receiver_the_array_is_still_told_by_its_region(right: KeptFilm) -> None:
    told = probed(right, reading=False)
    assert not told.read
    assert told.regions[0].remedy is not None
    assert told.regions[0].causes[0].proven


@pytest.mark.parametrize(
    ("pixels", "kinds"),
    [
        ([np.full((16, 16), 9, np.uint8)], {"short", "dark"}),
        ([np.zeros((16, 16), np.uint8)] * 150, {"still", "dark"}),
        ([np.full((16, 16), 255, np.uint8)] * 150, {"still", "overexposed"}),
        ([*np.random.default_rng(1).integers(60, 64, (150, 3, 5)).astype(np.uint8)], {"still"}),
    ],
    ids=["one frame", "black", "white", "tiny"],
)
def test_films_that_show_nothing_are_told_so(pixels: list[Any], kinds: set[str]) -> None:
    told = probed(KeptFilm([Frame(k, k / 1000, one) for k, one in enumerate(pixels)]))
    assert not told.read
    assert {cause.kind for cause in told.causes} == kinds
    assert "no array found" in list(lines(told))


def test_all_of_it_is_plain_values(found: Findings) -> None:
    row = json.loads(json.dumps(as_mapping(found)))
    assert row["array_read"]
    assert row["light"]["camera_hz"] == pytest.approx(1000, rel=5e-3)
    assert row["arrays"][0]["codewords"]["high"] == {"ok": 1, "failed": 0}
    assert row["regions"][0]["causes"][0]["kind"] == "array"


def test_where_leds_are_at_full_scale_the_noise_beside_the_array_stands_for_it() -> None:
    near, far = (probed(kept(link(distance_m=distance))) for distance in (25.0, 50.0))
    assert near.arrays[0].clipped
    assert not far.arrays[0].clipped
    # both films give the same predicted range
    for one, other in zip(near.arrays[0].reach, far.arrays[0].reach, strict=True):
        assert one.distance_m == pytest.approx(other.distance_m, rel=0.1)
    assert as_mapping(near)["arrays"][0]["noise"]["lit"] is None
    assert any("noise of a pixel: unknown within, as some are at full scale" in line for line in lines(near))


def test_the_page_fetches_nothing_and_says_what_the_command_says(found: Findings, tmp_path: Path) -> None:
    write_page(tmp_path / "probe.html", found)
    page = (tmp_path / "probe.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    # table of contents links stay within the page
    assert not re.findall(r"""(?:src|href)=["']?(?!["']?data:|#part-)""", page)
    assert "Read with the settings as they are: array 0 (upright)" in page
    assert "plain" in page
    assert [one.name for one in tmp_path.iterdir()] == ["probe.html"]


def test_the_page_of_a_film_in_which_nothing_is_read_has_causes_and_advice(tmp_path: Path) -> None:
    told = probed(FAULTY["cut"]())
    write_page(tmp_path / "probe.html", told)
    page = (tmp_path / "probe.html").read_text()
    assert "No array was read" in page
    assert "Region 1: cut" in page
    assert "What to change" in page
    assert any("turn the camera" in line for line in in_short(told))


def test_a_page_that_cannot_be_written_is_told(found: Findings, tmp_path: Path) -> None:
    with pytest.raises(MediaError):
        write_page(tmp_path / "no" / "probe.html", found)
