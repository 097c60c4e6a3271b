"""Truth files: atomic writing, streaming, damage detection."""

import contextlib
import io
import json
import os
import tracemalloc
import warnings
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from small_links import small

from heliograph.base.errors import MediaError
from heliograph.channel import NoiseModel, Truth
from heliograph.link.settings import PRESETS, LinkSettings, load_settings
from heliograph.link.simulate import Messages, default_messages, simulate
from heliograph.link.truth import TruthWriter, open_truth, truth_path

SETTINGS = small("channel.duration_s=0.03")
MESSAGES: list[Messages] = [{"high": [b"one", b"two\x00"], "low": [bytes(range(256)) * 5]}]


@lru_cache(maxsize=1)
def simulated() -> tuple[Truth, ...]:
    return tuple(truth for _, truth in simulate(SETTINGS, MESSAGES, 7))


def write(path: Path, settings: LinkSettings = SETTINGS, truths: Sequence[Truth] = ()) -> Sequence[Truth]:
    messages = MESSAGES if settings is SETTINGS else default_messages(settings)
    writer = TruthWriter(path, settings, messages, 7, "its id")
    if settings is SETTINGS:
        truths = simulated()
    truths = truths or [truth for _, truth in simulate(settings, messages, 7)]
    for truth in truths:
        writer.add(truth)
    with writer.finishing():
        pass
    return truths


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return truth_path(tmp_path / "film.mkv")


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


def test_a_written_truth_is_read_back(path: Path) -> None:
    truths = write(path)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    file = open_truth(path)
    assert (file.settings, file.seed) == (SETTINGS, 7)
    assert [{n: list(m) for n, m in by_layer.items() if m} for by_layer in file.messages] == MESSAGES
    assert file.film_id == "its id"
    rows = list(file.rows())
    assert len(rows) == len(truths) == 30
    for row, truth in zip(rows, truths, strict=True):
        (array,) = truth.arrays
        assert row["index"] == truth.index
        assert row["time_s"] == truth.time_s
        assert row["arrays"][0]["distance_m"] == np.float32(array.distance_m)
        assert row["arrays"][0]["x"] == np.float32(array.x)
        assert row["arrays"][0]["y"] == np.float32(array.y)
        assert row["arrays"][0]["visible"] == array.visible
        assert row["arrays"][0]["pattern"] == array.patterns[0]
        assert row["arrays"][0]["last_pattern"] == array.patterns[-1]
        assert np.array_equal(row["arrays"][0]["homography"], array.homography.astype(np.float32))
    with zipfile.ZipFile(path) as archive:
        noise = json.loads(archive.read("about.json"))["noise"]
    assert noise == {"level": 0.5, "sigma": float(NoiseModel(SETTINGS.channel.sensor).sigma(0.5))}


def test_a_frame_across_two_patterns_names_both(path: Path) -> None:
    settings = small("channel.duration_s=0.01", "channel.camera.start_s=0.0005")
    truths = write(path, settings)
    assert any(len(truth.arrays[0].patterns) == 2 for truth in truths)
    for row, truth in zip(open_truth(path).rows(), truths, strict=True):
        shown = truth.arrays[0].patterns
        assert (row["arrays"][0]["pattern"], row["arrays"][0]["last_pattern"]) == (shown[0], shown[-1])


def test_two_arrays_and_darkness_before_the_start(path: Path) -> None:
    settings = load_settings("two-arrays", None, ["channel.duration_s=0.04", "channel.shake=none"])
    write(path, settings)
    rows = list(open_truth(path).rows())
    assert [len(row["arrays"]) for row in rows] == [2] * 40
    assert [row["arrays"][1]["pattern"] for row in rows] == [-1] * 37 + [0, 0, 1]


def test_numpy_reads_it_too(path: Path) -> None:
    write(path)
    with np.load(path) as archive:
        assert archive["frames"]["index"].tolist() == list(range(30))


@pytest.mark.parametrize("name", PRESETS)
def test_the_settings_survive_the_file(name: str, path: Path) -> None:
    settings = load_settings(name)
    truth = simulated()[0]
    write(path, settings, [replace(truth, arrays=truth.arrays * len(settings.channel.arrays))])
    assert open_truth(path).settings == settings


