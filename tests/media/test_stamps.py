"""Frame rate and times from timestamps, independent of demuxer estimates, container rounding and time units."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import h5py
import numpy as np
import pytest
from film_checks import ends, form, holds
from made_recordings import write_cine
from made_videos import MS, brightness, write_video

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import create_film, open_film
from heliograph.media.stamps import StampClock, measure_pace

COUNT = 40
EVERY = range(COUNT)
TS = Fraction(1, 90_000)
BETWEEN = {"bf": "3"}
FIELDS = {"flags": "+ildct+ilme", "x264-params": "tff=1"}
UNEVEN = np.random.default_rng(0).integers(20, 60, COUNT).cumsum()
JITTER = np.round(np.arange(COUNT) * 100 / 3 + np.random.default_rng(0).normal(0, 2, COUNT) + 50).astype(int)


def times_of(path: Path, rate_hz: float | None = None) -> list[float]:
    """Return frame times; check order and completeness."""
    with open_film(path, rate_hz=rate_hz) as film:
        frames = list(film)
    levels = [float(frame.pixels.mean()) for frame in frames]
    assert levels == pytest.approx([brightness(k) for k in range(len(levels))], abs=2.9)
    assert (np.diff([frame.index for frame in frames]) > 0).all()
    return [frame.time_s for frame in frames]


EVEN_FILMS: dict[str, tuple[float, dict[str, Any]]] = {
    "between.ts": (1000, {"stamps": [90 * k for k in EVERY], "tick": TS, "options": BETWEEN}),
    "tv.ts": (240, {"stamps": [375 * k for k in EVERY], "tick": TS, "rate": 240}),
    "fields.ts": (25, {"stamps": [3600 * k for k in EVERY], "tick": TS, "rate": 25, "options": FIELDS}),
    "claims_less.ts": (1000, {"stamps": [90 * k for k in EVERY], "tick": TS, "rate": 30}),
    "claims_less.mp4": (1000, {"stamps": EVERY, "rate": 30}),
    "claims_more.nut": (100, {"stamps": [10 * k for k in EVERY], "codec": "ffv1", "rate": 1000}),
    "fine.mkv": (2000, {"stamps": EVERY, "tick": Fraction(1, 2000), "codec": "ffv1", "rate": 2000}),
    "finer.mkv": (3000, {"stamps": EVERY, "tick": Fraction(1, 3000), "codec": "ffv1", "rate": 3000}),
    "rounded.mkv": (240, {"stamps": EVERY, "tick": Fraction(1, 240), "codec": "ffv1", "rate": 240}),
    "rounded_700.mkv": (700, {"stamps": EVERY, "tick": Fraction(1, 700), "codec": "ffv1", "rate": 700}),
    "late_start.ts": (1000, {"stamps": [90 * k + 9_000_000 for k in EVERY], "tick": TS}),
    "early_start.nut": (1000, {"stamps": [k - 30 for k in EVERY], "codec": "ffv1"}),
    "between.avi": (1000, {"stamps": EVERY, "options": BETWEEN}),
    "between_mpeg4.avi": (1000, {"stamps": EVERY, "codec": "mpeg4", "options": {"bf": "2"}}),
    "alone.h264": (1000, {"stamps": EVERY, "kind": "h264", "options": BETWEEN}),
    "film.flv": (1000, {"stamps": EVERY}),
}


@pytest.mark.parametrize("name", EVEN_FILMS)
def test_even_films_have_the_rate_of_their_stamps(tmp_path: Path, name: str) -> None:
    rate, form = EVEN_FILMS[name]
    path = write_video(tmp_path / name, **form)
    with open_film(path) as film:
        assert film.rate_hz == pytest.approx(rate, rel=1e-6)
    times = times_of(path)
    assert np.diff(times) == pytest.approx([1 / rate] * (COUNT - 1), abs=1e-9)
    # a given rate numbers the frames
    assert times_of(path, 500.0) == pytest.approx(np.arange(COUNT) / 500, abs=1e-12)


@pytest.mark.parametrize(("name", "form"), [
    ("a.webm", {"stamps": UNEVEN, "codec": "libvpx", "rate": 30}),
    ("a.ts", {"stamps": 90 * UNEVEN, "tick": TS, "rate": 30}), ("a.mp4", {"stamps": UNEVEN, "rate": 30}),
    ("jitter.webm", {"stamps": JITTER, "codec": "libvpx", "rate": 30}),
])  # fmt: skip
def test_uneven_films_keep_their_stamps_until_a_rate_is_given(tmp_path: Path, name: str, form: dict[str, Any]) -> None:
    path = write_video(tmp_path / name, **{**form, "stamps": form["stamps"].tolist()})
    gaps = np.diff(form["stamps"]) * float(form.get("tick", MS))
    assert np.diff(times_of(path)) == pytest.approx(gaps, abs=1e-9)
    assert times_of(path, 30.0) == pytest.approx(np.arange(COUNT) / 30, abs=1e-12)


@pytest.mark.parametrize(("name", "tick"), [("a.mp4", MS), ("a.ts", TS), ("fine.mkv", Fraction(1, 1500))])
def test_missing_frames_leave_their_gaps(tmp_path: Path, name: str, tick: Fraction) -> None:
    numbers = [k for k in range(50) if k % 12 != 5 and k not in (20, 21)]
    rate, codec = (1500, "ffv1") if name == "fine.mkv" else (1000, "libx264")
    path = write_video(tmp_path / name, [(90 if tick == TS else 1) * k for k in numbers], tick, codec, rate)
    times = np.array(times_of(path))
    # at 1500 frames/s and 1 ms ticks, the number of an isolated frame is ambiguous
    assert times - times[0] == pytest.approx(np.array(numbers) / rate, abs=1e-9 if rate == 1000 else 1.01 / rate)
    if rate == 1000:
        assert times_of(path, 100.0) == pytest.approx(np.array(numbers) / 100, abs=1e-9)


def test_a_long_gap_does_not_change_the_rate(tmp_path: Path) -> None:
    stamps = [k + (2000 if k > 30 else 0) for k in EVERY]
    with open_film(write_video(tmp_path / "a.mp4", stamps, rate=30)) as film:
        assert [film.rate_hz, *(frame.index for frame in film)] == pytest.approx([1000, *stamps])


def test_frames_hidden_by_an_edit_list_are_not_read(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", [k - 10 for k in EVERY])
    with open_film(path) as film:
        frames = list(film)
        assert film.rate_hz == 1000
    assert [frame.time_s for frame in frames] == pytest.approx(np.arange(COUNT - 10) / 1000)
    assert frames[0].pixels.mean() == pytest.approx(brightness(10), abs=2.9)


def rewritten(path: Path, pts: Sequence[int | None]) -> Path:
    """Rewrite timestamps in a coded film."""
    target = path.with_name(f"other{path.suffix}")
    with av.open(str(path)) as source, av.open(str(target), "w") as container:
        stream = container.add_stream_from_template(source.streams.video[0])
        packets = [packet for packet in source.demux(video=0) if packet.size]
        for number, (packet, stamp) in enumerate(zip(packets, pts, strict=True)):
            packet.pts, packet.dts, packet.stream = stamp, number if stamp is None else stamp, stream
            packet.time_base = MS
            container.mux(packet)
    return target


@pytest.mark.parametrize(("name", "codec", "options"), [
    ("a.avi", "mpeg4", {"bf": "2"}), ("a.mkv", "libx265", {"x265-params": "bframes=4:log-level=none"}),
    ("a.mp4", "libx264", BETWEEN), ("a.nut", "libx264", BETWEEN),
])  # fmt: skip
def test_stamps_in_coding_order_are_sorted(tmp_path: Path, name: str, codec: str, options: dict[str, str]) -> None:
    if codec not in av.codecs_available:
        pytest.skip(f"FFmpeg lacks {codec} here")
    times = times_of(rewritten(write_video(tmp_path / name, EVERY, codec=codec, options=options), EVERY))
    assert np.diff(times) == pytest.approx([1e-3] * (COUNT - 1))


def test_two_frames_of_one_stamp_follow_each_other(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", EVERY, codec="mjpeg")
    stamps = [k - (k in (20, 30)) for k in EVERY]
    times = times_of(rewritten(path, stamps))
    assert times == pytest.approx([k / 1000 for k in EVERY], abs=1e-9)


def test_stamps_that_fall_are_an_error_unless_a_rate_is_given(tmp_path: Path) -> None:
    times, levels = np.arange(COUNT) / 1000, np.zeros((COUNT, 8, 8))
    times[25:] -= 0.02
    path = timed(tmp_path / "a.h5", times)
    assert ends(path, levels[:25], "after 25 whole frames: times must rise; correct them, or number the")
    assert holds(path, levels, np.arange(COUNT) / 500, rate_hz=500.0)


def timed(path: Path, times: Any, **attributes: Any) -> Path:
    with h5py.File(path, "w") as file:
        file["frames"], file["times_s"] = np.zeros((len(times), 8, 8), np.uint8), times
        file.attrs.update(attributes)
    return path


@pytest.mark.parametrize(("rate", "kind", "factor", "unit", "start_s"), [
    (30.0, float, 1e3, "milliseconds", 0.0), (240.0, np.int64, 1e3, "milliseconds", 1.7e9),
    (5000.0, float, 1e3, "milliseconds", 1.7e9), (30.0, np.int64, 1e6, "microseconds", 1.7e9),
    (1000.0, float, 1e6, "microseconds", 0.0), (240.0, float, 1e9, "nanoseconds", 1.7e9),
    (5000.0, np.int64, 1e9, "nanoseconds", 0.0),
])  # fmt: skip
def test_times_in_another_unit_are_reported(
    tmp_path: Path, rate: float, kind: type, factor: float, unit: str, start_s: float
) -> None:
    times: Any = ((start_s + np.arange(COUNT) / rate) * factor).astype(kind)
    path = timed(tmp_path / "a.h5", times)
    with pytest.raises(MediaError, match=rf"they look like {unit}.*; write times_s in seconds, or say .* --fps"):
        open_film(path)
    with open_film(path, rate_hz=rate) as film:
        assert [frame.time_s for frame in film] == pytest.approx(np.arange(COUNT) / rate)


@pytest.mark.parametrize(("times", "stated", "says"), [
    (np.arange(COUNT), {}, "they look like milliseconds or frame numbers; write times_s in seconds"),
    (np.arange(COUNT) * 1e3, {"rate_hz": 1e3}, r"and rate_hz says 1000\.0: they look like microseconds"),
])  # fmt: skip
def test_numbers_and_a_stated_rate_show_units(tmp_path: Path, times: Any, stated: dict[str, float], says: str) -> None:
    with pytest.raises(MediaError, match=says):
        open_film(timed(tmp_path / "a.h5", times, **stated))


@pytest.mark.parametrize("start_s", [0.0, 3e4, 1e5, 1.7e9])
def test_times_of_day_in_seconds_are_read_unless_they_lack_resolution(tmp_path: Path, start_s: float) -> None:
    path, times = tmp_path / "a.h5", start_s + np.arange(COUNT) / 1000
    with open_film(timed(path, times)) as film:
        assert film.rate_hz == pytest.approx(1000, rel=1e-3)
        assert np.diff([frame.time_s for frame in film]) == pytest.approx(1e-3, rel=1e-3)
    timed(path, times.astype(np.float32))
    if start_s:
        with pytest.raises(MediaError, match=r"times_s of float32 have a resolution of .* write them as float64"):
            open_film(path)
    assert holds(path, np.zeros((COUNT, 8, 8)), np.arange(COUNT) / 1000, rate_hz=1000.0)


@pytest.mark.parametrize(("times", "stated", "indices"), [
    (np.arange(COUNT) * 4.0, {"rate_hz": 0.25}, EVERY),
    (np.delete(np.arange(200) * 1e-3, [40, 41, 90, 150]), {}, np.delete(np.arange(200), [40, 41, 90, 150])),
])  # fmt: skip
def test_slow_films_and_missing_frames_of_unstated_rates(tmp_path: Path, times: Any, stated: Any, indices: Any) -> None:
    path = timed(tmp_path / "a.h5", times, **stated)
    assert form(path)[3] == pytest.approx(stated.get("rate_hz", 1000))
    assert holds(path, np.zeros((len(times), 8, 8)), times, indices)


def test_a_given_rate_numbers_the_frames_of_a_camera_by_its_stamps(tmp_path: Path) -> None:
    """Camera timestamps show 997 frames/s with a missing frame; the settings state 1000."""
    numbers = np.delete(np.arange(400), 200)
    levels = np.zeros((len(numbers), 4, 8), np.uint8)
    path = write_cine(tmp_path / "a.cine", list(levels), 8, 8, list(numbers / 997), 1000)
    assert holds(path, levels, indices=numbers, rate_hz=997.0)


@pytest.mark.parametrize("suffix", [".mkv", ".mp4", ".nut", ".h5"])
def test_own_films_keep_their_first_number(tmp_path: Path, suffix: str) -> None:
    """The given rate replaces the rate of a film in slow motion; gaps stay."""
    path, numbers = tmp_path / f"a{suffix}", [5, 6, 7, 9, 10]
    with create_film(path, width=16, height=16, rate_hz=25) as made:
        for number in numbers:
            made.write(Frame(number, number / 25, np.full((16, 16), 20 * number, np.uint8)))
    with open_film(path, rate_hz=1000) as film:
        frames = list(film)
        assert (film.rate_hz, film.claimed_hz) == (1000, 25)
    assert [frame.index for frame in frames] == numbers
    assert [frame.time_s for frame in frames] == pytest.approx(np.array(numbers) / 1000, abs=1e-6)


def test_rate_with_gaps_of_full_periods_is_even() -> None:
    even, uneven = measure_pace([0, 1, 2, 4, 5, 6, 9, 10]), measure_pace(UNEVEN / 1000)
    assert even is not None
    assert uneven is not None
    assert (even.rate_hz, even.is_even, uneven.is_even) == (1, True, False)
    assert (measure_pace([0, 0, 0]), measure_pace([3, 2, 1])) == (None, None)


def test_constant_stamps_have_the_stated_rate() -> None:
    clock = StampClock([0.0] * 5, 1e-3, [50.0])
    assert [clock.time(0.0, 0.0) for _ in range(5)] == pytest.approx(np.arange(5) / 50)
