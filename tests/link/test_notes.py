"""Film metadata: signal settings and the matching truth file."""

from dataclasses import replace
from pathlib import Path

import pytest
from scenes import link

from heliograph.base.errors import MediaError
from heliograph.link.film import write_film
from heliograph.link.simulate import simulate
from heliograph.link.truth import SIGNAL_TAG, check_truth, open_truth, signal_of
from heliograph.media import create_film, open_film


def test_the_truth_of_another_film_is_refused(tmp_path: Path) -> None:
    settings = link("channel.duration_s=0.01")
    write_film(tmp_path / "a.mkv", settings, [{}], seed=1)
    write_film(tmp_path / "b.mkv", settings, [{}], seed=1)  # films with equal settings may hold different recordings
    truth = open_truth(tmp_path / "b.mkv.truth.npz")
    with open_film(tmp_path / "b.mkv") as film:
        check_truth(film, truth, settings.signal)
    with open_film(tmp_path / "a.mkv") as film, pytest.raises(MediaError, match="different simulations"):
        check_truth(film, truth, settings.signal)
    with open_film(tmp_path / "a.mkv") as film:
        film.metadata = {}  # as copied by a tool that drops metadata
        check_truth(film, truth, settings.signal)
        film.width = 320
        with pytest.raises(MediaError, match="160x120 pixels, the film of 320x120"):
            check_truth(film, truth, settings.signal)
        film.width, film.claimed_hz = 160, 500.0
        with pytest.raises(MediaError, match="1000 frames/s, the film 500"):
            check_truth(film, truth, settings.signal)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["signal.data_pairs=24"], r"^signal\.data_pairs is 24, but .* says 48 was sent"),
        (["signal.rate.high=0.5", "signal.rate.low=0.4"], r"^signal\.rate\.high is 0\.5, but .* says 0\.333"),
        (["signal.slot_order=[1,0,2,3]"], r"^signal\.slot_order is \[1, 0, 2, 3\], but .* says \[0, 1, 2, 3\]"),
    ],
)
def test_a_truth_of_another_signal_is_refused(tmp_path: Path, changes: list[str], said: str) -> None:
    write_film(tmp_path / "a.mkv", link("channel.duration_s=0.001"), [{}], seed=1)
    truth = open_truth(tmp_path / "a.mkv.truth.npz")
    with open_film(tmp_path / "a.mkv") as film, pytest.raises(MediaError, match=said):
        check_truth(film, truth, link(*changes).signal)


def test_the_films_note_lies_over_the_preset_and_changes_over_it(tmp_path: Path) -> None:
    settings = link("channel.duration_s=0.001", "signal.data_pairs=64", "signal.rate.low=0.5")
    write_film(tmp_path / "a.mkv", settings, [{}], seed=1)
    preset = link("signal.header_pairs=3", "signal.rate.high=0.8").signal
    with open_film(tmp_path / "a.mkv") as film:
        assert signal_of(film, preset) == (settings.signal, "")
        assert signal_of(film, preset, [{"data_pairs": 64}]) == (settings.signal, ""), "it says the same"
        signal, departure = signal_of(film, preset, [{"rate": {"high": 0.6}, "header_pairs": 1}, {"header_pairs": 4}])
        expected = link("signal.data_pairs=64", "signal.rate.low=0.5", "signal.rate.high=0.6", "signal.header_pairs=4")
        assert signal == expected.signal
        assert departure.startswith("not as the film's note says: signal.header_pairs=4 instead of 2, signal.rate.high")
        film.metadata = {SIGNAL_TAG: '{"data_pairs": 32}'}
        assert signal_of(film, preset)[0] == replace(preset, data_pairs=32), "what is not noted is the preset's"
        film.metadata = {}
        assert signal_of(film, preset, [{"side": 8}]) == (replace(preset, side=8), "")


@pytest.mark.parametrize("note", ["", "{", "[1]", "null", '{"sied": 3}', '{"side": 3}'])
def test_an_unreadable_note_on_the_signal_is_reported(tmp_path: Path, note: str) -> None:
    settings = link("channel.duration_s=0.001")
    with create_film(tmp_path / "a.mkv", width=160, height=120, rate_hz=1000, metadata={SIGNAL_TAG: note}) as film:
        film.write(next(iter(simulate(settings, [{}], 0)))[0])
    with open_film(tmp_path / "a.mkv") as source:
        assert signal_of(source, settings.signal, [{"side": 16}]) == (settings.signal, "")
        with pytest.raises(MediaError, match=r"note on its signal is unreadable"):
            signal_of(source, settings.signal)
