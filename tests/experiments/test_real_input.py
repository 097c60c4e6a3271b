"""Real footage and real shake: stated link performance holds, and empty scenes give no packets."""

from pathlib import Path

import pytest

from heliograph.base.errors import MediaError
from heliograph.experiments.error_rates import real_input
from heliograph.experiments.error_rates.real_input import EmptyCounts, RealScene
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages
from heliograph.link.truth import open_truth, truth_path

SMALL = ("channel.camera.width=192", "channel.camera.height=160", "channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0")


def scene(data: Path, clip: str, seed: int, *changes: str) -> RealScene:
    return RealScene(data / "driving" / f"{clip}.mp4", data / "motion" / "car-imu.csv", seed, changes)


@pytest.mark.real_data
@pytest.mark.parametrize(("clip", "distance_m", "readable"), [("day-shade", 75, 1), ("night-road", 45, 3)])
@pytest.mark.slow
def test_layers_are_read_over_real_footage_and_shake(data: Path, clip: str, distance_m: int, readable: int) -> None:
    drive = scene(data, clip, 1, f"channel.distance_m={distance_m}", "channel.duration_s=0.24")
    # film only the array and a margin, for speed
    found = real_input.drive(drive, 16)
    assert found.frames == 240
    assert found.errors is not None
    total = found.errors.total()
    # two packets are completely filmed
    assert {n: e.codewords for n, e in total.items()} == {"high": 2, "middle": 4, "low": 2}
    assert [total[n].codeword_errors for n in ("high", "middle", "low")[:readable]] == [0] * readable
    assert found.errors.false_codewords == 0


@pytest.mark.real_data
@pytest.mark.parametrize(("clip", "native"), [("day-shade", False), ("night-road", True)])
@pytest.mark.slow
def test_a_clip_without_an_array_has_no_packet(data: Path, clip: str, native: bool) -> None:
    # short packets, so that a packet from a false detection ends within the clip
    small = ("signal.data_pairs=8", "channel.camera.width=480", "channel.camera.height=270")
    found = real_input.empty(
        scene(data, clip, 3, "channel.duration_s=0.04", *small), 20 if native else None, native=native
    )
    assert found.frames == (20 if native else 40)
    assert (found.right, found.words) == (0, 0)
    # a false detection of native frames costs little time, but a valid codeword from noise is a wrong message
    assert found.detections <= (1 if native else 0)


def test_counts_of_empty_films_add_up() -> None:
    one = EmptyCounts(100, 1, 1, 0, 2, 3)
    total = one + one
    assert (total.frames, total.detections, total.words, total.without_header) == (200, 2, 4, 6)
    assert "0/200 (< 1.5e-02) packets with a right codeword" in total.text()


@pytest.mark.slow
def test_a_transcoded_film_is_compared_with_the_original_truth(tmp_path: Path) -> None:
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
