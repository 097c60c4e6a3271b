"""Live cameras as films: loss, reconnection, bounded waits, end."""

import itertools
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import played_camera
import pytest
from film_checks import counts_of, refused, uniform, write_levels
from played_camera import PlayedCamera, find
from waiting import HANG_S

from heliograph.base.errors import HeliographError, MediaError, SettingsError
from heliograph.base.frames import Frame
from heliograph.media import open_film
from heliograph.media.live.camera import CameraForm, CameraKind, Picture, register_camera
from heliograph.media.live.grabber import CameraTiming, FrameQueue
from heliograph.media.live.reader import LiveReader, live_of
from heliograph.media.live.settings import CameraSettings, camera_settings

FRAMES = 60


@pytest.fixture(autouse=True)
def plugged_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(PlayedCamera, "opened", 0)
    monkeypatch.setattr(PlayedCamera, "unplugged", 0)
    monkeypatch.setattr(PlayedCamera, "pulled", None)
    register_camera("played", PlayedCamera, find)
    register_camera("odd", Odd)
    yield
    assert not [thread for thread in threading.enumerate() if thread.name == "camera"]


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """Write a film with the frame number as gray level."""
    return write_levels(tmp_path / "a.h5", uniform(range(FRAMES), 8, 12), 100)


def live(film: Path, **asked: Any) -> LiveReader:
    reader = open_film(f"camera:played:{film}", camera=asked)
    assert isinstance(reader, LiveReader)
    reader.timing = CameraTiming(retry_s=(0.02, 0.03))
    return reader


def told(film: Path, **asked: Any) -> tuple[list[Frame], list[str], LiveReader]:
    """Return frames, camera messages and reader."""
    said: list[str] = []
    with live(film, **asked) as reader:
        reader.say = said.append
        return list(reader), said, reader


def test_all_frames_come_with_numbers_times_and_form(film: Path) -> None:
    frames, said, reader = told(film)
    assert (reader.width, reader.height, reader.bits, reader.rate_hz, reader.frame_count) == (12, 8, 8, 100, None)
    assert [frame.index for frame in frames] == list(range(FRAMES))
    assert [frame.time_s for frame in frames] == pytest.approx([k / 100 for k in range(FRAMES)])
    assert all(np.array_equal(frame.pixels, np.full((8, 12), frame.index)) for frame in frames)
    assert reader.metadata["camera"] == "Played"
    assert reader.metadata["camera_gain"] == "1"
    assert said == []
    counts = counts_of(reader)
    assert (counts.frames, counts.lost, counts.dropped) == (FRAMES, 0, 0)
    assert counts.rate_hz == pytest.approx(100)


def test_lost_and_incomplete_frames_leave_gaps_and_are_counted(film: Path) -> None:
    frames, _, reader = told(film, Lost=10, Lost2=11, Broken=30)
    assert [frame.index for frame in frames] == [k for k in range(FRAMES) if k not in (10, 11, 30)]
    assert all(frame.pixels[0, 0] == frame.index for frame in frames)
    counts = counts_of(reader)
    assert (counts.lost, counts.incomplete, counts.skipped) == (2, 1, 0)


def test_stamps_replace_missing_numbers_and_the_host_clock_missing_stamps(film: Path) -> None:
    frames, _, reader = told(film, Lost=40, Numbers=0)
    assert [frame.index for frame in frames] == [k for k in range(FRAMES) if k != 40]
    counts = counts_of(reader)
    assert (counts.lost, counts.skipped, counts.host_clock) == (0, 1, False)
    frames, _, reader = told(film, Stamps=0, Speed=400)
    assert [frame.index for frame in frames] == list(range(FRAMES))
    assert counts_of(reader).host_clock


@pytest.mark.parametrize("back", [0, 1])
def test_a_camera_comes_back_after_its_cable_was_pulled(film: Path, back: int) -> None:
    frames, said, reader = told(film, Unplugged=25, Back=back)
    # the film restarts at the reconnection
    assert [int(frame.pixels[0, 0]) for frame in frames] == [*range(25), *range(FRAMES)]
    pairs = list(itertools.pairwise(frames))
    assert all(one.index < other.index and one.time_s < other.time_s for one, other in pairs)
    assert len(said) == 2 + back
    assert "is lost after 25 frames (the cable was pulled); try 1 of 6 in 0.02 s" in said[0]
    assert "is back after" in said[-1]
    counts = counts_of(reader)
    assert (counts.reconnections, counts.frames) == (1, 25 + FRAMES)


def test_a_lost_camera_ends_the_film_after_the_frames(film: Path) -> None:
    said: list[str] = []
    got: list[Frame] = []
    with live(film, Unplugged=25, Back=9, reconnect=3) as reader:
        reader.say = said.append
        with pytest.raises(MediaError, match=r"is lost after 25 frames \(it does not answer\): check cable and power"):
            got.extend(reader)
    assert [frame.index for frame in got] == list(range(25))
    tries = [line.partition("; ")[2] for line in said]
    assert tries == ["try 1 of 3 in 0.02 s", "try 2 of 3 in 0.03 s", "try 3 of 3 in 0.03 s"]


