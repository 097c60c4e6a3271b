"""Send files with symbols: simulate, receive, combine two films, write under safe names."""

import json
import random
import re
from pathlib import Path

import numpy as np
import pytest
from cli_runs import Call, lasting, succeeded

from heliograph.cli.files import FileOutput, join
from heliograph.link.file_store import FileStore, safe_name
from heliograph.link.truth import open_truth, truth_path
from heliograph.signal.fountain.cauchy import CauchyEncoder
from heliograph.signal.fountain.files import FileGatherer, FileKey, SentFile, WholeFile

EXAMPLE = Path(__file__).parents[2] / "examples" / "junction.toml"
PICTURE = random.Random(1).randbytes(1500)
DATA = b"\x01a" + bytes(range(200))
ENCODER, KEY = CauchyEncoder(DATA, 8), FileKey(0, len(DATA), 8, 0)


@pytest.mark.slow
def test_two_films_complete_a_file(tmp_path: Path, call: Call) -> None:
    (tmp_path / "map.png").write_bytes(PICTURE)
    for number, start_s in enumerate((0.0, -0.3)):
        changes = ("--set", f"channel.arrays.0.start_s={start_s}", "--file", "map.png", "--high", "brake")
        succeeded(call("simulate", f"{number}.h5", *lasting(0.32), *changes))
    assert open_truth(truth_path(tmp_path / "0.h5")).messages[0]["low"] == [SentFile("map.png", PICTURE)]
    said = succeeded(call("receive", "0.h5", "--preset", "static", "--files", "got"))
    assert re.search(r"^file [0-9a-f]{8}: 3 of 14 symbols \(21 %\)$", said, re.M)
    lacking = r"9 of 14 symbols \(64 %\), 5 missing: film longer, about 0\.2 s, or use another film"
    assert re.search(rf"^file [0-9a-f]{{8}}: {lacking}", said, re.M), said
    assert [path.suffix for path in (tmp_path / "got").iterdir()] == [".npz"]
    said = succeeded(call("receive", "1.h5", "--preset", "static", "--files", "got", "--follow"))
    files = [row for row in map(json.loads, said.splitlines()) if row["event"] == "file"]
    assert (files[0]["symbols"], files[-1]["whole"], files[-1]["name"]) == (12, True, "map.png")
    assert [(path.name, path.read_bytes()) for path in (tmp_path / "got").iterdir()] == [("map.png", PICTURE)]
    (tmp_path / "got/map.png").unlink()
    together = call("receive", "0.h5", "1.h5", "--preset", "static", "--files", "got", "--workers", "1")
    assert (together.returncode, (tmp_path / "got/map.png").read_bytes()) == (0, PICTURE)


@pytest.mark.parametrize("folder", [None, "got"])
def test_an_incomplete_file_has_a_line_with_progress_and_remedy(tmp_path: Path, folder: str | None) -> None:
    gatherer, files = FileGatherer(), FileOutput(tmp_path / folder if folder else None, is_quiet=False)
    files.begin(gatherer)
    assert list(files.incomplete_lines(gatherer, 2.0)) == []
    gatherer.take(KEY, {n: ENCODER.symbol(n) for n in range(20)})
    (line,) = files.incomplete_lines(gatherer, 2.0)
    assert line.startswith("file 00000000: 20 of 26 symbols (76 %), 6 missing: film longer, about 0.6 s, or use ")
    assert line.endswith("another film with the same --files DIR" if folder else "keeps symbols for another film")
    files.finish(gatherer)
    if folder:
        FileOutput(tmp_path / folder, is_quiet=True).begin(FileGatherer())
        assert join(tmp_path / folder) == ([], [line.replace(", about 0.6 s", "")])


@pytest.mark.parametrize(("sent", "kept"), [
    ("map.png", "map.png"), ("../../etc/passwd", "passwd"), ("C:\\Windows\\system32\\a.dll", "a.dll"), ("/", "file"),
    ("", "file"), ("..", "file"), (".bashrc", "bashrc"), ("a\0b\x1b[31m.txt", "ab_31m.txt"),
    ("con.txt", "file-con.txt"), ("Stra\u00dfe 7.jpg", "Stra_e_7.jpg"), ("x" * 300 + ".jpeg", "x" * 68 + ".jpeg"),
])  # fmt: skip
def test_a_name_from_the_air_is_no_path(sent: str, kept: str) -> None:
    assert safe_name(sent) == kept


def test_a_file_never_replaces_another(tmp_path: Path) -> None:
    store, key = FileStore(tmp_path / "new"), FileKey(1, 2, 2, 0)
    (tmp_path / "outside").write_bytes(b"mine")
    written = [store.keep(WholeFile("../outside", data), key).name for data in (b"1", b"2", b"1")]
    assert written == ["outside", "outside-2", "outside"]
    (tmp_path / "new/link").symlink_to(tmp_path / "outside")
    assert (store.keep(WholeFile("link", b"3"), key).name, (tmp_path / "outside").read_bytes()) == ("link-2", b"mine")


def test_damaged_stored_symbols_are_ignored(tmp_path: Path) -> None:
    files, rng = FileGatherer(), np.random.default_rng(1)
    files.take(KEY, {n: ENCODER.symbol(n) for n in range(5)})
    FileStore(tmp_path).finish(files)
    (part,) = tmp_path.glob(".part-*")
    whole = part.read_bytes()
    for number in range(60):
        broken = bytearray(whole)
        broken[int(rng.integers(len(whole)))] ^= 1 + int(rng.integers(255))
        (tmp_path / f".part-00000000-{number}.npz").write_bytes(broken[: int(rng.integers(len(whole)))])
    (tmp_path / ".part-00000000-x.npz").write_bytes(b"none")
    assert [one.had for one in FileStore(tmp_path).begin(FileGatherer())][-1:] == [5]


@pytest.mark.slow
def test_a_junction_is_sent_and_counted_down(tmp_path: Path, call: Call) -> None:
    pytest.importorskip("pycrate_asn1dir", reason="needs the extra its: pip install 'heliograph[its]'")
    sent = ("--junction", str(EXAMPLE), "--set", "channel.arrays.0.start_s=-0.9")
    succeeded(call("simulate", "a.h5", *lasting(0.42), *sent))
    said = succeeded(call("receive", "a.h5", "--preset", "static"))
    for red_s, green_s in ((12, 9), (11, 8)):
        assert f"49 bytes, SPATEM of junction 7: group 1 red, {red_s}.0 s left, group 2 green, {green_s}.0 s" in said
    assert "MAPEM of junction 7 (Harbour Road): 9 lanes" in said
    followed = call("receive", "a.h5", "--preset", "static", "--follow", "--verbose")
    lights = [row for row in map(json.loads, followed.stdout.splitlines()) if row["event"] == "lights"]
    # the first message predicts the state 0.9 s after its timestamp; the second corrects it
    assert [row["junctions"][0]["groups"][0]["left_s"] for row in lights] == [12.0, 11.0, 10.9, 10.8]
    assert "tells of junction 7: group 1 red, 10.9 s left" in followed.stderr
