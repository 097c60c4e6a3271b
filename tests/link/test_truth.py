"""Truth files: atomic writing, streaming, damage detection; notes in films on signal and truth."""

import contextlib
import io
import json
import os
import tempfile
import tracemalloc
import warnings
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from scenes import link

from heliograph.base.errors import MediaError
from heliograph.channel.truth import ArrayTruth, NoiseModel, Truth
from heliograph.link.film import write_film
from heliograph.link.settings import PRESETS, LinkSettings, load_settings
from heliograph.link.simulate import simulate
from heliograph.link.truth import SIGNAL_TAG, TruthWriter, check_truth, open_truth, signal_of, truth_path
from heliograph.media import create_film, open_film
from heliograph.signal.settings import LAYERS
from heliograph.transmit import Messages

SETTINGS = link("channel.duration_s=0.03")
MESSAGES: list[Messages] = [{"high": [b"one", b"two\x00"], "low": [bytes(range(256)) * 5]}]


@cache
def simulated() -> list[Truth]:
    return [truth for _, truth in simulate(SETTINGS, MESSAGES, 7)]


def write(
    path: Path, truths: Sequence[Truth] = (), settings: LinkSettings = SETTINGS, messages: Any = MESSAGES,
    seed: int = 7, film_id: str = "its id",
) -> None:  # fmt: skip
    writer = TruthWriter(path, settings, messages, seed, film_id)
    for truth in truths or simulated():
        writer.add(truth)
    with writer.finishing():
        pass


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return truth_path(tmp_path / "film.mkv")


@pytest.fixture
def written(path: Path) -> Path:
    write(path)
    return path


def test_the_name_is_the_films_with_a_suffix(tmp_path: Path) -> None:
    assert truth_path(tmp_path / "a.b.mkv") == tmp_path / "a.b.mkv.truth.npz"
    assert truth_path(Path("n" * 245)) == Path("n" * 245 + ".truth.npz")


@pytest.mark.parametrize("name", ["n" * 255, "n" * 246, "試" * 85, "\udce9" * 255])
def test_the_name_of_the_truth_is_no_longer_than_file_systems_allow(name: str) -> None:
    truth, other = truth_path(Path("d") / name), truth_path(Path("d") / name[:-1])
    assert truth.name.endswith(".truth.npz")
    assert len(os.fsencode(truth.name)) <= 255
    assert truth.name[:30] == name[:30] or "\udce9" in name
    assert truth != other


def test_numpy_reads_the_rows_and_the_noise_is_noted(written: Path) -> None:
    assert [entry.name for entry in written.parent.iterdir()] == [written.name]
    with zipfile.ZipFile(written) as archive:
        noise = json.loads(archive.read("about.json"))["noise"]
    assert noise == {"level": 0.5, "sigma": float(NoiseModel(SETTINGS.channel.sensor).sigma(0.5))}
    with np.load(written) as archive:
        assert archive["frames"]["index"].tolist() == list(range(30))


@pytest.mark.parametrize("name", PRESETS)
def test_the_settings_survive_the_file(name: str, path: Path) -> None:
    settings, truth = load_settings(name), simulated()[0]
    arrays = len(settings.channel.arrays)
    write(path, [replace(truth, arrays=truth.arrays * arrays)], settings, [{}] * arrays)
    assert open_truth(path).settings == settings


def test_rows_are_read_in_blocks_of_4096(path: Path) -> None:
    array, noise = ArrayTruth(1.0, 2.0, 3.0, 0.0, np.eye(3), 50.0, True, ()), NoiseModel(SETTINGS.channel.sensor)
    write(path, [Truth(k, 1e-3 * k, (array,), noise) for k in range(8197)])
    assert [int(row["index"]) for row in islice(open_truth(path).rows(), 3)] == [0, 1, 2]
    assert [int(row["index"]) for row in open_truth(path).rows()] == list(range(8197))


def test_aborted_or_failed_file_is_removed(path: Path) -> None:
    writer = TruthWriter(path, SETTINGS, MESSAGES, 0)
    with pytest.raises(KeyboardInterrupt), writer.finishing():
        raise KeyboardInterrupt
    assert list(path.parent.iterdir()) == []