def test_frames_dropped_by_a_slow_receiver_are_counted(film: Path) -> None:
    got = []
    with live(film, Speed=400, Times=2, queue_s=0.05) as reader:
        for frame in reader:
            got.append(frame.index)
            time.sleep(0.01)
    counts = counts_of(reader)
    assert counts.dropped > 0
    assert len(got) + counts.dropped == counts.frames == 2 * FRAMES
    assert counts.lost == 0


def test_a_live_film_ends_after_its_duration(film: Path) -> None:
    began = time.monotonic()
    told(film, Speed=100, Times=0, duration_s=0.2)  # the film is endless without a duration
    assert time.monotonic() - began > 0.19


def test_another_thread_stops_a_live_film(film: Path) -> None:
    with live(film, Speed=100, Times=0) as reader:
        frames = iter(reader)
        next(frames)
        threading.Thread(target=reader.stop).start()
        list(frames)  # the film is endless without the stop


def test_a_live_film_can_be_left_and_iterated_again(film: Path) -> None:
    with live(film, Speed=100, Times=0) as reader:
        for _ in range(2):
            first = next(iter(reader))
            assert (first.index, first.time_s) == (0, 0)
    assert PlayedCamera.opened == 2
    with pytest.raises(MediaError, match="is closed"):
        iter(reader)


def test_a_live_film_is_cropped_and_rotated(film: Path) -> None:
    with open_film(f"camera:played:{film}", crop=(2, 1, 8, 4), rotate=90) as seen:
        first = next(iter(seen))
        behind = live_of(seen)
    assert first.pixels.shape == (8, 4)
    assert behind is not None
    assert behind.counts is not None


class Odd:
    """Camera with a single fault, selected by address."""

    def __init__(self, address: str):
        self._address = address

    def open(self, _settings: CameraSettings) -> CameraForm:
        if self._address == "unopened":
            raise RuntimeError("no such\nluck")
        side = 1 << 15 if self._address == "large" else 4
        return CameraForm(side, side, 8, None if self._address == "rateless" else 50.0)

    def frames(self, wait_s: float) -> list[Picture] | None:
        if self._address == "broken":
            raise RuntimeError("a fault\nof its own")
        if self._address == "empty":
            return None
        time.sleep(wait_s)
        return []

    def close(self) -> None:
        if self._address == "clinging":
            raise RuntimeError("no")


@pytest.mark.parametrize(("address", "says"), [
    ("unopened", "camera:odd:unopened cannot be opened: RuntimeError: no such luck"),
    ("rateless", "camera:odd:rateless: it does not say its rate; give it by --fps"),
    ("large", "has frames of 32768x32768 pixels"),
])  # fmt: skip
def test_unusable_cameras_are_named(address: str, says: str) -> None:
    with pytest.raises(MediaError, match=says):
        open_film(f"camera:odd:{address}")


def test_a_given_rate_replaces_a_missing_rate() -> None:
    with open_film("camera:odd:rateless", rate_hz=200) as reader:
        assert reader.rate_hz == 200


def test_an_exception_of_a_camera_is_one_line() -> None:
    assert refused(Path("camera:odd:broken"))[1] == "camera:odd:broken ended by RuntimeError: a fault of its own"


def test_a_failed_close_is_reported() -> None:
    said: list[str] = []
    with open_film("camera:odd:clinging", camera={"duration_s": 0.1}) as reader:
        assert isinstance(reader, LiveReader)
        reader.say = said.append
        assert list(reader) == []
    assert said == ["camera:odd:clinging could not be closed: RuntimeError: no"]


def test_silence_of_a_free_running_camera_is_an_error() -> None:
    with open_film("camera:odd:silent") as reader:
        assert isinstance(reader, LiveReader)
        reader.timing = CameraTiming(silent_s=0.1)
        with pytest.raises(MediaError, match="is set, but sends no frames: check"):
            list(reader)


def test_silence_of_a_trigger_is_reported_once() -> None:
    said: list[str] = []
    asked = {"trigger": "Line1", "duration_s": 0.4}
    with open_film("camera:odd:silent", rate_hz=50, camera=asked) as reader:
        assert isinstance(reader, LiveReader)
        reader.say, reader.timing = said.append, CameraTiming(silent_s=0.1)
        assert list(reader) == []
    assert said == ["camera:odd:silent: no pulse of Line1 for 0.1 s; still waiting"]


def test_a_triggered_camera_needs_a_given_rate() -> None:
    with pytest.raises(MediaError, match="its trigger sets its rate; give it by --fps"):
        open_film("camera:odd:silent", camera={"trigger": "Line1"})


