"""Real footage and real shake: stated link performance holds, and empty scenes give no packets."""

from collections import deque
from pathlib import Path

import pytest

from heliograph.base.errors import MediaError
from heliograph.experiments.error_rates import real_input
from heliograph.experiments.error_rates.real_input import EmptyCounts, RealScene
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import open_film

CLIPS = ("day-motorway", "day-shade", "night-road")

READ_FROM = {75: ("high",), 52: ("high", "middle"), 45: ("high", "middle", "low")}
"""Layers with all codewords decoded, by start distance of the drive in m."""

FILMED_MARGIN_PX = 16
"""Film only the array and a margin, for speed."""

NATIVE_FRAMES = 20
MOST_NATIVE_DETECTIONS = 1
"""Per 20 frames. A false detection costs little time, but a valid codeword from noise is a wrong message."""

SMALL = (
    "channel.camera.width=192",
    "channel.camera.height=160",
    "channel.arrays.0.x_m=0",
    "channel.arrays.0.y_m=0",
)


def scene(data: Path, clip: str, seed: int, *changes: str) -> RealScene:
    return RealScene(data / "driving" / f"{clip}.mp4", data / "motion" / "car-imu.csv", seed, changes)


@pytest.mark.real_data
@pytest.mark.parametrize("distance_m", READ_FROM)
@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.slow
def test_layers_are_read_over_real_footage_and_shake(data: Path, clip: str, distance_m: int) -> None:
    drive = scene(data, clip, 1, f"channel.distance_m={distance_m}", "channel.duration_s=0.35")
    errors = real_input.drive(drive, FILMED_MARGIN_PX).errors
    total = errors.total()
    # three packets are completely filmed
    assert {n: e.codewords for n, e in total.items()} == {"high": 3, "middle": 6, "low": 3}
    assert {n: total[n].codeword_errors for n in READ_FROM[distance_m]} == dict.fromkeys(READ_FROM[distance_m], 0)
    assert errors.false_codewords == 0


@pytest.mark.real_data
@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.slow
def test_a_clip_played_natively_has_no_packet(data: Path, clip: str) -> None:
    # short packets, so that a packet from a false detection ends within the clip
    small = ("signal.data_pairs=8", "channel.camera.width=480", "channel.camera.height=270")
    found = real_input.empty(scene(data, clip, 3, *small), NATIVE_FRAMES, native=True)
    assert found.frames == NATIVE_FRAMES
    assert (found.right, found.words) == (0, 0)
    assert found.detections <= MOST_NATIVE_DETECTIONS


@pytest.mark.real_data
@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.slow
def test_a_film_without_any_array_has_no_detection(data: Path, clip: str) -> None:
    found = real_input.empty(scene(data, clip, 3, "channel.duration_s=0.1"))
    assert found.frames == 100
    assert (found.right, found.words) == (0, 0)
    assert found.detections == 0


def test_counts_of_empty_films_add_up() -> None:
    one = EmptyCounts(100, 1, 1, 0, 2, 3)
    total = one + one
    assert (total.frames, total.detections, total.words, total.without_header) == (200, 2, 4, 6)
    assert "0/200 (< 1.5e-02) packets with a right codeword" in total.text()


@pytest.mark.slow
def test_a_lossy_film_gives_high_and_middle_layers(tmp_path: Path) -> None:
    settings = load_settings("paper", None, ["channel.distance_m=38", "channel.duration_s=0.31", *SMALL])
    path = tmp_path / "lossy.mp4"
    write_film(path, settings, default_messages(settings), 5, crf=18)
    reception = Reception(open_truth(truth_path(path)))
    with open_film(path) as film:
        deque(receive_film(film, settings.signal, settings, reception), maxlen=0)
    assert reception.errors is not None
    words = {n: e.words for n, e in reception.errors.total().items()}
    assert [(words[n].trials, words[n].errors) for n in ("high", "middle")] == [(3, 0), (6, 0)]
    assert reception.errors.false_codewords == 0


def test_a_film_encoded_again_is_read_against_its_own_truth(tmp_path: Path) -> None:
    settings = load_settings("static", None, ["channel.distance_m=30", "channel.duration_s=0.11", *SMALL])
    film, again = tmp_path / "film.mp4", tmp_path / "again.mp4"
    write_film(film, settings, default_messages(settings), 5, lossless=True)
    with pytest.raises(MediaError, match="is the film itself"):
        real_input.encode_again(film, film)
    real_input.encode_again(film, again)
    assert again.stat().st_size < film.stat().st_size
    reception = real_input.receive_again(again, open_truth(truth_path(film)))
    assert reception.errors is not None
    lines = list(real_input.error_lines(reception.errors))
    assert lines[0] == "30-35 m: high 0/1, middle 0/2, low 0/1"
    assert lines[-1] == "false codewords 0, false packets 0"