def complaint(path: Path) -> str:
    with pytest.raises(MediaError) as caught:
        list(open_truth(path).rows())
    text = str(caught.value)
    assert (str(path) in text, text.count("\n")) == (True, 0)
    return text


def test_a_missing_file_or_folder_is_reported(path: Path, tmp_path: Path) -> None:
    assert "there is no truth file" in complaint(path)
    assert "heliograph simulate" in complaint(path.parent)
    with pytest.raises(MediaError, match="cannot write"):
        TruthWriter(tmp_path / "none" / "a.npz", SETTINGS, MESSAGES, 0)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"text", bytes(5000)])
def test_other_files_are_no_truth(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    assert "no truth file, or damaged" in complaint(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_cut_file_is_damaged(written: Path, share: float) -> None:
    data = written.read_bytes()
    written.write_bytes(data[: int(len(data) * share)])
    assert "damaged" in complaint(written)


def test_any_flipped_byte_is_harmless_or_reported(written: Path) -> None:
    data, reported = written.read_bytes(), 0
    for place in range(0, len(data), 23):
        written.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        with contextlib.suppress(MediaError):
            list(open_truth(written).rows())
            continue
        reported += 1
    assert reported > len(data) / 23 / 2


def rewritten(path: Path, **changes: bytes) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for name, data in changes.items():
        members[name.replace("_", ".")] = data
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)


@pytest.mark.parametrize(("about", "says"), [
    *((text, "no truth file, or damaged") for text in ("[]", "3", "{", "{}")),
    ("null", "no truth file, or damaged; simulate"),
    ('{"settings": {}, "messages": [], "seed": 0}', "damaged (it has messages of 0 arrays, not 1); simulate"),
])  # fmt: skip
def test_an_archive_of_something_else_is_no_truth(written: Path, about: str, says: str) -> None:
    rewritten(written, about_json=about.encode())
    assert says in complaint(written)
    assert complaint(written).count("damaged") == 1


def rows_of(path: Path, version: tuple[int, int], count: int = 30) -> bytes:
    """Return film rows in a given .npy version."""
    out = io.BytesIO()
    rows = np.array(list(open_truth(path).rows()))[:count]
    with warnings.catch_warnings(action="ignore"):  # for unneeded versions
        np.lib.format.write_array(out, rows, version)
    return out.getvalue()


def test_rows_of_either_version_are_read(written: Path) -> None:
    for version in ((1, 0), (2, 0)):
        rewritten(written, frames_npy=rows_of(written, version))
        assert [int(row["index"]) for row in open_truth(written).rows()] == list(range(30))
    rewritten(written, frames_npy=rows_of(written, (3, 0)))
    assert "damaged" in complaint(written)


def test_claimed_sizes_allocate_no_memory(written: Path) -> None:
    for claimed in (1 << 31, (1 << 16) + 1):
        rewritten(written, frames_npy=b"\x93NUMPY\x02\0" + claimed.to_bytes(4, "little") + bytes(1 << 24))
        assert "damaged" in complaint(written)  # import modules before measuring
        tracemalloc.start()
        complaint(written)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1e6


@pytest.mark.parametrize("changed", [(b"(30,)", b"(30L)"), (b"(30,)", b"(True,)"), (b"'descr': [", b"'descr': (),#")])
def test_a_damaged_header_of_the_rows_gives_no_warning(written: Path, changed: tuple[bytes, bytes]) -> None:
    rows = rows_of(written, (1, 0))
    assert changed[0] in rows
    header, size = rows.replace(*changed), int.from_bytes(rows[8:10], "little")
    size += len(header) - len(rows)
    rewritten(written, frames_npy=header[:8] + size.to_bytes(2, "little") + header[10:])
    assert "damaged" in complaint(written)


def test_a_truth_without_frames_is_refused_at_once(written: Path) -> None:
    rewritten(written, frames_npy=rows_of(written, (2, 0), count=0))
    with pytest.raises(MediaError, match="it has no frames"):
        open_truth(written)


def test_rows_of_another_type_or_number_are_damage(path: Path) -> None:
    write(path)
    with zipfile.ZipFile(path) as archive:
        frames, about = archive.read("frames.npy"), json.loads(archive.read("about.json"))
    about["settings"]["channel"]["speed"] = 3
    np.save(path.parent / "other.npy", np.zeros(5))
    other, changed = (path.parent / "other.npy").read_bytes(), json.dumps(about).encode()
    damages = ({"frames_npy": frames[:-100]}, "damaged"), ({"frames_npy": other}, "damaged")
    for change, said in (*damages, ({"about_json": changed}, "unknown setting 'channel.speed'")):
        write(path)
        rewritten(path, **change)
        assert said in complaint(path)


TWO_ARRAYS = link("channel.arrays=[{x_m=-1.0, y_m=0.0}, {x_m=1.0, y_m=0.0}]", "transmit.identities=[4, 21]")
NUMBERS = st.floats(-1e6, 1e6, width=32)
ARRAYS = st.builds(
    ArrayTruth, x=NUMBERS, y=NUMBERS, pitch_px=NUMBERS, roll_rad=NUMBERS, distance_m=NUMBERS, visible=st.booleans(),
    homography=st.lists(NUMBERS, min_size=9, max_size=9).map(lambda values: np.reshape(values, (3, 3))),
    patterns=st.lists(st.integers(0, 2**31 - 1), max_size=3).map(lambda numbers: tuple(sorted(numbers))),
)  # fmt: skip


@st.composite
def films(draw: st.DrawFn) -> tuple[LinkSettings, list[Truth]]:
    """Draw settings with one or two arrays, and frames with arbitrary times and numbers."""
    count = draw(st.sampled_from([1, 2]))
    settings = SETTINGS if count == 1 else TWO_ARRAYS
    noise, arrays = st.just(NoiseModel(settings.channel.sensor)), st.tuples(*[ARRAYS] * count)
    truths = st.builds(Truth, st.integers(0, 2**62), st.floats(-1e9, 1e9), arrays, noise)
    return settings, draw(st.lists(truths, min_size=1, max_size=6))


@st.composite
def messages(draw: st.DrawFn, arrays: int) -> list[dict[str, list[bytes]]]:
    """Draw messages per array and layer; a layer may be empty."""
    some = st.lists(st.binary(max_size=40), max_size=3)
    return [draw(st.fixed_dictionaries({}, optional=dict.fromkeys(LAYERS, some))) for _ in range(arrays)]


@examples(50)
@given(film=films(), data=st.data(), seed=st.integers(0, 2**63), film_id=st.text(max_size=8))
@pytest.mark.slow
def test_a_film_and_back(film: tuple[LinkSettings, list[Truth]], data: st.DataObject, seed: int, film_id: str) -> None:
    settings, truths = film
    sent = data.draw(messages(len(settings.channel.arrays)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mkv.truth.npz"
        write(path, truths, settings, sent, seed, film_id)
        found = open_truth(path)
        rows = list(found.rows())
    assert (found.settings, found.seed, found.film_id) == (settings, seed, film_id)
    assert list(found.messages) == [{name: by.get(name, []) for name in LAYERS} for by in sent]
    assert len(rows) == len(truths)
    for row, truth in zip(rows, truths, strict=True):
        assert (int(row["index"]), float(row["time_s"])) == (truth.index, truth.time_s)
        for got, array in zip(row["arrays"], truth.arrays, strict=True):
            for name in ("x", "y", "pitch_px", "roll_rad", "distance_m", "visible"):
                assert got[name] == getattr(array, name), name
            assert np.array_equal(got["homography"], array.homography)
            ends = (array.patterns[0], array.patterns[-1]) if array.patterns else (-1, -1)
            assert (got["pattern"], got["last_pattern"]) == ends


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


@pytest.mark.parametrize(("changes", "said"), [
    (["signal.data_pairs=24"], r"^signal\.data_pairs is 24, but .* says 48 was sent"),
    (["signal.rate.high=0.5", "signal.rate.low=0.4"], r"^signal\.rate\.high is 0\.5, but .* says 0\.333"),
    (["signal.slot_order=[1,0,2,3]"], r"^signal\.slot_order is \[1, 0, 2, 3\], but .* says \[0, 1, 2, 3\]"),
])  # fmt: skip
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