@pytest.mark.parametrize(("asked", "says"), [
    (["exposure=3"], "unknown setting 'exposure'; did you mean 'exposure_us'"),
    (["exposure_us=-3"], "setting 'exposure_us': input should be greater than 0"),
    (["exposure_us=soon"], "setting 'exposure_us': input should be a valid number"),
    (["region=0,0,8"], "setting 'region"),
    (["region=0,0,8,0"], "region 0,0,8,0 has no pixels"),
    (["trigger=Software"], "trigger is a line whose pulses start exposures"),
    (["exposure_us"], "is not an assignment; write key=value"),
    (["Gain.x=3"], "a camera has no setting 'Gain.x'; its names have no dots"),
    (["reconnect=-1"], "setting 'reconnect'"),
    (["queue_s=0"], "setting 'queue_s'"),
    ("exposure_us=3", "settings of a camera are by name"),
    ({3: 4}, "a camera's setting is named by text"),
])  # fmt: skip
def test_wrong_settings(asked: Any, says: str) -> None:
    with pytest.raises(SettingsError) as caught:
        camera_settings(asked)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_from_text_and_by_name_are_the_same() -> None:
    texts = ["exposure_us=500", "region=0,4,128,64", "pixel_format=Mono12p", "trigger=Line1", "BlackLevel=1e1",
             "Lit=true"]  # fmt: skip
    by_name = {"exposure_us": 500, "region": (0, 4, 128, 64), "pixel_format": "Mono12p", "trigger": "Line1",
               "BlackLevel": "1e1", "Lit": True, "gain": None}  # fmt: skip
    settings = camera_settings(texts)
    assert settings == camera_settings(by_name)
    assert settings.region == (0, 4, 128, 64)
    assert settings.features == {"BlackLevel": "1e1", "Lit": "true"}
    assert settings.triggered
    assert not camera_settings(["trigger=off"]).triggered


def test_names_of_cameras(film: Path) -> None:
    for name, says in (
        ("camera:", "a camera is camera:KIND or camera:KIND:ADDRESS"),
        ("camera:playd:x", "unknown camera 'playd'; did you mean 'played'?"),
    ):
        with pytest.raises(HeliographError) as caught:
            open_film(name)
        assert says in str(caught.value)
    with pytest.raises(MediaError, match="is a recording: only a live camera"):
        open_film(film, camera={"gain": 3})
    with pytest.raises(SettingsError, match="is one of the package"):
        register_camera("aravis", Odd)
    assert isinstance(played_camera.find(CameraSettings()), list)
    assert CameraKind(Odd).find is None


class RefilledCamera(Odd):
    """Camera that reuses an array for ten pictures."""

    pixels, number = np.zeros((4, 4), np.uint8), 0

    def frames(self, wait_s: float) -> list[Picture] | None:  # noqa: ARG002 - the protocol's
        self.number += 1
        self.pixels[:] = self.number
        return [Picture(self.pixels, self.number)] if self.number <= 10 else None


def test_a_camera_may_reuse_its_array() -> None:
    register_camera("refilled", RefilledCamera)
    with open_film("camera:refilled") as reader:
        assert [int(frame.pixels[0, 0]) for frame in reader] == list(range(1, 11))


def frame(index: int) -> Frame:
    return Frame(index, index / 100, np.zeros((2, 2), np.uint8))


def test_frames_come_in_their_order() -> None:
    queue = FrameQueue(8)
    for index in range(5):
        queue.put(frame(index))
    queue.end()
    got = [queue.get(0) for _ in range(5)]
    assert [one and one.index for one in got] == [0, 1, 2, 3, 4]
    assert len(queue) == 0
    assert queue.get(0) is None
    assert queue.over
    assert queue.dropped == 0


def test_a_full_queue_drops_a_run_of_frames_until_half_empty() -> None:
    queue = FrameQueue(8)
    kept: list[int] = []
    for index in range(60):
        queue.put(frame(index))
        if index % 2 and (one := queue.get(0)):  # the receiver takes two frame periods per frame
            kept.append(one.index)
    kept += [one.index for one in iter(lambda: queue.get(0), None)]
    assert len(kept) + queue.dropped == 60
    gaps = [(one, other) for one, other in itertools.pairwise(kept) if other != one + 1]
    assert queue.dropped > 10
    # a full queue drops half of its frames at once, not single frames
    assert len(gaps) <= queue.dropped // 4


def test_waiting_is_bounded_and_ends_with_the_queue() -> None:
    queue = FrameQueue(2)
    began = time.monotonic()
    assert queue.get(0.05) is None
    assert time.monotonic() - began > 0.04
    threading.Timer(0.05, queue.end).start()
    assert queue.get(HANG_S) is None
    assert queue.over


@pytest.mark.parametrize("most", [1, 2, 3])
def test_a_small_queue_accepts_frames_after_it_was_full(most: int) -> None:
    queue = FrameQueue(most)
    for index in range(10):
        queue.put(frame(index))
    assert len(queue) == most
    for _ in range(most):
        queue.get(0)
    queue.put(frame(99))
    last = queue.get(0)
    assert last is not None
    assert last.index == 99
