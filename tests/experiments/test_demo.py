"""Demonstration: a self-contained page with the results."""

import base64
import contextlib
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.experiments.demo import cut_out_of, demo_messages, run
from heliograph.experiments.report import Report
from heliograph.link.settings import load_settings
from heliograph.link.simulate import Recordings
from heliograph.receive.geometry.pose import Pose

pytestmark = pytest.mark.slow
SMALL = (
    "channel.speed_m_s=0", "channel.shake=none", "channel.camera.width=256", "channel.camera.height=96",
    "channel.arrays.0.x_m=0.8", "channel.arrays.0.y_m=0",
)  # fmt: skip
WEBP = b"RIFF"


@contextlib.contextmanager
def bar(title: str, total: int | None) -> Iterator[Callable[[int], None]]:
    yield lambda _: None


def demo(folder: Path, preset: str, *changes: str) -> dict[str, Any]:
    shown = list[dict[str, Any]]()
    run(folder, load_settings(preset, None, [*SMALL, *changes]), 1, Recordings(), bar, shown.append)
    return shown[0]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("demo")
    made = demo(
        folder, "two-arrays", "channel.distance_m=40", "channel.duration_s=0.6",
        "channel.arrays.1.x_m=-0.8", "channel.arrays.1.y_m=0", "channel.sensor.bits=10",
    )  # fmt: skip
    return folder, made


def test_the_page_is_self_contained_with_pictures_and_messages(two: tuple[Path, dict[str, Any]]) -> None:
    page, moving = (two[0] / "report.html").read_text(encoding="utf-8"), (two[0] / "drive.webp").read_bytes()
    assert page.startswith("<!doctype html>")
    assert page.rstrip().endswith("</html>")
    assert not re.search(r"https?:|<script|<link|@import|url\(", page)
    sources = re.findall(r'src="([^"]*)"', page)
    assert {source.partition(";base64,")[0] for source in sources} == {"data:image/svg+xml", "data:image/webp"}
    pictures = [base64.b64decode(source.partition(",")[2]) for source in sources]
    assert len(pictures) >= 6
    assert all(picture.startswith((b"<?xml", WEBP)) for picture in pictures)
    assert moving[8:12] == b"WEBP"
    assert b"ANMF" in moving
    assert len(moving) < 1_000_000
    assert page.index("data:image/webp") < page.index("data:image/svg") < page.index("<table")
    headings = re.findall(r"<h2 id=(part-\d+)>([^<]*)</h2>", page)
    assert re.findall(r"<a href=#(part-\d+)>([^<]*)</a>", page) == headings
    assert (page.count("Signal ahead: red for 12 s. Prepare to stop."), page.count("Tram 4 crosses")) == (2, 2)
    assert [text for _, text in headings][-3:] == [
        "The receivers", "Errors by distance, receiver plain", "Errors by distance, receiver soft",
    ]  # fmt: skip
    rows = re.findall(r"<td>(plain|soft)</td>" + r"<td>(\d+) of (\d+)</td>" * 3, page)
    assert [name for name, *_ in rows] == ["plain", "soft"]
    assert rows[0][2::2] == rows[1][2::2], "both receivers were sent the same codewords"
    assert sum(map(int, rows[1][1::2])) >= sum(map(int, rows[0][1::2])) > 30
    for text in (
        "Array 0, high priority", "Array 7, high priority", "What the camera saw", "rms error of position",
        "Accepted codewords that were not sent: 0.", '<span class="badge good">accepted, but not sent: 0</span>',
    ):  # fmt: skip
        assert text in page


def test_the_messages_are_files_as_well(two: tuple[Path, dict[str, Any]]) -> None:
    folder, counts = two
    sent = demo_messages(load_settings("two-arrays"))[0]
    for identity in (0, 7):
        for layer, suffix in (("high", "txt"), ("middle", "txt"), ("low", "webp")):
            assert (folder / f"array-{identity}-{layer}-0.{suffix}").read_bytes() == sent[layer][0]
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]
    assert [array["id"] for array in counts["arrays"]] == [0, 7]
    assert json.loads(json.dumps(counts)) == counts


@pytest.mark.parametrize(("change", "text"), [
    ("channel.arrays.0.x_m=30", "No packet was received, and none was completely filmed."),
    ("channel.emitter.all_on=0.001", "<td>no data</td>"),
])  # fmt: skip
def test_a_film_without_packets_has_a_report(tmp_path: Path, change: str, text: str) -> None:
    counts = demo(tmp_path, "static", "channel.duration_s=0.03", "signal.data_pairs=8", change)
    assert counts["arrays"] == []
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "No message is complete." in page
    assert text in page


def test_a_drive_too_short_still_has_its_report(tmp_path: Path) -> None:
    with pytest.raises(MediaError):
        demo(tmp_path, "static", "channel.duration_s=0.003")
    assert (tmp_path / "report.html").exists()


def test_text_is_text_on_the_page(tmp_path: Path) -> None:
    page = Report("a < b")
    page.text("<script>x</script>")
    page.code("<b>&")
    page.table(["<i>"], [["<u>"]])
    page.write(tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert not re.search(r"<script|<b>|<i>|<u>", text)
    assert "&lt;script&gt;x&lt;/script&gt;" in text
    with pytest.raises(MediaError, match="cannot write"):
        page.write(tmp_path / "none" / "a.html")


def test_the_page_shows_the_countdown_of_the_lights(two: tuple[Path, dict[str, Any]]) -> None:
    pytest.importorskip("pycrate_asn1dir", reason="needs the extra its: pip install 'heliograph[its]'")
    page = (two[0] / "report.html").read_text(encoding="utf-8")
    assert "SPATEM of junction 7: group 1 red, 12.0 s left, group 2 green, 9.0 s left" in page
    assert (two[0] / "array-0-high-1.spatem").exists()
    assert (two[0] / "array-7-middle-1.mapem").exists()


def test_cut_outs_near_and_far_have_equal_size_and_the_pixels_of_the_camera() -> None:
    pixels = np.zeros((100, 200), np.uint8)
    pixels[40:56, 90:106] = 200
    frame = Frame(0, 0.0, pixels)
    near = cut_out_of(Pose(97.5, 47.5, 1.0, 0.0, 0.5), frame)
    far = cut_out_of(Pose(97.5, 47.5, 2.0, 0.0, 0.5), frame)
    assert near.shape == far.shape == (200, 200)
    assert set(np.unique(near)) == {0, 200}
    # 16 of 22 pitches; half the width at twice the pitch
    assert np.mean(near == 200) == pytest.approx((16 / 22) ** 2, rel=0.02)
    assert np.mean(far == 200) == pytest.approx((8 / 22) ** 2, rel=0.05)