def test_rows_come_as_a_stream(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.link.truth.BLOCK_ROWS", 4)
    write(path)
    assert [int(row["index"]) for row in islice(open_truth(path).rows(), 3)] == [0, 1, 2]
    assert [int(row["index"]) for row in open_truth(path).rows()] == list(range(30))


def test_an_aborted_or_failed_file_leaves_nothing(path: Path) -> None:
    writer = TruthWriter(path, SETTINGS, MESSAGES, 0)

    def fail() -> None:
        with writer.finishing():
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert list(path.parent.iterdir()) == []


def test_a_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(MediaError, match="cannot write"):
        TruthWriter(tmp_path / "none" / "a.npz", SETTINGS, MESSAGES, 0)


def read_all(path: Path) -> None:
    for _ in open_truth(path).rows():
        pass


def complaint(path: Path) -> str:
    with pytest.raises(MediaError) as caught:
        read_all(path)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def test_a_missing_file_is_reported_with_the_command_that_makes_it(path: Path) -> None:
    assert "there is no truth file" in complaint(path)
    assert "heliograph simulate" in complaint(path.parent)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"text", bytes(5000)])
def test_other_files_are_no_truth(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    assert "no truth file, or damaged" in complaint(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_cut_file_is_damaged(path: Path, share: float) -> None:
    write(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    assert "damaged" in complaint(path)


def test_any_flipped_byte_is_harmless_or_reported(path: Path) -> None:
    write(path)
    data, reported = path.read_bytes(), 0
    for place in range(0, len(data), 23):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        with contextlib.suppress(MediaError):
            read_all(path)
            continue
        reported += 1
    assert reported > len(data) / 23 / 2


def rewritten(path: Path, **changes: bytes) -> None:
    """Return the archive with some members replaced."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for name, data in changes.items():
        members[name.replace("_", ".")] = data
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)


@pytest.mark.parametrize(
    ("about", "says"),
    [
        *((text, "no truth file, or damaged") for text in ("[]", "3", "{", "{}")),
        ("null", "no truth file, or damaged; simulate"),
        ('{"settings": {}, "messages": [], "seed": 0}', "damaged (it has messages of 0 arrays, not 1); simulate"),
    ],
)
def test_an_archive_of_something_else_is_no_truth(path: Path, about: str, says: str) -> None:
    write(path)
    rewritten(path, about_json=about.encode())
    assert says in complaint(path)
    assert complaint(path).count("damaged") == 1


def rows_of(path: Path, version: tuple[int, int], count: int = 30) -> bytes:
    """Return film rows in a given .npy version."""
    out = io.BytesIO()
    rows = np.array(list(open_truth(path).rows()))[:count]
    with warnings.catch_warnings(action="ignore"):  # for unneeded versions
        np.lib.format.write_array(out, rows, version)
    return out.getvalue()


def test_rows_of_either_version_are_read(path: Path) -> None:
    write(path)
    for version in ((1, 0), (2, 0)):
        rewritten(path, frames_npy=rows_of(path, version))
        assert [int(row["index"]) for row in open_truth(path).rows()] == list(range(30))
    rewritten(path, frames_npy=rows_of(path, (3, 0)))
    assert "damaged" in complaint(path)


def test_a_header_takes_no_memory_for_what_it_claims(path: Path) -> None:
    write(path)
    for claimed in (1 << 31, (1 << 16) + 1):
        rewritten(path, frames_npy=b"\x93NUMPY\x02\0" + claimed.to_bytes(4, "little") + bytes(1 << 24))
        assert "damaged" in complaint(path)  # import modules before measuring
        tracemalloc.start()
        complaint(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1e6


@pytest.mark.parametrize("changed", [(b"(30,)", b"(30L)"), (b"(30,)", b"(True,)"), (b"'descr': [", b"'descr': (),#")])
def test_a_damaged_header_of_the_rows_gives_no_warning(path: Path, changed: tuple[bytes, bytes]) -> None:
    write(path)
    rows = rows_of(path, (1, 0))
    assert changed[0] in rows
    header, size = rows.replace(*changed), int.from_bytes(rows[8:10], "little")
    size += len(header) - len(rows)
    rewritten(path, frames_npy=header[:8] + size.to_bytes(2, "little") + header[10:])
    assert "damaged" in complaint(path)


def test_a_truth_without_frames_is_refused_at_once(path: Path) -> None:
    write(path)
    rewritten(path, frames_npy=rows_of(path, (2, 0), count=0))
    with pytest.raises(MediaError, match="it has no frames"):
        open_truth(path)


def test_rows_of_another_type_or_number_are_damage(path: Path) -> None:
    write(path)
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        frames, about = archive.read("frames.npy"), json.loads(archive.read("about.json"))
    rewritten(path, frames_npy=frames[:-100])
    assert "damaged" in complaint(path)
    path.write_bytes(whole)
    kind = np.lib.format.dtype_to_descr(np.dtype("f8"))
    np.save(path.parent / "other.npy", np.zeros(5, kind))
    rewritten(path, frames_npy=(path.parent / "other.npy").read_bytes())
    assert "damaged" in complaint(path)
    path.write_bytes(whole)
    about["settings"]["channel"]["speed"] = 3
    rewritten(path, about_json=json.dumps(about).encode())
    assert "unknown setting 'channel.speed'" in complaint(path)
